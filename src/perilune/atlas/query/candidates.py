"""Candidate extremals of cells at a point, before and after Newton's method, and those that leave it in doubt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.charts import SLACK, Lanes, OpenChart, Polished
from perilune.core import Vector

_HERE = np.zeros(1, dtype=np.int64)  # one point is one lane


@dataclass(slots=True)
class Candidate:
    """Candidate of one branch at a point from its cell: unknowns (None with nothing to polish) and J, canonical.

    J is exact once it was `polished` and is an answer.
    """

    charted: OpenChart
    number: int
    y: Vector | None
    cost: float
    cell: Vector
    breaks: bool = False  # the path all over the cell, or an arc has a negative duration
    short: bool = False  # the latter
    polished: Polished | None = None

    @property
    def label(self) -> str:
        """Return the label of its branch."""
        return self.charted.labels[self.number]

    @property
    def vouches(self) -> bool:
        """Return True if the candidate is a valid extremal as far as is known, whether or not it is the best."""
        known = self.y is not None if self.polished is None else bool(self.polished.answers[0])
        return known and not self.breaks

    @property
    def beyond(self) -> list[tuple[str, str]]:
        """Return the names of parameters and ranges beyond a bound, each with the side."""
        assert self.polished is not None
        bounds = self.charted.borders.bounds
        return [bounds[i] for i in np.nonzero(self.polished.beyond[0])[0].tolist()]

    @property
    def why(self) -> str:
        """Return the reason why it is no answer, and casts doubt on others."""
        polished, sheet = self.polished, f"the sheet '{self.label}'"
        if polished is not None and (beyond := self.beyond):
            name, side = beyond[0]
            return f"an extremal of {sheet} lies beyond the {side} bound of {name}, and one at this bound may be better"
        if polished is not None and polished.gains[0]:
            return f"an extremal of {sheet} has a multiplier of the wrong sign, and the better extremal is not known"
        if self.short:
            return f"an extremal of {sheet} has an arc of negative duration, and the extremal without it may be better"
        if self.breaks or (polished is not None and polished.breaking[0]):
            return f"an extremal of {sheet} violates a condition, and an unknown flight that keeps it may be better"
        if polished is None:
            return f"{sheet} ends in this cell"
        if not polished.reached[0]:
            return f"Newton's method finds no extremal of {sheet} from the cell's first guess"
        if polished.reintegrated.margins.good[0]:
            return f"the extremal of {sheet} is known only to {polished.bound[0]:.1e} (relative; limit {SLACK:g})"
        return f"the independent re-integration contradicts the extremal of {sheet}: {polished.reintegrated.violation}"


def dominates_known(charted: OpenChart, cost: Any, best: Any) -> Any:
    """Return True where inadmissible extremals of a chart have less J than the best answer, inf for none.

    Parameters
    ----------
    charted
        Their chart.
    cost, best
        J of the extremals and of the best answer, canonical; numbers or arrays.
    """
    return np.isinf(best) | ((cost < best) & (not charted.breaks_controls_alone))


def without_admissible_answer(
    better: Sequence[tuple[OpenChart, Lanes, NDArray[np.bool_]]],
    vouching: Sequence[tuple[OpenChart, NDArray[np.bool_]]],
    of_arcs: NDArray[np.bool_],
) -> list[NDArray[np.bool_]]:
    """Return masks of the better, inadmissible extremals whose basin may have no answer among those known.

    Each basin has at most one extremal of each chart, and one answer. An extremal that breaks the path leads to one of
    several arcs; one with a negative arc duration to one of other arcs, or of a single arc.

    Parameters
    ----------
    better
        Their charts, the lanes in which there is one, and True for those with a negative arc duration.
    vouching
        Charts of extremals, and the lanes in which they are valid, best or not, (lanes,).
    of_arcs
        True where the best answer consists of several arcs, (lanes,).
    """
    arcs, answers = np.zeros((2, len(of_arcs)), dtype=np.int64)
    wells = {charted: np.zeros_like(arcs) for charted, *_ in [*better, *vouching]}
    for charted, known in vouching:
        answers += known
        if charted.of_arcs:
            arcs += known
            wells[charted] += known
    for charted, lanes, _ in better:
        wells[charted][lanes] += 1
    left = [(wells[charted] > answers, ~of_arcs | (wells[charted] > arcs)) for charted, *_ in better]
    return [np.where(its, of[lanes], to[lanes]) for (_, lanes, its), (of, to) in zip(better, left, strict=True)]


def casting_doubt(short: Any, left: Any, *, follows: bool, settles: bool) -> tuple[Any, Any]:
    """Return masks of the extremals that cast doubt, and of those that are followed to the minimum of their basin.

    An extremal that breaks the path is always followed: it may lead to another basin than the one of the known answer.
    One with a negative arc duration usually continues as a known answer, and else casts doubt by where it leads. All
    that are left cast doubt if following settles nothing, as basins may differ in parameters that are not followed.

    Parameters
    ----------
    short
        True for those with a negative arc duration; one or an array.
    left
        True for those whose basin may have no known answer; one or an array.
    follows, settles
        True if extremals can be followed, and if that decides.
    """
    cast, each = left & ~(short & settles), (left | ~short) if settles else ~(left | short)
    return cast, each & follows


def candidates_in_doubt(
    better: Sequence[Candidate],
    alike: Sequence[Candidate],
    offers: Sequence[Candidate],
    *,
    follows: bool,
    settles: bool,
) -> tuple[list[Candidate], list[Candidate]]:
    """Return the candidates at one point that cast doubt, and those to follow, as `casting_doubt`.

    Parameters
    ----------
    better
        Inadmissible candidates that are better than the answer.
    alike
        The best answers.
    offers
        All candidates at the point.
    follows, settles
        As of `casting_doubt`.
    """
    if not better:
        return [], []
    short = [np.array([one.short]) for one in better]
    left = without_admissible_answer(
        [(one.charted, _HERE, its) for one, its in zip(better, short, strict=True)],
        [(one.charted, np.array([one.vouches])) for one in offers],
        np.array([any(one.charted.of_arcs for one in alike)]),
    )
    told = [casting_doubt(its, own, follows=follows, settles=settles) for its, own in zip(short, left, strict=True)]
    return tuple([one for one, both in zip(better, told, strict=True) if both[k][0]] for k in (0, 1))  # pyright: ignore
