"""Slices of the atlas around the present point, for the page."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from threading import Lock
from typing import Any

from perilune.app.messages import round_to_digits
from perilune.app.source import Subject
from perilune.atlas import Slice, sliced

POINTS = 61  # along an axis, at most
_GRIDS = (16, 31, POINTS)  # along each of two: the finest that takes no longer than a designer waits
_LONGEST = 2.0  # s
_GROWS = 4.0  # times as long as the grid before


class Slices:
    """Slices of the map, computed one at a time; the last is kept, as moves along its axes do not change it."""

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self._one = Lock()
        self._last: tuple[tuple[object, ...], dict[str, Any]] | None = None

    def at(
        self, values: Mapping[str, float], axes: Sequence[str], wanted: Callable[[], bool] = lambda: True
    ) -> dict[str, Any] | None:
        """Return J over one or two axes of the atlas, the others at their present values.

        None if the atlas is of other values, or the slice is wanted no longer.

        Parameters
        ----------
        values
            Present values of the parameters by name [SI].
        axes
            Names of one or two axes of the atlas; with none, its first two.
        wanted
            Returns False if the slice is wanted no longer; asked before each grid.

        Returns
        -------
        dict or None
            Message for the page.
        """
        atlas, knobs = self.subject.atlas, self.subject.knobs
        if atlas is None or any(not knob.mapped and values.get(knob.name, knob.value) != knob.value for knob in knobs):
            return None
        known = {knob.name: knob for knob in knobs if knob.mapped}
        along = list(axes) or list(known)[:2]
        held = {name: knob for name, knob in known.items() if name not in along and name in values}
        others = {name: min(max(values[name], knob.low), knob.high) for name, knob in held.items()}
        asked = (*along, *others.items())
        with self._one:
            if self._last is not None and self._last[0] == asked:
                return self._last[1]
            shown = None
            for points in _GRIDS if len(along) == 2 else (POINTS,):
                began = time.perf_counter()
                if not wanted():
                    return None
                shown = sliced(atlas, along, others, points=points)
                if _GROWS * (time.perf_counter() - began) > _LONGEST:
                    break
            assert shown is not None, "of some grid"
            self._last = asked, _slice_message(shown, along)
            return self._last[1]


def _slice_message(shown: Slice, along: Sequence[str]) -> dict[str, Any]:
    return {
        "axes": list(along),
        "along": [round_to_digits(array) for array in shown.values],
        "objective": round_to_digits(shown.answers.objective),
        "sheet": [int(sheet) for sheet in shown.answers.sheet],
        "why": [int(why) for why in shown.reason_index],
        "reasons": list(shown.reasons),
        "sheets": list(shown.sheets),
    }
