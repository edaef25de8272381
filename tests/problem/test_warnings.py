"""What stands beside an answer: right where something is to be said, and silent where nothing is."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from command_line import ROOT
from perilune.cli import run_command_line
from perilune.models import Approach, UniformGravity, Vehicle, precision_landing
from perilune.models.deorbit.outputs import validity_ranges
from perilune.models.physics.atmosphere import exponential, standard
from perilune.models.physics.standard_atmosphere import HIGHEST
from perilune.problem.display.quantity_names import free_name
from perilune.problem.results.warnings import _warn_of_contact
from perilune.report.summary import solution_markdown, solution_summary
from perilune.scenario import load_file

EXAMPLES = Path(__file__).parents[2] / "examples"
RADIUS, MU, APOAPSIS = 1737.4e3, 4.9028e12, 80e3


def variables(**units: str) -> tuple[pl.Variable, ...]:
    return tuple(pl.Variable(name=name, unit=unit) for name, unit in units.items())


def ascent(radius: str = "R", longest: float = 1500.0, views: pl.Views | None = None) -> pl.Problem:
    """From the ground of the Moon to an orbit at 15 km, in the plane, with nothing that keeps it above the ground."""
    given = {
        "mu": (MU, "m^3/s^2"), radius: (RADIUS, "m"), "thrust": (15.6e3, "N"), "ve": (311 * 9.80665, "m/s"),
        "mass": (4700.0, "kg"), "h1": (15e3, "m"), "h2": (APOAPSIS, "m"),
    }  # fmt: skip

    def at(p: Any) -> Any:
        return getattr(p, radius)

    def dynamics(x: Any, u: Any, p: Any, xp: Any) -> Any:
        push = p.thrust * u.throttle / x.m
        return (
            x.v, push * u.along - x.u * x.v / x.r, push * u.up + x.u**2 / x.r - p.mu / x.r**2,
            -p.thrust * u.throttle / p.ve,
        )  # fmt: skip

    def end(x: Any, p: Any, xp: Any) -> Any:
        low, high = at(p) + p.h1, at(p) + p.h2
        return x.r - low, x.u - xp.sqrt(2 * p.mu * high / (low * (low + high))), x.v

    phase = pl.Phase(
        name="ascent",
        states=variables(r="m", u="m/s", v="m/s", m="kg"),
        controls=(
            pl.UnitVectorControl(names=("along", "up")),
            pl.ScalarControl(name="throttle", unit="1", lower=0.0, upper=1.0),
        ),
        dynamics=dynamics,
        duration="flight_time",
        end=pl.Conditions(end, end_r="m", end_u="m/s", end_v="m/s"),
        end_guess=lambda p, xp: (at(p) + p.h1, 1680.0, 0.0, 0.55 * p.mass),
        outputs=pl.Quantities(lambda x, u, p, xp: (x.r - at(p),), height="m"),
    )
    return pl.Problem(
        name="ascent", phases=(phase,), start=lambda p, xp: (at(p), 0.0, 0.0, p.mass),
        given={name: pl.Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        free=(pl.FreeParameter(name="flight_time", unit="s", lower=0.0, upper=longest, guess=430.0),),
        objective=lambda x, p, xp: -x.m, objective_unit="kg", views=views or pl.Views(),
        scales=pl.Scales(length=1e5, time=100.0, mass=4700.0),
    )  # fmt: skip


@pytest.fixture(scope="module")
def low() -> pl.Solution:
    """The best ascent of 1500 s, that goes through the Moon."""
    return pl.solve(ascent(), verify=0)


def seen_by(solution: pl.Solution, problem: pl.Problem) -> pl.Solution:
    return replace(solution, problem=problem)


def test_a_duration_on_its_bound_and_a_flight_below_the_ground_are_said(low: pl.Solution) -> None:
    """By how much and when are those of a dense look at its tables."""
    t = np.linspace(0.0, low.duration, 200_001)
    height = low.trajectories[0].state(t)[:, 0] - RADIUS
    bound, ground = low.warnings
    assert bound.startswith("flight time is at its upper bound of 1500 s")
    assert height.min() < -8e3
    assert f"{-height.min() / 1e3:.3g} km below the ground at {t[height.argmin()]:.4g} s" in ground
    assert ground.startswith("if R is the radius of the body")


def test_with_a_view_of_the_height_nothing_is_guessed(low: pl.Solution) -> None:
    seen = seen_by(low, ascent(views=pl.Views(height="height", radius="R")))
    assert any(said.startswith("the flight goes 8.28 km below the ground") for said in seen.warnings)


def test_where_nothing_says_how_large_the_body_is_nothing_is_said_of_its_ground(low: pl.Solution) -> None:
    assert not any("ground" in said for said in seen_by(low, ascent(radius="size")).warnings)


def test_a_parameter_within_its_bounds_is_not_named(low: pl.Solution) -> None:
    assert not any("bound" in said for said in seen_by(low, ascent(longest=1600.0)).warnings)


def test_what_the_model_is_not_meant_for_is_said_with_its_reason(low: pl.Solution) -> None:
    """Of a state, of an output, and of none within its range."""
    because = "a spherical body (a book)"
    views = pl.Views(
        meant_for=(
            pl.views.ValidRange(quantity="height", lower=-5e3, because=because),
            pl.views.ValidRange(quantity="u", upper=1e3, because=because, title="speed along"),
            pl.views.ValidRange(quantity="v", upper=1e4, because=because),
        )
    )
    said = [text for text in seen_by(low, ascent(views=views)).warnings if because in text]
    fastest = low.trajectories[0].state(np.linspace(0, low.duration, 100_001))[:, 1].max()
    assert len(said) == 2 and said[0].startswith("height reaches -8.28e+03 m")
    assert said[1].startswith(f"speed along reaches {fastest:.3g} m/s")


def test_a_range_of_a_quantity_that_is_not_there_is_refused() -> None:
    views = pl.Views(meant_for=(pl.views.ValidRange(quantity="hight", because=""),))
    with pytest.raises(pl.PeriluneError, match="did you mean 'height'"):
        ascent(views=views)
    with pytest.raises(pl.PeriluneError, match="phase"):
        ascent(views=pl.Views(meant_for=(pl.views.ValidRange(quantity="u", because="", phases=("descent",)),)))
    with pytest.raises(pl.PeriluneError, match="upper end of a range"):
        pl.views.ValidRange(quantity="u", because="", upper=float("nan"))


def test_they_are_saved_with_the_problem(low: pl.Solution, tmp_path: Path) -> None:
    views = pl.Views(meant_for=(pl.views.ValidRange(quantity="u", upper=1e3, because="a book"),))
    seen = seen_by(low, ascent(views=views))
    pl.save(seen, tmp_path / "kept")
    assert pl.load(tmp_path / "kept").warnings == seen.warnings and len(seen.warnings) == 3


def test_the_terminal_and_the_report_say_them(low: pl.Solution) -> None:
    assert f"warning: {low.warnings[0]}" in solution_summary(low)
    assert "## Warnings" in (text := solution_markdown(low)) and "below the ground" in text


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("hybrid_lander", []),
        ("precision_landing", []),
        ("mars_pinpoint", ["height above glide slope is at its limit at 32.8"]),
    ],
)
def test_shipped_examples_say_what_a_colleague_would(name: str, said: list[str]) -> None:
    """No false alarm: a retro burn inside its range, a slope that is touched and one that is not."""
    found = pl.solve(load_file(EXAMPLES / f"{name}.toml").problem, verify=0).warnings
    assert len(found) == len(said) and all(map(str.startswith, found, said))


def test_all_propellant_burnt_is_said() -> None:
    """The dry mass of the hybrid lander set to what it lands with: a limit that is reached, and named by its key."""
    problem = load_file(EXAMPLES / "ordinary_lander.toml").problem
    landed = pl.solve(problem, verify=0).results["landed_mass"].value
    scenario = load_file(EXAMPLES / "ordinary_lander.toml", [f"vehicle.dry_mass={landed - 1e-7:.9f} kg"])
    found = pl.solve(scenario.problem, verify=0).warnings
    assert any(said.startswith("vehicle.dry_mass of") and said.endswith("is reached") for said in found)


def test_flat_ground_is_for_the_last_kilometres() -> None:
    """From 14 km up the answer is one of flat ground, which is said; from 1 km nothing is."""
    lander = Vehicle(mass=2000.0, thrust=8000.0, specific_impulse=310.0)
    found = []
    for up in (14e3, 1e3):
        start = Approach(east=-1e3, north=0.0, up=up, up_speed=-20.0)
        problem = precision_landing(lander, start, None, None, (0.3, 1.0), UniformGravity(gravity=1.62))
        found.append(pl.solve(problem, verify=0).warnings)
    assert [said for said in found[0] if said.startswith("height reaches 1.4e+04 m") and "round body" in said]
    assert not any("round body" in said for said in found[1])


def test_the_air_and_its_heat_are_known_in_their_ranges() -> None:
    """Of the standard atmosphere up to its last row; of a vehicle without a nose radius no heat."""
    hot, cold = validity_ranges(standard(), heat=True), validity_ranges(exponential(1.2, 7e3), heat=False)
    assert [valid.quantity for valid in hot] == ["altitude", "heat_rate", "speed"] and cold == ()
    assert hot[0].upper == HIGHEST and hot[1].upper == 1e6 and "Sutton" in hot[1].because
    assert validity_ranges(None, heat=True) == ()


def test_json_lists_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["solve", str(EXAMPLES / "mars_pinpoint.toml"), "--level", "1", "--json"]) == 0
    (said,) = json.loads(capsys.readouterr().out)["warnings"]
    assert said.startswith("height above glide slope is at its limit")


@pytest.mark.parametrize(
    ("up", "said"),
    [
        ("1 km", "coast time is at its lower bound of 0.001 s: the optimal flight has no phase coast"),
        (
            "2 km",
            "coast time is at its upper bound of 10 s, approach.longest_coast: with a wider one the optimum may"
            " be better",
        ),
    ],
)
def test_a_coast_on_its_bound_names_the_key_that_states_it_or_that_none_is_best(up: str, said: str) -> None:
    problem = load_file(
        EXAMPLES / "precision_landing.toml", ["approach.longest_coast=10 s", f"approach.up={up}"]
    ).problem
    assert said in pl.solve(problem, verify=0).warnings


def test_a_free_parameter_is_called_by_its_key_or_in_words() -> None:
    lander, capsule = (load_file(ROOT / "examples" / f"{n}.toml").problem for n in ("hybrid_lander", "capsule_return"))
    assert [free_name(lander, name) for name in lander.free_names] == ["retro.delta_v", "flight time"]
    assert free_name(capsule, "burn_time") == "burn time"


@pytest.mark.parametrize(
    ("room", "said"),
    [
        (lambda s: (s - 2.0) ** 2 * (s - 6.0) ** 2, "at 12 s and at 16 s"),
        (lambda s: np.maximum(0.0, np.abs(s - 4.0) - 2.0), "between 12 and 16 s"),
        (lambda s: np.maximum(0.0, s - 4.0) * np.abs(s - 7.0), "between 10.04 and 14 s and at 17 s"),
        (lambda s: np.where(np.abs(s - 4.0) < 2.0, 1e-5 * np.sin(9.0 * s) ** 2, s**2), "between 12"),
    ],
)
def test_a_limit_that_is_left_and_reached_again_is_told_so(room: Callable[[Any], Any], said: str) -> None:
    """Two touches are no ride; what flutters along a limit by the error of a mesh is one."""
    t = np.linspace(0.005, 0.995, 199) * 8.0
    t = np.sort(np.concatenate([t, [2.0, 6.0, 7.0]]))
    (text,) = _warn_of_contact("room", t, room(t), room, 10.0)
    assert text.startswith(f"room is at its limit {said}") and text.count("between") == said.count("between")
