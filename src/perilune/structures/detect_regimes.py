"""Detection of bang and singular arcs of scalar controls from an answer with costates.

Of a scalar that enters the dynamics linearly H shows by how much one bound is worse than the other,

    gain = H(upper) - H(lower) = Phi (upper - lower),       Phi = dH/du:

and the control is at its upper bound where that is negative, at its lower where it is positive. At a switch the gain
crosses zero: it is below 4 times a level for 4 times as long as below it. Along a singular arc it stays there, however
the control of a mesh chatters, and beyond both ends it leaves zero like t^2, which shows where they are.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from perilune.core import Vector
from perilune.problem import (
    Problem,
    ScalarControl,
    Settled,
    Solution,
    depends_linearly_on_control,
    priced_rates,
    scalars,
)
from perilune.structures.structure import Regimes, Structure

# Of the size of the gain: so small it is zero, on better and on worse meshes. Its size is what it reaches while the
# control is on a bound, on the bound where that is less and on the other: where a state is on a bound of its own
# a mesh gives costates of any size, and along a short arc hardly more than its noise.
EXACT = (0, 0.0)  # by the breaks of tables that have an arc between any two of them
LEVELS = tuple((size, level) for size in (0, 1) for level in (2e-3, 5e-3, 1e-2, 2e-2, 4e-2, 8e-2))
WIDER, STAYS = 4.0, 0.5  # a wider level; singular where the gain stays for such a share of the time below the wider one
SHORTEST, BURST = 0.01, 2e-3  # of a phase: singular arcs that are read are longer, and arcs on bounds
INSTANT = 0.01  # of a phase: what flies it at full accuracy takes steps of about that length
INSIDE = 0.02  # of its range: on the average a singular control is farther from its bounds
BETWEEN = 0.1  # of its range and of a phase
CLEAR = 0.05  # of its range: so near to its lower bound a control is there, whatever the gain
POINTS = 2000
WRONG = 1e-6  # of the largest gain, and of the range of a control: more is no rounding


@dataclass(frozen=True, kw_only=True)
class Stay:
    """A scalar control that stays in a regime from `begin` to `end` [s] of a phase."""

    control: str
    regime: str
    begin: float
    end: float


def linear_scalars(problem: Problem, k: int) -> list[tuple[int, ScalarControl]]:
    """Return scalars of phase k with two bounds that enter the dynamics linearly and no condition of the path.

    In rates of states whose costates vanish identically they may stand in any way.

    Parameters
    ----------
    problem
        The problem.
    k
        Index of the phase.

    Returns
    -------
    list
        Index among the components of the control, and the scalar, of each.
    """
    phase = problem.phases[k]
    functions = [problem.form.expressions.get((k, name)) for name in ("path", "held")]
    dynamics = problem.form.expressions[k, "dynamics"]
    return [
        (at, control)
        for at, control in scalars(phase.controls)
        if control.bounded
        and any(depends_linearly_on_control(rates, control.name) for rates in (dynamics, priced_rates(problem, k)))
        and not any(f is not None and ("u", control.name) in f.tape.instructions for f in functions)
    ]


def stays_between_bounds(solution: Solution) -> bool:
    """Return True if a scalar that enters linearly is between its bounds for longer than a switch on a mesh."""
    for k in range(len(solution.trajectories)):
        for at, control in linear_scalars(solution.problem, k):
            flown = solution.trajectories[k].control
            share = control.share(flown(np.linspace(0.0, flown.time[-1], POINTS))[:, at], solution.parameters)
            if float(((share > BETWEEN) & (share < 1 - BETWEEN)).mean()) > BETWEEN:
                return True
    return False


def leaves_bounds(solution: Solution, k: int) -> bool:
    """Return whether a scalar of phase k that enters linearly is anywhere between its bounds, by exact tables.

    Parameters
    ----------
    solution
        Solution with exact tables of the control.
    k
        Index of the phase.
    """
    t, known = np.linspace(0.0, solution.trajectories[k].duration, POINTS), linear_scalars(solution.problem, k)
    shares = [control.share(solution.evaluate(k, t)[1][at], solution.parameters) for at, control in known]
    return any(bool((np.minimum(np.abs(share), np.abs(share - 1.0)) > WRONG).any()) for share in shares)


def read_stays(solution: Solution, k: int) -> dict[tuple[int, float], list[Stay]]:
    """Return by level the regimes of each scalar of phase k that is singular for a while; nothing of others.

    Parameters
    ----------
    solution
        A solution with costates, else nothing is read.
    k
        Number of the phase.

    Returns
    -------
    dict
        Stays by level, which is `EXACT` or one of `LEVELS`.
    """
    found: dict[tuple[int, float], list[Stay]] = {level: [] for level in (EXACT, *LEVELS)}
    if solution.trajectories[k].costate is None:
        return found
    for at, control in linear_scalars(solution.problem, k):
        t, gain, share = gain_along(solution, k, at, control)
        found[EXACT] += _between_breaks(control.name, solution.trajectories[k].control.time, t, gain, share)
        sizes = _gain_sizes(gain, share)
        for size, level in LEVELS:
            zero = level * sizes[size]
            if singular := list(_singular(t, gain, share, zero)):
                # A mesh passes from bound to bound within a segment: there the gain says which it is.
                upper = (share > 0.5) | ((share > CLEAR) & (gain < -zero))
                found[size, level] += stays_around_singular(control.name, t, upper, singular)
    return found


def brief_stays(solution: Solution, k: int) -> list[Stay]:
    """Return the bounds that the one scalar of phase k is on, where one of these arcs is a mere instant of the phase.

    Exact tables break at each switch. A control law that looks for its switches within a flight that is a hundred
    times as long leaps over such an arc or loses it; where it begins and ends are unknowns of its own then.

    Parameters
    ----------
    solution
        Solution with exact tables and costates.
    k
        Index of the phase.

    Returns
    -------
    list
        Regimes with begin and end [s of the phase]; empty if no arc is that short or the phase has another control.
    """
    flown, known = solution.trajectories[k], linear_scalars(solution.problem, k)
    if len(known) != 1 or flown.costate is None:
        return []
    (at, control), nodes = known[0], flown.control.time
    edges = np.unique([0.0, *nodes[1:][np.diff(nodes) == 0], flown.duration])
    if len(edges) < 3 or np.diff(edges).min() > INSTANT * flown.duration:
        return []
    share = control.share(flown.control(0.5 * (edges[1:] + edges[:-1]))[:, at], solution.parameters)
    if np.minimum(np.abs(share), np.abs(share - 1.0)).max() > WRONG:
        return []
    names = ["upper" if high else "lower" for high in share > 0.5]
    found = list[Stay]()
    for regime, (begin, end) in zip(names, pairwise(edges.tolist()), strict=True):
        if found and found[-1].regime == regime:
            found[-1] = replace(found[-1], end=end)
        else:
            found.append(Stay(control=control.name, regime=regime, begin=begin, end=end))
    return found


def seen_stays(solution: Solution, k: int) -> list[Stay]:
    """Return the bounds that the one scalar of phase k is on, as the places in its range show them, however rough.

    Parameters
    ----------
    solution
        Solution of any accuracy.
    k
        Index of the phase.

    Returns
    -------
    list
        Regimes with begin and end [s of the phase]; empty unless the phase has exactly one such scalar.
    """
    known = linear_scalars(solution.problem, k)
    if len(known) != 1:
        return []
    (at, control), t = known[0], np.linspace(0.0, solution.trajectories[k].duration, POINTS)
    upper = control.share(solution.evaluate(k, t)[1][at], solution.parameters) > 0.5
    return _bang_bang_stays(control.name, t, upper, 0.0, float(t[-1]))


def gain_along(solution: Solution, k: int, at: int, control: ScalarControl) -> tuple[Vector, Vector, Vector]:
    """Return times of phase k, H at the upper less H at the lower bound [J/s], and the place in the range, 0 to 1.

    Parameters
    ----------
    solution
        A solution with costates.
    k
        Number of the phase.
    at
        Place of the control among the components.
    control
        A scalar with two bounds that enters linearly.
    """
    phase, flown = solution.problem.phases[k], solution.trajectories[k]
    assert flown.costate is not None, "asked for where there is one"
    t = np.linspace(0.0, flown.duration, POINTS)
    x, u = solution.evaluate(k, t)
    lam, p = flown.costate(t).T, solution.parameters
    sides = []
    for limit in control.limits(p):
        moved = np.array(u)
        moved[at] = limit
        rates = phase.rates(list(x), list(moved), p)
        sides.append(sum(a * np.asarray(b) for a, b in zip(lam, rates, strict=True)))
    return t, sides[1] - sides[0], control.share(u[at], p)


def _between_breaks(name: str, nodes: Vector, t: Vector, gain: Vector, share: Vector) -> list[Stay]:
    """Return the regime between any two breaks; nothing where one is none, or none of them singular."""
    breaks = nodes[1:][np.diff(nodes) == 0]
    edges, most, found = np.unique([0.0, *breaks, t[-1]]), float(np.abs(gain).max()), list[Stay]()
    for begin, end in pairwise(edges.tolist()):
        inside = (t > begin) & (t < end)
        if not inside.any():  # shorter than the points are apart
            return []
        low, high = (bool((np.abs(share[inside] - bound) <= WRONG).all()) for bound in (0.0, 1.0))
        if not (low or high or np.abs(gain[inside]).max() <= WRONG * most):
            return []
        regime = "lower" if low else "upper" if high else "singular"
        if found and found[-1].regime == regime:
            found[-1] = replace(found[-1], end=end)
        else:
            found.append(Stay(control=name, regime=regime, begin=begin, end=end))
    return found if any(stay.regime == "singular" for stay in found) else []


def _gain_sizes(gain: Vector, share: Vector) -> tuple[float, float]:
    """Return the largest gain while the control is on a bound: on the one where it is less, and on the other."""
    sizes = [float(np.abs(gain[on]).max()) for on in (share < INSIDE, share > 1 - INSIDE) if on.mean() > SHORTEST]
    sizes = sizes or [float(np.abs(gain).max())]
    return min(sizes), max(sizes)


def _singular(t: Vector, gain: Vector, share: Vector, level: float) -> Iterator[tuple[float, float]]:
    """Yield from when to when the gain stays at zero."""
    size, total = np.abs(gain), float(t[-1])
    wide = runs_by_kind(size <= WIDER * level)
    for first, last in runs_by_kind(size <= level):
        low, high = next((a, b) for a, b in wide if a <= first <= b)
        stays = (t[last] - t[first]) > STAYS * (t[high] - t[low])
        if not stays or not INSIDE < share[first : last + 1].mean() < 1 - INSIDE:
            continue
        # Like t^2 beyond both ends: twice as far from them at four times the level.
        begin = 0.0 if first == 0 else float(2 * t[first] - t[low])
        end = total if last == len(t) - 1 else float(2 * t[last] - t[high])
        if end - begin > SHORTEST * total:
            yield begin, end


def stays_around_singular(name: str, t: Vector, upper: Vector, singular: Sequence[tuple[float, float]]) -> list[Stay]:
    """Return singular arcs, and those at bounds between them.

    Parameters
    ----------
    name
        Name of the scalar.
    t
        Times of the phase [s], (n,).
    upper
        True where the upper bound is the better one, (n,).
    singular
        Begin and end [s] of each singular arc, in order.
    """
    found, total, before = list[Stay](), float(t[-1]), 0.0
    for begin, end in [*singular, (total, total)]:
        if begin - before > SHORTEST * total:
            found += _bang_bang_stays(name, t, upper, before, begin)
        elif found:
            found[-1] = replace(found[-1], end=begin)
        else:
            begin = 0.0
        if end > begin:
            found.append(Stay(control=name, regime="singular", begin=begin, end=end))
        before = end
    return [*found[:-1], replace(found[-1], end=total)]


def _bang_bang_stays(name: str, t: Vector, upper: Vector, begin: float, end: float) -> list[Stay]:
    """Return bang-bang stays from one time to another."""
    inside = (t >= begin) & (t <= end)
    here, upper = t[inside], upper[inside]
    found = list[Stay]()
    for first, last in runs_by_kind(np.ones(len(here), dtype=bool), upper):
        if found and here[last] - here[first] <= BURST * t[-1]:
            continue
        regime = "upper" if upper[first] else "lower"
        if found and found[-1].regime == regime:
            continue
        at = begin if not found else float(here[first])
        if found:
            found[-1] = replace(found[-1], end=at)
        found.append(Stay(control=name, regime=regime, begin=at, end=end))
    return found


def runs_by_kind(true: Vector, kind: Vector | None = None) -> list[tuple[int, int]]:
    """Return the first and last index of each run of true values, each of one kind.

    Parameters
    ----------
    true
        Truth values, (n,).
    kind
        Numbers of kinds, (n,); by default all are of one kind.
    """
    kind = np.zeros(len(true)) if kind is None else kind
    edges = np.nonzero((np.diff(true.astype(int)) != 0) | (np.diff(kind.astype(int)) != 0))[0] + 1
    bounds = zip([0, *edges.tolist()], [*(edges - 1).tolist(), len(true) - 1], strict=True)
    return [(a, b) for a, b in bounds if true[a]]


def stays_of(structure: Structure, k: int) -> list[Stay]:
    """Return the regimes of phase k in a structure with times; neighbours of one regime are one.

    Parameters
    ----------
    structure
        Arcs of each phase, with the times at which they end [s of the phase].
    k
        Index of the phase.
    """
    found, begin = list[Stay](), 0.0
    for arc in structure.phases[k]:
        for name, regime in arc.regimes:
            last = next((i for i, s in enumerate(found) if s.control == name and s.end == begin), None)
            if last is not None and found[last].regime == regime:
                found[last] = replace(found[last], end=arc.until)
            else:
                found.append(Stay(control=name, regime=regime, begin=begin, end=arc.until))
        begin = arc.until
    return sorted(found, key=lambda s: (s.begin, s.control))


def regimes_at(stays: Sequence[Stay], t: float, held: Collection[str] = ()) -> Regimes:
    """Return the regime of each scalar at a time; `held` are those that keep boundary arcs then.

    Parameters
    ----------
    stays
        Regimes of the scalars of a phase.
    t
        Time [s].
    held
        Names of scalars that keep boundary arcs then.
    """
    here = [s for s in stays if s.begin < t < s.end]
    free = {s.control: "singular" if s.regime == "held" else s.regime for s in here}
    return tuple((name, "held" if name in held else regime) for name, regime in free.items())


def settle_scalar(control: ScalarControl, regime: str) -> Settled:
    """Return a scalar that stays in a regime.

    Parameters
    ----------
    control
        Scalar control with bounds.
    regime
        "lower", "upper" or "singular".
    """
    own = {name: getattr(control, name) for name in ("name", "unit", "lower", "upper")}
    return Settled(**own, regime=regime)  # pyright: ignore[reportArgumentType]
