"""Progress and time limits of long computations.

A computation reports to a `Watch`: each iteration, and lines of text. Deep inside of it, where no watch is passed,
`sign_of_life` is one for the computation that is at work in this context (`contextvars`): it is told at most once
a second, and is where a time limit takes effect. A limit that is not met changes nothing.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

_SIGN_EVERY = 1.0  # s between two signs of life that are told


@dataclass(frozen=True, kw_only=True)
class Iteration:
    """Iteration of Newton's method or of a mesh: norms are scaled, damping is alpha of Cho et al. 2015 (23)."""

    number: int
    residual: float
    step: float
    damping: float


# Receives each iteration, and lines of text.
Watch = Callable[[Iteration | str], None]


def ignore_events(event: Iteration | str) -> None:
    """Ignore an event."""


class TimeLimitReached(BaseException):
    """End of a computation's time limit; no `Exception`, which a method would try to recover from.

    Attributes
    ----------
    tried
        Attempts of a search until then.
    """

    def __init__(self) -> None:
        super().__init__("the time limit is reached")
        self.tried: tuple[str, ...] = ()


@dataclass
class Progress:
    """Computation at work: a `Watch` that passes events on, and ends the work when its time is over.

    Parameters
    ----------
    watch
        Receives the events.
    subject
        What is computed, by which `remember_best` tells whether a flight is one of it.
    limit
        Time [s] that it may take, without bound if infinite.
    outer
        The computation of which this one is a part.
    """

    watch: Watch
    subject: Any = None
    limit: float = math.inf
    outer: Progress | None = None
    stage: str = ""
    best: tuple[bool, float, Callable[[], Any]] | None = None

    def __post_init__(self) -> None:
        self.began: float = time.monotonic()
        self.heard: float = self.began

    def __call__(self, event: Iteration | str) -> None:
        """Pass an event on."""
        self.demand_time()
        self.heard = time.monotonic()
        if isinstance(event, str) and event:
            self.stage = event
        self.watch(event)

    def demand_time(self) -> None:
        """End the work once its time is over, or the time of the work of which it is a part.

        Raises
        ------
        TimeLimitReached
            If it is.
        """
        if self.outer is not None:
            self.outer.demand_time()
        if time.monotonic() - self.began > self.limit:
            self.limit = math.inf  # what is said of the end takes time as well
            raise TimeLimitReached

    def at_work(self, text: str) -> None:
        """Report a sign of life if nothing was reported for a second."""
        self.demand_time()
        if time.monotonic() - self.heard > _SIGN_EVERY:
            self(text)

    def flight(self) -> tuple[Any, bool] | None:
        """Return the best flight known so far, and True if it is an extremal; None without any flight."""
        return None if self.best is None else (self.best[2](), self.best[0])


_AT_WORK: ContextVar[Progress | None] = ContextVar("_AT_WORK", default=None)


@contextmanager
def enter_computation(watch: Watch | None, subject: Any = None, limit: float = math.inf) -> Iterator[Progress]:
    """Enter a computation, as a part of the one at work in this context, if any.

    Parameters
    ----------
    watch
        Receives its events; one that is at work already goes on.
    subject, limit
        As of `Progress`.
    """
    if isinstance(watch, Progress):
        yield watch
        return
    made = Progress(watch or ignore_events, subject, limit, outer=_AT_WORK.get())
    token = _AT_WORK.set(made)
    try:
        yield made
    finally:
        _AT_WORK.reset(token)


def sign_of_life(text: Iteration | str) -> None:
    """Report a sign of life of the computation at work, if any; also a `Watch` for a part that reports no more.

    Raises
    ------
    TimeLimitReached
        If its time is over.
    """
    if (now := _AT_WORK.get()) is not None:
        now.at_work(text if isinstance(text, str) else now.stage)


def remember_best(
    subject: Any, objective: float, told: Callable[[], str], flight: Callable[[], Any], *, extremal: bool
) -> None:
    """Remember and report the best flight of a computation, unless a better one is known.

    Parameters
    ----------
    subject
        The problem of the flight; of another than that which is computed nothing is remembered.
    objective, told
        J, and what makes the words that are told of it: of what nobody is told they are not asked for.
    flight
        Makes it.
    extremal
        Whether it is an extremal, which is better than a rough flight.
    """
    now = _AT_WORK.get()
    if now is None or now.subject is not subject:
        return
    if now.best is None or (extremal, -objective) >= (now.best[0], -now.best[1]):
        now.best = extremal, objective, flight
        stage = now.stage
        now(f"best so far: {told()}")
        now.stage = stage  # a flight that is known is no stage of the work
