"""The control that minimises the Hamiltonian, regime by regime, from the Hamiltonian's own derivatives.

A `Direction` d enters H linearly, H = a + g . d, so its minimum on the circle or sphere is d = -g/|g|; for planar
thrust that is Cho et al. 2015 (15) with both signs right, beta = atan2(-lambda_v, -lambda_u). What is left is a
function of the scalars alone, whose slopes S = dH/du are the same with d in place (envelope theorem). A scalar in
which H is linear sits at a bound, at the upper one where S < 0. One in which H bends sits at a bound, or between them
where S = 0: in closed form where H is quadratic, else by Newton's method.

A *mode* names the regime of every scalar; its control is smooth in (x, lambda). Zeros of S, and a control between its
bounds that reaches one, are the events that lead from mode to mode.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import casadi as ca
import numpy as np

from perilune.problem.controls import Bounded, Regime, directions, scalars
from perilune.problem.phase import Phase
from perilune.problem.symbolic import elements
from perilune.words.outcome import PeriluneError

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
    control
        For each mode the whole control, a column of expressions.
    solved
        For each mode None, or what is found by Newton's method: the control as an expression of w, the symbols w, and
        the values of w. The control is one more step from w, so that its derivative at fixed w is the whole one.
    transitions
        What leads from mode to mode.
    mode
        Number of the mode in which H is least.
    """

    regimes: tuple[tuple[Regime, ...], ...]
    control: tuple[ca.SX, ...]
    solved: tuple[tuple[ca.SX, ca.SX, ca.SX] | None, ...]
    transitions: tuple[Transition, ...]
    mode: ca.SX


def minimising_control(
    phase: Phase, hamiltonian: ca.SX, u: ca.SX, limits: dict[str, tuple[ca.SX, ca.SX]]
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

    Raises
    ------
    PeriluneError
        If H is linear in a scalar without bounds, or in a direction not linear, or a direction depends on a scalar.
    """
    reduced, law = _directions_eliminated(phase, hamiltonian, u, limits)
    kinds = [_Scalar(phase, at, control, reduced, u, limits[control.name]) for at, control in scalars(phase.controls)]
    modes = list(product(*(kind.regimes for kind in kinds)))
    stepped = [_control(phase, reduced, law, u, kinds, regimes) for regimes in modes]
    controls = [ca.substitute(*step) for step in stepped]
    return ControlLaw(
        regimes=tuple(modes),
        control=tuple(controls),
        solved=tuple(step if step[1].numel() else None for step in stepped),
        transitions=tuple(_transitions(u, kinds, modes, controls)),
        mode=_least(hamiltonian, u, kinds, modes, controls),
    )


class _Scalar:
    """A scalar control with the slope S of H in it, directions in place."""

    def __init__(
        self, phase: Phase, at: int, control: Bounded, reduced: ca.SX, u: ca.SX, limits: tuple[ca.SX, ca.SX]
    ) -> None:
        self.at, self.control, self.limits = at, control, limits
        self.slope = ca.gradient(reduced, u[at])
        self.linear = not ca.depends_on(self.slope, u[at])
        lower, upper = (not (limit.is_constant() and np.isinf(float(limit))) for limit in limits)
        if self.linear and not (lower and upper):
            raise _no_law(phase, control.names, "a Hamiltonian that is linear in it, and no bounds")
        between: tuple[Regime, ...] = () if self.linear else ("interior",)
        self.regimes: tuple[Regime, ...] = (*(("lower",) if lower else ()), *between, *(("upper",) if upper else ()))

    def value(self, regime: Regime) -> ca.SX:
        """The control at a bound."""
        return self.limits[regime == "upper"]


def _directions_eliminated(
    phase: Phase, hamiltonian: ca.SX, u: ca.SX, limits: dict[str, tuple[ca.SX, ca.SX]]
) -> tuple[ca.SX, list[ca.SX]]:
    """H with the best directions in place, and u with them."""
    law = elements(u)
    for first, last in directions(phase.controls):
        names, part = phase.control_names[first:last], u[first:last]
        gradient = ca.gradient(hamiltonian, part)
        if ca.depends_on(gradient, part):
            raise _no_law(phase, names, "a Hamiltonian that is not linear in it")
        for at, control in scalars(phase.controls):
            if ca.depends_on(gradient, u[at]):
                # Thrust carries its throttle as a factor, which is not negative and leaves the direction as it is.
                upper = limits[control.name][1]
                reference = ca.SX(1.0) if upper.is_constant() and np.isinf(float(upper)) else upper
                if (isinstance(control.lower, float | int) and control.lower < 0) or not _factor(gradient, u[at]):
                    raise _no_law(phase, names, f"a direction that depends on {control.name}")
                gradient = ca.substitute(gradient, u[at], reference)
        law[first:last] = elements(-gradient / ca.norm_2(gradient))
    places = [i for first, last in directions(phase.controls) for i in range(first, last)]
    best = ca.vertcat(ca.SX(0, 1), *(law[i] for i in places))
    return ca.substitute(hamiltonian, ca.vertcat(ca.SX(0, 1), *(u[i] for i in places)), best), law


def _factor(gradient: ca.SX, scalar: ca.SX) -> bool:
    """Whether the scalar only scales the gradient: seen at a few points."""
    others = [s for s in ca.symvar(gradient) if not ca.is_equal(s, scalar)]
    evaluate = ca.Function("gradient", [scalar, ca.vertcat(ca.SX(0, 1), *others)], [gradient])
    rng = np.random.default_rng(0)
    for _ in range(3):
        point = rng.uniform(0.5, 1.5, len(others))
        a, b = (np.array(evaluate(value, point)).ravel() for value in (0.3, 0.8))
        if not np.allclose(a * np.linalg.norm(b), b * np.linalg.norm(a), rtol=1e-9, atol=1e-12):
            return False
    return True


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
        raise _no_law(phase, names, "more than two controls that bend the Hamiltonian together")
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


def _transitions(
    u: ca.SX, kinds: list[_Scalar], modes: list[tuple[Regime, ...]], controls: list[ca.SX]
) -> list[Transition]:
    """All ways from mode to mode; what is the same function in several modes is one."""
    found: dict[tuple[str, int], Transition] = {}
    for before, regimes in enumerate(modes):
        for i, (kind, regime) in enumerate(zip(kinds, regimes, strict=True)):
            for after, function, direction in _ways(kind, regime, controls[before], u):
                target = modes.index((*regimes[:i], after, *regimes[i + 1 :]))
                key = _text(function), direction
                way = Transition(function=function, direction=direction, steady=not kind.linear, switches={})
                known = found.setdefault(key, way)
                known.switches[before] = target
    return list(found.values())


def _ways(kind: _Scalar, regime: Regime, control: ca.SX, u: ca.SX) -> list[tuple[Regime, ca.SX, int]]:
    """(regime after, function, direction) of what leads a scalar out of a regime."""
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


def _least(
    hamiltonian: ca.SX, u: ca.SX, kinds: list[_Scalar], modes: list[tuple[Regime, ...]], controls: list[ca.SX]
) -> ca.SX:
    """Number of the mode in which H is least; a control between its bounds must be there."""
    if len(modes) == 1:
        return ca.SX(0.0)
    number, least = ca.SX(0.0), ca.SX(np.inf)
    for mode, (regimes, control) in enumerate(zip(modes, controls, strict=True)):
        value = ca.substitute(hamiltonian, u, control)
        for kind, regime in zip(kinds, regimes, strict=True):
            if regime == "interior":
                here = control[kind.at]
                value = ca.if_else(ca.logic_and(kind.limits[0] <= here, here <= kind.limits[1]), value, np.inf)
        # At a switch both are equal and the later one, full thrust, is as good.
        better = value < least
        number, least = ca.if_else(better, mode, number), ca.if_else(better, value, least)
    return number


def _text(expression: ca.SX) -> str:
    symbols = ca.symvar(expression)
    return ca.Function("f", symbols, [expression]).serialize()


def _no_law(phase: Phase, names: tuple[str, ...], got: str) -> PeriluneError:
    return PeriluneError(
        f"the indirect method has no control law for {', '.join(names)} of {phase.name}",
        got=got,
        expected="a direction or a bounded scalar that enters linearly, or a scalar that bends the Hamiltonian",
        advice="use the direct method: solve(problem, Pseudospectral())",
    )
