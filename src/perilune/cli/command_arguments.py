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
    real,
    switch,
    verify_options,
)
from perilune_papers.papers import PAPERS


def add_solving_commands(command: Callable[..., Any]) -> None:
    """Add the commands that read a scenario: solve, sweep, check and opportunities."""
    find = (SET, OUT, VERBOSE, FORCE)
    command(
        "solve", "Find the optimal flight without an initial guess, and prove it.", FILE, *find, level_option(0, 3),
        METHOD, *SETTINGS, SOLVED_WITHIN, NO_CACHE,
    )  # fmt: skip
    command(
        "sweep",
        "Solve over a range of parameters; the table goes to stdout as CSV, and with --out also to JSON and a figure,"
        " with every member.",
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
        level_option(0, None, "1; with --batch 0"),
        METHOD,
        *SETTINGS,
        SOLVED_WITHIN,
        option(
            "--workers",
            metavar="N",
            type=integer_in_range(1),
            default=1,
            help="Processes that solve members in parallel. Default: 1.",
        ),
        *MAP,
        switch(
            "--batch",
            "Solve members together from known solutions, thousands in a second, each integrated again: results at the "
            "ends of phases, and no file for each member.",
        ),
        switch("--resume", "Continue with the members that are already in --out DIR."),
        NO_CACHE,
    )
    command(
        "check", "Validate a scenario and compare it with physical bounds, without solving.", FILE, SET
    )  # fmt: skip
    command(
        "opportunities",
        "List the passes from which the site of a return can be reached, with the plane change each needs.",
        FILE,
        option("--days", metavar="N", type=real, default=1.0, help="How far ahead to look. Default: 1."),
        switch("--all", "Also show passes that are out of reach.", dest="every"),
        SET,
    )


def add_solution_commands(command: Callable[..., Any]) -> None:
    """Add the commands that read a saved solution: verify, export and explore."""
    command(
        "verify",
        "Verify a saved solution again, from its file only.",
        option("directory", metavar="DIR", type=Path, help="A directory written by `perilune solve --out`."),
        switch("--verbose", "Show every check."),
        level_option(1, 3),
        option("--certificate", metavar="FILE", type=Path, help="File for the certificate of a theorem."),
        FORCE,
        NO_CACHE,
    )
    command(
        "export",
        "Export a saved solution to one file for other programs.",
        option("directory", metavar="DIR", type=Path, help="A directory written by `perilune solve --out`."),
        option(
            "--format",
            metavar="FORMAT",
            help="netcdf, csv, parquet, oem or czml. Default: by the ending of FILE (netcdf without one).",
        ),
        option("--out", metavar="FILE", type=Path, required=True, help="The file."),
        option(
            "--epoch",
            metavar="TIME",
            help="UTC at the start of the flight, e.g. 2030-01-01T00:00:00, where the scenario has none; "
            "oem and czml need it.",
        ),
        option("--object-name", metavar="TEXT", help="OBJECT_NAME of an OEM. Default: the name of the problem."),
        option("--object-id", metavar="TEXT", help="OBJECT_ID of an OEM, e.g. 2030-001A. Default: UNKNOWN."),
        *verify_options("Prove the solution first", "; otherwise the file states what the solution claims"),
        FORCE,
        NO_CACHE,
    )
    _add_explore_command(command)


def _add_explore_command(command: Callable[..., Any]) -> None:
    command(
        "explore",
        "Open a page that shows the optimal flight while its parameters are dragged.",
        option(
            "target",
            metavar="TARGET",
            nargs="?",
            type=Path,
            help="A scenario, or a directory of `perilune solve --out` or `perilune atlas build`. "
            "Default: a landing on the Moon.",
        ),
        SET,
        option(
            "--port",
            metavar="N",
            type=integer_in_range(0, 65535),
            default=0,
            help="Port on 127.0.0.1. Default: any free one.",
        ),
        switch("--no-open", "Print the address without opening a browser."),
        option(
            "--html",
            metavar="FILE",
            type=Path,
            help="Instead write one page that needs no server, with flights over one or two parameters.",
        ),
        option(
            "--vary",
            metavar="KEY[=LOW:HIGH]",
            action="append",
            help='With --html: one or two parameters to move, e.g. "vehicle.thrust=350:650 N"; without a range, over '
            "that of the slider. Default: the first two axes of an atlas, or the first parameter.",
        ),
        FORCE,
        NO_CACHE,
    )


def add_other_commands(command: Callable[..., Any], kinds: str) -> None:
    """Add reproduce, new and doctor; `kinds` is the help on the kinds of problems.

    Parameters
    ----------
    command
        ``command(name, help, *options)`` adds a command to the parser.
    kinds
        Text that lists the kinds of problems.
    """
    command(
        "reproduce",
        "Compute every number and figure of a paper and compare them with the printed ones.",
        option("paper", metavar="PAPER", help=" or ".join(PAPERS)),
        option("--out", metavar="DIR", type=Path, required=True, help="Directory of the report."),
        option(
            "--seeds",
            metavar="N",
            type=integer_in_range(1),
            help="Trials of the paper's random search, if it has one.",
        ),
        VERBOSE,
        FORCE,
        NO_CACHE,
    )
    place = "Where to write. Default: stdout for a template, the directory examples for the examples of the manual."
    command(
        "new",
        "Write a commented template of a scenario, or the examples of the manual.",
        option("kind", metavar="KIND", nargs="?", help=kinds),
        option("place", metavar="FILE", nargs="?", type=Path, help=place),
        switch("--force", "Replace existing files."),
    )
    command(
        "doctor",
        "Show versions, available optional parts, and the machine code stored on disk.",
        switch("--clear-cache", "Remove the machine code stored on disk."),
    )
