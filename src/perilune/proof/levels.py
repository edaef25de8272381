"""Levels of a proof: which checks are run, in which order, and the record of them (its `level` is the one reached).

Level 1 (`feasibility`): the exported control is integrated again. Level 2 (`first_order`): the necessary conditions
hold along the exported curves; `minimum_principle`: for the control. Level 3 (`second_order`, `sensitivities`): the
extremal is locally optimal. Level 4 (`cross_check`): another method agrees. Each check has a value, a limit 3 to 10
times above the error of a good answer, so that it can fail, and a meaning; a NaN fails.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from perilune.core import PeriluneError, require_level, sign_of_life
from perilune.methods import Method
from perilune.problem import LEVELS, OWN_TEXT, Check, Problem, Solution, Tolerance, Verification
from perilune.proof.cross_check import check_agreement
from perilune.proof.feasible.feasibility import check_feasibility, check_tables
from perilune.proof.feasible.phase_data import keep_phase_data, phase_data_of
from perilune.proof.feasible.reintegration import reintegrate
from perilune.proof.necessary.constraint_activity import may_meet_condition
from perilune.proof.necessary.first_order import check_extremality
from perilune.proof.necessary.terminal_bounds import with_end_bounds
from perilune.proof.sufficient.second_order import check_local_optimality
from perilune.proof.sufficient.second_variation import KeptConditions
from perilune.proof.sufficient.sensitivities import SHIFTED, Resolve, check_neighbours
from perilune.proof.tolerance import check_tolerance_sense, raise_limit

_ROUGH = "neighbouring problems were not solved, because a check of level 1 failed"
_UNTOLD = "neighbouring problems were not solved, because a check of level 3 is undetermined"


def examine(
    solution: Solution, level: int, resolve: Resolve, other: Method | None = None, tolerance: Tolerance | None = None
) -> Verification:
    """Check what a solution claims.

    Parameters
    ----------
    solution
        Of any method, with trajectories. Its own `verification` is not looked at.
    level
        1 feasible, 2 extremal, 3 locally optimal, 4 cross-checked; each with those below.
    resolve
        ``resolve(problem, guess) -> Solution`` solves a neighbouring problem from this solution for the
        checks of level 3 that need it.
    other
        The method of level 4; by default ``Pseudospectral()``, and ``Indirect()`` for an answer of that.
    tolerance
        Differences that do not matter; None takes what the solution was stated with (`Verification.tolerance`).

    Returns
    -------
    Verification
        Every check made. Unusable tables, costates that are missing, or physics that cannot be computed end the proof
        at the check that says so.

    Raises
    ------
    PeriluneError
        If the level is not 1, 2, 3 or 4, or the solution lacks the trajectory of a phase, or has them in another order.
    """
    require_level(level, LEVELS[:-1])
    tolerance = solution.verification.tolerance if tolerance is None else tolerance
    _refuse_unmatched_trajectories(solution)
    checks, notes = list[Check](), _notes_on_loaded_problem(solution.problem)
    try:
        # A tampered table may divide by zero anywhere; the checks turn that into NaN, which fails.
        with np.errstate(all="ignore"), keep_phase_data():
            for check in _checks_in_order(solution, level, resolve, other, tolerance, checks):
                sign_of_life(f"proof: level {check.level}, {check.name}")
                checks.append(raise_limit(check, tolerance))
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        meaning = f"evaluation of the physics along the tables: {error}"
        checks.append(Check(name="computable", level=1, value=float("nan"), limit=0.0, unit="1", meaning=meaning))
    if level >= 3 and _has_failed_feasibility(checks):
        notes = (_ROUGH, *notes)
    elif level >= 3 and _has_no_answer(checks) and not any(check.name.startswith(SHIFTED) for check in checks):
        notes = (_UNTOLD, *notes)
    notes = (*_note_unused_tolerance(checks, tolerance), *notes)
    return Verification(checks=tuple(checks), source=solution.problem.source, notes=notes, tolerance=tolerance)


def _refuse_unmatched_trajectories(solution: Solution) -> None:
    """Refuse a solution that lacks the trajectory of a phase, or has them in another order."""
    if len(solution.trajectories) != len(solution.problem.phases):
        raise PeriluneError(
            "the solution lacks trajectories",
            got=f"{len(solution.trajectories)} for {len(solution.problem.phases)} phases",
            expected="one for each phase",
        )
    named, phases = [flown.phase for flown in solution.trajectories], [phase.name for phase in solution.problem.phases]
    if named != phases and set(named) & set(phases):
        raise PeriluneError(
            "the trajectories of the solution are not in the order of its phases",
            got=", ".join(named)[:200],
            expected=", ".join(phases)[:200],
        )


def _has_failed_feasibility(made: Sequence[Check]) -> bool:
    """Return True if a check of level 1 failed: it is no flight, let alone an optimum."""
    return any(check.level == 1 and not check.passed for check in made)


def _has_no_answer(made: Sequence[Check]) -> bool:
    """Return True if a check of level 3 has no answer: neighbours, which cost much, could not mend that."""
    return any(check.level == 3 and np.isnan(check.value) for check in made)


def _checks_in_order(
    solution: Solution,
    level: int,
    resolve: Resolve,
    other: Method | None,
    tolerance: Tolerance,
    made: Sequence[Check],
) -> Iterator[Check]:
    """Yield every check in order, after those `made` so far; only those of the tables if they cannot be read."""
    readable = check_tables(solution)
    yield readable
    if not readable.passed:
        return
    yield from check_tolerance_sense(tolerance, solution)
    flown = reintegrate(solution)
    yield from check_feasibility(solution, flown)
    arcs = None
    if level >= 2:
        stated = with_end_bounds(solution)
        parts, kept, idle, strict = stated, dict[int, KeptConditions](), dict[int, KeptConditions](), list[Check]()
        if any(may_meet_condition(arc) for arc, _ in flown):
            from perilune.proof.necessary.contact_points import check_contact_multipliers, restate_with_contacts
            from perilune.proof.sufficient.boundary_arcs import BoundaryArcs

            parts, structure = restate_with_contacts(stated)
            arcs, rides = None if structure.plain else (parts, structure), BoundaryArcs.of(stated, parts, structure)
            found = list(check_contact_multipliers(stated, parts, structure))
            yield from (check for check in found if check.level < 3)
            yield from rides.checks()
            if level >= 3:
                kept, idle = rides.kept_conditions(), rides.kept_conditions(idle=False)
                strict = [check for check in found if check.level == 3]
        yield from check_extremality(parts)
        if level >= 3 and all(t.costate is not None for t in solution.trajectories):
            yield from _local_optimality_checks(parts, kept, idle, strict)
            if not _has_failed_feasibility(made) and not _has_no_answer(made):
                yield from check_neighbours(parts, resolve)
    if level >= 4:
        yield from check_agreement(solution, other, arcs)


def _local_optimality_checks(
    parts: Solution, kept: dict[int, KeptConditions], idle: dict[int, KeptConditions], strict: Sequence[Check]
) -> Iterator[Check]:
    """Yield the checks of level 3 that need no other solve, those of the multipliers of contact points among them.

    Where one is next to nothing, or that of a condition which holds the control for a moment, the second variation has
    to be positive without that condition: J - J* >= L - L* with multipliers of the right sign, strictly or not. Else
    variations keep the condition, and its multiplier must be strict.
    """
    if not all(check.passed for check in strict):
        from perilune.proof.necessary.contact_points import relax_strict_check

        without = list(check_local_optimality(parts, idle))
        if all(check.passed for check in without):
            yield from (check if check.passed else relax_strict_check(check) for check in strict)
            yield from without
            return
    yield from strict
    found = list(check_local_optimality(parts, kept))
    if idling := _idle_controls(parts, found):
        from perilune.proof.necessary.contact_points import relax_strict_check

        released = {k: kept.get(k, KeptConditions()) for k in range(len(parts.problem.phases))}
        released = {k: replace(one, released=(*one.released, *idling.values())) for k, one in released.items()}
        without = [relax_strict_check(c) if c.name in idling else c for c in check_local_optimality(parts, released)]
        found = without if all(check.passed for check in without) else found
    yield from found


def _idle_controls(parts: Solution, found: Sequence[Check]) -> dict[str, str]:
    """Return the conditions that hold the control with multipliers that are not strictly positive, by failed check.

    One that is called as a control is left out: the check may be that of the control, which nothing excuses.
    """
    strict = {
        f"{arc.prefix}strict_{condition.name}": condition.name
        for arc in phase_data_of(parts)
        for condition in arc.phase.path_conditions
        if condition.name not in arc.phase.control_names
    }
    return {c.name: strict[c.name] for c in found if c.name in strict and not c.passed}


def _note_unused_tolerance(checks: Sequence[Check], tolerance: Tolerance) -> tuple[str, ...]:
    """Return a note if a tolerance was stated and every check would have passed without it."""
    if not tolerance.stated or not all(check.passed and not check.lenient for check in checks):
        return ()
    return (f"no part of the stated tolerance ({tolerance.describe()}) was needed",)


def _notes_on_loaded_problem(problem: Problem) -> tuple[str, ...]:
    """Return a note on the checks that a problem from a file does not state."""
    missing = [
        what
        for what, stated in (
            ("the model's consistency checks (rocket equation)", problem.consistency_checks),
            ("the physical bounds before solving (preflight)", problem.preflight),
        )
        if stated is None
    ]
    if problem.source == OWN_TEXT or not missing:
        return ()
    return (f"not checked, because the problem in the file does not state it: {'; '.join(missing)}",)
