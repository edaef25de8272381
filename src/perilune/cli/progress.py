"""Progress on stderr, warnings, and files kept after a failure."""

from __future__ import annotations

import re
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

from perilune import InfeasibleError, NotConvergedError, PeriluneError
from perilune.cli.interrupts import STOPPED, raise_pending_interrupt
from perilune.cli.output import INTERRUPTED, WrittenFiles, interrupted_error, print_to_stderr, refusal_answer

if TYPE_CHECKING:
    from rich.text import Text

    from perilune import Finding
    from perilune.core import Iteration
    from perilune.scenario import Scenario

LONGEST_LOG = 1000  # lines of progress that a failure keeps
_FIRST_WORD, _NEXT_WORD = 2.0, 5.0  # s: until the first word on what is at work, and between two of them
_BEST_SO_FAR = "best so far: "  # how `perilune.core.callbacks.remember_best` begins
WRITING = "writing figures and the report"  # of an answer: no flight is the best so far any more
_COUNT = re.compile(r"\d+ of \d+")  # members that are done, of all
_COUNTED = re.compile(r" \((\d+ of \d+)\).*")  # behind the name of a member


def _iteration_line(i: Iteration) -> str:
    return f"iteration {i.number:3d}  residual {i.residual:.3e}  step {i.step:.3e}  damping {i.damping:.3g}"


@contextmanager
def progress(verbose: bool, log: deque[str]) -> Iterator[Callable[[Iteration | str], None]]:
    """Yield a `watch` that keeps lines in `log`, and prints them if verbose.

    Work of more than two seconds shows its duration and present line: next to a spinner on a terminal, else in a line
    every few seconds.

    Parameters
    ----------
    verbose
        True to print every line on stderr.
    log
        Receives every line.
    """
    shown: AbstractContextManager[Any] = nullcontext()
    clock = WorkClock()
    show: Callable[[str], object] = print_to_stderr if verbose else str
    tick: Callable[[], object] = clock.print_line
    if not verbose and sys.stderr.isatty():
        from rich.console import Console

        console, told = Console(stderr=True), SpinnerText()
        shown = console.status("solving")
        spin, room = shown.update, console.width - 3  # beside the spinner
        show = lambda line: spin(told.line(clock.text(line), room))  # noqa: E731
        tick = lambda: spin(told.line(clock.text(), room))  # noqa: E731

    def watch(event: Iteration | str) -> None:
        line = event if isinstance(event, str) else _iteration_line(event)
        log.append(line)
        clock.hear(line, printed=verbose)
        show(line)
        raise_pending_interrupt()

    with shown, clock.ticking(tick):
        yield watch


@dataclass
class WorkClock:
    """Clock of a command at work, with the present line of progress."""

    began: float = field(default_factory=time.monotonic)
    printed: float = field(default_factory=time.monotonic)
    line: str = ""
    best: str = ""
    count: str = ""

    def hear(self, line: str, *, printed: bool = False) -> None:
        """Remember a line, and the time if it was printed.

        Parameters
        ----------
        line
            Line of progress.
        printed
            True if it is printed, so that the next line on the duration can wait.
        """
        if line.startswith(_BEST_SO_FAR):
            self.best = f"; {line}"
        elif line:
            self.line = line
            if counted := _COUNTED.search(line):
                self.count = f", {counted[1]}"
            if counted or line == WRITING:
                self.best = ""
        self.printed = time.monotonic() if printed else self.printed

    def text(self, line: str = "") -> str:
        """Return the text next to a spinner."""
        seconds = time.monotonic() - self.began
        return (f"{seconds:.0f} s: " if seconds > _FIRST_WORD else "") + (line or self.line) + self.best

    def print_line(self) -> None:
        """Print the time that the command has been at work, if nothing was printed for a while."""
        now = time.monotonic()
        if now - self.printed > (_FIRST_WORD if self.printed == self.began else _NEXT_WORD):
            self.printed = now
            on = ": " * bool(self.line) + _COUNTED.sub("", self.line) + self.best
            print_to_stderr(f"perilune: running for {now - self.began:.0f} s{self.count}{on}")

    @contextmanager
    def ticking(self, tick: Callable[[], object]) -> Iterator[None]:
        """Call `tick` twice a second from a thread of its own, as foreign code may not come back for long."""
        ended = Event()

        def run() -> None:
            while not ended.wait(0.5):
                tick()

        self.printed = self.began
        thread = Thread(target=run)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()


@dataclass
class SpinnerText:
    """Text of a spinner: the count of what is done, kept until the next one, and the work in progress."""

    count: str = ""

    def line(self, text: str, width: int) -> Text:
        """Return one line that is not longer than the terminal is wide.

        Parameters
        ----------
        text
            Duration and present line of the work.
        width
            Columns that the line may take.
        """
        from rich.text import Text

        if found := _COUNT.findall(text):
            self.count = f"{found[-1]}: "
        told = Text(self.count + _COUNTED.sub("", text))
        told.truncate(width, overflow="ellipsis")
        return told


def print_warnings(found: Sequence[Finding]) -> None:
    """Print every comparison that warns; the refusal reports one that forbids the flight."""
    for f in found:
        if f.verdict == "warning":
            print_to_stderr(f"warning: {f.meaning} ({f.name} {f.formatted[0]}, {f.formatted[1]})")


def print_note(text: str) -> None:
    """Print a note to the reader of the answer."""
    print_to_stderr(f"perilune: {text}")


def refuse_unusable_target(out: Path | None, force: bool) -> None:
    """Refuse an unusable target before the work, not after it.

    Parameters
    ----------
    out
        Directory to be written; None for none.
    force
        True if an existing one may be replaced.

    Raises
    ------
    PeriluneError
        If it exists and may not be replaced, or cannot be written.
    """
    if out is not None:
        from perilune.io import fresh_directory

        with fresh_directory(out, force):
            pass


@contextmanager
def failure_kept(scenario: Scenario, out: Path | None, force: bool, log: deque[str]) -> Iterator[None]:
    """Save what was computed before a failure or Ctrl-C as ``failure.json``; Ctrl-C replaces no earlier result.

    Parameters
    ----------
    scenario
        The scenario that is solved.
    out
        Directory of the file; None to save nothing.
    force
        True if an existing one may be replaced.
    log
        Lines of progress, which are saved as well.
    """
    try:
        yield
    except (InfeasibleError, NotConvergedError, KeyboardInterrupt) as error:
        from perilune.io import FAILURE_FILE, fresh_directory, in_use, json_text

        interrupted = isinstance(error, KeyboardInterrupt) or STOPPED.is_set()
        if out is not None and not (interrupted and in_use(out)):
            from perilune.io import hash_of, program_versions, whole_document

            known = error if isinstance(error, PeriluneError) and not interrupted else interrupted_error()
            said = refusal_answer(known, getattr(error, "exit_code", INTERRUPTED))
            told = scenario.text
            origin = None if told is None else {"sha256": hash_of(told), "text": told}
            files = WrittenFiles()
            with files.written(), fresh_directory(out, force) as work:
                document = {**said.document, "log": list(log), "scenario": origin, "versions": program_versions()}
                if (flight := getattr(error, "flight", None)) is not None:
                    document["flight"] = whole_document(flight)
                (work / FAILURE_FILE).write_text(json_text(document), encoding="utf-8")
            files.tell()
        raise
