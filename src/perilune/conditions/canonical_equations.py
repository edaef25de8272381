"""Canonical equations of one phase: state, constant states and costate on the minimising control.

With H = lambda . f(x, u, p), which the control minimises, lambda' = -dH/dx (Cho et al. 2015 (11), (12), (14), where
(12) prints H_r for H_x). A free parameter q in the dynamics becomes a constant state, whose costate collects the
integral of dH/dq.

The equations are smooth in each *mode*: a regime for each scalar control (`perilune.conditions.control_law`) and a side
for each kink of the dynamics (`perilune.problem.casadi_trace.trace_sides`). Events lead from mode to mode.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from perilune.conditions.active_constraints import (
    Held,
    active_constraint_multipliers,
    attainable_as_equality,
    multiplier_term,
)
from perilune.conditions.control_law import minimising_control
from perilune.conditions.known_costates import known_hamiltonian_terms, weighing_costates
from perilune.conditions.mode_events import events_between_modes, number_of_mode, select_by_mode
from perilune.conditions.singular_control import Motion
from perilune.core.arrays import Vector
from perilune.core.errors import PeriluneError
from perilune.kernels import Event
from perilune.problem.casadi_trace import (
    SYMBOLIC,
    Parameters,
    canonical_given,
    column,
    elements,
    state_scales,
    trace_sides,
)
from perilune.problem.controls import Regime, ScalarControl, scalars
from perilune.problem.perturbed import start_offsets, without_start_offsets
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseExtremal:
    """The canonical equations of one phase, z = (x, constant states, lambda) in canonical units.

    Parameters
    ----------
    modes
        (z, p) -> z' for each mode. p is `extremal_parameters`.
    solved
        For each mode None, or where its control is found by Newton's method (z, p) -> w and (z, [p; w]) -> z'.
    rates
        (x, u, given, free) -> x' under any control for each mode, on its side of what the dynamics choose by.
    reports
        (z, p) -> (u, u', H) for each mode: the minimising control, its rate along the extremal, the Hamiltonian.
    multipliers
        (z, p) -> multipliers of the conditions held all along the phase, for each mode; none where there is none.
    regimes, held
        For each mode the regime of each scalar control, and the conditions of the path that hold a direction.
    events
        What leads from mode to mode.
    mode
        (z, p) -> number of the mode in which H is least.
    state_count
        Number of x's own components; z has 2 (state_count + constants) components.
    constants
        Indices of the free parameters that were made constant states.
    periodic
        Places of controls that are angles: a mode determines them within one turn.
    settles
        Whether the phase is uncontrolled and contracting, as a fall through air is: then its costates
        grow from start to end without bound, and are what its end makes of them, lambda(0) = (dx(T)/dx(0))^T lambda(T).
    """

    modes: tuple[ca.Function, ...]
    solved: tuple[tuple[ca.Function, ca.Function] | None, ...]
    rates: tuple[ca.Function, ...]
    reports: tuple[ca.Function, ...]
    multipliers: tuple[ca.Function, ...]
    regimes: tuple[tuple[Regime, ...], ...]
    held: tuple[Held, ...]
    events: tuple[Event, ...]
    mode: ca.Function
    state_count: int
    constants: tuple[int, ...]
    periodic: tuple[int, ...]
    settles: bool

    @property
    def half(self) -> int:
        """Length of lambda."""
        return self.state_count + len(self.constants)


def extremal_parameters(problem: Problem) -> Vector:
    """Return the numbers p of the canonical equations: given parameters, numeric limits, offsets of the start."""
    limits = [getattr(control, side) / problem.scales.of(control.unit) for _, control, side in _plain_limits(problem)]
    moved = start_offsets(problem) / state_scales(problem, problem.phases[0])
    return np.concatenate([canonical_given(without_start_offsets(problem)), limits, moved])


def _plain_limits(problem: Problem) -> list[tuple[int, ScalarControl, str]]:
    """Return (phase, scalar control, side) of every limit that is a finite number and not a parameter's name."""
    return [
        (k, control, side)
        for k, phase in enumerate(problem.phases)
        for _, control in scalars(phase.controls)
        for side in ("lower", "upper")
        if not isinstance(limit := getattr(control, side), str) and np.isfinite(limit)
    ]


def limit_symbols(problem: Problem, p: Parameters) -> tuple[ca.SX, list[dict[str, tuple[ca.SX, ca.SX]]]]:
    """Return symbols of the plain limits, and for each phase (lower, upper) of each scalar by name.

    Parameters
    ----------
    problem
        The problem; its limits that are numbers become symbols, canonical.
    p
        Symbols of the parameters, canonical, for limits that are names of parameters.
    """
    place = {(k, control.name, side): i for i, (k, control, side) in enumerate(_plain_limits(problem))}
    symbols = ca.SX.sym("limit", len(place))

    def limit(k: int, control: ScalarControl, side: str) -> ca.SX:
        stated = getattr(control, side)
        if isinstance(stated, str):
            return ca.SX(getattr(p.record, stated))
        i = place.get((k, control.name, side))
        return ca.SX(stated) if i is None else symbols[i]

    return symbols, [
        {c.name: (limit(k, c, "lower"), limit(k, c, "upper")) for _, c in scalars(phase.controls)}
        for k, phase in enumerate(problem.phases)
    ]


def canonical_equations(
    phase: Phase,
    p: Parameters,
    limits: dict[str, tuple[ca.SX, ca.SX]],
    numbers: ca.SX,
    free_names: tuple[str, ...],
    keep: Held = (),
    unpriced: frozenset[str] = frozenset(),
    costs: frozenset[str] = frozenset(),
) -> PhaseExtremal:
    """Derive the canonical equations of a phase.

    Parameters
    ----------
    phase, p
        The phase, and the symbols of all parameters.
    limits, numbers
        Of `limit_symbols`: lower and upper limit of each scalar control of the phase; all numbers that the equations
        take, as `extremal_parameters` lists them.
    free_names
        Names of the free parameters.
    keep
        Conditions of the path that the control has to keep; those that are not `attainable_as_equality` are ignored
        here.
    unpriced, costs
        Names of states whose costates vanish identically, and of those whose costates are a positive number
        (`perilune.problem.tracing.costate_signs`).

    Raises
    ------
    PeriluneError
        If a control's minimum of H is not known, or the dynamics depend on the phase's own duration.
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
    # The constant states are symbols of p.free; as entries of z they need symbols of their own.
    z = ca.vertcat(x, q, lam)
    symbol = ca.SX.sym("z", z.numel())

    def function(name: str, *expressions: ca.SX) -> ca.Function:
        return ca.Function(name, [symbol, numbers], ca.cse([ca.substitute(e, z, symbol) for e in expressions]))

    laws, flows, solved, sides, reports, multipliers = [], [], [], [], [], []
    weights = weighing_costates(phase, dynamics, u, lam[:n], unpriced)
    for f in dynamics.rates:
        hamiltonian = ca.dot(weights, f)
        # dH/dx at fixed u: on the minimising control the derivative through u vanishes or is tangent to its constraint.
        gradient = ca.gradient(hamiltonian, ca.vertcat(x, q))

        def moving(
            control: ca.SX,
            held: Held,
            regimes: tuple[Regime, ...],
            f: ca.SX = f,
            hamiltonian: ca.SX = hamiltonian,
            gradient: ca.SX = gradient,
        ) -> ca.SX:
            """Return z' as an expression of u; `control` is the one of these regimes."""
            # A limit that is a free parameter moves the control with it.
            pull = ca.vertcat(ca.SX.zeros(n, 1), _slope_through_limits(hamiltonian, u, control, bounds, q))
            holds = [*always.values(), *(kept[name] for name in held)]
            pull -= multiplier_term(phase, hamiltonian, u, holds, ca.vertcat(x, q), regimes)
            return ca.vertcat(f, ca.SX.zeros(len(constants), 1), -gradient - pull)

        motion = Motion(
            z=z, rate=lambda control, *mode, moving=moving: ca.substitute(moving(control, *mode), u, control)
        )
        terms = known_hamiltonian_terms(phase, weights, f, costs)
        law = minimising_control(phase, hamiltonian, u, limits, kept, always, motion, terms)
        sides += [ca.Function("rates", [x, u, p.given, p.free], [f])] * len(law.control)
        each = zip(law.control, law.room, law.solved, law.held, law.regimes, strict=True)
        for control, room, found, held, regimes in each:
            if always:
                holds = [*always.values(), *(kept[name] for name in held)]
                mu = active_constraint_multipliers(phase, hamiltonian, u, holds, regimes)[: len(always)]
                multipliers.append(function("multipliers", ca.substitute(mu, u, control)))
            whole = moving(control, held, regimes)
            whole += _nan_without_room(whole, u, z, room)
            rate, value = (ca.substitute(e, u, control) for e in (whole, hamiltonian))
            flows.append(rate)
            if found is None:
                solved.append(None)
            else:
                stepped, w, values = found
                held = ca.cse(ca.substitute(ca.substitute(whole, u, stepped), z, symbol))
                solved.append(
                    (function("solved", values), ca.Function("rhs", [symbol, ca.vertcat(numbers, w)], [held]))
                )
            reports.append(function("report", control, ca.jtimes(control, z, rate), value))
        laws.append(law)
    events = tuple(events_between_modes(dynamics, laws, flows, z, function))
    return PhaseExtremal(
        modes=tuple(function("rhs", rate) for rate in flows),
        solved=tuple(solved),
        rates=tuple(sides),
        reports=tuple(reports),
        multipliers=tuple(multipliers),
        regimes=tuple(regimes for law in laws for regimes in law.regimes),
        held=tuple(held for law in laws for held in law.held),
        events=events,
        settles=not phase.controls and all(e.jump is None for e in events) and _is_dissipative(flows, z),
        mode=function("mode", number_of_mode(dynamics, laws, flows, z)),
        state_count=n,
        constants=constants,
        periodic=tuple(sorted({at for law in laws for at in law.periodic})),
    )


def _is_dissipative(flows: list[ca.SX], z: ca.SX) -> bool:
    """Return True if the flow does not preserve volumes of states, as with drag."""
    x = z[: z.numel() // 2]
    return any(not ca.simplify(ca.trace(ca.jacobian(flow[: x.numel()], x))).is_zero() for flow in flows)


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


def _slope_through_limits(hamiltonian: ca.SX, u: ca.SX, control: ca.SX, bounds: ca.SX, q: ca.SX) -> ca.SX:
    """Return dH/dq through a control that sits at a limit which depends on the free parameters q."""
    if not ca.depends_on(bounds, q):
        return ca.SX.zeros(q.numel(), 1)
    # On a bound dH/du is its multiplier; between bounds it vanishes, and along a sphere it is tangent to nothing.
    return ca.mtimes(ca.jacobian(control, q).T, ca.gradient(hamiltonian, u))


def minimising_control_at(extremal: PhaseExtremal, z: ca.SX, numbers: ca.SX) -> ca.SX:
    """Return the minimising control, that of the mode in which H is least.

    Parameters
    ----------
    extremal
        The canonical equations of the phase.
    z
        State and costate, canonical, a column.
    numbers
        Numbers of the canonical equations, `extremal_parameters`.

    Returns
    -------
    casadi.SX
        One entry for each component of the control, canonical.
    """
    return select_by_mode([report(z, numbers)[0] for report in extremal.reports], extremal.mode(z, numbers))


def hamiltonian_at(extremal: PhaseExtremal, z: ca.SX, numbers: ca.SX) -> ca.SX:
    """Return H on the minimising control, that of the mode in which it is least.

    Parameters
    ----------
    extremal, z, numbers
        As for `minimising_control_at`.

    Returns
    -------
    casadi.SX
        H, canonical.
    """
    return select_by_mode([report(z, numbers)[2] for report in extremal.reports], extremal.mode(z, numbers))
