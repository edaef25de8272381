"""Second-order condition of singular controls.

H is linear in such a control, and its slope Phi = dH/du vanishes all along, so that other values do not change H. With
u in Phi'' = A + B u for the first time, B <= 0 is the generalised Legendre-Clebsch condition.

Source: Kelley, Kopp, Moyer, *Singular extremals*, in Leitmann (ed.), Topics in Optimization, 1967.
"""

from __future__ import annotations

import casadi as ca

from perilune.conditions.canonical import PhaseExtremal
from perilune.problem.controls import Settled, scalars
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.symbolic import SYMBOLIC, column, elements, trace_parameters


def kelley_terms(
    stated: Problem, phase: Phase, extremal: PhaseExtremal, mode: int, z: ca.SX, numbers: ca.SX, free: ca.SX
) -> list[ca.SX]:
    """Return -B of each singular control of a phase, over 1 + |B|; below zero for a maximum."""
    known, n, found = trace_parameters(stated), extremal.state_count, list[ca.SX]()
    symbol, u, s = ca.SX.sym("z", z.numel()), ca.SX.sym("u", len(phase.control_names)), ca.SX.sym("s")
    x, lam = symbol[:n], symbol[extremal.half : extremal.half + n]
    H = ca.dot(lam, column(phase.rates(elements(x), elements(u), known.record, SYMBOLIC)))
    for at, control in scalars(phase.controls):
        if not isinstance(control, Settled) or control.regime != "singular":
            continue
        beside = ca.SX(extremal.reports[mode](symbol, numbers)[0])
        beside[at] = s
        moving = ca.vertcat(ca.gradient(H, lam), -ca.gradient(H, x))
        slope, rate = (ca.substitute(e, u, beside) for e in (ca.gradient(H, u[at]), moving))
        B = ca.gradient(_rate_along_flow(_rate_along_flow(slope, x, lam, rate), x, lam, rate), s)
        told = ca.Function("B", [symbol, s, numbers, known.given, known.free], [B])
        value = told(z, extremal.reports[mode](z, numbers)[0][at], numbers, numbers[: known.given.numel()], free)
        found.append(-value / (1 + ca.fabs(value)))
    return found


def _rate_along_flow(value: ca.SX, x: ca.SX, lam: ca.SX, rate: ca.SX) -> ca.SX:
    """Return the rate of an expression of state and costate."""
    n = x.numel()
    return ca.dot(ca.gradient(value, x), rate[:n]) + ca.dot(ca.gradient(value, lam), rate[n:])
