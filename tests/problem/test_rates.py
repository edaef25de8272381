"""Total derivatives along the flight, against complex steps of the same physics and closed forms."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.core import COMPLEX, NUMERIC, NUMPY_NAMES, STEP
from perilune.problem.tracing.lie_derivatives import (
    component,
    depends_on_control,
    derivatives_to_control,
    gather_expressions,
    total_derivative,
)
from perilune.problem.tracing.tape import Expression, Recorder
from perilune.problem.tracing.traced_problem import trace
from perilune.scenario import load_file

EXAMPLES = Path(__file__).parents[2] / "examples"
NAMES = ("a", "b")
AIR = pl.Table((0.0, 0.2, 0.5, 0.9, 1.2, 1.5, 2.0), (1.0, 0.8, 0.65, 0.3, 0.28, 0.2, 0.1))
KINDS: tuple[Any, ...] = ("smooth", "smoother", "monotone", "linear")


def flow(x: Any, u: Any, p: Any, xp: Any) -> tuple[Any, ...]:
    """Two coupled states, a control in the second only."""
    return (xp.sin(x.b) + p.k * x.a, x.a * x.b + u.w)


def tape(function: Callable[..., Any], roles: tuple[str, ...] = ("x", "u", "p")) -> Expression:
    recorder = Recorder()
    known = {"x": NAMES, "u": ("w",), "p": ("k",)}
    records = [SimpleNamespace(**{n: recorder.input(role, n) for n in known[role]}) for role in roles]
    return Expression(recorder.tape(function(*records, recorder.namespace)), roles)


DYNAMICS = tape(flow)
P, U = SimpleNamespace(k=0.3), SimpleNamespace(w=0.7)


def along(function: Callable[..., Any], a: float, b: float) -> float:
    """Rate by a step along the flow, in the numbers of the proof."""
    f = flow(SimpleNamespace(a=a, b=b), U, P, NUMERIC)
    moved = SimpleNamespace(a=a + 1j * STEP * f[0], b=b + 1j * STEP * f[1])
    try:
        return float(np.imag(function(moved, P, COMPLEX)[0])) / STEP
    except TypeError:  # complex numbers are not compared
        h = 1e-6
        ends = [function(SimpleNamespace(a=a + s * h * f[0], b=b + s * h * f[1]), P, NUMERIC)[0] for s in (1, -1)]
        return float(ends[0] - ends[1]) / (2 * h)


UNARY = {
    **{name: (lambda x, p, xp, name=name: (getattr(xp, name)(0.4 * x.a + x.b * p.k),)) for name in NUMPY_NAMES},
    **{
        name: (lambda x, p, xp, name=name: (getattr(xp, name)(x.a * x.b, x.a - p.k),))
        for name in ("atan2", "fmin", "fmax")
    },
}
OTHERS: dict[str, Callable[..., Any]] = {
    "sum": lambda x, p, xp: (2.0 + x.a + x.b - p.k - x.a * 3.0,),
    "left": lambda x, p, xp: (p.k - x.a,),
    "product": lambda x, p, xp: (-x.a * x.b * p.k,),
    "quotient": lambda x, p, xp: (x.a / (1.0 + x.b) + p.k / x.a + x.b / p.k,),
    "square": lambda x, p, xp: (x.a**2 + x.b**3.5 + x.a**p.k,),
    "exponent": lambda x, p, xp: (p.k**x.a + x.a**x.b + 2.0**x.b,),
    "below": lambda x, p, xp: (xp.where(x.a < x.b, x.a * x.b, p.k),),
    "above": lambda x, p, xp: (xp.where(x.a > x.b, x.a * x.b, x.a),),
    "minus": lambda x, p, xp: (xp.fabs(x.a - 5.0) + xp.fabs(x.b),),
    **{kind: (lambda x, p, xp, kind=kind: (xp.table(pl.Table(AIR.x, AIR.y, kind), x.a * x.b),)) for kind in KINDS},
}


@pytest.mark.parametrize("name", [*UNARY, *OTHERS])
@pytest.mark.parametrize(("a", "b"), [(0.37, 0.9), (1.3, 0.55), (0.02, 0.4), (2.5, 1.1)])
def test_rates_are_those_of_a_step_along_the_flow(name: str, a: float, b: float) -> None:
    function = {**UNARY, **OTHERS}[name]
    if name in ("asin", "acos"):
        a, b = 0.2 * a, 0.2 * b
    found = total_derivative(tape(function, ("x", "p")), DYNAMICS, NAMES)
    value = found(SimpleNamespace(a=a, b=b), U, P, NUMERIC)[0]
    exact = 1e-13 if name not in ("below", "above") else 1e-8
    assert value == pytest.approx(along(function, a, b), rel=exact, abs=exact)


def test_derivatives_end_where_a_control_appears() -> None:
    """a' = sin b + k a, a'' = cos(b) (a b + w) + k a'."""
    S = tape(lambda x, p, xp: (x.a,), ("x", "p"))
    found = derivatives_to_control(S, DYNAMICS, NAMES)
    assert [depends_on_control(f) for f in found] == [False, False, True]
    x = SimpleNamespace(a=0.4, b=1.1)
    first = np.sin(1.1) + 0.3 * 0.4
    assert found[1](x, U, P, NUMERIC) == pytest.approx([first])
    assert found[2](x, U, P, NUMERIC) == pytest.approx([np.cos(1.1) * (0.4 * 1.1 + 0.7) + 0.3 * first])
    assert len(derivatives_to_control(tape(lambda x, p, xp: (x.b * x.b,), ("x", "p")), DYNAMICS, NAMES)) == 2


def test_what_does_not_change_shows_no_control() -> None:
    """A product with what is constant, a choice between constants, the speed of a state that stands."""
    still = tape(lambda x, u, p, xp: (0.0, u.w))
    S = tape(lambda x, p, xp: (xp.where(x.b < p.k, 1.0, 2.0) * x.a + x.a**x.a * p.k, x.b * 0.0 + x.a), ("x", "p"))
    assert not depends_on_control(total_derivative(component(S, 0), still, NAMES))
    assert not any(depends_on_control(f) for f in derivatives_to_control(component(S, 0), still, NAMES))


def test_a_control_whose_effects_cancel_does_not_act() -> None:
    """A lift across the velocity (u, v) does not change the speed: what the speed and the height say it moves later."""
    names = ("h", "u", "v")
    recorder = Recorder()
    x = SimpleNamespace(**{n: recorder.input("x", n) for n in names})
    w, k = recorder.input("u", "w"), recorder.input("p", "k")
    rates = (x.v, -(k * x.u) - w * x.v, w * x.u - k * x.v - 1.0)
    dynamics = Expression(recorder.tape(rates), ("x", "u", "p"))
    recorder = Recorder()
    x = SimpleNamespace(**{n: recorder.input("x", n) for n in names})
    load = recorder.namespace.exp(-x.h) * (x.u * x.u + x.v * x.v)
    found = derivatives_to_control(Expression(recorder.tape([load]), ("x", "p")), dynamics, names)
    assert [depends_on_control(value) for value in found] == [False, False, True]
    # With q = h, u, v: S = e^-h V^2 has S' = -e^-h V^2 (v + 2 k) - 2 e^-h v.
    h, u, v = 0.3, 0.7, -0.4
    x, fast = SimpleNamespace(h=h, u=u, v=v), u * u + v * v
    first = -np.exp(-h) * (fast * (v + 2 * P.k) + 2 * v)
    assert found[1](x, SimpleNamespace(), P, NUMERIC)[0] == pytest.approx(first, rel=1e-12)
    moved = [found[2](x, SimpleNamespace(w=w), P, NUMERIC)[0] for w in (0.0, 1.0)]
    assert moved[1] - moved[0] == pytest.approx(-np.exp(-h) * (fast + 2) * u, rel=1e-12)


def test_orders_of_a_lander() -> None:
    """A height is moved in two steps; the tilt of the thrust is the control itself."""
    problem = load_file(EXAMPLES / "precision_landing.toml").problem
    phase = problem.phases[0]
    form = trace(problem)
    path = form.expressions[0, "path"]
    orders = {
        c.name: len(derivatives_to_control(component(path, k), form.expressions[0, "dynamics"], phase.state_names)) - 1
        for k, c in enumerate(phase.path_conditions)
    }
    assert orders == {"height_above_glide_slope": 2, "pointing_margin": 0}


def test_expressions_are_gathered() -> None:
    S = tape(lambda x, p, xp: (x.a, x.b * p.k), ("x", "p"))
    both = gather_expressions([component(S, 1), DYNAMICS], ("x", "u", "p"))
    x = SimpleNamespace(a=0.4, b=1.1)
    assert both(x, U, P, NUMERIC) == [1.1 * 0.3, *flow(x, U, P, NUMERIC)]
