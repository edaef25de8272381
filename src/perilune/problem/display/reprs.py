"""Displays of problems, solutions and their parts: one-line, in a notebook, and as data for other libraries.

Displays that need higher rooms are implemented there (`perilune.core.facade`).
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perilune.core import check_call, format_quantity, format_value_range, method_function, one_line
from perilune.problem.parameters import given_of

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.animation import FuncAnimation
    from matplotlib.figure import Figure


_MOST_TOLD = 4  # values that were given later, in a heading
_LONGEST_INPUT = 600  # characters of what was read of a file


class ShownProblem:
    """The reprs and displays of a problem."""

    @property
    def heading(self: Any) -> str:
        """Its title, or else its name, as it stands above what is printed of it: who stated it may be a stranger.

        A title says what records the problem was made of; values that were given later follow it.
        """
        made = given_of(*self.records)
        later = [
            f"{name} {one_line(format_quantity(g.value, g.unit, 10))}"
            for name, g in self.given.items()
            if name in made and made[name].value != g.value
        ]
        said = ", ".join([*later[:_MOST_TOLD], *([f"{len(later) - _MOST_TOLD} more"] if later[_MOST_TOLD:] else [])])
        return one_line(self.title or self.name) + (f", but with {said}" if said else "")

    @property
    def inputs_read(self: Any) -> tuple[str, ...]:
        """Return what was read of its files, as it may be printed (`Views.inputs`)."""
        return tuple(one_line(text, _LONGEST_INPUT) for text in self.views.inputs)

    def __repr__(self: Any) -> str:
        phases = ", ".join(f"{p.name} ({len(p.states)} states)" for p in self.phases)
        free = ", ".join(self.free_names) or "nothing"
        return f"<Problem {self.name}: {self.heading}; {phases}; free: {free}; least J in {self.objective_unit}>"

    def _repr_html_(self) -> str:
        return method_function("problem_page")(self)


class ShownPhase:
    """The repr of a phase."""

    def __repr__(self: Any) -> str:
        states = ", ".join(f"{state.name} [{state.unit}]" for state in self.states)
        steered = ", ".join(self.control_names) or "nothing"
        return f"<Phase {self.name}: {states}; steered by {steered}; lasts {self.duration}>"


class ShownCurve:
    """The repr of a curve."""

    def __repr__(self: Any) -> str:
        nodes, components = self.values.shape
        return f"<Curve of {components} values at {nodes} nodes, {format_value_range(self.time, 's')}>"


class ShownTrajectory:
    """The repr of the flight of a phase."""

    def __repr__(self: Any) -> str:
        curves = {"states": self.state, "values of the control": self.control, "costates": self.costate}
        parts = ", ".join(f"{curve.values.shape[1]} {name}" for name, curve in curves.items() if curve is not None)
        return f"<Trajectory of {self.phase}: {len(self.time)} nodes, {format_value_range(self.time, 's')}; {parts}>"


class ShownSolution:
    """The reprs and displays of a solution."""

    def __repr__(self: Any) -> str:
        problem = self.problem
        free = [f"{name} = {format_quantity(value, problem.unit_of(name))}" for name, value in self.free.items()]
        numbers = [f"J = {format_quantity(self.objective, problem.objective_unit)}", *free]
        proof = f"{self.outcome.name}, {self.verification.title}"
        return f"<Solution of {problem.name} by {self.method}: {proof}; {', '.join(numbers)}>"

    @check_call
    def plot(self, name: str = "") -> Figure:
        """Draw a figure of the flight; see `perilune.report.plot.plot`.

        Parameters
        ----------
        name
            Of the figure, as ``perilune solve --out`` names its file; "" is the way in space, or the first there is.

        Raises
        ------
        PeriluneError
            If there is no figure of that name; the names that there are stand in it.
        """
        return method_function("plot")(self, name)

    @check_call
    def animate(self, file: str | Path | None = None, *, seconds: float = 8.0, force: bool = False) -> FuncAnimation:
        """Animate the flight; see `perilune.report.animation.animate`.

        Parameters
        ----------
        file
            A GIF to write; None writes nothing.
        seconds
            How long it takes to show the flight.
        force
            Whether a file that is there may be replaced.
        """
        return method_function("animate")(self, file, seconds=seconds, force=force)

    @check_call
    def to_xarray(self, *, epoch: str | datetime | None = None) -> xarray.Dataset:
        """Return the flight as a data set of xarray; see `perilune.io.exports.writing.to_xarray`.

        Parameters
        ----------
        epoch
            Time at the begin of the flight in ISO 8601, UTC unless it says otherwise; without it times are seconds.

        Raises
        ------
        PeriluneError
            If xarray is not installed.
        """
        return method_function("to_xarray")(self, epoch=epoch)

    @check_call
    def to_dataframe(self) -> pandas.DataFrame:
        """Return the flight as a frame of pandas, its index the time from the begin of the flight [s].

        Raises
        ------
        PeriluneError
            If pandas is not installed.
        """
        return method_function("to_dataframe")(self)

    def _repr_html_(self) -> str:
        return method_function("solution_page")(self)
