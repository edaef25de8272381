"""The shooting function of a boundary value problem and its Jacobian by the state-transition matrix.

Entries of z on which no condition depends are not flown; a costate that vanishes on every extremal has the condition
that it vanishes in place of its flight.

Single shooting as in Cho et al. 2015 (20)-(24): fly every phase from its start, evaluate the residual at the ends.
With several segments to a phase, the states at the joints are further unknowns and continuity is a further residual
(multiple shooting), for arcs on which errors grow too much.

The derivative of an arc's end by all unknowns is carried from arc to arc: S(T) dz0 + z'(T) dT.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from perilune.kernels.mapped import compile_map
from perilune.pontryagin import Conditions
from perilune.propagate import engine, equations, flight
from perilune.rootfind import Root, Watch, damped_newton
from perilune.types import Matrix, Vector


@lru_cache(maxsize=128)
def _compiled(function: ca.Function) -> Callable[..., list[Matrix]]:
    """The function as machine code: arguments as vectors, its outputs as dense matrices."""
    symbols = [ca.SX.sym(f"a{i}", function.size1_in(i)) for i in range(function.n_in())]
    outputs = function.call(symbols)
    shapes = [tuple(o.shape) for o in outputs]
    kept = [i for i, size in enumerate(function.size1_in(i) for i in range(function.n_in())) if size]
    flat = ca.vertcat(*[ca.vec(ca.densify(o).T) for o in outputs])  # row by row, as NumPy reads them
    mapped = compile_map(ca.Function("flat", [symbols[i] for i in kept], [flat]))
    cuts = np.cumsum([rows * columns for rows, columns in shapes])[:-1]

    def call(*arguments: Vector) -> list[Matrix]:
        values = mapped(*[arguments[i] for i in kept])[0]
        return [part.reshape(shape) for part, shape in zip(np.split(values, cuts), shapes, strict=True)]

    return call


class Shooting:
    """Shooting function of `conditions` over Y = (y, states at the joints).

    Parameters
    ----------
    conditions
        The boundary value problem.
    segments
        Arcs for each phase; 1 is single shooting.
    rtol
        Tolerance of the arcs.

    Attributes
    ----------
    arcs
        How many arcs were flown so far.
    """

    def __init__(self, conditions: Conditions, segments: int = 1, rtol: float = 1e-12) -> None:
        self.conditions, self.segments, self.rtol, self.arcs = conditions, segments, rtol, 0
        self._size = len(conditions.unknowns)

    def __call__(self, Y: Vector, p: Vector, held: Mapping[int, float], jacobian: bool = True) -> tuple[Vector, Matrix]:
        """Residual and Jacobian.

        Parameters
        ----------
        Y
            Unknowns, canonical.
        p
            Given parameters, canonical.
        held
            Free parameters (by index) held at a value: their stationarity row is replaced by ``q - value``.
        jacobian
            Without it the Jacobian is empty.

        Returns
        -------
        residual, jacobian
            NaN where an arc could not be flown.
        """
        flown = self._fly(Y, p, jacobian)
        total = len(Y)
        if flown is None:
            return np.full(total, np.nan), np.full((total, total), np.nan)
        ends, end_jacobians, gaps, gap_jacobians = flown
        y = Y[: self._size]
        h, h_y, h_z = _compiled(self.conditions.residual)(y, np.concatenate(ends), p)
        h = h.ravel()
        J = np.zeros((0, 0))
        if jacobian:
            J = h_z @ np.vstack(end_jacobians)
            J[:, : self._size] += h_y
        for index, value in held.items():
            row = self.conditions.stationarity_at.start + index
            h[row] = y[self.conditions.free_at.start + index] - value
            if jacobian:
                J[row] = 0.0
                J[row, self.conditions.free_at.start + index] = 1.0
        for row, index in self.conditions.silent_rows:
            h[row] = y[index]
            if jacobian:
                J[row] = 0.0
                J[row, index] = 1.0
        if gaps:
            h = np.concatenate([h, *gaps])
            J = np.vstack([J, *gap_jacobians]) if jacobian else J
        return h, J

    def root(
        self, Y: Vector, p: Vector, held: Mapping[int, float], watch: Watch | None = None, **settings: Any
    ) -> Root:
        """Damped Newton from Y, with the free parameters `held` at exactly their values."""
        at = self.conditions.free_at.start
        Y = np.array(Y, dtype=float)
        for index, value in held.items():
            Y[at + index] = value
        root = damped_newton(lambda y, jacobian: self(y, p, held, jacobian), Y, watch=watch, **settings)
        for index, value in held.items():
            root.y[at + index] = value  # Newton leaves the last bit of it
        return root

    def stationarity(self, Y: Vector, p: Vector) -> Vector:
        """dJ/dq of each free parameter q along the family of extremals, canonical, held or not."""
        return self(Y, p, {}, jacobian=False)[0][self.conditions.stationarity_at]

    def ends(self, y: Vector, p: Vector) -> list[Vector]:
        """Canonical z at the end of each phase, flown from y; NaN where an arc is lost."""
        flown = self._fly(y, p, False)
        return flown[0] if flown is not None else [np.full(2 * e.half, np.nan) for e in self.conditions.phases]

    def joints(self, y: Vector, p: Vector) -> Vector | None:
        """Y for this number of segments from y alone: the states at the joints are those of a flight in one piece."""
        before, nodes = np.zeros(0), [y]
        for k, start in enumerate(self.conditions.starts):
            z0, duration = (out.ravel() for out in _compiled(start)(y, before, p)[:2])
            extremal = self.conditions.phases[k]
            curve = flight(extremal, z0, p, float(duration[0]))
            at = curve(np.linspace(0.0, float(duration[0]), self.segments + 1))
            if not np.all(np.isfinite(at)):
                return None
            nodes.extend(at[1:-1])
            before = at[-1]
        return np.concatenate(nodes)

    def _fly(self, Y: Vector, p: Vector, jacobian: bool):
        y, total = Y[: self._size], len(Y)
        ends, end_jacobians, gaps, gap_jacobians = [], [], [], []
        z, dz, at = np.zeros(0), np.zeros((0, total)), self._size
        for k, start in enumerate(self.conditions.starts):
            z0, duration, z0_y, z0_before, T_y = _compiled(start)(y, z, p)
            z0 = z0.ravel()
            T, dT = float(duration[0, 0]) / self.segments, np.zeros(total)
            dT[: self._size] = T_y.ravel() / self.segments
            dz = z0_before @ dz
            dz[:, : self._size] += z0_y
            z = z0
            for j in range(self.segments):
                if j:
                    node, selector = Y[at : at + len(z)], np.zeros((len(z), total))
                    selector[:, at : at + len(z)] = np.eye(len(z))
                    at += len(z)
                    gaps.append(z - node)
                    gap_jacobians.append(dz - selector)
                    z, dz = node, selector
                end = self._arc(k, z, dz, T, dT, p, jacobian)
                if end is None:
                    return None
                z, dz = end
            ends.append(z)
            end_jacobians.append(dz)
        return ends, end_jacobians, gaps, gap_jacobians

    def _arc(self, phase: int, z: Vector, dz: Matrix, T: float, dT: Vector, p: Vector, jacobian: bool):
        """End of an arc and its derivative by all unknowns, or None."""
        if not (np.all(np.isfinite(z)) and np.isfinite(T)):
            return None
        extremal = self.conditions.phases[phase]
        flown = equations(extremal, self.conditions.needed[phase], self.conditions.silent[phase])
        kept = flown.kept
        moving = np.nonzero(np.any(dz[kept] != 0.0, axis=0))[0] if jacobian else np.zeros(0, dtype=int)
        arc = engine(flown, len(moving)).propagate(
            z[kept],
            p[flown.numbers],
            T,
            dz[np.ix_(kept, moving)] if jacobian else None,
            rtol=self.rtol,
            atol=self.rtol,
            mode=extremal.mode(z, p),
        )
        self.arcs += 1
        if not arc.succeeded[0]:
            return None
        end, out = np.zeros_like(z), np.zeros_like(dz)
        end[kept] = arc.z[0]
        if jacobian:
            out[np.ix_(kept, moving)] = arc.columns[0]
            out[kept] += np.outer(_compiled(flown.modes[int(arc.mode[0])])(arc.z[0], p[flown.numbers])[0], dT)
        return end, out
