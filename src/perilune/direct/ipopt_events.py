"""Events of IPOPT while it searches: signs of life, and a user's interrupt."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from threading import current_thread, main_thread
from typing import Any, TextIO

import casadi as ca

from perilune.core import sign_of_life


class IterationCallback(ca.Callback):
    """A sign of life at each iteration of IPOPT; what it raises is raised again when IPOPT has ended."""

    def __init__(self, unknowns: int, rows: int, given: int) -> None:
        super().__init__()
        self.sizes = {"x": unknowns, "f": 1, "g": rows, "lam_x": unknowns, "lam_g": rows, "lam_p": given}
        self.begin()
        self.construct("alive", {})

    def begin(self) -> None:
        """Begin a search."""
        self.raised: BaseException | None = None
        self.count = 0

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
        except BaseException as error:
            self.raised = error
        return [int(self.raised is not None)]


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
