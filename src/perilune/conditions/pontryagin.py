"""First-order optimality conditions of a `Problem`, derived by automatic differentiation only.

Sign convention (the tests assert it: lambda(t0) = dJ*/dx0):

    H = lambda . f(x, u, p), the control minimises H                             Cho et al. 2015 (11), (14)
    lambda' = -dH/dx                                                             (12), which prints H_r for H_x
    lambda(T) = dJ/dx + nu . dpsi/dx at the last end                             (18), (19)
    lambda_k(T) = (dlink/dx)^T lambda_{k+1}(0) + nu_k . dpsi_k/dx at an inner end

and for each free parameter q, which may move the initial state, the ends, the links or a duration,

    dJ/dq + nu . dpsi/dq + lambda_1(0) . dstart/dq + lambda_{k+1}(0) . dlink_k/dq + (H_k(T_k) if q is T_k) = 0.

For the retro burn this last line is Cho et al. (19), "lambda_u(0) + lambda_m(0) M/c exp(...) = 0", and H_f = 0. A free
parameter in the dynamics becomes a constant state, whose costate collects the integral of dH/dq.

Conditions along a phase are in `perilune.conditions.canonical_equations`, those at links and ends are here.

Unknowns of shooting: y = (lambda_k(0) for each phase, free parameters, nu), all in canonical units.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

from perilune.conditions.active_constraints import Held, attainable_as_equality
from perilune.conditions.canonical_equations import PhaseExtremal, canonical_equations, hamiltonian_at, limit_symbols
from perilune.conditions.junction_conditions import contact_point_rows, smooth_junction_rows
from perilune.core import Watch, ignore_events, quotient_unit
from perilune.problem import (
    SYMBOLIC,
    Parameters,
    Problem,
    Unnumbered,
    column,
    cost_states,
    elements,
    trace_at_end,
    trace_parameters,
    unpriced_states,
    without_start_offsets,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class OptimalityConditions:
    """The boundary value problem of a `Problem`.

    Parameters
    ----------
    phases
        Canonical equations of each phase.
    starts
        For each phase (y, z_before, p) -> (z0, duration); the first phase takes an empty z_before.
    residual
        (y, all end z stacked, p) -> (residual, J).
    unknowns, residuals
        (name, unit) of each component, units in SI.
    free_at, costate_at
        Slices of y: the free parameters, and each phase's lambda(0).
    transversality_at
        First of the rows of the residual that hold the costates at the ends, in the order of `costate_at`.
    stationarity_at
        Slice of the residual: one row for each free parameter, which is dJ/dq along the family of extremals; but for
        durations that end where something begins or ceases to be held (`perilune.conditions.junction_conditions`).
    ranges
        (row of the residual, unknown nu) of each end condition with a finite bound: its row holds psi, which only has
        to lie between the bounds.
    silent
        For each phase the entries of z that vanish on every extremal: costates of coordinates that neither the
        dynamics nor the end know of. Cho et al. (13), (19): lambda_phi.
    silent_rows
        (row of the residual, unknown) of each of them: the condition that it vanishes at the end.
    needed
        For each phase the entries of the end z on which the rest depends.
    """

    phases: tuple[PhaseExtremal, ...]
    starts: tuple[ca.Function, ...]
    residual: ca.Function
    unknowns: tuple[tuple[str, str], ...]
    residuals: tuple[tuple[str, str], ...]
    free_at: slice
    costate_at: tuple[slice, ...]
    transversality_at: int
    stationarity_at: slice
    ranges: tuple[tuple[int, int], ...]
    silent: tuple[tuple[int, ...], ...]
    silent_rows: tuple[tuple[int, int], ...]
    needed: tuple[tuple[int, ...], ...]


def derive(problem: Problem, keep: Held = (), watch: Watch = ignore_events) -> OptimalityConditions:
    """Derive the boundary value problem of a `Problem`.

    Values and bounds do not enter the expressions, so problems that differ only in them share one derivation.

    Parameters
    ----------
    problem
        The problem to be solved.
    keep
        Names of conditions of the path that the control has to keep, where it can (`attainable_as_equality`).
    watch
        Receives a line where they are not known yet: what is derived and traced may take many seconds.

    Raises
    ------
    PeriluneError
        If a control's minimum of H is not known in closed form.
    """
    unnumbered = Unnumbered(without_start_offsets(problem))
    if told := _pending_announcements(unnumbered, keep):
        watch(told[0])
        told.clear()
    return _derive(unnumbered, keep)


@lru_cache(maxsize=64)
def _pending_announcements(unnumbered: Unnumbered, keep: Held) -> list[str]:
    """Return the messages not yet shown before conditions are derived: kept as long as these."""
    return ["deriving the optimality conditions"]


def attainable_conditions(problem: Problem) -> Held:
    """Return the conditions of the path, by name, that `derive` can have the control keep."""
    problem = without_start_offsets(problem)
    if not any(problem.form.limits_control(k) for k in range(len(problem.phases))):
        return ()
    return _find_attainable_conditions(Unnumbered(problem))


@lru_cache(maxsize=64)
def _find_attainable_conditions(unnumbered: Unnumbered) -> Held:
    problem = unnumbered.problem
    p, found = trace_parameters(problem), list[str]()
    for phase in problem.phases:
        x, u = ca.SX.sym("x", len(phase.states)), ca.SX.sym("u", len(phase.control_names))
        values = column(phase.evaluate("path", elements(x), elements(u), p.record, SYMBOLIC))
        found += [c.name for i, c in enumerate(phase.path_conditions) if attainable_as_equality(phase, values[i], u)]
    return tuple(dict.fromkeys(found))


@lru_cache(maxsize=64)
def _derive(unnumbered: Unnumbered, keep: Held) -> OptimalityConditions:
    problem = unnumbered.problem
    p = trace_parameters(problem)
    symbols, limits = limit_symbols(problem, p)
    offset = ca.SX.sym("offset", len(problem.phases[0].states))
    numbers = ca.vertcat(p.given, symbols, offset)
    phases = [
        canonical_equations(phase, p, pairs, numbers, problem.free_names, keep, *known)
        for phase, pairs, *known in zip(
            problem.phases, limits, unpriced_states(problem), cost_states(problem), strict=True
        )
    ]
    lam0 = [ca.SX.sym(f"lam0_{k}", e.half) for k, e in enumerate(phases)]
    nu = [ca.SX.sym(f"nu_{k}", len(phase.end_conditions)) for k, phase in enumerate(problem.phases)]
    y = ca.vertcat(*lam0, p.free, *nu)
    ends = [ca.SX.sym(f"zf_{k}", 2 * e.half) for k, e in enumerate(phases)]

    starts, initial_states = _phase_start_functions(problem, p, numbers, offset, tuple(phases), lam0, y)
    conditions, costates = [], []
    last = problem.phases[-1]
    cost = ca.SX(problem.objective(last.state_record(*elements(ends[-1][: len(last.states)])), p.record, SYMBOLIC))
    lagrangian = cost  # its derivative by q collects every way a free parameter acts at the boundaries
    for k, (phase, extremal, zf) in enumerate(zip(problem.phases, phases, ends, strict=True)):
        x_end, lam_end = zf[: extremal.half], zf[extremal.half :]
        psi = trace_at_end(phase, zf[: extremal.state_count], p.record)
        conditions.append(psi)
        boundary = ca.dot(nu[k], psi)
        if phase is last:
            boundary += cost
        else:  # the link carries the next phase's costate back to this end
            boundary += ca.dot(lam0[k + 1], initial_states[k + 1](zf))
        costates.append(lam_end - ca.gradient(boundary, x_end))
        lagrangian += ca.dot(nu[k], psi) + ca.dot(lam0[k], initial_states[k](ends[k - 1] if k else ca.SX(0, 1)))
    stationarity = ca.gradient(lagrangian, p.free)
    sides = [(zf, ca.vertcat(initial_states[k + 1](zf), lam0[k + 1])) for k, zf in enumerate(ends[:-1])]
    met = [(zf[: e.state_count], psi, nu_k) for e, zf, psi, nu_k in zip(phases, ends, conditions, nu, strict=True)]
    slopes = ca.SX(stationarity)
    joints = [
        *smooth_junction_rows(problem, p, phases, sides, numbers, slopes),
        *contact_point_rows(problem, p, met, slopes),
    ]
    for phase, extremal, zf in zip(problem.phases, phases, ends, strict=True):
        if phase.duration in problem.free_names:
            stationarity[problem.free_names.index(phase.duration)] += hamiltonian_at(extremal, zf, numbers)
    for i, _, row in joints:
        stationarity[i] = row
    residual = ca.vertcat(*conditions, *costates, stationarity)
    zf = ca.vertcat(*ends)
    silent = tuple(_zero_costates(e, z, rows) for e, z, rows in zip(phases, ends, costates, strict=True))
    silent_rows = _zero_costate_rows(phases, silent, sum(c.numel() for c in conditions))
    # J is read off the ends too: an integrated cost is in no condition.
    read = ca.vertcat(residual, cost)
    needed = _needed_end_entries(phases, ends, read, starts, silent, {row for row, _ in silent_rows})
    count = sum(e.half for e in phases)
    unknowns, residuals = _names(problem, tuple(phases), {i: name for i, name, _ in joints})
    return OptimalityConditions(
        phases=tuple(phases),
        starts=starts,
        residual=ca.Function("residual", [y, zf, numbers], ca.cse([residual, cost])),
        unknowns=unknowns,
        residuals=residuals,
        free_at=slice(count, count + len(problem.free)),
        costate_at=_slices([e.half for e in phases]),
        transversality_at=sum(c.numel() for c in conditions),
        stationarity_at=slice(residual.numel() - len(problem.free), residual.numel()),
        ranges=tuple((row, count + len(problem.free) + row) for row in _range_rows(problem)),
        silent=silent,
        silent_rows=silent_rows,
        needed=needed,
    )


def _range_rows(problem: Problem) -> list[int]:
    """Return the rows of the end conditions that have a finite bound: those rows come first, phase by phase."""
    conditions = [c for phase in problem.phases for c in phase.end_conditions]
    return [row for row, c in enumerate(conditions) if c.ranged]


def _zero_costates(extremal: PhaseExtremal, zf: ca.SX, transversality: ca.SX) -> tuple[int, ...]:
    """Return costates with rate zero in every mode whose condition at the end is that they vanish."""
    half, p = extremal.half, ca.SX.sym("p", extremal.modes[0].size1_in(1))
    rates = [mode(zf, p) for mode in extremal.modes]
    jumps = [event.jump(zf, p) - zf for event in extremal.events if event.jump is not None]
    return tuple(
        half + i
        for i in range(half)
        if ca.substitute(transversality[i], zf[half + i], 0).is_zero()
        and all(change[half + i].is_zero() for change in (*rates, *jumps))
    )


def _zero_costate_rows(
    phases: list[PhaseExtremal], silent: tuple[tuple[int, ...], ...], first_row: int
) -> tuple[tuple[int, int], ...]:
    found, at = [], 0
    for extremal, entries in zip(phases, silent, strict=True):
        found += [(first_row + at + i - extremal.half, at + i - extremal.half) for i in entries]
        at += extremal.half
    return tuple(found)


def _needed_end_entries(
    phases: list[PhaseExtremal],
    ends: list[ca.SX],
    read: ca.SX,
    starts: tuple[ca.Function, ...],
    silent: tuple[tuple[int, ...], ...],
    silent_rows: set[int],
) -> tuple[tuple[int, ...], ...]:
    """Return entries of each end that the other rows (the residual's, and J), or the next phase's start, depend on."""
    rows = read[[i for i in range(read.numel()) if i not in silent_rows]]
    for zf, entries in zip(ends, silent, strict=True):
        for i in entries:
            rows = ca.substitute(rows, zf[i], 0)
    found = []
    for k, zf in enumerate(ends):
        wanted = set(ca.jacobian_sparsity(ca.simplify(rows), zf).get_triplet()[1])
        if k + 1 < len(phases):
            wanted |= set(starts[k + 1].jac_sparsity(0, 1).get_triplet()[1])
        found.append(tuple(sorted(wanted - set(silent[k]))))
    return tuple(found)


def _phase_start_functions(
    problem: Problem,
    p: Parameters,
    numbers: ca.SX,
    offset: ca.SX,
    phases: tuple[PhaseExtremal, ...],
    lam0: list[ca.SX],
    y: ca.SX,
) -> tuple[tuple[ca.Function, ...], list[Callable[[ca.SX], ca.SX]]]:
    """Derive functions for the start of each phase, and its states as callables of the end before."""
    starts, states = [], []
    for k, (phase, extremal) in enumerate(zip(problem.phases, phases, strict=True)):
        constants = [p.free[i] for i in extremal.constants]

        def state(before: ca.SX, k: int = k, constants: list[ca.SX] = constants) -> ca.SX:
            if k == 0:
                return ca.vertcat(column(problem.start(p.record, SYMBOLIC)) + offset, *constants)
            previous = problem.phases[k - 1]
            record = previous.state_record(*elements(before[: len(previous.states)]))
            return ca.vertcat(column(problem.links[k - 1](record, p.record, SYMBOLIC)), *constants)

        states.append(state)
        before = ca.SX.sym("before", 2 * phases[k - 1].half if k else 0)
        z0 = ca.vertcat(state(before), lam0[k])
        duration = getattr(p.record, phase.duration)
        starts.append(ca.Function(f"start_{k}", [y, before, numbers], ca.cse([z0, ca.SX(duration)])))
    return tuple(starts), states


def _slices(lengths: list[int]) -> tuple[slice, ...]:
    ends = [sum(lengths[: i + 1]) for i in range(len(lengths))]
    return tuple(slice(end - length, end) for end, length in zip(ends, lengths, strict=True))


Names = tuple[tuple[str, str], ...]


def _names(problem: Problem, phases: tuple[PhaseExtremal, ...], joints: dict[int, str]) -> tuple[Names, Names]:
    """Return (name, unit) of each unknown and of each residual; `joints` names the joints' rows, by parameter."""
    cost = problem.objective_unit
    lam, nu, psi, transversality = [], [], [], []
    for phase, extremal in zip(problem.phases, phases, strict=True):
        promoted = [(problem.free[i].name, problem.free[i].unit) for i in extremal.constants]
        for name, unit in [*((s.name, s.unit) for s in phase.states), *promoted]:
            lam.append((f"{phase.name}.lambda_{name}(0)", quotient_unit(cost, unit)))
            transversality.append((f"{phase.name}: transversality of {name} at the end", quotient_unit(cost, unit)))
        for c in phase.end_conditions:
            nu.append((f"{phase.name}.nu_{c.name}", quotient_unit(cost, c.unit)))
            psi.append((f"{phase.name}: {c.name}", c.unit))
    free = [(f.name, f.unit) for f in problem.free]
    stationarity = [
        (joints.get(i, f"stationarity in {f.name}"), quotient_unit(cost, f.unit)) for i, f in enumerate(problem.free)
    ]
    return (*lam, *free, *nu), (*psi, *transversality, *stationarity)
