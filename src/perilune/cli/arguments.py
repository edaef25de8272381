"""Commands, their arguments and options, and the help that lists them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, NoReturn

from perilune import PeriluneError
from perilune.cli.atlas_arguments import add_atlas_commands
from perilune.cli.command_arguments import add_other_commands, add_solution_commands, add_solving_commands
from perilune.cli.options import JSON, Option
from perilune.core import unknown_name

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
        return PeriluneError("unexpected argument", got=repr(word[:60]), advice=advice)
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

    return f"{', '.join(kind_names())}; or examples. Default: hybrid_landing.".replace("%", "%%")


def _parsers(kinds: str = "") -> tuple[_Parser, dict[str, _Parser]]:
    """Build the parser of the program and that of each command; `kinds` is the text of help on kinds of problems."""
    parser = _Parser(
        prog="perilune",
        description="Optimal finite-thrust landings, each with its proof.",
        epilog=f"`perilune COMMAND --help` shows more; the manual has a glossary. {_EXIT_CODES}",
        add_help=False,
        allow_abbrev=False,
    )
    parser.add_argument("--version", nargs=0, action=_Version, help="Show the version and exit.")
    parser.add_argument("-h", "--help", nargs=0, action=_Help, help="Show this message and exit.")
    known: dict[str, _Parser] = {}
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="Commands")

    def command(name: str, about: str, *options: Option, among: Any = commands) -> _Parser:
        made = known[name] = among.add_parser(
            name.split()[-1], help=about, description=about, add_help=False, allow_abbrev=False
        )
        for flags, settings in (*options, JSON) if options else ():
            made.add_argument(*flags, **settings)
        made.add_argument("-h", "--help", nargs=0, action=_Help, help="Show this message and exit.")
        return made

    add_solving_commands(command)
    add_atlas_commands(command)
    add_solution_commands(command)
    add_other_commands(command, kinds)
    return parser, known
