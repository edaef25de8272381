"""Store of a batch on disk, some thousand points a file, so that an interrupted batch goes on where it stood.

``points-000000.npz`` has the rows of the points from that number on, one array a column. Rows are taken over as stored:
bits of an answer are the same in any run, and nothing in a store is called proved before it is proved again.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from perilune.core import Matrix, Outcome, PeriluneError
from perilune.families.batch_rows import NOWHERE, OUTCOMES, SOLVED, UNSOLVED, BatchRows
from perilune.families.batch_solver import BatchRequest
from perilune.families.store_directory import begin_store, problem_identity, read_arrays, unusable_store, write_stored
from perilune.io import tree

_MESSAGES, _LIMIT = "messages", "time_limit"
_LONGEST = 4000  # characters of a message
_PROVED = OUTCOMES.index(Outcome.PROVED)
_NOT_CONVERGED = OUTCOMES.index(Outcome.NOT_CONVERGED)
_ANSWERS = [_PROVED, SOLVED, OUTCOMES.index(Outcome.NOT_PROVED)]


class BatchStore:
    """Directory of one batch.

    Parameters
    ----------
    directory
        Where it is kept.
    request, values
        What is asked for, and values of the parameters at the points [SI], (points, d).
    """

    def __init__(self, directory: Path, request: BatchRequest, values: Matrix) -> None:
        self.directory, self.request = directory, request
        self._identity: dict[str, Any] = {
            "problem": problem_identity(request.problem, request.names),
            "points": {"names": list(request.names), "count": len(values), "digest": _array_digest(values)},
            "known solutions": [_array_digest(known.unknowns) for known in request.known],
            "level": request.level,
            "search": request.search,
        }

    def open(
        self, parts: Iterable[tuple[int, BatchRows]], note: Callable[[str], None]
    ) -> Iterator[tuple[int, BatchRows]]:
        """Yield stored rows with the number of their first point; makes a missing directory.

        Parameters
        ----------
        parts
            Rows of the batch, as they are before anything is solved, with the number of their first point.
        note
            Receives a sentence for each file that cannot be used.

        Raises
        ------
        PeriluneError
            If the directory is of another batch, or cannot be read or written.
        """
        begin_store(self.directory, self._identity)
        for start, rows in parts:
            if (file := self._file(start)).exists():
                try:
                    yield start, self._read(file, rows)
                except PeriluneError as error:
                    note(f"{file.name} cannot be used ({error.what}; got {error.got}), its points are solved again")

    def write(self, start: int, rows: BatchRows) -> None:
        """Store rows.

        Parameters
        ----------
        start, rows
            Number of their first point, and the rows.

        Raises
        ------
        PeriluneError
            If they cannot be written; those stored before are kept.
        """
        said = json.dumps({str(i): message for i, message in rows.messages.items()}).encode()
        content = io.BytesIO()
        arrays: dict[str, Any] = {**dict(rows.columns), _MESSAGES: np.frombuffer(said, dtype=np.uint8)}
        arrays[_LIMIT] = np.array(self.request.limit)
        np.savez_compressed(content, **arrays)
        try:
            write_stored(self.directory, self._file(start).name, content.getvalue())
        except OSError as error:
            raise PeriluneError(
                "points of the batch cannot be stored", got=f"{self.directory}: {error.strerror}",
                expected="a directory that you may write, with space left",
                advice="free space or check its permissions, and run the same batch again: stored points are kept",
            ) from error  # fmt: skip

    def _file(self, start: int) -> Path:
        return self.directory / f"points-{start:06d}.npz"

    def _read(self, file: Path, rows: BatchRows) -> BatchRows:
        """Enter what a file has into rows of the same points, whose arrays are left as they are if it is not theirs."""
        found, own = read_arrays(file, "rows of a batch"), dict(rows.columns)
        for name, column in own.items():
            y = found.get(name)
            if y is None or y.shape != column.shape or y.dtype != column.dtype:
                raise unusable_store(file, f"another column {name}", "the columns of the same points")
        solved = np.isin(found["codes"], _ANSWERS)
        fine = np.array_equal(found["values"], rows.values, equal_nan=True) and bool(
            np.all((found["codes"] >= 0) & (found["codes"] < len(OUTCOMES)))
            and np.all((found["origin"] >= NOWHERE) & (found["origin"] < len(self.request.known)))
            and np.array_equal(solved, found["origin"] != NOWHERE)
            and np.array_equal(solved, np.isfinite(found["objective"]))
            and (self.request.level or not np.any(found["codes"] == _PROVED))
        )
        if not fine:
            raise unusable_store(file, "values that no batch has", "the rows of the same points")
        messages = self._messages(file, found.get(_MESSAGES), len(rows))
        for name, column in own.items():
            column[:] = found[name]
        told = {i: text for i, text in messages.items() if not solved[i] and found["codes"][i] != UNSOLVED}
        rows.messages.update(told)
        rows.levels[:] = 0
        if self.request.level:
            rows.codes[solved] = SOLVED  # and not proved before it is proved again
        if not self.request.limit <= _scalar(found.get(_LIMIT)):  # more time may find what was not found
            rows.clear(rows.where(_NOT_CONVERGED))
        return rows

    def _messages(self, file: Path, content: Any, count: int) -> dict[int, str]:
        """Read the messages of a file, by the number of the point."""
        written = content.tobytes() if content is not None and content.dtype == np.uint8 else b""
        said = tree(written.decode(errors="replace"), "messages of a batch", "")
        if not isinstance(said, dict) or not all(
            key.isdecimal() and int(key) < count and isinstance(text, str) for key, text in said.items()
        ):
            raise unusable_store(file, "messages of no points", "a text for each point")
        return {int(key): text[:_LONGEST] for key, text in said.items()}


def _scalar(content: Any) -> float:
    """Return the number of an array without dimensions; NaN if it is none."""
    return float(content) if content is not None and content.shape == () and content.dtype == float else np.nan


def _array_digest(*arrays: Any) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(y, dtype=float).tobytes() for y in arrays)).hexdigest()
