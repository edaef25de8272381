"""Structure of an answer: the arcs of each phase, with their active conditions and contact points.

On an *arc* nothing of the state is held, or it is a boundary arc *along* conditions: path conditions, or bounds of
states, S >= 0 that are 0 all along it. Of order q (`perilune.problem.tracing.lie_derivatives`) such an arc is entered
with S = S' = ... = S^(q-1) = 0, and S^(q) = 0 says what the control does on it. At the end of an arc a condition may
have a *contact point*: S = 0 and S' = 0.

Source: Bryson, Ho, *Applied Optimal Control*, 1975, sections 3.11 to 3.13.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

import numpy as np

from perilune.core import PeriluneError
from perilune.problem import Problem, scalars
from perilune.structures.state_constraints import conditions_of, margins, state_conditions

Regimes = tuple[tuple[str, str], ...]  # scalar controls with "lower", "upper", "singular" or "held"
PAIR = 1e-5  # of the time on a bound: how long a pair of switches in it is tried
_LONGEST = 2.0  # times as long as a pair of switches is tried


@dataclass(frozen=True)
class Arc:
    """One arc.

    Parameters
    ----------
    along
        Names of the conditions whose boundary arc it is, as `conditions_of` has them.
    touches
        Names of those with a contact point at its end.
    regimes
        Scalar controls that are on a bound, or singular, all along it, or held by its boundary conditions; of the
        others the control law decides.
    until
        When it ends, in seconds from the beginning of its phase, as far as that is known; NaN otherwise.
    """

    along: tuple[str, ...] = ()
    touches: tuple[str, ...] = ()
    regimes: Regimes = ()
    until: float = math.nan

    @property
    def text(self) -> str:
        """The arc in short."""
        held = [f"{name} singular" if regime == "singular" else f"{name} at its {regime} bound"
                for name, regime in self.regimes if regime != "held"]  # fmt: skip
        held = ["along " + ", ".join(self.along)] * bool(self.along) + held
        return " and ".join((*(held or ["free"]), *(f"touches {name}" for name in self.touches)))


@dataclass(frozen=True)
class Structure:
    """The arcs of every phase, in order of flight."""

    phases: tuple[tuple[Arc, ...], ...]

    @classmethod
    def free(cls, problem: Problem) -> Structure:
        """Return one arc for each phase, on which nothing is held."""
        return cls(tuple((Arc(),) for _ in problem.phases))

    def timed(self, durations: Sequence[Sequence[float]]) -> Structure:
        """Return the same with the times at which the arcs of each phase end, from how long each of them lasts [s]."""
        phases = []
        for arcs, lasting in zip(self.phases, durations, strict=True):
            ends = accumulate(lasting)
            phases.append(tuple(replace(arc, until=float(end)) for arc, end in zip(arcs, ends, strict=True)))
        return Structure(tuple(phases))

    @property
    def count(self) -> int:
        """Return the number of arcs."""
        return sum(len(arcs) for arcs in self.phases)

    @property
    def singular(self) -> bool:
        """Return True if a control is singular along an arc."""
        return any(regime == "singular" for arcs in self.phases for arc in arcs for _, regime in arc.regimes)

    @property
    def switched(self) -> bool:
        """Return True if scalars keep boundary arcs, and are on a bound everywhere else."""
        regimes = [regime for arcs in self.phases for arc in arcs for _, regime in arc.regimes]
        return "held" in regimes and "singular" not in regimes

    @property
    def plain(self) -> bool:
        """Return True if there is no boundary arc or contact point, and no phase is cut."""
        return all(len(arcs) == 1 and not (arcs[0].along or arcs[0].touches or arcs[0].regimes) for arcs in self.phases)

    def named(self, k: int) -> tuple[str, ...]:
        """Return every condition with a boundary arc or contact point in phase k, once each."""
        return tuple(dict.fromkeys(name for arc in self.phases[k] for name in (*arc.along, *arc.touches)))

    def ends(self, k: int, duration: float) -> list[float]:
        """Return the end of each arc of phase k [s] in a flight of that duration; in equal parts where not known.

        Parameters
        ----------
        k
            Index of the phase.
        duration
            Duration of the phase [s], to which known ends are stretched.
        """
        count, known = len(self.phases[k]), [arc.until for arc in self.phases[k]]
        if not all(math.isfinite(t) for t in known) or not known[-1] > 0:
            known = [float(i + 1) for i in range(count)]
        return [*(t / known[-1] * duration for t in known[:-1]), duration]

    @property
    def text(self) -> str:
        """The structure in short: ``descent: free, touches glide; along glide``."""
        parts = []
        for arcs in self.phases:
            parts.append(", ".join(arc.text for arc in arcs))
        return "; ".join(parts)

    def part_durations(self, problem: Problem, k: int) -> tuple[str, ...]:
        """Return the names of the durations of the parts of a phase of the user's problem.

        Parameters
        ----------
        problem
            The user's problem.
        k
            Number of the phase.
        """
        count, name = len(self.phases[k]), problem.phases[k].duration
        if count == 1:
            return (name,)
        shared = problem.duration_names.count(name) > 1
        own = f"{name}.{problem.phases[k].name}" if shared else name
        return tuple(part_name(own, j, count) for j in range(count))

    def summed_durations(self, problem: Problem) -> dict[str, int]:
        """Return free durations that are sums of new ones, each with the number of the phase whose parts it sums."""
        found: dict[str, int] = {}
        for k, phase in enumerate(problem.phases):
            if phase.duration in problem.free_names and len(self.phases[k]) > 1:
                found.setdefault(phase.duration, k)
        whole = {p.duration for p, arcs in zip(problem.phases, self.phases, strict=True) if len(arcs) == 1}
        return {name: k for name, k in found.items() if name not in whole}

    def sums(self, problem: Problem) -> dict[str, tuple[str, ...]]:
        """Return free durations that are sums, with the names of the new ones that they sum."""
        return {name: self.part_durations(problem, k) for name, k in self.summed_durations(problem).items()}

    def contact_multipliers(self, problem: Problem) -> list[str]:
        """Return the names of the multipliers of contact points among the unknowns of the restated problem."""
        found = list[str]()
        for k, arcs in enumerate(self.phases):
            for j, arc in enumerate(arcs):
                part = part_name(problem.phases[k].name, j, len(arcs))
                conditions = conditions_of(problem, k, arc.touches).values()
                found += [f"{part}.nu_{condition.rated(0, 'touch_', 1.0).name}" for condition in conditions]
        return found

    def may_break_controls(self, problem: Problem, p: Any) -> bool:
        """Return True if extremals may break limits of the control to which the control laws of the arcs do not keep.

        Such are conditions of the path that a law cannot hold, and the bounds of a scalar that keeps a boundary arc.

        Parameters
        ----------
        problem
            The user's problem.
        p
            Record of its parameters in SI.
        """
        for k, (phase, arcs) in enumerate(zip(problem.phases, self.phases, strict=True)):
            bounded = {c.name for _, c in scalars(phase.controls) if np.isfinite(c.limits(p)).any()}
            ridden = conditions_of(problem, k, [name for arc in arcs for name in arc.along]).values()
            steered = len(margins(problem, k)) > len(state_conditions(problem, k))
            if steered or any(bounded & condition.steering_controls for condition in ridden):
                return True
        return False

    def begun_pair(self, problem: Problem) -> str | None:
        """Return the name of the duration of an arc as short as a pair of switches is tried, or None.

        It lies between two arcs on the other bound.
        """
        for k, arcs in enumerate(self.phases):
            names = self.part_durations(problem, k)
            for j in range(1, len(arcs) - 1):
                before, own, behind = (arcs[i].regimes for i in (j - 1, j, j + 1))
                brief = arcs[j].until - arcs[j - 1].until <= _LONGEST * PAIR * arcs[-1].until
                bound = all(regime in ("lower", "upper") for _, regime in own)
                if brief and own and own != before == behind and bound:
                    return names[j]
        return None


def part_name(name: str, j: int, count: int) -> str:
    """Return the name of the j-th of so many parts of a phase, or of its duration.

    Parameters
    ----------
    name
        Name of the phase, or of its duration.
    j
        Number of the part, from 0.
    count
        Number of the parts.
    """
    return name if count == 1 else f"{name}-{j + 1}"


def check_arc_structure(problem: Problem, structure: Structure) -> None:
    """Refuse a structure that is none of the problem's.

    Parameters
    ----------
    problem
        The user's problem.
    structure
        Arcs of each phase.

    Raises
    ------
    PeriluneError
        If it has other phases, or a phase without an arc.
    """
    if len(structure.phases) != len(problem.phases) or not all(structure.phases):
        raise PeriluneError(
            "a structure has at least one arc for each phase",
            got=f"{[len(arcs) for arcs in structure.phases]} arcs",
            expected=f"{len(problem.phases)} phases",
        )
