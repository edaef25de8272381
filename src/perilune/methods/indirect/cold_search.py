"""Extremals without an initial guess: one way of starting after the other, until one leads to an answer."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import islice

from perilune.conditions import Held
from perilune.methods.indirect.coarse_direct import nearly_active_conditions
from perilune.methods.indirect.continuation.family_search import extremals_through
from perilune.methods.indirect.continuation.parameter_scan import ExtremalRoot, unknown_extremals
from perilune.methods.indirect.diagnosis import NOT_ISOLATED
from perilune.methods.indirect.initializers import ColdStarts, StartMembers
from perilune.methods.indirect.search_state import SearchState, count_extremals
from perilune.problem import Solution
from perilune.shooting import Member, Root

_MOST_OUTDOING = 6  # extremals that break the path, in whose basins admissible ones are looked for


def extremals_without_guess(
    state: SearchState, base: Member | None = None, *, last: bool = False, answered: bool = False
) -> tuple[SearchState, list[ExtremalRoot]]:
    """Return extremals from all starts, and their state: this one, or one whose control keeps more of the path.

    Parameters
    ----------
    state
        Of the run.
    base
        A member of a family of another run, which is followed first.
    last
        True to start by the last group of starts only.
    answered
        True to leave the last group of starts out, as an answer is known.
    """
    found: list[ExtremalRoot] = []
    given = [(base, "continuation")] if base is not None else []
    ways = ColdStarts(state.settings, state.trials, state.keep, state.coarse, state.tried)
    rungs = [
        given,
        _members_in_bounds(state, ways.from_random_costates()),
        _members_in_bounds(state, ways.from_shorter_flights()),
        ways.from_transcription(),
    ]
    for i, group in enumerate(rungs):
        if (last and i < 3) or (i == 3 and answered):
            continue
        if state.has_answer(found) and (i == 3 or (i == 2 and (base is not None or ways.agreed))):
            continue  # the last group of starts is for those that the others left without an answer
        if i == 3 and (held := conditions_reached_by(state, state.coarse.solve())):
            return extremals_without_guess(state.keeping(held), last=True)
        for first, name in group:
            if not state.walked_through(first):
                new, members = extremals_through(state, first)
                if state.has_answer(new) and (state.base is None or _isolated_and_better(state, first)):
                    state.base, state.start = first, name
                found += unknown_extremals(new, found)
                for member in members:
                    state.walked.setdefault(member.value, []).append(member.root.y)
        if i > 0 and (more := conditions_worth_keeping(state, found)):
            kept_state, kept = extremals_without_guess(state.keeping(more))
            if kept_state.has_answer(kept) or not state.has_answer(found):
                answers = [f for f in found if state.judge.breach(f.root) is None]
                return kept_state, [*kept, *unknown_extremals(answers, kept)]
    return state, found


def conditions_reached_by(state: SearchState, flight: Solution | None) -> Held:
    """Return conditions that the control could keep, which may hold a flight back.

    Parameters
    ----------
    state
        Of the run.
    flight
        The flight, or None.
    """
    near = nearly_active_conditions(flight) if state.keepable and flight is not None else set[str]()
    return tuple(name for name in state.keepable if name in near)


def conditions_worth_keeping(state: SearchState, found: list[ExtremalRoot]) -> Held:
    """Return conditions that the control could keep, broken by extremals that are better than every answer.

    Parameters
    ----------
    state
        Of the run.
    found
        Extremals found.
    """
    if not state.keepable:
        return ()
    answers = [f.root.cost for f in found if f.minimum and not _broken_names(state, f.root)]
    best, names = min(answers, default=math.inf), set[str]()
    for root in (*(f.root for f in found), *state.breaking):
        broken = _broken_names(state, root)
        if root.cost < best and (not answers or broken <= {*state.keepable}):
            names |= broken
    return tuple(name for name in state.keepable if name in names)


def better_inadmissible_roots(state: SearchState, found: list[ExtremalRoot]) -> list[Root]:
    """Return extremals that break the path and beat every answer: what keeps it near them may be better as well.

    Parameters
    ----------
    state
        Of the run.
    found
        Extremals found.
    """
    answers = (f.root.cost for f in found if f.minimum and state.judge.breach(f.root) is None)
    best = min(answers, default=math.inf)
    roots = (*(f.root for f in sorted(found, key=lambda f: (not f.minimum, f.root.cost))), *state.breaking)
    better = (root for root in roots if root.cost < best)
    outdoing = (root for root in better if all(breach.path for breach in state.judge.breaches(root)))
    return list(islice(outdoing, _MOST_OUTDOING))


def _members_in_bounds(state: SearchState, ways: Iterable[StartMembers]) -> Iterator[tuple[Member, str]]:
    """Yield members within the bounds, start by start.

    Those that break a condition come last, and only where nothing else was found.
    """
    for members, name, tried in ways:
        breaking, met = list[Member](), 0
        for member in members:
            if state.trials.outside(member.root) is not None:
                continue
            met += 1
            if state.walked_through(member):
                continue
            breach = state.judge.breach(member.root)
            if breach is None:
                yield member, name
            else:
                breaking.append(member)
                state.broken.append(breach)
                state.breaking.append(member.root)
        breaks = f"{len(breaking)} of them break{'s' if len(breaking) == 1 else ''} a condition" if met else ""
        state.tried.append(", ".join(filter(None, (tried, count_extremals(met), breaks))))
        if any(member.root.open_directions for member in members):
            state.tried.append(NOT_ISOLATED)
        if state.base is None:
            yield from ((member, name) for member in breaking)


def _isolated_and_better(state: SearchState, first: Member) -> bool:
    """Return True if an extremal that is no member of a family is better than the one known."""
    return state.trials.scanned is None and state.base is not None and first.root.cost < state.base.root.cost


def _broken_names(state: SearchState, root: Root) -> set[str]:
    """Return the names of what an extremal breaks; of what the control could keep by however little."""
    grazed = state.judge.grazed(root) & {*state.keepable}
    return {breach.name for breach in state.judge.breaches(root)} | grazed
