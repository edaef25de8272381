"""Events of IPOPT while it searches: signs of life, the end of a search that gains nothing, and a user's interrupt."""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from threading import current_thread, main_thread
from typing import Any, TextIO

import casadi as ca
import numpy as np

from perilune.core.arrays import Vector
from perilune.core.callbacks import sign_of_life

_UNCHANGED = 30  # iterations in which the least miss has to become less
_LESS = 0.98  # times the least before them
_NEAR = 1.1  # times the least: what misses by more is on its way
_FLIES = 1e-2  # canonical: what breaks the dynamics by less is nearly a flight
_SURELY = 1e-2  # canonical, squared: a miss that is less may still become none


class LeastMissProgress:
    """Progress of a search for the flight that misses least, whose objective is the miss squared.

    What cannot be flown is missed by about the same from some tens of iterations on, and IPOPT polishes that until its
    iterations are used up, as dynamics and miss compete.
    """

    def __init__(self) -> None:
        self._least = list[float]()  # of all flights until each iteration

    def is_stalled(self, miss: float, violation: float) -> bool:
        """Return True at a flight if no flight of the last iterations misses by less than those before.

        Parameters
        ----------
        miss
            Objective of an iterate, canonical and squared.
        violation
            Largest violation of its dynamics and links, canonical.
        """
        flies, before = violation < _FLIES, self._least[-1] if self._least else math.inf
        self._least.append(min(before, miss) if flies else before)
        if not flies or len(self._least) <= _UNCHANGED or miss > _NEAR * self._least[-1]:
            return False
        return self._least[-1] > max(_SURELY, _LESS * self._least[-1 - _UNCHANGED])


class IterationCallback(ca.Callback):
    """A sign of life at each iteration of IPOPT, which ends where a search for the least miss is stalled.

    What a sign of life raises is raised again when IPOPT has ended.
    """

    def __init__(self, unknowns: int, rows: int, given: int) -> None:
        super().__init__()
        self.sizes = {"x": unknowns, "f": 1, "g": rows, "lam_x": unknowns, "lam_g": rows, "lam_p": given}
        self.begin()
        self.construct("alive", {})

    def begin(self, bounds: tuple[Vector, Vector] | None = None) -> None:
        """Begin a search; one for the least miss has bounds of its rows."""
        self.raised: BaseException | None = None
        self.count, self.stalled = 0, False
        self.bounds, self.progress = bounds, LeastMissProgress()

    def get_n_in(self) -> int:
        """Return the number of inputs, which are the outputs of a solver."""
        return ca.nlpsol_n_out()

    def get_n_out(self) -> int:
        """Return the number of outputs."""
        return 1

    def get_name_in(self, i: int) -> str:
        """Return the name of an input."""
        return ca.nlpsol_out(i)

    def get_name_out(self, i: int) -> str:
        """Return the name of the output."""
        return "ret"

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of an input."""
        return ca.Sparsity.dense(self.sizes[ca.nlpsol_out(i)], 1)

    def eval(self, arg: Any) -> list[int]:
        """Return 1 where IPOPT has to end, else 0."""
        self.count += 1
        try:
            sign_of_life(f"direct method: iteration {self.count} of the nonlinear program")
            self.stalled = self.bounds is not None and self._gains_nothing(arg, *self.bounds)
        except BaseException as error:
            self.raised = error
        return [int(self.stalled or self.raised is not None)]

    def _gains_nothing(self, arg: Any, low: Vector, high: Vector) -> bool:
        values = dict(zip(map(ca.nlpsol_out, range(len(arg))), arg, strict=True))
        rows = np.array(values["g"]).ravel()
        violation = max(np.max(low - rows, initial=0.0), np.max(rows - high, initial=0.0))
        return self.progress.is_stalled(float(values["f"]), float(violation))


class _WholeLines(io.StringIO):
    """Whole lines to a stream, which come in pieces; without CasADi's line for Ctrl-C, as there is one of ours."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self.stream = stream

    def write(self, text: str) -> int:
        *lines, rest = (self.getvalue() + text).splitlines(keepends=True) or [""]
        if rest.endswith("\n"):
            lines, rest = [*lines, rest], ""
        self.stream.write("".join(line for line in lines if "KeyboardInterruptException" not in line))
        self.seek(0)
        self.truncate()
        super().write(rest)
        return len(text)


@contextmanager
def rewrite_interrupt_messages() -> Iterator[None]:
    """Rewrite the interrupt messages on standard error, in the main thread, the only one that Ctrl-C reaches."""
    if current_thread() is not main_thread():
        yield
        return
    lines = _WholeLines(sys.stderr)
    try:
        with redirect_stderr(lines):
            yield
    finally:
        sys.stderr.write(lines.getvalue())
