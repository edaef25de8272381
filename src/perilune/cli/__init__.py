"""The command line: ``perilune COMMAND``; `perilune.cli.arguments` lists the commands.

Answers go to stdout, progress and refusals to stderr; with ``--json`` stdout holds exactly one JSON document,
for a refusal too. Exit codes: 0 done and proved, 1 a fault of this program, 2 bad scenario or usage, 3
infeasible, 4 not converged, 5 solved but not proved, 130 interrupted.

Everything heavy is imported inside the commands, so that ``--help`` is quick.
"""

from __future__ import annotations

import _signal  # pyright: ignore[reportMissingImports] - what `signal` is made of, without the time its names take
import gc
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import NoReturn


def main() -> NoReturn:
    """Run the command line of the process; entry point of the console script."""
    heeded = _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler  # a job in the background ignores Ctrl-C
    if heeded:
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)  # it ends without a word until there is somebody to say one
    import signal

    from perilune.cli.interrupts import handle_interrupt

    if heeded:
        signal.signal(signal.SIGINT, handle_interrupt)
    # Before NumPy is loaded: the matrices are tiny, and threads that wait for each other cost more than they give.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Imports make a hundred thousand objects that stay: looking through them again and again takes long.
    gc.set_threshold(200_000)
    _fill_closed_streams()
    code = run_command_line(sys.argv[1:])
    if signal.getsignal(signal.SIGINT) is handle_interrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is said, and the exit code is that of what was said
    gc.freeze()  # nor at the end, where all of them go anyway
    _exit_process(code)


def _exit_process(code: int) -> NoReturn:
    """End the program; at once where a thread still computes, for which nobody waits.

    At an ordinary end C++ takes its globals away from below machine code that runs or is made, which crashes. All is
    said by now, and written; what Python's own libraries do at the end, as to free semaphores, is done here.
    """
    import threading

    if any(thread.daemon for thread in threading.enumerate()):
        import atexit

        try:
            atexit._run_exitfuncs()
        finally:
            os._exit(code)
    sys.exit(code)


def _fill_closed_streams() -> None:
    """Open the null device for each closed stream (``2>&-``), else a file of ours gets its number and the output."""
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))


def run_command_line(arguments: Sequence[str]) -> int:
    """Run one command line; returns the exit code."""
    try:
        from perilune.cli.commands import run_command

        return run_command(arguments)
    except KeyboardInterrupt:
        # The commands answer for themselves; here is only who was quicker than the imports.
        from perilune.cli.output import INTERRUPTED, interrupted_error, print_answer, refusal_answer

        return print_answer(refusal_answer(interrupted_error(), INTERRUPTED), as_json="--json" in arguments)
