"""Reading ``solution.json`` back. It may come from a stranger, so it is data, checked before it is used.

The problem is built anew from the scenario text inside, whose hash must match, and every number is compared
in shape with what that problem needs. What the file *claims* of itself (its outcome, its checks) proves
nothing: a solution that was verified comes back as SOLVED and unverified, for `perilune.proof` to judge.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from perilune.problem.controls import directions
from perilune.problem.problem import Phase, Problem
from perilune.problem.solution import Curve, Extremal, Nature, Solution, Statistics, Trajectory
from perilune.words.outcome import Outcome, PeriluneError

FORMAT_NAME, FORMAT_VERSION, SOLUTION_FILE = "perilune-solution", 1, "solution.json"
LARGEST_FILE = 64 * 2**20  # bytes; the largest trajectory (6401 nodes, 10 states) takes about 8 MB
MOST_NODES = 100_000
MOST_ENTRIES = 1000  # extremals, unknowns


def hash_of(scenario_text: str) -> str:
    """SHA-256 of the text in UTF-8, hexadecimal."""
    return hashlib.sha256(scenario_text.encode("utf-8")).hexdigest()


def read_solution(directory: str | Path, problem_from_scenario: Callable[[str], Problem] | None = None) -> Solution:
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
        Unverified: a file's own claims are not taken over.

    Raises
    ------
    PeriluneError
        If the file is missing, too large, not of this format, altered, or does not fit its own scenario.
    """
    document = _document(Path(directory))
    text = _scenario_text(document)
    if problem_from_scenario is None:
        from perilune.scenario import load_text as problem_from_scenario
    problem = problem_from_scenario(text)
    _check_given(document, problem)
    free = _numbers(document, "free")
    if set(free) != set(problem.free_names):
        _refuse("free", ", ".join(sorted(free)) or "none", ", ".join(problem.free_names) or "none")
    outcome = _member(Outcome, Outcome.__members__.get(_text(_part(document, "outcome", dict), "name")), "outcome")
    return Solution(
        problem=problem,
        method=_text(document, "method"),
        outcome=Outcome.SOLVED if outcome in (Outcome.PROVED, Outcome.NOT_PROVED) else outcome,
        objective=_number(_part(document, "objective", dict), "value", "objective"),
        free=free,
        trajectories=_trajectories(document, problem, free),
        multipliers=_numbers(document, "multipliers"),
        extremals=_extremals(document, free),
        unknowns=None if document.get("unknowns") is None else _array(document["unknowns"], "unknowns", (None,)),
        statistics=_statistics(_part(document, "statistics", dict)),
    )


def _document(path: Path) -> dict[str, Any]:
    """Read the JSON tree of a file of this format."""
    path = path / SOLUTION_FILE if path.is_dir() else path
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
    except OSError as error:
        raise PeriluneError(
            "there is no saved solution here",
            got=f"{path}: {error.strerror}",
            expected=f"a directory with {SOLUTION_FILE}, as `perilune solve --out` writes it",
            advice="perilune solve FILE --out DIR",
        ) from error
    if len(raw) > LARGEST_FILE:
        raise PeriluneError(
            "the saved solution is too large",
            got=f"more than {LARGEST_FILE} bytes",
            expected="a few megabytes",
            advice="solve again with --out",
        )
    try:
        document = json.loads(raw.decode("utf-8"), parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        if isinstance(error, PeriluneError):
            raise
        raise PeriluneError(
            "the saved solution is not readable JSON",
            got=str(error)[:120],
            expected=f"{SOLUTION_FILE} as `perilune solve --out` writes it, whole",
            advice="solve again with --out",
        ) from error
    head = document.get("format") if isinstance(document, dict) else None
    if not isinstance(head, dict) or head.get("name") != FORMAT_NAME or head.get("version") != FORMAT_VERSION:
        raise PeriluneError(
            "this is not a saved solution of this program",
            got=f"format {str(head)[:60]}",
            expected=f"{FORMAT_NAME}, version {FORMAT_VERSION}",
            advice="solve again with --out",
        )
    return document


def _scenario_text(document: Mapping[str, Any]) -> str:
    scenario = _part(document, "scenario", dict)
    text = _text(scenario, "text")
    found = hash_of(text)
    if found != scenario.get("sha256"):
        raise PeriluneError(
            "the scenario in the saved solution was altered",
            got=f"text with SHA-256 {found[:16]}…",
            expected=f"{str(scenario.get('sha256'))[:16]}…",
            advice="solve the altered scenario anew",
        )
    return text


def _check_given(document: Mapping[str, Any], problem: Problem) -> None:
    """Refuse a file whose parameters are not those its scenario gives."""
    saved = _numbers(document, "given")
    for name, given in problem.given.items():
        if name not in saved or not math.isclose(saved[name], given.value, rel_tol=1e-12, abs_tol=0.0):
            _refuse(f"given.{name}", str(saved.get(name, "none")), f"{given.value!r}, as the scenario says")
    if extra := set(saved) - set(problem.given):
        _refuse("given", ", ".join(sorted(extra)), "only parameters that the scenario gives")


def _trajectories(document: Mapping[str, Any], problem: Problem, free: Mapping[str, float]) -> tuple[Trajectory, ...]:
    entries = _part(document, "phases", list)
    if len(entries) != len(problem.phases):
        _refuse("phases", str(len(entries)), str(len(problem.phases)))
    trajectories = []
    for k, (entry, phase) in enumerate(zip(entries, problem.phases, strict=True)):
        where = f"phases[{k}]"
        if not isinstance(entry, dict) or entry.get("name") != phase.name:
            _refuse(where, str(entry)[:40], f"the phase {phase.name}")
        n, m = len(phase.states), len(phase.control_names)
        state, control = _curve(entry, "state", n, where), _curve(entry, "control", m, where)
        costate = None if entry.get("costate") is None else _curve(entry, "costate", n, where)
        ends = {float(c.time[-1]) for c in (state, control, costate) if c is not None}
        if len(ends) > 1:
            _refuse(where, f"curves that end at {sorted(ends)} s", "one duration")
        _check_directions(phase, control, f"{where}.control")
        # Small differences are for the proof to find; with large ones it would have nothing to compute with.
        duration = free.get(phase.duration)
        if duration is not None and not math.isclose(duration, max(ends), rel_tol=1e-3):
            _refuse(f"free.{phase.duration}", f"{duration:g} s", f"{max(ends):g} s, where the curves end")
        trajectories.append(Trajectory(phase=phase.name, state=state, control=control, costate=costate))
    return tuple(trajectories)


def _check_directions(phase: Phase, control: Curve, where: str) -> None:
    """Refuse a control that points nowhere; whether it points where it should is for the proof to find."""
    for first, last in directions(phase.controls):
        if np.linalg.norm(control.values[:, first:last], axis=1).min() < 0.5:
            _refuse(where, "a direction of length 0", "directions of length 1")


def _curve(entry: Mapping[str, Any], name: str, width: int, where: str) -> Curve:
    tables = _part(entry, name, dict)
    where = f"{where}.{name}"
    time = _array(tables.get("time"), f"{where}.time", (None,))
    # At a switch a time stands there twice, once for each side.
    ordered = 2 <= len(time) <= MOST_NODES and (np.diff(time) >= 0).all() and (time[2:] > time[:-2]).all()
    if not ordered or time[0] != 0.0:
        expected = f"2 to {MOST_NODES} increasing times that begin at 0, the same twice at a switch only"
        _refuse(f"{where}.time", f"{len(time)} nodes", expected)
    shape = (len(time), width)
    return Curve(
        time=time,
        values=_array(tables.get("values"), f"{where}.values", shape),
        rates=_array(tables.get("rates"), f"{where}.rates", shape),
    )


def _extremals(document: Mapping[str, Any], free: Mapping[str, float]) -> tuple[Extremal, ...]:
    entries = _part(document, "extremals", list)
    if len(entries) > MOST_ENTRIES or not all(isinstance(e, dict) for e in entries):
        _refuse("extremals", f"{len(entries)} entries", f"at most {MOST_ENTRIES} records")
    found = tuple(
        Extremal(
            free={str(k): _number(e["free"], k, "extremals.free") for k in _part(e, "free", dict)},
            objective=_number(e, "objective", "extremals"),
            nature=_nature(_text(e, "nature")),
        )
        for e in entries
    )
    own = (_number(_part(document, "objective", dict), "value", "objective"), *free.values())
    if found and not np.allclose([found[0].objective, *(found[0].free.get(k, math.nan) for k in free)], own, rtol=1e-6):
        _refuse("extremals", "a first one that is not this solution", "this solution first")
    return found


def _nature(text: str) -> Nature:
    try:
        return Nature(text)
    except ValueError:
        return _member(Nature, None, "extremals.nature")


def _statistics(entry: Mapping[str, Any]) -> Statistics:
    def count(name: str) -> int:
        return int(_number(entry, name, "statistics"))

    def known(name: str) -> float:
        return math.nan if entry.get(name) is None else _number(entry, name, "statistics")

    tried = _part(entry, "tried", list)
    return Statistics(
        rung=_text(entry, "rung"),
        tried=tuple(str(rung)[:200] for rung in tried[:MOST_ENTRIES]),
        iterations=count("iterations"),
        arcs=count("arcs"),
        residual=known("residual"),
        wall_time=known("wall_time"),
        claimed=True,
    )


def _array(value: Any, where: str, shape: tuple[int | None, ...]) -> Any:
    """Array of finite numbers of a shape (None: any length); text and booleans are not numbers."""
    try:
        array = np.asarray(value)
    except ValueError:
        _refuse(where, "rows of unequal length", "a full table of numbers")
    wanted = " x ".join("any" if n is None else str(n) for n in shape)
    fits = array.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if (array.size and array.dtype.kind not in "if") or not fits:
        _refuse(where, f"{array.dtype.kind}-type table of shape {array.shape}", f"numbers, {wanted}")
    array = array.astype(float)
    if not np.isfinite(array).all():
        _refuse(where, "numbers that are not finite", "finite numbers")
    return array


def _number(entry: Mapping[str, Any], name: str, where: str) -> float:
    value = entry.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        _refuse(f"{where}.{name}", str(value)[:40], "a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        _refuse(f"{where}.{name}", str(value)[:40], "a finite number")
    return number


def _numbers(document: Mapping[str, Any], name: str) -> dict[str, float]:
    entries = _part(document, name, dict)
    return {key: _number(_part(entries, key, dict), "value", f"{name}.{key}") for key in entries}


def _text(entry: Mapping[str, Any], name: str) -> str:
    return _part(entry, name, str)


def _part(entry: Mapping[str, Any], name: str, kind: type) -> Any:
    value = entry.get(name)
    if not isinstance(value, kind):
        _refuse(name, str(value)[:40], {dict: "a record", list: "a list", str: "a text"}[kind])
    return value


def _member(kind: type, member: Any, where: str) -> Any:
    if member is None:
        _refuse(where, "an unknown word", "one of " + ", ".join(str(m.name) for m in kind))  # type: ignore[attr-defined]
    return member


def _refuse(where: str, got: str, expected: str) -> NoReturn:
    raise PeriluneError(
        f"the saved solution does not fit its own scenario: {where}",
        got=got,
        expected=expected,
        advice="solve again with --out; files are not meant to be edited",
    )


def _no_constant(name: str) -> NoReturn:
    raise PeriluneError(
        "the saved solution holds a number that is not finite",
        got=name,
        expected="finite numbers",
        advice="solve again with --out",
    )
