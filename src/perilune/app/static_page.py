"""Static page without a server: flights at the points of a grid over an atlas, in one file."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from perilune import PeriluneError
from perilune.app.answers import Answering, NoNearbyFlight
from perilune.app.files import page_files
from perilune.app.messages import ALL_DIGITS, flight_message, opening_message, refusal_message
from perilune.app.sliders import Knob
from perilune.app.source import Subject
from perilune.core import Watch, ignore_events

_ALONG, _BOTH, _POINTS = 61, 15, 60  # flights along one parameter, along each of two; points of a flight

_ANSWERS = """
"use strict";
window.PERILUNE_FROZEN = (() => {
  const said = JSON.parse(document.getElementById("frozen").textContent);
  return { hello: said.hello, answer: (number, values, receive) => {
    const place = said.hello.knobs.reduce((at, knob) => at * knob.grid.length + knob.grid.indexOf(knob.grid.reduce(
      (best, v) => Math.abs(v - values[knob.name]) < Math.abs(best - values[knob.name]) ? v : best)), 0);
    receive({ ...said.flights[place], number });
  } };
})();
"""


def default_sliders(subject: Subject) -> tuple[Knob, ...]:
    """Return the default knobs of a page: the first two axes of an atlas, or the first parameter without an atlas."""
    return tuple(knob for knob in subject.knobs if knob.mapped)[:2] or subject.knobs[:1]


class StaticPage(NamedTuple):
    """Static page, and its content in words."""

    page: str
    words: str


def build_static_page(subject: Subject, watch: Watch = ignore_events, chosen: Sequence[Knob] = ()) -> StaticPage:
    """Make a page with the flights over one parameter or two, all others as they are.

    Parameters
    ----------
    subject, chosen
        What is shown, and what of it moves, each in its range; `default_sliders` where nothing is chosen.
    watch
        Receives a line for every row of flights, and what each solve tells.

    Raises
    ------
    PeriluneError
        If there is no flight at any point.
    """
    chosen = chosen or default_sliders(subject)
    count = _ALONG if len(chosen) == 1 else _BOTH
    grids = [_slider_grid(knob, count) for knob in chosen]
    points = [dict(zip((knob.name for knob in chosen), values, strict=True)) for values in product(*grids)]
    flights = list[dict[str, Any]]()
    for row in range(0, len(points), count):
        watch(f"{row} of {len(points)} flights")
        flights += _flights_along_row(subject, points[row : row + count], watch)
    if not any(found["type"] == "flight" for found in flights):
        raise PeriluneError("there is no flight at any point of the page", got=flights[0]["what"])
    words = "; ".join((_flight_count_text(flights), *_stated_values_outside(subject, chosen)))
    knobs = [{**vars(knob), "grid": grid, "mapped": False} for knob, grid in zip(chosen, grids, strict=True)]
    told = {**opening_message(subject), "knobs": knobs, "mapped": False, "scenario": False, "stored": words}
    document = json.dumps({"hello": told, "flights": flights}, allow_nan=False, separators=(",", ":"))
    return StaticPage(_page(page_files(), document), words)


def _flight_count_text(found: Sequence[Mapping[str, Any]]) -> str:
    count = sum(one["type"] == "flight" for one in found)
    return f"a flight at {'each' if count == len(found) else count} of {len(found)} points"


def _stated_values_outside(subject: Subject, chosen: Sequence[Knob]) -> Iterator[str]:
    """Yield a sentence for each knob whose stated value lies outside the range chosen for it."""
    for knob in chosen:
        stated = subject.problem.given.get(knob.name)
        if stated is not None and not knob.mapped and not knob.low <= stated.value <= knob.high:
            yield f"{knob.key} as it is stated, {knob.shown(stated.value)}, is not among them"


def _slider_grid(knob: Knob, count: int) -> list[float]:
    """Space values evenly over a range, but move the nearest inner one to the page's first value."""
    grid = np.linspace(knob.low, knob.high, count)
    if knob.low < knob.value < knob.high:
        grid[np.clip(np.abs(grid - knob.value).argmin(), 1, count - 2)] = knob.value
    return grid.tolist()


def _flights_along_row(subject: Subject, points: Sequence[Mapping[str, float]], watch: Watch) -> list[dict[str, Any]]:
    """Return the flights at a row of points: from the map, else each from the one before.

    From neighbour to neighbour a family is kept across a jump. So flights off the map are followed from the other end
    of the row too, with a cold start there, and the better of both is taken.
    """
    problem, atlas = subject.problem, subject.atlas
    there, back = Answering(problem, atlas, subject.known), Answering(problem, atlas)
    found = [_stored_answer(there, values, watch) for values in points]
    if atlas is not None and {*points[0]} <= {*atlas.region.names}:
        return found
    again = [_stored_answer(back, values, watch) for values in reversed(points)]
    return [
        min(pair, key=lambda one: one.get("objective", math.inf)) for pair in zip(found, reversed(again), strict=True)
    ]


def _stored_answer(answering: Answering, values: Mapping[str, float], watch: Watch) -> dict[str, Any]:
    try:
        found = answering.at(values, watch)
    except PeriluneError as error:
        told = refusal_message(error) | (
            {"try": "a live page, which searches longer"} if isinstance(error, NoNearbyFlight) else {}
        )
        return {"type": "refusal", "values": dict(values), **told, "latency": 0.0}
    words = f"a flight that was stored: {found.words}"
    document = flight_message(found.solution, _POINTS, ALL_DIGITS)  # its table is what the page gives away
    return {"type": "flight", "values": dict(values), **document, "source": "stored", "words": words, "latency": 0.0}


def _page(files: Mapping[str, bytes], document: str) -> str:
    """Join all parts in one file, with a policy that admits nothing else."""
    text = {name: content.decode("utf-8") for name, content in files.items()}
    styles = [text["vendor/uPlot.min.css"], text["style.css"]]
    scripts = [text["vendor/uPlot.iife.min.js"], text["draw.js"], _ANSWERS, text["app.js"]]
    allowed = [" ".join(f"'sha256-{_sha256_base64(part)}'" for part in parts) for parts in (scripts, styles)]
    policy = f"default-src 'none'; script-src {allowed[0]}; style-src {allowed[1]}; img-src data: blob:"
    head = [f'<meta http-equiv="Content-Security-Policy" content="{policy}">', *(f"<style>{s}</style>" for s in styles)]
    data = f'<script type="application/json" id="frozen">{document.replace("<", chr(92) + "u003c")}</script>'
    page = text["index.html"]
    first, last = page.index('<link rel="icon"'), page.index("</head>")
    page = page[:first] + "\n".join(head) + "\n" + page[last:]
    first, last = page.index("<script src="), page.index("</body>")
    return page[:first] + data + "".join(f"<script>{s}</script>" for s in scripts) + "\n" + page[last:]


def _sha256_base64(part: str) -> str:
    return base64.b64encode(hashlib.sha256(part.encode("utf-8")).digest()).decode("ascii")
