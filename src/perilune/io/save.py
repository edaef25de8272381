"""Save a solution as documents: a short one for programs (``--json``), the whole one to load again, the table.

``solution.json`` explains itself: it names its format and version, describes every field, gives every unit,
and carries the scenario it came from with its hash, the program versions, costates, multipliers, and the
control *with the rule by which it is interpolated*, so that another program can fly exactly what was proved.
`perilune.io.load` reads it.
"""

from __future__ import annotations

import csv
import io
import math
import platform
import sys
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from perilune import __version__ as perilune_version
from perilune.core import PeriluneError, check_call, require_type, wrong_type_error
from perilune.io.atomic_files import finite, fresh_directory, json_text, refuse_unwritten, write_each
from perilune.io.columns import per_unit, phase_columns, round_degrees
from perilune.io.format import FORMAT_NAME, FORMAT_VERSION, SOLUTION_FILE
from perilune.io.problem_document import stated_problem_document
from perilune.problem import (
    Check,
    Curve,
    Phase,
    ScalarControl,
    Solution,
    Trajectory,
    UnitVectorControl,
    Verification,
    results_between,
    unit_of,
)

INTERPOLATION = {
    "state": "cubic Hermite",
    "costate": "cubic Hermite",
    **{f"control of kind {control.kind}": control.rule for control in (UnitVectorControl, ScalarControl)},
}

_FIELDS = {
    "scenario": "the scenario of this solution, verbatim, and the SHA-256 of its UTF-8 text; or null",
    "model": "the model of the problem and the values of its records, if there is no scenario; or null",
    "problem": "the problem without its given values; defaults (no bound, no title) are left out",
    "problem.functions": "physics as operations in order: [record, component], [const, number] or [operation, "
    "operand, ...], an operand being the index of an earlier entry, as the outputs are",
    "problem.digest": "SHA-256 of the problem without its numbers: equal physics has the same",
    "given": "parameters with their values, all in SI (angles in radians)",
    "free": "parameters chosen by the optimiser, including durations of phases, in SI",
    "objective": "minimised objective J at the solution",
    "multipliers": "nu of each end condition, by phase.condition; lambda(t_f) = dphi/dx + nu.dpsi/dx",
    "phases": "in order of flight; the time of each starts at 0, in seconds",
    "phases.state": "time (n), values (n, states) in their units, rates (n, states) per second",
    "phases.costate": "lambda = dJ*/dx, same layout; H = lambda.f, minimised; lambda' = -dH/dx; null if none",
    "phases.control": "same layout; names and kinds of the components in `controls`",
    "phases.interpolation": "the rule for values between nodes; to normalise is to divide by the length",
    "results": "quantities that the problem requests of its solution, in SI",
    "extremals": "every extremal found, best first; the first is this solution. Only a claim: `perilune verify`"
    " recomputes each from its unknowns",
    "structure": "arcs of the solution in words, each with its phase and times [s]; empty if they were not detected",
    "verification": "checks made; passed if value <= limit. Only a claim: `perilune verify` repeats them",
    "verification.tolerance": "stated tolerance of the proof, {} for none; `perilune verify` uses it too. A limit"
    " that it raised is accompanied by `own_limit` and `raised_by`",
    "verification.tolerance_used": "the part of it that the level needed, in words; empty if none",
    "unknowns": "the unknowns of the method, from which it can restart",
    "null": "stands for an unknown or infinite number",
}  # fmt: skip


def results_document(solution: Solution) -> dict[str, dict[str, Any]]:
    """Return the results of a solution, each ``{"value": float, "unit": str, "description": str}``, SI."""
    return {name: asdict(result) for name, result in solution.results.items()}


def solution_document(solution: Solution) -> dict[str, Any]:
    """Make the document that ``perilune solve --json`` prints; a number that is not finite becomes None.

    For a loaded solution ``unverified_claims`` names the unverified claims of its file.
    """
    statistics = solution.statistics
    claims = (
        {"unverified_claims": ["method", "statistics", *_structure_document(solution)]} if statistics.from_file else {}
    )
    inputs = {"inputs": list(solution.problem.inputs_read)} if solution.problem.inputs_read else {}
    document = {
        "problem": solution.problem.name,
        "title": solution.problem.title,
        **inputs,
        "method": solution.method,
        "outcome": solution.outcome.name,
        "tolerance_used": solution.verification.tolerance_used,
        "results": results_document(solution),
        "extremals": extremals_document(solution),
        "warnings": list(solution.warnings),
        "verification": _verification_document(solution.verification),
        "statistics": {
            "initialization": statistics.initialization,
            "attempts": list(statistics.attempts),
            "iterations": int(statistics.iterations),
            "arcs": int(statistics.arcs),
            "residual": float(statistics.residual),
            "wall_time": float(statistics.wall_time),
        },
    }
    return finite(document | _structure_document(solution) | claims)


def _structure_document(solution: Solution) -> dict[str, Any]:
    """Return the entry of the named arcs; empty if they were not determined."""
    return {"structure": [asdict(arc) for arc in solution.structure]} if solution.structure else {}


def _verification_document(verification: Verification) -> dict[str, Any]:
    stated = verification.tolerance.stated
    return {
        "level": verification.level,
        "tolerance_used": verification.tolerance_used,
        "source": verification.source,
        "notes": list(verification.notes),
        "tolerance": _values_with_units(stated, {name: unit_of(name) for name in stated}),
        "checks": [_check_document(check) for check in verification.checks],
    }


def _check_document(check: Check) -> dict[str, Any]:
    raised = {} if check.own_limit is None else {"own_limit": float(check.own_limit), "raised_by": check.raised_by}
    return {
        "name": check.name,
        "level": check.level,
        "value": float(check.value),
        "limit": float(check.limit),
        **raised,
        "unit": check.unit,
        "passed": check.passed,
        "meaning": check.meaning,
    }


def extremals_document(solution: Solution) -> list[dict[str, Any]]:
    """List the extremals, best first: results that the parameters decide, the objective, the nature.

    A result that equals J up to a constant or the sign is given in place of J.
    """
    problem = solution.problem
    first, last = ([math.nan] * len(problem.phases[k].states) for k in (0, -1))
    rows = []
    for extremal in solution.extremals:
        found = results_between(problem, first, last, problem.parameters({**solution.free, **extremal.free}))
        known: dict[str, Any] = {name: r.value for name, r in found.items() if math.isfinite(r.value)}
        best = {problem.maximised: -extremal.objective} if problem.maximised else {"objective": extremal.objective}
        if problem.minimised:  # J is this result but for a constant, which the solution tells
            here = solution.results[problem.minimised].value - solution.objective
            best = {problem.minimised: here + extremal.objective}
        rows.append({**known, **{k: float(v) for k, v in best.items()}, "nature": extremal.nature.value})
    return rows


@check_call
def save(solution: Solution, directory: str | Path, scenario_text: str | None = None, *, force: bool = False) -> None:
    """Write ``solution.json``, from which `perilune.load` makes the solution again, and the trajectory as CSV.

    The problem may be stated in any way: its formulas are written as expressions, so that it can be proved again
    without the code that stated it. One of a scenario is stated from its text again: where the kind comes from another
    package, with that package installed.

    Parameters
    ----------
    solution
        What to write.
    directory
        Where; see `perilune.io.atomic_files.fresh_directory`.
    scenario_text
        The scenario that `solution.problem` was made of, with every change made to it; None for a problem in Python.
    force
        Whether what an earlier run wrote there may be replaced.

    Raises
    ------
    NotWrittenError
        If a table cannot be written; ``solution.json`` and the other tables are there then.
    PeriluneError
        If the directory cannot be written, or is not empty and `force` is false.
    """
    require_type(solution, Solution, "a solution to save")
    if not isinstance(scenario_text, str | None):
        raise wrong_type_error(scenario_text, "a text, or None for a problem in Python", "the text of a scenario")
    with fresh_directory(directory, force) as work:
        failed = write_solution_files(solution, work, scenario_text)
    refuse_unwritten(failed)


def write_solution_files(solution: Solution, directory: Path, scenario_text: str | None) -> list[PeriluneError]:
    """Write the files of `save` into a directory that exists; return the errors of tables that failed.

    Parameters
    ----------
    solution, directory
        The solution, and where to write.
    scenario_text
        Text of its scenario, if it has one.
    """
    (directory / SOLUTION_FILE).write_text(json_text(whole_document(solution, scenario_text)), encoding="utf-8")

    def table(path: Path, k: int) -> None:
        path.write_text(trajectory_csv(solution, k), encoding="utf-8", newline="")

    tables = {trajectory_name(solution, k): partial(table, k=k) for k in range(len(solution.trajectories))}
    return write_each(directory, tables)


def solution_files(solution: Solution) -> list[str]:
    """Return the names of the files that `write_solution_files` writes."""
    return [SOLUTION_FILE, *(trajectory_name(solution, k) for k in range(len(solution.trajectories)))]


def trajectory_name(solution: Solution, k: int) -> str:
    """Return the file name of the table of phase k.

    Parameters
    ----------
    solution
        Solution to save.
    k
        Number of the phase, from 0.
    """
    names = solution.problem.phases
    return "trajectory.csv" if len(names) == 1 else f"trajectory_{k + 1}_{names[k].name}.csv"


def whole_document(solution: Solution, scenario_text: str | None = None) -> dict[str, Any]:
    """Return the whole solution as the tree that ``solution.json`` holds.

    Parameters
    ----------
    solution
        Solution to save.
    scenario_text
        Text of the scenario that states its problem; None without one.
    """
    return {
        "format": {"name": FORMAT_NAME, "version": FORMAT_VERSION, "units": "SI, radians", "fields": _FIELDS},
        "versions": program_versions(),
        **stated_problem_document(solution.problem, scenario_text),
        **answer_document(solution),
        "phases": phases_document(solution),
    }


def answer_document(solution: Solution) -> dict[str, Any]:
    """Return the tree of a solution without its problem and its curves."""
    problem, short = solution.problem, solution_document(solution)
    return {
        "method": solution.method,
        "outcome": {
            "name": solution.outcome.name,
            "tolerance_used": short["tolerance_used"],
            "advice": solution.outcome.value,
        },
        "objective": {"value": float(solution.objective), "unit": problem.objective_unit},
        "free": _values_with_units(solution.free, {f.name: f.unit for f in problem.free}),
        "results": short["results"],
        "multipliers": _values_with_units(solution.multipliers, _multiplier_units(solution)),
        "extremals": [
            {
                "free": dict(e.free),
                "objective": float(e.objective),
                "nature": e.nature.value,
                "unknowns": list(e.unknowns),
            }
            for e in solution.extremals
        ],
        "statistics": short["statistics"],
        "verification": short["verification"],
        "structure": [asdict(arc) for arc in solution.structure],
        "unknowns": None if solution.unknowns is None else [float(v) for v in solution.unknowns],
    }


def phases_document(solution: Solution) -> list[dict[str, Any]]:
    """Return the curves of each phase, with the names and units of their components."""
    problem = solution.problem
    return [
        _trajectory_document(phase, trajectory, problem.objective_unit)
        for phase, trajectory in zip(problem.phases, solution.trajectories, strict=True)
    ]


def trajectory_csv(solution: Solution, k: int = 0) -> str:
    """Return phase k as comma-separated values at the state's nodes; units in the header, angles in degrees.

    Parameters
    ----------
    solution
        Solution to save.
    k
        Number of the phase, from 0.
    """
    table = phase_columns(solution, k)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([column.heading for column in table.values()])
    units = [column.unit for column in table.values()]
    for row in zip(*(column.values for column in table.values()), strict=True):
        cells = zip(row, units, strict=True)
        writer.writerow([repr(round_degrees(value, unit)) if math.isfinite(value) else "" for value, unit in cells])
    return text.getvalue()


def program_versions() -> dict[str, str]:
    """Return the versions of this program and of the packages that it computes with."""
    found = {"perilune": perilune_version, "python": platform.python_version()}
    for package in ("numpy", "scipy", "casadi", "llvmlite"):
        loaded = sys.modules.get(package)  # to ask the package index takes longer than to write the document
        found[package] = getattr(loaded, "__version__", "") or _installed(package)
    return found


def _installed(package: str) -> str:
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed as a package"


def _trajectory_document(phase: Phase, trajectory: Trajectory, objective_unit: str) -> dict[str, Any]:
    return {
        "name": phase.name,
        "duration": {"value": trajectory.duration, "unit": "s"},
        "states": [{"name": s.name, "unit": s.unit, "description": s.description} for s in phase.states],
        "costate_units": [per_unit(objective_unit, s.unit) for s in phase.states],
        "controls": [{"components": list(c.names), "kind": c.kind, "unit": c.unit} for c in phase.controls],
        "interpolation": INTERPOLATION,
        "state": _curve_document(trajectory.state),
        "control": _curve_document(trajectory.control),
        "costate": None if trajectory.costate is None else _curve_document(trajectory.costate),
    }


def _curve_document(curve: Curve) -> dict[str, Any]:
    return {"time": curve.time.tolist(), "values": curve.values.tolist(), "rates": curve.rates.tolist()}


def _multiplier_units(solution: Solution) -> dict[str, str]:
    per = solution.problem.objective_unit
    return {
        f"{phase.name}.{condition.name}": per_unit(per, condition.unit)
        for phase in solution.problem.phases
        for condition in phase.end_conditions
    }


def _values_with_units(values: Mapping[str, float], units: Mapping[str, str]) -> dict[str, Any]:
    return {name: {"value": float(value), "unit": units.get(name, "")} for name, value in values.items()}
