"""Record of a proof: checks, each with a value, a limit and a meaning, and the level they reach.

Levels: 0 unverified; 1 feasible; 2 extremal; 3 locally optimal; 4 cross-checked by another method; 5 a theorem. A level
is reached when every check of it and of the levels below passed; but a theorem needs no other method.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

from perilune.core import (
    RenamedAttribute,
    check_call,
    method_function,
    renamed_keywords,
)
from perilune.problem.tolerance import Tolerance

LEVEL_NAMES = ("unverified", "feasible", "extremal", "locally optimal", "cross-checked", "theorem")
LEVELS = tuple(range(1, len(LEVEL_NAMES)))  # levels that may be requested
THEOREM = 5  # with those up to 3


@check_call
@dataclass(frozen=True, kw_only=True)
class Check:
    """One test of a solution.

    Parameters
    ----------
    name, meaning
        Short name, and what the check shows, in a sentence.
    level
        The level (1-5) that needs it.
    value, limit
        The check passes when ``value <= limit`` (a NaN fails).
    unit
        Unit of both.
    exact
        Whether a number is compared with its own copy, so that no stated tolerance applies.
    own_limit, raised_by
        Where a stated tolerance raised the limit: what it would be without, and the quantity that was stated.
    """

    name: str
    level: int
    value: float
    limit: float
    unit: str
    meaning: str
    exact: bool = False
    own_limit: float | None = None
    raised_by: str = ""
    limit_told: ClassVar[RenamedAttribute] = RenamedAttribute("format_limit")

    @property
    def passed(self) -> bool:
        """Return True if the value is within the limit; NaN never is."""
        return bool(self.value <= self.limit)

    @property
    def lenient(self) -> bool:
        """Return True if it passed only with the stated tolerance."""
        return self.own_limit is not None and self.passed and not self.value <= self.own_limit

    def format_limit(self, digits: int = 3) -> str:
        """Format the limit; one that was raised with its own."""
        own = "" if self.own_limit is None else f" stated, its own {self.own_limit:.{digits}g}"
        return f"limit {self.limit:.{digits}g}{own}"


def format_failed_checks(passed: Sequence[bool]) -> str:
    """Format what stands behind a level where checks failed, also those of a higher one; else nothing."""
    return f", NOT_PROVED: {passed.count(False)} of {len(passed)} checks failed" if False in passed else ""


@renamed_keywords(text="source")
@check_call
@dataclass(frozen=True, kw_only=True, repr=False)
class Verification:
    """All checks made of one solution.

    Parameters
    ----------
    checks
        In the order of their levels.
    source
        Where the integrated physics comes from: the problem's own Python functions, or expressions and where they
        came from (`Problem.source`).
    notes
        What was not checked, or could not be, in sentences.
    tolerance
        What was stated of differences that do not matter. Of a solution without checks, with what it is to be proved.
    certificate
        The statement and premises of a theorem, a tree for JSON; None without one.
    claimed
        Of a solution that was loaded: what its file says of its proof, which proves nothing.
    """

    checks: tuple[Check, ...] = ()
    source: str = ""
    notes: tuple[str, ...] = ()
    tolerance: Tolerance = field(default_factory=Tolerance)
    certificate: Mapping[str, Any] | None = field(default=None, compare=False)
    claimed: str = field(default="", compare=False)
    text: ClassVar[RenamedAttribute] = RenamedAttribute("source")
    told: ClassVar[RenamedAttribute] = RenamedAttribute("summary")
    within: ClassVar[RenamedAttribute] = RenamedAttribute("tolerance_used")

    @property
    def level(self) -> int:
        """Highest level such that it has checks and all checks up to it passed; a theorem without level 4 counts."""
        reached = 0
        for level in LEVELS:
            here = [c for c in self.checks if c.level == level]
            if here and not all(c.passed for c in here):
                break
            if (here and level == reached + 1) or (here and level == THEOREM and reached == THEOREM - 2):
                reached = level
        return reached

    @property
    def title(self) -> str:
        """The level and its name, as it stands with every outcome, and what of the stated tolerance it needed."""
        return self._claim or f"level {self.level}: {LEVEL_NAMES[self.level]}{self._qualified}"

    @property
    def summary(self) -> str:
        """The title with what failed, as it stands in exports."""
        return self.title + format_failed_checks([check.passed for check in self.checks])

    @property
    def headline(self) -> str:
        """The same as the first line of a list of checks."""
        return self._claim or f"level {self.level} ({LEVEL_NAMES[self.level]}){self._qualified}"

    @property
    def tolerance_used(self) -> str:
        """``within the stated tolerance (position 1 mm)``, if the level would not be reached without; else empty."""
        level = self.level
        needed = {c.raised_by for c in self.checks if c.lenient and c.level <= level}
        return f"within the stated tolerance ({self.tolerance.describe(needed)})" if needed else ""

    @property
    def _claim(self) -> str:
        return f"not verified again; its file claims {self.claimed}" if self.claimed and not self.checks else ""

    @property
    def _qualified(self) -> str:
        return f", {within}" if (within := self.tolerance_used) else ""

    @property
    def passed(self) -> bool:
        """Return True if checks were made and none failed."""
        return bool(self.checks) and all(c.passed for c in self.checks)

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that did not pass."""
        return tuple(c for c in self.checks if not c.passed)

    def __repr__(self) -> str:
        checks = f"; {len(self.checks) - len(self.failed)} of {len(self.checks)} checks passed" if self.checks else ""
        failed = f"; failed: {', '.join(check.name for check in self.failed)}" if self.failed else ""
        return f"<Verification {self.title}{checks}{failed}>"

    def _repr_html_(self) -> str:
        return method_function("verification_page")(self)

    def __str__(self) -> str:
        lines = [self.headline + (f", integrated: {self.source}" if self.source else "")]
        for c in self.checks:
            mark = "ok  " if c.passed else "FAIL"
            lines.append(f"  {mark} {c.level} {c.name}: {c.value:.3g} ({c.format_limit()}) {c.unit}")
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])
