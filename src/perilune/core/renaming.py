"""Warning of an old name, for every line of a user that uses one."""

from __future__ import annotations

import sys
import warnings
from types import FrameType

_OLD_NAMES = "perilune.core.deprecation"  # whose `attribute` finds an old name


def warn_renamed(old: str, new: str, depth: int = 1) -> None:
    """Warn that a name is another one now.

    Parameters
    ----------
    old, new
        The two names, as a user writes them.
    depth
        Number of calls between the user's line and the caller of this function; those of `dataclasses.replace` and of
        old attributes are not counted.
    """
    frame = sys._getframe(depth + 1)
    while frame.f_back is not None and _is_nobodys(frame):
        frame, depth = frame.f_back, depth + 1
    warnings.warn(
        f"{old} is {new} now; the old name goes with the next minor version", DeprecationWarning, stacklevel=depth + 2
    )


def copies_records(frame: FrameType) -> bool:
    """Return True for a frame of `dataclasses.replace` or `copy.replace`."""
    return frame.f_globals.get("__name__") in ("dataclasses", "copy")


def _is_nobodys(frame: FrameType) -> bool:
    """Return True for a frame between a user's line and what it asks for."""
    return copies_records(frame) or (
        frame.f_code.co_name == "attribute" and frame.f_globals.get("__name__") == _OLD_NAMES
    )
