"""Classification of an extremal behind a fold by its second variation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from perilune.atlas.charted import OpenChart
from perilune.atlas.region import Region
from perilune.problem.extremal import Nature
from perilune.problem.problem import Problem
from perilune.problem.solution import Statistics
from perilune.proof.second_order import check_local_optimality
from perilune.shooting.extremals import ExtremalRoot
from perilune.words.outcome import PeriluneError
from perilune.words.types import Vector

_TOLD_BY = ("conjugate_point", "second_variation")  # checks of the proof


def classify_behind_folds(
    problem: Problem, region: Region, said: Mapping[str, Any], values: Vector, y: Vector
) -> Nature:
    """Classify an extremal behind a fold, at which no solve has been, by its second variation.

    Parameters
    ----------
    problem, region
        The problem, and the region that is mapped.
    said
        Its chart, as the survey's line has it, with its sheet alone.
    values, y
        Of the axes and its unknowns, canonical.

    Returns
    -------
    Nature
        A local optimum or locally worst; `UNPROVED` where its second variation does not tell.
    """
    charted = OpenChart(problem, region, said)
    polished = charted.polish(values[None], np.zeros(1, dtype=np.int64), y[None])
    if not polished.reached[0]:
        return Nature.UNPROVED
    at = dict(zip(region.names, (values * charted.chart.scale).tolist(), strict=True))
    root = ExtremalRoot(root=charted.root(polished), minimum=True)
    try:
        solution = charted.solution(problem.with_given(**at), [root], Statistics(rung="atlas"))
        told = [check for check in check_local_optimality(solution) if check.name in _TOLD_BY]
    except (PeriluneError, ArithmeticError):
        return Nature.UNPROVED
    if any(check.value > check.limit for check in told):
        return Nature.WORST
    if not told or any(np.isnan(check.value) for check in told):
        return Nature.UNPROVED
    return Nature.LOCAL_OPTIMUM_AT_BOUND if charted.sheets[0].holds else Nature.LOCAL_OPTIMUM
