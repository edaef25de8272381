"""200 returns from orbit drawn at random: proved, refused with the reason, or failed; all but the proved are listed.

Altitude 250-800 km, inclination 28-98 deg, thrust 0.1-2 m/s^2 of the initial mass, exhaust speed 3000 m/s, 30 % of
propellant, ballistic coefficient 30-500 kg/m^2, path angle at the interface -3 to -1.2 deg, given or the flattest that
is allowed. The site lies where an impulsive deorbit would land, some of the way further or less far, and beside the
ground track by up to a third of what the propellant can turn. By turns least flight time and least propellant; ignition
at a place, or free on a revolution; exponential air and that of 1976. Each is solved without a guess and proved:

    python benchmarks/random_returns.py [--count 200] [--seed 9] [--jobs 2] [--limit 180] [--only 17] [--out FILE.json]

``--limit`` is the processor time [s] of each, ``--only`` solves these numbers alone. Feasible is what either method
flies: of a refused or failed one the direct method follows a flight that lands anywhere to the site. The draw depends
on the seed alone.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.methods.indirect import Indirect
from perilune.methods.pseudospectral import Pseudospectral
from perilune.models.bodies import EARTH
from perilune.models.deorbit.orbit import from_place, plane
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.records import (
    Atmosphere,
    Interface,
    Landing,
    Manoeuvre,
    Orbit,
    Returner,
    Transition,
)
from perilune.models.deorbit.times import impulsive
from perilune.problem.declared import given_of
from perilune.problem.problem import Problem
from perilune.words.maths import NUMERIC
from perilune.words.outcome import PeriluneError
from random_problems import PROVED, OutOfTime, at_most, ending, logarithmic, measured

EXHAUST = 3000.0  # m/s
LEFT = 0.7  # of the mass, without propellant
INTERFACE = 120e3  # m
ENTRY_TIME, ENTRY_SWEPT = 450.0, math.radians(17.0)  # roughly, from the interface to the site
EXPONENTIAL = Atmosphere(model="exponential", density=1.225, scale_height=7200.0)
STANDARD = Atmosphere(model="us1976")
STEPS, FINEST_STEP = 8, 1 / 64  # in which a landing anywhere is led to the site


@dataclass(frozen=True)
class Return:
    """One drawn return: what it is called, and what is stated of it."""

    words: str
    stated: dict[str, Any]

    @property
    def problem(self) -> Problem:
        """To its site."""
        return deorbit_entry(**self.stated)

    @property
    def anywhere(self) -> Problem:
        """The same to any place at the altitude of the site."""
        return deorbit_entry(**{**self.stated, "site": replace(self.stated["site"], longitude=None, latitude=None)})


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
    orbit = Orbit(radius=radius, inclination=inclination)
    period = 2 * math.pi * math.sqrt(radius**3 / EARTH.gravitational_parameter)
    site = _site(rng, orbit, place, angle, rng.uniform(0.0, period) if free else 0.0)
    vehicle = Returner(
        mass=mass, thrust=mass * acceleration, exhaust_velocity=EXHAUST, dry_mass=LEFT * mass,
        ballistic_coefficient=rng.uniform(30.0, 500.0),
    )  # fmt: skip
    flattest = Interface(altitude=INTERFACE, angle_lower=math.radians(-3.5), angle_upper=angle)
    return Return(
        words=f"{minimise}, ignition {'free' if free else 'at a place'}, {air.model}, "
        f"{(radius - EARTH.radius) / 1e3:.0f} km, {math.degrees(inclination):.0f} deg, {acceleration:.2f} m/s^2, "
        f"{vehicle.ballistic_coefficient:.0f} kg/m^2, {steep} deg",
        stated={
            "vehicle": vehicle,
            "orbit_": replace(orbit, longest_coast=period) if free else orbit,
            "interface": Interface(altitude=INTERFACE, angle=angle) if given else flattest,
            "body": EARTH,
            "manoeuvre": place,
            "transition": Transition(longest_coast=4000.0),
            "air": air,
            "site": site,
            "minimise": minimise,
        },
    )


def _site(rng: np.random.Generator, orbit: Orbit, place: Manoeuvre, angle: float, coast: float) -> Landing:
    """Where an impulse after a coast would land, moved along the track and across it."""
    mu, radius = EARTH.gravitational_parameter, float(orbit.radius or 0.0)
    down = impulsive(radius, EARTH.radius + INTERFACE, angle, mu)
    stated = given_of(EARTH, orbit, place)
    begun = SimpleNamespace(**{name: given.value for name, given in stated.items()})
    begins, node = (float(v) for v in from_place(place.going)(begun, NUMERIC))
    swept = (down.swept + ENTRY_SWEPT) * rng.uniform(0.9, 1.1) + coast * math.sqrt(mu / radius**3)
    spare = EXHAUST * math.log(1 / LEFT) - down.velocity_change
    across = rng.uniform(-1.0, 1.0) / 3 * spare / math.sqrt(mu / radius)
    lasts = coast + down.time + ENTRY_TIME
    up, ahead = plane(begins + swept, node - EARTH.rotation_rate * lasts, begun, NUMERIC)
    towards = math.cos(across) * np.array(up) + math.sin(across) * np.cross(up, ahead)
    return Landing(longitude=math.atan2(towards[1], towards[0]), latitude=math.asin(towards[2]), altitude=10e3)


def flown_after_all(drawn: Return) -> bool:
    """Whether the direct method finds a flight, coming from one of either method that lands anywhere."""
    method, near, step, problem = Pseudospectral(nodes=5, segments=8, refine=0), 0.0, 1 / STEPS, drawn.problem
    try:
        flight = Indirect().run(drawn.anywhere)
    except PeriluneError as error:
        if (flight := getattr(error, "flight", None)) is None:  # which is the direct method's, if it has one
            return False
    names = ("longitude", "latitude")
    landed = {name: flight.results[f"landing_{name}"].value for name in names}
    aim = {name: float(problem.given[f"site_{name}"].value) for name in names}
    aim["longitude"] += 2 * math.pi * round((landed["longitude"] - aim["longitude"]) / (2 * math.pi))
    while near < 1.0 and step > FINEST_STEP:
        to = min(1.0, near + step)
        moved = {f"site_{name}": landed[name] + to * (aim[name] - landed[name]) for name in names}
        try:
            flight, near = method.run(problem.with_given(**moved), guess=flight), to
        except PeriluneError:
            step *= 0.5
    return near == 1.0


def judge(seed: int, number: int, limit: float) -> dict[str, Any]:
    """Solve and prove one return: its class, why, whether it can be flown, and its times [s]."""
    drawn = draw(seed, number)
    row: dict[str, Any] = {"number": number, "words": drawn.words}
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        with at_most(limit):
            row |= ending(drawn.problem)
    except OutOfTime:
        row |= {"class": "failed", "why": f"not finished after {limit:g} s of the processor", "feasible": None}
    row |= {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
    if row["feasible"] is None:
        try:
            with at_most(2 * limit):
                row["feasible"] = flown_after_all(drawn)
        except OutOfTime:
            row["feasible"] = False
    return row


def summary(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Each that is not proved, and the counts."""
    for row in rows:
        if row["class"] != PROVED:
            flown = "can be flown" if row["feasible"] else "no flight is known"
            yield f"{row['number']:4d} {row['class']}, {flown} ({row['cpu']:.0f} s): {row['words']}: {row['why'][:300]}"
    feasible = [row for row in rows if row["feasible"]]
    proved = [row for row in feasible if row["class"] == PROVED]
    yield f"{dict(sorted(Counter(row['class'] for row in rows).items()))}"
    yield f"refused, though it can be flown: {sum(row['class'] == 'refused' for row in feasible)}"
    yield f"{PROVED}: {len(proved)} of {len(feasible)} feasible, {100 * len(proved) / max(len(feasible), 1):.1f} %"
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
