"""Forty-odd command lines: exit code, what stands on stdout, and the files that are written."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from golden.answers import EXAMPLES, Record
from perilune.cli import run_command_line

#: Clocks and versions, by key; in texts, by the words about them.
PASSING = {"wall_time", "processor_time", "latency", "versions"}
_CLOCKS = re.compile(
    r"(?<=iterations; )[\d.]+(?= s)|(?<=answered from the atlas in )[\d.]+(?= ms)|(?<=CREATION_DATE = )\S+"
)

#: Quick ones, in order: some read what an earlier one wrote.
QUICK = (
    "check examples/hybrid_lander.toml --json",
    "check examples/ordinary_lander.toml",
    "check examples/precision_landing.toml --json",
    "check examples/polar_descent.toml --json",
    "check examples/mars_pinpoint.toml --json",
    "check examples/capsule_return.toml --json",
    "check examples/minimum_duration_return.toml --json",
    "check examples/maps/capsule.toml --json",
    "new hybrid_landing",
    "new deorbit_entry new.toml --json",
    "solve nowhere.toml --json",
    "solve examples/hybrid_lander.toml --level 9 --json",
    "solve examples/hybrid_lander.toml --method simplex --json",
    "solve examples/hybrid_lander.toml --set vehicle.thurst=500_N --json",
    "solve examples/hybrid_lander.toml --set vehicle.thrust=500_kg --json",
    "solve examples/hybrid_lander.toml --set vehicle.mass=-300_kg --json",
    "solve examples/ordinary_lander.toml --set vehicle.thrust=10_N --set vehicle.dry_mass=30_kg --json",
    "sweep examples/ordinary_lander.toml --vary vehicle.thrust=440:400:10_N --json",
    "verify nowhere --json",
    "slove examples/hybrid_lander.toml --json",
    "solve examples/ordinary_lander.toml",
    "solve examples/hybrid_lander.toml --json --level 1 --out flight",
    "verify flight --json --level 2",
    "export flight --out flight.csv --json",
    "export flight --out flight.oem --epoch 2030-01-01T00:00:00 --json",
    "export flight --out flight.czml --epoch 2030-01-01T00:00:00",
    "export flight --out flight.oem --json",
)
SLOW = (
    "solve examples/hybrid_lander.toml --level 4 --json",
    "solve examples/precision_landing.toml --json --out precision",
    "verify precision",
    "solve examples/polar_descent.toml --level 0",
    "solve examples/polar_descent.toml --method direct --level 2 --json",
    "solve examples/mars_pinpoint.toml --level 3 --verbose",
    "solve examples/mars_pinpoint.toml --set vehicle.mass=1901.19_kg --json",
    "solve examples/hybrid_lander.toml --method direct --no-polish --nodes 6 --json",
    "solve examples/hybrid_lander.toml --method hybrid --seed 1 --level 1 --json",
    "solve examples/maps/capsule.toml --level 2 --json --out capsule",
    "verify capsule --json --level 1",
    "solve examples/minimum_duration_return.toml --level 1 --json",
    "opportunities examples/capsule_return.toml --json",
    "sweep examples/ordinary_lander.toml --vary vehicle.thrust=440,470,500_N --vary vehicle.mass=290,300,310_kg"
    " --json --out family",
    "sweep examples/ordinary_lander.toml --vary vehicle.thrust=440:500:30_N",
    "atlas build examples/hybrid_lander.toml --vary vehicle.thrust=430:450_N --out map --json",
    "atlas info map --json",
    "atlas query map --at vehicle.thrust=441.5_N --json",
    "atlas query map --at vehicle.thrust=441.5_N",
    "atlas query map --at vehicle.thrust=460_N --json",
    "atlas verify map --json",
    "atlas export map --out nodes.nc --json",
    "atlas plot map --out slice --json",
    "explore examples/ordinary_lander.toml --html page.html --json",
)  # fmt: skip
_TEXTS = {".json", ".csv", ".oem", ".czml", ".md", ".toml"}  # of which every letter counts


def command_records(quick: bool) -> dict[str, Record]:
    """Return what each command line says, run one after the other in a folder with the examples."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        shutil.copytree(EXAMPLES, "examples")
        return {f"perilune {line}": _said(line) for line in (QUICK if quick else QUICK + SLOW)}


def _said(line: str) -> Record:
    """Run one command line; underscores stand for the blanks between a number and its unit."""
    words = [re.sub(r"(?<=[\d])_(?=\w+$)", " ", word) for word in line.split()]
    before, out = set(_written()), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        code = run_command_line(words)
    record: Record = {"exit": code}
    if "--json" in words:
        record["document"] = without_clocks(json.loads(out.getvalue()))
    else:
        record["text"] = [_clock_masked(text) for text in out.getvalue().splitlines()]
    if new := {str(path): _digest(path) for path in sorted(set(_written()) - before)}:
        record |= {"written": list(new), "files": new}
    return record


def without_clocks(document: Any) -> Any:
    """Return a document without what no two runs share: clocks, versions."""
    if isinstance(document, dict):
        return {key: without_clocks(value) for key, value in document.items() if key not in PASSING}
    if isinstance(document, list):
        return [without_clocks(value) for value in document]
    return _clock_masked(document) if isinstance(document, str) else document


def _clock_masked(text: str) -> str:
    return _CLOCKS.sub("TIME", text)


def _written() -> Iterator[Path]:
    return (Path(folder, name) for folder, _, names in os.walk(".") for name in names)


def _digest(path: Path) -> str:
    """Return the SHA-256 of a text without clocks; nothing of pictures and binary files, which hold more of them."""
    if path.suffix not in _TEXTS:
        return ""
    text = path.read_text(encoding="utf-8")
    with contextlib.suppress(ValueError):
        text = json.dumps(without_clocks(json.loads(text)))
    return hashlib.sha256(_clock_masked(text).encode()).hexdigest()
