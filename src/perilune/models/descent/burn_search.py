"""Search for landings by two burns, or three, near those by two impulses: the programs of `burn_programs` in turn.

The second burn begins behind the lowest point of the fall or at it; where at it the ground may be grazed while it
burns. Where the switching function of two burns is above 0 in a fall, another brief burn pays there (Lawden 1963,
chapter 5); where it is below 0 as a burn grazes the ground, that burn is parted by a fall to the ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from threading import Lock
from typing import Any

import casadi as ca
import numpy as np

from perilune.core import Matrix, Vector
from perilune.models.descent.burn_programs import (
    BurnProgram,
    burn_grazing_program,
    compile_burn,
    fall_grazing_program,
    orbital_axes,
)
from perilune.models.descent.two_burns import (
    NO_TIME,
    BurnArc,
    Burning,
    CanonicalUnits,
    TwoBurns,
    length_of,
    propagate_with_costate,
)
from perilune.models.descent.two_impulses import (
    LandingStart,
    TwoImpulses,
    anomaly_after,
    propagate_kepler,
    time_to_periapsis,
)

_LATE = 0.45  # of the length of the second burn: how long behind the lowest point it is expected to begin
_EARLY = 0.2  # the same, before it, where the burn grazes the ground
_NEAR = 0.9  # canonical: how far from where they are expected states and anomalies may come to lie
_LOOKS = (200, 4, 200, 4, 4)  # of the arcs: where the switching function is looked at
_PAYS, _LEAST = 2.0, 1e-7  # another burn pays above so much of what brief burns of one direction leave; no less than
_SHORT = 0.005  # of the last burn: another one as it is tried
_LOCK = Lock()  # a compiled program serves one thread at a time


def two_burns(around: LandingStart, landing: TwoImpulses, burning: Burning, *, at_once: bool) -> TwoBurns | None:
    """Return the landing by two burns near one by two impulses, the second burn at or behind the lowest point.

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
    given = _SearchData.of(around, burning, at_once)
    expected = _unknowns_of_impulses(landing, given.units)
    expected["fall1"] = _anomaly(given.start, landing.wait / given.units.time)
    return given.solved(fall_grazing_program(), expected)


def advance_second_burn(known: TwoBurns, *, at_once: bool) -> TwoBurns:
    """Return a landing whose second burn begins before the ground is grazed, or the known one where that is best.

    Parameters
    ----------
    known
        A landing by `two_burns`.
    at_once
        As for that.
    """
    if known.lengths[-2] > NO_TIME * known.lengths.sum():
        return known
    given = _SearchData.of(known.around, known.burning, at_once)
    found = given.solved(burn_grazing_program(known.brief), given.burning_earlier(known))
    return known if found is None else max(known, found, key=lambda one: one.landed)


def add_brief_burn(known: TwoBurns, *, at_once: bool) -> TwoBurns:
    """Return a landing with another burn before the ground is grazed, or the known one where none pays.

    Parameters
    ----------
    known, at_once
        As for `advance_second_burn`.
    """
    place = _paying(known)
    if place is None:
        return known
    given = _SearchData.of(known.around, known.burning, at_once)
    found = given.solved(fall_grazing_program(known.brief + 1), given.burning_between(known, *place))
    if found is None or (found.lengths[1 : 2 * found.brief + 1] < NO_TIME * found.lengths.sum()).any():
        return known
    return max(known, advance_second_burn(found, at_once=at_once), key=lambda one: one.landed)


def _paying(known: TwoBurns) -> tuple[int, BurnArc, int, float] | None:
    """Return the fall (its arc and rows) that another burn parts, the row where that begins, and its length [s]."""
    legs = list(known.legs(_LOOKS[:2] * known.brief + _LOOKS[2:]))
    arcs = [k for k in range(0, 2 * known.brief + 1, 2) if known.lengths[k] > NO_TIME * known.lengths.sum()]
    falls = list(zip(arcs, (leg for leg in legs if not leg.burns), strict=False))  # but for that from the ground
    k, leg = max(falls, key=lambda one: float(one[1].worth()[1:].max()))
    left = max((float(abs(leg.worth()[0])) for leg in legs[:-1] if leg.burns), default=0.0)
    if float(leg.worth()[1:].max()) > _PAYS * max(left, _LEAST):
        return k, leg, 1 + int(leg.worth()[1:-1].argmax()), _SHORT * known.lengths[-1]
    if known.early and min(float(leg.worth().min()) for leg in legs[-2:]) < -_LEAST:
        return *falls[-1], -1, known.lengths[-2]
    return None


@dataclass(frozen=True, kw_only=True)
class _SearchData:
    """Data with which the programs are solved."""

    units: CanonicalUnits
    start: Vector
    around: LandingStart
    burning: Burning
    at_once: bool

    @classmethod
    def of(cls, around: LandingStart, burning: Burning, at_once: bool) -> _SearchData:
        units = CanonicalUnits.of(around, burning)
        start = np.concatenate([around.position, around.velocity]) / units.states[:6]
        return cls(units=units, start=start, around=around, burning=burning, at_once=at_once)

    def solved(self, program: BurnProgram, expected: dict[str, Vector]) -> TwoBurns | None:
        """Solve a program from what is expected of its unknowns."""
        lower, upper = _bounds_around(expected)
        if self.at_once:
            lower["fall1"], upper["fall1"] = np.zeros(1), np.zeros(1)
        units = self.units
        numbers = np.concatenate([self.start, [units.force, units.flow, self.around.turning[2] * units.time]])
        at, low, high = (np.concatenate([of[name] for name in program.unknowns]) for of in (expected, lower, upper))
        with _LOCK:
            found = program.solver(x0=at, p=numbers, lbx=low, ubx=high, lbg=0.0, ubg=0.0)
            solved = program.solver.stats()["success"]
        return self._told(program, found, numbers) if solved else None

    def _told(self, program: BurnProgram, found: Any, numbers: Vector) -> TwoBurns:
        """Return an answer of a program in SI and in inertial axes."""
        x, multipliers = np.array(found["x"]).ravel(), np.array(found["lam_g"]).ravel()
        unknown = {name: x[at] for name, at in program.unknowns.items()}
        falls, axes, seen = (np.array(value) for value in program.falls(x, numbers))
        (*waits, fall), mass = falls.ravel(), 1.0

        def begin(name: str, mass: float, axes: Matrix) -> tuple[Vector, Vector]:
            """Return state and costate with which an arc begins, canonical, the costate of mass left out."""
            state, by = unknown[name][:6].reshape(2, 3), -multipliers[program.conditions[name]][:6].reshape(2, 3)
            return np.append(state @ axes.T, mass), np.append(by @ axes.T, 0.0)

        arcs, lengths = list[tuple[Vector, Vector]](), list[float]()
        for k, wait in enumerate(waits, 1):
            arcs += [begin(f"begun{k}", mass, axes)]
            mass = float(unknown[f"left{k}"][6])
            arcs += [begin(f"left{k}", mass, axes)]
            lengths += [wait, float(unknown[f"burn{k}"][0])]
        braked = begin("braked", mass, seen)
        law = unknown["law"] * np.linalg.norm(braked[1][3:6])
        braked[1][:6] = np.concatenate([seen @ law[3:], seen @ law[:3]])
        second, heights = float(unknown["second"][0]), np.array(found["lam_x"]).ravel()
        if "early" in unknown:
            early = float(unknown["early"][0])
            there, by, _ = self._burnt(*braked, early)
            by[:3] += unknown["jump"] * np.linalg.norm(braked[1][3:6]) * there[:3]
            by[6] = -1.0 + self._burnt(there, by, second)[2]
            braked[1][6] = by[6] + self._burnt(*braked, early)[2]
            behind, last, height = (braked, (there, by)), (fall, early), heights[program.unknowns["height"]]
        else:
            braked[1][6] = -1.0 + self._burnt(*braked, second)[2]
            down = time_to_periapsis(arcs[-1][0][:3], arcs[-1][0][3:6], 1.0)
            behind, last = (propagate_with_costate(*braked, 1.0, -fall), braked), (down, fall)
            height = heights[program.unknowns["lowest"]]
        by_mass = float(braked[1][6])
        for k in range(2 * program.brief - 1, 0, -2):
            arcs[k][1][6] = by_mass
            by_mass += self._burnt(*arcs[k - 1], lengths[k])[2]
            arcs[k - 1][1][6] = by_mass
        arcs, units = [propagate_with_costate(*arcs[0], 1.0, -waits[0]), *arcs, *behind], self.units
        states, costates = (np.array([arc[i] for arc in arcs]) for i in (0, 1))
        return TwoBurns(
            lengths=np.array([*lengths, *last, second]) * units.time, states=states * units.states,
            brief=program.brief, early="early" in unknown, touch=-float(height[0]),
            costates=costates * self.burning.mass / units.states, around=self.around, burning=self.burning,
        )  # fmt: skip

    def _burnt(self, state: Vector, costate: Vector, length: float) -> tuple[Vector, Vector, float]:
        """Return state and costate at the end of a burn, that of mass as it was, and what it has lost; canonical."""
        law = np.concatenate([costate[3:6], costate[:3]])
        y = np.array(compile_burn()(state, law, length, self.units.force, self.units.flow)).ravel()
        return y[:7], np.concatenate([y[10:13], y[7:10], costate[6:]]), float(y[13])

    def burning_earlier(self, known: TwoBurns) -> dict[str, Vector]:
        """Return the unknowns of a burn that grazes the ground from a landing whose burn begins as it is grazed."""
        states, costates, times = self._canonical(known)
        early, second, axes = _EARLY * times[-1], (1 - _EARLY) * times[-1], np.array(orbital_axes(ca.DM(states[1][:6])))
        there, by = propagate_with_costate(states[-1], costates[-1], 1.0, -early)
        law = _state_in_axes(np.concatenate([by[3:6], by[:3]]), axes) / length_of(by[3:6])
        return self._risen(axes, states, costates, times) | {
            "down": _anomaly(states[-3], times[-3] - early),
            "braked": _state_in_axes(there, axes)[:6],
            "law": law,
            "early": np.array([early]),
            "lowest": _state_in_axes(self._burnt(there, by, early)[0], axes),
            "height": np.ones(1),
            "jump": np.zeros(1),
            "bend": np.full(1, 0.5),
            "second": np.array([second]),
        }

    def burning_between(self, known: TwoBurns, k: int, leg: BurnArc, row: int, length: float) -> dict[str, Vector]:
        """Return the unknowns of another burn of so long [s] at a moment of a fall, arc k of a known landing."""
        states, costates, times = self._canonical(known)
        since = (leg.times[row] - leg.times[0]) / self.units.time
        place, there = leg.states[:, row] / self.units.states, leg.costates[:, row] * self.units.states
        length /= self.units.time
        kick = -leg.costates[3:6, row] / length_of(leg.costates[3:6, row]) * length * self.units.force
        left = place + np.concatenate([np.zeros(3), kick, np.zeros(1)])
        lowest, braked, by = states[-1 if known.early else -2], states[-1], costates[-1]
        states = np.concatenate([states[: k + 1], [place, left], states[k + 1 :]])
        costates = np.concatenate([costates[: k + 1], [there, there], costates[k + 1 :]])
        times = np.concatenate([times[:k], [since, length, times[k] - since], times[k + 1 :]])
        axes = np.array(orbital_axes(ca.DM(lowest[:6])))
        return self._risen(np.array(orbital_axes(ca.DM(states[1][:6]))), states, costates, times) | {
            "lowest": np.array([length_of(lowest[:3]), length_of(lowest[3:6])]),
            "rest": _anomaly(lowest, 0.0 if known.early else times[-2]),
            "braked": _state_in_axes(braked, axes)[:6],
            "law": _state_in_axes(np.concatenate([by[3:6], by[:3]]), axes) / length_of(by[3:6]),
            "second": times[-1:],
        }

    def _canonical(self, known: TwoBurns) -> tuple[Matrix, Matrix, Vector]:
        costates = known.costates * self.units.states / self.burning.mass
        return known.states / self.units.states, costates, known.lengths / self.units.time

    def _risen(self, axes: Matrix, states: Matrix, costates: Matrix, times: Vector) -> dict[str, Vector]:
        """Return the unknowns until the last brief burn."""
        found, before = dict[str, Vector](), self.start
        slopes = [by[:3] @ axes / length_of(by[3:6]) for by in costates]
        for k in range(1, (len(times) - 1) // 2):
            begun, left = states[2 * k - 1], states[2 * k]
            kick = left[3:6] - begun[3:6]
            found |= {
                f"fall{k}": _anomaly(before, times[2 * k - 2]),
                f"begun{k}": _state_in_axes(begun, axes)[:6],
                f"direction{k}": -kick @ axes / length_of(kick),
                f"burn{k}": times[2 * k - 1 : 2 * k],
                f"left{k}": _state_in_axes(left, axes),
                f"slope{k}": slopes[2 * k - 1],
            }
            before = left
        return found


def _state_in_axes(state: Vector, axes: Matrix) -> Vector:
    """Return a state (6 or 7) in axes."""
    return np.concatenate([(state[:6].reshape(2, 3) @ axes).ravel(), state[6:]])


def _unknowns_of_impulses(landing: TwoImpulses, units: CanonicalUnits) -> dict[str, Vector]:
    """Return the unknowns of the landing by two impulses but for the wait, canonical."""
    scale, axes = units.states[:6], np.array(orbital_axes(ca.DM(np.concatenate(landing.before))))

    def seen(place: Vector, velocity: Vector) -> Vector:
        return np.concatenate([place @ axes, velocity @ axes]) / scale

    begun, left = seen(*landing.before), seen(landing.before[0], landing.after)
    axes = np.array(orbital_axes(ca.DM(np.concatenate(landing.lowest))))  # of `seen` from here on
    lowest = seen(*landing.lowest)
    burnt, exhaust = list[float](), units.force / units.flow
    for change in (landing.first, landing.second):
        burnt.append((1 - sum(burnt)) * (1 - math.exp(-change / scale[3] / exhaust)))
    first, second = burnt[0] / units.flow, burnt[1] / units.flow
    braked = np.concatenate(propagate_kepler(lowest[:3], lowest[3:], 1.0, _LATE * second))
    # Down to the ground's velocity, and upwards against the weight that the fall's bend does not carry.
    over_ground = braked[3:] - landing.ground @ axes / scale[3]
    law = over_ground / length_of(over_ground) - 0.3 * braked[:3] / length_of(braked[:3]) / units.force
    faster = landing.after @ (landing.after - landing.before[1]) > 0
    return {
        "begun1": begun,
        "direction1": begun[3:] / length_of(begun[3:]) * (-1.0 if faster else 1.0), "burn1": np.array([first]),
        "left1": np.append(left, 1 - burnt[0]), "lowest": lowest[[0, 4]],
        "rest": _anomaly(lowest, _LATE * second), "braked": braked,
        "law": np.append(law / length_of(law), np.zeros(3)), "second": np.array([second]),
    }  # fmt: skip


def _bounds_around(expected: dict[str, Vector]) -> tuple[dict[str, Vector], dict[str, Vector]]:
    """Return bounds of the unknowns around what is expected: farther off the way down is another."""
    lower, upper = ({name: value + side for name, value in expected.items()} for side in (-_NEAR, _NEAR))
    second = float((expected["second"] + expected.get("early", 0.0))[0])
    lower["second"], upper["second"] = 0.5 * expected["second"], np.array([2 * second])
    for name in expected:
        if name.startswith(("fall", "burn", "rest", "down", "early")):
            lower[name] = np.maximum(lower[name], 0.0)
        if name.startswith("burn"):
            lower[name], upper[name] = np.zeros(1), 3 * expected[name] + 0.2 * second
        if name.startswith("direction"):
            lower[name], upper[name] = np.full(3, -1.2), np.full(3, 1.2)
        if name.startswith("slope"):
            lower[name], upper[name] = np.full(3, -3 / second), np.full(3, 3 / second)
    if "early" in expected:
        upper["early"], lower["height"], lower["bend"] = np.array([second]), np.ones(1), np.zeros(1)
        lower["jump"], upper["jump"], upper["bend"] = np.array([[-math.inf], [math.inf], [math.inf]])
    else:
        lower["lowest"][0] = 1.0
    upper["law"] = np.repeat((1.2, 3 / second), 3)
    lower["law"] = -upper["law"]
    return lower, upper


def _anomaly(state: Vector, time: float) -> Vector:
    """Return the difference of eccentric anomalies of a free fall; canonical."""
    return np.array([anomaly_after(state[:3], state[3:6], 1.0, time)])
