"""Air: the standard against its printed tables, and tables against what they are made of, in both languages."""

from __future__ import annotations

import math
import sys
from datetime import datetime, timedelta, timezone
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from perilune.core import NUMERIC, PeriluneError
from perilune.models.physics import atmosphere, standard_atmosphere
from perilune.models.physics.atmosphere import Air
from perilune.problem import SYMBOLIC

# Table I of the standard: altitude [km], density [kg/m^3]; Table VIII: number densities [1/m^3] by way of them.
PRINTED = {
    0: 1.2250, 5: 7.3643e-1, 10: 4.1351e-1, 20: 8.8910e-2, 30: 1.8410e-2, 40: 3.9957e-3, 50: 1.0269e-3, 60: 3.0968e-4,
    70: 8.2829e-5, 80: 1.8458e-5, 86: 6.958e-6, 90: 3.416e-6, 100: 5.604e-7, 110: 9.708e-8, 120: 2.222e-8,
    150: 2.076e-9, 200: 2.541e-10, 300: 1.916e-11, 400: 2.803e-12, 500: 5.215e-13, 1000: 3.561e-15,
}  # fmt: skip
WARM = {0: 288.15, 11: 216.774, 25: 221.552, 50: 270.65, 80: 198.639, 86: 186.87, 100: 195.08, 110: 240.0, 120: 360.0,
        150: 634.39, 200: 854.56, 500: 999.24, 1000: 1000.0}  # fmt: skip


def parameters(air: Air) -> SimpleNamespace:
    return SimpleNamespace(**{name: given.value for name, given in air.given.items()})


def density(air: Air, altitude: Any) -> Any:
    return air.density(altitude, parameters(air), NUMERIC)


def test_the_standard_is_as_it_is_printed() -> None:
    altitude = 1e3 * np.array(list(PRINTED))
    np.testing.assert_allclose(
        standard_atmosphere.density(altitude), list(PRINTED.values()), rtol=2.5e-4
    )  # half of a last digit
    warm = standard_atmosphere.temperature(1e3 * np.array(list(WARM)))
    np.testing.assert_allclose(warm, list(WARM.values()), rtol=2e-5)
    assert standard_atmosphere.speed_of_sound(0.0) == pytest.approx(340.294, abs=1e-3)
    assert standard_atmosphere.speed_of_sound(11e3) == pytest.approx(295.154, abs=1e-3)
    outside = np.array([-5.1e3, 1000.1e3])
    for function in (standard_atmosphere.density, standard_atmosphere.temperature, standard_atmosphere.speed_of_sound):
        assert np.isnan(function(outside)).all()
    assert np.isnan(standard_atmosphere.speed_of_sound(90e3))


def test_the_standard_is_that_of_another_program() -> None:
    ambiance = pytest.importorskip("ambiance")
    altitude = np.linspace(-4e3, 81e3, 400)
    other = ambiance.Atmosphere(altitude)
    np.testing.assert_allclose(standard_atmosphere.density(altitude), other.density, rtol=3e-5)
    np.testing.assert_allclose(standard_atmosphere.speed_of_sound(altitude), other.speed_of_sound, rtol=1e-5)


def test_the_smooth_standard_is_near_the_standard_everywhere() -> None:
    air = atmosphere.standard()
    altitude = np.concatenate([np.linspace(-5e3, 150e3, 77_777), np.linspace(150e3, 1000e3, 7_777)])
    away = np.abs(density(air, altitude) / standard_atmosphere.density(altitude) - 1)
    assert air.near <= away.max() * 1.001 < 1.001e-3
    beyond = density(air, np.array([1000e3, 1050e3, 1100e3]))
    assert beyond[0] > beyond[1] > beyond[2] > 0


def test_one_text_is_the_same_air_in_both_languages() -> None:
    """The proof reads a table as NumPy does, the solver by choices; SciPy's own spline is a third."""
    air = atmosphere.standard()
    h = ca.SX.sym("h")
    symbolic = ca.Function("rho", [h], [air.density(h, parameters(air), SYMBOLIC)])
    altitude = np.random.default_rng(1).uniform(-20e3, 1100e3, 500)
    np.testing.assert_allclose(symbolic(altitude).full().ravel(), density(air, altitude), rtol=1e-12)
    assert air.table is not None
    inside = altitude[(altitude > -5e3) & (altitude < 1000e3)]
    spline = make_interp_spline(air.table.x, air.table.y, k=7)
    np.testing.assert_allclose(density(air, inside), 1.225 * np.exp(spline(inside / 1e3)), rtol=1e-9)
    slope = density(air, np.array([50e3 + 1e-20j])).imag / 1e-20  # a complex step, as the proof takes it
    exact = ca.Function("slope", [h], [ca.gradient(air.density(h, parameters(air), SYMBOLIC), h)])
    assert slope[0] == pytest.approx(float(exact(50e3)), rel=1e-10)


def test_exponential_air_is_a_formula() -> None:
    air = atmosphere.exponential(1.225, 7200.0)
    np.testing.assert_allclose(density(air, np.array([0.0, 7200.0, -7200.0])), 1.225 * np.exp([0.0, -1.0, 1.0]))


def written(path: Path, rows: Any, head: str = "altitude [m], density [kg/m^3]\n") -> Path:
    path.write_text(head + "".join(f"{a},{b}\n" for a, b in rows), encoding="utf-8")
    return path


def test_a_file_of_air_is_flown_as_it_is(tmp_path: Path) -> None:
    altitude = np.arange(0.0, 200e3, 250.0)
    air = atmosphere.from_file(
        written(tmp_path / "own.csv", zip(altitude, standard_atmosphere.density(altitude), strict=True))
    )
    between = altitude[:-1] + 125.0
    np.testing.assert_allclose(density(air, between), standard_atmosphere.density(between), rtol=2e-3)
    assert air.near <= 1e-3 and air.top == altitude[-1] and air.name == "air of own.csv"
    few = atmosphere.from_file(written(tmp_path / "few.csv", [(0, 1.0), (10e3, 0.25), (20e3, 0.0625)], head="# mine\n"))
    assert density(few, 5e3) == pytest.approx(0.5, rel=1e-9) and density(few, 30e3) == pytest.approx(1 / 64, rel=1e-9)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([(0, 1.0), (1000, 0.9)], "needs rows"),
        ([(0, 1.0), (1000, 0.9), (900, 0.8)], "do not increase at line 4"),
        ([(0, 1.0), (1000, 0.0), (2000, 0.8)], "line 3 is not an altitude with a density"),
        ([(0, 1.0), (1000, "nan"), (2000, 0.8)], "line 3 is not an altitude with a density"),
        ([(0, 1.0), (1000, "thin"), (2000, 0.8)], "line 3 of the table of air has no number in column 2"),
        ([(0, 1.0), (1000, "0.9,0.8"), (2000, 0.8)], "line 3 of the table of air has 3 cells"),
        ([(k * 100, 1.0 if k % 2 else 2.0) for k in range(500)], "too irregular for a smooth table"),
        ([(0, 1.0), (1, 0.9), (2, 0.8), (1e5, 0.7), (2e5, 0.6)], "swings between line 5 and line 6"),
        ([], "needs rows"),
    ],
)
def test_a_file_that_is_no_air_is_refused(tmp_path: Path, rows: Any, said: str) -> None:
    with pytest.raises(PeriluneError, match=said):
        atmosphere.from_file(written(tmp_path / "wrong.csv", rows))


def test_a_file_that_is_not_there_or_too_large_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PeriluneError, match="there is no table of air here"):
        atmosphere.from_file(tmp_path / "none.csv")
    large = tmp_path / "large.csv"
    large.write_bytes(b"1,1\n" * 300_000)
    with pytest.raises(PeriluneError, match="the table of air is too large"):
        atmosphere.from_file(large)


def test_the_thermosphere_is_that_of_its_program() -> None:
    pymsis = pytest.importorskip("pymsis")
    place = atmosphere.TrajectoryProfile.over(0.3, -0.6)
    sun: dict[str, float] = {"f107": 150.0, "f107a": 140.0, "ap": 7.0}
    when = datetime(2024, 2, 21, 20, 40)
    air = atmosphere.thermosphere(when, place, **sun)
    altitude = np.random.default_rng(2).uniform(0.0, 1000e3, 200)
    other = pymsis.calculate(
        np.datetime64(when), np.degrees(0.3), np.degrees(-0.6), altitude / 1e3, f107s=150.0, f107as=140.0,
        aps=[[7.0] * 7], version=2.1,
    )  # fmt: skip
    np.testing.assert_allclose(density(air, altitude), np.ravel(other[..., 0]), rtol=2e-3)
    zoned = datetime(2024, 2, 21, 22, 40, tzinfo=timezone(timedelta(hours=2)))
    assert atmosphere.thermosphere(zoned, place, **sun).table == air.table
    busy = atmosphere.thermosphere(when, place, f107=250.0, f107a=250.0, ap=50.0)
    assert density(busy, 400e3) > 2 * density(air, 400e3)


def test_the_thermosphere_along_a_flight_is_that_of_each_place() -> None:
    """At each altitude where and when a flight from 120 km passes it the last time, after it rose once."""
    pymsis = pytest.importorskip("pymsis")
    when, sun = datetime(2024, 2, 21, 20, 40), {"f107": 150.0, "f107a": 140.0, "ap": 7.0}
    time = np.linspace(0.0, 2000.0, 400)
    altitude = 66e3 + 54e3 * np.cos(time / 2000.0 * math.pi) + 8e3 * np.sin(time / 200.0)
    longitude = np.mod(3.0 + 2e-4 * time + math.pi, 2 * math.pi) - math.pi  # over the date line
    way = atmosphere.TrajectoryProfile.down(altitude, longitude, 0.9 - 3e-4 * time, time)
    assert (np.diff(way.altitude) > 0).all() and np.abs(np.diff(way.longitude)).max() < 0.1
    air = atmosphere.thermosphere(when, way, **sun)
    for k in range(0, len(way.altitude), 40):
        at = np.datetime64(when) + np.timedelta64(int(way.time[k]), "s")
        other = pymsis.calculate(
            at, np.degrees(way.longitude[k]), np.degrees(way.latitude[k]), way.altitude[k] / 1e3, f107s=150.0,
            f107as=140.0, aps=[[7.0] * 7], version=2.1,
        )  # fmt: skip
        assert density(air, way.altitude[k]) == pytest.approx(float(np.ravel(other[..., 0])[0]), rel=4e-3)


def test_what_is_missing_is_said_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymsis", None)
    with pytest.raises(PeriluneError, match="nrlmsis needs pymsis") as error:
        atmosphere.thermosphere(
            datetime(2024, 1, 1), atmosphere.TrajectoryProfile.over(0.0, 0.0), f107=150, f107a=150, ap=4
        )
    assert error.value.advice == "pip install 'perilune[msis]'"
