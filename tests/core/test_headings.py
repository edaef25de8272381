"""What stands above an answer is true of the problem that was solved: its numbers, and the body that it is called."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

import perilune as pl
from command_line import ROOT
from perilune.cli import run_command_line
from perilune.models import MARS, MOON, Body, Orbit, Vehicle, hybrid_landing
from perilune.scenario import load_file


def lander(body: Body = MOON) -> pl.Problem:
    return hybrid_landing(
        Vehicle(mass=300.0, thrust=440.0, specific_impulse=310.0),
        None,
        Orbit(parking_altitude=100e3, perilune_altitude=15e3),
        body,
    )


def test_values_that_were_given_later_are_told() -> None:
    """The title is of the records that the model was made of."""
    problem = lander()
    assert problem.heading == "300 kg lander from 15 km to the Moon"
    heavier = problem.with_given(vehicle_mass=330.0)
    assert heavier.heading == "300 kg lander from 15 km to the Moon, but with vehicle_mass 330 kg"
    assert heavier.with_given(vehicle_mass=300.0).heading == problem.heading
    turned = load_file(ROOT / "examples" / "polar_descent.toml").problem.with_given(site_longitude=math.radians(6.0))
    assert turned.heading.endswith(", but with site_longitude 6 deg")
    many = problem.with_given(**{name: 1.001 * given.value for name, given in problem.given.items()})
    assert many.heading.count(",") == 5 and many.heading.endswith(" more")


@pytest.mark.parametrize("share", [0.5, 1.001])
def test_a_name_is_that_of_the_body_it_belongs_to(share: float) -> None:
    """Constants differ from paper to paper; half of its pull is another body."""
    heading = lander(replace(MOON, gravitational_parameter=share * MOON.gravitational_parameter)).heading
    assert heading.endswith("to the Moon" if share > 0.9 else "to a body called moon")
    assert lander(
        Body(name="vesta", gravitational_parameter=1.73e10, radius=262.7e3, rotation_rate=3.27e-4)
    ).heading.endswith("to Vesta")


@pytest.mark.parametrize("numbers", ["of Mars", "of none"])
def test_a_file_calls_no_body_by_the_name_of_another(
    numbers: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The answer itself is right for the numbers in the file; and the air of Mars is told."""
    body = MARS if numbers == "of Mars" else replace(MOON, gravitational_parameter=4e12)
    problem = lander(replace(body, name="forged")).with_given(vehicle_thrust=3000.0)
    pl.save(pl.solve(problem), tmp_path / "saved")
    path = tmp_path / "saved" / "solution.json"
    document = json.loads(path.read_text())
    document["model"]["sections"]["body"]["name"] = "moon"
    path.write_text(json.dumps(document))
    assert run_command_line(["verify", str(tmp_path / "saved")]) == 0
    first = capsys.readouterr().out.splitlines()[0]
    called = "Mars, without its atmosphere" if numbers == "of Mars" else "a body called moon"
    assert first.startswith(f"300 kg lander from 15 km to {called}, but with vehicle_thrust 3000 N: PROVED")
