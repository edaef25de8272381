"""Tables of state, control and costate in SI, phase by phase, from the flight of an extremal."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any, cast

import casadi as ca
import numpy as np

from perilune.conditions import OptimalityConditions, PhaseExtremal, extremal_parameters
from perilune.core import Matrix, Vector
from perilune.methods.indirect.export_arcs import PropagatedPhase
from perilune.methods.indirect.unknowns import free_values, objective_scale
from perilune.problem import (
    Curve,
    Phase,
    Problem,
    Trajectory,
    control_scales,
    full,
    hermite_nodes,
    reached_sizes,
    scalars,
    state_scales,
)

# Accuracy to which curves are interpolated (canonical): the re-flight integrates the control's error over the whole
# burn, and 3e-11 rad of a few m/s^2 over 1000 s stays below 1e-6 m/s.
_STATES, _COSTATES, _CONTROLS = 1e-10, 3e-10, 3e-11
_PLAIN = 3.0  # times their sizes a control moves the states on a plain landing, for which these numbers are
_CHANGED = 6e-10  # of H, by all errors together, where the proof allows 1e-9
_LOOKS, _DIFFERENCE = 16, 1e-6  # nodes of a phase, and of a control in canonical units
_NOTHING = 1e-12  # of a duration: a shorter piece is none
_GOES_ON = 1e-7  # of a control: a smaller step at a switch is none
_CLEAR, _DECADES = 1e-6, 8  # a control that changes by less in that is clear; how much longer a moment is looked at
_TURNS, _TURN = 2001, 2 * math.pi  # points at which it is seen how an angle goes on
Turns = Callable[[Vector, Matrix], Matrix]


def minimising_controls(extremal: PhaseExtremal, arc: PropagatedPhase, t: Vector, p: Vector) -> Matrix:
    """Return the minimising control along an arc, (n, controls); at a switch, the one after it.

    Parameters
    ----------
    extremal
        The canonical equations of the phase.
    arc
        The phase as it was flown.
    t
        Times, canonical, (n,).
    p
        Numbers of the canonical equations.
    """
    modes, z = arc.modes(t), arc(t)
    out = np.zeros((len(t), extremal.reports[0].size1_out(0)))
    for mode in np.unique(modes):
        here = modes == mode
        points = z[here]
        out[here] = _control_of_mode(extremal, int(mode), points, p)
    return out


def _control_of_mode(extremal: PhaseExtremal, mode: int, z: Matrix, p: Vector) -> Matrix:
    """Return the control in one mode at points z (n, nz)."""
    return _evaluate_mapped(_first_output(extremal.reports[mode]), z, np.tile(p, (len(z), 1)))[0]


def _evaluate_mapped(function: ca.Function, *arguments: Matrix) -> list[Matrix]:
    """Evaluate a function of columns, all of them dense, at many points: (n, m) from (n, k) each.

    In NumPy's own arrays: to make CasADi's of them takes several times as long as to evaluate.
    """
    count = len(arguments[0])
    buffer, evaluate = cast(Any, _mapped(function, count)).buffer()
    taken = [np.ascontiguousarray(argument, dtype=float).ravel() for argument in arguments]
    found = [np.empty((count, function.size1_out(i))) for i in range(function.n_out())]
    for i, array in enumerate(taken):
        buffer.set_arg(i, memoryview(cast(Any, array)))
    for i, array in enumerate(found):
        buffer.set_res(i, memoryview(cast(Any, array.ravel())))
    evaluate()
    return found


@lru_cache(maxsize=256)
def _mapped(function: ca.Function, count: int) -> ca.Function:
    """Map a function over so many points."""
    return function.map(count)


@lru_cache(maxsize=64)
def _first_output(report: ca.Function) -> ca.Function:
    """Return a function of only its first output."""
    z, p = (ca.SX.sym(name, report.size1_in(i)) for i, name in enumerate("zp"))
    return ca.Function("first", [z, p], [ca.densify(report(z, p)[0])])


@lru_cache(maxsize=64)
def _rates_and_control_function(rate: ca.Function, report: ca.Function) -> ca.Function:
    """Join both functions in one: (z, the z that decides the control, numbers) -> (z', u, u')."""
    z, decides, p = (ca.SX.sym(name, report.size1_in(i)) for i, name in ((0, "z"), (0, "d"), (1, "p")))
    return ca.Function("together", [z, decides, p], [ca.densify(x) for x in (rate(z, p), *report(decides, p)[:2])])


def _rates_and_control(
    extremal: PhaseExtremal, mode: int, z: Matrix, decides: Matrix, p: Vector
) -> tuple[Matrix, Matrix, Matrix]:
    """Return (z', u, u') in one mode: z' at points z (n, nz), the control at those that decide it."""
    together = _rates_and_control_function(extremal.modes[mode], extremal.reports[mode])
    rate, u, u_rate = _evaluate_mapped(together, z, decides, np.tile(p, (len(z), 1)))
    return rate, u, u_rate


def assemble_trajectories(
    problem: Problem, conditions: OptimalityConditions, y: Vector, flown: Sequence[PropagatedPhase]
) -> tuple[Trajectory, ...]:
    """Return curves of state, costate and control of each phase in SI; a repeated node marks a switch.

    Parameters
    ----------
    problem, conditions, y
        As for `free_values`.
    flown
        Each phase as it was flown.
    """
    free = free_values(problem, conditions, y)
    whole = sum(arc.duration for arc in flown)
    return tuple(_assemble_phase(problem, conditions, k, arc, free, whole) for k, arc in enumerate(flown))


def _assemble_phase(
    problem: Problem,
    conditions: OptimalityConditions,
    k: int,
    arc: PropagatedPhase,
    free: Mapping[str, float],
    whole: float,
) -> Trajectory:
    phase, extremal = problem.phases[k], conditions.phases[k]
    n, half, width = extremal.state_count, extremal.half, len(phase.control_names)
    x_scale, reached = state_scales(problem, phase), np.abs(arc.z).max(axis=0)
    size = np.maximum(1.0, reached)
    size[:n] = reached_sizes(problem.scales, phase.states, arc.z[:, :n].T * x_scale[:, None]) / x_scale
    u_scale = control_scales(phase.controls, problem.scales)
    scale = np.concatenate([x_scale, objective_scale(problem) / x_scale, u_scale])
    plain = np.concatenate([_STATES * size[:n], _COSTATES * size[half : half + n], np.full(width, _CONTROLS)])

    numbers, parameters = extremal_parameters(problem), problem.parameters(free)
    ranges = [control.limits(parameters) for at, control in scalars(phase.controls) if at in extremal.periodic]
    turns = _turns(extremal, arc, numbers, ranges)

    def changed(error: Matrix, rate: Matrix) -> Vector:
        """H is lam.f, and its size J over the whole flight: dH = x'.dlam - lam'.dx, as u minimises it."""
        of_state, of_costate = slice(n), slice(n, 2 * n)
        change = (error[:, of_costate] * rate[:, of_state] - rate[:, of_costate] * error[:, of_state]).sum(axis=1)
        return np.abs(change) * whole / _CHANGED

    def told(tolerance: Vector) -> tuple[Vector, Matrix, Matrix]:
        nodes, values, rates = _arc_nodes(extremal, arc, tolerance, numbers, changed, turns)
        return nodes, values * scale, rates * scale / problem.scales.time

    nodes, values, rates = told(plain)
    some = values[:: 1 + len(values) // _LOOKS]
    leverage = _control_leverage(problem, phase, parameters, (some[:, :n].T, some[:, 2 * n :].T), size[:n])
    finer = np.concatenate([np.ones(2 * n), leverage])
    if (finer > 1.0).any():
        nodes, values, rates = told(plain / finer)
    cut, time = np.split(np.arange(2 * n + width), [n, 2 * n]), nodes * problem.scales.time
    state, costate, control = (Curve(time=time, values=values[:, at], rates=rates[:, at]) for at in cut)
    return Trajectory(phase=phase.name, state=state, control=control, costate=costate)


def _turns(extremal: PhaseExtremal, arc: PropagatedPhase, p: Vector, ranges: Sequence[tuple[float, float]]) -> Turns:
    """Return (t, u) -> the whole turns [rad] by which angles in u go on without a jump, where their range has room."""
    t, ahead = np.linspace(0.0, arc.duration, _TURNS), dict[int, Vector]()
    whole = np.unwrap(minimising_controls(extremal, arc, t, p), axis=0) if extremal.periodic else np.zeros((0, 0))
    for place, (lower, upper) in zip(extremal.periodic, ranges, strict=True):
        least, most = whole[:, place].min(), whole[:, place].max()  # NaN where nothing points it
        up, down = (math.ceil(np.fmax(0.0, missing) / _TURN) for missing in (lower - least, most - upper))
        moved = _TURN * (up - down)
        if lower <= least + moved and most + moved <= upper:
            ahead[place] = whole[:, place] + moved

    def turns(at: Vector, u: Matrix) -> Matrix:
        found = np.zeros(u.shape)
        for place, values in ahead.items():
            found[:, place] = _TURN * np.round((np.interp(at, t, values) - u[:, place]) / _TURN)
        return found

    return turns


def _arc_nodes(
    extremal: PhaseExtremal,
    arc: PropagatedPhase,
    tolerance: Vector,
    p: Vector,
    changed: Callable[[Matrix, Matrix], Vector],
    turns: Turns,
) -> tuple[Vector, Matrix, Matrix]:
    """Return times, and state, costate and control there with their rates, canonical; a switch stands there twice.

    Where a velocity is free the costate that points the thrust vanishes at the end, and rounding lets it pass through
    zero just before: the control at an end of the phase is the one a moment inside, where rounding decides it.
    """
    n, half, duration = extremal.state_count, extremal.half, arc.duration
    nothing = _NOTHING * duration
    # One that occurs as the phase begins or ends (a table may end on the ground) leaves no piece of its own.
    inside = [t for t in arc.switches if abs(t - 0.5 * duration) < (0.5 - _NOTHING) * duration]
    # Nor do two controls that switch at once, as what is pulled one way and pushed the other, leave one between them.
    inside = [t for before, t in pairwise([-np.inf, *sorted(inside)]) if t - before > nothing]
    joints = [t for t in arc.begins[1:].tolist() if np.abs(t - np.array([np.inf, *inside])).min() > nothing]
    first, last = (_resolved_control_time(extremal, arc, end, p) for end in (0.0, duration))
    pieces = []
    for left, right in pairwise([0.0, *sorted([*inside, *joints]), duration]):
        mode = int(arc.modes(np.array([0.5 * (left + right)]))[0])

        def evaluate(
            t: Vector, left: float = left, mode: int = mode, before: float = np.nextafter(right, left)
        ) -> tuple[Matrix, Matrix]:
            at = np.minimum(left + t, before)  # at the switch itself the costate may have jumped
            z, decides = arc(at), arc(np.clip(at, first, last))
            rate, u, u_rate = _rates_and_control(extremal, mode, z, decides, p)
            values = np.hstack([z[:, :n], z[:, half : half + n], u + turns(at, u)])
            return values, np.hstack([rate[:, :n], rate[:, half : half + n], u_rate])

        nodes, *there = hermite_nodes(evaluate, right - left, tolerance, shortest=nothing, together=changed)
        # The last node is the switch itself, not a sum that may miss it by one rounding; a joint is the next piece's.
        piece = np.append(left + nodes[:-1], right), *there
        pieces.append([part[:-1] for part in piece] if right in joints else piece)
    _reconcile_switch_values(pieces, slice(2 * n, None))
    nodes, values, rates = (np.concatenate(part) for part in zip(*pieces, strict=True))
    return nodes, values, rates


def _reconcile_switch_values(pieces: Sequence[Sequence[Any]], controls: slice) -> None:
    """Give both sides of a switch through which a control goes on the value of the side that turns less.

    Behind a limit on its tilt a thrust may turn over at once. What the rounding of the switch, or of a costate near
    zero, makes of it there is beyond the limit.
    """
    for (time, values, rates), (later, ahead, slopes) in pairwise(pieces):
        before, after = values[-1, controls], ahead[0, controls]
        if time[-1] == later[0] and np.abs(before - after).max(initial=0.0) <= _GOES_ON:
            slower = np.abs(rates[-1, controls]).max(initial=0.0) <= np.abs(slopes[0, controls]).max(initial=0.0)
            (after if slower else before)[:] = before if slower else after


def _resolved_control_time(extremal: PhaseExtremal, arc: PropagatedPhase, end: float, p: Vector) -> float:
    """Return the time nearest to an end of a phase at which its control is more than rounding.

    Where what points a direction vanishes at the end, its rounding over its distance from there is all that is left of
    it; further inside the control itself is another. Between the two it changes least.
    """
    duration, inwards = arc.duration, 1.0 if end == 0.0 else -1.0

    def control(share: float) -> Vector:
        t = np.array([end + inwards * share * duration])
        return _control_of_mode(extremal, int(arc.modes(t)[0]), arc(t), p)[0]

    def change(share: float) -> float:
        return float(np.nan_to_num(np.abs(control(2 * share) - control(share)), nan=np.inf).max(initial=0.0))

    shares = [_NOTHING * 10.0**k for k in range(_DECADES)]
    best = shares[0] if change(shares[0]) <= _CLEAR else min(shares, key=change)
    return end + inwards * best * duration


def _control_leverage(problem: Problem, phase: Phase, p: Any, flown: tuple[Matrix, Matrix], size: Vector) -> Vector:
    """Return how far an error of each control along the whole phase moves the states, by their sizes, and at least 1.

    In a descent that nearly hovers much more speed goes through the engine than the flight changes.

    Parameters
    ----------
    problem, phase, p
        The phase, and the record of all parameters in SI.
    flown
        States (n, points) and controls (components, points) along the phase [SI].
    size
        Sizes of the states [SI], (n,).
    """
    (x, u), x_scale = flown, state_scales(problem, phase)
    scale = control_scales(phase.controls, problem.scales)

    def rates(u: Matrix) -> Matrix:
        return np.array([full(rate, x[0]) for rate in phase.rates(list(x), list(u), p)])

    moved = [np.abs(rates(u + step[:, None]) - rates(u)) / _DIFFERENCE for step in _DIFFERENCE * np.diag(scale)]
    by = [(change.mean(axis=1) * getattr(p, phase.duration) / x_scale / size).max() for change in moved]
    return np.maximum(1.0, np.array(by) / _PLAIN)
