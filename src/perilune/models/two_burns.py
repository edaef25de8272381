"""Burn, coast, burn by nonlinear programming: both burns finite, each free fall between them in closed form.

In units of the ground's radius, the speed of a circle there and the first mass, with the flow q and the lengths t_1 and
t_2 of the burns,

    minimise q (t_1 + t_2);   wait, burn, fall to the lowest point on or above the ground, fall on, burn to rest on it.

A fall is Lagrange's f and g in the difference of the eccentric anomalies, of which its time is an explicit function
(Battin 1999, section 4.3), so that no equation of Kepler is left to be solved. The first burn, which is brief, keeps
its direction; the second is flown against a primer vector, p'' = (dg/dr) p (Lawden 1963, chapter 3), whose first value
and rate are unknowns. The states with which arcs begin are unknowns too: the multipliers of what joins them to the arc
before are the costates there, but for their sign. All of that is in axes along the radius, ahead and along the momentum
where the first burn begins: a longer wait turns the whole flight, and in them changes almost nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from threading import Lock
from typing import Any

import casadi as ca
import numpy as np

from perilune.models.two_impulses import Around, TwoImpulses, fallen, time_down
from perilune.words.types import Matrix, Vector

_BRIEF, _STEPS = 3, 16  # of Runge and Kutta along the burns
_LATE = 0.45  # of the length of the second burn: how long behind the lowest point it is expected to begin
_ITERATIONS, _TOLERANCE = 200, 1e-12
_NEAR = 0.9  # canonical: how far from where they are expected states and anomalies may come to lie
_KEPLER_STEPS = 50
_DIFFERENCE = 1e-5  # of place or velocity: how far apart neighbouring falls begin
_NO_TIME = 1e-5  # of the flight: an arc that is shorter is none
_LOCK = Lock()  # a compiled program serves one thread at a time


@dataclass(frozen=True, kw_only=True)
class Burning:
    """What burns: mass [kg] at the start, thrust [N], exhaust speed [m/s]."""

    mass: float
    force: float
    exhaust: float


@dataclass(frozen=True, kw_only=True)
class Leg:
    """An arc as it is flown, in axes that do not turn.

    Parameters
    ----------
    burns, touches
        Whether the engine is on, and whether the arc ends on the ground that holds it back.
    times
        [s], (n,).
    states, costates
        Place, velocity, mass, and theirs of J = -m_f [kg], (7, n).
    """

    burns: bool
    touches: bool
    times: Vector
    states: Matrix
    costates: Matrix


@dataclass(frozen=True, kw_only=True)
class TwoBurns:
    """A landing by two burns.

    Parameters
    ----------
    lengths
        Of wait, first burn, fall to the lowest point, fall behind it, second burn [s].
    states, costates
        With which these begin: place, velocity and mass, of J = -m_f [kg] (5, 7).
    touch
        Multiplier of the height of the lowest point, canonical: above 0 where the ground holds it back.
    around, burning
        Where it begins, and what burns.
    """

    lengths: Vector
    states: Matrix
    costates: Matrix
    touch: float
    around: Around
    burning: Burning

    @property
    def landed(self) -> float:
        """Mass [kg] on the ground."""
        burnt = self.burning.force / self.burning.exhaust * (self.lengths[1] + self.lengths[4])
        return self.burning.mass - float(burnt)

    def legs(self, counts: Sequence[int]) -> Iterator[Leg]:
        """Fly the arcs, with so many rows each.

        Parameters
        ----------
        counts
            Of the five arcs.
        """
        begin = 0.0
        for k, (count, length) in enumerate(zip(counts, self.lengths, strict=True)):
            burns, shares = k in (1, 4), np.linspace(0.0, 1.0, count + 1)
            if length <= _NO_TIME * self.lengths.sum():
                continue
            rows = [(self._burnt if burns else self._fallen)(k, share * length) for share in shares]
            states, costates = (np.array([row[i] for row in rows]).T for i in (0, 1))
            touches = k == 2 and self.touch > 0.0
            yield Leg(burns=burns, touches=touches, times=begin + shares * length, states=states, costates=costates)
            begin += length

    def _fallen(self, k: int, t: float) -> tuple[Vector, Vector]:
        """Fall from the start of an arc."""
        return carried(self.states[k], self.costates[k], self.around.mu, t)

    def _burnt(self, k: int, t: float) -> tuple[Vector, Vector]:
        """Burn from the start of an arc."""
        units = _Units.of(self.around, self.burning)
        state, costate = self.states[k] / units.states, self.costates[k] * units.states / self.burning.mass
        law = np.concatenate([costate[3:6], costate[:3]])
        y = np.array(_program().burn(state, law, t / units.time, units.force, units.flow)).ravel()
        costates = np.concatenate([y[10:13], y[7:10], [costate[6] - y[13]]])
        return y[:7] * units.states, costates * self.burning.mass / units.states


@dataclass(frozen=True, kw_only=True)
class _Units:
    """Of the states and of time; thrust and flow in them."""

    states: Vector
    time: float
    force: float
    flow: float

    @classmethod
    def of(cls, around: Around, burning: Burning) -> _Units:
        speed = math.sqrt(around.mu / around.radius)
        states = np.array([around.radius] * 3 + [speed] * 3 + [burning.mass])
        force = burning.force / burning.mass / (around.mu / around.radius**2)
        return cls(states=states, time=around.radius / speed, force=force, flow=force * speed / burning.exhaust)


@dataclass(frozen=True, kw_only=True)
class _Program:
    """The compiled program; where its unknowns and conditions lie; the times of its falls, and its axes; a burn."""

    solver: ca.Function
    unknowns: dict[str, slice]
    conditions: dict[str, slice]
    falls: ca.Function
    burn: ca.Function


def _length(vector: Vector) -> float:
    return float(np.linalg.norm(vector)) + 1e-300


def carried(state: Vector, costate: Vector, mu: float, t: float) -> tuple[Vector, Vector]:
    """Return a state and its costate after a free fall: costates (rate, primer) follow from two neighbouring falls."""
    place, velocity, primer, rate = state[:3], state[3:6], costate[3:6], -costate[:3]
    size = _DIFFERENCE * min(_length(place) / _length(primer), _length(velocity) / _length(rate))
    ahead, behind = (fallen(place + s * primer, velocity + s * rate, mu, t) for s in (size, -size))
    moved = [(after - before) / (2 * size) for after, before in zip(ahead, behind, strict=True)]
    there = np.concatenate([*fallen(place, velocity, mu, t), state[6:]])
    return there, np.concatenate([-moved[1], moved[0], costate[6:]])


def _falling(s: Any, x: Any) -> tuple[Any, Any]:
    """Return place and velocity a difference x of eccentric anomalies on, and the time until then; canonical."""
    r, v = s[:3], s[3:6]
    distance = ca.norm_2(r)
    semi = 1 / (2 / distance - ca.dot(v, v))
    rising, turn = ca.dot(r, v) / ca.sqrt(semi), ca.sqrt(semi) ** 3
    time = turn * (x - (1 - distance / semi) * ca.sin(x) + rising * (1 - ca.cos(x)))
    there = (1 - semi / distance * (1 - ca.cos(x))) * r + (time - turn * (x - ca.sin(x))) * v
    far = ca.norm_2(there)
    f_rate, g_rate = -ca.sqrt(semi) / (distance * far) * ca.sin(x), 1 - semi / far * (1 - ca.cos(x))
    return ca.vertcat(there, f_rate * r + g_rate * v), time


def _burnt(state: Any, law: Any, time: Any, force: Any, flow: Any, steps: int) -> Any:
    """Return state, costates of velocity and place, and what the costate of mass has lost; canonical."""
    y, h = ca.vertcat(state, law, 0), time / steps

    def rates(y: Any) -> Any:
        r, v, m, primer, slope = y[:3], y[3:6], y[6], y[7:10], y[10:13]
        distance, size = ca.norm_2(r), ca.norm_2(primer)
        pull = primer / distance**3 - 3 * r * ca.dot(r, primer) / distance**5
        push = -r / distance**3 - force / m * primer / size
        return ca.vertcat(v, push, -flow, -slope, pull, force * size / m**2)

    for _ in range(steps):
        k1 = rates(y)
        k2 = rates(y + h / 2 * k1)
        k3 = rates(y + h / 2 * k2)
        k4 = rates(y + h * k3)
        y += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return y


class _Sheet:
    """Symbols and conditions of a program, by name."""

    def __init__(self) -> None:
        self.symbols: list[Any] = []
        self.residuals: list[Any] = []
        self.unknowns: dict[str, slice] = {}
        self.conditions: dict[str, slice] = {}

    def unknown(self, name: str, count: int = 1) -> Any:
        first = sum(symbol.numel() for symbol in self.symbols)
        self.unknowns[name] = slice(first, first + count)
        self.symbols.append(ca.SX.sym(name, count))
        return self.symbols[-1]

    def condition(self, name: str, value: Any) -> None:
        first = sum(residual.numel() for residual in self.residuals)
        self.conditions[name] = slice(first, first + value.numel())
        self.residuals.append(value)

    def joined(self, name: str, value: Any) -> Any:
        """Return an unknown state, with the condition that it is where the arc before ends."""
        state = self.unknown(name, value.numel())
        self.condition(name, state - value)
        return state


def _axes(state: Any) -> Any:
    """Return unit vectors along the radius, ahead and along the momentum, in columns."""
    up, normal = state[:3] / ca.norm_2(state[:3]), ca.cross(state[:3], state[3:])
    normal /= ca.norm_2(normal)
    return ca.horzcat(up, ca.cross(normal, up), normal)


def _lowest_point(state: Any) -> tuple[Any, Any]:
    """Return distance and speed where an orbit is lowest, and its `_axes` there; canonical."""
    r, v = state[:3], state[3:6]
    momentum = ca.cross(r, v)
    eccentric = ca.cross(v, momentum) - r / ca.norm_2(r)
    eccentricity, normal = ca.norm_2(eccentric), momentum / ca.norm_2(momentum)
    distance = ca.dot(momentum, momentum) / (1 + eccentricity)
    up = eccentric / eccentricity
    return ca.vertcat(distance, (1 + eccentricity) / ca.norm_2(momentum)), ca.horzcat(up, ca.cross(normal, up), normal)


@cache
def _program() -> _Program:
    sheet, p = _Sheet(), ca.SX.sym("p", 9)
    force, flow, turning = p[6], p[7], ca.vertcat(0, 0, p[8])
    state, wait = _falling(p[:6], sheet.unknown("wait"))
    axes = _axes(state)
    begun, direction, length = (
        sheet.joined("begun", ca.vertcat(ca.mtimes(axes.T, state[:3]), ca.mtimes(axes.T, state[3:]))),
        sheet.unknown("direction", 3),
        sheet.unknown("first"),
    )
    sheet.condition("of length 1", ca.dot(direction, direction) - 1)
    state = _burnt(ca.vertcat(begun, 1), ca.vertcat(direction, 0, 0, 0), length, force, flow, _BRIEF)
    left = sheet.joined("left", state[:7])
    reached, seen = _lowest_point(left)
    lowest = sheet.joined("lowest", reached)
    state, rest = _falling(ca.vertcat(lowest[0], 0, 0, 0, lowest[1], 0), sheet.unknown("rest"))
    braked, law, lasts = sheet.joined("braked", state), sheet.unknown("law", 6), sheet.unknown("second")
    sheet.condition("of length 1 too", ca.dot(law[:3], law[:3]) - 1)
    end = _burnt(ca.vertcat(braked, left[6]), law, lasts, force, flow, _STEPS)
    seen = ca.mtimes(axes, seen)
    sheet.condition("ground", ca.dot(end[:3], end[:3]) - 1)
    sheet.condition("at rest", end[3:6] - ca.cross(ca.mtimes(seen.T, turning), end[:3]))
    unknowns = ca.vertcat(*sheet.symbols)
    options = {
        "print_time": False, "error_on_fail": False, "show_eval_warnings": False, "ipopt.print_level": 0,
        "ipopt.sb": "yes", "ipopt.max_iter": _ITERATIONS, "ipopt.tol": _TOLERANCE, "ipopt.mu_init": 1e-3,
    }  # fmt: skip
    program = {"x": unknowns, "f": flow * (length + lasts), "g": ca.vertcat(*sheet.residuals), "p": p}
    s, by, t = (ca.SX.sym(name, count) for name, count in (("s", 7), ("by", 6), ("t", 1)))
    return _Program(
        solver=ca.nlpsol("two_burns", "ipopt", program, options),
        unknowns=sheet.unknowns,
        conditions=sheet.conditions,
        falls=ca.Function("falls", [unknowns, p], [ca.vertcat(wait, rest), axes, seen]),
        burn=ca.Function("burn", [s, by, t, force, flow], [_burnt(s, by, t, force, flow, _STEPS)]),
    )


def two_burns(around: Around, landing: TwoImpulses, burning: Burning, *, at_once: bool) -> TwoBurns | None:
    """Return the landing by two burns near one by two impulses.

    Parameters
    ----------
    around, landing, burning
        Where it begins, the impulses, and what burns.
    at_once
        Whether it does not wait: where waiting costs nothing no wait is the best.

    Returns
    -------
    TwoBurns
        None where none was found.
    """
    units, program = _Units.of(around, burning), _program()
    expected = _expected(landing, units)
    start = np.concatenate([around.position, around.velocity]) / units.states[:6]
    expected["wait"] = _anomaly(start, landing.wait / units.time)
    lower, upper = _beside(expected)
    if at_once:
        lower["wait"], upper["wait"] = np.zeros(1), np.zeros(1)
    numbers = np.concatenate([start, [units.force, units.flow, around.turning[2] * units.time]])
    at, low, high = (np.concatenate([of[name] for name in program.unknowns]) for of in (expected, lower, upper))
    with _LOCK:
        found = program.solver(x0=at, p=numbers, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
        solved = program.solver.stats()["success"]
    return _told(program, found, numbers, units, around, burning) if solved else None


def _told(program: _Program, found: Any, numbers: Vector, units: _Units, around: Around, burning: Burning) -> TwoBurns:
    """Return an answer of the program in SI and in axes that do not turn."""
    x, multipliers = np.array(found["x"]).ravel(), np.array(found["lam_g"]).ravel()

    def of(name: str) -> Vector:
        return x[program.unknowns[name]]

    falls, axes, seen = (np.array(value) for value in program.falls(x, numbers))
    wait, rest = falls.ravel()

    def begin(name: str, mass: float, axes: Matrix) -> tuple[Vector, Vector]:
        """Return state and costate with which an arc begins, canonical, the costate of mass left out."""
        state, by = of(name)[:6].reshape(2, 3) @ axes.T, -multipliers[program.conditions[name]][:6].reshape(2, 3)
        return np.append(state, mass), np.append(by @ axes.T, 0.0)

    mass = float(of("left")[6])
    begun, left, braked = begin("begun", 1.0, axes), begin("left", mass, axes), begin("braked", mass, seen)
    law = of("law") * np.linalg.norm(braked[1][3:6])
    braked[1][:6] = np.concatenate([seen @ law[3:], seen @ law[:3]])

    def lost(state: Vector, costate: Vector, length: float) -> float:
        by = np.concatenate([costate[3:6], costate[:3]])
        return float(program.burn(state, by, length, units.force, units.flow)[13])

    first, second = float(of("first")[0]), float(of("second")[0])
    braked[1][6] = left[1][6] = -1.0 + lost(*braked, second)
    begun[1][6] = left[1][6] + lost(*begun, first)
    lowest, start = carried(*braked, 1.0, -rest), carried(*begun, 1.0, -wait)
    fall = time_down(left[0][:3], left[0][3:6], 1.0)
    states, costates = (np.array([arc[i] for arc in (start, begun, left, lowest, braked)]) for i in (0, 1))
    touch = -float(np.array(found["lam_x"]).ravel()[program.unknowns["lowest"]][0])
    return TwoBurns(
        lengths=np.array([wait, first, fall, rest, second]) * units.time, states=states * units.states, touch=touch,
        costates=costates * burning.mass / units.states, around=around, burning=burning,
    )  # fmt: skip


def _expected(landing: TwoImpulses, units: _Units) -> dict[str, Vector]:
    """Return the unknowns of the landing by two impulses but for the wait, canonical."""
    scale, axes = units.states[:6], np.array(_axes(ca.DM(np.concatenate(landing.before))))

    def seen(place: Vector, velocity: Vector) -> Vector:
        return np.concatenate([place @ axes, velocity @ axes]) / scale

    begun, left = seen(*landing.before), seen(landing.before[0], landing.after)
    axes = np.array(_axes(ca.DM(np.concatenate(landing.lowest))))  # of `seen` from here on
    lowest = seen(*landing.lowest)
    burnt, exhaust = list[float](), units.force / units.flow
    for change in (landing.first, landing.second):
        burnt.append((1 - sum(burnt)) * (1 - math.exp(-change / scale[3] / exhaust)))
    first, second = burnt[0] / units.flow, burnt[1] / units.flow
    braked = np.concatenate(fallen(lowest[:3], lowest[3:], 1.0, _LATE * second))
    # Down to the ground's velocity, and upwards against the weight that the fall's bend does not carry.
    over_ground = braked[3:] - landing.ground @ axes / scale[3]
    law = over_ground / _length(over_ground) - 0.3 * braked[:3] / _length(braked[:3]) / units.force
    faster = landing.after @ (landing.after - landing.before[1]) > 0
    return {
        "begun": begun,
        "direction": begun[3:] / _length(begun[3:]) * (-1.0 if faster else 1.0), "first": np.array([first]),
        "left": np.append(left, 1 - burnt[0]), "lowest": lowest[[0, 4]],
        "rest": _anomaly(lowest, _LATE * second), "braked": braked,
        "law": np.append(law / _length(law), np.zeros(3)), "second": np.array([second]),
    }  # fmt: skip


def _beside(expected: dict[str, Vector]) -> tuple[dict[str, Vector], dict[str, Vector]]:
    """Return bounds of the unknowns around what is expected: farther off the way down is another."""
    lower, upper = ({name: value + side for name, value in expected.items()} for side in (-_NEAR, _NEAR))
    second = float(expected["second"][0])
    upper["first"], upper["second"] = 3 * expected["first"] + 0.2 * second, 2 * expected["second"]
    lower["second"], lower["lowest"][0] = 0.5 * expected["second"], 1.0
    lower["first"] = np.zeros(1)
    for name in ("wait", "rest"):
        lower[name] = np.maximum(lower[name], 0.0)
    upper["law"], upper["direction"] = np.repeat((1.2, 3 / second), 3), np.full(3, 1.2)
    lower["law"], lower["direction"] = -upper["law"], -upper["direction"]
    return lower, upper


def _anomaly(state: Vector, time: float) -> Vector:
    """Return the difference of eccentric anomalies of a free fall; canonical."""
    distance = float(np.linalg.norm(state[:3]))
    semi = 1 / (2 / distance - float(state[3:] @ state[3:]))
    rising, mean = float(state[:3] @ state[3:]) / math.sqrt(semi), time / semi**1.5
    x = mean
    for _ in range(_KEPLER_STEPS):
        miss = x - (1 - distance / semi) * math.sin(x) + rising * (1 - math.cos(x)) - mean
        x -= miss / (1 - (1 - distance / semi) * math.cos(x) + rising * math.sin(x))
    return np.array([x])
