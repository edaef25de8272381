"""Extremals of families: along a free parameter between bounds, and at the limits of the ranges of an end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from perilune.methods.indirect.continuation.parameter_scan import (
    ExtremalRoot,
    HeldFamily,
    scan_family,
    unknown_extremals,
)
from perilune.methods.indirect.search_state import SearchState, count_extremals
from perilune.problem import free_name, free_scales
from perilune.shooting import Member, Root

_MOST_FOLLOWED = 24  # extremals from which families along other parameters are followed


def extremals_through(state: SearchState, first: Member) -> tuple[list[ExtremalRoot], list[Member]]:
    """Return the extremals of all families through a member, and the members visited on the first.

    Parameters
    ----------
    state
        Of the run.
    first
        An extremal with the scanned parameter held, or any where none is scanned.
    """
    trials, shooting = state.trials, state.trials.shooting
    if trials.scanned is None:
        return _over_ranges(state, first.root), [first]
    found, members = _scan_parameter(state, trials.scanned, first)
    if len(trials.bounded) > 1:
        found += _scan_other_parameters(state, found)
    down = (
        bool(shooting.curving_down(f.root, trials.p)) or not shooting.curved_upwards(f.root, trials.bounded)
        for f in found
    )
    return [replace(f, minimum=f.minimum and not is_down) for f, is_down in zip(found, down, strict=True)], members


def others_through(state: SearchState, known: ExtremalRoot) -> list[ExtremalRoot]:
    """Return the other extremals on the families through one, along parameters between bounds.

    Parameters
    ----------
    state
        Of the run.
    known
        The extremal.
    """
    scanned = state.trials.scanned
    if scanned is None or (member := _member_held_at(state, known.root, scanned)) is None:
        return []
    return unknown_extremals(extremals_through(state, member)[0], [known])


def _scan_other_parameters(state: SearchState, found: list[ExtremalRoot]) -> list[ExtremalRoot]:
    """Return more extremals: along one parameter the others stay in their basins, and at their bounds."""
    trials, more = state.trials, list[ExtremalRoot]()
    left = [(f, trials.scanned) for f in unknown_extremals(found, state.followed)]
    while left:
        if len(state.followed) >= _MOST_FOLLOWED:
            state.tried.append(f"{len(left)} more extremals, from which no further family was followed")
            break
        one, along = left.pop(0)
        state.followed.append(one)
        for index in trials.bounded:
            if index != along and (here := _member_held_at(state, one.root, index)) is not None:
                new = unknown_extremals(_scan_parameter(state, index, here)[0], [*found, *more, *state.followed])
                more += new
                left += [(f, index) for f in new]
    return more


def _scan_parameter(state: SearchState, index: int, first: Member) -> tuple[list[ExtremalRoot], list[Member]]:
    """Return extremals of the family through a member along one free parameter, and the members visited."""
    trials, free = state.trials, state.problem.free[index]
    state.watch(f"following the family of extremals along {free_name(state.problem, free.name)}")
    family = HeldFamily(
        shooting=trials.shooting, p=trials.p, index=index, limits=trials.limits.without(index), watch=state.watch,
        keeps=lambda root: trials.outside(root) is None,
    )  # fmt: skip
    found, members = scan_family(family, first, trials.bounds(index), state.settings.scan_points)
    scale = free_scales(state.problem.free, state.problem)[index]
    low, high = (members[end].value * scale for end in (0, -1))
    ends, count = f"{low:.6g} to {high:.6g} {free.unit}", count_extremals(len(found))
    state.tried.append(f"a family along {free_name(state.problem, free.name)} from {ends}: {count}")
    return found, members


def _member_held_at(state: SearchState, root: Root, index: int) -> Member | None:
    """Return an extremal as a member of the family along a free parameter; None where Newton's method loses it."""
    trials = state.trials
    value, choice = float(root.y[trials.conditions.free_at.start + index]), root.choice.copy()
    trials.shooting.plan.hold(choice, index, value)
    held = trials.settled(root.y[None], choice, limits=trials.limits.without(index))[0]
    return Member(value=value, root=held) if held.converged else None


def _over_ranges(state: SearchState, root: Root) -> list[ExtremalRoot]:
    """Return an extremal, and those at the limits of ranges of an end over which J is at a maximum there."""
    trials, shooting = state.trials, state.trials.shooting
    if not (curved := shooting.curving_down(root, trials.p)):
        return [ExtremalRoot(root=root, minimum=True)]
    found, first = [ExtremalRoot(root=root, minimum=False)], shooting.plan.free
    for i in (first + k for k in curved):
        for limit in (trials.limits.lower[i], trials.limits.upper[i]):
            choice = root.choice.copy()
            shooting.plan.hold(choice, i, limit)
            held = trials.settled(root.y[None], choice, limits=trials.limits)[0] if np.isfinite(limit) else root
            if held.converged and held.choice[i]:
                minimum = not shooting.curving_down(held, trials.p)
                found += unknown_extremals([ExtremalRoot(root=held, minimum=minimum)], found)
    return found
