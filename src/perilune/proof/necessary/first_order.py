"""Level 2, extremal: the first-order necessary conditions, from the exported curves and the numpy physics.

With H = lam.f (running costs are states) and Phi = phi + nu.psi at each phase's end:

    lam' = -dH/dx,  H constant,  lam(t_f) = dPhi/dx  (or through the link to the next phase's lam(0)),
    dJ/dp = dPhi/dp + lam(0).dx0/dp + sum over links + nu.ds/dp over crossings of kinks (`crossings`)
            + int lam.df/dp dt = 0 for each free p,
    u minimises H at each time.

A path condition in which the control appears has the multiplier that `allowed` finds, and H - mu.c the place of H in
lam' and dJ/dp. Any other, or a bound of a state, that is kept has multiplier 0, but for a bound that holds the end of a
phase, which is made an end condition before (`terminal_bounds`). One that holds the flight back has
a multiplier that no table holds: it shows in lam', or in dH/du, and that check fails.

A duration T is a parameter too, T H being the rate per unit of normalised time: its condition gives H its required
value, which is 0 where nothing but the dynamics depends on T. For the free initial state of Cho et al. the same line is
(19). At an active bound dJ/dp must point outwards, and so must -nu of an end condition on a bound of its range
(Karush-Kuhn-Tucker). Source: Bryson and Ho (1975), sections 2.7, 3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import COMPLEX, STEP, Matrix, Vector
from perilune.problem import Check, FreeParameter, Solution
from perilune.proof.feasible.branch_guards import watched_rates
from perilune.proof.feasible.deviations import MOST_GROWTH, Deviation, costate_deviation
from perilune.proof.feasible.numerics import significant_size
from perilune.proof.feasible.phase_data import (
    PhaseData,
    end_slopes,
    free_size,
    objective_size,
    objective_slope,
    once_for_phase,
    phase_data_of,
    slopes_at_end,
)
from perilune.proof.feasible.sample_points import time_just_before
from perilune.proof.necessary.minimum_principle import HAMILTONIAN_LIMIT, check_minimality, limit_derivatives

# In canonical units. Measured on good answers: costates 1.3e-10, derivatives in parameters 2e-11.
COSTATE_LIMIT = 1e-9
STATIONARY_LIMIT = 1e-9
ACTIVE = 1e-9  # a free parameter or a range this close to its bound, in canonical units, lies on it
INSIDE = 2  # of a range
# A condition is said to be active where it is zero this closely for a while, 2 % of the flight. A direct answer keeps a
# limit at its nodes and may leave it between them: by 30 times its mesh error, measured.
_TOUCHING, _MESH, _WHILE = 1e-6, 50.0, 0.02


def check_extremality(solution: Solution) -> Iterator[Check]:
    """Make all checks of level 2."""
    if any(t.costate is None for t in solution.trajectories):
        yield Check(
            name="costates", level=2, value=float("nan"), limit=0.0, unit="1",
            meaning="the method gave no costates, so that optimality cannot be shown; solve again with Indirect()",
        )  # fmt: skip
        return
    arcs = phase_data_of(solution)
    nu = all_multipliers(arcs)
    deviations = [costate_deviation(arc) for arc in arcs]
    # What follows is known no better than it begins; after the last phase nothing does.
    known = [*(_errors_passed_back(arc, begun) for arc, (_, begun) in zip(arcs, deviations[1:], strict=False)), 0.0]
    for arc, multipliers, (deviation, _), ahead in zip(arcs, nu, deviations, known, strict=True):
        yield from _check_costates(arc, deviation)
        yield _check_transversality(arc, ahead)
        yield from _check_range_signs(arc, multipliers)
        yield _check_hamiltonian(arc)
    yield from _check_multipliers(solution, arcs, nu, known)
    for free in solution.problem.free:
        yield _check_stationarity(arcs[0], free, list(_gradient_parts(arcs, nu, free.name)))
    for arc in arcs:
        if arc.phase.controls:
            yield from check_minimality(arc)


def _errors_passed_back(arc: PhaseData, begun: Vector) -> Vector:
    """Carry errors of the next phase's initial costates, scaled, to the end of this one, (n,)."""
    after = phase_data_of(arc.solution)[arc.index + 1]
    link, record = arc.problem.links[arc.index], arc.phase.state_record
    slopes = slopes_at_end(arc, lambda z: link(record(*z), arc.p, COMPLEX))
    return (begun / after.state_scale) @ np.abs(slopes)


def _check_costates(arc: PhaseData, deviation: Deviation) -> Iterator[Check]:
    active = _name_active_limits(arc)
    for state, value, growth in zip(arc.phase.states, deviation.largest, deviation.growth, strict=True):
        yield Check(
            name=f"{arc.prefix}costate_{state.name}", level=2, value=float(value), unit="1",
            limit=COSTATE_LIMIT * float(growth),
            meaning=f"largest difference between the costate of {state.name} and an independent integration of lam' ="
            f" -dH/dx, inside every interval of the tables (scaled){active}",
        )  # fmt: skip


@once_for_phase
def end_gradients(arc: PhaseData) -> tuple[Matrix, Vector]:
    """d(psi)/dx, shape (q, n), and the part of lam(t_f) without multipliers, shape (n,); scaled."""
    problem, record = arc.problem, arc.phase.state_record
    if arc.index == len(problem.phases) - 1:
        return end_slopes(arc), objective_slope(arc)
    ahead = phase_data_of(arc.solution)[arc.index + 1].costate(np.zeros(1))[:, 0]
    link = problem.links[arc.index]
    return end_slopes(arc), ahead @ slopes_at_end(arc, lambda z: link(record(*z), arc.p, COMPLEX))


@once_for_phase
def phase_end_multipliers(arc: PhaseData) -> tuple[Vector, Vector]:
    """Multipliers nu [J per unit] by least squares, and what of lam(t_f) they leave (scaled).

    That of a range is 0 where its value lies between the bounds.
    """
    psi, ahead = end_gradients(arc)
    wanted = arc.costate(np.array([arc.duration]))[:, 0] * arc.state_scale - ahead
    size, met = arc.end_scale, end_sides(arc) != INSIDE
    nu = np.zeros(len(size))
    if met.any():
        nu[met] = np.linalg.lstsq(psi[met].T / size[met], wanted, rcond=None)[0] / size[met]
    return nu, (wanted - psi.T @ nu) / arc.objective_scale


def _sizes_at_end(arc: PhaseData, known: Vector | float) -> Vector:
    """Sizes of the components of lam(t_f), and of what has to explain them, at least `known`; scaled."""
    lam = arc.costate(np.array([arc.duration]))[:, 0] * arc.state_scale
    sizes = np.maximum(np.abs(lam), np.abs(end_gradients(arc)[1])) / arc.objective_scale
    return np.maximum(1.0, np.maximum(known, sizes))


def _multiplier_sizes(arc: PhaseData, known: Vector | float) -> Vector:
    """Return the error of each multiplier from errors of lam(t_f), each of its size, at least 1; scaled, (q,).

    Conditions that are nearly the same have multipliers that are nearly undetermined: up to `MOST_GROWTH` times.
    """
    psi, size, met = end_slopes(arc), arc.end_scale, end_sides(arc) != INSIDE
    sizes = np.ones(len(size))
    if met.any():
        at_end = _sizes_at_end(arc, known)
        spread = np.abs(np.linalg.pinv(psi[met].T / size[met])) @ at_end
        sizes[met] = np.clip(spread, 1.0, MOST_GROWTH * at_end.max())
    return sizes


def all_multipliers(arcs: Sequence[PhaseData]) -> list[Vector]:
    """Return the multipliers nu [J per unit] of the end conditions of all phases.

    A condition only on parameters, as that durations have a given sum, is in no lam(t_f): its multiplier is what
    makes J stationary in the free parameters, by least squares, as far as there is one.
    """
    nu, size = [phase_end_multipliers(arc)[0].copy() for arc in arcs], objective_size(arcs[0].solution)
    bare = [
        (k, i)
        for k, arc in enumerate(arcs)
        for i in np.nonzero(~end_slopes(arc).any(axis=1) & (end_sides(arc) != INSIDE))[0].tolist()
    ]
    inside = [f for f in arcs[0].problem.free if not any(is_at_bounds(arcs[0].solution, f))]
    if not bare or not inside:
        return nu

    def slopes() -> Vector:
        own = [parameter_gradient(arcs, nu, f.name) * free_size(arcs[0].solution, f) for f in inside]
        return np.array(own) / size

    left, columns = slopes(), list[Vector]()
    for k, i in bare:
        unit = size / arcs[k].end_scale[i]
        nu[k][i] = unit
        columns.append(slopes() - left)
        nu[k][i] = 0.0
    found = np.linalg.lstsq(np.array(columns).T, -left, rcond=None)[0]
    for (k, i), value in zip(bare, found, strict=True):
        nu[k][i] = value * size / arcs[k].end_scale[i]
    return nu


@once_for_phase
def end_sides(arc: PhaseData) -> Vector:
    """Return for each end condition 0 for an equality, -1 or 1 at the lower or upper bound of a range, else INSIDE.

    A range of one value is an equality.
    """
    end = arc.state(np.array([arc.duration]))[:, 0].tolist()
    sides, values = [], arc.phase.evaluate("end", end, (), arc.p)
    for condition, size, value in zip(arc.phase.end_conditions, arc.end_scale, values, strict=True):
        near, (lower, upper) = ACTIVE * size, condition.limits(arc.p)
        low, high = value <= lower + near, value >= upper - near
        sides.append((-1 if low else 1 if high else INSIDE) if condition.ranged and lower < upper else 0)
    return np.array(sides)


def _check_range_signs(arc: PhaseData, nu: Vector) -> Iterator[Check]:
    """Check that J does not fall into the interior of a range: nu <= 0 at its lower bound, >= 0 at its upper one."""
    sizes = arc.end_scale / arc.objective_scale
    for condition, side, value, size in zip(arc.phase.end_conditions, end_sides(arc), nu, sizes, strict=True):
        if condition.ranged:
            wrong = 0.0 if side == INSIDE else float(np.maximum(0.0, -side * value)) * size  # a NaN stays one
            yield Check(
                name=f"{arc.prefix}range_{condition.name}", level=2, unit="1", limit=STATIONARY_LIMIT, value=wrong,
                meaning=f"multiplier of {condition.name} of the wrong sign: the decrease of J if it left its bound"
                f" (scaled); inside the range it vanishes",
            )  # fmt: skip


def _check_transversality(arc: PhaseData, known: Vector | float) -> Check:
    psi, size, met = end_slopes(arc), arc.end_scale, end_sides(arc) != INSIDE
    left = np.eye(psi.shape[1])
    if met.any():  # what no multipliers can explain
        scaled = psi[met].T / size[met]
        left = left - scaled @ np.linalg.pinv(scaled)
    sizes = np.maximum(1.0, np.abs(left) @ _sizes_at_end(arc, known))
    missed = np.abs(phase_end_multipliers(arc)[1])
    lam = arc.costate(np.array([arc.duration]))[:, 0] / arc.costate_scale
    # What the missing part would have to be counts too where lam itself says that a state has no influence.
    many = significant_size(arc.units / arc.state_scale, np.abs(lam) + missed)
    # As often as the missing part counts, so do errors of what follows that it is made of.
    missed, sizes = many * missed, np.maximum(sizes, many * (np.abs(left) @ np.broadcast_to(known, len(lam))))
    return Check(
        name=f"{arc.prefix}transversality", level=2, limit=STATIONARY_LIMIT, unit="1",
        value=float((missed / sizes).max()),
        meaning="part of lam(t_f) - d(phi)/dx that no multipliers of the end conditions explain, relative to its"
        " sensitivity to errors of lam(t_f) (scaled); a state bound reached only there counts as an end condition,"
        " with its sign",
    )  # fmt: skip


def _check_multipliers(
    solution: Solution, arcs: Sequence[PhaseData], found: Sequence[Vector], known: Sequence[Vector | float]
) -> Iterator[Check]:
    differences = []
    for arc, nu, ahead in zip(arcs, found, known, strict=True):
        scaled = arc.end_scale / arc.objective_scale
        sizes = np.maximum(_multiplier_sizes(arc, ahead), np.abs(nu) * scaled) / scaled
        for condition, value, size in zip(arc.phase.end_conditions, nu, sizes, strict=True):
            name = f"{arc.phase.name}.{condition.name}"
            if name in solution.multipliers:
                differences.append(abs(value - solution.multipliers[name]) / size)
    if differences:
        yield Check(
            name="multipliers", level=2, value=float(np.max(differences)), limit=STATIONARY_LIMIT, unit="1",
            meaning="largest difference between an end condition's multiplier and the one implied by lam(t_f),"
            " relative to its sensitivity to errors of lam(t_f) (scaled)",
        )  # fmt: skip


def _check_hamiltonian(arc: PhaseData) -> Check:
    ends, inside = arc.ends, arc.sampled
    values = np.append(
        arc.hamiltonian(arc.state(ends), arc.control(ends), arc.costate(ends)),
        arc.hamiltonian(inside.x, inside.u, inside.lam),
    )
    return Check(
        name=f"{arc.prefix}hamiltonian_constant", level=2, limit=HAMILTONIAN_LIMIT, unit="1",
        value=float(np.abs(values - values.mean()).max()) / arc.rate_scale,
        meaning="largest change of the Hamiltonian along the arc (scaled); it is constant on an extremal",
    )  # fmt: skip


def parameter_gradient(arcs: Sequence[PhaseData], nu: Sequence[Vector], name: str) -> float:
    """dJ/dp at an extremal, p a free parameter: J per unit of p, from costates and multipliers (above).

    Parameters
    ----------
    arcs
        All phases of the solution.
    nu
        Multipliers of the end conditions of each phase [J per unit].
    name
        Of the free parameter.
    """
    return float(sum(float(np.sum(part)) for part in _gradient_parts(arcs, nu, name)))


def _gradient_parts(arcs: Sequence[PhaseData], nu: Sequence[Vector], name: str) -> Iterator[Any]:
    """Yield the terms of dJ/dp, some terms or times at a time."""
    problem, p = arcs[0].problem, arcs[0].p
    unit = problem.scales.of(problem.unit_of(name))
    stepped = SimpleNamespace(**{**vars(p), name: getattr(p, name) + 1j * STEP * unit})

    def slopes(weights: Any, values: Sequence[Any]) -> Any:
        return np.array([float(w * np.imag(v)) for w, v in zip(weights, values, strict=True)]) / (STEP * unit)

    yield slopes(arcs[0].costate(np.zeros(1))[:, 0], problem.start(stepped, COMPLEX))
    for arc, multipliers in zip(arcs, nu, strict=True):
        end = arc.state(np.array([arc.duration]))[:, 0].tolist()
        yield slopes(multipliers, arc.phase.evaluate("end", end, (), stepped, COMPLEX))
        if arc.index < len(problem.links):
            ahead = arcs[arc.index + 1].costate(np.zeros(1))[:, 0]
            yield slopes(ahead, problem.links[arc.index](arc.phase.state_record(*end), stepped, COMPLEX))
        else:
            yield slopes([1.0], [problem.objective(arc.phase.state_record(*end), stepped, COMPLEX)])
        yield [nu * slopes([1.0], [s]) for nu, s in _guard_multipliers(arc, stepped)]
        inside = arc.sampled
        u = inside.u + 1j * STEP * unit * limit_derivatives(arc, inside.u, name)
        f = arc.rates(inside.x, u, stepped)
        yield inside.lam * f.imag * inside.weights / (STEP * unit)
        if arc.allowed:
            mu = arc.allowed.multipliers(inside.x, inside.u, inside.lam).mu
            yield -mu * arc.allowed.values(inside.x, u, stepped).imag * inside.weights / (STEP * unit)
        if arc.phase.duration == name:
            yield (inside.lam * f.real).sum(axis=0) * inside.weights / arc.duration


def _guard_multipliers(arc: PhaseData, p: Any) -> Iterator[tuple[float, Any]]:
    """Return at each crossing nu [J per unit of its guard], and the guard, complex-safe in the parameters p."""
    for crossing in arc.crossings:
        before = np.array([time_just_before(crossing.time)])
        x, u, lam = arc.state(before), arc.control(before), arc.costate(before)[:, 0]
        nu = crossing.multiplier(lam / arc.costate_scale) * arc.objective_scale / crossing.size
        yield nu, watched_rates(arc.phase, x, u, p, crossing.before)[1][crossing.guard][0]


def is_at_bounds(solution: Solution, free: FreeParameter) -> tuple[bool, bool]:
    """Return True for the lower and for the upper bound of a free parameter if its value lies on it.

    Parameters
    ----------
    solution
        Solution with the value of the parameter.
    free
        The free parameter, with its bounds [SI].
    """
    value, near = solution.free[free.name], ACTIVE * free_size(solution, free)
    return abs(value - free.lower) <= near, abs(value - free.upper) <= near


def unbounded_parameters(solution: Solution, arcs: Sequence[PhaseData]) -> list[str]:
    """Free parameters that no bound holds: inside theirs, or on one that they may leave at no first-order cost.

    The second variation takes the latter to both sides, which asks for more than is necessary.

    Parameters
    ----------
    solution
        The solution.
    arcs
        Its phases.
    """
    nu, slack = all_multipliers(arcs), STATIONARY_LIMIT * objective_size(solution)
    return [
        f.name
        for f in solution.problem.free
        if not any(is_at_bounds(solution, f))
        or abs(parameter_gradient(arcs, nu, f.name)) * free_size(solution, f) <= slack
    ]


def _check_stationarity(arc: PhaseData, free: FreeParameter, parts: Sequence[Any]) -> Check:
    solution, problem = arc.solution, arc.problem
    timed, size = free.name in problem.duration_names, free_size(solution, free)
    gradient, most = (float(sum(np.sum(function(part)) for part in parts)) for function in (np.asarray, np.abs))
    more = significant_size(problem.scales.of(free.unit) / size, most * size / arc.objective_scale)
    scaled = gradient / arc.rate_scale if timed else gradient * more * size / arc.objective_scale
    lower, upper = is_at_bounds(solution, free)
    limit, meaning = (
        STATIONARY_LIMIT,
        f"derivative of the optimal objective with respect to {free.name} (scaled)",
    )
    if timed:
        limit = HAMILTONIAN_LIMIT
        meaning += ": deviation of the Hamiltonian from its required value, 0 for a free flight time"
    value = abs(scaled)
    if lower or upper:
        allowed = (lower and scaled > 0) or (upper and scaled < 0)
        value = 0.0 if allowed else abs(scaled)
        meaning += f"; {free.name} is at its bound, so that only a decrease of J on leaving the bound counts"
    return Check(
        name=f"stationary_{free.name}", level=2, value=float(value), limit=limit, unit="1", meaning=meaning,
    )  # fmt: skip


def _name_active_limits(arc: PhaseData) -> str:
    """Name the limits at which the flight stays for a while: a failing costate may owe its difference to them."""
    inside = arc.sampled
    paths = zip(arc.phase.path_conditions, arc.path_scale, arc.path(inside.x, inside.u), strict=True)
    margins = [(f"{condition.name} >= 0", size, value) for condition, size, value in paths]
    loose = []  # where the control lies on one of these its multiplier is known
    if arc.allowed:
        known = dict(zip(arc.allowed.places, arc.allowed.active(inside.x, inside.u), strict=True))
        loose = [(*margins[k][:2], np.where(known[k], np.inf, margins[k][2])) for k in known if k < len(margins)]
        margins = [margin for k, margin in enumerate(margins) if k not in known]
    for state, size, value in zip(arc.phase.states, arc.state_scale, inside.x, strict=True):
        lower, upper = state.limits(arc.p)
        if np.isfinite(lower):
            margins.append((f"{state.name} >= {lower:g}", size, value - lower))
        if np.isfinite(upper):
            margins.append((f"{state.name} <= {upper:g}", size, upper - value))
    near, long = float(np.fmax(_TOUCHING, _MESH * arc.solution.statistics.residual)), _WHILE * arc.duration
    said = ""
    for group, what in (
        (margins, "active, but no table has its multiplier"),
        (loose, "kept too inaccurately for a multiplier"),
    ):
        stays = [text for text, size, margin in group if inside.weights[margin <= near * size].sum() > long]
        if stays:
            said += f"; {' and '.join(stays)} {'is' if len(stays) == 1 else 'are'} {what}"
    return said
