"""How long it takes to find an extremal: the paper's two methods beside ours, in words and a table."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median

from perilune.report.summary import table
from perilune.reproductions.liu2019.case import PRINTED_TIMES
from perilune.reproductions.liu2019.compute import Reproduction
from perilune.reproductions.starts import Starts


def times(made: Reproduction) -> Iterator[str]:
    """Paragraphs of the section."""
    found, printed = made.searches, ", ".join(f"{seconds:g} s ({name})" for name, seconds in PRINTED_TIMES.items())
    yield (
        "The paper's hybrid method is a genetic search over initial costates and what is free at the interface, and "
        "Pontryagin's conditions from there. Here: 128 individuals, 60 generations, Newton from the three best, from "
        f"another seed each time; processor time. The paper prints {printed}, on another machine."
    )
    free, fixed = (s.results["flight_time"].value for s in (made.site_free["descending"], made.site_fixed))
    rows = [
        _row("A, hybrid", found.hybrid, free),
        _row(f"A, ours without a guess (the first: {found.cold:.2f} s, with what is derived once)", found.ours, free),
        *([_row("B, hybrid", found.on_fixed, fixed)] if found.on_fixed.flight_times else []),
    ]
    head = ["neighbour, method", "found the extremal", "elsewhere", "spread of t (s)", "median (s)", "longest (s)"]
    yield table(head, rows)
    yield (
        f"Neighbour B touches the interface on its way; without any start ours took "
        f"{made.site_fixed.statistics.wall_time:.1f} s by the clock. {_neighbouring(made)} "
        "`--seeds 20` tries 20 seeds on A and 4 on B."
    )


def _row(name: str, tried: Starts, flight_time: float) -> list[str]:
    return [
        name, f"{tried.found(flight_time)} of {len(tried.flight_times)}", str(tried.elsewhere(flight_time)),
        f"{tried.spread(flight_time):.0e}" if tried.found(flight_time) else "",
        f"{tried.median_time:.3f}", f"{max(tried.processor_times):.3f}",
    ]  # fmt: skip


def _neighbouring(made: Reproduction) -> str:
    took = [m.processor_time for m in made.experiments if m.solution is not None]
    if not took:
        return "None of the other manoeuvre points was solved."
    return (
        f"From a neighbouring manoeuvre point it takes {median(took):.2f} s of processor time, median of {len(took)}."
    )
