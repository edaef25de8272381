"""Report and figures on Liu, Liu, Wu 2019: results of its example and equations, and two neighbours that fly."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from perilune import Solution
from perilune.core import Vector
from perilune.report import line_figure, markdown_table, solution_drawings, solution_summary
from perilune_papers.liu2019.case import CASE, paper_costates
from perilune_papers.liu2019.compute import (
    LiuReproduction,
    away_from_plane,
    burn_until,
    hamiltonian_by_thrust,
    mass_after,
    sideways_reach,
)
from perilune_papers.liu2019.csv_tables import comma_separated, table_2, table_2_rows, table_3
from perilune_papers.liu2019.equations import NAMES, SAMPLES
from perilune_papers.liu2019.fast import WITHIN
from perilune_papers.liu2019.members import ManoeuvreMember
from perilune_papers.liu2019.printed import TABLE_2, TABLES_1_AND_3
from perilune_papers.liu2019.surfaces import fit_errors, fit_table, surfaces
from perilune_papers.liu2019.times import time_section
from perilune_papers.liu2019.trajectories import HEAD, trajectory_figures, trajectory_rows, trajectory_section
from perilune_papers.paper import claim_verdict, claims_section, figure_markdown, versions_line, write_paper_report

_CAPTIONS = {
    "mass": "Mass that full thrust leaves. Vertical: range of the printed t_a; horizontal: of the printed m_b.",
    "off_plane": "Angle of the printed site from the plane of the orbit through (16°, 39.5°), while the Earth turns "
    "below it; and what full thrust sideways moves the vehicle by until then.",
    "fig7_15": "Figs 7 to 15, of neighbour B: costates at ignition in the paper's units, speed and angle at the "
    "interface, and its time. Dots: the manoeuvre points of Table 2.",
    "fig16_18": "Figs 16 to 18, of neighbour B: its flights from the points of experiments 5, 45 and 85.",
    "altitude": "Neighbour B, altitude: it touches the interface, climbs, and comes back.",
    "ground_track": "Neighbour B over the ground, to (-98°, 38°). The printed site is at (-158°, 38°).",
    "air": "Neighbour B: what the air does, from the interface on.",
    "steering": "Neighbour B: the direction of the thrust in axes that turn with the Earth.",
}  # fmt: skip


def write_liu_report(made: LiuReproduction, directory: Path) -> None:
    """Write ``report.md``, its data and its figures into a directory that exists.

    Parameters
    ----------
    made
        Everything that was computed.
    directory
        Where to write.
    """
    data = {
        "table2.csv": table_2(made),
        "table3.csv": table_3(made),
        "fig16_18.csv": comma_separated(HEAD, trajectory_rows(made)),
    }
    write_paper_report(directory, liu_report(made), liu_figures(made), data)


def liu_figures(made: LiuReproduction) -> dict[str, Figure]:
    """Return all figures, by file name."""
    ours = solution_drawings(made.site_fixed)
    return {
        "mass": _mass_figure(),
        "off_plane": _off_plane_figure(),
        "fig7_15": surfaces(made.grid),
        "fig16_18": trajectory_figures(made),
        **{name: ours[name]() for name in ("altitude", "ground_track", "air", "steering")},
    }


def liu_report(made: LiuReproduction) -> str:
    """Write the report."""
    parts = [
        "# Return from orbit in the least time: the paper and our numbers",
        "Liu, Liu, Wu, Mathematical Problems in Engineering 2019, 5319530. Everything but what is called *printed* was "
        "computed when this report was made, without a guess. **The printed example cannot be flown**; two neighbours "
        "of it can, and stand in its place.",
        claims_section(_liu_claims(made)),
        "## The printed example",
        "Before anything is solved it is refused, whatever the pass, with all the propellant that the longest printed "
        "t_a burns:",
        "\n".join(f"- {going}: {text}" for going, text in made.refusals.items()),
        _mass_section(),
        "### The printed costates, flown",
        _printed_flight_section(made),
        "## The printed equations",
        *_equation_section(made),
        "## Neighbour A: the site free",
        "(12) at its word: nothing is asked of the place, so that its costates end at 0. The flight ends at 120 km "
        "under -6°, from (16°, 39.5°), in the least time. By symmetry its costates cannot depend on the longitude, "
        "as those of Table 2 do.",
        _neighbour_table(made.site_free),
        "## Neighbour B: a site in the plane of the orbit",
        "The site is moved to (-98°, 38°), and the costates at the interface are what the way through the air makes of "
        "the place, not the zeros of (12). Speed and angle sit on their bounds. Fixed there, the same conditions but "
        "for the sign of J's multiplier are met by a second extremal, **a time maximum**: none nearby takes longer.",
        _neighbour_table({"least time": made.site_fixed, "most time": made.slowest}),
        "### In the form of Table 2",
        "λ at ignition, in the paper's coordinates and units, from the manoeuvre points that Table 2 prints.",
        markdown_table(_TABLE_2_HEAD, [_table_2_cells(row) for row in table_2_rows(made)]),
        *_unsolved_points(made),
        "### In the form of Table 3",
        _landing_section(made),
        "### Figs 16 to 18",
        *trajectory_section(made),
        "### Figs 19 to 27",
        "What (16), fitted to the grid, misses at the points of Table 1; what is at a bound is one number everywhere.",
        fit_table(made.grid, made.experiments),
        "## Time",
        *time_section(made),
        "## Figures",
        *figure_markdown(_CAPTIONS),
        "## Data",
        "`table2.csv` and `table3.csv` hold every row of the tables, the printed one beside ours; `fig16_18.csv` the "
        "points of Figs 16 to 18.",
        "## The flights",
        "```text\n" + "\n\n".join(
            solution_summary(s, every_check=False) for s in (*made.site_free.values(), made.site_fixed, made.slowest)
        ) + "\n```",
        versions_line(),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


# -- why the printed example cannot be flown --------------------------------------------------------------------------


def _liu_claims(made: LiuReproduction) -> list[list[str]]:
    """Return each claim that the paper makes or implies, the numbers that decide it, and whether it holds."""
    times, masses = _printed_column(TABLE_2, "time"), _printed_column(TABLES_1_AND_3, "mass")
    left = np.array([mass_after(float(t)) for t in times])
    off, longitude = made.off_plane, _printed_column(TABLE_2, "lambda_longitude")
    nearest = ", ".join(f"{_format_range(np.degrees(angles), 1)}° {going}" for going, angles in off.away.items())
    turned = hamiltonian_by_thrust()
    missed = min(float(np.abs(f.altitude - CASE.interface_altitude / 1e3).min()) for f in made.flown)
    twice = _same_place()
    missed_most = np.max(list(fit_errors(made.grid, made.experiments).values()), axis=0)
    reached = missed_most[np.isfinite(missed_most)]
    speeds = _computed_values(made.grid, "interface_speed")
    angles = np.degrees(_computed_values(made.grid, "interface_angle"))
    inside = (speeds > CASE.speeds[0] + 1) & (angles < math.degrees(CASE.angles[1]) - 1e-3)
    return [
        [
            "full thrust over t_a leaves m_b",
            "Tables 2, 3",
            f"{_format_range(left, 1)} kg; printed {_format_range(masses, 1)} kg",
            claim_verdict(left.max() >= masses.min()),
        ],
        [
            "the site is within reach",
            "4.1",
            f"{nearest} off the plane of the orbit; sideways thrust moves {_format_range(np.degrees(off.reach), 1)}°",
            claim_verdict(bool(any((angle < off.reach).any() for angle in off.away.values()))),
        ],
        [
            "λ_Θ, constant by (6), ends at 0 by (12)",
            "Table 2",
            f"printed {_format_range(longitude, 3)}; along a line in latitude, r² = {_straightness():.3f}",
            claim_verdict(bool((longitude == 0).all())),
        ],
        [
            "the thrust of (9) makes H least",
            "(9), Table 2",
            f"turned around, it makes H smaller by {_format_range(turned, 2)}, where H = -1",
            claim_verdict(bool((turned <= 0).all())),
        ],
        [
            "the printed costates lead to 120 km",
            "Table 2",
            f"{missed:.0f} km off at best, see below",
            claim_verdict(missed < 1.0),
        ],
        ["one place, one answer", "Tables 1, 3", twice or "no place is there twice", claim_verdict(not twice)],
        [
            "speed and angle at the interface lie within their bounds",
            "Table 2",
            f"neighbour B: inside at {int(inside.sum())} of {len(inside)} points",
            claim_verdict(bool(inside.all())),
        ],
        [
            "(16) predicts the values at a point to 2 %",
            "Figs 7-15",
            f"neighbour B: all nine at {int((reached < WITHIN).sum())} of {len(reached)} points; at worst "
            f"{100 * max(reached, default=0.0):.2g} % of a quantity's size",
            claim_verdict(bool((reached < WITHIN).all())),
        ],
    ]


def _mass_section() -> str:
    masses = _printed_column(TABLES_1_AND_3, "mass")
    shorter = [burn_until(float(mass)) for mass in (masses.max(), masses.min())]
    return (
        f"The printed masses belong to burns of {shorter[0]:.0f} to {shorter[1]:.0f} s, near neighbour A's, while "
        f"t_a is printed as {_format_range(_printed_column(TABLE_2, 'time'), 1)} s; the paper knows no coast on the "
        f"way."
    )


def _same_place() -> str:
    """Rows of Table 1 that are of one place and have other answers."""
    found = [
        f"rows {a.number} and {b.number}: {a.landing_speed:.3f} and {b.landing_speed:.3f} km/s"
        for a, b in combinations(TABLES_1_AND_3, 2)
        if (a.longitude, a.latitude) == (b.longitude, b.latitude) and a[3:] != b[3:]
    ]
    return "; ".join(found)


def _straightness() -> float:
    """Share of the variance of the printed lambda_Theta that a line in latitude explains."""
    return float(
        np.corrcoef(_printed_column(TABLE_2, "latitude"), _printed_column(TABLE_2, "lambda_longitude"))[0, 1] ** 2
    )


def _printed_flight_section(made: LiuReproduction) -> str:
    head = ["thrust", "altitude (km)", "speed (km/s)", "angle (°)", "λ_ψ", "λ_m"]
    rows = [
        [
            f.direction,
            _format_range(f.altitude, 0),
            _format_range(f.speed, 3),
            _format_range(f.angle, 2),
            _format_range(f.lambda_course, 2),
            _format_range(f.lambda_mass, 2),
        ]
        for f in made.flown
    ]
    printed = [
        "printed",
        "120",
        _format_range(_printed_column(TABLE_2, "speed"), 3),
        _format_range(_printed_column(TABLE_2, "angle"), 2),
        "0",
        "0",
    ]
    return (
        "Each row of Table 2, flown by the right equations for its printed t_a, with λ_Φ from H(t_0) = -1 as the paper "
        "has it; λ_ψ and λ_m should end at 0 by (12). A negative altitude is below the ground, which nothing here "
        "stops.\n\n" + markdown_table(head, [*rows, printed])
    )


# -- equations --------------------------------------------------------------------------------------------------------


def _equation_section(made: LiuReproduction) -> Iterable[str]:
    found = made.equations
    yield (
        f"At {SAMPLES} sampled states of a transition, dimensionless. The right equations are those of "
        "`perilune_papers.liu2019.flight_path`; Newton's law in Cartesian coordinates judges both."
    )
    yield markdown_table(
        ["row of (1)", "printed, largest error", "corrected, largest error"],
        [[f"{name}'", f"{printed:.1e}", f"{right:.1e}"] for name, (printed, right) in found.off.items()],
    )
    yield f"These slips are all of it; they leave {found.unexplained:.0e} unexplained:"
    yield markdown_table(
        ["row", "printed", "right", "difference, up to"],
        [[s.row, s.printed, s.right, f"{s.size:.2g} {s.unit}"] for s in found.slips],
    )
    yield "In ψ' (1) prints g_θ as well, which is defined nowhere: g_Φ. In (2) and (7), printed over right derivative:"
    yield markdown_table(
        ["derivative", "printed over right"], [[name, f"{v:.6g}"] for name, v in found.gravity.items()]
    )
    rows = [[c.row, c.costate, _share(c.own), _share(c.right)] for c in found.coefficients]
    yield (
        f"Of the 49 coefficients of (6), {len(rows)} are not -∂f_j/∂x_i of the right (1). Where the first says 0, "
        "the row was differentiated rightly from the wrong (1); the others are slips of their own:"
    )
    yield markdown_table(["row of (6)", "coefficient of", "off from the printed (1)", "off from the right (1)"], rows)
    yield (
        "(8) needs a minus in its second line. H is least for thrust along -(λ_V, λ_γ/V, λ_ψ/(V cos γ)); (9) has the "
        "opposite for λ_V > 0. (13) prints λ_Θ(t_b) = Θ_b and λ_Φ(t_b) = Φ_b, where places are meant."
    )


def _share(value: float) -> str:
    return "0" if value == 0 else "right one is 0" if math.isinf(value) else f"{100 * value:.3g} %"


# -- neighbours -------------------------------------------------------------------------------------------------------


def _neighbour_table(flights: dict[str, Solution]) -> str:
    """Numbers of each flight, one column for each, and its costates in the paper's units."""
    rows = []
    for name, unit, factor in (
        ("flight_time", "s", 1.0), ("transition_time", "s", 1.0), ("mass_at_interface", "kg", 1.0),
        ("interface_speed", "km/s", 1e-3), ("interface_angle", "°", math.degrees(1)), ("landing_speed", "km/s", 1e-3),
        ("peak_load", "g0", 1.0), ("along_track_per_second_late", "km", 1e-3),
        ("along_track_per_percent_thrust", "km", 1e-3), ("along_track_per_percent_drag", "km", 1e-3),
    ):  # fmt: skip
        known = [s.results.get(name) for s in flights.values()]
        cells = [f"{factor * r.value:.4f}" for r in known if r is not None]
        if cells:
            rows.append([f"{name.replace('_', ' ')} ({unit})", *cells])
    for when in ("ignition", "interface"):
        ends = [paper_costates(s, 0, 0.0 if when == "ignition" else s.trajectories[0].duration)
                for s in flights.values()]  # fmt: skip
        rows += [
            [f"λ_{name} at {when}", *(f"{_format_nil(end[i]):.4f}" for end in ends)] for i, name in enumerate(NAMES)
        ]
    rows.append(["proof", *(f"{s.outcome.name}, level {s.verification.level}" for s in flights.values())])
    return markdown_table(["", *flights], rows)


def _format_nil(value: float) -> float:
    """Return the value without a minus before a zero."""
    return 0.0 if abs(value) < 5e-5 else float(value)


_TABLE_2_HEAD = ["Θ", "Φ", *(f"λ_{name}" for name in NAMES), "V_a (km/s)", "γ_a (°)", "t_a (s)"]


def _table_2_cells(row: Sequence[float]) -> list[str]:
    """A row of Table 2 as the paper writes it."""
    return [f"{row[0]:g}", f"{row[1]:.3f}", *(f"{v:.3f}" for v in row[2:-1]), f"{row[-1]:.1f}"]


def _landing_section(made: LiuReproduction) -> str:
    speeds = _computed_values(made.experiments, "landing_speed") / 1e3
    masses = _computed_values(made.experiments, "mass_at_interface")
    solved = int(np.isfinite(masses).sum())
    return (
        f"{solved} of {len(masses)} manoeuvre points of Table 1 solved. Final mass {_format_range(masses, 2)} kg, "
        f"printed "
        f"{_format_range(_printed_column(TABLES_1_AND_3, 'mass'), 1)} kg. Speed at the end, 10 km over the site, "
        f"{_format_range(speeds, 4)} "
        f"km/s; printed, at the ground, {_format_range(_printed_column(TABLES_1_AND_3, 'landing_speed'), 3)} km/s, "
        f"of a vehicle that "
        "air hardly brakes. Every row is in `table3.csv`."
    )


def _unsolved_points(made: LiuReproduction) -> list[str]:
    """List what could not be solved, so that no gap is silent."""
    missing = [
        f"- ({m.longitude:g}°, {m.latitude:g}°): {m.message}"
        for m in (*made.grid, *made.experiments)
        if m.solution is None
    ]
    return ["Not solved, and missing in tables and figures:", "\n".join(missing)] if missing else []


# -- small things -----------------------------------------------------------------------------------------------------


def _printed_column(rows: Sequence[Any], name: str) -> Vector:
    return np.array([getattr(row, name) for row in rows])


def _computed_values(members: Sequence[ManoeuvreMember], name: str) -> Vector:
    return np.array([m.value(name) for m in members])


def _format_range(values: Vector, decimals: int) -> str:
    """Least to greatest of what is there, or the one value that all round to."""
    known = values[np.isfinite(values)]
    if not len(known):
        return "none"
    low, high = (f"{v:.{decimals}f}" for v in (known.min(), known.max()))
    return low if low == high else f"{low} to {high}"


def _mass_figure() -> Figure:
    times, masses = _printed_column(TABLE_2, "time"), _printed_column(TABLES_1_AND_3, "mass")
    t = np.linspace(0.0, 5000.0, 201)
    low, high = mass_after(float(t[-1])), CASE.mass
    gap = math.nan  # between two strokes of one look
    when, left = [f(times) for f in (np.min, np.max)], [f(masses) for f in (np.min, np.max)]
    curves = [
        (t, [mass_after(float(v)) for v in t], "-", "full thrust"),
        ([when[0]] * 2 + [gap] + [when[1]] * 2, [low, high, gap, low, high], "--", "printed t_a"),
        ([t[0], t[-1], gap, t[0], t[-1]], [left[0]] * 2 + [gap] + [left[1]] * 2, ":", "printed m_b"),
    ]
    return line_figure(curves, ("time from ignition (s)", "mass (kg)"), height=2.5)


def _off_plane_figure() -> Figure:
    t = np.linspace(0.0, 7200.0, 361)
    longitude, latitude = (math.degrees(angle) for angle in CASE.place)
    longest = max(row.time for row in TABLE_2)
    curves = [(t, np.degrees(away_from_plane(longitude, latitude, going, t)), dash, going)
              for going, dash in (("descending", "-"), ("ascending", "--"))]  # fmt: skip
    reach = np.degrees([sideways_reach(longest, float(at)) for at in t])
    return line_figure(
        [*curves, (t, reach, ":", "sideways thrust")], ("time from ignition (s)", "angle (°)"), height=2.5
    )
