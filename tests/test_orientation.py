"""Axes of bodies in space: against another library, and against the printed example of another book."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from perilune.models.bodies import BODIES, EARTH
from perilune.models.orientation import ELEMENTS, axes_in_space, told_orientation
from perilune.models.time_scales import tdb_minus_utc
from perilune.words.outcome import PeriluneError


@pytest.mark.parametrize("year", [1976, 2015, 2026, 2040])
def test_the_earth_is_turned_as_the_iau_library_says(year: int) -> None:
    erfa = pytest.importorskip("erfa", reason="needs the extra 'test'")
    epoch = datetime(year, 6, 1, 12, 34, 56, tzinfo=UTC)
    day = 2451545.0 + (epoch - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=1)
    expected = erfa.c2t06a(day, 69.184 / 86400, day, 0.0, 0.0, 0.0).T
    # Half a second of arc of nutation is left out: 15 m on the ground.
    np.testing.assert_allclose(axes_in_space("earth", epoch), expected, atol=2.5e-6)


@pytest.mark.parametrize(
    ("landed", "leaps"), [(datetime(1997, 7, 4, 16, 56, 55, tzinfo=UTC), 31), (datetime(1976, 7, 20, tzinfo=UTC), 15)]
)
def test_mars_is_where_the_clocks_of_its_landers_had_it(landed: datetime, leaps: int) -> None:
    """Within metres, by the printed elements (Archinal et al. 2011) and TAI - UTC of the day."""
    days = ((landed - datetime(2000, 1, 1, 12, tzinfo=UTC)).total_seconds() + leaps + 32.184) / 86400
    ascension, declination = 317.68143 - 0.1061 * days / 36525, 52.88650 - 0.0609 * days / 36525
    turns = [ascension + 90, 90 - declination, 176.630 + 350.89198226 * days]
    expected = Rotation.from_euler("ZXZ", turns, degrees=True).as_matrix()
    np.testing.assert_allclose(3396.19e3 * axes_in_space("mars", landed), 3396.19e3 * expected, rtol=0, atol=2.0)


def test_leap_seconds_are_those_of_another_library() -> None:
    erfa = pytest.importorskip("erfa", reason="needs the extra 'test'")
    for month in range(12 * 1972, 12 * 2025):
        year, later = divmod(month, 12)
        begin = datetime(year, later + 1, 1, tzinfo=UTC)
        assert tdb_minus_utc(begin) == pytest.approx(erfa.dat(year, later + 1, 1, 0.0) + 32.184, abs=1e-9)
        before = begin - timedelta(seconds=1)
        known = erfa.dat(before.year, before.month, before.day, 0.5)
        assert month == 12 * 1972 or tdb_minus_utc(before) == pytest.approx(known + 32.184, abs=1e-9)


@pytest.mark.parametrize(
    ("year", "said"),
    [(1971, "42.184 s ahead of UTC as in 1972, which before is too much"), (1997, "62.184 s ahead of UTC"),
     (2030, "69.184 s ahead of UTC as since 2017: later leap seconds are not known")],
)  # fmt: skip
def test_it_is_said_which_time_a_body_is_turned_by(year: int, said: str) -> None:
    assert said in told_orientation("mars", datetime(year, 1, 1, tzinfo=UTC))


def test_the_moon_shows_the_earth_the_side_that_is_printed() -> None:
    """Meeus, Astronomical Algorithms (1998), example 53.a: libration on 1992 April 12.0 TD, place of example 47.a."""
    epoch = datetime(1992, 4, 12, tzinfo=UTC) - timedelta(seconds=58.184)
    longitude, latitude, tilt = np.radians([133.162655, -3.229126, 23.440636])
    t = -0.077221081451
    ecliptic = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    c, s = np.cos(tilt), np.sin(tilt)
    of_date = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ ecliptic
    zeta, z, theta = np.radians(np.array([2306.2181, 2306.2181, 2004.3109]) * t / 3600)  # precession, linear

    def about_z(a: float) -> np.ndarray:
        return np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])

    def about_y(a: float) -> np.ndarray:
        return np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])

    to_moon = about_z(-zeta) @ about_y(theta) @ about_z(-z) @ of_date
    x, y, z = axes_in_space("moon", epoch).T @ -to_moon
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(-1.23, abs=0.03)
    assert np.degrees(np.arcsin(z)) == pytest.approx(4.20, abs=0.03)


@pytest.mark.parametrize("name", [*ELEMENTS, "earth"])
def test_bodies_turn_at_the_rate_that_models_have(name: str) -> None:
    body = {**BODIES, "earth": EARTH}[name]
    epoch, seconds = datetime(2030, 1, 1, tzinfo=UTC), 1000.0
    before, after = (axes_in_space(name, epoch + timedelta(seconds=s)) for s in (0.0, seconds))
    np.testing.assert_allclose(before @ before.T, np.eye(3), atol=1e-9)
    turned = before.T @ after
    rate = np.arctan2(turned[1, 0], turned[0, 0]) / seconds
    # The Moon librates, by some percent within a month; the rate of Ceres has four digits.
    assert rate == pytest.approx(body.rotation_rate, rel=0.02 if name == "moon" else 3e-4)


def test_a_body_that_is_not_known_is_named() -> None:
    with pytest.raises(PeriluneError, match="orientation") as refused:
        axes_in_space("vesta", datetime(2030, 1, 1, tzinfo=UTC))
    assert "ceres" in str(refused.value)
