"""Problem with one limit made elastic, and the least relaxation with which everything else can be kept.

Limits are the bounds of states, controls and free parameters, and conditions of the path; where none of them helps, the
end conditions of one unit. Each in turn is replaced by the same limit less a free, not negative parameter s, which is
minimised:

    c(x, u, p) >= 0   becomes   c(x, u, p) + s >= 0,          min s,
    e(x, p) = 0       becomes   e(x, p) + s+ - s- = 0,        min sum(s+ + s-).

This is the elastic mode of nonlinear programming (Chinneck, Feasibility and Infeasibility in Optimization, 2008,
chapter 6), with one elastic constraint at a time so that its optimum is the least relaxation that makes the rest
feasible, as far as a local search shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from perilune.problem import Conditions, FreeParameter, Parameter, Phase, Problem, Variable, scalars

_SLACK = "relaxation"
_STATED = "relaxed_bound"  # a given parameter, as a number in the text of a condition has no unit and is not scaled


@dataclass(frozen=True, kw_only=True)
class ElasticLimit:
    """A limit that may be relaxed; the same one in all phases that state it.

    Parameters
    ----------
    kind
        ``"state"``, ``"control"``, ``"path"``, ``"free"`` (a parameter) or ``"end"``.
    names
        Of the state, control or path condition; of end conditions all of one unit.
    side
        ``"lower"`` or ``"upper"`` of a bound.
    bounded
        The record that states it, the first where there are several.
    """

    kind: str
    names: tuple[str, ...]
    side: str
    bounded: Any

    @property
    def slack_names(self) -> tuple[str, ...]:
        """Names of the free parameters by which the limit is relaxed."""
        if self.kind != "end":
            return (_SLACK,)
        return tuple(f"{_SLACK}_{name}_{way}" for name in self.names for way in ("over", "under"))

    def relaxed(self, problem: Problem, at_end: Sequence[str] = ()) -> Problem:
        """Return the problem with the limit made elastic, that minimises by how much it gives.

        Parameters
        ----------
        problem
            The problem whose limit it is.
        at_end
            Names of end conditions that say a condition of the path at the end: they give with it.
        """
        size, slacks = problem.size_of(self.bounded), self.slack_names
        phases, free = tuple(_relaxed_phase(phase, self, at_end) for phase in problem.phases), problem.free
        bound, unit = getattr(self.bounded, self.side) if self.side else None, self.bounded.unit
        stated = {} if bound is None or isinstance(bound, str) else {_STATED: Parameter(value=bound, unit=unit)}
        if self.kind == "free":
            none = {self.side: -math.inf if self.side == "lower" else math.inf}
            free = tuple(replace(f, **none) if f.name in self.names else f for f in free)
            phases = (*phases[:-1], _with_end(phases[-1], self))
        new = (FreeParameter(name=name, unit=unit, lower=0.0, guess=size) for name in slacks)

        def least(x: Any, p: Any, xp: Any) -> Any:
            return sum(getattr(p, name) for name in slacks)

        return problem.changed(
            phases=phases, free=(*free, *new), given={**problem.given, **stated}, objective=least,
            objective_unit=unit, objective_scale=size, results=None,
            maximised="", minimised="", parameter_bounds=None, preflight=None, consistency_checks=None,
            records=(), form=None,
        )  # fmt: skip

    def relaxations(self, free: Mapping[str, float]) -> dict[str, float]:
        """Return by how much each condition of a limit gives [SI], the largest first, from the free parameters.

        Parameters
        ----------
        free
            Free parameters [SI] by name, of a solution of the relaxed problem.
        """
        if self.kind != "end":
            return {self.names[0]: free[_SLACK]}
        given = {name: free[f"{_SLACK}_{name}_over"] + free[f"{_SLACK}_{name}_under"] for name in self.names}
        return dict(sorted(given.items(), key=lambda pair: -pair[1]))


def elastic_limits(problem: Problem) -> tuple[ElasticLimit, ...]:
    """Return the limits of a problem in the order in which they are worth relaxing; ends come last, unit by unit."""
    p, found, ends = problem.parameters({}), dict[tuple[str, ...], ElasticLimit](), dict[str, list[Variable]]()

    def add(kind: str, side: str, bounded: Any) -> None:
        limit = ElasticLimit(kind=kind, names=(bounded.name,), side=side, bounded=bounded)
        found.setdefault((kind, bounded.name, side), limit)

    bounds = [
        (kind, one, side)
        for phase in problem.phases
        for kind, rows in (("state", phase.states), ("control", [c for _, c in scalars(phase.controls)]))
        for one in rows
        for side, limit in zip(("lower", "upper"), one.limits(p), strict=True)
        if math.isfinite(limit)
    ]
    for phase in problem.phases:
        for condition in phase.path_conditions:
            add("path", "", condition)
        for condition in phase.end_conditions:
            ends.setdefault(condition.unit, []).append(condition)
    for f in problem.free:
        for side in ("upper",) if f.name in problem.duration_names else ("lower", "upper"):
            if math.isfinite(getattr(f, side)):
                add("free", side, f)
    for kind, one, side in bounds:
        add(kind, side, one)
    for same in ends.values():
        names = tuple(dict.fromkeys(c.name for c in same))
        found["end", *names] = ElasticLimit(kind="end", names=names, side="", bounded=same[0])
    return tuple(found.values())


def _relaxed_phase(phase: Phase, limit: ElasticLimit, at_end: Sequence[str]) -> Phase:
    """Return the phase with its own part of the limit relaxed."""
    if limit.kind == "path":
        path = _with_slack(phase.path, limit.names, _with_one_slack)
        return replace(phase, path=path, end=_with_slack(phase.end, at_end, _with_one_slack))
    if limit.kind == "end":
        return replace(phase, end=_with_slack(phase.end, limit.names, _with_two_slacks))
    if limit.kind == "free":
        return phase
    rows = phase.states if limit.kind == "state" else [c for _, c in scalars(phase.controls)]
    (name,) = limit.names
    bounded = next((row for row in rows if row.name == name), None)
    return phase if bounded is None else _bound_as_condition(phase, limit, bounded)


def _with_end(phase: Phase, limit: ElasticLimit) -> Phase:
    """Return the last phase with the relaxed bound of a free parameter as a condition of its end."""
    (name,), sign = limit.names, 1 if limit.side == "lower" else -1

    def end(x: Any, p: Any, xp: Any) -> tuple[Any, ...]:
        own = () if phase.end is None else phase.end(x, p, xp)
        return *own, sign * (getattr(p, name) - getattr(p, _STATED)) + getattr(p, _SLACK)

    room = Variable(name=f"room_of_{name}", unit=limit.bounded.unit, lower=0.0)
    return replace(phase, end=Conditions(end, *phase.end_conditions, room))


def _with_slack(stated: Conditions | None, names: Sequence[str], give: Callable[..., Any]) -> Conditions | None:
    """Return the conditions with the slacks of those of these names added."""
    if stated is None or not any(c.name in names for c in stated.variables):
        return stated

    def relaxed(*arguments: Any) -> tuple[Any, ...]:
        p = arguments[-2]
        values = zip(stated.variables, stated(*arguments), strict=True)
        return tuple(give(value, c.name, p) if c.name in names else value for c, value in values)

    return stated.with_function(relaxed)


def _with_one_slack(value: Any, name: str, p: Any) -> Any:
    return value + getattr(p, _SLACK)


def _with_two_slacks(value: Any, name: str, p: Any) -> Any:
    return value + getattr(p, f"{_SLACK}_{name}_under") - getattr(p, f"{_SLACK}_{name}_over")


def _bound_as_condition(phase: Phase, limit: ElasticLimit, bounded: Any) -> Phase:
    """Return the phase with a relaxed bound as a condition of the path, and that of a state as one of the end too."""
    bound, side = getattr(bounded, limit.side), limit.side
    sign, free = (1, -math.inf) if side == "lower" else (-1, math.inf)
    room = Variable(name=f"room_of_{bounded.name}", unit=bounded.unit, scale=getattr(bounded, "scale", None))

    def left(values: Any, p: Any) -> Any:
        at = getattr(p, bound if isinstance(bound, str) else _STATED)
        return sign * (getattr(values, bounded.name) - at) + getattr(p, _SLACK)

    def path(x: Any, u: Any, p: Any, xp: Any) -> tuple[Any, ...]:
        own = () if phase.path is None else phase.path(x, u, p, xp)
        return *own, left(x if limit.kind == "state" else u, p)

    def end(x: Any, p: Any, xp: Any) -> tuple[Any, ...]:
        return *(() if phase.end is None else phase.end(x, p, xp)), left(x, p)

    loose = replace(bounded, **{side: free})
    kept = Conditions(path, *phase.path_conditions, room)
    if limit.kind == "control":
        return replace(phase, controls=tuple(loose if c is bounded else c for c in phase.controls), path=kept)
    states = tuple(loose if s is bounded else s for s in phase.states)
    last = replace(room, name=f"end_{room.name}", lower=0.0)
    return replace(phase, states=states, end=Conditions(end, *phase.end_conditions, last), path=kept)
