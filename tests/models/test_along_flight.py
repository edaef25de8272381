"""Air of a day along the flight: the rough one, and solved ones until the table stays."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.core import NotConvergedError, PeriluneError
from perilune.io.model_records import model_document
from perilune.models.deorbit.atmosphere_iteration import solve_with_epoch_air, with_air_along_flight
from perilune.models.deorbit.opportunities import opportunities
from perilune.models.deorbit.records import Aim
from perilune.models.deorbit.trajectory_atmosphere import NEAR, largest_density_change
from perilune.models.physics.atmosphere import TrajectoryProfile, thermosphere
from perilune.scenario import load_text
from test_opportunities import SCENARIO

pytest.importorskip("pymsis")
DAY = SCENARIO.replace('kind = "', 'epoch = "2026-06-01T12:00:00Z"\nkind = "')
SUN = 'model = "nrlmsis"\nf107 = "150"\nf107a = "150"\nap = "4"'
DAY = re.sub(r'model = "exponential"\ndensity = .*\nscale_height = .*', SUN, DAY)
PLAIN, PASS = (
    text.replace('"-27 deg"', '"131.859 deg"').replace('"120 deg"', '"-36.826 deg"') for text in (SCENARIO, DAY)
)


def air_of(problem: pl.Problem) -> Any:
    return problem.phases[-1].dynamics.keywords["air"]  # type: ignore[attr-defined]


def test_the_air_is_that_along_the_rough_flight() -> None:
    """Not that above the site, by some per cent; nor that of another pass."""
    problem = load_text(PASS)
    epoch = next(record for record in problem.records if isinstance(record, Aim)).instant()
    assert epoch is not None
    p = problem.parameters({})
    over = thermosphere(
        epoch, TrajectoryProfile.over(p.site_longitude, p.site_latitude), f107=150.0, f107a=150.0, ap=4.0
    )
    assert over.table is not None and 0.01 < largest_density_change(over, air_of(problem)) < 0.1
    assert abs(np.expm1(air_of(problem).table(10.0) - over.table(10.0))) < 2e-3  # at its end it is over the site
    assert largest_density_change(air_of(load_text(DAY)), air_of(problem)) > 0.01
    # The same text makes the same table, so that a saved solution is read back as what it was.
    assert air_of(load_text(PASS)).table == air_of(problem).table and model_document(problem) is not None


def test_no_place_is_needed_where_the_orbit_says_it() -> None:
    anywhere = load_text(re.sub(r'longitude = "-98 deg"\nlatitude = .*\n', "", PASS))
    assert "site_longitude" not in anywhere.given and air_of(anywhere).name.startswith("NRLMSIS 2.1 of 2026-06-01")


def test_opportunities_begin_at_their_own_hour() -> None:
    found = next(one for one in opportunities(load_text(DAY), 2) if one.verdict == "reachable")
    assert found.settings["problem.epoch"].startswith("2026-06-02T01:11:")


def test_a_flight_settles_in_the_air_along_it() -> None:
    """Where the same flight comes out again, here one through other air, the table of it stays."""
    problem = load_text(PASS).with_given(vehicle_drag_area=0.7)
    first, asked = pl.solve(load_text(PLAIN), verify=0), list[pl.Problem]()

    def solve(again: pl.Problem, guess: pl.Solution | None = None) -> pl.Solution:
        assert (guess is None) == (not asked) and again.given["vehicle_drag_area"].value == 0.7
        asked.append(again)
        return first

    assert solve_with_epoch_air(problem, solve) is first and len(asked) == 2
    moved = largest_density_change(air_of(problem), air_of(asked[1]))
    assert NEAR < moved < 0.02
    assert largest_density_change(air_of(asked[1]), air_of(with_air_along_flight(problem, first))) == 0.0
    with pytest.raises(NotConvergedError, match="does not converge"):
        solve_with_epoch_air(problem, lambda *_, **__: first, near=-1.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (DAY.replace('epoch = "2026-06-01T12:00:00Z"\n', ""), "epoch of the nrlmsis atmosphere is not stated"),
        (DAY.replace("2026-06-01T12", "2026-06-01T25"), "problem.epoch is not a supported time"),
        (DAY.replace('ap = "4"', ""), "atmosphere.ap is missing"),
        (DAY.replace('f107 = "150"', 'f107 = "1500000"'), "atmosphere.f107 is out of range"),
        (DAY.replace('altitude = "10 km"', 'altitude = "-2 km"'), "ends before the flight does"),
    ],
)
def test_a_day_that_is_not_said_is_refused(text: str, said: str) -> None:
    with pytest.raises(PeriluneError) as error:
        load_text(text)
    assert said in str(error.value)


def test_air_of_no_day_is_along_no_flight() -> None:
    with pytest.raises(PeriluneError, match="has no atmosphere of an epoch"):
        solve_with_epoch_air(load_text(SCENARIO), lambda *_, **__: None)  # type: ignore[arg-type,return-value]
