"""Active mixed constraints: which the control can keep, the direction that keeps them, and their multipliers.

A condition of the path that is linear in a direction, c = a . d - b >= 0, leaves a cap of the sphere. Where -g/|g| lies
outside, the least of g . d is on its rim, d = b/|a| a/|a| - sqrt(1 - (b/|a|)^2) h/|h| with h the part of g across a;
where two of them are active, in a corner. A condition of scalars only leaves a range of one, or a part of a plane of
more: where it is active they are given by it and by the rest of H (`perilune.conditions.scalar_regimes`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import casadi as ca
import numpy as np

from perilune.conditions.scalar_regimes import pivots
from perilune.core import PeriluneError
from perilune.problem import Phase, Regime, Settled, directions, scalars

Held = tuple[str, ...]  # conditions of the path by name


def depends_on_direction(phase: Phase, condition: ca.SX, u: ca.SX) -> bool:
    """Return True if a condition depends on a direction.

    Parameters
    ----------
    phase
        The phase.
    condition
        An expression of its control.
    u
        Symbols of the control.
    """
    return any(ca.depends_on(condition, u[first:last]) for first, last in directions(phase.controls))


def attainable_as_equality(phase: Phase, condition: ca.SX, u: ca.SX) -> bool:
    """Return True if a condition of the path is linear in only one direction, or depends on scalars only.

    Parameters
    ----------
    phase, condition, u
        As for `depends_on_direction`.
    """
    if depends_on_direction(phase, condition, u):
        return _direction_of(phase, condition, u) is not None
    acting = [control for at, control in scalars(phase.controls) if ca.depends_on(condition, u[at])]
    return bool(acting) and not any(isinstance(control, Settled) for control in acting)


def multiplier_term(
    phase: Phase, hamiltonian: ca.SX, u: ca.SX, held: Sequence[ca.SX], z: ca.SX, regimes: Sequence[Regime]
) -> ca.SX:
    """Return the term (dc/dz)' mu that active conditions c = 0 add to -dH/dz, as a function of the control u.

    Parameters
    ----------
    phase
        The phase whose controls hold the conditions.
    hamiltonian, u
        H as an expression of the symbols u of the phase's controls, among others.
    held
        Conditions c of the control that are held at zero.
    z
        Symbols of states and costates.
    regimes
        Regimes of the scalars in the mode.

    Returns
    -------
    casadi.SX
        A column of the length of z.
    """
    if not any(ca.depends_on(c, z) for c in held):
        return ca.SX.zeros(z.numel(), 1)
    return ca.jtimes(ca.vertcat(*held), z, active_constraint_multipliers(phase, hamiltonian, u, held, regimes), True)


def active_constraint_multipliers(
    phase: Phase, hamiltonian: ca.SX, u: ca.SX, held: Sequence[ca.SX], regimes: Sequence[Regime]
) -> ca.SX:
    """Return the multipliers mu of conditions c = 0 that are held, a column of functions of the control u.

    H - mu.c is stationary in the control: mu of a direction's conditions from the tangents of the sphere and scalars
    between their bounds, that of scalars' conditions from their slopes. `regimes` are those of the scalars.

    Parameters
    ----------
    phase
        The phase whose controls hold the conditions.
    hamiltonian, u
        H as an expression of the symbols u of the controls, among others.
    held
        Conditions c that are held at zero.
    regimes
        Regime of each scalar, in their order.
    """
    places = {at: regime for (at, _), regime in zip(scalars(phase.controls), regimes, strict=True)}
    slopes, rest, found = ca.gradient(hamiltonian, u), list(range(len(held))), ca.SX.zeros(len(held), 1)
    for first, last in directions(phase.controls):
        own = [i for i in rest if ca.depends_on(held[i], u[first:last])]
        if own:
            d, c = u[first:last], ca.vertcat(*(held[i] for i in own))
            sphere = ca.SX.eye(d.numel()) - ca.mtimes(d, d.T)
            between = [at for at, regime in places.items() if regime == "interior"]
            free = ca.vertcat(ca.SX(0, 1), *(u[i] for i in between))
            G = ca.horzcat(ca.mtimes(ca.jacobian(c, d), sphere), ca.jacobian(c, free))
            found[own] = ca.solve(
                ca.mtimes(G, G.T), ca.mtimes(G, ca.vertcat(slopes[first:last], *(slopes[i] for i in between)))
            )
            slopes -= ca.jtimes(c, u, found[own], True)
            rest = [i for i in rest if i not in own]
    if rest:
        told, c = [at for at, regime in places.items() if regime == "held"], ca.vertcat(*(held[i] for i in rest))
        C = ca.jacobian(c, ca.vertcat(*(u[at] for at in told)))
        found[rest] = ca.solve(ca.mtimes(C, C.T), ca.mtimes(C, ca.vertcat(*(slopes[at] for at in told))))
    return found


def _direction_of(phase: Phase, condition: ca.SX, u: ca.SX) -> tuple[int, int] | None:
    """Return the first and last place of the direction in which a condition is linear; None where it is not."""
    for first, last in directions(phase.controls):
        part, others = u[first:last], ca.vertcat(ca.SX(0, 1), u[:first], u[last:])
        if ca.depends_on(condition, part):
            linear = not ca.depends_on(ca.gradient(condition, part), part)
            return (first, last) if linear and not ca.depends_on(condition, others) else None
    return None


def enumerate_active_sets(phase: Phase, u: ca.SX, kept: Mapping[str, ca.SX]) -> list[Held]:
    """Enumerate conditions that can be held at once: one of a direction, or two in space; one of each scalar.

    Parameters
    ----------
    phase
        The phase.
    u
        Symbols of its control.
    kept
        Conditions of the path that the control can keep, by name.

    Returns
    -------
    list
        Tuples of names, the empty one among them.
    """
    of = {name: _direction_of(phase, condition, u) for name, condition in kept.items()}
    turning, others = [n for n in kept if of[n] is not None], [n for n in kept if of[n] is None]
    pairs = [
        (a, b)
        for a, b in combinations(turning, 2)
        if (at := of[a]) is not None and at == of[b] and at[1] - at[0] == 3 and not _share_one_axis(kept[a], kept[b], u)
    ]
    symbols = [u[at] for at, _ in scalars(phase.controls)]
    sets = [
        held
        for count in range(len(others) + 1)
        for held in combinations(others, count)
        if pivots(symbols, [kept[name] for name in held]) is not None
    ]
    every = ({*one, *other} for one in sets for other in [(), *((n,) for n in turning), *pairs])
    return [tuple(name for name in kept if name in held) for held in every]


def _share_one_axis(one: ca.SX, other: ca.SX, u: ca.SX) -> bool:
    """Return True if two conditions have one axis, as seen at a few points."""
    turn = ca.vertcat(ca.gradient(one, u), ca.gradient(other, u))
    symbols = ca.symvar(turn)
    evaluate = ca.Function("axes", [ca.vertcat(ca.SX(0, 1), *symbols)], [turn])
    rng = np.random.default_rng(0)
    for _ in range(3):
        a, b = np.array(evaluate(rng.uniform(0.5, 1.5, len(symbols)))).reshape(2, -1)
        if np.linalg.norm(a) * np.linalg.norm(b) - abs(a @ b) > 1e-9 * np.linalg.norm(a) * np.linalg.norm(b):
            return False
    return True


def require_attainable(phase: Phase, name: str, condition: ca.SX, u: ca.SX) -> None:
    """Refuse a condition to be held that is neither linear in one direction nor one of scalars only.

    Parameters
    ----------
    phase
        The phase that holds the condition.
    name
        Name of the condition, for the message.
    condition, u
        The condition as an expression of the symbols u of the control.
    """
    for first, last in directions(phase.controls):
        part = u[first:last]
        if ca.depends_on(condition, part):
            if not ca.depends_on(ca.gradient(condition, part), part):
                return
            break
    else:
        if any(ca.depends_on(condition, u[at]) for at, _ in scalars(phase.controls)):
            return
    raise PeriluneError(
        f"the indirect method cannot keep {name} active along {phase.name}",
        got="a condition that is linear in one direction, or one of scalars only",
        expected="an active condition that determines the control",
        advice="use the direct method: solve(problem, Pseudospectral())",
    )


def minimising_direction(gradient: ca.SX, d: ca.SX, held: Sequence[ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Minimise gradient . d over the unit sphere with up to two linear conditions held.

    Parameters
    ----------
    gradient
        Slope of H in the direction.
    d
        Symbols of the direction, two or three.
    held
        Conditions that are linear in d.

    Returns
    -------
    (direction, room)
        `room` is >= 0 where a direction holds the conditions; empty where there are none.
    """
    if not held:
        return -gradient / ca.norm_2(gradient), ca.SX(0, 1)
    if len(held) == 1:
        axis, share = unit_share(held[0], d)
        across, room = gradient - ca.dot(gradient, axis) * axis, 1 - share * share
        return share * axis - real_root(room) * across / ca.norm_2(across), room
    axes = [ca.gradient(c, d) for c in held]
    shares = ca.vertcat(*(-ca.substitute(c, d, ca.SX.zeros(d.numel(), 1)) for c in held))
    A = ca.horzcat(*axes)
    base, normal = ca.mtimes(A, ca.solve(ca.mtimes(A.T, A), shares)), ca.cross(axes[0], axes[1])
    down = ca.if_else(ca.dot(gradient, normal) > 0, -normal, normal) / ca.norm_2(normal)
    room = 1 - ca.sumsqr(base)
    return base + real_root(room) * down, room


def real_root(square: ca.SX) -> ca.SX:
    """Return the square root of what is not negative, and a number of what is.

    Of several laws the best one is chosen. Derivatives are taken of all, and those of the others multiplied by zero:
    that a NaN among them would not stand.
    """
    return ca.sqrt(ca.if_else(square >= 0, square, 1.0))


def unit_share(condition: ca.SX, d: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return a linear condition on d as axis . d = share, with an axis of length one.

    Parameters
    ----------
    condition
        An expression that is linear in d.
    d
        Symbols of the direction, two or three.

    Returns
    -------
    (axis, share)
        A unit vector and an expression without d.
    """
    axis = ca.gradient(condition, d)
    size = ca.norm_2(axis)
    return axis / size, -ca.substitute(condition, d, ca.SX.zeros(d.numel(), 1)) / size
