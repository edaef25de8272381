"""Contour map of a family along two parameters: one quantity over two others, each member with its value.

Any of the three may be a parameter, a given or free parameter, a result, or `OVER_WEIGHT`. The grid of the members is
cut into triangles, between whose corners a quantity is interpolated; triangles with a corner that has no solution are
hatched, so that colours end at the outermost members that have one: with lines where such corners are infeasible, with
dots where one of them was not solved, of which nothing is known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import BoundaryNorm
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation

from perilune.core import Matrix, Outcome, PeriluneError, Vector, parameter_name, unknown_name
from perilune.families import Batch, Family, MemberTable, member_table, shown_column
from perilune.problem import Problem
from perilune.report.style import GREY, VERMILION, new_figure, styled
from perilune.report.time_histories import LONG

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

OVER_WEIGHT = "thrust_over_weight"  # of the whole vehicle, where it would stand on the ground
_LEVELS = 8  # about so many lines
_MOST_DOTS = 400  # members that are drawn one by one: more hide what is behind them
_WIDTH = 4.4  # inches: one column, and the bar of colours


def map_names(problem: Problem, parameters: tuple[str, ...]) -> list[str]:
    """Return the names of the quantities that a map of the problem's families can show, without results of views.

    Parameters
    ----------
    problem
        Base problem of the family.
    parameters
        Parameters that vary in it.
    """
    variables = [*problem.result_variables]
    for phase in problem.phases:
        variables += phase.end_output_variables
    own = {v.name for v in variables} or {"flight_time", "objective"}
    weight = {OVER_WEIGHT} if _weighs({*problem.given, *parameters}) else set()
    return sorted({*problem.given, *problem.free_names, *parameters, *own, *_on_the_way(problem), *weight})


def require_map(
    problem: Problem, parameters: tuple[str, ...], names: Mapping[str, str | None], batch: bool = False
) -> None:
    """Refuse a map that cannot be drawn, before anything is computed for it.

    Parameters
    ----------
    problem, parameters
        What is varied, and along what.
    names
        What was asked for as ``x``, ``y`` and ``z``, None for what is usual.
    batch
        True for a batch, whose results are those at the ends of phases.

    Raises
    ------
    PeriluneError
        If something is asked for and there are not two parameters, or there is no such quantity.
    """
    asked = {axis: name for axis, name in names.items() if name is not None}
    if asked and len(parameters) != 2:
        raise PeriluneError(
            "a map is of a sweep along two parameters", got=", ".join(parameters), expected="two of them",
            advice=f"leave out {', '.join(asked)}, or vary a second parameter",
        )  # fmt: skip
    known = map_names(problem, parameters)
    for name in asked.values():
        if parameter_name(name) not in known and (batch or problem.views.dispersion is None):
            raise unknown_name("quantity of a family", name, known)
        if batch and parameter_name(name) in _on_the_way(problem):
            raise PeriluneError(
                "members that are solved together have results at the ends of phases only", got=name,
                expected="no peak and no integral along the flight", advice="leave out --batch, or choose another",
            )  # fmt: skip


def _on_the_way(problem: Problem) -> set[str]:
    integrals = {variable.name for phase in problem.phases for variable in phase.integral_variables}
    return integrals | {f"peak_{name}{more}" for name in problem.views.peaks for more in ("", "_time")}


@styled
def family_map(
    found: Family | Batch | MemberTable, x: str | None = None, y: str | None = None, z: str | None = None
) -> Figure:
    """Draw filled contours, with labels, of one quantity of a family over two others.

    Parameters
    ----------
    found
        Family or batch along two parameters, its members their grid.
    x, y
        Names of the axes; the two parameters if None.
    z
        What is shown; if None the result that the problem makes as large as can be, or the first that varies.

    Returns
    -------
    Figure
        Where a member has no solution there is no colour: hatched by lines where it is infeasible and by dots where it
        was not solved. Up to 400 members are marked one by one, where their places are known.

    Raises
    ------
    PeriluneError
        If there are not two parameters, the members are no grid, or a quantity is not known or nowhere a number.
    """
    members = member_table(found)
    placed = members.grid
    if len(members.parameters) != 2 or placed is None or min(placed.shape) < 2:
        raise PeriluneError(
            "a map needs a family along two parameters, with all of its members",
            got=f"{len(members)} members along {', '.join(members.parameters)}",
            expected="a grid of 2 by 2 or more",
        )  # fmt: skip
    table = _quantities(members)
    names = [x or members.parameters[0], y or members.parameters[1], z or _default_quantity(members, table)]
    for name in names:
        if parameter_name(name) not in table:
            raise unknown_name("quantity of a family", name, sorted(table))
    (along, x_text), (across, y_text), (height, z_text) = (
        _values_for_axis(*table[parameter_name(name)], name) for name in names
    )
    good, bad = _triangles(placed, np.isfinite(along) & np.isfinite(across), np.isfinite(height))
    figure, axes = new_figure(height=3.2, width=_WIDTH)
    if not len(good):
        raise PeriluneError(
            f"there is nothing to draw of {names[2]}", got="no three neighbouring members with a value",
            expected="neighbouring members with a solution",
        )  # fmt: skip
    infeasible = np.array(members.outcomes) == Outcome.INFEASIBLE.name
    _hatch_unsolved(axes, np.stack([along, across], axis=1), bad, ~np.isfinite(height) & ~infeasible)
    mesh, folded = Triangulation(along, across, good), _folded(along, across, good)
    drawn = _scatter_of(axes, along, across, height) if folded else _contours(axes, mesh, height, _levels(height))
    bar = figure.colorbar(drawn, ax=axes, pad=0.02)
    bar.set_label(z_text)
    bar.outline.set_linewidth(0.4)  # pyright: ignore[reportCallIssue]
    _mark_members(axes, members, along, across, np.isfinite(height), folded)
    axes.set(xlabel=x_text, ylabel=y_text)
    axes.grid(False)
    move_labels_inside(figure, axes)
    return figure


def _scatter_of(axes: Axes, along: Vector, across: Vector, height: Vector) -> Any:
    """Draw members as coloured points, where their places fold over and contours would cross."""
    near = np.isfinite(height) & np.isfinite(along) & np.isfinite(across)
    norm = BoundaryNorm(_levels(height), 256)
    return axes.scatter(along[near], across[near], c=height[near], s=14, cmap="viridis", norm=norm, clip_on=False)


def _quantities(members: MemberTable) -> dict[str, tuple[Vector, str]]:
    """Return values and unit of all quantities of a member, by name; a parameter has precedence over a result."""
    columns = [shown_column(c) for c in (*members.given, *members.quantities, *members.axes)]
    found = {c.name: (np.broadcast_to(c.values, len(members)), c.unit) for c in columns}
    given = {name: np.full(len(members), value.value) for name, value in members.problem.given.items()}
    given |= {axis.name: axis.values for axis in members.axes}
    if _weighs(set(given)):
        pull = given.get("body_gravity")
        if pull is None:
            pull = given["body_gravitational_parameter"] / given["body_radius"] ** 2
        found[OVER_WEIGHT] = given["vehicle_thrust"] / (given["vehicle_mass"] * pull), "1"
    return found


def _weighs(names: set[str]) -> bool:
    ground = "body_gravity" in names or names >= {"body_gravitational_parameter", "body_radius"}
    return ground and names >= {"vehicle_thrust", "vehicle_mass"}


def _default_quantity(members: MemberTable, table: Mapping[str, tuple[Vector, str]]) -> str:
    """Return the name of the quantity to show by default."""
    if members.problem.maximised in table:
        return members.problem.maximised
    for f in members.quantities:
        known = f.values[np.isfinite(f.values)]
        if len(known) and np.ptp(known) > 1e-9 * np.abs(known).max():
            return f.name
    raise PeriluneError("no result of this family varies", expected="one that varies", advice="choose one with z")


def _values_for_axis(values: Vector, unit: str, name: str) -> tuple[Vector, str]:
    """Return values in the unit of their axis, and the text of the axis."""
    least, longer = LONG.get(unit, (math.inf, unit))
    factor, unit = (1e-3, longer) if np.nanmax(np.abs(values), initial=0.0) >= least else (1.0, unit)
    return factor * values, f"{parameter_name(name).replace('_', ' ')} ({unit})".removesuffix(" (1)")


def _triangles(placed: np.ndarray, known: np.ndarray, good: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles of the grid with good corners only, and others whose corners have places, (n, 3) each."""
    full, empty = list[tuple[int, ...]](), list[tuple[int, ...]]()
    for i, j in product(range(placed.shape[0] - 1), range(placed.shape[1] - 1)):
        a, b, c, d = (int(placed[i + p, j + q]) for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
        # Cut so that three good corners are one triangle.
        other = good[b] and good[d] and not (good[a] and good[c])
        halves = [(a, b, d), (b, c, d)] if other else [(a, b, c), (a, c, d)]
        for half in halves:
            if all(known[n] for n in half):
                (full if all(good[n] for n in half) else empty).append(half)
    return np.array(full, dtype=np.int64).reshape(-1, 3), np.array(empty, dtype=np.int64).reshape(-1, 3)


def _hatch_unsolved(axes: Any, at: Matrix, triangles: np.ndarray, unknown: np.ndarray) -> None:
    """Hatch triangles with corners that have no solution: by dots where one of them was not solved, else by lines."""
    dotted = unknown[triangles].any(axis=1)
    for hatch, its in (("////", triangles[~dotted]), ("....", triangles[dotted])):
        if len(its):
            shapes = PolyCollection(list(at[its]), facecolor="#F4F4F4", edgecolor="#B0B0B0", hatch=hatch, linewidth=0)
            axes.add_collection(shapes)


def _folded(along: Vector, across: Vector, triangles: np.ndarray) -> bool:
    """Return True if triangles overlap: two results may depend on each other, or turn back."""
    x, y = along[triangles].T, across[triangles].T
    areas = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    return bool(abs(areas.sum()) < (1 - 1e-6) * np.abs(areas).sum() or not areas.any())


def _levels(height: Vector) -> Vector:
    """Return round levels over the range of a quantity; around its value if that is constant."""
    known = height[np.isfinite(height)]
    low, high = float(known.min()), float(known.max())
    if high - low <= 1e-9 * max(abs(low), abs(high)):
        room = abs(high) or 1.0
        low, high = low - 0.1 * room, high + 0.1 * room
    return np.asarray(MaxNLocator(nbins=_LEVELS).tick_values(low, high))


def _contours(axes: Any, mesh: Triangulation, height: Vector, levels: Vector) -> Any:
    """Draw colours, and lines with their value."""
    filled = np.where(np.isfinite(height), height, levels[0])  # of corners that no triangle has
    drawn = axes.tricontourf(mesh, filled, levels=levels, cmap="viridis")
    label_lines(axes, axes.tricontour(mesh, filled, levels=levels, colors="white", linewidths=0.6))
    return drawn


def label_lines(axes: Any, lines: Any) -> None:
    """Label lines of equal value, legibly on any colour.

    Parameters
    ----------
    axes
        Axes of matplotlib.
    lines
        Contour set in them.
    """
    for text in axes.clabel(lines, fmt="%g", fontsize=6, inline=True, inline_spacing=2):
        text.set_path_effects([withStroke(linewidth=1.0, foreground="#00000080")])


def move_labels_inside(figure: Figure, axes: Any) -> None:
    """Move what is written at lines into the axes, as laid out, where their edge would cut it.

    Parameters
    ----------
    figure, axes
        Figure of matplotlib, and its axes with the labels.
    """
    figure.draw_without_rendering()
    room = axes.get_window_extent()
    for text in axes.texts:
        box, at = text.get_window_extent(), axes.transData.transform(text.get_position())
        moved = np.maximum(room.min - box.min, 0) - np.maximum(box.max - room.max, 0)
        if moved.any():
            text.set_position(axes.transData.inverted().transform(at + moved))


def _mark_members(
    axes: Any, members: MemberTable, along: Vector, across: Vector, good: np.ndarray, folded: bool
) -> None:
    """Mark each member with a dot, hollow if it is not proved; with a cross or plus if it has no solution."""
    doubted, infeasible = (
        np.array(members.outcomes) == outcome.name for outcome in (Outcome.NOT_PROVED, Outcome.INFEASIBLE)
    )
    placed = np.isfinite(along) & np.isfinite(across)
    few = len(members) <= _MOST_DOTS
    if few and not folded:  # there they are all that is drawn
        axes.plot(along[good & ~doubted], across[good & ~doubted], ".", color="black", markersize=1.5, clip_on=False)
    axes.plot(
        along[good & doubted],
        across[good & doubted],
        "o",
        color=VERMILION,
        markersize=3,
        markerfacecolor="none",
        clip_on=False,
    )
    said = []
    for marker, shown, words in (
        ("x", placed & ~good & infeasible, ("lines", "crosses", "infeasible")),
        ("+", placed & ~good & ~infeasible, ("dots", "plus signs", "not solved")),
    ):
        if shown.any():
            said.append(f"{', '.join(words[: 1 + few])}: {words[2]}")
        if few:
            axes.plot(along[shown], across[shown], marker, color=GREY, markersize=3, markeredgewidth=0.7, clip_on=False)
    lost = int((~placed).sum())
    said += [
        *(["hollow: NOT_PROVED"] if (good & doubted).any() else []),
        *(["only the members: contours would overlap"] if folded else []),
        *([f"{lost} without a solution are not shown here"] if lost else []),
    ]
    axes.set_title("; ".join(said), fontsize=6.5, color=VERMILION, loc="left")
