"""Orientation of bodies in space: axes that turn with a body, relative to the ICRF, at a time.

Elements of the IAU/IAG working group (Archinal et al. 2018, Celest. Mech. Dyn. Astr. 130:22; those of Mars are by
Kuchynka et al. 2014, Icarus 229:340): right ascension and declination of the pole, and the angle W of the prime
meridian from the node of the body's equator, with T centuries and d days of TDB since J2000,

    alpha = a0 + a1 T + sum a_k sin E_k,  delta = d0 + d1 T + sum d_k cos E_k,  W = w0 + w1 d + w2 d^2 + sum w_k sin E_k

The Earth's are too rough for that: its pole is the celestial intermediate one by its leading terms, and it is turned by
the Earth rotation angle (IERS Conventions 2010, section 5.4 and equations 5.15, 5.16).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from perilune.core import Matrix, unknown_name
from perilune.io.exports.time_scales import describe_tdb, tdb_minus_utc

_J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
_SECONDS = np.pi / 180 / 3600  # of arc


@dataclass(frozen=True, kw_only=True)
class Elements:
    """Elements of one body [deg]; angles E_k as constants and rates per century, amplitudes in their order."""

    pole_right_ascension: tuple[float, float]
    pole_declination: tuple[float, float]
    meridian: tuple[float, float, float]
    angles: tuple[tuple[float, float], ...] = ()
    right_ascension: tuple[float, ...] = ()
    declination: tuple[float, ...] = ()
    turned: tuple[float, ...] = ()
    told: str = ""


_IAU = "IAU/IAG elements of 2015"
_UNCOMPARED = "not compared here with those of others"
ELEMENTS = {
    "moon": Elements(
        pole_right_ascension=(269.9949, 0.0031), pole_declination=(66.5392, 0.0130),
        meridian=(38.3213, 13.17635815, -1.4e-12),
        angles=(
            (125.045, -1935.5364525), (250.089, -3871.0729050), (260.008, 475263.3328725), (176.625, 487269.6299850),
            (357.529, 35999.0509575), (311.589, 964468.4993100), (134.963, 477198.8693250), (276.617, 12006.3007650),
            (34.226, 63863.5132425), (15.134, -5806.6093575), (119.743, 131.8406400), (239.961, 6003.1503825),
            (25.053, 473327.7964200),
        ),
        right_ascension=(-3.8787, -0.1204, 0.0700, -0.0172, 0.0, 0.0072, 0.0, 0.0, 0.0, -0.0052, 0.0, 0.0, 0.0043),
        declination=(1.5419, 0.0239, -0.0278, 0.0068, 0.0, -0.0029, 0.0009, 0.0, 0.0, 0.0008, 0.0, 0.0, -0.0009),
        turned=(
            3.5610, 0.1208, -0.0642, 0.0158, 0.0252, -0.0066, -0.0047, -0.0046, 0.0028, 0.0052, 0.0040, 0.0019, -0.0044
        ),
        told=f"{_IAU}, which keep within some 150 m on the ground to the mean-Earth axes of an ephemeris",
    ),
    "mercury": Elements(
        pole_right_ascension=(281.0103, -0.0328), pole_declination=(61.4155, -0.0049),
        meridian=(329.5988, 6.1385108, 0.0),
        angles=(
            (174.7910857, 149472.535875), (349.5821714, 298945.07175), (164.3732571, 448417.607625),
            (339.1643429, 597890.1435), (153.9554286, 747362.679375),
        ),
        right_ascension=(0.0,) * 5, declination=(0.0,) * 5,
        turned=(0.01067257, -0.00112309, -0.00011040, -0.00002539, -0.00000571), told=f"{_IAU}, {_UNCOMPARED}",
    ),
    "mars": Elements(
        pole_right_ascension=(317.269202, -0.10927547), pole_declination=(54.432516, -0.05827105),
        meridian=(176.049863, 350.891982443297, 0.0),
        angles=(
            (198.991226, 19139.4819985), (226.292679, 38280.8511281), (249.663391, 57420.7251593),
            (266.183510, 76560.6367950), (79.398797, 0.5042615),
            (122.433576, 19139.9407476), (43.058401, 38280.8753272), (57.663379, 57420.7517205),
            (79.476401, 76560.6495004), (166.325722, 0.5042615),
            (129.071773, 19140.0328244), (36.352167, 38281.0473591), (56.668646, 57420.9295360),
            (67.364003, 76560.2552215), (104.792680, 95700.4387578), (95.391654, 0.5042615),
        ),
        right_ascension=(0.000068, 0.000238, 0.000052, 0.000009, 0.419057, *[0.0] * 11),
        declination=(*[0.0] * 5, 0.000051, 0.000141, 0.000031, 0.000005, 1.591274, *[0.0] * 6),
        turned=(*[0.0] * 10, 0.000145, 0.000157, 0.000040, 0.000001, 0.000001, 0.584542),
        told=f"{_IAU}, on the ground within some 20 m of those of Konopliv et al. 2016 from 1970 to 2040, and within "
        "60 m from 1900 to 2199",
    ),
    "europa": Elements(
        pole_right_ascension=(268.08, -0.009), pole_declination=(64.51, 0.003), meridian=(36.022, 101.3747235, 0.0),
        angles=((355.80, 1191.3), (119.90, 262.1), (229.80, 64.3), (352.25, 2382.6)),
        right_ascension=(1.086, 0.060, 0.015, 0.009), declination=(0.468, 0.026, 0.007, 0.002),
        turned=(-0.980, -0.054, -0.014, -0.008), told=f"{_IAU}, {_UNCOMPARED}",
    ),
    "ceres": Elements(
        pole_right_ascension=(291.418, 0.0), pole_declination=(66.764, 0.0), meridian=(170.650, 952.1532, 0.0),
        told=f"{_IAU}, {_UNCOMPARED}",
    ),
}  # fmt: skip
_EARTH = (
    "leading terms of its precession and nutation, UT1 taken as UTC (leap seconds keep them within 0.9 s), no polar "
    "motion: some 500 m on the ground"
)


def axes_in_space(body: str, epoch: datetime) -> Matrix:
    """Matrix from axes that turn with a body to those of the ICRF, both from its centre.

    Parameters
    ----------
    body
        ``earth``, or a name in `ELEMENTS`.
    epoch
        With its time zone.

    Raises
    ------
    PeriluneError
        If the body's orientation is not known here.
    """
    if body == "earth":
        return _earth_axes(epoch)
    found = _orientation_elements(body)
    days = ((epoch - _J2000).total_seconds() + tdb_minus_utc(epoch)) / 86400
    centuries = days / 36525
    angles = np.radians([constant + rate * centuries for constant, rate in found.angles])
    ascension = _cosine_series(found.pole_right_ascension, centuries) + float(
        np.dot(found.right_ascension, np.sin(angles))
    )
    declination = _cosine_series(found.pole_declination, centuries) + float(np.dot(found.declination, np.cos(angles)))
    meridian = _cosine_series(found.meridian, days) + float(np.dot(found.turned, np.sin(angles)))
    node, tilt, turn = np.radians([ascension + 90, 90 - declination, meridian])
    return _about_z(node) @ _about_x(tilt) @ _about_z(turn)


def describe_orientation(body: str, epoch: datetime) -> str:
    """Describe the source of a body's orientation, and its accuracy.

    Parameters
    ----------
    body
        ``earth``, or a name in `ELEMENTS`.
    epoch
        With its time zone.
    """
    return _EARTH if body == "earth" else f"{_orientation_elements(body).told}; {describe_tdb(epoch)}"


def _orientation_elements(body: str) -> Elements:
    known = sorted((*ELEMENTS, "earth"))
    if body not in ELEMENTS:
        raise unknown_name(
            "a body whose orientation in space is known",
            body or "a body of another mass or rotation, or without a name",
            known,
        )
    return ELEMENTS[body]


def _cosine_series(coefficients: Sequence[float], x: float) -> float:
    return sum(c * x**k for k, c in enumerate(coefficients))


def _earth_axes(epoch: datetime) -> Matrix:
    days = (epoch - _J2000).total_seconds() / 86400
    t = (days + tdb_minus_utc(epoch) / 86400) / 36525
    node = np.radians(125.04455501 - 1934.13626197 * t)
    twice_sun = 2 * np.radians(280.4665 + 36000.7698 * t)  # mean longitude
    x = 2004.191898 * t - 0.4297829 * t**2 - 0.016617 - 6.844318 * np.sin(node) - 0.523908 * np.sin(twice_sun)
    y = -0.006951 - 0.025896 * t - 22.4072747 * t**2 + 9.205236 * np.cos(node) + 0.573033 * np.cos(twice_sun)
    x, y = x * _SECONDS, y * _SECONDS
    a = 0.5 + (x * x + y * y) / 8
    pole = np.array([[1 - a * x * x, -a * x * y, x], [-a * x * y, 1 - a * y * y, y], [-x, -y, 1 - a * (x * x + y * y)]])
    turns = 0.7790572732640 + 0.00273781191135448 * days + days % 1.0
    return pole @ _about_z(2 * np.pi * turns + x * y / 2)


def _about_z(angle: float) -> Matrix:
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _about_x(angle: float) -> Matrix:
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
