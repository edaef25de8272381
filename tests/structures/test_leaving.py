"""Where a flight leaves what it rides along: against a closed form, and from a structure that rides on too far."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

import perilune as pl
from perilune import Indirect, Pseudospectral
from perilune.core import ignore_events
from perilune.methods.indirect.refinement.structure_search import StructureRefinement
from perilune.methods.indirect.search import Search
from perilune.problem import Curve, Solution
from perilune.structures import Arc, Condition, Structure, conditions_of
from perilune.structures.multiphase import restate
from perilune.structures.multiplier_signs import paying_intervals
from perilune.structures.split_join import split_solution
from problems.constrained import FROM, HOP, UNTIL, drawn_off, hopping

TOO_FAR = Structure(((Arc(until=FROM), Arc(along=("height",), until=2.9)),))


@pytest.fixture(scope="module")
def rough() -> Solution:
    return Pseudospectral(nodes=5, segments=8, refine=0, polish=False).run(drawn_off())


def test_an_arc_pays_until_its_multiplier_changes_sign(rough: Solution) -> None:
    """mu = 6 (2 - t): worth it for 1.5 s from where it is met, and not to the end."""
    restated = restate(drawn_off(), TOO_FAR, repeated=False)
    ridden = Search(Indirect(), restated, ignore_events).solve(split_solution(rough, TOO_FAR, restated))
    assert ridden.trajectories[0].duration == pytest.approx(FROM, abs=1e-9)
    condition = conditions_of(drawn_off(), 0, ("height",))["height"]
    [(begin, end)] = paying_intervals(ridden, 1, condition) or []
    assert begin == 0.0
    assert end == pytest.approx(2.0 - FROM, abs=0.01)


def test_where_the_multiplier_has_a_kink_it_tells_nothing(rough: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    """No polynomial follows it, and curves that it has not would be read off one; a parabola is what it is."""
    condition, index = conditions_of(drawn_off(), 0, ("height",))["height"], 0
    monkeypatch.setattr(
        "perilune.structures.multiplier_signs._multiplier", lambda solved, index, rate, t: np.abs(t - 0.3)
    )
    assert paying_intervals(rough, index, condition) is None
    monkeypatch.setattr("perilune.structures.multiplier_signs._multiplier", lambda solved, index, rate, t: t * t)
    assert paying_intervals(rough, index, condition) == [(0.0, rough.trajectories[0].duration)]


@pytest.mark.parametrize(("order", "pays"), [(1, True), (2, False), (3, None)])
def test_what_pays_is_a_derivative_of_the_multiplier_of_the_order_of_the_condition(
    order: int, pays: bool | None, rough: Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It falls, the faster the later: mu is -eta', which pays, or eta'', which does not; of more nothing is told."""
    condition = cast(Condition, SimpleNamespace(order=order, rated=lambda *_: SimpleNamespace(name="height")))
    monkeypatch.setattr("perilune.structures.multiplier_signs._multiplier", lambda solved, index, rate, t: -t - t * t)
    everywhere = [(0.0, rough.trajectories[0].duration)]
    assert paying_intervals(rough, 0, condition) == {True: everywhere, False: [], None: None}[pays]


def test_the_structure_is_revised_to_one_that_leaves(rough: Solution) -> None:
    tried = list[str]()
    run = StructureRefinement(settings=Indirect(), problem=drawn_off(), watch=ignore_events, tried=tried)
    found = run.followed(rough, TOO_FAR, set())
    assert found is not None
    assert tried == [
        "structure free, along height: an extremal of another structure",
        "structure free, along height, free: an extremal",
    ]


def test_what_leaves_before_its_end_is_found_and_proved() -> None:
    solution = pl.solve(drawn_off())
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    [arc] = [arc for arc in solution.structure if arc.description == "along height"]
    assert arc.begin == pytest.approx(FROM, abs=1e-8)
    assert arc.end == pytest.approx(UNTIL, abs=1e-8)


@pytest.fixture(scope="module")
def hop() -> Solution:
    return pl.solve(hopping())


def test_an_arc_that_pays_nowhere_is_a_touch(hop: Solution) -> None:
    """The touch, the hop behind it and the jump of the costate in closed form, though S'' is 4e-7 of its largest."""
    tried, ridden = list[str](), Structure(((Arc(until=0.5), Arc(along=("height",), until=1.0)),))
    assert StructureRefinement(settings=Indirect(), problem=hopping(), watch=ignore_events, tried=tried).followed(
        hop, ridden, set()
    )
    assert tried == [
        "structure free, along height: an extremal of another structure",
        "structure free and touches height, free: an extremal",
    ]
    assert hop.outcome is pl.Outcome.PROVED and hop.verification.level == 3
    [touch] = [arc for arc in hop.structure if "height" in arc.description]
    assert touch.description == "contact point of height" and touch.begin == touch.end == pytest.approx(0.5, abs=1e-9)
    s = np.linspace(0.01, 0.49, 25)
    assert hop.trajectories[0].state(0.5 + s)[:, 0] == pytest.approx(HOP * (s * (0.5 - s)) ** 2 / 24, abs=1e-14)
    costate = hop.trajectories[0].costate
    assert costate is not None
    before, behind = costate.values[np.abs(costate.time - 0.5) < 1e-9][:, 0]
    assert behind - before == pytest.approx(10.0 - 0.25 * HOP, rel=1e-9)


@pytest.mark.parametrize("share", [-1.0, 1e-4])
def test_another_jump_of_a_costate_is_refused(hop: Solution, share: float) -> None:
    """None at all, and a little more."""
    flown = hop.trajectories[0]
    assert flown.costate is not None
    values = flown.costate.values.copy()
    values[: int(np.searchsorted(flown.costate.time, 0.5, "right")) - 1, 0] -= 10.0 * share
    wrong = replace(flown, costate=Curve(time=flown.costate.time, values=values, rates=flown.costate.rates))
    assert not pl.verify(replace(hop, trajectories=(wrong,))).verification.passed
