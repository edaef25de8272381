"""Landing by two burns or three, as `burn_search` finds it: its arcs, integrated with their costates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from perilune.core import Matrix, Vector
from perilune.models.descent.burn_programs import compile_burn
from perilune.models.descent.two_impulses import LandingStart, propagate_kepler

_DIFFERENCE = 1e-5  # of place or velocity: how far apart neighbouring falls begin
NO_TIME = 1e-6  # of the flight: an arc that is shorter is none


@dataclass(frozen=True, kw_only=True)
class Burning:
    """Lander and engine: mass [kg] at the start, thrust [N], exhaust speed [m/s]."""

    mass: float
    force: float
    exhaust: float


@dataclass(frozen=True, kw_only=True)
class BurnArc:
    """Propagated arc in inertial axes.

    Parameters
    ----------
    burns, touches
        Whether the engine is on, and whether the arc ends on the ground that holds it back.
    times
        [s], (n,).
    states, costates
        Place, velocity, mass, and theirs of J = -m_f [kg], (7, n).
    exhaust
        Exhaust speed [m/s].
    """

    burns: bool
    touches: bool
    times: Vector
    states: Matrix
    costates: Matrix
    exhaust: float

    def worth(self) -> Vector:
        """Return the switching function: above 0 where burning pays, a share of what is burnt."""
        return np.linalg.norm(self.costates[3:6], axis=0) * self.exhaust / self.states[6] + self.costates[6]


@dataclass(frozen=True, kw_only=True)
class TwoBurns:
    """A landing by two burns, or three.

    Parameters
    ----------
    lengths
        Of wait and first burn (and those of another fall and burn, if any), fall to the lowest point, fall behind it,
        last burn [s]; where that grazes the ground of fall, last burn to the lowest point, and behind it.
    states, costates
        With which these begin: place, velocity and mass, of J = -m_f [kg] (5 or 7, 7).
    brief, early
        How many burns come before the fall, and whether the last grazes the ground.
    touch
        Multiplier of the height of the lowest point, canonical: above 0 where the ground holds it back.
    around, burning
        Where it begins, and what burns.
    """

    lengths: Vector
    states: Matrix
    costates: Matrix
    brief: int
    early: bool
    touch: float
    around: LandingStart
    burning: Burning

    @property
    def burns(self) -> tuple[int, ...]:
        """Indices of the arcs that burn."""
        last = len(self.lengths) - 1
        return (*range(1, 2 * self.brief, 2), *((last - 1,) if self.early else ()), last)

    @property
    def landed(self) -> float:
        """Mass [kg] on the ground."""
        burnt = self.burning.force / self.burning.exhaust * sum(self.lengths[k] for k in self.burns)
        return self.burning.mass - float(burnt)

    def legs(self, counts: Sequence[int]) -> Iterator[BurnArc]:
        """Fly the arcs, with so many rows each.

        Parameters
        ----------
        counts
            Of the five arcs.
        """
        begin = 0.0
        for k, (count, length) in enumerate(zip(counts, self.lengths, strict=True)):
            burns, shares = k in self.burns, np.linspace(0.0, 1.0, count + 1)
            if length <= NO_TIME * self.lengths.sum():
                continue
            rows = [(self._burnt if burns else self._fallen)(k, share * length) for share in shares]
            states, costates = (np.array([row[i] for row in rows]).T for i in (0, 1))
            touches = self.touch > 0.0 and k == len(self.lengths) - (2 if self.early else 3)
            yield BurnArc(
                burns=burns, touches=touches, times=begin + shares * length, states=states, costates=costates,
                exhaust=self.burning.exhaust,
            )  # fmt: skip
            begin += length

    def _fallen(self, k: int, t: float) -> tuple[Vector, Vector]:
        """Fall from the start of an arc."""
        return propagate_with_costate(self.states[k], self.costates[k], self.around.mu, t)

    def _burnt(self, k: int, t: float) -> tuple[Vector, Vector]:
        """Burn from the start of an arc."""
        units = CanonicalUnits.of(self.around, self.burning)
        state, costate = self.states[k] / units.states, self.costates[k] * units.states / self.burning.mass
        law = np.concatenate([costate[3:6], costate[:3]])
        y = np.array(compile_burn()(state, law, t / units.time, units.force, units.flow)).ravel()
        costates = np.concatenate([y[10:13], y[7:10], [costate[6] - y[13]]])
        return y[:7] * units.states, costates * self.burning.mass / units.states


@dataclass(frozen=True, kw_only=True)
class CanonicalUnits:
    """Units of the states and of time; thrust and flow in them."""

    states: Vector
    time: float
    force: float
    flow: float

    @classmethod
    def of(cls, around: LandingStart, burning: Burning) -> CanonicalUnits:
        """Return those of a start and of what burns.

        Parameters
        ----------
        around
            Radius [m] and gravitational parameter [m^3/s^2] at the start.
        burning
            Mass [kg], thrust [N] and exhaust speed [m/s].
        """
        speed = math.sqrt(around.mu / around.radius)
        states = np.array([around.radius] * 3 + [speed] * 3 + [burning.mass])
        force = burning.force / burning.mass / (around.mu / around.radius**2)
        return cls(states=states, time=around.radius / speed, force=force, flow=force * speed / burning.exhaust)


def length_of(vector: Vector) -> float:
    """Return the length of a vector, above 0."""
    return float(np.linalg.norm(vector)) + 1e-300


def propagate_with_costate(state: Vector, costate: Vector, mu: float, t: float) -> tuple[Vector, Vector]:
    """Return a state and its costate after a free fall: costates (rate, primer) follow from two neighbouring falls.

    Parameters
    ----------
    state
        Position, velocity and mass in inertial axes, (7,).
    costate
        Costates in that order, (7,).
    mu
        Gravitational parameter, in the units of the state.
    t
        Duration of the fall, in the units of the state.

    Returns
    -------
    tuple[Vector, Vector]
        State and costate at its end, (7,) each.
    """
    place, velocity, primer, rate = state[:3], state[3:6], costate[3:6], -costate[:3]
    size = _DIFFERENCE * min(length_of(place) / length_of(primer), length_of(velocity) / length_of(rate))
    ahead, behind = (propagate_kepler(place + s * primer, velocity + s * rate, mu, t) for s in (size, -size))
    moved = [(after - before) / (2 * size) for after, before in zip(ahead, behind, strict=True)]
    there = np.concatenate([*propagate_kepler(place, velocity, mu, t), state[6:]])
    return there, np.concatenate([-moved[1], moved[0], costate[6:]])
