"""First-order optimality conditions of a `Problem`, derived by automatic differentiation alone.

Sign convention (the tests assert it: lambda(t0) = dJ*/dx0):

    H = lambda . f(x, u, p), the control minimises H                             Cho et al. 2015 (11), (14)
    lambda' = -dH/dx                                                             (12), which prints H_r for H_x
    lambda(T) = dJ/dx + nu . dpsi/dx at the last end                             (18), (19)
    lambda_k(T) = (dlink/dx)^T lambda_{k+1}(0) + nu_k . dpsi_k/dx at an inner end

and for each free parameter q, which may move the initial state, the ends, the links or a duration,

    dJ/dq + nu . dpsi/dq + lambda_1(0) . dstart/dq + lambda_{k+1}(0) . dlink_k/dq + (H_k(T_k) if q is T_k) = 0.

For the retro burn this last line is Cho et al. (19), "lambda_u(0) + lambda_m(0) M/c exp(...) = 0", and H_f = 0. A free
parameter in the dynamics becomes a constant state, whose costate collects the integral of dH/dq.

The minimising control is smooth in each *mode*, a combination of regimes of the scalar controls (at a bound, or between
bounds: `perilune.conditions.control_law`); zeros of switching functions are events between modes.

Unknowns of shooting: y = (lambda_k(0) for each phase, free parameters, nu), all in canonical units.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate

import casadi as ca
import numpy as np

from perilune.conditions.control_law import ControlLaw, minimising_control
from perilune.kernels import Event
from perilune.problem.controls import Bounded, Regime, scalars
from perilune.problem.problem import Phase, Problem
from perilune.problem.symbolic import (
    SYMBOLIC,
    Kinked,
    Parameters,
    Unnumbered,
    canonical_given,
    column,
    elements,
    trace_at_end,
    trace_parameters,
    trace_sides,
)
from perilune.words.outcome import PeriluneError
from perilune.words.types import Vector
from perilune.words.units import quotient

_REFRACTIONS = 7  # steps of Newton's method for the costate behind a surface; a step too many changes nothing


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseExtremal:
    """The canonical equations of one phase, z = (x, constant states, lambda) in canonical units.

    Parameters
    ----------
    modes
        (z, p) -> z' for each mode. p is `extremal_parameters`.
    solved
        For each mode None, or where its control is found by Newton's method (z, p) -> w and (z, [p; w]) -> z'.
    reports
        (z, p) -> (u, u', H) for each mode: the minimising control, its rate along the extremal, the Hamiltonian.
    regimes
        For each mode the regime of each scalar control.
    events
        What leads from mode to mode.
    mode
        (z, p) -> number of the mode in which H is least.
    state_count
        Number of x's own components; z has 2 (state_count + constants) components.
    constants
        Indices of the free parameters that were made constant states.
    """

    modes: tuple[ca.Function, ...]
    solved: tuple[tuple[ca.Function, ca.Function] | None, ...]
    reports: tuple[ca.Function, ...]
    regimes: tuple[tuple[Regime, ...], ...]
    events: tuple[Event, ...]
    mode: ca.Function
    state_count: int
    constants: tuple[int, ...]

    @property
    def half(self) -> int:
        """Length of lambda."""
        return self.state_count + len(self.constants)


@dataclass(frozen=True, kw_only=True, eq=False)
class Conditions:
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
    stationarity_at
        Slice of the residual: one row for each free parameter, which is dJ/dq along the family of extremals.
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
    stationarity_at: slice
    ranges: tuple[tuple[int, int], ...]
    silent: tuple[tuple[int, ...], ...]
    silent_rows: tuple[tuple[int, int], ...]
    needed: tuple[tuple[int, ...], ...]


def extremal_parameters(problem: Problem) -> Vector:
    """The numbers p of the canonical equations: the given parameters, then the limits that are numbers of their own."""
    limits = [limit / problem.scales.of(control.unit) for control, limit in _plain_limits(problem)]
    return np.concatenate([canonical_given(problem), limits])


def _plain_limits(problem: Problem) -> list[tuple[Bounded, float]]:
    """Every finite limit of a scalar control that is a number and not a parameter's name."""
    return [
        (control, limit)
        for phase in problem.phases
        for _, control in scalars(phase.controls)
        for limit in (control.lower, control.upper)
        if not isinstance(limit, str) and np.isfinite(limit)
    ]


def _limit_symbols(problem: Problem, p: Parameters) -> tuple[ca.SX, list[dict[str, tuple[ca.SX, ca.SX]]]]:
    """Symbols of the plain limits, and for each phase (lower, upper) of each scalar by name."""
    symbols, found = list[ca.SX](), []
    for phase in problem.phases:
        pairs = {}
        for _, control in scalars(phase.controls):
            pair = []
            for limit in (control.lower, control.upper):
                if isinstance(limit, str):
                    pair.append(ca.SX(getattr(p.record, limit)))
                elif np.isfinite(limit):
                    symbols.append(ca.SX.sym(f"{phase.name}_{control.name}"))
                    pair.append(symbols[-1])
                else:
                    pair.append(ca.SX(limit))
            pairs[control.name] = (pair[0], pair[1])
        found.append(pairs)
    return ca.vertcat(ca.SX(0, 1), *symbols), found


def _phase_extremal(
    phase: Phase,
    p: Parameters,
    limits: dict[str, tuple[ca.SX, ca.SX]],
    numbers: ca.SX,
    free_names: tuple[str, ...],
) -> PhaseExtremal:
    n = len(phase.states)
    x, u = ca.SX.sym("x", n), ca.SX.sym("u", len(phase.control_names))
    dynamics = trace_sides(phase, x, u, p.record)
    acting = ca.vertcat(*dynamics.rates, *dynamics.margins, *(limit for pair in limits.values() for limit in pair))
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

    laws, flows, solved, reports = [], [], [], []
    for f in dynamics.rates:
        hamiltonian = ca.dot(lam[:n], f)
        law = minimising_control(phase, hamiltonian, u, limits)
        # dH/dx at fixed u: on the minimising control the derivative through u vanishes or is tangent to its constraint.
        gradient = ca.gradient(hamiltonian, ca.vertcat(x, q))
        for control, found in zip(law.control, law.solved, strict=True):
            # A limit that is a free parameter moves the control with it.
            pull = ca.vertcat(ca.SX.zeros(n, 1), _through_limits(hamiltonian, u, control, limits, q))
            whole = ca.vertcat(f, ca.SX.zeros(len(constants), 1), -gradient - pull)
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
    return PhaseExtremal(
        modes=tuple(function("rhs", rate) for rate in flows),
        solved=tuple(solved),
        reports=tuple(reports),
        regimes=tuple(regimes for law in laws for regimes in law.regimes),
        events=tuple(_events(dynamics, laws, flows, z, function)),
        mode=function("mode", _mode(dynamics, laws)),
        state_count=n,
        constants=constants,
    )


def _mode(dynamics: Kinked, laws: list[ControlLaw]) -> ca.SX:
    """Number of the mode at a point: the side of each kink, and there the regimes in which H is least."""
    number, first = ca.SX(0.0), 0
    for sides, law in zip(dynamics.sides, laws, strict=True):
        here = ca.SX(1.0)
        for side, margin in zip(sides, dynamics.margins, strict=True):
            here = ca.logic_and(here, margin > 0 if side else margin <= 0)
        number = ca.if_else(here, first + law.mode, number)
        first += len(law.control)
    return number


def _events(
    dynamics: Kinked, laws: list[ControlLaw], flows: list[ca.SX], z: ca.SX, function: Callable[..., ca.Function]
) -> Iterator[Event]:
    """What leads from mode to mode: the control's transitions on each side, and the kinks."""
    firsts = list(accumulate((len(law.control) for law in laws), initial=0))
    grouped: dict[tuple[str, int], tuple[ca.Function, dict[int, int]]] = {}
    for first, law in zip(firsts, laws, strict=False):
        for way in law.transitions:
            S = function("S", way.function)
            switches = grouped.setdefault((S.serialize(), way.direction), (S, {}))[1]
            switches |= {first + before: first + after for before, after in way.switches.items()}
    for (_, direction), (S, switches) in grouped.items():
        yield Event(function=S, direction=direction, switches=switches)
    for number, (sides, law) in enumerate(zip(dynamics.sides, laws, strict=True)):
        for i, margin in enumerate(dynamics.margins):
            other = dynamics.sides.index((*sides[:i], not sides[i], *sides[i + 1 :]))
            for k, regimes in enumerate(law.regimes):
                if regimes in laws[other].regimes:
                    before, after = firsts[number] + k, firsts[other] + laws[other].regimes.index(regimes)
                    yield Event(
                        function=function("kink", margin),
                        direction=-1 if sides[i] else 1,
                        switches={before: after},
                        jump=function("jump", _refracted(z, margin, flows[before], flows[after])),
                    )


def _refracted(z: ca.SX, margin: ca.SX, before: ca.SX, after: ca.SX) -> ca.SX:
    """z beyond a surface g = 0 on which the dynamics change: lambda+ = lambda- - nu g_x, and H goes on as it was.

    nu is 0 where the rates are continuous (Bryson, Ho 1975, section 3.7). As the control behind the surface is that of
    lambda+, nu is found by Newton's method: dH+/dnu = -g_x . f+, H being stationary in the control.
    """
    half = z.numel() // 2
    x, lam = z[:half], z[half:]
    normal, kept = ca.gradient(margin, x), ca.dot(lam, before[:half])
    behind = lam
    for _ in range(_REFRACTIONS):
        rate = ca.substitute(after[:half], lam, behind)
        behind = behind - (ca.dot(behind, rate) - kept) / ca.dot(normal, rate) * normal
    return ca.vertcat(x, behind)


def _through_limits(
    hamiltonian: ca.SX, u: ca.SX, control: ca.SX, limits: dict[str, tuple[ca.SX, ca.SX]], q: ca.SX
) -> ca.SX:
    """dH/dq through a control that sits at a limit which depends on the free parameters q."""
    if not ca.depends_on(ca.vertcat(ca.SX(0, 1), *(limit for pair in limits.values() for limit in pair)), q):
        return ca.SX.zeros(q.numel(), 1)
    # On a bound dH/du is its multiplier; between bounds it vanishes, and along a sphere it is tangent to nothing.
    return ca.mtimes(ca.jacobian(control, q).T, ca.gradient(hamiltonian, u))


def derive(problem: Problem) -> Conditions:
    """Derive the boundary value problem of a `Problem`.

    Values and bounds do not enter the expressions, so problems that differ only in them share one derivation.

    Raises
    ------
    PeriluneError
        If a control's minimum of H is not known in closed form.
    """
    return _derive(Unnumbered(problem))


@lru_cache(maxsize=64)
def _derive(unnumbered: Unnumbered) -> Conditions:
    problem = unnumbered.problem
    p = trace_parameters(problem)
    symbols, limits = _limit_symbols(problem, p)
    numbers = ca.vertcat(p.given, symbols)
    phases = [
        _phase_extremal(phase, p, pairs, numbers, problem.free_names)
        for phase, pairs in zip(problem.phases, limits, strict=True)
    ]
    lam0 = [ca.SX.sym(f"lam0_{k}", e.half) for k, e in enumerate(phases)]
    nu = [ca.SX.sym(f"nu_{k}", len(phase.end_conditions)) for k, phase in enumerate(problem.phases)]
    y = ca.vertcat(*lam0, p.free, *nu)
    ends = [ca.SX.sym(f"zf_{k}", 2 * e.half) for k, e in enumerate(phases)]

    starts, initial_states = _starts(problem, p, numbers, tuple(phases), lam0, y)
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
    for phase, extremal, zf in zip(problem.phases, phases, ends, strict=True):
        if phase.duration in problem.free_names:
            stationarity[problem.free_names.index(phase.duration)] += _hamiltonian(extremal, zf, numbers)
    residual = ca.vertcat(*conditions, *costates, stationarity)
    zf = ca.vertcat(*ends)
    silent = tuple(_silent(e, z, rows) for e, z, rows in zip(phases, ends, costates, strict=True))
    silent_rows = _silent_rows(phases, silent, sum(c.numel() for c in conditions))
    # J is read off the ends too: a cost that is integrated stands in no condition.
    read = ca.vertcat(residual, cost)
    needed = _needed(phases, ends, read, starts, silent, {row for row, _ in silent_rows})
    count = sum(e.half for e in phases)
    unknowns, residuals = _names(problem, tuple(phases))
    return Conditions(
        phases=tuple(phases),
        starts=starts,
        residual=ca.Function("residual", [y, zf, numbers], ca.cse([residual, cost])),
        unknowns=unknowns,
        residuals=residuals,
        free_at=slice(count, count + len(problem.free)),
        costate_at=_slices([e.half for e in phases]),
        stationarity_at=slice(residual.numel() - len(problem.free), residual.numel()),
        ranges=tuple((row, count + len(problem.free) + row) for row in _range_rows(problem)),
        silent=silent,
        silent_rows=silent_rows,
        needed=needed,
    )


def _range_rows(problem: Problem) -> list[int]:
    """Rows of the end conditions that have a finite bound: those rows come first, phase by phase."""
    conditions = [c for phase in problem.phases for c in phase.end_conditions]
    return [row for row, c in enumerate(conditions) if c.ranged]


def _silent(extremal: PhaseExtremal, zf: ca.SX, transversality: ca.SX) -> tuple[int, ...]:
    """Costates with rate zero in every mode whose condition at the end is that they vanish."""
    half, p = extremal.half, ca.SX.sym("p", extremal.modes[0].size1_in(1))
    rates = [mode(zf, p) for mode in extremal.modes]
    jumps = [event.jump(zf, p) - zf for event in extremal.events if event.jump is not None]
    return tuple(
        half + i
        for i in range(half)
        if ca.substitute(transversality[i], zf[half + i], 0).is_zero()
        and all(change[half + i].is_zero() for change in (*rates, *jumps))
    )


def _silent_rows(
    phases: list[PhaseExtremal], silent: tuple[tuple[int, ...], ...], first_row: int
) -> tuple[tuple[int, int], ...]:
    found, at = [], 0
    for extremal, entries in zip(phases, silent, strict=True):
        found += [(first_row + at + i - extremal.half, at + i - extremal.half) for i in entries]
        at += extremal.half
    return tuple(found)


def _needed(
    phases: list[PhaseExtremal],
    ends: list[ca.SX],
    read: ca.SX,
    starts: tuple[ca.Function, ...],
    silent: tuple[tuple[int, ...], ...],
    silent_rows: set[int],
) -> tuple[tuple[int, ...], ...]:
    """Entries of each end that the other rows (the residual's, and J), or the next phase's start, depend on."""
    rows = read[[i for i in range(read.numel()) if i not in silent_rows]]
    for zf, entries in zip(ends, silent, strict=True):
        for i in entries:
            rows = ca.substitute(rows, zf[i], 0)
    found = []
    for k, zf in enumerate(ends):
        wanted = set(ca.jacobian(ca.simplify(rows), zf).sparsity().get_triplet()[1])
        if k + 1 < len(phases):
            wanted |= set(starts[k + 1].jac_sparsity(0, 1).get_triplet()[1])
        found.append(tuple(sorted(wanted - set(silent[k]))))
    return tuple(found)


def _hamiltonian(extremal: PhaseExtremal, z: ca.SX, numbers: ca.SX) -> ca.SX:
    """H on the minimising control, that of the mode in which it is least."""
    value, mode = extremal.reports[0](z, numbers)[2], extremal.mode(z, numbers)
    for k, report in enumerate(extremal.reports[1:], 1):
        value = ca.if_else(mode == k, report(z, numbers)[2], value)
    return value


def _starts(
    problem: Problem,
    p: Parameters,
    numbers: ca.SX,
    phases: tuple[PhaseExtremal, ...],
    lam0: list[ca.SX],
    y: ca.SX,
) -> tuple[tuple[ca.Function, ...], list[Callable[[ca.SX], ca.SX]]]:
    """Functions for the start of each phase, and the start's states as callables of the end before."""
    starts, states = [], []
    for k, (phase, extremal) in enumerate(zip(problem.phases, phases, strict=True)):
        constants = [p.free[i] for i in extremal.constants]

        def state(before: ca.SX, k: int = k, constants: list[ca.SX] = constants) -> ca.SX:
            if k == 0:
                return ca.vertcat(column(problem.start(p.record, SYMBOLIC)), *constants)
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


def _names(problem: Problem, phases: tuple[PhaseExtremal, ...]) -> tuple[Names, Names]:
    """(name, unit) of each unknown and of each residual."""
    cost = problem.objective_unit
    lam, nu, psi, transversality = [], [], [], []
    for phase, extremal in zip(problem.phases, phases, strict=True):
        promoted = [(problem.free[i].name, problem.free[i].unit) for i in extremal.constants]
        for name, unit in [*((s.name, s.unit) for s in phase.states), *promoted]:
            lam.append((f"{phase.name}.lambda_{name}(0)", quotient(cost, unit)))
            transversality.append((f"{phase.name}: transversality of {name} at the end", quotient(cost, unit)))
        for c in phase.end_conditions:
            nu.append((f"{phase.name}.nu_{c.name}", quotient(cost, c.unit)))
            psi.append((f"{phase.name}: {c.name}", c.unit))
    free = [(f.name, f.unit) for f in problem.free]
    stationarity = [(f"stationarity in {f.name}", quotient(cost, f.unit)) for f in problem.free]
    return (*lam, *free, *nu), (*psi, *transversality, *stationarity)
