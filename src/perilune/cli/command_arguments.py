"""Commands of the command line other than `atlas`, each with its help and its options."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from perilune.cli.options import (
    FILE,
    FORCE,
    MAP,
    METHOD,
    NO_CACHE,
    OUT,
    SET,
    SETTINGS,
    SOLVED_WITHIN,
    VERBOSE,
    integer_in_range,
    level_option,
    option,
    prove_option,
    real,
    switch,
)
from perilune_papers.papers import PAPERS


def add_solving_commands(command: Callable[..., Any]) -> None:
    """Add the commands that read a scenario: solve, sweep, check and opportunities."""
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


def add_solution_commands(command: Callable[..., Any]) -> None:
    """Add the commands that read a saved solution: verify, export and explore."""
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
    _add_explore_command(command)


def _add_explore_command(command: Callable[..., Any]) -> None:
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


def add_other_commands(command: Callable[..., Any], kinds: str) -> None:
    """Add reproduce, new and doctor; `kinds` is the help on the kinds of problems."""
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
