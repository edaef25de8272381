"""A problem traced: its address, its travels, and the user's mistakes in the user's words."""

from __future__ import annotations

import copy
import json
import math
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cho import cho_landing
from perilune.core import COMPLEX, NUMERIC, PeriluneError
from perilune.io.tape_json import tape_of
from perilune.problem.named_values import Quantities
from perilune.problem.problem import Problem
from perilune.problem.variables import Parameter
from test_problem import slider


def with_dynamics(dynamics: Any) -> Problem:
    return slider(phases=(replace(slider().phases[0], dynamics=dynamics),))


# -- the address ----------------------------------------------------------------------------------------------------


def test_equal_physics_of_two_factories_is_one() -> None:
    """`slider` makes new functions at each call."""
    one, other = slider(), slider()
    assert one.phases[0].dynamics is not other.phases[0].dynamics
    assert one.form.digest == other.form.digest
    assert one == other
    assert hash(one) == hash(other)


def test_another_process_finds_the_same_address() -> None:
    code = "from test_problem import slider; print(slider().form.digest)"
    said = subprocess.run(
        [sys.executable, "-c", code], cwd=Path(__file__).parent, capture_output=True, text=True, check=True
    )
    assert said.stdout.strip() == slider().form.digest


def test_numbers_and_titles_are_no_part_of_it() -> None:
    """Nor which parameter is free; but the problems are not equal."""
    plain = slider()
    for other in (slider(title="another"), plain.with_given(push=3.0), plain.with_given(time=3.0)):
        assert other.form.digest == plain.form.digest
    assert plain != plain.with_given(push=3.0)
    assert plain == slider(title="another")


def test_physics_units_and_names_are() -> None:
    plain = slider()
    faster = with_dynamics(lambda x, u, p, xp: (x.v, 2 * p.push * u.along))
    more = slider(given={**plain.given, "spare": Parameter(value=1.0, unit="s")})
    assert len({plain.form.digest, faster.form.digest, more.form.digest}) == 3


def test_with_given_does_not_trace_again() -> None:
    plain = slider()
    assert plain.with_given(push=3.0).form is plain.form


# -- what is written down is what is computed -----------------------------------------------------------------------


def physics(x: Any, u: Any, p: Any, xp: Any) -> tuple[Any, ...]:
    """Every kind of operation, in one homogeneous pair of rates."""
    ratio = x.v / (p.push * p.time)
    shape = xp.sin(ratio) + xp.cos(ratio) ** 3 - xp.fabs(xp.tanh(-ratio))
    shape += xp.exp(-(ratio**2)) / (1 + xp.sqrt(1 + ratio * ratio))
    shape += (
        xp.atan2(u.along, 1.5 + u.across) + xp.fmin(ratio, 0.3) * xp.fmax(0.1, ratio) + 2.5**ratio - xp.log(3 + ratio)
    )
    shape += (ratio > 0.2) * 0.25 + xp.asin(0.1 * ratio) + xp.sinh(0.1 * ratio) + np.sqrt(2 + ratio)
    return x.v * shape, p.push * u.along * shape - 3 * p.push * u.across


def test_an_expression_rounds_as_the_function_does() -> None:
    """Bit for bit, over floats, arrays and complex steps."""
    problem = with_dynamics(physics)
    expressed = problem.expressed.phases[0]
    rng = np.random.default_rng(0)
    p = problem.parameters({"time": 4.0})
    for xp, x, u in (
        (NUMERIC, rng.normal(size=2).tolist(), rng.normal(size=2).tolist()),
        (NUMERIC, rng.normal(size=(2, 50)), rng.normal(size=(2, 50))),
        (COMPLEX, rng.normal(size=(2, 50)) + 1e-40j * rng.normal(size=(2, 50)), rng.normal(size=(2, 50))),
    ):
        here, there = problem.phases[0].rates(x, u, p, xp), expressed.rates(x, u, p, xp)
        for a, b in zip(here, there, strict=True):
            np.testing.assert_array_equal(np.asarray(a), np.asarray(b))


def test_models_round_alike_too(landing: Problem) -> None:
    for name, function in landing.form.expressions.items():
        again = json.loads(json.dumps(function.tape.document()))
        states = landing.phases[0].state_names
        known = {"x": landing.phases[0].state_names, "u": landing.phases[0].control_names,
                 "p": (*landing.given, *landing.free_names), "t": ("",), "first": states, "last": states}  # fmt: skip
        assert tape_of(again, known, str(name)) == function.tape


@pytest.mark.parametrize(
    "document",
    [
        None,
        {"instructions": [["import", "os"]], "outputs": [0]},
        {"instructions": [["x", "__class__"]], "outputs": [0]},
        {"instructions": [["const", "__import__('os')"]], "outputs": [0]},
        {"instructions": [["const", "1.0"], ["add", 0, 1]], "outputs": [0]},
        {"instructions": [["const", "1.0"], ["add", 0, -1]], "outputs": [0]},
        {"instructions": [["const", "1.0"], ["add", 0, True]], "outputs": [0]},
        {"instructions": [["const", "1.0"], ["sin", 0, 0]], "outputs": [0]},
        {"instructions": [["const", "1.0"]], "outputs": [1]},
        {"instructions": [["const", "1.0"]] * 50_001, "outputs": [0]},
        {"instructions": [["x", ["x"]], [["const"], "1.0"]], "outputs": [0]},
    ],
)
def test_a_file_is_not_trusted(document: Any) -> None:
    with pytest.raises(PeriluneError, match="expressions of it in the file cannot be read"):
        tape_of(document, {"x": ("x", "v"), "p": ("push",)}, "it")


# -- travelling -----------------------------------------------------------------------------------------------------


def test_a_problem_of_lambdas_travels() -> None:
    plain = slider()
    there = pickle.loads(pickle.dumps(plain))
    assert there == plain
    assert there.form.digest == plain.form.digest
    assert there.source == "expressions from a copy"
    assert plain.source == "the problem's own Python functions"
    assert there.with_given(push=3.0) == plain.with_given(push=3.0)
    assert copy.deepcopy(plain) is plain


def test_ranges_travel_by_name() -> None:
    """The landing's bounds follow from its parameters, over there too; what has no name stays behind."""
    plain = cho_landing()
    there = pickle.loads(pickle.dumps(plain))
    assert there.with_given(vehicle_mass=250.0).free == plain.with_given(vehicle_mass=250.0).free
    unnamed = slider(parameter_bounds=lambda p, xp: {"time": (0.0, 2 * p.distance / p.push, 1.0)})
    assert pickle.loads(pickle.dumps(unnamed)).parameter_bounds is None
    assert pickle.loads(pickle.dumps(unnamed)).free == unnamed.free


# -- the user's own mistakes ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dynamics", "words"),
    [
        (lambda x, u, p, xp: (x.v, p.push * u.along if x.v > 0 else 0.0), r"it branches(.|\n)*xp\.where"),
        (lambda x, u, p, xp: (x.v, max(p.push, p.push * u.along)), r"it branches(.|\n)*xp\.fmax"),
        (lambda x, u, p, xp: (x.v, p.push * u.along * math.sin(u.across)), r"plain number(.|\n)*xp\.sin"),
        (lambda x, u, p, xp: (x.v, p.push * np.interp(u.along, [0, 1], [0, 1])), r"np\.interp(.|\n)*xp\.table"),
        (lambda x, u, p, xp: (x.v, np.where(u.along > 0, p.push, -p.push)), r"np\.where(.|\n)*xp\.where"),
        (
            lambda x, u, p, xp: (abs(x.v), p.push * u.along),
            r"is not a formula(.|\n)*abs, which has no deriv(.|\n)*xp\.fabs",
        ),
        (lambda x, u, p, xp: (np.abs(x.v), p.push * u.along), r"abs, which has no derivative(.|\n)*xp\.fabs"),
        (lambda x, u, p, xp: (np.fabs(x.v), p.push * u.along), r"np\.abs, which has no derivative(.|\n)*xp\.fabs"),
        (lambda x, u, p, xp: (x.v, p.push * np.arctan2(u.along, 2.0)), r"np\.arctan2, which has(.|\n)*xp\.atan2"),
        (lambda x, u, p, xp: (x.v, p.psh * u.along), r"no parameter(.|\n)*p\.psh(.|\n)*did you mean 'push'"),
        (lambda x, u, p, xp: (x.vv, p.push * u.along), r"no state(.|\n)*x\.vv(.|\n)*did you mean 'v'"),
        (lambda x, u, p, xp: (x.v, p.push * u.alon), r"no control(.|\n)*did you mean 'along'"),
        (lambda x, u, p, m: (x.v, p.push * m.arctan(u.along)), r"no function of xp(.|\n)*did you mean 'atan"),
        (lambda x, u, p, xp: None, r"wrong number of values(.|\n)*None: is there a return"),
        (lambda x, u, p, xp: x.v, r"wrong number of values(.|\n)*2: x, v"),
        (lambda x, u, p, xp: (x.v, "fast"), r"returns a value that is not a number(.|\n)*'fast'"),
        (
            lambda x, u, p, xp: np.array([x.v, p.push * u.along]),
            r"array of NumPy(.|\n)*np\.array(.|\n)*a tuple or a list",
        ),
        (lambda x, u, p: (x.v, p.push), r"fails when it is tried(.|\n)*positional"),
        (lambda x, u, p, xp: (x.v, p.push * u.along / 0.0), r"fails when it is tried(.|\n)*ZeroDivisionError"),
        (lambda x, u, p, xp: (x.v, p.push * math.nan), r"dynamics of slide, v is not a number \(NaN\)"),
    ],
)
def test_mistakes_in_the_physics_are_named(dynamics: Any, words: str) -> None:
    with pytest.raises(PeriluneError, match=r"dynamics of slide") as refused:
        with_dynamics(dynamics)
    assert refused.match(words)


def test_a_size_has_its_derivative_where_one_is_taken_and_may_be_told_by_any_function() -> None:
    """Outputs are never differentiated: there `abs` is as good as `xp.fabs`, whose derivative is the sign."""
    slope = with_dynamics(lambda x, u, p, xp: (xp.fabs(x.v), p.push * u.along)).phases[0]
    z = np.array([[0.0 + 0j, 0.0], [3.0 + 1e-40j, -3.0 + 1e-40j]])
    at = (z, np.ones((2, 2)), slider().parameters({"time": 4.0}), COMPLEX)
    assert (np.imag(slope.rates(*at)[0]) / 1e-40).tolist() == [1.0, -1.0]
    told = replace(
        slider().phases[0],
        outputs=Quantities(lambda x, u, p, xp: (abs(x.v),), pace="m/s"),
    )
    expression = slider(phases=(told,)).form.expressions[0, "outputs"]
    assert [op[0] for op in expression.tape.instructions] == ["x", "fabs"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"start": lambda p, xp: (p.distanse, 0.0)}, r"start: (.|\n)*did you mean 'distance'"),
        ({"objective": lambda x, p, xp: x.tme}, r"objective: there is no state"),
        ({"objective": lambda x, p, xp: abs(p.time)}, r"objective is not a formula(.|\n)*xp\.fabs"),
        ({"objective": lambda x, p, xp: None}, r"objective returns a value that is not a number"),
        ({"start": lambda p, xp: 0.0}, r"start returns the wrong number of values"),
    ],
)
def test_mistakes_elsewhere_are_named(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(PeriluneError, match=words):
        slider(**changes)
