"""The cover of all extremal directions by boxes: what it encloses, what it may exclude, and how it is kept."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("flint")
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import global_optimum as go
from perilune.scenario import load_file
from viable import Viable

TIME, ACROSS = 1005.3507046156803, (0.5192659141533, -0.0696533042948)  # of the known flight, on the face +r
MU, RADIUS, TURN, THRUST, FLOW = 4902.7779e9, 1738140.0, 2.6617e-6, 440.0, 440.0 / (310 * 9.81)
LENGTHS = go.grid(TIME + 1, go.STEPS, go.HALVED)


@cache
def equations() -> go.Equations:
    return go.Equations(load_file(go.ORDINARY).problem, ("phi",), ("m",))


def viable(latest: float = TIME + 1) -> Viable:
    return Viable(load_file(go.ORDINARY).problem, latest)


def rates(t: float, z: Any) -> Any:
    """Cho et al. (2)-(5) and their costates, by hand."""
    r, u, v, pr, pu, pv = z
    push, size, w = THRUST / (300 - FLOW * t), np.hypot(pu, pv), u / r
    costates = (pu * -w * v / r + pv * (w * w - 2 * MU / r**3), pu * v / r - 2 * pv * w, -pr + pu * w)
    return np.array([v, -w * v - push * pu / size, w * u - MU / r**2 - push * pv / size, *costates])


def sampled(faces: Any, places: Any, steps: int, each: int) -> list[Any]:
    """Flights from places on the faces by the method of Runge and Kutta: states at the ends of steps."""
    lanes = np.arange(len(faces))
    axes = np.array([[1, 2], [0, 2], [0, 1]])[faces // 2]
    p = np.zeros((len(faces), 3))
    p[lanes, faces // 2] = 1.0 - 2 * (faces % 2)
    p[lanes, axes[:, 0]], p[lanes, axes[:, 1]] = places.T
    low, top = RADIUS + 15e3, RADIUS + 100e3
    one = np.ones(len(faces))
    z = np.array([low * one, np.sqrt(2 * MU * (1 / low - 1 / (low + top))) * one, 0 * one, *(p * [2.0**-10, 1, 1]).T])
    h, t, found = LENGTHS[0] / each, 0.0, []
    for _ in range(steps):
        for _ in range(each):
            a = rates(t, z)
            b = rates(t + h / 2, z + h / 2 * a)
            c = rates(t + h / 2, z + h / 2 * b)
            z, t = z + h / 6 * (a + 2 * b + 2 * c + rates(t + h, z + h * c)), t + h
        found.append(z)
    return found


def all_inside(columns: float) -> bool:
    """Whether flights from corners and middles of boxes lie in their enclosures; with columns made smaller or not."""
    # The last two: where the thrust turns over at once, and at 70 s.
    boxes = np.array([[0, 7, 7, 97, 59], [2, 6, 6, 20, 40], [5, 6, 6, 33, 3], [0, 8, 8, 128, 128], [0, 8, 8, 125, 146]])
    middle, half = go.centres(boxes)
    corners = np.array([[0, 0], [-1, -1], [1, -1], [-1, 1], [1, 1]])
    places = (middle[:, None] + half[:, None] * corners * (1 - 1e-12)).reshape(-1, 2)
    bundle, steps = go.started(equations(), boxes[:, 0], middle, half), 20
    inside = True
    for k, z in enumerate(sampled(np.repeat(boxes[:, 0], 5), places + 1e-9, steps, 20)):
        bundle = go.step(equations(), bundle, LENGTHS[k], go.ORDER).end
        bundle.columns = [[x * columns for x in v] for v in bundle.columns]
        hull = bundle.hull
        inside &= bool((np.abs(hull[3].c - 300 + FLOW * LENGTHS[0] * (k + 1)) < 1e-9).all())
        for own, ball in zip(z.reshape(6, -1, 5), [*hull[:3], *hull[4:]], strict=True):
            slack = 1e-9 * np.abs(own).max()  # of the method
            inside &= bool((np.abs(own - ball.c[:, None]) <= ball.r[:, None] + slack).all())
    return inside


def test_sampled_flights_lie_in_the_enclosures_of_their_boxes() -> None:
    assert all_inside(1.0)


def test_columns_that_are_too_small_are_seen() -> None:
    assert not all_inside(0.9)


def around_the_truth() -> Any:
    """Boxes with the known flight in them, from an eighth of a face to a millionth of it."""
    rows = []
    for k in (5, 11, 20):
        rows.append([0, k, k, *(int((x + 1) / 2 * 2**k) for x in ACROSS)])
    return np.array(rows)


class Recorded(Viable):
    """With what it was asked."""

    asked: list[Any]

    def excludes(self, z: Any, t: float) -> Any:
        self.asked.append((z, t))
        return super().excludes(z, t)


@cache
def flown_with_the_truth() -> tuple[Any, Recorded]:
    recorded = Recorded(load_file(go.ORDINARY).problem, TIME + 1)
    recorded.asked = []
    return go.fly(equations(), recorded, around_the_truth(), LENGTHS), recorded


def test_the_box_of_the_known_flight_is_never_excluded() -> None:
    flown, recorded = flown_with_the_truth()
    assert (flown.excluded == -1).all()
    assert recorded.asked[-1][1] > TIME - 1  # until it touches down


@pytest.mark.parametrize(("name", "part"), [("speeds", 0.4), ("depths", 0.1), ("impulses", 0.7)])
def test_a_bound_that_is_too_tight_is_seen(name: str, part: float) -> None:
    tight = viable()
    if name == "impulses":
        impulse = tight.impulse
        tight.impulse = lambda t: part * impulse(t)
    else:
        setattr(tight, name, getattr(tight, name) * part)
    assert any(tight.excludes(z, t).any() for z, t in flown_with_the_truth()[1].asked)


def test_no_flight_in_time_comes_near_the_centre() -> None:
    assert 0.4 * RADIUS < viable().lowest < RADIUS


def test_what_is_not_closed_is_halved_and_kept(tmp_path: Path) -> None:
    cover = go.Cover.whole()
    assert go.measures(cover.boxes).sum() == pytest.approx(1, abs=1e-15)
    count = len(cover.boxes)
    root = go.Root(face=0, middle=(0.0625, 0.0625), half=0.0626, begin=0.0, contraction=0.0)
    taken = cover.next()
    excluded = np.where(np.arange(count) % 3 == 0, 5, -1)
    flown = go.Flown(excluded=excluded, side=np.arange(count) % 2)
    cover.flew(taken, flown, root)
    total = cover.excluded + cover.rooted + go.measures(cover.boxes).sum()
    assert total == pytest.approx(1, abs=1e-14)
    assert cover.rooted > 0
    cover.save(tmp_path / "cover.npz", "this")
    again = go.Cover.read(tmp_path / "cover.npz", "this")
    assert np.array_equal(again.boxes, cover.boxes)
    assert (again.flown, again.excluded, again.rooted) == (cover.flown, cover.excluded, cover.rooted)
    with pytest.raises(SystemExit, match="another problem"):
        go.Cover.read(tmp_path / "cover.npz", "that")
