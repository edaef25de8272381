"""Entries that leave the air again are none: refused where every fall does, and else no answer."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.core import InfeasibleError
from perilune.models.deorbit.ballistic_fall import fall
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.records import Atmosphere, Interface, Landing, Manoeuvre, Returner, ReturnOrbit, Transition
from perilune.models.deorbit.skip_out import rebound_height
from perilune.models.physics.atmosphere import exponential
from perilune.models.physics.bodies import EARTH
from perilune.problem import preflight
from perilune.verify import verify

CONDITION = "depth_below_interface"


def returning(degrees: float, *, dry_mass: float = 350.0, speed: float | None = None) -> pl.Problem:
    """From 500 km, to anywhere."""
    return deorbit_entry(
        Returner(mass=500.0, thrust=500.0, exhaust_velocity=3000.0, dry_mass=dry_mass, ballistic_coefficient=345.0),
        ReturnOrbit(radius=6878.14e3, inclination=math.radians(50)),
        Interface(altitude=120e3, angle=math.radians(degrees), speed=speed),
        EARTH,
        manoeuvre=Manoeuvre(longitude=math.radians(16), latitude=math.radians(39.5), going="descending"),
        minimise="propellant",
        transition=Transition(longest_coast=4000.0),
        air=Atmosphere(model="exponential", density=1.225, scale_height=7200.0),
        site=Landing(altitude=10e3),
    )


def geodetic_altitude(position: Any) -> Any:
    """By the usual iteration for the latitude."""
    flat, (x, y, z) = EARTH.flattening or 0.0, position
    square = flat * (2 - flat)
    aside, latitude = np.hypot(x, y), np.arctan2(z, np.hypot(x, y))
    for _ in range(20):
        across = EARTH.radius / np.sqrt(1 - square * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + square * across * np.sin(latitude), aside)
    return aside * np.cos(latitude) + z * np.sin(latitude) - EARTH.radius**2 / across


def without_condition(problem: pl.Problem) -> pl.Problem:
    """The same where an entry may leave the air."""
    bare = replace(problem.phases[-1], path=None)
    return problem.changed(phases=(*problem.phases[:-1], bare), form=None)


def test_an_entry_that_leaves_the_air_is_no_answer() -> None:
    """At -0.8 deg the best flight without the condition comes above the interface for a while: level 0.

    It is found beside that of a steeper entry: none of 768 random starts, and no coarse mesh, leads to it from nothing.
    """
    problem = returning(-0.8)
    steeper = pl.solve(without_condition(returning(-0.9)), verify=0)
    skips = pl.solve(without_condition(problem), guess=steeper, verify=0)
    entry = len(problem.phases) - 1
    x, _ = skips.evaluate(entry, np.linspace(0.0, skips.trajectories[entry].duration, 2000))
    highest = float(geodetic_altitude(np.array(x[:3])).max()) - 120e3
    assert highest > 1e3
    checked = verify(replace(skips, problem=problem), level=1).verification
    failed = {check.name: check.value for check in checked.failed}
    assert checked.level == 0 and list(failed) == [f"entry_path_{CONDITION}"]
    assert failed[f"entry_path_{CONDITION}"] == pytest.approx(highest, abs=5.0)


def test_an_entry_that_climbs_within_the_air_is_one() -> None:
    solution = pl.solve(returning(-0.9))
    assert solution.verification.level == 3
    assert solution.free["entry_time"] > 1000


def test_what_rises_again_without_air_is_keplers_ellipse() -> None:
    """The fall passes its perigee and rises to the apogee of its energy and its angular momentum."""
    mu, gate, speed, angle = EARTH.gravitational_parameter, EARTH.radius + 120e3, 8000.0, math.radians(-1.0)
    semi = 1 / (2 / gate - speed**2 / mu)
    momentum = gate * speed * math.cos(angle)
    apogee = semi * (1 + math.sqrt(1 - momentum**2 / (mu * semi)))
    p = SimpleNamespace(
        **{name: given.value for name, given in returning(-1.0).given.items()}
        | {"body_rotation_rate": 0.0, "vehicle_ballistic_coefficient": 1e12}
    )
    fallen = fall(p, exponential(1.225, 7200.0), angle, speed, 4001)
    assert rebound_height(fallen, 120e3) == pytest.approx(apogee - gate, rel=1e-4)
    assert rebound_height(fall(p, exponential(1.225, 7200.0), math.radians(-30), 3000.0), 120e3) == -math.inf


def found(problem: pl.Problem) -> list[tuple[bool, bool]]:
    return [(each.passed, each.binding) for each in preflight(problem) if "skip-out" in each.name]


def test_what_no_entry_keeps_is_refused() -> None:
    """Faster than a circular orbit, and flat: whatever its mass and its heading, it rises to hundreds of km."""
    fast = returning(-0.5, speed=7900.0)
    assert found(fast) == [(False, True)]
    with pytest.raises(InfeasibleError, match="leaves the atmosphere again"):
        pl.solve(fast)
    # All propellant may turn it against the air: nothing is said of every fall, and of a typical one it is warned.
    assert found(returning(-0.5, speed=7650.0)) == [(False, False)]
    assert found(returning(-2.0)) == [(True, False)]
