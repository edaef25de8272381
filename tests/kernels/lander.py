"""The planar lunar landing extremal, scaled, as the kernels' test piece.

State (r, phi, u, v, m) and costates, Cho et al. 2015 (1)-(5); thrust along -(lam_v, lam_u) (15); the costate
rates are -dH/dx by differentiation. Units: R = 1738 km, mu = 4902.8 km^3/s^2, 300 kg; 440 N, 310 s are the
parameters.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

RADIUS, MU, MASS = 1738.0e3, 4902.8e9, 300.0
SPEED = np.sqrt(MU / RADIUS)
TIME = RADIUS / SPEED
THRUST, ISP, G0 = 440.0, 310.0, 9.81
PARAMETERS = np.array([1.0, THRUST / (MASS * SPEED / TIME), THRUST / (ISP * G0) / (MASS / TIME)])
DURATION = 700.0 / TIME


def landing_rhs() -> ca.Function:
    """(z[10], p[3]) -> z' with p = (mu, thrust, mass flow)."""
    x, lam, p = ca.SX.sym("x", 5), ca.SX.sym("lam", 5), ca.SX.sym("p", 3)
    r, _, u, v, m = ca.vertsplit(x)
    norm = ca.sqrt(lam[2] ** 2 + lam[3] ** 2)
    cosine, sine = -lam[2] / norm, -lam[3] / norm
    direction = ca.SX.sym("n", 2)
    rate = ca.vertcat(
        v,
        u / r,
        -u * v / r + p[1] / m * direction[0],
        u**2 / r - p[0] / r**2 + p[1] / m * direction[1],
        -p[2],
    )
    hamiltonian = ca.dot(lam, rate)
    full = ca.vertcat(rate, -ca.gradient(hamiltonian, x))
    closed = ca.substitute(full, direction, ca.vertcat(cosine, sine))
    return ca.Function("landing", [ca.vertcat(x, lam), p], [closed])


def start(lanes: int = 1, seed: int = 0) -> np.ndarray:
    """Starts near perilune of a 100 km x 15 km orbit, dispersed: (lanes, 10)."""
    random = np.random.default_rng(seed)
    centre = np.array([1 + 15.0 / 1738, 0.0, 1.6919e3 / SPEED, 0.0, 1.0, -0.2, 0.0, -0.8, -0.3, -0.4])
    size = np.array([5e-3, 0.0, 0.02, 0.02, 0.03, 0.1, 0.0, 0.1, 0.1, 0.1])
    return centre + size * random.uniform(-1, 1, (lanes, 10)) * (lanes > 1)


def landing_seeds(lanes: int = 1) -> np.ndarray:
    """Six columns: lam_r, lam_u, lam_v, lam_m, u and m at the start."""
    seeds = np.zeros((lanes, 10, 6))
    for column, row in enumerate((5, 7, 8, 9, 2, 4)):
        seeds[:, row, column] = 1.0
    return seeds
