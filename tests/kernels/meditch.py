"""Meditch's lunar lander as an extremal with a thrust switch (IEEE Trans. AC-9, 1964).

h' = v, v' = -1 + T/m, m' = -T/2.349, 0 <= T <= 1.227; minimise the integral of T. The control minimises H =
T + lam_h v + lam_v (-1 + T/m) - lam_m T/2.349, so T is at its bounds by the sign of the switching function.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from perilune.kernels import Event

THRUST, EXHAUST = 1.227, 2.349
COSTATE = np.array([0.267592863436, -0.209525212070, 1.70643283042])
START = np.array([1.0, -0.783, 1.0, *COSTATE])
FINAL_TIME, SWITCH = 1.39680808911, 0.239259108626
COST = 1.42031259905


def modes_and_switch() -> tuple[list[ca.Function], list[Event]]:
    """Thrust off and on, and the switch between them both ways."""
    x, lam, p = ca.SX.sym("x", 3), ca.SX.sym("lam", 3), ca.SX.sym("p", 2)
    z = ca.vertcat(x, lam)

    def mode(thrust: ca.SX | float) -> ca.Function:
        rate = ca.vertcat(x[1], -1 + thrust / x[2], -thrust / p[1])
        hamiltonian = thrust + ca.dot(lam, rate)
        return ca.Function("mode", [z, p], [ca.vertcat(rate, -ca.gradient(hamiltonian, x))])

    switching = ca.Function("switching", [z, p], [1 + lam[1] / x[2] - lam[2] / p[1]])
    events = [
        Event(function=switching, direction=-1, switches={0: 1}),
        Event(function=switching, direction=1, switches={1: 0}),
    ]
    return [mode(0.0), mode(p[0])], events


PARAMETERS = np.array([THRUST, EXHAUST])
