"""Errors of the files of an atlas: unusable, unwritable, unreadable or damaged."""

from __future__ import annotations

import errno
from pathlib import Path

from perilune.core import PeriluneError


def unusable_atlas_error(
    place: Path, got: str, expected: str, advice: str = "choose another directory"
) -> PeriluneError:
    """Return the error of a directory that cannot serve as this atlas.

    Parameters
    ----------
    place
        Directory of the atlas.
    got, expected, advice
        Parts of the message.
    """
    return PeriluneError(f"this atlas cannot be used: {place}", got=got, expected=expected, advice=advice)


def unwritable_atlas_error(name: str, error: OSError) -> PeriluneError:
    """Return the error of a file that cannot be written.

    Parameters
    ----------
    name
        Name of the file.
    error
        Error of the operating system.
    """
    helps = (
        "check its permissions" if isinstance(error, PermissionError) or error.errno == errno.EROFS else "free space"
    )
    return PeriluneError(
        "the atlas cannot be written", got=f"{name}: {error.strerror}",
        expected="a directory that you may write, with space left",
        advice=f"existing files are kept: {helps}, and run the same command again (atlas build: with --resume)",
    )  # fmt: skip


def unreadable_file_error(name: str, error: OSError) -> PeriluneError:
    """Return the error of a file that cannot be read.

    Parameters
    ----------
    name
        Name of the file.
    error
        Error of the operating system.
    """
    return PeriluneError(
        f"a file of the atlas cannot be read: {name}", got=str(error.strerror), expected="a file that you may read",
        advice="check its permissions",
    )  # fmt: skip


def damaged_shard_error(name: str, got: str) -> PeriluneError:
    """Return the error of a shard that differs from what was written.

    Parameters
    ----------
    name
        Name of the file.
    got
        Description of what was read.
    """
    again = "the rest still serves; remove its line from manifest.jsonl; perilune atlas extend DIR builds it again"
    if name.startswith("survey-"):  # without its line it is unknown where branches are
        again = "remove its line from manifest.jsonl, and run the command that built it again: atlas build ... --resume"
    return PeriluneError(
        f"a shard of the atlas is damaged: {name}", got=got, expected="the file as it was written", advice=again
    )
