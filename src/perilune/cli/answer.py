"""What a command says, for people and for programs, and the exit code that goes with it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from perilune.cli.stopping import STOPPED
from perilune.words.outcome import InfeasibleError, NotConvergedError, Outcome, PeriluneError

INTERRUPTED = Outcome.INTERRUPTED.exit_code
_FAILED = (Outcome.REFUSED, Outcome.INFEASIBLE, Outcome.NOT_CONVERGED, Outcome.INTERRUPTED)
OUTCOME_OF_CODE = {1: "FAULT", **{outcome.exit_code: outcome.name for outcome in _FAILED}}


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a command says: for people, for programs, and its exit code."""

    text: str
    document: dict[str, Any]
    exit_code: int = 0


def deliver(as_json: bool, work: Callable[[], Answer]) -> int:
    """Do the work of a command, say its answer or why there is none; the exit code."""
    try:
        answer = work()
    except KeyboardInterrupt as error:
        answer = refusal(stopped(*error.args), INTERRUPTED)
    except Exception as error:
        # Foreign code that is met by Ctrl-C may make an error of its own of it.
        answer = refusal(stopped(), INTERRUPTED) if STOPPED.is_set() else _failed(error)
    return say(answer, as_json)


def _failed(error: Exception) -> Answer:
    """What is said where a command cannot go on."""
    tracing = os.environ.get("PERILUNE_TRACEBACK")
    if isinstance(error, PeriluneError):
        if tracing and (behind := error.__cause__ or error.__context__) is not None:  # for who wrote what failed
            from traceback import format_exception

            aside("".join(format_exception(behind)))
        return refusal(error, error.exit_code)
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        fault = PeriluneError(
            "a file cannot be read or written",
            got=f"{place}{error.strerror}",
            advice="choose another place; look at its rights and at the space that is left",
        )
        return refusal(fault, 2)
    if tracing:
        raise error
    if isinstance(error, ModuleNotFoundError) and error.name and not error.name.startswith("perilune"):
        missing = PeriluneError(f"perilune needs {error.name}, which is not installed", advice="pip install perilune")
        return refusal(missing, 2)
    fault = PeriluneError(
        "perilune failed, which is a fault of the program and not yours",
        got=f"{type(error).__name__}: {str(error)[:300]}",
        advice="report it with your scenario and what PERILUNE_TRACEBACK=1 shows",
    )
    return refusal(fault, 1)


def stopped(advice: str = "") -> PeriluneError:
    """What is said of Ctrl-C."""
    return PeriluneError("stopped by the user", advice=advice)


def refusal(error: PeriluneError, code: int) -> Answer:
    """What is said of an error."""
    parts = {"what": error.what, "got": error.got, "expected": error.expected, "try": error.advice}
    document: dict[str, Any] = {"outcome": OUTCOME_OF_CODE.get(code, "REFUSED"), "error": parts}
    if isinstance(error, InfeasibleError):
        parts["reason"] = error.reason
    if isinstance(error, NotConvergedError) or (isinstance(error, InfeasibleError) and error.partial):
        document["partial"] = error.partial
    return Answer(text=f"perilune: {error}", document=document, exit_code=code)


def say(answer: Answer, as_json: bool) -> int:
    """Print an answer where it belongs: a refusal on stderr, and on stdout as well if JSON is wanted.

    Returns
    -------
    int
        The exit code: the answer's, or that of a file that cannot be written where stdout cannot.
    """
    refused = "error" in answer.document
    # Names and titles may be a stranger's, and control characters move the cursor over what was said.
    text = "".join(c if c.isprintable() or c in "\n\t" else "?" for c in answer.text)
    if refused:
        aside(text)
    if as_json or not refused:
        if as_json:
            from perilune.io.files import json_text

            text = json_text(answer.document)
        return tell(text.rstrip("\n"), answer.exit_code)
    return answer.exit_code


def tell(text: str, code: int = 0) -> int:
    """Print a text on stdout; the exit code, that of a fault where stdout cannot be written."""
    try:
        print(text, flush=True)
    except OSError as error:
        forsake_stdout()
        if not isinstance(error, BrokenPipeError):  # a reader who has seen enough is no fault
            aside(f"perilune: the answer cannot be written\n  got: stdout: {error.strerror}")
            return code or 2
    return code


def aside(text: str) -> None:
    """Print a text on stderr; where that cannot be written nobody is told, and nothing else changes."""
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)


def forsake_stdout() -> None:
    """Write nothing more to stdout, so that Python does not complain once more when it flushes at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
