"""Equal steps of Gragg's extrapolated midpoint rule, of order 8, with margins: start, steps and end of a phase.

Steps are those of the extrapolated midpoint rule.

Source: E. Hairer, S. P. Norsett, G. Wanner, *Solving Ordinary Differential Equations I*, 2nd ed., Springer 1993,
section II.9 (9.10), (9.13).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from perilune.charts import extrapolated_midpoint as singular
from perilune.charts.bound_status import SLACK, conjunction
from perilune.charts.multiplier_signs import NOTHING, ChartBoundaryArcs
from perilune.conditions import OptimalityConditions, PhaseExtremal, hamiltonian_at, limit_symbols
from perilune.problem import (
    SYMBOLIC,
    Phase,
    Problem,
    ScalarControl,
    Settled,
    column,
    control_slices,
    elements,
    scalars,
    trace_parameters,
)
from perilune.shooting import settling_equations

FAR = 1e30  # stands for infinity: nothing was looked at yet
# The least condition, the least gain of another control, the least and most H, the least multiplier of boundary arcs.
NOTHING_SEEN = (FAR, FAR, FAR, -FAR, FAR)
_NEARLY = 1e-3  # canonical: what a flight by finer steps may mend
_SUBSTEPS = (2, 4, 6, 8)
_KEPT = 1e-9  # canonical: by so little a control may miss what is held
_NEAR = 0.1  # how far from the control that is flown an unbounded one is tried, canonical


class MarchedMargins(NamedTuple):
    """Margins and errors of an independent re-integration, canonical: symbols, or columns of numbers.

    Attributes
    ----------
    path
        The least of all conditions of the path and distances of states from their bounds; `FAR` without any.
    minimum
        The least of H of another control minus H of the flown one.
    drift
        Change of H along a phase.
    cost
        J.
    least_multiplier
        The least multiplier of boundary arcs, which is below zero where J falls if the flight leaves one.
    residual
        The largest violation of a condition at the ends.
    good
        True if nothing is violated.
    nearly
        True if something is violated by as little as rounding or coarse steps may cause.
    """

    path: Any
    minimum: Any
    drift: Any
    cost: Any
    least_multiplier: Any
    residual: Any
    good: Any
    nearly: Any


def start_function(conditions: OptimalityConditions, k: int) -> ca.Function:
    """Build the function (y, numbers, end state of the phase before) -> marched state, all of z, and duration.

    Parameters
    ----------
    conditions
        Optimality conditions of the chart.
    k
        Number of the phase.
    """
    y, p = ca.SX.sym("y", len(conditions.unknowns)), ca.SX.sym("p", conditions.residual.size1_in(2))
    extremal = conditions.phases[k]
    before = _march_symbols(conditions, k - 1) if k else ca.SX(0, 1)
    z, duration = conditions.starts[k](y, _phase_end_state(conditions, k - 1, before) if k else before, p)
    flown = settling_equations(extremal).start(z[: extremal.half]) if extremal.settles else z
    state = ca.vertcat(flown, ca.DM(NOTHING_SEEN))
    return ca.Function("begun", [y, p, before], [ca.cse(ca.densify(each)) for each in (state, z, duration)])


def _march_symbols(conditions: OptimalityConditions, k: int) -> ca.SX:
    """Return symbols for the marched state of a phase: z, or x and the moving part of Phi; and the margins so far."""
    extremal = conditions.phases[k]
    size = settling_equations(extremal).equations.modes[0].size1_in(0) if extremal.settles else 2 * extremal.half
    return ca.SX.sym(f"state{k}", size + len(NOTHING_SEEN))


def _phase_end_state(conditions: OptimalityConditions, k: int, state: ca.SX) -> ca.SX:
    """Return z at the end of a phase; for one that settles x, and zeros."""
    extremal = conditions.phases[k]
    n = extremal.half
    return ca.vertcat(state[:n], ca.SX.zeros(n, 1)) if extremal.settles else state[: 2 * n]


def end_function(conditions: OptimalityConditions, rides: ChartBoundaryArcs) -> ca.Function:
    """Build the function (y, numbers, choice, state at the end of each phase) -> residuals, seen, rates, ranges, ends.

    Choice and results are those of `perilune.charts.reintegrate`.

    Parameters
    ----------
    conditions
        Optimality conditions of the chart.
    rides
        Boundary arcs of its extremals.
    """
    y, p = ca.SX.sym("y", len(conditions.unknowns)), ca.SX.sym("p", conditions.residual.size1_in(2))
    free = conditions.free_at.stop - conditions.free_at.start
    held, told = (ca.SX.sym(name, free + len(conditions.ranges)) for name in ("held", "told"))
    marched = [_march_symbols(conditions, k) for k in range(len(conditions.phases))]
    ends = [_phase_end_state(conditions, k, state) for k, state in enumerate(marched)]
    plain, cost = conditions.residual(y, ca.vertcat(*ends), p)
    settled = [k for k, extremal in enumerate(conditions.phases) if extremal.settles]
    rows = dict[int, slice]()
    for k in settled:
        at, first = conditions.costate_at[k], conditions.transversality_at
        rows[k] = slice(first + at.start, first + at.stop)
        ends[k][conditions.phases[k].half :] = -plain[rows[k]]  # the costates that its end asks for
    residual, cost = conditions.residual(y, ca.vertcat(*ends), p)
    path, minimum, drift, pays = ca.SX(FAR), ca.SX(FAR), ca.SX(0.0), ca.SX(FAR)
    begins = [
        conditions.starts[k](y, _phase_end_state(conditions, k - 1, marched[k - 1]) if k else ca.SX(0, 1), p)[0]
        for k in range(len(marched))
    ]
    for k, (extremal, state) in enumerate(zip(conditions.phases, marched, strict=True)):
        condition, gain, least, most, multiplier = ca.vertsplit(state[-len(NOTHING_SEEN) :])
        path, minimum, change = ca.fmin(path, condition), ca.fmin(minimum, gain), most - least
        pays = ca.fmin(pays, multiplier)
        if extremal.settles:
            n, lam = extremal.half, y[conditions.costate_at[k]]
            residual[rows[k]] = lam - ca.mtimes(
                settling_equations(extremal).transition(state[: -len(NOTHING_SEEN)]).T, ends[k][n:]
            )
            values = [hamiltonian_at(extremal, z, p) for z in (ca.vertcat(begins[k][:n], lam), ends[k])]
            change = ca.fabs(values[1] - values[0])
        drift = ca.fmax(drift, change)
    ranged = [row for row, _ in conditions.ranges]
    rates, ranges = residual[conditions.stationarity_at], residual[ranged]
    residual[conditions.stationarity_at] *= 1 - held[:free]
    for i, (row, nu) in enumerate(conditions.ranges, free):  # one that is not held has no multiplier
        residual[row] = ca.if_else(held[i], residual[row] - told[i], y[nu])
    jumps, aside = rides.jumps(y, begins, ends, p)
    path = ca.mmin(ca.vertcat(path, rides.turns(y, begins, ends, p)))
    pays, minimum = ca.fmin(pays, jumps) + NOTHING, ca.fmin(minimum, -aside)
    missed = ca.vertcat(ca.fabs(residual), -path, -minimum)
    good = conjunction(*ca.vertsplit(ca.vertcat(missed, drift) <= SLACK))
    nearly = conjunction(*ca.vertsplit(missed <= _NEARLY), ca.logic_not(good))
    seen = MarchedMargins(path, minimum, drift, cost, pays, ca.mmax(ca.fabs(residual)), good, nearly)
    counts = [extremal.state_count for extremal in conditions.phases]
    states = ca.vertcat(begins[0][: counts[0]], *(end[:n] for end, n in zip(ends, counts, strict=True)))
    found = [residual, ca.vertcat(*seen), rates, ranges, states]
    return ca.Function("ended", [y, p, ca.vertcat(held, told), *marched], [ca.cse(ca.densify(each)) for each in found])


def step_along(rides: ChartBoundaryArcs, k: int, mode: int) -> ca.Function:
    """Build one step: (z and margins so far, numbers, free parameters, length) -> the same behind it.

    Parameters
    ----------
    rides
        Boundary arcs of the chart's extremals.
    k, mode
        Numbers of the phase, and of its mode between two switches.
    """
    extremal = rides.conditions.phases[k]
    size = 2 * extremal.half
    numbers = ca.SX.sym("numbers", extremal.modes[mode].size1_in(1))
    free, h = ca.SX.sym("free", len(rides.stated.free)), ca.SX.sym("h")
    state = ca.SX.sym("state", size + len(NOTHING_SEEN))
    z = state[:size]
    after = extrapolated_step(lambda point: extremal.modes[mode](point, numbers), z, h)
    path, minimum, value, smooth = _margins_at(rides, k, mode, z, numbers, free)
    dip = _minimum_inside_step(smooth, lambda point: extremal.modes[mode](point, numbers), z, after, h)
    behind = _margins_at(rides, k, mode, after, numbers, free)[0]  # a control may break it within the last step
    bent = singular.kelley_terms(rides.stated, rides.stated.phases[k], extremal, mode, z, numbers, free)
    seen = [
        ca.mmin(ca.vertcat(state[size], path, dip, behind)),
        ca.fmin(state[size + 1], minimum),
        ca.fmin(state[size + 2], value),
        ca.fmax(state[size + 3], value),
        ca.mmin(ca.vertcat(state[size + 4], *rides.arc_multipliers(k, mode, z, numbers), *bent)),
    ]
    out = ca.vertcat(after, *seen)
    return ca.Function("step", [state, numbers, free, h], [ca.cse(out)])


def step_settling(rides: ChartBoundaryArcs, k: int, mode: int) -> ca.Function:
    """Build one step of a phase that settles, with (x, Phi) in place of z, and no control.

    Parameters
    ----------
    rides
        Boundary arcs of the chart's extremals.
    k, mode
        Numbers of the phase, and of its mode between two switches.
    """
    extremal = rides.conditions.phases[k]
    made = settling_equations(extremal)
    flown, known = made.equations.modes[mode], made.equations.numbers.tolist()
    numbers = ca.SX.sym("numbers", extremal.modes[mode].size1_in(1))
    free, h = ca.SX.sym("free", len(rides.stated.free)), ca.SX.sym("h")
    size = flown.size1_in(0)
    state = ca.SX.sym("state", size + len(NOTHING_SEEN))
    after = extrapolated_step(lambda point: flown(point, numbers[known]), state[:size], h)
    still = ca.vertcat(state[: extremal.half], ca.SX.zeros(extremal.half, 1))
    path, _, _, smooth = _margins_at(rides, k, mode, still, numbers, free)
    dip = _minimum_inside_step(smooth, lambda point: flown(point, numbers[known]), state[:size], after, h)
    seen = ca.vertcat(ca.mmin(ca.vertcat(state[size], path, dip)), state[size + 1 :])
    return ca.Function("step", [state, numbers, free, h], [ca.cse(ca.vertcat(after, seen))])


def extrapolated_step(rate: Any, z: ca.SX, h: ca.SX) -> ca.SX:
    """Return a step of order 8: midpoint rules of 2, 4, 6 and 8 parts, extrapolated in the square of their length.

    Extrapolated are increments of z, which are small: so a step rounds z once, and not some ten times.

    Parameters
    ----------
    rate
        ``rate(z)`` returns dz/dt, canonical.
    z
        State and costate, canonical.
    h
        Length of the step, canonical.
    """
    first, table = rate(z), list[ca.SX]()
    for j, count in enumerate(_SUBSTEPS):
        part = h / count
        before, way = ca.SX.zeros(z.numel()), part * first
        for _ in range(count - 1):
            before, way = way, before + 2 * part * rate(z + way)
        row = [way]
        for k in range(1, j + 1):
            ratio = (count / _SUBSTEPS[j - k]) ** 2 - 1.0
            row.append(row[k - 1] + (row[k - 1] - table[k - 1]) / ratio)
        table = row
    return z + table[-1]


def _minimum_inside_step(smooth: tuple[ca.SX, ca.SX], rate: Any, before: ca.SX, after: ca.SX, h: ca.SX) -> ca.SX:
    """Return the least of conditions inside a step, by the cubic of values and rates at both ends."""
    point, conditions = smooth
    if not conditions.numel():
        return ca.SX(FAR)
    way, n = ca.SX.sym("way", point.numel()), point.numel()
    changes = ca.jtimes(conditions, point, way)
    (a, b), (far, slope) = (
        ca.substitute([conditions, h * changes], [point, way], [z[:n], rate(z)[:n]]) for z in (before, after)
    )
    c, d = 3 * (far - a) - 2 * b - slope, 2 * (a - far) + b + slope
    below = c + ca.sqrt(ca.fmax(c * c - 3 * b * d, 0))  # of a + b s + c s^2 + d s^3, which turns up at -b/below
    s = ca.if_else(ca.fabs(below) > 0, ca.fmin(ca.fmax(-b / below, 0), 1), 0)
    return ca.mmin(a + s * (b + s * (c + s * d)))


def _margins_at(
    rides: ChartBoundaryArcs, k: int, mode: int, z: ca.SX, numbers: ca.SX, free: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX, tuple[ca.SX, ca.SX]]:
    """Return the least condition at a point, the least excess of H of other controls, and H of the flown one.

    On a boundary arc other controls leave it, and are compared by L. Last come symbols for z, with the conditions as
    functions of it, of the control that is flown too; of a phase that settles those on states only.
    """
    problem, extremal = rides.stated, rides.conditions.phases[k]
    phase, n, p = problem.phases[k], extremal.state_count, trace_parameters(problem)
    symbols, limits = limit_symbols(problem, p)
    x, u = ca.SX.sym("x", n), ca.SX.sym("u", len(phase.control_names))
    # On the mode's own side also where it begins: there its rounded place may be on the other side of a jump.
    rates = extremal.rates[mode](x, u, p.given, p.free)
    path, held = (
        column(phase.evaluate(name, elements(x), elements(u), p.record, SYMBOLIC)) for name in ("path", "held")
    )
    room = list[tuple[ca.SX, ca.SX]]()
    for i, state in enumerate(phase.states):
        # A bound that is a number is so in SI, one that a parameter holds in its canonical unit.
        unit, stated = problem.scales.of(state.unit), (state.lower, state.upper)
        share = problem.size_of(state) / unit
        low, high = (
            ca.SX(limit) / (1.0 if isinstance(named, str) else unit)
            for limit, named in zip(state.limits(p.record), stated, strict=True)
        )
        room.append((share * x[i] - low, high - share * x[i]))
    if rides.boundary_arcs[k] or rides.singular(k):  # which may ask for more than there is
        room += [(u[i] - limits[k][c.name][0], limits[k][c.name][1] - u[i]) for i, c in scalars(phase.controls)]
    finite = [ca.SX(e) for pair in room for e in pair if not (ca.SX(e).is_constant() and not np.isfinite(float(e)))]
    conditions = ca.vertcat(ca.SX(0, 1), path, *finite)
    given = numbers[: p.given.numel()]
    plain = numbers[p.given.numel() : p.given.numel() + symbols.numel()]
    known = [p.given, p.free, symbols]
    lam = ca.SX.sym("lam", n)
    value = ca.Function("value", [x, u, lam, *known], [ca.dot(lam, rates), conditions, held])
    control, _, _ = extremal.reports[mode](z, numbers)
    where, costate = z[:n], z[extremal.half : extremal.half + n]
    best, kept, _ = value(where, control, costate, given, free, plain)
    of_limits = ca.Function(
        "limits", known, [ca.vertcat(ca.SX(0, 1), *(e for pair in limits[k].values() for e in pair))]
    )
    eta, always = rides.multipliers(k, mode, z, numbers), rides.held_places(k)
    others = []
    for other in _admissible_controls(phase, control, of_limits(given, free, plain)):
        there, allowed, told = value(where, other, costate, given, free, plain)
        gain = there - best - ca.dot(eta, told)
        if allowed.numel() and ca.depends_on(path, u):
            gain = ca.if_else(ca.mmin(allowed[: path.numel()]) >= 0, gain, FAR)
        if always:
            gain = ca.if_else(ca.norm_inf(told[always]) <= _KEPT, gain, FAR)
        others.append(gain)
    least = ca.mmin(ca.vertcat(*others)) if others else ca.SX(FAR)
    point = ca.SX.sym("z", z.numel())
    if extremal.settles:
        smooth = ca.vertcat(ca.SX(0, 1), *(e for e in ca.vertsplit(conditions) if not ca.depends_on(e, u)))
        inside = ca.substitute(smooth, ca.vertcat(x, *known), ca.vertcat(point[:n], given, free, plain))
    else:
        inside = value(point[:n], extremal.reports[mode](point, numbers)[0], costate, given, free, plain)[1]
    return ca.mmin(kept) if kept.numel() else ca.SX(FAR), least, best, (point, inside)


def _admissible_controls(phase: Phase, control: ca.SX, limits: ca.SX) -> Iterator[ca.SX]:
    """Yield admissible controls all over the set of each phase."""
    choices, at = list[list[ca.SX]](), 0
    for here, kind in control_slices(phase.controls):
        flown = control[here.start : here.stop]
        if isinstance(kind, ScalarControl):
            low, high = limits[2 * at], limits[2 * at + 1]
            at += 1
            if all(isinstance(limit, str) or math.isfinite(limit) for limit in (kind.lower, kind.upper)):
                choices.append([flown, low, 0.5 * (low + high), high])
            else:
                choices.append([flown, *(ca.fmin(ca.fmax(flown + way * _NEAR, low), high) for way in (-1, 1))])
        else:
            choices.append([flown, *(ca.SX(ca.DM(v)) for v in _sampled_directions(len(kind.names)))])
    for number, parts in enumerate(product(*choices)):
        if number:  # the first is the control itself
            yield ca.vertcat(*parts)


@lru_cache(maxsize=4)
def _sampled_directions(components: int) -> tuple[tuple[float, ...], ...]:
    """Return unit vectors all around: eight in the plane, the faces and corners of a cube in space."""
    if components == 2:
        return tuple((float(np.cos(a)), float(np.sin(a))) for a in np.arange(8) * np.pi / 4)
    whole = [v for v in product((-1.0, 0.0, 1.0), repeat=3) if np.count_nonzero(v) in (1, 3)]
    return tuple(tuple((np.array(v) / np.linalg.norm(v)).tolist()) for v in whole)


def kelley_terms(
    stated: Problem, phase: Phase, extremal: PhaseExtremal, mode: int, z: ca.SX, numbers: ca.SX, free: ca.SX
) -> list[ca.SX]:
    """Return -B of each singular control of a phase, over 1 + |B|; below zero for a maximum.

    Parameters
    ----------
    stated, phase
        Problem of the chart, as it is traced, and its phase.
    extremal, mode
        Canonical equations of the phase, and the number of its mode between two switches.
    z
        State and costate, canonical.
    numbers, free
        Numbers of the canonical equations, and free parameters, canonical.
    """
    known, n, found = trace_parameters(stated), extremal.state_count, list[ca.SX]()
    symbol, u, s = ca.SX.sym("z", z.numel()), ca.SX.sym("u", len(phase.control_names)), ca.SX.sym("s")
    x, lam = symbol[:n], symbol[extremal.half : extremal.half + n]
    H = ca.dot(lam, column(phase.rates(elements(x), elements(u), known.record, SYMBOLIC)))
    for at, control in scalars(phase.controls):
        if not isinstance(control, Settled) or control.regime != "singular":
            continue
        beside = ca.SX(extremal.reports[mode](symbol, numbers)[0])
        beside[at] = s
        moving = ca.vertcat(ca.gradient(H, lam), -ca.gradient(H, x))
        slope, rate = (ca.substitute(e, u, beside) for e in (ca.gradient(H, u[at]), moving))
        B = ca.gradient(_rate_along_flow(_rate_along_flow(slope, x, lam, rate), x, lam, rate), s)
        told = ca.Function("B", [symbol, s, numbers, known.given, known.free], [B])
        value = told(z, extremal.reports[mode](z, numbers)[0][at], numbers, numbers[: known.given.numel()], free)
        found.append(-value / (1 + ca.fabs(value)))
    return found


def _rate_along_flow(value: ca.SX, x: ca.SX, lam: ca.SX, rate: ca.SX) -> ca.SX:
    """Return the rate of an expression of state and costate."""
    n = x.numel()
    return ca.dot(ca.gradient(value, x), rate[:n]) + ca.dot(ca.gradient(value, lam), rate[n:])
