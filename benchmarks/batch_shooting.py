"""Complete boundary value problems per second: four kinds, each dispersed around one solution, Newton in lanes.

The first line is a landing with its conditions written by hand in the fewest unknowns, four, as `parameters` disperses
it; the others are derived from problems. Arcs are counted too: what a problem costs depends on how many it needs.

    python benchmarks/batch_shooting.py [--lanes 16384]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

TESTS = Path(__file__).parents[1] / "tests"
sys.path[:0] = [str(TESTS), str(TESTS / "kernels")]
# ruff: noqa: E402

from landing_bvp import by_hand, parameters  # pyright: ignore[reportMissingImports]

from many_problems import KINDS  # pyright: ignore[reportMissingImports]
from perilune.core import Matrix
from perilune.shooting.shooting_function import Shooting


def measure(name: str, shooting: Shooting, guesses: Matrix, p: Matrix) -> None:
    """Measure one kind and print its line."""
    lanes, nothing = len(guesses), shooting.holding({})
    shortest, processor = np.inf, np.inf
    for _ in range(5):
        shooting.arcs = 0
        begun, used = time.perf_counter(), time.process_time()
        roots = shooting.solve(guesses, p, nothing, tolerance=1e-10)
        shortest = min(shortest, time.perf_counter() - begun)
        processor = min(processor, time.process_time() - used)
    print(
        f"{name:40s} {lanes / shortest:8.0f} problems/s, {lanes / processor:8.0f} per core second; "
        f"{shooting.arcs / lanes:5.2f} arcs each, {shooting.arcs / shortest:8.0f} arcs/s, "
        f"{shooting.arcs / processor:8.0f} per core second; {roots.converged.mean():.2%} converged, "
        f"greatest residual {np.nanmax(roots.residuals):.1e}"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=16384)
    lanes = parser.parse_args().lanes
    shooting, p = Shooting(by_hand()), parameters(lanes)
    nominal = shooting.root(np.array([0.887, 0.458, -0.063, 0.973]), p[0], shooting.holding({}))
    measure("landing, conditions by hand", shooting, np.tile(nominal.y, (lanes, 1)), p)
    for kind in KINDS:
        measure(kind.name, *kind.batch(lanes))


if __name__ == "__main__":
    main()
