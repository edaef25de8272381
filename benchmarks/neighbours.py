"""A solve from a neighbour's solution: what it takes one by one, as a user calls it, and in lanes.

The neighbours differ in the thrust by 0.1 to 0.5 thousandths. Processor time of one process, without proof; medians.

    python benchmarks/neighbours.py [--lanes 256] [SCENARIO ...]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import perilune as pl
from perilune import Indirect
from perilune.methods.indirect.neighboring import Nearby
from perilune.problem import preflight
from perilune.scenario import load_file

EXAMPLES = Path(__file__).parents[1] / "examples"
SCENARIOS = ("minimum_duration_return.toml", "hybrid_lander.toml")
PARAMETER, TIMES = "vehicle_thrust", 30


def measure(path: Path, lanes: int) -> None:
    """Print the lines of one scenario."""
    problem = load_file(path).problem
    solution = Indirect().run(problem)
    value, taken = problem.given[PARAMETER].value, dict[str, list[float]]()

    def timed(what: str, do: Callable[[], Any]) -> Any:
        begun = time.process_time()
        result = do()
        taken.setdefault(what, []).append(1e3 * (time.process_time() - begun))
        return result

    for i in range(TIMES):
        thrust = value * (1 + 1e-4 * (1 + 4 * i / TIMES))
        neighbour = timed("with_given", lambda thrust=thrust: problem.with_given(**{PARAMETER: thrust}))
        timed("preflight", lambda neighbour=neighbour: preflight(neighbour))
        timed("solve, preflight apart", lambda neighbour=neighbour: Indirect().run(neighbour, solution))
        timed("solve", lambda neighbour=neighbour: pl.solve(neighbour, guess=solution, verify=0))
    nearby = Nearby(solution)
    values = {PARAMETER: value * (1 + 1e-4 * np.linspace(1.0, 5.0, lanes))}
    for _ in range(5):
        roots = timed("in lanes", lambda: nearby.roots(values))
        assert roots.converged.all(), "neighbours"
    taken["in lanes"] = [each / lanes for each in taken["in lanes"]]
    print(f"{path.stem}: " + ", ".join(f"{what} {median(each):.3g} ms" for what, each in taken.items()))


def main() -> None:
    """Measure the scenarios that are named."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=256)
    parser.add_argument("scenarios", nargs="*", type=Path, default=[EXAMPLES / name for name in SCENARIOS])
    asked = parser.parse_args()
    for path in asked.scenarios:
        measure(path, asked.lanes)


if __name__ == "__main__":
    main()
