"""Extremals as smooth functions of parameters: many at once, in lanes, each integrated again by another integrator.

A `Chart` has the extremals of one arc sequence over some parameters, `Borders` the bounds within which they are
answers, `ChartReintegration` the independent re-integration, and `OpenChart` brings guesses to answers and solutions.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
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
    from perilune.charts.extrapolated_midpoint import MarchedMargins
    from perilune.charts.feasibility import Allowed, point_feasibility
    from perilune.charts.open_chart import OpenChart
    from perilune.charts.point_solver import KnownExtremal, PointSolver
    from perilune.charts.polish import Polished
    from perilune.charts.reintegrate import ChartReintegration
    from perilune.charts.sheet import Sheet
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
