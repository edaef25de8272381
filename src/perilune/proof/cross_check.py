"""Level 4, cross-checked: another method solves the same problem, and both answers agree within their mesh error.

The mesh error is the larger of what the two methods report of themselves (`Statistics.residual`), relative to one
plus the size of a quantity in canonical units. An answer of the indirect method is compared with a direct one from no
guess, an answer of the direct method with the extremal that Newton's method reaches from it. What was found on
either side is listed, and the answer must be the best of it: a proof that *nothing* is better there is not.

Where the answer has contact points or boundary arcs, its costates jump, and methods give them in different
ways along an arc: with the multiplier of S, or of S^(q). On a mesh the jumps are spread. There curves and free
parameters are compared with an answer of the problem restated with the same arcs (`restate_with_contacts`), in which
costates are unique; the other method solves that from its own answer. The times of the boundary arcs are fixed: J is
flat in them to third order.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np

from perilune.core import PeriluneError, quotient_unit, sign_of_life
from perilune.methods import Method
from perilune.problem import Check, Conditions, Extremal, Nature, Phase, Problem, Solution, fix_free_parameters
from perilune.proof.feasible.feasibility import check_feasibility
from perilune.proof.feasible.phase_data import objective_size, phase_data_of
from perilune.proof.feasible.reintegration import reintegrate

if TYPE_CHECKING:
    from perilune.structures import Structure

FINEST = 1e-9  # no difference between two tables is better known
# Against the mesh error, which is of one segment; measured on good answers: states 9, costates 4, the rest less.
AGREEMENT, COSTATE_AGREEMENT = 30.0, 30.0
# Of costates by the covector mapping, however fine the mesh: at touchdown the multiplier of a path condition
# that ends at its limit is spread over the last points. Measured 9e-7 (root mean square).
COVECTOR = 5e-6
_TIMES = 401


def check_agreement(
    solution: Solution, other: Method | None, arcs: tuple[Solution, Structure] | None = None
) -> Iterator[Check]:
    """Make all checks of level 4.

    Parameters
    ----------
    solution
        An answer with costates.
    other
        The other method; None takes the direct one for an answer of an indirect method, and the reverse.
    arcs
        The answer cut into its arcs, and these, as `restate_with_contacts` has them, where it has some.
    """
    other = _default_other_method(solution) if other is None else other
    rivals, reason = _rival_solutions(solution, other)
    yield Check(
        name="cross_solved", level=4, value=0.0 if rivals else float("nan"), limit=0.0, unit="1",
        meaning=f"another method solves the same problem{reason}",
    )  # fmt: skip
    if not rivals:
        return
    near = min(rivals, key=lambda rival: abs(rival.objective - solution.objective))
    error = _mesh_error(solution, near)
    yield _compare_objectives(solution, near, error)
    yield _check_best_extremal(solution, rivals, error)
    if arcs is not None:
        from perilune.structures import split_solution

        parts, structure = arcs
        same = _restate_with_arcs(solution.problem, parts, structure)
        try:
            solution, near = parts, other.run(same, split_solution(near, structure, same), sign_of_life)
        except PeriluneError as failure:
            yield Check(
                name="cross_arcs", level=4, value=float("nan"), limit=0.0, unit="1",
                meaning=f"another method solves the problem with the same arcs, but {type(other).__name__} does not: "
                f"{failure.what}",
            )  # fmt: skip
            return
        error = max(error, _mesh_error(near))
    yield from _compare_parameters(solution, near, error)
    for index in range(len(solution.problem.phases)):
        yield from _compare_curves(solution, near, index, error)


def _default_other_method(solution: Solution) -> Method:
    """The other method where none is named."""
    from perilune.methods import Indirect, Pseudospectral

    # What a file says of its method is not known here; level 3 has asked the indirect one about the neighbours.
    direct = solution.method == "pseudospectral" and not solution.statistics.from_file
    return Indirect() if direct else Pseudospectral()


def _restate_with_arcs(problem: Problem, parts: Solution, structure: Structure) -> Problem:
    """Restate the problem with boundary arcs that begin and end at the answer's times, and S >= 0 kept by the arcs."""
    from perilune.structures import conditions_of

    times, phases = dict[str, float](), list[Phase]()
    for k, arcs in enumerate(structure.phases):
        kept = {c.variable.name for c in conditions_of(problem, k, structure.named(k)).values()}
        for arc, after in zip_longest(arcs, arcs[1:]):
            phase, flown = parts.problem.phases[len(phases)], parts.trajectories[len(phases)]
            if after is not None and (arc.along or after.along):
                times[phase.duration] = flown.duration
            phases.append(_without_conditions(phase, kept))
    return fix_free_parameters(parts.problem.changed(phases=tuple(phases), form=None), **times)


def _without_conditions(phase: Phase, names: Collection[str]) -> Phase:
    """A phase without the path conditions of these names."""
    rows, path = [i for i, c in enumerate(phase.path_conditions) if c.name not in names], phase.path
    if path is None:
        return phase
    kept = tuple(phase.path_conditions[i] for i in rows)
    some = (lambda x, u, p, xp: tuple(path(x, u, p, xp)[i] for i in rows)) if rows else None
    return replace(phase, path=Conditions.of(some, kept))


def _rival_solutions(solution: Solution, other: Method) -> tuple[list[Solution], str]:
    """Answers of the other method, and where there are none the reason."""
    from perilune.methods import Indirect

    try:
        first = other.run(solution.problem, solution if isinstance(other, Indirect) else None, sign_of_life)
    except PeriluneError as error:
        return [], f", but {type(other).__name__} does not: {error.what}"
    if isinstance(other, Indirect):
        missed = _failed_conditions(first)
        if missed:
            return [], f", but the extremal found by {type(other).__name__} does not meet {', '.join(missed)}"
        return [first], ""
    rivals = [first]
    problem, near = solution.problem, _mesh_error(first)
    if first.objective - solution.objective > _explained_difference(objective_size(solution), first.objective, near):
        # From no guess it ended in a worse optimum, which refutes nothing: does it confirm this one?
        try:
            rivals.append(other.run(problem, solution, sign_of_life))
        except PeriluneError:
            pass
    return rivals, ""


def _failed_conditions(rival: Solution) -> list[str]:
    """Conditions of level 1 that an extremal does not meet: it knows of none along the path."""
    return [check.name for check in check_feasibility(rival, reintegrate(rival)) if not check.passed]


def _mesh_error(*solutions: Solution) -> float:
    """The largest mesh error that the methods report; what a file says of it opens no limit."""
    return float(np.fmax.reduce([FINEST, *(s.statistics.residual for s in solutions if not s.statistics.from_file)]))


def _explained_difference(size: float, value: float, error: float) -> float:
    """Difference of a quantity of this canonical size that the mesh error explains [its unit]."""
    return AGREEMENT * error * (size + abs(value))


def _compare_objectives(solution: Solution, rival: Solution, error: float) -> Check:
    problem = solution.problem
    return Check(
        name="cross_objective",
        level=4,
        value=abs(solution.objective - rival.objective),
        limit=_explained_difference(objective_size(solution), solution.objective, error),
        unit=problem.objective_unit,
        meaning=f"difference between the objective, "
        f"{_both_values(solution, rival, solution.objective, rival.objective)} "
        f"{problem.objective_unit}; the relative mesh error is {error:.1e}",
    )


def _both_values(solution: Solution, rival: Solution, here: float, there: float) -> str:
    return f"{here:.12g} by {_method_name(solution)}, {there:.12g} by {_method_name(rival)}"


def _method_name(solution: Solution) -> str:
    """Return the method that found a solution; it is unknown for one from a file."""
    return "the file" if solution.statistics.from_file else solution.method


def _check_best_extremal(solution: Solution, rivals: Sequence[Solution], error: float) -> Check:
    """Check that no extremal that either side has found is better than the one claimed."""
    problem = solution.problem
    found = [(e, _method_name(s)) for s in (solution, *rivals) for e in _listed_extremals(s)]
    found.sort(key=lambda pair: pair[0].objective)
    listed = "; ".join(f"J = {e.objective:.9g} by {method}{_describe_parameters(problem, e)}" for e, method in found)
    return Check(
        name="best_extremal",
        level=4,
        value=max(solution.objective - found[0][0].objective, 0.0),
        limit=_explained_difference(objective_size(solution), solution.objective, error),
        unit=problem.objective_unit,
        meaning=f"difference by which the best extremal found is better than this one, J = {solution.objective:.9g};"
        f" found, "
        f"best first: {listed}",
    )


def _listed_extremals(solution: Solution) -> Sequence[Extremal]:
    """The extremals that a solution lists, or itself."""
    itself = Extremal(free=solution.free, objective=solution.objective, nature=Nature.LOCAL_OPTIMUM)
    return solution.extremals or [itself]


def _describe_parameters(problem: Problem, extremal: Extremal) -> str:
    values = [f"{name} {value:.6g} {problem.unit_of(name)}" for name, value in extremal.free.items()]
    return f" ({', '.join(values)})" if values else ""


def _compare_parameters(solution: Solution, rival: Solution, error: float) -> Iterator[Check]:
    for free in solution.problem.free:
        here, there = solution.free[free.name], rival.free[free.name]
        yield Check(
            name=f"cross_{free.name}", level=4, value=abs(here - there), unit=free.unit,
            limit=_explained_difference(solution.problem.size_of(free), here, error),
            meaning=f"difference between {free.name}, {_both_values(solution, rival, here, there)} {free.unit}",
        )  # fmt: skip


def _compare_curves(solution: Solution, rival: Solution, index: int, error: float) -> Iterator[Check]:
    """States at equal shares of the phase; costates by their root mean square, as ends hold only on the average."""
    arc, other = (phase_data_of(s)[index] for s in (solution, rival))
    share, cost = np.linspace(0.0, 1.0, _TIMES), solution.problem.objective_unit
    for kind, unit, limit in (("state", arc.state_scale, AGREEMENT * error),
                              ("costate", arc.objective_scale / arc.state_scale, COVECTOR + COSTATE_AGREEMENT * error),
                              ):  # fmt: skip
        here, there = (getattr(of, kind)(share * of.duration) for of in (arc, other))
        difference = np.abs(here - there) / unit[:, None]
        norm = difference.max(axis=1) if kind == "state" else np.sqrt((difference**2).mean(axis=1))
        value = norm / (1.0 + np.abs(here).max(axis=1) / unit)
        for i, state in enumerate(arc.phase.states):
            at = int(np.argmax(difference[i]))
            both = _both_values(solution, rival, here[i, at], there[i, at])
            yield Check(
                name=f"{arc.prefix}cross_{kind}_{state.name}", level=4, value=float(value[i]), limit=limit, unit="1",
                meaning=f"{'largest' if kind == 'state' else 'root mean square'} difference between the {kind} of "
                f"{state.name} along the arc, over one plus its size (scaled); at {share[at] * arc.duration:.6g} s "
                f"it is {both} {state.unit if kind == 'state' else quotient_unit(cost, state.unit)}",
            )  # fmt: skip
