"""Multi-phase reformulation: one smooth phase for each arc, with its active conditions and its end conditions.

A phase of several arcs becomes as many phases with the states, controls and formulas of its own, linked by identity.
Each has a free duration; their sum is the user's: where that is a free parameter, the sum stands in its place in every
formula, and its range becomes a range of the sum; where it is given, or belongs to another phase too, the sum has to
be equal to it.

The condition of a boundary arc decides the control there (`Phase.held`), and is no path condition of that arc. On the
others it stays one, as the arc that leads to it needs it: without S >= 0 the cost has no minimum at the time of entry,
but a slope that vanishes and does not change its sign (`perilune.conditions.junction_conditions`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

from perilune.core import PeriluneError, format_value_range
from perilune.problem import (
    MOST_ORDER,
    PHASE_FUNCTIONS,
    Conditions,
    Control,
    Expression,
    FreeParameter,
    Phase,
    Problem,
    Recorder,
    ScalarControl,
    Variable,
    component,
    gather_expressions,
    roles_of,
    run_expression,
)
from perilune.structures.detect_regimes import settle_scalar
from perilune.structures.redundant_conditions import repeated_ends
from perilune.structures.state_constraints import (
    Condition,
    conditions_of,
    plain_bound,
    plain_bounds,
    sum_of_parameters,
    with_sums,
    without_bounds,
)
from perilune.structures.structure import Arc, Structure, check_arc_structure, part_name

_ENDLESS = 1e6  # canonical units of time: what a free duration without an upper bound may last


def restate(problem: Problem, structure: Structure, *, repeated: bool = True, varied: Collection[str] = ()) -> Problem:
    """Restate the problem with a phase for each arc of a structure.

    Parameters
    ----------
    problem
        As the user states it.
    structure
        Its arcs. Their times are first values of the new durations; nothing else depends on them.
    repeated
        Whether end conditions are stated that an arc to the end says already
        (`perilune.structures.redundant_conditions`).
    varied
        Given parameters that will have other values: what is said already is so whatever these are.

    Returns
    -------
    Problem
        With phases ``descent-1``, ``descent-2``, ... in place of ``descent``, whose durations are free parameters of
        the same endings. Its `consistency_checks` are left out, as they are of the user's phases.

    Raises
    ------
    PeriluneError
        If the structure is none of the problem's, no control acts on one of its conditions, or a condition has a
        contact point that admits boundary arcs only, as the control acts on its first derivative.
    """
    check_arc_structure(problem, structure)
    return _Restated(problem, structure, repeated, varied).problem()


def renumber_restated(restated: Problem, problem: Problem, structure: Structure) -> Problem:
    """Return what `restate` returns, from its result for a problem of other values: nothing is traced again.

    Parameters
    ----------
    restated
        Of that other problem, with the arcs of the structure.
    problem, structure
        As for `restate`.

    Raises
    ------
    PeriluneError
        If the range of a duration that is a sum is none there any more, or one value, or becomes one.
    """
    given = {**{name: g for name, g in restated.given.items() if name not in problem.given}, **problem.given}
    given = MappingProxyType({name: given[name] for name in restated.given})  # in its order
    free, phases = _Restated(problem, structure, True).free(), _resummed_phases(restated, problem, structure)
    return restated.changed(phases=tuple(phases), given=given, free=tuple(free), structure=restated.structure)


def _range_of_sum(of: FreeParameter) -> tuple[float, float]:
    """Return the range of a sum of durations that stands in place of a free one [s]."""
    return (of.lower if of.lower > 0 else -math.inf), of.upper  # none of the durations is negative


def _resummed_phases(restated: Problem, problem: Problem, structure: Structure) -> Sequence[Phase]:
    """Return the phases of `renumber_restated`, whose sums of durations may have other ranges."""
    phases, most = list(restated.phases), {f.name: f.upper for f in restated.free}
    for name, k in structure.summed_durations(problem).items():
        of, at = problem.free[problem.free_names.index(name)], sum(map(len, structure.phases[: k + 1])) - 1
        one, (lower, upper), stated = of.lower == of.upper, _range_of_sum(of), phases[at].end_conditions
        if stated and (was := stated[-1]).name == name:
            alike = not one if was.ranged else one and most[structure.part_durations(problem, k)[0]] == upper
            if was.ranged and alike and (was.lower, was.upper) != (lower, upper):
                end = Conditions.of(phases[at].end, (*stated[:-1], replace(was, lower=lower, upper=upper)))
                phases[at] = replace(phases[at], end=end)
        else:
            alike = not (math.isfinite(lower) or math.isfinite(upper))
        if not alike:
            what = f"the range of {name} changes its kind there: none, one value, or between bounds"
            raise PeriluneError(
                what, got=format_value_range((lower, upper), of.unit), advice="solve there without an initial guess"
            )
    return restated.phases if all(new is old for new, old in zip(phases, restated.phases, strict=True)) else phases


def refuse_unstated_ends(
    restated: Problem, problem: Problem, structure: Structure, varied: Collection[str] = ()
) -> None:
    """Refuse values at which an arc to the end does not say what `restate` left out as said by it.

    Parameters
    ----------
    restated, problem, structure
        As for `renumber_restated`.
    varied
        Given parameters that will have other values.
    """
    for k, (phase, arcs) in enumerate(zip(problem.phases, structure.phases, strict=True)):
        last = next(p for p in restated.phases if p.name == part_name(phase.name, len(arcs) - 1, len(arcs)))
        stated = {condition.name for condition in last.end_conditions}
        left_out = {i for i, condition in enumerate(phase.end_conditions) if condition.name not in stated}
        if not left_out:
            continue
        said = repeated_ends(problem, k, arcs[-1], conditions_of(problem, k, arcs[-1].along), varied)
        for i in left_out - said:
            raise PeriluneError(
                f"{phase.end_conditions[i].name} is no longer implied by the arc along {' and '.join(arcs[-1].along)}",
                expected="an end on this boundary arc, as in the known flight",
                advice="solve at these values without an initial guess",
            )


@dataclass
class _Restated:
    """The parts of a problem while it is restated."""

    user: Problem
    structure: Structure
    repeated: bool
    varied: Collection[str] = ()

    @cached_property
    def sums(self) -> dict[str, tuple[str, ...]]:
        """Free durations of the user that are sums, by name."""
        return self.structure.sums(self.user)

    @cached_property
    def expressions(self) -> dict[Any, Expression]:
        """The user's functions with the sums in them."""
        return {key: with_sums(e, self.sums) for key, e in self.user.form.expressions.items()}

    def problem(self) -> Problem:
        user, own = self.user, self.expressions
        phases, links = list[Phase](), list[Expression]()
        for k, phase in enumerate(user.phases):
            if k:
                links.append(own["links", k - 1])
            parts = list(self._parts(k))
            links += [_identity_link(phase)] * (len(parts) - 1)
            phases += parts
        bounds = {name: g for name, g in plain_bounds(user).items() if name in self._bounds_named()}
        return user.changed(
            phases=tuple(phases),
            links=tuple(links),
            start=own["start"],
            objective=own["objective"],
            results=user.results and user.results.with_function(own["results"]),
            given=MappingProxyType({**user.given, **bounds}),
            free=tuple(self.free()),
            views=replace(user.views, dispersion=None),  # which names phases
            consistency_checks=None,
            initial_guess=None,
            switching_guesses=None,
            form=None,
        )

    def _bounds_named(self) -> set[str]:
        return {
            plain_bound(phase.name, phase.states[c.bound[0]], c.bound[1])
            for k, phase in enumerate(self.user.phases)
            for c in self._conditions(k).values()
            if c.bound is not None
        }

    def _conditions(self, k: int) -> dict[str, Condition]:
        return conditions_of(self.user, k, self.structure.named(k))

    def free(self) -> Iterator[FreeParameter]:
        """Yield free parameters: the user's, but for durations that are sums, and those of the arcs."""
        yield from (f for f in self.user.free if f.name not in self.sums)
        known = {f.name: f for f in self.user.free}
        for k, (phase, arcs) in enumerate(zip(self.user.phases, self.structure.phases, strict=True)):
            if len(arcs) == 1:
                continue
            of = known.get(phase.duration)
            whole = self.user.given[phase.duration].value if of is None else of.guess
            longest = whole if of is None else min(of.upper, _ENDLESS * self.user.scales.time)
            whole = arcs[-1].until if math.isfinite(arcs[-1].until) else whole
            ends = self.structure.ends(k, whole)
            for name, begin, end in zip(
                self.structure.part_durations(self.user, k), [0.0, *ends[:-1]], ends, strict=True
            ):
                yield FreeParameter(name=name, unit="s", lower=0.0, upper=longest, guess=end - begin)

    def _parts(self, k: int) -> Iterator[Phase]:
        """Yield the phases that a phase becomes."""
        phase, arcs, own = self.user.phases[k], self.structure.phases[k], self.expressions
        conditions, count = self._conditions(k), len(arcs)
        rough = self._rough(k)
        durations = self.structure.part_durations(self.user, k)
        for j, arc in enumerate(arcs):
            ends = list(self._vanishing_at_end(arc, arcs[j + 1] if j + 1 < count else None, conditions))
            if j + 1 == count:
                entered = j > 0 and not self.repeated  # else nothing but its start says that S = 0 on it
                said = repeated_ends(self.user, k, arc, conditions, self.varied) if entered else frozenset()
                ends += [(v, component(own[k, "end"], i)) for i, v in enumerate(phase.end_conditions) if i not in said]
                ends += list(self._whole(phase, durations))
            self._refuse_unsteered(arc, conditions)
            held = [(conditions[n].rated(conditions[n].order, "", self._second), conditions[n].values[-1])
                    for n in arc.along]  # fmt: skip
            changes: dict[str, Any] = {
                "name": part_name(phase.name, j, count),
                "duration": durations[j],
                "controls": _arc_controls(phase, arc),
                "states": without_bounds(phase, [c.bound for c in conditions.values() if c.bound is not None]),
                "end_guess": rough[j],
                **({} if j + 1 == count else {"end_outputs": None}),
                "end": _gathered_conditions("end", ends),
                "path": _gathered_conditions("path", self._inequalities(k, arc, conditions)),
                "held": _gathered_conditions("held", held + self._user_held(k)),
            }
            yield replace(phase.with_functions({name: own.get((k, name)) for name in PHASE_FUNCTIONS}), **changes)

    @staticmethod
    def _refuse_unsteered(arc: Arc, conditions: Mapping[str, Condition]) -> None:
        for name in arc.along:
            if not conditions[name].steered:
                raise PeriluneError(
                    f"no control acts on {name}",
                    got=f"none in its first {MOST_ORDER} derivatives along the flight",
                    expected="a boundary arc needs a quantity that a control influences",
                    advice=f"Arc(touches=({name!r},)), where an arc ends",
                )

    @property
    def _second(self) -> float:
        return self.user.scales.time

    def _user_held(self, k: int) -> list[tuple[Variable, Expression]]:
        held = self.user.phases[k].held_conditions
        return [(v, component(self.expressions[k, "held"], i)) for i, v in enumerate(held)]

    def _inequalities(self, k: int, arc: Arc, conditions: Mapping[str, Condition]) -> list[tuple[Variable, Expression]]:
        """Return what stays >= 0 on an arc: path conditions, and bounds in contact with another arc of the phase."""
        phase = self.user.phases[k]
        paths = [
            (v, component(self.expressions[k, "path"], i))
            for i, v in enumerate(phase.path_conditions)
            if v.name not in arc.along
        ]
        others = [c for c in conditions.values() if c.bound is not None and c.name not in arc.along]
        return paths + [(c.variable, with_sums(c.values[0], self.sums)) for c in others]

    def _vanishing_at_end(
        self, arc: Arc, following: Arc | None, conditions: Mapping[str, Condition]
    ) -> Iterator[tuple[Variable, Expression]]:
        """Yield what vanishes at the end of an arc: conditions in contact, and those of boundary arcs that follow."""
        entered = () if following is None else following.along
        for name in arc.touches:
            found = conditions[name]
            if found.order < 2:
                raise PeriluneError(
                    f"{name} allows a boundary arc, but no contact point",
                    got=f"a condition of order {found.order}",
                    expected="order 2 or more, so that S = 0 and S' = 0 are conditions on the state",
                    advice=f"Arc(along=({name!r},)), an arc of its own",
                )
            yield from self._vanishing(found, "touch_", 2)
        for name in (n for n in entered if n not in arc.along):
            yield from self._vanishing(conditions[name], "enter_", conditions[name].order)

    def _vanishing(self, condition: Condition, prefix: str, count: int) -> Iterator[tuple[Variable, Expression]]:
        for i in range(count):
            yield condition.rated(i, prefix, self._second), with_sums(condition.values[i], self.sums)

    def _whole(self, phase: Phase, durations: Sequence[str]) -> Iterator[tuple[Variable, Expression]]:
        """Yield the sum of the durations of a phase's parts, that has to be what the user says of it."""
        if len(durations) == 1:
            return
        recorder, name = Recorder(), phase.duration
        total = sum_of_parameters(recorder, durations)
        if self.sums.get(name) == tuple(durations):
            of = next(f for f in self.user.free if f.name == name)
            if of.lower == of.upper:
                total = recorder.do("sub", total, of.lower)
                yield Variable(name=name, unit="s"), Expression(recorder.tape([total]), ("x", "p"), origin="a duration")
                return
            lower, upper = _range_of_sum(of)
            if math.isfinite(lower) or math.isfinite(upper):
                whole = Variable(name=name, unit="s", lower=lower, upper=upper)
                yield whole, Expression(recorder.tape([total]), ("x", "p"), origin="a duration")
            return
        said = sum_of_parameters(recorder, self.sums[name]) if name in self.sums else recorder.input("p", name)
        yield Variable(name=name, unit="s"), Expression(recorder.tape([total - said]), ("x", "p"), origin="a duration")

    def _rough(self, k: int) -> list[Expression | None]:
        """Return rough end states of the parts, on a straight line through the rough end of the phase."""
        arcs, user = self.structure.phases[k], self.expressions
        if (k, "end_guess") not in user:
            return [None] * len(arcs)
        recorder = Recorder()
        begin, names = run_expression(user["start"], recorder), self.user.phases[0].state_names
        for before in range(k):
            end = run_expression(user[before, "end_guess"], recorder) if (before, "end_guess") in user else begin
            begin = run_expression(
                user["links", before], recorder, {("x", n): v for n, v in zip(names, end, strict=True)}
            )
            names = self.user.phases[before + 1].state_names
        end, shares = run_expression(user[k, "end_guess"], recorder), self.structure.ends(k, 1.0)
        inner = [recorder.tape([a + share * (b - a) for a, b in zip(begin, end, strict=True)]) for share in shares[:-1]]
        roles = roles_of((k, "end_guess"))
        return [*(Expression(tape, roles, origin="a straight line") for tape in inner), user[k, "end_guess"]]


def _gathered_conditions(name: str, rows: Sequence[tuple[Variable, Expression]]) -> Conditions | None:
    """Return the conditions of a field of a phase; None where there are none."""
    if not rows:
        return None
    return Conditions(gather_expressions([e for _, e in rows], PHASE_FUNCTIONS[name][0]), *(v for v, _ in rows))


def _arc_controls(phase: Phase, arc: Arc) -> tuple[Control, ...]:
    """Return the controls of an arc: those that stay in a regime along it say so."""
    regimes = {name: regime for name, regime in arc.regimes if regime != "held"}
    return tuple(
        settle_scalar(c, regimes[c.name]) if isinstance(c, ScalarControl) and c.name in regimes else c
        for c in phase.controls
    )


def _identity_link(phase: Phase) -> Expression:
    recorder = Recorder()
    return Expression(recorder.tape([recorder.input("x", n) for n in phase.state_names]), ("x", "p"), origin="identity")
