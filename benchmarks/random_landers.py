"""500 landers drawn at random, each solved without a guess and proved: certified, refused with the reason, or failed.

Thrust-to-mass 0.8-6 m/s^2, Isp 250-450 s, impulsive Isp 0.85-1 of it, perilune 8-30 km, parking orbit 50-200 km, mass
50 kg-20 t (logarithmic), over the Moon, Mercury, Europa and Ceres. Run:

    python benchmarks/random_landers.py [--count 500] [--seed 2015] [--level 3] [--out landers.json]

Wall-clock figures depend on the machine; the counts do not.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

from perilune.models.bodies import CERES, EUROPA, MERCURY, MOON
from perilune.models.landing import Orbit, Retro, Vehicle, hybrid_landing
from perilune.problem.problem import Problem
from perilune.solve import solve
from perilune.words.outcome import InfeasibleError, Outcome, PeriluneError

BODIES = (MOON, MERCURY, EUROPA, CERES)


def draw(rng: np.random.Generator) -> tuple[dict[str, Any], Problem]:
    """One lander: its description and its problem."""
    body = BODIES[rng.integers(len(BODIES))]
    mass = math.exp(rng.uniform(math.log(50.0), math.log(20e3)))
    acceleration, isp = rng.uniform(0.8, 6.0), rng.uniform(250.0, 450.0)
    retro_isp = isp * rng.uniform(0.85, 1.0)
    perilune, parking = rng.uniform(8e3, 30e3), rng.uniform(50e3, 200e3)
    words = {
        "body": body.name,
        "mass": mass,
        "thrust_to_mass": acceleration,
        "specific_impulse": isp,
        "retro_specific_impulse": retro_isp,
        "perilune_altitude": perilune,
        "parking_altitude": parking,
    }
    problem = hybrid_landing(
        Vehicle(mass=mass, thrust=mass * acceleration, specific_impulse=isp),
        Retro(specific_impulse=retro_isp),
        Orbit(parking_altitude=parking, perilune_altitude=perilune),
        body,
    )
    return words, problem


def judge(number: int, seed: int, level: int) -> dict[str, Any]:
    """Solve and prove lander `number`; what became of it."""
    words, problem = draw(np.random.default_rng([seed, number]))
    row: dict[str, Any] = {"number": number, **words}
    began = time.perf_counter()
    try:
        solution = solve(problem, level=level)
        good = solution.outcome is (Outcome.PROVED if level else Outcome.SOLVED)
        row |= {"result": "certified" if good else "failed", "rung": solution.statistics.rung}
        row |= {"delta_v": solution.free["retro_delta_v"], "landed_mass": -solution.objective}
        row["extremals"] = len(solution.extremals)
        if not good:
            row["reason"] = "; ".join(f"{c.name}: {c.value:.3g} > {c.limit:.3g}" for c in solution.verification.failed)
    except InfeasibleError as error:
        row |= {"result": "refused", "reason": f"{error.what}: {error.got}"}
    except PeriluneError as error:
        row |= {"result": "failed", "reason": f"{error.what}: {error.got}"}
    row["seconds"] = time.perf_counter() - began
    return row


def main() -> None:
    """Draw, solve on all cores, print the counts and every lander that was not certified."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=2015)
    parser.add_argument("--level", type=int, default=3)
    parser.add_argument("--out", default="")
    arguments = parser.parse_args()
    began = time.perf_counter()
    with ProcessPoolExecutor(max_workers=os.cpu_count()) as pool:
        jobs = [pool.submit(judge, n, arguments.seed, arguments.level) for n in range(arguments.count)]
        rows = [job.result() for job in jobs]
    wall = time.perf_counter() - began
    counts = Counter(row["result"] for row in rows)
    feasible = counts["certified"] + counts["failed"]
    seconds = np.array([row["seconds"] for row in rows])
    for row in rows:
        if row["result"] != "certified":
            print(
                f"{row['number']:4d} {row['result']}: {row['body']}, {row['thrust_to_mass']:.2f} m/s^2, "
                f"{row['specific_impulse']:.0f} s, perilune {row['perilune_altitude'] / 1e3:.1f} km: {row['reason']}"
            )
    print(f"{dict(counts)}; rungs {dict(Counter(row.get('rung') for row in rows))}")
    print(f"certified {100 * counts['certified'] / max(feasible, 1):.2f} % of {feasible} not refused")
    print(f"median {np.median(seconds):.2f} s, longest {seconds.max():.2f} s each; {wall:.0f} s in all")
    if arguments.out:
        with open(arguments.out, "w", encoding="utf-8") as file:
            json.dump(rows, file, indent=1)


if __name__ == "__main__":
    main()
