"""Burn, coast, burn as a rough flight: where the search for the landing of a strong lander begins.

The burns of a landing by two impulses (`perilune.models.two_impulses`) last as long as the rocket equation says. The
second is flown with the tangent of the thrust's elevation linear in time (Lawden 1963, section 3.4, without gravity's
gradient), whose two constants and length bring it to rest on the ground.

Costates are those of impulses (Lawden 1963, chapter 3): J = -m_f, so that with the primer vector p, of length 1 and
against the thrust at both impulses, and the exhaust speed c

    lam_v = (m_f/c) p,   lam_r = -lam_v',   lam_m = -m_f/m;    p'' = (dg/dr) p on the fall,

whose p' at the first impulse is the one that leads to p at the second.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from perilune.models.limits import exhaust_speed, greatest_thrust
from perilune.models.two_impulses import Around, TwoImpulses, around_body, fallen, orbit_shape, two_impulses
from perilune.problem.guess import guess
from perilune.problem.problem import Problem
from perilune.problem.solution import Curve, Solution
from perilune.structures.structure import Arc, Structure
from perilune.words.maths import NUMERIC
from perilune.words.types import Matrix, Vector

_GROUND = "height_above_site"  # the condition that the coast touches
_BESIDE = (0.45, 0.7, 0.2)  # of the length of the second burn: how long after the lowest point it begins
_WAIT, _COAST, _BURN, _BRIEF = 40, 60, 25, 5  # rows of the arcs
_SHORT = 1e-3  # of a turn: a wait that is shorter is none
_DIFFERENCE = 1e-4  # of a distance: how far neighbouring falls begin apart
_SINGULAR = 1e-3  # half a turn on, no rate across the plane shows in the place
_INSTANT = 1e-3  # of the second burn: how far apart slopes are taken
_STEPS = 50  # of the second burn


@dataclass
class _Rows:
    """A flight as it is written down, in inertial axes, and its arcs."""

    times: list[float] = field(default_factory=list)
    states: list[Vector] = field(default_factory=list)
    controls: list[Vector] = field(default_factory=list)
    arcs: list[Arc] = field(default_factory=list)
    primers: list[list[Vector]] = field(default_factory=list)  # arc by arc: time, primer vector, its rate, mass

    def fly(
        self, count: int, lasts: float, at: Callable[[float], Any], throttle: float, regime: str, touch: str = ""
    ) -> None:
        """Add an arc of so many rows [s]: place, velocity, mass, direction, primer vector and rate at times of it."""
        begin = self.times[-1] if self.times else 0.0
        known, primers = bool(self.times), list[Vector]()
        for share in np.linspace(0.0, 1.0, count + 1):
            position, velocity, mass, direction, primer, rate = at(share * lasts)
            primers.append(np.concatenate([[begin + share * lasts], primer, rate, [mass]]))
            if known and share == 0.0:
                continue
            self.times.append(begin + share * lasts)
            self.states.append(np.concatenate([position, velocity, [mass]]))
            self.controls.append(np.append(direction, throttle))
        self.primers.append(primers)
        touches = (touch,) if touch else ()
        self.arcs.append(Arc(regimes=(("throttle", regime),), touches=touches, until=self.times[-1]))


def rough_landing(problem: Problem) -> list[tuple[Solution, Structure]]:
    """Return burn-coast-burn flights of a powered descent, by `two_impulses`.

    Parameters
    ----------
    problem
        In Cartesian coordinates, throttled, to rest anywhere.

    Returns
    -------
    list
        Rough flights with their arcs, which touch the ground where the fall is lowest and brake sooner or later behind
        that, and the first of them without a touch; none where there is no landing by two impulses, or the engine
        cannot be off.
    """
    p = problem.parameters({f.name: f.typical for f in problem.free})
    start = np.array(problem.start(p, NUMERIC), dtype=float)
    if p.throttle_lower > 0.0 or (landing := two_impulses(around := around_body(p, start))) is None:
        return []
    about: Any = {"around": around, "landing": landing, "mass": float(start[6]), "force": greatest_thrust(p),
                  "exhaust": exhaust_speed(p)}  # fmt: skip
    drawn = [_drawn(problem, p, _Flight(**about, beside=beside)) for beside in _BESIDE]
    rough, structure = drawn[0]
    clear = Structure((tuple(arc for arc in structure.phases[0] if not arc.touches),))
    return [*drawn, (rough, clear)]


def _drawn(problem: Problem, p: Any, flight: _Flight) -> tuple[Solution, Structure]:
    """Return a flight as a guess, with its arcs."""
    rows, low, high = _Rows(), p.throttle_lower, p.throttle_upper
    if flight.waits:
        rows.fly(_WAIT, flight.begin, flight.waiting, low, "lower")
    rows.fly(_BRIEF, flight.burns, flight.burning, high, "upper")
    rows.fly(_COAST, flight.landing.fall - flight.late, flight.falling, low, "lower", _GROUND)
    rows.fly(_BRIEF, flight.rest, flight.rising, low, "lower")
    rows.fly(_BURN, flight.second.lasts, flight.braking, high, "upper")
    return _seen(problem, rows, p.body_rotation_rate, flight.exhaust), Structure((tuple(rows.arcs),))


@dataclass(kw_only=True)
class _Flight:
    """The arcs: each gives place, velocity, mass, direction, primer vector and its rate at times of it [s].

    Parameters
    ----------
    around, landing
        Where it begins, and its two impulses.
    mass, force, exhaust
        At the start [kg]; thrust [N] and exhaust speed [m/s].
    beside
        How long after the lowest point the second burn begins, as a share of its length.
    """

    around: Around
    landing: TwoImpulses
    mass: float
    force: float
    exhaust: float
    beside: float

    def __post_init__(self) -> None:
        landing, (position, velocity) = self.landing, self.landing.before
        self.left = self.mass * math.exp(-landing.first / self.exhaust)
        self.flow = self.force / self.exhaust
        self.burns = (self.mass - self.left) / self.flow
        self.primer = velocity / np.linalg.norm(velocity)
        semi, _ = orbit_shape(position, velocity, self.around.mu)
        early = landing.wait - 0.5 * self.burns
        self.waits = early > _SHORT * 2 * math.pi * math.sqrt(semi**3 / self.around.mu)
        self.begin = early if self.waits else 0.0
        self.late = 0.5 * self.burns if self.waits else 0.0  # of the fall
        self.second = _second_burn(self.around, landing, self.left, self.force, self.exhaust, self.beside)
        self.rest = self.beside * self.second.lasts
        self.instant = _INSTANT * self.second.lasts
        self.last = -self.second(0.0)[3]
        self.turning = (-self.second(self.instant)[3] - self.last) / self.instant
        self.rate = _primer_rate(landing, self.around.mu, self.primer, self.last)

    def waiting(self, t: float) -> Any:
        """Fall freely on the orbit of the start."""
        mu, landing = self.around.mu, self.landing
        primer = _carried(landing.before, (self.primer, self.rate), mu, t - landing.wait)
        return *fallen(self.around.position, self.around.velocity, mu, t), self.mass, -self.primer, *primer

    def burning(self, t: float) -> Any:
        """Burn against the velocity."""
        place, velocity = fallen(self.around.position, self.around.velocity, self.around.mu, self.begin + t)
        velocity = velocity + (self.landing.after - self.landing.before[1]) * t / self.burns
        return place, velocity, self.mass - self.flow * t, -self.primer, self.primer, self.rate

    def falling(self, t: float) -> Any:
        """Fall to the lowest point."""
        place, mu = (self.landing.before[0], self.landing.after), self.around.mu
        primer = _carried(place, (self.primer, self.rate), mu, self.late + t)
        return *fallen(*place, mu, self.late + t), self.left, -self.primer, *primer

    def rising(self, t: float) -> Any:
        """Fall on until the second burn."""
        primer = self.last + (t - self.rest) * self.turning
        return *fallen(*self.landing.lowest, self.around.mu, t), self.left, -self.primer, primer, self.turning

    def braking(self, t: float) -> Any:
        """Burn to rest."""
        known = self.second(t)
        before, behind = (self.second(t + side * self.instant)[3] for side in (-1.0, 1.0))
        return *known, -known[3], (before - behind) / (2 * self.instant)


def _carried(
    place: tuple[Vector, Vector], primer: tuple[Vector, Vector], mu: float, time: float
) -> tuple[Vector, Vector]:
    """Return the primer vector and its rate after free fall: the difference of two neighbouring falls."""
    size = _DIFFERENCE * float(np.linalg.norm(place[0]))
    ahead, behind = (
        fallen(place[0] + side * size * primer[0], place[1] + side * size * primer[1], mu, time) for side in (1.0, -1.0)
    )
    return (ahead[0] - behind[0]) / (2 * size), (ahead[1] - behind[1]) / (2 * size)


def _primer_rate(landing: TwoImpulses, mu: float, begin: Vector, end: Vector) -> Vector:
    """Return the rate with which the primer vector begins that is `end` at the lowest point."""
    place, rate = (
        (landing.before[0], landing.after),
        float(np.linalg.norm(landing.after) / np.linalg.norm(landing.before[0])),
    )
    alone = _carried(place, (begin, np.zeros(3)), mu, landing.fall)[0]
    columns = [_carried(place, (np.zeros(3), rate * axis), mu, landing.fall)[0] for axis in np.eye(3)]
    return rate * np.linalg.lstsq(np.array(columns).T, end - alone, rcond=_SINGULAR)[0]


def _seen(problem: Problem, rows: _Rows, rate: float, exhaust: float) -> Solution:
    """Return rows in inertial axes as a guess in axes that turn with the body, with costates."""
    turning, states, controls = np.array([0.0, 0.0, rate]), list[Vector](), list[Vector]()
    for t, x, u in zip(rows.times, rows.states, rows.controls, strict=True):
        turned = _turned(-rate * t)
        seen = x[3:6] - np.cross(turning, x[:3])
        states.append(np.concatenate([turned @ x[:3], turned @ seen, x[6:]]))
        controls.append(np.append(turned @ u[:3], u[3:]))
    solution = guess(problem, np.array(rows.times), np.array(states), np.array(controls))
    landed, times, values, rates = float(states[-1][6]), list[Vector](), list[Matrix](), list[Matrix]()
    for arc in rows.primers:
        table = list[Vector]()
        for t, primer, slope, mass in ((row[0], row[1:4], row[4:7], row[7]) for row in arc):
            by_place = -slope - np.cross(turning, primer)  # as velocities are relative to the body
            turned = _turned(-rate * t) * landed / exhaust
            table.append(np.concatenate([turned @ by_place, turned @ primer, [-landed / mass]]))
        times.append(np.array([row[0] for row in arc]))
        values.append(np.array(table))
        rates.append(np.gradient(values[-1], times[-1], axis=0))
    costate = Curve(time=np.concatenate(times), values=np.concatenate(values), rates=np.concatenate(rates))
    return replace(solution, trajectories=(replace(solution.trajectories[0], costate=costate),))


def _turned(angle: float) -> Matrix:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, kw_only=True)
class _Braking:
    """The second burn: its length [s], its states (time, distance, angle, speeds upwards and ahead, mass), and axes."""

    lasts: float
    states: Matrix
    elevations: tuple[float, float]
    axes: tuple[Vector, Vector]

    def __call__(self, t: float) -> tuple[Vector, Vector, float, Vector]:
        r, angle, upwards, ahead, mass = (np.interp(t, self.states[0], row) for row in self.states[1:])
        first, then = self.axes
        up, along = (math.cos(angle) * first + math.sin(angle) * then, math.cos(angle) * then - math.sin(angle) * first)
        slope = self.elevations[0] + self.elevations[1] * t / self.lasts
        return r * up, upwards * up + ahead * along, float(mass), (slope * up - along) / math.hypot(slope, 1.0)


def _second_burn(
    around: Around, landing: TwoImpulses, mass: float, force: float, exhaust: float, beside: float
) -> _Braking:
    """Return the burn from the lowest point, or a little behind it, to rest on the ground in the plane of the fall."""
    from scipy.optimize import root

    mu, flow = around.mu, force / exhaust
    usual = mass * (1 - math.exp(-landing.second / exhaust)) / flow
    place, flown = fallen(*landing.lowest, mu, beside * usual)
    up = place / np.linalg.norm(place)
    along = flown - (flown @ up) * up
    along = along / np.linalg.norm(along)
    begin = np.array([np.linalg.norm(place), 0.0, flown @ up, flown @ along, mass])
    ahead = float(landing.ground @ along)

    def rates(x: Vector, slope: float) -> Vector:
        push = force / x[4] / math.hypot(slope, 1.0)
        return np.array([
            x[2], x[3] / x[0], x[3] ** 2 / x[0] - mu / x[0] ** 2 + push * slope, -x[2] * x[3] / x[0] - push, -flow
        ])  # fmt: skip

    def flight(unknowns: Vector) -> list[Vector]:
        lasts, states = usual * float(np.clip(unknowns[2], 0.2, 3.0)), [begin]
        h = min(lasts, 0.99 * mass / flow) / _STEPS
        for i in range(_STEPS):
            slopes = [unknowns[0] + unknowns[1] * (i + part) / _STEPS for part in (0.0, 0.5, 1.0)]
            x = states[-1]
            k1 = rates(x, slopes[0])
            k2 = rates(x + 0.5 * h * k1, slopes[1])
            k3 = rates(x + 0.5 * h * k2, slopes[1])
            k4 = rates(x + h * k3, slopes[2])
            states.append(x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
        return states

    def missed(unknowns: Vector) -> list[float]:
        r, _, upwards, left, _ = flight(unknowns)[-1]
        return [
            (r - around.radius) / (landing.second * usual),
            upwards / landing.second,
            (left - ahead) / landing.second,
        ]

    weight = mu / around.radius**2 * mass / force
    found = root(missed, np.array([0.3 * weight, 0.3 * weight, 1.05]))
    unknowns = found.x if found.success else np.array([0.3 * weight, 0.3 * weight, 1.0])
    states = np.array(flight(unknowns)).T
    lasts = min(usual * float(np.clip(unknowns[2], 0.2, 3.0)), 0.99 * mass / flow)
    return _Braking(
        lasts=lasts, states=np.vstack([np.linspace(0.0, lasts, _STEPS + 1), states]),
        elevations=(float(unknowns[0]), float(unknowns[1])), axes=(up, along),
    )  # fmt: skip
