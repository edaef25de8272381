"""Strong landers drawn at random, from circular, elliptic and falling starts to rest anywhere on the ground.

Thrust over weight 1-20, throttle floors 0 (half of the draws) to 0.6, from 2 to 200 km over four airless bodies and one
of the size of a captured asteroid, turning either way or not at all. Coasting first costs about half of what full
thrust all the way does, and the coast grazes the ground. What the pre-flight forbids is drawn again. Each is solved
without a guess and proved to level 3:

    python benchmarks/strong_landers.py [--count 200] [--seed 41] [--jobs 1] [--limit 30] [--only 17] [--out FILE]

``--limit`` is the processor time [s] of each, ``--only`` solves these numbers alone. The draw depends on the seed
alone.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from perilune.models import CERES, EUROPA, MERCURY, MOON, Body, Ignition, Site, Vehicle, powered_descent
from perilune.problem import Problem, is_possible, preflight
from random_problems import DRAWS, PROVED, logarithmic, measured, surface_gravity, timed_ending

# A made-up body with the gravity of Minmus, a moon of the game Kerbal Space Program.
MINMUS = Body(name="minmus", gravitational_parameter=1.7658e9, radius=60e3, rotation_rate=1.5552e-4)
BODIES = (MOON, MERCURY, EUROPA, CERES, MINMUS)
STARTS = ("circular", "elliptic", "falling")


def shape(rng: np.random.Generator, start: str, body: Body, altitude: float) -> tuple[float, float]:
    """Speed ahead and upwards [m/s] at the start, in inertial axes."""
    mu, r = body.gravitational_parameter, body.radius + altitude
    circular = math.sqrt(mu / r)
    if start == "circular":
        return circular, 0.0
    if start == "falling":
        return circular * rng.uniform(0.0, 0.8), -circular * rng.uniform(0.0, 0.3)
    low = body.radius + rng.uniform(-0.2, 1.0) * altitude
    high = r + rng.uniform(0.0, 200e3)
    semi = 0.5 * (low + high)
    ahead = math.sqrt(mu * low * high / semi) / r
    return ahead, rng.choice((-1.0, 1.0)) * math.sqrt(max(mu * (2 / r - 1 / semi) - ahead**2, 0.0))


def drawn(rng: np.random.Generator) -> tuple[str, Problem]:
    """Draw one start and its problem."""
    body, start = BODIES[rng.integers(len(BODIES))], STARTS[rng.integers(len(STARTS))]
    body = replace(body, rotation_rate=body.rotation_rate * rng.choice((-1.0, 0.0, 1.0)))
    altitude, latitude, heading = logarithmic(rng, 2e3, 200e3), rng.uniform(-1.2, 1.2), rng.uniform(0.0, 2 * math.pi)
    if body.radius < 1e5:
        altitude = min(altitude, body.radius)
    ahead, up = shape(rng, start, body, altitude)
    ground = body.rotation_rate * (body.radius + altitude) * math.cos(latitude)  # eastwards
    mass, weight = logarithmic(rng, 50.0, 20e3), surface_gravity(body)
    return start, powered_descent(
        Vehicle(
            mass=mass,
            thrust=mass * weight * logarithmic(rng, 1.0, 20.0),
            specific_impulse=rng.uniform(220.0, 450.0),
        ),
        Ignition(
            altitude=altitude, longitude=0.0, latitude=latitude, heading=heading,
            forward_speed=ahead - ground * math.sin(heading), sideways_speed=ground * math.cos(heading),
            vertical_speed=up,
        ),
        Site(altitude=0.0, longitude=0.5, latitude=0.3),
        body,
        target="anywhere",
        throttle=(rng.uniform(0.0, 0.6) if rng.random() < 0.5 else 0.0, 1.0),
    )  # fmt: skip


def draw(seed: int, number: int) -> tuple[str, Problem]:
    """Lander `number`."""
    rng = np.random.default_rng([seed, number])
    for _ in range(DRAWS):
        start, problem = drawn(rng)
        if is_possible(preflight(problem)):
            return start, problem
    raise RuntimeError(f"{DRAWS} draws, and all are impossible")


def judge(seed: int, number: int, limit: float) -> dict[str, Any]:
    """Solve and prove one lander: its class, why, and its times [s]."""
    start, problem = draw(seed, number)
    row: dict[str, Any] = {"number": number, "start": start, "body": problem.title}
    row["given"] = {name: given.value for name, given in problem.given.items()}
    return row | timed_ending(problem, limit)


def summary(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Say what became of all, of each that is not proved why, and how long it took."""
    for row in rows:
        if row["class"] != PROVED:
            floor = row["given"]["throttle_lower"]
            where = f"{row['number']:4d} {row['start']}, floor {floor:.2f}"
            yield f"{where}, {row['class']} ({row['cpu']:.1f} s): {row['why'][:300]}"
    for start in STARTS:
        for floored in (False, True):
            of = [r for r in rows if r["start"] == start and (r["given"]["throttle_lower"] > 0) is floored]
            ends = dict(sorted(Counter(row["class"] for row in of).items()))
            yield f"{start}, floor {'above 0' if floored else '0'}: {ends}"
    proved = [row for row in rows if row["class"] == PROVED]
    yield f"{PROVED}: {len(proved)} of {len(rows)}, {100 * len(proved) / max(len(rows), 1):.1f} %"
    yield f"rungs {dict(Counter(row['initialization'] for row in proved))}"
    took = np.array([row["cpu"] for row in rows])
    p50, p99 = np.percentile(took, (50, 99))
    yield f"processor time: median {p50:.2f} s, p99 {p99:.2f} s, longest {took.max():.2f} s, {took.sum():.0f} s in all"


if __name__ == "__main__":
    measured(
        __doc__,
        judge,
        summary,
        lambda row: f"{row['start']}, {row['class']}, {row['cpu']:.1f} s",
        count=200,
        limit=30.0,
    )
