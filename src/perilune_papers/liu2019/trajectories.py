"""Figs 16 to 18 of the paper: the flights of its experiments 5, 45 and 85, of neighbour B, point by point.

The paper's own have no numbers beside them but those of Table 3. They cannot be flown: their masses belong to burns
that end at some 2800 s, on the way to an interface that is reached after more than 4300 s.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from perilune.core import Matrix
from perilune.report import LOOKS, legend_above, markdown_table, new_figure, styled, track_on_map
from perilune_papers.liu2019.compute import LiuReproduction, ManoeuvreMember, burn_until
from perilune_papers.liu2019.printed import TABLES_1_AND_3, Experiment

NUMBERS = (5, 45, 85)
HEAD = ("experiment", "time [s]", "longitude [deg]", "latitude [deg]", "altitude [km]", "speed [km/s]", "angle [deg]",
        "mass [kg]")  # fmt: skip
_POINTS = 201  # of a phase


def experiments_shown(made: LiuReproduction) -> list[tuple[Experiment, ManoeuvreMember]]:
    """The three experiments, as far as they were solved."""
    rows = zip(TABLES_1_AND_3, made.experiments, strict=True)
    return [(row, member) for row, member in rows if row.number in NUMBERS and member.solution is not None]


def trajectory_columns(member: ManoeuvreMember) -> Matrix:
    """Columns of `HEAD` without the first, from ignition to the end."""
    solution, since, found = member.solution, 0.0, []
    assert solution is not None, "asked for of what was solved"
    for k, flown in enumerate(solution.trajectories):
        t = np.linspace(0.0, flown.duration, _POINTS)
        told = solution.outputs(k, t)
        angles = (np.degrees(told[name]) for name in ("longitude", "latitude"))
        found.append([since + t, *angles, told["altitude"] / 1e3, told["speed"] / 1e3, np.degrees(told["path_angle"]),
                      flown.state(t)[:, 6]])  # fmt: skip
        since += flown.duration
    return np.concatenate(found, axis=1).T


def trajectory_rows(made: LiuReproduction) -> list[list[float]]:
    """Rows of `HEAD`."""
    return [
        [row.number, *point] for row, member in experiments_shown(made) for point in trajectory_columns(member).tolist()
    ]


@styled
def trajectory_figures(made: LiuReproduction) -> Figure:
    """Altitude and speed against time, and latitude against longitude."""
    figure, axes = new_figure(height=2.6, cols=3, width=7.0)
    for (row, member), (colour, dash) in zip(experiments_shown(made), LOOKS, strict=False):
        t, longitude, latitude, altitude, speed, *_ = trajectory_columns(member).T
        text = f"No. {row.number}"
        axes[0].plot(t, altitude, dash, color=colour, label=text)
        axes[1].plot(t, speed, dash, color=colour)
        axes[2].plot(*track_on_map(longitude, latitude), dash, color=colour)
    axes[0].set(ylabel="altitude (km)", xlabel="time from ignition (s)")
    axes[1].set(ylabel="speed (km/s)", xlabel="time from ignition (s)")
    axes[2].set(xlabel="longitude (°)", ylabel="latitude (°)")
    if axes[0].lines:
        legend_above(figure, axes[0], columns=3)
    return figure


def trajectory_section(made: LiuReproduction) -> Iterator[str]:
    """Paragraphs of the section."""
    found = experiments_shown(made)
    yield (
        "The paper draws its flights 5, 45 and 85 without numbers; of them Table 3 has the speed at the end and the "
        "mass, which belongs to a burn that ends long before the interface. Ours are those of neighbour B from the "
        "same manoeuvre points; `fig16_18.csv` has them point by point."
    )
    yield markdown_table(
        ["No.", "Θ, Φ (°)", "printed m_b (kg): its burn (s)", "ours: burn (s)", "m_b (kg)", "t_b (s)", "highest (km)"],
        [
            [
                str(row.number), f"{row.longitude:g}, {row.latitude:g}", f"{row.mass:.1f}: {burn_until(row.mass):.0f}",
                f"{member.value('burn_time'):.1f}", f"{member.value('mass_at_interface'):.2f}",
                f"{member.value('flight_time'):.2f}", f"{trajectory_columns(member)[:, 3].max():.1f}",
            ]
            for row, member in found
        ],
    )  # fmt: skip
    if missing := sorted(set(NUMBERS) - {row.number for row, _ in found}):
        yield "Not solved: " + ", ".join(f"No. {number}" for number in missing) + "."
