"""Directory that keeps what a sweep has done, each file whole or not at all, so that it goes on where it stood.

``sweep.json`` says which sweep it is. What else is read from it is checked as any saved file is.
"""

from __future__ import annotations

import io
import json
import os
import re
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.core import PeriluneError, bounded_bytes, bounded_text
from perilune.io import LARGEST_FILE, program_versions, tree
from perilune.problem import Problem

MANIFEST, _FORMAT = "sweep.json", {"name": "perilune-sweep", "version": 2}
_KNOWN_FORMATS = ({**_FORMAT, "version": 1}, _FORMAT)  # the first with other keys (`perilune.problem.renamed_keys`)
_OURS = re.compile(r"(points-)?\d{6,}\.(json|npz)|\.writing-.*|sweep\.json")


def begin_store(directory: Path, identity: Mapping[str, Any]) -> None:
    """Make the directory of a sweep, or see that it is that of the same sweep, and remove what was half written.

    Parameters
    ----------
    directory, identity
        The directory, and what the sweep is, as a tree that JSON gives back unchanged.

    Raises
    ------
    PeriluneError
        If the directory is of another sweep, or cannot be read or written.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if not (directory / MANIFEST).exists():
            if any(directory.iterdir()):
                raise unusable_store(directory, "files, and no sweep", "a new or empty directory")
            head = {"format": _FORMAT, "versions": program_versions(), **identity}
            write_stored(directory, MANIFEST, json.dumps(head).encode())
        found = _manifest(directory)
        differs = [name for name, value in identity.items() if found.get(name) != value]
        if found.get("format") not in _KNOWN_FORMATS or differs:
            raise unusable_store(
                directory, f"a sweep that differs in its {', '.join(differs) or 'format'}", "the same sweep"
            )
        for left in directory.glob(".writing-*"):
            left.unlink(missing_ok=True)
    except OSError as error:
        raise unusable_store(directory, str(error.strerror), "a directory that you may write") from error


def _manifest(directory: Path) -> dict[str, Any]:
    try:
        return read_record(directory / MANIFEST, "record of a sweep")
    except PeriluneError as error:
        raise unusable_store(directory, f"{MANIFEST}: {error.what}", "the record that the sweep writes") from error


def problem_identity(problem: Problem, names: Sequence[str]) -> dict[str, Any]:
    """Return what a problem is but for the values of some parameters, as a tree that JSON gives back unchanged.

    Parameters
    ----------
    problem, names
        The problem, and the parameters that vary.
    """
    name, given, free, bounds, scales = problem.numbers
    fixed = tuple(pair for pair in given if pair[0] not in names)
    # Where the ranges follow from the parameters, those of the problem's own values are nobody's.
    own = (name, fixed, free if problem.parameter_bounds is None else (), bounds, scales)
    return {"name": name, "digest": problem.form.digest, "numbers": repr(own)}


def write_stored(directory: Path, name: str, content: bytes) -> None:
    """Write a file of a store, whole or not at all.

    Parameters
    ----------
    directory, name, content
        The directory of the store, and name and content of the file.
    """
    temporary = directory / f".writing-{os.getpid()}-{name}"
    temporary.write_bytes(content)
    os.replace(temporary, directory / name)


def read_record(file: Path, what: str) -> dict[str, Any]:
    """Read a record of a store.

    Parameters
    ----------
    file, what
        The file, and its content in words.

    Raises
    ------
    PeriluneError
        If it is none, or too large.
    """
    advice = "remove it, and it is computed again"
    content = bounded_text(file, what, LARGEST_FILE, expected="JSON as the sweep writes it", advice=advice)
    document = tree(content, what, advice)
    if not isinstance(document, dict):
        raise PeriluneError(f"the {what} is not a record", got=type(document).__name__, advice=advice)
    return document


def read_arrays(file: Path, what: str) -> dict[str, NDArray[Any]]:
    """Read the arrays of a file of a store, by name.

    Parameters
    ----------
    file, what
        The file, and its content in words.

    Raises
    ------
    PeriluneError
        If it is none, too large, or holds anything but arrays.
    """
    try:
        content = bounded_bytes(file, "table of arrays", LARGEST_FILE, expected=what, advice="")
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            if sum(entry.file_size for entry in packed.infolist()) > LARGEST_FILE:
                raise ValueError(f"more than {LARGEST_FILE} bytes when unpacked")
        with np.load(io.BytesIO(content), allow_pickle=False) as tables:
            arrays = {name: tables[name] for name in tables.files}
            if any(not isinstance(y, np.ndarray) for y in arrays.values()):
                raise ValueError("a file in it that is no array")
            return arrays
    # RuntimeError: of another compression, or with a password, as damaged bytes say
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise unusable_store(file, str(error)[:80] or "it ends too early", what) from error


def clear_family(directory: Path) -> None:
    """Remove the files of a store, and nothing else."""
    with suppress(FileNotFoundError):
        for file in list(directory.iterdir()):
            if _OURS.fullmatch(file.name):
                file.unlink()


def unusable_store(place: Path, got: str, expected: str) -> PeriluneError:
    """Return the error for a store that cannot be used.

    Parameters
    ----------
    place, got, expected
        File or directory, what it is, and what it should be.
    """
    return PeriluneError(
        f"this store cannot be used: {place}",
        got=got,
        expected=expected,
        advice="choose another directory; or remove this one, and its members are computed again",
    )
