"""Level 3 by solving again: costates and free parameters predict the cost of neighbouring extremals.

lam(0) = dJ*/dx0      against central differences of J over problems whose initial state is shifted; what else is
                      free, but for durations, is held: by the envelope theorem choosing it again changes nothing;
                      and so is what an optimum hardly determines, as a wait (`perilune.shooting.root_across`).
                      A bound of a duration that holds nothing back is left out, as neighbours may take longer
d2J*/dp2 > 0          over problems with a free parameter held to either side of its optimum
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from perilune.core import PeriluneError, sign_of_life
from perilune.problem import (
    Check,
    Problem,
    Solution,
    fix_free_parameters,
    move_start,
    offset_of,
    release_free_parameters,
    with_start_offsets,
)
from perilune.proof.feasible.phase_data import objective_size, phase_data_of
from perilune.proof.necessary.first_order import all_multipliers, is_at_bounds, unbounded_parameters

Resolve = Callable[[Problem, Solution], Solution]

START_SHIFT = 3e-6  # canonical; central differences err by its square: 4e-8 at most measured, J itself by 1e-13
# Of what a state reaches: so much it rounds as a neighbour is solved, 20 times the last digit measured.
_ROUNDS = 1e-14
_J_ROUNDS = 1e-12  # of J: its neighbours on both sides, and twice itself
# Of the shift: a start five metres above its site bends within five metres, and Newton's method finds neighbours of an
# optimum that hardly distinguishes one wait from another within millimetres. Rounding of J allows no smaller one.
_SHARES = (1.0, 0.1, 0.01, 0.001)
PARAMETER_SHIFT = 2e-3
COSTATE_LIMIT = 1e-6
CURVATURE_LIMIT = -1e-4
SHIFTED = "initial_costate_"  # how the names of checks of shifted starts begin


def _neighbour_objective(resolve: Resolve, problem: Problem, guess: Solution) -> float:
    """J of a neighbouring problem, NaN where it could not be solved: the check then fails, saying so."""
    sign_of_life("proof: neighbouring problems are solved")
    try:
        return float(resolve(problem, guess).objective)
    except PeriluneError:
        return float("nan")


def check_neighbours(solution: Solution, resolve: Resolve) -> Iterator[Check]:
    """Checks of level 3 that solve neighbouring problems.

    Parameters
    ----------
    solution
        An extremal with costates.
    resolve
        ``resolve(problem, guess)`` returns the extremal of `problem` next to the guess; a free parameter whose range is
        a single value is held there.
    """
    bound = {f.name: solution.free[f.name] for f in solution.problem.free if any(is_at_bounds(solution, f))}
    solution = _with_implied_multipliers(solution)
    yield from _check_initial_costates(solution, resolve)
    yield from _check_parameter_slopes(solution, bound, resolve)


def _with_implied_multipliers(solution: Solution) -> Solution:
    """Return the solution with the multipliers that its curves imply where it gives none, as at contact points.

    Neighbours keep its active ranges: nothing else shows that a duration in two parts is at its longest.
    """
    arcs = phase_data_of(solution)
    implied = {
        f"{arc.phase.name}.{condition.name}": float(value)
        for arc, nu in zip(arcs, all_multipliers(arcs), strict=True)
        for condition, value in zip(arc.phase.end_conditions, nu, strict=True)
    }
    return replace(solution, multipliers={**implied, **solution.multipliers})


def _check_initial_costates(solution: Solution, resolve: Resolve) -> Iterator[Check]:
    problem, costate = with_start_offsets(solution.problem), solution.trajectories[0].costate
    if costate is None:
        return
    arcs = phase_data_of(solution)
    arc = arcs[0]
    durations = [name for name in unbounded_parameters(solution, arcs) if name in problem.duration_names]
    chosen = {f.name: solution.free[f.name] for f in problem.free if f.name not in durations}
    # J is known no better than the states are: of a place far from its origin the shift has to be larger for that.
    known = _ROUNDS * float(np.abs(costate.values[0]) @ np.abs(arc.trajectory.state.values).max(axis=0))
    shares = list(_SHARES)
    for state, of_state, lam in zip(problem.phases[0].states, arc.state_scale, costate.values[0], strict=True):
        size = of_state / max(arc.objective_scale, abs(solution.objective))  # differences of J are rounded by |J|

        def slope(shift: float, name: str = offset_of(state.name)) -> float:
            sides = (
                fix_free_parameters(release_free_parameters(move_start(problem, **{name: s}), durations), **chosen)
                for s in (shift, -shift)
            )
            ahead = _neighbour_objective(resolve, next(sides), solution)
            # Where one side has no answer the other, which takes as long to fail, shows nothing.
            return (
                (ahead - _neighbour_objective(resolve, next(sides), solution)) / (2 * shift)
                if np.isfinite(ahead)
                else ahead
            )

        limit = COSTATE_LIMIT * max(1.0, abs(lam) * size)
        nearest = START_SHIFT * of_state, float("nan")
        for share in tuple(shares):
            shift = share * max(START_SHIFT * of_state, known * size / limit)
            change = slope(shift)
            if abs(change - lam) * size > 0.3 * limit and np.isfinite(wider := slope(2 * shift)):
                # Long arcs bend more within a shift: Richardson's extrapolation takes out the square of it.
                change = (4 * change - wider) / 3
            if np.isfinite(change) and not abs(nearest[1] - lam) <= abs(change - lam):
                nearest = shift, change
            if abs(change - lam) * size <= limit:
                # Along a flat optimum no wider shift is needed: the other states begin with what is.
                shares.sort(key=lambda other: abs(_SHARES.index(other) - _SHARES.index(share)))
                break
        yield Check(
            name=f"{SHIFTED}{state.name}", level=3, limit=limit, unit="1",
            value=abs(float(nearest[1] - lam)) * size,
            meaning=f"difference between the costate of {state.name} at the start and the change of the "
            "optimum when "
            f"the start is shifted by {nearest[0]:.3g} {state.unit} and solved again (scaled; NaN: not solved)",
        )  # fmt: skip


def _check_parameter_slopes(solution: Solution, bound: dict[str, float], resolve: Resolve) -> Iterator[Check]:
    problem = solution.problem
    for free in problem.free:
        if free.name in problem.duration_names or free.name in bound:
            continue
        value, room = solution.free[free.name], free.upper - free.lower
        # Its canonical unit may be as small as anyone likes; where it is counted from is no size.
        size = max(problem.size_of(free), min(abs(value), room) if np.isfinite(room) else 0.0)
        widest = min(PARAMETER_SHIFT * size, 0.5 * (value - free.lower), 0.5 * (free.upper - value))
        for share in _SHARES:
            shift = share * widest
            beside = [fix_free_parameters(problem, **bound, **{free.name: value + s}) for s in (shift, -shift)]
            sides = [_neighbour_objective(resolve, neighbour, solution) for neighbour in beside]
            if np.isfinite(sides).all():
                break
        # What J may owe to rounding is not taken for a curvature.
        risen = sides[0] + sides[1] - 2 * solution.objective - _J_ROUNDS * abs(solution.objective)
        curvature = risen / shift**2
        yield Check(
            name=f"second_order_{free.name}", level=3, limit=CURVATURE_LIMIT, unit="1",
            value=-float(np.float64(curvature)) * size**2 / objective_size(solution),
            meaning=f"minus the curvature of the optimum over {free.name}, solved again {shift:.3g} "
            f"{free.unit} to "
            "either side (scaled): below 0 at a minimum, above 0 at a maximum (NaN: not solved)",
        )  # fmt: skip
