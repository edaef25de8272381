"""The planar landing as a boundary value problem for the batch: land at rest from dispersed ignition points.

Minimum time at constant thrust. Unknowns y = (lam_r, lam_u, lam_v, T), p = (mu, thrust, flow, r0, u0, v0,
m0); conditions r = 1, u = v = 0 at the end and |lam| = 1, the scale of the costates being free when T is
fixed by H alone.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from lander import PARAMETERS, RADIUS, SPEED, landing_rhs

from perilune.conditions.canonical_equations import PhaseExtremal
from perilune.conditions.pontryagin import OptimalityConditions
from perilune.kernels.algebra.prune import prune

#: A solution from r0 = 15 km above the surface at perilune speed; found by continuation in `reference`.
NOMINAL = np.array([1 + 15.0e3 / RADIUS, 1691.9e0 / SPEED, 0.0, 1.0])


def functions() -> tuple[ca.Function, ca.Function, ca.Function]:
    """Return rhs over (r, u, v, m, lam_r, lam_u, lam_v), start and residual."""
    pruned = prune(landing_rhs(), [0, 2, 3], fixed={6: 0.0})
    y, p = ca.SX.sym("y", 4), ca.SX.sym("p", 7)
    z = ca.SX.sym("z", 7)
    rhs = ca.Function("rhs", [z, p], [pruned.rhs(z, p[:3])])
    start = ca.Function("start", [y, p], [ca.vertcat(p[3:], y[:3]), y[3]])
    conditions = ca.vertcat(z[0] - 1, z[1], z[2], ca.dot(y[:3], y[:3]) - 1)
    return rhs, start, ca.Function("residual", [y, z, p], [conditions])


def by_hand() -> OptimalityConditions:
    """Return the same as conditions for the shooting function, with the costate of the mass as an entry left at 0."""
    rhs, start, residual = functions()
    y, z, p, nothing = ca.SX.sym("y", 4), ca.SX.sym("z", 8), ca.SX.sym("p", 7), ca.SX.sym("before", 0)
    z0, duration = start(y, p)
    phase = PhaseExtremal(
        solved=(None,),
        modes=(ca.Function("rhs", [z, p], [ca.vertcat(rhs(z[:7], p), 0)]),),
        rates=(),
        reports=(),
        multipliers=(),
        regimes=((),),
        held=((),),
        events=(),
        mode=ca.Function("mode", [z, p], [ca.SX(0)]),
        state_count=4,
        constants=(),
        settles=False,
        periodic=(),
    )
    return OptimalityConditions(
        phases=(phase,),
        starts=(ca.Function("start", [y, nothing, p], [ca.vertcat(z0, 0), duration]),),
        residual=ca.Function("residual", [y, z, p], [residual(y, z[:7], p), y[3]]),
        unknowns=tuple((name, "1") for name in ("lam_r", "lam_u", "lam_v", "time")),
        residuals=tuple((name, "1") for name in ("r", "u", "v", "length")),
        free_at=slice(0, 0),
        costate_at=(slice(0, 3),),
        transversality_at=3,
        stationarity_at=slice(0, 0),
        ranges=(),
        silent=((),),
        silent_rows=(),
        needed=(tuple(range(7)),),
    )


def parameters(lanes: int, seed: int = 1) -> np.ndarray:
    """Dispersed around the nominal: dr +-5 km, du, dv +-30 m/s, dm +-3 %; lane 0 is the nominal."""
    random = np.random.default_rng(seed)
    size = np.array([5e3 / RADIUS, 30 / SPEED, 30 / SPEED, 0.03])
    ignition = NOMINAL + size * random.uniform(-1, 1, (lanes, 4))
    ignition[0] = NOMINAL
    return np.column_stack([np.tile(PARAMETERS, (lanes, 1)), ignition])
