"""Problems of every model drawn at random, with limits that are often active: what the default call makes of each.

Landings from perilune, descents, precision landings over round bodies and over flat ground. Drawn with each are
throttle floors, tilts, slopes, steering bounds, dry masses, free ignitions, vertical ends, speeds of touchdown and
altitudes of the site. What the pre-flight forbids is drawn again. Each is solved without a guess and proved to level 3:

    python benchmarks/random_problems.py [--count 300] [--seed 9] [--jobs 2] [--limit 120] [--only 17] [--out FILE]

``--limit`` is the processor time [s] of each, ``--only`` solves these numbers alone. Feasible is what either method
flies: a refused or failed problem counts where the direct method has a flight that misses nothing, or gets one from
wider limits (`refusals.py`). The draw depends on the seed alone.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import ExitStack, contextmanager
from typing import Any, TextIO

import numpy as np

from perilune.core import InfeasibleError, NotConvergedError, Outcome, PeriluneError
from perilune.methods.indirect.coarse_direct import nearly_active_conditions
from perilune.models import (
    CERES,
    EUROPA,
    MARS,
    MERCURY,
    MOON,
    Approach,
    Body,
    Corridor,
    FinalDescent,
    Ignition,
    Orbit,
    Retro,
    Site,
    Steering,
    UniformGravity,
    Vehicle,
    hybrid_landing,
    powered_descent,
    precision_landing,
)
from perilune.problem import Problem, Solution, is_possible, preflight
from perilune.solve import solve
from refusals import flown_after_all

STANDARD_GRAVITY = 9.80665
AIRLESS = (MOON, MERCURY, EUROPA, CERES)
DRAWS = 200  # of one problem, until the pre-flight lets it through
PROVED = "PROVED 3"


def surface_gravity(body: Body) -> float:
    """Of the body, m/s^2."""
    return body.gravitational_parameter / body.radius**2


def logarithmic(rng: np.random.Generator, low: float, high: float) -> float:
    """Drawn so that its logarithm is uniform."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def often(rng: np.random.Generator, share: float, value: Any) -> Any:
    """A value in a share of all draws, else None."""
    return value if rng.random() < share else None


def vehicle(rng: np.random.Generator, acceleration: float, speed: float) -> Vehicle:
    """A lander, half of the time with a dry mass that leaves up to twice what an ideal flight loses of `speed`."""
    mass, isp = logarithmic(rng, 50.0, 20e3), rng.uniform(220.0, 450.0)
    dry = mass * math.exp(-speed * rng.uniform(1.05, 2.0) / (isp * STANDARD_GRAVITY))
    return Vehicle(mass=mass, thrust=mass * acceleration, specific_impulse=isp, dry_mass=often(rng, 0.5, dry))


def landing(rng: np.random.Generator) -> Problem:
    """From perilune onto a site above or below the mean ground, with a retro burn or without."""
    body = AIRLESS[rng.integers(len(AIRLESS))]
    perilune = rng.uniform(8e3, 30e3)
    speed = math.sqrt(body.gravitational_parameter / (body.radius + perilune))
    lander = vehicle(rng, surface_gravity(body) * logarithmic(rng, 0.8, 4.0), 1.1 * speed)
    retro = often(rng, 0.7, Retro(specific_impulse=lander.specific_impulse * rng.uniform(0.85, 1.0)))
    orbit = Orbit(parking_altitude=rng.uniform(50e3, 200e3), perilune_altitude=perilune)
    return hybrid_landing(lander, retro, orbit, body, rng.uniform(-0.3, 0.3) * perilune)


def descent(rng: np.random.Generator) -> Problem:
    """From low flight to a site at a distance near that of braking, over a drawn height."""
    body = AIRLESS[rng.integers(len(AIRLESS))]
    altitude = rng.uniform(5e3, 30e3)
    speed = math.sqrt(body.gravitational_parameter / body.radius) * rng.uniform(0.5, 1.0)
    acceleration = surface_gravity(body) * rng.uniform(1.3, 3.5)
    way = rng.uniform(0.9, 1.6) * speed**2 / (2 * acceleration) / body.radius
    elevation = (-math.radians(rng.uniform(10.0, 60.0)), math.radians(rng.uniform(20.0, 80.0)))
    return powered_descent(
        vehicle(rng, acceleration, 1.1 * speed),
        Ignition(altitude=altitude, longitude=0.0, latitude=0.3, heading=math.pi, forward_speed=speed,
                 vertical_speed=rng.uniform(-0.05, 0.02) * speed, longest_coast=often(rng, 0.2, 600.0)),
        Site(altitude=rng.uniform(-0.3, 0.3) * altitude, longitude=rng.uniform(-0.1, 0.1) * way, latitude=0.3 - way),
        body,
        target=("site", "downrange", "anywhere")[rng.integers(3)],
        steering=often(rng, 0.3, Steering(elevation=elevation)),
        throttle=often(rng, 0.5, (rng.uniform(0.1, 0.6), 1.0)),
    )  # fmt: skip


def precision(rng: np.random.Generator, body: Body | UniformGravity | None = None) -> Problem:
    """The last kilometres, with and without each part of a corridor, a free ignition and a vertical end."""
    if body is None:
        body = (*AIRLESS, MARS)[rng.integers(len(AIRLESS) + 1)]
    g = body.gravity if isinstance(body, UniformGravity) else surface_gravity(body)
    up = logarithmic(rng, 200.0, 5000.0)
    fall, away, bearing = math.sqrt(2 * g * up), up * rng.uniform(0.0, 2.5), rng.uniform(0.0, 2 * math.pi)
    site = Site(altitude=rng.uniform(-2e3, 2e3), longitude=0.0, latitude=rng.uniform(-1.4, 1.4))
    final = FinalDescent(height=up * rng.uniform(0.02, 0.2), touchdown_speed=rng.uniform(0.0, 3.0))
    return precision_landing(
        vehicle(rng, g * rng.uniform(1.5, 5.0), 1.5 * fall + 2 * math.sqrt(g * away)),
        Approach(east=away * math.cos(bearing), north=away * math.sin(bearing), up=up,
                 east_speed=fall * rng.uniform(-0.7, 0.7), north_speed=fall * rng.uniform(-0.7, 0.7),
                 up_speed=-fall * rng.uniform(0.0, 0.8), longest_coast=often(rng, 0.2, 4 * fall / g)),
        None if isinstance(body, UniformGravity) else site,
        Corridor(tilt=often(rng, 0.6, math.radians(rng.uniform(15.0, 80.0))),
                 slope=often(rng, 0.6, math.radians(rng.uniform(3.0, 30.0))),
                 pad_radius=logarithmic(rng, 1.0, 30.0)),
        (rng.uniform(0.05, 0.6), rng.uniform(0.7, 1.0)),
        body,
        final=often(rng, 0.35, final),
    )  # fmt: skip


def flat(rng: np.random.Generator) -> Problem:
    """The same over flat ground, from the gravity of a small moon to that of the Earth."""
    return precision(rng, UniformGravity(gravity=logarithmic(rng, 0.1, 9.81)))


KINDS: dict[str, Callable[[np.random.Generator], Problem]] = {
    "landing": landing,
    "descent": descent,
    "precision": precision,
    "flat": flat,
}


def draw(seed: int, number: int) -> tuple[str, Problem]:
    """Problem `number`, of the kinds in turn."""
    kind, rng = list(KINDS)[number % len(KINDS)], np.random.default_rng([seed, number])
    for _ in range(DRAWS):
        problem = KINDS[kind](rng)
        if is_possible(preflight(problem)):
            return kind, problem
    raise RuntimeError(f"{DRAWS} draws of {kind}, and all are impossible")


class OutOfTime(BaseException):
    """The time of one problem has run out; nothing of the library may catch it."""


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Raise `OutOfTime` in this thread after so many seconds of the processor, at the next step of Python.

    Again each second, where that is lost.
    """
    over = False

    def stop(*_: Any) -> None:
        nonlocal over
        over = True
        raise OutOfTime

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, 1.0)  # CasADi swallows what is raised while it computes
    try:
        yield
    except KeyboardInterrupt:  # what is raised inside IPOPT comes out of it as this
        if not over:
            raise
        raise OutOfTime from None
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def judge(seed: int, number: int, limit: float) -> dict[str, Any]:
    """Solve and prove one problem: its class, why, whether it can be flown, and its times [s]."""
    kind, problem = draw(seed, number)
    row: dict[str, Any] = {"number": number, "kind": kind, "title": problem.title}
    row["given"] = {name: given.value for name, given in problem.given.items() if not name.startswith("body")}
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        with at_most(limit):
            row |= ending(problem)
    except OutOfTime:
        row |= {"class": "failed", "why": f"not finished after {limit:g} s", "feasible": None}
    row |= {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
    if row["feasible"] is None:
        try:
            with at_most(limit):
                row["feasible"] = flown_after_all(problem)
        except OutOfTime:
            row["feasible"] = False
    return row


def ending(problem: Problem) -> dict[str, Any]:
    """How the default call ends; `feasible` is None where it leaves open whether any flight is known."""
    try:
        return told_of(solve(problem))
    except NotConvergedError as error:
        flown = error.flight is not None and not error.partial.get("violations")
        return {"class": "failed", "why": f"{error.what}: {error.got}", "feasible": flown or None}
    except InfeasibleError as error:
        return {"class": "refused", "why": f"{error.what}: {error.got}", "feasible": None}
    except PeriluneError as error:
        return {"class": "failed", "why": f"{error.what}: {error.got}", "feasible": None}


def timed_ending(problem: Problem, limit: float) -> dict[str, Any]:
    """Return how the default call ends within `limit` [s], with its times [s]; a fault is an outcome as well."""
    row: dict[str, Any] = {}
    wall, cpu = time.perf_counter(), time.process_time()
    try:
        with at_most(limit):
            row |= ending(problem)
    except OutOfTime:
        row |= {"class": "slow", "why": f"not finished after {limit:g} s"}
    except Exception as error:  # what is no word of ours is what this looks for
        row |= {"class": "error", "why": f"{type(error).__name__}: {error}"}
    return row | {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}


def told_of(solution: Solution) -> dict[str, Any]:
    """Class and reason of an answer, with what it touches."""
    proof = solution.verification
    row = {
        "objective": solution.objective,
        "initialization": solution.statistics.initialization,
        "active": sorted(nearly_active_conditions(solution)),
    }
    row |= {"feasible": True, "class": PROVED, "why": ""}
    if solution.outcome is not Outcome.PROVED:
        failed = [f"{c.name} {c.value:.3g} > {c.limit:.3g}" for c in proof.failed]
        row |= {"class": f"level {proof.level}", "why": "; ".join(failed[:4]), "failed": [c.name for c in proof.failed]}
    return row


def summary(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """What became of all, each that is feasible and not proved, and the shares."""
    for row in rows:
        if row["class"] != PROVED and row["feasible"]:
            yield f"{row['number']:4d} {row['kind']}, {row['class']} ({row['wall']:.0f} s): {row['why'][:300]}"
    for kind in KINDS:
        here = Counter(row["class"] for row in rows if row["kind"] == kind)
        yield f"{kind}: {dict(sorted(here.items()))}"
    feasible = [row for row in rows if row["feasible"]]
    proved = [row for row in feasible if row["class"] == PROVED]
    active = Counter(name for row in proved for name in row["active"])
    wall, cpu = (np.array([row[name] for row in rows]) for name in ("wall", "cpu"))
    yield f"{len(rows) - len(feasible)} that no method flies; {len(feasible)} feasible"
    yield f"{PROVED}: {len(proved)} of these, {100 * len(proved) / max(len(feasible), 1):.1f} %"
    yield f"rungs {dict(Counter(row['initialization'] for row in proved))}; touched {dict(active)}"
    for name, took in (("wall clock", wall), ("processor", cpu)):
        yield f"{name} of each: median {np.median(took):.1f} s, longest {took.max():.1f} s"


def measured(
    about: str | None,
    judge: Callable[[int, int, float], dict[str, Any]],
    summary: Callable[[Sequence[dict[str, Any]]], Iterator[str]],
    told: Callable[[dict[str, Any]], str],
    *,
    count: int,
    limit: float,
) -> None:
    """Draw, judge, and print what became of them.

    Parameters
    ----------
    about
        Docstring of the benchmark.
    judge, summary, told
        What becomes of (seed, number, limit); all lines of the rows in order; and the line of a row as it comes.
    count, limit
        How many are drawn, and for how long each may be at work [s], unless others are asked for.
    """
    parser = argparse.ArgumentParser(description=about.split("\n")[0] if about else "")
    parser.add_argument("--count", type=int, default=count)
    parser.add_argument("--seed", type=int, default=9)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--limit", type=float, default=limit)
    parser.add_argument("--only", type=int, nargs="*")
    parser.add_argument("--out", default="", help="a line for each as it comes; what it has is not computed again")
    arguments = parser.parse_args()
    numbers = arguments.only or range(arguments.count)
    with ExitStack() as left:
        kept = left.enter_context(open(arguments.out, "a+", encoding="utf-8")) if arguments.out else None
        rows = _known(kept, arguments.seed, numbers)
        known = {row["number"] for row in rows}
        pool = left.enter_context(ProcessPoolExecutor(max_workers=arguments.jobs))
        jobs = [
            pool.submit(judge, arguments.seed, number, arguments.limit) for number in numbers if number not in known
        ]
        for done in as_completed(jobs):
            rows.append(row := done.result())
            print(f"{len(rows)}/{len(numbers)}: {row['number']} {told(row)}", file=sys.stderr, flush=True)
            if kept is not None:
                kept.write(json.dumps({"seed": arguments.seed, **row}) + "\n")
                kept.flush()
    rows.sort(key=lambda row: row["number"])
    print("\n".join(summary(rows)))


def _known(kept: TextIO | None, seed: int, numbers: Sequence[int]) -> list[dict[str, Any]]:
    """Rows of a run that was stopped, from its file; a last line that was cut is none."""
    if kept is None:
        return []
    kept.seek(0)
    lines = [line for line in kept if line.endswith("}\n")]
    return [row for line in lines if (row := json.loads(line))["seed"] == seed and row["number"] in numbers]


if __name__ == "__main__":
    measured(__doc__, judge, summary, lambda row: f"{row['kind']}, {row['class']}", count=300, limit=120.0)
