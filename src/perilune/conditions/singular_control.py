"""Control of a singular arc: H is linear in it, and its slope Phi = dH/du vanishes along the arc.

H then does not determine u, but Phi = 0 along the arc does: Phi is differentiated along the flight of state and
costate until u appears,

    Phi^(2k) = A(x, lambda) + B(x, lambda) u = 0,       u = -A/B,       (-1)^k B >= 0,

the last being the generalised Legendre-Clebsch condition (Kelley) of a minimum. The first derivative in which u appears
is an even one; k is the order of the arc. With this control Phi is a polynomial of degree 2k - 1 in time, whatever the
unknowns are: at k = 1 it vanishes all along where it does at both ends of the arc, which follows from H being
continuous there.

Source: Kelley, Kopp, Moyer, *Singular extremals*, in Leitmann (ed.), Topics in Optimization, 1967; Bryson and Ho 1975,
chapter 8.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from perilune.conditions.active_constraints import Held
from perilune.core import PeriluneError
from perilune.problem import Regime

MOST = 4  # derivatives that are looked at: arcs of order 1 and 2
_POINTS, _DRAWS, _ZERO = 3, 30, 1e-9  # at which a coefficient is looked at; drawn for these; of its terms


@dataclass(frozen=True, kw_only=True)
class Motion:
    """State and costate z, and their rates with a control of a mode: what it holds, the regimes of its scalars."""

    z: ca.SX
    rate: Callable[[ca.SX, Held, tuple[Regime, ...]], ca.SX]


def singular_control(name: str, slope: ca.SX, s: ca.SX, z: ca.SX, rate: ca.SX) -> ca.SX:
    """Derive the control -A/B of a singular arc of order 1.

    Parameters
    ----------
    name
        Its name in messages.
    slope
        Phi, an expression of z.
    s
        The symbol of the control.
    z, rate
        State and costate, and their rates as expressions of z and s, linear in s.

    Raises
    ------
    PeriluneError
        If u appears in no derivative, in an odd one, or in the fourth: an arc of order 2 is reached by infinitely many
        switches (Fuller), which no list of arcs holds.
    """
    by_control = ca.jacobian(rate, s)
    bent = [i for i in range(rate.numel()) if ca.depends_on(by_control[i], s)]
    by_control[bent] = 0  # of states that only count: where it has an effect the arc is refused
    without = ca.substitute(rate, s, 0)
    for order in range(1, MOST + 1):
        if any(ca.depends_on(slope, z[i]) for i in bent):
            raise _no_singular_arc_error(name, "the rates are not linear in it")
        terms = ca.gradient(slope, z) * by_control
        slope = ca.dot(ca.gradient(slope, z), without)
        if not _vanishes_identically(terms):
            if order == 2:
                return -slope / ca.sum1(terms)
            raise _no_singular_arc_error(name, f"the control first appears in derivative {order} of dH/du")
    raise _no_singular_arc_error(name, f"the control appears in none of the first {MOST} time derivatives of dH/du")


def _vanishes_identically(terms: ca.SX) -> bool:
    """Return True if a sum is zero at a few points, measured against the size of its terms."""
    symbols = ca.symvar(terms)
    if not symbols:
        return bool(abs(float(ca.sum1(terms))) == 0.0)
    evaluate = ca.Function("terms", [ca.vertcat(*symbols)], [ca.sum1(terms), ca.sum1(ca.fabs(terms))])
    rng, looked = np.random.default_rng(0), 0
    for _ in range(_DRAWS):
        total, size = (float(value) for value in evaluate(rng.uniform(0.5, 1.5, len(symbols))))
        if not np.isfinite(size):  # where the physics has no value
            continue
        if abs(total) > _ZERO * size:
            return False
        looked += 1
        if looked == _POINTS:
            break
    return True


def _no_singular_arc_error(name: str, why: str) -> PeriluneError:
    return PeriluneError(
        f"{name} has no singular arc that can be joined to others, because {why}",
        expected="a control that appears in the second time derivative of dH/du",
        advice="use the direct method: solve(problem, Pseudospectral())",
    )
