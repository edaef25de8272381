"""Level 1, feasible: the exported control, integrated by another integrator, does what the solution says.

From x(0) = start(p) each phase is flown with the control read from the export (`reintegration`); the end conditions,
the states along the arc, path constraints, bounds and the objective are recomputed only from that flight, inside every
piece of every table (`sample_points`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from perilune.core import COMPLEX, NUMERIC, Matrix, PeriluneError, Vector
from perilune.problem import Check, Solution, control_slices
from perilune.proof.feasible.deviations import MOST_GROWTH
from perilune.proof.feasible.phase_data import PhaseData, end_slopes, free_size, objective_slope, slopes_at
from perilune.proof.feasible.reintegration import Reintegration, smooth_pieces
from perilune.proof.feasible.sample_points import (
    ENDS,
    cubic_turning_points,
    extreme_values,
    interpolating_cubics,
    polynomial,
)
from perilune.proof.feasible.switching_surfaces import SAME_TIME

# Of the size of each quantity, times the growth of errors along the flight. Measured on good answers: end conditions
# 2e-11, states along the arc 4e-11.
END_LIMIT = 1e-10
STATE_LIMIT = 3e-10


def check_tables(solution: Solution) -> Check:
    """Count what is no usable number in the exported tables: everything else is computed from them."""
    bad = 0
    for flown in solution.trajectories:
        for curve in (flown.state, flown.control, *([flown.costate] if flown.costate else [])):
            bad += sum(int(np.size(a) - np.isfinite(a).sum()) for a in (curve.time, curve.values, curve.rates))
            bad += int((np.diff(curve.time) < 0).sum()) + int(not len(curve.time) or curve.time[0] != 0.0)
            # A time may stand there twice, once for each side of a switch; a piece has two ends.
            bad += sum(len(piece.time) < 2 for piece in smooth_pieces(curve))
    numbers = [solution.objective, *solution.free.values()]
    bad += sum(not np.isfinite(v) for v in numbers)
    return Check(
        name="tables", level=1, value=float(bad), limit=0.0, unit="1",
        meaning="number of entries of the exported tables that are not finite or not in order of time from 0",
    )  # fmt: skip


def check_feasibility(solution: Solution, flown: Sequence[tuple[PhaseData, Reintegration]]) -> Iterator[Check]:
    """Make all checks of level 1 but `check_tables`.

    Parameters
    ----------
    solution
        What is claimed.
    flown
        Of `reintegration.reintegrate`.
    """
    for arc, flight in flown:
        yield from _check_times(arc)
        yield from _check_ends(arc, flight)
        yield from _check_states(arc, flight)
        yield from _check_controls(arc)
        yield from _check_path(arc, flight)
    yield from _check_free_parameters(solution)
    yield _check_objective(solution, *flown[-1])
    yield from _consistency_checks(solution)


def _check_times(arc: PhaseData) -> Iterator[Check]:
    yield Check(
        name=f"{arc.prefix}{arc.phase.duration}", level=1, unit="s", exact=True,
        value=float(np.max([abs(c.time[-1] - arc.duration) for c in arc.curves])),
        limit=1e-12 * arc.time_scale,
        meaning=f"difference between the last time of the exported tables and {arc.phase.duration}",
    )  # fmt: skip


def _check_ends(arc: PhaseData, flight: Reintegration) -> Iterator[Check]:
    residuals = [arc.phase.evaluate("end", end.tolist(), (), arc.p) for end in flight.ends]
    sizes = np.clip(np.abs(end_slopes(arc)) @ flight.grown, arc.end_scale, MOST_GROWTH * arc.end_scale)
    of_conditions = zip(arc.phase.end_conditions, sizes, zip(*residuals, strict=True), strict=True)
    for condition, size, values in of_conditions:
        what = f"violation of the range of {condition.name}" if condition.ranged else f"{condition.name} left"
        yield Check(
            name=f"{arc.prefix}{condition.name}", level=1, unit=condition.unit,
            value=float(np.max([abs(condition.missed(float(value), arc.p)) for value in values])),
            limit=END_LIMIT * float(size),
            meaning=f"{what} when the exported control is integrated by another method",
        )  # fmt: skip


def _check_states(arc: PhaseData, flight: Reintegration) -> Iterator[Check]:
    of_states, missed = zip(arc.phase.states, arc.state_scale, flight.difference, strict=True), _first_missed_jump(arc)
    for row, (state, scale, difference) in enumerate(of_states):
        yield Check(
            name=f"{arc.prefix}state_{state.name}", level=1, value=float(difference * scale), unit=state.unit,
            limit=STATE_LIMIT * scale * float(flight.growth[row]),
            meaning=f"largest difference between {state.name} of the table and of the independent re-integration,"
            f" inside every interval of the tables{missed}",
        )  # fmt: skip
        lower, upper = state.limits(arc.p)
        if np.isfinite(lower) or np.isfinite(upper):
            name = f"{arc.prefix}bounds_{state.name}"
            own = interpolating_cubics(flight.inside[row])
            values = np.concatenate(
                [polynomial(own[:, None], cubic_turning_points(own)).ravel(), flight.at_ends[row].ravel()]
            )
            yield _check_bound(name, state.name, values, lower, upper, state.unit, scale * float(flight.growth[row]))


def _first_missed_jump(arc: PhaseData) -> str:
    """The first jump of the rates at which the table of the state has no break: its integration missed it."""
    time = arc.trajectory.state.time
    breaks = time[1:][np.diff(time) == 0]
    for crossing in arc.crossings:
        if crossing.jump.any() and np.abs(breaks - crossing.time).min(initial=np.inf) > SAME_TIME * arc.duration:
            by = " and ".join(s.name for s, slope in zip(arc.phase.states, crossing.normal, strict=True) if slope)
            return f"; at {crossing.time:.6g} s a switch by {by} changes the rates, but the table has no break"
    return ""


def _check_bound(name: str, what: str, values: Vector, lower: float, upper: float, unit: str, scale: float) -> Check:
    return Check(
        name=name, level=1, value=float(np.max([lower - values, values - upper, 0 * values])), unit=unit,
        limit=END_LIMIT * scale, meaning=f"violation of the bounds [{lower:g}, {upper:g}] by {what}",
    )  # fmt: skip


def _check_controls(arc: PhaseData) -> Iterator[Check]:
    curve = arc.trajectory.control
    u = arc.looked_at[0].read(curve)
    of_pieces = extreme_values(curve)
    for here, control in control_slices(arc.phase.controls):
        name = "_".join(control.names)
        if not control.scalar:
            nodes = curve.values.T[here]
            yield Check(
                name=f"{arc.prefix}direction_{name}", level=1, unit="1", limit=1e-9,
                value=max(float(control.broken(part, arc.p).max()) for part in (u[here], nodes)),
                meaning="deviation of the interpolated direction from length 1 before normalisation",
            )  # fmt: skip
        elif np.isfinite(limits := control.limits(arc.p)).any():
            values, scale = of_pieces[here].ravel(), float(arc.control_scale[here.start])
            yield _check_bound(f"{arc.prefix}bounds_{name}", name, values, *limits, control.unit, scale)


def _check_path(arc: PhaseData, flight: Reintegration) -> Iterator[Check]:
    phase, count = arc.phase, len(arc.looked_at[0])
    if phase.path_conditions:
        rows = zip(
            phase.path_conditions, _path_sizes(arc, flight), _values_inside_pieces(arc, flight, arc.path), strict=True
        )
        for condition, size, values in rows:
            yield Check(
                name=f"{arc.prefix}path_{condition.name}", level=1, unit=condition.unit,
                value=float(np.max(np.maximum(-values, 0.0))), limit=END_LIMIT * float(size),
                meaning=f"largest violation of {condition.name} >= 0 inside {count} intervals of the re-integrated"
                f" flight",
            )  # fmt: skip
    if phase.held_conditions:
        rows = zip(phase.held_conditions, arc.held_scale, _values_inside_pieces(arc, flight, arc.held), strict=True)
        for condition, size, values in rows:
            yield Check(
                name=f"{arc.prefix}held_{condition.name}", level=1, unit=condition.unit,
                value=float(np.max(np.abs(values))), limit=END_LIMIT * float(size),
                meaning=f"largest difference of {condition.name} from 0 inside {count} intervals of the re-integrated"
                f" flight",
            )  # fmt: skip


def _path_sizes(arc: PhaseData, flight: Reintegration) -> Vector:
    """Sizes of the path conditions: a phase that is over at once still begins with the errors of those before it."""
    u = arc.control(np.zeros(1))
    slopes = slopes_at(arc, np.zeros(1), lambda z: arc.phase.evaluate("path", z, u, arc.p, COMPLEX))
    return np.clip(np.abs(slopes) @ (flight.begun - 1.0), arc.path_scale, MOST_GROWTH * arc.path_scale)


def _values_inside_pieces(
    arc: PhaseData, flight: Reintegration, conditions: Callable[[Any, Any], Matrix]
) -> Iterator[Vector]:
    """Values of each condition inside every piece, at its ends, and where the cubic through those of a piece turns."""
    pieces = arc.looked_at[0]
    inside = conditions(flight.inside, arc.read(pieces)[1])
    at_ends = conditions(flight.at_ends, arc.read(pieces, ENDS)[1])
    for row in range(len(inside)):
        shares = cubic_turning_points(interpolating_cubics(inside[row]))
        dips = conditions(
            polynomial(interpolating_cubics(flight.inside)[:, :, None], shares), arc.read(pieces, shares)[1]
        )[row]
        yield np.concatenate([part.ravel() for part in (inside[row], at_ends[row], dips)])


def _check_free_parameters(solution: Solution) -> Iterator[Check]:
    for f in solution.problem.free:
        if np.isfinite(f.lower) or np.isfinite(f.upper):
            value, scale = np.array([solution.free[f.name]]), free_size(solution, f)
            yield _check_bound(f"bounds_{f.name}", f.name, value, f.lower, f.upper, f.unit, scale)


def _check_objective(solution: Solution, arc: PhaseData, flight: Reintegration) -> Check:
    flown = [float(solution.problem.objective(arc.phase.state_record(*x), arc.p, NUMERIC)) for x in flight.ends]
    grown = float(np.abs(objective_slope(arc)) @ flight.grown)
    return Check(
        name="objective", level=1, value=float(np.max(np.abs(np.array(flown) - solution.objective))),
        unit=solution.problem.objective_unit,
        limit=END_LIMIT * float(np.clip(grown, arc.objective_scale, MOST_GROWTH * arc.objective_scale)),
        meaning="difference between the objective of the re-integrated flight and the one claimed",
    )  # fmt: skip


def _consistency_checks(solution: Solution) -> Sequence[Check]:
    """The model's own checks; one that fails where they cannot be made."""
    try:
        return () if solution.problem.consistency_checks is None else solution.problem.consistency_checks(solution)
    except PeriluneError as error:
        meaning = f"evaluation of the model's own checks: {error.what} ({error.got})"
        return [Check(name="bookkeeping", level=1, value=float("nan"), limit=0.0, unit="1", meaning=meaning)]
