"""Curves between the nodes of a table, and the trajectory of one phase."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from perilune.core import Matrix, PeriluneError, RenamedAttribute, Vector, check_call, require_numbers
from perilune.problem.display.reprs import ShownCurve, ShownTrajectory
from perilune.problem.results.equality import equal_fields

_TIMES = "a time at which to evaluate a curve"
_ROUNDING = 1e-9  # of a curve's length: by so much a time may lie beyond its ends


@check_call
@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Curve(ShownCurve):
    """A vector function of time: values and rates at nodes, cubic Hermite between them. Its arrays are read-only.

    Parameters
    ----------
    time
        Nodes [s], shape (n,), increasing.
    values, rates
        Shape (n, k), in SI and SI per second.
    """

    time: Vector
    values: Matrix
    rates: Matrix

    def __post_init__(self) -> None:
        for name in ("time", "values", "rates"):
            object.__setattr__(self, name, read_only_array(getattr(self, name)))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Curve) and equal_fields(self, other))

    def __hash__(self) -> int:
        return hash((self.values.shape, self.time.shape))

    @check_call
    def __call__(self, t: float | Vector) -> Any:
        """Return the value at times t [s]: shape (k,) for a number, (len(t), k) for an array.

        Raises
        ------
        PeriluneError
            If a time lies outside the curve by more than 1e-9 of its length, or is NaN.
        """
        t = require_numbers(t, _TIMES, most=1)
        first, last = self.time[0], self.time[-1]
        slack = _ROUNDING * (last - first)
        # A curve whose nodes are not numbers has no ends to compare with: its values are NaN, which a proof will see.
        if np.any(outside := (np.less(t, first - slack) | np.greater(t, last + slack) | np.isnan(t))):
            raise PeriluneError(
                "the curve is asked outside its time",
                got=f"{np.asarray(t)[outside].flat[0]:.9g} s",
                expected=f"{first:.9g} to {last:.9g} s",
                advice="each phase has its own time, which begins at 0 with the phase",
            )
        return self.extrapolate(t)

    @check_call
    def extrapolate(self, t: float | Vector) -> Any:
        """Return the extrapolated value: before the first and after the last node their cubics continue.

        For a proof, which has to look at tables that end where they should not.

        Raises
        ------
        PeriluneError
            If these are no times.
        """
        at = np.atleast_1d(require_numbers(t, _TIMES, most=1))
        i = np.minimum(np.maximum(self.time.searchsorted(at, side="right") - 1, 0), len(self.time) - 2)
        h = self.time[i + 1] - self.time[i]
        # A last piece without length, as of an arc shorter than rounding, is its end.
        s = np.divide(at - self.time[i], h, out=np.ones_like(at), where=h != 0)[:, None]
        h = h[:, None]
        left, right = self.values[i], self.values[i + 1]
        slope_left, slope_right = self.rates[i] * h, self.rates[i + 1] * h
        jump = right - left
        out = left + s * (
            slope_left + s * (3 * jump - 2 * slope_left - slope_right + s * (slope_left + slope_right - 2 * jump))
        )
        return out if np.ndim(t) else out[0]

    extended: ClassVar[RenamedAttribute] = RenamedAttribute("extrapolate")


@check_call
@dataclass(frozen=True, kw_only=True, repr=False)
class Trajectory(ShownTrajectory):
    """One phase of a solution, in SI, time from the phase's ignition.

    Parameters
    ----------
    phase
        Name of the phase.
    state, control, costate
        Curves with as many components as the phase has states, control components and states. A `UnitVectorControl`
        is normalised again after interpolation. `costate` is None where a method gives none.
    """

    phase: str
    state: Curve
    control: Curve
    costate: Curve | None = None

    @property
    def time(self) -> Vector:
        """Nodes [s]."""
        return self.state.time

    @property
    def duration(self) -> float:
        """Length of the phase [s]."""
        return float(self.state.time[-1])


def read_only_array(values: Any) -> Any:
    """Return the array if it is read-only, else a read-only copy."""
    array = np.asarray(values, dtype=float)
    owner = array if array.base is None else array.base
    if array.flags.writeable or not isinstance(owner, np.ndarray) or owner.flags.writeable:
        array = np.array(array)
        array.flags.writeable = False
    return array
