"""Store of an atlas on disk: a header, shards that never change, and a manifest to which lines are added.

``atlas.json`` states the problem, the region and the tolerance. A *shard* is one array in a file of NumPy's own format
(``.npy``, a structured array that names its columns); it is written under another name and renamed, so that it is
complete or absent. ``manifest.jsonl`` has one JSON object in each line: the survey, then each block with the names of
its shards and their SHA-256, and a checksum of its own. A line is added by one write, after the shards that it names.
So a kill at any moment costs only the blocks that were being computed; several builders may work on one directory, each
on blocks that it has locked; and a reader sees the content of the manifest at the time of reading.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import io
import json
import math
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.store.checksums import CHECKSUM, FORMAT, KNOWN_FORMATS, end_line, sealed_header, with_checksum
from perilune.atlas.store.file_errors import (
    damaged_shard_error,
    unreadable_file_error,
    unusable_atlas_error,
    unwritable_atlas_error,
)
from perilune.atlas.store.file_locks import locked_file
from perilune.atlas.store.manifest import (
    damage_text,
    is_cut_off,
    read_line,
    refuse_no_brick,
    refuse_no_sample,
    refuse_no_survey,
    written_line,
)
from perilune.core import PeriluneError, bounded_text
from perilune.io import LARGEST_FILE, finite, json_text, refuse_name_of_file, tree
from perilune.problem import with_new_keys

HEADER, MANIFEST = "atlas.json", "manifest.jsonl"
PATIENCE = 0.2  # seconds between looks at what another builder does
_OURS = re.compile(r"(brick|survey)-[\w.~-]{1,80}\.npy", re.ASCII)
_ANEW = "rebuild the atlas: perilune atlas build ... --force"


class AtlasStore:
    """Directory of one atlas.

    Parameters
    ----------
    directory
        Where it is.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._file, self._read, self._made = -1, 0, False
        self._seal = ""  # checksum of the header that was read
        self._lines, self._names = list[dict[str, Any]](), set[str]()
        self.unreadable: int = 0  # lines that were written whole, and say nothing now

    def prepare(self, header: Mapping[str, Any] | None) -> None:
        """Make the directory, or check that it holds only the same atlas, or any if `header` is None.

        Raises
        ------
        PeriluneError
            If there is something else, or it cannot be written.
        """
        refuse_name_of_file(self.directory)
        try:
            self._made = self._made or not self.directory.exists()
            self.directory.mkdir(parents=True, exist_ok=True)
            there = (self.directory / HEADER).exists()
            if (header is None or not there) and not all(is_atlas_file(path.name) for path in self.directory.iterdir()):
                got = "an atlas and other files" if there else "files, and no atlas"
                raise unusable_atlas_error(self.directory, got, "a new or empty directory")
        except OSError as error:
            raise unusable_atlas_error(self.directory, str(error.strerror), "a directory that you may write") from error
        if header is None or not there:
            return
        said, found = json.loads(json.dumps(finite(dict(header)))), self.header()
        differs = [name for name, value in said.items() if name != "versions" and found.get(name) != value]
        if differs:
            got, advice = f"an atlas that differs in its {', '.join(differs)}", "choose another directory"
            if differs == ["axes"]:
                advice = f"perilune atlas extend widens ranges, and completes an atlas that was widened; or {advice}"
            raise unusable_atlas_error(self.directory, got, "the same atlas", advice)

    def begin(self, header: Mapping[str, Any]) -> None:
        """Write the header, unless another builder did; arguments and errors of `prepare`."""
        if not (self.directory / HEADER).exists():
            self._put(HEADER, json_text(sealed_header(header)).encode())
        self.prepare(header)

    def leave(self) -> None:
        """Leave the directory as it was found, if nothing was begun in it."""
        with contextlib.suppress(OSError):
            if all(path.name.startswith((".claim-", ".writing-")) for path in self.directory.iterdir()):
                clear_atlas(self.directory)
                if self._made:
                    self.directory.rmdir()

    def header(self) -> dict[str, Any]:
        """Read ``atlas.json``.

        Raises
        ------
        PeriluneError
            If there is none, or it is of another format, or altered: extremals of another problem would be polished to
            answers of this one, each with its proof.
        """
        content = bounded_text(
            self.directory / HEADER, "atlas", LARGEST_FILE, expected=f"a directory with {HEADER}",
            advice="perilune atlas build SCENARIO --vary KEY=LOW:HIGH --out DIR",
        )  # fmt: skip
        found = tree(content, "atlas", _ANEW)
        if not isinstance(found, dict) or found.get("format") not in KNOWN_FORMATS:
            said = found.get("format") if isinstance(found, dict) else None
            raise PeriluneError(
                "this is not an atlas of this version",
                got=f"format {str(said)[:60]}",
                expected=str(FORMAT),
                advice=_ANEW,
            )
        if found != with_checksum(found):
            raise PeriluneError(
                f"the atlas is damaged: {HEADER} is not as it was written",
                got="content that does not match its checksum",
                expected="the file as it was written",
                advice=_ANEW,
            )
        self._seal = found.pop(CHECKSUM)
        return with_new_keys(found, "header")

    @property
    def seal(self) -> str:
        """Return the checksum of the header, which a survey names: of the one that was read, if any; "" without one."""
        if not self._seal and (self.directory / HEADER).exists():
            self.header()
        return self._seal

    def lines(self) -> list[dict[str, Any]]:
        """Read the lines of the manifest so far; an incomplete last line counts as not written.

        Lines are never changed, so each is read once.
        """
        try:
            with (self.directory / MANIFEST).open("rb") as opened:
                if os.fstat(opened.fileno()).st_ino != self._file or opened.seek(0, os.SEEK_END) < self._read:
                    self._file, self._read = os.fstat(opened.fileno()).st_ino, 0
                    self._lines.clear()
                    self._names.clear()
                    self.unreadable = 0
                opened.seek(self._read)
                content = opened.read()
        except FileNotFoundError:
            return []
        except OSError as error:
            raise unreadable_file_error(MANIFEST, error) from error
        whole = content[: content.rfind(b"\n") + 1]
        self._read += len(whole)
        for line in whole.splitlines():
            if (found := read_line(line)) is not None:
                self._lines.append(found)
                if found.get("kind") == "brick":
                    self._names.add(str(found.get("name")))
            elif line.strip() and not is_cut_off(line):
                self.unreadable += 1
        return self._lines

    def survey(self) -> dict[str, Any] | None:
        """Return the line of the valid survey.

        It is the first (two builders that make one at once make the same), or the last extension of it: each names the
        surveys before it as its ``predecessors``, the last of which it extends.

        Raises
        ------
        PeriluneError
            If it is foreign, or all are of another header: extremals of one problem would be polished to those of
            another, and need not be its best.
        """
        found, others = None, False
        for line in self.lines():
            if line.get("kind") == "survey":
                with damage_text(MANIFEST):
                    refuse_no_survey(line)
                if line.get("header") != self.seal:
                    others = True
                elif line.get("predecessors", [])[-1:] == ([] if found is None else [found["digest"]]):
                    found = line
        if others and found is None and self.seal:
            raise PeriluneError(
                f"the atlas is damaged: {HEADER} and {MANIFEST} belong to two atlases", got=str(self.directory),
                expected="the files of one, as they were written",
                advice=f"copy the whole directory again; reopen an atlas that was replaced meanwhile; or {_ANEW}",
            )  # fmt: skip
        return found

    def bricks(self, survey: Mapping[str, Any], d: int) -> list[dict[str, Any]]:
        """Return the lines of the blocks of a survey of d axes, and of those that it extends; errors of `survey`.

        Parameters
        ----------
        survey
            Line of the survey.
        d
            Number of axes.
        """
        mine, charts = {survey["digest"], *survey.get("predecessors", [])}, len(survey["charts"])
        found = [line for line in self.lines() if line.get("kind") == "brick" and line.get("survey") in mine]
        with damage_text(MANIFEST):
            for line in found:
                refuse_no_brick(line, d, charts)
        return found

    def latest(
        self, survey: Mapping[str, Any], d: int, rounds: float = math.inf
    ) -> dict[tuple[int, ...], dict[str, Any]]:
        """Return the last line of each block by chart and numbers, of so many rounds; otherwise as `bricks`.

        Parameters
        ----------
        survey
            Line of the survey.
        d
            Number of axes.
        rounds
            Number of the last round whose lines count.
        """
        lines = (line for line in self.bricks(survey, d) if line.get("round", 0) <= rounds)
        return {(line["chart"], *line["brick"]): line for line in lines}

    def ended(self, survey: Mapping[str, Any], d: int) -> bool:
        """Return True if a builder completed a survey, and no line of a block was lost since; errors of `survey`.

        Parameters
        ----------
        survey
            Line of the survey.
        d
            Number of axes.
        """
        return end_line(survey, self.bricks(survey, d)) in self.lines()

    def samples(self, digest: Any, nodes: int, d: int) -> list[dict[str, Any]]:
        """Return the lines of samples of a survey of d axes with so many nodes; errors of `survey`.

        Parameters
        ----------
        digest
            Digest of the survey.
        nodes
            Number of nodes of the atlas when the sample was drawn.
        d
            Number of axes.
        """
        found = [line for line in self.lines() if line.get("kind") == "sample"]
        with damage_text(MANIFEST):
            for line in found:
                refuse_no_sample(line, d)
        return [line for line in found if line.get("survey") == digest and line.get("nodes") == nodes]

    def there(self, name: str) -> bool:
        """Return True if a block was written, perhaps by another builder meanwhile."""
        self.lines()
        return name in self._names

    def add(self, line: Mapping[str, Any]) -> None:
        """Add a line to the manifest, by one write.

        Raises
        ------
        PeriluneError
            If there is no space left.
        """
        content = (written_line(line) + "\n").encode()
        try:
            handle = os.open(self.directory / MANIFEST, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
            try:
                size = os.fstat(handle).st_size
                if size:
                    os.lseek(handle, size - 1, os.SEEK_SET)
                    if os.read(handle, 1) != b"\n":  # a writer was killed in the middle of its line
                        content = b"\n" + content
                if os.write(handle, content) != len(content):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                os.fsync(handle)
            finally:
                os.close(handle)
        except OSError as error:
            raise unwritable_atlas_error(MANIFEST, error) from error

    def write_lines(self, lines: Iterable[Mapping[str, Any]]) -> None:
        """Write the whole manifest at once, in place of an existing one."""
        self._put(MANIFEST, "".join(written_line(line) + "\n" for line in lines).encode())

    def has(self, name: str, said: Mapping[str, Any]) -> bool:
        """Return True if a shard of a name exists with the content that a line states of another.

        Parameters
        ----------
        name
            File name of the shard.
        said
            Entry of the other, with its ``sha256``.
        """
        try:
            return hashlib.sha256((self.directory / name).read_bytes()).hexdigest() == said.get("sha256")
        except OSError:
            return False

    def put(self, name: str, array: NDArray[Any]) -> dict[str, Any]:
        """Write a shard; return its entry in the manifest.

        Parameters
        ----------
        name
            Name of the file.
        array
            Structured array, (rows,).

        Raises
        ------
        PeriluneError
            If it cannot be written.
        """
        content = io.BytesIO()
        np.save(content, array, allow_pickle=False)
        data = content.getvalue()
        self._put(name, data)
        return {"file": name, "rows": len(array), "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}

    def shard(self, said: Mapping[str, Any], dtype: np.dtype[Any]) -> NDArray[Any]:
        """Return a shard as an array that reads the file on access.

        Parameters
        ----------
        said
            Entry in the manifest: file, rows, bytes, sha256.
        dtype
            Columns that it must have.

        Raises
        ------
        PeriluneError
            If it is missing, altered, or not what it should be; it is named.
        """
        name = str(said.get("file"))
        path = self.directory / name
        if not _OURS.fullmatch(name):
            raise damaged_shard_error(name[:60], "no name of a shard")
        try:
            altered = hashlib.sha256(path.read_bytes()).hexdigest() != said.get("sha256")
            found = None if altered else np.load(path, mmap_mode="r", allow_pickle=False)
        except PermissionError as error:
            raise unreadable_file_error(name, error) from error
        except (OSError, ValueError, EOFError) as error:
            raise damaged_shard_error(name, str(error)[:80]) from error
        if found is None:
            raise damaged_shard_error(name, "content that does not match its checksum")
        if found.dtype != dtype or found.ndim != 1 or len(found) != said.get("rows"):
            raise damaged_shard_error(name, f"{found.dtype} {found.shape}"[:80])
        return found

    def claimed(self, name: str) -> contextlib.AbstractContextManager[bool]:
        """Lock a brick for the block; it has False if another process holds the brick."""
        return locked_file(self.directory / f".claim-{name}")

    def settled(self, name: str) -> None:
        """Remove the file by which a block was claimed; another process finds the finished block."""
        (self.directory / f".claim-{name}").unlink(missing_ok=True)

    def tidy(self) -> None:
        """Remove the files that killed or late builders leave, of blocks that exist meanwhile."""
        for file in self.directory.glob(".writing-*"):
            if (self.directory / file.name.split("-", 2)[-1]).exists():
                file.unlink(missing_ok=True)
        for file in self.directory.glob(".claim-*"):
            if self.there(name := file.name.removeprefix(".claim-")):
                self.settled(name)

    def _put(self, name: str, content: bytes) -> None:
        temporary = self.directory / f".writing-{os.getpid()}-{name}"
        try:
            with temporary.open("wb") as opened:
                opened.write(content)
                opened.flush()
                os.fsync(opened.fileno())
            os.replace(temporary, self.directory / name)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise unwritable_atlas_error(name, error) from error


def clear_atlas(directory: Path) -> None:
    """Remove the files of an atlas, and no others."""
    with contextlib.suppress(FileNotFoundError):
        for file in list(directory.iterdir()):
            if is_atlas_file(file.name):
                file.unlink()


def is_atlas_file(name: str) -> bool:
    """Return True if a file of this name belongs to an atlas."""
    return name in (HEADER, MANIFEST) or name.startswith((".claim-", ".writing-")) or bool(_OURS.fullmatch(name))
