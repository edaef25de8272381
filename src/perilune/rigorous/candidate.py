"""Candidate from a solution: the arcs of its extremal, and approximate values of the unknowns.

None of it is trusted: it says where to look, and the proof begins there.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from flint import arb

from perilune.problem import ScalarControl, Solution, scalars
from perilune.proof import PhaseData, end_bound_multipliers
from perilune.rigorous.boundary_value_problem import ArcPiece, BoundaryProblem, Sides
from perilune.rigorous.exact_tape import Unsupported
from perilune.rigorous.taylor import Ball

_ON_BOUND = 1e-7  # of the range of a control
_INSIDE = 1e-9  # of an arc: behind a jump


def suggested_pieces(solution: Solution) -> tuple[list[ArcPiece], list[float]]:
    """The arcs of a solution between the jumps of its control, and the length of each [s].

    Raises
    ------
    Unsupported
        If two scalars switch at once.
    """
    pieces, lengths = list[ArcPiece](), list[float]()
    for k, phase in enumerate(solution.problem.phases):
        own = list(scalars(phase.controls))
        trajectory = solution.trajectories[k]
        time = trajectory.control.time
        breaks = time[1:][np.diff(time) == 0] if own else time[:0]
        found = list[tuple[dict[str, str], float, float]]()
        for begin, end in pairwise(np.unique([0.0, *breaks, trajectory.duration]).tolist()):
            if end - begin <= 1e-9 * trajectory.duration:
                continue
            u = solution.evaluate(k, np.linspace(begin, end, 9)[1:-1])[1]
            regimes = {control.name: _regime(control, u[at], solution) for at, control in own}
            if found and found[-1][0] == regimes:
                found[-1] = (regimes, found[-1][1], end)
            else:
                found.append((regimes, begin, end))
        for number, (regimes, begin, end) in enumerate(found):
            changed = []
            if number + 1 < len(found):
                changed = [name for name, regime in regimes.items() if found[number + 1][0][name] != regime]
                if len(changed) > 1:
                    raise Unsupported(f"{' and '.join(changed)} switch at once")
            pieces.append(ArcPiece(phase=k, regimes=regimes, switched="".join(changed)))
            lengths.append(end - begin)
    return pieces, lengths


def sides_of(solution: Solution) -> Sides:
    """The bounds that a solution is on: free parameters, and at the ends of phases ranges and states."""
    problem, free, ranges = solution.problem, dict[str, str](), dict[tuple[str, str], str]()
    for f in problem.free:
        value = float(solution.free[f.name])
        near = _ON_BOUND * max(abs(value), problem.size_of(f) * _ON_BOUND)
        for side, limit in (("lower", f.lower), ("upper", f.upper)):
            if abs(value - limit) <= near:
                free[f.name] = side
    for k, phase in enumerate(problem.phases):
        ranged = [c for c in phase.end_conditions if c.ranged]
        if not ranged:
            continue
        values = phase.evaluate("end", solution.trajectories[k].state.values[-1], (), solution.parameters)
        for c, value in zip(phase.end_conditions, values, strict=True):
            if c.ranged:
                lower, upper = c.limits(solution.parameters)
                nu = solution.multipliers.get(f"{phase.name}.{c.name}", 0.0)
                nearer = "lower" if abs(value - lower) < abs(value - upper) else "upper"
                ranges[phase.name, c.name] = nearer if nu else "inside"
    states = {
        (phase.name, name): "upper" if mu > 0 else "lower"
        for k, phase in enumerate(problem.phases)
        for name, mu in end_bound_multipliers(PhaseData(solution=solution, index=k)).items()
    }
    return Sides(free=free, ranges=ranges, states=states)


def _regime(control: ScalarControl, u: np.ndarray, solution: Solution) -> str:
    lower, upper = control.limits(solution.parameters)
    near = _ON_BOUND * (upper - lower if np.isfinite(upper - lower) else 1.0)
    for name, on in zip(("lower", "upper"), control.on_bounds(u, near, solution.parameters), strict=True):
        if np.all(on):
            return name
    return "interior"


def unknowns_of(solution: Solution, boundary: BoundaryProblem, lengths: Sequence[float]) -> list[Ball]:
    """About where the root is, in the order of `boundary.names`.

    Parameters
    ----------
    solution
        Approximate extremal [SI].
    boundary
        The boundary value problem of its arcs.
    lengths
        Approximate duration of each arc, in the order of `boundary.pieces` [s].

    Raises
    ------
    Unsupported
        If the solution has no costates.
    """
    problem, found = solution.problem, list[float]()
    for k, trajectory in enumerate(solution.trajectories):
        if trajectory.costate is None:
            raise Unsupported("the solution has no costates")
        arc = next(arc for arc in boundary.arcs if arc.phase_index == k)
        found += [*trajectory.costate.values[0].tolist(), *([0.0] * len(arc.constants))]
    found += [float(solution.free[name]) for name in problem.free_names]
    for k, phase in enumerate(problem.phases):
        found += [float(solution.multipliers.get(f"{phase.name}.{c.name}", 0.0)) for c in phase.end_conditions]
        held = end_bound_multipliers(PhaseData(solution=solution, index=k))
        found += [held.get(phase.states[i].name, 0.0) for i in boundary.sides.held(phase)]
    found += [length for length, piece in zip(lengths, boundary.pieces, strict=True) if piece.switched]
    for i, (piece, arc) in enumerate(zip(boundary.pieces, boundary.arcs, strict=True)):
        if arc.implicit:
            before = sum(own for own, p in zip(lengths[:i], boundary.pieces, strict=False) if p.phase == piece.phase)
            u = solution.evaluate(piece.phase, np.array([before + _INSIDE * lengths[i]]))[1]
            at = dict(zip(arc.phase.control_names, u[:, 0], strict=True))
            found += [float(at[name]) for name in arc.implicit]
    return [arb(value) for value in found]
