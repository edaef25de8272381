"""200 returns from orbit drawn at random: proved, refused with the reason, or failed; all but the proved are listed.

Altitude 250-800 km, inclination 28-98 deg, thrust 0.1-2 m/s^2 of the initial mass, exhaust speed 3000 m/s, 30 % of
propellant, ballistic coefficient 30-500 kg/m^2, path angle at the interface -3 to -1.2 deg, given or the flattest that
is allowed. The site is in reach: it is where a plain return lands (`plain_returns.py`), of thrust up to a right angle
above or below, and up to 45 deg beside, the direction against the velocity; drawn again until there is one, and where
there seems to be none with a pitch that turns as fast as the orbit at most. By turns
least flight time and least propellant; ignition at a place, or free on a revolution; exponential air and that of 1976.
Each is solved without a guess and proved:

    python benchmarks/random_returns.py [--count 200] [--seed 9] [--jobs 2] [--limit 180] [--only 17] [--out FILE]

``--limit`` is the processor time [s] of each, ``--only`` solves these numbers alone. All can be flown, as the plain
returns are: what is refused is refused wrongly. The draw depends on the seed alone.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from perilune.core import NUMERIC
from perilune.models import (
    EARTH,
    Atmosphere,
    Interface,
    Landing,
    Manoeuvre,
    Returner,
    ReturnOrbit,
    Transition,
    deorbit_entry,
)
from perilune.models.physics import ellipsoid
from perilune.problem import Problem
from plain_returns import landing
from random_problems import PROVED, OutOfTime, at_most, ending, logarithmic, measured

EXHAUST = 3000.0  # m/s
LEFT = 0.7  # of the mass, without propellant
INTERFACE = 120e3  # m
SITE = 10e3  # m
EXPONENTIAL = Atmosphere(model="exponential", density=1.225, scale_height=7200.0)
STANDARD = Atmosphere(model="us1976")
PITCH, YAW = math.radians(90.0), math.radians(45.0)  # of the thrust of plain returns, at most
STEADY, TRIES = 100, 800  # directions of it: that keep a pitch, and in all


@dataclass(frozen=True)
class Return:
    """One drawn return, and what it is called."""

    words: str
    problem: Problem


def draw(seed: int, number: int) -> Return:
    """Return `number` of a seed."""
    rng = np.random.default_rng([seed, number])
    mass, acceleration = logarithmic(rng, 100.0, 10e3), logarithmic(rng, 0.1, 2.0)
    radius, inclination = EARTH.radius + rng.uniform(250e3, 800e3), math.radians(rng.uniform(28.0, 98.0))
    angle, given = math.radians(rng.uniform(-3.0, -1.2)), bool(rng.random() < 0.5)
    free, minimise = bool(number % 2), ("flight_time", "propellant")[number // 2 % 2]
    air = (EXPONENTIAL, STANDARD)[number // 4 % 2]
    highest, steep = (
        math.asin(math.sin(inclination)),
        f"{'at' if given else 'no flatter than'} {math.degrees(angle):.2f}",
    )
    place = Manoeuvre(
        longitude=rng.uniform(-math.pi, math.pi), latitude=highest * rng.uniform(-0.95, 0.95),
        going=("ascending", "descending")[rng.integers(2)],
    )  # fmt: skip
    orbit = ReturnOrbit(radius=radius, inclination=inclination)
    period = 2 * math.pi * math.sqrt(radius**3 / EARTH.gravitational_parameter)
    coast, pitch, yaw = rng.uniform(0.0, period) if free else 0.0, *_direction(rng)
    vehicle = Returner(
        mass=mass, thrust=mass * acceleration, exhaust_velocity=EXHAUST, dry_mass=LEFT * mass,
        ballistic_coefficient=rng.uniform(30.0, 500.0),
    )  # fmt: skip
    flattest = Interface(altitude=INTERFACE, angle_lower=math.radians(-3.5), angle_upper=angle)
    stated: dict[str, Any] = {
        "vehicle": vehicle,
        "orbit_": replace(orbit, longest_coast=period) if free else orbit,
        "interface": Interface(altitude=INTERFACE, angle=angle) if given else flattest,
        "body": EARTH,
        "manoeuvre": place,
        "transition": Transition(longest_coast=4000.0),
        "air": air,
        "minimise": minimise,
    }
    anywhere = deorbit_entry(**stated, site=Landing(altitude=SITE))
    return Return(
        words=f"{minimise}, ignition {'free' if free else 'at a place'}, {air.model}, "
        f"{(radius - EARTH.radius) / 1e3:.0f} km, {math.degrees(inclination):.0f} deg, {acceleration:.2f} m/s^2, "
        f"{vehicle.ballistic_coefficient:.0f} kg/m^2, {steep} deg",
        problem=deorbit_entry(**stated, site=_site(rng, anywhere, coast, pitch, yaw)),
    )


def _site(rng: np.random.Generator, anywhere: Problem, coast: float, pitch: float, yaw: float) -> Landing:
    """Where a plain return lands, of these or of others that are drawn until one flies."""
    given = anywhere.given
    angle = float((given.get("interface_angle") or given["interface_angle_upper"]).value)
    for tried in range(TRIES):
        turning = rng.uniform(-1.0, 1.0) if tried >= STEADY else 0.0
        position = landing(anywhere, coast, pitch, yaw, angle, turning)
        if position is not None:
            latitude = ellipsoid.latitude(position, anywhere.parameters({}), NUMERIC)
            return Landing(longitude=math.atan2(position[1], position[0]), latitude=float(latitude), altitude=SITE)
        pitch, yaw = _direction(rng)
    raise RuntimeError(f"{TRIES} directions, and no plain return")


def _direction(rng: np.random.Generator) -> tuple[float, float]:
    """Pitch and yaw [rad] of the thrust of a plain return."""
    return rng.uniform(-1.0, 1.0) * PITCH, rng.uniform(-1.0, 1.0) * YAW


def judge(seed: int, number: int, limit: float) -> dict[str, Any]:
    """Solve and prove one return: its class, why, and its times [s]."""
    drawn = draw(seed, number)
    row: dict[str, Any] = {"number": number, "words": drawn.words}
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        with at_most(limit):
            row |= ending(drawn.problem)
    except OutOfTime:
        row |= {"class": "failed", "why": f"not finished after {limit:g} s of the processor"}
    row |= {"feasible": True, "wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
    return row


def summary(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Each that is not proved, and the counts."""
    for row in rows:
        if row["class"] != PROVED:
            yield f"{row['number']:4d} {row['class']} ({row['cpu']:.0f} s): {row['words']}: {row['why'][:300]}"
    proved = [row for row in rows if row["class"] == PROVED]
    yield f"{dict(sorted(Counter(row['class'] for row in rows).items()))}"
    yield f"{PROVED}: {len(proved)} of {len(rows)}, all feasible, {100 * len(proved) / max(len(rows), 1):.1f} %"
    yield f"touched {dict(Counter(name for row in proved for name in row['active']))}"
    for name, some in (("proved", proved), ("all", rows)):
        cpu = np.array([row["cpu"] for row in some] or [math.nan])
        parts = f"median {np.median(cpu):.1f} s, 90 % within {np.percentile(cpu, 90):.1f} s, longest {cpu.max():.1f} s"
        yield f"processor of {name}: {parts}"


def told(row: dict[str, Any]) -> str:
    """The line of a return as it comes."""
    return f"{row['class']} ({row['cpu']:.1f} s), {row['words']} {row['why'][:150]}"


if __name__ == "__main__":
    measured(__doc__, judge, summary, told, count=200, limit=180.0)
