"""Level 2, extremal: the first-order necessary conditions, from the exported curves and the numpy physics.

With H = lam.f (running costs are states) and Phi = phi + nu.psi at each phase's end:

    lam' = -dH/dx,  H constant,  lam(t_f) = dPhi/dx  (or through the link to the next phase's lam(0)),
    dJ/dp = dPhi/dp + lam(0).dx0/dp + sum over links + int lam.df/dp dt  = 0 for each free p,
    u minimises H at each time.

A duration T is a parameter too, T H being the rate per unit of normalised time: its condition gives H its
required value, which is 0 where nothing but the dynamics depends on T. For the free initial state of Cho et
al. the same line is (19). At an active bound dJ/dp must point outwards (Karush-Kuhn-Tucker). Source: Bryson
and Ho (1975), sections 2.7, 3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.problem import Direction, Free
from perilune.solution import Solution
from perilune.types import Matrix, Vector
from perilune.verification import Check
from perilune.verify.numerics import COMPLEX, STEP, Arc, Flight, jacobian, normalised, stacked

# In canonical units. Measured on good answers: H 7e-11, costates 1.3e-10, derivatives in controls and
# parameters 2e-11.
HAMILTONIAN_LIMIT = 1e-9
COSTATE_LIMIT = 1e-9
STATIONARY_LIMIT = 1e-9
ACTIVE = 1e-9  # a free parameter this close to its bound, in canonical units, lies on it


def extremality(solution: Solution, flown: Sequence[tuple[Arc, Flight]]) -> Iterator[Check]:
    """All checks of level 2.

    Parameters
    ----------
    solution
        What is claimed.
    flown
        Of `feasible.flights`, with costates.
    """
    if any(t.costate is None for t in solution.trajectories):
        yield Check(
            name="costates", level=2, value=float("nan"), limit=0.0, unit="1",
            meaning="the method gave no costates, so optimality cannot be shown; solve again with Indirect()",
        )  # fmt: skip
        return
    arcs = [arc for arc, _ in flown]
    nu = [end_multipliers(arc) for arc in arcs]
    for (arc, flight), (_, residual) in zip(flown, nu, strict=True):
        yield from _costates(arc, flight)
        yield _transversality(arc, residual)
        yield _hamiltonian_constant(arc)
    yield from _multipliers(solution, arcs, [v for v, _ in nu])
    for free in solution.problem.free:
        yield _stationary(solution, free, parameter_gradient(arcs, [v for v, _ in nu], free.name))
    for arc in arcs:
        if arc.phase.controls:
            yield _minimum(arc)
            yield from _switching(arc)


def _costates(arc: Arc, flight: Flight) -> Iterator[Check]:
    n, t = len(arc.phase.states), np.append(arc.quadrature[0], arc.duration)
    error = np.abs(flight.at(t)[n:] - arc.costate(t)).max(axis=1) * arc.state_scale / arc.objective_scale
    for state, value in zip(arc.phase.states, error, strict=True):
        yield Check(
            name=f"{arc.prefix}costate_{state.name}", level=2, unit="1", limit=COSTATE_LIMIT,
            value=float(value) if flight.completed else float("nan"),
            meaning=f"difference between the costate of {state.name} and lam' = -dH/dx flown again (scaled)",
        )  # fmt: skip


def end_gradients(arc: Arc) -> tuple[Matrix, Vector]:
    """d(psi)/dx, shape (q, n), and the part of lam(t_f) without multipliers, shape (n,); scaled."""
    problem, record, x = arc.problem, arc.phase.state_record, arc.state(np.array([arc.duration]))

    def gradient(function: Any) -> Matrix:
        return jacobian(lambda z: stacked(function(z), z.shape[1:]), x, arc.state_scale)[:, :, 0]

    psi = gradient(lambda z: arc.phase.evaluate("end", z, (), arc.p, COMPLEX))
    if arc.index == len(problem.phases) - 1:
        return psi, gradient(lambda z: [problem.objective(record(*z), arc.p, COMPLEX)])[0]
    ahead = Arc(solution=arc.solution, index=arc.index + 1).costate(np.zeros(1))[:, 0]
    return psi, ahead @ gradient(lambda z: problem.links[arc.index](record(*z), arc.p, COMPLEX))


def end_multipliers(arc: Arc) -> tuple[Vector, Vector]:
    """Multipliers nu [J per unit] by least squares, and what of lam(t_f) they leave (scaled)."""
    psi, ahead = end_gradients(arc)
    wanted = arc.costate(np.array([arc.duration]))[:, 0] * arc.state_scale - ahead
    size = np.array([arc.problem.scales.of(v.unit) for v in arc.phase.end_conditions])
    nu = np.linalg.lstsq(psi.T / size, wanted, rcond=None)[0] / size if len(size) else np.zeros(0)
    return nu, (wanted - psi.T @ nu) / arc.objective_scale


def _transversality(arc: Arc, residual: Vector) -> Check:
    return Check(
        name=f"{arc.prefix}transversality", level=2, value=float(np.abs(residual).max()),
        limit=STATIONARY_LIMIT, unit="1",
        meaning="part of lam(t_f) - d(phi)/dx that no multipliers of the end conditions explain (scaled)",
    )  # fmt: skip


def _multipliers(solution: Solution, arcs: Sequence[Arc], found: Sequence[Vector]) -> Iterator[Check]:
    differences = []
    for arc, nu in zip(arcs, found, strict=True):
        for condition, value in zip(arc.phase.end_conditions, nu, strict=True):
            name = f"{arc.phase.name}.{condition.name}"
            if name in solution.multipliers:
                size = arc.problem.scales.of(condition.unit) / arc.objective_scale
                differences.append(abs(value - solution.multipliers[name]) * size)
    if differences:
        yield Check(
            name="multipliers", level=2, value=float(np.max(differences)), limit=STATIONARY_LIMIT, unit="1",
            meaning="largest difference between an end condition's multiplier and the one lam(t_f) implies "
            "(scaled)",
        )  # fmt: skip


def hamiltonian(arc: Arc, t: Vector) -> Vector:
    """H = lam.f at times t from the exported curves [J/s]."""
    return (arc.costate(t) * arc.rates(arc.state(t), arc.control(t)).real).sum(axis=0)


def _hamiltonian_constant(arc: Arc) -> Check:
    values = hamiltonian(arc, np.concatenate([[0.0], arc.quadrature[0], [arc.duration]]))
    return Check(
        name=f"{arc.prefix}hamiltonian_constant", level=2, limit=HAMILTONIAN_LIMIT, unit="1",
        value=float(np.abs(values - values.mean()).max()) * arc.problem.scales.time / arc.objective_scale,
        meaning="largest change of the Hamiltonian along the arc (scaled); it is constant on an extremal",
    )  # fmt: skip


def parameter_gradient(arcs: Sequence[Arc], nu: Sequence[Vector], name: str) -> float:
    """dJ/dp at an extremal, p a free parameter: J per unit of p, from costates and multipliers (above)."""
    problem, p = arcs[0].problem, arcs[0].p
    unit = problem.scales.of(problem.unit_of(name))
    stepped = SimpleNamespace(**{**vars(p), name: getattr(p, name) + 1j * STEP * unit})

    def slope(weights: Any, values: Sequence[Any]) -> float:
        return sum(float(w * np.imag(v)) for w, v in zip(weights, values, strict=True)) / (STEP * unit)

    total = slope(arcs[0].costate(np.zeros(1))[:, 0], problem.start(stepped, COMPLEX))
    for arc, multipliers in zip(arcs, nu, strict=True):
        end = arc.state(np.array([arc.duration]))[:, 0].tolist()
        total += slope(multipliers, arc.phase.evaluate("end", end, (), stepped, COMPLEX))
        if arc.index < len(problem.links):
            ahead = arcs[arc.index + 1].costate(np.zeros(1))[:, 0]
            total += slope(ahead, problem.links[arc.index](arc.phase.state_record(*end), stepped, COMPLEX))
        else:
            total += slope([1.0], [problem.objective(arc.phase.state_record(*end), stepped, COMPLEX)])
        t, weights = arc.quadrature
        lam, f = arc.costate(t), arc.rates(arc.state(t), arc.control(t), stepped)
        total += float(((lam * f.imag).sum(axis=0) * weights).sum()) / (STEP * unit)
        if arc.phase.duration == name:
            total += float(((lam * f.real).sum(axis=0) * weights).sum()) / arc.duration
    return total


def at_bound(solution: Solution, free: Free) -> tuple[bool, bool]:
    """Whether a free parameter lies on its lower and on its upper bound."""
    value, near = solution.free[free.name], ACTIVE * solution.problem.scales.of(free.unit)
    return abs(value - free.lower) <= near, abs(value - free.upper) <= near


def _stationary(solution: Solution, free: Free, gradient: float) -> Check:
    problem = solution.problem
    scaled = gradient * problem.scales.of(free.unit) / problem.scales.of(problem.objective_unit)
    lower, upper = at_bound(solution, free)
    limit, meaning = (
        STATIONARY_LIMIT,
        f"derivative of the optimal objective with respect to {free.name} (scaled)",
    )
    if free.name in problem.duration_names:
        limit = HAMILTONIAN_LIMIT
        meaning += ": how far the Hamiltonian is from its required value, 0 for a free flight time"
    value = abs(scaled)
    if lower or upper:
        allowed = (lower and scaled > 0) or (upper and scaled < 0)
        value = 0.0 if allowed else abs(scaled)
        meaning += f"; {free.name} is at its bound, so only a gain from leaving the bound counts"
    return Check(
        name=f"stationary_{free.name}", level=2, value=float(value), limit=limit, unit="1", meaning=meaning,
    )  # fmt: skip


def _samples(control: Any, u: Matrix, scale: float) -> list[Matrix]:
    """Admissible values of one control, all over its set and close to the exported: (components, N)."""
    close = (-1e-1, -1e-2, -1e-3, -1e-4, 1e-4, 1e-3, 1e-2, 1e-1)
    ones = np.ones((1, u.shape[1]))
    if not isinstance(control, Direction):
        lower, upper = max(control.lower, -10 * scale), min(control.upper, 10 * scale)
        near = [np.clip(u + scale * c, control.lower, control.upper) for c in close]
        return [u, *near, *(v * ones for v in np.linspace(lower, upper, 21))]
    if len(u) == 2:
        turns = [*close, *(2 * np.pi * (k + 0.5) / 90 for k in range(90))]
        return [
            u,
            *(
                np.array([u[0] * np.cos(a) - u[1] * np.sin(a), u[1] * np.cos(a) + u[0] * np.sin(a)])
                for a in turns
            ),
        ]
    index = np.arange(200) + 0.5  # a Fibonacci lattice covers the sphere evenly
    z, longitude = 1 - index / 100, np.pi * (1 + 5**0.5) * index
    lattice = np.array([np.sqrt(1 - z * z) * np.cos(longitude), np.sqrt(1 - z * z) * np.sin(longitude), z])
    near = [u + c * axis[:, None] for c in close for axis in np.eye(3)]
    return [u, *(v / np.sqrt((v * v).sum(axis=0)) for v in near), *(v[:, None] * ones for v in lattice.T)]


def _minimum(arc: Arc) -> Check:
    t = np.linspace(0.0, arc.duration, 65)
    x, u, lam = arc.state(t), arc.control(t), arc.costate(t)
    parts, at = [], 0
    for control in arc.phase.controls:
        width = len(control.names)
        parts.append(_samples(control, u[at : at + width], float(arc.control_scale[at])))
        at += width
    tried = np.stack(
        [np.concatenate(choice) for choice in product(*parts)], axis=1
    )  # (components, samples, times)
    samples = tried.shape[1]
    x_many = np.broadcast_to(x[:, None, :], (len(x), samples, len(t)))
    H = (lam[:, None, :] * arc.rates(x_many, tried).real).sum(axis=0)
    worst = float((H[0] - H.min(axis=0)).max())
    return Check(
        name=f"{arc.prefix}minimum_of_hamiltonian", level=2, limit=HAMILTONIAN_LIMIT, unit="1",
        value=worst * arc.problem.scales.time / arc.objective_scale,
        meaning=f"most that any of {samples} controls at {len(t)} times lowers the Hamiltonian (scaled)",
    )  # fmt: skip


def tangents(arc: Arc, u: Matrix) -> Any:
    """Where the control can move, shape (components, k, N): a sphere's tangents, a scalar's axis."""
    columns, at = [], 0
    for control in arc.phase.controls:
        width = len(control.names)
        part = u[at : at + width]
        if not isinstance(control, Direction):
            found = [np.full((1, u.shape[1]), arc.control_scale[at])]
        elif width == 2:
            found = [np.array([-part[1], part[0]])]
        else:
            axis = np.eye(3)[:, np.argmin(np.abs(part), axis=0)]
            first = np.cross(part, axis, axis=0)
            first = first / np.sqrt((first * first).sum(axis=0))
            found = [first, np.cross(part, first, axis=0)]
        for vectors in found:
            column = np.zeros(u.shape)
            column[at : at + width] = vectors
            columns.append(column)
        at += width
    return np.stack(columns, axis=1)


def control_gradient(arc: Arc, t: Vector) -> Matrix:
    """dH/d(control) along `tangents`, scaled, shape (k, N)."""
    x, u, lam = arc.state(t), arc.control(t), arc.costate(t)
    basis = tangents(arc, u)
    moved = u[:, None, :] + 1j * STEP * basis
    x_many = np.broadcast_to(x[:, None, :], (len(x), *moved.shape[1:]))
    f = arc.rates(x_many, normalised(arc.phase, moved)).imag / STEP
    return (lam[:, None, :] * f).sum(axis=0) * arc.problem.scales.time / arc.objective_scale


def _switching(arc: Arc) -> Iterator[Check]:
    t = np.linspace(0.0, arc.duration, 257)
    gradient, u = control_gradient(arc, t), arc.control(t)
    row, at = 0, 0
    for control in arc.phase.controls:
        width = len(control.names)
        if isinstance(control, Direction):
            value = np.abs(gradient[row : row + width - 1])
            name, row = "stationary_direction_" + "_".join(control.names), row + width - 1
            meaning = "largest derivative of the Hamiltonian as the direction turns (scaled)"
        else:
            near = 1e-7 * arc.control_scale[at]
            slope, lower, upper = gradient[row], u[at] <= control.lower + near, u[at] >= control.upper - near
            value = np.where(lower, -slope, np.where(upper, slope, np.abs(slope)))
            name, row = f"switching_{control.name}", row + 1
            meaning = (
                f"largest derivative of the Hamiltonian in {control.name} of the wrong sign: it must be 0 "
                "between "
                "the bounds, not negative at the lower, not positive at the upper (scaled)"
            )
        at += width
        yield Check(
            name=f"{arc.prefix}{name}", level=2, value=float(max(value.max(), 0.0)), unit="1",
            limit=STATIONARY_LIMIT, meaning=meaning,
        )  # fmt: skip
