"""Proving an atlas again: every shard by its checksum, and a random sample of its nodes to level 3.

Each node of a brick carries what its second flight showed; the whole proof of a node takes a hundred times as long as
the node itself. Of n nodes that are drawn at random and all proved, at least a share 0.01^(1/n) of all nodes would be
proved, at 99 % confidence: with 459, 99 %.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perilune.atlas.building import cell_type, node_type
from perilune.atlas.query import Atlas
from perilune.atlas.reflight import SLACK
from perilune.solve import prove
from perilune.words.outcome import Outcome, PeriluneError
from perilune.words.watch import Watch, silent

LEVEL, _DOUBT = 3, 0.01


@dataclass(frozen=True, kw_only=True)
class Verified:
    """What was found.

    Attributes
    ----------
    shards, damaged
        How many files were looked at, and what is wrong with some of them, in sentences.
    nodes, answers
        How many nodes there are, and how many of them may be answers.
    proved, drawn
        How many of the drawn answers are proved to level 3.
    unproved
        Which were not, and why, in sentences.
    """

    shards: int
    damaged: tuple[str, ...]
    nodes: int
    answers: int
    proved: int
    drawn: int
    unproved: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing is damaged, and all that was drawn is proved."""
        return not self.damaged and self.proved == self.drawn

    @property
    def share(self) -> float:
        """Of all answers at least so many would be proved, at 99 % confidence; 0 where one of the drawn was not."""
        return _DOUBT ** (1.0 / self.drawn) if self.drawn and self.proved == self.drawn else 0.0

    def __str__(self) -> str:
        lines = [
            f"{self.shards} shards, {len(self.damaged)} damaged; {self.nodes} nodes, {self.answers} of them answers",
            f"{self.proved} of {self.drawn} answers drawn at random proved to level {LEVEL}"
            + (f": at least {100 * self.share:.1f} % of all, at 99 % confidence" if self.share else ""),
        ]
        return "\n".join([*lines, *self.damaged, *self.unproved])


def verify_atlas(atlas: Atlas, sample: int = 50, *, seed: int | None = None, watch: Watch = silent) -> Verified:
    """Look at every shard, and prove some of the nodes.

    Parameters
    ----------
    atlas
        Which.
    sample
        How many nodes are proved; 459 of 459 is 99 % at 99 %.
    seed
        Of the draw; by default another each time, so that nobody can choose what is looked at.
    watch
        Receives lines of text.
    """
    d, damaged, shards, nodes = len(atlas.region.axes), list[str](), 0, 0
    found = list[np.ndarray]()
    for (number, *_), line in sorted(atlas.said.items()):
        charted = atlas.charted[number]
        minimum = np.array([sheet.minimum for sheet in charted.sheets])
        for kind, dtype in (("nodes", node_type(d, charted.unknowns)), ("cells", cell_type(d))):
            shards += 1
            watch(f"shard {shards} of {2 * len(atlas.said)}")
            try:
                rows = atlas.store.shard(line[kind], dtype)
            except PeriluneError as error:
                damaged.append(str(error))
                continue
            if kind == "nodes":
                nodes += len(rows)
                good = (rows["margin"] >= 0) & (rows["residual"] <= SLACK) & (rows["path"] >= -SLACK)
                found.append(np.array(rows["values"][good & minimum[rows["sheet"]]]))
    values = np.concatenate([np.empty((0, d)), *found])
    drawn = values[np.random.default_rng(seed).choice(len(values), min(sample, len(values)), replace=False)]
    unproved = list[str]()
    for i, row in enumerate(drawn.tolist()):
        watch(f"proof {i + 1} of {len(drawn)}")
        told = dict(zip(atlas.region.names, row, strict=True))
        try:
            proved = prove(atlas.query(**told), LEVEL)
        except PeriluneError as error:
            unproved.append(f"at {told}: {error.what}")
            continue
        if proved.outcome is not Outcome.PROVED:
            failed = ", ".join(check.name for check in proved.verification.failed[:3])
            unproved.append(f"at {told}: level {proved.verification.level}, not {failed}")
    return Verified(
        shards=shards, damaged=tuple(damaged), nodes=nodes, answers=len(values), proved=len(drawn) - len(unproved),
        drawn=len(drawn), unproved=tuple(unproved),
    )  # fmt: skip
