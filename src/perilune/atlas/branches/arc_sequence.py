"""Arc sequences of a chart's extremals: conditions that the control keeps, and boundary arcs of state conditions.

Extremals with the same arcs are roots of one shooting function, so that Newton's method leads from one to the other.
Extremals with several arcs are extremals of the problem restated with a phase for each arc.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from perilune.conditions import Held, attainable_conditions, derive
from perilune.core.errors import PeriluneError
from perilune.methods import Curves
from perilune.problem.controls import ScalarControl
from perilune.problem.problem import Problem
from perilune.problem.results.extremal import Extremal
from perilune.problem.results.solution import Solution
from perilune.structures.detect_regimes import WRONG, gain_along, linear_scalars
from perilune.structures.multiphase import restate
from perilune.structures.part_durations import part_name
from perilune.structures.split_join import JoinedTrajectories
from perilune.structures.structure import SIDES, Arc, Structure, conditions_of, steering_controls

_MOST_ORDER = (
    2  # of a condition whose multiplier is known along its boundary arc (`perilune.atlas.evaluate.multiplier_signs`)
)


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
        found = list[str]()
        for k, arcs in enumerate(self.structure.phases if self.structure is not None else ()):
            for j, arc in enumerate(arcs):
                for name, condition in conditions_of(problem, k, arc.touches).items():
                    part = part_name(problem.phases[k].name, j, len(arcs))
                    found += [f"{part}.nu_{condition.rated(0, 'touch_', 1.0).name}"] if name in arc.touches else []
        return found

    def document(self) -> dict[str, Any]:
        """Return the entry for a manifest; times are initial values of free durations."""
        if self.structure is None:
            return {"keep": list(self.keep)}
        arcs = [
            [{**asdict(a), "until": a.until if math.isfinite(a.until) else None} for a in arcs]
            for arcs in self.structure.phases
        ]
        return {"keep": list(self.keep), "structure": arcs}


PLAIN = ArcSequence()


def arc_sequence_from(document: Mapping[str, Any]) -> ArcSequence:
    """Read the course that `ArcSequence.document` wrote."""
    keep, said = tuple(map(str, document["keep"])), document.get("structure")
    return ArcSequence(keep, None if said is None else Structure(tuple(tuple(map(_arc, arcs)) for arcs in said)))


def _arc(said: Mapping[str, Any]) -> Arc:
    until = said["until"]
    return Arc(
        along=tuple(map(str, said["along"])),
        touches=tuple(map(str, said["touches"])),
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
            settled = _state_bound_regimes(solution, known.structure)
            alike = derive(restate(solution.problem, settled), own).unknowns == curves.conditions.unknowns
            return ArcSequence(own, settled if alike else known.structure), extremals
    raise PeriluneError("the control keeps only some of the mixed constraints, which an atlas does not follow yet")


def _state_bound_regimes(solution: Solution, structure: Structure) -> Structure:
    """State the regime of scalars that keep boundary arcs, and are on one bound along each other arc.

    Where such an arc meets the boundary arc the slope of H vanishes, so that rounding decides if there is a switch.
    """
    phases = list(structure.phases)
    for k, arcs in enumerate(structure.phases):
        for at, control in linear_scalars(solution.problem, k):
            keeps = [control.name in _controls_moved_by_arc(solution.problem, k, arc) for arc in arcs]
            if any(keeps) and not any(name == control.name for arc in arcs for name, _ in arc.regimes):
                regimes = _regimes(solution, k, at, control, arcs, keeps)
                if None not in regimes:
                    said = zip(phases[k], regimes, strict=True)
                    phases[k] = tuple(replace(arc, regimes=(*arc.regimes, (control.name, r))) for arc, r in said)
    return Structure(tuple(phases))


def _controls_moved_by_arc(problem: Problem, k: int, arc: Arc) -> set[str]:
    """Return the components of the control that keep the conditions of a boundary arc."""
    return {name for c in conditions_of(problem, k, arc.along).values() for name in steering_controls(c)}


def _regimes(
    solution: Solution, k: int, at: int, control: ScalarControl, arcs: Sequence[Arc], keeps: Sequence[bool]
) -> list[str | None]:
    """Return the regime of a scalar on each arc; None where it is not on one bound throughout."""
    t, _, share = gain_along(solution, k, at, control)
    found, begin = list[str | None](), 0.0
    for arc, held in zip(arcs, keeps, strict=True):
        here = share[(t > begin) & (t < arc.until)]
        bounds = [side for side, bound in zip(SIDES, (0.0, 1.0), strict=True) if (np.abs(here - bound) <= WRONG).all()]
        found.append("held" if held else bounds[0] if len(here) and bounds else None)
        begin = arc.until
    return found


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
