"""The sparse nonlinear program of a direct transcription: built on CasADi, solved by IPOPT, explained in SI.

On each segment of width h the state polynomial X (see `perilune.direct.collocation`) is held to the dynamics F,

    D X - (h/2) F(X, U) = 0,    X_end - X_start - (h/2) w.F = 0   (gauss only: Peng et al. 2012, (12), (13)),

with the phase's start and end conditions, unit directions, path and held conditions at the collocation points
and bounds. All in the problem's canonical units, with exact sparse first and second derivatives.

Given values are parameters of the program, so that one program serves every problem of the same physics and
mesh.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from perilune.direct.collocation import Mesh, Rule, Scheme, rule
from perilune.problem.controls import directions
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.symbolic import (
    SYMBOLIC,
    Unnumbered,
    canonical_given,
    column,
    elements,
    free_scales,
    state_scales,
    trace_at_end,
    trace_parameters,
    trace_rates,
)
from perilune.problem.variables import Variable
from perilune.words.types import Matrix, Vector


class Layout(NamedTuple):
    """Where one phase's unknowns and rows lie; hashable, it is half of the key of a program."""

    scheme: Scheme
    degrees: tuple[int, ...]
    states: int
    controls: int
    directions: tuple[tuple[int, int], ...]
    held: int
    path: int
    end: int

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The rule of each segment."""
        return tuple(rule(self.scheme, degree) for degree in self.degrees)

    @property
    def nodes(self) -> int:
        """Collocation points."""
        return sum(self.degrees)

    @property
    def starts(self) -> tuple[int, ...]:
        """Index of the state point at which each segment starts, and of the last one."""
        return tuple(int(i) for i in np.cumsum([0, *(r.stride for r in self.rules)]))

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Unknowns: inner joints, state values, control values."""
        return len(self.degrees) - 1, self.states * (self.starts[-1] + 1), self.controls * self.nodes

    @property
    def collocated(self) -> list[int]:
        """State points at which the dynamics are collocated."""
        return [s + r.first + i for s, r in zip(self.starts, self.rules, strict=False) for i in range(r.degree)]

    @property
    def rows(self) -> dict[str, int]:
        """Number of rows of each kind of condition, in their order."""
        gauss = self.states * len(self.degrees) if self.scheme == "gauss" else 0
        return {
            "start": self.states,
            "defect": self.states * self.nodes,
            "quadrature": gauss,
            "direction": len(self.directions) * self.nodes,
            "held": self.held * self.nodes,
            "path": self.path * self.nodes,
            "end": self.end,
        }


@dataclass(frozen=True, kw_only=True)
class PhaseValues:
    """Values of one phase in canonical units: joints (K + 1,), state (points, nx), control (nodes, nu)."""

    joints: Vector
    state: Matrix
    control: Matrix


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What IPOPT returned, in canonical units.

    `free` are the free parameters, `phases` the values, `rows` the multipliers and `residuals` the
    violations, by (phase, kind of condition); `status` is IPOPT's word, for the history only.
    """

    status: str
    iterations: int
    objective: float
    free: Vector
    phases: tuple[PhaseValues, ...]
    rows: dict[tuple[int, str], Vector]
    residuals: dict[tuple[int, str], Vector]

    def free_si(self, problem: Problem) -> dict[str, float]:
        """Values of the free parameters in SI."""
        values = self.free * free_scales(problem.free, problem)
        return dict(zip(problem.free_names, values.tolist(), strict=True))

    @property
    def violation(self) -> float:
        """Largest violation of any condition."""
        return max((float(r.max()) for r in self.residuals.values() if len(r)), default=0.0)

    @property
    def infeasible(self) -> bool:
        """Whether the least violation near this start is not zero."""
        return self.status == "Infeasible_Problem_Detected"

    @property
    def converged(self) -> bool:
        """Whether the optimality conditions of the program hold."""
        return self.status in ("Solve_Succeeded", "Solved_To_Acceptable_Level")


@dataclass(frozen=True, kw_only=True)
class Program:
    """A problem's NLP on given meshes. `meshes` are not part of the compiled program except their degrees."""

    problem: Problem
    scheme: Scheme
    meshes: tuple[Mesh, ...]

    @cached_property
    def layouts(self) -> tuple[Layout, ...]:
        """One for each phase."""
        return tuple(
            _layout(self.scheme, phase, mesh) for phase, mesh in zip(self.problem.phases, self.meshes, strict=True)
        )

    def solve(
        self,
        free: Vector,
        guesses: tuple[PhaseValues, ...],
        *,
        iterations: int,
        tolerance: float,
        nearest: bool = False,
    ) -> Answer:
        """Solve from a first guess in canonical units.

        With `nearest` the end and path conditions are not held; what they miss by is minimised instead of J: the sum
        of the squares at the ends, and of the mean square along each path.

        Raises
        ------
        KeyboardInterrupt
            If the user stopped it.
        """
        solver = _solver(Unnumbered(self.problem), self.layouts, iterations, tolerance, nearest)
        lower, upper = self._bounds()
        first = np.concatenate([free, *(_pack(g) for g in guesses)])
        low_rows, high_rows = self._row_bounds()
        misses = sum(layout.path + 2 * layout.end for layout in self.layouts) if nearest else 0
        out = solver(
            x0=np.append(np.clip(first, lower, upper), np.full(misses, 0.1)),
            lbx=np.append(lower, np.zeros(misses)), ubx=np.append(upper, np.full(misses, math.inf)),
            p=canonical_given(self.problem), lbg=low_rows, ubg=high_rows,
        )  # fmt: skip
        stats = solver.stats()
        # Ctrl-C inside a derivative reaches IPOPT as a foreign exception.
        if stats["return_status"] in ("User_Requested_Stop", "NonIpopt_Exception_Thrown"):
            raise KeyboardInterrupt
        w, g, lam = (np.array(out[key]).ravel() for key in ("x", "g", "lam_g"))
        w, missed = np.split(w, [len(first)])
        g = g - self._lent(missed) if nearest else g
        violation = np.maximum(low_rows - g, 0.0) + np.maximum(g - high_rows, 0.0)
        return Answer(
            status=stats["return_status"],
            iterations=int(stats["iter_count"]),
            objective=float(out["f"]),
            free=w[: len(free)],
            phases=tuple(self._unpack(w)),
            rows=self._split(lam),
            residuals=self._split(violation),
        )

    def _lent(self, missed: Vector) -> Vector:
        """What the misses add to the rows."""
        lent = []
        for layout in self.layouts:
            below, over, missed = np.split(missed, np.cumsum([layout.path + layout.end, layout.end]))
            rows = {"path": np.tile(below[: layout.path], layout.nodes), "end": below[layout.path :] - over}
            lent += [rows.get(kind, np.zeros(size)) for kind, size in layout.rows.items()]
        return np.concatenate(lent)

    def _bounds(self) -> tuple[Vector, Vector]:
        problem, scales = self.problem, free_scales(self.problem.free, self.problem)
        ends: list[list[Any]] = [[], []]
        p = problem.parameters({})
        for side, sign, name in ((0, -1.0, "lower"), (1, 1.0, "upper")):
            ends[side].append(np.array([getattr(f, name) for f in problem.free], dtype=float) / scales)
            for phase, mesh, layout in zip(problem.phases, self.meshes, self.layouts, strict=True):
                ends[side].append(np.array(mesh.joints[1:-1]) + sign * np.array(mesh.free))
                state = np.array([s.limits(p)[side] for s in phase.states], dtype=float) / state_scales(problem, phase)
                ends[side].append(np.tile(state, layout.starts[-1] + 1))
                ends[side].append(_control_bounds(problem, phase, mesh, sign).ravel())
        return np.concatenate(ends[0]), np.concatenate(ends[1])

    def _row_bounds(self) -> tuple[Vector, Vector]:
        """Lower and upper bounds of the rows."""
        lower, upper = [], []
        for phase, layout in zip(self.problem.phases, self.layouts, strict=True):
            ranges = {"path": [(0.0, math.inf)], "end": [_end_range(self.problem, c) for c in phase.end_conditions]}
            for kind, size in layout.rows.items():
                pairs = np.resize(np.array(ranges.get(kind, [(0.0, 0.0)])), (size, 2))
                lower.append(pairs[:, 0])
                upper.append(pairs[:, 1])
        return np.concatenate(lower), np.concatenate(upper)

    def _unpack(self, w: Vector) -> list[PhaseValues]:
        at, found = len(self.problem.free), []
        for layout in self.layouts:
            joints, states, controls = np.split(w[at : at + sum(layout.sizes)], np.cumsum(layout.sizes)[:-1])
            at += sum(layout.sizes)
            found.append(
                PhaseValues(
                    joints=np.concatenate([[0.0], joints, [1.0]]),
                    state=states.reshape(-1, layout.states),
                    control=controls.reshape(layout.nodes, layout.controls),
                )
            )
        return found

    def _split(self, values: Vector) -> dict[tuple[int, str], Vector]:
        at, found = 0, {}
        for k, layout in enumerate(self.layouts):
            for kind, size in layout.rows.items():
                found[k, kind] = values[at : at + size]
                at += size
        return found


def _end_range(problem: Problem, condition: Variable) -> tuple[float, float]:
    """Canonical bounds of an end condition's value."""
    scale = problem.size_of(condition)
    lower, upper = condition.limits(problem.parameters({}))
    return (lower / scale, upper / scale) if condition.ranged else (0.0, 0.0)


def _layout(scheme: Scheme, phase: Phase, mesh: Mesh) -> Layout:
    return Layout(
        scheme, mesh.degrees, len(phase.states), len(phase.control_names), directions(phase.controls),
        len(phase.held_conditions), len(phase.path_conditions), len(phase.end_conditions),
    )  # fmt: skip


def _control_bounds(problem: Problem, phase: Phase, mesh: Mesh, sign: float) -> Matrix:
    """Lower (sign -1) or upper bounds (nodes, nu); a direction's only keep the search near the sphere."""
    p, both = problem.parameters({}), list[tuple[float, float]]()
    for control in phase.controls:
        limits = control.limits(p) if control.scalar else (-1.5, 1.5)
        both += [(limits[0] / problem.scales.of(control.unit), limits[1] / problem.scales.of(control.unit))] * len(
            control.names
        )
    plain = [bounds[int(sign > 0)] for bounds in both]
    rows = []
    for k, degree in enumerate(mesh.degrees):
        pins = mesh.pinned[k] if mesh.pinned else (0,) * len(both)
        row = [bounds[int(pin > 0)] if pin else own for bounds, own, pin in zip(both, plain, pins, strict=True)]
        rows += [row] * degree
    return np.array(rows).reshape(mesh.nodes, len(both))


def _pack(values: PhaseValues) -> Vector:
    return np.concatenate([values.joints[1:-1], values.state.ravel(), values.control.ravel()])


def _traced(problem: Problem) -> tuple[list[tuple[ca.Function, ...]], ca.Function]:
    """Start, rates, held, path, end and duration of each phase in canonical units, and the objective."""
    p = trace_parameters(problem)
    phases: list[tuple[ca.Function, ...]] = []
    arguments = [p.free, p.given]
    x = ca.SX.sym("x", 0)
    for k, phase in enumerate(problem.phases):
        start = problem.start(p.record, SYMBOLIC) if k == 0 else problem.links[k - 1](
            problem.phases[k - 1].state_record(*elements(x)), p.record, SYMBOLIC
        )  # fmt: skip
        before, x = x, ca.SX.sym("x", len(phase.states))
        u = ca.SX.sym("u", len(phase.control_names))
        duration = ca.SX(getattr(p.record, phase.duration))
        held, path = (
            column(phase.evaluate(name, elements(x), elements(u), p.record, SYMBOLIC)) for name in ("held", "path")
        )
        phases.append((
            ca.Function("start", [before, *arguments], [column(start)]),
            ca.Function("rates", [x, u, *arguments], [trace_rates(phase, x, u, p.record)]),
            ca.Function("held", [x, u, *arguments], [held]),
            ca.Function("path", [x, u, *arguments], [path]),
            ca.Function("end", [x, *arguments], [trace_at_end(phase, x, p.record)]),
            ca.Function("duration", arguments, [duration]),
        ))  # fmt: skip
    last = problem.phases[-1].state_record(*elements(x))
    objective = ca.Function("objective", [x, *arguments], [ca.SX(problem.objective(last, p.record, SYMBOLIC))])
    return phases, objective


@lru_cache(maxsize=32)
def _solver(
    unnumbered: Unnumbered, layouts: tuple[Layout, ...], iterations: int, tolerance: float, nearest: bool
) -> ca.Function:
    """The compiled program: its cache is what makes the second solve of the same physics cheap."""
    phases, objective = _traced(unnumbered.problem)
    free = ca.MX.sym("free", objective.numel_in(1))
    given = ca.MX.sym("given", objective.numel_in(2))
    unknowns, rows, misses = [free], [], list[ca.MX]()
    before = ca.MX(0, 1)
    for functions, layout in zip(phases, layouts, strict=True):
        own, conditions, before = _phase(functions, layout, before, free, given)
        unknowns += own
        if nearest:  # a miss of every path condition, the same all along, and two of each end condition
            below, over = ca.MX.sym("below", layout.path + layout.end), ca.MX.sym("over", layout.end)
            at = len(conditions) - (layout.path > 0) - (layout.end > 0)
            if layout.path:
                conditions[at] += ca.repmat(below[: layout.path], layout.nodes, 1)
            if layout.end:
                conditions[-1] += below[layout.path :] - over
            misses += [below, over]
        rows += conditions
    J = ca.sum1(ca.vertcat(*misses)) if nearest else objective(before, free, given)
    program = {
        "x": ca.vertcat(*unknowns, *misses),
        "p": given,
        "f": J,
        "g": ca.vertcat(*rows),
    }
    options = {
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,  # a NaN on the way is the search's to deal with, not C++'s to print
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": iterations,
        "ipopt.tol": tolerance,
        "ipopt.acceptable_tol": 100 * tolerance,
        "ipopt.constr_viol_tol": tolerance,
        "ipopt.mu_strategy": "adaptive",
        "ipopt.honor_original_bounds": "yes",
        "ipopt.bound_relax_factor": 0.0,
    }
    return ca.nlpsol("transcription", "ipopt", program, options)


def _phase(
    functions: tuple[ca.Function, ...], layout: Layout, before: ca.MX, free: ca.MX, given: ca.MX
) -> tuple[list[ca.MX], list[ca.MX], ca.MX]:
    """Unknowns, rows (in the order of `Layout.rows`) and end state of one phase."""
    start, rates, held, path, end, duration = functions
    joints = ca.MX.sym("joints", len(layout.degrees) - 1)
    states = ca.MX.sym("x", layout.states, layout.starts[-1] + 1)
    controls = ca.MX.sym("u", layout.controls, layout.nodes)
    ends = ca.vertcat(0, joints, 1)
    shared = [ca.repmat(free, 1, layout.nodes), ca.repmat(given, 1, layout.nodes)]
    at_nodes = states[:, layout.collocated]
    flow = rates.map(layout.nodes)(at_nodes, controls, *shared)
    defects, quadratures, node = [], [], 0
    for k, (first, r) in enumerate(zip(layout.starts, layout.rules, strict=False)):
        half = 0.5 * duration(free, given) * (ends[k + 1] - ends[k])
        here = flow[:, node : node + r.degree]
        support = states[:, first : first + r.degree + 1]
        defects.append(ca.vec(support @ r.differentiation.T - half * here))
        if layout.scheme == "gauss":
            quadratures.append(states[:, first + r.stride] - states[:, first] - half * (here @ r.weights))
        node += r.degree
    norms = [ca.sum1(controls[a:b, :] ** 2).T - 1 for a, b in layout.directions]
    rows = [states[:, 0] - start(before, free, given), *defects, *quadratures, *norms]
    for along, count in ((held, layout.held), (path, layout.path)):
        if count:
            rows.append(ca.vec(along.map(layout.nodes)(at_nodes, controls, *shared)))
    if layout.end:
        rows.append(end(states[:, -1], free, given))
    return [joints, ca.vec(states), ca.vec(controls)], rows, states[:, -1]
