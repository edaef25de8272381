"""10 000 landers from perilune drawn at random: proved, at a lower level, refused and why, failed, or an error.

Nine bodies of the sizes of Phobos to Titan, turning either way, thrust-to-mass 0.5-30 m/s^2, Isp 200-450 s, impulsive
Isp 0.5-1.1 of it, perilune 1-60 km (below the parking orbit), parking orbit 20-1000 km, mass 50 kg-20 t (logarithmic),
site 3 km below to 5 km above the mean ground. Each is solved without a guess and proved to level 3:

    python benchmarks/random_landers.py [--count 10000] [--seed 2015] [--jobs 2] [--limit 20] [--only 17] [--out FILE]

``--limit`` is the processor time [s] of each, ``--only`` solves these numbers alone. What is refused is not flown by
another method here: the reasons are listed. The draw depends on the seed alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from perilune.models import CERES, EUROPA, MERCURY, MOON, Body, Orbit, Retro, Vehicle, hybrid_landing
from perilune.problem import Problem
from random_problems import PROVED, logarithmic, measured, timed_ending

# Of those that the package does not bring: JPL's tables of physical parameters, rounded; rotation by the sidereal day.
PHOBOS = Body(name="phobos", gravitational_parameter=7.087e5, radius=11.08e3, rotation_rate=2.28e-4)
ENCELADUS = Body(name="enceladus", gravitational_parameter=7.211e9, radius=252.1e3, rotation_rate=5.31e-5)
VESTA = Body(name="vesta", gravitational_parameter=1.729e10, radius=261.4e3, rotation_rate=3.267e-4)
TITAN = Body(name="titan", gravitational_parameter=8.97814e12, radius=2574.76e3, rotation_rate=4.561e-6)
GANYMEDE = Body(name="ganymede", gravitational_parameter=9.88783e12, radius=2631.2e3, rotation_rate=1.0164e-5)
NINE = (PHOBOS, ENCELADUS, VESTA, CERES, EUROPA, MOON, MERCURY, TITAN, GANYMEDE)


def draw(seed: int, number: int) -> Problem:
    """Lander `number`."""
    rng = np.random.default_rng([seed, number])
    body = NINE[rng.integers(len(NINE))]
    body = replace(body, rotation_rate=body.rotation_rate * rng.choice((-1.0, 1.0)))
    mass, isp, acceleration = logarithmic(rng, 50.0, 20e3), rng.uniform(200.0, 450.0), logarithmic(rng, 0.5, 30.0)
    parking = logarithmic(rng, 20e3, 1000e3)
    return hybrid_landing(
        Vehicle(mass=mass, thrust=mass * acceleration, specific_impulse=isp),
        Retro(specific_impulse=isp * rng.uniform(0.5, 1.1)),
        Orbit(parking_altitude=parking, perilune_altitude=rng.uniform(1e3, min(60e3, 0.9 * parking))),
        body,
        rng.uniform(-3e3, 5e3),
    )


def judge(seed: int, number: int, limit: float) -> dict[str, Any]:
    """Solve and prove one lander: its class, why, and its times [s]."""
    problem = draw(seed, number)
    row: dict[str, Any] = {"number": number}
    row["given"] = {name: given.value for name, given in problem.given.items()}
    return row | timed_ending(problem, limit)


def weak(row: dict[str, Any]) -> bool:
    """Whether its thrust is less than half of its weight on the mean ground."""
    given = row["given"]
    weight = given["vehicle_mass"] * given["body_gravitational_parameter"] / given["body_radius"] ** 2
    return given["vehicle_thrust"] < 0.5 * weight


def table(rows: Sequence[dict[str, Any]]) -> Iterator[tuple[str, ...]]:
    """How many ended in which way, over bodies from small to large and over all, those of little thrust apart."""
    yield "body", "thrust over weight", "drawn", "refused", PROVED, "lower level", "no answer"
    for name, radius in (*((body.name, body.radius) for body in NINE), ("all", None)):
        for little, words in ((False, "at least 0.5"), (True, "less")):
            of = [row for row in rows if radius in (None, row["given"]["body_radius"]) and weak(row) is little]
            ends = Counter(row["class"] if row["class"] in (PROVED, "refused") else row["class"][:5] for row in of)
            shown = (ends["refused"], ends[PROVED], ends["level"])
            if of:
                yield name.capitalize(), words, *map(str, (len(of), *shown, len(of) - sum(shown)))


def summary(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """What became of all, each that is neither proved nor refused, and the reasons of refusals."""
    for row in rows:
        if row["class"] not in (PROVED, "refused"):
            yield f"{row['number']:5d} {row['class']} ({row['cpu']:.1f} s): {row['why'][:300]}"
    yield from (" | ".join(line) for line in table(rows))
    yield f"{dict(Counter(row['class'] for row in rows))}"
    yield f"refused: {dict(Counter(row['why'].partition(':')[0] for row in rows if row['class'] == 'refused'))}"
    flown = [row for row in rows if row["class"] != "refused"]
    proved = [row for row in flown if row["class"] == PROVED]
    yield f"{PROVED}: {len(proved)} of {len(flown)} not refused, {100 * len(proved) / max(len(flown), 1):.2f} %"
    yield f"rungs {dict(Counter(row['initialization'] for row in proved))}"
    took = np.array([row["cpu"] for row in rows])
    yield f"processor time: median {np.median(took):.2f} s, longest {took.max():.1f} s, {took.sum():.0f} s in all"


if __name__ == "__main__":
    measured(__doc__, judge, summary, lambda row: row["class"], count=10_000, limit=20.0)
