"""What the manifest of an atlas costs as it grows: adding a line, reading all of them, opening, and a brick's claim.

    python benchmarks/atlas_manifest.py [--lines 100000]

The lines are those of bricks of a small atlas, again and again with other numbers; their shards are not there, and are
not looked at.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from pathlib import Path

from perilune.atlas.building.build import build
from perilune.atlas.query.query import open_atlas
from perilune.atlas.store.store import MANIFEST, AtlasStore
from perilune.scenario import load_file

EXAMPLE = Path(__file__).parent.parent / "examples" / "hybrid_lander.toml"
AXES = {"vehicle.thrust": (430.0, 450.0), "retro.specific_impulse": (270.0, 310.0)}
SYNCED = 500  # lines that are added as a builder adds them


def grown(place: Path, count: int) -> float:
    """Write so many lines; the time in which a builder adds one, claims included [s]."""
    lines = [json.loads(line) for line in (place / MANIFEST).read_text().splitlines()]
    brick = next(line for line in lines if line["kind"] == "brick")
    side = int(count**0.5) + 1
    store = AtlasStore(place)
    whole = [{**brick, "name": f"0-{i // side}-{i % side}", "brick": [i // side, i % side]} for i in range(count)]
    store.write_lines([lines[0], *whole[:-SYNCED]])
    begun = time.perf_counter()
    for line in whole[-SYNCED:]:
        with store.claimed(line["name"]) as ours:
            assert ours and not store.there(line["name"])
            store.add(line)
            store.settled(line["name"])
    return (time.perf_counter() - begun) / SYNCED


def main() -> None:
    """Grow, read, open."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--lines", type=int, default=100_000)
    most = parser.parse_args().lines
    directory = Path(tempfile.mkdtemp())
    build(load_file(EXAMPLE).problem, AXES, directory / "atlas", sample=0)
    for count in (most // 100, most // 10, most):
        place = Path(shutil.copytree(directory / "atlas", directory / str(count)))
        each = grown(place, count)
        begun, cpu = time.perf_counter(), time.process_time()
        AtlasStore(place).lines()
        read, read_cpu = time.perf_counter() - begun, time.process_time() - cpu
        begun = time.perf_counter()
        atlas = open_atlas(place)
        opened = time.perf_counter() - begun
        size = (place / MANIFEST).stat().st_size / 2**20
        print(
            f"{count} bricks, {size:.1f} MiB: a line added in {1e3 * each:.2f} ms, all read in {1e3 * read:.0f} ms "
            f"({1e3 * read_cpu:.0f} ms CPU), atlas opened in {1e3 * opened:.0f} ms with {len(atlas.said)} bricks"
        )
    shutil.rmtree(directory)


if __name__ == "__main__":
    main()
