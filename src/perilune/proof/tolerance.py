"""Stated tolerance in a proof: it raises limits, each of which says so, and is refused if it would prove nothing.

It is applied to checks that are made already, so that what is computed, where it is looked and which bounds count as
active is the same with it and without.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from perilune.problem import LARGEST, SIZED, Check, Solution, Tolerance, format_tolerance, quantity_in, unit_of


def raise_limit(check: Check, tolerance: Tolerance) -> Check:
    """The check with the limit that is stated for its quantity, where that is larger than its own.

    A limit of 0 counts what may not be there at all, one below 0 asks for a sign: neither is a size.

    Parameters
    ----------
    check
        A check, with its own limit.
    tolerance
        Stated tolerances by the names of quantities, in the units of the checks.
    """
    name = {1: quantity_in(check.unit), 2: "optimality" if check.unit == "1" else ""}.get(check.level, "")
    stated = tolerance.stated.get(name)
    if stated is None or check.exact or not 0 < check.limit < stated:
        return check
    return replace(check, limit=stated, own_limit=check.limit, raised_by=name)


def check_tolerance_sense(tolerance: Tolerance, solution: Solution) -> Iterator[Check]:
    """Yield for each quantity that the flight changes a check that its tolerance leaves something to prove.

    Parameters
    ----------
    tolerance
        Stated tolerances by the names of quantities, in the units of the checks.
    solution
        The flight, from whose states the changes of the quantities are taken.
    """
    changed = _change_of_quantities(solution)
    for name, stated in tolerance.stated.items():
        if name in SIZED and name not in changed:
            continue
        size = changed.get(name, 0.0)
        yield Check(
            name=f"stated_{name}",
            level=1,
            value=stated,
            limit=LARGEST * size,
            unit=unit_of(name),
            exact=True,
            meaning=f"the tolerance stated, against a thousandth of the {format_tolerance(name, size)} by which the"
            f" flight changes it: a larger one would prove nothing",
        )


def _change_of_quantities(solution: Solution) -> dict[str, float]:
    """Return the most that the flight changes each quantity in one of its states [SI]; for time, its duration."""
    changed: dict[str, float] = {}
    for phase, flown in zip(solution.problem.phases, solution.trajectories, strict=True):
        for state, span in zip(phase.states, np.ptp(flown.state.values, axis=0).tolist(), strict=True):
            name = quantity_in(state.unit)
            changed[name] = max(changed.get(name, 0.0), span)
    return {**changed, "time": solution.duration}
