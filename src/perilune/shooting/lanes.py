"""A boundary value problem for many starts, held values and given parameters at once: Newton in lanes.

For problems of one phase without switches, which is where thousands are asked for: starts on the unit sphere, members
of a family, dispersed ignition points. What a lane finds is a root like any other; a lane that fails says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.conditions.pontryagin import Conditions
from perilune.kernels.batch import BatchShooter
from perilune.shooting.propagate import equations
from perilune.words.types import Matrix, Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Lanes:
    """Shooting of `conditions` in lanes, with free parameter `index` held (None: all free).

    Use `lanes`. `active` are the unknowns that are not silent.
    """

    shooter: BatchShooter
    active: NDArray[np.int64]
    size: int

    def solve(self, Y: Matrix, p: Matrix, held: Vector) -> tuple[Matrix, NDArray[np.bool_]]:
        """Newton in every lane.

        Parameters
        ----------
        Y
            First guesses, (lanes, unknowns), canonical.
        p
            Given parameters, (lanes, np) or (np,).
        held
            Value of the held parameter in each lane, (lanes,); not used where none is held.

        Returns
        -------
        Y, converged
            Shapes (lanes, unknowns), (lanes,).
        """
        count = len(Y)
        numbers = np.column_stack([np.broadcast_to(p, (count, np.shape(p)[-1])), held])
        shots = self.shooter.solve(Y[:, self.active], numbers, tolerance=1e-11)
        found = np.zeros((count, self.size))
        found[:, self.active] = shots.y
        return found, shots.converged


@lru_cache(maxsize=64)
def lanes(conditions: Conditions, index: int | None) -> Lanes | None:
    """Compile the lanes of a boundary value problem; None for several phases or switched controls."""
    extremal = conditions.phases[0]
    mode = extremal.modes[0]
    start, needed, silent_entries = conditions.starts[0], conditions.needed[0], conditions.silent[0]
    if len(conditions.phases) > 1 or len(extremal.modes) > 1:
        return None
    size, silent = len(conditions.unknowns), {unknown for _, unknown in conditions.silent_rows}
    active = [i for i in range(size) if i not in silent]
    rows = [i for i in range(size) if i not in {row for row, _ in conditions.silent_rows}]
    flown = equations(extremal, needed, silent_entries)
    kept = flown.kept.tolist()
    numbers = mode.size1_in(1)
    y, p = ca.SX.sym("y", len(active)), ca.SX.sym("p", numbers + 1)
    z = ca.SX.sym("z", len(kept))
    whole_y, whole_z = ca.SX.zeros(size, 1), ca.SX.zeros(mode.size1_in(0), 1)
    whole_y[active], whole_z[kept] = y, z
    z0, duration = start(whole_y, ca.SX(0, 1), p[:numbers])[:2]
    residual = conditions.residual(whole_y, whole_z, p[:numbers])[0]
    if index is not None:
        residual[conditions.stationarity_at.start + index] = whole_y[conditions.free_at.start + index] - p[numbers]
    rhs = ca.Function("rhs", [z, p], [flown.modes[0](z, p[flown.numbers.tolist()])])
    shooter = BatchShooter(
        rhs,
        ca.Function("start", [y, p], [z0[kept], duration]),
        ca.Function("residual", [y, z, p], [ca.simplify(residual[rows])]),
    )
    return Lanes(shooter=shooter, active=np.array(active), size=size)
