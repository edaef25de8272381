"""A crew capsule home: limits along its entry, and what a lift that is switched proves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.models.deorbit import ballistic
from perilune.models.deorbit.fall import fall
from perilune.problem.problem import Problem
from perilune.scenario import load_text
from perilune.structures.read import readings
from perilune.structures.structure import conditions_of
from perilune.words.outcome import InfeasibleError, PeriluneError

EXAMPLE = (Path(__file__).parent.parent / "examples" / "capsule_return.toml").read_text(encoding="utf-8")


def capsule(*changes: tuple[str, str]) -> Problem:
    """The example with parts of its text replaced."""
    text = EXAMPLE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return load_text(text)


BALLISTIC = [
    (line, "")
    for line in EXAMPLE.splitlines(keepends=True)
    if line.startswith(("lift_to_drag", "bank"))
]  # fmt: skip


def test_a_limit_of_the_load_is_moved_by_the_lift_in_two_steps() -> None:
    """A lift across the velocity does not change the speed: it is in the formula of the first rate, to no effect."""
    problem = capsule()
    found = conditions_of(problem, len(problem.phases) - 1, ("load_left",))["load_left"]
    assert found.order == 2


@pytest.mark.parametrize(
    ("limit", "said", "least", "most"),
    [
        ('load = "4.5 g0"', "peak load of every fall without lift", 6.0, 7.8),
        ('dynamic_pressure = "10 kPa"', "peak dynamic pressure", 3e4, 4e4),
        ('heat_rate = "0.3 MW/m^2"', "peak heat rate", 3e5, 1.2e6),
    ],
)
def test_a_limit_that_no_ballistic_entry_keeps_is_refused_with_the_reason(
    limit: str, said: str, least: float, most: float
) -> None:
    problem = capsule(*BALLISTIC, ('load = "4.5 g0"', limit))
    with pytest.raises(InfeasibleError) as error:
        pl.solve(problem)
    assert said in error.value.got and "no ballistic entry that the interface allows" in error.value.what
    assert least < float(error.value.got.split()[-2]) < most


def test_what_is_refused_is_less_than_what_any_fall_bears() -> None:
    """Falls anywhere in the box of angles and speeds peak above what every fall is said to bear."""
    problem = capsule(*BALLISTIC)
    (said,) = (f for f in pl.preflight(problem) if f.name.startswith("peak load"))
    p = problem.parameters({})
    air: Any = problem.preflight.keywords["air"]  # type: ignore[union-attr]
    rng = np.random.default_rng(1)
    speeds = ballistic.box_of_speeds(p)
    assert speeds is not None
    for _ in range(12):
        speed, angle = rng.uniform(speeds[0], speeds[-1]), np.radians(rng.uniform(-2.5, -1.2))
        fallen = fall(p, air, angle, speed, 4001)
        assert ballistic.peak("load", fallen, p, air) / 9.80665 > float(said.value)


def test_limits_that_some_ballistic_entry_keeps_are_not_refused() -> None:
    problem = capsule(*BALLISTIC, ('load = "4.5 g0"', 'load = "8.5 g0"'))
    assert all(f.passed for f in pl.preflight(problem) if f.binding)
    # With lift, and where the speeds at the interface are not known, nothing is said.
    for other in (capsule(), capsule(*BALLISTIC, ('dry_mass = "6703.9 kg"', ""))):
        assert not any(f.name.startswith("peak") for f in pl.preflight(other))


def test_the_arcs_along_a_limit_are_read_off_the_direct_answer() -> None:
    """Down, up, as the limit has it, up and down again. It takes its seconds: two meshes of a whole return."""
    problem = capsule(('model = "us1976"', 'model = "exponential"\ndensity = "1.225 kg/m^3"\nscale_height = "7.2 km"'))
    rough = pl.Pseudospectral(nodes=5, segments=8, refine=0).run(problem)
    arcs = readings(problem, pl.Pseudospectral(nodes=4, segments=32, refine=0).near(rough))[0]
    assert [arc.text.partition(" and touches")[0] for arc in arcs.phases[-1][:5]] == [
        "lift_up at its lower bound",
        "lift_up at its upper bound",
        "along load_left",
        "lift_up at its upper bound",
        "lift_up at its lower bound",
    ]


def test_the_example_flies_along_its_limit() -> None:
    """The direct method has 2095.15 to 2095.17 s on fine meshes. Most of a minute: nothing shorter is of order 2."""
    found = pl.solve(capsule(), level=2)
    assert found.verification.passed and found.objective == pytest.approx(2095.1732, abs=1e-3)
    assert found.results["peak_load"].value == pytest.approx(4.5, rel=1e-9)
    along, touched = (arc for arc in found.structure if "load left" in arc.words)
    assert along.begin == pytest.approx(225.0, abs=0.1) and along.end == pytest.approx(315.9, abs=0.1)
    assert touched.begin == pytest.approx(335.05, abs=0.1)


@pytest.mark.parametrize("aim", ["propellant", "transition_time"])
def test_a_lift_that_changes_nothing_is_named(aim: str) -> None:
    """No bank changes what happens above the air, and without a place any of them arrives."""
    anywhere = ('longitude = "-166.4 deg"\nlatitude = "-43.8 deg"\n', "")
    aimed = ('minimise = "flight_time"', f'minimise = "{aim}"')
    with pytest.raises(PeriluneError, match="the lift is undetermined") as error:
        capsule(anywhere, aimed)
    assert aim in error.value.got
    assert (
        capsule(anywhere)
        and capsule(aimed)
        and capsule(anywhere, aimed, *BALLISTIC, ('load = "4.5 g0"', 'load = "9 g0"'))
    )
