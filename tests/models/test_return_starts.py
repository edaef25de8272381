"""Starts of returns without a guess: those that once ended without an answer."""

from __future__ import annotations

import pytest

import perilune as pl
from matrix import QUICK_RETURNS, WAYS, cover, text_of
from perilune.core import ignore_events
from perilune.direct.initialization import BRIEF, PATIENT, FirstMesh
from perilune.direct.transcription import Run
from perilune.methods.indirect.coarse_direct import Coarse
from perilune.methods.indirect.newton_trials import Trials
from perilune.methods.indirect.random_costates import active_set_of_guess
from perilune.methods.indirect.unknowns import unknowns_from_solution
from perilune.scenario import load_text

LATE, BANKED = (
    load_text(text_of(WAYS["deorbit_entry"].document(picked)))
    for picked in ({**QUICK_RETURNS[2], "throttle": "stated"}, QUICK_RETURNS[3])
)


def test_a_time_is_lowered_without_losing_the_flight() -> None:
    """From a flight that misses nothing the first steps led out of the air, and 300 iterations not back."""
    found = Coarse(pl.Indirect(), LATE, []).solve()
    assert found is not None and found.statistics.residual < 1e-3
    assert found.free["coast_time"] == pytest.approx(1200.0, rel=1e-6)
    assert found.objective < 1114.278  # the extremal that random costates meet, at a maximum over the coast


def test_pieces_that_miss_by_rounding_are_a_root() -> None:
    """Through the air of a day a billionth is rounding: it is an extremal, with the cost that the mesh has."""
    rough = Coarse(pl.Indirect(), BANKED, []).solve()
    assert rough is not None
    trials = Trials(BANKED, ignore_events)
    y = unknowns_from_solution(BANKED, trials.conditions, rough)
    root = trials.by_pieces(rough, y, active_set_of_guess(trials, y), 6, trials.others)
    assert root.converged and root.cost * BANKED.scales.mass == pytest.approx(rough.objective, rel=1e-6)


def test_a_heat_load_is_lowered_in_short_steps() -> None:
    """A burn with a throttle all the way down: two hundred of them, and 60 had been allowed."""
    throttled = cover(WAYS["deorbit_entry"], pairs=False)[3]
    assert throttled["minimise"] == "heat_load" and throttled["throttle"] == "stated"
    problem = load_text(text_of(WAYS["deorbit_entry"].document(throttled)))
    first = FirstMesh(Run(settings=pl.Pseudospectral(nodes=5, segments=8), problem=problem), None)
    longer = next(start for start in first.starts() if start.name.endswith("x 1.6"))
    nearest = first.run.attempt(longer.program, longer.free, longer.values, "nearest", nearest=True, most=PATIENT)
    ((_, found),) = first.in_short_steps([(longer.program, nearest)])
    assert found.converged and found.iterations > BRIEF
    assert found.objective * problem.objective_size == pytest.approx(168.85e6, rel=1e-3)  # J/m^2, of the extremal
