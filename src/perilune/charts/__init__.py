"""Extremals as smooth functions of parameters: many at once, in lanes, each flown again by another integrator.

A `Chart` has the extremals of one arc sequence over some parameters, `Borders` the bounds within which they are
answers, `ChartReintegration` the independent second flight, and `OpenChart` brings guesses to answers and solutions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.charts.arc_sequence import ArcSequence, arc_sequence_from, arc_sequence_of
    from perilune.charts.borders import Borders, held_at
    from perilune.charts.bound_status import SLACK
    from perilune.charts.chart import Chart, Extremals, Holds
    from perilune.charts.continuation import (
        MOST,
        Lanes,
        StraightContinuation,
        follow_sheets,
        line_places,
        same_unknowns,
    )
    from perilune.charts.feasibility import Allowed, point_feasibility
    from perilune.charts.midpoint_march import MarchedMargins
    from perilune.charts.open_chart import OpenChart
    from perilune.charts.polish import Polished
    from perilune.charts.reintegrate import ChartReintegration
    from perilune.charts.sheet import Sheet

__all__ = [
    "MOST",
    "SLACK",
    "Allowed",
    "ArcSequence",
    "Borders",
    "Chart",
    "ChartReintegration",
    "Extremals",
    "Holds",
    "Lanes",
    "MarchedMargins",
    "OpenChart",
    "Polished",
    "Sheet",
    "StraightContinuation",
    "arc_sequence_from",
    "arc_sequence_of",
    "follow_sheets",
    "held_at",
    "line_places",
    "point_feasibility",
    "same_unknowns",
]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "arc_sequence": "ArcSequence arc_sequence_from arc_sequence_of",
        "borders": "Borders held_at",
        "bound_status": "SLACK",
        "chart": "Chart Extremals Holds",
        "continuation": "MOST Lanes StraightContinuation follow_sheets line_places same_unknowns",
        "feasibility": "Allowed point_feasibility",
        "midpoint_march": "MarchedMargins",
        "open_chart": "OpenChart",
        "polish": "Polished",
        "reintegrate": "ChartReintegration",
        "sheet": "Sheet",
    },
)
