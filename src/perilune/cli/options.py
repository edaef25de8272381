"""Options that commands share, as argparse takes them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from perilune import PeriluneError
from perilune.cli.output import print_to_stderr


def integer_in_range(least: int, most: int | None = None) -> Callable[[str], int]:
    """Return a reader of whole numbers in a range.

    Parameters
    ----------
    least, most
        Bounds, both allowed; without `most` there is no upper one.

    Returns
    -------
    callable
        From the text on the command line to the number; raises argparse.ArgumentTypeError out of range.
    """

    def read(text: str) -> int:
        number = int(text)
        if number < least or (most is not None and number > most):
            raise argparse.ArgumentTypeError(f"{number} is not {_integer_range_text(least, most)}")
        return number

    read.__name__ = "whole number"  # what argparse calls it
    return read


def real(text: str) -> float:
    """Read a number."""
    return float(text)


def time_limit(typed: argparse.Namespace) -> float | None:
    """Return the time limit that was typed [s], if any.

    Raises
    ------
    PeriluneError
        If it is no time with its unit.
    """
    from perilune.core import parse_quantity, with_key_named

    if typed.time_limit is None:
        return None
    try:
        return parse_quantity(typed.time_limit, "s", "60 s")
    except PeriluneError as error:
        raise with_key_named("--time-limit", error) from None


real.__name__ = "number"  # what argparse calls it


def _integer_range_text(least: int, most: int | None) -> str:
    return f"at least {least}" if most is None else f"from {least} to {most}"


THEOREM = 5  # of `perilune.problem.verification`, which help need not wait for

Option = tuple[tuple[str, ...], dict[str, Any]]  # its flags, and what argparse is told of it


def option(*flags: str, **settings: Any) -> Option:
    """Return the flags and keywords of an option."""
    return flags, settings


def switch(flag: str, about: str, **settings: Any) -> Option:
    """Return an option that is on or off.

    Parameters
    ----------
    flag
        The flag as it is typed, with its dashes.
    about
        The help text.
    **settings
        As for ``ArgumentParser.add_argument``.
    """
    return option(flag, action="store_true", help=about, **settings)


def level_option(least: int, usual: int | None, about: str = "") -> Option:
    """Return the option for the level of a proof.

    Parameters
    ----------
    least
        Lowest level that the command accepts.
    usual
        The default; None where the command chooses it.
    about
        The default in words, where the command chooses it.
    """
    text = f"Verification level to reach, {_integer_range_text(least, THEOREM)}" + ("; 0 for none" if not least else "")
    read = integer_in_range(least, THEOREM)
    return option("--level", metavar="LEVEL", type=read, default=usual, help=f"{text}. Default: {about or usual}.")


def verify_options(what: str, otherwise: str = "") -> tuple[Option, Option]:
    """Return the option for the level to which a command proves its solutions, by default none, and its old name.

    Parameters
    ----------
    what
        Beginning of the help text: the solutions that are proved.
    otherwise
        Its continuation behind the levels.
    """
    help_ = f"{what}, to level 1 to {THEOREM}{otherwise}; 0 (default) for none."
    settings: dict[str, Any] = {"metavar": "LEVEL", "type": integer_in_range(0, THEOREM), "default": 0}
    named = option("--verify", help=help_, **settings)
    return named, option("--prove", dest="verify", help=argparse.SUPPRESS, action=_OldOption, **settings)


class _OldOption(argparse.Action):
    """Old name of an option, which is told on stderr; until the next minor version."""

    def __call__(
        self, parser: Any, namespace: argparse.Namespace, values: Any, option_string: str | None = None
    ) -> None:
        print_to_stderr(f"warning: {option_string} is --{self.dest} now; the old name goes with the next minor version")
        setattr(namespace, self.dest, values)


FILE = option("file", metavar="FILE", type=Path, help="Scenario in TOML; `perilune new` writes one.")
SET = option(
    "--set",
    dest="changes",
    metavar="KEY=VALUE",
    action="append",
    default=[],
    help='Change a value, e.g. "vehicle.thrust=500 N"; may be repeated.',
)
OUT = option("--out", metavar="DIR", type=Path, help="Write everything into this directory.")
JSON = switch("--json", "One JSON document on stdout.", dest="as_json")
VERBOSE = switch("--verbose", "Show every iteration on stderr, and every check.")
FORCE = switch("--force", "Replace what an earlier run wrote there.")
NO_CACHE = switch("--no-cache", "Compile again and store no machine code on disk.")
SOLVED_WITHIN = option(
    "--time-limit",
    metavar="TIME",
    help='Time limit for one flight, e.g. "60 s", after which the best flight so far is reported. Default: "10 min", '
    "and none for a theorem.",
)
METHOD = option(
    "--method",
    metavar="METHOD",
    default="indirect",
    help="indirect (default); direct; or hybrid: genetic search, then direct.",
)
MAP = tuple(
    option(f"--{axis}", metavar="NAME", help=f"For the map of two parameters: what is {where}. Default: {usual}.")
    for axis, where, usual in (
        ("x", "to the right", "the first parameter"),
        ("y", "upwards", "the second"),
        ("z", "shown by colours and contours", "the main result"),
    )
)
SETTINGS = (
    option(
        "--nodes", metavar="N", type=integer_in_range(0), help="Points of the direct method's first mesh. Default: 20."
    ),
    option(
        "--tolerance",
        metavar="PART",
        type=real,
        help="Relative error at which the direct method's mesh has converged. Default: 1e-6. "
        "Tolerances of the proof are stated in the scenario, under [proof].",
    ),
    option(
        "--no-polish",
        dest="polish",
        action="store_const",
        const=False,
        help="Keep the direct method's answer on its mesh, without refining it by Newton's method.",
    ),
    option(
        "--starts", metavar="N", type=integer_in_range(0), help="Random starts of the indirect method. Default: 24."
    ),
    option(
        "--seed",
        metavar="N",
        type=integer_in_range(0),
        help="Seed of random starts and of the genetic search. Default: 0.",
    ),
)
