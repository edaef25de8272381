"""Costates known before any extremal is, and the curvature of H in the controls that follows from them.

Those of states that nothing asks for vanish identically, and those of states that count the cost are a positive number
(`perilune.problem.tracing.costate_signs`). So H may be linear in a control that bends such a rate, or convex in it for
certain.
"""

from __future__ import annotations

import casadi as ca

from perilune.conditions.scalar_regimes import Terms
from perilune.problem import Kinked, Phase


def weighing_costates(phase: Phase, dynamics: Kinked, u: ca.SX, lam: ca.SX, unpriced: frozenset[str]) -> ca.SX:
    """Return the costates, with zero for unpriced states if only these bend H in some control, or in a pair of them.

    H without them is linear there, as it is on every extremal; elsewhere a vanishing factor does no harm.

    Parameters
    ----------
    phase, dynamics, u
        The phase, its rates on each side of their choices, and the symbols of its controls.
    lam
        Costates of its states.
    unpriced
        Names of states whose costates vanish identically.
    """
    idle = [i for i, name in enumerate(phase.state_names) if name in unpriced]
    if not idle or not u.numel():
        return lam

    def bends(states: list[int]) -> set[tuple[int, int]]:
        rates = ca.vertcat(ca.SX(0, 1), *(f[i] for f in dynamics.rates for i in states))
        slopes = ca.jacobian(rates, u)
        return {(i, j) for i in range(u.numel()) for j in ca.jacobian_sparsity(slopes[:, i], u).get_triplet()[1]}

    others = bends([i for i in range(lam.numel()) if i not in idle])
    dropped = [i for i in idle if bends([i]) - others]
    return ca.vertcat(*(ca.SX(0) if i in dropped else lam[i] for i in range(lam.numel())))


def known_hamiltonian_terms(phase: Phase, weights: ca.SX, f: ca.SX, costs: frozenset[str]) -> Terms:
    """Return the known sizes and signs of the terms of H = weights . f.

    Parameters
    ----------
    phase
        Whose states.
    weights, f
        Their costates, of `weighing_costates`, and their rates.
    costs
        Names of states whose costates are a positive number on every extremal.
    """
    positive = ca.vertcat(ca.SX(0, 1), *(weights[i] for i, name in enumerate(phase.state_names) if name in costs))
    return Terms(size=ca.sum1(ca.fabs(weights * f)), positive=positive)
