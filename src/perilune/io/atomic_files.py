"""Atomic writing: a reader sees either the whole result or nothing of it.

Everything is written into a temporary directory beside the target and moved when it is complete, so an error
or Ctrl-C in the middle leaves the target as it was; a file that only repeats the result, such as a figure, may fail for
itself (`write_each`). A killed process leaves that directory; the next writer of the same
target removes it. Nothing that is there already is overwritten unless the caller says so. Then what an earlier run
wrote goes as a whole, so that no figure of it stays beside the new ones; files that this program did not write are
never removed.
"""

from __future__ import annotations

import errno
import glob
import json
import math
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from perilune.core import PeriluneError, require_path

try:
    import fcntl
except ImportError:  # Windows: what a killed process leaves there stays
    fcntl = None


class NotWrittenError(PeriluneError):
    """Failure to write some files of a result; all others of it were written.

    `failed` has an error for each file, whose cause is the error of its writer.
    """

    def __init__(self, failed: Sequence[PeriluneError]) -> None:
        first, *more = failed
        what = f"{first.what}, and {len(more)} more files" if more else first.what
        super().__init__(what, got=first.got, expected="every file; the others are written", advice=first.advice)
        self.failed: tuple[PeriluneError, ...] = tuple(failed)


FAILURE_FILE = "failure.json"
FIGURES, DRAWN_BY = "figures", "perilune"  # their folder, and the creator that an SVG names
DRAWN_AS = (".png", ".svg")  # files of one drawing
_OF_FILES = set(".csv .czml .gif .html .jpg .json .md .mp4 .nc .oem .parquet .pdf .png .svg .toml .txt .zip".split())
# What runs write into their directory by name; where others may use the name too, by what is near its head.
_RESULTS = re.compile(r"(solution|failure|family)\.json|family\.(csv|png|svg)|trajectory(_\d+_\w+)?\.csv")
_DRAWING, _REPORT = f"<dc:title>{DRAWN_BY}</dc:title>".encode(), b"\n\n## Results\n\n| quantity | value | unit |"
_HEAD = 2000  # bytes


@contextmanager
def fresh_directory(target: str | Path, force: bool = False) -> Iterator[Path]:
    """Enter a directory to write into; its files appear in `target` when the block ends without an error.

    Parameters
    ----------
    target
        Where the files shall be; made if it is not there.
    force
        Whether what an earlier run wrote there may be replaced, and files of the same names.

    Raises
    ------
    PeriluneError
        If `target` is a file, or called as one and not there, cannot be written, or holds more than a failure already
        and `force` is false.
    """
    target = require_path(target, "an output directory")
    refuse_name_of_file(target)
    if target.exists() and not target.is_dir():
        raise PeriluneError(
            "the output directory is a file", got=str(target), expected="a directory", advice="choose another name"
        )
    if not force and in_use(target):
        raise PeriluneError(
            "the output directory is not empty",
            got=str(target),
            expected="a new or empty directory",
            advice="choose another, or replace the results of an earlier run: --force (in Python force=True)",
        )
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir() and not os.access(target, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        work, lock = _temporary(target)
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
    except OSError as error:
        if error.filename is None:  # a full disk names no file
            error.filename = str(target)
        raise
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def refuse_name_of_file(target: Path) -> None:
    """Refuse a missing directory with the name of a file: ``--out map.png`` does not mean a folder."""
    if target.suffix.lower() in _OF_FILES and not target.exists():
        raise PeriluneError(
            "the output directory is named like a file", got=str(target), expected="a directory for all files",
            advice=f"call it {target.stem}",
        )  # fmt: skip


def new_file(file: str | Path, what: str, force: bool = False) -> Path:
    """Return the path of a file to write, behind links; refuse one that is no file, or exists unless forced.

    Parameters
    ----------
    file
        Path as the user gave it.
    what
        Description of the content in messages.
    force
        Let an existing file be replaced.

    Raises
    ------
    PeriluneError
        If it is "-", a directory, a device or a pipe, or exists.
    """
    path = require_path(file, f"the file of {what}")
    if str(path) == "-":
        raise PeriluneError(
            "the output is a file, not standard output", got="-", expected=f"the name of the file of {what}",
            advice="use ./- for a file of this name",
        )  # fmt: skip
    if path.is_dir():
        raise PeriluneError("the file is a directory", got=str(path), advice="choose another name")
    # Asked before the link is followed: /dev/stdout leads to a name that is nowhere where it is a pipe.
    if path.exists() and not path.is_file():
        raise PeriluneError("this is a device or a pipe, not a file", got=str(path), advice="choose another name")
    path = Path(os.path.realpath(path)) if path.is_symlink() else path
    if path.exists() and not force:
        raise PeriluneError(
            "the file already exists", got=str(path), advice="choose another name, or --force (in Python force=True)"
        )
    return path


@contextmanager
def fresh_file(target: Path, what: str) -> Iterator[Path]:
    """Enter a temporary file next to a target; it becomes the target when the block ends without an error.

    Parameters
    ----------
    target
        File to write.
    what
        Description of the content in messages.

    Raises
    ------
    PeriluneError
        If it cannot be written; `what` is what it holds.
    """
    beside = target.with_name(f".writing-{os.getpid()}-{target.name}")  # which keeps how the name ends
    try:
        yield beside
        os.replace(beside, target)
    except OSError as error:
        raise PeriluneError(
            f"{what} cannot be written", got=f"{target}: {error.strerror or error}",
            expected="a place that you may write, with space left",
            advice="choose another, check its permissions, or free space; existing files are kept",
        ) from error  # fmt: skip
    finally:
        with suppress(OSError):
            beside.unlink()


def write_each(directory: Path, writers: Mapping[str, Callable[[Path], object]]) -> list[PeriluneError]:
    """Write files one by one, so that the failure of one leaves the others.

    Parameters
    ----------
    directory
        Where; folders below it that names go through are made.
    writers
        By the name of the file, or of the drawing without its ending: what writes it to a path.

    Returns
    -------
    list of PeriluneError
        One for each file whose writer failed, whatever it raised; nothing of that file is left.
    """
    failed = []
    for name, write in writers.items():
        path = directory / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write(path)
        except Exception as error:
            for part in (path, *(path.with_name(f"{path.name}{ending}") for ending in DRAWN_AS)):
                part.unlink(missing_ok=True)
            failed.append(unwritten(f"{name} is not written" if path.suffix else f"{name} is not drawn", error))
    return failed


def refuse_unwritten(failed: Sequence[PeriluneError]) -> None:
    """Raise the errors of files that could not be written, if there are any."""
    if failed:
        raise NotWrittenError(failed) from failed[0].__cause__


def unwritten(what: str, error: Exception) -> PeriluneError:
    """Return the error for something that was not written, with the writer's error as its cause.

    Parameters
    ----------
    what
        First words of the message: what was not written.
    error
        Error of the writer.
    """
    if isinstance(error, PeriluneError):
        got, advice = "; ".join(text for text in (error.what, error.got) if text), error.advice
    elif isinstance(error, OSError):
        got, advice = error.strerror or str(error), "free space, or check the permissions there, and write it again"
    else:
        got = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
        advice = "a fault of the program: report it with solution.json and the output under PERILUNE_TRACEBACK=1"
    found = PeriluneError(what, got=got, advice=advice)
    found.__cause__ = error
    return found


def in_use(target: Path) -> bool:
    """Return True if a directory holds more than the record of a failed run."""
    return target.is_dir() and any(path.name != FAILURE_FILE for path in target.iterdir())


def _temporary(target: Path) -> tuple[Path, int | None]:
    """Make a directory to write into, locked while its writer lives; those of killed writers are removed."""
    prefix = f".{target.name}-writing-"
    for left in target.parent.glob(glob.escape(prefix) + "?" * 8):  # as `mkdtemp` names them
        if left.is_dir() and not left.is_symlink() and (lock := _locked(left)) is not None:
            shutil.rmtree(left, ignore_errors=True)
            os.close(lock)
    while True:
        work = Path(tempfile.mkdtemp(prefix=prefix, dir=target.parent))
        if fcntl is None or (lock := _locked(work)) is not None:
            return work, None if fcntl is None else lock


def _locked(directory: Path) -> int | None:
    """Lock a directory and return the handle; None if another process has it, it is gone, or locks do not work."""
    if fcntl is None:
        return None
    with suppress(OSError):
        handle = os.open(directory, os.O_RDONLY)
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if directory.exists():
                return handle
        os.close(handle)
    return None


def _move(work: Path, target: Path) -> None:
    """Move every file of `work` to the same place in `target`, each at once; then remove what an older run left.

    One that has no place there, as where a folder has its name, takes no other with it; the first is raised at the end.
    """
    moved, failed = set[Path](), list[OSError]()
    for source in sorted(path for path in work.rglob("*") if path.is_file()):
        place = target / source.relative_to(work)
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            os.replace(source, place)
        except OSError as error:  # which is to name the place, and not what is moved there
            failed.append(OSError(error.errno, error.strerror, error.filename2 or error.filename))
        moved.add(place)
    if failed:
        raise failed[0]
    if moved:
        for left in _results_in(target) - moved:
            left.unlink(missing_ok=True)
        with suppress(OSError):
            (target / FIGURES).rmdir()  # where it is empty


def _results_in(target: Path) -> set[Path]:
    """Return every file that runs of this program wrote into a directory."""
    found = {path for path in target.iterdir() if _RESULTS.fullmatch(path.name) and path.is_file()}
    if _near_head(target / "report.md", _REPORT):
        found.add(target / "report.md")
    for drawn in (target / FIGURES).glob("*.svg"):
        if _near_head(drawn, _DRAWING):
            found |= {drawn, drawn.with_suffix(".png")}
    return found


def _near_head(file: Path, mark: bytes) -> bool:
    with suppress(OSError), file.open("rb") as opened:
        return mark in opened.read(_HEAD)
    return False


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
    """Return JSON with an indented outline; innermost rows of numbers stay on one line each."""
    return _outline(finite(document), "") + "\n"


def _outline(value: Any, indent: str) -> str:
    deeper = indent + " "
    if isinstance(value, dict) and value:
        rows = [f"{deeper}{json.dumps(str(k))}: {_outline(v, deeper)}" for k, v in value.items()]
        return "{\n" + ",\n".join(rows) + "\n" + indent + "}"
    if isinstance(value, list) and any(isinstance(v, (list, dict)) for v in value):
        return "[\n" + ",\n".join(deeper + _outline(v, deeper) for v in value) + "\n" + indent + "]"
    return json.dumps(value, allow_nan=False, ensure_ascii=False)
