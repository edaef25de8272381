"""Times to find an extremal: the paper's two methods compared with ours, in words and a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import median

import numpy as np

from perilune.core import Vector
from perilune.report import markdown_table
from perilune_papers.liu2019.case import PRINTED_TIMES
from perilune_papers.liu2019.compute import LiuReproduction
from perilune_papers.starts import Starts


def time_section(made: LiuReproduction) -> Iterator[str]:
    """Paragraphs of the section."""
    found, printed = made.searches, ", ".join(f"{seconds:g} s ({name})" for name, seconds in PRINTED_TIMES.items())
    yield (
        "The paper's hybrid method is a genetic search over initial costates and what is free at the interface, and "
        "Pontryagin's conditions from there. Here: 128 individuals, 60 generations, Newton from the three best, from "
        f"another seed each time; processor time. The paper prints {printed}, on another machine."
    )
    free, fixed = (s.results["flight_time"].value for s in (made.site_free["descending"], made.site_fixed))
    rows = [
        _starts_row("A, hybrid", found.hybrid, free),
        _starts_row(
            f"A, ours without a guess (the first: {found.cold:.2f} s, with what is derived once)", found.ours, free
        ),
        *([_starts_row("B, hybrid", found.on_fixed, fixed)] if found.on_fixed.flight_times else []),
    ]
    head = ["neighbour, method", "found the extremal", "elsewhere", "spread of t (s)", "median (s)", "longest (s)"]
    yield markdown_table(head, rows)
    yield (
        f"Neighbour B touches the interface on its way; without any start ours took "
        f"{made.site_fixed.statistics.wall_time:.1f} s by the clock. {_neighbouring_time(made)} "
        "`--seeds 20` tries 20 seeds on A and 4 on B, and the paper's fast method at 20 points."
    )
    yield from _fast_section(made)


def _fast_section(made: LiuReproduction) -> Iterator[str]:
    """The fast methods at the points of Table 1."""
    fast, slow = made.fast, made.searches.on_fixed
    answered = np.isfinite(fast.queried)
    yield (
        "The paper keeps the extremals of the grid, predicts those of a manoeuvre point by (16), and searches within "
        f"2 % of that. Ours is an atlas over the box around the region, {fast.nodes} extremals with their derivatives "
        f"in {fast.built:.1f} s ({'; '.join(fast.kinds)}): it interpolates, makes a step or two of Newton's method, "
        f"and flies the answer again. At the points of Table 1 it answers {np.count_nonzero(answered)} of "
        f"{len(answered)}; solved without an initial guess at {len(fast.alone)} of them the time of flight is the"
        f" same within "
        f"{fast.apart:.0e}, relative."
    )
    rows = [
        [
            "hybrid, without an initial guess",
            f"{PRINTED_TIMES['hybrid method']:g} s",
            _format_times(slow.processor_times),
        ],
        ["fast: (16), then a search within 2 %", f"{PRINTED_TIMES['fast method']:g} s", _format_times(fast.searched)],
        ["fast: (16), then Newton's method", "", _format_times(fast.predicted)],
        ["ours, without an initial guess", "", _format_times(fast.alone)],
        ["ours, from the atlas, re-integrated", "", _format_times(fast.queried)],
    ]
    yield markdown_table(["neighbour B", "printed", "here: median, longest"], rows)
    if answered.any() and slow.processor_times:
        query = 100 * np.nanmedian(fast.queried)
        yield (
            f"A query takes {query / slow.median_time:.2g} % of the hybrid method's time (2.93 % printed), which found "
            f"the extremal from {slow.found(made.site_fixed.results['flight_time'].value)} of "
            f"{len(slow.flight_times)} seeds, and {query / np.median(fast.alone):.2g} % of ours without an initial"
            f" guess."
        )
    yield from (f"- refused: {text}" for text in fast.refused)


def _format_times(seconds: Sequence[float] | Vector) -> str:
    """Median and longest of processor times, and how many there are none of."""
    known = np.array(seconds)[np.isfinite(seconds)]
    if not len(known):
        return "none"
    failed = f", {len(seconds) - len(known)} failed" if len(known) < len(seconds) else ""
    return ", ".join(f"{t:.3g} s" for t in (np.median(known), known.max())) + failed


def _starts_row(name: str, tried: Starts, flight_time: float) -> list[str]:
    return [
        name, f"{tried.found(flight_time)} of {len(tried.flight_times)}", str(tried.elsewhere(flight_time)),
        f"{tried.spread(flight_time):.0e}" if tried.found(flight_time) else "",
        f"{tried.median_time:.3f}", f"{max(tried.processor_times):.3f}",
    ]  # fmt: skip


def _neighbouring_time(made: LiuReproduction) -> str:
    took = [m.processor_time for m in made.experiments if m.solution is not None]
    if not took:
        return "None of the other manoeuvre points was solved."
    return (
        f"From a neighbouring manoeuvre point it takes {median(took):.2f} s of processor time, median of {len(took)}."
    )
