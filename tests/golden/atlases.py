"""Queries of three small atlases, one by one and many at once, as plain records."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import perilune as pl
from golden.answers import EXAMPLES, Record, answer_of
from perilune.scenario import load_file
from problems.constrained import bryson_denham

Region = dict[str, tuple[float, float]]


def _hybrid() -> pl.Problem:
    return load_file(EXAMPLES / "hybrid_lander.toml").problem


def _precision() -> pl.Problem:
    return load_file(EXAMPLES / "precision_landing.toml").problem


def _ceiling() -> pl.Problem:
    return bryson_denham(0.2)


#: What is mapped, over what, how many points are asked, and whether it takes less than three seconds.
MAPS: dict[str, tuple[Callable[[], pl.Problem], Region, int, bool]] = {
    # Across the jump at which a retro burn begins to pay: two sheets, each the best on its side.
    "hybrid": (_hybrid, {"vehicle.thrust": (430.0, 450.0), "retro.specific_impulse": (270.0, 310.0)}, 300, True),
    # A contact comes and goes: half of the answers are searched for from one that breaks the slope; some points
    # cannot be flown.
    "slope": (_precision, {"corridor.slope": (math.radians(20.0), math.radians(32.0))}, 400, False),
    # Free, with a contact point and along the ceiling.
    "ceiling": (_ceiling, {"ceiling": (0.1, 0.45)}, 300, False),
}


def query_records(quick: bool) -> dict[str, Record]:
    """Return the answers of each atlas at points drawn at random, a record for each point and one for the atlas."""
    found: dict[str, Record] = {}
    for name, (make, region, count, cheap) in MAPS.items():
        if cheap or not quick:
            with tempfile.TemporaryDirectory() as folder:
                problem = make()
                pl.atlas.build(problem, region, Path(folder) / name, sample=0)
                found |= _asked(name, problem, Path(folder) / name, count)
    return found


def _asked(name: str, problem: pl.Problem, directory: Path, count: int) -> dict[str, Record]:
    atlas = pl.atlas.open(directory, lambda _: problem)
    axes = atlas.region.names
    points = np.random.default_rng(1).uniform(atlas.region.low, atlas.region.high, (count, len(axes)))
    many = atlas.query_many(points)
    records: dict[str, Record] = {}
    for i, point in enumerate(points.tolist()):
        together = {
            "answered": int(many.answered[i]),
            "objective": float(many.objective[i]),
            "slopes": many.slopes[i].tolist(),
            "free": [float(values[i]) for values in many.free.values()],
        }
        one = _one(atlas, dict(zip(axes, point, strict=True)))
        # What differs between the two is written; what does not once.
        records[f"{name} {i}"] = together | {"alone": {k: v for k, v in one.items() if together.get(k) != v}}
    first = int(np.flatnonzero(many.good)[0])
    records[name] = answer_of(atlas.query(**dict(zip(axes, points[first].tolist(), strict=True))))
    return records


def _one(atlas: Any, values: dict[str, float]) -> Record:
    """Ask one point: J and its slopes, or what is said in their place."""
    try:
        answer = atlas.query(**values)
    except pl.PeriluneError as refusal:
        return {"refused": [type(refusal).__name__, str(refusal)]}
    return {"objective": float(answer.objective), "slopes": list(answer.query.slopes.values())}
