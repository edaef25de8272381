"""An orbit ephemeris message (CCSDS 502.0-B-2, OEM version 2.0, in its keyword form), one segment for each phase.

Positions and velocities stand in the axes of the ICRF, from the centre of the body, times in UTC. From the model's own
axes they come by the orientation of the body at the begin of the flight (`perilune.models.orientation`); how well that
is known stands in a comment, as does what the model left open.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path

from perilune.io.exports.epochs import stamp
from perilune.io.exports.path import Leg, legs, space_of
from perilune.io.format import hash_of
from perilune.models.orientation import axes_in_space, told_orientation
from perilune.problem.solution import Solution
from perilune.words.bounded import one_line

_WIDTH = 200  # the standard allows 254 characters
_NAMED = 80  # of them for the name of the problem
NAME = "an orbit ephemeris message (OEM)"


def write_oem(solution: Solution, about: Mapping[str, str], epoch: datetime, path: Path) -> None:
    """Write the message.

    Raises
    ------
    PeriluneError
        If the problem is nowhere in space, or the orientation of its body is not known.
    """
    body = space_of(solution, NAME).body.lower()
    matrix = axes_in_space(body, epoch)
    flown = [leg.turned(matrix) for leg in legs(solution)]
    lines = ["CCSDS_OEM_VERS = 2.0", *_comments(_told(solution, about, body, epoch, max(leg.lost for leg in flown)))]
    lines += [f"CREATION_DATE = {datetime.now(UTC):%Y-%m-%dT%H:%M:%S}", "ORIGINATOR = PERILUNE", ""]
    for leg in flown:
        lines += _segment(leg, solution.problem.name, body, epoch)
    path.write_text("\n".join(lines), encoding="ascii", newline="\n")


def _told(solution: Solution, about: Mapping[str, str], body: str, epoch: datetime, lost: float) -> Iterator[str]:
    yield about["title"]
    yield about["source"]
    yield f"method {about['method']}; proof: {about['proof']}; J = {about['objective']}"
    if "scenario" in about:
        yield f"SHA-256 of its scenario: {hash_of(about['scenario'])}"
    space = solution.problem.views.space
    if space is not None and space.chosen:
        yield space.chosen
    yield (
        "The model flies in inertial axes that are those of the body at the begin of the flight. Axes of the body in "
        f"the ICRF at that time: {told_orientation(body, epoch)}."
    )
    yield f"Hermite interpolation of degree 3 between two lines loses at most {1e3 * lost:.1g} mm."
    yield "Times are the epoch and the seconds of the model: no leap second is put in."


def _comments(texts: Iterator[str]) -> Iterator[str]:
    """Comments in lines of letters that the standard knows."""
    for text in texts:
        line = "COMMENT"
        for word in _plain(text).split():
            if len(line) + len(word) >= _WIDTH:
                yield line
                line = "COMMENT"
            line += f" {word}"
        yield line


def _plain(text: str) -> str:
    """One line of letters that the standard knows: names are those of who stated the problem."""
    return one_line(text.replace("Δ", "Delta "), most=10_000).encode("ascii", "replace").decode()


def _segment(leg: Leg, name: str, body: str, epoch: datetime) -> list[str]:
    kilometres = zip(*(leg.position / 1e3).tolist(), *(leg.velocity / 1e3).tolist(), strict=True)
    stamps = [stamp(epoch, float(t)) for t in leg.time]
    # Two times nearer than a nanosecond are one here.
    rows = dict(zip(stamps, kilometres, strict=True))
    return [
        "META_START", f"COMMENT phase {_plain(leg.phase)}", f"OBJECT_NAME = {_plain(name)[:_NAMED]}",
        "OBJECT_ID = UNKNOWN", f"CENTER_NAME = {body.upper()}", "REF_FRAME = ICRF", "TIME_SYSTEM = UTC",
        f"START_TIME = {stamps[0]}", f"STOP_TIME = {stamps[-1]}",
        "INTERPOLATION = HERMITE", "INTERPOLATION_DEGREE = 3", "META_STOP", "",
        *(" ".join([at, *map(repr, row)]) for at, row in rows.items()), "",
    ]  # fmt: skip
