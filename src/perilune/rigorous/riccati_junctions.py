"""Riccati junctions between phases: how W, the least second variation of the phases before, passes them.

What follows begins at l(v): v are the free parameters at the start, and state and constant states at the end of the
phase before, where psi = 0. With K the second derivative of lambda . l + nu . psi, lambda the costate behind it, and
W- = 0 at the start, the second variation of what lies before is no less than dv' (K - W-) dv. So it is no less than

    -dx' W dx = min of [|dx - l_v dv|^2_M + dv' (K - W-) dv]  over dv in the kernel of psi_v

for all dx = l_v dv and any weights M, where what is minimised is strictly convex. With a basis N of the kernel,
G = l_v N and C = N' (K - W-) N this is W = M G (G' M G + C)^-1 G' M - M. Of K - W- what l passes on may be negative: it
is weighed against all that follows. What l drops, as the mass of an empty stage, has to be positive by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import mul
from typing import Any

import numpy as np
from flint import arb, arb_mat

from perilune.rigorous.enclosure import ball_identity
from perilune.rigorous.enclosure_step import EnclosedStep
from perilune.rigorous.equations import Key
from perilune.rigorous.graph import Graph, GraphExpression
from perilune.rigorous.hamiltonian_minimum import positive_definite
from perilune.rigorous.taylor import Ball, TaylorProgram

_MORE = 1 + 1e-12  # times what doubles give for a sum, which is never less than that then


class Junction:
    """A junction.

    Parameters
    ----------
    graph
        Of all expressions.
    inputs, varied
        What the expressions depend on, and which of it is v.
    follows
        l; nothing at the last end.
    lagrangian
        lambda . l + nu . psi, and J at the last end.
    psi
        What vanishes there.
    """

    def __init__(
        self, graph: Graph, inputs: Sequence[Key], varied: Sequence[Key], follows: Sequence[GraphExpression],
        lagrangian: GraphExpression, psi: Sequence[GraphExpression],
    ) -> None:  # fmt: skip
        hessian = graph.jacobian(graph.gradient(lagrangian, varied), varied)
        self._shapes = [(len(follows), len(varied)), (len(varied), len(varied)), (len(psi), len(varied))]
        rows = [*graph.jacobian(follows, varied), *hessian, *graph.jacobian(psi, varied)]
        self._follows = TaylorProgram(graph, inputs, follows)
        self._slopes = TaylorProgram(graph, inputs, [e for row in rows for e in row])

    def follows(self, values: Sequence[Ball]) -> list[Ball]:
        """l."""
        return self._follows.values(values)

    def form(self, values: Sequence[Ball], W: Any, weights: Sequence[float]) -> tuple[Any, Any]:
        """G and C, where W comes from before; None at the start. Weights are those of v.

        Parameters
        ----------
        values
            Values of `inputs`, balls [SI].
        W
            Matrix of the phase before, ``arb_mat`` of the size of v; None at the start.
        weights
            Positive weights of the components of v.
        """
        found, matrices = self._slopes.values(values), []
        for rows, columns in self._shapes:
            matrices.append(arb_mat(rows, columns, found[: rows * columns]))
            found = found[rows * columns :]
        G, C, normals = matrices
        N = exact_kernel(normals, weights)
        return G * N, N.transpose() * (C if W is None else C - W) * N


def pass_junction(G: Any, C: Any, weights: Sequence[float]) -> Any:
    """An exact W behind a junction; None where the weights do not outweigh what is negative.

    Parameters
    ----------
    G, C
        Matrices of the junction, ``arb_mat``, as `Junction.form` returns them.
    weights
        Positive weights M of the states behind the junction, its diagonal.
    """
    size = len(weights)
    M = arb_mat([[arb(w) if i == j else arb(0) for j in range(size)] for i, w in enumerate(weights)])
    core = G.transpose() * M * G + C
    if not positive_definite(core):
        return None
    if not core.nrows():
        return upper_bound_matrix(M * -1, weights)
    return upper_bound_matrix(M * G * core.inv() * G.transpose() * M - M, weights)


def upper_bound_matrix(W: Any, weights: Sequence[float]) -> Any:
    """An exact symmetric matrix, hardly larger than W in balls: what lies before stays no less than -dx' W dx.

    Parameters
    ----------
    W
        Symmetric ``arb_mat``, balls.
    weights
        Positive weights of the components, by which they are scaled.
    """
    size, middle = W.nrows(), W.mid()
    found = arb_mat(size, size)
    for i in range(size):
        for j in range(i + 1):
            found[i, j] = found[j, i] = ((middle[i, j] + middle[j, i]) * arb(0.5)).mid()
    gap = found - W
    units = [weight**-0.5 for weight in weights]
    for i in range(size):  # their difference is diagonally dominant, in units of one size
        most = sum(float((gap[i, j] + gap[j, i]).abs_upper()) * units[j] for j in range(size)) / units[i]
        found[i, i] = (found[i, i] + arb(most) * arb(_MORE) + arb(weights[i]) * arb(1e-30)).upper()
    return found


def exact_kernel(normals: Any, weights: Sequence[float]) -> Any:
    """A basis of the kernel of a matrix, as columns.

    Parameters
    ----------
    normals
        ``arb_mat`` whose rows span what the kernel is normal to; independent rows.
    weights
        Positive weights of the columns, by which pivots are compared.
    """
    half = len(weights)
    if not normals.nrows():
        return ball_identity(half)
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


_DEEPEST = 16  # halvings of a step


def first_irregular_time(proved: EnclosedStep, half: int) -> Ball | None:
    """A time at which X is not seen to be regular; None where it is all along the step.

    Parameters
    ----------
    proved
        Step of an arc with its tangents.
    half
        Number of rows of X, the upper half of the tangents: states and constant states.
    """
    order, waiting = len(proved.tangents) - 1, [(0.0, 1.0, 0)]
    *polynomial, last = (arb_mat(own.tolist()[:half]) for own in proved.tangents)
    while waiting:
        a, b, depth = waiting.pop()
        middle, away = proved.length * arb(0.5 * (a + b)), proved.length * arb(0.5 * (b - a))
        missing = last * (proved.length * arb(a).union(arb(b))) ** order
        if _is_regular_about(_shifted_coefficients(polynomial, middle), missing, away.abs_upper()):
            continue
        if depth == _DEEPEST:
            return proved.begin + middle
        waiting += [(a, 0.5 * (a + b), depth + 1), (0.5 * (a + b), b, depth + 1)]
    return None


def _shifted_coefficients(polynomial: Sequence[Any], middle: Ball) -> list[Any]:
    """The coefficients of a polynomial about another time."""
    c = list(polynomial)
    for i in range(len(c) - 1):
        for k in range(len(c) - 2, i - 1, -1):
            c[k] = c[k] + c[k + 1] * middle
    return c


def _is_regular_about(c: Sequence[Any], missing: Any, away: Ball) -> bool:
    """Return True if X = sum of c[k] s^k + missing is regular for all |s| <= away.

    X C = 1 + E with C about the inverse of its centre. From this side, and for each coefficient by itself, E is as
    small as what the control does, though X is nearly singular: costates may grow together without moving anything.
    |E|^k 1 < 1 in every row makes 1 + E regular, whatever units its rows have.
    """
    try:
        inverse = c[0].mid().inv().mid()
    except ZeroDivisionError:
        return False
    size = inverse.nrows()
    unit = ball_identity(size)
    parts = [(c[0] + missing) * inverse - unit, *(own * inverse * away**k for k, own in enumerate(c[1:], start=1))]
    E = [sum(entry.abs_upper() for entry in entries) for entries in zip(*(p.entries() for p in parts), strict=True)]
    sums = [arb(1)] * size
    for _ in range(size):
        sums = [sum(map(mul, E[i * size : (i + 1) * size], sums)) for i in range(size)]
        if all(total < 1 for total in sums):
            return True
    return False
