"""Which limit stands in the way: against a closed form, against what flies just beyond it, and in words."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

import perilune as pl
from perilune.cli import run_command_line
from perilune.core import NotConvergedError
from perilune.direct.elastic_constraint import elastic_limits
from perilune.io import extremals_document
from perilune.methods.binding_limit import with_binding_limit
from perilune.methods.indirect.chattering import detect_chattering
from perilune.methods.indirect.coarse_direct import Coarse
from perilune.methods.indirect.diagnosis import NO_EXTREMAL
from perilune.methods.indirect.indirect import Indirect
from perilune.problem import is_possible, limit_name, parameter_key, preflight, quantity_name
from perilune.scenario import load_file

EXAMPLES = Path(__file__).parents[2] / "examples"


def variables(**units: str) -> tuple[pl.Variable, ...]:
    return tuple(pl.Variable(name=name, unit=unit) for name, unit in units.items())


def moved(
    duration: float = 1.5, hardest: float = 1.0, minimised: str = "", scales: pl.Scales | None = None
) -> pl.Problem:
    """One metre from rest to rest, by a push between -1 and `hardest` m/s^2, in a given time at most."""
    phase = pl.Phase(
        name="move", states=variables(x="m", v="m/s"),
        controls=(pl.ScalarControl(name="push", unit="m/s^2", lower=-1.0, upper="hardest"),),
        dynamics=lambda x, u, p, xp: (x.v, u.push), duration="flight_time",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.way, x.v), place="m", rest="m/s"), 
        end_guess=lambda p, xp: (p.way, 0.0),
    )  # fmt: skip
    given = {
        "way": pl.Parameter(value=1.0, unit="m"),
        "hardest": pl.Parameter(value=hardest, unit="m/s^2"),
        "spare": pl.Parameter(value=3.0, unit="s"),
    }
    return pl.Problem(
        name="move", phases=(phase,), start=lambda p, xp: (0.0, 0.0), given=given,
        free=(pl.FreeParameter(name="flight_time", unit="s", lower=0.1, upper=duration, guess=duration),),
        objective=lambda x, p, xp: p.flight_time, objective_unit="s",
        results=pl.Quantities(lambda first, last, p, xp: (p.flight_time + p.spare,), clock="s"),
        minimised=minimised, scales=scales or pl.Scales(),
    )  # fmt: skip


def failed(problem: pl.Problem) -> NotConvergedError:
    with pytest.raises(NotConvergedError) as caught:
        pl.Pseudospectral(nodes=5, segments=8, refine=0).run(problem)
    return caught.value


@pytest.mark.parametrize("scales", [pl.Scales(), pl.Scales(length=3.0, time=5.0)])
def test_the_bound_of_a_control_gives_as_much_as_a_closed_form_says(scales: pl.Scales) -> None:
    """To brake at 1 and be there in T = 1.5 s the push is a with 1/a + 1 = T^2/2: 8 m/s^2, 7 more than there are."""
    problem = moved(scales=scales)
    error = with_binding_limit(problem, failed(problem))
    assert error.what.startswith("no flight was found that keeps every limit: the best violates ")
    relaxed = {one["limit"]: one["amount"] for one in error.partial["relaxations"]}
    assert relaxed["hardest"] == pytest.approx(7.0, rel=0.05)
    # To be there in the least time takes 2 s.
    assert relaxed["the upper bound of flight time"] == pytest.approx(0.5, rel=0.02)
    assert "violates the upper bound of flight time by about 0.5 s" in error.what
    # And to brake as hard: the same by symmetry.
    assert relaxed["the lower bound of push"] == pytest.approx(7.0, rel=0.05)


def test_what_is_got_and_expected_is_what_the_first_line_names() -> None:
    problem = moved()
    error = with_binding_limit(problem, failed(problem))
    name = error.partial["relaxations"][0]["limit"]
    assert all(name in text for text in (error.what, error.got, error.expected, error.advice))


def test_a_problem_that_flies_has_nothing_in_the_way() -> None:
    """An error without a flight, or whose flight misses nothing, is left as it is."""
    problem, error = moved(duration=3.0), NotConvergedError("nothing", partial={"violations": []})
    assert with_binding_limit(problem, error) is error
    error = NotConvergedError("nothing", partial={"violations": ["place"]})
    assert with_binding_limit(problem, error) is error


def test_every_limit_can_be_relaxed() -> None:
    """Bounds of states and controls, conditions of the path, and ends by unit; the relaxed problem is well stated."""
    problem = load_file(EXAMPLES / "precision_landing.toml").problem
    limits = elastic_limits(problem)
    kinds = [limit.kind for limit in limits]
    assert kinds.index("end") == len(kinds) - 2  # metres, and metres per second
    names = {limit.names[0] for limit in limits}
    assert {"m", "throttle", "height_above_glide_slope", "pointing_margin", "site_east", "rest_east"} <= names
    for limit in limits:
        relaxed = limit.relaxed(problem)
        assert set(relaxed.free_names) > set(problem.free_names)
        assert relaxed.form.digest != problem.form.digest


def test_a_vehicle_is_blamed_for_its_dry_mass_and_not_the_slope() -> None:
    """By what the indirect method lands without that dry mass: 1504.5486 kg of the 1505 kg that are asked for."""
    path = EXAMPLES / "mars_pinpoint.toml"
    with pytest.raises(NotConvergedError) as caught:
        pl.solve(load_file(path, ["vehicle.mass=1901.19 kg"]).problem, verify=0)
    lighter = load_file(path, ["vehicle.mass=1901.19 kg", "vehicle.dry_mass=1400 kg"]).problem
    landed = pl.solve(lighter, verify=0).results["landed_mass"].value
    first = caught.value.partial["relaxations"][0]
    assert first["limit"] == "vehicle.dry_mass" and first["amount"] == pytest.approx(1505 - landed, rel=0.02)
    assert "violates vehicle.dry_mass by about 0.45 kg" in caught.value.what
    assert caught.value.got.startswith("all other limits can be kept with vehicle.dry_mass 1504.5")
    *ways, easier = caught.value.advice.removeprefix("one of these: ").split("; ")
    assert [way.partition(" ")[0] for way in ways] == [
        "vehicle.dry_mass", "throttle.upper", "corridor.slope", "throttle.lower"
    ] and easier.startswith("more thrust")  # fmt: skip
    for way in ways:  # who types what would do is not refused again
        name, _, value = way.partition(" ")
        solved = pl.solve(load_file(path, ["vehicle.mass=1901.19 kg", f"{name}={value}"]).problem, verify=0)
        assert solved.results["landed_mass"].value > 1504.5


WEAK = "vehicle.thrust=4.65 kN"


@cache
def refused_for_its_thrust() -> NotConvergedError:
    """Return what the search for a landing with too little thrust ends with."""
    with pytest.raises(NotConvergedError) as caught:
        pl.solve(load_file(EXAMPLES / "precision_landing.toml", [WEAK]).problem, verify=0)
    return caught.value


def test_a_thrust_is_blamed_and_what_is_said_to_suffice_flies() -> None:
    """4.65 kN are too few at 90 % throttle, at 92.7 % they are not: 93.5 % lands. What is weaker is seen at once."""
    path = EXAMPLES / "precision_landing.toml"
    assert not is_possible(preflight(load_file(path, ["vehicle.thrust=4.5 kN"]).problem))
    found = {one["limit"]: one["amount"] for one in refused_for_its_thrust().partial["relaxations"]}
    assert found["throttle.upper"] == pytest.approx(0.027, abs=0.003)
    assert (
        pl.solve(load_file(path, [WEAK, "throttle.upper=0.935"]).problem, verify=0).results["landed_mass"].value > 1200
    )


FLIP = {
    "g": (9.81, "m/s^2"), "thrust": (4.4e6, "N"), "ve": (3300.0, "m/s"), "mass": (130e3, "kg"), "x0": (200.0, "m"),
    "h0": (900.0, "m"), "vx0": (-10.0, "m/s"), "vy0": (-85.0, "m/s"), "tilt": (1.0471975511965976, "rad"),
}  # fmt: skip


def floored(floor: float) -> pl.Problem:
    """A landing burn that begins too early for a throttle floor of 0.4, which lifts more than the weight."""

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
        push = p.thrust * u.throttle / x.m
        return x.vx, x.vy, push * u.along, push * u.up - p.g, -p.thrust * u.throttle / p.ve

    burn = pl.Phase(
        name="burn",
        states=variables(x="m", y="m", vx="m/s", vy="m/s", m="kg"),
        controls=(
            pl.UnitVectorControl(names=("along", "up")),
            pl.ScalarControl(name="throttle", lower=floor, upper=1.0),
        ),
        dynamics=rates,
        duration="flight_time",
        end=pl.Conditions(lambda x, p, xp: (x.x, x.y, x.vx, x.vy), end_x="m", end_y="m", end_vx="m/s", end_vy="m/s"),
        end_guess=lambda p, xp: (0.0, 0.0, 0.0, 0.0, 0.95 * p.mass),
        path=pl.Conditions(lambda x, u, p, xp: (u.up - xp.cos(p.tilt),), tilt_margin="1"),
    )
    return pl.Problem(
        name="flip", phases=(burn,), start=lambda p, xp: (p.x0, p.h0, p.vx0, p.vy0, p.mass),
        given={name: pl.Parameter(value=value, unit=unit) for name, (value, unit) in FLIP.items()},
        free=(pl.FreeParameter(name="flight_time", unit="s", lower=0.0, upper=60.0, guess=15.0),),
        objective=lambda x, p, xp: -x.m, objective_unit="kg", scales=pl.Scales(length=500.0, time=10.0, mass=1e5),
    )  # fmt: skip


def test_a_control_that_chatters_is_said_with_its_usual_cause() -> None:
    """The throttle floor lifts 1.38 times the weight, and the thrust is turned back and forth to lift less."""
    assert 0.4 * FLIP["thrust"][0] > FLIP["mass"][0] * FLIP["g"][0]
    with pytest.raises(NotConvergedError, match="it chatters") as caught:
        pl.solve(floored(0.4), verify=0)
    error = caught.value
    assert "jumps" in error.got and "throttle is at its floor (0.4)" in error.got
    assert "time of ignition" in error.advice and "stationarity" not in str(error) and "tried" not in str(error)


def test_a_search_in_vain_is_not_repeated_without_limits() -> None:
    """One metre in 1.5 s takes 1.78 m/s^2, whatever bounds the speed: seen from a line and from the nearest flight."""
    problem, tried = moved(), list[str]()
    (phase,) = problem.phases
    slow = replace(phase, states=(phase.states[0], replace(phase.states[1], upper=5.0)))
    coarse = Coarse(Indirect(), problem.changed(phases=(slow,), form=None), tried)
    assert coarse.solve() is None and "nearest miss" in tried.pop()
    assert coarse.without_limits() is None
    assert len(tried) == 2 and "nearest miss" not in " ".join(tried)


def test_an_ordinary_flight_does_not_chatter() -> None:
    """Two switches of a throttle, and a direction that turns."""
    problem = load_file(EXAMPLES / "precision_landing.toml").problem
    flight = Coarse(Indirect(), problem, []).solve()
    assert flight is not None and detect_chattering(flight) is None


def test_the_log_of_the_search_is_shown_with_verbose_alone(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pl, "solve", Mock(side_effect=refused_for_its_thrust()))
    words = ["solve", str(EXAMPLES / "precision_landing.toml"), "--set", WEAK, "--level", "0"]
    assert run_command_line(words) == 4
    assert "random costates" not in (short := capsys.readouterr().err) and "IPOPT" not in short
    assert run_command_line([*words, "--verbose"]) == 4
    assert "    - random costates" in capsys.readouterr().err


def test_limits_are_called_by_the_key_that_states_them() -> None:
    problem = load_file(EXAMPLES / "precision_landing.toml").problem
    mass = problem.phases[0].states[-1]
    assert limit_name(problem, mass, "lower") == "vehicle.dry_mass" and quantity_name(mass) == "mass (m)"
    assert parameter_key(problem, "corridor_slope") == "corridor.slope" and parameter_key(problem, "mine") == "mine"
    bare = SimpleNamespace(name="top_speed", lower=0.0, upper=3.0, description="")
    assert limit_name(problem, bare, "upper") == "the upper bound of top speed"


def test_an_objective_is_shown_in_the_words_of_its_problem() -> None:
    """A result that J is but for 3 s stands in the list of extremals; J itself where none is named."""
    for minimised, column, value in (("clock", "clock", 5.0), ("", "objective", 2.0)):
        solution = pl.solve(moved(duration=9.0, minimised=minimised), verify=0)
        (row,) = extremals_document(solution)
        assert row[column] == pytest.approx(value, abs=1e-9)
        assert ("objective" in row) == (not minimised)


def test_a_name_that_is_no_result_is_no_objective() -> None:
    with pytest.raises(pl.PeriluneError, match="did you mean 'clock'"):
        moved(minimised="clok")


def test_a_failure_says_what_an_extremal_is() -> None:
    assert NO_EXTREMAL.startswith("no extremal was found") and "optimum" in NO_EXTREMAL


def test_a_limit_that_the_relaxed_flight_keeps_already_has_no_parameter_to_name() -> None:
    """The relaxed flight keeps the slope as it is stated: there is no root to look for, which was a fault."""
    changes = ["vehicle.mass=1901.19 kg", "corridor.slope=3.88 deg"]
    with pytest.raises(NotConvergedError, match=r"violates vehicle\.dry_mass by about") as caught:
        pl.solve(load_file(EXAMPLES / "mars_pinpoint.toml", changes).problem, verify=1)
    assert "vehicle.dry_mass 1504.9" in str(caught.value)


def test_what_may_not_be_stated_is_no_advice() -> None:
    """A lander that is too weak wants a throttle of 1.44 where up to 0.9 is given: full thrust is 1."""
    problem = load_file(EXAMPLES / "precision_landing.toml", ["vehicle.thrust=3 kN"]).problem
    error = with_binding_limit(problem, failed(problem))
    assert "throttle.upper" in error.what and "out of its range" in error.got
    assert "throttle.upper" not in error.advice and "more thrust" in error.advice
