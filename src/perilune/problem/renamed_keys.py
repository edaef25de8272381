"""Keys of files that have another name now: the only place that knows the old ones, and the reading by the new ones.

By place, the new name of each old key. In a place ``*`` stands for every entry of a list. A key with dots, as the
functions of a problem have, is renamed in its last part.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

_Renamed = Mapping[str, Mapping[str, str]]

FUNCTIONS = {"marks": "end_outputs", "typical_end": "end_guess"}
_PROBLEM: _Renamed = {
    "": {"made": "model"},
    "problem.free.*": {"typical": "guess"},
    "problem.phases.*": {"mark_variables": "end_output_variables"},
    "problem.functions": FUNCTIONS,
    "problem.views": {"beside": "comparison"},
}
_ANSWER: _Renamed = {
    "outcome": {"within": "tolerance_used"},
    "statistics": {"rung": "initialization", "tried": "attempts"},
    "structure.*": {"words": "description"},
    "verification": {"within": "tolerance_used", "text": "source"},
}
_MANIFEST: _Renamed = {
    "": {"before": "predecessors", "thin": "thin_margin", "asked": "requested", "kept": "merged"},
    "charts.*": {"keep": "attainable_conditions", "without": "excluded_bricks", "times": "reintegration_steps"},
    "charts.*.structure.*.*": {"touches": "contact_points"},
    "charts.*.sheets.*": {"holds": "active_bounds"},
}
_OF_FORMAT = {
    "solution": {**_PROBLEM, **_ANSWER},  # before version 3
    "answer": _ANSWER,  # of a member of a sweep, before version 2
    "header": {**_PROBLEM, "comparisons": {"stated": "findings"}},  # of an atlas, before version 7
    "manifest": _MANIFEST,  # a line of it, likewise
}


def with_new_keys(document: Any, form: Literal["solution", "answer", "header", "manifest"]) -> Any:
    """Return a tree with the new names of its keys; what has them already, or is no tree, stays as it is.

    Parameters
    ----------
    document
        Tree of JSON.
    form
        What it is the tree of.
    """
    return _with_new_keys(document, _OF_FORMAT[form], "")


def _with_new_keys(document: Any, renamed: _Renamed, place: str) -> Any:
    if place and not any(f"{known}.".startswith(f"{place}.") for known in renamed):
        return document
    if isinstance(document, list):
        return [_with_new_keys(entry, renamed, f"{place}.*") for entry in document]
    if not isinstance(document, dict):
        return document
    new = renamed.get(place, {})
    below = f"{place}." if place else ""
    return {_new_name(key, new): _with_new_keys(entry, renamed, f"{below}{key}") for key, entry in document.items()}


def _new_name(key: str, new: Mapping[str, str]) -> str:
    head, dot, name = key.rpartition(".")
    return f"{head}{dot}{new.get(name, name)}"
