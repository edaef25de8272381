"""A flight for Cesium: CZML with position, attitude and thrust against time, in axes that turn with the body.

Cesium takes ``FIXED`` for the axes of the globe that it shows, which by default is the Earth. Its ``INERTIAL`` is that
of the Earth alone, and is not used here. The vehicle is a point in the model: its attitude here is that its z axis lies
along the thrust, turned about it no more than it must be, x forward at first. Without thrust there is none: Cesium
turns it from one burn to the next.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from perilune.io.exports.epochs import stamp
from perilune.io.exports.path import Leg, legs, space_of
from perilune.io.files import json_text
from perilune.problem.solution import Solution
from perilune.words.types import Matrix

NAME = "CZML"
_LONGEST = 0.05  # of the way, the longest arrow of thrust
_TURNED = 0.02  # rad; Cesium takes attitudes that are less than 0.003 rad apart for one
_PLAYED = 60.0  # s, that a flight takes when it is played


def write_czml(solution: Solution, about: Mapping[str, str], epoch: datetime, path: Path) -> None:
    """Write the document.

    Raises
    ------
    PeriluneError
        If the problem is nowhere in space.
    """
    space = space_of(solution, NAME)
    rate = float(getattr(solution.parameters, space.rotation)) if space.rotation else 0.0
    flown = [leg.turning(rate) for leg in legs(solution)]
    path.write_text(json_text(_document(flown, about, epoch)), encoding="utf-8")


def _document(flown: list[Leg], about: Mapping[str, str], epoch: datetime) -> list[dict[str, Any]]:
    def utc(seconds: float) -> str:
        return f"{stamp(epoch, seconds)}Z"

    begin, end = float(flown[0].time[0]), float(flown[-1].time[-1])
    whole = f"{utc(begin)}/{utc(end)}"
    powered = [leg for leg in flown if leg.powered]
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
        "id": "vehicle", "name": about["title"], "description": _description(about), "availability": whole,
        "position": {**sampled, **curved, "cartesianVelocity": _rows(flown, "position", "velocity")},
        "path": {"width": 2, "material": _colour(0, 114, 178), "resolution": (end - begin) / 600},
        "point": {"pixelSize": 8, "color": {"rgba": [255, 255, 255, 255]}},
    }  # fmt: skip
    if not powered:
        return [head, vehicle]
    way = np.concatenate([leg.position for leg in flown], axis=1)
    most = max(float(np.linalg.norm(leg.push, axis=0).max()) for leg in powered)
    stretch = _LONGEST * float(np.linalg.norm(np.ptp(way, axis=1))) / most
    vehicle["orientation"] = {"epoch": utc(0.0), **held, "unitQuaternion": _attitudes(powered)}
    tip = {
        "id": "thrust", "name": "thrust", "availability": whole, "parent": "vehicle",
        "description": f"An arrow along the acceleration by thrust, {stretch:.6g} m long for each m/s^2.",
        "position": {**sampled, "cartesian": _rows(flown, "position", stretch=stretch)},
        "polyline": {
            "positions": {"references": ["vehicle#position", "thrust#position"]}, "width": 6, "arcType": "NONE",
            "material": {"polylineArrow": {"color": {"rgba": [213, 94, 0, 255]}}},
            "show": [
                {"interval": f"{utc(float(leg.time[0]))}/{utc(float(leg.time[-1]))}", "boolean": leg.powered}
                for leg in flown
            ],
        },
    }  # fmt: skip
    return [head, vehicle, tip]


def _description(about: Mapping[str, str]) -> str:
    words = ("source", "method", "proof", "objective", "results", "body", "frame", "chosen", "scenario")
    return "".join(f"<h3>{name}</h3><pre>{escape(about[name])}</pre>" for name in words if name in about)


def _colour(*rgb: int) -> dict[str, Any]:
    return {"solidColor": {"color": {"rgba": [*rgb, 255]}}}


def _rows(flown: list[Leg], *names: str, stretch: float = 0.0) -> list[float]:
    """Time and values of each sample, one behind the other; where a leg begins it is the end of the one before."""
    parts = []
    for number, leg in enumerate(flown):
        values = [getattr(leg, name) for name in names]
        values[0] = values[0] + stretch * leg.push
        row = np.concatenate([leg.time[None], *values])
        # At a time that two legs share the later leg's is kept: Cesium has one sample of each time.
        parts.append(row if number == len(flown) - 1 else row[:, :-1])
    return np.concatenate(parts, axis=1).T.ravel().tolist()


def _attitudes(powered: list[Leg]) -> list[float]:
    """Time and quaternion (x, y, z, w) from the axes of the vehicle to those of the body, of each sample."""
    time = np.concatenate([leg.time for leg in powered])
    push = np.concatenate([leg.push for leg in powered], axis=1).T
    velocity = powered[0].velocity[:, 0]
    on = np.concatenate([np.diff(time) > 0, [True]]) & (np.linalg.norm(push, axis=1) > 0)
    time, along = time[on], push[on] / np.linalg.norm(push[on], axis=1)[:, None]
    x, last, rows = _beside(velocity, along[0]), np.zeros(4), []
    for i in _thinned(along):
        z = along[i]
        x = _beside(x, z)
        quaternion = _quaternion(np.column_stack([x, np.cross(z, x), z]))
        last = quaternion if quaternion @ last >= 0 else -quaternion
        rows += [float(time[i]), *last.tolist()]
    return rows


def _thinned(along: np.ndarray) -> list[int]:
    """Numbers of those directions that are further than `_TURNED` from each other, with both sides of every jump."""
    found = [0]
    for i in range(1, len(along)):
        if i == len(along) - 1 or _angle(along[found[-1]], along[i]) > _TURNED:
            if found[-1] < i - 1 and _angle(along[i - 1], along[i]) > 0.5 * _TURNED:
                found.append(i - 1)
            found.append(i)
    return found


def _angle(one: np.ndarray, other: np.ndarray) -> float:
    return 2 * np.arcsin(min(1.0, 0.5 * float(np.linalg.norm(one - other))))


def _beside(vector: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Unit vector at right angles to an axis, as near to a vector as can be."""
    axis = axis / np.linalg.norm(axis)
    for start in (vector, np.eye(3)[np.argmin(np.abs(axis))]):
        found = start - (start @ axis) * axis
        if np.linalg.norm(found) > 1e-6 * np.linalg.norm(start):
            break
    return found / np.linalg.norm(found)


def _quaternion(matrix: Matrix) -> np.ndarray:
    """Quaternion (x, y, z, w) of a rotation, by its largest component."""
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
