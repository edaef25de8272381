"""Steps of a flight in balls: Taylor polynomials by Picard's iteration in power series, with their remainder."""

import math
from typing import Any

from flint import arb, arb_mat, arb_series, ctx

from perilune_checker.expressions import CertifiedProgram, Failed, StepTooLong, require_claim

ORDER, WIDER, LEAST = 34, 2.0**-20, 1e-60  # of the series; what encloses a step is wider by a part and that


def unit_matrix(size: int) -> Any:
    """The unit matrix."""
    return arb_mat([[int(a == b) for b in range(size)] for a in range(size)]) if size else arb_mat(0, 0)


def evaluate_polynomial(c: list[Any], t: Any) -> Any:
    """A polynomial, lowest order first.

    Parameters
    ----------
    c
        Coefficients, at least one.
    t
        Argument, a ball.
    """
    total = c[-1]
    for own in c[-2::-1]:
        total = total * t + own
    return total


def ball_power(t: Any, n: int) -> Any:
    """t^n, of balls about 0 too, of which FLINT's own is none.

    Parameters
    ----------
    t
        The base, a ball.
    n
        The exponent, a whole number >= 0.
    """
    return math.prod([t] * n, start=arb(1))


def polynomial_over_interval(c: list[Any], t: Any) -> Any:
    """A polynomial over an interval, by its slope there; its last coefficient is a ball that holds the remainder.

    Parameters
    ----------
    c
        Coefficients, lowest order first.
    t
        The interval, as a ball.
    """
    slope = evaluate_polynomial([k * own for k, own in enumerate(c[:-1])][1:], t)
    return evaluate_polynomial(c[:-1], t.mid()) + slope * (t - t.mid()) + c[-1] * ball_power(t, len(c) - 1)


def series_coefficients(series: Any, count: int) -> list[Any]:
    """Coefficients of a series that is known far enough, or of a constant.

    Parameters
    ----------
    series
        Power series of balls, or a number.
    count
        Number of coefficients wanted, from order 0 up.

    Raises
    ------
    Failed
        If the series is shorter.
    """
    if not isinstance(series, arb_series):
        return [arb(series), *[arb(0)] * (count - 1)]
    require_claim(series.prec >= count, "a series is shorter than its use")  # it has cut something off
    return [*(c := series.coeffs()[:count]), *[arb(0)] * (count - len(c))]


def taylor_coefficients(rates: CertifiedProgram, z: list[Any], V: Any, orders: int, *others: Any) -> list[list[Any]]:
    """The Taylor coefficients of z with z' = rates(z, others), and of the entries of the tangents V if it has any.

    Parameters
    ----------
    rates
        Program of z', with its derivatives by z.
    z
        Balls where the series begin, n of them.
    V
        Tangents there, ``arb_mat`` of shape (n, m); m = 0 for none.
    orders
        Order of the last coefficient.
    *others
        Constant arguments of the rates.

    Returns
    -------
    list
        Coefficients of orders 0 to `orders` of each component of z, then of each entry of V, row by row.
    """
    found, size = [[v] for v in z], len(z)
    for k in range(orders):
        ctx.cap = k + 1
        moved = rates([arb_series(own, k + 1) for own in found], *others)
        found = [[*own, series_coefficients(rate, k + 1)[k] / (k + 1)] for own, rate in zip(found, moved, strict=True)]
    if not V.ncols():
        return found
    ctx.cap = orders
    series = [arb_series(own[:orders], orders) for own in found]
    slopes = [series_coefficients(d, orders) for d in rates.slopes[0](series, *others)]
    A, T = [arb_mat(size, size, [*own]) for own in zip(*slopes, strict=True)], [V]
    for k in range(orders):
        T.append(sum((A[j] * T[k - j] for j in range(k + 1)), arb_mat(size, V.ncols())) * (1 / arb(k + 1)))
    return found + [[*own] for own in zip(*(t.entries() for t in T), strict=True)]


def certified_step(
    rates: CertifiedProgram, z: list[Any], V: Any, length: Any, *others: Any
) -> tuple[list[Any], Any, list[list[Any]]]:
    """z and V behind a step, and all their polynomials: what moves within `whole` of `ranges` cannot leave it.

    Parameters
    ----------
    rates
        Program of z', with its derivatives by z.
    z
        Balls where the step begins, n of them.
    V
        Tangents there, ``arb_mat`` of shape (n, m); m = 0 for none.
    length
        Duration of the step, a ball.
    *others
        Constant arguments of the rates.

    Raises
    ------
    StepTooLong
        If the step is not enclosed.
    """
    n, size, span = ORDER, len(z), arb(0).union(length)
    c = taylor_coefficients(rates, z, V, n - 1, *others)
    ranges = [evaluate_polynomial(own, span) for own in c]
    sizes = [float(own.abs_upper()) for own in ranges]
    sizes[size:] = [max(sizes[size:], default=0.0)] * (len(c) - size)
    whole = [own + arb(0, WIDER * wide + LEAST) for own, wide in zip(ranges, sizes, strict=True)]
    try:
        last = [
            own[n]
            for own in taylor_coefficients(rates, whole[:size], arb_mat(size, V.ncols(), whole[size:]), n, *others)
        ]
    except (Failed, ZeroDivisionError) as error:  # of balls too wide to divide by
        raise StepTooLong("a step is not enclosed") from error
    reach = arb(0).union(ball_power(length, n))
    held = [w.contains_interior(r + top * reach) for w, r, top in zip(whole, ranges, last, strict=True)]
    require_claim(all(held), "a step is not enclosed", StepTooLong)
    c = [[*own, top] for own, top in zip(c, last, strict=True)]
    end = [evaluate_polynomial(own, length) for own in c]
    return end[:size], arb_mat(size, V.ncols(), end[size:]), c
