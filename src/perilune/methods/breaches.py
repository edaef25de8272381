"""What a flight breaks on its way: bounds of states and free parameters, and conditions of the path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.variables import Free, Variable
from perilune.words.types import Matrix, Vector
from perilune.words.units import told


@dataclass(frozen=True, kw_only=True)
class Breach:
    """A condition or bound that a flight breaks.

    Parameters
    ----------
    name, text
        Of the condition, and what happens to it, in the user's words.
    miss, unit
        By how much it is broken, SI.
    canonical
        The same in canonical units, to compare breaches of different kinds.
    path
        Whether it is a path condition, which an extremal knows nothing of, and not a bound.
    """

    name: str
    text: str
    miss: float
    unit: str
    canonical: float
    path: bool = False


def breaches_along(problem: Problem, phase: Phase, x: Matrix, u: Matrix, p: Any, slack: float) -> Iterator[Breach]:
    """What is broken by more than a slack [canonical] where states and controls of a phase were looked at."""
    for state, along in zip(phase.states, x, strict=True):
        yield from outside(problem, state, along, state.limits(p), slack)
    for condition, along in phase.path_along(x, u, p):
        least, scale = float(np.min(along)), problem.size_of(condition)
        if not least >= -slack * scale:
            text = f"{_called(condition)} falls to {told(least, condition.unit)} on the way"
            miss, unit = -least, condition.unit
            yield Breach(name=condition.name, text=text, miss=miss, unit=unit, canonical=miss / scale, path=True)


def outside(
    problem: Problem, named: Variable | Free, values: Vector, limits: tuple[float, float], slack: float
) -> Iterator[Breach]:
    """Values beyond their bounds. What is no number lies within none, not even where there are none."""
    (lower, upper), name, unit, scale = limits, named.name, named.unit, problem.size_of(named)
    least, most = float(np.min(values)), float(np.max(values))
    for side, limit, reached, miss in (("below", lower, least, lower - least), ("above", upper, most, most - upper)):
        if not miss <= slack * scale:
            way = "falls" if side == "below" else "rises"
            text = f"{_called(named)} {way} to {told(reached, unit)}, {side} its bound of {told(limit, unit)}"
            yield Breach(name=name, text=text, miss=miss, unit=unit, canonical=miss / scale)


def _called(named: Variable | Free) -> str:
    """The name of a quantity, with what it is where that is said."""
    about = getattr(named, "description", "")
    return f"{named.name} ({about})" if about else named.name
