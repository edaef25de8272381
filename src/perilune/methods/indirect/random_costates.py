"""Starting points of Newton's method: random costates, a known solution's unknowns, or those it is continued to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from perilune.conditions import extremal_parameters
from perilune.core import Matrix, Vector
from perilune.methods.indirect.newton_trials import Trials
from perilune.methods.indirect.settings import SearchSettings
from perilune.methods.indirect.unknowns import unknowns_from_solution
from perilune.problem import Solution, canonical_free, is_neighbour, move_start, offset_of
from perilune.shooting import ActiveSetBounds, Member, Root, follow_family, root_across

PATIENCE = 24  # evaluations of a random start: the first to reach an extremal take 6 to 24, on nearly all landers
STRIDE = 0.5  # largest component of a step from a random start, whose costates have length one
_BESIDE, _CORRECTIONS = 1e-6, 20  # of the numbers: where sensitivities are differences; steps of Newton's method
#: Residual of what is followed: where the rest is rounding the flight that is exported may end nearer.
NEARLY = 1e-8
_ON_BOUND = 1e-5  # canonical distance at which a guess means a bound, as the direct method stays up to that far inside
_VANISHING = 1e-3  # of the longest that a phase may last
SIGNED = 1e-6  # canonical multiplier of a range beyond which a guess counts as holding it
_OF_EXTREMAL = 1e-9  # the same of an extremal, whose neighbours are solved: J or the range may be stated in large units


def random_costate_unknowns(trials: Trials, count: int, seed: int) -> Matrix:
    """Return unknowns with random costates of length one and free parameters around their typical values.

    Parameters
    ----------
    trials
        Newton's method on the problem.
    count
        Number of starts.
    seed
        Of the random numbers.

    Returns
    -------
    Matrix
        Unknowns, canonical, (count, n).
    """
    rng, c, problem = np.random.default_rng(seed), trials.conditions, trials.problem
    Y = np.zeros((count, len(c.unknowns)))
    directions = rng.normal(size=(count, c.free_at.start))
    Y[:, : c.free_at.start] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    typical = canonical_free(problem, {f.name: f.guess for f in problem.free})
    Y[:, c.free_at] = typical * np.exp(rng.uniform(-0.4, 0.4, size=(count, len(typical))))
    return Y


def vanishing_durations(trials: Trials) -> dict[int, float]:
    """Return free parameters that are lengths of phases which may shrink to an instant, and their least values."""
    lower, upper, problem = trials.limits.lower, trials.limits.upper, trials.problem
    lengths = [i for i, name in enumerate(problem.free_names) if name in problem.duration_names]
    return {i: float(lower[i]) for i in lengths if 0 < lower[i] < _VANISHING * upper[i]}


def leave_out_vanishing(trials: Trials, Y: Matrix, choices: Matrix) -> None:
    """Leave out the phases that may vanish; the phase before each then lasts for as long as both.

    Parameters
    ----------
    trials
        Newton's method on the problem.
    Y
        Unknowns of the starts, (starts, n), changed in place.
    choices
        What each start holds, changed in place.
    """
    problem, first = trials.problem, trials.conditions.free_at.start
    for i, least in vanishing_durations(trials).items():
        k = problem.duration_names.index(problem.free_names[i])
        if k and problem.duration_names[k - 1] in problem.free_names:
            Y[:, first + problem.free_names.index(problem.duration_names[k - 1])] += Y[:, first + i]
        Y[:, first + i] = least
        trials.shooting.plan.hold(choices, i, least)


def hold_ranges(trials: Trials, choices: Matrix) -> None:
    """Hold in one start none of the ranges, in the next the first at a bound, and so on.

    Parameters
    ----------
    trials
        Newton's method on the problem, with the bounds of its ranges.
    choices
        Active set (`Shooting.holding`) of each start, shape (starts, 2 k); changed in place.
    """
    first, held = trials.shooting.plan.free, trials.shooting.plan.held
    bounds = [
        (i, side[i])
        for side in (trials.limits.lower, trials.limits.upper)
        for i in range(first, held)
        if np.isfinite(side[i])
    ]
    for number, (i, bound) in enumerate(bounds, 1):
        trials.shooting.plan.hold(choices[number :: len(bounds) + 1], i, bound)


def unknowns_of_guess(settings: SearchSettings, trials: Trials, guess: Solution) -> Vector:
    """Return the unknowns of a guess: its own where it is of this method and form, else read off its curves.

    So do neighbours for a proof begin, which looks at the curves and believes no other numbers.

    Parameters
    ----------
    settings
        Settings of the search.
    trials
        Newton's method on the problem.
    guess
        A solution with costates.
    """
    problem = trials.problem
    own = guess.unknowns if guess.method == settings.name and not is_neighbour(problem) else None
    same = own is not None and (guess.problem.scales, guess.problem.structure) == (problem.scales, problem.structure)
    if own is not None and same and len(own) == len(trials.conditions.unknowns):
        return np.array(own)
    return unknowns_from_solution(problem, trials.conditions, guess)


def active_set_of_guess(trials: Trials, y: Vector, limits: ActiveSetBounds | None = None) -> Vector:
    """Return the active set of a guess: free parameters on a bound, and ranges whose multiplier says so.

    Parameters
    ----------
    trials
        Newton's method on the problem.
    y
        Unknowns of the guess, canonical.
    limits
        Bounds of free parameters and ranges, by default those of the problem.
    """
    limits, free = limits or trials.limits, y[trials.conditions.free_at]
    held = {
        i: limit
        for i, value in enumerate(free.tolist())
        for limit in (limits.lower[i], limits.upper[i])
        if abs(value - limit) <= _ON_BOUND or limits.lower[i] == limits.upper[i]
    }
    ranges, least = {}, _OF_EXTREMAL if is_neighbour(trials.problem) else SIGNED
    for i, (_, unknown) in enumerate(trials.conditions.ranges):
        nu = y[unknown]
        limit = (limits.lower if nu < 0 else limits.upper)[len(free) + i]
        if abs(nu) > least and np.isfinite(limit):
            ranges[i] = float(limit)
    return trials.shooting.holding(held, ranges)


def continue_from_guess(trials: Trials, guess: Solution, y: Vector) -> tuple[Vector, Vector] | None:
    """Follow an extremal from other values of the parameters to those of the problem; return what it holds too.

    None where it ends on the way, or the guess is none of this form.

    Extremal by extremal on a straight way, each predicted by the sensitivity of the one before: a fall that climbs
    again multiplies what the flight before it is off by so much that Newton's method at the end of the way is lost.

    Parameters
    ----------
    trials
        Of the problem.
    guess, y
        The extremal, and its unknowns.
    """
    problem, before, shooting = trials.problem, guess.problem, trials.shooting
    alike = (before.structure, before.scales) == (problem.structure, problem.scales)
    if is_neighbour(problem) or guess.unknowns is None or not alike or len(guess.unknowns) != len(y):
        return None
    limits = ActiveSetBounds.of(before, trials.conditions)
    first = extremal_parameters(before), active_set_of_guess(trials, y, limits)
    last = trials.p, trials.limits.taken_over(first[1], limits)
    way = last[0] - first[0], last[1] - first[1]
    parts = [np.abs(part) / (1.0 + np.abs(begin)) for part, begin in zip(way, first, strict=True)]
    largest = float(np.concatenate(parts).max(initial=0.0))
    if largest == 0.0:
        return None
    step = min(_BESIDE / largest, 0.5)

    def at(share: float) -> tuple[Vector, Vector]:
        numbers, held = (begin + share * part for begin, part in zip(first, way, strict=True))
        return numbers, held

    def correct(predicted: Vector, share: float) -> Root:
        trials.watch(f"following the guess: {share:.0%} of the way")
        root = shooting.root(predicted, *at(share), limit=_CORRECTIONS, tolerance=NEARLY)
        return root if root.converged else replace(root, converged=shooting.rounding(root))

    def tangent(root: Root, share: float) -> Vector:
        (ahead, more), (behind, less) = at(share + step), at(share - step)
        return shooting.shift(root, ahead, behind, np.stack([more, less])) / (2.0 * step)

    begin = correct(y, 0.0)
    if not begin.converged:
        return None
    reached = next(iter(follow_family(Member(value=0.0, root=begin), [1.0], correct, tangent)))
    return None if reached is None else (reached.root.y, last[1])


def beside_flat(trials: Trials, y: Vector, choice: Vector) -> Root | None:
    """Return the root of a moved start with what a flat optimum hardly changes held; None where there is none.

    J of a neighbour whose parameter is held shows a curvature, to which what is held would add: of that none either.

    Parameters
    ----------
    trials
        Of a neighbour.
    y, choice
        Unknowns of the neighbouring extremal, and what that holds.
    """
    problem, shooting = trials.problem, trials.shooting
    names = {offset_of(state.name) for state in problem.phases[0].states} & {*problem.given}
    if not any(problem.given[name].value for name in names):
        return None
    same = move_start(problem, **dict.fromkeys(names, 0.0))
    like = shooting.at(y[None], extremal_parameters(same), choice)[0]
    return root_across(shooting, like, trials.p)
