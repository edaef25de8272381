"""Phase data of a proof: the tables of one phase, their breaks and pieces, and the numpy physics on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property, wraps
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np

from perilune.core import COMPLEX, STEP, Matrix, Vector, complex_step_jacobian, stack_broadcast
from perilune.problem import (
    BEYOND,
    ROUNDS,
    STILL,
    Curve,
    FreeParameter,
    Phase,
    Problem,
    Solution,
    Trajectory,
    Variable,
    control_scales,
    normalised,
    reached_sizes,
    supported_scale,
    supported_unit,
)
from perilune.proof.feasible.mixed_constraints import ON_BOUND, MixedConstraints
from perilune.proof.feasible.piece_refinement import halve_until_settled
from perilune.proof.feasible.sample_points import (
    BLOCK,
    ENDS,
    POINTS,
    WEIGHTS,
    Pieces,
    Sampled,
    Slopes,
    slopes_joined,
    time_just_before,
)
from perilune.proof.feasible.switching_surfaces import GuardCrossing, Guarded

_SAMPLES = 16  # nodes at which conditions are asked how the states round in them
_TRIED = 100  # of the pieces: whether a condition depends on the control


@dataclass(frozen=True, kw_only=True)
class PhaseData:
    """One phase of a solution with what the checks evaluate on it. Arrays are (components, times)."""

    solution: Solution
    index: int

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return self.solution.problem

    @property
    def phase(self) -> Phase:
        """The phase."""
        return self.problem.phases[self.index]

    @property
    def trajectory(self) -> Trajectory:
        """The exported trajectory of the phase."""
        return self.solution.trajectories[self.index]

    @cached_property
    def computed(self) -> dict[Any, Any]:
        """Results of functions of this phase, by function (`once_for_phase`)."""
        return {}

    @cached_property
    def p(self) -> Any:
        """All parameters in SI."""
        return self.solution.parameters

    @property
    def duration(self) -> float:
        """Length of the phase [s], from the parameters."""
        return float(getattr(self.p, self.phase.duration))

    @property
    def prefix(self) -> str:
        """Begins the names of checks in problems of several phases."""
        return f"{self.phase.name}_" if len(self.problem.phases) > 1 else ""

    @cached_property
    def state_scale(self) -> Vector:
        """Sizes of the states [SI]."""
        others = dict[str, float]()
        for phase, flown in zip(self.problem.phases, self.solution.trajectories, strict=True):
            for state, span in zip(phase.states, np.ptp(flown.state.values, axis=0).tolist(), strict=True):
                others[state.unit] = max(others.get(state.unit, 0.0), span)
        return reached_sizes(self.problem.scales, self.phase.states, self.trajectory.state.values.T, others)

    @cached_property
    def units(self) -> Vector:
        """Canonical units of the states [SI]."""
        return np.array([self.problem.scales.of(state.unit) for state in self.phase.states])

    @cached_property
    def end_scale(self) -> Vector:
        """Sizes of the end conditions [SI]."""
        return self._condition_sizes("end", self.phase.end_conditions)

    @cached_property
    def path_scale(self) -> Vector:
        """Sizes of the path conditions [SI]."""
        by_control = self.allowed.of_path if self.allowed else 0.0  # one that is active all along goes through nothing
        return self._condition_sizes("path", self.phase.path_conditions, by_control)

    @cached_property
    def held_scale(self) -> Vector:
        """Sizes of the held conditions [SI]; what they go through are their terms, as together these vanish."""
        t, n = self.trajectory.state.time, len(self.phase.states)
        size = np.concatenate([self.state_scale, self.control_scale])
        slopes = complex_step_jacobian(
            lambda z: stack_broadcast(self.phase.evaluate("held", z[:n], z[n:], self.p, COMPLEX), np.shape(z)[1:]),
            np.concatenate([self.state(t), self.control(t)]), size,
        )  # fmt: skip
        return self._sizes(self.phase.held_conditions, np.abs(slopes).sum(axis=1).max(axis=1))

    def _condition_sizes(self, function: str, conditions: Sequence[Variable], least: Any = 0.0) -> Vector:
        """Return sizes of conditions, their largest value or `least`; at least the rounding of states and parameters.

        Metres over the ground are a difference of radii; durations with a given sum go through nothing. What vanishes
        all along, as what an arc to the end says already, goes through what its states do.
        """
        t = self.trajectory.state.time

        def conditions_at(x: Any, t: Vector, p: Any = self.p) -> Any:
            values = self.phase.evaluate(function, list(x), list(self.control(t)), p, COMPLEX)
            return stack_broadcast(values, x.shape[1:])

        reached = np.maximum(np.abs(conditions_at(self.state(t), t).real).max(axis=1), least)
        some = t[:: 1 + len(t) // _SAMPLES]
        x = self.state(some)
        slopes = complex_step_jacobian(lambda z: conditions_at(z, some), x, np.ones(len(x)))
        terms = np.abs(slopes * x).sum(axis=1)
        by_states = np.median((np.abs(slopes) * self.state_scale[:, None]).sum(axis=1), axis=1)
        reached = np.where(reached <= STILL * by_states, by_states, reached)
        for name, value in self.solution.free.items():
            p = SimpleNamespace(**{**vars(self.p), name: value * (1 + 1j * STEP)})
            terms = terms + np.abs(conditions_at(x, some, p).imag) / STEP
        # The median, as one time at which a slope has no bound says nothing of the others.
        rounding = ROUNDS * np.median(terms, axis=1)
        return np.fmax(self._sizes(conditions, reached), rounding)

    def _sizes(self, conditions: Sequence[Variable], reached: Vector) -> Vector:
        """Canonical units, or scales of their own; no more than what the conditions go through bears out."""
        units = [
            supported_unit(self.problem.scales.of(c.unit), most) for c, most in zip(conditions, reached, strict=True)
        ]
        return np.array([
            unit if c.scale is None else supported_scale(c.scale, unit, float(most))
            for c, unit, most in zip(conditions, units, reached, strict=True)
        ])  # fmt: skip

    @cached_property
    def costate_scale(self) -> Vector:
        """Canonical units of the costates [SI]."""
        return self.objective_scale / self.state_scale

    @cached_property
    def control_scale(self) -> Vector:
        """Sizes of the control components [SI]."""
        units = control_scales(self.phase.controls, self.problem.scales)
        reached = np.abs(self.trajectory.control.values).max(axis=0)
        return np.array(
            [supported_unit(unit, most) for unit, most in zip(units.tolist(), reached.tolist(), strict=True)]
        )

    @property
    def time_scale(self) -> float:
        """Size of a time [s]."""
        return supported_unit(self.problem.scales.time, self.duration)

    @cached_property
    def objective_scale(self) -> float:
        """Size of J [SI]."""
        return objective_size(self.solution)

    @cached_property
    def rate_scale(self) -> float:
        """Size of H [J/s]: J over the time of the whole flight, whatever units it was computed in."""
        return self.objective_scale / self.solution.duration

    @cached_property
    def breaks(self) -> Vector:
        """Return the times inside the phase at which the control's table breaks: switches, joints of a mesh [s]."""
        time = self.trajectory.control.time
        return time[1:][(np.diff(time) == 0) & (time[1:] < self.duration)]

    @cached_property
    def cut(self) -> Pieces:
        """The pieces on which all tables are cubics."""
        return Pieces.between([curve.time for curve in self.curves], self.duration)

    @cached_property
    def crossings(self) -> tuple[GuardCrossing, ...]:
        """Return the crossings of a kink or a jump of the physics."""
        return self._guarded.crossings(self.cut)

    @cached_property
    def _guarded(self) -> Guarded:
        return Guarded(
            phase=self.phase, p=self.p, trajectory=self.trajectory, duration=self.duration, scale=self.state_scale
        )

    def answers(self, t: float) -> Vector:
        """Return on which side of each of its guards the physics is at a time."""
        return self._guarded.answers(t)

    @cached_property
    def ends(self) -> Vector:
        """0 and the duration [s], but for one that lies on a kink of the physics, where rates have no side."""
        return self._guarded.off(np.array([0.0, self.duration]))

    @cached_property
    def crossed(self) -> Vector:
        """Times of the crossings [s]."""
        return np.array([crossing.time for crossing in self.crossings])

    @cached_property
    def edges(self) -> Vector:
        """0, the breaks and crossings, and the duration [s]."""
        return np.array([0.0, *np.union1d(self.breaks, self.crossed), self.duration])

    @cached_property
    def jumps(self) -> Matrix:
        """Change of each control component over each break, canonical; what is less than `ON_BOUND` is none.

        Nor is what jumps where the physics does: it is no switch, whose time is chosen.
        """
        change = self.control(self.breaks) - self.control(time_just_before(self.breaks))
        change = change / self.control_scale[:, None]
        return np.where((np.abs(change) > ON_BOUND) & ~np.isin(self.breaks, self.crossed), change, 0.0)

    @property
    def curves(self) -> list[Curve]:
        """Tables of the phase: state, control, and costate where there is one."""
        flown = self.trajectory
        return [flown.state, flown.control, *([flown.costate] if flown.costate is not None else [])]

    def state(self, t: Vector) -> Matrix:
        """Exported states."""
        return self.trajectory.state.extrapolate(t).T

    def control(self, t: Vector) -> Matrix:
        """Exported control, directions normalised."""
        return normalised(self.phase.controls, self.trajectory.control.extrapolate(t).T)

    def costate(self, t: Vector) -> Matrix:
        """Exported costates [J per state]; NaN where the method gave none."""
        curve = self.trajectory.costate
        return np.full((len(self.phase.states), len(t)), np.nan) if curve is None else curve.extrapolate(t).T

    def rates(self, x: Any, u: Any, p: Any = None) -> Any:
        """Dynamics, complex-safe, (n, ...) for x (n, ...) and u (k, ...).

        Parameters
        ----------
        x, u
            States and controls [SI], complex where derivatives are taken by complex steps.
        p
            Record of all parameters [SI]; None for those of the solution.
        """
        values = self.phase.rates(x, u, self.p if p is None else p, COMPLEX)
        return stack_broadcast(values, np.broadcast_shapes(np.shape(x)[1:], np.shape(u)[1:]))

    def hamiltonian(self, x: Any, u: Any, lam: Any) -> Any:
        """lam.f of real values, (...), for x and lam (n, ...) and u (k, ...).

        Parameters
        ----------
        x, u
            States and controls [SI].
        lam
            Costates [J per SI unit of the state].
        """
        return sum(a * b for a, b in zip(lam, self.phase.rates(x, u, self.p), strict=True))

    def path(self, x: Any, u: Any) -> Matrix:
        """Path conditions, (conditions, ...), for x (n, ...) and u (k, ...).

        Parameters
        ----------
        x, u
            States and controls [SI].
        """
        return self._along("path", x, u)

    def held(self, x: Any, u: Any) -> Matrix:
        """Held conditions, (conditions, ...), for x (n, ...) and u (k, ...).

        Parameters
        ----------
        x, u
            States and controls [SI].
        """
        return self._along("held", x, u)

    def _along(self, function: str, x: Any, u: Any) -> Matrix:
        values = self.phase.evaluate(function, list(x), list(u), self.p)
        return stack_broadcast(values, np.broadcast_shapes(np.shape(x)[1:], np.shape(u)[1:]), float)

    @cached_property
    def allowed(self) -> MixedConstraints | None:
        """The conditions in which the control appears, if there are any."""
        phase, t = self.phase, self.cut.left[:: len(self.cut) // _TRIED + 1]
        if not (phase.path_conditions or phase.held_conditions) or not phase.controls:
            return None
        return MixedConstraints.along(
            phase, self.p, (self.state_scale, self.control_scale), self.state(t), self.control(t)
        )

    def read(self, pieces: Pieces, shares: Vector = POINTS) -> tuple[Matrix, Matrix, Matrix]:
        """State, control (directions normalised) and costate on pieces, (components, N, shares).

        Parameters
        ----------
        pieces
            N intervals between neighbouring nodes.
        shares
            Fractions of each interval, 0 to 1, shape (count,), or (N, count) where they differ.
        """
        # Most checks look at the same times.
        often = "looked_at" in self.__dict__ and pieces is self.looked_at[0] and (shares is POINTS or shares is ENDS)
        key = "at points" if shares is POINTS else "at ends"
        if often and key in self.computed:
            return self.computed[key]
        x, u, *lam = (pieces.read(curve, shares) for curve in self.curves)
        found = x, normalised(self.phase.controls, u), lam[0] if lam else np.full(x.shape, np.nan)
        if often:
            for values in found:
                values.flags.writeable = False
            self.computed[key] = found
        return found

    def slopes(self, pieces: Pieces) -> Slopes:
        """The equations of motion on the tables."""
        count, shape = len(pieces), (len(self.phase.states), len(pieces), len(POINTS))
        x, u, lam = (values.reshape(len(values), np.size(pieces.times())) for values in self.read(pieces))
        n, scale = shape[0], self.state_scale
        # The columns of df/dx and f itself are one evaluation.
        f = self.rates(x[:, None] + (1j * STEP * np.diag(scale))[:, :, None], u)
        matrix = f.imag / STEP / scale[:, None, None]
        known = self.trajectory.costate is not None
        pushed = self.allowed.push(x, u, lam) / self.objective_scale if known and self.allowed else 0.0
        costate = pushed - (lam[:, None] / self.costate_scale[:, None, None] * matrix).sum(axis=0)
        return Slopes(
            state=(f[:, 0].real / scale[:, None]).reshape(shape), costate=costate.reshape(shape)[: n * known],
            matrix=np.moveaxis(matrix.reshape(n, n, count, -1), (2, 3), (0, 1)),
        )  # fmt: skip

    @cached_property
    def looked_at(self) -> tuple[Pieces, Slopes, Vector]:
        """The pieces, cut where the physics has a kink too, and halved until the integrals of all rates settle.

        With the rates there, and what is still open in their integrals: the differences between the pieces and their
        halves, added up, scaled, (rows,).
        """
        pieces = Pieces.between([self.cut.left, self.crossed], self.duration)
        parts = [halve_until_settled(self.slopes, pieces[k : k + BLOCK]) for k in range(0, len(pieces), BLOCK)]
        found = Pieces.joined([piece for part in parts for piece in part[0]])
        slopes = slopes_joined([rates for part in parts for rates in part[1]])
        order = np.argsort(found.left, kind="stable")
        return found[order], slopes[order], np.sum([part[2] for part in parts], axis=0)

    @cached_property
    def sampled(self) -> Sampled:
        """The tables at all `POINTS` of the pieces."""
        pieces = self.looked_at[0]
        x, u, lam = (values.reshape(len(values), np.size(pieces.times())) for values in self.read(pieces))
        return Sampled(t=pieces.times().ravel(), weights=(pieces.width[:, None] * WEIGHTS).ravel(), x=x, u=u, lam=lam)


Value = TypeVar("Value")


def once_for_phase(function: Callable[[PhaseData], Value]) -> Callable[[PhaseData], Value]:
    """Make a function of a phase look up what it returned before; arrays can no longer be changed."""

    @wraps(function)
    def look_up(arc: PhaseData) -> Value:
        if function not in arc.computed:
            found = function(arc)
            for array in found if isinstance(found, tuple) else (found,):
                if isinstance(array, np.ndarray):
                    array.flags.writeable = False
            arc.computed[function] = found
        return arc.computed[function]

    return look_up


_KEPT: ContextVar[dict[int, tuple[PhaseData, ...]] | None] = ContextVar("kept phase data", default=None)


@contextmanager
def keep_phase_data() -> Iterator[None]:
    """Compute what is known of a phase once for all checks inside the block."""
    token = _KEPT.set({})
    try:
        yield
    finally:
        _KEPT.reset(token)


def phase_data_of(solution: Solution) -> tuple[PhaseData, ...]:
    """Return the data of all phases, in a block of `keep_phase_data` the same for the same solution."""
    kept = _KEPT.get()
    if kept is None:
        kept = {}
    if id(solution) not in kept:  # which stays alive with them
        kept[id(solution)] = tuple(PhaseData(solution=solution, index=k) for k in range(len(solution.problem.phases)))
    return kept[id(solution)]


def objective_size(solution: Solution) -> float:
    """Size of J [SI]: what it is, and at least its canonical unit or the scale of its own.

    A constant in it, as of a clock that does not begin at 0, is no size: beyond a thousand canonical units, J counts up
    to a thousand times what the flight changes of it.
    """
    return _objective_size(phase_data_of(solution)[-1])


@once_for_phase
def _objective_size(last: PhaseData) -> float:
    solution, problem = last.solution, last.problem
    reached, changed = abs(solution.objective), _flight_change_of_objective(last)
    unit = problem.scales.of(problem.objective_unit)
    unit = min(unit, supported_unit(unit, max(reached, changed)))
    if reached > BEYOND * max(unit, problem.objective_size):
        reached = supported_scale(reached, BEYOND * unit, changed)
    if problem.objective_scale is None:
        return max(reached, unit)
    return max(reached, supported_scale(problem.objective_scale, unit, reached))


def free_size(solution: Solution, free: FreeParameter) -> float:
    """Size of a free parameter [SI]: its canonical unit, as far as its value and bounds bear it out.

    Parameters
    ----------
    solution
        Solution with the value of the parameter and the canonical units of its problem.
    free
        The free parameter, with its bounds [SI].
    """
    told = [abs(v) for v in (solution.free[free.name], free.lower, free.upper) if np.isfinite(v)]
    return supported_unit(solution.problem.scales.of(free.unit), max(told))


def _flight_change_of_objective(last: PhaseData) -> float:
    """Return how much the flight and the free parameters change J, to first order [SI]."""
    solution, problem, p = last.solution, last.problem, last.p
    spans = np.zeros(len(last.phase.states))
    for phase, flown in zip(problem.phases, solution.trajectories, strict=True):
        of_phase = dict(zip(phase.state_names, np.ptp(flown.state.values, axis=0).tolist(), strict=True))
        spans += np.array([of_phase.get(name, 0.0) for name in last.phase.state_names])
    end = last.phase.state_record(*last.state(np.array([last.duration]))[:, 0].tolist())
    changed = float(np.abs(objective_slope(last) / last.state_scale) @ spans)
    for free in problem.free:
        value = solution.free[free.name]
        stepped = SimpleNamespace(**{**vars(p), free.name: value + 1j * STEP})
        changed += abs(float(np.imag(problem.objective(end, stepped, COMPLEX))) / STEP * value)
    return changed


def slopes_at_end(arc: PhaseData, function: Callable[[Any], Any]) -> Matrix:
    """Derivatives (values, n) of a function of the states at the end of the phase, a change by their sizes.

    Parameters
    ----------
    arc
        Phase with n states.
    function
        Complex-safe function of the states, n values of any shape, that returns a sequence of values [SI].
    """
    return slopes_at(arc, np.array([arc.duration]), function)


def slopes_at(arc: PhaseData, t: Vector, function: Callable[[Any], Any]) -> Matrix:
    """Derivatives (values, n) of a function of the states at one time [s], (1,), a change by their sizes.

    Parameters
    ----------
    arc
        Phase with n states.
    t
        Time from the start of the phase [s], shape (1,).
    function
        Complex-safe function of the states, n values of any shape, that returns a sequence of values [SI].
    """
    x = arc.state(t)
    return complex_step_jacobian(lambda z: stack_broadcast(function(z), z.shape[1:]), x, arc.state_scale)[:, :, 0]


@once_for_phase
def end_slopes(arc: PhaseData) -> Matrix:
    """`slopes_at_end` of the end conditions."""
    return slopes_at_end(arc, lambda z: arc.phase.evaluate("end", z, (), arc.p, COMPLEX))


@once_for_phase
def objective_slope(arc: PhaseData) -> Vector:
    """`slopes_at_end` of J, in the last phase, (n,)."""
    record = arc.phase.state_record
    return slopes_at_end(arc, lambda z: [arc.problem.objective(record(*z), arc.p, COMPLEX)])[0]
