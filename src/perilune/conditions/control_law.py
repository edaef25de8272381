"""The control that minimises the Hamiltonian, regime by regime, from the Hamiltonian's own derivatives.

A `Direction` d enters H linearly, H = a + g . d, so its minimum on the circle or sphere is d = -g/|g|; for planar
thrust that is Cho et al. 2015 (15) with both signs right, beta = atan2(-lambda_v, -lambda_u). What is left is a
function of the scalars alone, whose slopes S = dH/du are the same with d in place (envelope theorem). A scalar in
which H is linear sits at a bound, at the upper one where S < 0. One in which H bends sits at a bound, or between them
where S = 0: in closed form where H is quadratic, else by Newton's method.

A scalar may be known to stay in one regime all along its phase (`perilune.problem.controls.Settled`): on a bound, or
singular, where what it does follows from the motion of state and costate (`perilune.conditions.singular`).

Conditions of the path that are linear in a direction are held where H asks for more (`perilune.conditions.held`).

A *mode* names the regime of every scalar and the conditions that are held; its control is smooth in (x, lambda). Zeros
of S, a control between its bounds that reaches one, and zeros of c with the control that leaves it out are the events
that lead from mode to mode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType

import casadi as ca
import numpy as np

from perilune.conditions.directions import directions_eliminated, no_law
from perilune.conditions.held import Held, together, told_scalar
from perilune.conditions.riding import riding_control
from perilune.conditions.singular import Motion, singular_control
from perilune.problem.controls import Bounded, Regime, Settled, scalars
from perilune.problem.phase import Phase
from perilune.problem.symbolic import elements

# Newton's method on S = 0 starts at the least of so many values of H, for one and for two controls at once.
_GRID = {1: 17, 2: 9}
_STEPS = 7  # from a grid point the error squares each time; one more step is taken where it is differentiated
_WIDEST = 5.0  # an open range is searched at sinh of -5 to 5, canonical


@dataclass(frozen=True, kw_only=True)
class Transition:
    """A zero of `function` rising (+1) or falling (-1) leads from mode to mode; a `steady` one without a jump of u."""

    function: ca.SX
    direction: int
    steady: bool
    switches: dict[int, int]


@dataclass(frozen=True, kw_only=True)
class ControlLaw:
    """The minimising control of a phase.

    Parameters
    ----------
    regimes
        For each mode the regime of each scalar, in the order of the phase's scalars.
    held
        For each mode the conditions of the path that are held, by name.
    control
        For each mode the whole control, a column of expressions.
    room
        For each mode a column of expressions: where one is negative, nothing holds what it should.
    solved
        For each mode None, or what is found by Newton's method: the control as an expression of w, the symbols w, and
        the values of w. The control is one more step from w, so that its derivative at fixed w is the whole one.
    transitions
        What leads from mode to mode.
    mode
        Number of the mode in which H is least.
    """

    regimes: tuple[tuple[Regime, ...], ...]
    held: tuple[Held, ...]
    control: tuple[ca.SX, ...]
    room: tuple[ca.SX, ...]
    solved: tuple[tuple[ca.SX, ca.SX, ca.SX] | None, ...]
    transitions: tuple[Transition, ...]
    mode: ca.SX


def minimising_control(
    phase: Phase,
    hamiltonian: ca.SX,
    u: ca.SX,
    limits: dict[str, tuple[ca.SX, ca.SX]],
    kept: Mapping[str, ca.SX] = MappingProxyType({}),
    always: Mapping[str, ca.SX] = MappingProxyType({}),
    motion: Motion | None = None,
) -> ControlLaw:
    """The control that minimises H.

    Parameters
    ----------
    phase
        Whose controls.
    hamiltonian, u
        H as an expression of the symbols u, among others.
    limits
        Lower and upper limit of each scalar by name; infinite where there is none.
    kept
        Conditions of the path by name, expressions of u that must not become negative; each must be `keepable`.
    always
        Expressions of u by name that vanish all along the phase: linear in a direction, or in one scalar alone.
    motion
        How state and costate move, which a singular scalar has to know.

    Raises
    ------
    PeriluneError
        If H is linear in a scalar without bounds, or in a direction not linear, or a direction depends on a scalar.
    """
    told = {name: told_scalar(phase, name, value, u) for name, value in always.items()}
    scalar_told = dict(found for found in told.values() if found is not None)
    turning = {name: value for name, value in always.items() if told[name] is None}
    modes, controls, stepped, values = list[_Mode](), list[ca.SX](), list[tuple[ca.SX, ca.SX, ca.SX]](), list[ca.SX]()
    rooms = list[ca.SX]()
    for held in together(phase, u, kept):
        here = {**turning, **{name: kept[name] for name in held}}
        reduced, law, room = directions_eliminated(phase, hamiltonian, u, limits, here)
        kinds = [
            _Scalar(phase, at, control, reduced, u, limits[control.name], scalar_told.get(at))
            for at, control in scalars(phase.controls)
        ]
        for regimes in product(*(kind.regimes for kind in kinds)):
            ridden = riding_control(phase, hamiltonian, u, here) if regimes == ("interior",) else None
            none = ca.SX(0, 1)
            step = _control(phase, reduced, law, u, kinds, regimes) if ridden is None else (ridden[0], none, none)
            if "singular" in regimes:
                step = _without_singular(phase, hamiltonian, u, kinds, step, motion, held)
            modes.append(_Mode(held=held, regimes=regimes, kinds=kinds))
            stepped.append(step)
            controls.append(ca.substitute(*step))
            rooms.append(ca.substitute(room, u, controls[-1]) if ridden is None else ridden[1])
            others = [c for name, c in kept.items() if name not in held]
            values.append(_value(hamiltonian, u, modes[-1], controls[-1], [*others, *elements(rooms[-1])]))
    return ControlLaw(
        regimes=tuple(mode.regimes for mode in modes),
        held=tuple(mode.held for mode in modes),
        control=tuple(controls),
        room=tuple(rooms),
        solved=tuple(step if step[1].numel() else None for step in stepped),
        transitions=tuple(_transitions(u, modes, controls, kept)),
        mode=_least(values),
    )


@dataclass(frozen=True, kw_only=True)
class _Mode:
    """What names a mode, and its scalars with directions in place."""

    held: Held
    regimes: tuple[Regime, ...]
    kinds: list[_Scalar]


class _Scalar:
    """A scalar control with the slope S of H in it, directions in place."""

    def __init__(
        self,
        phase: Phase,
        at: int,
        control: Bounded,
        reduced: ca.SX,
        u: ca.SX,
        limits: tuple[ca.SX, ca.SX],
        told: ca.SX | None,
    ) -> None:
        self.at, self.control, self.limits, self.told, self.symbol = at, control, limits, told, u[at]
        if told is not None:
            self.regimes: tuple[Regime, ...] = ("held",)
            return
        self.slope = ca.gradient(reduced, u[at])
        self.linear = not ca.depends_on(self.slope, u[at])
        if isinstance(control, Settled):
            if control.regime == "singular" and not self.linear:
                raise no_law(phase, control.names, "a Hamiltonian that bends in it, and so no singular arc")
            self.regimes = (control.regime,)
            return
        lower, upper = (not (limit.is_constant() and np.isinf(float(limit))) for limit in limits)
        if self.linear and not (lower and upper):
            raise no_law(phase, control.names, "a Hamiltonian that is linear in it, and no bounds")
        between: tuple[Regime, ...] = () if self.linear else ("interior",)
        self.regimes = (*(("lower",) if lower else ()), *between, *(("upper",) if upper else ()))

    def value(self, regime: Regime) -> ca.SX:
        """The control at a bound, or as a held condition says; of a singular one its symbol."""
        if regime == "singular":
            return self.symbol
        return self.limits[regime == "upper"] if self.told is None else self.told


def _control(
    phase: Phase,
    reduced: ca.SX,
    law: list[ca.SX],
    u: ca.SX,
    kinds: list[_Scalar],
    regimes: tuple[Regime, ...],
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """The whole control in one mode, with symbols w in it for what is solved for, and the values of w."""
    held = [(kind.at, kind.value(regime)) for kind, regime in zip(kinds, regimes, strict=True) if regime != "interior"]
    free = [kind for kind, regime in zip(kinds, regimes, strict=True) if regime == "interior"]
    places, values, w, found = [at for at, _ in held], [value for _, value in held], ca.SX(0, 1), ca.SX(0, 1)
    if free:
        symbols = ca.vertcat(*(u[kind.at] for kind in free))
        H = _put(reduced, u, places, values)
        best, w, found = _interior(phase, H, symbols, free)
        values += elements(best)
        places += [kind.at for kind in free]
    whole = ca.vertcat(ca.SX(0, 1), *law)
    return _put(whole, u, places, values), w, found


def _without_singular(
    phase: Phase,
    hamiltonian: ca.SX,
    u: ca.SX,
    kinds: list[_Scalar],
    step: tuple[ca.SX, ca.SX, ca.SX],
    motion: Motion | None,
    held: Held,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """The control of `_control` with what the motion says in place of the symbol of the singular scalar."""
    singular = [kind for kind in kinds if kind.regimes == ("singular",)]
    control, solved, _ = step
    if motion is None or len(singular) > 1 or solved.numel():
        names = tuple(kind.control.name for kind in singular)
        raise no_law(phase, names, "more than one singular control, or one beside a control without a formula")
    (kind,) = singular
    slope = ca.substitute(ca.gradient(hamiltonian, kind.symbol), u, control)
    name = f"{kind.control.name} of {phase.name}"
    found = singular_control(name, slope, kind.symbol, motion.z, motion.rate(control, held))
    return ca.substitute(control, kind.symbol, found), ca.SX(0, 1), ca.SX(0, 1)


def _put(expression: ca.SX, u: ca.SX, places: list[int], values: list[ca.SX]) -> ca.SX:
    """An expression with values in the place of some controls."""
    symbols = ca.vertcat(ca.SX(0, 1), *(u[i] for i in places))
    return ca.substitute(expression, symbols, ca.vertcat(ca.SX(0, 1), *values))


def _interior(phase: Phase, H: ca.SX, u: ca.SX, free: list[_Scalar]) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Where the slopes of H vanish: in closed form where H is quadratic, else a step from w, which Newton finds."""
    slope = ca.gradient(H, u)
    bend = ca.jacobian(slope, u)
    if not ca.depends_on(bend, u):
        closed = -ca.solve(bend, ca.substitute(slope, u, ca.SX.zeros(u.numel(), 1)))
        return closed, ca.SX(0, 1), ca.SX(0, 1)
    if len(free) not in _GRID:
        names = tuple(kind.control.name for kind in free)
        raise no_law(phase, names, "more than two controls that bend the Hamiltonian together")
    grids = [_grid(kind, _GRID[len(free)]) for kind in free]
    at, least = None, None
    for corner in product(*grids):
        point = ca.vertcat(*corner)
        value = ca.substitute(H, u, point)
        if at is None or least is None:
            at, least = point, value
        else:
            better = value < least
            at, least = ca.if_else(better, point, at), ca.if_else(better, value, least)
    assert at is not None
    reach = ca.vertcat(*(ca.fabs(grid[1] - grid[0]) for grid in grids))
    # |bend| keeps a single control on the way down where H is not convex.
    step = -slope / ca.fabs(bend) if len(free) == 1 else -ca.solve(bend, slope)
    for _ in range(_STEPS):
        at = at + ca.fmax(-reach, ca.fmin(reach, ca.substitute(step, u, at)))
    w = ca.SX.sym("w", u.numel())
    return ca.substitute(u - ca.solve(bend, slope), u, w), w, at


def _grid(kind: _Scalar, count: int) -> list[ca.SX]:
    """Values over the range of a scalar, canonical."""
    lower, upper = kind.limits
    if kind.control.bounded:
        return [lower + share * (upper - lower) for share in np.linspace(0.0, 1.0, count)]
    if kind.control.unit == "rad":
        return [ca.SX(value) for value in np.linspace(-np.pi, np.pi, count)]
    return [ca.SX(value) for value in np.sinh(np.linspace(-_WIDEST, _WIDEST, count))]


def _transitions(u: ca.SX, modes: list[_Mode], controls: list[ca.SX], kept: Mapping[str, ca.SX]) -> list[Transition]:
    """All ways from mode to mode; what is the same function in several modes is one."""
    found: dict[tuple[str, int, bool], Transition] = {}
    names = [(mode.held, mode.regimes) for mode in modes]

    def way(before: int, after: tuple[Held, tuple[Regime, ...]], function: ca.SX, direction: int, steady: bool) -> None:
        key = _text(function), direction, steady
        known = found.setdefault(key, Transition(function=function, direction=direction, steady=steady, switches={}))
        known.switches[before] = names.index(after)

    for before, mode in enumerate(modes):
        for i, (kind, regime) in enumerate(zip(mode.kinds, mode.regimes, strict=True)):
            for after, function, direction in _ways(kind, regime, controls[before], u):
                regimes = (*mode.regimes[:i], after, *mode.regimes[i + 1 :])
                way(before, (mode.held, regimes), function, direction, not kind.linear)
        for name, condition in kept.items():
            more = tuple(n for n in kept if n in mode.held or n == name)
            if name not in mode.held and (more, mode.regimes) in names:
                # The best control without the condition breaks it from here on, or no longer does.
                function = ca.substitute(condition, u, controls[before])
                way(before, (more, mode.regimes), function, -1, True)
                way(names.index((more, mode.regimes)), (mode.held, mode.regimes), function, 1, True)
    return list(found.values())


def _ways(kind: _Scalar, regime: Regime, control: ca.SX, u: ca.SX) -> list[tuple[Regime, ca.SX, int]]:
    """(regime after, function, direction) of what leads a scalar out of a regime."""
    if len(kind.regimes) == 1:
        return []
    if regime == "interior":
        value, out = control[kind.at], list[tuple[Regime, ca.SX, int]]()
        if "upper" in kind.regimes:
            out.append(("upper", value - kind.limits[1], 1))
        if "lower" in kind.regimes:
            out.append(("lower", value - kind.limits[0], -1))
        return out
    slope = ca.substitute(kind.slope, u, control)
    if regime == "upper":
        return [("lower" if kind.linear else "interior", slope, 1)]
    return [("upper" if kind.linear else "interior", slope, -1)]


def _value(hamiltonian: ca.SX, u: ca.SX, mode: _Mode, control: ca.SX, others: Sequence[ca.SX]) -> ca.SX:
    """H in a mode; infinite where a control is not between its bounds, or breaks another condition of the path."""
    value = ca.substitute(hamiltonian, u, control)
    for kind, regime in zip(mode.kinds, mode.regimes, strict=True):
        if regime == "interior":
            here = control[kind.at]
            value = ca.if_else(ca.logic_and(kind.limits[0] <= here, here <= kind.limits[1]), value, np.inf)
    for condition in others:
        value = ca.if_else(ca.substitute(condition, u, control) >= 0, value, np.inf)
    return value


def _least(values: Sequence[ca.SX]) -> ca.SX:
    """Number of the mode in which H is least."""
    number, least = ca.SX(0.0), ca.SX(np.inf)
    if len(values) == 1:
        return number
    for mode, value in enumerate(values):
        # At a switch both are equal and the later one, full thrust, is as good.
        better = value < least
        number, least = ca.if_else(better, mode, number), ca.if_else(better, value, least)
    return number


def _text(expression: ca.SX) -> str:
    symbols = ca.symvar(expression)
    return ca.Function("f", symbols, [expression]).serialize()
