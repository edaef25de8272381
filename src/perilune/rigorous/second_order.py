"""Sufficient conditions of the second order, enclosed: the extremal is a strict local optimum.

Every free parameter, the duration too, is made a constant state, and time runs from 0 to 1. Let W be symmetric with
W' = -H_xx - W f_x - f_x' W + (H_xu + W f_u) H_uu^-1 (H_ux + f_u' W) on all of [0, 1]. Then the second variation is

    dx(1)' (Phi_xx - W(1)) dx(1) + dx(0)' W(0) dx(0) + dp' K dp + int |du + ...|^2_H_uu dt,    K = (lambda(0) . x0)_pp,

for all variations with dx(0) = x0_p dp and psi_x dx(1) = 0. With W(0) = -min of [|dx0 - x0_p dp|^2_M + dp' K dp] over
dp, for any weights M, the terms at the start are together no less than 0. So it suffices that H_uu > 0 (`limits`), that
W exists, and that Phi_xx - W(1) is positive on the kernel of psi_x (Zeidan, *Sufficient conditions for the generalized
problem of Bolza*, 1983; Maurer, Pickenhain, *Second-order sufficient conditions for control problems with mixed
control-state constraints*, 1995). W = Lambda X^-1 with the tangents (X, Lambda) of the canonical equations that begin
with (1, W(0)); it exists as long as X is regular. As X begins with 1, nothing is singular at the start; large M come as
close as one likes to the condition that no point is conjugate to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import mul
from typing import Any

import numpy as np
from flint import arb, arb_mat

from perilune.rigorous.boundary import BoundaryProblem, Differentiated
from perilune.rigorous.equations import Arc, Reader
from perilune.rigorous.flight import Grid, identity
from perilune.rigorous.flow import NotEnclosed, Step, step
from perilune.rigorous.given import exactly
from perilune.rigorous.limits import Statement
from perilune.rigorous.minimum import positive_definite
from perilune.rigorous.taylor import Ball, Program

WORDS = "a strict local optimum"
_WEIGHTS = (1e2, 1e4, 1e6)  # times the size of J over the square of that of a state
_DEEPEST = 10  # halvings of a step


def local_optimum(
    boundary: BoundaryProblem,
    y: Sequence[Ball],
    grid: Grid,
    order: int,
    sizes: Sequence[float],
    tell: Callable[[str], None],
) -> Statement:
    """Whether a proved extremal is a strict local optimum.

    Parameters
    ----------
    boundary, y
        The equations and their root.
    grid, order
        Of its flight.
    sizes
        About how large the states are.
    tell
        Is told of every part.
    """
    first = next(iter(boundary.arcs))
    if len(boundary.arcs) > 1 or any(scalar.regime != "interior" for scalar in first.scalars):
        return Statement(words=WORDS, proved=False, where="as the flight has several arcs, or a scalar on its bound")
    if first.joint:
        return Statement(words=WORDS, proved=False, where="as no formula gives its control")
    if boundary.sides.free or boundary.sides.ranges:
        return Statement(words=WORDS, proved=False, where="as a parameter is on its bound, or an end is a range")
    where = ""
    form = _Form(boundary, y)
    for weight in _WEIGHTS:
        try:
            where = form.fails(grid, order, form.weights(weight, sizes))
        except (NotEnclosed, ZeroDivisionError) as error:
            where = f"as {error.what}" if isinstance(error, NotEnclosed) else "as a matrix is singular"
        tell(f"second variation, weight {weight:.0e}: {where or 'positive'}")
        if not where:
            return Statement(words=WORDS, proved=True)
    return Statement(words=WORDS, proved=False, where=where)


class _Form:
    """The second variation of one phase."""

    def __init__(self, boundary: BoundaryProblem, y: Sequence[Ball]) -> None:
        problem, piece = boundary.problem, boundary.pieces[0]
        reader = Reader(problem)
        graph, phase = reader.graph, problem.phases[0]
        self.arc: Arc = reader.arc(0, piece.regimes, whole=True)
        half, n = self.arc.half, len(phase.states)
        named = dict(zip(boundary.names, y, strict=True))
        costates = list(y[:n])  # not by name: a free parameter may be called as a state is
        self.free = [named[name] for name in problem.free_names]
        free = {name: graph.input(("p", name)) for name in problem.free_names}
        keys = [("p", name) for name in problem.free_names]
        start = reader.function("start", free=free)
        lam = [graph.input(("lam", i)) for i in range(n)]
        slopes = graph.gradient(sum((a * b for a, b in zip(lam, start, strict=True)), graph.constant(0)), keys)
        begin = Differentiated(graph, [*start, *free.values()], [keys])
        x0, (self.moved,) = begin.slopes(self.free)
        curvature = Differentiated(graph, slopes, [keys, [("lam", i) for i in range(n)]])
        self.curved = curvature.slopes(self.free, costates)[1][0]
        self.z = [*x0, *costates, *([arb(0)] * (half - n))]
        z = [graph.input(("z", i)) for i in range(half)]
        at_end = dict(zip(problem.free_names, z[n:], strict=True))
        psi = reader.function((0, "end"), z, free=at_end, phase=phase) if phase.end_conditions else []
        nu = [named[f"{phase.name}.nu_{c.name}"] for c in phase.end_conditions]
        phi = reader.function("objective", z, free=at_end, phase=phase)[0]
        inputs = [("z", i) for i in range(half)]
        for i, value in enumerate(psi):
            phi = phi + graph.input(("nu", i)) * value
        hessian = graph.jacobian(graph.gradient(phi, inputs), inputs)
        normals = graph.jacobian(psi, inputs)
        flat = [e for rows in (hessian, normals) for row in rows for e in row]
        self._end = Program(graph, [*inputs, *(("nu", i) for i in range(len(psi)))], flat)
        self._nu, self._count = nu, len(psi)
        self.duration = named.get(phase.duration, exactly(problem.given[phase.duration]).ball()
                                  if phase.duration in problem.given else arb(0))  # fmt: skip

    def weights(self, weight: float, sizes: Sequence[float]) -> list[float]:
        """M of each state: as much as moving by its size would cost, by its costate, times the weight."""
        costs = [abs(float(c)) * s for c, s in zip(self.z[self.arc.half :], sizes, strict=False)]
        together = max(costs) or 1.0
        every = [*sizes, *(max(abs(float(value)), 1e-3) for value in self.free)]
        return [weight * together / (size * size) for size in every]

    def fails(self, grid: Grid, order: int, weights: Sequence[float]) -> str:
        """Where a condition is not enclosed, in words; "" where all are."""
        half = self.arc.half
        M = arb_mat([[arb(w) if i == j else arb(0) for j in range(half)] for i, w in enumerate(weights)])
        core = self.moved.transpose() * M * self.moved + self.curved
        if not positive_definite(core):
            return "as the weights do not outweigh the curvature of the start"
        if core.nrows():
            W = M * self.moved * core.inv() * self.moved.transpose() * M - M
        else:
            W = M * -1
        W = _above(W, weights)
        # Columns of one size, in exact numbers: X has another factor, and the same W.
        unit = arb_mat([[arb(weights[i] ** -0.5) if i == j else arb(0) for j in range(half)] for i in range(half)])
        V = arb_mat(unit.tolist() + (W * unit).tolist())
        z, whole = list(self.z), float(self.duration)
        begins = [begin / whole for begin in grid[0]]
        for number, begin in enumerate(begins):
            end = arb(1) if number + 1 == len(begins) else arb(begins[number + 1])
            z, V, proved = step(self.arc, z, V, arb(begin), end - arb(begin), order)
            if (t := _irregular(proved, half)) is not None:
                return f"as no solution of Riccati's equation is enclosed at {t * whole:.6g} s"
        rows = V.tolist()
        W = arb_mat(rows[half:]) * arb_mat(rows[:half]).inv()
        values = self._end.values([*z[:half], *self._nu])
        hessian = arb_mat(half, half, values[: half * half])
        form = hessian - (W + W.transpose()) * arb(0.5)
        kernel = _kernel(arb_mat(self._count, half, values[half * half :]) if self._count else None, weights)
        return (
            ""
            if positive_definite(kernel.transpose() * form * kernel)
            else "as the second variation is not seen to be positive at the end"
        )


def _above(W: Any, weights: Sequence[float]) -> Any:
    """An exact symmetric matrix, hardly larger than W in balls: the terms at the start stay no less than 0."""
    size, middle = W.nrows(), W.mid()
    found = arb_mat(size, size)
    for i in range(size):
        for j in range(i + 1):
            found[i, j] = found[j, i] = ((middle[i, j] + middle[j, i]) * arb(0.5)).mid()
    gap = found - W
    for i in range(size):  # their difference is diagonally dominant
        most = sum(float((gap[i, j] + gap[j, i]).abs_upper()) for j in range(size))
        found[i, i] = (found[i, i] + arb(most) + arb(weights[i]) * arb(1e-30)).mid()
    return found


def _irregular(proved: Step, half: int) -> float | None:
    """A time at which X is not seen to be regular; None where it is all along the step."""
    order, waiting = len(proved.tangents) - 1, [(0.0, 1.0, 0)]
    *polynomial, last = (arb_mat(own.tolist()[:half]) for own in proved.tangents)
    while waiting:
        a, b, depth = waiting.pop()
        middle, away = proved.length * arb(0.5 * (a + b)), proved.length * arb(0.5 * (b - a))
        missing = last * (proved.length * arb(a).union(arb(b))) ** order
        if _regular(_about(polynomial, middle), missing, away.abs_upper()):
            continue
        if depth == _DEEPEST:
            return float((proved.begin + middle).mid())
        waiting += [(a, 0.5 * (a + b), depth + 1), (0.5 * (a + b), b, depth + 1)]
    return None


def _about(polynomial: Sequence[Any], middle: Ball) -> list[Any]:
    """The coefficients of a polynomial about another time."""
    c = list(polynomial)
    for i in range(len(c) - 1):
        for k in range(len(c) - 2, i - 1, -1):
            c[k] = c[k] + c[k + 1] * middle
    return c


def _regular(c: Sequence[Any], missing: Any, away: Ball) -> bool:
    """Whether X = sum of c[k] s^k + missing is regular for all |s| <= away.

    X C = 1 + E with C about the inverse of its centre. From this side, and for each coefficient by itself, E is as
    small as what the control does, though X is nearly singular: costates may grow together without moving anything.
    |E|^k 1 < 1 in every row makes 1 + E regular, whatever units its rows have.
    """
    try:
        inverse = c[0].mid().inv().mid()
    except ZeroDivisionError:
        return False
    size = inverse.nrows()
    unit = identity(size)
    parts = [(c[0] + missing) * inverse - unit, *(own * inverse * away**k for k, own in enumerate(c[1:], start=1))]
    E = [sum(entry.abs_upper() for entry in entries) for entries in zip(*(p.entries() for p in parts), strict=True)]
    sums = [arb(1)] * size
    for _ in range(size):
        sums = [sum(map(mul, E[i * size : (i + 1) * size], sums)) for i in range(size)]
        if all(total < 1 for total in sums):
            return True
    return False


def _kernel(normals: Any, weights: Sequence[float]) -> Any:
    """A basis of the kernel of a matrix, as columns."""
    half = len(weights)
    if normals is None:
        return identity(half)
    count, chosen = normals.nrows(), list[int]()
    scaled = np.array([[float(normals[i, j].mid()) / weights[j] ** 0.5 for j in range(half)] for i in range(count)])
    for _ in range(count):  # the largest pivot of what is left
        sizes = [0.0 if j in chosen else float(np.linalg.norm(scaled[:, j])) for j in range(half)]
        chosen.append(int(np.argmax(sizes)))
        unit = scaled[:, chosen[-1]] / sizes[chosen[-1]]
        scaled = scaled - np.outer(unit, unit @ scaled)
    others = [j for j in range(half) if j not in chosen]
    inner = arb_mat([[normals[i, j] for j in chosen] for i in range(count)])
    rest = arb_mat([[normals[i, j] for j in others] for i in range(count)]) if others else arb_mat(count, 0)
    solved = inner.inv() * rest
    found = arb_mat(half, len(others))
    for column, j in enumerate(others):
        found[j, column] = 1
        for row, i in enumerate(chosen):
            found[i, column] = -solved[row, column]
    return found
