"""Controls that nothing determines are named: a lift of which least propellant needs only that it arrives."""

from __future__ import annotations

import perilune as pl
from perilune.conditions.pontryagin import derive
from perilune.methods.indirect.coarse_direct import Coarse
from perilune.methods.indirect.diagnosis import no_start_converged_error, undetermined_controls
from perilune.methods.indirect.settings import SearchSettings
from perilune.problem import Problem
from perilune.scenario import load_text, template


def returning(minimise: str, east: float) -> Problem:
    """The template with a lift, to a place so far east [deg] of where it lands by least propellant without one."""
    text = template("deorbit_entry").replace("# lift_to_drag", "lift_to_drag").replace('"propellant"', f'"{minimise}"')
    place = f'longitude = "{159.85 + east} deg"\nlatitude = "-49.34 deg"\n'
    return load_text(text.replace("[site]", "[site]\n" + place + "#"))


def direct(problem: Problem) -> pl.Solution:
    return pl.Pseudospectral(nodes=5, segments=5, refine=0, polish=False).run(problem)


def test_a_lift_that_only_has_to_arrive_is_named() -> None:
    """Least propellant within reach; 6 degrees east of it each degree of lift counts."""
    problem = returning("propellant", 0.3)
    coarse = Coarse(SearchSettings(), problem, [])
    coarse.solution = direct(problem)
    assert undetermined_controls(coarse.solution) == ("entry.lift_up, lift_right",)
    error = no_start_converged_error(derive(problem), coarse, 0, None)
    assert "nothing determines entry.lift_up, lift_right" in error.got and "time of flight" in error.advice
    assert undetermined_controls(direct(returning("propellant", 6.0))) == ()
