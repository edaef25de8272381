"""Store of a family on disk, member by member, so that an interrupted sweep goes on where it stood.

``sweep.json`` says which sweep it is: the problem's digest and numbers, the members asked for, method, level and
tolerance. Each member is ``000042.json`` (outcome, checks, what was chosen) and ``000042.npz`` (its curves, read when
looked at). A file appears whole or not at all, the first after the second, so what is there is done; a kill at any time
costs the member that was being computed.

A store is read as any saved solution is: what a member says of its outcome and its proof is not taken over
(`perilune.families.members.Members.taken_over` proves it again), and one that cannot be read is solved again.
"""

from __future__ import annotations

import io
import json
import os
import re
import zipfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from perilune.core import Deferred, Outcome, PeriluneError, bounded_bytes, bounded_text
from perilune.families.family import FamilyPoint
from perilune.io import (
    LARGEST_FILE,
    answer_document,
    array,
    enumeration_member,
    finite,
    part,
    program_versions,
    read_answer,
    read_trajectories,
    refuse_entry,
    short_text,
    tree,
)
from perilune.problem import Problem, Solution, Trajectory, Verification, with_new_keys

if TYPE_CHECKING:
    from perilune.families.members import Members

MANIFEST, _FORMAT = "sweep.json", {"name": "perilune-sweep", "version": 2}
_KNOWN_FORMATS = ({**_FORMAT, "version": 1}, _FORMAT)  # the first with other keys (`perilune.problem.renamed_keys`)
_OURS = re.compile(r"\d{6,}\.(json|npz)|\.writing-.*|sweep\.json")


class FamilyStore:
    """Directory of one sweep."""

    def __init__(self, directory: Path, members: Members) -> None:
        self.directory: Path = directory
        self.members: Members = members

    def open(self, note: Callable[[str], None]) -> dict[int, FamilyPoint]:
        """Return the stored members, unverified, by their number; makes a missing directory.

        Parameters
        ----------
        note
            Receives a sentence for each member that cannot be used and has to be solved again.

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
                    raise _unusable_family_store(self.directory, "files, and no sweep", "a new or empty directory")
                self._put(MANIFEST, json.dumps({"format": _FORMAT, "versions": program_versions(), **said}).encode())
            found = self._manifest()
            differs = [name for name, value in said.items() if found.get(name) != value]
            if found.get("format") not in _KNOWN_FORMATS or differs:
                raise _unusable_family_store(
                    self.directory, f"a sweep that differs in its {', '.join(differs) or 'format'}", "the same sweep"
                )
            for left in self.directory.glob(".writing-*"):
                left.unlink(missing_ok=True)
            numbers = sorted(int(p.stem) for p in self.directory.glob("*.json") if re.fullmatch(r"\d{6,}", p.stem))
            found_members = {}
            for i in (i for i in numbers if i < len(self.members.values)):
                try:
                    found_members[i] = self._member(i)
                except PeriluneError as error:
                    note(f"stored member {i:06d} cannot be used ({error.what}; got {error.got}) and is solved again")
            return found_members
        except OSError as error:
            raise _unusable_family_store(
                self.directory, str(error.strerror), "a directory that you may write"
            ) from error

    def write(self, i: int, point: FamilyPoint) -> None:
        """Store one member.

        Parameters
        ----------
        i
            Number of the member.
        point
            Member with its values, and its solution or failure.

        Raises
        ------
        PeriluneError
            If it cannot be written; members stored before it are kept.
        """
        try:
            self._write(i, point)
        except OSError as error:
            raise PeriluneError(
                f"member {i:06d} of the sweep cannot be stored", got=f"{self.directory}: {error.strerror}",
                expected="a directory that you may write, with space left",
                advice="free space or check its permissions, and run the same sweep again: stored members are kept",
            ) from error  # fmt: skip

    def _write(self, i: int, point: FamilyPoint) -> None:
        solution = point.solution
        if solution is not None:
            self._put(f"{i:06d}.npz", _curves_archive(solution))
        document = {
            "values": list(point.values),
            "message": point.message,
            **({"failure": point.failure.name} if point.failure else {}),
            "solution": None if solution is None else answer_document(solution),
        }
        self._put(f"{i:06d}.json", json.dumps(finite(document), allow_nan=False).encode())

    def _identity(self) -> dict[str, Any]:
        """Return the identity of the sweep, as a tree that JSON gives back unchanged."""
        members, problem = self.members, self.members.problem
        name, given, free, bounds, scales = problem.numbers
        fixed = tuple(pair for pair in given if pair[0] not in members.names)
        # Where the ranges follow from the parameters, those of the problem's own values are nobody's.
        own = (name, fixed, free if problem.parameter_bounds is None else (), bounds, scales)
        return {
            "problem": {"name": name, "digest": problem.form.digest, "numbers": repr(own)},
            "members": {"names": list(members.names), "values": [list(v) for v in members.values]},
            "method": repr(members.method),
            "level": members.level,
            "tolerance": members.tolerance.stated or None,  # None: as in the record of a sweep that knew of none
        }

    def _manifest(self) -> dict[str, Any]:
        try:
            return _read_json(self.directory / MANIFEST, "record of a sweep")
        except PeriluneError as error:
            raise _unusable_family_store(
                self.directory, f"{MANIFEST}: {error.what}", "the record that the sweep writes"
            ) from error

    def _put(self, name: str, content: bytes) -> None:
        temporary = self.directory / f".writing-{os.getpid()}-{name}"
        temporary.write_bytes(content)
        os.replace(temporary, self.directory / name)

    def _member(self, i: int) -> FamilyPoint:
        document = _read_json(self.directory / f"{i:06d}.json", "stored member")
        values = self.members.values[i]
        if document.get("values") != list(values):
            refuse_entry("values", str(document.get("values"))[:60], str(list(values)))
        message = short_text(document, "message")
        if document.get("solution") is None:
            failure = enumeration_member(Outcome, Outcome.__members__.get(short_text(document, "failure")), "failure")
            return FamilyPoint(values=values, solution=None, message=message, failure=failure)
        said = with_new_keys(part(document, "solution", dict), "answer")
        return FamilyPoint(values=values, solution=self._solution(i, said), message=message)

    def _solution(self, i: int, document: Mapping[str, Any]) -> Solution:
        problem = self.members.problem_of(i)
        curves = self.directory / f"{i:06d}.npz"
        if not self.members.level:  # no proof will look at them
            _read_curves(curves, problem, document)
        made = Deferred(len(problem.phases), lambda: _read_curves(curves, problem, document))
        unverified = Verification(tolerance=self.members.tolerance)
        return replace(read_answer(document, problem, made), outcome=Outcome.SOLVED, verification=unverified)


def clear_family(directory: Path) -> None:
    """Remove the files of a store, and nothing else."""
    with suppress(FileNotFoundError):
        for file in list(directory.iterdir()):
            if _OURS.fullmatch(file.name):
                file.unlink()


def _curves_archive(solution: Solution) -> bytes:
    tables: dict[str, Any] = {}
    for k, flown in enumerate(solution.trajectories):
        for kind in ("state", "control", "costate"):
            if (curve := getattr(flown, kind)) is not None:
                tables |= {f"{k}.{kind}.{name}": getattr(curve, name) for name in ("time", "values", "rates")}
    content = io.BytesIO()
    np.savez(content, **tables)
    return content.getvalue()


def _read_curves(file: Path, problem: Problem, document: Mapping[str, Any]) -> tuple[Trajectory, ...]:
    """Read the curves of a member, checked as those of a saved solution are."""
    try:
        content = bounded_bytes(file, "table of curves", LARGEST_FILE, expected="the curves of a member", advice="")
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            if sum(entry.file_size for entry in packed.infolist()) > LARGEST_FILE:
                raise ValueError(f"more than {LARGEST_FILE} bytes when unpacked")
        with np.load(io.BytesIO(content), allow_pickle=False) as tables:
            found = {name: array(tables[name], name, (None,) * tables[name].ndim) for name in tables.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise _unusable_family_store(file, str(error)[:80], "the curves of a member") from error
    phases = []
    for k, phase in enumerate(problem.phases):
        entry: dict[str, Any] = {"name": phase.name, "costate": None}
        for kind in ("state", "control", "costate"):
            if f"{k}.{kind}.time" in found:
                entry[kind] = {name: found.get(f"{k}.{kind}.{name}") for name in ("time", "values", "rates")}
        phases.append(entry)
    return read_trajectories({**document, "phases": phases}, problem)


def _read_json(file: Path, what: str) -> dict[str, Any]:
    advice = "remove it, and it is computed again"
    content = bounded_text(file, what, LARGEST_FILE, expected="JSON as the sweep writes it", advice=advice)
    document = tree(content, what, advice)
    if not isinstance(document, dict):
        raise PeriluneError(f"the {what} is not a record", got=type(document).__name__, advice=advice)
    return document


def _unusable_family_store(place: Path, got: str, expected: str) -> PeriluneError:
    return PeriluneError(
        f"this store cannot be used: {place}",
        got=got,
        expected=expected,
        advice="choose another directory; or remove this one, and its members are computed again",
    )
