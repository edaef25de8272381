"""Linear dispersion of the landing point under disturbed parameters: the table that `Views.dispersion` names.

The control is held: a function of time from the start of each phase, without feedback. Along the flight
small changes d of the state follow the linear equations of motion, in which a disturbed parameter q pushes:

    d' = f_x d + f_q dq,    d(0) of the next phase = l_x d + l_q dq,  l the link

A phase that has end conditions ends where the first of them is met, any other after its own length. With c the
condition, the end of the first comes later by dt, and so does what follows it:

    dt = -(c_x d + c_q dq)/(c_x f),    d at the end = d + f dt

A phase that begins one second later has continued for that second without what acts from its begin on. All
transition matrices from node to node are found at once, by the classical formula of Runge and Kutta, and multiplied.
Source of the event's part: Bryson, Ho, *Applied Optimal Control*, 1975, section 3.7.
"""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import COMPLEX, STEP, Matrix, Vector, complex_step_jacobian, stack_broadcast
from perilune.problem.display.views import Dispersion, Disturbance
from perilune.problem.variables import Variable

_FEWEST = 401  # nodes of a phase
_BLOCK = 2000  # pieces that are computed at once
_PERCENT = 0.01


def dispersion_variables(views: Any) -> tuple[Variable, ...]:
    """Return the two results of each disturbance, as variables."""
    asked: Dispersion | None = views.dispersion
    if asked is None:
        return ()
    return tuple(
        Variable(
            name=f"{way}_track_per_{d.name}", unit="m/s" if d.begins else "m",
            description=f"shift of the landing point {where} for each {d.name.replace('_', ' ')}, with the control"
            f" unchanged",
        )
        for d in asked.disturbances
        for way, where in (("along", "ahead"), ("across", "to the left"))
    )  # fmt: skip


def dispersion(solution: Any) -> tuple[tuple[Variable, ...], list[float]]:
    """Return the requested results of a flight, and their values: metres along the track and to the left of it."""
    variables, problem = dispersion_variables(solution.problem.views), solution.problem
    if not variables:
        return (), []
    with np.errstate(all="ignore"):  # a file may hold values with which nothing can be computed
        moved = _moved_at_the_end(solution, problem.views.dispersion)
        values = _ground_directions(solution, problem.views.dispersion) @ moved
    return variables, [float(v) for v in values.T.ravel()]


def _moved_at_the_end(solution: Any, asked: Dispersion) -> Matrix:
    """Return the changes of the position [m] at the end, shape (3, disturbances)."""
    problem, p = solution.problem, solution.parameters
    disturbed = [_disturbed(p, by) for by in asked.disturbances]
    moved: Any = np.zeros((0, len(disturbed)))
    for k, phase in enumerate(problem.phases):
        before = solution.trajectories[k - 1].state.values[-1] if k else np.zeros(0)
        moved = _push_forward(partial(_phase_begin, problem, k), before, moved, disturbed) + _delay_change(
            solution, k, p, asked
        )
        moved = _propagate_changes(solution, k, moved, disturbed)
        if phase.end_conditions:
            moved = _shift_to_end_condition(solution, k, moved, disturbed)
    states = problem.phases[-1].state_names
    return moved[[states.index(name) for name in asked.position]]


def _phase_begin(problem: Any, k: int, before: Any, p: Any) -> Any:
    """Return the state at which a phase begins, from the end of the one before."""
    if k == 0:
        return problem.start(p, COMPLEX)
    return problem.links[k - 1](problem.phases[k - 1].state_record(*before), p, COMPLEX)


def _shift_to_end_condition(solution: Any, k: int, moved: Matrix, disturbed: list[SimpleNamespace]) -> Matrix:
    """Return the changes where the first end condition of a phase is met, from those at its time."""
    phase, p = solution.problem.phases[k], solution.parameters
    x, u = (row[:, 0] for row in solution.evaluate(k, np.array([solution.trajectories[k].duration])))
    rates = np.array([float(v) for v in phase.rates(x, u, p)])

    def condition(z: Any, q: Any) -> Any:
        return phase.evaluate("end", z, (), q, COMPLEX)[:1]

    return moved - np.outer(rates, _push_forward(condition, x, moved, disturbed)) / _push_forward(
        condition, x, rates[:, None], [p]
    )


def _disturbed(p: Any, by: Disturbance) -> SimpleNamespace:
    """Return the parameters with a complex step towards one percent more."""
    changed = {name: getattr(p, name) * (1 + 1j * STEP * _PERCENT * share) for name, share in by.shares}
    return SimpleNamespace(**{**vars(p), **changed})


def _push_forward(function: Any, x: Vector, moved: Matrix, disturbed: list[SimpleNamespace]) -> Matrix:
    """Return the changes of a function of the state and the parameters, shape (values, disturbances)."""
    found = [function(x + 1j * STEP * column, q) for column, q in zip(moved.T, disturbed, strict=True)]
    return np.array([[float(np.imag(v)) / STEP for v in values] for values in found]).T


def _delay_change(solution: Any, k: int, p: Any, asked: Dispersion) -> Matrix:
    """Return the change of the state for each second by which a phase begins later, (states, disturbances)."""
    phase, t = solution.problem.phases[k], np.zeros(1)
    x, u = solution.evaluate(k, t)
    found = np.zeros((len(x), len(asked.disturbances)))
    for i, by in enumerate(asked.disturbances):
        if by.begins == phase.name:
            before = SimpleNamespace(**{**vars(p), **dict.fromkeys(by.without, 0.0)})
            found[:, i] = [float(v) for v in phase.rates(x[:, 0], u[:, 0], before)]
    return found


def _propagate_changes(solution: Any, k: int, moved: Matrix, disturbed: list[SimpleNamespace]) -> Matrix:
    """Propagate changes `moved` at the begin of a phase to its end."""
    flown = solution.trajectories[k]
    nodes = np.unique(np.concatenate([flown.time, flown.control.time, np.linspace(0.0, flown.duration, _FEWEST)]))
    whole = np.vstack([moved, np.eye(len(disturbed))])
    for first in range(0, len(nodes) - 1, _BLOCK):
        whole = _transition(solution, k, nodes[first : first + _BLOCK + 1], disturbed) @ whole
    return whole[: len(moved)]


def _transition(solution: Any, k: int, nodes: Vector, disturbed: list[SimpleNamespace]) -> Matrix:
    """Return the transition matrix over the nodes, of changes of the state and the disturbances that push them."""
    phase, h, count = solution.problem.phases[k], np.diff(nodes)[:, None, None], len(nodes)
    t = np.concatenate([nodes, 0.5 * (nodes[:-1] + nodes[1:])])
    x, u = solution.evaluate(k, t)
    size = len(x)

    def rates(z: Any, p: Any) -> Any:
        return stack_broadcast(phase.rates(z, u.reshape(len(u), *(1,) * (z.ndim - 2), len(t)), p, COMPLEX), z.shape[1:])

    slopes = np.zeros((len(t), size + len(disturbed), size + len(disturbed)))
    slopes[:, :size, :size] = np.moveaxis(
        complex_step_jacobian(lambda z: rates(z, solution.parameters), x, np.ones(size)), -1, 0
    )
    for i, p in enumerate(disturbed):
        slopes[:, :size, size + i] = np.imag(rates(x + 0j, p)).T / STEP
    left, right, middle = slopes[: count - 1], slopes[1:count], slopes[count:]
    one = np.eye(slopes.shape[1])
    second = middle @ (one + h / 2 * left)
    third = middle @ (one + h / 2 * second)
    fourth = right @ (one + h * third)
    return _ordered_product(one + h / 6 * (left + 2 * second + 2 * third + fourth))


def _ordered_product(matrices: Any) -> Matrix:
    """Multiply all matrices, the last one leftmost, in pairs."""
    while len(matrices) > 1:
        odd = matrices[-1:] if len(matrices) % 2 else matrices[:0]
        matrices = np.concatenate([matrices[1::2] @ matrices[: len(matrices) - len(odd) : 2], odd])
    return matrices[0]


def _ground_directions(solution: Any, asked: Dispersion) -> Matrix:
    """Return unit vectors along the track and to the left of it at the landing point, one in each row.

    The track is the great circle above which the named phase begins.
    """
    problem = solution.problem
    k = [phase.name for phase in problem.phases].index(asked.track)
    above, begin = problem.phases[k].state_names, solution.trajectories[k].state.values[0]
    r, v = (begin[[above.index(name) for name in names]] for names in (asked.position, asked.velocity))
    end, names = solution.trajectories[-1].state.values[-1], problem.phases[-1].state_names
    up = end[[names.index(name) for name in asked.position]]
    along = np.cross(np.cross(r, v), up)
    axes = np.array([along, np.cross(up, along)])
    return axes / np.linalg.norm(axes, axis=1)[:, None]
