"""Landings, descents, precision landings and returns of which about half have no answer, so tight are their limits.

How each ends, and the CPU time that saying so takes. Each problem is solved without a guess and not proved:

    python benchmarks/refusals.py [--count 60] [--seed 8] [--jobs 2] [--kinds return,...] [--doubt] [--edge]
        [--out FILE]

``--count`` is of each kind. With ``--doubt`` every refusal without a bound that holds for every flight is attacked: the
direct method solves the problem with its limits far apart, and follows that flight while they close in. With ``--edge``
each is solved again with a dry mass just below, and just above, the mass that its best flight lands. The counts depend
on the seed alone, the times on the machine; compare two versions with ``PYTHONPATH`` in one run.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from perilune import Pseudospectral
from perilune.core import InfeasibleError, NotConvergedError, PeriluneError
from perilune.models import (
    CERES,
    EUROPA,
    MERCURY,
    MOON,
    Approach,
    Body,
    Corridor,
    Ignition,
    Orbit,
    Retro,
    Site,
    Vehicle,
    hybrid_landing,
    powered_descent,
    precision_landing,
)
from perilune.problem import Problem
from perilune.scenario import load_file
from perilune.solve import solve

BODIES = (MOON, MERCURY, EUROPA, CERES)
CAPSULE = Path(__file__).parent.parent / "examples" / "maps" / "capsule.toml"
STANDARD_GRAVITY = 9.80665
SEARCHED = "the best of n found violates it"


def surface_gravity(body: Body) -> float:
    """Of the body, m/s^2."""
    return body.gravitational_parameter / body.radius**2


def landing(rng: np.random.Generator) -> Problem:
    """From perilune: thrust near the weight, a dry mass near what the rocket equation leaves, perilunes from 1 km."""
    body = BODIES[rng.integers(len(BODIES))]
    isp = rng.uniform(250.0, 450.0)
    perilune = math.exp(rng.uniform(math.log(1e3), math.log(30e3)))
    r = body.radius + perilune
    speed = math.sqrt(body.gravitational_parameter / r)
    least = math.exp(-speed * rng.uniform(1.0, 1.25) / (isp * STANDARD_GRAVITY))
    thrust = 300.0 * surface_gravity(body) * math.exp(rng.uniform(math.log(0.4), math.log(3.0)))
    vehicle = Vehicle(mass=300.0, thrust=thrust, specific_impulse=isp, dry_mass=300.0 * least)
    retro = Retro(specific_impulse=isp * rng.uniform(0.85, 1.0)) if rng.random() < 0.7 else None
    return hybrid_landing(vehicle, retro, Orbit(parking_altitude=100e3, perilune_altitude=perilune), body)


def descent(rng: np.random.Generator) -> Problem:
    """From low flight to a site at a distance near that of braking, over a drawn height, with a dry mass."""
    body = BODIES[rng.integers(len(BODIES))]
    isp, altitude = rng.uniform(250.0, 450.0), rng.uniform(5e3, 30e3)
    speed = math.sqrt(body.gravitational_parameter / body.radius) * rng.uniform(0.5, 1.0)
    acceleration = surface_gravity(body) * rng.uniform(1.0, 3.5)
    way = rng.uniform(0.7, 1.6) * speed**2 / (2 * acceleration) / body.radius
    least = math.exp(-speed * rng.uniform(1.0, 1.4) / (isp * STANDARD_GRAVITY))
    throttle = (rng.uniform(0.1, 0.6), 1.0) if rng.random() < 0.5 else None
    return powered_descent(
        Vehicle(mass=2000.0, thrust=2000.0 * acceleration, specific_impulse=isp, dry_mass=2000.0 * least),
        Ignition(altitude=altitude, longitude=0.0, latitude=0.3, heading=math.pi, forward_speed=speed,
                 vertical_speed=rng.uniform(-0.1, 0.02) * speed),
        Site(altitude=rng.uniform(-0.5, 0.5) * altitude, longitude=rng.uniform(-0.1, 0.1) * way, latitude=0.3 - way),
        body,
        target=rng.choice(["site", "downrange", "anywhere"]),
        throttle=throttle,
    )  # fmt: skip


def precision(rng: np.random.Generator) -> Problem:
    """The last kilometres, with a throttle range, a tilt, a slope and a dry mass near their limits."""
    body = BODIES[rng.integers(len(BODIES))]
    g, up = surface_gravity(body), rng.uniform(300.0, 3000.0)
    fall = math.sqrt(2 * g * up)
    away, bearing = up * rng.uniform(0.0, 2.0), rng.uniform(0.0, 2 * math.pi)
    acceleration = g * rng.uniform(1.3, 4.0)
    return precision_landing(
        Vehicle(mass=2000.0, thrust=2000.0 * acceleration, specific_impulse=rng.uniform(250.0, 450.0),
                dry_mass=2000.0 * rng.uniform(0.7, 0.97)),
        Approach(east=away * math.cos(bearing), north=away * math.sin(bearing), up=up,
                 east_speed=fall * rng.uniform(-0.7, 0.7), north_speed=fall * rng.uniform(-0.7, 0.7),
                 up_speed=-fall * rng.uniform(0.0, 1.0)),
        Site(altitude=0.0, longitude=0.0, latitude=rng.uniform(-1.4, 1.4)),
        Corridor(tilt=math.radians(rng.uniform(15.0, 80.0)), slope=math.radians(rng.uniform(3.0, 30.0))),
        (rng.uniform(0.05, 0.6), rng.uniform(0.7, 1.0)),
        body,
    )  # fmt: skip


def homecoming(rng: np.random.Generator) -> Problem:
    """The capsule of examples/maps, with thrust, site, interface, limits and lift drawn far beyond what it can do."""
    changes = [f"vehicle.thrust={math.exp(rng.uniform(math.log(2.0), math.log(2e4))):.4g} N"]
    if rng.random() < 0.3:
        changes += [f"site.latitude={rng.uniform(-75.0, 75.0):.4g} deg"]
    steep = rng.uniform(1.5, 8.0)
    changes += [f"interface.angle_lower={-steep:.4g} deg", f"interface.angle_upper={-0.8 * steep:.4g} deg"]
    if rng.random() < 0.5:
        changes += [f"limits.load={rng.uniform(1.5, 12.0):.4g} g0"]
    if rng.random() < 0.3:
        changes += [f"limits.heat_rate={math.exp(rng.uniform(math.log(50.0), math.log(1500.0))):.4g} kW/m^2"]
    if rng.random() < 0.4:
        changes += [f"vehicle.lift_to_drag={rng.uniform(0.1, 0.4):.3g}", "vehicle.bank=reversed"]
        changes += ["problem.minimise=flight_time"]
    if rng.random() < 0.5:
        changes += [f"vehicle.dry_mass={rng.uniform(6000.0, 6900.0):.4g} kg"]
    return load_file(CAPSULE, changes).problem


KINDS: dict[str, Callable[[np.random.Generator], Problem]] = {
    "landing": landing,
    "descent": descent,
    "precision": precision,
    "return": homecoming,
}


def draw(kind: str, seed: int, number: int) -> Problem:
    """Problem `number` of a kind."""
    return KINDS[kind](np.random.default_rng([seed, list(KINDS).index(kind), number]))


WIDE: dict[str, Callable[[float], float]] = {
    "vehicle_dry_mass": lambda mass: 0.6 * mass,
    "vehicle_thrust": lambda thrust: 1.5 * thrust,
    "throttle_lower": lambda share: 0.3 * share,
    "throttle_upper": lambda share: 1.0,
    "corridor_tilt": lambda tilt: math.radians(89.0),
    "corridor_slope": lambda slope: math.radians(0.5),
}
STEPS = 10  # in which the limits close in
FINEST_STEP = 1 / 80
EDGES = (0.995, 0.9995, 1.003)  # of the landed mass


def flown_after_all(problem: Problem) -> bool:
    """Whether the direct method finds a flight of a refused problem, coming from one with wide limits."""
    method, shut, step = Pseudospectral(nodes=5, segments=8, refine=0), 0.0, 1 / STEPS
    limits = {name: (wide(problem.given[name].value), problem.given[name].value)
              for name, wide in WIDE.items() if name in problem.given}  # fmt: skip

    def at(share: float) -> Problem:
        return problem.with_given(**{name: a + share * (b - a) for name, (a, b) in limits.items()})

    try:
        flight = method.run(at(0.0))
    except PeriluneError:
        return False
    while shut < 1.0 and step > FINEST_STEP:
        try:
            flight = method.run(at(min(1.0, shut + step)), guess=flight)
            shut = min(1.0, shut + step)
        except PeriluneError:
            step *= 0.5
    return shut == 1.0


def judge(kind: str, seed: int, number: int, doubt: bool) -> dict[str, Any]:
    """Solve one problem; what became of it, and the CPU time [s]."""
    row: dict[str, Any] = {"kind": kind, "number": number}
    began = time.process_time()
    try:
        problem = draw(kind, seed, number)
        solution = solve(problem, verify=0)
        row |= {"outcome": "answered", "why": f"{solution.objective:.9g} by {solution.statistics.initialization}"}
    except InfeasibleError as error:
        row |= {"outcome": error.reason, "why": f"{error.what}: {error.got}"}
    except NotConvergedError as error:
        kept = "a flight kept" if error.flight is not None else "nothing found"
        row |= {"outcome": f"not converged, {kept}", "why": f"{error.what}: {error.got}"}
    except PeriluneError as error:
        row |= {"outcome": "scenario refused", "why": f"{error.what}: {error.got}"}
    row["seconds"] = time.process_time() - began
    if doubt and row["outcome"] == SEARCHED and flown_after_all(problem):
        row["flown"] = True
    return row


def at_the_edge(kind: str, seed: int, number: int) -> list[str]:
    """What is said where the dry mass is a given share of the mass that can land; nothing where no flight is known."""
    try:
        loose = draw(kind, seed, number)
    except PeriluneError:
        return []
    if "vehicle_dry_mass" not in loose.given:
        return []
    loose = loose.with_given(vehicle_dry_mass=0.3 * loose.given["vehicle_dry_mass"].value)
    said = []
    try:
        landed = -solve(loose, verify=0).objective
    except NotConvergedError as error:
        if error.flight is None:
            return []
        landed = -error.flight.objective
    except PeriluneError:
        return []
    for share in EDGES:
        try:
            solve(loose.with_given(vehicle_dry_mass=share * landed), verify=0)
            said.append("answered")
        except InfeasibleError:
            said.append("refused")
        except NotConvergedError as error:
            said.append("not converged, " + ("nothing found" if error.flight is None else "a flight kept"))
    return said


def told(name: str, rows: Sequence[dict[str, Any]]) -> str:
    """Median and 99th percentile of the CPU times of some rows."""
    if not rows:
        return f"{name}: none"
    seconds = np.array([row["seconds"] for row in rows])
    median, most = np.median(seconds), np.percentile(seconds, 99)
    return f"{name}: {len(rows)}, median {median:.2f} s, 99 % within {most:.2f} s, longest {seconds.max():.2f} s"


def main() -> None:
    """Draw, solve, print the counts of each kind and the times."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=8)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--doubt", action="store_true")
    parser.add_argument("--edge", action="store_true")
    parser.add_argument("--out", default="")
    arguments = parser.parse_args()
    kinds = arguments.kinds.split(",")
    with ProcessPoolExecutor(max_workers=arguments.jobs) as pool:
        each = [(kind, arguments.seed, n, arguments.doubt) for kind in kinds for n in range(arguments.count)]
        jobs = [pool.submit(judge, *one) for one in each]
        rows = [job.result() for job in jobs]
        edges = [pool.submit(at_the_edge, *one[:3]) for one in each] if arguments.edge else []
        for share, said in zip(EDGES, zip(*filter(None, (edge.result() for edge in edges)), strict=True), strict=False):
            print(f"dry mass {share:g} of what can land: {dict(Counter(said))}")
    for kind in kinds:
        here = [row for row in rows if row["kind"] == kind]
        print(f"{kind}: {dict(Counter(row['outcome'] for row in here))}")
        print("  " + told("all", here))
    refused = [row for row in rows if row["outcome"] != "answered"]
    print(told("answered", [row for row in rows if row["outcome"] == "answered"]))
    print(told("without an answer", refused))
    print(told("all", rows))
    if arguments.doubt:
        searched = [row for row in rows if row["outcome"] == SEARCHED]
        wrong = [f"{row['kind']} {row['number']}" for row in searched if "flown" in row]
        print(f"refused by a search: {len(searched)}, of which can be flown: {', '.join(wrong) or 'none'}")
    if arguments.out:
        with open(arguments.out, "w", encoding="utf-8") as file:
            json.dump(rows, file, indent=1)


if __name__ == "__main__":
    main()
