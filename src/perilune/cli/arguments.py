"""What may be typed: the commands, their arguments and options, and the help that lists them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from perilune.reproductions.papers import PAPERS
from perilune.words.outcome import PeriluneError, unknown_name

_EXIT_CODES = "Exit codes: 0 proved, 2 bad scenario, 3 infeasible, 4 not converged, 5 not proved, 130 stopped."


class Told(Exception):
    """What was asked for is a text: the help or the version."""


def parsed(arguments: Sequence[str]) -> argparse.Namespace:
    """The command line as a record, `command` among its fields.

    Raises
    ------
    PeriluneError
        If it is none.
    Told
        With the text, where only that is wanted.
    """
    words = list(arguments)
    if words[:1] == ["help"]:
        words = [*words[1:2], "--help"]
    if words[:1] == ["new"]:  # of which argparse would not see the FILE in `new KIND --force FILE`
        words.sort(key=lambda word: word.startswith("-"))
    parser, known = _parsers()
    commands = list(dict.fromkeys(name.split()[0] for name in known))
    if words and not words[0].startswith("-") and words[0] not in commands:
        raise unknown_name("command", words[0], commands)
    actions = [name.split()[1] for name in known if name.startswith(f"{words[0]} ")] if words else []
    if actions and words[1:] and not words[1].startswith("-") and words[1] not in actions:
        raise unknown_name(f"action of {words[0]}", words[1], actions)
    typed, left = parser.parse_known_args(words)
    if left:
        name = " ".join(filter(None, (typed.command, getattr(typed, "action", None))))
        raise _unknown_argument(left[0], known.get(name, parser))
    return typed


def settings(typed: argparse.Namespace) -> dict[str, Any]:
    """The settings of the method, by name; None where none was typed."""
    return {name: getattr(typed, name) for name in ("nodes", "tolerance", "polish", "starts", "seed")}


def help_text() -> str:
    """The help of the whole program."""
    return _parsers()[0].format_help()


def _unknown_argument(word: str, parser: argparse.ArgumentParser) -> PeriluneError:
    """What is said of a word that a command has no use for."""
    if not word.startswith("-"):
        return PeriluneError("this argument is one too many", got=repr(word[:60]), advice=f"{parser.prog} --help")
    options = [flag for action in parser._actions for flag in action.option_strings if flag.startswith("--")]
    error = unknown_name("option", word.partition("=")[0], options)
    return PeriluneError(
        error.what, got=error.got, expected=error.expected, advice=error.advice or f"{parser.prog} --help"
    )


class _Parser(argparse.ArgumentParser):
    """Says what is wrong by an error of ours, and its help by `Told`, so that both leave as all answers do."""

    def error(self, message: str) -> NoReturn:
        raise PeriluneError(message, advice=f"{self.prog} --help")


class _Help(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        raise Told(parser.format_help())


class _Version(argparse.Action):
    def __call__(self, *_: Any) -> NoReturn:
        from perilune import __version__

        raise Told(f"perilune {__version__}")


def _number(least: int, most: int | None = None) -> Callable[[str], int]:
    def whole(text: str) -> int:
        number = int(text)
        if number < least or (most is not None and number > most):
            raise argparse.ArgumentTypeError(f"{number} is not {_range(least, most)}")
        return number

    whole.__name__ = "whole number"  # what argparse calls it
    return whole


def _real(text: str) -> float:
    return float(text)


_real.__name__ = "number"  # what argparse calls it


def _range(least: int, most: int | None) -> str:
    return f"at least {least}" if most is None else f"from {least} to {most}"


_Option = tuple[tuple[str, ...], dict[str, Any]]  # its flags, and what argparse is told of it


def _option(*flags: str, **settings: Any) -> _Option:
    return flags, settings


def _switch(flag: str, about: str, **settings: Any) -> _Option:
    return _option(flag, action="store_true", help=about, **settings)


def _level(least: int, usual: int) -> _Option:
    text = f"Verification level to prove, {_range(least, 3)}" + ("; 0 for none" if not least else "")
    help_ = f"{text}. Usually {usual}."
    return _option("--level", metavar="LEVEL", type=_number(least, 3), default=usual, help=help_)


_FILE = _option("file", metavar="FILE", type=Path, help="Scenario in TOML; `perilune new` writes one.")
_SET = _option(
    "--set",
    dest="changes",
    metavar="KEY=VALUE",
    action="append",
    default=[],
    help='Change a value, e.g. "vehicle.thrust=500 N"; may be repeated.',
)
_OUT = _option("--out", metavar="DIR", type=Path, help="Write everything into this directory.")
_JSON = _switch("--json", "One JSON document on stdout.", dest="as_json")
_VERBOSE = _switch("--verbose", "Show every iteration on stderr, and every check.")
_FORCE = _switch("--force", "Replace what an earlier run wrote there.")
_NO_CACHE = _switch("--no-cache", "Compile anew and keep no machine code on disk.")
_METHOD = _option(
    "--method",
    metavar="METHOD",
    default="indirect",
    help="indirect (unless given); direct, which also flies along a limit; hybrid: genetic search, then direct.",
)
_SETTINGS = (
    _option("--nodes", metavar="N", type=_number(0), help="Points of the direct method's first mesh. Usually 20."),
    _option(
        "--tolerance",
        metavar="PART",
        type=_real,
        help="Relative error at which the direct method's mesh has converged. Usually 1e-6. "
        "What a proof may leave open is stated in the file, under [proof].",
    ),
    _option(
        "--no-polish",
        dest="polish",
        action="store_const",
        const=False,
        help="Leave the direct method's answer as its mesh has it, and do not make it exact by Newton's method.",
    ),
    _option("--starts", metavar="N", type=_number(0), help="Random starts of the indirect method. Usually 24."),
    _option("--seed", metavar="N", type=_number(0), help="Of random starts, and of the genetic search. Usually 0."),
)


def _parsers() -> tuple[_Parser, dict[str, _Parser]]:
    """That of the whole program, and that of each command."""
    parser = _Parser(
        prog="perilune",
        description="Optimal finite-thrust landings, each with its proof.",
        epilog=f"`perilune COMMAND --help` tells more. {_EXIT_CODES}",
        add_help=False,
        allow_abbrev=False,
    )
    parser.add_argument("--version", nargs=0, action=_Version, help="Show the version and leave.")
    parser.add_argument("-h", "--help", nargs=0, action=_Help, help="Show this message and leave.")
    known: dict[str, _Parser] = {}
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="Commands")

    def command(name: str, about: str, *options: _Option, among: Any = commands) -> _Parser:
        made = known[name] = among.add_parser(
            name.split()[-1], help=about, description=about, add_help=False, allow_abbrev=False
        )
        for flags, settings in (*options, _JSON) if options else ():
            made.add_argument(*flags, **settings)
        made.add_argument("-h", "--help", nargs=0, action=_Help, help="Show this message and leave.")
        return made

    find = (_SET, _OUT, _VERBOSE, _FORCE)
    command(
        "solve", "Find the best landing, without a guess, and prove it.", _FILE, *find, _level(0, 3), _METHOD,
        *_SETTINGS, _NO_CACHE,
    )  # fmt: skip
    command(
        "sweep",
        "Solve along parameters; table as CSV on stdout, with --out also as JSON and figure, and every member.",
        _FILE,
        _option(
            "--vary",
            metavar="KEY=START:STOP:STEP",
            action="append",
            required=True,
            help='E.g. "retro.delta_v=0:1600:50 m/s"; given more than once, the family is the grid.',
        ),
        *find,
        _level(0, 1),
        _METHOD,
        *_SETTINGS,
        _option(
            "--workers",
            metavar="N",
            type=_number(1),
            default=1,
            help="Processes that solve members side by side. Usually 1.",
        ),
        _switch("--resume", "Go on with the members that are in --out DIR already."),
        _NO_CACHE,
    )
    command(
        "check", "Validate a scenario and compare it with what physics allows, without solving.", _FILE, _SET
    )  # fmt: skip
    command(
        "opportunities",
        "List the passes from which the site of a return can be reached, with the turn each needs.",
        _FILE,
        _option("--days", metavar="N", type=_real, default=1.0, help="How far ahead to look. Usually 1."),
        _switch("--all", "Show passes that are out of reach too.", dest="every"),
        _SET,
    )
    _atlas(command)
    command(
        "verify",
        "Prove a saved solution again, from its file alone.",
        _option("directory", metavar="DIR", type=Path, help="What `perilune solve --out` wrote."),
        _switch("--verbose", "Show every check."),
        _level(1, 3),
        _NO_CACHE,
    )
    command(
        "reproduce",
        "Compute every number and figure of a paper and set them beside the printed ones.",
        _option("paper", metavar="PAPER", help=" or ".join(PAPERS)),
        _option("--out", metavar="DIR", type=Path, required=True, help="Where the report goes."),
        _option("--seeds", metavar="N", type=_number(1), help="Tries of the paper's random search, where it has one."),
        _VERBOSE,
        _FORCE,
        _NO_CACHE,
    )
    kinds = "hybrid_landing (unless given), powered_descent, precision_landing or deorbit_entry."
    command(
        "new",
        "Write a commented scenario to start from.",
        _option("kind", metavar="KIND", nargs="?", help=kinds),
        _option("place", metavar="FILE", nargs="?", type=Path, help="Where to write; to stdout if left out."),
        _switch("--force", "Replace the file."),
    )
    command(
        "doctor",
        "Show versions, which optional parts are there, and the machine code kept on disk.",
        _switch("--clear-cache", "Remove the machine code kept on disk."),
    )
    return parser, known


def _atlas(command: Callable[..., _Parser]) -> None:
    """The command ``atlas`` and its actions."""
    made = command("atlas", "Map extremals over a region of parameters once, and answer from the map at once.")
    actions = made.add_subparsers(dest="action", metavar="ACTION", title="Actions", required=True)
    directory = _option("directory", metavar="DIR", type=Path, help="The atlas, as `perilune atlas build` made it.")
    workers = _option("--workers", metavar="N", type=_number(1), default=1, help="Processes side by side. Usually 1.")

    def at(about: str) -> _Option:
        return _option("--at", metavar="KEY=VALUE", action="append", default=[], help=about)

    scheduler = _option(
        "--scheduler",
        metavar="ADDRESS",
        help="Of a Dask cluster that computes, e.g. tcp://10.0.0.1:8786; pip install 'perilune[cluster]'.",
    )
    sample = _option(
        "--sample",
        metavar="N",
        type=_number(0),
        help="Answers drawn at random that are proved to level 3. Usually 1 of 100 nodes, at most 10; 459 says most.",
    )
    command(
        "atlas build",
        "Map the extremals of a scenario over ranges of one to four of its values.",
        _FILE,
        _option(
            "--vary",
            metavar="KEY=LOW:HIGH",
            action="append",
            required=True,
            help='E.g. "vehicle.thrust=350:650 N"; given more than once, the region is the box of all.',
        ),
        _SET,
        _option("--out", metavar="DIR", type=Path, required=True, help="Where the atlas goes."),
        _option(
            "--tolerance",
            metavar="PART",
            type=_real,
            help="Relative error at which one step of Newton's method has to end. Usually 1e-9.",
        ),
        _option(
            "--bricks",
            metavar="N",
            type=_number(1),
            help="Along each axis, which are computed side by side. Usually 8 of one axis, 4 of two, 2 of more.",
        ),
        workers,
        scheduler,
        sample,
        _switch("--resume", "Go on with the atlas that is in --out DIR already."),
        _VERBOSE,
        _FORCE,
        _NO_CACHE,
        among=actions,
    )
    command(
        "atlas extend",
        "Map more of the same problem around an atlas; what is there is kept. Without a range: what is missing.",
        directory,
        _option(
            "--vary",
            metavar="KEY=LOW:HIGH",
            action="append",
            default=[],
            help="The wider range of an axis; may be repeated.",
        ),
        workers,
        scheduler,
        sample,
        _VERBOSE,
        _NO_CACHE,
        among=actions,
    )
    command(
        "atlas merge",
        "Make one atlas of two of the same problem: of the same region, or side by side.",
        directory,
        _option("other", metavar="OTHER", type=Path, help="Another atlas."),
        _option("--out", metavar="DIR", type=Path, required=True, help="Where the new one goes."),
        _VERBOSE,
        _FORCE,
        among=actions,
    )
    command(
        "atlas query",
        "Answer at one point of an atlas.",
        directory,
        at('Of every axis, e.g. "vehicle.thrust=440 N".'),
        _OUT,
        _option("--prove", metavar="LEVEL", type=_number(0, 3), default=0, help="Prove the answer, to level 1 to 3."),
        _VERBOSE,
        _FORCE,
        _NO_CACHE,
        among=actions,
    )  # fmt: skip
    command(
        "atlas plot",
        "Draw a slice of an atlas: cost, free parameters, sheets and refusals, nodes, errors.",
        directory,
        _option("--axes", metavar="A,B", help="Along which axes, one or two; the first two if left out."),
        at("Of the other axes; in the middle of their ranges if left out."),
        _option("--points", metavar="N", type=_number(2, 2000), default=101, help="Along each axis. Usually 101."),
        _OUT,
        _FORCE,
        _NO_CACHE,
        among=actions,
    )
    command(
        "atlas export",
        "Write all nodes of an atlas into one file for other programs.",
        directory,
        _option("--format", metavar="FORMAT", default="netcdf", help="netcdf (unless given), or parquet."),
        _option("--out", metavar="FILE", type=Path, required=True, help="The file."),
        _FORCE,
        among=actions,
    )
    command("atlas info", "Say what an atlas maps, and how much of it is there.", directory, among=actions)
    command(
        "atlas verify",
        "Look at every file of an atlas, and prove nodes that are drawn at random.",
        directory,
        _option("--sample", metavar="N", type=_number(0), default=50, help="How many. Usually 50; 459 says most."),
        _option("--seed", metavar="N", type=_number(0), help="Of the draw; another each time if left out."),
        _VERBOSE,
        _NO_CACHE,
        among=actions,
    )
