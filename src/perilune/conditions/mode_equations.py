"""Equations of the modes of one phase: rates of z on each minimising control, reports, multipliers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from perilune.conditions.active_constraints import (
    Held,
    active_constraint_multipliers,
    attainable_as_equality,
    multiplier_term,
)
from perilune.conditions.control_law import ControlLaw, minimising_control
from perilune.conditions.scalar_regimes import Terms
from perilune.conditions.singular_control import Motion
from perilune.core import PeriluneError
from perilune.problem import SYMBOLIC, Kinked, Parameters, Phase, Regime, column, elements, trace_sides


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseSymbols:
    """Symbols of one phase, and what its conditions are in them.

    Parameters
    ----------
    phase
        The phase.
    x, u, q, lam, z
        States, controls, free parameters that are constant states, costates, and z = (x, q, lam), canonical.
    symbol, numbers
        What functions take for z, and the numbers of the equations, `extremal_parameters`.
    bounds
        All limits of scalar controls.
    dynamics
        The dynamics, on each side of what they choose by.
    parameters
        Symbols of the problem's parameters.
    kept, always
        Conditions of the path that the control keeps, and those that are held all along, by name.
    constants
        Indices of the free parameters that are constant states.
    """

    phase: Phase
    x: ca.SX
    u: ca.SX
    q: ca.SX
    lam: ca.SX
    z: ca.SX
    symbol: ca.SX
    numbers: ca.SX
    bounds: ca.SX
    dynamics: Kinked
    parameters: Parameters
    kept: dict[str, ca.SX]
    always: dict[str, ca.SX]
    constants: tuple[int, ...]

    @property
    def state_count(self) -> int:
        """Number of the phase's own states."""
        return self.x.numel()

    def function(self, name: str, *expressions: ca.SX) -> ca.Function:
        """Return a function (z, numbers) -> expressions in z."""
        inner = [ca.substitute(e, self.z, self.symbol) for e in expressions]
        return ca.Function(name, [self.symbol, self.numbers], ca.cse(inner))

    def held_values(self, held: Held) -> list[ca.SX]:
        """Return the conditions that are held all along, and those that a direction is held on."""
        return [*self.always.values(), *(self.kept[name] for name in held)]


class ModeEquations(NamedTuple):
    """Parts of one mode for `PhaseExtremal`; `rate` is z' as an expression of z."""

    rate: ca.SX
    solved: tuple[ca.Function, ca.Function] | None
    side: ca.Function
    report: ca.Function
    multipliers: ca.Function | None
    regimes: tuple[Regime, ...]
    held: Held


def phase_symbols(
    phase: Phase,
    p: Parameters,
    limits: dict[str, tuple[ca.SX, ca.SX]],
    numbers: ca.SX,
    free_names: tuple[str, ...],
    keep: Held,
) -> PhaseSymbols:
    """Return the symbols of a phase.

    Parameters
    ----------
    phase, p, limits, numbers, free_names, keep
        As for `canonical_equations`.

    Raises
    ------
    PeriluneError
        If the dynamics depend on the phase's own duration.
    """
    n = len(phase.states)
    x, u = ca.SX.sym("x", n), ca.SX.sym("u", len(phase.control_names))
    dynamics = trace_sides(phase, x, u, p.record)
    kept = {
        name: c
        for name, c in _constraints_by_name("path", phase, x, u, p).items()
        if name in keep and attainable_as_equality(phase, c, u)
    }
    always = _constraints_by_name("held", phase, x, u, p)
    bounds = ca.vertcat(ca.SX(0, 1), *(limit for pair in limits.values() for limit in pair))
    acting = ca.vertcat(
        *dynamics.rates, *(c.argument for c in dynamics.choices), bounds, *kept.values(), *always.values()
    )
    constants = tuple(
        i for i, name in enumerate(free_names) if name != phase.duration and ca.depends_on(acting, p.free[i])
    )
    if phase.duration in free_names and ca.depends_on(acting, p.free[free_names.index(phase.duration)]):
        raise PeriluneError(
            f"the dynamics of {phase.name} depend on the phase's own duration",
            advice="make time a state with rate 1",
        )
    q = ca.vertcat(ca.SX(0, 1), *[p.free[i] for i in constants])
    lam = ca.SX.sym("lam", n + len(constants))
    z = ca.vertcat(x, q, lam)
    # The constant states are symbols of p.free; as entries of z they need symbols of their own.
    symbol = ca.SX.sym("z", z.numel())
    return PhaseSymbols(
        phase=phase, x=x, u=u, q=q, lam=lam, z=z, symbol=symbol, numbers=numbers, bounds=bounds, dynamics=dynamics,
        parameters=p, kept=kept, always=always, constants=constants,
    )  # fmt: skip


def mode_equations(
    symbols: PhaseSymbols, f: ca.SX, weights: ca.SX, limits: dict[str, tuple[ca.SX, ca.SX]], terms: Terms
) -> tuple[ControlLaw, list[ModeEquations]]:
    """Return the law of the minimising control on one side of the dynamics, and the equations of its modes.

    Parameters
    ----------
    symbols
        Of the phase.
    f, weights
        The dynamics on this side, and what weighs them in H.
    limits
        Lower and upper limit of each scalar control.
    terms
        What is known of H, `known_hamiltonian_terms`.
    """
    phase, x, u, p, z = symbols.phase, symbols.x, symbols.u, symbols.parameters, symbols.z
    hamiltonian = ca.dot(weights, f)
    states = ca.vertcat(x, symbols.q)
    # dH/dx at fixed u: on the minimising control the derivative through u vanishes or is tangent to its constraint.
    gradient = ca.gradient(hamiltonian, states)

    def moving(control: ca.SX, held: Held, regimes: tuple[Regime, ...]) -> ca.SX:
        """Return z' as an expression of u; `control` is the one of these regimes."""
        # A limit that is a free parameter moves the control with it.
        slope, holds = ca.SX.zeros(symbols.q.numel(), 1), symbols.held_values(held)
        if ca.depends_on(symbols.bounds, symbols.q):
            pressure = ca.gradient(hamiltonian, u)
            if holds:  # what a condition does to the control is in its multiplier already
                mu = active_constraint_multipliers(phase, hamiltonian, u, holds, regimes)
                pressure -= ca.jtimes(ca.vertcat(*holds), u, mu, True)
            # On a bound it is its multiplier; between bounds it vanishes, and along a sphere it is tangent to nothing.
            slope = ca.mtimes(ca.jacobian(control, symbols.q).T, pressure)
        pull = ca.vertcat(ca.SX.zeros(symbols.state_count, 1), slope)
        pull -= multiplier_term(phase, hamiltonian, u, holds, states, regimes)
        return ca.vertcat(f, ca.SX.zeros(len(symbols.constants), 1), -gradient - pull)

    motion = Motion(z=z, rate=lambda control, *mode: ca.substitute(moving(control, *mode), u, control))
    law = minimising_control(phase, hamiltonian, u, limits, symbols.kept, symbols.always, motion, terms)
    side = ca.Function("rates", [x, u, p.given, p.free], [f])
    modes = list[ModeEquations]()
    for control, room, found, held, regimes in zip(
        law.control, law.room, law.solved, law.held, law.regimes, strict=True
    ):
        multipliers, solved = None, None
        if symbols.always:
            holds = symbols.held_values(held)
            mu = active_constraint_multipliers(phase, hamiltonian, u, holds, regimes)[: len(symbols.always)]
            multipliers = symbols.function("multipliers", ca.substitute(mu, u, control))
        whole = moving(control, held, regimes)
        whole += _nan_without_room(whole, u, z, room)
        rate, value = (ca.substitute(e, u, control) for e in (whole, hamiltonian))
        if found is not None:
            stepped, w, values = found
            step = ca.cse(ca.substitute(ca.substitute(whole, u, stepped), z, symbols.symbol))
            inputs = [symbols.symbol, ca.vertcat(symbols.numbers, w)]
            solved = (symbols.function("solved", values), ca.Function("rhs", inputs, [step]))
        report = symbols.function("report", control, ca.jtimes(control, z, rate), value)
        modes.append(ModeEquations(rate, solved, side, report, multipliers, regimes, held))
    return law, modes


def _nan_without_room(rate: ca.SX, u: ca.SX, z: ca.SX, room: ca.SX) -> ca.SX:
    """Return NaN for rates with a control whose room is negative, so that no flight goes there; else 0."""
    lost, changing = ca.SX(rate.numel(), 1), [r for r in elements(room) if ca.depends_on(r, z)]
    for i in range(rate.numel() if changing else 0):
        if ca.depends_on(rate[i], u):
            lost[i] = ca.if_else(ca.mmin(ca.vertcat(*changing)) >= 0, 0.0, np.nan)
    return lost


def _constraints_by_name(function: str, phase: Phase, x: ca.SX, u: ca.SX, p: Parameters) -> dict[str, ca.SX]:
    """Return path or held conditions by name."""
    values = column(phase.evaluate(function, elements(x), elements(u), p.record, SYMBOLIC))
    return {c.name: values[i] for i, c in enumerate(getattr(phase, f"{function}_conditions"))}
