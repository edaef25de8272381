"""An atlas of the hybrid lander: building, opening, asking one by one and many at once, and what the answers are worth.

    python benchmarks/atlas.py [--workers 1] [--queries 10000] [--solved 50] [--tolerance 1e-9]

Thrust 350 to 650 N, impulsive Isp 270 to 310 s, perilune 10 to 25 km, the jump at which the retro burn stops paying
among them; nodes are flown twice, and none is proved. Times are of this run on this machine; the ratio to solving each
point from nothing is of the same run. A polynomial of ten coefficients on the ten nearest nodes, as Liu, Liu, Wu 2019,
(16), have it (in three variables it is of the second degree), is compared with what the cells give before it is
polished.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from perilune.atlas.building.build import TOLERANCE, build
from perilune.atlas.grid.cell_subdivision import WHOLE
from perilune.atlas.query.query import Atlas, open_atlas
from perilune.core import Matrix, Vector
from perilune.scenario import load_file
from perilune.solve import solve

EXAMPLE = Path(__file__).parent.parent / "examples" / "hybrid_lander.toml"
AXES = {
    "vehicle.thrust": (350.0, 650.0),
    "retro.specific_impulse": (270.0, 310.0),
    "orbit.perilune_altitude": (10e3, 25e3),
}
TEN = 10  # nodes, and coefficients


def percentiles(seconds: list[float]) -> str:
    """Of times, in milliseconds."""
    return ", ".join(f"{name} {1e3 * np.percentile(seconds, p):.3f} ms" for name, p in (("p50", 50), ("p99", 99)))


def asked(atlas: Atlas, points: Matrix) -> tuple[list[float], dict[int, float]]:
    """Times of queries one by one, and J of those that have an answer."""
    times, found = list[float](), dict[int, float]()
    for i, point in enumerate(points.tolist()):
        begun = time.perf_counter()
        try:
            found[i] = atlas.query(**dict(zip(atlas.region.names, point, strict=True))).objective
        except ValueError:
            pass
        times.append(time.perf_counter() - begun)
    return times, found


def nearest_nodes(values: Matrix, y: Matrix, at: Vector) -> Vector:
    """The paper's prediction: a polynomial of the ten nearest nodes, here of second degree in three variables."""
    near = np.argsort(np.abs(values - at).sum(axis=1))[:TEN]
    x = values[near] - at
    columns = [np.ones(len(x)), *x.T, *(x[:, i] * x[:, k] for i in range(3) for k in range(i, 3))]
    return np.linalg.lstsq(np.array(columns).T, y[near], rcond=None)[0][0]


def first_guesses(atlas: Atlas, points: Matrix) -> tuple[Vector, Vector]:
    """Errors of the first guess of the cells, and of the paper's polynomial on the same nodes, for the first sheet."""
    charted = atlas.charted[0]
    ours, theirs = list[float](), list[float]()
    for point in points:
        place = atlas.region.brick_of(point)
        brick, (low, high) = atlas.brick(0, place), atlas.region.box(place)
        if brick is None:
            continue
        inside = (point - low) / (high - low) * WHOLE
        cell = brick.leaf(0, inside.tolist())
        scale, guess = charted.chart.scale, brick.given(cell, inside)[:-1]
        exact = charted.polish((point / scale)[None], np.zeros(1, dtype=np.int64), guess[None])
        here = brick.nodes["sheet"] == 0
        rough = nearest_nodes(
            (brick.nodes["values"][here] - low) / (high - low),
            brick.nodes["terms"][here, 0, :-1],
            (point - low) / (high - low),
        )
        y = exact.y[0, charted.chart.active]
        ours.append(float(np.linalg.norm(guess - y)))
        theirs.append(float(np.linalg.norm(rough - y)))
    return np.array(ours), np.array(theirs)


def main() -> None:
    """Build, ask, compare."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--queries", type=int, default=10000)
    parser.add_argument("--solved", type=int, default=50)
    parser.add_argument("--tolerance", type=float, default=TOLERANCE, help="of cells: the finer, the more nodes")
    options = parser.parse_args()
    problem, directory = load_file(EXAMPLE).problem, Path(tempfile.mkdtemp()) / "atlas"
    begun, cpu = time.perf_counter(), time.process_time()
    if options.workers > 1:
        with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
            build(problem, AXES, directory, pool, sample=0, tolerance=options.tolerance)
    else:
        build(problem, AXES, directory, sample=0, tolerance=options.tolerance)
    took, used = time.perf_counter() - begun, time.process_time() - cpu
    begun = time.perf_counter()
    atlas = open_atlas(directory)
    opened = time.perf_counter() - begun
    nodes = sum(line["nodes"]["rows"] for line in atlas.said.values())
    print(f"build: {nodes} nodes, each flown twice, in {took:.2f} s: {nodes / took:.0f}/s (this process: {used:.2f} s)")
    print(f"open: {1e3 * opened:.1f} ms")
    points = np.random.default_rng(1).uniform(atlas.region.low, atlas.region.high, (options.queries, 3))
    asked(atlas, points[:200])
    times, found = asked(atlas, points)
    print(f"query, one by one: {percentiles(times)}; {len(found)} of {len(points)} answered, the others refused")
    begun = time.perf_counter()
    many = atlas.query_many(points)
    print(f"query_many: {len(points) / (time.perf_counter() - begun):.0f}/s, {int(many.good.sum())} answered")
    print(f"largest bound on the error: {np.nanmax(many.error_bound):.1e}")
    alone, worst = list[float](), 0.0
    for i in [i for i in range(len(points)) if i in found][: options.solved]:
        begun = time.perf_counter()
        best = solve(problem.with_given(**dict(zip(atlas.region.names, points[i].tolist(), strict=True))), verify=0)
        alone.append(time.perf_counter() - begun)
        worst = max(worst, abs(best.objective - found[i]) / abs(best.objective))
    if alone:
        ratio = statistics.median(alone) / statistics.median(times)
        print(f"{len(alone)} solved from nothing: largest difference of J {worst:.1e}, {ratio:.0f} times as long each")
    ours, theirs = first_guesses(atlas, points[:200])
    print(f"first guess: median error {np.median(ours):.1e}, the paper's fit {np.median(theirs):.1e}")
    shutil.rmtree(directory.parent)


if __name__ == "__main__":
    main()
