"""Hybrid method of the paper on both neighbours, from one random start after another, compared with ours."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial

from perilune import Genetic, Hybrid, Indirect, Problem, solve
from perilune.core import Watch
from perilune_papers.liu2019.case import site_fixed, site_free
from perilune_papers.starts import Starts, run_starts

RARELY = 5  # one of so many seeds is tried on neighbour B as well, where each takes so long


@dataclass(frozen=True, kw_only=True)
class Searches:
    """Neighbours solved again and again: by the hybrid method from other random values each time.

    Parameters
    ----------
    ours, hybrid
        Neighbour A on the descending pass; ours with what it derives for its first answer (`cold` [s]), and after it.
    on_fixed
        Neighbour B by the hybrid method.
    """

    cold: float
    ours: Starts
    hybrid: Starts
    on_fixed: Starts


def run_searches(seeds: int, watch: Watch) -> Searches:
    """Neighbours from so many seeds, and ours as often.

    Parameters
    ----------
    seeds
        Number of seeds; the slower searches run fewer.
    watch
        Called with lines of text.
    """
    free = site_free("descending")
    began = time.process_time()
    solve(free, verify=0)
    cold = time.process_time() - began
    return Searches(
        cold=cold,
        ours=run_starts(lambda _: solve(free, verify=0).results["flight_time"].value, seeds, watch),
        hybrid=run_starts(partial(by_hybrid, free), seeds, watch),
        on_fixed=run_starts(partial(by_hybrid, site_fixed()), seeds // RARELY, watch),
    )


def by_hybrid(problem: Problem, seed: int) -> float:
    """Time of flight [s] by a genetic search over initial costates and t_a, and Newton from its three best.

    Parameters
    ----------
    problem
        The problem to solve.
    seed
        Seed of the genetic search.
    """
    return Hybrid(Genetic(seed=seed, best=3), Indirect()).run(problem).results["flight_time"].value
