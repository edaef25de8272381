"""Writing to disk so that a reader sees either the whole result or nothing of it.

Everything is written into a temporary directory beside the target and moved when it is complete, so an error
or Ctrl-C in the middle leaves the target as it was. Nothing that is there already is overwritten unless the
caller says so, and files that this program did not write are never removed.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from perilune.words.outcome import PeriluneError


@contextmanager
def fresh_directory(target: str | Path, force: bool = False) -> Iterator[Path]:
    """Directory to write into; its files appear in `target` when the block ends without an error.

    Parameters
    ----------
    target
        Where the files shall be; made if it is not there.
    force
        Whether files of the same names in `target` may be replaced.

    Raises
    ------
    PeriluneError
        If `target` is a file, cannot be written, or holds files already and `force` is false.
    """
    target = Path(target)
    if target.exists() and not target.is_dir():
        raise PeriluneError(
            "the output directory is a file", got=str(target), expected="a directory", advice="choose another name"
        )
    if not force and target.is_dir() and any(target.iterdir()):
        raise PeriluneError(
            "the output directory is not empty",
            got=str(target),
            expected="a new or empty directory",
            advice="choose another, or pass --force to replace the files of the same names",
        )
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise PeriluneError(
            "the output directory cannot be written",
            got=f"{target}: {error.strerror}",
            expected="a directory that you may write",
            advice="choose another",
        ) from error
    try:
        yield work
        _move(work, target)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _move(work: Path, target: Path) -> None:
    """Move every file of `work` to the same place in `target`; each single move is atomic."""
    for source in sorted(path for path in work.rglob("*") if path.is_file()):
        place = target / source.relative_to(work)
        place.parent.mkdir(parents=True, exist_ok=True)
        os.replace(source, place)


def finite(value: Any) -> Any:
    """Copy a tree of dicts, lists and numbers with None for each number not finite: JSON has no NaN."""
    if isinstance(value, dict):
        return {key: finite(v) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def json_text(document: Any) -> str:
    """JSON with an indented outline; innermost rows of numbers stay on one line each."""
    return _outline(finite(document), "") + "\n"


def _outline(value: Any, indent: str) -> str:
    deeper = indent + " "
    if isinstance(value, dict) and value:
        rows = [f"{deeper}{json.dumps(str(k))}: {_outline(v, deeper)}" for k, v in value.items()]
        return "{\n" + ",\n".join(rows) + "\n" + indent + "}"
    if isinstance(value, list) and any(isinstance(v, (list, dict)) for v in value):
        return "[\n" + ",\n".join(deeper + _outline(v, deeper) for v in value) + "\n" + indent + "]"
    return json.dumps(value, allow_nan=False, ensure_ascii=False)
