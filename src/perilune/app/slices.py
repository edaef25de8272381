"""A slice of the atlas around the present point, for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from perilune.app.frames import rounded
from perilune.app.subject import Subject
from perilune.atlas.slices import sliced

POINTS = 61  # along each axis


def slice_of(subject: Subject, values: Mapping[str, float], axes: Sequence[str]) -> dict[str, Any] | None:
    """J all over one or two axes of the atlas, the others as they are now; None where the atlas is of other values."""
    atlas = subject.atlas
    if atlas is None or any(
        not knob.mapped and values.get(knob.name, knob.value) != knob.value for knob in subject.knobs
    ):
        return None
    known = {knob.name: knob for knob in subject.knobs if knob.mapped}
    along = list(axes) or [name for name in known][: min(2, len(known))]
    held = {name: knob for name, knob in known.items() if name not in along and name in values}
    others = {name: min(max(values[name], knob.low), knob.high) for name, knob in held.items()}
    shown = sliced(atlas, along, others, points=POINTS)
    return {
        "axes": along,
        "along": [rounded(array) for array in shown.values],
        "objective": rounded(shown.answers.objective),
        "sheet": [int(sheet) for sheet in shown.answers.sheet],
        "why": [int(why) for why in shown.why],
        "reasons": list(shown.reasons),
        "sheets": list(shown.sheets),
    }
