"""Redundant end conditions, which the boundary arc that ends there implies already.

A boundary arc along the ground to the site ends at its height, and has no vertical speed there: S = 0 and S' = 0 hold
all along the arc. Stated twice, a condition has no multiplier of its own, and no Newton's method finds one; a proof may
state it as often as it likes.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np

from perilune.core import NUMERIC
from perilune.problem import Expression, Problem, component
from perilune.structures.state_constraints import Condition, plain_bounds
from perilune.structures.structure import Arc

_TRIED, _ALIKE = 8, 1e-9  # states, and how far a multiple of another may be off, of its own size


def repeated_ends(
    problem: Problem, k: int, arc: Arc, conditions: dict[str, Condition], varied: Collection[str] = ()
) -> frozenset[int]:
    """Return the numbers of end conditions of phase k that are multiples of a boundary arc's S or a rate below S^(q).

    Found at states drawn at random about the canonical units; parameters have their values, but for free ones and those
    that are `varied`: an end at x1 is no end at the bound l because both have one value now.

    Parameters
    ----------
    problem, k
        The problem and the number of the phase.
    arc
        Its last arc.
    conditions
        Conditions of the phase by name, as `conditions_of` has them.
    varied
        Names of given parameters whose values are to change.
    """
    phase, form = problem.phases[k], problem.form.expressions
    ridden = [value for name in arc.along for value in conditions[name].values[:-1]]
    if not ridden or not phase.end_conditions:
        return frozenset()
    rng = np.random.default_rng(0)
    moving = {f.name: f.guess for f in problem.free}
    moving |= {name: problem.given[name].value for name in varied if name in problem.given}
    for name, value in moving.items():
        moving[name] = value + problem.scales.of(problem.unit_of(name)) * rng.uniform(0.05, 0.15)
    p = problem.parameters({})
    vars(p).update({name: g.value for name, g in plain_bounds(problem).items()} | moving)
    sizes = np.array([problem.size_of(state) for state in phase.states])
    x = phase.state_record(*(sizes[:, None] * rng.uniform(0.5, 1.5, (len(sizes), _TRIED))))
    u = phase.control_record(*np.full((len(phase.control_names), _TRIED), math.nan))
    records = {"x": x, "u": u, "p": p}

    def at(value: Expression) -> Any:
        found = value(*(records[role] for role in value.roles), NUMERIC)
        return np.broadcast_to(found if value.scalar else found[0], _TRIED)

    with np.errstate(all="ignore"):
        known = [at(value) for value in ridden]
        return frozenset(
            i
            for i, condition in enumerate(phase.end_conditions)
            if not condition.ranged and any(_multiple(at(component(form[k, "end"], i)), values) for values in known)
        )


def _multiple(one: Any, other: Any) -> bool:
    factor = one @ other / (other @ other)
    return bool(factor and np.abs(one - factor * other).max() <= _ALIKE * np.abs(one).max())
