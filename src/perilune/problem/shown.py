"""What problems and solutions show of themselves, in a line, in a notebook, to other libraries.

What needs rooms above is done there (`perilune.words.face`).
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perilune.words.face import method

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.animation import FuncAnimation
    from matplotlib.figure import Figure


class ShownProblem:
    """How a problem shows itself."""

    def __repr__(self: Any) -> str:
        phases = ", ".join(f"{p.name} ({len(p.states)} states)" for p in self.phases)
        free = ", ".join(self.free_names) or "nothing"
        return f"<Problem {self.name}: {self.heading}; {phases}; free: {free}; least J in {self.objective_unit}>"

    def _repr_html_(self) -> str:
        return method("problem_page")(self)


class ShownSolution:
    """How a solution shows itself."""

    def plot(self, name: str = "") -> Figure:
        """A figure of the flight; see `perilune.report.shown.plot`.

        Parameters
        ----------
        name
            Of the figure, as ``perilune solve --out`` names its file; "" is the way in space, or the first there is.

        Raises
        ------
        PeriluneError
            If there is no figure of that name; the names that there are stand in it.
        """
        return method("plot")(self, name)

    def animate(self, file: str | Path | None = None, *, seconds: float = 8.0, force: bool = False) -> FuncAnimation:
        """The flight as it goes; see `perilune.report.animated.animate`.

        Parameters
        ----------
        file
            A GIF to write; None writes nothing.
        seconds
            How long it takes to show the flight.
        force
            Whether a file that is there may be replaced.
        """
        return method("animate")(self, file, seconds=seconds, force=force)

    def to_xarray(self, *, epoch: str | datetime | None = None) -> xarray.Dataset:
        """The flight as a data set of xarray; see `perilune.io.exports.writing.to_xarray`.

        Parameters
        ----------
        epoch
            Time at the begin of the flight in ISO 8601, UTC unless it says otherwise; without it times are seconds.

        Raises
        ------
        PeriluneError
            If xarray is not installed.
        """
        return method("to_xarray")(self, epoch=epoch)

    def to_dataframe(self) -> pandas.DataFrame:
        """The flight as a frame of pandas, its index the time from the begin of the flight [s].

        Raises
        ------
        PeriluneError
            If pandas is not installed.
        """
        return method("to_dataframe")(self)

    def _repr_html_(self) -> str:
        return method("solution_page")(self)
