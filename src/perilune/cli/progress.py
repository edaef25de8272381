"""What happens beside the work.

Progress on stderr, warnings, and what is kept when the work does not end well.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from perilune.cli.answer import INTERRUPTED, refusal, stopped
from perilune.words.outcome import InfeasibleError, NotConvergedError, PeriluneError

if TYPE_CHECKING:
    from perilune.problem.preflight import Finding
    from perilune.scenario import Scenario
    from perilune.words.watch import Iteration

LONGEST_LOG = 1000  # lines of progress that a failure keeps


def _iteration_line(i: Iteration) -> str:
    return f"iteration {i.number:3d}  residual {i.residual:.3e}  step {i.step:.3e}  damping {i.damping:.3g}"


@contextmanager
def progress(verbose: bool, log: deque[str]) -> Iterator[Callable[[Iteration | str], None]]:
    """A `watch` that keeps lines in `log`, prints them if verbose, and else moves a spinner on a terminal."""
    status = None
    if not verbose and sys.stderr.isatty():
        from rich.console import Console

        status = Console(stderr=True).status("solving")

    def watch(event: Iteration | str) -> None:
        line = event if isinstance(event, str) else _iteration_line(event)
        log.append(line)
        if verbose:
            print(line, file=sys.stderr)
        elif status is not None:
            status.update(line.replace("[", "\\["))

    if status is None:
        yield watch
    else:
        with status:
            yield watch


def warn(found: Sequence[Finding]) -> None:
    """Print every comparison that warns; one that forbids the flight is the refusal's to say."""
    for f in found:
        if f.verdict == "warning":
            limit = f"{f.limit:.4g} {f.unit}".removesuffix(" 1")
            print(f"warning: {f.meaning} ({f.name} {f.value:.4g}, limit {limit})", file=sys.stderr)


def note(text: str) -> None:
    """Print what the reader of the answer should know beside it."""
    print(f"perilune: {text}", file=sys.stderr)


def refuse_used(out: Path | None, force: bool) -> None:
    """Refuse an unusable target before the work, not after it."""
    if out is not None:
        from perilune.io.files import fresh_directory

        with fresh_directory(out, force):
            pass


@contextmanager
def failure_kept(scenario: Scenario, out: Path | None, force: bool, log: deque[str]) -> Iterator[None]:
    """Save what was computed before a failure or Ctrl-C as ``failure.json``."""
    try:
        yield
    except (InfeasibleError, NotConvergedError, KeyboardInterrupt) as error:
        if out is not None:
            from perilune.io.export import versions
            from perilune.io.files import fresh_directory, json_text
            from perilune.io.reload import hash_of

            known = error if isinstance(error, PeriluneError) else stopped()
            said = refusal(known, getattr(error, "exit_code", INTERRUPTED))
            origin = {"sha256": hash_of(scenario.text), "text": scenario.text}
            with fresh_directory(out, force) as work:
                document = {**said.document, "log": list(log), "scenario": origin, "versions": versions()}
                (work / "failure.json").write_text(json_text(document), encoding="utf-8")
        raise
