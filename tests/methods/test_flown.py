"""Flights of an answer where errors grow: exported in pieces, each from its own start."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.conditions.canonical_equations import extremal_parameters
from perilune.conditions.pontryagin import derive
from perilune.core import NotConvergedError, ignore_events
from perilune.methods.indirect.export_arcs import correct_last_digits, propagate_for_export, propagate_in_one_piece
from perilune.methods.indirect.result import Curves
from perilune.methods.indirect.search import Search
from perilune.problem import Parameter, Variable
from perilune.shooting.shooting_function import Root, Shooting
from test_control_law import given, variables


def saddle(rate: float) -> pl.Problem:
    """From 1 to 1 in a second with the least int (u^2 + rate^2 x^2)/2: near 0 on the way, errors grow by e^rate."""
    phase = pl.Phase(
        name="way",
        states=(Variable(name="x", unit="m"), Variable(name="J", unit="m^2/s")),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-100.0, upper=100.0),),
        dynamics=lambda x, u, p, xp: (u.u, 0.5 * (u.u * u.u + (p.rate * x.x) ** 2)),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.side,), there="m"),
        end_guess=lambda p, xp: (p.side, p.side**2 / p.T),
    )
    return pl.Problem(
        name="saddle",
        phases=(phase,),
        start=lambda p, xp: (p.side, 0.0),
        given={
            "side": Parameter(value=1.0, unit="m"),
            "rate": Parameter(value=rate, unit="1/s"),
            "T": Parameter(value=1.0, unit="s"),
        },
        objective=lambda x, p, xp: x.J,
        objective_unit="m^2/s",
    )


def least(rate: float) -> float:
    """Its closed form."""
    return rate * (math.cosh(rate) - 1) / math.sinh(rate)


@pytest.mark.parametrize("rate", [2.0, 12.0, 20.0, 28.0])
def test_what_multiplies_errors_is_proved(rate: float) -> None:
    solution = pl.solve(saddle(rate))
    assert solution.objective == pytest.approx(least(rate), rel=1e-11)
    assert solution.verification.level == 3


def test_one_piece_misses_where_pieces_do_not() -> None:
    """A costate that is rounded in its last digit ends e^20 times as far off; each of six pieces e^3.3."""
    problem = saddle(20.0)
    found = pl.solve(problem, verify=0)
    conditions = derive(problem)
    assert found.unknowns is not None
    p, shooting = extremal_parameters(problem), Shooting(conditions)
    root = shooting.at(found.unknowns[None], p, shooting.holding({}))[0]
    ends = [
        flown.z[-1, 0] - 1
        for flown in (
            propagate_in_one_piece(problem, conditions, root.y)[0],
            propagate_for_export(problem, conditions, root)[0],
        )
    ]
    assert abs(ends[0]) > 1e-10 > 1e-12 > abs(ends[1])


def test_a_flight_that_cannot_be_cut_ends_where_it_should(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's flights are rougher than those exported: of as many phases as along a limit by 1e-12 times 1e5."""
    problem = saddle(8.0)
    near = pl.solve(problem, verify=0)
    monkeypatch.setattr("perilune.methods.indirect.export_arcs._JOINED", -1)
    monkeypatch.setattr("perilune.shooting.newton.FINEST", 1e-9)  # and of one phase by 1e-9 times a few
    found = pl.Indirect().run(problem.with_given(side=1.1), near)
    assert found.trajectories[0].state(1.0)[0] == pytest.approx(1.1, rel=1e-11)


def test_a_root_of_amplified_rounding_is_moved_by_its_last_digits() -> None:
    """The pieces of a return that touches its load limit are no root: its rate was left at 5.5e-9 of its size."""
    problem = saddle(8.0)
    known = pl.solve(problem, verify=0).trajectories
    assert isinstance(known, Curves)
    search, root = Search(pl.Indirect(), problem, ignore_events), known.root
    rounded = replace(root, y=root.y + np.array([1e-10, 0.0, 0.0]), residual=root.residual + 5e-10)

    def missed(root: Root) -> float:
        (flown,) = propagate_in_one_piece(problem, known.conditions, root.y)
        return abs(float(flown.z[-1, 0]) - 1.0)

    assert missed(rounded) > 1e-8 and missed(search.state.newton.to_last_digits(rounded)) < 1e-11
    assert search.state.newton.to_last_digits(root) is root


@pytest.mark.parametrize(
    ("left", "flights", "kept"),
    [
        ([4e-8, 3e-9, 5e-9, 2e-9, 9e-10, 1e-9, 2e-9, 7e-9, 1e-9, 3e-9, 2e-9, 4e-9], 12, 4),
        ([4e-8, 3e-9, 6e-7], 3, 1),
        ([4e-8, 1e-11, 3e-12, 2e-11], 4, 2),
        ([math.nan], 1, 0),
    ],
)
def test_of_what_rounding_leaves_the_least_is_kept(
    monkeypatch: pytest.MonkeyPatch, left: list[float], flights: int, kept: int
) -> None:
    """A step at rounding is a draw: one that is worse ends nothing, but for one far off, or where the best will do."""
    problem = saddle(2.0)
    conditions, still = derive(problem), iter(left)
    shooting, tried = Shooting(conditions), list[Any]()
    ones = np.ones((1, len(conditions.unknowns)))
    start = shooting.at(ones, extremal_parameters(problem), shooting.holding({}))[0]
    plan = shooting.plan

    def flown(problem: pl.Problem, conditions: Any, y: Any) -> list[Any]:
        tried.append(y)
        return []

    monkeypatch.setattr("perilune.methods.indirect.export_arcs.propagate_in_one_piece", flown)
    monkeypatch.setattr(
        "perilune.methods.indirect.export_arcs._end_residual", lambda *_, **__: np.full(len(plan.rows), next(still))
    )
    best, least = correct_last_digits(problem, conditions, start, plan.rows, plan.active)
    assert len(tried) == flights and best.y is tried[kept]
    assert least == (left[kept] if math.isfinite(left[kept]) else math.inf)


def test_a_flight_that_is_stuck_is_flown_as_newton_flew_it_or_refused() -> None:
    """Out of steps, as beside a grazed switch: its tables had ended anywhere, and level 0 looked at none of them."""
    problem = saddle(2.0)
    known = pl.solve(problem, verify=0).trajectories
    assert isinstance(known, Curves)
    of = problem, known.conditions, known.root
    assert not propagate_in_one_piece(*of[:2], known.root.y, max_steps=15)[0].complete
    (flown,) = propagate_for_export(*of, max_steps=15)
    assert flown.complete and flown.arcs[0].t[-1] == flown.duration
    assert flown.z[-1, 0] == pytest.approx(1.0, abs=1e-10)
    with pytest.raises(NotConvergedError, match=r"to its end\n  got: it stops 0\.\d+ s into way, of 1 s"):
        propagate_for_export(*of, max_steps=8)


def test_pieces_are_one_curve() -> None:
    """No break is added, and times, gaps and switches are those of the whole flight."""
    problem = saddle(20.0)
    solution = pl.solve(problem, verify=0)
    flown = solution.trajectories[0]
    assert np.all(np.diff(flown.time) > 0)
    assert flown.time[-1] == 1.0
    assert flown.state(0.5)[0] == pytest.approx(1 / math.cosh(10.0), rel=1e-9)


@pytest.mark.parametrize("drag", [0.0, 0.3])
def test_a_thrust_that_nothing_points_in_the_last_instant_is_told(drag: float) -> None:
    """Least time to a point at any velocity: the costate of the velocity vanishes there, all but its rounding.

    Without drag the thrust keeps one direction: (L + v t)^2 + (L + g t^2/2)^2 = (T t^2/2)^2.
    """

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
        slowed = p.k * xp.sqrt(x.vx**2 + x.vy**2 + p.v**2)
        return x.vx, x.vy, p.T * u.a - slowed * x.vx, p.T * u.b - p.g - slowed * x.vy

    phase = pl.Phase(
        name="go",
        states=variables(x="m", y="m", vx="m/s", vy="m/s"),
        controls=(pl.UnitVectorControl(names=("a", "b")),),
        dynamics=rates,
        duration="t",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.L, x.y - p.L), east="m", up="m"),
    )
    problem = pl.Problem(
        name="toy", phases=(phase,), start=lambda p, xp: (0.0, 0.0, -p.v, 0.0),
        given=given(T=(2.0, "m/s^2"), k=(drag, "1/m"), g=(1.0, "m/s^2"), L=(3.0, "m"), v=(0.5, "m/s")),
        free=(pl.FreeParameter(name="t", unit="s", lower=0.1, upper=50.0, guess=3.0),),
        objective=lambda x, p, xp: p.t, objective_unit="s",
    )  # fmt: skip
    solution = pl.solve(problem)
    assert solution.outcome is pl.Outcome.PROVED
    if not drag:
        t = solution.objective
        along, up = 3.0 + 0.5 * t, 3.0 + 0.5 * t * t
        assert math.hypot(along, up) == pytest.approx(t * t, rel=1e-9)
    path = solution.trajectories[0].control
    last = path(np.linspace(0.999, 1.0, 50) * solution.objective)
    assert np.ptp(last, axis=0).max() < 2e-3
