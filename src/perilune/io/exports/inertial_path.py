"""Path of a flight in space, at times so close that cubic Hermite interpolation is off by a millimetre at most.

Axes are inertial, those of the body itself at the begin of the flight, or turn with the body (`InertialLeg.turning`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from perilune.core import Matrix, PeriluneError, Vector
from perilune.io.columns import times_around_switches
from perilune.problem import Solution, views

LOST = 1e-3  # m, between two times
JUMP = 1e-6  # s; what changes faster than in so short a time jumps
_HALVED = 12  # times, at most
_NEAR = 1e-3  # of the way to the next time, at which a rate is looked for


@dataclass(frozen=True, kw_only=True)
class InertialLeg:
    """Path of one phase in space.

    Parameters
    ----------
    phase
        Its name.
    time
        From the begin of the flight [s], shape (n,), increasing.
    position, velocity, push, push_rate
        [m], [m/s], thrust acceleration [m/s^2] and its rate [m/s^3], each (3, n).
    lost
        Most that interpolation of position and velocity loses half-way between two times [m].
    """

    phase: str
    time: Vector
    position: Matrix
    velocity: Matrix
    push: Matrix
    push_rate: Matrix
    lost: float

    @property
    def powered(self) -> bool:
        """Return True if there is thrust on it."""
        return bool(np.any(self.push))

    def turned(self, matrix: Matrix) -> InertialLeg:
        """Return the leg in other axes that do not turn."""
        names = ("position", "velocity", "push", "push_rate")
        return replace(self, **{name: matrix @ getattr(self, name) for name in names})

    def turning(self, rate: float) -> InertialLeg:
        """Return the leg in axes that turn about z at a rate [rad/s]; velocities and rates are relative to these."""
        sine, cosine = np.sin(rate * self.time), np.cos(rate * self.time)

        def back(v: Matrix) -> Matrix:
            return np.array([cosine * v[0] + sine * v[1], cosine * v[1] - sine * v[0], v[2]])

        def beside(v: Matrix, its_rate: Matrix) -> Matrix:
            return back(its_rate + rate * np.array([v[1], -v[0], np.zeros_like(v[0])]))

        return replace(
            self, position=back(self.position), velocity=beside(self.position, self.velocity),
            push=back(self.push), push_rate=beside(self.push, self.push_rate),
        )  # fmt: skip


def separate_jumps(time: Vector) -> tuple[Vector, np.ndarray]:
    """Space times by at least `JUMP`: of those about a jump keep the last, and the first moved that much before it.

    Returns
    -------
    tuple
        All times with those before a jump moved, and the numbers of the ones that are kept.
    """
    # To the next; twice as far as one is moved, which so keeps behind those before it.
    near = np.append(np.diff(time) < 2 * JUMP, False)
    lasts = np.flatnonzero(~near)
    last = time[lasts[np.searchsorted(lasts, np.arange(len(time)))]]
    told = np.where(near, np.maximum(np.minimum(time, last - JUMP), time[0]), time)
    return told, (np.append(True, ~near[:-1]) & (told < last)) | ~near


def space_of(solution: Solution, form: str) -> views.Space:
    """Return the body and axes in space of a flight, for a format that has no other places.

    Parameters
    ----------
    solution
        Solution, whose problem may state a body and axes.
    form
        Name of the format in messages.

    Raises
    ------
    PeriluneError
        If the problem does not say it.
    """
    problem = solution.problem
    unseen = [phase.name for phase in problem.phases if phase.inertial is None]
    if problem.views.space is None or unseen:
        what = f"its phase {unseen[0]} states no inertial view" if unseen else "it states no celestial body"
        raise PeriluneError(
            f"{form} needs a position in space, and {problem.name} has none", got=what,
            expected="Phase(inertial=...) of every phase, and Views(space=Space(...)); flat ground has no position in"
            " space",
            advice="csv, parquet and netcdf need neither",
        )  # fmt: skip
    return problem.views.space


def legs(solution: Solution, bent: float | None = None, tick: float | None = None) -> list[InertialLeg]:
    """Return the phases in inertial axes; a phase of zero duration has none.

    Parameters
    ----------
    solution
        The flight.
    bent
        Most that linear interpolation of the thrust loses between two times, as a share of it: an angle [rad]. Then a
        switch, at which the thrust jumps, is seen from both its sides, which are times next to each other. None where
        the thrust does not matter.
    tick
        Times are whole multiples of this [s], and states are those of these times: at the ends of a phase, up to half
        of it beyond them. A phase that has only one such time is left out. None for times as they are.

    Raises
    ------
    PeriluneError
        If the flight has no length, or a place that is no number.
    """
    found, begin = [], 0.0
    for k, trajectory in enumerate(solution.trajectories):
        if trajectory.duration > 0:
            leg = _leg(solution, k, begin, bent)
            leg = leg if tick is None else _at_whole_ticks(leg, solution, k, begin, tick)
            found += [leg] if len(leg.time) > 1 else []
        begin += trajectory.duration
    if not found or not all(np.isfinite([leg.position, leg.velocity, leg.push]).all() for leg in found):
        raise PeriluneError(
            "this flight cannot be placed in space", got="numbers that are not finite, or no duration",
            expected="a solution of `perilune.solve`",
        )  # fmt: skip
    return found


def _leg(solution: Solution, k: int, begin: float, bent: float | None) -> InertialLeg:
    trajectory = solution.trajectories[k]
    t = np.unique(trajectory.time) if bent is None else np.union1d(trajectory.time, times_around_switches(trajectory))
    for left in reversed(range(_HALVED)):
        r, v, push = solution.inertial(k, t)
        middle, width = 0.5 * (t[1:] + t[:-1]), np.diff(t)
        between = 0.5 * (r[:, 1:] + r[:, :-1]) - 0.125 * width * np.diff(v, axis=1)
        lost = np.linalg.norm(between - solution.inertial(k, middle)[0], axis=0)
        bad = lost > LOST
        if bent is not None:
            bad |= (width > JUMP) & (_thrust_interpolation_error(solution, k, t, push) > bent)
        if not bad.any() or not left:  # of what is no flight, as a guess, nothing is fine enough
            break
        t = np.union1d(t, middle[bad])
    return InertialLeg(
        phase=solution.problem.phases[k].name, time=begin + t, position=r, velocity=v, push=push,
        push_rate=_thrust_rates(solution, k, t, push), lost=float(lost.max()),
    )  # fmt: skip


def _at_whole_ticks(leg: InertialLeg, solution: Solution, k: int, begin: float, tick: float) -> InertialLeg:
    """Return the leg at whole multiples of a tick, with the rate of thrust of the time before."""
    wholes, first = np.unique(np.round(leg.time / tick), return_index=True)
    duration = solution.trajectories[k].duration
    inside = np.clip(wholes * tick - begin, 0.0, duration)
    beyond = wholes * tick - begin - inside
    r, v, push = solution.inertial(k, inside)
    step = min(_NEAR, 0.5 * duration) * np.where(inside < 0.5 * duration, 1.0, -1.0)  # within the shortest phase too
    pull = (solution.inertial(k, inside + step)[1] - v) / step
    return replace(
        leg, time=wholes * tick, position=r + beyond * v, velocity=v + beyond * pull, push=push,
        push_rate=leg.push_rate[:, first],
    )  # fmt: skip


def _thrust_rates(solution: Solution, k: int, t: Vector, push: Matrix) -> Matrix:
    """Return the rates of thrust, by a difference ahead, or back from a time at which thrust jumps."""
    width = np.append(np.diff(t), 0.0)
    step = _NEAR * np.where(width > JUMP, width, -np.roll(width, 1))
    moved, step = solution.inertial(k, t + step)[2] - push, (t + step) - t
    return np.divide(moved, step, out=np.zeros_like(push), where=np.abs(step) > _NEAR * JUMP)


def _thrust_interpolation_error(solution: Solution, k: int, t: Vector, push: Matrix) -> Vector:
    """Return the relative error of linear interpolation of thrust between times, at two places, shape (n - 1,).

    A cubic with an error somewhere has one at one of these places, but not always in the middle.
    """
    found = np.zeros(len(t) - 1)
    for part in (0.25, 0.75):
        real = solution.inertial(k, t[:-1] + part * np.diff(t))[2]
        off, size = push[:, :-1] + part * np.diff(push, axis=1) - real, np.linalg.norm(real, axis=0)
        found = np.maximum(found, np.divide(np.linalg.norm(off, axis=0), size, out=np.zeros_like(size), where=size > 0))
    return found
