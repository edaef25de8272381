"""Revision of bang and singular stays by the extremal found with them; switches that merge are removed here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from perilune.core import Vector
from perilune.problem import Problem, ScalarControl, Solution
from perilune.structures.detect_regimes import WRONG, Stay, gain_along, linear_scalars, runs_by_kind
from perilune.structures.state_constraints import SIDES, conditions_of
from perilune.structures.structure import PAIR, Arc, Structure

BARELY, BEGUN = 1e-9, 1e-2  # of the largest gain: more is no rounding of exact tables; a pair of switches that begins
_LEAST_PAIR = 1e-10  # of a phase: what is shorter is no pair of switches


def revised_stays(whole: Solution, k: int, known: Sequence[Stay], shortest: float) -> list[Stay] | None:
    """Return the regimes that an extremal of these asks for: themselves where it keeps to them; None where it is none.

    Parameters
    ----------
    whole
        The extremal in the user's phases.
    k, known
        The phase, and its regimes with the times of the extremal.
    shortest
        Of the phase: an arc that is shorter is none.
    """
    if not known:
        return []
    found, least = list[Stay](), shortest * whole.trajectories[k].duration
    for at, control in linear_scalars(whole.problem, k):
        own = [s for s in known if s.control == control.name]
        if not own:
            continue
        t, gain, share = gain_along(whole, k, at, control)
        most, kept, bang_bang = (
            float(np.abs(gain).max()),
            list[Stay](),
            all(s.regime in ("lower", "upper") for s in own),
        )
        for stay in own:
            if stay.end - stay.begin <= (_LEAST_PAIR * whole.trajectories[k].duration if bang_bang else least):
                continue
            inside = np.nonzero((t > stay.begin) & (t < stay.end))[0]
            if stay.regime == "singular" and np.abs(gain[inside]).max(initial=0.0) > WRONG * most:
                return None
            born = _born(stay, t[inside], gain[inside] / most) if bang_bang else []
            kept += born or _revise_stay(stay, t[inside], gain[inside] / most, share[inside])
        found += _close_gaps(kept, known[-1].end)
    return sorted(found, key=lambda s: (s.begin, s.control))


def _revise_stay(stay: Stay, t: Vector, gain: Vector, share: Vector) -> Iterator[Stay]:
    """Yield a stay cut where it should be another: on a bound that is the worse one, or beyond the bounds."""
    if stay.regime == "held":
        yield stay
        return
    if stay.regime == "singular":
        asked = np.where(share > 1 + WRONG, 1, np.where(share < -WRONG, -1, 0))
        names = {1: "upper", -1: "lower", 0: "singular"}
    else:
        wrong = gain * (1 if stay.regime == "upper" else -1) > WRONG
        asked = wrong.astype(int)
        names = {0: stay.regime, 1: "lower" if stay.regime == "upper" else "upper"}
    if not asked.any():
        yield stay
        return
    pieces = runs_by_kind(np.ones(len(t), dtype=bool), asked)
    for first, last in pieces:
        begin = stay.begin if first == 0 else float(t[first])
        end = stay.end if last == len(t) - 1 else float(t[last + 1])
        yield Stay(control=stay.control, regime=names[int(asked[first])], begin=begin, end=end)


def _born(stay: Stay, t: Vector, gain: Vector) -> list[Stay]:
    """Return a stay on a bound cut where a pair of switches begins, if it does: H is less on the other bound by little.

    There J falls with the time w on that by gain w and rises by K w^2, so that w is as small as the gain while H is
    less there for as long as its root: the pair is tried as short as an instant, at the time of the gain.
    """
    if len(t) < 3:
        return []
    g = gain * (1 if stay.regime == "upper" else -1)
    i = 1 + int(np.argmax(g[1:-1]))
    slope, bend = 0.5 * (g[i + 1] - g[i - 1]), g[i + 1] - 2.0 * g[i] + g[i - 1]  # of a parabola through the points
    if not (g[i] >= max(g[i - 1], g[i + 1]) and bend < 0.0 and BARELY < g[i] - 0.5 * slope**2 / bend < BEGUN):
        return []
    at, half = float(t[i] - (t[i + 1] - t[i]) * slope / bend), 0.5 * PAIR * float(t[-1] - t[0])
    other = "lower" if stay.regime == "upper" else "upper"
    return [
        replace(stay, end=at - half), replace(stay, regime=other, begin=at - half, end=at + half),
        replace(stay, begin=at + half),
    ]  # fmt: skip


def _close_gaps(stays: Sequence[Stay], total: float) -> list[Stay]:
    """Close the gaps from the beginning of the phase to its end, and join neighbours of one regime."""
    found = list[Stay]()
    for stay in stays:
        if found and found[-1].regime == stay.regime:
            found[-1] = replace(found[-1], end=stay.end)
        else:
            found.append(replace(stay, begin=found[-1].end if found else 0.0))
    return [*found[:-1], replace(found[-1], end=total)] if found else []


def with_bound_regimes(solution: Solution, structure: Structure) -> Structure:
    """State the regime of scalars that keep boundary arcs, and are on one bound along each other arc.

    Where such an arc meets the boundary arc the slope of H vanishes, so that rounding decides if there is a switch.

    Parameters
    ----------
    solution
        Answer that consists of the arcs.
    structure
        The arcs.
    """
    phases = list(structure.phases)
    for k, arcs in enumerate(structure.phases):
        for at, control in linear_scalars(solution.problem, k):
            keeps = [control.name in _controls_moved_by_arc(solution.problem, k, arc) for arc in arcs]
            if any(keeps) and not any(name == control.name for arc in arcs for name, _ in arc.regimes):
                regimes = _regimes_of_arcs(solution, k, at, control, arcs, keeps)
                if None not in regimes:
                    said = zip(phases[k], regimes, strict=True)
                    phases[k] = tuple(replace(arc, regimes=(*arc.regimes, (control.name, r))) for arc, r in said)
    return Structure(tuple(phases))


def _controls_moved_by_arc(problem: Problem, k: int, arc: Arc) -> set[str]:
    """Return the components of the control that keep the conditions of a boundary arc."""
    return {name for c in conditions_of(problem, k, arc.along).values() for name in c.steering_controls}


def _regimes_of_arcs(
    solution: Solution, k: int, at: int, control: ScalarControl, arcs: Sequence[Arc], keeps: Sequence[bool]
) -> list[str | None]:
    """Return the regime of a scalar on each arc; None where it is not on one bound throughout."""
    t, _, share = gain_along(solution, k, at, control)
    found, begin = list[str | None](), 0.0
    for arc, held in zip(arcs, keeps, strict=True):
        here = share[(t > begin) & (t < arc.until)]
        bounds = [side for side, bound in zip(SIDES, (0.0, 1.0), strict=True) if (np.abs(here - bound) <= WRONG).all()]
        found.append("held" if held else bounds[0] if len(here) and bounds else None)
        begin = arc.until
    return found
