"""What is abused: saved answers, a certificate, an atlas, all small; how a command ends; how bytes are falsified."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import perilune as pl
from perilune.atlas.building import build as building
from perilune.scenario import load_file

ROOT = Path(__file__).parent.parent.parent
EXAMPLES = ROOT / "examples"
HYBRID = EXAMPLES / "hybrid_lander.toml"
REGION = {"vehicle.thrust": (430.0, 450.0), "retro.specific_impulse": (290.0, 310.0)}
VARY = [word for key, unit in zip(REGION, ("N", "s"), strict=True)
        for word in ("--vary", f"{key}={REGION[key][0]:g}:{REGION[key][1]:g} {unit}")]  # fmt: skip
CODES = {0, 2, 3, 4, 5, 130}  # how a command may end
OURS = ("Traceback", "fault of the program")  # what none of them may say
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "MPLBACKEND": "Agg"}


class Fault(Exception):
    """What must not be: a false answer accepted, something lost, someone let in, a traceback."""


class Ended(NamedTuple):
    """How a command ended."""

    code: int
    out: str
    err: str


@dataclass(frozen=True)
class Material:
    """Where things are, and what is right.

    Attributes
    ----------
    own, modelled
        Saved answers: of a problem stated by expressions, and of a scenario.
    atlas
        Directory of an atlas over `REGION`.
    points, objectives
        Places in it, and J there.
    certificate
        Text of the certificate of a theorem; empty without python-flint.
    """

    own: Path
    modelled: Path
    atlas: Path
    points: np.ndarray
    objectives: np.ndarray
    certificate: str


def made(directory: Path) -> Material:
    """Everything, made anew below a directory."""
    hybrid = load_file(HYBRID).problem
    own = pl.solve(_hop())
    pl.save(own, directory / "own")
    pl.save(pl.solve(hybrid), directory / "modelled")
    building.build(hybrid, REGION, directory / "atlas", sample=0)
    low, high = (np.array(side) for side in zip(*REGION.values(), strict=True))
    points = np.random.default_rng(1).uniform(low, high, (20, 2))
    atlas = pl.atlas.open(directory / "atlas")
    try:
        certificate = json.dumps(pl.verify(own, level=5).verification.certificate)
    except pl.PeriluneError:
        certificate = ""
    return Material(directory / "own", directory / "modelled", directory / "atlas", points,
                    atlas.query_many(points).objective, certificate)  # fmt: skip


def _hop() -> pl.Problem:
    """A cart brought to rest with least effort: x'' = u, J the integral of u^2 / 2, exactly 6 over a metre and 1 s."""
    sys.path.insert(0, str(ROOT / "tests"))
    from problems.integrators import least_energy

    return least_energy()


def command(*words: str | Path, limit: float = 120.0, **environment: str) -> Ended:
    """What a command says; a `Fault` where it does not end, ends in another way than it may, or shows a traceback."""
    with started(*words, **environment) as process:
        return finished(process, limit)


def started(*words: str | Path, **environment: str) -> subprocess.Popen[str]:
    """A command, in a session of its own."""
    order = [sys.executable, "-m", "perilune", *map(str, words)]
    return subprocess.Popen(order, env=ENVIRONMENT | environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                            text=True, start_new_session=True)  # fmt: skip


def finished(process: subprocess.Popen[str], limit: float = 120.0) -> Ended:
    """How it ended."""
    try:
        out, err = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        kill(process)
        raise Fault(f"it does not end in {limit:g} s") from None
    demand(process.returncode in CODES, f"exit code {process.returncode}: {err[-300:]}")
    demand(not any(word in err for word in OURS), err[-500:])
    return Ended(process.returncode, out, err)


def kill(process: subprocess.Popen[str]) -> None:
    """SIGKILL to it and all its workers."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def after(rng: np.random.Generator, process: subprocess.Popen[str], seconds: float) -> bool:
    """Kill it at a time drawn; whether it was still at work."""
    time.sleep(rng.uniform(0.0, seconds))
    at_work = process.poll() is None
    kill(process)
    return at_work


def demand(held: bool, told: str) -> None:
    """Go on only if it is so."""
    if not held:
        raise Fault(told)


# -- falsified -------------------------------------------------------------------------------------------------------

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_ODD = (b"nan", b"inf", b"-1e999", b"1e400", b"0", b"-0.0", b"true", b"null", b'"1"', b"[]", b"{}", b"9" * 400,
        b"[" * 5000, b"1e-320", b"\xff\xfe", b"'''", b"../../../etc/passwd", b"\x00", b"=", b"\n[", b"#")  # fmt: skip
_DIGIT = 48


def falsified(rng: np.random.Generator, content: bytes) -> bytes:
    """A content with something else in it, so that it differs."""
    ways = (_flipped, _cut, _doubled, _odd, _other_number, _other_digit)
    while True:
        now = content
        for _ in range(rng.integers(1, 3)):
            now = ways[rng.integers(len(ways))](rng, now)
        if now != content:
            return now


def _flipped(rng: np.random.Generator, content: bytes) -> bytes:
    changed = bytearray(content)
    if changed:
        changed[rng.integers(len(changed))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _piece(rng: np.random.Generator, content: bytes) -> tuple[int, int]:
    begin = int(rng.integers(len(content) + 1))
    return begin, begin + int(np.exp(rng.uniform(0.0, np.log(len(content) + 2))))


def _cut(rng: np.random.Generator, content: bytes) -> bytes:
    begin, end = _piece(rng, content)
    return content[:begin] + (content[end:] if rng.random() < 0.7 else b"")


def _doubled(rng: np.random.Generator, content: bytes) -> bytes:
    begin, end = _piece(rng, content)
    return content[:end] + content[begin:]


def _odd(rng: np.random.Generator, content: bytes) -> bytes:
    begin, end = _number(rng, content)
    return content[:begin] + _ODD[rng.integers(len(_ODD))] + content[end:]


def _other_number(rng: np.random.Generator, content: bytes) -> bytes:
    begin, end = _number(rng, content)
    try:
        value = float(content[begin:end])
    except ValueError:
        return content
    factor = (-1.0, 0.0, 1.0 + 10.0 ** rng.uniform(-12.0, 1.0), 10.0 ** rng.uniform(-6.0, 6.0))[rng.integers(4)]
    return content[:begin] + repr(value * factor).encode() + content[end:]


def _other_digit(rng: np.random.Generator, content: bytes) -> bytes:
    begin, end = _number(rng, content)
    at = int(rng.integers(begin, max(end, begin + 1)))
    return content[:at] + bytes([_DIGIT + int(rng.integers(10))]) + content[at + 1 :]


def _number(rng: np.random.Generator, content: bytes) -> tuple[int, int]:
    """Where one of the numbers stands; anywhere where there is none."""
    found = [match.span() for match in _NUMBER.finditer(content)]
    return found[rng.integers(len(found))] if found else _piece(rng, content)


def replaced(rng: np.random.Generator, directory: Path, names: Sequence[str] = ("*",)) -> str:
    """Falsify one of the files of a directory; its name and where it differs first."""
    files = sorted(path for name in names for path in directory.rglob(name) if path.is_file())
    path = files[rng.integers(len(files))]
    before = path.read_bytes()
    after = falsified(rng, before)
    path.write_bytes(after)
    at = next((i for i, (a, b) in enumerate(zip(before, after, strict=False)) if a != b), min(len(before), len(after)))
    return f"{path.name}, from {at}: {before[at : at + 24]!r} -> {after[at : at + 24]!r}"


def document(text: str) -> Any:
    """The one document that --json prints."""
    try:
        return json.loads(text)
    except ValueError:
        raise Fault(f"no document: {text[:200]}") from None
