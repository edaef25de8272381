"""Junction conditions of constrained arcs: continuity of the control at entry and exit, and contact points.

The time of such a joint is free, so H is the same on both sides. Outside the arc H- is the minimum over the control,
and at most H+, the value of the control on the arc: the difference is never positive, and its zero is a double root, of
which Newton's method finds half the digits. Where the minimum is unique H- = H+ says that the control goes on without a
jump. So

    c(x, u*(x, lambda)) = 0    at the joint, by the minimising control of the adjacent arc,

replaces the row of that duration: a simple root (Jacobson, Lele, Speyer 1971, on junction conditions). A
scalar that jumps there from its bound has a simple root in H and keeps its row.

At a *contact point* of a condition S(x) >= 0 of the path, with S = 0 and S' = 0 as conditions at the end of a phase,
the costates jump by nu dS/dx only. With a multiplier nu' of S' = 0 they jump by nu' dS'/dx as well, and H by
nu' S'': the row of H determines nu' the worse the less S'' is, and has another root, at which u and -u of S'' change
over. nu' = 0 replaces it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import casadi as ca
import numpy as np

from perilune.conditions.canonical_equations import PhaseExtremal, minimising_control_at
from perilune.problem import SYMBOLIC, Parameters, Phase, Problem, column, control_slices, elements


def smooth_junction_rows(
    problem: Problem,
    p: Parameters,
    extremals: list[PhaseExtremal],
    sides: list[tuple[ca.SX, ca.SX]],
    numbers: ca.SX,
    slopes: ca.SX,
) -> Iterator[tuple[int, str, ca.SX]]:
    """Yield rows of free durations that a control without a jump fixes: number of the free parameter, name, expression.

    Parameters
    ----------
    problem, p, extremals, numbers
        The problem, its parameters, the canonical equations of each phase and the numbers that they take.
    sides
        For each joint z at the end of the phase before and at the start of the phase behind.
    slopes
        dJ/dq of every free parameter without H: where two durations share it, their rows state equal H.
    """
    for k, first in _free_junctions(problem, slopes):
        before, behind = problem.phases[k : k + 2]
        entered, left = _sole_condition_ending(behind, before), _sole_condition_ending(before, behind)
        if entered is not None and left is None:
            held, row, beside = behind, entered, 0
        elif left is not None and entered is None:
            held, row, beside = before, left, 1
        else:
            continue
        z, extremal, phase = sides[k][beside], extremals[k + beside], (before, behind)[beside]
        u = minimising_control_at(extremal, z, numbers)
        symbol = ca.SX.sym("u", u.numel())
        x = elements(z[: extremal.state_count])
        value = column(held.evaluate("held", x, elements(symbol), p.record, SYMBOLIC))[row]
        if not _has_minimum_in_condition(phase, extremal, value, symbol):
            continue
        name = held.held_conditions[row].name
        yield (
            first,
            f"{phase.name}: {name} as it is {'met' if beside == 0 else 'left'}",
            ca.substitute(value, symbol, u),
        )


def contact_point_rows(
    problem: Problem, p: Parameters, ends: list[tuple[ca.SX, ca.SX, ca.SX]], slopes: ca.SX
) -> Iterator[tuple[int, str, ca.SX]]:
    """Yield rows of free durations that end at a contact point, in the form of `smooth_junction_rows`.

    Parameters
    ----------
    problem, p, slopes
        As for `smooth_junction_rows`.
    ends
        For each phase the states at its end, its end conditions there, and their multipliers.
    """
    for k, first in _free_junctions(problem, slopes):
        before, behind = problem.phases[k : k + 2]
        kept = {c.name for c in before.path_conditions} & {c.name for c in behind.path_conditions}
        if not kept or len(before.end_conditions) < 2:
            continue
        (x, psi, nu), u = ends[k], ca.SX.sym("u", len(before.control_names))
        rates = column(before.evaluate("dynamics", elements(x), elements(u), p.record, SYMBOLIC))
        path = column(before.evaluate("path", elements(x), elements(u), p.record, SYMBOLIC))
        for i, condition in enumerate(before.path_conditions):
            S, rate = path[i], ca.jtimes(path[i], x, rates)
            if condition.name not in kept or ca.depends_on(ca.vertcat(S, rate), u):
                continue
            met, still = (
                next((j for j in range(psi.numel()) if _equal_at_sample_points(psi[j], e)), None) for e in (S, rate)
            )
            if met is not None and still is not None:
                yield first, f"{before.name}: jump along the rate of {condition.name}", nu[still]


def _free_junctions(problem: Problem, slopes: ca.SX) -> Iterator[tuple[int, int]]:
    """Yield for each joint with nothing free but its time the number of the phase before and of the free parameter."""
    free = problem.free_names
    for k, pair in enumerate(pairwise(problem.phases)):
        if all(problem.duration_names.count(phase.duration) == 1 and phase.duration in free for phase in pair):
            first, second = (free.index(phase.duration) for phase in pair)
            if _equal_by_simplification(slopes[first], slopes[second]):
                yield k, first


def _equal_at_sample_points(one: ca.SX, other: ca.SX) -> bool:
    """Return True if two expressions, of whatever size, have the same values at a few points."""
    both = ca.vertcat(one, other)
    symbols, rng = ca.symvar(both), np.random.default_rng(0)
    evaluate = ca.Function("both", [ca.vertcat(ca.SX(0, 1), *symbols)], [both])
    values = [np.array(evaluate(rng.uniform(0.5, 1.5, len(symbols)))).ravel() for _ in range(3)]
    return all(np.isclose(a, b, rtol=1e-9, atol=0.0) for a, b in values)


def _sole_condition_ending(phase: Phase, other: Phase) -> int | None:
    """Return the place of the one condition that is held along the phase and not along the other."""
    known = {c.name for c in other.held_conditions}
    found = [i for i, c in enumerate(phase.held_conditions) if c.name not in known]
    same = phase.control_names == other.control_names and phase.state_names == other.state_names
    return found[0] if len(found) == 1 and same else None


def _equal_by_simplification(one: ca.SX, other: ca.SX) -> bool:
    return bool(ca.is_equal(one, other, 20)) or bool(ca.simplify(one - other).is_zero())


def _has_minimum_in_condition(phase: Phase, extremal: PhaseExtremal, value: ca.SX, u: ca.SX) -> bool:
    """Return True if H has a minimum inside the set of a control in the condition: a direction, or a scalar."""
    scalar = -1
    for here, control in control_slices(phase.controls):
        scalar += control.scalar
        acts = ca.depends_on(value, u[here])
        if acts and (not control.scalar or any(regimes[scalar] == "interior" for regimes in extremal.regimes)):
            return True
    return False
