"""Fitness functions of a population search, and guesses for other methods from its individuals.

Both judge a whole population at once, by flying all of it side by side: coarse (a guess needs no more) but
cheap.

*Controls* (for direct methods): genes are the free parameters and each phase's control at a few equidistant
nodes, linear between them. Flown forward by classical Runge-Kutta steps of the user's own functions from the
start, so that the dynamics hold and only J and the missed conditions are left:

    fitness = J + price (|end conditions| + rms of broken path and held conditions and state bounds).

*Costates* (for the indirect method): genes are the free parameters and the direction of all initial costates.
The flight depends on that direction only; the length s of the costates and the multipliers nu enter the
residual h linearly, so they are not searched but solved for:

    fitness = min over s > 0, nu of |h(s lambda(0), free, nu)|.

All in canonical units, in which J, the conditions and their multipliers are of order one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from perilune.conditions import derive, extremal_parameters
from perilune.core import NUMERIC, Matrix, Outcome, Stack, Vector
from perilune.methods.indirect.export_arcs import propagate_in_one_piece
from perilune.methods.indirect.exported_phases import assemble_trajectories
from perilune.methods.indirect.unknowns import free_values, scaled_end_multipliers
from perilune.problem import (
    Curve,
    Phase,
    Problem,
    Solution,
    Trajectory,
    Variable,
    canonical_given,
    control_scales,
    free_scales,
    state_scales,
)
from perilune.shooting import propagate_lanes

STEPS = 40  # of one phase under given controls: far more accurate than what a population resolves
TOLERANCE, MOST_STEPS = 1e-6, 300  # of extremals; one that needs more steps is no good start either
# Above the multipliers of the end conditions, which are of order one: then the penalty is exact, the optimum is
# its minimum (Nocedal, Wright 2006, section 17.2).
PRICE = 10.0


def free_box(problem: Problem) -> tuple[Vector, Vector]:
    """Return bounds of the free parameters, canonical; an open one lies within four times the typical value."""
    scale = free_scales(problem.free, problem)
    typical = [abs(f.guess) for f in problem.free]
    lower = [f.lower if np.isfinite(f.lower) else 0.25 * t if f.guess > 0 else -4 * t
             for f, t in zip(problem.free, typical, strict=True)]  # fmt: skip
    upper = [f.upper if np.isfinite(f.upper) else max(4 * t, 2 * low)
             for f, t, low in zip(problem.free, typical, lower, strict=True)]  # fmt: skip
    for i, f in enumerate(problem.free):
        if f.name in problem.duration_names:  # no phase is infinitely short
            lower[i] = max(lower[i], 0.25 * f.guess)
            upper[i] = min(upper[i], 4 * f.guess)
    return np.array(lower) / scale, np.array(upper) / scale


class ControlFitness:
    """Fitness of controls at nodes, flown forward.

    Parameters
    ----------
    problem
        Any problem.
    nodes
        Control nodes of each phase.

    Attributes
    ----------
    lower, upper
        Bounds of the genes, shape (n,).
    """

    def __init__(self, problem: Problem, nodes: int = 5) -> None:
        self.problem, self.canonical, self.nodes = problem, problem.canonical, nodes
        lower, upper = free_box(problem)
        boxes = [(lower, upper)]
        for phase in problem.phases:
            for control in phase.controls:
                low, high = (v / problem.scales.of(control.unit) for v in control.box(problem.parameters({})))
                boxes.append((np.full(nodes * len(control.names), low), np.full(nodes * len(control.names), high)))
        self.lower, self.upper = (np.concatenate([box[side] for box in boxes]) for side in (0, 1))

    def __call__(self, genes: Matrix) -> Vector:
        """Return the fitness (population,) of individuals (population, n)."""
        with np.errstate(all="ignore"):
            miss = np.zeros(len(genes))
            for phase, p, _, states, controls in self._flights(genes):
                miss += self._miss(phase, p, states, controls)
            last = self.problem.phases[-1]
            cost = self.canonical.objective(last.state_record(*states[-1]), p, NUMERIC)
            return cost + PRICE * miss

    def guess(self, genes: Vector) -> Solution:
        """Return one individual as a `Solution` without costates; it satisfies the dynamics, not the end."""
        problem, found = self.problem, []
        for phase, _, duration, states, controls in self._flights(genes[None, :]):
            time = np.linspace(0.0, 1.0, STEPS + 1) * duration[0] * problem.scales.time
            x = states[:, :, 0] * state_scales(problem, phase)
            u = controls[::2, :, 0] * control_scales(phase.controls, problem.scales)
            curves = (Curve(time=time, values=v, rates=np.gradient(v, time, axis=0)) for v in (x, u))
            found.append(Trajectory(phase=phase.name, state=next(curves), control=next(curves)))
        free = genes[: len(problem.free)] * free_scales(problem.free, problem)
        last = problem.phases[-1]
        values = dict(zip(problem.free_names, free.tolist(), strict=True))
        end = last.state_record(*found[-1].state.values[-1])
        return Solution(
            problem=problem,
            method="genetic",
            outcome=Outcome.NOT_CONVERGED,
            objective=float(problem.objective(end, problem.parameters(values), NUMERIC)),
            free=values,
            trajectories=tuple(found),
        )

    def _flights(self, genes: Matrix) -> Iterator[tuple[Phase, Any, Vector, Stack, Stack]]:
        """Yield each phase, p, duration, states (STEPS + 1, nx, N) and controls (2 STEPS + 1, nu, N)."""
        problem = self.canonical
        given = dict(zip(problem.given, canonical_given(problem), strict=True))
        free = dict(zip(problem.free_names, genes.T, strict=False))
        p = SimpleNamespace(**given, **free)
        at, end = len(problem.free), np.zeros((0, len(genes)))
        for k, phase in enumerate(problem.phases):
            controls, at = self._controls(phase, genes, at)
            start = problem.start(p, NUMERIC) if k == 0 else problem.links[k - 1](
                problem.phases[k - 1].state_record(*end), p, NUMERIC
            )  # fmt: skip
            duration = np.broadcast_to(np.asarray(getattr(p, phase.duration), dtype=float), len(genes))
            states = _integrate_rk4(phase, p, _stack_values(start, len(genes)), controls, duration)
            end = states[-1]
            yield phase, p, duration, states, controls

    def _controls(self, phase: Phase, genes: Matrix, at: int) -> tuple[Stack, int]:
        """Return controls (2 STEPS + 1, nu, N) at the ends and middles of all steps."""
        knots, places = np.linspace(0.0, 1.0, self.nodes), np.linspace(0.0, 1.0, 2 * STEPS + 1)
        hats = np.array([np.interp(places, knots, row) for row in np.eye(self.nodes)]).T
        parts = []
        for control in phase.controls:
            width = len(control.names)
            at_knots = genes[:, at : at + width * self.nodes].reshape(len(genes), self.nodes, width)
            at += width * self.nodes
            part = np.einsum("tk,nkw->wtn", hats, at_knots)
            parts.append(control.normalised(part).transpose(1, 0, 2))
        return np.concatenate([np.zeros((len(places), 0, len(genes))), *parts], axis=1), at

    def _miss(self, phase: Phase, p: Any, states: Stack, controls: Stack) -> Vector:
        """Return how far the conditions of a phase are missed, (N,)."""
        size = states.shape[2]
        end = _stack_values(phase.evaluate("end", list(states[-1]), (), p), size)
        end = _end_misses(self.problem, phase.end_conditions, end)
        broken, along = [], (list(np.moveaxis(states[1:], 0, 1)), list(np.moveaxis(controls[2::2], 0, 1)))
        for name, amiss in (("path", lambda value: np.maximum(-value, 0.0)), ("held", np.abs)):
            for value in phase.evaluate(name, *along, p):
                broken.append(amiss(np.broadcast_to(np.asarray(value, dtype=float), (STEPS, size))))
        scales = state_scales(self.problem, phase)
        for i, (state, scale) in enumerate(zip(phase.states, scales, strict=True)):
            x = states[1:, i]
            lower, upper = self.problem.bounds(state)
            broken.append(np.maximum(np.maximum(lower / scale - x, x - upper / scale), 0.0))
        return np.linalg.norm(end, axis=0) + np.sqrt(np.mean(np.square(broken), axis=1).sum(axis=0))


class CostateFitness:
    """Fitness of initial costates, flown with the minimising control; attributes as `ControlFitness`."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.conditions = problem, derive(problem)
        self.p = extremal_parameters(problem)
        self._mapped: dict[tuple[int, int], Any] = {}
        lower, upper = free_box(problem)
        count = self.conditions.free_at.start
        self.lower = np.concatenate([np.full(count, -1.0), lower])
        self.upper = np.concatenate([np.full(count, 1.0), upper])

    def __call__(self, genes: Matrix) -> Vector:
        """Return the fitness (population,) of individuals (population, n)."""
        return self._solved(genes)[1]

    def guess(self, genes: Vector) -> Solution:
        """Return one individual as a `Solution` with costates; it satisfies the dynamics, not the end conditions."""
        problem, conditions = self.problem, self.conditions
        y = self._solved(genes[None, :])[0][0]
        free = free_values(problem, conditions, y)
        return Solution(
            problem=problem,
            method="genetic",
            outcome=Outcome.NOT_CONVERGED,
            objective=float("nan"),
            free=free,
            trajectories=assemble_trajectories(problem, conditions, y, propagate_in_one_piece(problem, conditions, y)),
            multipliers=scaled_end_multipliers(problem, conditions, y),
            unknowns=y,
        )

    @cached_property
    def _multipliers_at(self) -> slice:
        return slice(self.conditions.free_at.stop, len(self.conditions.unknowns))

    def _solved(self, genes: Matrix) -> tuple[Matrix, Vector]:
        """Return unknowns y (N, ny) with the best length and multipliers, and their residual's norm (N,)."""
        size, c = len(genes), self.conditions
        count, nu = c.free_at.start, self._multipliers_at
        y = np.zeros((size, len(c.unknowns)))
        y[:, :count] = genes[:, :count] / np.linalg.norm(genes[:, :count], axis=1, keepdims=True)
        y[:, c.free_at] = genes[:, count:]
        ends = self._ends(y)
        h, h_y, h_z = (np.array(out) for out in self._over(self._residual, size)(y.T, ends, self._numbers(size)))
        rows = h.shape[0]
        h = h.T
        ends_of = [condition for phase in self.problem.phases for condition in phase.end_conditions]
        h[:, : len(ends_of)] = _end_misses(self.problem, ends_of, h.T).T
        h_y = h_y.reshape(rows, size, -1).transpose(1, 0, 2)
        h_z = h_z.reshape(rows, size, -1).transpose(1, 0, 2)
        multiplied = np.where(self._is_costate, ends.T, 0.0)
        by_length = np.einsum("nrc,nc->nr", h_y[:, :, :count], y[:, :count]) + np.einsum("nrc,nc->nr", h_z, multiplied)
        finite = np.isfinite(h).all(axis=1) & np.isfinite(h_y).all(axis=(1, 2)) & np.isfinite(by_length).all(axis=1)
        offset = np.where(finite[:, None], h - by_length, 0.0)
        columns = np.where(finite[:, None, None], np.concatenate([by_length[:, :, None], h_y[:, :, nu]], axis=2), 0.0)
        best = -np.einsum("ncr,nr->nc", np.linalg.pinv(columns), offset)
        best[best[:, 0] <= 0.0] = 0.0  # costates of the wrong sign maximise: as if there were none
        fitness = np.linalg.norm(offset + np.einsum("nrc,nc->nr", columns, best), axis=1)
        y[:, :count] *= np.where(best[:, :1] > 0.0, best[:, :1], 1.0)
        y[:, nu] = best[:, 1:]
        return y, np.where(finite, fitness, np.inf)

    @cached_property
    def _residual(self) -> ca.Function:
        """(y, ends, p) -> residual, Jacobian by y, Jacobian by the ends."""
        function = self.conditions.residual
        y, ends, p = (ca.SX.sym(f"a{i}", function.size1_in(i)) for i in range(3))
        h = function(y, ends, p)[0]
        return ca.Function("residual", [y, ends, p], ca.cse([h, ca.jacobian(h, y), ca.jacobian(h, ends)]))

    @cached_property
    def _is_costate(self) -> Vector:
        """Return True for those components of the stacked ends that are costates."""
        return np.concatenate([np.repeat([False, True], phase.half) for phase in self.conditions.phases])

    def _ends(self, y: Matrix) -> Matrix:
        """Return the ends of all phases, stacked: (nz, N); NaN where an arc was lost."""
        size, before, ends = len(y), np.zeros((0, len(y))), []
        for extremal, start in zip(self.conditions.phases, self.conditions.starts, strict=True):
            z0, duration = (np.array(out) for out in self._over(start, size)(y.T, before, self._numbers(size)))
            mode = np.array(self._over(extremal.mode, size)(z0, self._numbers(size))).ravel().astype(int)
            settings = {"rtol": TOLERANCE, "atol": TOLERANCE, "max_steps": MOST_STEPS}
            arcs = propagate_lanes(extremal, z0.T, self.p, duration.ravel(), mode, **settings)
            before = np.where(arcs.succeeded, arcs.z.T, np.nan)
            ends.append(before)
        return np.vstack(ends)

    def _over(self, function: Any, size: int) -> Any:
        """Map a CasADi function over the population, once for all."""
        key = (id(function), size)
        if key not in self._mapped:
            self._mapped[key] = function.map(size)
        return self._mapped[key]

    def _numbers(self, size: int) -> Matrix:
        return np.repeat(self.p[:, None], size, axis=1)


def _end_misses(problem: Problem, conditions: Sequence[Variable], values: Matrix) -> Matrix:
    """Return the violation of end conditions by canonical values (n, N): themselves, but for ranges."""
    scales = [problem.size_of(c) for c in conditions]
    p = problem.parameters({})
    missed = [c.missed(v * scale, p) / scale for c, v, scale in zip(conditions, values, scales, strict=False)]
    return np.array(missed).reshape(len(conditions), *np.shape(values)[1:])


def _integrate_rk4(phase: Phase, p: Any, start: Matrix, controls: Stack, duration: Vector) -> Stack:
    """Return the states (STEPS + 1, nx, N) from the start (nx, N), by the classical Runge-Kutta method."""
    size = start.shape[1]
    states, h = np.empty((STEPS + 1, *start.shape)), duration / STEPS
    states[0] = start
    for i in range(STEPS):
        states[i + 1] = _rk4_step(
            lambda x, u: _stack_values(phase.rates(x, u, p), size), states[i], h, controls[2 * i : 2 * i + 3]
        )
    return states


def _rk4_step(rate: Any, x: Matrix, h: Vector, u: Any) -> Matrix:
    """Take one classical Runge-Kutta step; u at its begin, middle and end."""
    k1 = rate(x, u[0])
    k2 = rate(x + 0.5 * h * k1, u[1])
    k3 = rate(x + 0.5 * h * k2, u[1])
    k4 = rate(x + h * k3, u[2])
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _stack_values(values: Any, size: int) -> Matrix:
    """Stack numbers and arrays (N,) as one array (n, N)."""
    if not len(values):
        return np.zeros((0, size))
    return np.array([np.broadcast_to(np.asarray(v, dtype=float), size) for v in values])
