"""Answers of commands, for people and for programs, with their exit codes, which are those of `Outcome`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from perilune import InfeasibleError, NotConvergedError, Outcome, PeriluneError
from perilune.cli.interrupts import STOPPED

INTERRUPTED = Outcome.INTERRUPTED.exit_code
_FAILED = (Outcome.REFUSED, Outcome.INFEASIBLE, Outcome.NOT_CONVERGED, Outcome.INTERRUPTED)
OUTCOME_OF_CODE = {1: "FAULT", **{outcome.exit_code: outcome.name for outcome in _FAILED}}


@dataclass(frozen=True, kw_only=True)
class CommandAnswer:
    """Answer of a command: text for people, document for programs, and exit code."""

    text: str
    document: dict[str, Any]
    exit_code: int = 0


def emit_answer(as_json: bool, work: Callable[[], CommandAnswer], verbose: bool = False) -> int:
    """Do the work of a command and print its answer or refusal, if verbose with all attempts.

    Parameters
    ----------
    as_json
        True to print the answer as JSON.
    work
        The command, without arguments.
    verbose
        True to list all attempts of a failed command.

    Returns
    -------
    int
        The exit code.
    """
    try:
        answer = work()
    except KeyboardInterrupt as error:
        answer = refusal_answer(interrupted_error(*error.args), INTERRUPTED)
    except Exception as error:
        # Foreign code that is met by Ctrl-C may make an error of its own of it.
        answer = refusal_answer(interrupted_error(), INTERRUPTED) if STOPPED.is_set() else answer_of_error(error)
        if verbose and (tried := getattr(error, "partial", {}).get("attempts")):
            answer = replace(answer, text="\n    ".join([answer.text, *(f"- {line}" for line in tried)]))
    return print_answer(answer, as_json)


class WrittenFiles:
    """Files written for an answer, which is given even if they cannot be.

    If the result itself is not written, the exit code is that of the fault, unless the answer has another.
    """

    def __init__(self) -> None:
        self.failed: list[PeriluneError] = []
        self._code = 0

    @contextmanager
    def written(self) -> Iterator[None]:
        """Catch the errors of a writer, but not Ctrl-C, even if foreign code turned it into an error of its own."""
        try:
            yield
        except Exception as error:
            if STOPPED.is_set():
                raise
            from perilune.io import NotWrittenError

            if isinstance(error, NotWrittenError):
                self.failed += error.failed
                return
            self._code, worded = _code_of(error), _error_in_words(error)
            if worded is not error:
                worded.__cause__ = error
            if str(worded) not in map(str, self.failed):  # a full disk says the same of all
                self.failed.append(worded)

    def tell(self) -> None:
        """Print on stderr the errors of files that failed."""
        for error in self.failed:
            _print_traceback(error)
            print_to_stderr(f"perilune: {error}")

    def noted(self, answer: CommandAnswer) -> CommandAnswer:
        """Return the answer with the errors of files that failed, and print these on stderr."""
        self.tell()
        if not self.failed:
            return answer
        document = {**answer.document, "not_written": [_error_parts(error) for error in self.failed]}
        return replace(answer, document=document, exit_code=answer.exit_code or self._code)

    def placed(self, answer: CommandAnswer, out: Path | None) -> CommandAnswer:
        """Return the answer with the place of the files at the end of its text.

        Parameters
        ----------
        answer
            The answer to complete.
        out
            Directory of the files; None if none were asked for.
        """
        if out is not None and not self._code:
            but = f", except {len(self.failed)} of its files" if self.failed else ""
            answer = replace(answer, text=f"{answer.text}\n\nwritten to {out}{but}")
        return self.noted(answer)


def answer_of_error(error: Exception) -> CommandAnswer:
    """Return the answer for an error that ends a command."""
    if isinstance(error, PeriluneError):
        _print_traceback(error)
    elif os.environ.get("PERILUNE_TRACEBACK") and not isinstance(error, OSError):
        raise error
    return refusal_answer(_error_in_words(error), _code_of(error))


def _print_traceback(error: PeriluneError) -> None:
    """Print the traceback behind an error, if the environment asks for it."""
    if os.environ.get("PERILUNE_TRACEBACK") and (behind := error.__cause__ or error.__context__) is not None:
        from traceback import format_exception

        print_to_stderr("".join(format_exception(behind)))


def _code_of(error: Exception) -> int:
    if isinstance(error, PeriluneError):
        return error.exit_code
    return 2 if isinstance(error, OSError) or _missing_package_name(error) else 1


def _missing_package_name(error: Exception) -> str:
    """Return the name of a package that is not installed; "" for any other error."""
    found = isinstance(error, ModuleNotFoundError) and error.name and not error.name.startswith("perilune")
    return str(error.name) if found and isinstance(error, ModuleNotFoundError) else ""


def _error_in_words(error: Exception) -> PeriluneError:
    """Return any error as a `PeriluneError` with its four parts."""
    if isinstance(error, PeriluneError):
        return error
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        return PeriluneError(
            "a file cannot be read or written",
            got=f"{place}{error.strerror}",
            advice="choose another place, or check its permissions and the free space",
        )
    if missing := _missing_package_name(error):
        return PeriluneError(f"perilune needs {missing}, which is not installed", advice="pip install perilune")
    return PeriluneError(
        "perilune failed; this is a fault of the program, not of your input",
        got=f"{type(error).__name__}: {str(error)[:300]}",
        advice="report it with your scenario and the output under PERILUNE_TRACEBACK=1",
    )


def interrupted_error(advice: str = "") -> PeriluneError:
    """Return the error for Ctrl-C."""
    return PeriluneError("stopped by the user", advice=advice)


def refusal_answer(error: PeriluneError, code: int) -> CommandAnswer:
    """Return the answer that reports an error.

    Parameters
    ----------
    error
        The error, with its message and what it keeps.
    code
        Exit code of the command.
    """
    parts = _error_parts(error)
    document: dict[str, Any] = {"outcome": OUTCOME_OF_CODE.get(code, "REFUSED"), "error": parts}
    if isinstance(error, InfeasibleError):
        parts["reason"] = error.reason
    if isinstance(error, NotConvergedError) or (isinstance(error, InfeasibleError) and error.partial):
        document["partial"] = error.partial
    return CommandAnswer(text=f"perilune: {error}", document=document, exit_code=code)


def _error_parts(error: PeriluneError) -> dict[str, str]:
    return {"what": error.what, "got": error.got, "expected": error.expected, "try": error.advice}


def print_answer(answer: CommandAnswer, as_json: bool) -> int:
    """Print an answer on stdout; a refusal on stderr, and on stdout as well if JSON is wanted.

    Parameters
    ----------
    answer
        Text, document and exit code.
    as_json
        True to print the document as JSON.

    Returns
    -------
    int
        The exit code: the answer's, or that of a file that cannot be written where stdout cannot.
    """
    refused = "error" in answer.document
    # Names and titles may be a stranger's, and control characters move the cursor over what was said.
    text = "".join(c if c.isprintable() or c in "\n\t" else "?" for c in answer.text)
    if refused:
        print_to_stderr(text)
    if as_json or not refused:
        if as_json:
            from perilune.io import json_text

            text = json_text(answer.document)
        return print_text(text.rstrip("\n"), answer.exit_code)
    return answer.exit_code


def print_text(text: str, code: int = 0) -> int:
    """Print a text on stdout; returns the exit code, that of a fault if stdout cannot be written.

    Parameters
    ----------
    text
        The text, without its last newline.
    code
        Exit code of the command where the text is printed.
    """
    try:
        print(text, flush=True)
    except OSError as error:
        discard_stdout()
        if not isinstance(error, BrokenPipeError):  # a reader who has seen enough is no fault
            print_to_stderr(f"perilune: the answer cannot be written\n  got: stdout: {error.strerror}")
            return code or 2
    return code


def print_to_stderr(text: str) -> None:
    """Print a text on stderr; ignore a stderr that cannot be written."""
    with suppress(OSError):
        print(text, file=sys.stderr, flush=True)


def discard_stdout() -> None:
    """Write nothing more to stdout, so that Python does not complain once more when it flushes at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
