"""The global optimum of the ordinary landing of Cho et al. as a theorem: every other extremal direction excluded.

``python benchmarks/global_optimum.py FOLDER [--seconds CPU]`` covers the sphere of costates at the start by boxes, and
keeps in FOLDER how far it is: stopped at any time, it goes on from there. docs/theory-rigorous.md says what it proves.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from doubles import Doubles, joined
from lanes import Bundle, Equations, Moved, step
from perilune import solve
from perilune.rigorous.theorem import attempt_proof
from perilune.scenario import load_file
from viable import Viable

ORDINARY = Path(__file__).parent.parent / "examples" / "ordinary_lander.toml"
STEPS, HALVED, ORDER, LANES = 100, 12, 5, 2000
_LATER = 2e-3  # s: so much longer than the known flight the others are flown
_ROOT, _ROOT_STEPS = 0.0005, 300  # half of the side of the known flight's box, and into how many steps it is flown
_NEAR = 1e-6  # how near to the answer the theorem has to be
_SLOW = 2.0**-10  # 1/s: costates of r are so many times those of velocities, that boxes are about round
_FIRST = 4  # the faces of the cube are halved so often before anything is flown
_LOST = (4e5, 6e2, 6e2)  # a box whose r, u, v are as uncertain as that is split without flying on [m, m/s, m/s]
_SAVED = 20.0  # s
_UNEVEN = 2  # so many times more than the other is one side halved at most, but for the next


def grid(latest: float, steps: int, halved: int) -> list[float]:
    """Lengths of steps: equal ones, but the last is halved so often."""
    h = latest / steps
    return [h] * (steps - 1) + [h / 2**k for k in range(1, halved + 1)] + [h / 2**halved]


def centres(boxes: Any) -> tuple[Any, Any]:
    """Middles and half widths (lanes, 2) on the faces of boxes (face, halvings, halvings, place, place)."""
    half = 0.5 ** boxes[:, 1:3]
    return (2 * boxes[:, 3:5] + 1) * half - 1, half


def measures(boxes: Any) -> Any:
    """Which part of the cube's surface each box is."""
    return 0.5 ** (boxes[:, 1] + boxes[:, 2]) / 6


def started(equations: Equations, faces: Any, middle: Any, half: Any) -> Bundle:
    """Flights from boxes on the cube: `faces` 0 to 5 are +r, -r, +u, -u, +v, -v."""
    lanes = np.arange(len(faces))
    n, count = len(equations.places), equations.count
    fixed = faces // 2
    axes = np.array([[1, 2], [0, 2], [0, 1]])[fixed]
    scale = np.array([_SLOW, 1.0, 1.0])
    costates = np.zeros((len(faces), 3))
    costates[lanes, fixed] = 1.0 - 2 * (faces % 2)
    costates[lanes, axes[:, 0]], costates[lanes, axes[:, 1]] = middle[:, 0], middle[:, 1]
    none = np.zeros(len(faces))
    columns = []
    for j in range(2):
        own = np.zeros((len(faces), 3))
        own[lanes, axes[:, j]] = half[:, j]
        columns.append([Doubles(x.copy(), none.copy()) for x in [none] * count + list((own * scale).T)])
    off = [Doubles(none.copy(), none + s.r) for s in equations.start] + [Doubles(none.copy(), none.copy())] * 3
    centre = [none + s.c for s in equations.start] + list((costates * scale).T.copy())
    assert len(centre) == n
    return Bundle(centre=centre, columns=columns, off=off)


def _through_end(equations: Equations, v: list[Doubles]) -> list[Doubles]:
    """The derivative of the end conditions applied to a vector."""
    rows = equations.end_slopes
    return [sum((v[j] * row[j] for j in range(len(row)) if row[j]), Doubles(np.zeros_like(v[0].c))) for row in rows]


def _inverse(columns: Sequence[list[Doubles]]) -> Any:
    """Rows of the inverse of the matrix with these columns, in lanes (lanes, 3, 3); inf where there is none."""
    a, b, c = (np.stack([x.c for x in v], axis=1) for v in columns)
    with np.errstate(all="ignore"):
        determinant = (a * np.cross(b, c)).sum(axis=1)
        return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1) / determinant[:, None, None]


def touches(equations: Equations, bundle: Bundle, moved: Moved, length: float) -> Any:
    """In which lanes an end condition may be met during a step."""
    psi = equations.end.values(moved.tube[: equations.count])
    clear = np.any([x.excludes(0.0) for x in psi], axis=0)
    near = np.flatnonzero(~clear)
    if len(near):
        clear[near] = _beside(equations, bundle.taken(near), [f[near] for f in moved.rates], length)
    return ~clear


def _beside(equations: Equations, bundle: Bundle, rates: list[Doubles], length: float) -> Any:
    """Lanes that pass beside the end: x = c + V d + off + f s, with d and s solved for at the centre."""
    off = bundle.off[: equations.count]
    there = equations.end.values([w + c for w, c in zip(off, bundle.centre, strict=False)])
    columns = [_through_end(equations, v) for v in bundle.columns]
    f = _through_end(equations, rates)
    inverse = _inverse([*columns, f])
    span, clear = Doubles(0.5 * length, 0.5 * length), np.zeros(len(off[0].c), bool)
    for i in range(3):
        weights = [inverse[:, i, k] for k in range(3)]

        def weighed(v: list[Doubles], weights: Any = weights) -> Doubles:
            return sum((x * w for x, w in zip(v, weights, strict=True)), Doubles(np.zeros_like(weights[0])))

        reach = sum(weighed(v).size for v in columns)
        with np.errstate(all="ignore"):
            clear |= (weighed(there) + weighed(f) * span).wider(reach).excludes(0.0)
    return clear


@dataclass
class Flown:
    """What became of boxes: at which step each was excluded (-1: it was not), and along which side to halve it."""

    excluded: Any
    side: Any


def fly(equations: Equations, viable: Viable, boxes: Any, lengths: list[float], order: int = ORDER) -> Flown:
    """Fly boxes until each is excluded or in doubt."""
    middle, half = centres(boxes)
    bundle = started(equations, boxes[:, 0], middle, half)
    excluded = np.full(len(boxes), -1)
    side = np.where(boxes[:, 1] > boxes[:, 2], 1, 0)
    lanes, t = np.arange(len(boxes)), 0.0
    scale = 1 / np.array(_LOST)
    for k, length in enumerate(lengths):
        out = viable.excludes(bundle.hull, t)
        excluded[lanes[out]] = k
        lanes, bundle = lanes[~out], bundle.taken(~out)
        if not len(lanes):
            break
        moved = step(equations, bundle, length, order)
        with np.errstate(invalid="ignore"):
            wide = ~np.all([z.r < most for z, most in zip(moved.end.hull, _LOST, strict=False)], axis=0)
            doubt = wide | touches(equations, bundle, moved, length)
        if doubt.any():
            # What the columns were when the step began is a number; where they are gone, the longer side is halved.
            reach = [sum(v[i].size[doubt] * scale[i] for i in range(3)) for v in bundle.columns]
            wanted = np.where(reach[0] + reach[1] > 0, reach[1] > reach[0], side[lanes[doubt]])
            uneven = boxes[lanes[doubt], 1] - boxes[lanes[doubt], 2]
            side[lanes[doubt]] = np.where(np.abs(uneven) > _UNEVEN, uneven > 0, wanted)
        lanes, bundle, t = lanes[~doubt], moved.end.taken(~doubt), t + length
    else:
        excluded[lanes] = len(lengths)
    return Flown(excluded=excluded, side=side)


@dataclass(frozen=True)
class Root:
    """The box in which one flight touches down, and no other."""

    face: int
    middle: tuple[float, float]
    half: float
    begin: float
    contraction: float

    def holds(self, boxes: Any) -> Any:
        """Which boxes lie in it."""
        middle, half = centres(boxes)
        inside = np.abs(middle - np.array(self.middle)) + half < self.half * (1 - 1e-9)
        return (boxes[:, 0] == self.face) & inside.all(axis=1)


def one_root(
    equations: Equations, face: int, middle: tuple[float, float], half: float, latest: float, steps: int
) -> Root:
    """A box in which directions and times of touchdown by the latest time are one at most.

    (d, s) -> end conditions has the derivative [V, f]; if for one matrix C all of 1 - C [V, f] over the box and all
    times from the first at which touchdown is not excluded are smaller than 1, it is one to one.
    """
    lengths = grid(latest, steps, HALVED)
    bundle = started(equations, np.array([face]), np.array([middle]), np.array([[half, half]]))
    t, begin, hull = 0.0, None, list[list[Doubles]]()
    for length in lengths:
        moved = step(equations, bundle, length, ORDER)
        if begin is None and touches(equations, bundle, moved, length)[0]:
            begin = t
        if begin is not None:
            # In time by the length of what is left, so that both directions and time run over a unit.
            own = [_through_end(equations, v) for v in (*moved.columns, moved.rates)]
            pairs = zip(hull or own, own, strict=True)
            hull = [[joined(a, b) for a, b in zip(x, y, strict=True)] for x, y in pairs]
        bundle, t = moved.end, t + length
    if begin is None:
        raise SystemExit("the known flight does not touch down in its own box: an error of this program")
    hull[2] = [x * (latest - begin) for x in hull[2]]
    inverse = _inverse(hull)[0]
    rests = []
    for i, row in enumerate(inverse):
        products = [sum((x * c for x, c in zip(v, row, strict=True)), Doubles(np.zeros(1))) for v in hull]
        rests.append(float(sum((p - float(i == j)).size[0] for j, p in enumerate(products))))
    # Not Python's max: what is not a number has to stay so.
    return Root(face=face, middle=middle, half=half, begin=begin, contraction=float(np.max(rests)))


@dataclass
class Cover:
    """Boxes that are open, and what became of the others."""

    boxes: Any
    flown: int = 0
    excluded: float = 0.0
    rooted: float = 0.0
    seconds: float = 0.0

    @classmethod
    def whole(cls) -> Cover:
        """The surface of the cube."""
        places = np.arange(2**_FIRST)
        faces, a, b = (x.ravel() for x in np.meshgrid(np.arange(6), places, places, indexing="ij"))
        halvings = np.full_like(faces, _FIRST)
        return cls(np.stack([faces, halvings, halvings, a, b], axis=1))

    @classmethod
    def read(cls, file: Path, told: str) -> Cover:
        """As it was saved for the same problem."""
        if not file.exists():
            return cls.whole()
        with np.load(file) as kept:
            if str(kept["told"]) != told:
                raise SystemExit(f"{file} covers another problem, or with other settings: {kept['told']}")
            return cls(kept["boxes"], int(kept["flown"]), *(float(kept[x]) for x in ("excluded", "rooted", "seconds")))

    def save(self, file: Path, told: str) -> None:
        """Whole, or as it was before."""
        beside = file.with_suffix(".part")
        with beside.open("wb") as f:
            np.savez(f, told=np.array(told), **vars(self))
        os.replace(beside, file)

    def next(self) -> Any:
        """The largest boxes first."""
        return np.argsort(self.boxes[:, 1:3].sum(axis=1), kind="stable")[:LANES]

    def flew(self, taken: Any, flown: Flown, root: Root) -> None:
        """Close what is excluded or in the box of the root, and halve the rest."""
        boxes = self.boxes[taken]
        out = flown.excluded >= 0
        held = ~out & root.holds(boxes)
        rest = ~out & ~held
        left, side = boxes[rest], flown.side[rest]
        lanes = np.arange(len(left))
        left[lanes, 1 + side] += 1
        left[lanes, 3 + side] *= 2
        other = left.copy()
        other[lanes, 3 + side] += 1
        self.boxes = np.concatenate([np.delete(self.boxes, taken, axis=0), left, other])
        self.flown += len(boxes)
        self.excluded += float(measures(boxes[out]).sum())
        self.rooted += float(measures(boxes[held]).sum())

    def __str__(self) -> str:
        deepest = int(self.boxes[:, 1:3].sum(axis=1).max()) if len(self.boxes) else 0
        return (
            f"{self.seconds:7.0f} s of CPU: {self.excluded:.9f} of the directions excluded, {self.rooted:.2e} at the "
            f"known flight, {measures(self.boxes).sum():.3e} open in {len(self.boxes)} boxes, halved up to {deepest} "
            f"times; {self.flown} flown"
        )


def cover(equations: Equations, viable: Viable, root: Root, file: Path, told: str, seconds: float) -> Cover:
    """Go on until nothing is open, for so long at most."""
    found = Cover.read(file, told)
    lengths, began, saved = grid(viable.latest, STEPS, HALVED), time.process_time(), time.monotonic()
    before = found.seconds
    try:
        while len(found.boxes) and time.process_time() - began < seconds:
            taken = found.next()
            found.flew(taken, fly(equations, viable, found.boxes[taken], lengths), root)
            found.seconds = before + time.process_time() - began
            if time.monotonic() - saved > _SAVED:
                found.save(file, told)
                saved = time.monotonic()
                print(found, flush=True)
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
    found.save(file, told)
    print(found, flush=True)
    return found


def main() -> None:
    """Solve, prove that the root is alone in its box, and cover the rest."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seconds", type=float, default=np.inf, help="of CPU, at most")
    asked = parser.parse_args()
    problem = load_file(ORDINARY).problem
    equations = Equations(problem, ("phi",), ("m",))
    solution = solve(problem, verify=0)
    known = solution.trajectories[0]
    assert known.costate is not None
    latest = float(known.duration) + _LATER
    viable = Viable(problem, latest)
    costates = dict(zip(problem.phases[0].state_names, known.costate.values[0], strict=True))
    across = [float(_SLOW * costates[name] / abs(costates["r"])) for name in ("u", "v")]
    root = one_root(equations, int(costates["r"] < 0), (across[0], across[1]), _ROOT, latest, _ROOT_STEPS)
    proved = attempt_proof(solution, lambda _: None).proved
    known_there = proved and not proved.missing and proved.distance < _NEAR
    if not (root.contraction < 1 and viable.lowest > 0 and known_there):
        raise SystemExit("the known flight is not proved to be an extremal, and alone in its box")
    asked.folder.mkdir(parents=True, exist_ok=True)
    told = f"{ORDINARY.read_text()}; {latest}, {STEPS}, {HALVED}, {ORDER}, {_SLOW}; {root}"
    found = cover(equations, viable, root, asked.folder / "cover.npz", told, asked.seconds)
    if not len(found.boxes) and proved:
        print(
            f"Global optimum: J = {proved.objective.str(30)}. No flight touches down sooner; every other extremal "
            f"takes longer than {latest - 0.5 * _LATER:.6f} s. Nearest to the centre: {viable.lowest / 1000:.0f} km."
        )


if __name__ == "__main__":
    main()
