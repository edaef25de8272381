"""Load ``solution.json``. It may come from a stranger, so it is data, checked before it is used.

The problem is built again from the expressions inside, or by a model from the scenario's text or the values of records
where they are there; then both must state the same, and the text's hash must match. Every number is compared in shape
with what that problem needs. What the file *claims* of itself (its outcome, its checks) proves nothing: a solution that
was verified comes back as SOLVED and not proved again, beside what its file claims, for `perilune.proof` to judge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from perilune.core import (
    Outcome,
    PeriluneError,
    bounded_text,
    check_call,
    one_line,
    record_keys,
    record_of_values,
    require_path,
)
from perilune.io.format import (
    FORMAT_NAME,
    FORMAT_VERSION,
    KNOWN_VERSIONS,
    LARGEST_FILE,
    SOLUTION_FILE,
)
from perilune.io.json_checks import (
    MOST_ENTRIES,
    array,
    enumeration_member,
    finite_number,
    part,
    refuse_entry,
    short_text,
    tree,
    valued_numbers,
)
from perilune.io.problem_document import read_problem, unaltered_scenario
from perilune.problem import (
    LEVEL_NAMES,
    Curve,
    Extremal,
    NamedArc,
    Nature,
    Phase,
    Problem,
    Solution,
    Statistics,
    Tolerance,
    Trajectory,
    Verification,
    directions,
    format_failed_checks,
    unit_of,
    with_new_keys,
)

MOST_NODES = 100_000


@check_call
def load(directory: str | Path, problem_from_scenario: Callable[[str], Problem] | None = None) -> Solution:
    """Load a saved solution.

    Parameters
    ----------
    directory
        The directory with ``solution.json``, or the file itself.
    problem_from_scenario
        Makes the problem of a scenario's text; `perilune.scenario.load_text` if None.

    Returns
    -------
    Solution
        Unverified: a file's own claims are told and not taken over; the tolerance that was stated for its proof is, for
        the next. Its problem is that of the scenario or the model where the file has one (the model's own functions and
        checks), else that of the expressions in the file; `problem.source` says which. The extremals that the file
        lists are `unverified_extremals`, for `perilune.verify` to find again; `statistics` are `from_file`. Results are
        computed again from the curves; those in the file, and derived files in the directory, are not evidence and are
        not read.

    Raises
    ------
    PeriluneError
        If the file is missing, too large, not of this format, altered, or does not fit its own problem.
    """
    return load_with_tree(directory, problem_from_scenario)[0]


def load_with_tree(
    directory: str | Path, problem_from_scenario: Callable[[str], Problem] | None = None
) -> tuple[Solution, Mapping[str, Any]]:
    """Load a solution as `load` does, with the tree that the file holds.

    Parameters
    ----------
    directory
        Directory of a saved solution.
    problem_from_scenario
        Makes the problem of a scenario's text; None for `perilune.scenario.load_text`.

    Returns
    -------
    tuple[Solution, Mapping[str, Any]]
        The solution, not proved, and the checked tree of its file.

    Raises
    ------
    PeriluneError
        If the file is missing, damaged, or states two different problems.
    """
    if problem_from_scenario is None:
        from perilune.scenario import load_text as problem_from_scenario
    path = require_path(directory, "the directory of a saved solution")
    document = _solution_tree(path)
    problem = read_problem(document, problem_from_scenario)
    found = read_answer(document, problem, read_trajectories(document, problem))
    return found, document


def claims_of(document: Mapping[str, Any]) -> tuple[str, dict[str, str]]:
    """Return the unverified claims of a file: the text of its scenario, and versions of programs."""
    told = {one_line(str(name)): one_line(str(v)) for name, v in part(document, "versions", dict).items()}
    return "" if document.get("scenario") is None else unaltered_scenario(document), told


def _claimed_verification(document: Mapping[str, Any]) -> str:
    """Return the claim of a file about its own proof; empty for none, as in files of earlier versions."""
    verification = document.get("verification")
    if not isinstance(verification, dict) or "level" not in verification:
        return ""
    level = int(finite_number(verification, "level", "verification"))
    if not 0 <= level < len(LEVEL_NAMES):
        refuse_entry("verification.level", str(level), f"0 to {len(LEVEL_NAMES) - 1}")
    passed = [isinstance(check, dict) and check.get("passed") is True for check in part(verification, "checks", list)]
    return f"level {level}: {LEVEL_NAMES[level]}{format_failed_checks(passed)}" if passed else ""


def read_answer(document: Mapping[str, Any], problem: Problem, trajectories: Sequence[Trajectory]) -> Solution:
    """Read the solution of a problem, unverified, from `perilune.io.save.answer_document`.

    Parameters
    ----------
    document
        Tree of the answer.
    problem, trajectories
        Its problem and curves.
    """
    free = valued_numbers(document, "free")
    if set(free) != set(problem.free_names):
        refuse_entry("free", ", ".join(sorted(free)) or "none", ", ".join(problem.free_names) or "none")
    multipliers = valued_numbers(document, "multipliers")
    conditions = {f"{phase.name}.{condition.name}" for phase in problem.phases for condition in phase.end_conditions}
    for name in multipliers:
        if name not in conditions:
            refuse_entry(f"multipliers.{name}"[:80], "an unknown condition", ", ".join(sorted(conditions)) or "none")
    outcome = enumeration_member(
        Outcome, Outcome.__members__.get(short_text(part(document, "outcome", dict), "name")), "outcome"
    )
    return Solution(
        problem=problem,
        method=short_text(document, "method"),
        outcome=Outcome.SOLVED if outcome in (Outcome.PROVED, Outcome.NOT_PROVED) else outcome,
        objective=finite_number(part(document, "objective", dict), "value", "objective"),
        free=free,
        trajectories=trajectories,
        multipliers=multipliers,
        unverified_extremals=_read_extremals(document, free),
        unknowns=None if document.get("unknowns") is None else array(document["unknowns"], "unknowns", (None,)),
        statistics=_statistics(part(document, "statistics", dict)),
        verification=Verification(
            tolerance=_tolerance(document.get("verification")), claimed=_claimed_verification(document)
        ),
        structure=_read_structure(document),
    )


def _tolerance(said: Any) -> Tolerance:
    """Return the tolerance with which the file was proved. It proves nothing; a new proof says what it needed of it."""
    if not isinstance(said, Mapping) or not said.get("tolerance"):
        return Tolerance()
    values, known = valued_numbers(said, "tolerance"), record_keys(Tolerance)
    for name in values:
        if name not in known:
            refuse_entry(f"tolerance.{name}"[:80], "an unknown quantity", ", ".join(known))
        if (unit := short_text(said["tolerance"][name], "unit")) != unit_of(name):
            refuse_entry(f"tolerance.{name}.unit", unit[:40], unit_of(name))
    return record_of_values(Tolerance, values)


def _solution_tree(path: Path) -> dict[str, Any]:
    """Read the JSON tree of a file of this format; errors as of `load`."""
    expected = f"a directory with {SOLUTION_FILE}, as `perilune.save` and `perilune solve --out` write it"
    if path.suffix.lower() == ".toml" and path.is_file():
        advice = f"perilune solve {path} --out DIR"
        raise PeriluneError("this is a scenario, not a saved solution", got=str(path), expected=expected, advice=advice)
    content = bounded_text(
        path / SOLUTION_FILE if path.is_dir() else path, "saved solution", LARGEST_FILE, expected=expected,
        advice="perilune.save(solution, DIR), or perilune solve FILE --out DIR",
    )  # fmt: skip
    document = tree(content, "saved solution")
    head = document.get("format") if isinstance(document, dict) else None
    if not isinstance(head, dict) or head.get("name") != FORMAT_NAME or head.get("version") not in KNOWN_VERSIONS:
        raise PeriluneError(
            "this is not a saved solution of this program",
            got=f"format {str(head)[:60]}",
            expected=f"{FORMAT_NAME}, version 1 to {FORMAT_VERSION}",
            advice="solve again with --out",
        )
    return document if head["version"] == FORMAT_VERSION else with_new_keys(document, "solution")


def read_trajectories(document: Mapping[str, Any], problem: Problem) -> tuple[Trajectory, ...]:
    """Read the curves of a document.

    Parameters
    ----------
    document
        Tree of a saved solution.
    problem
        Problem that it solves.

    Returns
    -------
    tuple[Trajectory, ...]
        One trajectory for each phase, in SI.

    Raises
    ------
    PeriluneError
        If phases, shapes or durations are not those of the problem.
    """
    free = valued_numbers(document, "free")
    entries = part(document, "phases", list)
    if len(entries) != len(problem.phases):
        refuse_entry("phases", str(len(entries)), str(len(problem.phases)))
    trajectories = []
    for k, (entry, phase) in enumerate(zip(entries, problem.phases, strict=True)):
        where = f"phases[{k}]"
        if not isinstance(entry, dict) or entry.get("name") != phase.name:
            refuse_entry(where, str(entry)[:40], f"the phase {phase.name}")
        n, m = len(phase.states), len(phase.control_names)
        state, control = _read_curve(entry, "state", n, where), _read_curve(entry, "control", m, where)
        costate = None if entry.get("costate") is None else _read_curve(entry, "costate", n, where)
        ends = {float(c.time[-1]) for c in (state, control, costate) if c is not None}
        if len(ends) > 1:
            refuse_entry(where, f"curves that end at {sorted(ends)} s", "one duration")
        _check_directions(phase, control, f"{where}.control")
        # Small differences are for the proof to find; with large ones it would have nothing to compute with.
        duration = free.get(phase.duration)
        if duration is not None and not math.isclose(duration, max(ends), rel_tol=1e-3):
            refuse_entry(f"free.{phase.duration}", f"{duration:g} s", f"{max(ends):g} s, where the curves end")
        trajectories.append(Trajectory(phase=phase.name, state=state, control=control, costate=costate))
    return tuple(trajectories)


def _check_directions(phase: Phase, control: Curve, where: str) -> None:
    """Refuse a control without direction; its optimality is for the proof to check."""
    for first, last in directions(phase.controls):
        if np.linalg.norm(control.values[:, first:last], axis=1).min() < 0.5:
            refuse_entry(where, "a direction of length 0", "directions of length 1")


def _read_curve(entry: Mapping[str, Any], name: str, width: int, where: str) -> Curve:
    tables = part(entry, name, dict)
    where = f"{where}.{name}"
    time = array(tables.get("time"), f"{where}.time", (None,))
    # At a switch a time stands there twice, once for each side.
    ordered = 2 <= len(time) <= MOST_NODES and (np.diff(time) >= 0).all() and (time[2:] > time[:-2]).all()
    if not ordered or time[0] != 0.0:
        expected = f"2 to {MOST_NODES} increasing times from 0; a time may occur twice only at a switch"
        refuse_entry(f"{where}.time", f"{len(time)} nodes", expected)
    shape = (len(time), width)
    return Curve(
        time=time,
        values=array(tables.get("values"), f"{where}.values", shape),
        rates=array(tables.get("rates"), f"{where}.rates", shape),
    )


def _read_extremals(document: Mapping[str, Any], free: Mapping[str, float]) -> tuple[Extremal, ...]:
    entries = part(document, "extremals", list)
    if len(entries) > MOST_ENTRIES or not all(isinstance(e, dict) for e in entries):
        refuse_entry("extremals", f"{len(entries)} entries", f"at most {MOST_ENTRIES} records")
    found = tuple(
        Extremal(
            free={str(k): finite_number(e["free"], k, "extremals.free") for k in part(e, "free", dict)},
            objective=finite_number(e, "objective", "extremals"),
            nature=_read_nature(short_text(e, "nature")),
            unknowns=tuple(array(e.get("unknowns", []), "extremals.unknowns", (None,)).tolist()),
        )
        for e in entries
    )
    own = (finite_number(part(document, "objective", dict), "value", "objective"), *free.values())
    if found and not np.allclose([found[0].objective, *(found[0].free.get(k, math.nan) for k in free)], own, rtol=1e-6):
        refuse_entry("extremals", "a first extremal that is not this solution", "this solution first")
    return found


def _read_nature(word: str) -> Nature:
    try:
        return Nature(word)
    except ValueError:
        return enumeration_member(Nature, None, "extremals.nature")


def _read_structure(document: Mapping[str, Any]) -> tuple[NamedArc, ...]:
    """Read the named arcs; empty for files of earlier versions."""
    entries = part(document, "structure", list) if "structure" in document else []
    if len(entries) > MOST_ENTRIES or not all(isinstance(e, dict) for e in entries):
        refuse_entry("structure", f"{len(entries)} entries", f"at most {MOST_ENTRIES} records")
    return tuple(
        NamedArc(
            phase=short_text(e, "phase")[:200],
            begin=finite_number(e, "begin", "structure"),
            end=finite_number(e, "end", "structure"),
            description=short_text(e, "description")[:200],
        )
        for e in entries
    )


def _statistics(entry: Mapping[str, Any]) -> Statistics:
    def count(name: str) -> int:
        return int(finite_number(entry, name, "statistics"))

    def known(name: str) -> float:
        return math.nan if entry.get(name) is None else finite_number(entry, name, "statistics")

    return Statistics(
        initialization=short_text(entry, "initialization"),
        attempts=tuple(str(attempt)[:200] for attempt in part(entry, "attempts", list)[:MOST_ENTRIES]),
        iterations=count("iterations"),
        arcs=count("arcs"),
        residual=known("residual"),
        wall_time=known("wall_time"),
        from_file=True,
    )
