"""When an arc begins and ends along which something is held: where the control of the arc beside it holds it too.

The time of such a joint is free, so H is the same on both sides. Beside the arc H- is the least that any control gives,
and at most what the held one gives, which is H+: the difference is never positive, and its zero is a double root, of
which Newton's method finds half the digits. Where the minimum is unique H- = H+ says that the control goes on without a
jump. So

    c(x, u*(x, lambda)) = 0    at the joint, by the best control of the arc beside it,

stands in the place of the row of that duration: a simple root (Jacobson, Lele, Speyer 1971, on junction conditions). A
scalar that jumps there from its bound has a simple root in H and keeps its row.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import casadi as ca

from perilune.conditions.canonical import PhaseExtremal, control_at
from perilune.problem.controls import placed
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.symbolic import SYMBOLIC, Parameters, column, elements


def smooth_joints(
    problem: Problem,
    p: Parameters,
    extremals: list[PhaseExtremal],
    sides: list[tuple[ca.SX, ca.SX]],
    numbers: ca.SX,
    slopes: ca.SX,
) -> Iterator[tuple[int, str, ca.SX]]:
    """Rows of free durations that are told by a control without a jump: number of the free parameter, name, expression.

    Parameters
    ----------
    problem, p, extremals, numbers
        The problem, its parameters, the canonical equations of each phase and the numbers that they take.
    sides
        For each joint z at the end of the phase before and at the start of the phase behind.
    slopes
        dJ/dq of every free parameter but for H: where two durations have the same, their rows say that H is the same.
    """
    free = problem.free_names
    for k, (before, behind) in enumerate(pairwise(problem.phases)):
        if not all(problem.duration_names.count(d) == 1 and d in free for d in (before.duration, behind.duration)):
            continue
        first, second = (free.index(phase.duration) for phase in (before, behind))
        entered, left = _only(behind, before), _only(before, behind)
        if entered is not None and left is None:
            held, row, beside = behind, entered, 0
        elif left is not None and entered is None:
            held, row, beside = before, left, 1
        else:
            continue
        if not _alike(slopes[first], slopes[second]):
            continue
        z, extremal, phase = sides[k][beside], extremals[k + beside], (before, behind)[beside]
        u = control_at(extremal, z, numbers)
        symbol = ca.SX.sym("u", u.numel())
        x = elements(z[: extremal.state_count])
        value = column(held.evaluate("held", x, elements(symbol), p.record, SYMBOLIC))[row]
        if not _bends(phase, extremal, value, symbol):
            continue
        name = held.held_conditions[row].name
        yield (
            first,
            f"{phase.name}: {name} as it is {'met' if beside == 0 else 'left'}",
            ca.substitute(value, symbol, u),
        )


def _only(phase: Phase, other: Phase) -> int | None:
    """Place of the one condition that is held along the phase and not along the other."""
    known = {c.name for c in other.held_conditions}
    found = [i for i, c in enumerate(phase.held_conditions) if c.name not in known]
    same = phase.control_names == other.control_names and phase.state_names == other.state_names
    return found[0] if len(found) == 1 and same else None


def _alike(one: ca.SX, other: ca.SX) -> bool:
    return bool(ca.is_equal(one, other, 20)) or bool(ca.simplify(one - other).is_zero())


def _bends(phase: Phase, extremal: PhaseExtremal, value: ca.SX, u: ca.SX) -> bool:
    """Whether the condition has a control in it of which H has a minimum inside its set: a direction, or a scalar."""
    scalar = -1
    for here, control in placed(phase.controls):
        scalar += control.scalar
        acts = ca.depends_on(value, u[here])
        if acts and (not control.scalar or any(regimes[scalar] == "interior" for regimes in extremal.regimes)):
            return True
    return False
