"""A landing at full thrust that touches the ground and hops a hand's breadth to rest: no mesh tells it from a ride."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from burn_coast_burn import POINTS, STANDARD_GRAVITY, rates_of_polynomials
from perilune.core import Outcome
from perilune.models.descent.problem import Ignition, Site, powered_descent
from perilune.models.physics.bodies import CERES
from perilune.models.physics.vehicle import Vehicle
from perilune.problem import Problem
from perilune.solve import solve

MASS, ISP, ALTITUDE, AHEAD, FALL = 80.0, 353.0, 3326.0, 126.0, 87.0
STILL = replace(CERES, rotation_rate=0.0)
MU, RADIUS = STILL.gravitational_parameter, STILL.radius
THRUST = 5.04 * MASS * MU / RADIUS**2
INTERVALS = 60


def falling() -> Problem:
    """Return a lander that falls so fast that only full thrust all the way keeps it above the ground."""
    return powered_descent(
        Vehicle(mass=MASS, thrust=THRUST, specific_impulse=ISP),
        Ignition(altitude=ALTITUDE, longitude=0.0, latitude=0.0, heading=math.pi / 2,
                 forward_speed=AHEAD, vertical_speed=-FALL),
        Site(),
        STILL,
        target="anywhere",
        throttle=(0.58, 1.0),
    )  # fmt: skip


def least_time() -> float:
    """Return the least time [s] to rest at full thrust: Radau points and IPOPT in the plane, nothing of ours."""
    tau, slopes = rates_of_polynomials()
    flow, opti = THRUST / (ISP * STANDARD_GRAVITY), ca.Opti()
    time = opti.variable()
    opti.set_initial(time, 1.3)
    x = ca.DM([ALTITUDE / 1e3, -FALL / 1e2, AHEAD / 1e2])
    for i in range(INTERVALS):
        states = [x, *(opti.variable(3) for _ in range(POINTS))]
        for j in range(1, POINTS + 1):
            share, angle = (i + tau[j]) / INTERVALS, opti.variable()
            left = 1 - share
            opti.set_initial(states[j], [ALTITUDE / 1e3 * left**2, -FALL / 1e2 * left, AHEAD / 1e2 * left])
            opti.set_initial(angle, 0.6)
            h, up, ahead = 1e3 * states[j][0], 1e2 * states[j][1], 1e2 * states[j][2]
            r, push = RADIUS + h, THRUST / (MASS - flow * 1e2 * time * share)
            rates = ca.vertcat(
                up / 1e3,
                (ahead**2 / r - MU / r**2 + push * ca.sin(angle)) / 1e2,
                (-up * ahead / r - push * ca.cos(angle)) / 1e2,
            )
            slope = sum(slopes[q, j] * states[q] for q in range(POINTS + 1))
            opti.subject_to(slope == 1e2 * time / INTERVALS * rates)
            opti.subject_to(h >= 0)
        x = states[-1]
    opti.subject_to(x == 0)
    opti.minimize(time)
    opti.solver("ipopt", {"print_time": 0, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10})
    return 1e2 * float(opti.solve().value(time))


def test_a_hop_that_a_mesh_reads_as_a_ride_is_a_touch_and_proved() -> None:
    """Collocation, which asks for the ground at its points alone, ends as soon to 1e-4 s."""
    landed: Any = solve(falling())
    assert (landed.outcome, landed.verification.level) == (Outcome.PROVED, 3)
    assert landed.free["flight_time"] == pytest.approx(least_time(), abs=2e-4)
    first, last = landed.trajectories.structure.phases[0]
    assert (first.touches, last.along) == (("height_above_site",), ())
    hop = landed.outputs(0, np.linspace(first.until + 1.0, last.until - 1.0, 500))["altitude"]
    assert 0.0 < hop.min() < hop.max() < 0.5
    assert landed.outputs(0, np.linspace(0.0, last.until, 20_001))["altitude"].min() > -1e-5
