"""Level 5: extremals of several arcs and phases that are a local optimum, or by a little none, in closed form."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest

import perilune as pl

pytest.importorskip("flint")
from flint import arb, ctx

from perilune.problem import Parameter, Variable
from perilune_checker.check import checked_sentence, confirm
from perilune_checker.expressions import Failed
from prover_checks import room, settings

AGAIN = False  # whether the checker is asked, too
UP, DOWN, FREE = {"v": "upper", "u": "interior"}, {"v": "lower", "u": "interior"}, {"u": "interior"}


def optimum(stated: pl.Problem, pieces: Sequence[tuple[int, dict[str, str], str]], guess: Sequence[float],
            sides: Any = None) -> Any:  # fmt: skip
    """What is said of the extremal of these pieces (phase, regimes, switched)."""
    rough, root = settings(24, 1e-36), room("krawczyk")
    own = [
        room("boundary_value_problem").ArcPiece(phase=k, regimes=regimes, switched=name) for k, regimes, name in pieces
    ]
    with ctx.workprec(rough.bits):
        boundary = room("boundary_equations").boundary_problem(stated, own, sides)
        refined = root.refine_root(boundary, [arb(value) for value in guess], rough, lambda _: None)
        found = root.prove_root(boundary, refined, rough, lambda _: None)
        said = room("second_order").prove_local_optimum(boundary, found, rough.order, lambda _: None)
        if AGAIN:
            assert seen_again(boundary, refined, found, rough, said) == said.proved, said.where
        return said


def ask_the_checker(monkeypatch: pytest.MonkeyPatch, too: bool) -> None:
    """Of the extremals that come the checker has to say what the prover says."""
    monkeypatch.setattr(sys.modules[__name__], "AGAIN", too)


def seen_again(boundary: Any, refined: Any, found: Any, rough: Any, said: Any) -> bool:
    """Whether the checker sees a strict local optimum too; that it is an extremal it has to see, and sees before."""
    second_order = room("second_order")
    weights = said.weights or second_order._SecondVariationForm(boundary, found).weights_of_moving(1e4)
    proved = room("theorem").ProvedExtremal(
        boundary=boundary, refined=refined, settings=rough, root=found,
        unique=room("krawczyk").enlarge_uniqueness_box(boundary, refined, found, rough, lambda _: None),
        objective=boundary.objective.values(found.y, found.flight.ends[-1])[0],
        statements=(), optimum=second_order.OptimumStatement(proved=False), distance=0.0, reached=True,
    )  # fmt: skip
    told = room("statement").certificate_document(proved, "")
    told["weights"] = weights
    steered = {regime for arc in told["arcs"] for name, regime in arc["regimes"].items() if name == "u"} == {"interior"}
    steered &= not any(arc.joint for arc in boundary.arcs)
    for control in (c for phase in told["problem"]["phases"] for c in phase["controls"] if c["names"] == ["u"]):
        control.update({"lower": None, "upper": None} if steered else {})  # some are steered beyond, and none on them
    told["theorem"] = checked_sentence(told)
    try:
        confirm(told, lambda _: None)
    except Failed as refused:
        assert re.search("second variation|Riccati|weights|not affine|not switch|factor of a dir", str(refused))
        return False
    return True


def variables(*names: str) -> tuple[Variable, ...]:
    return tuple(Variable(name=name) for name in names)


def given(**values: float) -> dict[str, Parameter]:
    """Numbers, and a second."""
    return {"T": Parameter(value=1.0, unit="s")} | {n: Parameter(value=v, unit="1") for n, v in values.items()}


def phases(name: str, *phase: pl.Phase, links: Sequence[Any] = (), free: Sequence[pl.FreeParameter] = (), start: Any,
           objective: Any = lambda x, p, xp: x.c, **numbers: float) -> pl.Problem:  # fmt: skip
    return pl.Problem(name=name, phases=phase, links=tuple(links), start=start, objective=objective, free=tuple(free),
                      given=given(**numbers))  # fmt: skip


def same(x: Any, p: Any, xp: Any) -> Any:
    return tuple(x)


# -- conjugate points --------------------------------------------------------------------------------------------------


def swung(angle: float, stretch: float = 0.0, end: str = "held", joint: bool = False) -> Any:
    """Least integral of (u^2 - x^2)/2 over an angle from x = 0 to 1, or from 0 to anywhere: minima up to pi, or pi/2.

    At a third of it x is measured anew, `stretch` times as long; not where that is 0. The end may be a range that ends
    at 1, or with no end near. Jointly u is the sum of two that no formula gives.
    """

    def phase(k: int, part: float) -> pl.Phase:
        def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
            by = part / p.T
            cost = 2 / 3 * (u.u**2 + u.v**2 + u.u * u.v) if joint else 0.5 * u.u**2
            scale = p.stretch**2 if k else 1
            return (by * (u.u + u.v if joint else u.u), by * (cost - 0.5 * x.x**2) / scale)

        last = k == 1 or not stretch
        place = Variable(name="place", lower=-1.0, upper=1.0) if end == "range" else Variable(name="place")
        return pl.Phase(
            name=f"go{k}",
            states=variables("x", "c"),
            duration="T",
            dynamics=rates,
            controls=tuple(pl.ScalarControl(name=name, lower=-9.0, upper=9.0) for name in ("uv" if joint else "u")),
            end=pl.Conditions.of(
                (lambda x, p, xp: ((x.x / p.stretch if k else x.x) - p.e,)) if last and end != "free" else None,
                (place,) if last and end != "free" else (),
            ),
        )

    at = 0.0 if end in ("range", "free") else 1.0
    parts = [angle / 3, 2 * angle / 3] if stretch else [angle]
    stated = phases(
        "swung", *(phase(k, part) for k, part in enumerate(parts)), start=lambda p, xp: (0.0, 0.0),
        links=[lambda x, p, xp: (p.stretch * x.x, x.c)] if stretch else [], stretch=stretch or 1.0,
        e=0.0 if end == "range" else 1.0,
    )  # fmt: skip
    if end == "bound":
        last = stated.phases[-1]
        place = Variable(name="place", upper=1.0)
        held = replace(last, end=pl.Conditions(lambda x, p, xp: (x.x / p.stretch,), place))
        stated = stated.changed(phases=(*stated.phases[:-1], held), form=None)
    slope = at / math.sin(angle)
    costates = [value for k in range(len(parts)) for value in (-slope * math.cos(k * angle / 3), 1.0)]
    if stretch:
        costates[2] /= stretch
    nu = [] if end == "free" else [slope * math.cos(angle)]
    w = [value for k in range(len(parts)) for value in [-0.5 * costates[2 * k] * (stretch**2 if k else 1)] * 2]
    sides = {(stated.phases[-1].name, "place"): {"range": "inside", "bound": "upper"}.get(end, "")}
    regimes = {"u": "interior", "v": "interior"} if joint else FREE
    return optimum(
        stated, [(k, regimes, "") for k in range(len(parts))], [*costates, *nu, *(w if joint else [])],
        room("boundary_value_problem").Sides(ranges=sides if end in ("range", "bound") else {}),
    )  # fmt: skip


@pytest.mark.parametrize("stretch", [0.0, 1.0, 3.0, -0.25])
@pytest.mark.parametrize(
    ("end", "last"), [("held", math.pi), ("free", math.pi / 2), ("range", math.pi / 2), ("bound", math.pi)]
)
def test_a_link_at_a_harmless_place_moves_no_conjugate_point(
    stretch: float, end: str, last: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert swung(0.6 * last, stretch, end).proved
    ask_the_checker(monkeypatch, (end, stretch) in {("held", -0.25), ("free", 3.0), ("range", 0.0)})
    # A range is held at its bound where less lies beyond: the integral is cot(angle)/2 at 1.
    if end != "bound":
        assert swung(0.97 * last, stretch, end).proved
    assert not swung(1.03 * last, stretch, end).proved


@pytest.mark.parametrize("stretch", [0.0, 3.0])
def test_a_control_without_a_formula_has_its_conjugate_points(stretch: float) -> None:
    assert swung(3.05, stretch, joint=True).proved and not swung(3.25, stretch, joint=True).proved


def pulled(stiffness: float) -> Any:
    """Least integral of (s^2 - k (y - x/1000)^2)/2 in 1 s from 0 to x = 1 with x' = s d: minima up to k = pi^2."""
    phase = pl.Phase(
        name="go", states=variables("x", "y", "c"), duration="T",
        controls=(pl.UnitVectorControl(names=("a", "b")), pl.ScalarControl(name="s", lower=0.0, upper=3.0)),
        dynamics=lambda x, u, p, xp: (
            u.s * u.a / p.T, u.s * u.b / p.T, (u.s**2 - p.k * (x.y - 0.001 * x.x) ** 2) / 2 / p.T,
        ),
        end=pl.Conditions(lambda x, p, xp: (x.x - p.e, x.y), there="1", beside="1"), 
    )  # fmt: skip
    stated = phases("pulled", phase, start=lambda p, xp: (0.0, 0.0, 0.0), e=1.0, k=stiffness)
    return optimum(stated, [(0, {"s": "interior"}, "")], [-1.0, 0.0, 1.0, 1.0, 0.0])


def spun(angle: float, turn: float, skew: float) -> Any:
    """Least integral of (|u|^2 - |x|^2)/2 over an angle in a plane that turns: minima up to pi, as where it does not.

    Its second coordinate is in the first, `skew` times.
    """

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
        first = x.x - skew * x.y
        along, across = angle * u.u + turn * x.y, angle * u.v - turn * first
        cost = 0.5 * (u.u**2 + u.v**2 - first**2 - x.y**2)
        return ((along + skew * across) / p.T, across / p.T, angle * cost / p.T)

    phase = pl.Phase(
        name="go", states=variables("x", "y", "c"), duration="T", dynamics=rates,
        controls=(pl.ScalarControl(name="u"), pl.ScalarControl(name="v")),
        end=pl.Conditions(lambda x, p, xp: (x.x - p.e, x.y), there="1", too="1"), 
    )  # fmt: skip
    stated = phases("spun", phase, start=lambda p, xp: (0.0, 0.0, 0.0), e=1.0)
    slope = -1 / math.sin(angle)
    first, last = slope * math.cos(turn), slope * math.cos(angle)
    guess = [first, slope * math.sin(turn) - skew * first, 1.0, last, -skew * last]
    return optimum(stated, [(0, {"u": "interior", "v": "interior"}, "")], guess)


def test_a_plane_that_turns_moves_no_conjugate_point() -> None:
    """In coordinates so skew that tangents enclosed from the start on are lost by wrapping in one turn."""
    assert spun(3.05, turn=6.0, skew=5.0).proved


# -- links and ends that are curved ------------------------------------------------------------------------------------


def turned(weight: float) -> Any:
    """An angle turns at a cost of weight u^2/2, from (-1, 0); from there to (1/2, 0) at a cost of its distance^2/2.

    Not to turn costs least for a weight of more than 1/2, though half a circle further is nearer.
    """
    turn = pl.Phase(
        name="turn", states=variables("angle", "c"), duration="T", controls=(pl.ScalarControl(name="u"),),
        dynamics=lambda x, u, p, xp: (u.u / p.T, p.weight * 0.5 * u.u**2 / p.T),
    )  # fmt: skip
    go = pl.Phase(
        name="go", states=variables("x", "y", "c"), duration="T",
        controls=(pl.ScalarControl(name="u"), pl.ScalarControl(name="v")),
        dynamics=lambda x, u, p, xp: (u.u / p.T, u.v / p.T, 0.5 * (u.u**2 + u.v**2) / p.T),
        end=pl.Conditions(lambda x, p, xp: (x.x - p.half, x.y), there="1", too="1"), 
    )  # fmt: skip
    stated = phases(
        "turned", turn, go, links=[lambda x, p, xp: (-xp.cos(x.angle), xp.sin(x.angle), x.c)],
        start=lambda p, xp: (0.0, 0.0), weight=weight, half=0.5,
    )  # fmt: skip
    return optimum(
        stated, [(0, FREE, ""), (1, {"u": "interior", "v": "interior"}, "")], [0.0, 1.0, -1.5, 0.0, 1.0, -1.5, 0.0]
    )


@pytest.mark.parametrize(("weight", "minimum"), [(2.0, True), (0.52, True), (0.48, False), (0.3, False)])
def test_a_link_that_is_curved_weighs_against_what_lies_before(weight: float, minimum: bool) -> None:
    assert turned(weight).proved == minimum


def passed_by(side: int, dropped: bool) -> Any:
    """From (1/2, 0) to the unit circle, where another phase begins: the nearest of its points, or the farthest.

    Or what is dropped there is one coordinate, and the circle a parabola.
    """
    go = pl.Phase(
        name="go", states=variables("x", "y", "c"), duration="T",
        controls=(pl.ScalarControl(name="u"), pl.ScalarControl(name="v")),
        dynamics=lambda x, u, p, xp: (u.u / p.T, u.v / p.T, 0.5 * (u.u**2 + u.v**2) / p.T),
        end=pl.Conditions(lambda x, p, xp: (x.x**2 + x.y**2 - 1,), circle="1"), 
    )  # fmt: skip
    more = pl.Phase(
        name="more", states=variables("c") if dropped else variables("x", "y", "c"), duration="T",
        controls=(pl.ScalarControl(name="u"),),
        dynamics=lambda x, u, p, xp: (0.5 * u.u**2 / p.T,) if dropped else (u.u / p.T, 0 * p.half / p.T,
                                                                             0.5 * u.u**2 / p.T),
    )  # fmt: skip
    stated = phases(
        "passed", go, more, links=[(lambda x, p, xp: (x.c,)) if dropped else same],
        start=lambda p, xp: (p.half, 0.0, 0.0), half=0.5,
    )  # fmt: skip
    speed = side - 0.5
    later = [1.0] if dropped else [0.0, 0.0, 1.0]
    return optimum(
        stated, [(0, {"u": "interior", "v": "interior"}, ""), (1, FREE, "")],
        [-speed, 0.0, 1.0, *later, speed / (2 * side)],
    )  # fmt: skip


@pytest.mark.parametrize("dropped", [False, True])
def test_the_end_of_a_phase_is_curved_where_another_follows(dropped: bool) -> None:
    """What a link drops is weighed there, and what it keeps at the end."""
    assert passed_by(1, dropped).proved and not passed_by(-1, dropped).proved


def test_end_conditions_have_multipliers_of_their_own() -> None:
    """The nearest and the farthest point of the circle again, and beside it to z = -1, whose multiplier is 1."""
    go = pl.Phase(
        name="go", states=variables("x", "y", "z", "c"), duration="T",
        controls=(pl.ScalarControl(name="u"), pl.ScalarControl(name="v"), pl.ScalarControl(name="w")),
        dynamics=lambda x, u, p, xp: (*(own / p.T for own in u), sum(0.5 * own**2 / p.T for own in u)),
        end=pl.Conditions(lambda x, p, xp: (x.x**2 + x.y**2 - 1, x.z + 1), *variables("distance", "depth")),
    )  # fmt: skip
    stated = phases("two_ends", go, start=lambda p, xp: (p.half, 0.0, 0.0, 0.0), half=0.5)
    for side in (1, -1):
        speed, regimes = side - 0.5, dict.fromkeys("uvw", "interior")
        found = optimum(stated, [(0, regimes, "")], [-speed, 0.0, 1.0, 1.0, -speed / (2 * side), 1.0])
        assert found.proved == (side > 0)


# -- switches ----------------------------------------------------------------------------------------------------------


def switched(curve: float, gain: float, split: float = 0.0) -> Any:
    """x' = gain u + v, s' = 1 from -1 to 1, least of curve x^2/2 at the end and the integral of u^2/2 + s v, |v| <= 1.

    v = 1 until s = 0, u = 0: least in the time of the switch and u where curve > -1/(2 (1 + gain^2)). Else it is none,
    though H is least all along. The same in two phases, the first of them that long.
    """

    def phase(k: int, part: float) -> pl.Phase:
        return pl.Phase(
            name=f"go{k}", states=variables("x", "s", "c"), duration="T",
            controls=(pl.ScalarControl(name="v", lower=-1.0, upper=1.0), pl.ScalarControl(name="u")),
            dynamics=lambda x, u, p, xp: (part / p.T * (p.gain * u.u + u.v), part / p.T,
                                         part / p.T * (0.5 * u.u**2 + x.s * u.v)),
        )  # fmt: skip

    parts = [split, 2.0 - split] if split else [2.0]
    last = len(parts) - 1
    stated = phases(
        "switched", *(phase(k, part) for k, part in enumerate(parts)), start=lambda p, xp: (0.0, -1.0, 0.0),
        links=[same] * last, objective=lambda x, p, xp: x.c + p.curve * 0.5 * x.x**2, curve=curve, gain=gain,
    )  # fmt: skip
    pieces = [(k, UP, "") for k in range(last)] + [(last, UP, "v"), (last, DOWN, "")]
    costates = [value for k in range(len(parts)) for value in (0.0, 2.0 if k == 0 else 2.0 - 1.0 * split, 1.0)]
    return optimum(stated, pieces, [*costates, (1.0 - split) / parts[-1]])


@pytest.mark.parametrize("split", [0.0, 0.25])
@pytest.mark.parametrize(("gain", "last"), [(0.0, -0.5), (1.0, -0.25), (2.0, -0.1)])
def test_a_switch_is_a_minimum_in_its_time_and_the_control_together(
    gain: float, last: float, split: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert switched(1.0, gain, split).proved and not switched(4 * last, gain, split).proved
    ask_the_checker(monkeypatch, (gain, split) == (1.0, 0.25))
    assert switched(0.97 * last, gain, split).proved
    assert not switched(1.03 * last, gain, split).proved


def twice(curve: float) -> Any:
    """x'' = u - 0.4 v^2 with u = -1, 1, -1, and a link in the middle that mixes x and v; curve x^2/2 about its end.

    By differences of flights in double precision J has the second derivatives ((4.7091, -0.4451), (-0.4451, 3.7270))
    by the times of both switches without `curve`, and x at the end the first (-2.6670, 1.3943): least for curve >
    -0.53634.
    """
    phase = pl.Phase(
        name="one", states=variables("x", "v", "s", "c"), duration="T",
        controls=(pl.ScalarControl(name="u", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (x.v / p.T, (u.u - p.drag * x.v**2) / p.T, 1 / p.T,
                                     (3 * (x.s - p.a) * (x.s - p.b) * u.u + 0.1 * x.x**2) / p.T),
    )  # fmt: skip
    stated = phases(
        "twice", phase, replace(phase, name="two"), start=lambda p, xp: (0.2, 0.5, 0.0, 0.0),
        links=[lambda x, p, xp: (x.x + 0.2 * x.v**2, x.v * (1 + 0.3 * x.x), x.s, x.c)],
        objective=lambda x, p, xp: x.c + 0.3 * x.x - 0.2 * x.v + p.curve * 0.5 * (x.x - p.end) ** 2,
        drag=0.4, a=0.6, b=1.3, end=0.25452149, curve=curve,
    )  # fmt: skip
    low, high = {"u": "lower"}, {"u": "upper"}
    return optimum(stated, [(0, low, "u"), (0, high, ""), (1, high, "u"), (1, low, "")],
                   [0.41781, 0.48786, -0.17313, 1.0, 0.36093, 0.11842, -2.61438, 1.0, 0.73640, 0.29172])  # fmt: skip


@pytest.mark.parametrize(("curve", "minimum"), [(0.0, True), (-1.0, False)])
def test_the_times_of_two_switches_and_a_link_between_them_as_by_differences(curve: float, minimum: bool) -> None:
    """Nearer to the border, -0.53 and -0.54, the checker is asked too, below."""
    assert twice(curve).proved == minimum


def crossing(power: int) -> Any:
    """x' = u, back to 0 with the least integral of s^power u, s from -1 to 1: dH/du = s^power, |u| <= 1."""
    phase = pl.Phase(
        name="go", states=variables("x", "s", "c"), duration="T",
        controls=(pl.ScalarControl(name="u", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (2 * u.u / p.T, 2 / p.T, 2 * x.s**power * u.u / p.T),
        end=pl.Conditions(lambda x, p, xp: (x.x,), back="1"), 
    )  # fmt: skip
    stated = phases("crossing", phase, start=lambda p, xp: (0.0, -1.0, 0.0))
    return optimum(stated, [(0, {"u": "upper"}, "u"), (0, {"u": "lower"}, "")], [0.0, 2.0, 1.0, 0.0, 0.5])


def test_a_switch_has_a_slope() -> None:
    assert crossing(1).proved
    assert "cross 0 with a slope" in crossing(3).where


def ending(at: float) -> Any:
    """Least integral of s u, |u| <= 1, s from -1 to `at` in any time: dH/du = s."""
    phase = pl.Phase(
        name="go",
        states=variables("s", "c"),
        duration="t",
        controls=(pl.ScalarControl(name="u", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (1 / p.T, x.s * u.u / p.T),
        end=pl.Conditions(lambda x, p, xp: (x.s - p.at,), there="1"),
    )
    stated = phases("ending", phase, start=lambda p, xp: (-1.0, 0.0), at=at,
                    free=[pl.FreeParameter(name="t", unit="s", lower=0.0, upper=9.0, guess=1.0)])  # fmt: skip
    return optimum(stated, [(0, {"u": "upper"}, "")], [1.0, 1.0, 1.0 + at, -at])


def test_a_control_on_a_bound_is_so_strictly_up_to_the_end() -> None:
    assert ending(-0.5).proved
    assert "keep its sign" in ending(0.0).where


def test_what_is_not_covered_is_named() -> None:
    """A control that comes to its bound; two that switch at once; a direction that nothing multiplies."""
    phase = pl.Phase(
        name="go", states=variables("s", "c"), duration="T", controls=(pl.ScalarControl(name="u", upper=1.0),),
        dynamics=lambda x, u, p, xp: (2 / p.T, (u.u - x.s) ** 2 / p.T),
    )  # fmt: skip
    stated = phases("rising", phase, start=lambda p, xp: (0.0, 0.0))
    found = optimum(stated, [(0, FREE, "u"), (0, {"u": "upper"}, "")], [0.5, 1.0, 0.5])
    assert "not affine in u" in found.where
    phase = pl.Phase(
        name="go", states=variables("s", "c"), duration="T",
        controls=(pl.UnitVectorControl(names=("a", "b")), pl.ScalarControl(name="u", lower=0.0, upper=1.0),
                  pl.ScalarControl(name="v", lower=-1.0, upper=1.0)),
        dynamics=lambda x, u, p, xp: (u.u * u.a / p.T, (u.u * u.b + x.s * u.v) / p.T),
    )  # fmt: skip
    stated = phases("idle", phase, start=lambda p, xp: (0.0, 0.0))
    for begin, end, word in (
        ("lower", "upper", "factor of a direction"),
        ("upper", "lower", "v does not switch separately"),
    ):
        one = room("boundary_value_problem").ArcPiece
        pieces = [one(phase=0, regimes={"u": begin, "v": "upper"}, switched="v"),
                  one(phase=0, regimes={"u": end, "v": "lower"})]  # fmt: skip
        boundary = room("boundary_equations").boundary_problem(stated, pieces)
        assert word in next(room("second_order")._unsupported_cases(boundary, None))


# -- parameters on bounds ----------------------------------------------------------------------------------------------


def test_a_parameter_on_its_bound_is_not_moved() -> None:
    """J = c - q^2 with q <= 1 is least at q = 1, though it is curved the other way; at q = 0 it is no minimum."""
    phase = pl.Phase(
        name="go",
        states=variables("x", "c"),
        duration="T",
        controls=(pl.ScalarControl(name="u"),),
        dynamics=lambda x, u, p, xp: (u.u / p.T, 0.5 * u.u**2 / p.T),
        end=pl.Conditions(lambda x, p, xp: (x.x - p.e,), there="1"),
    )
    stated = phases("bounded", phase, start=lambda p, xp: (0.0, 0.0), objective=lambda x, p, xp: x.c - p.q**2, e=1.0,
                    free=[pl.FreeParameter(name="q", lower=-2.0, upper=1.0)])  # fmt: skip
    assert optimum(
        stated, [(0, FREE, "")], [-1.0, 1.0, 1.0, 1.0], room("boundary_value_problem").Sides(free={"q": "upper"})
    ).proved
    assert not optimum(stated, [(0, FREE, "")], [-1.0, 1.0, 0.0, 1.0]).proved


def test_a_state_that_its_bound_holds_at_the_end_is_not_moved() -> None:
    """J = c - 2 x(1)^2 with x <= 1 is least at x = 1, though it is curved the other way; to stay at 0 is no minimum."""
    phase = pl.Phase(
        name="go", states=(Variable(name="x", upper=1.0), Variable(name="c")), duration="T",
        controls=(pl.ScalarControl(name="u"),), dynamics=lambda x, u, p, xp: (u.u / p.T, 0.5 * u.u**2 / p.T),
    )  # fmt: skip
    stated = phases("bounded", phase, start=lambda p, xp: (0.0, 0.0), objective=lambda x, p, xp: x.c - 2 * x.x**2)
    held = room("boundary_value_problem").Sides(states={("go", "x"): "upper"})
    assert optimum(stated, [(0, FREE, "")], [-1.0, 1.0, 3.0], held).proved
    assert not optimum(stated, [(0, FREE, "")], [0.0, 1.0]).proved


# -- the checker -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("made", "minimum"), [
    (lambda: twice(-0.53), True), (lambda: twice(-0.54), False),
    (lambda: swung(3.05, 0.5, joint=True), True), (lambda: swung(3.25, 0.5, joint=True), False),
    (lambda: pulled(0.97 * math.pi**2), True), (lambda: pulled(1.03 * math.pi**2), False),
])  # fmt: skip
def test_the_checker_sees_as_much(made: Any, minimum: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of conjugate points and a switch it is asked where they are tested."""
    ask_the_checker(monkeypatch, True)
    assert made().proved == minimum
