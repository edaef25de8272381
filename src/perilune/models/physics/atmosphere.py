"""Atmosphere: density against altitude, as smooth functions that every part of the library integrates.

Exponential air is a formula. All other air is a table of the logarithm of the density (`xp.table`, six times
differentiable), so that there is no layer at whose boundary a flight would have to stop:

    rho = rho_ref exp(table(h/h_ref))

`tabulated` chooses its knots: beginning with a few, it adds the sample from which the table is furthest, until it is
near enough to all. The U.S. Standard Atmosphere, 1976, is followed to 1e-3 of its density from -5 to 1000 km, its kinks
at layers' boundaries included. Above and below, a table goes on as exponential air does.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from perilune.core import MOST_KNOTS, PeriluneError, Table, Vector, one_line
from perilune.models.physics import standard_atmosphere
from perilune.models.physics.air_table import read_air_table
from perilune.problem import Parameter

STANDARD_NEAR = 1e-3  # of the density
NEAR, ROUGHEST = 1e-3, 1e-2  # of the density: aimed at, and refused
_KILOMETRE = 1e3  # m, by which tables count altitudes
_SEA_LEVEL = 1.225  # kg/m^3, by which they count densities
_FIRST_KNOTS = 12
_LOWEST = -500.0  # m, of NRLMSIS, so that flights to altitude 0 do not end at the edge of a table
_PLACE = 3  # digits of degrees at which the air of a day is looked at
_DIGITS = 10  # of the logarithm, so that a table is the same on every machine


@dataclass(frozen=True, kw_only=True)
class Air:
    """Air that turns with its body.

    Parameters
    ----------
    name
        What it is, in words.
    given
        Parameters by which it is scaled, as a problem takes them: a density and a height.
    table
        Logarithm of the density over that one against the altitude over that height; None for exponential air of them.
    bottom, top
        From and up to which altitude [m] the data go.
    near
        How near the table is to them, as a share of the density.
    said
        What was read of its file, in words; "" of air that is no file's.
    """

    name: str
    given: Mapping[str, Parameter]
    table: Table | None = None
    bottom: float = float("-inf")
    top: float = float("inf")
    near: float = 0.0
    said: str = ""

    def density(self, altitude: Any, p: Any, xp: Any) -> Any:
        """Density [kg/m^3] at an altitude [m], from the parameters of the problem.

        Parameters
        ----------
        altitude
            Altitude above the body [m].
        p, xp
            Parameters [SI] and maths namespace.
        """
        density, height = (getattr(p, name) for name in self.given)
        share = altitude / height
        return density * xp.exp(-share if self.table is None else xp.table(self.table, share))


def exponential(density: float, scale_height: float) -> Air:
    """Air whose density [kg/m^3] falls by e with each scale height [m].

    Parameters
    ----------
    density
        Density at altitude 0 [kg/m^3].
    scale_height
        Scale height [m].
    """
    given = _air_parameters("atmosphere_density", density, "atmosphere_scale_height", scale_height)
    return Air(name=f"exponential atmosphere of scale height {scale_height / 1e3:g} km", given=given)


@cache
def standard() -> Air:
    """U.S. Standard Atmosphere, 1976."""
    low, high = standard_atmosphere.LOWEST, standard_atmosphere.HIGHEST
    # Finer than its layers, of which the lowest are the sharpest.
    parts = ((low, 86e3, 50.0), (86e3, 150e3, 100.0), (150e3, high + 1, 2e3))
    altitude = np.concatenate([np.arange(*part) for part in parts])
    return tabulated(altitude, standard_atmosphere.density(altitude), "US Standard Atmosphere 1976", STANDARD_NEAR)


def from_file(path: str | Path) -> Air:
    """Return the air of a file with a column of altitudes and one of densities, in the units that its headings state.

    Parameters
    ----------
    path
        A text file of at most 1 MB: cells apart by commas, semicolons, tabs or blanks, altitudes in increasing or in
        decreasing order. Without headings, or where these state no unit, they are [m] and [kg/m^3].

    Raises
    ------
    PeriluneError
        If it cannot be read, has no altitudes or no positive densities, or is so rough that no smooth table follows it.
    """
    path = Path(path)
    read = read_air_table(path)
    name = f"air of {one_line(path.name, 60)}"
    return replace(tabulated(read.altitude, read.density, name, lines=read.lines), said=read.said)


@dataclass(frozen=True, kw_only=True)
class TrajectoryProfile:
    """Position and time of a flight at each altitude, where it passes that altitude for the last time.

    Parameters
    ----------
    altitude
        In increasing order [m].
    longitude, latitude
        Of the subpoint [rad], the longitude without jumps.
    time
        After the epoch [s].
    """

    altitude: Vector
    longitude: Vector
    latitude: Vector
    time: Vector

    @classmethod
    def over(cls, longitude: float, latitude: float) -> TrajectoryProfile:
        """Straight above a place [rad], at the epoch.

        Parameters
        ----------
        longitude, latitude
            Of the place [rad].
        """
        return cls(**{name: np.array([value]) for name, value in zip(
            cls.__annotations__, (0.0, longitude, latitude, 0.0), strict=True)})  # fmt: skip

    @classmethod
    def down(cls, altitude: Vector, longitude: Vector, latitude: Vector, time: Vector) -> TrajectoryProfile:
        """Return the profile of a descending flight, from rows in the order of time.

        Parameters
        ----------
        altitude
            Altitudes in order of time [m], (n,).
        longitude, latitude
            Of the subpoint [rad], (n,).
        time
            After the epoch [s], (n,).
        """
        lower = np.append(np.inf, np.minimum.accumulate(altitude)[:-1]) > altitude
        longitude = np.unwrap(longitude)
        return cls(**{
            name: row[lower][::-1]
            for name, row in zip(cls.__annotations__, (altitude, longitude, latitude, time), strict=True)
        })  # fmt: skip


def thermosphere(epoch: datetime, way: TrajectoryProfile, *, f107: float, f107a: float, ap: float) -> Air:
    """Air of NRLMSIS 2.1 along a flight, from -0.5 to 1000 km; needs the extra ``msis``, and no network.

    At each altitude it is the air where and when the flight passes that; above and below it, where it begins and ends.

    Parameters
    ----------
    epoch
        Time; without a zone it is UTC.
    way
        Of the flight; one row of it gives the air above a place.
    f107, f107a, ap
        Solar flux of the day before and its mean of 81 days [1e-22 W/m^2/Hz], geomagnetic index.

    Raises
    ------
    PeriluneError
        If pymsis is not installed.
    """
    try:
        import pymsis  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise PeriluneError(
            "the atmosphere nrlmsis needs pymsis, which is not installed",
            expected="the extra msis",
            advice="pip install 'perilune[msis]'",
        ) from None
    utc = epoch.astimezone(UTC).replace(tzinfo=None) if epoch.tzinfo else epoch
    altitude = np.concatenate([np.arange(_LOWEST, 200e3, 500.0), np.arange(200e3, 1001e3, 2e3)])
    # Rounded, so that a table is the same on every machine.
    east, north = (np.round(np.degrees(np.interp(altitude, way.altitude, row)), _PLACE)
                   for row in (way.longitude, way.latitude))  # fmt: skip
    later = np.round(np.interp(altitude, way.altitude, way.time)).astype("timedelta64[s]")
    every = len(altitude)
    found = pymsis.calculate(
        np.datetime64(utc) + later, east, north, altitude / 1e3, f107s=[f107] * every, f107as=[f107a] * every,
        aps=[[ap] * 7] * every, version=2.1,
    )  # fmt: skip
    density = np.asarray(found, dtype=float)[..., 0].ravel()
    return tabulated(altitude, density, f"NRLMSIS 2.1 of {utc:%Y-%m-%d %H:%M} UTC")


def tabulated(
    altitude: Vector, density: Vector, name: str, near: float = NEAR, *, lines: Sequence[int] | None = None
) -> Air:
    """Air of samples of the density.

    Parameters
    ----------
    altitude, density
        Samples [m], [kg/m^3].
    name
        What it is, in words.
    near
        How near the table should come to all samples, as a share of the density.
    lines
        Where in a file each sample stands, for messages.

    Raises
    ------
    PeriluneError
        If the altitudes do not increase, a density is not positive, or no table of `MOST_KNOTS` knots follows them.
    """
    places = [f"row {k + 1}" for k in range(len(altitude))] if lines is None else [f"line {k}" for k in lines]
    x, y = _check_samples(altitude, density, name, places)
    knots = np.unique(np.linspace(0, len(x) - 1, _FIRST_KNOTS).astype(int)).tolist()
    while True:
        table = Table(x=tuple(x[knots]), y=tuple(y[knots]), kind="smoother")
        away = np.abs(np.expm1(np.clip(table(x) - y, -1.0, 1.0)))
        worst = int(away.argmax())
        if away[worst] <= near or len(knots) in (MOST_KNOTS, len(x)):
            break
        knots = sorted({*knots, worst})
    _refuse_rough(x, y, table, float(away[worst]), name, places)
    given = _air_parameters("air_density", _SEA_LEVEL, "air_height", _KILOMETRE)
    low, high = float(altitude[0]), float(altitude[-1])
    return Air(name=name, given=given, table=table, bottom=low, top=high, near=float(away[worst]))


def _air_parameters(name: str, density: float, height_name: str, height: float) -> Mapping[str, Parameter]:
    return MappingProxyType(
        {name: Parameter(value=density, unit="kg/m^3"), height_name: Parameter(value=height, unit="m")}
    )


def _check_samples(altitude: Vector, density: Vector, name: str, places: Sequence[str]) -> tuple[Vector, Vector]:
    """Return the altitude in km and the logarithm of the density relative to sea level; refuse unusable samples."""
    if len(altitude) < 3:
        raise PeriluneError(f"{name}: a table needs rows", got=str(len(altitude)), expected="at least 3")
    wrong = np.flatnonzero(~(np.isfinite(altitude) & np.isfinite(density) & (density > 0)))
    if len(wrong):
        k = int(wrong[0])
        raise PeriluneError(
            f"{name}: {places[k]} is not an altitude with a density",
            got=f"{altitude[k]:g} m, {density[k]:g} kg/m^3",
            expected="finite numbers, and a density above 0",
            advice="leave the row out: beyond its ends a table is continued as an exponential atmosphere",
        )
    back = np.flatnonzero(np.diff(altitude) <= 0)
    if len(back):
        k = int(back[0])
        raise PeriluneError(
            f"{name}: altitudes do not increase at {places[k + 1]}",
            got=f"{altitude[k]:g} m, then {altitude[k + 1]:g} m",
            expected="altitudes in order, each once",
            advice="sort the rows by altitude",
        )
    return altitude / _KILOMETRE, np.round(np.log(density / _SEA_LEVEL), _DIGITS)


def _refuse_rough(x: Vector, y: Vector, table: Table, away: float, name: str, places: Sequence[str]) -> None:
    """Refuse samples that a smooth table misses, or between which it swings."""
    if away > ROUGHEST:
        raise PeriluneError(
            f"{name}: the densities are too irregular for a smooth table",
            got=f"{MOST_KNOTS} knots,and still {100 * away:.2g} % off",
            expected=f"at most {100 * ROUGHEST:g} %",
            advice="smooth the data, or leave out altitudes that no flight reaches",
        )
    middle = table(0.5 * (x[1:] + x[:-1]))
    low, high = np.minimum(y[1:], y[:-1]), np.maximum(y[1:], y[:-1])
    swing = np.maximum(low - middle, middle - high) - 0.25 * (high - low)
    k = int(swing.argmax())
    if swing[k] > ROUGHEST:
        raise PeriluneError(
            f"{name}: a smooth table swings between {places[k]} and {places[k + 1]}",
            got=f"between {x[k]:g} and {x[k + 1]:g} km it leaves the range of both densities",
            expected="densities that vary gradually from row to row",
            advice="add rows there, evenly spaced",
        )
