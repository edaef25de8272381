"""Complete boundary value problems per second: four kinds, each dispersed around one solution, Newton in lanes.

The last columns count arcs: what one problem costs depends on how many it needs.

    python benchmarks/batch_shooting.py [--lanes 16384]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from many_problems import KINDS, Kind  # pyright: ignore[reportMissingImports]


def measure(kind: Kind, lanes: int) -> None:
    """Measure one kind and print its line."""
    shooting, guesses, p = kind.batch(lanes)
    nothing = shooting.holding({})
    shortest, processor = np.inf, np.inf
    for _ in range(5):
        shooting.arcs = 0
        begun, used = time.perf_counter(), time.process_time()
        roots = shooting.solve(guesses, p, nothing, tolerance=1e-10)
        shortest = min(shortest, time.perf_counter() - begun)
        processor = min(processor, time.process_time() - used)
    print(
        f"{kind.name:40s} {lanes / shortest:8.0f} problems/s, {lanes / processor:8.0f} per core second; "
        f"{shooting.arcs / lanes:5.2f} arcs each, {shooting.arcs / shortest:8.0f} arcs/s, "
        f"{shooting.arcs / processor:8.0f} per core second; {roots.converged.mean():.2%} converged, "
        f"greatest residual {np.nanmax(roots.residuals):.1e}"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=16384)
    lanes = parser.parse_args().lanes
    for kind in KINDS:
        measure(kind, lanes)


if __name__ == "__main__":
    main()
