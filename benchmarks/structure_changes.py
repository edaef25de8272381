"""Points at which a limit is only just reached: the multiplier of a condition goes through zero, the structure changes.

Drawn on purpose. Of most sorts the change is read off the flight without the limit, which is the answer up to it: the
flattest elevation seen from the site (`slope`), the largest tilt of the thrust (`tilt`), the landed mass (`dry_mass`),
the length of the free fall before ignition (`coast`), speed and path angle at the interface (`interface`), the largest
load (`load`). Of others a sweep is bisected until the structure changes between neighbours: how often the throttle
switches (`throttle`), what of a glide slope is touched or flown along (`arcs`), whether there is a free fall at all
(`coast` too). There, and at a drawn distance of 1e-12 to 1e-3 of it on both sides, the problem is solved without a
guess and proved:

    python benchmarks/structure_changes.py [--count 300] [--seed 41] [--jobs 1] [--limit 60] [--only 17] [--out FILE]

``--limit`` is the processor time [s] of one solution, ``--only`` draws these points alone. The draw depends on the seed
alone. J on the open side of a limit is compared with that without it, on the closed side is no better, and beside the
point is near that at the point.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from perilune.core import PeriluneError
from perilune.models import MARS, Approach, Corridor, Site, UniformGravity, precision_landing
from perilune.problem import Problem, Solution
from perilune.scenario import load_file
from perilune.solve import solve
from random_problems import AIRLESS, PROVED, OutOfTime, at_most, ending, logarithmic, measured, surface_gravity, vehicle

CAPSULE = Path(__file__).parent.parent / "examples" / "maps" / "capsule.toml"
NEAREST, FARTHEST = 1e-12, 1e-3  # relative: the distances between which one is drawn
DRAWS = 60  # of one point, until the flight without the limit has one
SAME = 1e-8  # of J: what does not matter
STEEPEST = 100.0  # by how much more than the parameter J changes at most, both relative


@dataclass(frozen=True, kw_only=True)
class Change:
    """A point of change.

    Parameters
    ----------
    value
        Of the parameter that is moved, SI.
    problem_at
        The problem at a value of it.
    open_side
        Sign of the direction in which the limit binds no longer; 0 where neither does.
    objective
        J without the limit; NaN where there is none.
    words
        The drawn problem.
    """

    value: float
    problem_at: Callable[[float], Problem]
    open_side: int
    objective: float
    words: str


def landing(
    rng: np.random.Generator, *, dry_mass: bool = False, **changes: Any
) -> tuple[Callable[..., Problem], dict[str, Any]]:
    """A precision landing without limits, as a function of what is changed, and its drawn approach."""
    over_flat = rng.random() < 0.3
    body = UniformGravity(gravity=logarithmic(rng, 0.5, 9.81)) if over_flat else (*AIRLESS, MARS)[rng.integers(5)]
    g = body.gravity if isinstance(body, UniformGravity) else surface_gravity(body)
    up = logarithmic(rng, 300.0, 4000.0)
    fall, away, bearing = math.sqrt(2 * g * up), up * rng.uniform(0.3, 2.5), rng.uniform(0.0, 2 * math.pi)
    site = None if over_flat else Site(altitude=0.0, longitude=0.0, latitude=rng.uniform(-1.4, 1.4))
    lander = replace(vehicle(rng, g * rng.uniform(1.7, 4.5), fall), dry_mass=None)
    throttle = (rng.uniform(0.05, 0.5), rng.uniform(0.75, 1.0))
    stated: dict[str, Any] = {
        "east": away * math.cos(bearing), "north": away * math.sin(bearing), "up": up,
        "east_speed": fall * rng.uniform(-0.5, 0.5), "north_speed": fall * rng.uniform(-0.5, 0.5),
        "up_speed": -fall * rng.uniform(0.0, 0.7),
    }  # fmt: skip

    def problem(
        corridor: Corridor | None = None, dry: float | None = None, floor: float = throttle[0], **others: Any
    ) -> Problem:
        return precision_landing(
            replace(lander, dry_mass=dry), Approach(**{**stated, **others}), site, corridor or Corridor(),
            (floor, throttle[1]), body,
        )  # fmt: skip

    return problem, stated


def best(problem: Problem) -> Solution | None:
    """The proved answer, or None."""
    try:
        found = solve(problem)
    except PeriluneError:
        return None
    return found if found.verification.level == 3 else None


def near(problem: Problem, known: Solution | None) -> Solution | None:
    """An extremal, first from a known one close by; None where there seems to be none."""
    level = 1 if any(phase.path_conditions for phase in problem.phases) else 0  # whether it keeps those it is to say
    for guess in (known, None) if known is not None else (None,):
        try:
            found = solve(problem, guess=guess, verify=level)
        except PeriluneError:
            continue
        if level == 0 or found.verification.level == level:
            return found
    return None


def _along(solution: Solution, value: Callable[[Any, Any], Any], *, ends: bool) -> tuple[float, float] | None:
    """Where a value of states and controls is least in the last phase, as a share of it, and the least value.

    None where it is least at an end of the phase and `ends` is not asked for.
    """
    k = len(solution.trajectories) - 1
    length = solution.trajectories[k].duration

    def at(share: float) -> float:
        x, u = solution.evaluate(k, np.array([share * length]))
        return float(np.asarray(value(x[:, 0], u[:, 0])))

    shares = np.linspace(0.0, 1.0, 2001)
    x, u = solution.evaluate(k, shares * length)
    with np.errstate(all="ignore"):
        values = np.array([value(x[:, i], u[:, i]) for i in range(len(shares))])
    values[~np.isfinite(values)] = np.inf
    i = int(np.argmin(values))
    if not ends and not 20 <= i <= 1980:
        return None
    around = (shares[max(i - 1, 0)], shares[min(i + 1, 2000)])
    finer: Any = minimize_scalar(at, bounds=around, method="bounded", options={"xatol": 1e-12})
    if finer.fun <= values[i]:
        return float(finer.x), float(finer.fun)
    return float(shares[i]), float(values[i])


def slope(rng: np.random.Generator) -> Change | None:
    """The flattest elevation of the site."""
    problem, _ = landing(rng)
    pad = logarithmic(rng, 1.0, 20.0)
    free = best(problem())
    if free is None:
        return None
    found = _along(free, lambda x, u: x[2] / (math.sqrt(x[0] ** 2 + x[1] ** 2 + pad**2) - pad), ends=False)
    if found is None or not 0.02 < found[1] < 3.0:
        return None
    return Change(
        value=math.atan(found[1]), open_side=-1, objective=free.objective, words=free.problem.title,
        problem_at=lambda value: problem(Corridor(slope=value, pad_radius=pad)),
    )  # fmt: skip


def tilt(rng: np.random.Generator) -> Change | None:
    """The largest tilt of the thrust."""
    problem, _ = landing(rng)
    free = best(problem())
    if free is None:
        return None
    names = free.problem.phases[-1].control_names
    up = names.index("toward_up")
    found = _along(free, lambda x, u: u[up], ends=True)
    if found is None or not 0.05 < found[1] < 0.995:
        return None
    return Change(
        value=math.acos(found[1]), open_side=1, objective=free.objective, words=free.problem.title,
        problem_at=lambda value: problem(Corridor(tilt=value)),
    )  # fmt: skip


def dry_mass(rng: np.random.Generator) -> Change | None:
    """The landed mass: beyond it nothing can be flown."""
    problem, _ = landing(rng)
    free = best(problem())
    if free is None:
        return None
    return Change(
        value=-free.objective, open_side=-1, objective=free.objective, words=free.problem.title,
        problem_at=lambda value: problem(dry=value),
    )  # fmt: skip


def coast(rng: np.random.Generator) -> Change | None:
    """The length of the free fall before ignition, which is chosen; or the approach from which there is one."""
    problem, stated = landing(rng)
    longest = 10 * stated["up"] / abs(stated["up_speed"] - 1.0)
    if rng.random() < 0.3:
        along = ("up_speed", "up", "east", "north")[rng.integers(4)]
        low, high = sorted(stated[along] * factor for factor in (0.1, 3.0))
        return _bisected(lambda value: problem(longest_coast=longest, **{along: value}), low, high, falls, along)
    free = best(problem(longest_coast=longest))
    if free is None or free.free["coast_time"] < 0.5:
        return None
    return Change(
        value=free.free["coast_time"], open_side=1, objective=free.objective, words=free.problem.title,
        problem_at=lambda value: problem(longest_coast=value),
    )  # fmt: skip


def throttle(rng: np.random.Generator) -> Change | None:
    """Where the throttle switches once more or less often, along the speed of approach, its height or the floor."""
    problem, stated = landing(rng)
    along = ("up_speed", "up", "floor")[rng.integers(3)]
    low, high = (0.02, 0.7) if along == "floor" else sorted(stated[along] * factor for factor in (0.5, 2.0))
    return _bisected(lambda value: problem(**{along: value}), low, high, switches, along)


def arcs(rng: np.random.Generator) -> Change | None:
    """Where a glide slope is touched once more, or flown along, as it rises."""
    problem, stated = landing(rng)
    pad = logarithmic(rng, 1.0, 20.0)
    start = math.atan(stated["up"] / (math.hypot(stated["east"], stated["north"], pad) - pad))

    def at(value: float) -> Problem:
        return problem(Corridor(slope=value, pad_radius=pad))

    return _bisected(at, 0.3 * start, 0.98 * start, contacts, "slope")


def switches(solution: Solution) -> str:
    """At which bounds the throttle is, one after the other, of all phases."""
    found = ""
    for k, flown in enumerate(solution.trajectories):
        names = solution.problem.phases[k].control_names
        if "throttle" in names:
            throttle = flown.control.values[:, names.index("throttle")]  # a jump has a node on either side
            high = throttle > 0.5 * (throttle.min() + throttle.max())
            found += "".join("-+"[int(high[i])] for i in (0, *(np.nonzero(high[1:] != high[:-1])[0] + 1)))
            found += "" if np.ptp(throttle) > 1e-6 else " all along"
    return found


def falls(solution: Solution) -> str:
    """Return True if it falls before ignition."""
    shortest = next(free.lower for free in solution.problem.free if free.name == "coast_time")
    return "a fall" if solution.free["coast_time"] > 2 * shortest else "none"


def contacts(solution: Solution) -> str:
    """What is touched and flown along, one after the other, without the times."""
    return ", ".join(arc.description for arc in solution.structure)


def _bisected(
    problem_at: Callable[[float], Problem], low: float, high: float, read: Callable[[Solution], str], along: str
) -> Change | None:
    """The first change between values, of a sweep of three."""
    known = list[tuple[float, Solution, str]]()
    for value in (low, 0.5 * (low + high), high):
        if (found := near(problem_at(value), None)) is not None:
            known.append((value, found, read(found)))
    pair = next(((a, b) for a, b in pairwise(known) if a[2] != b[2]), None)
    if pair is None:
        return None
    (low, nearest, before), (high, _, after) = pair
    while abs(high - low) > NEAREST * abs(low) and (middle := 0.5 * (low + high)) not in (low, high):
        found = near(problem_at(middle), nearest)
        if found is None:  # this is such a point, too
            high = middle
            break
        low, high = (middle, high) if read(found) == before else (low, middle)
        nearest = found
    return Change(
        value=high, problem_at=problem_at, open_side=0, objective=math.nan,
        words=f"{nearest.problem.title} along {along} from {before!r} to {after!r}",
    )  # fmt: skip


def capsule(rng: np.random.Generator, *limits: str) -> Problem:
    """A return of the example's capsule, of a drawn drag and thrust, from a drawn point of ignition."""
    drag, thrust, mass = logarithmic(rng, 200.0, 600.0), rng.uniform(2500.0, 4500.0), rng.uniform(6600.0, 7400.0)
    given = (
        f"vehicle.ballistic_coefficient={drag:.17g} kg/m^2", f"vehicle.thrust={thrust:.17g} N",
        f"vehicle.mass={mass:.17g} kg", f"manoeuvre.longitude={rng.uniform(43.0, 48.0):.17g} deg",
        f"manoeuvre.latitude={rng.uniform(49.8, 50.4):.17g} deg",
    )  # fmt: skip
    return load_file(CAPSULE, (*given, *limits)).problem


def interface(rng: np.random.Generator) -> Change | None:
    """The speed or path angle at the interface that the best return has, where it may be any."""
    name, side = ("angle", "speed")[rng.integers(2)], ("lower", "upper")[rng.integers(2)]
    loose = {"speed": ("interface.speed_lower=7 km/s", "interface.speed_upper=9 km/s")}.get(name, ())
    problem = capsule(rng, "interface.angle_lower=-4 deg", "interface.angle_upper=-0.6 deg", *loose)
    free = best(problem)
    if free is None:
        return None
    reached, bound = free.results[f"interface_{name}"].value, f"interface_{name}_{side}"
    if name == "angle" and not -3.9 < math.degrees(reached) < -0.7:
        return None
    sign = 1 if side == "upper" else -1
    return Change(
        value=reached, open_side=sign, objective=free.objective, words=f"{problem.title} {bound}",
        problem_at=lambda value: problem.with_given(**{bound: value}),
    )  # fmt: skip


def load(rng: np.random.Generator) -> Change | None:
    """The largest load of the best return."""
    problem = capsule(rng, "limits.load=1000 g0")
    free = best(problem)
    if free is None:
        return None
    return Change(
        value=free.results["peak_load"].value * problem.given["standard_gravity"].value, open_side=1,
        objective=free.objective, words=problem.title,
        problem_at=lambda value: problem.with_given(limits_load=value),
    )  # fmt: skip


SORTS: dict[str, Callable[[np.random.Generator], Change | None]] = {
    "slope": slope,
    "tilt": tilt,
    "dry_mass": dry_mass,
    "coast": coast,
    "throttle": throttle,
    "arcs": arcs,
    "interface": interface,
    "load": load,
}
# In turns: the bisected ones and the returns cost more than the others.
TURNS = (
    "slope", "tilt", "dry_mass", "coast", "throttle", "slope", "tilt", "dry_mass", "coast", "arcs",
    "slope", "tilt", "dry_mass", "coast", "throttle", "slope", "load", "interface", "throttle", "slope",
)  # fmt: skip


def judge(seed: int, number: int, limit: float) -> dict[str, Any]:
    """Draw one point of change, and solve at it and beside it."""
    sort = TURNS[number % len(TURNS)]
    rng = np.random.default_rng([seed, number])
    wall, cpu = time.perf_counter(), time.process_time()
    change = next((found for _ in range(DRAWS) if (found := SORTS[sort](rng)) is not None), None)
    row: dict[str, Any] = {"number": number, "sort": sort}
    if change is None:
        return row | {"class": "not drawn", "solved": [], "words": ""}
    size = logarithmic(rng, NEAREST, FARTHEST)
    row |= {"words": change.words, "value": change.value, "drawn": time.process_time() - cpu}
    solved = [{"offset": offset, **_ending_at(change, offset, limit)} for offset in (0.0, size, -size)]
    for one in solved[1:]:
        if "objective" in one and "objective" in solved[0] and one["class"] != "off":
            jump = abs(one["objective"] - solved[0]["objective"]) / abs(solved[0]["objective"])
            if jump > SAME + STEEPEST * size:
                one |= {"class": "off", "why": f"J differs by {jump:.3g} of it from that at the point"}
    classes = [one["class"] for one in solved]
    row |= {"solved": solved, "class": next((c for c in ("failed", "off", "refused") if c in classes), min(classes))}
    return row | {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}


def _ending_at(change: Change, offset: float, limit: float) -> dict[str, Any]:
    """How the default call ends beside a point of change."""
    began, row = time.process_time(), dict[str, Any]()
    try:
        with at_most(limit):
            row = ending(change.problem_at(change.value * (1.0 + offset)))
    except OutOfTime:
        row = {"class": "failed", "why": f"not finished after {limit:g} s"}
    except Exception as error:  # what is no word of ours is what this looks for
        row = {"class": "failed", "why": f"{type(error).__name__}: {error}"}
    inside = offset * np.sign(change.value) * change.open_side
    if change.open_side and "objective" in row:
        lost = (float(row["objective"]) - change.objective) / abs(change.objective)
        if lost < -SAME or (inside > 0 and lost > SAME):
            row |= {"class": "off", "why": f"J is {lost:.3g} of it above that without the limit"}
    row.pop("feasible", None)
    return row | {"cpu": time.process_time() - began}


def _honest(row: dict[str, Any], one: dict[str, Any]) -> bool:
    """Whether an ending is one that is asked for: answered, or refused where nothing can be flown."""
    beyond = row["sort"] == "dry_mass" and one["offset"] >= 0.0
    return one["class"] not in ("failed", "off", "refused") or (beyond and one["class"] == "refused")


def summary(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Each ending that is no answer, and the counts."""
    for row in rows:
        for one in row["solved"]:
            if not _honest(row, one) or one["class"] == "level 0":
                at = f"{row['value']:.17g} x (1 {one['offset']:+.17g})"
                yield f"{row['number']:4d} {row['sort']} {at}, {one['class']}: {one['why'][:200]} [{row['words']}]"
    for sort in SORTS:
        here = [row for row in rows if row["sort"] == sort and row["solved"]]
        ends = Counter(one["class"] for row in here for one in row["solved"])
        whole = sum(all(_honest(row, one) for one in row["solved"]) for row in here)
        yield f"{sort}: {whole} of {len(here)} points answered all around; {dict(sorted(ends.items()))}"
    drawn = [row for row in rows if row["solved"]]
    ends = [one for row in drawn for one in row["solved"]]
    whole = sum(all(_honest(row, one) for one in row["solved"]) for row in drawn)
    proved = sum(one["class"] == PROVED for one in ends)
    yield f"{whole} of {len(drawn)} points answered all around; {proved} of {len(ends)} solutions {PROVED}"
    cpu = np.array([one["cpu"] for one in ends] or [math.nan])
    parts = f"median {np.median(cpu):.1f} s, 99 % within {np.percentile(cpu, 99):.1f} s, longest {cpu.max():.1f} s"
    yield f"processor of each: {parts}"


if __name__ == "__main__":
    measured(__doc__, judge, summary, lambda row: f"{row['sort']}, {row['class']}", count=300, limit=60.0)
