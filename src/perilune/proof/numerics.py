"""Numbers without the solver's tools: complex-step derivatives, the exported control, flights.

The derivative of a real-analytic f is Im f(x + ih)/h, exact to rounding for tiny h (Squire and Trapp 1998),
so the numpy text of the physics is differentiated without a symbolic engine. Everything is computed in SI;
derivatives are taken with respect to *scaled* coordinates (a state divided by its canonical unit), which
makes matrices comparable.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.problem.controls import control_scales, directions, normalised
from perilune.problem.problem import Phase, Problem
from perilune.problem.solution import Curve, Solution, Trajectory
from perilune.words.maths import NUMERIC
from perilune.words.types import Matrix, Vector

STEP = 1e-40  # of the complex step: its square vanishes against 1
DIFFERENCE = 1e-4  # of gradients, in canonical units: truncation 1e-8, rounding 1e-12
ON_BOUND = 1e-7  # a control this close to its bound, in canonical units, lies on it
_TOLERANCE = 1e-12  # of SciPy's integrator, relative and in canonical units
_QUADRATURE = 150  # pieces of three points


def _atan2(y: Any, x: Any) -> Any:
    y, x = np.asarray(y), np.asarray(x)
    turn = (y.imag * x.real - y.real * x.imag) / (x.real**2 + y.real**2)
    return np.arctan2(y.real, x.real) + 1j * turn


def _fabs(x: Any) -> Any:
    return np.where(np.real(x) < 0, -np.asarray(x), x)


# The functions that numpy has for real numbers only, or not as analytic functions, replaced by ones that
# carry the step.
COMPLEX = SimpleNamespace(**{**vars(NUMERIC), "atan2": _atan2, "fabs": _fabs})
COMPLEX.fmin = lambda a, b: np.where(np.real(a) <= np.real(b), a, b)
COMPLEX.fmax = lambda a, b: np.where(np.real(a) >= np.real(b), a, b)


def stacked(values: Sequence[Any], shape: tuple[int, ...], dtype: Any = complex) -> Any:
    """Values of a user's function as one array (len(values), *shape); constants are broadcast."""
    out = np.empty((len(values), *shape), dtype=dtype)
    for i, value in enumerate(values):
        out[i] = value
    return out


def jacobian(function: Callable[[Any], Any], z: Any, scale: Vector) -> Any:
    """First derivatives by complex step with respect to z/scale, at many points at once.

    Parameters
    ----------
    function
        Maps a complex array (d, ...) to (m, ...).
    z
        Points, shape (d, *shape).
    scale
        Size of the coordinates, shape (d,).

    Returns
    -------
    Array (m, d, *shape).
    """
    shape = np.shape(z)[1:]
    steps = (1j * STEP * np.diag(scale)).reshape(len(scale), len(scale), *(1,) * len(shape))
    return np.imag(function(z[:, None] + steps)) / STEP


def hessian(function: Callable[[Any], Any], z: Matrix, scale: Vector) -> Any:
    """Second derivatives of a scalar function: central differences of its complex-step gradient.

    Parameters
    ----------
    function
        Maps a complex array (d, d, 2d, N) to (d, 2d, N); the last axis counts the points.
    z
        Points, shape (d, N).
    scale
        Size of the coordinates, shape (d,).

    Returns
    -------
    Array (d, d, N), symmetric.
    """
    size = len(scale)
    moves = DIFFERENCE * np.hstack([np.diag(scale), -np.diag(scale)])
    gradient = jacobian(lambda w: function(w)[None], z[:, None, :] + moves[:, :, None], scale)[0]
    out = (gradient[:, :size] - gradient[:, size:]) / (2 * DIFFERENCE)
    return 0.5 * (out + out.transpose(1, 0, 2))


def smooth_pieces(curve: Curve) -> list[Curve]:
    """The parts of a table between the times that stand in it twice, with the values of either side."""
    cut = np.nonzero(np.diff(curve.time) == 0)[0] + 1
    parts = (np.split(a, cut) for a in (curve.time, curve.values, curve.rates))
    return [Curve(time=t, values=v, rates=r) for t, v, r in zip(*parts, strict=True)]


def exported_control(phase: Phase, curve: Curve) -> Callable[[float], list[float]]:
    """The control as a piece of its file describes it: cubic Hermite, then a direction normalised.

    Plain floats, as the flight calls it a thousand times for one value each.
    """
    h = np.diff(curve.time)[:, None]
    left, slope, right = curve.values[:-1], curve.rates[:-1] * h, curve.values[1:]
    slope_right = curve.rates[1:] * h
    bend = 3 * (right - left) - 2 * slope - slope_right
    twist = slope + slope_right - 2 * (right - left)
    pieces = np.stack([left, slope, bend, twist], axis=2).tolist()
    nodes, widths = curve.time.tolist(), h.ravel().tolist()
    interior, groups = nodes[1:-1], directions(phase.controls)

    def control_at(t: float) -> list[float]:
        i = bisect_right(interior, t)
        s = (t - nodes[i]) / widths[i]
        u = [a + s * (b + s * (c + s * d)) for a, b, c, d in pieces[i]]
        for first, last in groups:
            length = sum(v * v for v in u[first:last]) ** 0.5 or math.nan  # no direction at all fails every check
            u[first:last] = [v / length for v in u[first:last]]
        return u

    return control_at


def just_before(t: Vector) -> Vector:
    """Times at which a table still has the values from before a break at t."""
    return np.nextafter(t, -np.inf)


def objective_scale(solution: Solution) -> float:
    """Size of J [SI]: its canonical unit; where it has a scale of its own, what it is if that is more."""
    problem = solution.problem
    return problem.objective_size if problem.objective_scale is None else max(
        problem.objective_size, abs(solution.objective)
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Arc:
    """One phase of a solution with what the checks evaluate on it. Arrays are (components, times)."""

    solution: Solution
    index: int

    @property
    def problem(self) -> Problem:
        """What was solved."""
        return self.solution.problem

    @property
    def phase(self) -> Phase:
        """The phase."""
        return self.problem.phases[self.index]

    @property
    def trajectory(self) -> Trajectory:
        """What was exported of it."""
        return self.solution.trajectories[self.index]

    @cached_property
    def p(self) -> Any:
        """All parameters in SI."""
        return self.solution.parameters

    @property
    def duration(self) -> float:
        """Length by its parameter [s]."""
        return float(getattr(self.p, self.phase.duration))

    @property
    def prefix(self) -> str:
        """Of the names of checks, where there are several phases."""
        return f"{self.phase.name}_" if len(self.problem.phases) > 1 else ""

    @cached_property
    def state_scale(self) -> Vector:
        """Sizes of the states [SI]."""
        return self.problem.reached_sizes(self.phase, np.abs(self.trajectory.state.values).max(axis=0))

    @cached_property
    def control_scale(self) -> Vector:
        """Canonical units of the control components [SI]."""
        return control_scales(self.phase.controls, self.problem.scales)

    @property
    def objective_scale(self) -> float:
        """Size of J [SI]."""
        return objective_scale(self.solution)

    @cached_property
    def breaks(self) -> Vector:
        """Times inside the phase at which the table of the control begins anew: switches, joints of a mesh [s]."""
        time = self.trajectory.control.time
        return time[1:][(np.diff(time) == 0) & (time[1:] < self.duration)]

    @cached_property
    def edges(self) -> Vector:
        """0, the breaks and the duration [s]."""
        return np.array([0.0, *self.breaks, self.duration])

    @cached_property
    def jumps(self) -> Matrix:
        """Change of each control component over each break, canonical; what is less than `ON_BOUND` is none."""
        change = self.control(self.breaks) - self.control(just_before(self.breaks))
        change = change / self.control_scale[:, None]
        return np.where(np.abs(change) > ON_BOUND, change, 0.0)

    def times(self, count: int) -> Vector:
        """Times all along [s], and both sides of every break."""
        even = np.linspace(0.0, self.duration, count)
        return np.sort(np.concatenate([even, self.breaks, just_before(self.breaks)]))

    def state(self, t: Vector) -> Matrix:
        """Exported states."""
        return self.trajectory.state.extended(t).T

    def control(self, t: Vector) -> Matrix:
        """Exported control, directions normalised."""
        return normalised(self.phase.controls, self.trajectory.control.extended(t).T)

    def costate(self, t: Vector) -> Matrix:
        """Exported costates [J per state]; NaN where the method gave none."""
        curve = self.trajectory.costate
        return np.full((len(self.phase.states), len(t)), np.nan) if curve is None else curve.extended(t).T

    def rates(self, x: Any, u: Any, p: Any = None) -> Any:
        """Dynamics, complex-safe, (n, ...) for x (n, ...) and u (k, ...)."""
        values = self.phase.rates(x, u, self.p if p is None else p, COMPLEX)
        return stacked(values, np.broadcast_shapes(np.shape(x)[1:], np.shape(u)[1:]))

    def path(self, x: Any, u: Any) -> Matrix:
        """Path conditions, (conditions, ...), for x (n, ...) and u (k, ...)."""
        values = self.phase.evaluate("path", list(x), list(u), self.p)
        return stacked(values, np.broadcast_shapes(np.shape(x)[1:], np.shape(u)[1:]), float)

    @cached_property
    def quadrature(self) -> tuple[Vector, Vector]:
        """Times [s] and weights: three-point Gauss-Legendre between the breaks, off every table's nodes."""
        nodes, weights = np.polynomial.legendre.leggauss(3)
        shares = [max(1, round(_QUADRATURE * (b - a) / self.duration)) for a, b in pairwise(self.edges)]
        pieces = [np.linspace(a, b, n + 1)[1:] for (a, b), n in zip(pairwise(self.edges), shares, strict=True)]
        edges = np.concatenate([[0.0], *pieces])
        half = 0.5 * np.diff(edges)[:, None]
        return ((edges[:-1, None] + half) + half * nodes).ravel(), (half * weights).ravel()

    @cached_property
    def sampled(self) -> tuple[Matrix, Matrix, Matrix]:
        """State, control and costate at the times of `quadrature`."""
        t = self.quadrature[0]
        return self.state(t), self.control(t), self.costate(t)


@dataclass(frozen=True, kw_only=True)
class Flight:
    """One phase flown again: callable states (and costates) and their end values."""

    at: Callable[[Vector], Matrix]
    end: Vector
    completed: bool


def initial_state(solution: Solution, index: int, before: Vector | None) -> Vector:
    """Where the phase starts: by `start`, or by the link from the end state of the phase before."""
    problem, p = solution.problem, solution.parameters
    if before is None:
        values = problem.start(p, NUMERIC)
    else:
        values = problem.links[index - 1](problem.phases[index - 1].state_record(*before), p, NUMERIC)
    return np.array([float(v) for v in values])


def fly(arc: Arc, x0: Vector, lam0: Vector | None = None) -> Flight:
    """Fly a phase by the exported control with SciPy's DOP853; with lam0 the costates too, lam' = -dH/dx.

    The integrator starts anew at each break of the control.

    Parameters
    ----------
    arc
        The phase.
    x0, lam0
        Initial states and costates in SI, shape (n,).

    Returns
    -------
    Flight
        With (n,) or (2n,) components; ends in NaN where the integrator gave up.
    """
    from scipy.integrate import OdeSolution, solve_ivp

    y, scale = x0, arc.state_scale
    if lam0 is not None:
        y, scale = np.concatenate([x0, lam0]), np.concatenate([scale, arc.objective_scale / scale])
    times, parts = [np.zeros(1)], []
    for (left, right), piece in zip(pairwise(arc.edges), smooth_pieces(arc.trajectory.control), strict=False):
        rates = _rates(arc, exported_control(arc.phase, piece), lam0 is not None)
        with np.errstate(all="ignore"):
            flown = solve_ivp(
                rates, (left, right), y, method="DOP853", rtol=_TOLERANCE, atol=_TOLERANCE * scale, dense_output=True
            )
        times.append(flown.t[1:])
        parts += flown.sol.interpolants
        y = flown.y[:, -1] if flown.success else np.full(len(y), np.nan)
        if not flown.success:
            break
    return Flight(at=OdeSolution(np.concatenate(times), parts), end=y, completed=bool(np.isfinite(y).all()))


def _rates(
    arc: Arc, control: Callable[[float], list[float]], with_costates: bool
) -> Callable[[float, Vector], Sequence[Any] | Vector]:
    """Right-hand side in SI."""
    n, phase, p = len(arc.phase.states), arc.phase, arc.p
    steps = 1j * STEP * np.diag(arc.state_scale)
    unscale = -1.0 / (STEP * arc.state_scale)

    def state_rates(t: float, x: Vector) -> Sequence[Any]:
        return phase.rates(x.tolist(), control(t), p)

    def extremal_rates(t: float, y: Vector) -> Vector:
        f = arc.rates(y[:n, None] + steps, control(t))
        return np.concatenate([f.real[:, 0], (y[n:] @ f.imag) * unscale])

    return extremal_rates if with_costates else state_rates
