"""Neighbours of a problem, with its start moved or free parameters held, without any new derivation.

A moved start is one more given parameter ``offset_<state>`` for each state, so a neighbour is a problem like any other.
Whatever is derived from a problem includes such offsets from the beginning (`without_start_offsets`, `start_offsets`),
and with any set of free parameters held: all neighbours share what was derived and compiled for the problem itself.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from perilune.core import Vector
from perilune.problem.problem import Problem
from perilune.problem.variables import FreeParameter, Parameter


def offset_of(state: str) -> str:
    """Return the name of the parameter by which a state is moved at the start."""
    return f"offset_{state}"


@dataclass(frozen=True, eq=False)
class MovedStart:
    """Initial state of a problem plus its offsets."""

    problem: Problem

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the offsets."""
        return tuple(map(offset_of, self.problem.phases[0].state_names))

    def __call__(self, p: Any, xp: Any) -> Sequence[Any]:
        """Return the initial state [SI]."""
        return tuple(a + getattr(p, name) for a, name in zip(self.problem.start(p, xp), self.names, strict=True))


def with_start_offsets(problem: Problem) -> Problem:
    """Return the problem with a given parameter ``offset_<state>``, 0, for each component of its initial state.

    The same whenever it is asked for, so that its functions are traced once.
    """
    if (known := problem.__dict__.get("with_start_offsets")) is not None:
        return known
    offsets = {offset_of(s.name): Parameter(value=0.0, unit=s.unit) for s in problem.phases[0].states}
    given = MappingProxyType({**problem.given, **offsets})
    problem.__dict__["with_start_offsets"] = moved = problem.changed(start=MovedStart(problem), given=given, form=None)
    return moved


def move_start(problem: Problem, **values: float) -> Problem:
    """Return a `with_start_offsets` problem with other offsets [SI]. Nothing else in it depends on them."""
    return _with_values(problem, values)


def without_start_offsets(problem: Problem) -> Problem:
    """Return the problem without the offsets of its start."""
    if not isinstance(problem.start, MovedStart):
        return problem
    of = problem.start.problem
    given = MappingProxyType({name: problem.given[name] for name in of.given})
    same = {"structure": of.structure} if len(of.free) == len(problem.free) else {}
    return of.changed(given=given, free=problem.free, **same)


def start_offsets(problem: Problem) -> Vector:
    """Return by how much each state is moved at the start [SI]."""
    if not isinstance(problem.start, MovedStart):
        return np.zeros(len(problem.phases[0].states))
    return np.array([problem.given[name].value for name in problem.start.names])


@dataclass(frozen=True, kw_only=True)
class FixedFree(FreeParameter):
    """A free parameter that a neighbour fixes at its value in an answer; a user's range may be one value as well."""


def fix_free_parameters(problem: Problem, **values: float) -> Problem:
    """Return a neighbour whose free parameters may take only these values [SI]."""
    return _with_fixed_free(problem, values, FixedFree)


def narrow_free_parameters(problem: Problem, **values: float) -> Problem:
    """Return the problem, to be solved as any other, with free parameters that take only these values [SI]."""
    return _with_fixed_free(problem, values, FreeParameter)


def _with_fixed_free(problem: Problem, values: Mapping[str, float], kind: type[FreeParameter]) -> Problem:
    free = tuple(
        kind(name=f.name, unit=f.unit, lower=v, upper=v, guess=v) if (v := values.get(f.name)) is not None else f
        for f in problem.free
    )
    return _with_free(problem, free)


def release_free_parameters(problem: Problem, names: Collection[str]) -> Problem:
    """Return the problem without the bounds of these free parameters.

    Parameters
    ----------
    problem
        Problem with bounded free parameters.
    names
        Free parameters whose bounds go.
    """
    free = tuple(replace(f, lower=-math.inf, upper=math.inf) if f.name in names else f for f in problem.free)
    return _with_free(problem, free)


def _with_free(problem: Problem, free: tuple[FreeParameter, ...]) -> Problem:
    """Return the same problem with other ranges, which do not enter its structure."""
    same = {"structure": problem.structure} if "structure" in problem.__dict__ else {}
    return problem.changed(free=free, **same)


def with_given_unchecked(problem: Problem, values: Mapping[str, float]) -> Problem:
    """Return the problem at other values [SI] of given parameters without checks: those of a table were made.

    One that is free here is fixed, as by `Problem.with_given`.

    Parameters
    ----------
    problem
        Problem at any values.
    values
        New values by the names of parameters [SI].
    """
    if any(name in problem.free_names for name in values):
        return problem.with_given(**values)
    new = _with_values(problem, values)
    new.take_ranges()
    return new


def _with_values(problem: Problem, values: Mapping[str, float]) -> Problem:
    """Return the problem with other values [SI] of given parameters, which do not enter its structure."""
    given = {name: Parameter(value=value, unit=problem.given[name].unit) for name, value in values.items()}
    return problem.changed(given=MappingProxyType({**problem.given, **given}), structure=problem.structure)


def is_neighbour(problem: Problem) -> bool:
    """Return True if the start is moved, or a free parameter held."""
    return isinstance(problem.start, MovedStart) or any(isinstance(f, FixedFree) for f in problem.free)
