"""Returns with a coast on the orbit, a burn, a coast to the interface and an entry: what the proof says of them."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

import perilune as pl
from perilune.models.bodies import EARTH
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.records import (
    Atmosphere,
    Interface,
    Landing,
    Manoeuvre,
    Orbit,
    Returner,
    Separation,
    Transition,
)
from perilune.scenario import load_file

NEIGHBOUR_B = Path(__file__).parents[1] / "examples" / "minimum_duration_return.toml"
FREE_IGNITION = (
    'orbit.longest_coast="5000 s"', 'transition.longest_coast="3000 s"', 'vehicle.thrust="400 N"',
    'problem.minimise="propellant"', 'interface.angle_upper="-2 deg"', 'vehicle.dry_mass="350 kg"',
)  # fmt: skip


def test_a_return_of_four_phases_is_proved() -> None:
    """The terms of H on its coast are 18 times J over the flight: errors of all costates add up in it."""
    solution = pl.solve(load_file(NEIGHBOUR_B, FREE_IGNITION).problem)
    assert solution.verification.passed and solution.verification.level == 3
    assert [flown.phase for flown in solution.trajectories] == ["coast", "burn", "drift", "entry"]
    checks = {check.name: check for check in solution.verification.checks}
    constant = checks["coast_hamiltonian_constant"]
    assert constant.limit == 1e-9 and 1e-12 < constant.value < 8e-10
    assert solution.objective == pytest.approx(-478.397229, abs=1e-6)


def test_propellant_is_that_of_the_whole_vehicle_whatever_enters_the_air() -> None:
    """What is left behind at the interface is no propellant: the best burn is that of a flight which ends there."""
    stated = {
        "vehicle": Returner(mass=7000.0, thrust=3190.0, specific_impulse=302.0, dry_mass=6000.0, drag_area=5.8),
        "orbit_": Orbit(radius=EARTH.radius + 432.7e3, inclination=math.radians(51.6)),
        "interface": Interface(altitude=100e3, angle=math.radians(-1.6)),
        "manoeuvre": Manoeuvre(longitude=0.0, latitude=math.radians(-45.0), going="ascending"),
        "transition": Transition(longest_coast=3000.0),
        "minimise": "propellant",
    }
    air = Atmosphere(model="us1976")
    landed, above = (
        pl.solve(deorbit_entry(**stated, **more))
        for more in ({"air": air, "site": Landing(altitude=10.8e3), "separation": Separation(mass=2900.0)}, {})
    )
    assert landed.verification.passed and landed.verification.level == 3
    assert landed.trajectories[-1].state.values[-1, 6] == pytest.approx(2900.0)
    assert landed.objective == pytest.approx(above.objective, rel=1e-9)
    assert -landed.objective == pytest.approx(7000.0 - landed.results["propellant"].value, rel=1e-12)
