"""Ours: each method in its default settings, from no guess, its cache of compiled kernels empty at first.

    python with_perilune.py TASK FILE direct|indirect

Only the method runs: the proof of its answer, which `perilune.solve` adds, is left out, as the peers have none.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
from itertools import pairwise
from typing import Any

import numpy as np
import task as numbers
from answer import Answer, Read, main, pieces
from task import LANDING, Task

# Inside each interval, as the control jumps at its ends; six, as the angle of an interpolated vector is no cubic.
SAMPLES = 0.5 * (1 + np.polynomial.legendre.leggauss(6)[0])


def problem_of(task: Task) -> Any:
    """The same problem in our words."""
    from perilune.models import Body, Orbit, Vehicle, hybrid_landing

    if task.control == LANDING.control:
        return hybrid_landing(
            Vehicle(
                mass=task.start[-1],
                thrust=numbers.THRUST,
                specific_impulse=numbers.SPECIFIC_IMPULSE,
                standard_gravity=numbers.STANDARD_GRAVITY,
            ),
            None,
            Orbit(
                parking_altitude=numbers.PARKING - numbers.RADIUS, perilune_altitude=numbers.PERILUNE - numbers.RADIUS
            ),
            Body(
                name="moon",
                gravitational_parameter=numbers.MU,
                radius=numbers.RADIUS,
                rotation_rate=numbers.ROTATION,
            ),
        )
    return _meditch(task)


def _meditch(task: Task) -> Any:
    from perilune import Conditions, FreeParameter, Parameter, Phase, Problem, ScalarControl, Variable

    phase = Phase(
        name="descent",
        states=(
            Variable(name="h", unit="m"),
            Variable(name="v", unit="m/s"),
            Variable(name="m", unit="kg", lower=0.1),
        ),
        controls=(ScalarControl(name="thrust", unit="N", lower=task.bounds[0], upper=task.bounds[1]),),
        dynamics=lambda x, u, p, xp: (x.v, u.thrust / x.m - p.g, -u.thrust / p.c),
        duration="t_f",
        end=Conditions(lambda x, p, xp: (x.h, x.v), touchdown="m", touchdown_speed="m/s"),
        end_guess=lambda p, xp: (0 * p.h, 0 * p.v, task.guess_end[-1] * p.m),
    )
    return Problem(
        name="meditch",
        phases=(phase,),
        start=lambda p, xp: (p.h, p.v, p.m),
        given={
            "g": Parameter(value=numbers.GRAVITY, unit="m/s^2"),
            "c": Parameter(value=numbers.EXHAUST, unit="m/s"),
            **{n: Parameter(value=v, unit=u) for n, v, u in zip("hvm", task.start, ("m", "m/s", "kg"), strict=True)},
        },
        free=(FreeParameter(name="t_f", unit="s", lower=0.0, upper=10.0, guess=task.guess_time),),
        objective=lambda x, p, xp: p.c * (p.m - x.m),
        objective_unit="N*s",
    )


def setup(task: Task) -> Any:
    """State the problem; both methods do all their work when they run."""
    from perilune import Indirect, Pseudospectral

    problem = problem_of(task)
    method = Pseudospectral() if DIRECT else Indirect()

    def solve() -> Read:
        solution = method.run(problem)

        def read() -> Answer:
            flown = solution.trajectories[0]
            time = flown.control.time
            nodes = [a + (b - a) * SAMPLES for a, b in pairwise(time)]
            values = [flown.control(t) for t in nodes]
            if task.control == LANDING.control:  # (cos beta, sin beta)
                values = [math.pi + np.arctan2(-u[:, 1], -u[:, 0]) for u in values]
            else:
                values = [u[:, 0] for u in values]
            mesh = f", mesh to {method.tolerance:g} (its default)" if DIRECT else ""
            return Answer(
                mass=float(flown.state(flown.duration)[-1]),
                time=flown.duration,
                control=pieces(time.tolist(), [t.tolist() for t in nodes], [u.tolist() for u in values]),
                grid=solution.statistics.initialization + mesh,
            )

        return read

    return solve


if __name__ == "__main__":
    DIRECT = sys.argv.pop() == "direct"
    with tempfile.TemporaryDirectory() as cache:
        os.environ["PERILUNE_CACHE"] = cache
        main("perilune", "perilune", setup)
