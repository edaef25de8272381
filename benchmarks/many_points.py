"""Points of one problem solved together and one by one: rate a core second, ratio, and agreement, in one run.

    OPENBLAS_NUM_THREADS=1 python benchmarks/many_points.py [--points 10000] [--spread 0.1]

Together is `perilune.solve_many` with its set-up and re-integrations; one by one is ``solve(guess=...)`` at level 0,
which has none, on 50 of the same points.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

import perilune as pl

ROOT = Path(__file__).parent.parent
ALONE = 50
# What varies in each scenario: one smooth phase; a bounded parameter; switches; two phases with a contact point.
CASES = {
    "ordinary_lander": ("vehicle_thrust", "vehicle_specific_impulse", "vehicle_mass"),
    "hybrid_lander": ("vehicle_thrust", "vehicle_specific_impulse", "vehicle_mass"),
    "precision_landing": ("vehicle_thrust", "vehicle_specific_impulse"),
    "mars_pinpoint": ("vehicle_thrust", "vehicle_specific_impulse"),
    "minimum_duration_return": ("vehicle_thrust", "vehicle_mass"),
}


def measured(name: str, count: int, spread: float) -> str:
    """Return a row of the table."""
    problem = pl.scenario.load_file(ROOT / "examples" / f"{name}.toml").problem
    known, rng = pl.solve(problem, verify=0), np.random.default_rng(20261128)
    table = {n: problem.given[n].value * (1.0 + spread * rng.uniform(-1.0, 1.0, count)) for n in CASES[name]}
    pl.solve_many(problem, {n: values[:8] for n, values in table.items()}, known, search=False)  # compiles
    begin = time.process_time()
    batch = pl.solve_many(problem, table, known, search=False)
    together = count / (time.process_time() - begin)
    some = np.nonzero(batch.solved)[0][:ALONE].tolist()
    begin = time.process_time()
    alone = [pl.solve(batch.problem_of(i), guess=known, verify=0).objective for i in some]
    each = len(some) / (time.process_time() - begin)
    with np.errstate(invalid="ignore"):
        worse = float(np.max((batch.objective[some] - alone) / np.abs(alone)))
    rates = f"{together:.0f}/s | {each:.0f}/s | {together / each:.0f}"
    return f"| {name} | {rates} | {np.mean(batch.solved):.1%} | {worse:.1e} |"


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Points solved together and one by one")
    parser.add_argument("--points", type=int, default=10_000)
    parser.add_argument("--spread", type=float, default=0.1)
    given = parser.parse_args()
    print("| problem | together | one by one | ratio | reached in lanes | J worse than one by one, relative |")
    print("|---|---|---|---|---|---|")
    for name in CASES:
        print(measured(name, given.points, given.spread), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
