"""Export to Cesium: CZML with position, attitude and thrust against time, in axes that turn with the body.

Cesium takes ``FIXED`` for the axes of the globe that it shows, which by default is the Earth. Its ``INERTIAL`` is that
of the Earth alone, and is not used here. The vehicle is a point in the model: its attitude here is that its z axis lies
along the thrust, turned about it no more than it must be, x forward at first. Without thrust there is none: Cesium
turns it from one burn to the next.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector
from perilune.io.atomic_files import json_text
from perilune.io.exports.epochs import stamp
from perilune.io.exports.inertial_path import JUMP, InertialLeg, legs, separate_jumps, space_of
from perilune.problem import Solution

NAME = "CZML"
_LONGEST = 0.05  # of the way, the longest arrow of thrust
_TURNED = np.radians(0.1)  # that attitudes and arrows are off; Cesium takes those less than 0.003 rad apart for one
_AXES = "body-fixed axes (FIXED); at the start of the flight they coincide with the model's inertial axes"
_PLAYED = 60.0  # s, that a flight takes when it is played


def write_czml(solution: Solution, about: Mapping[str, str], epoch: datetime, path: Path) -> None:
    """Write a flight as CZML.

    Parameters
    ----------
    solution
        The solution.
    about
        Texts on its origin (`perilune.io.exports.provenance`).
    epoch
        UTC at the begin of the flight.
    path
        File to write.

    Raises
    ------
    PeriluneError
        If the problem is nowhere in space.
    """
    space = space_of(solution, NAME)
    rate = float(getattr(solution.parameters, space.rotation)) if space.rotation else 0.0
    flown = [leg.turning(rate) for leg in legs(solution, _TURNED / 4)]
    path.write_text(json_text(_czml_document(flown, about, epoch)), encoding="utf-8")


def _czml_document(flown: list[InertialLeg], about: Mapping[str, str], epoch: datetime) -> list[dict[str, Any]]:
    def utc(seconds: float) -> str:
        return f"{stamp(epoch, seconds)}Z"

    flight = join_legs(flown)
    begin, end = float(flight.time[0]), float(flight.time[-1])
    whole = f"{utc(begin)}/{utc(end)}"
    head = {
        "id": "document", "name": about["title"], "version": "1.0",
        "clock": {
            "interval": whole, "currentTime": utc(begin), "multiplier": max(1.0, round((end - begin) / _PLAYED)),
            "range": "LOOP_STOP", "step": "SYSTEM_CLOCK_MULTIPLIER",
        },
    }  # fmt: skip
    held = {"forwardExtrapolationType": "HOLD", "backwardExtrapolationType": "HOLD"}
    # Cesium's clock ends up to a nanosecond later than the samples; with velocities it holds a wrong one of them.
    sampled: dict[str, Any] = {
        "epoch": utc(0.0), "referenceFrame": "FIXED", "forwardExtrapolationType": "EXTRAPOLATE",
        "forwardExtrapolationDuration": 1e-3,
    }  # fmt: skip
    curved = {"interpolationAlgorithm": "HERMITE", "interpolationDegree": 3}
    vehicle: dict[str, Any] = {
        "id": "vehicle",
        "name": about["title"],
        "description": _description(about),
        "availability": whole,
        "position": {
            **sampled,
            **curved,
            "cartesianVelocity": _interleaved_samples(flight.time, flight.position, flight.velocity),
        },
        "path": {"width": 2, "material": _colour(0, 114, 178), "resolution": (end - begin) / 600},
        "point": {"pixelSize": 8, "color": {"rgba": [255, 255, 255, 255]}},
    }
    if not flight.powered:
        return [head, vehicle]
    most = float(np.linalg.norm(flight.push, axis=0).max())
    stretch = _LONGEST * float(np.linalg.norm(np.ptp(flight.position, axis=1))) / most
    tip_at, tip_velocity = flight.position + stretch * flight.push, flight.velocity + stretch * flight.push_rate
    vehicle["orientation"] = {"epoch": utc(0.0), **held, "unitQuaternion": attitudes(flight)}
    tip = {
        "id": "thrust",
        "name": "thrust",
        "availability": whole,
        "parent": "vehicle",
        "description": f"An arrow along the thrust acceleration, {stretch:.6g} m long for each m/s^2.",
        "position": {**sampled, **curved, "cartesianVelocity": _interleaved_samples(flight.time, tip_at, tip_velocity)},
        "polyline": {
            "positions": {"references": ["vehicle#position", "thrust#position"]},
            "width": 6,
            "arcType": "NONE",
            "material": {"polylineArrow": {"color": {"rgba": [213, 94, 0, 255]}}},
            "show": [
                {"interval": f"{utc(float(leg.time[0]))}/{utc(float(leg.time[-1]))}", "boolean": leg.powered}
                for leg in flown
            ],
        },
    }
    return [head, vehicle, tip]


def _description(about: Mapping[str, str]) -> str:
    about = {**about, "frame": ": ".join(filter(None, (_AXES, about.get("frame"))))}
    words = ("source", "method", "proof", "objective", "results", "body", "frame", "chosen", "scenario")
    return "".join(f"<h3>{name}</h3><pre>{escape(about[name])}</pre>" for name in words if name in about)


def _colour(*rgb: int) -> dict[str, Any]:
    return {"solidColor": {"color": {"rgba": [*rgb, 255]}}}


def join_legs(flown: list[InertialLeg]) -> InertialLeg:
    """Join legs into one flight with one sample of each time; about a jump the last, and the first before it."""
    time = np.concatenate([leg.time for leg in flown])
    told, kept = separate_jumps(time)
    found = {
        name: np.concatenate([getattr(leg, name) for leg in flown], axis=1)[:, kept]
        for name in ("position", "velocity", "push", "push_rate")
    }
    found["position"] -= (time - told)[kept] * found["velocity"]
    return replace(flown[0], time=told[kept], **found)


def _interleaved_samples(time: Vector, *values: Matrix) -> list[float]:
    """Interleave time and values of each sample in one list."""
    return np.concatenate([time[None], *values]).T.ravel().tolist()


def _smooth(time: Vector) -> list[np.ndarray]:
    """Return the numbers of the samples from one jump to the next, for each smooth part."""
    return np.split(np.arange(len(time)), np.flatnonzero(np.diff(time) < 1.5 * JUMP) + 1)


def attitudes(flight: InertialLeg) -> list[float]:
    """Return time and quaternion (x, y, z, w) from the axes of the vehicle to those of the body, for each sample."""
    size = np.linalg.norm(flight.push, axis=0)
    x, before, last, rows = flight.velocity[:, np.argmax(size > 0)], None, np.zeros(4), []
    for part in _smooth(flight.time):
        on = part[size[part] > 0]
        time, along = flight.time[on], (flight.push[:, on] / size[on]).T
        for i in _thinned(time, along) if len(on) else ():
            z = along[i]
            x = _perpendicular_unit(x if before is None else _parallel_transport(x, before, z), z)
            quaternion = _quaternion(np.column_stack([x, np.cross(z, x), z]))
            before, last = z, quaternion if quaternion @ last >= 0 else -quaternion
            rows += [float(time[i]), *last.tolist()]
    return rows


def _thinned(time: Vector, along: Matrix) -> list[int]:
    """Select directions (n, 3) between which an even turn is nowhere off by more than half of `_TURNED`."""
    kept, spans = {0, len(time) - 1}, [(0, len(time) - 1)]
    while spans:
        a, b = spans.pop()
        if b <= a + 1:
            continue
        part = ((time[a + 1 : b] - time[a]) / (time[b] - time[a]))[:, None]
        half_turns = _angle_between(along[a], along[b]) / np.pi
        met = (1 - part) * np.sinc((1 - part) * half_turns) * along[a] + part * np.sinc(part * half_turns) * along[b]
        length = np.maximum(np.linalg.norm(met, axis=1), np.finfo(float).tiny)  # half-way to the opposite it is none
        off = _angle_between(met / length[:, None], along[a + 1 : b])
        if off.max() > 0.5 * _TURNED:
            worst = a + 1 + int(np.argmax(off))
            kept.add(worst)
            spans += [(a, worst), (worst, b)]
    return sorted(kept)


def _angle_between(one: np.ndarray, other: np.ndarray) -> Any:
    """Return the angle between unit vectors along the last axis of both [rad]."""
    return 2 * np.arcsin(np.minimum(1.0, 0.5 * np.linalg.norm(one - other, axis=-1)))


def _parallel_transport(vector: Vector, before: Vector, behind: Vector) -> Vector:
    """Rotate a vector by the smallest rotation that brings one direction to another."""
    axis, cosine = np.cross(before, behind), before @ behind
    if cosine < 1e-9 - 1:  # about any axis, that of the vector too
        return vector
    across = np.cross(axis, vector)
    return vector + across + np.cross(axis, across) / (1 + cosine)


def _perpendicular_unit(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the unit vector at right angles to an axis that is nearest to a vector."""
    axis = axis / np.linalg.norm(axis)
    for start in (vector, np.eye(3)[np.argmin(np.abs(axis))]):
        found = start - (start @ axis) * axis
        if np.linalg.norm(found) > 1e-6 * np.linalg.norm(start):
            break
    return found / np.linalg.norm(found)


def _quaternion(matrix: Matrix) -> np.ndarray:
    """Return the quaternion (x, y, z, w) of a rotation, computed from its largest component."""
    trace = np.trace(matrix)
    squares = np.array([*(1 + 2 * np.diag(matrix) - trace), 1 + trace])
    k = int(np.argmax(squares))
    m = matrix
    odd = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    if k == 3:
        found = np.array([*odd, squares[3]])
    else:
        found = np.array([*(m[k] + m[:, k]), odd[k]])
        found[k] = squares[k]
    return found / np.linalg.norm(found)
