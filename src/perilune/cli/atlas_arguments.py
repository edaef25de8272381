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
    real,
    switch,
    verify_options,
)

_DIRECTORY = option(
    "directory", metavar="DIR", type=Path, help="The directory of an atlas, from `perilune atlas build`."
)
_WORKERS = option("--workers", metavar="N", type=integer_in_range(1), default=1, help="Parallel processes. Default: 1.")

_SCHEDULER = option(
    "--scheduler",
    metavar="ADDRESS",
    help="Scheduler of a Dask cluster to compute on, e.g. tcp://10.0.0.1:8786; pip install 'perilune[cluster]'.",
)
_SAMPLE = option(
    "--sample",
    metavar="N",
    type=integer_in_range(0),
    help="Number of random answers to prove to level 3. Default: 1 of 100 nodes, at most 10. If all of 459 pass,"
    " at least 99 %% of all pass, at 99 %% confidence.",
)


def add_atlas_commands(command: Callable[..., Any]) -> None:
    """Add the command ``atlas`` and its actions."""
    made = command("atlas", "Map optimal flights over a region of parameters, and answer queries from the map.")
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
            help='E.g. "vehicle.thrust=350:650 N"; if given more than once, the region is the product of the ranges.',
        ),
        SET,
        option("--out", metavar="DIR", type=Path, required=True, help="Directory of the atlas."),
        option(
            "--tolerance",
            metavar="PART",
            type=real,
            help="Relative error that one step of Newton's method must reach. Default: 1e-9.",
        ),
        option(
            "--bricks",
            metavar="N",
            type=integer_in_range(1),
            help="Number of bricks along each axis; they are computed in parallel. Default: 8 for one axis, 4 for"
            " two, 2 for more.",
        ),
        _WORKERS,
        _SCHEDULER,
        _SAMPLE,
        switch("--resume", "Continue with the atlas that is already in --out DIR."),
        VERBOSE,
        FORCE,
        NO_CACHE,
        among=actions,
    )


def _add_atlas_growth(command: Callable[..., Any], actions: Any) -> None:
    command(
        "atlas extend",
        "Extend an atlas to a wider region of the same problem, keeping what is there. Without a range: build what is"
        " missing.",
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
        "Merge two atlases of the same problem, over the same region or over adjacent ones.",
        _DIRECTORY,
        option("other", metavar="OTHER", type=Path, help="Another atlas."),
        option("--out", metavar="DIR", type=Path, required=True, help="Directory of the merged atlas."),
        VERBOSE,
        FORCE,
        among=actions,
    )


def _add_atlas_reading(command: Callable[..., Any], actions: Any) -> None:
    command(
        "atlas query",
        "Answer at one point of an atlas.",
        _DIRECTORY,
        _at('Value of every axis, e.g. "vehicle.thrust=440 N".'),
        OUT,
        *verify_options("Prove the answer"),
        VERBOSE,
        FORCE,
        NO_CACHE,
        among=actions,
    )  # fmt: skip
    command(
        "atlas plot",
        "Draw a slice of an atlas: cost, free parameters, sheets (families of extremals), refusals, nodes and errors.",
        _DIRECTORY,
        option("--axes", metavar="A,B", help="One or two axes along which to slice. Default: the first two."),
        _at("Values of the other axes. Default: the middle of their ranges."),
        option(
            "--points",
            metavar="N",
            type=integer_in_range(2, 2000),
            default=101,
            help="Number of points along each axis. Default: 101.",
        ),
        OUT,
        FORCE,
        NO_CACHE,
        among=actions,
    )
    command(
        "atlas export",
        "Export all nodes of an atlas to one file for other programs.",
        _DIRECTORY,
        option("--format", metavar="FORMAT", help="netcdf or parquet. Default: by the ending of FILE."),
        option("--out", metavar="FILE", type=Path, required=True, help="The file."),
        FORCE,
        among=actions,
    )
    command("atlas info", "Show what an atlas maps, and how much of it is built.", _DIRECTORY, among=actions)
    command(
        "atlas verify",
        "Check every file of an atlas, and prove nodes drawn at random.",
        _DIRECTORY,
        option(
            "--sample",
            metavar="N",
            type=integer_in_range(0),
            default=50,
            help="Number of nodes to prove. Default: 50. If all of 459 pass, at least 99 %% of all pass, at 99 %%"
            " confidence.",
        ),
        option(
            "--seed",
            metavar="N",
            type=integer_in_range(0),
            help="Seed of the draw. Default: a different one each time.",
        ),
        VERBOSE,
        NO_CACHE,
        among=actions,
    )
