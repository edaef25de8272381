"""Sparse nonlinear program of a direct transcription: its solution, and its messages in SI.

On each segment of width h the state polynomial X (see `perilune.direct.collocation`) is held to the dynamics F,

    D X - (h/2) F(X, U) = 0,    X_end - X_start - (h/2) w.F = 0   (gauss only: Peng et al. 2012, (12), (13)),

with the phase's start and end conditions, unit directions, path and held conditions at the collocation points
and bounds. All in the problem's canonical units, with exact sparse first and second derivatives.

Given values and mesh widths are numbers of the program and not of its functions, so that one program serves every
problem of the same physics on every mesh of the same degrees. What is differentiated is differentiated once for each
traced problem (`perilune.direct.blocks`); another mesh is put together from that (`perilune.direct.assembly`).

Of programs of moderate size a search of our own (`perilune.direct.interior_point`) finds most optima, in about half the
time; what it does not find, the others, and the least misses are for IPOPT.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from threading import Lock
from typing import Any

import casadi as ca
import numpy as np

from perilune.core import Matrix, Vector
from perilune.direct.assembly import Assembled, assemble_program
from perilune.direct.blocks import phase_blocks
from perilune.direct.collocation import Mesh, Scheme
from perilune.direct.interior_point import Optimum, PosedProgram, find_local_optimum
from perilune.direct.ipopt_events import IterationCallback, rewrite_interrupt_messages
from perilune.direct.layout import (
    Layout,
    PhaseValues,
    by_kind,
    determined_states,
    layout_of,
    packed,
    unit_lengths,
    unpacked,
)
from perilune.problem import Phase, Problem, Unnumbered, Variable, canonical_given, free_scales, state_scales

# State values up to which the dense search of our own is quicker than IPOPT, and iterations after which it is given up.
MODERATE, PATIENCE = 160, 50
SUCCESS = "Solve_Succeeded"


@dataclass(frozen=True, kw_only=True)
class ProgramSolution:
    """The result of a solve, in canonical units.

    `free` are the free parameters, `phases` the values, `rows` the multipliers and `residuals` the
    violations, by (phase, kind of condition); `status` is in IPOPT's words.
    """

    status: str
    iterations: int
    objective: float
    free: Vector
    phases: tuple[PhaseValues, ...]
    rows: dict[tuple[int, str], Vector]
    residuals: dict[tuple[int, str], Vector]

    def free_si(self, problem: Problem) -> dict[str, float]:
        """Return the values of the free parameters in SI."""
        values = self.free * free_scales(problem.free, problem)
        return dict(zip(problem.free_names, values.tolist(), strict=True))

    @property
    def violation(self) -> float:
        """Largest violation of any condition."""
        return max((float(r.max()) for r in self.residuals.values() if len(r)), default=0.0)

    @property
    def infeasible(self) -> bool:
        """Return True if the least violation near this start is not zero."""
        return self.status == "Infeasible_Problem_Detected"

    @property
    def converged(self) -> bool:
        """Return True if the optimality conditions of the program hold."""
        return self.status in (SUCCESS, "Solved_To_Acceptable_Level")


# From close by: a barrier that does not push a start away from where it lies, next to bounds that will be active.
_CLOSE = {
    "ipopt.mu_init": 1e-5,
    **{f"ipopt.{push}": 1e-7 for push in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")},
}


@dataclass(frozen=True, kw_only=True)
class TranscribedProgram:
    """A problem's NLP on given meshes. `meshes` are not part of the compiled program except their degrees."""

    problem: Problem
    scheme: Scheme
    meshes: tuple[Mesh, ...]

    @cached_property
    def layouts(self) -> tuple[Layout, ...]:
        """One for each phase."""
        return tuple(
            layout_of(self.scheme, phase, mesh) for phase, mesh in zip(self.problem.phases, self.meshes, strict=True)
        )

    def solve(
        self,
        free: Vector,
        guesses: tuple[PhaseValues, ...],
        *,
        iterations: int,
        tolerance: float,
        nearest: bool = False,
        close: bool = False,
    ) -> ProgramSolution:
        """Solve from a first guess in canonical units, which lies `close` to the answer or anywhere.

        With `nearest` the end and path conditions are not held; what they miss by is minimised instead of J: the sum
        of the squares at the ends, and of the mean square along each path.

        Parameters
        ----------
        free
            Initial values of the free parameters, canonical, in the order of the problem.
        guesses
            Initial states and controls at the nodes, canonical, phase by phase.
        iterations
            Most iterations.
        tolerance
            Tolerance of the optimality conditions, canonical.
        nearest
            True to minimise the violation of path and end conditions in place of J.
        close
            True if the initial values lie close to the answer: bounds that they lie next to are not left.

        Raises
        ------
        KeyboardInterrupt
            If the user stopped it.
        """
        low, high = self._row_bounds()
        lower, upper = self._bounds()
        start = np.concatenate([free, *(packed(g) for g in guesses)])
        misses = sum(layout.path + 2 * layout.end for layout in self.layouts) if nearest else 0
        states, dynamics, segments = determined_states(self.layouts, len(free))
        posed = PosedProgram(
            program=_assemble_blocks(Unnumbered(self.problem), self.layouts, nearest),
            given=canonical_given(self.problem),
            lower=np.append(lower, np.zeros(misses)),
            upper=np.append(upper, np.full(misses, math.inf)),
            low=low,
            high=high,
            states=states,
            dynamics=dynamics,
            segments=segments,
            sizes=_state_magnitudes(guesses),
            lengths=unit_lengths(self.layouts, len(free)),
        )
        first = np.append(np.clip(start, lower, upper), np.full(misses, 0.1))
        found = None
        if len(states) <= MODERATE and not nearest and not close:
            found, status = find_local_optimum(posed, first, min(iterations, PATIENCE), tolerance), SUCCESS
        if found is None:
            key = Unnumbered(self.problem), self.layouts, iterations, tolerance, nearest, close
            found, status = _solver(*key)(posed, first)
        w, missed = np.split(found.w, [len(start)])
        g = found.rows - self._lent(missed) if nearest else found.rows
        violation = np.maximum(low - g, 0.0) + np.maximum(g - high, 0.0)
        return ProgramSolution(
            status=status,
            iterations=found.iterations,
            objective=found.objective,
            free=w[: len(free)],
            phases=unpacked(self.layouts, w[len(free) :]),
            rows=by_kind(self.layouts, found.multipliers),
            residuals=by_kind(self.layouts, violation),
        )

    def _lent(self, missed: Vector) -> Vector:
        """Return what the misses add to the rows."""
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
        """Return the lower and upper bounds of the rows."""
        lower, upper = (np.zeros(sum(sum(layout.rows.values()) for layout in self.layouts)) for _ in range(2))
        end = 0
        for phase, layout in zip(self.problem.phases, self.layouts, strict=True):
            end += sum(layout.rows.values())
            ends = end - layout.end
            upper[ends - layout.path * layout.nodes : ends] = math.inf
            for row, condition in enumerate(phase.end_conditions, ends):
                lower[row], upper[row] = _end_range(self.problem, condition)
        return lower, upper


def _state_magnitudes(guesses: tuple[PhaseValues, ...]) -> Vector:
    """Return for every state value how large that state is along its phase, or 1."""
    found = []
    for values in guesses:
        largest = np.abs(values.state).max(axis=0)
        found.append(np.tile(np.where(largest > 0, largest, 1.0), len(values.state)))
    return np.concatenate(found)


def _end_range(problem: Problem, condition: Variable) -> tuple[float, float]:
    """Return the canonical bounds of an end condition's value."""
    if not condition.ranged:
        return 0.0, 0.0
    scale = problem.size_of(condition)
    lower, upper = condition.limits(problem.parameters({}))
    return lower / scale, upper / scale


def _control_bounds(problem: Problem, phase: Phase, mesh: Mesh, sign: float) -> Matrix:
    """Return lower (sign -1) or upper bounds (nodes, nu); a direction's only keep the search near the sphere."""
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


@dataclass(frozen=True, eq=False)
class _Solver:
    """A compiled program; what it reports of its last run holds as long as one thread at a time uses it."""

    function: ca.Function
    alive: IterationCallback
    lock: Lock

    def __call__(self, posed: PosedProgram, first: Vector) -> tuple[Optimum, str]:
        """Return the point that IPOPT reaches from the first values, and its status.

        Raises
        ------
        KeyboardInterrupt
            If the user stopped it.
        """
        with self.lock, rewrite_interrupt_messages():
            self.alive.begin()
            out = self.function(
                x0=first, p=posed.given, lbx=posed.lower, ubx=posed.upper, lbg=posed.low, ubg=posed.high
            )
            stats, raised = self.function.stats(), self.alive.raised
        if raised is not None:
            raise raised
        status = str(stats["return_status"])
        # Ctrl-C inside a derivative reaches IPOPT as a foreign exception.
        if status in ("User_Requested_Stop", "NonIpopt_Exception_Thrown"):
            raise KeyboardInterrupt
        w, g, multipliers = (np.array(out[key]).ravel() for key in ("x", "g", "lam_g"))
        return Optimum(w, float(out["f"]), g, multipliers, int(stats["iter_count"])), status


@lru_cache(maxsize=64)
def _assemble_blocks(unnumbered: Unnumbered, layouts: tuple[Layout, ...], nearest: bool) -> Assembled:
    return assemble_program(layouts, phase_blocks(unnumbered), len(unnumbered.stated.free), nearest)


@lru_cache(maxsize=64)
def _solver(
    unnumbered: Unnumbered, layouts: tuple[Layout, ...], iterations: int, tolerance: float, nearest: bool, close: bool
) -> _Solver:
    """Compile the program: its cache is what makes the second solve of the same physics cheap."""
    program = _assemble_blocks(unnumbered, layouts, nearest)
    value = program.value
    alive = IterationCallback(value.size1_in("x"), value.size1_out("g"), value.size1_in("p"))
    options = {
        "iteration_callback": alive,
        "print_time": False,
        "error_on_fail": False,
        "show_eval_warnings": False,  # a NaN on the way is the search's to deal with, not C++'s to print
        "no_nlp_grad": True,
        "calc_lam_p": False,
        "grad_f": program.gradient,
        "jac_g": program.jacobian,
        "hess_lag": program.hessian,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": iterations,
        "ipopt.tol": tolerance,
        "ipopt.acceptable_tol": 100 * tolerance,
        "ipopt.constr_viol_tol": tolerance,
        **(_CLOSE if close else {"ipopt.mu_strategy": "adaptive"}),
        "ipopt.honor_original_bounds": "yes",
        "ipopt.bound_relax_factor": 0.0,
    }
    return _Solver(ca.nlpsol("transcription", "ipopt", program.value, options), alive, Lock())
