"""Animation of a flight: the path with the vehicle on it, its thrust, the clock and the height.

The path is seen from the side, distance along the ground against height, each to its own scale, the exhaust at its
true angle to the horizon; a problem without a place in space shows its first history with a point running along it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg

from perilune.core import Matrix, Vector, require_type, wrong_type_error
from perilune.io import flight_columns, fresh_file, new_file
from perilune.problem import Solution
from perilune.report.figures import label, write_doubts
from perilune.report.profile_view import plane_of_flight
from perilune.report.side_and_top_view import track_path
from perilune.report.style import BLUE, GREY, STYLE, VERMILION, new_figure

_FRAMES = 15  # a second
_FASTEST, _LONGEST = 0.2, 120.0  # s
_STROKE = 0.2  # of the height of the picture, for the largest thrust


@dataclass(frozen=True, kw_only=True)
class _AnimatedPath:
    """Drawn path: places (2, n) at times (n,), exhaust (2, n) in parts of the largest thrust, texts of the axes."""

    time: Vector
    places: Matrix
    exhaust: Matrix
    labels: tuple[str, str]


def animate(
    solution: Solution, file: str | Path | None = None, *, seconds: float = 8.0, force: bool = False
) -> FuncAnimation:
    """Animate a flight.

    Parameters
    ----------
    solution
        What to show.
    file
        A GIF to write; None writes nothing.
    seconds
        How long it takes to show the flight.
    force
        Whether a file that is there may be replaced.

    Returns
    -------
    FuncAnimation
        Of matplotlib; in a notebook ``IPython.display.HTML(animation.to_jshtml())`` shows it.

    Raises
    ------
    PeriluneError
        If the file is there already or cannot be written, or the time is none to show a flight in.
    """
    require_type(solution, Solution, "a solution to show")
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not _FASTEST <= seconds <= _LONGEST:
        raise wrong_type_error(seconds, f"seconds, {_FASTEST:g} to {_LONGEST:g}", "a valid duration of an animation")
    target = None if file is None else new_file(file, "an animation", force)
    if target is not None and target.suffix.lower() != ".gif":
        raise wrong_type_error(target.name, "a name that ends in .gif", "the file of an animation")
    with matplotlib.rc_context(STYLE):
        made = _animation(_path_at_frames(solution, round(_FRAMES * seconds)), solution)
        if target is not None:
            with fresh_file(target, "the animation") as beside:
                made.save(beside, writer=PillowWriter(fps=_FRAMES), dpi=100)
    return made


def _path_at_frames(solution: Solution, frames: int) -> _AnimatedPath:
    """Return the path at evenly spaced times."""
    whole = solution.duration
    time = np.linspace(0.0, whole, max(frames, 2))
    problem = solution.problem
    if all(phase.inertial is not None for phase in problem.phases) and problem.views.radius:
        return _path_over_body(solution, time)
    if all(phase.track is not None for phase in problem.phases):
        at, sampled = track_path(solution)
        rows = np.array([np.interp(time, at, sampled[k]) for k in (0, 2)]) / 1e3
        return _AnimatedPath(
            time=time, places=rows, exhaust=np.zeros((2, len(time))), labels=("downrange (km)", "height (km)")
        )
    name = problem.views.histories[0].quantities[0] if problem.views.histories else problem.phases[0].state_names[0]
    parts = flight_columns(solution, name)
    at, values = (np.concatenate(rows) for rows in zip(*((t, column.values) for t, column in parts), strict=True))
    rows = np.array([time, np.interp(time, at, values)])
    labels = ("time (s)", f"{name.replace('_', ' ')} ({parts[0][1].unit})")
    return _AnimatedPath(time=time, places=rows, exhaust=np.zeros((2, len(time))), labels=labels)


def _path_over_body(solution: Solution, time: Vector) -> _AnimatedPath:
    radius = getattr(solution.parameters, solution.problem.views.radius)
    plane, begin, parts = plane_of_flight(solution), 0.0, []
    for k, trajectory in enumerate(solution.trajectories):
        last = k == len(solution.trajectories) - 1
        end = begin + trajectory.duration
        here = time[(time >= begin) & ((time < end) | last)]
        r, _, push = solution.inertial(k, np.clip(here - begin, 0.0, trajectory.duration))
        parts.append(np.concatenate([plane @ r, plane @ push, np.linalg.norm(r, axis=0)[None]]))
        begin = end
    above, ahead, out, on, distance = np.concatenate(parts, axis=1)
    angle = np.unwrap(np.arctan2(ahead, above))
    cosine, sine = np.cos(angle), np.sin(angle)
    push = np.array([on * cosine - out * sine, out * cosine + on * sine])
    most = float(np.linalg.norm(push, axis=0).max()) or 1.0
    places = np.array([radius * angle, distance - radius]) / 1e3
    return _AnimatedPath(
        time=time, places=places, exhaust=-push / most, labels=("along the ground (km)", "height (km)")
    )


def _animation(way: _AnimatedPath, solution: Solution) -> FuncAnimation:
    figure, axes = new_figure(height=2.6, width=5.0)
    FigureCanvasAgg(figure)
    along, height = way.places
    axes.plot(along, height, color=GREY, linewidth=0.8)
    (flown,) = axes.plot([], [], color=BLUE)
    (stroke,) = axes.plot([], [], color=VERMILION, linewidth=2.0)
    (vehicle,) = axes.plot([], [], "o", color="black", markersize=5, zorder=5)
    axes.set(xlabel=way.labels[0], ylabel=way.labels[1])
    axes.margins(0.08, 0.12)
    title = axes.set_title(" ", fontsize=8)
    write_doubts(figure, {label(solution): solution})
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # else every frame is laid out again
    box = axes.get_window_extent()
    reach = _STROKE * np.array([np.ptp(axes.get_xlim()) * box.height / box.width, np.ptp(axes.get_ylim())])
    draw = _frame_drawer(way, reach, (flown, stroke, vehicle, title))
    return FuncAnimation(
        figure, draw, frames=len(way.time), interval=1000 / _FRAMES, blit=False, cache_frame_data=False
    )


def _frame_drawer(way: _AnimatedPath, reach: Vector, parts: tuple) -> Callable[[int], tuple]:
    flown, stroke, vehicle, title = parts
    what, _, unit = way.labels[1].removesuffix(")").partition(" (")

    def draw(i: int) -> tuple:
        here = way.places[:, i]
        flown.set_data(way.places[0, : i + 1], way.places[1, : i + 1])
        end = here + reach * way.exhaust[:, i]
        stroke.set_data([here[0], end[0]], [here[1], end[1]])
        vehicle.set_data([here[0]], [here[1]])
        title.set_text(f"{way.time[i]:.1f} s, {what} {here[1]:.3f} {unit}")
        return parts

    return draw
