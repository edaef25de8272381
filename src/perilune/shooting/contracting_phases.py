"""Contracting phases (`PhaseExtremal.settles`): uncontrolled, with states that forget their initial values.

A fall through air ends at terminal speed, however it began: errors of its states shrink, by
exp(-90) on a parachute, and those of its costates, flown from start to end, grow by as much. So the states are flown
with the matrix Phi = dx/dx(0), which shrinks as they do, and the costates follow from the end:

    x' = f,   Phi' = f_x Phi,   Phi(0) = 1,   lambda(0) = Phi(T)^T lambda(T)

As curves costates are integrated in pieces, from starts that the Phi of each carries back from the end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from perilune.conditions import PhaseExtremal
from perilune.core import Matrix, Vector
from perilune.kernels import DenseArc
from perilune.shooting.propagate import Equations, arc_engine, mode_at, propagate_arc

MOST_STEPS = 1000  # a flight that ends at a site takes 50 to 500; one that takes more falls through the ground
_PIECES = 4  # of a phase at first
_MOST_GROWTH = 100.0  # of errors of costates in one piece
_SHORTEST = 1e-3  # of the phase


@dataclass(frozen=True, kw_only=True, eq=False)
class SettlingPhase:
    """A phase that settles, flown as z = (x, the rows of Phi that move, one behind the other).

    Attributes
    ----------
    equations
        Its equations; `kept` are the states.
    rows
        Which rows of Phi move: of a state without a rate it stays that of the unit matrix.
    """

    equations: Equations
    rows: tuple[int, ...]

    @property
    def seeds(self) -> Vector:
        """Return the entries after x where Phi is the unit matrix."""
        return np.eye(len(self.equations.kept))[list(self.rows)].ravel()

    def start(self, x: ca.SX) -> ca.SX:
        """Return z with Phi = 1."""
        return ca.vertcat(x, ca.SX(self.seeds))

    def transition(self, z: ca.SX) -> ca.SX:
        """Return Phi of z, (n, n)."""
        return _transition_of(z, len(self.equations.kept), self.rows)


def _transition_of(z: ca.SX, n: int, rows: tuple[int, ...]) -> ca.SX:
    matrix = ca.SX.eye(n)
    matrix[list(rows), :] = ca.reshape(z[n:], n, len(rows)).T
    return matrix


@lru_cache(maxsize=256)
def settling_equations(extremal: PhaseExtremal) -> SettlingPhase:
    """Derive the equations of a phase that settles."""
    n, numbers = extremal.half, extremal.modes[0].size1_in(1)
    x, p = ca.SX.sym("x", n), ca.SX.sym("p", numbers)
    still = ca.vertcat(x, ca.SX.zeros(n, 1))
    rates = [ca.simplify(mode(still, p)[:n]) for mode in extremal.modes]
    rows = tuple(i for i in range(n) if not all(rate[i].is_zero() for rate in rates))
    moved = ca.SX.sym("Phi", n * len(rows))
    z = ca.vertcat(x, moved)
    phi = _transition_of(z, n, rows)
    flows = [ca.vertcat(rate, ca.vec(ca.mtimes(ca.jacobian(rate, x), phi)[list(rows), :].T)) for rate in rates]
    crossings = [ca.simplify(event.function(still, p)) for event in extremal.events]
    used = ca.vertcat(*rates, *crossings)
    known = [i for i in range(numbers) if ca.depends_on(used, p[i])]
    flown = Equations(
        kept=np.arange(n),
        numbers=np.array(known, dtype=int),
        modes=tuple(ca.Function("rhs", [z, p[known]], [ca.cse(ca.densify(flow))]) for flow in flows),
        solved=(None,) * len(flows),
        switches=tuple(
            replace(event, function=ca.Function("S", [z, p[known]], [S]))
            for event, S in zip(extremal.events, crossings, strict=True)
        ),
    )
    return SettlingPhase(equations=flown, rows=rows)


def costate_error_growth(phi: Matrix) -> float:
    """Return how much errors of costates grow along a piece: norm of Phi^-1, inf where a state is lost in thick air.

    It is 0 where Phi is NaN, as shorter pieces do not help.
    """
    if not np.isfinite(phi).all():
        return 0.0
    least = float(np.linalg.norm(phi, -2))
    return 1.0 / least if least > 0.0 else np.inf


def propagate_settling_phase(
    extremal: PhaseExtremal, x: Vector, p: Vector, duration: float, end: Callable[[Vector], Vector], **settings: Any
) -> tuple[list[DenseArc], Vector]:
    """Propagate all of z along a phase that settles, and return its arcs with when each begins.

    Parameters
    ----------
    extremal
        Canonical equations of the phase.
    x
        States at the start, with the constant ones.
    p
        Numbers of the canonical equations.
    duration
        Duration of the phase, canonical.
    end
        x(T) -> lambda(T).
    """
    made, n = settling_equations(extremal), extremal.half
    flown = made.equations
    starts, begins, through = [np.asarray(x)], [0.0], list[Matrix]()
    length = duration / _PIECES
    while begins[-1] < duration:
        length = min(length, duration - begins[-1])
        mode = mode_at(extremal, np.concatenate([starts[-1], np.zeros(n)]), p)
        z = arc_engine(flown).propagate(
            np.concatenate([starts[-1], made.seeds]), p[flown.numbers], length, mode=np.array([mode]), **settings
        ).z[0]  # fmt: skip
        phi = np.eye(n)
        phi[list(made.rows)] = z[n:].reshape(len(made.rows), n)
        if costate_error_growth(phi) > _MOST_GROWTH and length > _SHORTEST * duration:
            length *= 0.5
            continue
        through.append(phi)
        starts.append(z[:n])
        begins.append(begins[-1] + length if length < duration - begins[-1] else duration)
        length *= 2.0
    lam = [end(starts[-1])]
    for phi in reversed(through):
        lam.append(phi.T @ lam[-1])
    pieces = zip(starts, reversed(lam[1:]), np.diff(begins), strict=False)
    arcs = [
        propagate_arc(extremal, np.concatenate([start, own]), p, float(each), **settings) for start, own, each in pieces
    ]
    return arcs, np.array(begins[:-1])
