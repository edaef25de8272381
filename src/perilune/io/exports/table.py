"""Flight as one table: all phases below each other at the nodes of their states, each column described.

The columns are those of `perilune.io.columns`: outputs, states, controls, costates and H, angles in degrees and
everything else in SI; and where the problem says where in space it flies, position, velocity and thrust acceleration
in inertial axes. What a phase does not have is NaN in it. Where a phase ends and the next begins, and at a switch, a
time stands twice: before it and behind it; or, where each time must be another, the row before it is that of a
microsecond earlier.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from perilune.core import Vector
from perilune.io.columns import Column, node_times, phase_columns
from perilune.io.exports.inertial_path import separate_jumps
from perilune.problem import Solution, views

_AXES = ("x", "y", "z")


@dataclass(frozen=True, kw_only=True)
class FlightColumn:
    """Column of the table.

    Parameters
    ----------
    name, unit, about
        ``about`` says what it is.
    values
        Shape (n,).
    placed
        ``longitude``, ``latitude`` or ``height``, where it places the point below the vehicle or the vehicle above it.
    """

    name: str
    unit: str
    about: str
    values: Vector
    placed: str = ""


@dataclass(frozen=True, kw_only=True)
class FlightTable:
    """Table of a flight; `time` is in seconds from the begin of the flight, `phase` the number of each row's phase."""

    time: Vector
    phase: np.ndarray
    phases: tuple[str, ...]
    fields: tuple[FlightColumn, ...]

    @property
    def phase_names(self) -> np.ndarray:
        """Return the name of each row's phase."""
        return np.array(self.phases)[self.phase]


def flight_table(solution: Solution, parted: bool = False) -> FlightTable:
    """Make the table of a solution.

    Parameters
    ----------
    solution
        The flight.
    parted
        Whether times increase strictly, by a microsecond at least; else both sides of a jump have one time.
    """
    begins = np.cumsum([0.0, *(trajectory.duration for trajectory in solution.trajectories[:-1])])
    times = [begin + trajectory.time for begin, trajectory in zip(begins, solution.trajectories, strict=True)]
    looks = [node_times(trajectory) for trajectory in solution.trajectories]
    if parted:
        times, looks = _separated_times(times, looks)
    parts = []
    for k, look in enumerate(looks):
        found = phase_columns(solution, k, look) if len(look) else {}
        found.pop("time", None)
        parts.append(found | {column.name: column for column in _inertial_columns(solution, k, look)})
    lengths = [len(time) for time in times]
    told, placed = _column_descriptions(solution), _coordinate_kinds(solution.problem.views.space)
    names = {name: part[name].unit for part in parts for name in part}
    return FlightTable(
        time=np.concatenate(times),
        phase=np.repeat(np.arange(len(times), dtype=np.int8), lengths),
        phases=tuple(phase.name for phase in solution.problem.phases),
        fields=tuple(
            FlightColumn(
                name=name,
                unit=unit,
                about=told.get(name) or name.replace("_", " "),
                values=np.concatenate([
                    part[name].values if name in part else np.full(length, np.nan)
                    for part, length in zip(parts, lengths, strict=True)
                ]),
                placed=placed.get(name, ""),
            )
            for name, unit in names.items()
        ),
    )  # fmt: skip


def _separated_times(times: list[Vector], looks: list[Vector]) -> tuple[list[Vector], list[Vector]]:
    """Return times of each phase at least a microsecond apart, and the times in it at which to evaluate it.

    Of those about a jump the last is kept, and the first moved that much before it.
    """
    whole, ends = np.concatenate(times), np.cumsum([len(time) for time in times])[:-1]
    told, kept = separate_jumps(whole)
    look = np.where(told == whole, np.concatenate(looks), np.maximum(np.concatenate(looks) + (told - whole), 0.0))
    here = np.split(kept, ends)

    def rows(values: Vector) -> list[Vector]:
        return [part[own] for part, own in zip(np.split(values, ends), here, strict=True)]

    return rows(told), rows(look)


def _inertial_columns(solution: Solution, k: int, t: Vector) -> Iterator[Column]:
    if solution.problem.phases[k].inertial is None or not len(t):
        return
    for stem, unit, rows in zip(("", "v", "thrust_"), ("m", "m/s", "m/s^2"), solution.inertial(k, t), strict=True):
        for axis, values in zip(_AXES, rows, strict=True):
            yield Column(name=f"inertial_{stem}{axis}", unit=unit, values=values)


def _column_descriptions(solution: Solution) -> dict[str, str]:
    """Return a description of each column."""
    phases = solution.problem.phases
    told = {"H": "Hamiltonian, minimised by the control"}
    for phase in phases:
        for v in (*phase.output_variables, *phase.states):
            told[v.name] = v.description or v.label
        told |= {
            f"lambda_{v.name}": f"costate of {v.name}: derivative of the optimal J with respect to it"
            for v in phase.states
        }
        for control in phase.controls:
            told |= {name: f"control, component of {control.kind}" for name in control.names}
    for stem, what in (("", "position"), ("v", "velocity"), ("thrust_", "thrust acceleration")):
        told |= {f"inertial_{stem}{axis}": f"{what} along {axis} in inertial axes" for axis in _AXES}
    return told


def _coordinate_kinds(space: views.Space | None) -> dict[str, str]:
    if space is None:
        return {}
    names = {space.longitude: "longitude", space.latitude: "latitude", space.height: "height"}
    return {name: kind for name, kind in names.items() if name}
