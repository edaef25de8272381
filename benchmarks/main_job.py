"""The main job: whole processes, start-up, and solves inside one process. Medians and ranges; machines are noisy.

    python benchmarks/main_job.py [--runs 7]

Alternatives in the same run: a bare `python -c "import numpy, casadi, scipy.integrate"` stands beside the whole
process (what of it is not ours), and the direct method beside the indirect.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
SCENARIO = str(ROOT / "examples" / "hybrid_lander.toml")
SOLVE = [sys.executable, "-m", "perilune", "solve", SCENARIO, "--json"]
IMPORTS = "import numpy, casadi, llvmlite.binding, scipy.integrate"


def timed(action: Callable[[], object], runs: int) -> list[float]:
    """Seconds of each run."""
    seconds = []
    for _ in range(runs):
        began = time.perf_counter()
        action()
        seconds.append(time.perf_counter() - began)
    return seconds


def show(what: str, seconds: list[float], scale: float = 1.0, unit: str = "s") -> None:
    """One line: median, least and most."""
    low, middle, high = min(seconds), statistics.median(seconds), max(seconds)
    print(f"{what:58s} {middle * scale:8.2f} {unit}  ({low * scale:.2f} to {high * scale:.2f})")


def process(command: list[str], **environment: str) -> None:
    """One whole process, which must succeed."""
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, **environment})


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=7)
    runs = parser.parse_args().runs
    python = [sys.executable, "-c"]
    process(SOLVE)
    show("process: solve, proved, JSON; kernels in the cache", timed(lambda: process(SOLVE), runs))
    with tempfile.TemporaryDirectory() as empty:
        seconds = []
        for i in range(min(runs, 3)):
            folder = str(Path(empty) / str(i))
            seconds += timed(lambda folder=folder: process(SOLVE, PERILUNE_CACHE=folder), 1)
        show("process: the same, cache empty", seconds)
    show("process: imports of the libraries alone", timed(lambda: process([*python, IMPORTS]), runs))
    show("process: import perilune", timed(lambda: process([*python, "import perilune"]), runs))
    show("process: python alone", timed(lambda: process([*python, "pass"]), runs))
    show("process: perilune --help", timed(lambda: process([sys.executable, "-m", "perilune", "--help"]), runs))
    inside(runs)


def inside(runs: int) -> None:
    """Solves inside this process, everything loaded and compiled."""
    from perilune import Pseudospectral
    from perilune.scenario import load_file
    from perilune.solve import solve
    from perilune.verify import verify

    problem = load_file(Path(SCENARIO)).problem
    solution = solve(problem, verify=0)
    near = problem.with_given(vehicle_mass=301.0)
    solve(near, guess=solution, verify=0)
    verify(solution)
    show("solve without a guess, every extremal", timed(lambda: solve(problem, verify=0), 3 * runs), 1e3, "ms")
    show(
        "solve from a neighbour's solution", timed(lambda: solve(near, guess=solution, verify=0), 30 * runs), 1e3, "ms"
    )
    show("verification to level 3", timed(lambda: verify(solution), runs), 1e3, "ms")
    direct = Pseudospectral(nodes=20, refine=0)
    direct.run(problem)
    show("direct method, 20 Gauss nodes, no guess, no refinement", timed(lambda: direct.run(problem), runs), 1e3, "ms")


if __name__ == "__main__":
    main()
