"""Orbit ephemeris message (CCSDS 502.0-B-2, OEM version 2.0, in its keyword form), one segment for each phase.

Positions and velocities stand in the axes of the ICRF, from the centre of the body, times in UTC. From the model's own
axes they come by the orientation of the body at the begin of the flight (`perilune.models.physics.orientation`); how
well that is known stands in a comment, as does what the model left open. The format has no place for mass and thrust: a
comment of each segment says how far they go, and their histories are in the tables of the other formats.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from perilune.core import PeriluneError, one_line
from perilune.io.columns import node_times
from perilune.io.exports.epochs import TICK, leap_seconds_sentence, stamp_of_tick
from perilune.io.exports.inertial_path import InertialLeg, legs, space_of
from perilune.io.exports.orientation import axes_in_space, describe_orientation
from perilune.io.format import hash_of
from perilune.problem import Solution

_WIDTH = 200  # the standard allows 254 characters
_NAMED = 80  # of them for the name of the object
UNNAMED = "UNKNOWN"  # as the standard has it, where there is no designator
NAME = "an orbit ephemeris message (OEM)"


def write_oem(
    solution: Solution,
    about: Mapping[str, str],
    epoch: datetime,
    path: Path,
    object_name: str | None = None,
    object_id: str | None = None,
) -> None:
    """Write a flight as an orbit ephemeris message.

    Parameters
    ----------
    solution, about, epoch, path
        What is written, words about it, UTC at its begin, and the file.
    object_name, object_id
        As `require_object_name` allows; the name of the problem and `UNNAMED` if None.

    Raises
    ------
    PeriluneError
        If the problem is nowhere in space, or the orientation of its body is not known.
    """
    body = space_of(solution, NAME).body.lower()
    matrix = axes_in_space(body, epoch)
    flown = [leg.turned(matrix) for leg in legs(solution, tick=TICK)]
    called = object_name or _ascii_line(solution.problem.name)[:_NAMED], object_id or UNNAMED
    lines = [
        "CCSDS_OEM_VERS = 2.0",
        *_comments(_header_comments(solution, about, body, epoch, max(leg.lost for leg in flown))),
    ]
    lines += [f"CREATION_DATE = {datetime.now(UTC):%Y-%m-%dT%H:%M:%S}", "ORIGINATOR = PERILUNE", ""]
    for leg in flown:
        lines += _segment(leg, called, body, epoch, _mass_and_thrust(solution, leg.phase))
    path.write_text("\n".join(lines), encoding="ascii", newline="\n")


def require_object_name(text: str, keyword: str) -> None:
    """Refuse a text that cannot be the OBJECT_NAME or OBJECT_ID of a message.

    Parameters
    ----------
    text
        Name or designator as the user gave it.
    keyword
        "OBJECT_NAME" or "OBJECT_ID".

    Raises
    ------
    PeriluneError
        If it is not a line of 1 to 80 printable ASCII characters, without blanks at its ends.
    """
    fits = isinstance(text, str) and 0 < len(text) <= _NAMED and text.isascii() and text.isprintable()
    if not fits or text != text.strip():
        raise PeriluneError(
            f"this is not a valid {keyword} of {NAME}", got=repr(text)[:_NAMED],
            expected=f"1 to {_NAMED} printable ASCII characters, as "
            + ("'LANDER 1'" if keyword == "OBJECT_NAME" else "the designator '2030-001A'"),
            advice="leave it out for the name of the problem" if keyword == "OBJECT_NAME" else f"or {UNNAMED}",
        )  # fmt: skip


def _header_comments(
    solution: Solution, about: Mapping[str, str], body: str, epoch: datetime, lost: float
) -> Iterator[str]:
    yield about["title"]
    yield about["source"]
    yield f"method {about['method']}; proof: {about['proof']}; J = {about['objective']}"
    if "scenario" in about:
        yield f"SHA-256 of its scenario: {hash_of(about['scenario'])}"
    space = solution.problem.views.space
    if space is not None and space.chosen:
        yield space.chosen
    yield (
        "The model uses inertial axes that coincide with those of the body at the start of the flight. Axes of the"
        " body in "
        f"the ICRF at that time: {describe_orientation(body, epoch)}."
    )
    yield f"Hermite interpolation of degree 3 between two lines loses at most {1e3 * lost:.1g} mm."
    yield f"Times are UTC, to a microsecond. {leap_seconds_sentence(epoch, solution.duration)}"


def _mass_and_thrust(solution: Solution, name: str) -> list[str]:
    """Return a comment on mass and thrust, which the format lacks, if one state of the phase is a mass [kg]."""
    k = [phase.name for phase in solution.problem.phases].index(name)
    masses = [i for i, state in enumerate(solution.problem.phases[k].states) if state.unit == "kg"]
    if len(masses) != 1:
        return []
    trajectory = solution.trajectories[k]
    t = node_times(trajectory)
    mass = solution.evaluate(k, t)[0][masses[0]]
    thrust = mass * np.linalg.norm(solution.inertial(k, t)[2], axis=0)
    pushed = f"thrust from {thrust.min():.6g} to {thrust.max():.6g} N" if thrust.any() else "no thrust"
    text = f"mass {mass[0]:.6f} kg at the start and {mass[-1]:.6f} kg at the end of the phase, {pushed}"
    return list(_comments(iter([text])))


def _comments(texts: Iterator[str]) -> Iterator[str]:
    """Yield comments in lines of the standard's characters."""
    for text in texts:
        line = "COMMENT"
        for word in _ascii_line(text).split():
            if len(line) + len(word) >= _WIDTH:
                yield line
                line = "COMMENT"
            line += f" {word}"
        yield line


def _ascii_line(text: str) -> str:
    """Return a text as one line of the standard's characters, as names may have any."""
    return one_line(text.replace("Δ", "Delta "), most=10_000).encode("ascii", "replace").decode()


def _segment(leg: InertialLeg, called: tuple[str, str], body: str, epoch: datetime, remarks: list[str]) -> list[str]:
    rows = zip(*(leg.position / 1e3).tolist(), *(leg.velocity / 1e3).tolist(), strict=True)
    stamps = [stamp_of_tick(epoch, float(t)) for t in leg.time]
    return [
        "META_START", f"COMMENT phase {_ascii_line(leg.phase)}", *remarks, f"OBJECT_NAME = {called[0]}",
        f"OBJECT_ID = {called[1]}", f"CENTER_NAME = {body.upper()}", "REF_FRAME = ICRF", "TIME_SYSTEM = UTC",
        f"START_TIME = {stamps[0]}", f"STOP_TIME = {stamps[-1]}",
        "INTERPOLATION = HERMITE", "INTERPOLATION_DEGREE = 3", "META_STOP", "",
        *(" ".join([at, *map(repr, row)]) for at, row in zip(stamps, rows, strict=True)), "",
    ]  # fmt: skip
