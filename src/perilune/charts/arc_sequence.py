"""Arc sequences of a chart's extremals: conditions that the control keeps, and boundary arcs of state conditions.

Extremals with the same arcs are roots of one shooting function, so that Newton's method leads from one to the other.
Extremals with several arcs are extremals of the problem restated with a phase for each arc.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from perilune.conditions import Held, attainable_conditions, derive
from perilune.core import PeriluneError
from perilune.methods import Curves
from perilune.problem import Extremal, Problem, Solution
from perilune.structures import Arc, JoinedTrajectories, Structure, conditions_of, restate, with_bound_regimes

_MOST_ORDER = 2  # of a condition whose multiplier is known along its boundary arc (`perilune.charts.multiplier_signs`)


@dataclass(frozen=True)
class ArcSequence:
    """The arcs of a family of extremals, and the conditions that its control keeps.

    Parameters
    ----------
    keep
        Conditions of the path that the control keeps.
    structure
        The arcs, where there are several.
    """

    keep: Held = ()
    structure: Structure | None = None

    @cached_property
    def text(self) -> str:
        """Return the arcs in words; empty for a single one."""
        return self.structure.text if self.structure is not None else ""

    def restated(self, problem: Problem, varied: Sequence[str]) -> Problem:
        """Return the problem whose smooth extremals they are, for any varied parameters.

        Parameters
        ----------
        problem
            The user's problem, at any values.
        varied
            Names of the parameters that vary.
        """
        return problem if self.structure is None else restate(problem, self.structure, repeated=False, varied=varied)

    def touched(self, problem: Problem) -> list[str]:
        """Return the names of the multipliers of contact points, none of which is positive at a minimum."""
        return [] if self.structure is None else self.structure.contact_multipliers(problem)

    def document(self) -> dict[str, Any]:
        """Return the entry for a manifest; times are initial values of free durations."""
        if self.structure is None:
            return {"attainable_conditions": list(self.keep)}
        arcs = [
            [
                {
                    "along": a.along,
                    "contact_points": a.touches,
                    "regimes": a.regimes,
                    "until": a.until if math.isfinite(a.until) else None,
                }
                for a in arcs
            ]
            for arcs in self.structure.phases
        ]
        return {"attainable_conditions": list(self.keep), "structure": arcs}


PLAIN = ArcSequence()


def arc_sequence_from(document: Mapping[str, Any]) -> ArcSequence:
    """Read the course that `ArcSequence.document` wrote."""
    keep, said = tuple(map(str, document["attainable_conditions"])), document.get("structure")
    return ArcSequence(keep, None if said is None else Structure(tuple(tuple(map(_arc, arcs)) for arcs in said)))


def _arc(said: Mapping[str, Any]) -> Arc:
    until = said["until"]
    return Arc(
        along=tuple(map(str, said["along"])),
        touches=tuple(map(str, said["contact_points"])),
        regimes=tuple((str(name), str(regime)) for name, regime in said["regimes"]),
        until=math.nan if until is None else float(until),
    )


def arc_sequence_of(solution: Solution, keep: Held) -> tuple[ArcSequence, list[Extremal]]:
    """Return the arcs of the extremals of a solution, and these with unknowns of the restated problem.

    Parameters
    ----------
    solution
        As the indirect method found it.
    keep
        What the control keeps where there are no arcs.

    Raises
    ------
    PeriluneError
        If an atlas does not follow it.
    """
    known = solution.trajectories
    if not isinstance(known, JoinedTrajectories):
        return ArcSequence(keep), list(solution.extremals)
    _refuse_unknown(solution, known.structure)
    restated, curves = known.restated, known.restated.trajectories
    if not isinstance(curves, Curves):
        raise PeriluneError("only the curves of this solution are known")
    for own in ((), attainable_conditions(restated.problem)):
        if derive(restated.problem, own) is curves.conditions:
            # Behind those of its arcs a solution lists others, without arcs, that break the path.
            natures = [extremal.nature for extremal in solution.extremals[: len(restated.extremals)]]
            extremals = [replace(e, nature=n) for e, n in zip(restated.extremals, natures, strict=True)]
            settled = with_bound_regimes(solution, known.structure)
            alike = derive(restate(solution.problem, settled), own).unknowns == curves.conditions.unknowns
            return ArcSequence(own, settled if alike else known.structure), extremals
    raise PeriluneError("the control keeps only some of the mixed constraints, which an atlas does not follow yet")


def kept_conditions(solution: Solution) -> Held:
    """Return the conditions of the path that the control keeps along a smooth extremal of the indirect method.

    Raises
    ------
    PeriluneError
        If it is not the curves of an extremal, or the control keeps only some of the mixed constraints.
    """
    flown, problem = solution.trajectories, solution.problem
    if isinstance(flown, JoinedTrajectories):
        return ()
    for own in ((), attainable_conditions(problem)):
        if isinstance(flown, Curves) and derive(problem, own) is flown.conditions:
            return own
    raise PeriluneError("the solution is no extremal that a chart can follow", got=f"a solution of {solution.method}")


def _refuse_unknown(solution: Solution, structure: Structure) -> None:
    """Refuse arcs whose multiplier signs an independent re-integration cannot determine."""
    for k, arcs in enumerate(structure.phases):
        for arc in arcs:
            if arc.along and any(regime == "singular" for _, regime in arc.regimes):
                raise PeriluneError("a control is singular on a boundary arc", got=structure.text)
            for name, condition in conditions_of(solution.problem, k, arc.along).items():
                if condition.order > _MOST_ORDER:
                    raise PeriluneError(
                        f"the answer has a boundary arc of {name}, of order {condition.order}, whose multiplier is"
                        f" not known",
                        got=structure.text,
                        expected=f"a condition in which a control appears within its first {_MOST_ORDER} derivatives",
                    )
