"""Output of the program: documents, tables, figures, reports. matplotlib is imported for figures only."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
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
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
