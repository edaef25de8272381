"""What a script for one package shares with the others: it states its answer, and its times are taken, in one way.

A script gives `main` a function that sets a task up and returns the one that solves it, which returns the one that
reads the answer. The first two are timed, apart; reading is not. The task is solved from nothing, and then with other
values, again and again. The answer's control is handed over *as the package
defines it between its nodes*: a polynomial on each piece of time, by its values at nodes.
"""

from __future__ import annotations

import importlib
import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from task import OTHERS, TASKS, Task

OTHERS_SOLVED = 9  # times with other values; medians count
BUDGET = 45.0  # seconds that no repetition may be expected to pass, as a script is stopped after 60 s


@dataclass(frozen=True, kw_only=True)
class Piece:
    """The control from `begin` to `end` [s]: the polynomial through `values` at the times `nodes`."""

    begin: float
    end: float
    nodes: list[float]
    values: list[float]


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a package claims: end mass [kg], flight time [s], control; `grid` says on what."""

    mass: float
    time: float
    control: list[Piece]
    grid: str


Read = Callable[[], Answer]
Setup = Callable[[Task], Callable[[], Read]]


def pieces(breaks: Sequence[float], nodes: Sequence[Sequence[float]], values: Sequence[Sequence[float]]) -> list[Piece]:
    """One piece between each two of the breaks."""
    return [
        Piece(begin=float(a), end=float(b), nodes=[float(t) for t in ts], values=[float(u) for u in us])
        for a, b, ts, us in zip(breaks[:-1], breaks[1:], nodes, values, strict=True)
    ]


def chained(time: Sequence[float], value: Sequence[float], degree: int) -> list[Piece]:
    """Pieces of one degree whose ends are nodes shared with the neighbours."""
    starts = range(0, len(time) - 1, degree)
    return pieces(
        np.asarray(time)[::degree].tolist(),
        [time[i : i + degree + 1] for i in starts],
        [value[i : i + degree + 1] for i in starts],
    )


def _version(module: str, package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:  # run from the source tree
        return str(importlib.import_module(module).__version__)


def main(module: str, package: str, setup: Setup) -> None:
    """``python with_package.py TASK FILE``: solve, repeat, and write the answer and the times to the file."""
    name, file = sys.argv[1:3]
    launched = time.perf_counter()
    importlib.import_module(module)
    imported = time.perf_counter() - launched
    read, first = timed(setup, TASKS[name])
    found = read()
    others, other = list[Times](), None
    while len(others) < OTHERS_SOLVED and time.perf_counter() - launched + first.setup + first.solve < BUDGET:
        read, times = timed(setup, OTHERS[name])
        others.append(times)
        other = read()
    result = {
        "version": _version(module, package),
        "imported": imported,
        "first": asdict(first),
        "others": [asdict(times) for times in others],
        "other_mass": other and other.mass,
        **asdict(found),
    }
    Path(file).write_text(json.dumps(result), encoding="utf-8")


@dataclass(frozen=True, kw_only=True)
class Times:
    """Seconds of set-up and of solution, on the clock and of the processor."""

    setup: float
    setup_busy: float
    solve: float
    solve_busy: float


def timed(setup: Setup, task: Task) -> tuple[Read, Times]:
    """Set up and solve: how to read the answer, and the times."""
    clock, busy = [time.perf_counter()], [time.process_time()]

    def passed() -> None:
        clock.append(time.perf_counter())
        busy.append(time.process_time())

    solve = setup(task)
    passed()
    read = solve()
    passed()
    return read, Times(
        setup=clock[1] - clock[0],
        setup_busy=busy[1] - busy[0],
        solve=clock[2] - clock[1],
        solve_busy=busy[2] - busy[1],
    )
