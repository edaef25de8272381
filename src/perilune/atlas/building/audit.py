"""Audit of an atlas: whole proofs of answers at nodes drawn at random, and at nodes with a thin margin.

Each node of a block carries the results of its independent re-integration; the proof of level 3 takes a hundred times
as long as the node itself. If n answers are drawn at random and all proved, at least a share 0.01^(1/n) of all would be
proved, at 99 % confidence: 99 % with n = 459. Answers are drawn at nodes at which the atlas answers, so the statement
covers neither points between them nor places that a query refuses, whose number in the draw is stated.

Nodes with a thin margin lie near the border of their branch, where a bound becomes active or inactive; an error there
would seldom be found by a draw among all.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from perilune.atlas.query.answer import Mapped
from perilune.atlas.query.query import Atlas, open_atlas
from perilune.atlas.query.reader import SERVING, AtlasReader, are_possible_answers
from perilune.atlas.store.cells import WHOLE
from perilune.atlas.store.schema import cell_type, node_type, sheets_of
from perilune.atlas.store.store import PATIENCE, AtlasStore
from perilune.charts import SLACK, Sheet
from perilune.core import NotConvergedError, PeriluneError, Watch, ignore_events, wrong_type_error
from perilune.families import Call, Submits, run_calls
from perilune.problem import Problem, Solution, Verification
from perilune.verify import verify

Drawn = tuple[tuple[float, ...], Mapped]  # values of the axes [SI], and the answer there
Refused = dict[tuple[float, ...], str]  # values of the axes [SI], and why a query has no answer there

LEVEL = 3
USUAL, _ONE_OF = 10, 100  # proofs of a build at most, unless it is given how many; and of so many nodes one
_THIN = 1e-3  # canonical
_DOUBT = 0.01
_TRIES = 50  # nodes that are looked at for each that is wanted


@dataclass(frozen=True, kw_only=True)
class Certificate:
    """Result of the proof of one answer.

    Parameters
    ----------
    values
        Of the axes [SI].
    level
        Reached.
    failed
        Names of the checks that failed.
    """

    values: tuple[float, ...]
    level: int
    failed: tuple[str, ...]

    @property
    def proved(self) -> bool:
        """Return True if the level that was asked for was reached."""
        return self.level >= LEVEL and not self.failed


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Answers that were drawn, with their proofs.

    Parameters
    ----------
    drawn
        Answers drawn at random.
    thin, thin_nodes
        Answers drawn among nodes with a thin margin, and the number of these nodes.
    merged
        Proofs of atlases that were merged to this one: drawn of parts of it, they say nothing of the whole.
    refused
        Number of places, drawn in addition to those of `drawn`, at which a query has no answer.
    """

    drawn: tuple[Certificate, ...] = ()
    thin: tuple[Certificate, ...] = ()
    thin_nodes: int = 0
    merged: tuple[Certificate, ...] = ()
    refused: int = 0

    @property
    def proved(self) -> int:
        """Return the number of answers drawn at random that are proved."""
        return sum(one.proved for one in self.drawn)

    @property
    def share(self) -> float:
        """Return a lower bound on the share of provable answers at nodes, at 99 % confidence; 0 if one is not."""
        return assured_share(self.proved, len(self.drawn))

    @property
    def unproved(self) -> tuple[Certificate, ...]:
        """Return the answers that are not proved."""
        return tuple(one for one in (*self.drawn, *self.thin, *self.merged) if not one.proved)

    def describe(self, atlas: Atlas) -> list[str]:
        """Describe the sample in sentences."""
        lines = [proved_text(self.proved, len(self.drawn))] if self.drawn else []
        lines += refused_text(self.refused, len(self.drawn))
        if self.thin:
            good = sum(one.proved for one in self.thin)
            lines.append(f"{good} of {len(self.thin)} with a thin margin proved, of {self.thin_nodes} that there are")
        if self.merged:
            good = sum(one.proved for one in self.merged)
            lines.append(f"{good} of {len(self.merged)} drawn from the merged atlases proved to level {LEVEL}")
        return [*lines, *(unproved_samples_text(atlas, one) for one in self.unproved)]


def require_count(sample: Any) -> None:
    """Refuse anything but a number of proofs."""
    if sample is not None and (isinstance(sample, bool) or not isinstance(sample, int) or sample < 0):
        raise wrong_type_error(sample, "a whole number from 0, or None", "a valid number of answers to prove")


def assured_share(proved: int, drawn: int) -> float:
    """Return a lower bound on the share of all that is provable, at 99 % confidence; 0 if one drawn was not.

    Parameters
    ----------
    proved, drawn
        Numbers of answers.
    """
    return _DOUBT ** (1.0 / drawn) if drawn and proved == drawn else 0.0


def proved_text(proved: int, drawn: int) -> str:
    """Describe the result of a draw, with the share of all answers that it assures.

    Parameters
    ----------
    proved, drawn
        Numbers of answers drawn at random: those proved, and all.
    """
    share = assured_share(proved, drawn)
    said = f": at least {100 * share:.1f} % of all, at 99 % confidence" if share else ""
    return f"{proved} of {drawn} answers drawn at random proved to level {LEVEL}{said}"


def refused_text(refused: int, drawn: int) -> list[str]:
    """Describe the number of drawn places that a query refuses; an empty list for none.

    Parameters
    ----------
    refused, drawn
        Numbers of places drawn without and with an answer.
    """
    told = f"of {drawn + refused} places that were drawn, a query refuses {refused}; nothing is claimed about these"
    return [told] if refused else []


def unproved_samples_text(atlas: Atlas, one: Certificate) -> str:
    """Describe an answer that is not proved: its point, level and failed checks.

    Parameters
    ----------
    atlas
        Atlas of the answer.
    one
        Its certificate.
    """
    return f"at {atlas.region.format_point(one.values)}: level {one.level}, not {', '.join(one.failed[:3])}"


def numbers_of_thin_nodes(nodes: NDArray[Any], sheets: Iterable[Sheet]) -> NDArray[np.int64]:
    """Return the numbers of nodes with a thin margin, the thinnest first.

    Parameters
    ----------
    nodes
        Shard of the nodes of a block, with the columns of `node_type`.
    sheets
        Branches of its chart.

    Returns
    -------
    NDArray[np.int64]
        Numbers of rows, (thin,).
    """
    found = np.nonzero(are_possible_answers(nodes, sheets) & (nodes["margin"] < _THIN))[0]
    return found[np.argsort(nodes["margin"][found], kind="stable")]


def drawn_at_random(atlas: Atlas, count: int, rng: np.random.Generator, refused: Refused) -> Iterator[Drawn]:
    """Yield answers at nodes drawn at random, no place twice, each with its values of the axes.

    Drawn places without an answer are added to `refused`.

    Parameters
    ----------
    atlas
        Atlas with all its blocks.
    count
        Number of answers.
    rng
        Source of the draw.
    refused
        Filled with drawn places [SI], each with the reason of the query.
    """
    keys = sorted(atlas.said)
    ends = np.cumsum([atlas.said[key]["nodes"]["rows"] for key in keys])
    total, seen = int(ends[-1]) if len(ends) else 0, set[tuple[float, ...]]()
    for number in rng.choice(total, min(total, _TRIES * count), replace=False).tolist() if total else ():
        if len(seen) >= count:
            return
        at = int(np.searchsorted(ends, number, side="right"))
        chart, *place = keys[at]
        if (brick := atlas.brick(chart, tuple(place))) is None:
            continue
        row = brick.nodes[number - int(ends[at])]
        if are_possible_answers(row[None], atlas.charted[chart].sheets)[0]:
            yield from _answer_at_new_place(atlas, row["values"], seen, refused)


def drawn_thin(atlas: Atlas, count: int, rng: np.random.Generator) -> Iterator[Drawn]:
    """Yield answers at nodes with a thin margin, no place twice; in each block the thinnest first.

    Parameters
    ----------
    atlas
        Atlas with all its blocks.
    count
        Number of answers.
    rng
        Source of the order of the blocks.
    """
    keys, seen = [key for key in sorted(atlas.said) if atlas.said[key].get("thin_margin", 0)], set[tuple[float, ...]]()
    refused = Refused()
    for at in rng.permutation(len(keys)).tolist():
        chart, *place = keys[at]
        if (brick := atlas.brick(chart, tuple(place))) is None:
            continue
        for row in numbers_of_thin_nodes(brick.nodes, atlas.charted[chart].sheets).tolist():
            if len(seen) >= count:
                return
            yield from _answer_at_new_place(atlas, brick.nodes["values"][row], seen, refused)


def _answer_at_new_place(
    atlas: Atlas, values: NDArray[Any], seen: set[tuple[float, ...]], refused: Refused
) -> Iterator[Drawn]:
    """Yield the answer at a new place, if there is one."""
    if (told := tuple(values.tolist())) not in seen and told not in refused:
        try:
            found = atlas.query(**dict(zip(atlas.region.names, told, strict=True)))
        except PeriluneError as error:  # where another branch that might be better ends
            refused[told] = error.what
            return
        seen.add(told)
        yield told, found


def certify_solutions(
    solutions: Iterator[Drawn], executor: Submits | None, watch: Watch = ignore_events
) -> tuple[Certificate, ...]:
    """Prove solutions, here or elsewhere.

    Parameters
    ----------
    solutions
        Values of the axes [SI], and the answer there.
    executor
        Where proofs are computed; None for this process.
    watch
        Receives a line after each proof.

    Returns
    -------
    tuple[Certificate, ...]
        Sorted by the values of the axes.
    """
    calls: Iterator[tuple[tuple[float, ...], Call]] = ((at, (_prove_sampled, solution)) for at, solution in solutions)
    found = list[Certificate]()
    for at, proof in run_calls(executor, calls):
        failed = tuple(check.name for check in proof.failed)
        found.append(Certificate(values=at, level=proof.level, failed=failed))
        watch(f"proof {len(found)}")
    return tuple(sorted(found, key=lambda one: one.values))


def _prove_sampled(solution: Solution) -> Verification:
    return verify(solution, LEVEL).verification


def draw_sample(
    kept: AtlasStore,
    count: int | None,
    executor: Submits | None,
    watch: Watch,
    problem_from_scenario: Callable[[str], Problem] | None = None,
) -> None:
    """Draw and prove the missing part of the sample of a complete atlas, and add it to the manifest.

    Waits for another builder that is drawing, which may want fewer, or die.

    Parameters
    ----------
    kept
        Store of a complete atlas.
    count
        Number of answers that the sample is to have in all; None for one in a hundred nodes, at most ten.
    executor
        Where proofs are computed; None for this process.
    watch
        Receives lines of text.
    problem_from_scenario
        Makes the problem of a scenario's text; None for the models of the catalogue.
    """
    if count == 0:
        return
    atlas = open_atlas(kept.directory, problem_from_scenario)
    nodes = atlas.rows
    count = min(USUAL, 1 + nodes // _ONE_OF) if count is None else count
    waits = False
    while atlas.said and count > sum(line["requested"] for line in sample_lines(atlas)):
        with kept.claimed("sample") as ours:
            missing = count - sum(line["requested"] for line in sample_lines(atlas))
            if ours and missing > 0:
                rng = np.random.default_rng()  # another each time, so that what is looked at cannot be chosen
                refused = Refused()
                drawn = certify_solutions(drawn_at_random(atlas, missing, rng, refused), executor, watch)
                thin = certify_solutions(drawn_thin(atlas, missing, rng), executor, watch)
                said = {"survey": atlas.survey["digest"], "nodes": nodes, "requested": missing, "level": LEVEL}
                said["refused"] = len(refused)
                proofs = {"drawn": [vars(one) for one in drawn], "thin_margin": [vars(one) for one in thin]}
                kept.add({"kind": "sample", **said, **proofs})
            if ours:
                kept.settled("sample")
                return
        if not waits:
            watch("another builder is drawing the sample to prove: waiting for it")
        waits = True
        time.sleep(PATIENCE)


def sample_lines(atlas: Atlas) -> list[dict[str, Any]]:
    """Return the lines of the samples of the present atlas."""
    return atlas.store.samples(atlas.survey.get("digest"), atlas.rows, len(atlas.region.axes))


def sample_of(atlas: Atlas) -> Sample:
    """Return the sample that was drawn of the atlas in its present state while it was built."""
    lines = sample_lines(atlas)
    thin = {one.values: one for line in lines for one in map(_certificate_of_line, line["thin_margin"])}
    return Sample(
        drawn=tuple(_certificate_of_line(said) for line in lines for said in line["drawn"]),
        thin=tuple(thin.values()),
        thin_nodes=sum(line.get("thin_margin", 0) for line in atlas.said.values()),
        merged=tuple(_certificate_of_line(said) for line in lines for said in line.get("merged", ())),
        refused=sum(line.get("refused", 0) for line in lines),
    )


def _certificate_of_line(said: Mapping[str, Any]) -> Certificate:
    return Certificate(values=tuple(said["values"]), level=said["level"], failed=tuple(said["failed"]))


_LOOKED_AT = 1000  # points of a region


class RegionCoverage(NamedTuple):
    """Shares of a region: where cells answer, and where physics refuses points."""

    answered: float
    impossible: float

    @property
    def points(self) -> int:
        """Number of points of the region by which they are known."""
        return _LOOKED_AT


def covered_share(atlas: AtlasReader) -> RegionCoverage:
    """Compute the share of points of a region that lie in a cell of some branch which answers; the draw is fixed.

    Queries answer only there, and may refuse some of these points: another branch can cast doubt on their answer.

    Parameters
    ----------
    atlas
        The atlas.
    """
    region, points = atlas.region, _LOOKED_AT
    drawn = np.random.default_rng(0).uniform(region.low, region.high, (points, len(region.axes)))
    places, good, allowed = region.bricks_of(drawn), np.zeros(points, dtype=bool), atlas.allowed(drawn)
    for place in map(tuple, np.unique(places, axis=0).tolist()):
        lanes, (low, high) = np.nonzero((places == place).all(axis=1))[0], region.box(place)
        inside = (drawn[lanes] - low) / (high - low) * WHOLE
        for number in range(len(atlas.charted)):
            if (brick := atlas.brick(number, place)) is not None:
                for _, root in brick.minima:
                    good[lanes] |= np.isin(brick.arrays[3][brick.leaves(root, inside)], SERVING)
    return RegionCoverage(answered=float((good & allowed).mean()), impossible=float((~allowed).mean()))


def refuse_nowhere(kept: AtlasStore, survey: Mapping[str, Any], axes: int) -> None:
    """Refuse a complete atlas without an answering cell, which would refuse every query.

    Parameters
    ----------
    kept
        Store of a complete atlas.
    survey
        Line of its survey.
    axes
        Number of axes.

    Raises
    ------
    NotConvergedError
        If no cell of a minimum answers.
    """
    lines, nodes, poor = kept.latest(survey, axes).values(), 0, 0
    for line in lines:
        try:
            cells = kept.shard(line["cells"], cell_type(axes))
            known = kept.shard(line["nodes"], node_type(axes, survey["charts"][line["chart"]]["unknowns"]))
        except PeriluneError:  # it is damaged, and may have answered
            return
        minimum = np.array([sheet.minimum for sheet in sheets_of(survey["charts"][line["chart"]])])
        if (np.isin(cells["status"], SERVING) & minimum[cells["sheet"]]).any():
            return
        nodes, poor = nodes + len(known), poor + int((known["residual"] > SLACK).sum())
    sensitive = (
        f"; the independent re-integration of {poor} of them misses the end conditions by more than {SLACK:g}"
        if poor
        else ""
    )
    raise NotConvergedError(
        "the atlas answers nowhere in its region: no sheet could be followed from one of its extremals to another",
        got=f"{nodes} extremals in {len(lines)} bricks{sensitive}",
        expected="extremals that Newton's method can follow, whose flights are not sensitive to rounding",
        advice="choose another region, or use perilune solve at single points",
    )
