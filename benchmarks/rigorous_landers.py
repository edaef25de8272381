"""Level 5 on landers from perilune drawn at random: how many are theorems, why others are not, and how long it takes.

Those of `random_landers.py` whose thrust is above half the weight on the ground; of these only what is PROVED 3 counts.
Then a false claim is made of each theorem, a place 1e-9 of each unknown away within 1e-12: none may be proved.

    python benchmarks/rigorous_landers.py [--count 100] [--seed 2015] [--jobs 2] [--limit 300] [--only 17] [--out FILE]

``--limit`` is the processor time [s] of each proof.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from flint import arb, ctx

from perilune.core import Outcome, PeriluneError, ignore_events
from perilune.problem import Problem
from perilune.rigorous.enclosure_step import NotEnclosed
from perilune.rigorous.krawczyk import NotProved, prove_root
from perilune.rigorous.theorem import ProvedExtremal, attempt_proof
from perilune.rigorous.verified import add_attempt
from perilune.solve import solve
from random_landers import draw
from random_problems import DRAWS, OutOfTime, at_most, measured

THEOREM, LOWER = "theorem", "not PROVED 3"
_WEAKEST = 0.5  # thrust beside the weight on the ground
_AWAY, _CLAIMED = 1e-9, 1e-12  # of each unknown
_LEAST = 1e-9  # of the largest unknown: the size of one that is zero


def strong(problem: Problem) -> bool:
    """Whether the thrust is above half of the weight on the ground."""
    p = problem.parameters({name: 0.0 for name in problem.free_names})
    gravity = p.body_gravitational_parameter / (p.body_radius + p.landing_altitude) ** 2
    return p.vehicle_thrust > _WEAKEST * p.vehicle_mass * gravity


def lander(seed: int, number: int) -> Problem:
    """Lander `number` of those that are strong enough."""
    return next(p for k in range(DRAWS) if strong(p := draw(seed, DRAWS * number + k)))


def judge(seed: int, number: int, limit: float) -> dict[str, Any]:
    """Solve a lander and prove it: its class, why, its digits, and the processor time of the proof [s]."""
    problem = lander(seed, number)
    row: dict[str, Any] = {"number": number, "given": {name: given.value for name, given in problem.given.items()}}
    row |= {"cpu": 0.0, "false": None}
    try:
        solution = solve(problem)
    except PeriluneError as error:
        return row | {"class": LOWER, "why": error.what}
    if solution.outcome is not Outcome.PROVED:
        return row | {"class": LOWER, "why": solution.verification.title}
    began = time.process_time()
    try:
        with at_most(limit):
            found = attempt_proof(solution, ignore_events)
    except OutOfTime:
        return row | {"class": "slow", "why": f"not proved after {limit:g} s", "cpu": limit}
    row["cpu"] = time.process_time() - began
    verification = add_attempt(solution.verification, found)
    if verification.certificate is None or found.proved is None:
        return row | {"class": "no theorem", "why": verification.notes[0]}
    proved = found.proved
    row |= {"class": THEOREM, "why": "", "optimum": proved.optimum.proved, "J": proved.objective.str(30)}
    return row | {"distance": proved.distance, "radius": float(proved.objective.rad()), "false": false(proved, number)}


def false(proved: ProvedExtremal, number: int) -> bool:
    """Whether a root is proved at a place where there is none."""
    rng = np.random.default_rng(number)
    centre = proved.refined.y
    least = _LEAST * max(float(c.abs_upper()) for c in centre)
    sizes = [max(float(c.abs_upper()), least) for c in centre]
    with ctx.workprec(proved.settings.bits):
        place = [c + arb(s * _AWAY * rng.choice((-1.0, 1.0))) for c, s in zip(centre, sizes, strict=True)]
        try:
            moved = replace(proved.refined, y=place)
            prove_root(proved.boundary, moved, proved.settings, ignore_events, [_CLAIMED * s for s in sizes])
        except (NotProved, NotEnclosed):
            return False
    return True


def summary(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Each that is no theorem, the share of theorems, and how many false claims were proved."""
    for row in rows:
        if row["class"] != THEOREM:
            yield f"{row['number']:5d} {row['class']} ({row['cpu']:.1f} s): {row['why'][:300]}"
    yield f"{dict(Counter(row['class'] for row in rows))}"
    counted = [row for row in rows if row["class"] != LOWER]
    proved = [row for row in counted if row["class"] == THEOREM]
    optima = sum(row["optimum"] for row in proved)
    yield f"theorems: {len(proved)} of {len(counted)} that are PROVED 3; {optima} of them strict local optima"
    yield f"false claims: {sum(r['false'] for r in proved)} of {len(proved)} proved"
    if proved:
        took = np.array([row["cpu"] for row in counted])
        yield f"J to within {max(r['radius'] for r in proved):.1e} kg at worst"
        yield f"processor time of a proof: median {np.median(took):.1f} s, longest {took.max():.1f} s"


if __name__ == "__main__":
    measured(__doc__, judge, summary, lambda row: f"{row['class']} {row['cpu']:.1f} s", count=100, limit=300.0)
