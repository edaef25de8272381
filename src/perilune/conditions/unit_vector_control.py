"""Minimising directions (Lawden's primer vector): H, linear in a unit vector, is least opposite to its gradient.

Scalars may scale that gradient, and other directions too; there is no formula where a control turns it.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from perilune.conditions.active_constraints import minimising_direction
from perilune.conditions.scalar_regimes import no_control_law_error
from perilune.problem import Phase, directions, elements, scalars

_FROM_ABOVE = (0.3, 0.8)  # values of a scalar between its bounds, to test whether it only scales
_ALL_ROUND = (-0.9, 0.3, 0.8)  # the same of a component of a direction


def minimising_directions(
    phase: Phase, hamiltonian: ca.SX, u: ca.SX, limits: dict[str, tuple[ca.SX, ca.SX]], held: Mapping[str, ca.SX]
) -> tuple[ca.SX, list[ca.SX], ca.SX]:
    """Eliminate the directions: replace them by the minimising ones that keep these conditions active.

    Parameters
    ----------
    phase, hamiltonian, u
        H as an expression of the symbols u of the phase's controls, among others.
    limits
        (lower, upper) of each scalar by name.
    held
        Conditions to be held, by name.

    Returns
    -------
    (hamiltonian, u, room)
        H and the controls with the directions in place, and values >= 0 where they can keep the conditions active.
    """
    law, left, rooms = elements(u), list(directions(phase.controls)), ca.SX(0, 1)
    while left:
        gradients = [_direction_slope(phase, hamiltonian, u, limits, left, first, last) for first, last in left]
        # A direction that is only scaled by another comes first.
        (first, last), gradient = next(
            (found for found in zip(left, gradients, strict=True) if found[1] is not None), (left[0], None)
        )
        if gradient is None:
            raise no_control_law_error(
                phase, phase.control_names[first:last], "a direction that depends on another one"
            )
        left.remove((first, last))
        own = [c for c in held.values() if ca.depends_on(c, u[first:last])]
        direction, room = minimising_direction(gradient, u[first:last], own)
        law[first:last], rooms = elements(direction), ca.vertcat(rooms, room)
        hamiltonian = ca.substitute(hamiltonian, u[first:last], ca.vertcat(*law[first:last]))
    return hamiltonian, law, rooms


def _direction_slope(
    phase: Phase,
    hamiltonian: ca.SX,
    u: ca.SX,
    limits: dict[str, tuple[ca.SX, ca.SX]],
    left: list[tuple[int, int]],
    first: int,
    last: int,
) -> ca.SX | None:
    """Return the gradient of H in a direction, minimised by its opposite; None if another of `left` turns it."""
    names, part = phase.control_names[first:last], u[first:last]
    gradient = ca.gradient(hamiltonian, part)
    if ca.depends_on(gradient, part):
        raise no_control_law_error(phase, names, "a Hamiltonian that is not linear in it")
    for at, control in scalars(phase.controls):
        if ca.depends_on(gradient, u[at]):
            # Thrust carries its throttle as a factor, which is not negative and leaves the direction as it is.
            upper = limits[control.name][1]
            reference = ca.SX(1.0) if upper.is_constant() and np.isinf(float(upper)) else upper
            if (isinstance(control.lower, float | int) and control.lower < 0) or not _factor(gradient, u[at]):
                raise no_control_law_error(phase, names, f"a direction that depends on {control.name}")
            gradient = ca.substitute(gradient, u[at], reference)
    for at in (i for begin, end in left if begin != first for i in range(begin, end)):
        if ca.depends_on(gradient, u[at]):
            if not _factor(gradient, u[at], _ALL_ROUND):
                return None
            gradient = ca.substitute(gradient, u[at], 1.0)
    return gradient


def _factor(gradient: ca.SX, scalar: ca.SX, values: tuple[float, ...] = _FROM_ABOVE) -> bool:
    """Return True if the scalar only scales the gradient, as seen at a few points."""
    others = [s for s in ca.symvar(gradient) if not ca.is_equal(s, scalar)]
    evaluate = ca.Function("gradient", [scalar, ca.vertcat(ca.SX(0, 1), *others)], [gradient])
    rng = np.random.default_rng(0)
    for _ in range(3):
        point = rng.uniform(0.5, 1.5, len(others))
        a, *more = (np.array(evaluate(value, point)).ravel() for value in values)
        for b in more:
            if not np.allclose(a * np.linalg.norm(b), b * np.linalg.norm(a), rtol=1e-9, atol=1e-12):
                return False
    return True
