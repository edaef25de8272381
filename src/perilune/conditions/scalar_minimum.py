"""The minimum of H over scalar controls that are not on a bound.

Between their bounds dH/du = 0. Where conditions c(x, u) = 0 of scalars only are active, as many scalars keep them,

    dH/du = sum of mu dc/du,     c = 0,

and H has to be least on what the conditions leave (Karush, Kuhn, Tucker). Both are solved in closed form where they are
linear, else by Newton's method in u and mu from the best of many points: of a grid, or where a line of the grid meets
the conditions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise, product

import casadi as ca
import numpy as np

from perilune.conditions.scalar_regimes import Scalar, least_squares_multipliers, no_control_law_error, pivots
from perilune.problem import Phase, elements

# Newton's method starts at the least of so many values of H, for one and for two controls at once.
_GRID = {1: 17, 2: 9}
_STEPS = 7  # from a grid point the error squares each time; one more step is taken where it is differentiated
_BEYOND = 0.1  # of a step of the grid: so far beyond the bounds conditions are looked for


def minimise_interior_scalars(
    phase: Phase, H: ca.SX, u: ca.SX, free: Sequence[Scalar], held: ca.SX, low: bool = False
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Minimise H over scalars that are not on a bound: in closed form, or by a step from w, which Newton finds.

    Parameters
    ----------
    phase
        Whose controls.
    H, u, free
        The Hamiltonian as an expression of the symbols u of these scalars.
    held
        Conditions of them that are held.
    low
        Whether of two minima of one scalar the low one is asked for, of a `Scalar.quartic`.

    Returns
    -------
    The control as an expression of w, the symbols w, and the values of w; no w where there is a closed form.

    Raises
    ------
    PeriluneError
        If there are more than two scalars and no closed form.
    """
    none = ca.SX.zeros(u.numel(), 1)
    step, system = _minimum_newton_step(H, u, held)
    if not ca.depends_on(system, u):
        return ca.substitute(step, u, none), ca.SX(0, 1), ca.SX(0, 1)
    if len(free) not in _GRID:
        names = tuple(kind.control.name for kind in free)
        raise no_control_law_error(phase, names, "more than two controls that bend the Hamiltonian together")
    grids = [kind.grid(_GRID[len(free)]) for kind in free]
    inside = len(free) == 1 and not held.numel() and free[0].curved_both_ways
    at = (
        _least_interior_point(H, u, grids[0], low if free[0].quartic else None)
        if inside
        else _best_grid_point(H, u, grids, held)
    )
    reach = ca.vertcat(*(ca.fabs(grid[1] - grid[0]) for grid in grids))
    # |bend| keeps a single control on the way down where H is not convex.
    down = -ca.gradient(H, u) / ca.fabs(system) if len(free) == 1 and not held.numel() else step
    for _ in range(_STEPS):
        at = at + ca.fmax(-reach, ca.fmin(reach, ca.substitute(down, u, at)))
    w = ca.SX.sym("w", u.numel())
    return ca.substitute(u + step, u, w), w, at


def _best_grid_point(H: ca.SX, u: ca.SX, grids: Sequence[Sequence[ca.SX]], held: ca.SX) -> ca.SX:
    """Return the point of a grid, or where its lines meet what is held, at which H is least."""
    at, least = ca.SX.zeros(u.numel(), 1), ca.SX(np.inf)
    for point, met in _candidates(u, grids, elements(held)):
        value = ca.substitute(H, u, point)
        better = ca.logic_and(met, value < least)
        at, least = ca.if_else(better, point, at), ca.if_else(better, value, least)
    return at


def _least_interior_point(H: ca.SX, u: ca.SX, grid: Sequence[ca.SX], low: bool | None) -> ca.SX:
    """Return the point of a grid next to the least minimum between the bounds, however small H is on a bound.

    With `low` stated one where d3H/du3 < 0, or one where it is not, if there is any. Where H falls to the bounds alone
    it is the one of them where H is less.
    """
    values, slope = [ca.substitute(H, u, value) for value in grid], ca.gradient(H, u)
    third, last = ca.gradient(ca.gradient(slope, u), u), len(grid) - 1
    at, least = ca.if_else(values[0] < values[-1], grid[0], grid[-1]), ca.SX(np.inf)
    asked, least_asked = at, ca.SX(np.inf)
    for i, (point, value) in enumerate(zip(grid, values, strict=True)):
        left = ca.substitute(slope, u, point) < 0 if i == 0 else value <= values[i - 1]
        right = ca.substitute(slope, u, point) > 0 if i == last else value <= values[i + 1]
        minimum = ca.logic_and(left, right)
        better = ca.logic_and(minimum, value < least)
        at, least = ca.if_else(better, point, at), ca.if_else(better, value, least)
        if low is not None:
            below = ca.substitute(third, u, point) < 0
            mine = ca.logic_and(ca.logic_and(minimum, below if low else ca.logic_not(below)), value < least_asked)
            asked, least_asked = ca.if_else(mine, point, asked), ca.if_else(mine, value, least_asked)
    return at if low is None else ca.if_else(least_asked < np.inf, asked, at)


def _minimum_newton_step(H: ca.SX, u: ca.SX, held: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return Newton's step for u, and the matrix of its system; multipliers are those of least squares at u."""
    slope, C = ca.gradient(H, u), ca.jacobian(held, u)
    if held.numel() == u.numel():
        return -ca.solve(C, held), C
    if not held.numel():
        bend = ca.jacobian(slope, u)
        return -ca.solve(bend, slope), bend
    symbols, mu = ca.SX.sym("mu", held.numel()), least_squares_multipliers(H, u, held)
    bend = ca.substitute(ca.jacobian(slope - ca.mtimes(C.T, symbols), u), symbols, mu)
    system = ca.blockcat([[bend, -C.T], [C, ca.SX(held.numel(), held.numel())]])
    left = ca.vertcat(slope - ca.mtimes(C.T, mu), held)
    return -ca.solve(system, left)[: u.numel()], system


def _candidates(u: ca.SX, grids: Sequence[Sequence[ca.SX]], held: Sequence[ca.SX]) -> Iterator[tuple[ca.SX, ca.SX]]:
    """Yield points to start from, and whether they are near to what is held."""
    symbols = elements(u)
    holding = pivots(symbols, held)
    assert holding is not None, "asked of scalars that hold them"
    middle = [grid[len(grid) // 2] for grid in grids]
    lines = [[middle[i]] if i in holding else grid for i, grid in enumerate(grids)]
    for corner in product(*lines):
        points = [([*corner], ca.SX(1.0))]
        for condition, i in zip(held, holding, strict=True):
            # A point on a bound may by rounding lie beyond it.
            first, *_, last = (b - a for a, b in pairwise(grids[i]))
            line = [grids[i][0] - _BEYOND * first, *grids[i][1:-1], grids[i][-1] + _BEYOND * last]
            points = [new for old in points for new in _condition_zeros_on_line(u, *old, condition, i, line)]
        for point, met in points:
            yield ca.vertcat(*point), met


def _condition_zeros_on_line(
    u: ca.SX, point: list[ca.SX], met: ca.SX, condition: ca.SX, i: int, grid: Sequence[ca.SX]
) -> Iterator[tuple[list[ca.SX], ca.SX]]:
    """Yield points on the line through one along scalar i at which a condition changes its sign, roughly."""

    def at(value: ca.SX) -> ca.SX:
        return ca.substitute(condition, u, ca.vertcat(*point[:i], value, *point[i + 1 :]))

    slope = ca.gradient(condition, u[i])
    if not ca.depends_on(slope, u[i]):
        zero = ca.SX(0.0)
        own = ca.substitute(slope, u, ca.vertcat(*point[:i], zero, *point[i + 1 :]))
        yield [*point[:i], -at(zero) / own, *point[i + 1 :]], met
        return
    for a, b in pairwise(grid):
        left, right = at(a), at(b)
        root = a - left * (b - a) / (right - left)
        yield [*point[:i], root, *point[i + 1 :]], ca.logic_and(met, left * right <= 0)
