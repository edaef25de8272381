"""Commands, their arguments and options, and the help that lists them."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

from perilune.cli.options import (
    FILE,
    FORCE,
    JSON,
    MAP,
    METHOD,
    NO_CACHE,
    OUT,
    SET,
    SETTINGS,
    SOLVED_WITHIN,
    VERBOSE,
    Option,
    integer_in_range,
    level_option,
    option,
    prove_option,
    real,
    switch,
)
from perilune.core.errors import PeriluneError, unknown_name
from perilune_papers.papers import PAPERS

_EXIT_CODES = "Exit codes: 0 proved, 2 bad scenario, 3 infeasible, 4 not converged, 5 not proved, 130 stopped."


class HelpShown(Exception):
    """Request for a text, the help or the version, which is printed in place of any work."""


def parse_command_line(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the command line into a record, `command` among its fields.

    Raises
    ------
    PeriluneError
        If it is not valid.
    HelpShown
        With the text, if only help or version is wanted.
    """
    words = list(arguments)
    if words[:1] == ["help"]:
        words = [*words[1:2], "--help"]
    if words[:1] == ["new"]:  # of which argparse would not see the FILE in `new KIND --force FILE`
        words.sort(key=lambda word: word.startswith("-"))
    parser, known = _parsers(_kinds() if words[:1] == ["new"] and {"-h", "--help"} & {*words} else "")
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


def method_settings(typed: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of the method, by name; None for those not typed."""
    return {name: getattr(typed, name) for name in ("nodes", "tolerance", "polish", "starts", "seed")}


def help_text() -> str:
    """Return the help of the whole program."""
    return _parsers()[0].format_help()


def _unknown_argument(word: str, parser: argparse.ArgumentParser) -> PeriluneError:
    """Return the error for a word that a command does not take."""
    if not word.startswith("-"):
        takes = [action.option_strings[0] for action in parser._actions if str(action.metavar).startswith("KEY=")]
        advice = f'{takes[0]} "{word[:60]}"' if takes and "=" in word else f"{parser.prog} --help"
        return PeriluneError("this argument is one too many", got=repr(word[:60]), advice=advice)
    options = [flag for action in parser._actions for flag in action.option_strings if flag.startswith("--")]
    error = unknown_name("option", word.partition("=")[0], options)
    return PeriluneError(
        error.what, got=error.got, expected=error.expected, advice=error.advice or f"{parser.prog} --help"
    )


class _Parser(argparse.ArgumentParser):
    """Parser that raises `PeriluneError` for errors and `HelpShown` for help, so that both are printed as answers."""

    def error(self, message: str) -> NoReturn:
        raise PeriluneError(message, advice=f"{self.prog} --help")


class _Help(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        raise HelpShown(parser.format_help())


class _Version(argparse.Action):
    def __call__(self, *_: Any) -> NoReturn:
        from perilune import __version__

        raise HelpShown(f"perilune {__version__}")


def _kinds() -> str:
    """Return the kinds that `perilune new` can write, those of installed packages included; looked up only for help."""
    from perilune.scenario import kind_names

    return f"{', '.join(kind_names())}; or examples. Usually hybrid_landing.".replace("%", "%%")


def _parsers(kinds: str = "") -> tuple[_Parser, dict[str, _Parser]]:
    """Build the parser of the program and that of each command; `kinds` is the text of help on kinds of problems."""
    parser = _Parser(
        prog="perilune",
        description="Optimal finite-thrust landings, each with its proof.",
        epilog=f"`perilune COMMAND --help` tells more; the manual has a glossary. {_EXIT_CODES}",
        add_help=False,
        allow_abbrev=False,
    )
    parser.add_argument("--version", nargs=0, action=_Version, help="Show the version and leave.")
    parser.add_argument("-h", "--help", nargs=0, action=_Help, help="Show this message and leave.")
    known: dict[str, _Parser] = {}
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="Commands")

    def command(name: str, about: str, *options: Option, among: Any = commands) -> _Parser:
        made = known[name] = among.add_parser(
            name.split()[-1], help=about, description=about, add_help=False, allow_abbrev=False
        )
        for flags, settings in (*options, JSON) if options else ():
            made.add_argument(*flags, **settings)
        made.add_argument("-h", "--help", nargs=0, action=_Help, help="Show this message and leave.")
        return made

    find = (SET, OUT, VERBOSE, FORCE)
    command(
        "solve", "Find the best landing, without a guess, and prove it.", FILE, *find, level_option(0, 3), METHOD,
        *SETTINGS, SOLVED_WITHIN, NO_CACHE,
    )  # fmt: skip
    command(
        "sweep",
        "Solve along parameters; table as CSV on stdout, with --out also as JSON and figure, and every member.",
        FILE,
        option(
            "--vary",
            metavar="KEY=START:STOP:STEP",
            action="append",
            required=True,
            help='E.g. "retro.delta_v=0:1600:50 m/s", or a list of values, "vehicle.thrust=2800,3200,4400 N"; given '
            "more than once, the family is the grid.",
        ),
        *find,
        level_option(0, 1),
        METHOD,
        *SETTINGS,
        SOLVED_WITHIN,
        option(
            "--workers",
            metavar="N",
            type=integer_in_range(1),
            default=1,
            help="Processes that solve members side by side. Usually 1.",
        ),
        *MAP,
        switch("--resume", "Go on with the members that are in --out DIR already."),
        NO_CACHE,
    )
    command(
        "check", "Validate a scenario and compare it with what physics allows, without solving.", FILE, SET
    )  # fmt: skip
    command(
        "opportunities",
        "List the passes from which the site of a return can be reached, with the turn each needs.",
        FILE,
        option("--days", metavar="N", type=real, default=1.0, help="How far ahead to look. Usually 1."),
        switch("--all", "Show passes that are out of reach too.", dest="every"),
        SET,
    )
    _add_atlas_command(command)
    command(
        "verify",
        "Prove a saved solution again, from its file alone.",
        option("directory", metavar="DIR", type=Path, help="What `perilune solve --out` wrote."),
        switch("--verbose", "Show every check."),
        level_option(1, 3),
        option("--certificate", metavar="FILE", type=Path, help="Where to write the certificate of a theorem."),
        FORCE,
        NO_CACHE,
    )
    command(
        "export",
        "Write a saved solution into one file for other programs.",
        option("directory", metavar="DIR", type=Path, help="What `perilune solve --out` wrote."),
        option(
            "--format",
            metavar="FORMAT",
            help="netcdf, csv, parquet, oem or czml; unless given as FILE is called (netcdf if bare).",
        ),
        option("--out", metavar="FILE", type=Path, required=True, help="The file."),
        option(
            "--epoch",
            metavar="TIME",
            help="UTC at the begin of the flight, e.g. 2030-01-01T00:00:00, where the scenario has none; "
            "oem and czml need it.",
        ),
        option("--object-name", metavar="TEXT", help="OBJECT_NAME of an oem. Usually the name of the problem."),
        option("--object-id", metavar="TEXT", help="OBJECT_ID of an oem, e.g. 2030-001A. Usually UNKNOWN."),
        prove_option("Prove the solution first", "; otherwise the file says what is claimed"),
        FORCE,
        NO_CACHE,
    )
    command(
        "explore",
        "Open a page on which the optimal flight follows the parameters as they are dragged.",
        option(
            "target",
            metavar="TARGET",
            nargs="?",
            type=Path,
            help="A scenario, or a directory of `perilune solve --out` or `perilune atlas build`; "
            "a landing on the Moon if left out.",
        ),
        SET,
        option(
            "--port",
            metavar="N",
            type=integer_in_range(0, 65535),
            default=0,
            help="On 127.0.0.1. Usually any that is free.",
        ),
        switch("--no-open", "Print the address and open no browser."),
        option(
            "--html",
            metavar="FILE",
            type=Path,
            help="Write one page that needs no server instead, with flights over one parameter or two.",
        ),
        option(
            "--vary",
            metavar="KEY[=LOW:HIGH]",
            action="append",
            help='With --html: what moves, e.g. "vehicle.thrust=350:650 N"; once or twice, in the range of its slider '
            "where none is said. If left out, the first two axes of an atlas, or the first parameter.",
        ),
        FORCE,
        NO_CACHE,
    )
    command(
        "reproduce",
        "Compute every number and figure of a paper and set them beside the printed ones.",
        option("paper", metavar="PAPER", help=" or ".join(PAPERS)),
        option("--out", metavar="DIR", type=Path, required=True, help="Where the report goes."),
        option(
            "--seeds",
            metavar="N",
            type=integer_in_range(1),
            help="Tries of the paper's random search, where it has one.",
        ),
        VERBOSE,
        FORCE,
        NO_CACHE,
    )
    place = "Where to write; if left out, a template to stdout, the examples of the manual to examples."
    command(
        "new",
        "Write a commented scenario to start from, or the examples of the manual.",
        option("kind", metavar="KIND", nargs="?", help=kinds),
        option("place", metavar="FILE", nargs="?", type=Path, help=place),
        switch("--force", "Replace what is there."),
    )
    command(
        "doctor",
        "Show versions, which optional parts are there, and the machine code kept on disk.",
        switch("--clear-cache", "Remove the machine code kept on disk."),
    )
    return parser, known


def _add_atlas_command(command: Callable[..., _Parser]) -> None:
    """Add the command ``atlas`` and its actions."""
    made = command("atlas", "Map optimal flights over a region of parameters once, and answer from the map at once.")
    actions = made.add_subparsers(dest="action", metavar="ACTION", title="Actions", required=True)
    directory = option("directory", metavar="DIR", type=Path, help="The atlas, as `perilune atlas build` made it.")
    workers = option(
        "--workers", metavar="N", type=integer_in_range(1), default=1, help="Processes side by side. Usually 1."
    )

    def at(about: str) -> Option:
        return option("--at", metavar="KEY=VALUE", action="append", default=[], help=about)

    scheduler = option(
        "--scheduler",
        metavar="ADDRESS",
        help="Of a Dask cluster that computes, e.g. tcp://10.0.0.1:8786; pip install 'perilune[cluster]'.",
    )
    sample = option(
        "--sample",
        metavar="N",
        type=integer_in_range(0),
        help="Answers drawn at random that are proved to level 3. Usually 1 of 100 nodes, at most 10; 459 says most.",
    )
    command(
        "atlas build",
        "Map the extremals of a scenario (flights that meet every necessary condition of an optimum) over ranges of "
        "one to four of its values.",
        FILE,
        option(
            "--vary",
            metavar="KEY=LOW:HIGH",
            action="append",
            required=True,
            help='E.g. "vehicle.thrust=350:650 N"; given more than once, the region is the box of all.',
        ),
        SET,
        option("--out", metavar="DIR", type=Path, required=True, help="Where the atlas goes."),
        option(
            "--tolerance",
            metavar="PART",
            type=real,
            help="Relative error at which one step of Newton's method has to end. Usually 1e-9.",
        ),
        option(
            "--bricks",
            metavar="N",
            type=integer_in_range(1),
            help="Along each axis, which are computed side by side. Usually 8 of one axis, 4 of two, 2 of more.",
        ),
        workers,
        scheduler,
        sample,
        switch("--resume", "Go on with the atlas that is in --out DIR already."),
        VERBOSE,
        FORCE,
        NO_CACHE,
        among=actions,
    )
    command(
        "atlas extend",
        "Map more of the same problem around an atlas; what is there is kept. Without a range: what is missing.",
        directory,
        option(
            "--vary",
            metavar="KEY=LOW:HIGH",
            action="append",
            default=[],
            help="The wider range of an axis; may be repeated.",
        ),
        workers,
        scheduler,
        sample,
        VERBOSE,
        NO_CACHE,
        among=actions,
    )
    command(
        "atlas merge",
        "Make one atlas of two of the same problem: of the same region, or side by side.",
        directory,
        option("other", metavar="OTHER", type=Path, help="Another atlas."),
        option("--out", metavar="DIR", type=Path, required=True, help="Where the new one goes."),
        VERBOSE,
        FORCE,
        among=actions,
    )
    command(
        "atlas query",
        "Answer at one point of an atlas.",
        directory,
        at('Of every axis, e.g. "vehicle.thrust=440 N".'),
        OUT,
        prove_option("Prove the answer"),
        VERBOSE,
        FORCE,
        NO_CACHE,
        among=actions,
    )  # fmt: skip
    command(
        "atlas plot",
        "Draw a slice of an atlas: cost, free parameters, sheets (families of extremals) and refusals, nodes, errors.",
        directory,
        option("--axes", metavar="A,B", help="Along which axes, one or two; the first two if left out."),
        at("Of the other axes; in the middle of their ranges if left out."),
        option(
            "--points", metavar="N", type=integer_in_range(2, 2000), default=101, help="Along each axis. Usually 101."
        ),
        OUT,
        FORCE,
        NO_CACHE,
        among=actions,
    )
    command(
        "atlas export",
        "Write all nodes of an atlas into one file for other programs.",
        directory,
        option("--format", metavar="FORMAT", help="netcdf or parquet; unless given as FILE is called."),
        option("--out", metavar="FILE", type=Path, required=True, help="The file."),
        FORCE,
        among=actions,
    )
    command("atlas info", "Say what an atlas maps, and how much of it is there.", directory, among=actions)
    command(
        "atlas verify",
        "Look at every file of an atlas, and prove nodes that are drawn at random.",
        directory,
        option(
            "--sample", metavar="N", type=integer_in_range(0), default=50, help="How many. Usually 50; 459 says most."
        ),
        option("--seed", metavar="N", type=integer_in_range(0), help="Of the draw; another each time if left out."),
        VERBOSE,
        NO_CACHE,
        among=actions,
    )
