"""Outcomes of computations, and errors that state why one failed.

Every answer leaves with an `Outcome`, whose value is the advice, and which has its exit code. Every refusal is a
`PeriluneError` that says *what* is wrong, what was *got*, what was *expected* and what to *try*.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import Any, ClassVar, NoReturn, TypeVar

from perilune.core.renaming import warn_renamed

Kept = TypeVar("Kept")


class Outcome(Enum):
    """Outcome of a solve; the value is the advice to the reader."""

    PROVED = "every check of the requested verification level passed"
    SOLVED = (
        "the method converged; nothing is verified yet: use perilune verify DIR for what --out DIR saved, or pl.verify"
    )
    NOT_PROVED = "solved, but at least one check failed: read the failed checks before using it"
    NOT_CONVERGED = "no solution was found: the residual report names the condition and what to try"
    INFEASIBLE = (
        "no feasible flight exists, or all extremals found violate a bound: the message says which and by how much"
    )
    REFUSED = "the statement of the problem is invalid: the message says what is wrong"
    INTERRUPTED = "stopped by the user: what was computed so far is kept"

    @property
    def exit_code(self) -> int:
        """Exit code of the command line for this outcome."""
        return _EXIT_CODES[self.name]


_SHORT_LIST = 6  # names, which a reader takes in at a glance, in their own order
# The two reasons of a refusal: a bound that holds for every flight, and a search that found none.
CANNOT_BE_FLOWN = "cannot be flown"
BEST_MISSES = "the best found violates it"

_EXIT_CODES = {
    "PROVED": 0,
    "SOLVED": 5,
    "NOT_PROVED": 5,
    "NOT_CONVERGED": 4,
    "INFEASIBLE": 3,
    "REFUSED": 2,
    "INTERRUPTED": 130,
}


class Partial(dict[str, Any]):
    """Entries that a failure keeps, by name; old names are read with a `DeprecationWarning`."""

    _RENAMED: ClassVar[dict[str, str]] = {
        "tried": "attempts", "missed": "violations", "all_missed": "all_infeasible", "settled": "converged"
    }  # fmt: skip

    def __missing__(self, key: str) -> Any:
        if self._RENAMED.get(key) not in self:
            raise KeyError(key)
        return self._by_old_name(key)

    def get(self, key: str, default: Any = None) -> Any:
        """Return the entry of a name, or of its old one.

        Parameters
        ----------
        key
            The name.
        default
            What is returned where there is no entry.
        """
        if key in self or self._RENAMED.get(key) not in self:
            return super().get(key, default)
        return self._by_old_name(key)

    def _by_old_name(self, key: str) -> Any:
        new = self._RENAMED[key]
        warn_renamed(f"partial[{key!r}]", f"partial[{new!r}]", 2)
        return self[new]


class PeriluneError(ValueError):
    """A refusal in four parts: what, got, expected, try.

    Parameters
    ----------
    what
        What is wrong, in the user's words.
    got, expected
        The offending value and what would be right; either may be empty.
    advice
        What to try.
    """

    exit_code = 2

    def __init__(self, what: str, *, got: str = "", expected: str = "", advice: str = "") -> None:
        self.what: str = what
        self.got: str = got
        self.expected: str = expected
        self.advice: str = advice
        parts = [what]
        parts += [f"{word}: {text}" for word, text in (("got", got), ("expected", expected), ("try", advice)) if text]
        super().__init__("\n  ".join(parts))

    def __reduce__(self) -> tuple[Any, ...]:
        return _as_it_was, (type(self), self.args, self.__dict__)


def _as_it_was(kind: type[PeriluneError], arguments: tuple[Any, ...], parts: dict[str, Any]) -> PeriluneError:
    """Rebuild an error on the other side of a process border."""
    error = kind.__new__(kind, *arguments)
    error.__dict__.update(parts)
    return error


class InfeasibleError(PeriluneError):
    """Refusal of a problem as infeasible; the message says which limit is missed and by how much.

    `reason` is `CANNOT_BE_FLOWN` or `BEST_MISSES`; for the latter `partial` says what was searched.
    """

    exit_code = 3

    def __init__(
        self,
        what: str,
        *,
        got: str = "",
        expected: str = "",
        advice: str = "",
        reason: str = CANNOT_BE_FLOWN,
        partial: dict[str, Any] | None = None,
    ) -> None:
        super().__init__(what, got=got, expected=expected, advice=advice)
        self.reason = reason
        self.partial: dict[str, Any] = Partial(partial or {})

    def __str__(self) -> str:
        what, *parts = super().__str__().split("\n")
        return "\n".join([what, f"  reason: {self.reason}", *parts])


class NotConvergedError(PeriluneError):
    """Failure of every way of starting.

    `partial` carries what was computed before: the best iterate's residuals in physical units and the `attempts`.
    `flight` is the best flight that was found, a Solution though no extremal, or None: `partial["violations"]` says
    what it violates, if anything, and its `statistics.residual` how rough its mesh is.
    """

    exit_code = 4

    def __init__(
        self,
        what: str,
        *,
        got: str = "",
        expected: str = "",
        advice: str = "",
        partial: dict[str, Any] | None = None,
        flight: Any = None,
    ) -> None:
        super().__init__(what, got=got, expected=expected, advice=advice)
        self.partial: dict[str, Any] = Partial(partial or {})
        self.flight = flight


class UnknownKindError(PeriluneError):
    """Unknown kind of problem: neither built in nor brought by an installed package."""


def unknown_name(kind: str, got: object, known: Sequence[str], also: Mapping[str, str] | None = None) -> PeriluneError:
    """Return the error for an unknown name, with the nearest one offered; a long list begins with the nearest.

    Parameters
    ----------
    kind, got
        Kind of the name in words, and the name.
    known, also
        Known names; other names, each with the known one that it stands for.
    """
    import difflib

    called = str(got)  # names of a mapping may be anything
    alike_at_least = 0.6 if len(called) > 3 else 0.5  # of two letters one may be wrong
    meant = {**{name: name for name in known}, **(also or {})}
    begun = [name for name in meant if called and name.startswith(called)]
    near = [meant[name] for name in begun if len(begun) == 1] or [
        meant[name] for name in difflib.get_close_matches(called, meant, n=1, cutoff=alike_at_least)
    ]
    if len(known) > _SHORT_LIST:
        likeness = difflib.SequenceMatcher(b=called)

        def alike(name: str) -> float:
            likeness.set_seq1(name)
            return likeness.ratio()

        known = sorted(known, key=alike, reverse=True)
    return PeriluneError(
        f"there is no {kind} of this name",
        got=repr(called[:60]),
        expected="one of " + ", ".join(known) if known else "none exist",
        advice=f"did you mean {near[0]!r}?" if near else "",
    )


class Named(dict[str, Kept]):
    """Dictionary whose error for an unknown key lists the known ones; `kind` is the kind of the names."""

    def __init__(self, kind: str, entries: Mapping[str, Kept]) -> None:
        super().__init__(entries)
        self.kind = kind

    def __missing__(self, name: object) -> NoReturn:
        raise unknown_name(self.kind, name, list(self))
