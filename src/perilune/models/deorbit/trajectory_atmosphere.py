"""Atmosphere along a return: at each altitude the air where and when the flight passes it.

Of a return that is not solved yet the way is that of its rough flight, which goes through the air itself: flown and
tabulated in turn until the table stays. Its place and its times are near enough for air that changes over hundreds of
kilometres and hours; `perilune.models.deorbit.atmosphere_iteration` goes on with solved flights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import NUMERIC, Matrix, Physics, Vector
from perilune.models.deorbit.initial_guess import rough_trajectory, typical_times
from perilune.models.deorbit.records import Atmosphere
from perilune.models.physics import ellipsoid
from perilune.models.physics.atmosphere import Air, TrajectoryProfile, standard, thermosphere
from perilune.problem import Parameter

NEAR = 1e-3  # of a density: a table that changes by less stays
_ROUNDS = 4
_LOOKS = np.linspace(0.0, 150.0, 301)  # km


def profile_of_states(rows: Matrix, time: Vector, p: Any) -> TrajectoryProfile:
    """The way of states (points, states) at times [s] after t = 0.

    Parameters
    ----------
    rows
        States [SI] in axes that turn with the body, (points, states), position first.
    time
        Their times [s], (points,).
    p
        Parameters [SI].
    """
    position = tuple(rows[:, :3].T)
    return TrajectoryProfile.down(
        ellipsoid.altitude(position, p, NUMERIC), np.arctan2(position[1], position[0]),
        ellipsoid.latitude(position, p, NUMERIC), time,
    )  # fmt: skip


def rough_air(
    stated: Atmosphere, epoch: datetime, given: Mapping[str, Parameter], angles: Physics, names: Sequence[str]
) -> Air:
    """Air of a day along the rough flight of a return.

    Parameters
    ----------
    stated
        Solar and geomagnetic indices of the day.
    epoch
        UTC of t = 0.
    given
        Parameters of the return, by name [SI].
    angles
        ``angles(p, xp)`` returns the argument of latitude and the longitude of the node at t = 0 [rad].
    names
        Phases in order of flight.
    """
    p = SimpleNamespace(**{name: value.value for name, value in given.items()})
    air = standard()
    for name, value in air.given.items():
        setattr(p, name, value.value)
    for _ in range(_ROUNDS):
        lengths = typical_times(p, angles, air, coasts="coast" in names, drifts="drift" in names)
        for name, value in lengths.items():
            setattr(p, name, value)
        rows = rough_trajectory(p, angles=angles, air=air, names=tuple(names), heat=False)[list(names).index("entry")]
        before = sum(value for name, value in lengths.items() if name in ("coast_time", "burn_time", "drift_time"))
        time = before + np.linspace(0.0, lengths["entry_time"], len(rows))
        last, air = air, air_along(stated, epoch, profile_of_states(rows, time, p))
        if largest_density_change(last, air) < NEAR:
            break
    return air


def air_along(stated: Atmosphere, epoch: datetime, way: TrajectoryProfile) -> Air:
    """Air of a day along a way.

    Parameters
    ----------
    stated
        Solar and geomagnetic indices of the day.
    epoch
        UTC of t = 0.
    way
        Longitude, latitude [rad] and time [s] at each altitude.
    """
    assert stated.f107 is not None and stated.f107a is not None and stated.ap is not None
    return thermosphere(epoch, way, f107=stated.f107, f107a=stated.f107a, ap=stated.ap)


def largest_density_change(before: Air, after: Air) -> float:
    """The largest change of the density between two airs of tables, as a share of it.

    Parameters
    ----------
    before, after
        Air of tables over the same reference altitude.
    """
    assert before.table is not None and after.table is not None
    return float(np.abs(np.expm1(after.table(_LOOKS) - before.table(_LOOKS))).max())
