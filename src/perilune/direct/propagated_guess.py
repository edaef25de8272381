"""First guess by simulation, for flights that no straight line resembles, such as one that winds round a body.

The controls of the straight lines (`perilune.direct.first_guess`) are flown from the start for the typical durations.
Such a flight misses the ends, but it keeps the dynamics and swings about as often as the answer will: it also
shows how fine the first mesh has to be.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp

from perilune.core import Matrix, Vector, sign_of_life
from perilune.direct.collocated_solution import Sampler
from perilune.direct.first_guess import first_guesses, phase_start
from perilune.problem import Problem, admissible, free_scales, state_scales

FAITHFUL = 1e-5  # relative accuracy of a flight that only has to look like one
LOOKS = 400  # points of a phase at which its swings are counted
WINDING = 2.5  # there and back is 2; a flight that goes through more of its range than this winds
EVALUATED = 10_000  # times the rates of a phase: what needs more winds a hundred times, more than any mesh follows
SEGMENTS, NODES = 2.0, 8  # for each time that a flight goes through its range, and of each segment


def simulate_guess(problem: Problem, free: Vector, lines: Sequence[Sampler]) -> list[Sampler] | None:
    """Fly each phase under the controls of other samplers; None where they cannot be flown to the end.

    Parameters
    ----------
    problem
        The problem.
    free
        Free parameters, canonical.
    lines
        A sampler for each phase, with its controls.
    """
    values = dict(zip(problem.free_names, (free * free_scales(problem.free, problem)).tolist(), strict=True))
    p, before, found = problem.parameters(values), None, list[Sampler]()
    for k, (phase, line) in enumerate(zip(problem.phases, lines, strict=True)):
        begin, duration = phase_start(problem, k, before, p), float(getattr(p, phase.duration))
        left = iter(range(EVALUATED))

        def flow(at: float, x: Vector, k=k, line: Sampler = line, duration: float = duration, left=left) -> Vector:
            if next(left, None) is None:
                raise ArithmeticError("a flight of too many turns")
            sign_of_life("direct method: a flight under the controls of a straight line")
            u = admissible(problem.phases[k].controls, line(np.array([at]))[1].T, p)[:, 0]
            return duration * np.array(problem.phases[k].rates(list(x), list(u), p), dtype=float)

        least = FAITHFUL * np.maximum(np.abs(begin), state_scales(problem, phase))
        try:
            with np.errstate(all="ignore"):  # it may lead where the physics is not defined
                flown = solve_ivp(flow, (0.0, 1.0), begin, "DOP853", rtol=FAITHFUL, atol=least, dense_output=True)
        except ArithmeticError:
            return None
        before = flown.y[:, -1]
        if flown.t[-1] < 1.0 or not np.isfinite(before).all():
            return None

        def sample(fraction: Vector, path=flown.sol, line: Sampler = line) -> tuple[Matrix, Matrix]:
            at = np.asarray(fraction)
            return path(at).T, line(at)[1]

        found.append(sample)
    return found


def count_swings(guess: Sequence[Sampler]) -> tuple[float, ...]:
    """Return for each phase of a guess the largest total variation of a state relative to its range."""
    times = []
    for sample in guess:
        x = sample(np.linspace(0.0, 1.0, LOOKS))[0]
        ways, ranges = np.abs(np.diff(x, axis=0)).sum(axis=0), np.ptp(x, axis=0)
        times.append(float(np.max(ways / np.where(ranges > 0, ranges, math.inf))))
    return tuple(times)


def fitting_segments(guess: Sequence[Sampler]) -> tuple[int, ...]:
    """Return the segments of each phase that follow a guess."""
    return tuple(max(1, math.ceil(SEGMENTS * t)) for t in count_swings(guess))


def winds_repeatedly(guess: Sequence[Sampler]) -> bool:
    """Return True if a guess goes through its range more often than there and back."""
    return max(count_swings(guess)) > WINDING


def segments_by_simulation(problem: Problem) -> tuple[int, ...]:
    """Return the segments of each phase that follow a flight under the first guess; none where it cannot be flown."""
    free, lines, _ = next(first_guesses(problem, None))
    flown = simulate_guess(problem, free, lines)
    return () if flown is None else fitting_segments(flown)
