"""Regimes of scalar controls, which of them may go together, and the curvature of H from bound to bound."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import casadi as ca
import numpy as np

from perilune.core import PeriluneError
from perilune.problem import Phase, Regime, ScalarControl, Settled, scalars

_WIDEST = 5.0  # an open range is searched at sinh of -5 to 5, canonical
_CONVEX_AT = 401  # values at which a known curvature is evaluated
_BETWEEN_BOUNDS = (0.21, 0.5, 0.83)  # of a range: where the curvature of H is evaluated
_ROUNDED_BEND = 1e-9  # of the terms of H: a curvature below this is none
_STATIONARY = 1e-6  # of the terms of H: its slope over the range, where Newton's method has found a minimum
_APART = 1e-3  # of its range: a minimum so near to a bound comes to it without a jump
_WIDE = 2 * np.pi * (1 + 1e-6)  # a range of more has room for each direction between its bounds
_DRAWS = 5  # points at which an expression is compared with itself a turn later
_MET = 1e-6  # canonical: a control so near to an active condition keeps it, and Newton's method has found it

# A minimum of H between the bounds; where H is quartic it may have two, the low one with d3H/du3 < 0.
INSIDE: tuple[Regime, ...] = ("low_interior", "interior")
FREE: tuple[Regime, ...] = (*INSIDE, "held")  # not on a bound
_NO_COSTATES = ca.SX(0, 1)


@dataclass(frozen=True, kw_only=True)
class Terms:
    """Sizes and signs that are known of the terms of H.

    Attributes
    ----------
    size
        The sum of their amounts, an expression of the controls.
    positive
        Costates that are a positive number on every extremal, a column of symbols.
    """

    size: ca.SX
    positive: ca.SX


class Scalar:
    """A scalar control with the slope S of H in it, directions in place.

    Attributes
    ----------
    regimes
        Regimes that it may have; for one that `acts` in an active condition not each is in a mode (`combinations`).
    linear
        Whether H is linear in it.
    weighed
        Whether its bounds are compared by the value of H: it has two, H bends in it only, and in which way the
        costates say. Of those that bend H together only the slopes are compared.
    curved_both_ways
        Whether H may be convex here and concave there within its range, so that a minimum between the bounds may be
        one of several, and the control may jump between it and a bound.
    quartic
        Whether it may then have two minima between its bounds: it is a polynomial of the fourth degree.
    periodic
        Whether it is an angle: a whole turn changes nothing.
    wide
        Whether it is one with room for more than a turn, so that no bound is reached.
    """

    def __init__(
        self, phase: Phase, at: int, control: ScalarControl, H: ca.SX, u: ca.SX, limits: tuple[ca.SX, ca.SX],
        *, acts: bool, positive: ca.SX = _NO_COSTATES, periodic: bool = False,
    ) -> None:  # fmt: skip
        self.at, self.control, self.limits, self.symbol, self.periodic = at, control, limits, u[at], periodic
        self.wide = limits[1] - limits[0] > _WIDE if periodic else ca.SX(0.0)
        self.slope = ca.gradient(H, u[at])
        self.linear = not ca.depends_on(self.slope, u[at])
        bend = ca.gradient(self.slope, u[at])
        known = ca.substitute(bend, positive, ca.SX.ones(positive.numel()))
        convex = _never_negative(known, u[at])
        others = ca.vertcat(ca.SX(0, 1), *(u[i] for i, _ in scalars(phase.controls) if i != at))
        alone = not (others.numel() and ca.depends_on(self.slope, others))
        self.weighed = control.bounded and alone and not (self.linear or convex)
        self.curved_both_ways = self.weighed and bool(ca.depends_on(bend, u[at]))
        self.third = ca.gradient(bend, u[at])
        bends_alike = not ca.depends_on(ca.gradient(self.third, u[at]), u[at])
        self.quartic = self.curved_both_ways and bool(ca.depends_on(self.third, u[at])) and bends_alike
        if isinstance(control, Settled):
            if control.regime == "singular" and not self.linear:
                raise no_control_law_error(
                    phase, control.names, "a Hamiltonian that is nonlinear in it, and so no singular arc"
                )
            self.regimes: tuple[Regime, ...] = (control.regime,)
            return
        lower, upper = (not (limit.is_constant() and np.isinf(float(limit))) for limit in limits)
        if self.linear and not acts and not (lower and upper):
            raise no_control_law_error(phase, control.names, "a Hamiltonian that is linear in it, and no bounds")
        inside: tuple[Regime, ...] = INSIDE if self.quartic else ("interior",)
        between: tuple[Regime, ...] = ("held",) if acts else () if self.linear else inside
        self.regimes = (*(("lower",) if lower else ()), *between, *(("upper",) if upper else ()))

    def value(self, regime: Regime) -> ca.SX:
        """Return the control at a bound; of a singular one its symbol."""
        return self.symbol if regime == "singular" else self.limits[regime == "upper"]

    def grid(self, count: int) -> list[ca.SX]:
        """Return values over its range, canonical."""
        lower, upper = self.limits
        if self.periodic:
            middle, half = self._middle_turn()
            return [middle + share * half for share in np.linspace(-1.0, 1.0, count)]
        if self.control.bounded:
            return [lower + share * (upper - lower) for share in np.linspace(0.0, 1.0, count)]
        return [ca.SX(value) for value in np.sinh(np.linspace(-_WIDEST, _WIDEST, count))]

    def _middle_turn(self) -> tuple[ca.SX, ca.SX]:
        """Return the middle of the range of an angle, or 0, and half of what is there of a turn."""
        lower, upper = self.limits
        if self.control.bounded:
            return 0.5 * (lower + upper), ca.fmin(0.5 * (upper - lower), np.pi)
        return ca.fmin(ca.fmax(lower + np.pi, 0.0), upper - np.pi), ca.SX(np.pi)


def is_periodic(control: ScalarControl, u: ca.SX, expressions: ca.SX) -> bool:
    """Return True if no expression of a scalar u distinguishes values a whole turn apart.

    Parameters
    ----------
    control
        Scalar control; only one with the unit rad or 1 can be an angle.
    u
        Symbol of the scalar [rad].
    expressions
        Expressions in which it may stand, a column.
    """
    if isinstance(control, Settled) or control.unit not in ("1", "rad") or not ca.depends_on(expressions, u):
        return False
    return _is_zero(ca.substitute(expressions, u, u + 2 * np.pi) - expressions, ca.fabs(expressions))


def is_factor(factor: ca.SX, expression: ca.SX) -> bool:
    """Return True if an expression is proportional to a symbol, as the pull of an angle is to the thrust it points.

    Parameters
    ----------
    factor
        Symbol that may be a factor.
    expression
        Expression of it and of other symbols.
    """
    if not ca.depends_on(expression, factor) or ca.depends_on(ca.gradient(expression, factor), factor):
        return False
    left = ca.substitute(expression, factor, 0.0)
    return _is_zero(left, ca.fabs(ca.substitute(expression, factor, 1.0)))


def _is_zero(expression: ca.SX, size: ca.SX) -> bool:
    """Return True if an expression vanishes to rounding wherever it is looked at; not where it is NaN."""
    symbols, draw = ca.symvar(ca.vertcat(expression, size)), np.random.default_rng(1)
    both = ca.Function("both", symbols, [expression, size])
    for _ in range(_DRAWS):
        here, terms = (e.full() for e in both(*draw.uniform(0.2, 2.0, len(symbols))))
        if not (np.abs(here) <= 1e-9 * (1.0 + terms)).all():
            return False
    return True


def _never_negative(bend: ca.SX, u: ca.SX) -> bool:
    """Return True if a second derivative of H that depends on u only is positive, except where it vanishes."""
    if bend.is_constant():
        return float(bend) > 0
    if any(not ca.is_equal(symbol, u) for symbol in ca.symvar(bend)):
        return False
    values = ca.Function("bend", [u], [bend])(np.sinh(np.linspace(-_WIDEST, _WIDEST, _CONVEX_AT))[None]).full()
    return bool((values >= 0).all() and (values > 0).any())


class Bend:
    """The curvature of H in a scalar from bound to bound, the others as a mode has them.

    Attributes
    ----------
    gain
        H at the upper less H at the lower bound.
    none
        Whether it is a straight line except for rounding: then there is no minimum between the bounds.
    hollow
        Whether H is less somewhere between than at either bound.
    points, values
        By regime where H may be least, and H there: the bounds, and the minima `inner` between them.
    there
        By regime whether a point between the bounds is a minimum.
    """

    def __init__(
        self, *, kind: Scalar, H: ca.SX, u: ca.SX, control: ca.SX, size: ca.SX, inner: Mapping[Regime, ca.SX]
    ) -> None:
        def at(value: ca.SX, of: ca.SX = H) -> ca.SX:
            moved = ca.SX(control)
            moved[kind.at] = value
            return ca.substitute(of, u, moved)

        (low, high), terms = (at(limit) for limit in kind.limits), ca.substitute(size, u, control)
        self.gain, least = high - low, ca.fmin(low, high)
        self.none, self.hollow, rounding = ca.SX(1.0), ca.SX(0.0), _ROUNDED_BEND * terms
        (first, last), self.points = kind.limits, dict[Regime, ca.SX](zip(("lower", "upper"), kind.limits, strict=True))
        self.span = last - first
        for share in _BETWEEN_BOUNDS:
            here = at(first + share * self.span)
            self.none = ca.logic_and(self.none, ca.fabs(here - low - share * self.gain) <= rounding)
            self.hollow = ca.logic_or(self.hollow, here < least - rounding)
        self.values: dict[Regime, ca.SX] = {"lower": low, "upper": high}
        self.there, self.apart = dict[Regime, ca.SX](), ca.logic_not(kind.wide)
        self.hollow = ca.SX(0.0) if inner else self.hollow
        for regime, value in inner.items():
            flat = ca.fabs(at(value, kind.slope)) * self.span <= _STATIONARY * terms
            minimum = ca.logic_and(flat, at(value, ca.gradient(kind.slope, kind.symbol)) > 0)
            if kind.quartic:
                low_one = at(value, kind.third) < 0
                minimum = ca.logic_and(minimum, low_one if regime == "low_interior" else ca.logic_not(low_one))
            self.there[regime] = ca.logic_and(minimum, ca.logic_and(first < value, value < last))
            self.points[regime], self.values[regime] = value, at(value)
            self.hollow = ca.logic_or(self.hollow, ca.logic_and(self.there[regime], self.values[regime] < least))

    def drop(self, one: Regime, other: Regime) -> tuple[ca.SX, ca.SX]:
        """Return whether a jump from one minimum of H or bound to another is one, and by how much H is less there.

        Parameters
        ----------
        one, other
            Regimes: the jump goes from the minimum of H in `one` to that in `other`.
        """
        both = ca.logic_and(ca.fabs(self.points[one] - self.points[other]) > _APART * self.span, self.apart)
        for regime in (one, other):
            both = ca.logic_and(both, self.there.get(regime, ca.SX(1.0)))
        return both, self.values[one] - self.values[other]


def combinations(kinds: Sequence[Scalar], held: Sequence[ca.SX]) -> Iterator[tuple[Regime, ...]]:
    """Yield regimes of all scalars that may go together: each condition that is held has a scalar to hold it.

    Parameters
    ----------
    kinds
        All scalars of the phase, with the regimes that each may have.
    held
        Active conditions, expressions of the scalars.
    """
    for regimes in product(*(kind.regimes for kind in kinds)):
        symbols = [kind.symbol for kind, regime in zip(kinds, regimes, strict=True) if regime == "held"]
        if pivots(symbols, held) is not None:
            yield regimes


def pivots(symbols: Sequence[ca.SX], held: Sequence[ca.SX]) -> list[int] | None:
    """Assign to each condition a scalar that holds it, each another one; None where there are not enough.

    Parameters
    ----------
    symbols
        Symbols of the scalars.
    held
        Conditions of these scalars.

    Returns
    -------
    list or None
        For each condition the place of its scalar.
    """
    if not held:
        return []
    for i, symbol in enumerate(symbols):
        if ca.depends_on(held[0], symbol):
            rest = pivots([*symbols[:i], *symbols[i + 1 :]], held[1:])
            if rest is not None:
                return [i, *(j + (j >= i) for j in rest)]
    return None


def least_squares_multipliers(H: ca.SX, u: ca.SX, held: ca.SX) -> ca.SX:
    """Return mu of conditions that are held by scalars u, by least squares: exact where H is least.

    Parameters
    ----------
    H, u
        The Hamiltonian as an expression of the symbols u of the scalars.
    held
        Conditions of u that are held, a column.

    Returns
    -------
    casadi.SX
        One multiplier for each condition.
    """
    C = ca.jacobian(held, u)
    return ca.solve(ca.mtimes(C, C.T), ca.mtimes(C, ca.gradient(H, u)))


def satisfies_conditions(told: ca.SX, held: ca.SX, u: ca.SX, control: ca.SX) -> ca.SX:
    """Return an expression that is true where a control holds conditions by these scalars.

    It is false where Newton's method has not found one that does.

    Parameters
    ----------
    told
        Symbols of the scalars that hold the conditions.
    held
        Conditions, zero where they are held.
    u, control
        Symbols of all controls, and the values in their place.
    """
    near = ca.fabs(held) <= _MET * ca.sum2(ca.fabs(ca.jacobian(held, told)))
    return ca.substitute(ca.logic_all(near), u, control)


def no_control_law_error(phase: Phase, names: tuple[str, ...], got: str) -> PeriluneError:
    """Return the error that says why a control's minimum of H is not known.

    Parameters
    ----------
    phase
        Phase of the controls.
    names
        Names of the controls.
    got
        The reason, for the message.
    """
    return PeriluneError(
        f"the indirect method has no control law for {', '.join(names)} of {phase.name}",
        got=got,
        expected="a direction or a bounded scalar that enters linearly, or a scalar in which the Hamiltonian is"
        " strictly convex",
        advice="use the direct method: solve(problem, Pseudospectral())",
    )
