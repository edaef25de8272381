"""Verification of an atlas: every shard by its checksum, and a random sample of its nodes to level 3.

See `perilune.atlas.building.audit` for what a sample shows of the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from perilune.atlas.building.audit import (
    Refused,
    assured_share,
    certify_solutions,
    drawn_at_random,
    proved_text,
    refused_text,
    unproved_samples_text,
)
from perilune.atlas.query.query import Atlas
from perilune.atlas.query.reader import are_possible_answers
from perilune.atlas.store.schema import cell_type, node_type, seed_type
from perilune.atlas.store.store import MANIFEST
from perilune.core import (
    PeriluneError,
    RenamedAttribute,
    Watch,
    ignore_events,
    renamed_keywords,
)

_UNENDED = "bricks are missing: the build has not ended, or they were lost; perilune atlas extend DIR builds them"
_TOLD = 10  # places that a query refuses, in words


@dataclass(frozen=True, kw_only=True)
class AtlasVerification:
    """Result of the verification of an atlas.

    Attributes
    ----------
    shards, damaged
        Number of files that were read, and a sentence for each that is damaged.
    nodes, answers
        Number of nodes, and of those that may be answers.
    proved, drawn
        Number of answers that are proved to level 3, and of those that were drawn.
    unproved
        A sentence for each answer that is not proved, with the reason.
    complete
        True if all blocks that a builder completed are there; the verification says nothing of others.
    refused
        Number of places, drawn in addition, at which a query has no answer; the verification says nothing of them.
    refusals
        A sentence for each of at most ten of them, with the reason.
    """

    shards: int
    damaged: tuple[str, ...]
    nodes: int
    answers: int
    proved: int
    drawn: int
    unproved: tuple[str, ...]
    complete: bool
    refused: int
    refusals: tuple[str, ...]
    ended: ClassVar[RenamedAttribute] = RenamedAttribute("complete")

    @property
    def passed(self) -> bool:
        """Return True if nothing is damaged or missing, and all answers that were drawn are proved."""
        return not self.damaged and self.complete and self.proved == self.drawn

    @property
    def share(self) -> float:
        """Return a lower bound on the share of provable answers at nodes, at 99 % confidence.

        It is 0 if one of those drawn was not proved.
        """
        return assured_share(self.proved, self.drawn)

    def __str__(self) -> str:
        lines = [
            f"{self.shards} shards, {len(self.damaged)} damaged; {self.nodes} nodes, {self.answers} of them answers",
            *([] if self.complete else [_UNENDED]),
            proved_text(self.proved, self.drawn),
            *refused_text(self.refused, self.drawn),
        ]
        return "\n".join([*lines, *self.refusals, *self.damaged, *self.unproved])


@renamed_keywords(watch="callback")
def verify_atlas(
    atlas: Atlas, sample: int = 50, *, seed: int | None = None, callback: Watch = ignore_events
) -> AtlasVerification:
    """Check every shard, and prove some of the nodes.

    Parameters
    ----------
    atlas
        Which.
    sample
        How many nodes are proved; 459 of 459 is 99 % at 99 %.
    seed
        Of the draw; by default another each time, so that what is looked at cannot be chosen.
    callback
        Receives lines of text.

    Raises
    ------
    PeriluneError
        If there is no survey, so that it is unknown what should be there.
    """
    d, damaged, nodes, good = len(atlas.region.axes), list[str](), 0, 0
    if not (charts := atlas.survey["charts"]):
        raise PeriluneError(
            "this atlas has no survey, and nothing to verify", got=str(atlas.store.directory),
            advice="build it first, or rebuild what was lost: perilune atlas build ... --resume",
        )  # fmt: skip
    shards = [(-1, chart["seeds"], seed_type(d, chart["unknowns"])) for chart in charts]
    for (number, *_), line in sorted(atlas.said.items()):
        shards.append((number, line["nodes"], node_type(d, charts[number]["unknowns"])))
        shards.append((-1, line["cells"], cell_type(d)))
    for count, (number, said, dtype) in enumerate(shards, 1):
        callback(f"shard {count} of {len(shards)}")
        try:
            rows = atlas.store.shard(said, dtype)
        except PeriluneError as error:
            damaged.append(str(error))
            continue
        if number >= 0:
            nodes += len(rows)
            good += int(are_possible_answers(rows, atlas.charted[number].sheets).sum())
    if broken := atlas.store.unreadable:
        damaged.append(
            f"{broken} line{'s' * (broken > 1)} of {MANIFEST} cannot be read: remove them; perilune atlas build ..."
            f" --resume computes again what they described"
        )
    complete = not atlas.unbuilt and atlas.store.ended(atlas.survey, d)
    refused = Refused()
    found = certify_solutions(drawn_at_random(atlas, sample, np.random.default_rng(seed), refused), None, callback)
    unproved = tuple(unproved_samples_text(atlas, one) for one in found if not one.proved)
    return AtlasVerification(
        shards=len(shards), damaged=tuple(damaged), nodes=nodes, answers=good, proved=len(found) - len(unproved),
        drawn=len(found), unproved=unproved, complete=complete, refused=len(refused),
        refusals=tuple(f"at {atlas.region.format_point(at)}: {why}" for at, why in list(refused.items())[:_TOLD]),
    )  # fmt: skip
