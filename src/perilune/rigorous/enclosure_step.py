"""Enclosed flow of an arc, step by step: Taylor polynomials with a remainder that is proved.

On a step [0, h] let Z be balls around the range of the polynomial P of order n - 1, a little wider, and z_n(Z) the
Taylor coefficient of order n that the equations give for every start in Z. If

    P([0, h]) + z_n(Z) [0, h^n]  lies in the interior of Z,

then every solution that begins where P does stays in Z, and z(h) lies in P(h) + z_n(Z) h^n (Corliss, Rihm, *Validating
an a priori enclosure using high-order Taylor series*, 1996). The same holds for its tangents V' = F'(z) V,
whose polynomials follow from the coefficients of F'(z), to a lower order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb, arb_mat, ctx

from perilune.core import PeriluneError
from perilune.rigorous.equations import CanonicalArc
from perilune.rigorous.taylor import Ball, Coefficients

_WIDER = 2.0**-20  # by so much of its size Z is wider than the range of P; radii have 30 bits
_NARROW = 80  # bits for coefficients over Z, whose radii are far above the rounding
_ATTEMPTS = 4
_OF_TANGENTS = 20  # order of theirs, at most: contraction needs no more digits of them
_LEAST = 1e-60  # SI: it is wider by this where it is zero


class NotEnclosed(PeriluneError):
    """A step whose enclosure could not be proved."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EnclosedStep:
    """A step that is proved.

    Attributes
    ----------
    begin, length
        Time from the begin of the arc, and how long [s].
    polynomial, remainder
        Of each component: coefficients of orders 0 to n - 1, and that of order n over the whole step.
    tangents
        The same of V, in fewer orders, the remainder the last; none where they were not flown.
    """

    begin: Ball
    length: Ball
    polynomial: list[Coefficients]
    remainder: list[Ball]
    tangents: list[Any]

    def at(self, since: Ball) -> list[Ball]:
        """z at a time, or over an interval of times, since the step began."""
        order = len(self.polynomial[0])
        return [
            _enclose_over(c, since) + last * since**order
            for c, last in zip(self.polynomial, self.remainder, strict=True)
        ]


def taylor_orders(arc: CanonicalArc, z: Sequence[Ball], V: Any, orders: int) -> tuple[list[Coefficients], list[Any]]:
    """Taylor coefficients of orders 0 to `orders` of state and costate; of tangents, where there are any, fewer.

    Parameters
    ----------
    arc
        Canonical equations of the arc.
    z
        State and costate where the series begin, balls.
    V
        Tangents there, ``arb_mat`` with a row for each component of z; None for none.
    orders
        Order of the last coefficient.

    Returns
    -------
    coefficients, tangents
        For each component of z its coefficients; for each order a matrix, up to `_OF_TANGENTS`.
    """
    inputs, m = arc.plain.flow(z, orders)[0], min(orders, _OF_TANGENTS)
    return inputs, [] if V is None else tangents_along(arc, arc.slopes.along(inputs, m), V, m)


def tangents_along(arc: CanonicalArc, slopes: Sequence[Coefficients], V: Any, orders: int) -> list[Any]:
    """Taylor coefficients of tangents, orders 0 to `orders`, from those of the derivatives of the rates.

    Parameters
    ----------
    arc
        Canonical equations of the arc.
    slopes
        Taylor coefficients of the nonzero entries of F'(z), in the order of `arc.pattern`.
    V
        Tangents at the start, ``arb_mat`` with a row for each component of z.
    orders
        Order of the last coefficient.
    """
    size, matrices = len(arc.rates), []
    for k in range(orders):
        A = arb_mat(size, size)
        for place, c in zip(arc.pattern, slopes, strict=True):
            A[place] = c[k]
        matrices.append(A)
    tangents = [V]
    for k in range(orders):
        total = matrices[0] * tangents[k]
        for j in range(1, k + 1):
            total += matrices[j] * tangents[k - j]
        tangents.append(total * (1 / arb(k + 1)))
    return tangents


def _remainders(
    arc: CanonicalArc, Z: Sequence[Ball], W: Any, order: int, order_of_tangents: int
) -> tuple[list[Ball], Any]:
    """Return the last coefficients over a whole step, only by recurrences: in wide balls they are the narrowest."""
    with ctx.workprec(_NARROW):
        remainder = [c[order] for c in arc.plain.flow(Z, order)[0]]
        if W is None:
            return remainder, None
        slopes = arc.with_slopes.flow(Z, order_of_tangents)[1][len(Z) :]
        return remainder, tangents_along(arc, slopes, W, order_of_tangents)[order_of_tangents]


def enclose_step(
    arc: CanonicalArc, z: Sequence[Ball], V: Any, begin: Ball, length: Ball, order: int
) -> tuple[list[Ball], Any, EnclosedStep]:
    """Make one proved step.

    Parameters
    ----------
    arc
        The equations.
    z, V
        Balls at its begin; V may be None.
    begin, length
        When it begins in its arc, and how long it is: a ball.
    order
        Of the remainder, n.

    Returns
    -------
    z and V at its end, and the step.

    Raises
    ------
    NotEnclosed
        If the inclusion fails.
    """
    polynomial, _ = taylor_orders(arc, z, None, order - 1)
    m = min(order, _OF_TANGENTS)
    tangents = [] if V is None else tangents_along(arc, arc.slopes.along(polynomial, m - 1), V, m - 1)
    span = arb(0).union(length)
    reach, reach_of_tangents = arb(0).union(length**order), arb(0).union(length**m)
    ranges = [horner_value(c, span) for c in polynomial]
    tangent_range = None if V is None else horner_value(tangents, span)
    still = [rate.vanishes() for rate in arc.rates]
    wider = [max(_ball_size(r) * _WIDER, _LEAST) for r in ranges]
    tangent_wider = [max(size * _WIDER, _LEAST) for size in _entry_sizes(tangent_range)]
    for _ in range(_ATTEMPTS):
        Z = [r if s else r + arb(0, w) for r, w, s in zip(ranges, wider, still, strict=True)]
        W = None if V is None else _widened(tangent_range, tangent_wider)
        remainder, last = _remainders(arc, Z, W, order, m)
        left = [r * reach for r in remainder]
        inside = [s or whole.contains_interior(r + e)
                  for whole, r, e, s in zip(Z, ranges, left, still, strict=True)]  # fmt: skip
        moved = None if V is None else last * reach_of_tangents
        tangent_inside = [
            whole.contains_interior(r + e)
            for whole, r, e in zip(_entries(W), _entries(tangent_range), _entries(moved), strict=True)
        ]
        if all(inside) and all(tangent_inside):
            end = [horner_value(c, length) + r * length**order for c, r in zip(polynomial, remainder, strict=True)]
            V_end = None if V is None else horner_value(tangents, length) + last * length**m
            proved = EnclosedStep(begin=begin, length=length, polynomial=polynomial, remainder=remainder,
                          tangents=[] if V is None else [*tangents, last])  # fmt: skip
            return end, V_end, proved
        wider = [max(w, 4 * _ball_size(e)) for w, e in zip(wider, left, strict=True)]
        tangent_wider = [max(w, 4 * _ball_size(e)) for w, e in zip(tangent_wider, _entries(moved), strict=True)]
    raise NotEnclosed(
        f"a step of {arc.phase.name} is not enclosed",
        got=f"at {float(begin.mid()):.6g} s, {float(length.mid()):.3g} s long",
    )


def horner_value(c: Sequence[Any], t: Ball) -> Any:
    """A polynomial with numbers or matrices for coefficients, lowest order first.

    Parameters
    ----------
    c
        Coefficients, at least one.
    t
        Argument, a ball.
    """
    total = c[-1]
    for k in range(len(c) - 2, -1, -1):
        total = total * t + c[k]
    return total


def _enclose_over(c: Coefficients, t: Ball) -> Ball:
    """A polynomial over an interval, by its slope there: narrower than its terms together."""
    middle = t.mid()
    slope = horner_value([k * own for k, own in enumerate(c)][1:] or [arb(0)], t)
    return horner_value(c, middle) + slope * (t - middle)


def _ball_size(ball: Ball) -> float:
    return float(ball.abs_upper()) if ball.is_finite() else float("inf")


def _entry_sizes(matrix: Any) -> list[float]:
    """About how large each entry may become, whatever units its row and its column have."""
    if matrix is None:
        return []
    rows = [[_ball_size(entry) for entry in row] for row in matrix.tolist()]
    largest = [max(row, default=0.0) for row in rows]
    shares = [max((row[j] / most for row, most in zip(rows, largest, strict=True) if most), default=0.0)
              for j in range(matrix.ncols())]  # fmt: skip
    return [most * share for most in largest for share in shares]


def _entries(matrix: Any) -> list[Ball]:
    return [] if matrix is None else matrix.entries()


def _widened(matrix: Any, by: Sequence[float]) -> Any:
    entries = [r + arb(0, w) for r, w in zip(matrix.entries(), by, strict=True)]
    return arb_mat(matrix.nrows(), matrix.ncols(), entries)
