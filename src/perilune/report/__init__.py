"""Output of the program: documents, tables, figures, reports. matplotlib is imported for figures only."""

from __future__ import annotations

from typing import TYPE_CHECKING

from perilune.core.facade import deferred

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from perilune.report.atlas_maps import write_maps
    from perilune.report.contour_map import require_map
    from perilune.report.directory import add_report, write_all
    from perilune.report.family import family_csv, family_document, write_family
    from perilune.report.figures import solution_drawings
    from perilune.report.ground import coastline, track_on_map
    from perilune.report.opportunities import opportunities_answer
    from perilune.report.profile_view import plane_of_flight
    from perilune.report.side_and_top_view import track_figure
    from perilune.report.style import LOOKS, legend_above, line_figure, new_figure, save_figure, styled
    from perilune.report.summary import markdown_table, solution_summary
    from perilune.report.time_histories import history_figure

__all__ = [
    "LOOKS",
    "add_report",
    "coastline",
    "family_csv",
    "family_document",
    "history_figure",
    "legend_above",
    "line_figure",
    "markdown_table",
    "new_figure",
    "opportunities_answer",
    "plane_of_flight",
    "require_map",
    "save_figure",
    "solution_drawings",
    "solution_summary",
    "styled",
    "track_figure",
    "track_on_map",
    "write_all",
    "write_family",
    "write_maps",
]

__getattr__: Callable[[str], Any] = deferred(
    __name__,
    {
        "atlas_maps": "write_maps",
        "contour_map": "require_map",
        "directory": "add_report write_all",
        "family": "family_csv family_document write_family",
        "figures": "solution_drawings",
        "ground": "coastline track_on_map",
        "opportunities": "opportunities_answer",
        "profile_view": "plane_of_flight",
        "side_and_top_view": "track_figure",
        "style": "LOOKS legend_above line_figure new_figure save_figure styled",
        "summary": "markdown_table solution_summary",
        "time_histories": "history_figure",
    },
)
