"""The library of answered problems: what any method that claims them has to find.

Each is an `Answered` record; `LIBRARY` holds them all, and ``tests/test_problems.py`` sweeps it. A problem is defined
here once, and tests that look at one of them more closely import its function from the module it lives in.
"""

from __future__ import annotations

from problems import ascents, delta, goddard, integrators, landings, orbit_raising, reentries, singular, staging
from problems.answered import Answered

LIBRARY: tuple[Answered, ...] = (
    *integrators.ANSWERED,
    *ascents.ANSWERED,
    *staging.ANSWERED,
    *orbit_raising.ANSWERED,
    *landings.ANSWERED,
    *goddard.ANSWERED,
    *singular.ANSWERED,
    *reentries.ANSWERED,
    *delta.ANSWERED,
)

__all__ = ["LIBRARY", "Answered"]
