"""The command ``atlas`` and its actions, each with its help and its options."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from perilune.cli.options import (
    FILE,
    FORCE,
    NO_CACHE,
    OUT,
    SET,
    VERBOSE,
    Option,
    integer_in_range,
    option,
    prove_option,
    real,
    switch,
)

_DIRECTORY = option("directory", metavar="DIR", type=Path, help="The atlas, as `perilune atlas build` made it.")
_WORKERS = option(
    "--workers", metavar="N", type=integer_in_range(1), default=1, help="Processes side by side. Usually 1."
)

_SCHEDULER = option(
    "--scheduler",
    metavar="ADDRESS",
    help="Of a Dask cluster that computes, e.g. tcp://10.0.0.1:8786; pip install 'perilune[cluster]'.",
)
_SAMPLE = option(
    "--sample",
    metavar="N",
    type=integer_in_range(0),
    help="Answers drawn at random that are proved to level 3. Usually 1 of 100 nodes, at most 10; 459 says most.",
)


def add_atlas_commands(command: Callable[..., Any]) -> None:
    """Add the command ``atlas`` and its actions."""
    made = command("atlas", "Map optimal flights over a region of parameters once, and answer from the map at once.")
    actions = made.add_subparsers(dest="action", metavar="ACTION", title="Actions", required=True)
    _add_atlas_build(command, actions)
    _add_atlas_growth(command, actions)
    _add_atlas_reading(command, actions)


def _at(about: str) -> Option:
    return option("--at", metavar="KEY=VALUE", action="append", default=[], help=about)


def _add_atlas_build(command: Callable[..., Any], actions: Any) -> None:
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
        _WORKERS,
        _SCHEDULER,
        _SAMPLE,
        switch("--resume", "Go on with the atlas that is in --out DIR already."),
        VERBOSE,
        FORCE,
        NO_CACHE,
        among=actions,
    )


def _add_atlas_growth(command: Callable[..., Any], actions: Any) -> None:
    command(
        "atlas extend",
        "Map more of the same problem around an atlas; what is there is kept. Without a range: what is missing.",
        _DIRECTORY,
        option(
            "--vary",
            metavar="KEY=LOW:HIGH",
            action="append",
            default=[],
            help="The wider range of an axis; may be repeated.",
        ),
        _WORKERS,
        _SCHEDULER,
        _SAMPLE,
        VERBOSE,
        NO_CACHE,
        among=actions,
    )
    command(
        "atlas merge",
        "Make one atlas of two of the same problem: of the same region, or side by side.",
        _DIRECTORY,
        option("other", metavar="OTHER", type=Path, help="Another atlas."),
        option("--out", metavar="DIR", type=Path, required=True, help="Where the new one goes."),
        VERBOSE,
        FORCE,
        among=actions,
    )


def _add_atlas_reading(command: Callable[..., Any], actions: Any) -> None:
    command(
        "atlas query",
        "Answer at one point of an atlas.",
        _DIRECTORY,
        _at('Of every axis, e.g. "vehicle.thrust=440 N".'),
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
        _DIRECTORY,
        option("--axes", metavar="A,B", help="Along which axes, one or two; the first two if left out."),
        _at("Of the other axes; in the middle of their ranges if left out."),
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
        _DIRECTORY,
        option("--format", metavar="FORMAT", help="netcdf or parquet; unless given as FILE is called."),
        option("--out", metavar="FILE", type=Path, required=True, help="The file."),
        FORCE,
        among=actions,
    )
    command("atlas info", "Say what an atlas maps, and how much of it is there.", _DIRECTORY, among=actions)
    command(
        "atlas verify",
        "Look at every file of an atlas, and prove nodes that are drawn at random.",
        _DIRECTORY,
        option(
            "--sample", metavar="N", type=integer_in_range(0), default=50, help="How many. Usually 50; 459 says most."
        ),
        option("--seed", metavar="N", type=integer_in_range(0), help="Of the draw; another each time if left out."),
        VERBOSE,
        NO_CACHE,
        among=actions,
    )
