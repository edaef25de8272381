"""Three atlases to begin with, each built in under a minute on two cores.

    python examples/maps/build.py hybrid|precision|capsule DIR

- hybrid: the hybrid lander over thrust, impulsive Isp and perilune, beyond the Isp at which a retro burn begins to pay;
- precision: the precision landing over position and velocity, as guidance asks it on the way down;
- capsule: a capsule's return over the point at which it ignites and its ballistic coefficient.
"""

from __future__ import annotations

import math
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import perilune as pl
from perilune.scenario import load_file

EXAMPLES = Path(__file__).parent.parent
MAPS = {
    "hybrid": (
        EXAMPLES / "hybrid_lander.toml",
        {
            "vehicle.thrust": (350.0, 650.0),
            "retro.specific_impulse": (270.0, 310.0),
            "orbit.perilune_altitude": (10e3, 25e3),
        },
    ),
    "precision": (
        EXAMPLES / "precision_landing.toml",
        {
            "approach.east": (-1940.0, -1660.0),
            "approach.up": (930.0, 1070.0),
            "approach.east_speed": (46.5, 53.5),
            "approach.up_speed": (-33.5, -26.5),
        },
    ),
    "capsule": (
        EXAMPLES / "maps" / "capsule.toml",
        {
            "manoeuvre.longitude": (math.radians(45.5), math.radians(46.5)),
            "manoeuvre.latitude": (math.radians(50.05), math.radians(50.15)),
            "vehicle.ballistic_coefficient": (420.0, 600.0),
        },
    ),
}


def main() -> None:
    """Build one of them."""
    if len(sys.argv) != 3 or sys.argv[1] not in MAPS:
        sys.exit(f"usage: python examples/maps/build.py {'|'.join(MAPS)} DIR")
    scenario, axes = MAPS[sys.argv[1]]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        pl.atlas.build(
            load_file(scenario).problem, axes, sys.argv[2], pool, callback=lambda line: print(line, end="\n")
        )


if __name__ == "__main__":
    main()
