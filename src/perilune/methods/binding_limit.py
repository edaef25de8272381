"""Infeasibility diagnosis: the limit that no flight found can keep, and the least relaxation it needs.

A least-squares miss spreads over whatever is held loosely, and so blames the wrong condition: a glide slope for a dry
mass. Here each limit is relaxed by itself (`perilune.direct.elastic_constraint`), from the flight that missed least;
those whose relaxation lets all else be kept stand in the way, and the one that gives least, by its own size, is named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

from perilune.core import NotConvergedError, PeriluneError, Vector, Watch, format_bound, format_quantity, ignore_events
from perilune.direct import ElasticLimit, elastic_limits
from perilune.methods.direct.pseudospectral import Pseudospectral
from perilune.problem import Problem, Solution, limit_name, only_in_path, parameter_key, quantity_name
from perilune.structures import AT_END, with_budgets

_MOST = 320  # iterations of all limits together, of a problem of one phase; no seconds, so that it says the same again
_PATIENT = 40  # iterations of each; what ends well takes 10 to 30
_FINER = (16, 32)  # segments of the meshes on which the one that gives least is looked at again
_LARGEST = 10.0  # of its own size: what has to give by more is not said to be in the way
_LISTED = 4  # limits of which a message says by how much they would have to give
_DIGITS = 3  # of what would do, rounded so that it does
_SHARE = 1e-3  # of the largest: end conditions that give by less are as good as satisfied
_LOOKS = 200  # times of a phase
_OVERSHOT = 1.001  # of what a condition gives: what is broken by more, between nodes, is the mesh's
_STEPS = (0.01, 10.0, 60)  # of a parameter, relative: the first, the largest, and how many
_KEPT = 1e-9  # canonical: a condition that is broken by less is kept
_SETTLED = 0.3  # of what a limit gives: by how much a finer mesh may change it


class Relaxed(NamedTuple):
    """A limit, by how much it gives [SI], that by its own size, the flight that keeps all else, and its doubt.

    That is by how much [SI] meshes differ about what gives.
    """

    limit: ElasticLimit
    amount: float
    share: float
    flight: Solution
    doubt: float = np.inf


class LimitReport(NamedTuple):
    """The texts of a limit: its name, by how much it is missed, with what all else can be kept, and what was stated.

    `possible` is False where what would be enough may not be stated: a throttle of 1.4 may not.
    """

    name: str
    much: str
    enough: str
    stated: str
    possible: bool = True


def with_binding_limit(problem: Problem, error: NotConvergedError, watch: Watch | None = None) -> NotConvergedError:
    """Return an error that names the limits which stand in the way, if the flight that it holds shows them.

    Parameters
    ----------
    problem
        What was not solved.
    error
        Why, with the flight that misses least and what it misses, else it is returned as it is.
    watch
        Receives a line.
    """
    if error.flight is None or not error.partial.get("violations") or not error.partial.get("converged", True):
        return error  # what is no least miss says nothing of a limit
    watch = watch or ignore_events
    watch("looking for the limit that prevents a flight")
    try:
        found = sorted(_relax_each_limit(problem, error.flight, watch), key=lambda one: one.share)
    except (PeriluneError, ArithmeticError):  # what cannot be traced with a limit relaxed
        return error
    if not found:
        return error
    best, *others = [_on_finer_meshes(one) for one in found[:_LISTED]]
    if not best.doubt <= _SETTLED * best.amount:
        return error  # meshes do not agree that anything is in the way
    return _name_limits(problem, error, [best, *(one for one in others if one.doubt <= _SETTLED * one.amount)])


def _relax_each_limit(problem: Problem, nearest: Solution, watch: Watch) -> Iterator[Relaxed]:
    """Yield flights with one limit relaxed each; ends only where no other limit helps."""
    left, found = _MOST // len(problem.phases), 0
    # What is used up binds where a phase ends, and no point of a mesh lies there.
    ended = with_budgets(problem, linear=True)
    for limit in elastic_limits(problem):
        if left <= 0 or (limit.kind == "end" and found):
            return
        said = [f"{name}{AT_END}" for name in limit.names]
        relaxed = limit.relaxed(problem if limit.kind == "state" else ended, said)
        size = problem.size_of(limit.bounded)
        values = {**nearest.free, **dict.fromkeys(limit.slack_names, 0.1 * size)}
        guess = replace(nearest, problem=relaxed, free=values, multipliers={})
        try:
            flight = Pseudospectral(nodes=5, segments=8, refine=0, iterations=_PATIENT).near(guess, watch)
        except PeriluneError:
            left -= _PATIENT
            continue
        left -= flight.statistics.iterations
        one = Relaxed(limit, flight.objective, flight.objective / _limit_magnitude(problem, limit, flight), flight)
        if one.share < _LARGEST:
            found += 1
            yield one


def _on_finer_meshes(one: Relaxed) -> Relaxed:
    """Solve again on finer meshes; return the relaxed limit with its doubt: how much the last one changed it."""
    for segments in _FINER[: 2 if len(one.flight.trajectories) == 1 else 1]:
        method = Pseudospectral(nodes=5, segments=segments, refine=0, iterations=_PATIENT)
        try:
            flight = method.near(one.flight)
        except PeriluneError:  # and a mesh that is finer still begins from no better flight
            break
        doubt = abs(flight.objective - one.amount)
        one = one._replace(amount=flight.objective, flight=flight, doubt=doubt)
    return one


def _limit_magnitude(problem: Problem, limit: ElasticLimit, flight: Solution) -> float:
    """Return the size of what is limited [SI]: its range along the flight, or the range of a control."""
    if limit.kind in ("control", "free"):
        lower, upper = _bounds(limit, flight.parameters)
        return upper - lower if np.isfinite(upper - lower) else abs(lower if limit.side == "lower" else upper)
    least = 1e-3 * problem.size_of(limit.bounded)
    if limit.kind == "end":
        return 1e3 * least
    return max([least, *(float(np.ptp(along)) for along in _limited_values(problem, limit, flight, flight.parameters))])


def _bounds(limit: ElasticLimit, p: Any) -> tuple[float, float]:
    """Return the bounds [SI] of what is limited."""
    bounded = limit.bounded
    return (bounded.lower, bounded.upper) if limit.kind == "free" else bounded.limits(p)


def _limited_values(problem: Problem, limit: ElasticLimit, flight: Solution, p: Any) -> Iterator[Vector]:
    """Yield values [SI] of a state or a condition of the path along each phase that has it, at any parameters."""
    for k, phase in enumerate(problem.phases):
        t = np.linspace(0.0, flight.trajectories[k].duration, _LOOKS)
        x, u = flight.evaluate(k, t)
        if limit.kind == "state" and limit.names[0] in phase.state_names:
            yield x[phase.state_names.index(limit.names[0])]
        elif limit.kind == "path":
            yield from (v for c, v in phase.path_along(x, u, p) if c.name in limit.names)


def _name_limits(problem: Problem, error: NotConvergedError, found: list[Relaxed]) -> NotConvergedError:
    """Return the error, with the limit that gives least first."""
    parts = [_describe_limit(problem, one) for one in found]
    first = parts[0]
    easier = "more thrust, less mass or a higher start" if "vehicle_thrust" in problem.given else ""
    ways = list(dict.fromkeys(part.enough for part in parts if part.possible))
    if found[0].limit.kind == "end":
        ways = []
    beyond = "" if first.possible else ", which is out of its range"
    several = "one of these: " if len(ways) > 1 else ""
    given = [
        {"limit": part.name, "amount": one.amount, "unit": one.limit.bounded.unit}
        for part, one in zip(parts, found, strict=True)
    ]
    return NotConvergedError(
        f"no flight was found that keeps every limit: the best violates {first.name} by about {first.much}",
        got=f"all other limits can be kept with {first.enough}{beyond}, to the accuracy of a mesh",
        expected=first.stated,
        advice="; ".join(filter(None, (several + "; ".join(ways), easier))),
        partial={**error.partial, "relaxations": given},
        flight=error.flight,
    )


def _describe_limit(problem: Problem, one: Relaxed) -> LimitReport:
    """Describe a limit that stands in the way, and what would be enough."""
    limit, unit, p = one.limit, one.limit.bounded.unit, one.flight.parameters
    if limit.kind == "end":
        given = limit.relaxations(one.flight.free)
        name, largest = next(iter(given.items()))
        missed = [
            f"{n.replace('_', ' ')} missed by {format_quantity(v, unit, 3)}"
            for n, v in given.items()
            if v > _SHARE * largest
        ]
        called = name.replace("_", " ")
        return LimitReport(
            f"the end condition {called}", format_quantity(largest, unit, 3), ", ".join(missed), f"{called} met"
        )
    if limit.kind == "path":
        if (found := _parameter_enough(problem, one)) is not None:
            name, value = found
            key, unit, stated = parameter_key(problem, name), problem.unit_of(name), getattr(p, name)
            further, side = (value - stated) * (1 + one.doubt / one.amount), "lower" if value < stated else "upper"
            much = format_quantity(abs(value - stated), unit, 2)
            enough = f"{key} {format_bound(stated + further, unit, side, _DIGITS)}"
            possible = _may_be_stated(problem, name, stated + further)
            return LimitReport(key, much, enough, f"{key} {format_quantity(stated, unit)}", possible)
        called = quantity_name(limit.bounded)
        enough = f"{called} down to {format_bound(-one.amount - one.doubt, unit, 'lower', _DIGITS)}"
        return LimitReport(called, format_quantity(one.amount, unit, 2), enough, f"{called} never below 0")
    lower, upper = _bounds(limit, p)
    at, name = lower if limit.side == "lower" else upper, limit_name(problem, limit.bounded, limit.side)
    give = one.amount + one.doubt
    reached = at - give if limit.side == "lower" else at + give
    enough, stated = f"{name} {format_bound(reached, unit, limit.side)}", getattr(limit.bounded, limit.side)
    possible = not isinstance(stated, str) or _may_be_stated(problem, stated, reached)
    return LimitReport(
        name, format_quantity(one.amount, unit, 2), enough, f"{name} {format_quantity(at, unit)}", possible
    )


def _may_be_stated(problem: Problem, name: str, value: float) -> bool:
    """Return True if a given parameter may have a value [SI], by what is declared of it."""
    try:
        problem.with_given(**{name: value})
    except PeriluneError:
        return False
    return True


def _parameter_enough(problem: Problem, one: Relaxed) -> tuple[str, float] | None:
    """Return the given parameter that states only the limit, and its nearest value with which the flight keeps it."""
    limit, p = one.limit, one.flight.parameters
    least = -_KEPT * problem.size_of(limit.bounded)
    stated_values = [*_limited_values(problem, limit, one.flight, p)]
    # Polynomials overshoot between the nodes of a mesh.
    kept = [along >= -_OVERSHOT * one.amount for along in stated_values]

    def room(name: str, value: float) -> float:
        here = SimpleNamespace(**{**vars(p), name: value})
        with np.errstate(all="ignore"):
            values = zip(_limited_values(problem, limit, one.flight, here), kept, strict=True)
            return min(float(along[at].min(initial=np.inf)) for along, at in values) - least

    found = list[tuple[float, str, float]]()
    for name in only_in_path(problem):
        stated = getattr(p, name)
        if not room(name, stated) < 0:
            continue  # the flight keeps it as stated: what gave by little was no more than rounding, or a node's
        for way in (-1, 1):
            before = stated
            for value in stated * (1 + way * np.geomspace(*_STEPS)):
                left = room(name, value)
                if not np.isfinite(left):
                    break  # where the condition says nothing, a tangent beyond a right angle
                if left >= 0:
                    enough = float(np.asarray(brentq(partial(room, name), before, value)))
                    found.append((abs(enough - stated), name, enough))
                    break
                before = value
    return min(found)[1:] if found else None
