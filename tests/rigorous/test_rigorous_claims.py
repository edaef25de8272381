"""Level 5: extremals that are none, each by a little; what the theorem says of them is nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import perilune as pl

pytest.importorskip("flint")
from flint import arb, ctx

from problems.landings import meditch
from problems.staging import staged_burns
from prover_checks import room, settings, solved

FREE = {"u": "interior", "v": "interior"}


def problem(
    phase: pl.Phase, objective: Any, given: dict[str, tuple[float, str]], unit: str = "m", **options: Any
) -> pl.Problem:
    return pl.Problem(
        name="claimed", phases=(phase,), start=lambda p, xp: (0.0,) * len(phase.states),
        given={name: pl.Parameter(value=value, unit=own) for name, (value, own) in given.items()},
        objective=objective, objective_unit=unit, **options,
    )  # fmt: skip


def proved(
    stated: pl.Problem, pieces: dict[str, str] | Sequence[Any], guess: Sequence[float], sides: Any = None
) -> tuple[Any, list[str]]:
    """The root, and what is not proved of it; of one arc in these regimes, or of these pieces."""
    rough, root = settings(24, 1e-36), room("krawczyk")
    one = room("boundary_value_problem").ArcPiece
    with ctx.workprec(rough.bits):
        boundary = room("boundary_equations").boundary_problem(
            stated, [one(phase=0, regimes=pieces)] if isinstance(pieces, dict) else pieces, sides
        )
        refined = root.refine_root(boundary, [arb(value) for value in guess], rough, lambda _: None)
        found = root.prove_root(boundary, refined, rough, lambda _: None)
        statements = room("inequalities").FlightLimits(boundary, found).all()
        return found, [statement.words for statement in statements if not statement.proved]


def test_a_corner_that_each_control_alone_would_keep_is_no_minimum() -> None:
    """H = -u - v - 3 u v is -1 at (-1, -1), where both slopes are positive, and -5 at (1, 1)."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"),),
        controls=tuple(pl.ScalarControl(name=name, lower=-1.0, upper=1.0) for name in "uv"),
        dynamics=lambda x, u, p, xp: (p.w * (-u.u - u.v - 3 * u.u * u.v),), duration="T",
    )  # fmt: skip
    stated = problem(phase, lambda x, p, xp: x.x, {"T": (1.0, "s"), "w": (1.0, "m/s")})
    for side, sign in (("lower", -1), ("upper", 1)):
        _, missing = proved(stated, {"u": side, "v": side}, [1.0])
        assert not missing if sign > 0 else any("(u, v) is the only minimum of H" in words for words in missing)


def test_controls_without_a_formula_are_states_and_the_only_minimum() -> None:
    """Straight to (3 m, 4 m) at 1 m/s by an angle: 5 s; and x' = u + v at a cost of u^2 + v^2 + u v: u = v = 1/2."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"), pl.Variable(name="y", unit="m")),
        controls=(pl.ScalarControl(name="a", unit="rad", lower=-1.5, upper=1.5),),
        dynamics=lambda x, u, p, xp: (p.w * xp.cos(u.a), p.w * xp.sin(u.a)), duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - 3 * p.l, x.y - 4 * p.l), along="m", up="m"),
    )  # fmt: skip
    free = (pl.FreeParameter(name="T", unit="s", lower=0.0, upper=50.0, guess=5.0),)
    stated = problem(phase, lambda x, p, xp: p.w * p.T, {"w": (1.0, "m/s"), "l": (1.0, "m")}, free=free)
    root, missing = proved(stated, {"a": "interior"}, [-0.6, -0.8, 5.0, -0.6, -0.8, 0.9])
    assert not missing and root.y[2].overlaps(arb(5)) and root.y[5].overlaps(arb.atan2(arb(4), arb(3)))
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"), pl.Variable(name="c", unit="m^2/s")),
        controls=tuple(pl.ScalarControl(name=name, unit="m/s", lower=-9.0, upper=9.0) for name in "uv"),
        dynamics=lambda x, u, p, xp: (u.u + u.v, u.u * u.u + u.v * u.v + u.u * u.v), duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.l,), along="m"), 
    )  # fmt: skip
    stated = problem(
        phase, lambda x, p, xp: x.c, {"T": (1.0, "s"), "l": (1.0, "m")}, unit="m^2/s",
    )  # fmt: skip
    root, missing = proved(stated, {"u": "interior", "v": "interior"}, [-1.5, 1.0, -1.5, 0.5, 0.5])
    assert not missing and all(w.overlaps(arb(0.5)) and w.rad() < 1e-20 for w in root.y[3:])


@pytest.mark.parametrize(
    ("tilt", "drift", "start", "only"),
    [(0.1, 0.0, -1.0, True), (0.1, 0.0, 1.0, False), (-0.1, 0.0, -1.0, False), (-1e-9, 0.0, -1.0, False),
     (1.001, -1.0, -1.0, True), (1 - 1e-9, -1.0, -1.0, False), (0.1, -0.2, -1.0, False)],
)  # fmt: skip
def test_another_minimum_of_h_that_is_lower_at_any_time_is_seen(
    tilt: float, drift: float, start: float, only: bool
) -> None:
    """H = (u^2 - 1)^2 + (tilt + drift t) u is least near -1 while the factor is positive; there is a minimum near 1."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="s"), pl.Variable(name="c")),
        controls=(pl.ScalarControl(name="u", lower=-2.0, upper=2.5),), duration="T",
        dynamics=lambda x, u, p, xp: (1 / p.T, ((u.u**2 - 1) ** 2 + (p.tilt + p.drift * x.s) * u.u) / p.T),
    )  # fmt: skip
    given = {"T": (1.0, "s"), "tilt": (tilt, "1"), "drift": (drift, "1")}
    root, missing = proved(problem(phase, lambda x, p, xp: x.c, given, unit="1"), {"u": "interior"}, [0.0, 1.0, start])
    u = root.flight.ends[-1][-1]
    assert (4 * u * (u * u - 1) + arb(tilt) + arb(drift)).contains(arb(0)) and u.rad() < 1e-9
    assert missing == [] if only else missing == ["(u) is the only minimum of H (go)"]


def test_an_arc_begins_with_no_control_of_the_one_before_but_by_a_formula() -> None:
    """Where a comes to its bound 1, b does not, though it stands behind the costate then where a stood before."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="s"), pl.Variable(name="c")),
        controls=tuple(pl.ScalarControl(name=name, lower=-1.0, upper=1.0) for name in "ab"), duration="T",
        dynamics=lambda x, u, p, xp: (1 / p.T, ((u.a - x.s) ** 2 + u.a**4 * u.b**4 + u.b**2) / p.T),
    )  # fmt: skip
    stated, one = (
        problem(phase, lambda x, p, xp: x.c, {"T": (2.0, "s")}, unit="1"),
        room("boundary_value_problem").ArcPiece,
    )
    pieces = [one(phase=0, regimes={"a": "interior", "b": "interior"}, switched="a"),
              one(phase=0, regimes={"a": "upper", "b": "interior"})]  # fmt: skip
    boundary = room("boundary_equations").boundary_problem(stated, pieces)
    flight = SimpleNamespace(steps=[], ends=[])
    limits = room("inequalities").FlightLimits(boundary, SimpleNamespace(flight=flight, y=[]))
    a, b = boundary.arcs[0].scalars[0], boundary.arcs[1].scalars[1]
    room_of = [
        room("inequalities").SignedQuantity(arc, 1 - one.value, [])
        for arc, one in zip(boundary.arcs, (a, b), strict=True)
    ]
    assert limits._zeros(0, room_of[0], 0) == 1 and limits._zeros(1, room_of[1], -1) == 0


def test_a_parameter_that_is_a_bound_is_chosen_for_what_it_bounds() -> None:
    """x' = u <= q, least q^2/2 - x(1): q = 1."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"),),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-10.0, upper="q"),),
        dynamics=lambda x, u, p, xp: (u.u,), duration="T",
    )  # fmt: skip
    free = (pl.FreeParameter(name="q", unit="m/s", lower=-5.0, upper=5.0, guess=1.0),)
    stated = problem(phase, lambda x, p, xp: (p.q * p.T) ** 2 / (2 * p.l) - x.x, {"T": (1.0, "s"), "l": (1.0, "m")},
                     free=free)  # fmt: skip
    root, missing = proved(stated, {"u": "upper"}, [-1.0, 0.0, 0.5])
    assert root.y[-1].overlaps(arb(1)) and not missing


@pytest.mark.parametrize("scale", [1.0, 1e-13])
def test_a_control_on_the_wrong_bound_is_seen_however_small_its_effect(scale: float) -> None:
    """dH/du grows through 0 at 0.7 s, where u has to leave its upper bound."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"), pl.Variable(name="v", unit="m/s")),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (x.v, u.u), duration="T",
    )  # fmt: skip
    stated = problem(phase, lambda x, p, xp: p.s * (0.3 * p.T * x.v - x.x), {"T": (1.0, "s"), "s": (scale, "1")})
    _, missing = proved(stated, {"u": "upper"}, [-scale, -0.7 * scale])
    assert missing == ["H is least with u at its upper bound (go)"]


@pytest.mark.parametrize(
    ("side", "holds"),
    [("lower", (2.0, 7.0)), ("upper", (-2.0, 0.5)), ("inside", (-2.0, 7.0)),
     ("lower", None), ("upper", None)],
)  # fmt: skip
def test_an_end_or_a_parameter_is_on_the_side_where_it_would_cost_less_beyond(
    side: str, holds: tuple[float, float] | None
) -> None:
    """Least u^2/2 + (q - 1)^2 from x = q to a range; the same on the other side, or outside, is no minimum."""
    lower, upper = holds or (-2.0, 7.0)
    told = {name: (0.3 if side == "upper" else 1.5) for name in ("lower", "upper") if name == side and not holds}
    wrong = {"lower": (-2.0, 0.5), "upper": (2.0, 7.0), "inside": (2.0, 7.0)}[side]
    beyond = {"lower": 0.3, "upper": 1.5}.get(side, 0.0)

    def missing(range_: tuple[float, float], bound: float | None) -> list[str]:
        phase = pl.Phase(
            name="go",
            states=(pl.Variable(name="x", unit="m"), pl.Variable(name="c", unit="m^2/s")),
            controls=(pl.ScalarControl(name="u", unit="m/s"),),
            dynamics=lambda x, u, p, xp: (u.u, 0.5 * u.u * u.u),
            duration="T",
            end=pl.Conditions(
                lambda x, p, xp: (x.x,), pl.Variable(name="place", unit="m", lower=range_[0], upper=range_[1])
            ),
        )
        at = {} if bound is None else {side: bound}
        stated = pl.Problem(
            name="ranged", phases=(phase,), start=lambda p, xp: (p.q, 0.0), objective_unit="m",
            given={"T": pl.Parameter(value=1.0, unit="s"), "w": pl.Parameter(value=1.0, unit="s/m")},
            objective=lambda x, p, xp: p.w * (x.c + (p.q - p.T / p.w) ** 2 / p.T),
            free=(pl.FreeParameter(name="q", unit="m", guess=1.0, **{"lower": -5.0, "upper": 5.0, **at}),),
        )  # fmt: skip
        sides = room("boundary_value_problem").Sides(
            free={"q": side} if at else {}, ranges={("go", "place"): side if holds else "inside"}
        )
        return proved(stated, {"u": "interior"}, [0.1, 1.0, 1.0, 0.1], sides)[1]

    assert not missing((lower, upper), told.get(side))
    assert len(missing(wrong if holds else (lower, upper), beyond if not holds else None)) == 1


def approaching(side: str, gain: float, named: bool) -> pl.Problem:
    """x moves towards its bound at 1 m/s for as long as pays, `gain` for each second."""
    sign = 1 if side == "upper" else -1
    bounds: dict[str, Any] = {side: "end" if named else float(sign)}
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m", **bounds),), duration="T",
        dynamics=lambda x, u, p, xp: (sign * p.w,),
    )  # fmt: skip
    return problem(phase, lambda x, p, xp: -gain * p.w * p.T, {"w": (1.0, "m/s"), "end": (sign, "m")},
                   free=(pl.FreeParameter(name="T", unit="s", lower=0.0, upper=9.0, guess=1.0),))  # fmt: skip


@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize("named", [False, True])
def test_a_bound_holds_an_end_only_where_it_would_cost_less_beyond(side: str, named: bool) -> None:
    """Where a second costs, or nothing, the flight that ends on the bound is no extremal, though all else is met."""
    sides = room("boundary_value_problem").Sides(states={("go", "x"): side})
    for gain in (2.0, 0.0, -2.0):
        root, missing = proved(approaching(side, gain, named), {}, [-1.0, 0.9, 1.0], sides)
        mu = gain if side == "upper" else -gain
        assert root.y[1].overlaps(arb(1)) and root.y[2].overlaps(arb(mu)) and root.y[2].rad() < 1e-25
        assert missing == (
            [] if gain > 0 else [f"go: x at its end would cost less beyond its {side} bound, where it is"]
        )
    with pytest.raises(pl.PeriluneError, match="has no"):
        other = {"lower": "upper", "upper": "lower"}[side]
        proved(
            approaching(side, 2.0, named),
            {},
            [-1.0, 0.9, 1.0],
            room("boundary_value_problem").Sides(states={("go", "x"): other}),
        )


@pytest.mark.parametrize(("gain", "J", "sides"), [(1.0, -0.375, {("go", "x"): "upper"}), (0.25, -0.03125, {})])
def test_a_bound_that_holds_an_end_keeps_a_local_optimum(gain: float, J: float, sides: dict[Any, str]) -> None:
    """Least integral of u^2/2, less gain x(1), x <= 1/2: x = t/2, or gain t where that is less."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m", upper=0.5), pl.Variable(name="c", unit="m^2/s")),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-9.0, upper=9.0),), duration="T",
        dynamics=lambda x, u, p, xp: (u.u, 0.5 * u.u * u.u),
    )  # fmt: skip
    stated = problem(phase, lambda x, p, xp: x.c - p.k * x.x, {"T": (1.0, "s"), "k": (gain, "m/s")}, unit="m^2/s")
    found = room("theorem").attempt_proof(pl.solve(stated, pl.Pseudospectral(), verify=0), lambda _: None).proved
    assert found.boundary.sides.states == sides and not found.missing and found.optimum.proved
    assert found.objective.contains(J) and found.objective.rad() < 1e-25


def test_a_bound_that_is_touched_and_not_crossed_is_not_seen_to_be_kept() -> None:
    """x = q + (t - 1)^2 - 1 comes to 0 with q = 1 and a rate of 0, which no equation says."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m", lower=0.0), pl.Variable(name="t", unit="s")),
        dynamics=lambda x, u, p, xp: (2 * p.a * (x.t - p.T), 1.0), duration="T",
    )  # fmt: skip
    stated = pl.Problem(
        name="touching", phases=(phase,), start=lambda p, xp: (p.q, 0.0), objective=lambda x, p, xp: p.q,
        given={"T": pl.Parameter(value=1.0, unit="s"), "a": pl.Parameter(value=1.0, unit="m/s^2")}, objective_unit="m",
        free=(pl.FreeParameter(name="q", unit="m", lower=-9.0, upper=9.0, guess=1.0),),
    )  # fmt: skip
    sides = room("boundary_value_problem").Sides(states={("go", "x"): "lower"})
    root, missing = proved(stated, {}, [-1.0, 0.0, 0.9, -1.0], sides)
    assert root.y[2].overlaps(arb(1)) and missing == ["x > 0.0 (go)"]


def test_a_bound_that_is_met_anyway_or_holds_nothing_back_has_no_multiplier() -> None:
    """Meditch's lander: h and v end by condition, m and the effort where it pays; and with bounds just there."""
    solution = solved(meditch)
    (flown,) = solution.trajectories
    (phase,) = solution.problem.phases
    h, v, m, effort = flown.state.values[-1].tolist()
    for bounds in (
        ({"lower": h}, {"lower": v}, {"lower": m}, {"lower": effort}),
        ({"upper": h}, {"upper": v}, {"upper": m}, {"upper": effort}),
    ):
        states = tuple(replace(s, **{"lower": -np.inf, **own}) for s, own in zip(phase.states, bounds, strict=True))
        bounded = replace(solution.problem, phases=(replace(phase, states=states),))
        assert not room("candidate").sides_of(replace(solution, problem=bounded)).states
    assert not room("candidate").sides_of(solution).states
    burnt = solved(staged_burns)
    assert room("candidate").sides_of(burnt).states == {("first", "m"): "lower", ("second", "m"): "lower"}


def test_a_limit_that_is_touched_at_the_end_is_not_broken_before() -> None:
    """x = 1 - 6 t + 6 t^2 - t^3 is at 0 in the end, which no linear condition says, and comes there from below."""
    phase = pl.Phase(
        name="go",
        states=(
            pl.Variable(name="x", unit="m", lower=0.0),
            pl.Variable(name="v", unit="m/s"),
            pl.Variable(name="cost", unit="m^2/s^3"),
        ),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (xp.sin(x.x / p.l), x.v - 3 * p.l / p.T), place="1", speed="m/s"),
    )
    stated = pl.Problem(
        name="dipping", phases=(phase,), start=lambda p, xp: (p.l, -6 * p.l / p.T, 0.0), objective_unit="m^2/s^3",
        given={"T": pl.Parameter(value=1.0, unit="s"), "l": pl.Parameter(value=1.0, unit="m")},
        objective=lambda x, p, xp: x.cost,
    )  # fmt: skip
    _, missing = proved(stated, {"u": "interior"}, [-6.0, -12.0, 1.0, -6.0, -6.0])
    assert missing == ["x > 0.0 (go)"]


@pytest.mark.parametrize(("by", "missing"), [(0.0, []), (1e-6, ["x > 0.0 (go)"])])
def test_a_limit_that_is_missed_at_the_end_is_named(by: float, missing: list[str]) -> None:
    """x = 1 - (1 + by) t."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m", lower=0.0), pl.Variable(name="c", unit="m^2/s")),
        controls=(pl.ScalarControl(name="u", unit="m/s"),), dynamics=lambda x, u, p, xp: (u.u, 0.5 * u.u * u.u),
        duration="T", end=pl.Conditions(lambda x, p, xp: (xp.sin(x.x / p.l + by),), place="1"), 
    )  # fmt: skip
    stated = pl.Problem(
        name="falling", phases=(phase,), start=lambda p, xp: (p.l, 0.0), objective=lambda x, p, xp: x.c,
        given={"T": pl.Parameter(value=1.0, unit="s"), "l": pl.Parameter(value=1.0, unit="m")}, objective_unit="m^2/s",
    )  # fmt: skip
    assert proved(stated, {"u": "interior"}, [1.0, 1.0, 1.0])[1] == missing


def test_every_limit_that_is_broken_is_named_and_no_other() -> None:
    """x = t, u = 1 is where -u^2/2 is stationary: the greatest, not the least; and q = 2."""
    states = (pl.Variable(name="x", unit="m", lower=0.2, upper=0.8), pl.Variable(name="c", unit="m^2/s", lower=-3.0))
    phase = pl.Phase(
        name="go", states=states, controls=(pl.ScalarControl(name="u", unit="m/s", lower=-1.0, upper=0.5),),
        dynamics=lambda x, u, p, xp: (u.u, -0.5 * u.u * u.u), duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.l,), place="m"), 
        path=pl.Conditions(lambda x, u, p, xp: (x.x - 0.9 * p.l, 2 * p.l - x.x), high="m", low="m"),
    )  # fmt: skip
    free = (pl.FreeParameter(name="q", unit="m", lower=-5.0, upper=1.0, guess=1.0),)
    stated = problem(phase, lambda x, p, xp: x.c / (p.l / p.T) + (p.q - 2 * p.l) ** 2 / p.l,
                     {"T": (1.0, "s"), "l": (1.0, "m")}, free=free)  # fmt: skip
    _, missing = proved(stated, {"u": "interior"}, [1.0, 1.0, 2.0, 1.0])
    broken = ["x > 0.2", "x < 0.8", "high > 0", "H is strictly convex in u", "u is inside its upper bound"]
    assert sorted(missing) == sorted(["q < 1", *(f"{words} (go)" for words in broken)])


def test_an_arc_of_negative_length_is_seen() -> None:
    """x'' = 1 for -1/4 s, then x'' = -1 for 3/4 s."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"), pl.Variable(name="v", unit="m/s")),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (x.v + p.w, u.u), duration="t_f",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.d, x.v + p.w), place="m", speed="m/s"),
    )  # fmt: skip
    stated = problem(phase, lambda x, p, xp: p.w * p.t_f, {"w": (1.0, "m/s"), "d": (0.0625, "m")},
                     free=(pl.FreeParameter(name="t_f", unit="s", lower=0.0, upper=10.0, guess=1.0),))  # fmt: skip
    one = room("boundary_value_problem").ArcPiece
    pieces = [one(phase=0, regimes={"u": "upper"}, switched="u"), one(phase=0, regimes={"u": "lower"})]
    _, missing = proved(stated, pieces, [-4 / 3, 1 / 3, 0.5, -4 / 3, 1.0, -0.25])
    assert "arc 1 lasts longer than 0 s" in missing and "arc 2 lasts longer than 0 s" not in missing


@pytest.mark.parametrize(("weight", "sign", "missing"), [(2.0, 1, []), (0.5, 1, ["least"]), (2.0, -1, ["convex"])])
def test_a_control_on_a_bound_is_the_least_where_h_is_convex_in_it(
    weight: float, sign: int, missing: list[str]
) -> None:
    """Least integral of sign u^2/2, less a multiple of x(1), u <= 1."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"), pl.Variable(name="c", unit="m^2/s")),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (u.u, sign * 0.5 * u.u * u.u), duration="T",
    )  # fmt: skip
    stated = problem(phase, lambda x, p, xp: p.k * x.c - weight * x.x, {"T": (1.0, "s"), "k": (1.0, "s/m")})
    found = proved(stated, {"u": "upper"}, [-weight, 1.0])[1]
    assert len(found) == len(missing) and all(word in told for word, told in zip(missing, found, strict=True))


@pytest.mark.parametrize(("at_start", "half_turns"), [(True, 0), (True, 1), (False, 0), (False, 1)])
def test_the_nearest_point_of_a_circle_is_a_minimum_and_the_farthest_is_none(at_start: bool, half_turns: int) -> None:
    """Least integral of |u|^2/2 between (1/2, 0) and the unit circle, where the flight begins or ends.

    And of a speed that is best left at 0, called as a state is.
    """

    def inside(p: Any) -> tuple[Any, Any]:
        return (0.5 * p.l, 0 * p.l)

    phase = pl.Phase(
        name="go",
        states=tuple(pl.Variable(name=n, unit=u) for n, u in (("x", "m"), ("y", "m"), ("c", "m^2/s"))),
        controls=(pl.ScalarControl(name="u", unit="m/s"), pl.ScalarControl(name="v", unit="m/s")),
        dynamics=lambda x, u, p, xp: (u.u, u.v, 0.5 * (u.u * u.u + u.v * u.v + p.x * p.x)),
        duration="T",
        end=pl.Conditions.of(
            (lambda x, p, xp: (x.x - inside(p)[0], x.y))
            if at_start
            else (lambda x, p, xp: ((x.x * x.x + x.y * x.y) / p.l - p.l,)),
            tuple(pl.Variable(name=n, unit="m") for n in ("one", "two")[: 2 if at_start else 1]),
        ),
    )
    stated = pl.Problem(
        name="circle", phases=(phase,), objective=lambda x, p, xp: x.c, objective_unit="m^2/s",
        start=lambda p, xp: (p.l * xp.cos(p.q), p.l * xp.sin(p.q), 0.0) if at_start else (*inside(p), 0.0),
        given={"T": pl.Parameter(value=1.0, unit="s"), "l": pl.Parameter(value=1.0, unit="m")},
        free=(pl.FreeParameter(name="x", unit="m/s"), *([pl.FreeParameter(name="q", guess=1.0)] if at_start else [])),
    )  # fmt: skip
    side = 1 - 2 * half_turns
    speed = (0.5 - side) * (1 if at_start else -1)
    told = [0.0, 0.0, *([np.pi * half_turns, -speed, 0.0] if at_start else [-speed / (2 * side)])]
    rough, root = settings(24, 1e-36), room("krawczyk")
    with ctx.workprec(rough.bits):
        boundary = room("boundary_equations").boundary_problem(
            stated, [room("boundary_value_problem").ArcPiece(phase=0, regimes=FREE)]
        )
        refined = root.refine_root(boundary, [arb(v) for v in (-speed, 0.0, 1.0, *told)], rough, lambda _: None)
        found = root.prove_root(boundary, refined, rough, lambda _: None)
        statement = room("second_order").prove_local_optimum(boundary, found, rough.order, lambda _: None)
    assert statement.proved == (not half_turns)


def test_conditions_that_are_called_alike_do_not_hide_one_another() -> None:
    """x and y at most 1, both called the same, behind the refusal; beyond the first J is less: it was a theorem."""
    with pytest.raises(pl.PeriluneError, match="two conditions are called same"):
        pl.Conditions(lambda x, p, xp: (x.x, x.y), *2 * (pl.Variable(name="same", upper=1.0),))
    ends = pl.Conditions(lambda x, p, xp: (x.x, x.y), same="1", other="1")
    object.__setattr__(ends, "variables", 2 * (pl.Variable(name="same", upper=1.0),))
    phase = pl.Phase(
        name="go", states=tuple(pl.Variable(name=name) for name in "xyc"), duration="T",
        controls=(pl.ScalarControl(name="u"), pl.ScalarControl(name="v")),
        dynamics=lambda x, u, p, xp: (u.u / p.T, u.v / p.T, 0.5 * (u.u * u.u + u.v * u.v) / p.T),
        end=ends,
    )  # fmt: skip
    stated = pl.Problem(
        name="alike", phases=(phase,), start=lambda p, xp: (0.0, 0.0, 0.0), objective=lambda x, p, xp: x.c - 3 * x.y,
        given={"T": pl.Parameter(value=1.0, unit="s")},
    )  # fmt: skip
    sides = room("boundary_value_problem").Sides(ranges={("go", "same"): "upper"})
    with pytest.raises(pl.PeriluneError, match="two conditions have the same name: go: same would cost less"):
        proved(stated, {"u": "interior", "v": "interior"}, [-1.0, -1.0, 1.0, -1.0, 2.0], sides)


def test_a_free_parameter_that_is_called_as_another_unknown_is_not_taken_for_it() -> None:
    """J = q^3 - 3 q with q called as a multiplier is: q = -1, a maximum below its bound, was a strict local optimum."""
    name = "go.nu_there"
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x"), pl.Variable(name="c")), duration="T",
        controls=(pl.ScalarControl(name="u"),), dynamics=lambda x, u, p, xp: (u.u / p.T, 0.5 * u.u * u.u / p.T),
        end=pl.Conditions(lambda x, p, xp: (x.x - p.e,), there="1"), 
    )  # fmt: skip
    stated = pl.Problem(
        name="named", phases=(phase,), start=lambda p, xp: (0.0, 0.0),
        objective=lambda x, p, xp: x.c + getattr(p, name) ** 3 - 3 * getattr(p, name),
        given={"T": pl.Parameter(value=1.0, unit="s"), "e": pl.Parameter(value=-1.0)},
        free=(pl.FreeParameter(name=name, lower=-0.5, upper=2.0),),
    )  # fmt: skip
    with pytest.raises(pl.PeriluneError, match=f"{name} is the name of another unknown too"):
        proved(stated, {"u": "interior"}, [1.0, 1.0, -1.0, 1.0])
