"""Reader of an atlas: its header, its charts, and the blocks that were read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cached_property
from numbers import Integral
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.hermite import interpolated_at
from perilune.atlas.query.minimum_search import MinimumSearch
from perilune.atlas.region import Region
from perilune.atlas.store.cells import WHOLE, Status, halved_at, leaves
from perilune.atlas.store.manifest import damage_text
from perilune.atlas.store.schema import (
    cell_type,
    header_region,
    node_type,
    open_chart,
    seed_type,
    seeded_places,
    survey_region,
)
from perilune.atlas.store.store import HEADER, MANIFEST, AtlasStore
from perilune.charts import SLACK, Allowed, OpenChart, Sheet, point_feasibility
from perilune.core import Matrix, PeriluneError, Vector, check_call, require_numbers, wrong_type_error
from perilune.io import read_problem
from perilune.problem import Problem

SERVING = (Status.ONE_STEP, Status.MORE_STEPS)
_MOST_OPEN = 10_000  # blocks, each of two files that are mapped; systems allow 65530 maps
_MOST_SEEN = 4096  # cells of a block that are kept at hand

Whole = NDArray[np.int64]


class LoadedBrick:
    """Brick as it is read: cells as lists, which Python reads fastest, and nodes as they lie on disk.

    `step` is that of the lattice, canonical.
    """

    def __init__(self, nodes: NDArray[Any], cells: NDArray[Any], sheets: Sequence[Sheet], step: Vector) -> None:
        self.step: Vector = step
        self.nodes: NDArray[Any] = np.asarray(nodes)  # still on disk, but without what a memory map says of each part
        self.cells: NDArray[Any] = np.asarray(cells)
        self.axis: list[int] = cells["axis"].tolist()
        self.child: list[int] = cells["child"].tolist()
        self.status: list[int] = cells["status"].tolist()
        first = np.nonzero((cells["size"] == WHOLE).all(axis=1))[0]
        roots = [(int(cells["sheet"][i]), int(i)) for i in first]
        self.minima: list[tuple[int, int]] = [(number, root) for number, root in roots if sheets[number].minimum]
        self.split: list[int] = halved_at(cells["low"], cells["axis"], cells["child"]).tolist()
        self._cells: dict[int, _LoadedCell] = {}

    @cached_property
    def arrays(self) -> tuple[Whole, Whole, Whole, Whole]:
        """Return axis, first child, place of the split and status of each cell."""
        return tuple(np.array(rows) for rows in (self.axis, self.child, self.split, self.status))  # pyright: ignore

    def leaves(self, root: int, places: Matrix) -> Whole:
        """Return the cells of a branch, whose first cell is `root`, in which places lie, (points,).

        Parameters
        ----------
        root
            Number of the first cell of the branch.
        places
            Places in lattice steps, (points, d).
        """
        return leaves(*self.arrays[:3], root, places)

    def leaf(self, root: int, place: Sequence[float]) -> int:
        """Return the cell of a branch, whose first cell is `root`, in which a place lies.

        Parameters
        ----------
        root
            Number of the first cell of the branch.
        place
            Place in lattice steps, (d,).
        """
        cell, axis, child, split = root, self.axis, self.child, self.split
        while child[cell] >= 0:
            cell = child[cell] + (place[axis[cell]] >= split[cell])
        return cell

    @cached_property
    def _wholes(self) -> Whole:
        """Return the cell of which each is a half, -1 for the first of a sheet."""
        found, cut = np.full(len(self.cells), -1), np.nonzero(self.cells["child"] >= 0)[0]
        for half in (0, 1):
            found[self.cells["child"][cut] + half] = cut
        return found

    def least(self, numbers: Whole, places: Matrix) -> Vector:
        """Return the least J that corners of cells predict at places; without any, those of the smallest cell around.

        A sheet without a corner of a cell may still pass through it, and must not be missed.

        Parameters
        ----------
        numbers
            Cell of each lane, (lanes,).
        places
            Places in lattice steps, (lanes, d).

        Returns
        -------
        Vector
            Canonical, (lanes,).
        """
        corners = self.cells["corners"][numbers]
        while (bare := np.nonzero((numbers >= 0) & (corners < 0).all(axis=1))[0]).size:
            numbers = numbers.copy()
            numbers[bare] = self._wholes[numbers[bare]]
            corners[bare] = np.where(numbers[bare, None] >= 0, self.cells["corners"][numbers[bare]], -1)
        found, (lanes, own) = np.full(corners.shape, np.inf), np.nonzero(corners >= 0)
        nodes = self.nodes[corners[lanes, own]]
        cost, slopes = nodes["terms"][:, 0, -1], nodes["terms"][:, [1 << i for i in range(len(self.step))], -1]
        promised = cost + (slopes * (places[lanes] - nodes["place"]) * self.step).sum(axis=1)
        found[lanes, own] = np.minimum(cost, promised)
        return found.min(axis=1)

    def given(self, number: int, place: Vector) -> Vector:
        """Interpolate unknowns and J at a place in a cell that has all its corners.

        Parameters
        ----------
        number
            Of the cell.
        place
            In lattice steps, (d,).
        """
        low, size, canonical, terms = self.cell(number)
        return interpolated_at(terms, (place - low) / size, canonical)

    def cell(self, number: int) -> _LoadedCell:
        """Return one of the cells."""
        found = self._cells.get(number)
        if found is None:
            if len(self._cells) >= _MOST_SEEN:
                self._cells.clear()
            said = self.cells[number]
            low, size = said["low"].astype(float), said["size"].astype(float)
            terms = self.nodes["terms"][said["corners"]]
            found = self._cells[number] = _LoadedCell(low, size, size * self.step, terms.reshape(-1, terms.shape[-1]))
        return found


class _LoadedCell(NamedTuple):
    """Cell as it is read: low corner, size, canonical size, and terms at its corners, (corners * terms, k)."""

    low: Vector
    size: Vector
    canonical: Vector
    terms: Matrix


class AtlasReader:
    """Atlas on disk; it may grow meanwhile.

    Parameters
    ----------
    directory
        Where it is.
    problem_from_scenario
        Makes the problem of a scenario's text.

    Attributes
    ----------
    problem, region, tolerance
        What is mapped, over which axes, and how finely.
    damaged
        Blocks whose shards cannot be used, and why.
    """

    def __init__(self, directory: Path, problem_from_scenario: Callable[[str], Problem]) -> None:
        self.store: AtlasStore = AtlasStore(directory)
        self._problem_from_scenario = problem_from_scenario
        header = self.store.header()
        self.problem: Problem = read_problem(header, problem_from_scenario)
        self._first = header_region(self.problem, header)
        with damage_text(HEADER):
            self.tolerance: float = float(header["tolerance"])
        self.damaged: dict[tuple[int, ...], str] = {}
        self._bricks: dict[tuple[int, ...], LoadedBrick] = {}
        self.said: dict[tuple[int, ...], dict[str, Any]] = {}
        self.refresh()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the directory only, which a copy opens again, as machine code belongs to one process."""
        return type(self), (self.store.directory, self._problem_from_scenario)

    def __repr__(self) -> str:
        return f"<Atlas of {self.problem.name}: {', '.join(axis.extent for axis in self.region.axes)}>"

    def refresh(self) -> None:
        """Read the manifest again."""
        survey, before = self.store.survey(), self.said
        self.survey: dict[str, Any] = survey or {"charts": []}
        self.region: Region = survey_region(self._first, self.survey)
        self.said = {} if survey is None else self.store.latest(survey, len(self.region.axes))
        self._bricks = {key: brick for key, brick in self._bricks.items() if before.get(key) == self.said.get(key)}
        self._boxes: dict[tuple[int, ...], tuple[Vector, Vector, Vector]] = {}
        for name in ("allowed", "charted", "descents", "unbuilt", "sample_level"):
            self.__dict__.pop(name, None)

    @property
    def rows(self) -> int:
        """Return the number of nodes."""
        return sum(line["nodes"]["rows"] for line in self.said.values())

    @cached_property
    def sample_level(self) -> int:
        """Return the level that all drawn answers at nodes of the present atlas reached; 0 if none was drawn."""
        lines = self.store.samples(self.survey.get("digest"), self.rows, len(self.region.axes))
        return min((one["level"] for line in lines for one in (*line["drawn"], *line["thin_margin"])), default=0)

    @cached_property
    def charted(self) -> list[OpenChart]:
        """Return its charts."""
        with damage_text(MANIFEST):
            return [open_chart(self.problem, self.region, said) for said in self.survey["charts"]]

    @cached_property
    def descents(self) -> MinimumSearch:
        """Return the search for minima over its charts."""
        return MinimumSearch(self.charted)

    @cached_property
    def allowed(self) -> Allowed:
        """Return the test, (points, d) -> (points,), if physics allows points of the region [SI]."""
        return point_feasibility(self.problem, self.region.names)

    @check_call
    def begins(self, points: Matrix) -> list[Matrix]:
        """Return the node of each chart nearest to points [SI], valid or not: values of the axes, and unknowns there.

        Canonical, NaN for a chart without nodes, (points, d + n) each.

        Raises
        ------
        PeriluneError
            If these are not points, one row each.
        """
        d = len(self.region.axes)
        if np.shape(points := require_numbers(points, "points of the region", most=2))[1:] != (d,):
            raise wrong_type_error(points, f"an array (points, {d}), its columns {self._axes}", "points of the region")
        places = self.region.bricks_of(points)
        found = [np.full((len(points), d + charted.unknowns), np.nan) for charted in self.charted]
        for number, charted in enumerate(self.charted):
            there = np.array([key[1:] for key in self.said if key[0] == number]).reshape(-1, d)
            for place in np.unique(places, axis=0) if len(there) else ():
                near = there[np.abs(there - place).sum(axis=1).argmin()]
                if (brick := self.brick(number, tuple(near.tolist()))) is not None and len(brick.nodes):
                    rows = np.nonzero((places == place).all(axis=1))[0]
                    away = (brick.nodes["values"] - points[rows, None]) / (self.region.high - self.region.low)
                    nodes = brick.nodes[np.abs(away).sum(axis=2).argmin(axis=1)]
                    found[number][rows] = np.hstack([nodes["values"] / charted.chart.scale, nodes["terms"][:, 0, :-1]])
        return found

    @check_call
    def damage(self, brick: tuple[int, ...]) -> list[str]:
        """Describe the damage at a place, one text for each damaged block; only blocks that were read are known."""
        keys = [(number, *self._place(brick)) for number in range(len(self.charted))]
        return [self.damaged[key] for key in keys if key in self.damaged]

    @check_call
    def missing(self, brick: tuple[int, ...]) -> bool:
        """Return True if there is no survey, or it has a sheet for a place whose block is missing.

        An answer there then need not be the best.
        """
        place = self._place(brick)
        return not self.survey["charts"] or any(key[1:] == place for key in self.unbuilt)

    @cached_property
    def unbuilt(self) -> set[tuple[int, ...]]:
        """Return the missing blocks at whose corners the survey has a sheet, by chart and numbers.

        If a shard of the survey is damaged they are unknown: `verify_atlas` names it.
        """
        d, found = len(self.region.axes), set[tuple[int, ...]]()
        for number, chart in enumerate(self.survey["charts"]):
            with suppress(PeriluneError):
                seeds = self.store.shard(chart["seeds"], seed_type(d, chart["unknowns"]))
                found |= {(number, *place) for place in seeded_places(self.region, chart, seeds)}
        return found - self.said.keys()

    @check_call
    def brick(self, number: int, brick: tuple[int, ...]) -> LoadedBrick | None:
        """Return a block of a chart; None if it is missing or damaged.

        Parameters
        ----------
        number
            Number of the chart.
        brick
            Numbers of the block along the axes, (d,).

        Raises
        ------
        PeriluneError
            If these are not the number of a chart and the place of a block.
        """
        try:
            key = (number, *brick)
            known, said = key in self._bricks, self.said.get(key)
        except TypeError:
            raise self._no_brick(number, brick) from None
        if not known:
            if said is None:
                if len(key) != 1 + len(self.region.axes) or not all(isinstance(part, Integral) for part in key):
                    raise self._no_brick(number, brick)
                return None
            d, n = len(self.region.axes), self.charted[number].unknowns
            try:
                nodes = self.store.shard(said["nodes"], node_type(d, n))
                cells = self.store.shard(said["cells"], cell_type(d))
                _refuse_wild(nodes, cells, d, len(self.charted[number].sheets), str(said["name"]))
            except PeriluneError as error:
                self.damaged[key] = error.what
                return None
            if len(self._bricks) >= _MOST_OPEN:
                self._bricks.pop(next(iter(self._bricks)))
            low, high = self.region.box(key[1:])
            step = (high - low) / WHOLE / self.charted[number].chart.scale
            self._bricks[key] = LoadedBrick(nodes, cells, self.charted[number].sheets, step)
        return self._bricks[key]

    def _place(self, brick: Any) -> tuple[int, ...]:
        """Return the numbers of a block along the axes; refuse any other count of them."""
        place = tuple(brick) if isinstance(brick, Sequence | np.ndarray) else ()
        if len(place) != len(self.region.axes) or not all(isinstance(part, Integral) for part in place):
            expected = f"the number of the brick along each of: {self._axes}"
            raise PeriluneError("this is not the position of a brick", got=repr(brick)[:80], expected=expected)
        return place

    @property
    def _axes(self) -> str:
        return ", ".join(axis.name for axis in self.region.axes)

    def _no_brick(self, number: Any, brick: Any) -> PeriluneError:
        expected = f"a chart, 0 to {len(self.charted) - 1}, and the number of the brick along each of: {self._axes}"
        return PeriluneError(
            "this is not the position of a brick", got=f"{number!r}, {brick!r}"[:80], expected=expected
        )


def are_possible_answers(nodes: NDArray[Any], sheets: Iterable[Sheet]) -> NDArray[np.bool_]:
    """Return a mask of the nodes of a shard that may be answers: within their sheet, and confirmed by re-integration.

    Parameters
    ----------
    nodes
        Rows of the shard.
    sheets
        All sheets of the chart, by number.
    """
    minimum = np.array([sheet.minimum for sheet in sheets])
    good = (nodes["margin"] >= 0) & (nodes["residual"] <= SLACK) & (nodes["path"] >= -SLACK)
    return good & minimum[nodes["sheet"]]


def _refuse_wild(nodes: NDArray[Any], cells: NDArray[Any], d: int, sheets: int, name: str) -> None:
    """Refuse a block whose numbers point nowhere, or in a circle; its checksum shows only that it was written so."""
    own, child = np.arange(len(cells)), cells["child"]
    good = (child == -1) | (child > own) & (child < len(cells) - 1)
    good &= ((cells["corners"] >= -1) & (cells["corners"] < len(nodes))).all(axis=1)
    good &= (cells["axis"] >= -1) & (cells["axis"] < d) & (cells["sheet"] >= 0) & (cells["sheet"] < sheets)
    good &= ~np.isin(cells["status"], SERVING) | (cells["corners"] >= 0).all(axis=1)
    if not good.all() or not ((nodes["sheet"] >= 0) & (nodes["sheet"] < sheets)).all():
        raise PeriluneError(f"a brick of the atlas is damaged: {name}", got="numbers that refer to nothing")
