"""Onset of a pair of switches, where one begins: the time w between them is held, and found where dJ/dw = 0.

What is on its bound gains by an instant on the other one, at a rate that goes through zero where the pair begins; it
loses like w^2, so that w rises in proportion. With w free both switches ask for nearly the same, and w = 0 at any zero
of the switching function asks for nothing more: Newton's method mostly ends there. With w held it does not, and the
slope of J along these extremals is nearly a straight line in w (secant method).
"""

from __future__ import annotations

from perilune.core import Vector
from perilune.methods.indirect.newton_trials import found_at
from perilune.methods.indirect.random_costates import active_set_of_guess, unknowns_of_guess
from perilune.methods.indirect.search import Search
from perilune.problem import Solution, free_scales
from perilune.shooting import FINEST, Root

_SECANTS = 8
_SAME = 1e-6  # of w: nearer Newton's method ends at it


def with_pair(search: Search, guess: Solution, duration: str) -> Solution | None:
    """Return the extremal in which a phase is as brief as it is best, from one near it without that; None if none.

    Parameters
    ----------
    search
        Of the restated problem.
    guess
        A solution of it, however the phase lasts.
    duration
        Name of the free parameter that the length of the phase is.
    """
    trials, index = search.state.trials, search.problem.free_names.index(duration)
    y = unknowns_of_guess(search.settings, trials, guess)
    free = active_set_of_guess(trials, y)
    free[[index, trials.shooting.plan.held + index]] = 0.0

    def held(y: Vector, w: float) -> Root:
        choice = free.copy()
        trials.shooting.plan.hold(choice, index, w)
        return trials.settled(y[None], choice, limits=trials.limits.without(index), accuracy=FINEST)[0]

    w = guess.free[duration] / float(free_scales(search.problem.free, search.problem)[index])
    last, root = held(y, 2.0 * w), held(y, w)
    for _ in range(_SECANTS):
        ends = [float(r.y[trials.conditions.free_at][index]) for r in (last, root)]
        slopes = [float(r.slopes[index]) for r in (last, root)]
        if not (last.converged and root.converged) or slopes[0] == slopes[1]:
            break
        w = ends[1] - slopes[1] * (ends[1] - ends[0]) / (slopes[1] - slopes[0])
        if not w > 0.0 or abs(w - ends[1]) <= _SAME * w:
            break
        last, root = root, held(root.y, w)
    found = trials.settled((root if root.converged else last).y[None], free, limits=trials.limits, accuracy=FINEST)[0]
    if not found.converged or trials.outside(found) is not None:
        return None
    return search.state.compose([found_at(trials.shooting, search.problem, found)], "guess")
