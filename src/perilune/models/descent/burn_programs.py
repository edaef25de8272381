"""Nonlinear programs of burn, coast, burn: the ground is grazed by the fall, or by the last burn.

In units of the ground's radius, the speed of a circle there and the first mass, with the flow q and the lengths of the
burns, minimise what is burnt:

    wait, burn, fall to the lowest point on or above the ground, fall on, burn to rest on it;
    (`fall_grazing_program`) wait, burn, fall, burn to a lowest point on or above the ground, burn on to rest on it.
    (`burn_grazing_program`)

A second brief burn may come before the fall, with a fall between both.

A fall is Lagrange's f and g in the difference of the eccentric anomalies, of which its time is an explicit function
(Battin 1999, section 4.3), so that no equation of Kepler is left to be solved. The first brief burn keeps its
direction; later ones are flown against a primer vector, p'' = (dg/dr) p (Lawden 1963, chapter 3), whose first value and
rate are unknowns, and whose rate jumps along the radius where the ground is grazed (Bryson and Ho 1975, section 3.11).
The states with which arcs begin are unknowns too: the multipliers of what joins them to the arc before are the costates
there, but for their sign. All of that is in axes along the radius, ahead and along the momentum where the first burn
begins: a longer wait turns the whole flight, and in them changes almost nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca

_BRIEF, _STEPS = 3, 16  # of Runge and Kutta along the burns
_ITERATIONS, _TOLERANCE = 150, 1e-12


@dataclass(frozen=True, kw_only=True)
class BurnProgram:
    """A compiled program.

    Parameters
    ----------
    solver
        Of the unknowns x, with p: place and velocity (6), thrust, flow, rate at which the body turns.
    unknowns, conditions
        Where these lie, by name.
    falls
        Of x and p: times of the falls that end with a burn; axes (3, 3) of the states before and behind the last.
    brief
        How many burns come before the last.
    """

    solver: ca.Function
    unknowns: dict[str, slice]
    conditions: dict[str, slice]
    falls: ca.Function
    brief: int


class _ProgramBuilder:
    """Symbols and conditions of a program, by name."""

    def __init__(self) -> None:
        self.p: Any = ca.SX.sym("p", 9)
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

    def burnt(self, state: Any, law: Any, length: Any, steps: int = _STEPS) -> Any:
        return _burn_end(state, law, length, self.p[6], self.p[7], steps)

    def raised(self, brief: int) -> tuple[Any, Any, list[Any], list[Any]]:
        """Fall and burn; return the axes, the state (7) behind the last brief burn, times of falls and of burns."""
        state, fall = _fall_by_anomaly(self.p[:6], self.unknown("fall1"))
        axes, mass, falls, burns = orbital_axes(state), 1, [fall], list[Any]()
        state = ca.vertcat(ca.mtimes(axes.T, state[:3]), ca.mtimes(axes.T, state[3:]))
        for k in range(1, brief + 1):
            begun = self.joined(f"begun{k}", state)
            direction, length = self.unknown(f"direction{k}", 3), self.unknown(f"burn{k}")
            self.condition(f"of length {k}", ca.dot(direction, direction) - 1)
            slope = self.unknown(f"slope{k}", 3) if k > 1 else ca.SX.zeros(3)
            state = self.burnt(ca.vertcat(begun, mass), ca.vertcat(direction, slope), length, _BRIEF)
            left = self.joined(f"left{k}", state[:7])
            burns, mass = [*burns, length], left[6]
            if k < brief:
                state, fall = _fall_by_anomaly(left[:6], self.unknown(f"fall{k + 1}"))
                falls.append(fall)
        return axes, left, falls, burns

    def primer(self) -> Any:
        """Return value and rate of the primer vector with which the second burn begins, the value of length 1."""
        law = self.unknown("law", 6)
        self.condition("of length 1 too", ca.dot(law[:3], law[:3]) - 1)
        return law

    def compiled(self, end: Any, axes: Any, lengths: Any, falls: Any) -> BurnProgram:
        """End at rest on the ground, seen in axes, with the least that burns of these lengths need."""
        turning = ca.mtimes(axes[1].T, ca.vertcat(0, 0, self.p[8]))
        self.condition("ground", ca.dot(end[:3], end[:3]) - 1)
        self.condition("at rest", end[3:6] - ca.cross(turning, end[:3]))
        x = ca.vertcat(*self.symbols)
        # Waits and burns differ by a millionth of what is burnt: a greater barrier drives away from what is near.
        barrier, push = (1e-7, 1e-2) if len(falls) == 2 else (1e-8, 1e-3)  # three burns begin near two
        options = {
            "print_time": False, "error_on_fail": False, "show_eval_warnings": False, "ipopt.print_level": 0,
            "ipopt.sb": "yes", "ipopt.max_iter": _ITERATIONS, "ipopt.tol": _TOLERANCE, "ipopt.mu_init": barrier,
            "ipopt.bound_push": push, "ipopt.bound_frac": push,
        }  # fmt: skip
        program = {"x": x, "f": self.p[7] * lengths, "g": ca.vertcat(*self.residuals), "p": self.p}
        return BurnProgram(
            solver=ca.nlpsol("two_burns", "ipopt", program, options),
            unknowns=self.unknowns,
            conditions=self.conditions,
            falls=ca.Function("falls", [x, self.p], [ca.vertcat(*falls), *axes]),
            brief=len(falls) - 1,
        )


@cache
def fall_grazing_program(brief: int = 1) -> BurnProgram:
    """Return the program whose fall has its lowest point on or above the ground, after so many brief burns."""
    program = _ProgramBuilder()
    axes, left, falls, burns = program.raised(brief)
    reached, seen = _lowest_point(left)
    lowest = program.joined("lowest", reached)
    state, rest = _fall_by_anomaly(ca.vertcat(lowest[0], 0, 0, 0, lowest[1], 0), program.unknown("rest"))
    braked, law, second = program.joined("braked", state), program.primer(), program.unknown("second")
    end = program.burnt(ca.vertcat(braked, left[6]), law, second)
    return program.compiled(end, (axes, ca.mtimes(axes, seen)), sum(burns) + second, (*falls, rest))


@cache
def burn_grazing_program(brief: int = 1) -> BurnProgram:
    """Return the program whose second burn has its lowest point on or above the ground before its end."""
    program = _ProgramBuilder()
    axes, left, falls, burns = program.raised(brief)
    state, down = _fall_by_anomaly(left[:6], program.unknown("down"))
    braked, law, early = program.joined("braked", state), program.primer(), program.unknown("early")
    end = program.burnt(ca.vertcat(braked, left[6]), law, early)
    lowest, height = program.joined("lowest", end[:7]), program.unknown("height")
    program.condition("height", ca.norm_2(lowest[:3]) - height)
    program.condition("level", ca.dot(lowest[:3], lowest[3:6]))
    pull = -program.p[6] / lowest[6] * end[7:10] / ca.norm_2(end[7:10]) - lowest[:3] / ca.norm_2(lowest[:3]) ** 3
    bend = ca.dot(lowest[3:6], lowest[3:6]) + ca.dot(lowest[:3], pull)  # where it is below 0 the point is a highest one
    program.condition("turning up", bend - program.unknown("bend"))
    slope, second = end[10:13] + program.unknown("jump") * lowest[:3], program.unknown("second")
    end = program.burnt(lowest, ca.vertcat(end[7:10], slope), second)
    return program.compiled(end, (axes, axes), sum(burns) + early + second, (*falls, down))


@cache
def compile_burn() -> ca.Function:
    """Return a burn as a function of state (7), law (6), length, thrust and flow, as `_burn_end`; canonical."""
    s, by, t, force, flow = (ca.SX.sym(name, n) for name, n in (("s", 7), ("by", 6), ("t", 1), ("f", 1), ("q", 1)))
    return ca.Function("burn", [s, by, t, force, flow], [_burn_end(s, by, t, force, flow, _STEPS)])


def _fall_by_anomaly(s: Any, x: Any) -> tuple[Any, Any]:
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


def _burn_end(state: Any, law: Any, time: Any, force: Any, flow: Any, steps: int) -> Any:
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


def orbital_axes(state: Any) -> Any:
    """Return unit vectors along the radius, ahead and along the momentum, in columns."""
    up, normal = state[:3] / ca.norm_2(state[:3]), ca.cross(state[:3], state[3:])
    normal /= ca.norm_2(normal)
    return ca.horzcat(up, ca.cross(normal, up), normal)


def _lowest_point(state: Any) -> tuple[Any, Any]:
    """Return distance and speed where an orbit is lowest, and its `orbital_axes` there; canonical."""
    r, v = state[:3], state[3:6]
    momentum = ca.cross(r, v)
    eccentric = ca.cross(v, momentum) - r / ca.norm_2(r)
    eccentricity, normal = ca.norm_2(eccentric), momentum / ca.norm_2(momentum)
    distance = ca.dot(momentum, momentum) / (1 + eccentricity)
    up = eccentric / eccentricity
    return ca.vertcat(distance, (1 + eccentricity) / ca.norm_2(momentum)), ca.horzcat(up, ca.cross(normal, up), normal)
