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

from perilune.conditions.active_constraints import Held
from perilune.conditions.control_law import ControlLaw
from perilune.conditions.known_costates import known_hamiltonian_terms, weighing_costates
from perilune.conditions.mode_equations import ModeEquations, mode_equations, phase_symbols
from perilune.conditions.mode_events import events_between_modes, number_of_mode, select_by_mode
from perilune.core import Vector
from perilune.kernels import Event
from perilune.problem import (
    Parameters,
    Phase,
    Problem,
    Regime,
    ScalarControl,
    canonical_given,
    scalars,
    start_offsets,
    state_scales,
    without_start_offsets,
)


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
    symbols = phase_symbols(phase, p, limits, numbers, free_names, keep)
    weights = weighing_costates(phase, symbols.dynamics, symbols.u, symbols.lam[: symbols.state_count], unpriced)
    laws, modes = list[ControlLaw](), list[ModeEquations]()
    for f in symbols.dynamics.rates:
        law, new = mode_equations(symbols, f, weights, limits, known_hamiltonian_terms(phase, weights, f, costs))
        laws.append(law)
        modes += new
    flows, z, function = [mode.rate for mode in modes], symbols.z, symbols.function
    events = tuple(events_between_modes(symbols.dynamics, laws, flows, z, function))
    return PhaseExtremal(
        modes=tuple(function("rhs", rate) for rate in flows),
        solved=tuple(mode.solved for mode in modes),
        rates=tuple(mode.side for mode in modes),
        reports=tuple(mode.report for mode in modes),
        multipliers=tuple(mode.multipliers for mode in modes if mode.multipliers is not None),
        regimes=tuple(mode.regimes for mode in modes),
        held=tuple(mode.held for mode in modes),
        events=events,
        settles=not phase.controls and all(e.jump is None for e in events) and _is_dissipative(flows, z),
        mode=function("mode", number_of_mode(symbols.dynamics, laws, flows, z)),
        state_count=symbols.state_count,
        constants=symbols.constants,
        periodic=tuple(sorted({at for law in laws for at in law.periodic})),
    )


def _is_dissipative(flows: list[ca.SX], z: ca.SX) -> bool:
    """Return True if the flow does not preserve volumes of states, as with drag."""
    x = z[: z.numel() // 2]
    return any(not ca.simplify(ca.trace(ca.jacobian(flow[: x.numel()], x))).is_zero() for flow in flows)


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
