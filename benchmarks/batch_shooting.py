"""Complete landing problems per second: 16 384 dispersed around one solution, Newton in lanes.

python benchmarks/batch_shooting.py [--lanes 16384]
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "kernels"))

from landing_bvp import functions, parameters  # pyright: ignore[reportMissingImports]

from perilune.kernels.batch import BatchShooter


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=16384)
    lanes = parser.parse_args().lanes
    shooter = BatchShooter(*functions())
    p = parameters(lanes)
    nominal = shooter.solve(np.array([0.887, 0.458, -0.063, 0.973]), p[:1])
    shortest, processor = np.inf, np.inf
    for _ in range(5):
        begun, used = time.perf_counter(), time.process_time()
        shots = shooter.solve(nominal.y[0], p)
        shortest = min(shortest, time.perf_counter() - begun)
        processor = min(processor, time.process_time() - used)
    print(
        f"{lanes / shortest:.0f} problems/s ({lanes} in {shortest:.3f} s), {lanes / processor:.0f} per core second, "
        f"{shots.converged.mean():.2%} converged, "
        f"{shots.iterations.mean():.2f} arcs each, greatest residual {shots.residual.max():.1e}"
    )


if __name__ == "__main__":
    main()
