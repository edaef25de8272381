"""Control law: minimises the Hamiltonian regime by regime, from the Hamiltonian's own derivatives.

A `UnitVectorControl` d enters H linearly, H = a + g . d, so its minimum on the circle or sphere is d = -g/|g|; for
planar thrust that is Cho et al. 2015 (15) with both signs right, beta = atan2(-lambda_v, -lambda_u). The rest is a
function of the scalars only, whose slopes S = dH/du are the same with d in place (envelope theorem). A scalar in
which H is linear sits at a bound, at the upper one where S < 0. One in which H bends sits at a bound, or between them
where S = 0: in closed form where H is quadratic, else by Newton's method.

A scalar may be known to stay in one regime all along its phase (`perilune.problem.controls.Settled`): on a bound, or
singular, where its value follows from the motion of state and costate (`perilune.conditions.singular_control`).

Conditions of the path that are linear in a direction, or of scalars only, are active where H asks for more
(`perilune.conditions.active_constraints`, `perilune.conditions.scalar_regimes`).

A *mode* names the regime of every scalar and the conditions that are held; its control is smooth in (x, lambda).
Events lead from mode to mode (`perilune.conditions.switching_events`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import casadi as ca
import numpy as np

from perilune.conditions.active_constraints import Held, depends_on_direction, enumerate_active_sets, require_attainable
from perilune.conditions.boundary_arc_control import boundary_arc_control
from perilune.conditions.scalar_minimum import minimise_interior_scalars
from perilune.conditions.scalar_regimes import (
    FREE,
    INSIDE,
    Bend,
    Scalar,
    Terms,
    combinations,
    is_factor,
    is_periodic,
    no_control_law_error,
    satisfies_conditions,
)
from perilune.conditions.singular_control import Motion, singular_control
from perilune.conditions.switching_events import Mode, ModeSwitches, SwitchingEvent
from perilune.conditions.unit_vector_control import minimising_directions
from perilune.problem import Phase, Regime, elements, scalars

_ROUNDED = 1e-12  # of the amounts of its terms: by less H in one mode is no less than in another
_UNKNOWN_TERMS = Terms(size=ca.SX(0.0), positive=ca.SX(0, 1))


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
        For each mode a column of expressions: where one is negative, the active conditions cannot be kept.
    solved
        For each mode None, or what is found by Newton's method: the control as an expression of w, the symbols w, and
        the values of w. The control is one more step from w, so that its derivative at fixed w is the whole one.
    transitions
        Events that lead from mode to mode.
    mode
        Number of the mode in which H is least.
    periodic
        Places of angles, of which each mode determines one turn only.
    values, sizes
        H in each mode, infinite where it is none, and the amounts of its terms.
    """

    regimes: tuple[tuple[Regime, ...], ...]
    held: tuple[Held, ...]
    control: tuple[ca.SX, ...]
    room: tuple[ca.SX, ...]
    solved: tuple[tuple[ca.SX, ca.SX, ca.SX] | None, ...]
    transitions: tuple[SwitchingEvent, ...]
    mode: ca.SX
    periodic: tuple[int, ...]
    values: tuple[ca.SX, ...]
    sizes: tuple[ca.SX, ...]

    def initial_mode(self, z: ca.SX, rates: Sequence[ca.SX]) -> ca.SX:
        """Return the number of the mode in which a flight begins at z, with the rates of z in each mode.

        It is the one in which H is least. Where that is rounding, as where a flight begins with a switch, a mode is
        left that should be left already: what leads out of it has passed its zero, is not reached again, and what H
        chose would stay.

        Parameters
        ----------
        z
            States and costates, symbols of shape (nz, 1), canonical.
        rates
            z' in each mode, expressions of shape (nz, 1), canonical.
        """
        number = self.mode
        for way in self.transitions:
            for before, after in way.switches.items():
                apart = ca.fabs(self.values[after] - self.values[before])
                rate = ca.jtimes(way.function, z, rates[before])
                passed = way.direction * ca.if_else(way.function == 0, rate, way.function) > 0
                leaves = ca.logic_and(passed, apart <= _ROUNDED * self.sizes[before])
                number = ca.if_else(ca.logic_and(number == before, leaves), after, number)
        return number


def minimising_control(
    phase: Phase,
    hamiltonian: ca.SX,
    u: ca.SX,
    limits: dict[str, tuple[ca.SX, ca.SX]],
    kept: Mapping[str, ca.SX] = MappingProxyType({}),
    always: Mapping[str, ca.SX] = MappingProxyType({}),
    motion: Motion | None = None,
    terms: Terms = _UNKNOWN_TERMS,
) -> ControlLaw:
    """Derive the control that minimises H.

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
        Expressions of u by name that vanish all along the phase: linear in a direction, or of scalars only.
    motion
        Motion of state and costate, which a singular scalar needs.
    terms
        Known sizes and signs of the terms of H: curvature below their rounding does not count.

    Raises
    ------
    PeriluneError
        If H is linear in a scalar without bounds, or in a direction not linear, or a direction depends on a scalar.
    """
    for name, condition in always.items():
        require_attainable(phase, name, condition, u)
    everything = ca.vertcat(hamiltonian, *kept.values(), *always.values())
    periodic = tuple(at for at, control in scalars(phase.controls) if is_periodic(control, u[at], everything))
    none, modes, solved = ca.SX(0, 1), list[Mode](), list[tuple[ca.SX, ca.SX, ca.SX] | None]()
    rooms, values = list[ca.SX](), list[ca.SX]()
    for held in enumerate_active_sets(phase, u, kept):
        here = {**always, **{name: kept[name] for name in held}}
        turning = {name: c for name, c in here.items() if depends_on_direction(phase, c, u)}
        own = {name: c for name, c in here.items() if name not in turning}
        reduced, law, room = minimising_directions(phase, hamiltonian, u, limits, turning)
        kinds = [
            Scalar(phase, at, control, reduced, u, limits[control.name],
                   acts=any(ca.depends_on(c, u[at]) for c in own.values()), positive=terms.positive,
                       periodic=at in periodic)
            for at, control in scalars(phase.controls)
        ]  # fmt: skip
        for regimes in combinations(kinds, [*own.values()]):
            ridden = boundary_arc_control(phase, hamiltonian, u, turning) if regimes == ("interior",) else None
            mode = Mode(held=held, regimes=regimes, kinds=kinds, own=own, H=reduced, control=none)
            step = _control_in_mode(phase, law, u, mode) if ridden is None else (ridden[0], none, none)
            if "singular" in regimes:
                step = _substitute_singular_control(phase, hamiltonian, u, mode, step, motion)
            mode.control = ca.substitute(*step)
            modes.append(mode)
            rooms.append(ca.substitute(room, u, mode.control) if ridden is None else ridden[1])
            solved.append(step if step[1].numel() else None)
            others = [c for name, c in kept.items() if name not in held]
            values.append(_hamiltonian_in_mode(hamiltonian, u, mode, [*others, *elements(rooms[-1])], terms.size))
    return ControlLaw(
        regimes=tuple(mode.regimes for mode in modes),
        held=tuple(mode.held for mode in modes),
        control=tuple(mode.control for mode in modes),
        room=tuple(rooms),
        solved=tuple(solved),
        transitions=tuple(ModeSwitches(phase=phase, u=u, modes=modes, kept=kept, size=terms.size).transitions()),
        mode=_least_hamiltonian_mode(values),
        periodic=periodic,
        values=tuple(values),
        sizes=tuple(ca.substitute(terms.size, u, mode.control) for mode in modes),
    )


def _control_in_mode(phase: Phase, law: list[ca.SX], u: ca.SX, mode: Mode) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the whole control in one mode, with symbols w in it for what is solved for, and the values of w."""
    known = [*zip(mode.kinds, mode.regimes, strict=True)]
    places = [kind.at for kind, regime in known if regime not in FREE]
    values = [kind.value(regime) for kind, regime in known if regime not in FREE]
    free = [kind for kind, regime in known if regime in FREE]
    w, found = ca.SX(0, 1), ca.SX(0, 1)
    if free:
        symbols = ca.vertcat(*(kind.symbol for kind in free))
        # What an angle points may be nothing: where it would point it is the same as for more, or less, of it.
        pointed = [len(free) == 1 and is_factor(u[i], free[0].slope) for i in places]
        some = [ca.if_else(v < 0, -1.0, 1.0) if of else v for of, v in zip(pointed, values, strict=True)]
        H = _substitute_controls(mode.H, u, places, some)
        own = _substitute_controls(ca.vertcat(ca.SX(0, 1), *mode.own.values()), u, places, values)
        best, w, found = minimise_interior_scalars(phase, H, symbols, free, own, "low_interior" in mode.regimes)
        values += elements(best)
        places += [kind.at for kind in free]
    whole = ca.vertcat(ca.SX(0, 1), *law)
    return _substitute_controls(whole, u, places, values), w, found


def _substitute_singular_control(
    phase: Phase,
    hamiltonian: ca.SX,
    u: ca.SX,
    mode: Mode,
    step: tuple[ca.SX, ca.SX, ca.SX],
    motion: Motion | None,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the control of `_control_in_mode`, the motion's expression in place of the singular scalar's symbol."""
    singular = [kind for kind in mode.kinds if kind.regimes == ("singular",)]
    control, solved, _ = step
    if motion is None or len(singular) > 1 or solved.numel():
        names = tuple(kind.control.name for kind in singular)
        raise no_control_law_error(
            phase, names, "more than one singular control, or one together with a control without a formula"
        )
    (kind,) = singular
    slope = ca.substitute(ca.gradient(hamiltonian, kind.symbol), u, control)
    name = f"{kind.control.name} of {phase.name}"
    found = singular_control(name, slope, kind.symbol, motion.z, motion.rate(control, mode.held, mode.regimes))
    return ca.substitute(control, kind.symbol, found), ca.SX(0, 1), ca.SX(0, 1)


def _substitute_controls(expression: ca.SX, u: ca.SX, places: list[int], values: list[ca.SX]) -> ca.SX:
    """Substitute values for some of the controls of an expression."""
    symbols = ca.vertcat(ca.SX(0, 1), *(u[i] for i in places))
    return ca.substitute(expression, symbols, ca.vertcat(ca.SX(0, 1), *values))


def _hamiltonian_in_mode(hamiltonian: ca.SX, u: ca.SX, mode: Mode, others: Sequence[ca.SX], size: ca.SX) -> ca.SX:
    """Return H in a mode; infinite where its control leaves its bounds, or breaks a condition of the path."""
    value = ca.substitute(hamiltonian, u, mode.control)
    for kind, regime in zip(mode.kinds, mode.regimes, strict=True):
        if regime in FREE:
            here = mode.control[kind.at]
            value = ca.if_else(ca.logic_and(kind.limits[0] <= here, here <= kind.limits[1]), value, np.inf)
            if regime in INSIDE and kind.weighed:
                inner: dict[Regime, ca.SX] = {regime: here} if kind.curved_both_ways else {}
                bend = Bend(kind=kind, H=mode.H, u=u, control=mode.control, size=size, inner=inner)
                value = ca.if_else(bend.none, np.inf, value)
                for there in bend.there.values():
                    value = ca.if_else(there, value, np.inf)
        elif kind.periodic:
            value = ca.if_else(kind.wide, np.inf, value)
    if mode.own:
        told = [kind.symbol for kind, regime in zip(mode.kinds, mode.regimes, strict=True) if regime == "held"]
        kept = satisfies_conditions(ca.vertcat(*told), ca.vertcat(*mode.own.values()), u, mode.control)
        value = ca.if_else(kept, value, np.inf)
    for condition in others:
        value = ca.if_else(ca.substitute(condition, u, mode.control) >= 0, value, np.inf)
    return value


def _least_hamiltonian_mode(values: Sequence[ca.SX]) -> ca.SX:
    """Return the number of the mode in which H is least."""
    number, least = ca.SX(0.0), ca.SX(np.inf)
    if len(values) == 1:
        return number
    for mode, value in enumerate(values):
        # At a switch both are equal and the later one, full thrust, is as good.
        better = value < least
        number, least = ca.if_else(better, mode, number), ca.if_else(better, value, least)
    return number
