"""Answers of the library of problems and of the examples, their proofs, theorems and a sweep, as plain records."""

from __future__ import annotations

import contextlib
import hashlib
import io
import runpy
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import perilune as pl
from perilune.scenario import load_file
from problems import LIBRARY
from problems.landings import meditch

Record = dict[str, Any]

EXAMPLES = Path(__file__).parents[2] / "examples"
SCENARIOS = ("*.toml", "maps/*.toml")  # examples/own_kind is a package of its own, which would have to be installed
GRID = {"vehicle.thrust": [440.0, 470.0, 500.0], "vehicle.mass": [290.0, 300.0, 310.0]}
#: More than a second of one core each: left to those who ask for every bit.
SLOW = {
    "Aly's problem, a singular arc to the end",
    "shuttle's cross range",
    "Delta III ascent",
    "examples/capsule_return.toml",
    "examples/minimum_duration_return.toml",
    "examples/maps/capsule.toml",
    "examples/ordinary_lander.toml, a theorem",
}


def _example(path: Path) -> Callable[[], pl.Problem]:
    return lambda: load_file(path).problem


def _own_problem() -> pl.Problem:
    with contextlib.redirect_stdout(io.StringIO()):
        return runpy.run_path(str(EXAMPLES / "own_problem.py"))["problem"]


@lru_cache
def golden_problems() -> dict[str, tuple[Callable[[], pl.Problem], tuple[Any, ...]]]:
    """Return what makes each problem, and the methods that solve it, by name."""
    library = {answered.name: (answered.make, answered.methods) for answered in LIBRARY}
    files = sorted(path for pattern in SCENARIOS for path in EXAMPLES.glob(pattern))
    examples = {f"examples/{path.relative_to(EXAMPLES).as_posix()}": _example(path) for path in files}
    examples["examples/own_problem.py"] = _own_problem
    return library | {name: (make, (pl.Indirect(),)) for name, make in examples.items()}


@lru_cache
def golden_solution(name: str, number: int = 0) -> pl.Solution:
    """Solve a problem by one of its methods, without a proof."""
    make, methods = golden_problems()[name]
    return pl.solve(make(), methods[number], verify=0)


def answer_of(solution: pl.Solution) -> Record:
    """Return J, all parameters and multipliers, both ends of every phase, and a digest of all tables."""
    digest = hashlib.sha256()
    for flown in solution.trajectories:
        for curve in (flown.state, flown.control, *([flown.costate] if flown.costate else [])):
            for array in (curve.time, curve.values, curve.rates):
                digest.update(np.ascontiguousarray(array).tobytes())
    flights, statistics = solution.trajectories, solution.statistics
    return {
        "objective": float(solution.objective),
        "free": {name: float(value) for name, value in solution.free.items()},
        "costate": [t.costate.values[0].tolist() if t.costate else None for t in flights],
        "first": [t.state.values[0].tolist() for t in flights],
        "last": [t.state.values[-1].tolist() for t in flights],
        "multipliers": {name: float(value) for name, value in solution.multipliers.items()},
        "extremals": [[float(one.objective), one.nature.value] for one in solution.extremals],
        "structure": [[arc.phase, arc.description, float(arc.begin), float(arc.end)] for arc in solution.structure],
        "warnings": list(solution.warnings),
        "effort": {
            "initialization": statistics.initialization, "attempts": list(statistics.attempts),
            "iterations": int(statistics.iterations), "arcs": int(statistics.arcs),
            "residual": float(statistics.residual), "nodes": [len(t.time) for t in flights],
            "sha256": digest.hexdigest(),
        },
    }  # fmt: skip


def proof_of(solution: pl.Solution) -> Record:
    """Return the level, and every check with whether it passed, its value and its limit."""
    proof = solution.verification
    return {
        "outcome": solution.outcome.name,
        "level": proof.level,
        "source": proof.source,
        "notes": list(proof.notes),
        "checks": [[check.name, check.level, check.unit, check.passed] for check in proof.checks],
        "effort": [[float(check.value), float(check.limit)] for check in proof.checks],
    }


def answer_records(quick: bool) -> dict[str, Record]:
    """Return the answers of every problem at level 0, by each method that claims it."""
    return {
        f"{name}, {type(method).__name__}": answer_of(golden_solution(name, number))
        for name, (_, methods) in golden_problems().items()
        for number, method in enumerate(methods)
        if not (quick and name in SLOW)
    }


def proof_records(quick: bool) -> dict[str, Record]:
    """Return the proofs at level 3 of the answers of each problem's first method."""
    return {
        name: proof_of(pl.verify(golden_solution(name), level=3))
        for name in golden_problems()
        if not (quick and name in SLOW)
    }  # fmt: skip


def theorem_records(quick: bool) -> dict[str, Record]:
    """Return the sentences and certificates at level 5 of two landings."""
    stated = {"Meditch's lander, a theorem": meditch} | {
        f"examples/{name}, a theorem": _example(EXAMPLES / name) for name in ("ordinary_lander.toml",)
    }
    proved = {name: pl.solve(make(), verify=5) for name, make in stated.items() if not (quick and name in SLOW)}
    return {
        name: {**proof_of(solution), "certificate": solution.verification.certificate}
        for name, solution in proved.items()
    }


def sweep_records(quick: bool) -> dict[str, Record]:
    """Return the members of a family over thrust and mass, each feasible; quick, over the thrust alone."""
    problem = load_file(EXAMPLES / "ordinary_lander.toml").problem
    over = {name: values for name, values in GRID.items() if not quick or name == "vehicle.thrust"}
    family = pl.sweep(problem, over, verify=1)
    members = {"; ".join(f"{value:g}" for value in point.values): point for point in family.points}
    return {
        name if len(over) > 1 else f"{name}; 300": {"outcome": point.outcome.name, "message": point.message}
        | ({} if point.solution is None else answer_of(point.solution))
        for name, point in members.items()
    }  # fmt: skip
