"""Points at which a limit is only just reached: the multiplier of a condition goes through zero, the structure changes.

Drawn on purpose. Of most sorts the change is read off the flight without the limit, which is the answer up to it: the
flattest elevation seen from the site (`slope`), the largest tilt of the thrust (`tilt`), the landed mass (`dry_mass`),
the length of the free fall before ignition (`coast`), the path angle at the interface (`interface`), the largest load
(`load`). Of others a sweep is bisected until the structure changes between neighbours: how often the throttle switches
(`throttle`), what of a glide slope is touched or flown along (`arcs`). There, and from 1e-12 to 1e-3 of it beside it on
both sides, the problem is solved without a guess and proved:

    python benchmarks/structure_changes.py [--count 300] [--seed 41] [--jobs 1] [--limit 60] [--only 17] [--out FILE]

``--limit`` is the processor time [s] of one solution, ``--only`` draws these points alone. The draw depends on the seed
alone. J on the open side of a limit is compared with that without it, and on the closed side is no better.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from perilune.models.bodies import MARS, UniformGravity
from perilune.models.descent import Site
from perilune.models.precision import Approach, Corridor, precision_landing
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution
from perilune.solve import solve
from perilune.words.outcome import PeriluneError
from random_problems import AIRLESS, PROVED, OutOfTime, at_most, ending, logarithmic, measured, surface_gravity, vehicle
from random_returns import draw as drawn_return

OFFSETS = (0.0, *(sign * size for size in (1e-3, 1e-6, 1e-9, 1e-12) for sign in (1.0, -1.0)))  # relative
DRAWS = 60  # of one point, until the flight without the limit has one
SAME = 1e-8  # of J: what does not matter
CLOSE = 1e-12  # of a value: so far a sweep is bisected


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
        with at_most(60.0):
            found = solve(problem)
    except (PeriluneError, OutOfTime):
        return None
    return found if found.verification.level == 3 else None


def _along(solution: Solution, value: Callable[[Any, Any], Any], *, ends: bool) -> tuple[float, float] | None:
    """Where a value of states and controls is least in the last phase, as a share of it, and the least value.

    None where it is least at an end of the phase and `ends` is not asked for.
    """
    k = len(solution.trajectories) - 1
    length = solution.trajectories[k].duration

    def at(share: float) -> float:
        x, u = solution.flown(k, np.array([share * length]))
        return float(np.asarray(value(x[:, 0], u[:, 0])))

    shares = np.linspace(0.0, 1.0, 2001)
    x, u = solution.flown(k, shares * length)
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
    """The length of the free fall before ignition, which is chosen."""
    problem, stated = landing(rng)
    free = best(problem(longest_coast=10 * stated["up"] / abs(stated["up_speed"] - 1.0)))
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
    return _bisected(lambda value: problem(**{along: value}), low, high, switches, f"along {along}")


def arcs(rng: np.random.Generator) -> Change | None:
    """Where a glide slope is touched once more, or flown along, as it rises."""
    problem, stated = landing(rng)
    pad = logarithmic(rng, 1.0, 20.0)
    start = math.atan(stated["up"] / (math.hypot(stated["east"], stated["north"], pad) - pad))

    def at(value: float) -> Problem:
        return problem(Corridor(slope=value, pad_radius=pad))

    return _bisected(at, 0.3 * start, 0.98 * start, contacts, "along slope")


def switches(solution: Solution) -> str:
    """At which bounds the throttle is, one after the other, of all phases."""
    found = ""
    for k, flown in enumerate(solution.trajectories):
        names = solution.problem.phases[k].control_names
        if "throttle" in names:
            _, u = solution.flown(k, np.linspace(0.0, 1.0, 100_001) * flown.duration)
            throttle = u[names.index("throttle")]
            high = throttle > 0.5 * (throttle.min() + throttle.max())
            found += "".join("-+"[int(high[i])] for i in (0, *(np.nonzero(high[1:] != high[:-1])[0] + 1)))
            found += "" if np.ptp(throttle) > 1e-6 else " all along"
    return found


def contacts(solution: Solution) -> str:
    """What is touched and flown along, one after the other, without the times."""
    return ", ".join(arc.words for arc in solution.structure)


def _bisected(
    problem_at: Callable[[float], Problem], low: float, high: float, read: Callable[[Solution], str], words: str
) -> Change | None:
    """The first change between values, of a sweep of five."""
    known = list[tuple[float, str]]()
    for value in np.linspace(low, high, 5).tolist():
        if (found := best(problem_at(value))) is not None:
            known.append((value, read(found)))
            title = found.problem.title
    pair = next(((a, b) for a, b in pairwise(known) if a[1] != b[1]), None)
    if pair is None:
        return None
    (low, before), (high, after) = pair
    for _ in range(45):
        if high - low <= CLOSE * abs(low):
            break
        middle = 0.5 * (low + high)
        found = best(problem_at(middle))
        if found is None:  # this is such a point, too
            words = f"{title} {words}"
            return Change(value=middle, problem_at=problem_at, open_side=0, objective=math.nan, words=words)
        low, high = (middle, high) if read(found) == before else (low, middle)
    return Change(
        value=high, problem_at=problem_at, open_side=0, objective=math.nan,
        words=f"{title} {words} from {before!r} to {after!r}",
    )  # fmt: skip


def interface(rng: np.random.Generator) -> Change | None:
    """The path angle at the interface that the best return has, where it may be any."""
    problem = drawn_return(int(rng.integers(1000)), 4 * int(rng.integers(50)) + int(rng.integers(4))).problem
    if "interface_angle_upper" not in problem.given:
        return None
    free = best(problem.with_given(interface_angle_upper=math.radians(-0.5)))
    if free is None:
        return None
    angle = free.results["interface_angle"].value
    if not -3.4 < math.degrees(angle) < -0.55:
        return None
    return Change(
        value=angle, open_side=1, objective=free.objective, words=problem.title,
        problem_at=lambda value: problem.with_given(interface_angle_upper=value),
    )  # fmt: skip


SORTS: dict[str, Callable[[np.random.Generator], Change | None]] = {
    "slope": slope,
    "tilt": tilt,
    "dry_mass": dry_mass,
    "coast": coast,
    "throttle": throttle,
    "arcs": arcs,
    "interface": interface,
}
# In turns: the bisected ones and the returns cost ten times as much as the others.
TURNS = (
    "slope", "tilt", "dry_mass", "coast", "throttle", "slope", "tilt", "dry_mass", "coast", "arcs",
    "slope", "tilt", "dry_mass", "coast", "throttle", "slope", "tilt", "dry_mass", "coast", "interface",
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
    row |= {"words": change.words, "value": change.value, "drawn": time.process_time() - cpu, "solved": []}
    for offset in OFFSETS:
        row["solved"].append({"offset": offset, **_ending_at(change, offset, limit)})
    classes = [one["class"] for one in row["solved"]]
    row["class"] = next((c for c in ("failed", "off", "refused") if c in classes), min(classes))
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
                yield (
                    f"{row['number']:4d} {row['sort']} {row['value']:.17g} x (1 {one['offset']:+.0e}), {one['class']}: "
                    f"{one['why'][:200]} [{row['words']}]"
                )
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
