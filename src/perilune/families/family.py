"""Family: many answers of one problem along some of its parameters, and why some have none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from perilune.core import (
    Outcome,
    PeriluneError,
    RenamedAttribute,
    check_call,
    format_value_range,
    method_function,
    parameter_name,
    unknown_name,
    wrong_type_error,
)
from perilune.problem import Problem, Solution

if TYPE_CHECKING:
    import pandas
    import xarray

# Values of each parameter (the family is their grid), or the points themselves.
Over = Mapping[str, Sequence[float]] | Sequence[Mapping[str, float]]
# Why a member has no solution, by the exit code of the error.
_FAILURES = {outcome.exit_code: outcome for outcome in (Outcome.NOT_CONVERGED, Outcome.INFEASIBLE, Outcome.REFUSED)}


@check_call
@dataclass(frozen=True, kw_only=True)
class FamilyPoint:
    """Member of a family: the parameters' values in SI, and the solution, or `failure` and `message` without one."""

    values: tuple[float, ...]
    solution: Solution | None
    message: str = ""
    failure: Outcome | None = None
    within: ClassVar[RenamedAttribute] = RenamedAttribute("tolerance_used")

    def __post_init__(self) -> None:
        allowed = (None,) if self.solution is not None else tuple(_FAILURES.values())
        if self.failure not in allowed:
            raise PeriluneError(
                "a member of a family has a solution or a reason why it has none",
                got=str(self.failure and self.failure.name),
                expected=" or ".join(outcome.name if outcome else "no failure" for outcome in allowed),
            )

    @property
    def value(self) -> float:
        """Return the value of the parameter, for a family along one."""
        (only,) = self.values
        return only

    @property
    def outcome(self) -> Outcome:
        """Return the solution's outcome, or the failure."""
        if self.solution is not None:
            return self.solution.outcome
        assert self.failure is not None  # seen to when it was made
        return self.failure

    @property
    def tolerance_used(self) -> str:
        """Return the part of a stated tolerance that the proof needed, in words; empty for none."""
        return "" if self.solution is None else self.solution.verification.tolerance_used


def failed_point(values: tuple[float, ...], error: PeriluneError) -> FamilyPoint:
    """Return the member for an error: it is infeasible, its search failed, or its values are refused.

    Parameters
    ----------
    values
        Values of the parameters [SI].
    error
        Refusal, proof of infeasibility, or failure of the search.
    """
    return FamilyPoint(values=values, solution=None, message=str(error), failure=failure_outcome(error))


def failure_outcome(error: PeriluneError) -> Outcome:
    """Return the outcome that an error stands for."""
    return _FAILURES[error.exit_code]


@check_call
@dataclass(frozen=True, kw_only=True, repr=False)
class Family:
    """Solutions along some parameters, in the order that was asked for.

    Parameters
    ----------
    problem
        What was varied.
    parameters
        Names of the parameters.
    points
        The members; after an interruption those that were done.
    interrupted
        Whether the user stopped it.
    notes
        Which members of a store could not be taken over, and were solved again.
    """

    problem: Problem
    parameters: tuple[str, ...]
    points: tuple[FamilyPoint, ...]
    interrupted: bool = False
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        values = zip(*(point.values for point in self.points), strict=True)
        along = zip(self.parameters, self.units, values, strict=False)  # of none where nothing was done
        ranges = "; ".join(f"{name} {format_value_range(of, unit)}" for name, unit, of in along) or ", ".join(
            self.parameters
        )
        solved = sum(point.solution is not None for point in self.points)
        left = ", interrupted" if self.interrupted else ""
        return f"<Family of {self.problem.name}: {ranges}; {solved} of {len(self.points)} members solved{left}>"

    @property
    def units(self) -> tuple[str, ...]:
        """Return the SI units of the parameters."""
        return tuple(self.problem.unit_of(name) for name in self.parameters)

    @property
    def parameter(self) -> str:
        """Return the parameter, for a family along one."""
        (only,) = self.parameters
        return only

    @property
    def unit(self) -> str:
        """Return the SI unit of the parameter, for a family along one."""
        (only,) = self.units
        return only

    @check_call
    def to_dataframe(self) -> pandas.DataFrame:
        """Return the members as rows of a frame of pandas; see `perilune.families.export_frames.member_frame`.

        Parameters, free parameters and results, angles in degrees and everything else in SI (``attrs["units"]``), then
        ``outcome``, ``verification_level``, ``tolerance_used`` and ``message``.

        Raises
        ------
        PeriluneError
            If pandas is not installed.
        """
        return method_function("member_frame")(self)

    @check_call
    def to_xarray(self) -> xarray.Dataset:
        """Return the members as a data set of xarray; see `perilune.families.export_frames.member_dataset`.

        Its dimensions are the parameters where the members are a grid, else the one dimension ``point``.

        Raises
        ------
        PeriluneError
            If xarray is not installed.
        """
        return method_function("member_dataset")(self)


def member_values(problem: Problem, over: Over) -> tuple[tuple[str, ...], list[tuple[float, ...]]]:
    """Return the names of the parameters and the values of every member; in a grid the last one changes fastest.

    Parameters
    ----------
    problem
        Base problem of the family.
    over
        Values of each parameter, of which the grid is made, or values of all of them point by point [SI].

    Raises
    ------
    PeriluneError
        If a name is no parameter, a value is no finite number, or the points have different parameters.
    """
    if isinstance(over, Mapping):
        names = [_parameter(problem, name) for name in over]
        for name, values in over.items():
            if isinstance(values, str) or not isinstance(values, Iterable):
                raise wrong_type_error(values, "a list of numbers in SI", f"a valid set of values of {name}")
        rows = list(product(*(list(values) for values in over.values())))
    elif isinstance(over, str) or not isinstance(over, Iterable):
        raise wrong_type_error(
            over, "{name: values} of each, or a list of {name: value, ...}", "a valid set of values to sweep over"
        )
    else:
        over = list(over)
        for point in over:
            if not isinstance(point, Mapping):
                raise wrong_type_error(point, "{name: value, ...}", "a point of a family")
        points = [{_parameter(problem, name): v for name, v in point.items()} for point in over]
        names = list(points[0]) if points else []
        if any(point.keys() != set(names) for point in points):
            raise PeriluneError("the points of a family have the same parameters", expected=", ".join(names))
        rows = [tuple(point[name] for name in names) for point in points]
    if not names or len(set(names)) < len(names):
        raise PeriluneError(
            "a sweep runs along one parameter or several",
            got=", ".join(names) or "none",
            expected="{name: values} of each, or a list of {name: value, ...}",
        )
    try:
        members = [tuple(float(v) for v in row) for row in rows]
    except (TypeError, ValueError, OverflowError):
        members = []
    if not members or not np.all(np.isfinite(members)):
        raise PeriluneError(f"the values of {' and '.join(names)} must be finite numbers", got=str(rows[:3])[:80])
    return tuple(names), members


def _parameter(problem: Problem, name: Any) -> str:
    """Return the parameter of a name, in which a dot may stand for an underscore."""
    if not isinstance(name, str):
        raise wrong_type_error(name, "a text", "the name of a parameter")
    name, known = parameter_name(name), sorted({*problem.given, *problem.free_names})
    if name not in known:
        raise unknown_name("parameter", name, known)
    return name
