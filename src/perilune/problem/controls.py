"""Kinds of controls: components, limits, admissible sets, and the regimes of the minimum of H on each.

A control has components, a unit, limits and a set of admissible values. A `UnitVectorControl` lives on the circle or
sphere, a `ScalarControl` on an interval. Arrays of controls have their components first, (components, ...), and may be
complex, as the proof differentiates by complex steps.

The minimum of H on each set is defined here too, by *regimes*: a direction is free on its sphere; a scalar is at
its lower or at its upper bound, or between them. `perilune.conditions.control_law` makes formulas of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from perilune.core import (
    Matrix,
    PeriluneError,
    Scales,
    Vector,
    check_call,
    check_operands,
    require_identifier,
    require_si_number,
    require_si_unit,
    wrong_type_error,
)

Regime = Literal["lower", "low_interior", "interior", "upper", "held", "direction", "singular"]
# A limit: a number in SI, or the name of the parameter that holds it.
Limit = float | str

_computing = check_operands(
    "arrays of NumPy whose first axis is the components, and the record p of all parameters, as solution.parameters",
    "limits", "box", "normalised", "admissible", "admissible_rates", "broken", "tangents", "samples", "example",
    "rough", "middle",
)  # fmt: skip

# Distances of the samples next to a value, in canonical units or radians.
_CLOSE = (-1e-1, -1e-2, -1e-3, -1e-4, 1e-4, 1e-3, 1e-2, 1e-1)


def limit_value(limit: Limit, p: Any) -> Any:
    """Return the value of a limit: the number itself, or the parameter of that name in the record p.

    Parameters
    ----------
    limit, p
        Number [SI] or name of a parameter, and the parameters [SI].
    """
    return getattr(p, limit) if isinstance(limit, str) else limit


def demand_limits(bounded: Any) -> None:
    """Refuse limits that are neither numbers nor names, None for none among them, where they are stated.

    Raises
    ------
    PeriluneError
        For the first.
    """
    for side in ("lower", "upper"):
        if not isinstance(limit := getattr(bounded, side), str):
            advice = f"omit {side} for no bound, or name the parameter that holds it"
            require_si_number(limit, f"the {side} bound of {bounded.name}", advice)


@check_call
@_computing
@dataclass(frozen=True, kw_only=True)
class UnitVectorControl:
    """A control that is a unit vector of two or three components, free on the circle or sphere."""

    names: tuple[str, ...]

    kind: ClassVar[str] = "direction"
    rule: ClassVar[str] = "cubic Hermite, then normalised"
    unit: ClassVar[str] = "1"
    bounded: ClassVar[bool] = False
    scalar: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if isinstance(self.names, str) or not isinstance(self.names, Sequence):
            raise wrong_type_error(
                self.names, '("toward_x", "toward_y", "toward_z"), or two of them', "names of components"
            )
        for name in self.names:
            require_identifier(name)
        if len(self.names) not in (2, 3):
            raise PeriluneError("a direction has two or three components", got=str(len(self.names)))

    @property
    def freedom(self) -> int:
        """The number of independent directions in which it can move."""
        return len(self.names) - 1

    def limits(self, p: Any) -> tuple[float, float]:
        """Return the limits of the components [1], which hold no direction back."""
        return -math.inf, math.inf

    def box(self, p: Any) -> tuple[float, float]:
        """Return the range of the components [1] for a search, which normalises afterwards."""
        return -1.0, 1.0

    def normalised(self, u: Any) -> Any:
        """Return the value with length 1, (components, ...); NaN where there is no direction at all."""
        with np.errstate(all="ignore"):
            return u / np.sqrt((u * u).sum(axis=0))

    def admissible(self, u: Any, p: Any) -> Any:
        """Return the nearest admissible value.

        Parameters
        ----------
        u, p
            Value, (components, ...), and parameters [SI], which are not needed.
        """
        return self.normalised(u)

    def admissible_rates(self, u: Any, good: Any, rates: Any) -> Any:
        """Return the rates of `admissible(u)`, which is `good`, from those of u.

        Parameters
        ----------
        u, good, rates
            Value, admissible value and rates of u [1/s], (components, ...) each.
        """
        return (rates - good * (good * rates).sum(axis=0)) / np.sqrt((u * u).sum(axis=0))

    def broken(self, u: Any, p: Any) -> Vector:
        """Return by how much a value leaves the set [1], (...).

        Parameters
        ----------
        u, p
            Value, (components, ...), and parameters [SI], which are not needed.
        """
        return np.abs(np.sqrt((u * u).sum(axis=0)) - 1)

    def tangents(self, u: Any, scale: float) -> list[Any]:
        """Return vectors (components, N) along which the value can move: a basis of the sphere's tangents.

        Parameters
        ----------
        u, scale
            Admissible value, (components, N), and its canonical unit, which is not needed.
        """
        if len(u) == 2:
            return [np.array([-u[1], u[0]])]
        axis = np.eye(3)[:, np.argmin(np.abs(u), axis=0)]
        first = np.cross(u, axis, axis=0)
        first = first / np.sqrt((first * first).sum(axis=0))
        return [first, np.cross(u, first, axis=0)]

    def samples(self, u: Matrix, scale: float, p: Any) -> list[Matrix]:
        """Return admissible values all over the set and close to u (components, N), which is the first.

        Parameters
        ----------
        u, scale, p
            Admissible value, (components, N); canonical unit and parameters are not needed.
        """
        if len(u) == 2:
            turns = [*_CLOSE, *(2 * np.pi * (k + 0.5) / 90 for k in range(90))]
            turned = [(np.cos(a), np.sin(a)) for a in turns]
            return [u, *(np.array([u[0] * c - u[1] * s, u[1] * c + u[0] * s]) for c, s in turned)]
        index = np.arange(200) + 0.5  # a Fibonacci lattice covers the sphere evenly
        z, longitude = 1 - index / 100, np.pi * (1 + 5**0.5) * index
        lattice = np.array([np.sqrt(1 - z * z) * np.cos(longitude), np.sqrt(1 - z * z) * np.sin(longitude), z])
        near = [self.normalised(u + c * axis[:, None]) for c in _CLOSE for axis in np.eye(3)]
        return [u, *near, *(v[:, None] * np.ones((1, u.shape[1])) for v in lattice.T)]

    def example(self, fractions: Iterator[float], p: Any, scale: float) -> list[float]:
        """Return some admissible value in SI, from numbers between 0 and 1.

        Parameters
        ----------
        fractions, p, scale
            Numbers between 0 and 1, one a component; parameters and canonical unit are not needed.
        """
        raw = [0.3 + next(fractions) for _ in self.names]
        return [r / math.hypot(*raw) for r in raw]

    def rough(self, u: Matrix, p: Any) -> Matrix:
        """Return an admissible value near u (components, N), as a first guess; the first axis where u says nothing.

        Parameters
        ----------
        u, p
            Any value, (components, N), and parameters [SI], which are not needed.
        """
        u = np.array(u)
        u[0, np.linalg.norm(u, axis=0) < 1e-9] = 1.0
        return self.normalised(u)

    def middle(self, p: Any) -> tuple[float, float]:
        """Return the middle of each component's range [1], and how far a first guess may go from there."""
        return 0.0, math.inf


@check_call
@_computing
@dataclass(frozen=True, kw_only=True)
class ScalarControl:
    """A scalar control between bounds, such as a throttle or an angle.

    `lower` and `upper` are numbers in SI, infinite ones allowed, or names of parameters that hold them, so that they
    may be swept or chosen.
    """

    name: str
    unit: str = "1"
    lower: Limit = -math.inf
    upper: Limit = math.inf

    kind: ClassVar[str] = "bounded"
    rule: ClassVar[str] = "cubic Hermite"
    scalar: ClassVar[bool] = True
    freedom: ClassVar[int] = 1

    def __post_init__(self) -> None:
        require_si_unit(self.unit, self.name)
        demand_limits(self)
        if not (isinstance(self.lower, str) or isinstance(self.upper, str) or self.lower <= self.upper):
            raise PeriluneError(
                f"bounds of control {self.name} are empty", got=f"[{self.lower:g}, {self.upper:g}] {self.unit}",
                expected="lower <= upper",
            )  # fmt: skip

    @property
    def names(self) -> tuple[str, ...]:
        """The one component."""
        return (self.name,)

    @property
    def bounded(self) -> bool:
        """Return True if both bounds are finite; one that a parameter holds is."""
        return all(isinstance(limit, str) or math.isfinite(limit) for limit in (self.lower, self.upper))

    def limits(self, p: Any) -> tuple[Any, Any]:
        """Return the bounds in SI, or in the units of the record p."""
        return limit_value(self.lower, p), limit_value(self.upper, p)

    def box(self, p: Any) -> tuple[float, float]:
        """Return the range [SI] for a search.

        Raises
        ------
        PeriluneError
            If a bound is infinite: there is nothing to draw from.
        """
        lower, upper = self.limits(p)
        if not math.isfinite(upper - lower):
            raise PeriluneError(
                f"a population is drawn from within bounds, and control {self.name} has none",
                got=f"[{lower}, {upper}]",
                expected="finite bounds",
                advice="bound it, or use only Pseudospectral()",
            )
        return lower, upper

    def normalised(self, u: Any) -> Any:
        """Return the value itself."""
        return u

    def admissible(self, u: Any, p: Any) -> Any:
        """Return the nearest value within the bounds.

        Parameters
        ----------
        u, p
            Value [SI], (...), and parameters [SI] with the bounds that are named.
        """
        return np.clip(u, *self.limits(p))

    def admissible_rates(self, u: Any, good: Any, rates: Any) -> Any:
        """Return the rates of `admissible(u)`, which is `good`, from those of u.

        Parameters
        ----------
        u, good, rates
            Value and admissible value [SI], and rates of u [SI/s], (...) each.
        """
        return np.where(good == u, rates, 0.0)

    def broken(self, u: Any, p: Any) -> Vector:
        """Return by how much a value leaves its bounds [SI], negative inside; NaN where the value is.

        Parameters
        ----------
        u, p
            Value [SI], (1, ...), and parameters [SI] with the bounds that are named.
        """
        lower, upper = self.limits(p)
        return np.maximum(lower - u[0], u[0] - upper) + 0.0 * u[0]

    def tangents(self, u: Any, scale: float) -> list[Any]:
        """Return the axis along which the value can move, (1, N), one canonical unit long.

        Parameters
        ----------
        u, scale
            Value [SI], (1, N), and SI size of the canonical unit.
        """
        return [np.full((1, u.shape[1]), scale)]

    def samples(self, u: Matrix, scale: float, p: Any) -> list[Matrix]:
        """Return admissible values all over the range and close to u (1, N), which is the first.

        Parameters
        ----------
        u, scale, p
            Value [SI], (1, N), SI size of the canonical unit, and parameters with the bounds that are named.
        """
        lower, upper = self.limits(p)
        near = [np.clip(u + scale * c, lower, upper) for c in _CLOSE]
        wide = np.linspace(max(lower, -10 * scale), min(upper, 10 * scale), 21)
        return [u, *near, *(v * np.ones((1, u.shape[1])) for v in wide)]

    def example(self, fractions: Iterator[float], p: Any, scale: float) -> list[float]:
        """Return some value within the bounds, in SI; bounds beyond one canonical unit `scale` do not count.

        Parameters
        ----------
        fractions, p, scale
            Numbers, which are not needed; parameters with the bounds; SI size of the canonical unit.
        """
        limits = self.limits(p)
        lower, upper = max(limits[0], -scale), min(limits[1], scale)
        return [lower + 0.4 * (upper - lower)]

    def rough(self, u: Matrix, p: Any) -> Matrix:
        """Return an admissible value near u, for a first guess.

        Parameters
        ----------
        u, p
            Any value [SI], (1, N), and parameters [SI] with the bounds that are named.
        """
        return self.admissible(u, p)

    def middle(self, p: Any) -> tuple[float, float]:
        """Return the middle of the range [SI], and how far a first guess may go from there."""
        lower, upper = self.limits(p)
        if math.isfinite(upper - lower):
            return 0.5 * (lower + upper), 0.4 * (upper - lower)
        return float(np.clip(0.0, lower, upper)), math.inf

    def share(self, u: Any, p: Any) -> Any:
        """Return the place within finite bounds, from 0 at the lower to 1 at the upper.

        Parameters
        ----------
        u, p
            Value [SI], (...), and parameters [SI] with the bounds that are named.
        """
        lower, upper = self.limits(p)
        return (u - lower) / (upper - lower)

    def on_bounds(self, u: Any, near: float, p: Any) -> tuple[Any, Any]:
        """Return whether a value lies on its lower, and on its upper bound, within `near` [SI].

        Parameters
        ----------
        u, near, p
            Value [SI], (...), distance that counts as none [SI], and parameters with the bounds that are named.
        """
        lower, upper = self.limits(p)
        return u <= lower + near, u >= upper - near


@dataclass(frozen=True, kw_only=True)
class Settled(ScalarControl):
    """A scalar control whose regime is known along its whole phase (`perilune.structures`).

    On its lower or its upper bound; or ``"singular"``, where H is linear in it and its slope dH/du vanishes all along.
    """

    regime: Literal["lower", "upper", "singular"]

    @property
    def bounded(self) -> bool:
        """Return True if it has a range to move in."""
        return self.regime == "singular" and super().bounded

    def limits(self, p: Any) -> tuple[Any, Any]:
        """Return the bounds in SI, or in the units of the record p: twice the one on which it lies."""
        lower, upper = super().limits(p)
        return {"lower": (lower, lower), "upper": (upper, upper), "singular": (lower, upper)}[self.regime]


Control = UnitVectorControl | ScalarControl


def control_slices(controls: Sequence[Control]) -> Iterator[tuple[slice, Control]]:
    """Yield each control with the slice of its components."""
    at = 0
    for control in controls:
        yield slice(at, at + len(control.names)), control
        at += len(control.names)


def scalars(controls: Sequence[Control]) -> Iterator[tuple[int, ScalarControl]]:
    """Yield each scalar with the place of its component."""
    for here, control in control_slices(controls):
        if isinstance(control, ScalarControl):
            yield here.start, control


def _each(controls: Sequence[Control], u: Any, change: Callable[[Control, slice, Any], Any]) -> Any:
    out = np.array(u)
    for here, control in control_slices(controls):
        out[here] = change(control, here, out[here])
    return out


def normalised(controls: Sequence[Control], u: Any) -> Any:
    """Return controls (components, ...) with every direction of length 1.

    Parameters
    ----------
    controls
        Controls of the phase.
    u
        Their components, (components, ...).
    """
    return _each(controls, u, lambda control, _, part: control.normalised(part))


def admissible(controls: Sequence[Control], u: Any, p: Any) -> Any:
    """Return controls with directions normalised and bounds held, which interpolation may leave a little.

    Parameters
    ----------
    controls
        Controls of the phase.
    u
        Their components, (components, ...) [SI].
    p
        Record of all parameters in SI.
    """
    return _each(controls, u, lambda control, _, part: control.admissible(part, p))


def admissible_rates(controls: Sequence[Control], u: Any, rates: Any, p: Any) -> tuple[Any, Any]:
    """Return `admissible` controls and their rates by the chain rule.

    Parameters
    ----------
    controls, u, p
        As for `admissible`.
    rates
        Rates of u, (components, ...) [SI/s].
    """
    good = admissible(controls, u, p)
    return good, _each(controls, rates, lambda control, here, part: control.admissible_rates(u[here], good[here], part))


def control_scales(controls: Sequence[Control], scales: Scales) -> Vector:
    """Return the SI size of the canonical unit of each component.

    Parameters
    ----------
    controls
        Controls of the phase.
    scales
        Canonical units.

    Returns
    -------
    Vector
        Sizes [SI], (components,).
    """
    return np.array([scales.of(control.unit) for control in controls for _ in control.names])


def tangents(controls: Sequence[Control], scales: Vector, u: Matrix) -> Any:
    """Return the directions in which controls can move: a sphere's tangents, a scalar's axis.

    Parameters
    ----------
    controls
        Controls of the phase.
    scales
        Sizes of their components, (components,); the axis of a scalar is one size long.
    u
        Controls, (components, N).

    Returns
    -------
    array
        Directions, (components, k, N).
    """
    columns = []
    for here, control in control_slices(controls):
        for vectors in control.tangents(u[here], float(scales[here.start])):
            column = np.zeros(u.shape)
            column[here] = vectors
            columns.append(column)
    return np.stack(columns, axis=1)


def directions(controls: Sequence[Control]) -> tuple[tuple[int, int], ...]:
    """Return the first and last place of the components of each direction."""
    return tuple((here.start, here.stop) for here, control in control_slices(controls) if not control.scalar)
