"""Locks of files by which builders of one atlas share its bricks; a process that dies releases its own."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from perilune.atlas.store.file_errors import unwritable_atlas_error

try:
    import fcntl
except ImportError:  # Windows: two builders may compute the same brick there
    fcntl = None

_claims = set[int]()  # files by which this process holds what it computes


@contextlib.contextmanager
def locked_file(file: Path) -> Iterator[bool]:
    """Create a file and lock it for the block; yield False if another process holds it.

    Raises
    ------
    PeriluneError
        If it cannot be written.
    """
    if fcntl is None:
        yield True
        return
    try:
        handle = os.open(file, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise unwritable_atlas_error(file.name, error) from error
    _claims.add(handle)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            ours = file.stat().st_ino == os.fstat(handle).st_ino  # else who held it before has removed it
        except OSError:
            ours = False
        yield ours
    finally:
        _claims.discard(handle)
        os.close(handle)


def _release_inherited_locks() -> None:
    """Release inherited locks in a forked worker, which may outlive its builder."""
    for handle in _claims:
        os.close(handle)
    _claims.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_release_inherited_locks)
