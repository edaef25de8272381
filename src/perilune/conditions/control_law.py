"""The control that minimises the Hamiltonian, in closed form, from the Hamiltonian's own derivatives.

A `Direction` is minimised on its circle or sphere, an unbounded scalar where dH/du = 0; a bounded scalar that enters
linearly sits at a bound and is left to be switched.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from perilune.problem.problem import Bounded, Direction, Phase
from perilune.problem.symbolic import elements
from perilune.words.outcome import PeriluneError


def switched_scalars(phase: Phase) -> list[Bounded]:
    """The scalars with two finite bounds."""
    scalars = [c for c in phase.controls if isinstance(c, Bounded)]
    return [c for c in scalars if np.isfinite(c.upper - c.lower)]


def minimising_control(
    phase: Phase, hamiltonian: ca.SX, u: ca.SX, bounds: dict[str, ca.SX]
) -> tuple[ca.SX, dict[str, ca.SX]]:
    """The control that minimises H, from H's own derivatives.

    A `Direction` d enters H linearly, H = a + g . d, so the minimum on the circle or sphere is d = -g/|g|; for planar
    thrust that is Cho et al. (15) with both signs right, beta = atan2(-lambda_v, -lambda_u). Where g carries a throttle
    as a factor, that factor is not negative and cancels: its upper bound stands for it. An unbounded scalar in which H
    is quadratic has its minimum where dH/du = 0. A bounded scalar in which H is linear is left as it is, to be set to
    its bounds.

    Returns
    -------
    law, switching
        The control, with switched scalars still symbols; S of each switched scalar by name.

    Raises
    ------
    PeriluneError
        If H is not of a form whose minimum is known in closed form.
    """
    law, at = [u[i] for i in range(u.numel())], 0
    scalars: list[tuple[int, Bounded]] = []
    for control in phase.controls:
        width = len(control.names)
        part = u[at : at + width]
        if isinstance(control, Direction):
            gradient = ca.gradient(hamiltonian, part)
            if ca.depends_on(gradient, part):
                raise _no_law(phase, control.names, "a Hamiltonian that is not linear in it")
            law[at : at + width] = elements(-gradient / ca.norm_2(gradient))
        else:
            scalars.append((at, control))
        at += width
    switching: dict[str, ca.SX] = {}
    for i, control in scalars:
        slope = ca.gradient(hamiltonian, u[i])
        if not ca.depends_on(slope, u[i]) and control.name in bounds:
            switching[control.name] = slope
            if control.lower < 0 and any(ca.depends_on(entry, u[i]) for entry in law[:i] + law[i + 1 :]):
                raise _no_law(phase, control.names, "a factor of a direction that may be negative")
            law = [ca.substitute(e, u[i], bounds[control.name][1]) if j != i else e for j, e in enumerate(law)]
        elif control.name not in bounds and not ca.depends_on(ca.gradient(slope, u[i]), u):
            law[i] = -ca.substitute(slope, u[i], 0) / ca.gradient(slope, u[i])
        else:
            raise _no_law(phase, control.names, "a Hamiltonian that is not linear in it, or no bounds")
    column_law = ca.vertcat(ca.SX(0, 1), *law)
    return column_law, {name: ca.substitute(slope, u, column_law) for name, slope in switching.items()}


def _no_law(phase: Phase, names: tuple[str, ...], got: str) -> PeriluneError:
    return PeriluneError(
        f"the indirect method has no closed-form control law for {', '.join(names)} of {phase.name}",
        got=got,
        expected="a direction or a bounded scalar that enters linearly, or an unbounded one that enters quadratically",
        advice="use the direct method: solve(problem, Pseudospectral())",
    )
