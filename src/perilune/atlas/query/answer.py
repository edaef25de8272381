"""Answer read from an atlas: a solution that is made on first access, and a record of the reading."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from perilune.core import RenamedAttribute
from perilune.problem import Solution


@dataclass(frozen=True, kw_only=True)
class Query:
    """Record of the reading of an answer.

    Parameters
    ----------
    sheet
        Label of the branch.
    candidates
        Labels of all branches that reach the point, by what they give for J, best first.
    cell
        Size of the answer's cell along each axis, as a share of the region.
    guess_error
        By how much what the cell gives is wrong, relative.
    steps
        Of Newton's method.
    error_bound
        How far the unknowns can be from those of the extremal, relative; see `perilune.charts.polish`.
    residual, path, minimum, drift
        What the independent re-integration shows (`perilune.charts.reintegrate.ReintegratedExtremals`),
        canonical.
    sample_level
        Level that all answers at nodes reached which were drawn for a proof of this atlas; 0 where none was.
    slopes
        dJ/dp of each axis [SI].
    latency
        Time that it took [s].
    """

    sheet: str
    candidates: tuple[str, ...]
    cell: tuple[float, ...]
    guess_error: float
    steps: int
    error_bound: float
    residual: float
    path: float
    minimum: float
    drift: float
    sample_level: int
    slopes: Mapping[str, float]
    latency: float
    met: ClassVar[RenamedAttribute] = RenamedAttribute("candidates")
    inherited: ClassVar[RenamedAttribute] = RenamedAttribute("sample_level")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Mapped(Solution):
    """Solution that was read from an atlas; `query` is the record of the reading."""

    query: Query

    @classmethod
    def deferred(cls, objective: float, query: Query, make: Callable[[], Solution]) -> Mapped:
        """Return a solution of which only J and `query` exist before it is accessed, which in a sweep it seldom is.

        Parameters
        ----------
        objective
            J [SI].
        query
            Record of the reading.
        make
            Returns the whole solution on first access.
        """
        found = object.__new__(cls)
        found.__dict__.update(objective=objective, query=query, _make=make)
        return found


class _Made:
    """Field of a `Mapped` that is made, with all others, on first access."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, found: Mapped | None, of: type) -> Any:
        if found is None or (make := found.__dict__.get("_make")) is None:
            raise AttributeError(self._name)
        found.__dict__.update({**make().__dict__, "query": found.query})
        return found.__dict__[self._name]


for _field in fields(Solution):  # an instance's own come before these
    setattr(Mapped, _field.name, _Made(_field.name))
