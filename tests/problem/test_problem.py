"""The record of a problem refuses what it cannot mean."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, cast

import pytest

from perilune.core import PeriluneError
from perilune.problem.controls import ScalarControl, UnitVectorControl
from perilune.problem.display.views import Space, Views
from perilune.problem.named_values import Conditions, Quantities
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.problem.variables import FreeParameter, Parameter, Variable


def slider(**changes: Any) -> Problem:
    """A cart pushed by a steerable force, in metres and seconds."""
    phase = Phase(
        name="slide",
        states=(Variable(name="x", unit="m"), Variable(name="v", unit="m/s")),
        controls=(UnitVectorControl(names=("along", "across")),),
        dynamics=lambda x, u, p, xp: (x.v, p.push * u.along),
        duration="time",
        end=Conditions(lambda x, p, xp: (x.x - p.distance, x.v), distance="m", speed="m/s"),
    )
    settings: dict[str, Any] = {
        "name": "slider",
        "phases": (phase,),
        "start": lambda p, xp: (0.0, 0.0),
        "given": {"push": Parameter(value=2.0, unit="m/s^2"), "distance": Parameter(value=8.0, unit="m")},
        "free": (FreeParameter(name="time", unit="s", lower=0.0, guess=4.0),),
        "objective": lambda x, p, xp: p.time,
        "objective_unit": "s",
    }
    return Problem(**{**settings, **changes})


def test_a_sound_problem_is_accepted() -> None:
    """And says its names."""
    problem = slider()
    assert problem.free_names == ("time",)
    assert problem.unit_of("distance") == "m"


def test_what_is_named_twice_is_refused() -> None:
    """Values of free parameters, multipliers and tables go by these names: the second would stand for both."""
    (phase,), (time,) = slider().phases, slider().free
    with pytest.raises(PeriluneError, match="two free parameters are called time"):
        slider(free=(time, replace(time, lower=1.0)))
    with pytest.raises(PeriluneError, match="two phases are called slide"):
        slider(phases=(phase, phase), links=(lambda x, p, xp: (x.x, x.v),))
    slider(phases=(phase, replace(phase, name="glide")), links=(lambda x, p, xp: (x.x, x.v),))


def sized(kind: str, name: str, unit: str = "m") -> dict[str, Any]:
    """Return a field of a phase or a problem that computes the distance from the start."""
    takes: dict[str, Any] = {
        "end_outputs": lambda x, p, xp: (x.x,), "integrals": lambda x, u, p, xp: (x.v,),
        "results": lambda first, last, p, xp: (last.x,),
    }  # fmt: skip
    return {kind: Quantities(takes[kind], **{name: unit})}


@pytest.mark.parametrize(
    ("phase", "problem", "words"),
    [
        (sized("end_outputs", "objective"), {}, ("called objective", "`end_outputs` of the phase slide", "state `res")),
        (sized("end_outputs", "flight_time"), {}, ("called flight_time", "of every problem without `results`")),
        (sized("integrals", "flight_time"), {}, ("called flight_time", "`integrals` of the phase slide")),
        (sized("end_outputs", "way"), sized("results", "way"), ("called way", "one of `results`, and", "the latter")),
        (sized("end_outputs", "way") | sized("integrals", "way"), {}, ("called way", "`end_outputs`", "`integrals`")),
        (sized("integrals", "peak_x"), {"views": Views(peaks=("x",))}, ("called peak_x", "`integrals`", "`peaks`")),
    ],
)
def test_two_results_of_one_name_are_refused(phase: Any, problem: Any, words: tuple[str, ...]) -> None:
    """A solution would have one of them, or for an integral their sum."""
    with pytest.raises(PeriluneError, match="two results are called") as caught:
        slider(phases=(replace(slider().phases[0], **phase),), **problem)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_results_take_the_names_of_those_that_they_replace() -> None:
    (phase,) = slider().phases
    slider(phases=(replace(phase, **sized("end_outputs", "objective")),), **sized("results", "way"))
    slider(**sized("results", "flight_time", "m"))
    slider(**sized("results", "time"))  # of a free parameter, which is no result


def test_integrals_of_phases_add_up_in_one_unit() -> None:
    (phase,) = slider().phases
    first, second = (replace(phase, name=name, **sized("integrals", "way")) for name in ("slide", "glide"))
    links = (lambda x, p, xp: (x.x, x.v),)
    slider(phases=(first, second), links=links)
    other = replace(second, integrals=Quantities(lambda x, u, p, xp: (x.x,), way="m*s"))
    with pytest.raises(PeriluneError, match=r"way, have different units(.|\n)*got: m\*s in the phase glide"):
        slider(phases=(first, other), links=links)


def test_a_hidden_constant_is_found() -> None:
    """A dimensional number typed into the physics would be wrong in canonical units."""
    phase = replace(slider().phases[0], dynamics=lambda x, u, p, xp: (x.v, p.push * u.along - 9.81))
    with pytest.raises(PeriluneError, match=r"not dimensionally homogeneous: dynamics of slide, v"):
        slider(phases=(phase,))


@pytest.mark.parametrize(
    ("rate", "got", "expected"),
    [
        (lambda x, u, p, xp: p.push * u.along - 9.81,
         "p.push*u.along in m/s^2, beside 9.81 without a unit, in p.push*u.along - 9.81", "the same unit for both"),
        (lambda x, u, p, xp: x.v, "x.v in m/s", "a quantity in m/s^2"),
        (lambda x, u, p, xp: p.push * xp.exp(-x.x / 500.0), "(-x.x)/500 in m, in xp.exp((-x.x)/500)",
         "a number without a unit there"),
        (lambda x, u, p, xp: xp.sqrt(p.push * x.x) + p.push, "xp.sqrt(p.push*x.x) in m/s, beside p.push in m/s^2, in "
         "xp.sqrt(p.push*x.x) + p.push", "the same unit for both"),
        (lambda x, u, p, xp: p.push * (x.x - x.v) / p.distance, "x.x in m, beside x.v in m/s, in x.x - x.v",
         "the same unit for both"),
        (lambda x, u, p, xp: p.push**2, "p.push**2 in m^2/s^4", "a quantity in m/s^2"),
        (lambda x, u, p, xp: 0.0 - x.v / 3.0, "0 - x.v/3 in m/s", "a quantity in m/s^2"),
        (lambda x, u, p, xp: x.v - (x.v - 2.0 * x.v), "x.v - (x.v - 2*x.v) in m/s", "a quantity in m/s^2"),
        (lambda x, u, p, xp: xp.fmin(x.x / p.distance, math.inf) + x.x, "xp.fmin(x.x/p.distance, inf) without a unit, "
         "beside x.x in m, in xp.fmin(x.x/p.distance, inf) + x.x", "the same unit for both"),
        (lambda x, u, p, xp: xp.sqrt(p.distance * p.distance) + p.distance + x.x + x.x + x.x,  # no dots: it is whole
         "xp.sqrt(p.distance*p.distance) + p.distance + x.x + x.x + x.x in m", "a quantity in m/s^2"),
        (lambda x, u, p, xp: p.push + xp.atan2(x.x, x.v), "x.x in m, beside x.v in m/s, in xp.atan2(x.x, x.v)",
         "the same unit for both"),
    ],
)  # fmt: skip
def test_units_that_clash_are_named_in_the_users_formula(rate: Any, got: str, expected: str) -> None:
    phase = replace(slider().phases[0], dynamics=lambda x, u, p, xp: (x.v, rate(x, u, p, xp)))
    with pytest.raises(PeriluneError) as caught:
        slider(phases=(phase,))
    assert caught.value.what.endswith("dynamics of slide, v")
    assert (caught.value.got, caught.value.expected) == (got, expected)
    assert "in SI" not in str(caught.value)


def test_a_long_formula_is_cut_where_it_is_deep() -> None:
    """Each square holds the one before twice: 18 of them would be a million letters."""

    def rate(x: Any, u: Any, p: Any, xp: Any) -> tuple[Any, Any]:
        value = p.push
        for _ in range(18):
            value = value * value / p.push
        return x.v, value + x.x

    with pytest.raises(PeriluneError) as caught:
        slider(phases=(replace(slider().phases[0], dynamics=rate),))
    assert caught.value.got is not None and "(...)" in caught.value.got


def test_a_comparison_with_a_bare_number_is_refused() -> None:
    # No value shows it: both branches scale as they should.
    def changed(compared: Any) -> Problem:
        rate = lambda x, u, p, xp: (x.v, xp.where(compared(x, p), p.push, 2 * p.push) * u.along)  # noqa: E731
        return slider(phases=(replace(slider().phases[0], dynamics=rate),))

    with pytest.raises(PeriluneError, match="dynamics of slide") as caught:
        changed(lambda x, p: x.x < 3.0)
    assert caught.value.got == "x.x in m, beside 3 without a unit, in x.x < 3"
    changed(lambda x, p: x.x < 0.25 * p.distance)
    changed(lambda x, p: x.v > 0.0)


def test_units_that_clash_are_named_in_links_and_ends_too() -> None:
    one = slider()
    first = replace(one.phases[0], name="first", end=None)
    with pytest.raises(PeriluneError, match=r"link to slide, v(.|\n)*got: x.x in m\n"):
        slider(phases=(first, one.phases[0]), links=(lambda x, p, xp: (x.x, x.x),))
    ended = replace(
        one.phases[0], end=Conditions.of(lambda x, p, xp: (x.x - p.push, x.v), one.phases[0].end_conditions)
    )
    with pytest.raises(PeriluneError, match=r"end of slide, .*(.|\n)*x.x in m, beside p.push in m/s\^2"):
        slider(phases=(ended,))
    with pytest.raises(PeriluneError, match=r"objective, J(.|\n)*got: x.x in m\n"):
        slider(objective=lambda x, p, xp: x.x)


@pytest.mark.parametrize("size", [1e308, 1e-4, 1e-300])
@pytest.mark.parametrize("name", ["exp", "sinh", "cosh"])
def test_absurd_values_are_tried_without_a_warning(name: str, size: float) -> None:
    """They overflow where the physics is tried; that is no fault of its text."""

    def dynamics(x: Any, u: Any, p: Any, xp: Any) -> Any:
        return x.v, p.push * u.along + p.push * getattr(xp, name)(x.x / p.distance)

    phase = replace(slider().phases[0], dynamics=dynamics)
    values = {**slider().given, "distance": Parameter(value=size, unit="m")}
    assert slider(phases=(phase,), given=values).form == slider(phases=(phase,)).form


def test_wrong_number_of_rates() -> None:
    """Named, with what is expected."""
    phase = replace(slider().phases[0], dynamics=lambda x, u, p, xp: (x.v,))
    with pytest.raises(PeriluneError, match=r"dynamics of slide returns the wrong number(.|\n)*got: 1(.|\n)*2: x, v"):
        slider(phases=(phase,))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"phases": ()}, "at least one phase"),
        ({"links": (lambda x, p, xp: (),)}, "needs a link"),
        (
            {"free": (FreeParameter(name="push", unit="m/s^2"), FreeParameter(name="time", unit="s"))},
            "both given and free: *|got: push",
        ),
        ({"given": {"push": Parameter(value=float("inf"), unit="m/s^2")}}, "value of push is not finite"),
        ({"free": (FreeParameter(name="time", unit="s", lower=2.0, upper=1.0),)}, "bounds of time are empty"),
        ({"free": (FreeParameter(name="tme", unit="s"),)}, "did you mean 'tme'"),
    ],
)
def test_inconsistent_problems(changes: dict[str, Any], words: str) -> None:
    """Each is refused in the user's words."""
    with pytest.raises(PeriluneError, match=words):
        slider(**changes)


@pytest.mark.parametrize("unit", ["kg", "m", "1"])
def test_a_duration_is_a_time(unit: str) -> None:
    """Free or given: in scales in which a kilogram is as much as a second the physics would not show it."""
    with pytest.raises(PeriluneError, match=f"the duration time of slide has another dimension(.|\n)*time in {unit}"):
        slider(free=(FreeParameter(name="time", unit=unit, lower=0.0, guess=1.0),))
    given = {**slider().given, "time": Parameter(value=1.0, unit=unit)}
    with pytest.raises(PeriluneError, match="the duration time of slide has another dimension"):
        slider(free=(), given=given)


def test_parameters_that_place_a_flight_have_the_dimension_of_that() -> None:
    with pytest.raises(PeriluneError, match=r"the rate of rotation push of the views(.|\n)*a parameter in rad/s"):
        slider(views=Views(space=Space(body="moon", rotation="push")))
    with pytest.raises(PeriluneError, match=r"the radius push of the views(.|\n)*a parameter in m"):
        slider(views=Views(radius="push"))


def test_unknown_parameter_offers_the_nearest() -> None:
    """A typo in a sweep."""
    with pytest.raises(PeriluneError, match="did you mean 'distance'"):
        slider().with_given(distanse=3.0)


def test_given_fixes_a_free_parameter() -> None:
    """And the values are the problem's own afterwards."""
    fixed = slider().with_given(time=3.0)
    assert fixed.free == ()
    assert fixed.given["time"] == Parameter(value=3.0, unit="s")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Variable(name="2x"), "identifier"),
        (lambda: Variable(name="x", unit="furlong"), "not a unit"),
        (lambda: Parameter(value=2.0, unit="km"), "numbers are in SI"),
        (lambda: FreeParameter(name="t", unit="min"), "numbers are in SI: t"),
        (lambda: Variable(name="x", lower=1.0, upper=1.0), "bounds of x are empty"),
        (
            lambda: Variable(name="x", lower=cast("Any", None), upper=1.0),
            r"the lower bound of x[\s\S]*got: None[\s\S]*try: omit lower",
        ),
        (lambda: Variable(name="x", lower="least", upper=cast("Any", None)), "the upper bound of x"),
        (lambda: ScalarControl(name="u", upper=cast("Any", None)), "the upper bound of u"),
        (lambda: FreeParameter(name="t", unit="s", lower=cast("Any", None)), r"the lower bound of t\n *got: None"),
        (lambda: FreeParameter(name="t", unit="s", guess=cast("Any", None)), "the guess of t"),
        (lambda: UnitVectorControl(names=("a",)), "two or three"),
    ],
)
def test_inconsistent_parts(make: Any, words: str) -> None:
    """Variables and controls check themselves."""
    with pytest.raises(PeriluneError, match=words):
        make()


def test_bounded_control_has_one_name() -> None:
    """As a component of u."""
    assert ScalarControl(name="throttle", lower=0.1, upper=1.0).names == ("throttle",)


def test_the_middle_of_a_range_and_the_shares_of_it() -> None:
    """Where a first guess begins, and how far it may go: of an open range from the bound that there is."""
    p: Any = None
    throttle = ScalarControl(name="throttle", lower=0.2, upper=1.0)
    assert throttle.middle(p) == pytest.approx((0.6, 0.32))
    assert ScalarControl(name="force", lower=2.0).middle(p) == (2.0, math.inf)
    assert ScalarControl(name="force", upper=-2.0).middle(p) == (-2.0, math.inf)
    assert ScalarControl(name="force").middle(p) == (0.0, math.inf)
    assert [throttle.share(u, p) for u in (0.2, 0.6, 1.0)] == pytest.approx([0.0, 0.5, 1.0])


@pytest.mark.parametrize(
    ("states", "controls", "words"),
    [
        (("time", "v"), "push", "time cannot be the name of a state[\\s\\S]*the time since the phase began"),
        (("phase", "v"), "push", "phase cannot be the name of a state"),
        (("x", "H"), "push", "H cannot be the name of a state[\\s\\S]*the Hamiltonian"),
        (("x", "lambda_x"), "push", "lambda_x cannot be the name of a state[\\s\\S]*the costate of x"),
        (("x", "push"), "push", "push cannot be the name of a control[\\s\\S]*the name of a state"),
        (("x", "x"), "push", "two states of the phase swing are called x"),
        (("x", "_v"), "push", "or begin with _"),
        (("x", "v"), "lambda", "a Python keyword"),
    ],
)
def test_a_name_that_a_table_has_for_something_else_is_refused(states: Any, controls: str, words: str) -> None:
    """It stood in tables and files in place of the time, the phase, a costate or H, or was lost."""
    with pytest.raises(PeriluneError, match=words):
        phase = replace(slider().phases[0], name="swing", states=tuple(Variable(name=name) for name in states))
        slider(phases=(replace(phase, controls=(ScalarControl(name=controls),)),))


@pytest.mark.parametrize("name", ["", "two words", "../out", "a\nb", cast("Any", 5)])
def test_a_phase_is_called_as_a_part_of_a_file_name_may_be(name: Any) -> None:
    """Tables are named by it."""
    with pytest.raises(PeriluneError, match="name"):
        slider(phases=(replace(slider().phases[0], name=name),))


def test_a_column_has_one_unit_in_all_phases() -> None:
    """The unit of the last phase stood above the numbers of all."""
    (first,) = slider().phases
    one, two = (
        replace(first, name=name, outputs=Quantities(lambda x, u, p, xp: (x.v,), q=unit))
        for name, unit in (("one", "m/s"), ("two", "m"))
    )
    with pytest.raises(PeriluneError, match=r"q has a different unit in the phase two[\s\S]*got: m\n *expected: m/s"):
        slider(phases=(one, two), links=(lambda x, p, xp: tuple(x),))


@pytest.mark.parametrize("changes", [{"name": 5}, {"title": None}])
def test_a_problem_is_called_by_a_text(changes: Any) -> None:
    with pytest.raises(PeriluneError, match=f"not the {next(iter(changes))} of a problem"):
        slider(**changes)
