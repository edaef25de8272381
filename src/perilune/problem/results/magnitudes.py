"""Magnitudes of quantities along a flight, by which errors are judged.

The user chooses the canonical units of a problem and may give a quantity a scale of its own. Neither may loosen a
limit of the proof: the magnitudes that a flight reaches, or spans, bound both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from perilune.core import Matrix, Scales, Vector
from perilune.problem.variables import Variable

_NOTHING = 1e-18  # of a canonical unit
STILL = 1e-9  # of the span of states of its unit on other phases: a state that moves less on a phase is at rest there
BEYOND = 1e3  # largest scale, in units of what the state reaches or of the size of its unit
ROUNDS = 1e-4  # of what a state reaches: some hundred times the last digit, with limits of 3e-10 of a size


def supported_scale(scale: float, unit: float, reached: float) -> float:
    """Return a stated scale [SI] as far as a flight bears it out, so that no limit is loosened at will.

    Parameters
    ----------
    scale, unit
        The scale, and the size of the variable's unit.
    reached
        Its largest absolute value on the flight.
    """
    return min(scale, max(BEYOND * reached, unit))


def supported_unit(unit: float, reached: float) -> float:
    """Return a canonical unit [SI] within a factor of what a flight reaches in it: `Scales` loosen no limit at will.

    What is rounding relative to any unit that may be stated counts as nothing reached.

    Parameters
    ----------
    unit
        Canonical unit as stated [SI].
    reached
        Greatest absolute value on the flight [SI].
    """
    return min(max(unit, reached / BEYOND), BEYOND * reached) if reached > _NOTHING * unit else unit


def reached_sizes(
    scales: Scales, states: Sequence[Variable], values: Matrix, elsewhere: Mapping[str, float] = MappingProxyType({})
) -> Vector:
    """Return the sizes [SI] by which errors of the states of a flight are judged, from their values, (n, times).

    That is what they reach, as far as the span that they cover bears it out, and at least their canonical units;
    or, where a state has a scale of its own, a thousandth of that. So an answer is judged alike whatever scale it
    was computed with, and wherever its states are counted from; what they reach still rounds. `elsewhere` are the
    spans on other phases, by unit: what stands still on this one, as on a limit that it rides along, is judged by
    them.

    Parameters
    ----------
    scales
        Canonical units.
    states
        States of the phase.
    values
        Their values along it [SI], (n, times).
    elsewhere
        Largest spans on other phases [SI], by unit.

    Returns
    -------
    Vector
        One size for each state [SI], (n,).
    """
    reached, spans = np.abs(values).max(axis=1).tolist(), np.ptp(values, axis=1).tolist()
    sizes = []
    for v, most, span in zip(states, reached, spans, strict=True):
        alike = [i for i, other in enumerate(states) if other.unit == v.unit]
        # A state at rest, with all states of its unit, has covered no span that says anything.
        together = max(spans[i] for i in alike)
        if together <= STILL * (other := elsewhere.get(v.unit, 0.0)):
            together = other
        together = together or max(reached[i] for i in alike)
        unit = supported_unit(scales.of(v.unit), together)
        own = unit if v.scale is None else supported_scale(v.scale, unit, span) / BEYOND
        sizes.append(max(supported_scale(most, unit, span), own, ROUNDS * most))
    return np.array(sizes)
