"""A family on disk, member by member, so that a sweep that was broken off goes on where it stood.

``sweep.json`` says which sweep it is: the problem's digest and numbers, the members asked for, method and level. Each
member is ``000042.json`` (outcome, checks, what was chosen) and ``000042.npz`` (its curves, read when looked at). A
file appears whole or not at all, the first after the second, so what is there is done; a kill at any time costs the
member that was being computed.

A store is the sweep's own memory: the checks in it are taken over, and the verification says that they were made when
the member was stored. A solution that comes from elsewhere is loaded by `perilune.load`, which takes over nothing.
"""

from __future__ import annotations

import io
import json
import os
import re
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from perilune.families.family import FamilyPoint
from perilune.io.export import answer_document, versions
from perilune.io.files import finite
from perilune.io.reading import array, part, refuse, text
from perilune.io.reload import LARGEST_FILE, read_answer, read_trajectories, read_verification
from perilune.problem.problem import Problem
from perilune.problem.solution import Deferred, Solution, Trajectory
from perilune.words.outcome import Outcome, PeriluneError

if TYPE_CHECKING:
    from perilune.families.members import Members

MANIFEST, _FORMAT = "sweep.json", {"name": "perilune-sweep", "version": 1}
_OURS = re.compile(r"\d{6,}\.(json|npz)|\.writing-.*|sweep\.json")
_STORED = "checked when it was stored: "


class Store:
    """The directory of one sweep."""

    def __init__(self, directory: Path, members: Members) -> None:
        self.directory, self.members = directory, members

    def open(self) -> dict[int, FamilyPoint]:
        """The members that are there, by their number; the directory is made where there is none.

        Raises
        ------
        PeriluneError
            If the directory is of another sweep, or cannot be read or written.
        """
        said = self._identity()
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            if not (self.directory / MANIFEST).exists():
                if any(self.directory.iterdir()):
                    raise _unusable(self.directory, "files, and no sweep", "a new or empty directory")
                self._put(MANIFEST, json.dumps({"format": _FORMAT, "versions": versions(), **said}).encode())
            found = _read_json(self.directory / MANIFEST)
            differs = [name for name, value in said.items() if found.get(name) != value]
            if found.get("format") != _FORMAT or differs:
                raise _unusable(self.directory, f"a sweep of other {', '.join(differs) or 'format'}", "the same sweep")
            for left in self.directory.glob(".writing-*"):
                left.unlink(missing_ok=True)
            numbers = sorted(int(p.stem) for p in self.directory.glob("*.json") if re.fullmatch(r"\d{6,}", p.stem))
            return {i: self._member(i) for i in numbers if i < len(self.members.values)}
        except OSError as error:
            raise _unusable(self.directory, str(error.strerror), "a directory that you may write") from error

    def write(self, i: int, point: FamilyPoint) -> None:
        """Keep one member."""
        solution = point.solution
        if solution is not None:
            self._put(f"{i:06d}.npz", _curves(solution))
        document = {
            "values": list(point.values),
            "message": point.message,
            "failure": point.failure.name,
            "solution": None if solution is None else answer_document(solution),
        }
        self._put(f"{i:06d}.json", json.dumps(finite(document), allow_nan=False).encode())

    def _identity(self) -> dict[str, Any]:
        """What makes it this sweep, as a tree that JSON gives back as it is."""
        members, problem = self.members, self.members.problem
        name, given, free, bounds, scales = problem.numbers
        fixed = tuple(pair for pair in given if pair[0] not in members.names)
        # Where the ranges follow from the parameters, those of the problem's own values are nobody's.
        own = (name, fixed, free if problem.ranges is None else (), bounds, scales)
        return {
            "problem": {"name": name, "digest": problem.form.digest, "numbers": repr(own)},
            "members": {"names": list(members.names), "values": [list(v) for v in members.values]},
            "method": repr(members.method),
            "level": members.level,
        }

    def _put(self, name: str, content: bytes) -> None:
        temporary = self.directory / f".writing-{os.getpid()}-{name}"
        temporary.write_bytes(content)
        os.replace(temporary, self.directory / name)

    def _member(self, i: int) -> FamilyPoint:
        file = self.directory / f"{i:06d}.json"
        try:
            document = _read_json(file)
            values = self.members.values[i]
            if document.get("values") != list(values):
                refuse("values", str(document.get("values"))[:60], str(list(values)))
            failure = Outcome.__members__.get(text(document, "failure"), Outcome.NOT_CONVERGED)
            entry = document.get("solution")
            solution = None if entry is None else self._solution(i, part(document, "solution", dict))
            return FamilyPoint(values=values, solution=solution, message=text(document, "message"), failure=failure)
        except PeriluneError as error:
            raise _unusable(file, f"{error.what}: {error.got}", "a member as it was written") from error

    def _solution(self, i: int, document: Mapping[str, Any]) -> Solution:
        problem = self.members.problem_of(i)
        curves = self.directory / f"{i:06d}.npz"
        count = len(problem.phases)
        solution = read_answer(document, problem, Deferred(count, lambda: _read_curves(curves, problem, document)))
        verification = read_verification(document)
        told = replace(verification, text=_STORED + verification.text) if verification.checks else verification
        outcome = Outcome[text(part(document, "outcome", dict), "name")]
        return replace(solution, outcome=outcome, verification=told)


def clear(directory: Path) -> None:
    """Remove the files of a store, and nothing else."""
    with suppress(FileNotFoundError):
        for file in list(directory.iterdir()):
            if _OURS.fullmatch(file.name):
                file.unlink()


def _curves(solution: Solution) -> bytes:
    tables: dict[str, Any] = {}
    for k, flown in enumerate(solution.trajectories):
        for kind in ("state", "control", "costate"):
            if (curve := getattr(flown, kind)) is not None:
                tables |= {f"{k}.{kind}.{name}": getattr(curve, name) for name in ("time", "values", "rates")}
    content = io.BytesIO()
    np.savez(content, **tables)
    return content.getvalue()


def _read_curves(file: Path, problem: Problem, document: Mapping[str, Any]) -> tuple[Trajectory, ...]:
    """The curves of a member, checked as those of a saved solution are."""
    try:
        if file.stat().st_size > LARGEST_FILE:
            raise _unusable(file, "too many bytes", "a few hundred kilobytes")
        with np.load(file, allow_pickle=False) as tables:
            found = {name: array(tables[name], name, (None,) * tables[name].ndim) for name in tables.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise _unusable(file, str(error)[:80], "the curves of a member") from error
    phases = []
    for k, phase in enumerate(problem.phases):
        entry: dict[str, Any] = {"name": phase.name, "costate": None}
        for kind in ("state", "control", "costate"):
            if f"{k}.{kind}.time" in found:
                entry[kind] = {name: found.get(f"{k}.{kind}.{name}") for name in ("time", "values", "rates")}
        phases.append(entry)
    return read_trajectories({**document, "phases": phases}, problem)


def _read_json(file: Path) -> dict[str, Any]:
    raw = file.read_bytes()[: LARGEST_FILE + 1]
    try:
        document = json.loads(raw.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise _unusable(file, str(error)[:80], "JSON as the sweep writes it") from error
    if not isinstance(document, dict):
        raise _unusable(file, type(document).__name__, "a record")
    return document


def _unusable(place: Path, got: str, expected: str) -> PeriluneError:
    return PeriluneError(
        f"this store cannot be used: {place}",
        got=got,
        expected=expected,
        advice="choose another directory; or remove this one, and its members are computed again",
    )
