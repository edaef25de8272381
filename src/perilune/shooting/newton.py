"""Newton's method for a batch of systems, one in each lane: Cho et al. 2015 (23), (24), with alpha chosen.

The step is dy = -J^-1 h. Damping alpha is accepted when the *simplified* correction |J^-1 h(y + alpha dy)| shrinks
(natural monotonicity). That test does not change when rows of h are scaled, so metres and radians may stand side by
side. Damping and outcome belong to the lane; a lane that has ended drops out.

Early iterates are computed with a tolerance fitted to their residual (an inexact Newton method); none counts as
converged (`_accepted_and_converged`) before it is computed at the full one. Where damping does not help a step that
came of a rough evaluation, the iterate is computed again, and that lane accurately from then on. Where no step improves
a residual that is round-off, that is a root.

Source: Deuflhard, *Newton Methods for Nonlinear Problems*, Springer 2011, sections 2.1 (inexact) and 3.3 (natural
monotonicity).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from perilune.core import Iteration, Matrix, Vector, Watch, ignore_events

Lanes = NDArray[np.int64]

TOLERANCE = 1e-11  # on the largest component of the residual of a root
FINEST = 1e-12  # accuracy of the function at which an iterate may count as a root
ROUGHEST = 1e-6  # accuracy of the first evaluations
#: The largest residual that is the function's own error: arcs are flown with a local error of `FINEST`.
ROUND_OFF = 1e-12
SETTLED = 1e-7  # a last undamped step below this, relative to |y|: its square is round-off
LAST_DIGITS = 1e-12  # a step below this, relative to |y|, moves it by its round-off
AMPLIFIED = 100.0  # how far beyond the tolerance a residual may be amplified round-off
_FEW = 0.1  # damping below which enough steps of amplified round-off were tried
_NOISE = 100.0  # residuals below this multiple of the accuracy say nothing
_FORCING = 1e-3  # accuracy of the next evaluation, in units of the residual squared
_LEAST_DAMPING = 1e-4
_ASTRAY = 1e100  # a step beyond this is of a lost iterate; a NaN compares as lost too


@dataclass(frozen=True, kw_only=True)
class Columns:
    """The places of the results of an evaluation in its row.

    First four numbers: max|h|, |J_old^-1 h| (the simplified correction), |J^-1 h|, |y|; then h, the step -J^-1 h, J^-1
    row by row, and `extra` numbers that Newton only carries along.
    """

    n: int
    extra: int = 0

    @cached_property
    def residual(self) -> slice:
        """Return the slice of the n entries of h."""
        return slice(4, 4 + self.n)

    @cached_property
    def step(self) -> slice:
        """The n entries of -J^-1 h."""
        return slice(4 + self.n, 4 + 2 * self.n)

    @cached_property
    def inverse(self) -> slice:
        """The n^2 entries of J^-1."""
        return slice(4 + 2 * self.n, 4 + 2 * self.n + self.n**2)

    @cached_property
    def extras(self) -> slice:
        """Return the slice of the numbers that Newton only carries along."""
        return slice(4 + 2 * self.n + self.n**2, self.width)

    @property
    def width(self) -> int:
        """Length of a row."""
        return 4 + 2 * self.n + self.n**2 + self.extra


#: (lanes, y (lanes, n), accuracy (lanes,), J_old^-1 (lanes, n^2)) -> rows (lanes, width); NaN where undefined.
Evaluate = Callable[[Lanes, Matrix, Vector, Matrix], Matrix]


def evaluation_rows(y: Matrix, h: Matrix, J: NDArray[np.float64], old: Matrix, extra: Matrix) -> Matrix:
    """Return rows of an evaluation from residual (lanes, n), Jacobian (lanes, n, n) and inverse before, by LAPACK.

    Parameters
    ----------
    y
        Unknowns, (lanes, n).
    h
        Residuals, (lanes, n).
    J
        Jacobians dh/dy, (lanes, n, n).
    old
        Inverses of the evaluations before, row by row, (lanes, n^2).
    extra
        Numbers that Newton's method only carries along, (lanes, k).

    Returns
    -------
    Matrix
        Rows as `Columns` names them, (lanes, width).
    """
    lanes, n = h.shape
    try:
        inverse = np.linalg.inv(J)
    except np.linalg.LinAlgError:  # a single singular matrix stops all
        inverse = np.array([_inverse_or_nan(matrix) for matrix in J])
    with np.errstate(all="ignore"):  # a diverged lane is known by its NaN
        step = -(inverse @ h[:, :, None])[:, :, 0]
        simplified = (old.reshape(lanes, n, n) @ h[:, :, None])[:, :, 0]
        lengths = [np.sqrt((v * v).sum(axis=1)) for v in (simplified, step, y)]
    head = np.column_stack([np.abs(h).max(axis=1), *lengths])
    return np.hstack([head, h, step, inverse.reshape(lanes, n * n), extra])


def _inverse_or_nan(matrix: Matrix) -> Matrix:
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)


@dataclass(kw_only=True)
class Ends:
    """The ends of the lanes.

    Attributes
    ----------
    y, rows
        The last iterate that was accepted and its evaluation, (lanes, n) and (lanes, width).
    converged
        Which of them are roots, (lanes,).
    evaluations, iterations
        How often each lane was evaluated, and how many steps of it were accepted, (lanes,).
    history
        The iterations, where there is one lane only.
    """

    y: Matrix
    rows: Matrix
    converged: NDArray[np.bool_]
    evaluations: NDArray[np.int64]
    iterations: NDArray[np.int64]
    history: tuple[Iteration, ...] = ()

    def keep(
        self, lanes: Lanes, y: Matrix, rows: Matrix, root: NDArray[np.bool_], which: NDArray[np.bool_], number: int
    ) -> None:
        """Note the ends of the lanes at work that end at evaluation `number`.

        Parameters
        ----------
        lanes
            Indices of the lanes at work, shape (m,).
        y, rows
            Their iterates and evaluations, shape (m, n) and (m, width).
        root, which
            True for the lanes that are roots, and for those that end now, shape (m,).
        number
            Evaluations made so far in each of them.
        """
        if len(lanes) == len(self.y) and which.all():
            self.y, self.rows, self.converged = y, rows, root
            self.evaluations[:] = number
        else:
            at = lanes[which]
            self.y[at], self.rows[at], self.converged[at] = y[which], rows[which], root[which]
            self.evaluations[at] = number


def newton(
    evaluate: Evaluate,
    start: Matrix,
    columns: Columns,
    *,
    tolerance: float = TOLERANCE,
    accuracy: float = ROUGHEST,
    limit: int = 100,
    max_step: float = np.inf,
    doubt: float = 0.25,
    reach: Vector | None = None,
    watch: Watch | None = None,
) -> Ends:
    """Find a root in each lane.

    Parameters
    ----------
    evaluate
        The function.
    start
        First guesses, (lanes, n).
    columns
        Where the results of `evaluate` lie.
    tolerance
        On the largest component of the residual.
    accuracy
        Of the first evaluation: `ROUGHEST` for a guess, `FINEST` for what may be a root already.
    limit
        Most evaluations of a lane.
    max_step
        Largest component of one step; keeps a far start from leaving where the function is defined.
    doubt
        Damping below which a rough evaluation is blamed, and repeated; 0 for starts that are cheaper given up.
    reach
        How far from its start each lane may be led, (lanes,): one whose next step goes beyond, and farther than the
        last, is given up. The first step of a poor guess goes far, and those that are damped less and less far.
    watch
        Called after each iteration of a single lane; with a line of text after each round of many.
    """
    run = _newton_one_lane if len(start) == 1 else _newton_many_lanes
    settings = _NewtonSettings(tolerance, accuracy, limit, max_step, doubt, reach)
    return run(evaluate, start, columns, settings, None if watch is ignore_events else watch)


class _NewtonSettings(NamedTuple):
    tolerance: float
    accuracy: float
    limit: int
    max_step: float
    doubt: float
    reach: Vector | None

    def stay_near(
        self, trial: Matrix, start: Matrix, lanes: Lanes, before: Vector
    ) -> tuple[NDArray[np.bool_] | bool, Vector]:
        """Return which of some lanes stay near their starts, and how far they are; `before` by the last step."""
        if self.reach is None:
            return True, before
        away = trial - start[lanes]
        length = np.sqrt((away * away).sum(axis=1))
        return length <= np.maximum(self.reach[lanes], before), length


def _newton_many_lanes(
    evaluate: Evaluate, start: Matrix, columns: Columns, settings: _NewtonSettings, watch: Watch | None
) -> Ends:
    """Solve lanes side by side; those that have ended drop out."""
    tolerance, accuracy, limit, max_step, doubt, _ = settings
    y = np.array(start, dtype=float)
    count = len(y)
    lanes, flown = np.arange(count), np.full(count, accuracy)
    row = evaluate(lanes, y, flown, np.zeros((count, columns.n**2)))
    ends = Ends(
        y=y.copy(),
        rows=row.copy(),
        converged=np.zeros(count, dtype=bool),
        evaluations=np.ones(count, dtype=np.int64),
        iterations=np.zeros(count, dtype=np.int64),
    )
    alpha, again = _limit_damping(np.ones(count), row, columns, max_step), np.zeros(count, dtype=bool)
    coarsest = np.full(count, ROUGHEST)
    trial = y + alpha[:, None] * row[:, columns.step]
    led, away = settings.stay_near(trial, start, lanes, np.full(count, np.inf))
    active = (row[:, 2] < _ASTRAY) & led
    for number in range(2, limit + 1):
        if not active.all():
            lanes, y, row, trial, away = lanes[active], y[active], row[active], trial[active], away[active]
            alpha, flown, again, coarsest = alpha[active], flown[active], again[active], coarsest[active]
            if not len(lanes):
                break
        coarsest = np.where(again, FINEST, coarsest)  # a lane misled once is evaluated accurately from then on
        finer = np.clip(_FORCING * (row[:, 0] * row[:, 0]), FINEST, coarsest)
        new = evaluate(lanes, trial, finer, row[:, columns.inverse])
        good, root = _accepted_and_converged(row[:, :4].T, new[:, :4].T, alpha, flown, finer, again, tolerance)
        ends.iterations[lanes] += good & ~again
        # What damped the steps was the rough evaluation: from the better one the whole step is tried.
        after = np.where(again, 1.0, np.where(good, np.minimum(1.0, 2.0 * alpha), 0.5 * alpha))
        lost, again = again & ~good, ~good & (flown > FINEST) & (alpha <= doubt)
        refused = np.nonzero(~good)[0]
        for ahead, here in ((trial, y), (new, row), (finer, flown)):
            ahead[refused] = here[refused]
        y, row, flown = trial, new, finer
        alpha = _limit_damping(after, row, columns, max_step)
        trial = y + np.where(again, 0.0, alpha)[:, None] * row[:, columns.step]
        led, away = settings.stay_near(trial, start, lanes, away)
        active = ~root & ~lost & (alpha > _LEAST_DAMPING) & (number < limit) & led
        ends.keep(lanes, y, row, root, ~active, number)
        if watch is not None:
            watch(_describe_round(number, ends, row[active, 0]))
    return ends


def _describe_round(number: int, ends: Ends, residuals: Vector) -> str:
    """Format how far many lanes have come; `residuals` are those of lanes still at work."""
    text = f"round {number - 1}: {np.count_nonzero(ends.converged)} of {len(ends.y)} converged"
    return f"{text}, {len(residuals)} at work, least residual {residuals.min():.1e}" if len(residuals) else text


def _newton_one_lane(
    evaluate: Evaluate, start: Matrix, columns: Columns, settings: _NewtonSettings, watch: Watch | None
) -> Ends:
    """Solve in one lane, whose few numbers Python compares faster than NumPy, and which shows its iterations."""
    tolerance, accuracy, limit, max_step, doubt, _ = settings
    lanes, history = np.zeros(1, dtype=np.int64), list[Iteration]()
    y, flown, again, root, lost, number = np.array(start, dtype=float), accuracy, False, False, False, 1
    coarsest, away = ROUGHEST, np.full(1, np.inf)
    row = evaluate(lanes, y, np.array([flown]), np.zeros((1, columns.n**2)))
    head = row[0, :4].tolist()
    alpha = _limit_damping(1.0, row, columns, max_step)
    while head[2] < _ASTRAY and alpha > _LEAST_DAMPING and number < limit and not root and not lost:
        trial = y if again else y + alpha * row[:, columns.step]
        led, away = settings.stay_near(trial, start, lanes, away)
        if not np.all(led):
            break
        coarsest = FINEST if again else coarsest
        finer = min(max(_FORCING * (head[0] * head[0]), FINEST), coarsest)
        new = evaluate(lanes, trial, np.array([finer]), row[:, columns.inverse])
        number, ahead = number + 1, new[0, :4].tolist()
        good, root = _accepted_and_converged(head, ahead, alpha, flown, finer, again, tolerance)
        if good and not again:
            history.append(Iteration(number=len(history) + 1, residual=ahead[0], step=head[2], damping=float(alpha)))
            if watch is not None:
                watch(history[-1])
        # What damped the steps was the rough evaluation: from the better one the whole step is tried.
        alpha = 1.0 if again else min(1.0, 2.0 * alpha) if good else 0.5 * alpha
        lost, again = again and not good, not good and flown > FINEST and 2.0 * alpha <= doubt
        if good:
            y, row, head, flown = trial, new, ahead, finer
        alpha = _limit_damping(alpha, row, columns, max_step)
    return Ends(
        y=y,
        rows=row,
        converged=np.array([root]),
        evaluations=np.array([number]),
        iterations=np.array([len(history)]),
        history=tuple(history),
    )


def _accepted_and_converged(
    row: Any, new: Any, alpha: Any, flown: Any, finer: Any, again: Any, tolerance: float
) -> tuple[Any, Any]:
    """Return whether a trial is accepted, and whether it reaches a root: of numbers, or of arrays of lanes.

    Parameters
    ----------
    row, new
        The first four columns before and after.
    alpha
        Damping of the step.
    flown, finer
        Accuracy of the evaluations before and after.
    again
        True where the trial is the old iterate, only more accurate, as the next step was refused that its rough
        evaluation had led to.
    tolerance
        Largest residual of a root.
    """
    residual, _, length, size = row
    left, simplified, ahead, _ = new
    size = 1.0 + size
    # A residual that a change of y in its last digits explains is amplified round-off: take the least of a few.
    last_digits = length < LAST_DIGITS * size
    explained = last_digits & (residual <= AMPLIFIED * tolerance)
    good = again | (simplified <= (1.0 - 0.5 * alpha) * length) | last_digits & (left < residual)
    good |= last_digits & (explained ^ True)
    # Within the error of a rough evaluation nothing can be compared.
    good |= (flown > FINEST) & (left <= _NOISE * flown) | (finer > FINEST) & (left <= _NOISE * finer)
    good &= ahead < _ASTRAY
    settled = length <= SETTLED * size
    root = good & settled & (alpha == 1.0) & (finer <= FINEST) & (left <= tolerance)
    # At round-off no step is an improvement: that is a root, if the residual says so.
    stuck = (flown <= FINEST) & (
        (residual <= ROUND_OFF) | settled & (residual <= tolerance) | explained & (alpha < _FEW)
    )
    return good, (root | (good ^ True) & stuck) & (again ^ True)


def _limit_damping(alpha: Any, row: Matrix, columns: Columns, max_step: float) -> Any:
    """Return the damping that keeps the largest component of each step within `max_step`."""
    if math.isinf(max_step):
        return alpha
    limited = np.minimum(alpha, max_step / np.maximum(np.abs(row[:, columns.step]).max(axis=1), 1e-300))
    return limited if np.ndim(alpha) else float(limited[0])
