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
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from perilune.core import Deferred, Outcome, PeriluneError
from perilune.families.family import FamilyPoint
from perilune.families.store_directory import begin_store, problem_identity, read_arrays, read_record, write_stored
from perilune.io import (
    answer_document,
    array,
    enumeration_member,
    finite,
    part,
    read_answer,
    read_trajectories,
    refuse_entry,
    short_text,
)
from perilune.problem import Problem, Solution, Trajectory, Verification, with_new_keys

if TYPE_CHECKING:
    from perilune.families.members import Members


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
        begin_store(self.directory, self._identity())
        numbers = sorted(int(p.stem) for p in self.directory.glob("*.json") if re.fullmatch(r"\d{6,}", p.stem))
        found_members = {}
        for i in (i for i in numbers if i < len(self.members.values)):
            try:
                found_members[i] = self._member(i)
            except PeriluneError as error:
                note(f"stored member {i:06d} cannot be used ({error.what}; got {error.got}) and is solved again")
        return found_members

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
            write_stored(self.directory, f"{i:06d}.npz", _curves_archive(solution))
        document = {
            "values": list(point.values),
            "message": point.message,
            **({"failure": point.failure.name} if point.failure else {}),
            "solution": None if solution is None else answer_document(solution),
        }
        write_stored(self.directory, f"{i:06d}.json", json.dumps(finite(document), allow_nan=False).encode())

    def _identity(self) -> dict[str, Any]:
        """Return the identity of the sweep, as a tree that JSON gives back unchanged."""
        members = self.members
        return {
            "problem": problem_identity(members.problem, members.names),
            "members": {"names": list(members.names), "values": [list(v) for v in members.values]},
            "method": repr(members.method),
            "level": members.level,
            "tolerance": members.tolerance.stated or None,  # None: as in the record of a sweep that knew of none
        }

    def _member(self, i: int) -> FamilyPoint:
        document = read_record(self.directory / f"{i:06d}.json", "stored member")
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
    found = {name: array(y, name, (None,) * y.ndim) for name, y in read_arrays(file, "the curves of a member").items()}
    phases = []
    for k, phase in enumerate(problem.phases):
        entry: dict[str, Any] = {"name": phase.name, "costate": None}
        for kind in ("state", "control", "costate"):
            if f"{k}.{kind}.time" in found:
                entry[kind] = {name: found.get(f"{k}.{kind}.{name}") for name in ("time", "values", "rates")}
        phases.append(entry)
    return read_trajectories({**document, "phases": phases}, problem)
