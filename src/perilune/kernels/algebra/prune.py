"""Algebra first: leave out what decouples before anything is compiled.

The sparsity of dz'/dz is a graph of who needs whom. What neither the wanted outputs nor the rates of what
they need depend on (downrange angle, a costate that only accumulates) is dropped; what never changes (the
costate of a cyclic coordinate) becomes a parameter, or a number where its value is known. The rest is the
same computation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from perilune.words.outcome import PeriluneError
from perilune.words.types import Matrix, Vector


class Curve(Protocol):
    """A flown arc: its nodes, and a function of time."""

    t: Vector
    z: Matrix

    def __call__(self, t: ArrayLike) -> Matrix:
        """Return z at times."""
        ...


@dataclass(frozen=True, kw_only=True)
class Pruned:
    """A right-hand side without what decouples.

    Attributes
    ----------
    rhs
        (z kept, p with the constants of motion appended) -> z' kept.
    kept, constant, dropped
        Which entries of the whole z are integrated, are carried as parameters, are left out.
    fixed
        Entries replaced by numbers.
    quadratures
        (whole z, p) -> z' of the whole, from which the dropped are recovered.
    """

    rhs: Any
    kept: tuple[int, ...]
    constant: tuple[int, ...]
    dropped: tuple[int, ...]
    fixed: Mapping[int, float]
    quadratures: Any

    def reduce(self, z: ArrayLike, p: ArrayLike) -> tuple[Matrix, Matrix]:
        """Return z kept (..., nk) and parameters (..., np + constants) from the whole (..., nz)."""
        whole, parameters = np.asarray(z, dtype=float), np.asarray(p, dtype=float)
        constants = whole[..., list(self.constant)]
        parameters = np.broadcast_to(parameters, (*constants.shape[:-1], parameters.shape[-1]))
        return whole[..., list(self.kept)], np.concatenate([parameters, constants], axis=-1)

    def restore(self, arc: Curve, start: ArrayLike, p: ArrayLike) -> Matrix:
        """Return whole z at the nodes of a flown arc, (nodes, nz), the dropped by quadrature along it.

        Parameters
        ----------
        arc
            The flight of z kept.
        start
            Whole z at its start, (nz,).
        p
            Parameters without the constants, (np,).

        Raises
        ------
        PeriluneError
            If the rate of a dropped entry depends on a dropped one that is not found before it; fly the whole
            z then.
        """
        whole = np.asarray(start, dtype=float)
        order = self._order()
        x, weights = np.polynomial.legendre.leggauss(8)
        lengths = np.diff(arc.t)
        times = arc.t[:-1, None] + lengths[:, None] * (x + 1) / 2  # (steps, 8)
        inner = np.tile(whole, (times.size, 1))
        inner[:, list(self.kept)] = arc(times.ravel())
        nodes = np.tile(whole, (len(arc.t), 1))
        nodes[:, list(self.kept)] = arc.z
        for entry in order:
            rate = self._rate(inner, p, entry).reshape(times.shape)
            nodes[1:, entry] = whole[entry] + np.cumsum(lengths / 2 * (rate @ weights))
            if any(entry in self._needs(other) for other in order):
                inner[:, entry] = self._inside(nodes[:-1, entry], lengths, rate, x).ravel()
        return nodes

    @staticmethod
    def _inside(base: Vector, lengths: Vector, rate: Matrix, x: Vector) -> Matrix:
        """Integrate the interpolating polynomial from the start of each piece to its inner points."""
        basis = np.linalg.inv(np.vander(x, increasing=True))
        powers = np.arange(1, len(x) + 1)
        integral = (x[:, None] ** powers - (-1.0) ** powers) / powers  # from -1 to x of s^(k-1)
        return base[:, None] + lengths[:, None] / 2 * (rate @ (integral @ basis).T)

    def _rate(self, z: Matrix, p: ArrayLike, entry: int) -> Vector:
        count = len(z)
        parameters = np.tile(np.asarray(p, dtype=float)[:, None], (1, count))
        return np.asarray(self.quadratures.map(count)(z.T, parameters))[entry]

    def _needs(self, entry: int) -> set[int]:
        return _dependence(self.quadratures)[entry] & set(self.dropped)

    def _order(self) -> list[int]:
        order: list[int] = []
        pending = list(self.dropped)
        while pending:
            free = [entry for entry in pending if self._needs(entry) <= set(order)]
            if not free:
                raise PeriluneError(
                    "dropped entries depend on one another and are no plain quadratures",
                    got=str(pending),
                    advice="fly the whole z once to have them",
                )
            order += free
            pending = [entry for entry in pending if entry not in free]
        return order


def prune(rhs: Any, outputs: Iterable[int] | Sequence[Any], *, fixed: Mapping[int, float] | None = None) -> Pruned:
    """Drop from z what the outputs do not need.

    Parameters
    ----------
    rhs
        SX ``casadi.Function`` (z, p) -> z'.
    outputs
        Entries of z that are wanted at the end, or SX functions (z, p) -> something wanted (boundary
        conditions, events).
    fixed
        Constants of motion with a known value, by entry (the costate of a free cyclic coordinate is 0).

    Raises
    ------
    PeriluneError
        If a fixed entry is not a constant of motion.
    """
    import casadi as ca

    known = dict(fixed or {})
    z, p = ca.SX.sym("z", rhs.size1_in(0)), ca.SX.sym("p", rhs.size1_in(1))
    whole = z
    for entry, value in known.items():
        whole = ca.substitute(whole, z[entry], value)
    rate = ca.densify(rhs(whole, p))
    steady = {i for i in range(rate.numel()) if rate[i].is_constant() and float(rate[i]) == 0.0}
    if not known.keys() <= steady:
        raise PeriluneError(
            "a fixed entry of z is not a constant of motion",
            got=str(sorted(known.keys() - steady)),
            expected=f"among {sorted(steady)}",
            advice="fix only what has rate zero",
        )
    substituted = ca.Function("whole", [z, p], [rate])
    needs = _dependence(substituted)
    wanted = _wanted(outputs, z, p)
    while True:
        grown = wanted.union(*(needs[i] for i in wanted))
        if grown == wanted:
            break
        wanted = grown
    kept = tuple(sorted(wanted - steady))
    constant = tuple(sorted((wanted & steady) - known.keys()))
    dropped = tuple(i for i in range(z.numel()) if i not in kept and i not in constant and i not in steady)
    parameters = ca.vertcat(p, *(z[i] for i in constant))
    reduced = ca.Function(
        "pruned", [ca.vertcat(*(z[i] for i in kept)), parameters], [ca.vertcat(*(rate[i] for i in kept))]
    )
    return Pruned(rhs=reduced, kept=kept, constant=constant, dropped=dropped, fixed=known, quadratures=substituted)


def _dependence(function: Any) -> list[set[int]]:
    """Which entries of z each rate depends on."""
    import casadi as ca

    z, p = ca.SX.sym("z", function.size1_in(0)), ca.SX.sym("p", function.size1_in(1))
    rows, columns = ca.jacobian(function(z, p), z).sparsity().get_triplet()
    found: list[set[int]] = [set() for _ in range(z.numel())]
    for row, column in zip(rows, columns, strict=True):
        found[row].add(column)
    return found


def _wanted(outputs: Iterable[Any], z: Any, p: Any) -> set[int]:
    import casadi as ca

    wanted: set[int] = set()
    for output in outputs:
        if isinstance(output, (int, np.integer)):
            wanted.add(int(output))
        else:
            wanted |= set(ca.jacobian(ca.vec(output(z, p)), z).sparsity().get_triplet()[1])
    return wanted
