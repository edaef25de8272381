"""Cache of machine code on disk, between processes.

A file is one object: a line that says what it is, the SHA-256 digest of the content, and the content. Its
name is the digest of all that the code depends on: expressions, what this package's own source does, processor and
versions. Comments and docstrings do nothing: who edits them compiles nothing anew. Writing goes to a file of its own
that is then renamed, so that a second process or a killed writer never shows half a file; a file whose digest does not
fit is removed and compiled again. Nothing is ever unpickled. Where the files grow beyond `MOST_BYTES`, those that were
not used for longest go, those of older versions first of all.

The directory is that of the operating system for caches, or the environment variable ``PERILUNE_CACHE``, which
may also be ``off``. It must be writable by its owner only, since code from it is run.
"""

from __future__ import annotations

import ast
import hashlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

_HEADER = b"perilune machine code 1\n"
_SUFFIX, _PART = ".code", ".part"
MOST_BYTES = 160 * 2**20  # all tests together take about 90 MB
_OFTEN = 1 / 64  # of it are kept by a process before it looks through the folder, which takes longer than keeping one
_new = [float("inf")]  # bytes kept since then; at first what others left is looked through
_LEFT_OVER = 3600.0  # seconds after which the file of a writer is that of a killed one
VARIABLE, OFF = "PERILUNE_CACHE", "off"


@dataclass(frozen=True, kw_only=True)
class CacheReport:
    """The cache as `doctor` shows it: path (None if nothing is kept), files, bytes, whether it can be used."""

    path: Path | None
    files: int
    size: int
    usable: bool


def directory() -> Path | None:
    """Return where objects are kept, which need not exist; None if they are not, by choice or for want of a home."""
    if chosen := os.environ.get(VARIABLE):
        return None if chosen == OFF else Path(chosen)
    try:
        if sys.platform == "win32":
            base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
        elif sys.platform == "darwin":
            base = Path.home() / "Library" / "Caches"
        else:
            base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # a user without a home
        return None
    return base / "perilune" / "kernels"


@lru_cache(maxsize=1)
def source_digest() -> str:
    """Return the digest of the code that generates code, so that no older version's object is taken."""
    sources = [path.read_bytes() for path in sorted(Path(__file__).parents[1].rglob("*.py"))]
    digest = hashlib.sha256(b"source")
    for source in sources:
        digest.update(hashlib.sha256(source).digest())
    if directory() is None:
        return digest.hexdigest()
    # To read the syntax takes a hundred times as long as to read the files: it is kept, by what they hold.
    return fetch_object(digest.hexdigest(), lambda: syntax_digest(sources).encode(), enabled=True).decode()


def syntax_digest(sources: Iterable[bytes]) -> str:
    """Return the digest of what modules do: of their syntax trees, without docstrings.

    Parameters
    ----------
    sources
        The text of each module.
    """
    digest = hashlib.sha256()
    for source in sources:
        tree = ast.parse(source)
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                if ast.get_docstring(node, clean=False) is not None:
                    del node.body[0]
        digest.update(f"{ast.dump(tree)}\n".encode())
    return digest.hexdigest()


def object_key(*parts: str) -> str:
    """Return the digest of all that an object depends on: this package's source, then parts such as equations."""
    digest = hashlib.sha256()
    for part in (source_digest(), *parts):
        digest.update(f"{len(part)}:".encode() + part.encode())
    return digest.hexdigest()


def load_object(name: str) -> bytes | None:
    """Return the object of a key, or None; a file that is not what was written is removed."""
    folder = directory()
    if folder is None:
        return None
    path = folder / (name + _SUFFIX)
    try:
        if not _is_private_to_user(folder) or not _is_private_to_user(path):
            return None
        content = path.read_bytes()
    except OSError:
        return None
    body = content[len(_HEADER) + 32 :]
    # The name is in the digest: a file copied to another's name is foreign, whole though it is.
    if content.startswith(_HEADER) and content[len(_HEADER) : len(_HEADER) + 32] == _object_digest(name, body):
        with suppress(OSError):
            os.utime(path)  # it is in use
        return body
    with suppress(OSError):
        path.unlink()
    return None


def is_cached(name: str) -> bool:
    """Return True if the object of a key is on disk; whether it is whole shows when it is loaded."""
    folder = directory()
    return folder is not None and (folder / (name + _SUFFIX)).is_file()


def store_object(name: str, body: bytes) -> bool:
    """Keep an object; returns False where there is no directory that can be written, which is no error.

    Parameters
    ----------
    name
        Digest of all that the code depends on (hexadecimal); the name of the file without its suffix.
    body
        Object file of the compiler.
    """
    folder = directory()
    if folder is None:
        return False
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        handle, temporary = tempfile.mkstemp(dir=folder, suffix=_PART)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(_HEADER + _object_digest(name, body) + body)
            os.replace(temporary, folder / (name + _SUFFIX))
        except BaseException:
            with suppress(OSError):
                os.unlink(temporary)
            raise
        _new[0] += len(body)
        if _new[0] > _OFTEN * MOST_BYTES:
            _new[0] = 0.0
            _evict_oldest(folder)
    except OSError:
        return False
    return True


def _evict_oldest(folder: Path) -> None:
    """Remove what was not used for longest while there is too much, and what killed writers left."""
    files, parts = [], []
    with os.scandir(folder) as entries:
        for entry in entries:
            with suppress(OSError):  # another process may be pruning
                if entry.name.endswith(_SUFFIX):
                    files.append((entry.stat().st_mtime, entry.stat().st_size, entry.path))
                elif entry.name.endswith(_PART) and time.time() - entry.stat().st_mtime > _LEFT_OVER:
                    parts.append(entry.path)
    excess = sum(size for _, size, _ in files) - MOST_BYTES
    for _, size, path in sorted(files):
        if excess <= 0:
            break
        excess -= size
        parts.append(path)
    for path in parts:
        with suppress(OSError):
            os.unlink(path)


def fetch_object(name: str, build: Callable[[], bytes], *, enabled: bool) -> bytes:
    """Return the object from disk, or build and keep it.

    Parameters
    ----------
    name
        Key of the object.
    build
        Compiles the object.
    enabled
        False to build without the cache.
    """
    if not enabled:
        return build()
    body = load_object(name)
    if body is None:
        body = build()
        store_object(name, body)
    return body


def report_cache() -> CacheReport:
    """Return the state of the cache."""
    folder = directory()
    if folder is None:
        return CacheReport(path=None, files=0, size=0, usable=False)
    files = list(folder.glob(f"*{_SUFFIX}"))
    existing = next(p for p in (folder, *folder.parents) if p.exists())
    return CacheReport(
        path=folder,
        files=len(files),
        size=sum(f.stat().st_size for f in files),
        usable=existing.is_dir()
        and os.access(existing, os.W_OK)
        and (not folder.exists() or _is_private_to_user(folder)),
    )


def clear_cache() -> int:
    """Remove every object and every leftover of a killed writer; returns how many."""
    folder, removed = directory(), 0
    if folder is None:
        return 0
    for path in [*folder.glob(f"*{_SUFFIX}"), *folder.glob(f"*{_PART}")]:
        with suppress(OSError):
            path.unlink()
            removed += 1
    return removed


def _object_digest(name: str, body: bytes) -> bytes:
    return hashlib.sha256(name.encode() + b"\n" + body).digest()


def _is_private_to_user(path: Path) -> bool:
    """Return True if only this user could have written it (where the operating system says)."""
    if not hasattr(os, "getuid"):
        return True
    status = path.stat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022
