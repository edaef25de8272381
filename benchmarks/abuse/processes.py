"""Builders that are killed, caches that several processes want, disks that are full. Nothing may be lost."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from abused import HYBRID, VARY, Material, after, command, demand, document, falsified, finished, started

_SAME = 1e-9  # relative, of J


def builders(rng: np.random.Generator, material: Material, at: Path) -> str:
    """One to three builders of one directory are killed, some of them together; the last one ends: the same nodes."""
    out, order = at / "atlas", ["atlas", "build", HYBRID, *VARY, "--resume", "--sample", "0", "--out"]
    killed = 0
    for _ in range(rng.integers(1, 4)):
        workers = ["--workers", str(rng.integers(1, 3))]
        beside = [started(*order, out, *workers) for _ in range(rng.integers(1, 3))]
        killed += sum([after(rng, one, 4.0) for one in beside])
    last = [started(*order, out) for _ in range(rng.integers(1, 3))]
    for one in last:
        ended = finished(one)
        demand(ended.code == 0, ended.err[-300:])
    nodes = {path.name: path.read_bytes() for path in material.atlas.glob("*.npy")}
    now = {path.name: path.read_bytes() for path in out.glob("*.npy")}
    demand(now.keys() == nodes.keys(), f"other files: {sorted(now.keys() ^ nodes.keys())}")
    for name, content in nodes.items():
        demand(_alike(content, now[name]), f"other nodes in {name}")
    left = [path.name for path in out.iterdir() if "writing" in path.name]
    demand(not left, f"left behind: {left}")
    return f"{killed} killed"


def _alike(a: bytes, b: bytes) -> bool:
    """Whether two files of an array are the same to 1e-12 relative."""
    if a == b:
        return True
    one, other = (np.load(io.BytesIO(content), allow_pickle=False) for content in (a, b))
    if one.dtype != other.dtype or one.shape != other.shape:
        return False
    pairs = [(one[n], other[n]) for n in one.dtype.names] if one.dtype.names else [(one, other)]
    return all(np.allclose(u, v, rtol=1e-12, atol=0.0, equal_nan=True) for u, v in pairs)


def caches(rng: np.random.Generator, material: Material, at: Path) -> str:
    """Several solves begin with one cache of machine code, empty or damaged; one is killed: the others are right."""
    cache = {"PERILUNE_CACHE": str(at / "cache")}
    way = "empty"
    if rng.random() < 0.5:
        way = "damaged"
        command("solve", HYBRID, "--json", **cache)
        for path in sorted(path for path in (at / "cache").rglob("*") if path.is_file()):
            if rng.random() < 0.5:
                path.write_bytes(falsified(rng, path.read_bytes()))
    beside = [started("solve", HYBRID, "--json", **cache) for _ in range(3)]
    if rng.random() < 0.5:
        after(rng, beside.pop(), 1.5)
        way += ", one killed"
    for one in beside:
        ended = finished(one)
        demand(ended.code == 0, f"{ended.code}: {ended.err[-300:]}")
        demand(_right(document(ended.out), material), "another answer")
    ended = command("solve", HYBRID, "--json", **cache)
    demand(ended.code == 0 and _right(document(ended.out), material), "another answer from what they left")
    return way


def _right(found: dict[str, object], material: Material) -> bool:
    known = json.loads((material.modelled / "solution.json").read_text())
    J, right = (float(d["results"]["landed_mass"]["value"]) for d in (found, known))  # type: ignore[index]
    return abs(J - right) <= _SAME * abs(right)


def disks(rng: np.random.Generator, material: Material, at: Path) -> str:
    """A disk that becomes full: what was written before is whole, and goes on where there is room again."""
    with _disk(at / "disk", int(np.exp(rng.uniform(np.log(4e3), np.log(1.5e6))))) as disk:
        which = rng.integers(3)
        if which == 0:
            ended = command("solve", HYBRID, "--out", disk / "out")
            demand(ended.code in (0, 2), f"{ended.code}: {ended.err[-300:]}")
            _whole(disk / "out", ended.code)
            return f"solve, {ended.code}"
        if which == 1:
            (disk / "out").mkdir()
            if _fits(disk, material.modelled):
                shutil.copytree(material.modelled, disk / "out", dirs_exist_ok=True)
            before = {p.name: p.read_bytes() for p in (disk / "out").iterdir()}
            ended = command("solve", HYBRID, "--out", disk / "out", "--force")
            demand(ended.code in (0, 2), f"{ended.code}: {ended.err[-300:]}")
            if ended.code == 2 and "solution.json" in before:
                there = (disk / "out" / "solution.json").read_bytes()
                demand(there == before["solution.json"] or _proves(disk / "out"), "an earlier answer is lost")
            return f"solve --force, {ended.code}"
        ended = command("atlas", "build", HYBRID, *VARY, "--sample", "0", "--out", disk / "out")
        demand(ended.code in (0, 2), f"{ended.code}: {ended.err[-300:]}")
        if ended.code == 0:
            return "build, 0"
        demand("space" in ended.err or "written" in ended.err, f"what is wrong is not said: {ended.err[-300:]}")
        elsewhere = at / "elsewhere"
        if (disk / "out").exists():
            shutil.copytree(disk / "out", elsewhere)
        ended = command("atlas", "build", HYBRID, *VARY, "--sample", "0", "--resume", "--out", elsewhere)
        demand(ended.code == 0, f"does not go on: {ended.err[-300:]}")
        names = {path.name for path in material.atlas.glob("*.npy")}
        demand({path.name for path in elsewhere.glob("*.npy")} == names, "other files")
        return "build, 2"


def _whole(out: Path, code: int) -> None:
    """What is called done is there; what is not, is not half there under its name."""
    if code == 0 or (out / "solution.json").exists():
        demand(_proves(out), "an answer that cannot be read is left")


def _proves(out: Path) -> bool:
    return command("verify", out).code == 0


def _fits(disk: Path, source: Path) -> bool:
    room = os.statvfs(disk)
    return sum(p.stat().st_size + 4096 for p in source.rglob("*")) < room.f_bavail * room.f_frsize


@contextmanager
def _disk(at: Path, size: int) -> Iterator[Path]:
    """A file system of so many bytes, which takes the right to mount one."""
    at.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(at)], check=True, capture_output=True)
    try:
        yield at
    finally:
        subprocess.run(["umount", "-l", str(at)], check=True, capture_output=True)


def may_mount(at: Path) -> bool:
    """Whether a disk can be made here."""
    try:
        with _disk(at / "trial", 4096):
            return True
    except (subprocess.CalledProcessError, OSError):
        return False
