"""Level 5: extremals that are none, each by a little; what the theorem says of them is nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

import perilune as pl

pytest.importorskip("flint")
from flint import arb, ctx

from perilune.rigorous.boundary import Piece, Sides, boundary_problem
from perilune.rigorous.limits import Limits
from perilune.rigorous.reading import Unsupported
from perilune.rigorous.root import Root, Settings, prove_root, refine

ROUGH = Settings(bits=160, order=24, tolerance=1e-36)


def problem(phase: pl.Phase, objective: Any, given: dict[str, tuple[float, str]], **options: Any) -> pl.Problem:
    return pl.Problem(
        name="claimed", phases=(phase,), start=lambda p, m: (0.0,) * len(phase.states),
        given={name: pl.Given(value=value, unit=unit) for name, (value, unit) in given.items()},
        objective=objective, objective_unit="m", **options,
    )  # fmt: skip


def proved(
    stated: pl.Problem, regimes: dict[str, str], guess: Sequence[float], sides: Sides | None = None
) -> tuple[Root, list[str]]:
    """The root, and what is not proved of it."""
    with ctx.workprec(ROUGH.bits):
        boundary = boundary_problem(stated, [Piece(phase=0, regimes=regimes)], sides)
        refined = refine(boundary, [arb(value) for value in guess], ROUGH, lambda _: None)
        root = prove_root(boundary, refined, ROUGH, lambda _: None)
        return root, [statement.words for statement in Limits(boundary, root).all() if not statement.proved]


def test_a_corner_that_each_control_alone_would_keep_is_no_minimum() -> None:
    """H = -u - v - 3 u v is -1 at (-1, -1), where both slopes are positive, and -5 at (1, 1)."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"),),
        controls=tuple(pl.Bounded(name=name, lower=-1.0, upper=1.0) for name in "uv"),
        dynamics=lambda x, u, p, m: (p.w * (-u.u - u.v - 3 * u.u * u.v),), duration="T",
    )  # fmt: skip
    stated = problem(phase, lambda x, p, m: x.x, {"T": (1.0, "s"), "w": (1.0, "m/s")})
    with pytest.raises(Unsupported, match="depends on another control"):
        proved(stated, {"u": "lower", "v": "lower"}, [1.0])


def test_a_parameter_that_is_a_bound_is_chosen_for_what_it_bounds() -> None:
    """x' = u <= q, least q^2/2 - x(1): q = 1."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"),),
        controls=(pl.Bounded(name="u", unit="m/s", lower=-10.0, upper="q"),),
        dynamics=lambda x, u, p, m: (u.u,), duration="T",
    )  # fmt: skip
    free = (pl.Free(name="q", unit="m/s", lower=-5.0, upper=5.0, typical=1.0),)
    stated = problem(phase, lambda x, p, m: (p.q * p.T) ** 2 / (2 * p.l) - x.x, {"T": (1.0, "s"), "l": (1.0, "m")},
                     free=free)  # fmt: skip
    root, missing = proved(stated, {"u": "upper"}, [-1.0, 0.0, 0.5])
    assert root.y[-1].overlaps(arb(1)) and not missing


@pytest.mark.parametrize("scale", [1.0, 1e-13])
def test_a_control_on_the_wrong_bound_is_seen_however_small_its_effect(scale: float) -> None:
    """dH/du grows through 0 at 0.7 s, where u has to leave its upper bound."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"), pl.Variable(name="v", unit="m/s")),
        controls=(pl.Bounded(name="u", unit="m/s^2", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, m: (x.v, u.u), duration="T",
    )  # fmt: skip
    stated = problem(phase, lambda x, p, m: p.s * (0.3 * p.T * x.v - x.x), {"T": (1.0, "s"), "s": (scale, "1")})
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
            name="go", states=(pl.Variable(name="x", unit="m"), pl.Variable(name="c", unit="m^2/s")),
            controls=(pl.Bounded(name="u", unit="m/s"),), dynamics=lambda x, u, p, m: (u.u, 0.5 * u.u * u.u),
            duration="T", end=lambda x, p, m: (x.x,),
            end_conditions=(pl.Variable(name="place", unit="m", lower=range_[0], upper=range_[1]),),
        )  # fmt: skip
        at = {} if bound is None else {side: bound}
        stated = pl.Problem(
            name="ranged", phases=(phase,), start=lambda p, m: (p.q, 0.0), objective_unit="m",
            given={"T": pl.Given(value=1.0, unit="s"), "w": pl.Given(value=1.0, unit="s/m")},
            objective=lambda x, p, m: p.w * (x.c + (p.q - p.T / p.w) ** 2 / p.T),
            free=(pl.Free(name="q", unit="m", typical=1.0, **{"lower": -5.0, "upper": 5.0, **at}),),
        )  # fmt: skip
        sides = Sides(free={"q": side} if at else {}, ranges={("go", "place"): side if holds else "inside"})
        return proved(stated, {"u": "interior"}, [0.1, 1.0, 1.0, 0.1], sides)[1]

    assert not missing((lower, upper), told.get(side))
    assert len(missing(wrong if holds else (lower, upper), beyond if not holds else None)) == 1


def test_a_limit_that_is_touched_at_the_end_is_not_broken_before() -> None:
    """x = 1 - 6 t + 6 t^2 - t^3 is at 0 in the end, which no linear condition says, and comes there from below."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m", lower=0.0), pl.Variable(name="v", unit="m/s"),
                           pl.Variable(name="cost", unit="m^2/s^3")),
        controls=(pl.Bounded(name="u", unit="m/s^2"),), dynamics=lambda x, u, p, m: (x.v, u.u, 0.5 * u.u * u.u),
        duration="T", end=lambda x, p, m: (m.sin(x.x / p.l), x.v - 3 * p.l / p.T),
        end_conditions=(pl.Variable(name="place"), pl.Variable(name="speed", unit="m/s")),
    )  # fmt: skip
    stated = pl.Problem(
        name="dipping", phases=(phase,), start=lambda p, m: (p.l, -6 * p.l / p.T, 0.0), objective_unit="m^2/s^3",
        given={"T": pl.Given(value=1.0, unit="s"), "l": pl.Given(value=1.0, unit="m")},
        objective=lambda x, p, m: x.cost,
    )  # fmt: skip
    _, missing = proved(stated, {"u": "interior"}, [-6.0, -12.0, 1.0, -6.0, -6.0])
    assert missing == ["x > 0.0 (go)"]
