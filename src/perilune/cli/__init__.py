"""The command line: ``perilune solve | sweep | check | verify | reproduce | new | doctor``.

Answers go to stdout, progress and refusals to stderr; with ``--json`` stdout holds exactly one JSON document,
for a refusal too. Exit codes: 0 done and proved, 1 a fault of this program, 2 bad scenario or usage, 3
physics forbids it, 4 not converged, 5 solved but not proved, 130 interrupted.

Everything heavy is imported inside the commands, so that ``--help`` is quick.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import NoReturn

from perilune.cli.answer import INTERRUPTED, refusal, say
from perilune.cli.commands import app
from perilune.outcome import PeriluneError


def main() -> NoReturn:
    """Entry point of the console script."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run one command line; the exit code."""
    try:
        return int(app(args=list(arguments), prog_name="perilune", standalone_mode=False) or 0)
    except KeyboardInterrupt:
        return INTERRUPTED
    except Exception as error:
        # Only the parser of the arguments gets here: the commands answer for themselves.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        if code := getattr(error, "exit_code", 2):
            usage = PeriluneError(message() or "no command", advice="perilune --help")
            say(refusal(usage, code), as_json="--json" in arguments)
        return code
