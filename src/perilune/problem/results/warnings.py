"""Warnings that go with an answer, however well it is proved: `Solution.warnings`.

A proof holds for the problem as it is stated. These warnings name what the statement may have wrong: a free parameter
held by its bound, a flight through the ground of its body, limits that are reached, and quantities that leave the
range which the model is meant for (`Views.meant_for`). Nothing here changes an outcome.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from perilune.core import NUMERIC, Vector, format_quantity
from perilune.problem.display.quantity_names import free_name, limit_name, parameter_key, quantity_name

KNOWN_BETTER = "a flight is known that is better by"  # with which a line of `Statistics.attempts` begins that says so
_AT_BOUND = 1e-7  # of its range: a parameter that is nearer to its bound is on it
_NO_LENGTH = 1e-3  # of a flight: a phase that is bounded to last so long at least may be as good as none
_CONTACT = 1e-6  # of its range along the flight: a condition with less room is reached
_LEFT = 1e-3  # and with more room in between it is reached again; less is the error of a mesh
_ENDS = 0.005  # of a phase at its ends, which conditions there decide
_POINTS, _NEARER, _ROUNDS = 401, 9, 8  # looked at first; then, each time, four times closer about the least
_DEEP = 1e-7  # of the radius, and at least a centimetre: a flight that is less deep touches the ground
_RADII = ("R", "radius", "body_radius", "planet_radius")  # names of a radius where no view gives one
_DISTANCES = ("r", "radius")  # and a state that is the distance from the centre


def warnings_of(solution: Any) -> tuple[str, ...]:
    """Return what should be said with a solution, one sentence each; empty where there is nothing.

    Parameters
    ----------
    solution
        Of any method, with curves that are numbers.
    """
    with np.errstate(all="ignore"):
        looks = (
            _warn_of_model_omissions,
            _warn_of_chattering,
            _warn_of_better_flight,
            _held_parameters,
            _warn_of_ground,
            _warn_of_valid_ranges,
            _warn_of_reached_limits,
        )
        found = [said for look in looks for said in look(solution)]
    return tuple(dict.fromkeys(found))


def _warn_of_model_omissions(solution: Any) -> Iterator[str]:
    """Yield what the model leaves out, as its own comparisons say."""
    problem = solution.problem
    stated = () if problem.preflight is None else problem.preflight(solution.parameters, NUMERIC)
    yield from (finding.meaning for finding in stated if finding.lasting and not finding.passed)


def _warn_of_chattering(solution: Any) -> Iterator[str]:
    """Yield a warning that chattering next to a limit is better: the proof has found that no flight is optimal."""
    for check in solution.verification.failed:
        if check.meaning.endswith("(chattering)"):
            yield f"flights that chatter are better than this one: {check.meaning.rpartition('; ')[2]}"


def _warn_of_better_flight(solution: Any) -> Iterator[str]:
    """Yield a sentence for each better flight that is known: the proved local optimum is dominated."""
    yield from (line for line in solution.statistics.attempts if line.startswith(KNOWN_BETTER))


def _held_parameters(solution: Any) -> Iterator[str]:
    for free in solution.problem.free:
        value, size = solution.free[free.name], max(abs(free.guess), 1e-9)
        both = free.upper - free.lower
        for side, bound in (("lower", free.lower), ("upper", free.upper)):
            near = _AT_BOUND * (both if math.isfinite(both) else max(abs(bound), size))
            if math.isfinite(bound) and abs(value - bound) <= near:
                name, limit = free_name(solution.problem, free.name), format_quantity(bound, free.unit)
                phase = next((x.name for x in solution.problem.phases if x.duration == free.name), None)
                if phase is not None and side == "lower" and 0 <= bound <= _NO_LENGTH * solution.duration:
                    yield f"{name} is at its lower bound of {limit}: the optimal flight has no phase {phase}"
                    continue
                own = parameter_key(solution.problem, free.name) == free.name
                key = _stated_by(solution.problem, bound, free.unit) if own else None
                of = f", {key}" if key else ""
                yield f"{name} is at its {side} bound of {limit}{of}: with a wider one the optimum may be better"


def _stated_by(problem: Any, bound: float, unit: str) -> str | None:
    """Return the key of the file that states a bound of a free parameter: the only one with that value."""
    keys = {parameter_key(problem, name) for name, q in problem.given.items() if (q.value, q.unit) == (bound, unit)}
    found = [key for key in keys if "." in key]
    return found[0] if len(found) == 1 else None


def _warn_of_ground(solution: Any) -> Iterator[str]:
    """Yield a warning if the flight goes below the ground: the body's radius, or its start and end if lower."""
    problem = solution.problem
    heights = _height_along(solution)
    if heights is None:
        return
    called, of, radius = heights
    last = len(problem.phases) - 1
    ends = (0.0, float(of(0, np.zeros(1))[0]), float(of(last, np.array([solution.trajectories[last].duration]))[0]))
    lowest, when, since = math.inf, 0.0, 0.0
    for k, flown in enumerate(solution.trajectories):
        least, at = _least_along(lambda t, k=k: of(k, t), flown.duration)
        lowest, when = min((lowest, when), (least, since + at))
        since += flown.duration
    depth = min(ends) - lowest
    if depth > max(_DEEP * radius, 0.01):
        said = f"{called} {depth / 1e3:.3g} km below the ground at {when:.4g} s"
        yield f"{said}: a path condition would keep it above"


def _height_along(solution: Any) -> tuple[str, Callable[[int, Vector], Vector], float] | None:
    """Return (description of a low flight, height [m] of a phase k at times, body's radius [m]); None without these."""
    problem, p = solution.problem, solution.parameters
    seen = problem.views.height or any(phase.inertial is not None for phase in problem.phases)
    if not (problem.views.radius and seen):
        return _guessed_heights(solution)
    name, radius = problem.views.height, float(getattr(p, problem.views.radius))

    def of(k: int, t: Vector) -> Vector:
        phase = problem.phases[k]
        if name in (v.name for v in phase.output_variables):
            return solution.outputs(k, t)[name]
        x, u = solution.evaluate(k, t)
        if name in (*phase.state_names, *phase.control_names):
            return np.vstack([x, u])[[*phase.state_names, *phase.control_names].index(name)]
        if phase.inertial is None:
            return np.full(np.shape(t), math.inf)
        return np.linalg.norm(solution.inertial(k, t)[0], axis=0) - radius

    return "the flight goes", of, radius


def _guessed_heights(solution: Any) -> tuple[str, Callable[[int, Vector], Vector], float] | None:
    """Return the same from names where no view gives them: a distance r from a centre, and a radius R."""
    problem = solution.problem
    radii = [name for name in _RADII if name in problem.given and problem.given[name].unit == "m"]
    names = [s.name for s in problem.phases[0].states if s.name in _DISTANCES and s.unit == "m"]
    if not radii or not names or any(names[0] not in phase.state_names for phase in problem.phases):
        return None
    radius = problem.given[radii[0]].value

    def of(k: int, t: Vector) -> Vector:
        return solution.evaluate(k, t)[0][problem.phases[k].state_names.index(names[0])] - radius

    return f"if {radii[0]} is the radius of the body, the flight goes", of, radius


def _warn_of_valid_ranges(solution: Any) -> Iterator[str]:
    """Yield a sentence for each quantity beyond the range that the model is meant for."""
    problem = solution.problem
    for meant in problem.views.meant_for:
        name, worst = meant.quantity, 0.0
        reached, unit = math.nan, "1"
        for k, phase in enumerate(problem.phases):
            if meant.phases and phase.name not in meant.phases:
                continue
            known = {v.name: v for v in (*phase.states, *phase.output_variables)}
            if name not in known:
                continue

            def of(t: Vector, sign: float, k: int = k, name: str = name) -> Vector:
                names = problem.phases[k].state_names
                values = (
                    solution.evaluate(k, t)[0][names.index(name)] if name in names else solution.outputs(k, t)[name]
                )
                return sign * values

            unit, duration = known[name].unit, solution.trajectories[k].duration
            for sign, limit in ((1.0, meant.lower), (-1.0, -meant.upper)):
                least, _ = _least_along(lambda t, sign=sign: of(t, sign), duration)
                if limit - least > max(worst, 1e-9 * abs(limit)):
                    worst, reached = limit - least, sign * least
        if worst > 0:
            said = meant.title or name.replace("_", " ")
            value = format_quantity(reached, unit, 3)
            yield f"{said} reaches {value}, outside the validity of the model: {meant.because}"


def _warn_of_reached_limits(solution: Any) -> Iterator[str]:
    """Yield a sentence for each limit that the flight reaches: of the path, of states and of ends."""
    problem, p, since = solution.problem, solution.parameters, 0.0
    for k, (phase, flown) in enumerate(zip(problem.phases, solution.trajectories, strict=True)):
        t = np.linspace(_ENDS, 1.0 - _ENDS, _POINTS) * flown.duration
        x, u = solution.evaluate(k, t)
        rows = [(quantity_name(c), v, _room_of(solution, k, i)) for i, (c, v) in enumerate(phase.path_along(x, u, p))]
        for name, values, of in rows:
            yield from _warn_of_contact(name, t, values, of, since)
        for j, state in enumerate(phase.states):
            for side, sign, bound in zip(("lower", "upper"), (1.0, -1.0), state.limits(p), strict=True):
                last = sign * (float(flown.state.values[-1][j]) - bound)
                if isinstance(getattr(state, side), str) and last <= _CONTACT * float(np.ptp(x[j])):
                    yield f"{limit_name(problem, state, side)} of {format_quantity(bound, state.unit)} is reached"
        yield from _ends_reached(solution, k)
        since += flown.duration


def _ends_reached(solution: Any, k: int) -> Iterator[str]:
    problem, p, phase = solution.problem, solution.parameters, solution.problem.phases[k]
    values = phase.evaluate("end", solution.trajectories[k].state.values[-1], (), p)
    for condition, value in zip(phase.end_conditions, values, strict=True):
        limits = condition.limits(p)
        for side, bound in zip(("lower", "upper"), limits, strict=True):
            wide = limits[1] - limits[0] if np.isfinite(limits).all() else abs(bound)
            if condition.ranged and np.isfinite(bound) and abs(float(value) - bound) <= _CONTACT * max(wide, 1e-9):
                yield f"{limit_name(problem, condition, side)} of {format_quantity(bound, condition.unit)} is reached"


def _room_of(solution: Any, k: int, i: int) -> Callable[[Vector], Vector]:
    """Return a condition of the path at any times of a phase."""

    def of(t: Vector) -> Vector:
        x, u = solution.evaluate(k, t)
        return [v for _, v in solution.problem.phases[k].path_along(x, u, solution.parameters)][i]

    return of


def _warn_of_contact(
    name: str, t: Vector, values: Vector, of: Callable[[Vector], Vector], since: float
) -> Iterator[str]:
    """Yield the sentence for a condition that has no room left away from the ends of its phase."""
    reach, i = float(np.ptp(values)), int(np.argmin(values))
    if not reach > 0 or i in (0, len(t) - 1):
        if reach > 0 and np.count_nonzero(values <= _CONTACT * reach) > 1:
            i = 1
        else:
            return
    low, high = float(t[max(i - 1, 0)]), float(t[min(i + 1, len(t) - 1)])
    least, when = _least_along(lambda s: of(low + s), high - low, _NEARER)
    on = np.flatnonzero(values <= _CONTACT * reach)
    if len(on) > 1:
        between = [values[a : b + 1].max() for a, b in itertools.pairwise(on)]
        rides = np.split(on, np.flatnonzero(np.array(between) > _LEFT * reach) + 1)
        yield f"{name} is at its limit {' and '.join(_format_instants(since + t[ride[[0, -1]]]) for ride in rides)}"
    elif least <= _CONTACT * reach:
        yield f"{name} is at its limit {_format_instants(np.full(2, since + low + when))}"


def _format_instants(ends: Vector) -> str:
    """Format instants: the first and the last, which may be one."""
    first, last = ends
    return f"at {first:.4g} s" if first == last else f"between {first:.4g} and {last:.4g} s"


def _least_along(of: Callable[[Vector], Vector], duration: float, first: int = _POINTS) -> tuple[float, float]:
    """Return the least value of a quantity along a duration, and the time at which it is taken [s]."""
    low, high, least, when = 0.0, duration, math.inf, 0.0
    for count in (first, *(_NEARER,) * _ROUNDS):
        t = np.linspace(low, high, count)
        values = np.asarray(of(t), dtype=float)
        i = int(np.argmin(values))
        if values[i] < least:
            least, when = float(values[i]), float(t[i])
        low, high = float(t[max(i - 1, 0)]), float(t[min(i + 1, count - 1)])
    return least, when
