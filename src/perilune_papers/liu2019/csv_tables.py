"""Tables 1 to 3 of Liu et al. as comma-separated values, ours beside the printed."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

from perilune_papers.liu2019.compute import LiuReproduction
from perilune_papers.liu2019.printed import TABLE_2, TABLES_1_AND_3


def table_2_rows(made: LiuReproduction) -> list[list[float]]:
    """Return the rows of Table 2 of neighbour B: place, costates, speed [km/s], angle [deg] and time [s]."""
    return [
        [m.longitude, m.latitude, *m.costates(), m.value("interface_speed") / 1e3,
         math.degrees(m.value("interface_angle")), m.value("transition_time")]
        for m in made.grid
    ]  # fmt: skip


def table_2(made: LiuReproduction) -> str:
    """Table 2 as comma-separated values, ours and the printed."""
    costates = "V gamma psi r Theta Phi m".split()
    ours = [
        "longitude [deg]",
        "latitude [deg]",
        *(f"lambda_{name} [1]" for name in costates),
        "V_a [km/s]",
        "gamma_a [deg]",
        "t_a [s]",
    ]
    printed = [f"printed {name}" for name in TABLE_2[0]._fields[2:]]
    rows = [[*row, *given[2:]] for row, given in zip(table_2_rows(made), TABLE_2, strict=True)]
    return comma_separated([*ours, *printed], rows)


def table_3(made: LiuReproduction) -> str:
    """Tables 1 and 3 as comma-separated values, ours and the printed."""
    head = [
        "number",
        "longitude [deg]",
        "latitude [deg]",
        "flight time [s]",
        "landing speed [km/s]",
        "mass [kg]",
        "processor time [s]",
        "printed landing speed [km/s]",
        "printed mass [kg]",
    ]
    rows = [
        [
            e.number,
            m.longitude,
            m.latitude,
            m.value("flight_time"),
            m.value("landing_speed") / 1e3,
            m.value("mass_at_interface"),
            m.processor_time,
            e.landing_speed,
            e.mass,
        ]
        for e, m in zip(TABLES_1_AND_3, made.experiments, strict=True)
    ]
    return comma_separated(head, rows)


def comma_separated(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return rows under a head as comma-separated values.

    Parameters
    ----------
    head
        Names of the columns.
    rows
        Cells of each row, in the order of the columns.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    return text.getvalue()
