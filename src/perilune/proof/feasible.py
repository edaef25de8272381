"""Level 1, feasible: the exported control, flown by another integrator, does what the solution says.

From x(0) = start(p) each phase is flown by SciPy's DOP853 with the control read from the export, from switch
to switch; the end conditions, the states along the arc, path constraints, bounds and the objective are
recomputed from that flight alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from perilune.problem.controls import placed
from perilune.problem.solution import Solution
from perilune.problem.verification import Check
from perilune.proof.numerics import Arc, Flight, fly, initial_state, smooth_pieces
from perilune.words.maths import NUMERIC
from perilune.words.outcome import PeriluneError
from perilune.words.types import Vector

# In canonical units. Measured on good answers: end conditions 2e-11, states along the arc 4e-11.
END_LIMIT = 1e-10
STATE_LIMIT = 3e-10
_DENSE = 2001


def tables(solution: Solution) -> Check:
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
        meaning="how many entries of the exported tables are not finite, or not in order of time from 0",
    )  # fmt: skip


def flights(solution: Solution, *, with_costates: bool) -> list[tuple[Arc, Flight]]:
    """Every phase flown again, each from the end of the flight before."""
    flown: list[tuple[Arc, Flight]] = []
    end: Vector | None = None
    for k, phase in enumerate(solution.problem.phases):
        arc, n = Arc(solution=solution, index=k), len(phase.states)
        lam0 = arc.costate(np.zeros(1))[:, 0] if with_costates and arc.trajectory.costate is not None else None
        flight = fly(arc, initial_state(solution, k, end), lam0)
        end = flight.end[:n]
        flown.append((arc, flight))
    return flown


def feasibility(solution: Solution, flown: Sequence[tuple[Arc, Flight]]) -> Iterator[Check]:
    """All checks of level 1 but `tables`.

    Parameters
    ----------
    solution
        What is claimed.
    flown
        Of `flights`.
    """
    for arc, flight in flown:
        yield from _times(arc)
        yield from _ends(arc, flight)
        yield from _states(arc, flight)
        yield from _controls(arc)
        yield from _paths(arc, flight)
    yield from _free_parameters(solution)
    yield _objective(solution, *flown[-1])
    yield from _bookkeeping(solution)


def _times(arc: Arc) -> Iterator[Check]:
    curves = [arc.trajectory.state, arc.trajectory.control]
    curves += [arc.trajectory.costate] if arc.trajectory.costate is not None else []
    yield Check(
        name=f"{arc.prefix}{arc.phase.duration}", level=1, unit="s",
        value=max(abs(float(c.time[-1]) - arc.duration) for c in curves),
        limit=1e-12 * arc.problem.scales.time,
        meaning=f"difference between the last time of the exported tables and {arc.phase.duration}",
    )  # fmt: skip


def _ends(arc: Arc, flight: Flight) -> Iterator[Check]:
    residuals = arc.phase.evaluate("end", flight.end[: len(arc.phase.states)].tolist(), (), arc.p)
    for condition, residual in zip(arc.phase.end_conditions, residuals, strict=True):
        what = f"by how much {condition.name} leaves its range" if condition.ranged else f"{condition.name} left"
        yield Check(
            name=f"{arc.prefix}{condition.name}", level=1, unit=condition.unit,
            value=abs(float(condition.missed(float(residual), arc.p))),
            limit=END_LIMIT * arc.problem.size_of(condition),
            meaning=f"{what} when the exported control is flown by another integrator",
        )  # fmt: skip


def _states(arc: Arc, flight: Flight) -> Iterator[Check]:
    t = np.append(arc.quadrature[0], arc.duration)
    error = np.abs(flight.at(t)[: len(arc.phase.states)] - arc.state(t)).max(axis=1)
    bounds = arc.phase.states
    for state, scale, difference, values in zip(bounds, arc.state_scale, error, flight.at(t), strict=False):
        difference = float(difference) if flight.completed else float("nan")
        yield Check(
            name=f"{arc.prefix}state_{state.name}", level=1, value=difference, unit=state.unit,
            limit=STATE_LIMIT * scale,
            meaning=f"largest difference along the arc between {state.name} of the table and as flown again",
        )  # fmt: skip
        lower, upper = state.limits(arc.p)
        if np.isfinite(lower) or np.isfinite(upper):
            name = f"{arc.prefix}bounds_{state.name}"
            yield _bound(name, state.name, values, lower, upper, state.unit, scale)


def _bound(name: str, what: str, values: Vector, lower: float, upper: float, unit: str, scale: float) -> Check:
    return Check(
        name=name, level=1, value=float(np.max([lower - values, values - upper, 0 * values])), unit=unit,
        limit=END_LIMIT * scale, meaning=f"by how much {what} leaves its bounds [{lower:g}, {upper:g}]",
    )  # fmt: skip


def _controls(arc: Arc) -> Iterator[Check]:
    t = arc.times(_DENSE)
    u = arc.trajectory.control.extended(t).T
    for here, control in placed(arc.phase.controls):
        part, name = u[here], "_".join(control.names)
        if not control.scalar:
            yield Check(
                name=f"{arc.prefix}direction_{name}", level=1, unit="1", limit=1e-9,
                value=float(control.broken(part, arc.p).max()),
                meaning="how far the interpolated direction is from length 1 before it is normalised",
            )  # fmt: skip
        elif np.isfinite(limits := control.limits(arc.p)).any():
            scale = float(arc.control_scale[here.start])
            yield _bound(f"{arc.prefix}bounds_{name}", name, part, *limits, control.unit, scale)


def _paths(arc: Arc, flight: Flight) -> Iterator[Check]:
    t = arc.times(_DENSE)
    x = flight.at(t)[: len(arc.phase.states)]
    for condition, value in zip(arc.phase.path_conditions, arc.path(x, arc.control(t)), strict=True):
        yield Check(
            name=f"{arc.prefix}path_{condition.name}", level=1, unit=condition.unit,
            value=float(np.max(np.maximum(-value, 0.0))) if flight.completed else float("nan"),
            limit=END_LIMIT * arc.problem.size_of(condition),
            meaning=f"largest violation of {condition.name} >= 0 at {len(t)} times of the new flight",
        )  # fmt: skip


def _free_parameters(solution: Solution) -> Iterator[Check]:
    for f in solution.problem.free:
        if np.isfinite(f.lower) or np.isfinite(f.upper):
            value, scale = np.array([solution.free[f.name]]), solution.problem.scales.of(f.unit)
            yield _bound(f"bounds_{f.name}", f.name, value, f.lower, f.upper, f.unit, scale)


def _objective(solution: Solution, arc: Arc, flight: Flight) -> Check:
    x = arc.phase.state_record(*flight.end[: len(arc.phase.states)])
    flown = float(solution.problem.objective(x, arc.p, NUMERIC))
    return Check(
        name="objective", level=1, value=abs(flown - solution.objective),
        unit=solution.problem.objective_unit, limit=END_LIMIT * arc.objective_scale,
        meaning="difference between the objective of the new flight and the one claimed",
    )  # fmt: skip


def _bookkeeping(solution: Solution) -> Sequence[Check]:
    """The model's own checks; one that fails where they cannot be made."""
    try:
        return () if solution.problem.bookkeeping is None else solution.problem.bookkeeping(solution)
    except PeriluneError as error:
        meaning = f"the model's own checks can be made: {error.what} ({error.got})"
        return [Check(name="bookkeeping", level=1, value=float("nan"), limit=0.0, unit="1", meaning=meaning)]
