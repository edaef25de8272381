"""Level 5: certificates are confirmed without the prover, and refused where anything that they say is not so."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import pytest

import perilune as pl
from problems.integrators import least_energy, least_time
from problems.landings import constant_mass, meditch
from problems.staging import staged_burns

pytest.importorskip("flint")
from flint import arb, arb_series, ctx

import prover_checks
from perilune.problem import Parameter, Variable, Verification
from perilune.rigorous.verified import add_theorem_checks
from perilune_checker.check import checked_sentence, confirm
from perilune_checker.equations import CertifiedEquations
from perilune_checker.expressions import (
    CertifiedExpression,
    CertifiedProgram,
    Failed,
    backward_gradient,
    symbol,
)

Told = dict[str, Any]


def rolled() -> pl.Problem:
    """Half a metre in a second by two controls that no formula gives: H is -0.27 (u + v) - cos u - cos v + 0.1 u v."""
    phase = pl.Phase(
        name="roll", states=(Variable(name="x", unit="m"), Variable(name="cost", unit="s")),
        controls=tuple(pl.ScalarControl(name=name, lower=-2.0, upper=2.0) for name in "uv"), duration="T",
        dynamics=lambda x, u, p, xp: (p.speed * (u.u + u.v), 2 - xp.cos(u.u) - xp.cos(u.v) + 0.1 * u.u * u.v),
        end=pl.Conditions(lambda x, p, xp: (x.x - p.distance,), place="m"), 
        end_guess=lambda p, xp: (p.distance, p.T),
    )  # fmt: skip
    given = {"T": Parameter(value=1.0, unit="s"), "speed": Parameter(value=1.0, unit="m/s")}
    return pl.Problem(
        name="rolled", phases=(phase,), start=lambda p, xp: (0.0 * p.distance, 0.0 * p.T), objective_unit="s",
        objective=lambda x, p, xp: x.cost, given={**given, "distance": Parameter(value=0.5, unit="m")},
    )  # fmt: skip


@cache
def _written(make: Callable[[], pl.Problem]) -> str:
    return json.dumps(add_theorem_checks(Verification(checks=()), prover_checks.solved(make)).certificate)


def certificate(make: Callable[[], pl.Problem]) -> Told:
    """The certificate of a problem, as a file has it."""
    return json.loads(_written(make))


@pytest.mark.parametrize("make", [meditch, least_time, least_energy, staged_burns, rolled])
def test_a_certificate_is_confirmed_without_the_prover(make: Callable[[], pl.Problem]) -> None:
    told = certificate(make)
    found, J = confirm(told, lambda _: None)
    with ctx.workprec(told["bits"]):
        claimed = arb(told["objective"])
    assert claimed.contains(J) and claimed.rad() < 1e-25 * abs(J) and len(found) == len(told["unknowns"])


def _beside(told: Told) -> None:
    """1e-9 away, with a radius that says otherwise."""
    mantissa, exponent = told["unknowns"][2]["centre"].split("*2^")
    told["unknowns"][2]["centre"] = f"{int(mantissa) * (10**9 + 1)}*2^{exponent}"


def _cut(told: Told) -> None:
    """The flight of the first arc from half a second on."""
    told["grid"][0] = [0.5]


def _sine(told: Told) -> None:
    """v' = sin u, which asks for no jump."""
    tape = told["problem"]["tapes"]["dynamics 0"]
    tape["instructions"].append(["sin", 1])
    tape["outputs"][1] = 2


def _curved(told: Told) -> None:
    """v' = u + 1e-9 u^2: where u jumps and dH/du vanishes on one side, H would jump."""
    tape = told["problem"]["tapes"]["dynamics 0"]
    u, count = tape["outputs"][1], len(tape["instructions"])
    tape["instructions"] += [["mul", u, u], ["const", 1e-9], ["mul", count, count + 1], ["add", u, count + 2]]
    tape["outputs"][1] = count + 3


def _one(told: Told) -> None:
    """v' = u v / v, which is nothing at rest."""
    tape = told["problem"]["tapes"]["dynamics 0"]
    v, count = tape["outputs"][0], len(tape["instructions"])
    tape["instructions"] += [["mul", tape["outputs"][1], v], ["div", count, v]]
    tape["outputs"][1] = count + 1


def _no_side(told: Told) -> None:
    """A range of 0 to 7 m whose name is that of a parameter, and the side on which it would be that."""
    tape, end = told["problem"]["tapes"]["end 0"], {"name": "distance", "lower": "0", "upper": "7"}
    tape["outputs"][0] = tape["instructions"].index(["x", "x"])
    told["problem"]["phases"][0]["end"][0] = end
    told["unknowns"][3]["name"] = "move.nu_distance"
    told["on_bounds"]["ranges"] = [["move", "distance", "name"]]


FALSE: dict[str, tuple[Callable[[Told], Any], str]] = {
    "place": (_beside, "leaves the box"),
    "J": (lambda told: told.update(objective="[2.0000000001 +/- 1e-15]"), "does not hold"),
    "nothing": (lambda told: told.update(objective="nan"), "does not hold"),
    "a wider box": (lambda told: told.update(only_one_within=[1.0] * 6), "leaves the box"),
    "a box without an inside": (lambda told: told["only_one_within"].__setitem__(1, -1e-9), "without an inside"),
    "another format": (lambda told: told.update(format="perilune theorem 4"), "another format"),
    "range": (lambda told: told["problem"]["free"][0].update(upper="1"), "a bound is broken"),
    "problem": (
        lambda told: told["problem"]["given"]["distance"].update(number="1000000001/1000000000"), "box|does not hold",
    ),
    "bound": (lambda told: told["problem"]["phases"][0]["states"][1].update(upper="1/2"), "limit of arc 1"),
    "an end that is a range": (
        lambda told: told["problem"]["phases"][0]["end"][0].update(upper="7"), "no such condition",
    ),
    "a side that is none": (_no_side, "no such side"),
    "a side within": (lambda told: told["on_bounds"].update(free={"t_f": "inside"}), "no such side"),
    "a side of nothing": (lambda told: told["on_bounds"].update(free={"t": "lower"}), "of nothing"),
    "a word unread": (lambda told: told["problem"]["phases"][0].update(held=["u"]), "goes unread"),
    "a tape unread": (lambda told: told["problem"]["tapes"].update({"held 0": {}}), "goes unread"),
    "a control of another kind": (
        lambda told: told["problem"]["phases"][0]["controls"][0].update(kind="chosen"), "no such kind",
    ),
    "a number for a name": (lambda told: told["problem"]["given"].update({"-1": {"number": "1"}}), "a name is none"),
    "words behind a number": (
        lambda told: told.update(objective="[2 +/- 1e-9 +/- 0], the best of all"), "does not hold anything",
    ),
    "a given unread": (lambda told: told["problem"]["given"]["distance"].update(offset="7"), "goes unread"),
    "a link unread": (lambda told: told["problem"]["tapes"].update({"links 0": {"outputs": []}}), "goes unread"),
    "a ball for a size": (lambda told: told["only_one_within"].__setitem__(0, "1e-9 +/- 1e-10"), "is no number"),
    "few bits": (lambda told: told.update(bits=1), "no such number of bits"),
    "more digits than are seen": (lambda told: told.update(objective=f"[2.{40 * '0'}1 +/- 1e-50]"), "does not hold"),
    "no double": (
        lambda told: told["problem"]["tapes"]["dynamics 0"]["instructions"].append(["const", "0.50"]), "no double",
    ),
    "a part of nothing": (
        lambda told: told["problem"]["tapes"]["dynamics 0"]["instructions"].append(["neg", -1]), "no such part",
    ),
    "a name": (lambda told: told["unknowns"][2].update(name="tf"), "named otherwise"),
    "a flight cut off": (_cut, "do not begin"),
    "steps without an end": (lambda told: told["grid"][0].append(math.inf), "out of order"),
    "steps back": (lambda told: told["grid"][0].extend([0.5, 0.25]), "out of order"),
    "an arc without an end": (lambda told: told["arcs"][1].update(switched="u"), "does not end where"),
    "a jump in a sine": (_sine, "does not switch there"),
    "a jump though H is curved": (_curved, "does not switch there"),
    "nothing at rest": (_one, "divided by 0"),
    "a regime that is none": (lambda told: told["arcs"][0]["regimes"].update(u="name"), "no such regime"),
    "one name for two": (lambda told: told["problem"]["given"].update(t_f={"number": "1"}), "two things have one name"),
    "an end without a name": (lambda told: told["problem"]["phases"][0]["end"].pop(), "does not name what its end"),
    "a name without a path": (lambda told: told["problem"]["phases"][0]["path"].append("low"), "what its path states"),
    "words for a name": (lambda told: told["problem"]["phases"][0].update(name="all, and none"), "a name is none"),
}  # fmt: skip


def _opposite(told: Told) -> None:
    """A multiplier that would have the end leave its bound."""
    (mu,) = (u for u in told["unknowns"] if u["name"] == "first.mu_m")
    mu["centre"] = f"-{mu['centre']}".removeprefix("--")


def _other_side(told: Told) -> None:
    """The first stage may have 60 kg at most: the same equations."""
    told["problem"]["phases"][0]["states"][1].update(lower=None, upper="60")
    told["on_bounds"]["states"][0][2] = "upper"


def _left_out(told: Told) -> None:
    """The first equation, with its multiplier."""
    at = [u["name"] for u in told["unknowns"]].index("first.mu_m")
    for rows in (told["unknowns"], told["only_one_within"]):
        del rows[at]
    del told["on_bounds"]["states"][0]


def _of_no_bound(told: Told) -> None:
    """That the first stage ends at 0 m/s, of which the problem says nothing."""
    told["on_bounds"]["states"][0] = ["first", "v", None]


FALSE_OPTIMUM: dict[str, tuple[Callable[[Told], Any], str]] = {
    "weight": (lambda told: told["weights"][0].__setitem__(0, -1.0), "a weight is none"),
    "no weight": (lambda told: told["weights"][0].__setitem__(0, math.nan), "a weight is none"),
    "one phase": (lambda told: told["weights"].pop(), "not as many weights as phases"),
    "one state": (lambda told: told["weights"][0].pop(), "not as many weights as states"),
    "light": (lambda told: told.update(weights=[[1e-60] * len(own) for own in told["weights"]]), "weights|positive"),
}  # fmt: skip


FALSE_END: dict[str, tuple[Callable[[Told], Any], str]] = {
    "multiplier": (_opposite, "leaves the box"),
    "side": (_other_side, "would be left"),
    "equation": (_left_out, "leaves the box"),
    "no bound": (_of_no_bound, "no such side"),
    "no such bound": (lambda told: told["on_bounds"]["states"].append(["second", "v", "lower"]), "named otherwise"),
    "no bound told": (lambda told: told["on_bounds"].update(states=[]), "named otherwise"),
    "bound": (lambda told: told["problem"]["phases"][1]["states"][1].update(lower="16"), "leaves the box"),
    "a free bound": (lambda told: told["problem"]["phases"][1]["states"][1].update(lower="t_1"), "no number that is"),
}  # fmt: skip


def _far(least: str, most: str | None) -> Callable[[Told], Any]:
    """Ranges of both controls."""

    def change(told: Told) -> None:
        for control in told["problem"]["phases"][0]["controls"]:
            control.update(lower=least, upper=most)

    return change


def _turned(told: Told) -> None:
    """Both as a direction, in which H is not linear."""
    told["problem"]["phases"][0]["controls"] = [{"kind": "direction", "names": ["u", "v"]}]
    told["arcs"][0]["regimes"] = {}


FALSE_CONTROL: dict[str, tuple[Callable[[Told], Any], str]] = {
    "least": (_far("-2", "19/4"), "a sign is not seen"),  # H of u = 4.75 alone is less by 0.14
    "range": (_far("-2", "1/5"), "a limit of arc 1"),  # both are 0.25
    "no range": (_far("-2", None), "has no range"),
    "place": (lambda told: told["unknowns"][-1].update(centre="251/1000"), "leaves the box"),
    "name": (lambda told: told["unknowns"][-1].update(name="w"), "named otherwise"),
    "no formula": (_turned, "no formula"),
}


def _beside_it(told: Told) -> None:
    """A control that costs, on its lower bound; an angle of the others that might jump, times 0."""
    tape, phase = told["problem"]["tapes"]["dynamics 0"], told["problem"]["phases"][0]
    phase["controls"].append({"kind": "bounded", "names": ["s"], "name": "s", "lower": "0", "upper": "1"})
    told["arcs"][0]["regimes"]["s"] = "lower"
    at, cost = len(tape["instructions"]), tape["outputs"][1]
    tape["instructions"] += [
        ["u", "s"], ["add", cost, at], ["u", "u"], ["mul", at + 2, at + 2], ["const", 1.5], ["add", at + 3, at + 4],
        ["atan2", at + 2, at + 5], ["const", 0.0], ["mul", at + 6, at + 7], ["add", at + 1, at + 8],
    ]  # fmt: skip
    tape["outputs"][1] = at + 9


def _to_the_end(told: Told) -> None:
    """Steps of the least time, of which the last is none."""
    told |= certificate(least_time)
    told["grid"] = [[0.0, 5e-324, 0.5], [0.0, 1.0]]


def _at_rest(told: Told) -> None:
    """A state more, y' = -y, that is 0."""
    phase, tapes = told["problem"]["phases"][0], told["problem"]["tapes"]
    phase["states"].append({"name": "y", "lower": None, "upper": None})
    for name, more in (("start", [["const", 0.0]]), ("dynamics 0", [["x", "y"], ["neg", None]])):
        tape = tapes[name]
        at = len(tape["instructions"])
        tape["instructions"] += [[at if part is None else part for part in own] for own in more]
        tape["outputs"].append(at + len(more) - 1)
    told["unknowns"].insert(2, {"name": "roll.lambda_y(0)", "centre": "0", "enclosure": "[+/- 1e-30]"})
    told["only_one_within"].insert(2, 1e-9)
    told["weights"][0].append(1.0)


@pytest.mark.parametrize("change", [_far("-2", "9/2"), _beside_it, _at_rest, _to_the_end])
def test_a_right_certificate_is_confirmed(change: Callable[[Told], Any]) -> None:
    told = certificate(rolled)
    change(told)
    told["theorem"] = checked_sentence(told)
    confirm(told, lambda _: None)


def test_no_other_is_in_the_box_about_a_centre_that_is_no_double() -> None:
    """q - 1 = 0, 2^-98 or 2^-98 + 2^-108, the last two within 1e-32 of 1 + 2^-98, which 96 bits round to 1."""
    numbers = {"T": "1", "one": "1", "near": "1*2^-98", "next": "1025*2^-108", "k": "1025*2^-10"}
    unbounded = {"lower": None, "upper": None}
    phase = {"name": "go", "duration": "T", "states": [{"name": "x", **unbounded}], "controls": [],
             "end": [{"name": "meets", **unbounded}], "path": []}  # fmt: skip
    end = [["x", "x"], ["p", "one"], ["sub", 0, 1], ["p", "near"], ["sub", 2, 3], ["p", "next"], ["sub", 2, 5],
           ["mul", 2, 4], ["mul", 7, 6]]  # fmt: skip
    tapes = {"start": [["p", "q"]], "dynamics 0": [["const", 0.0]], "end 0": end,
             "objective": [["x", "x"], ["p", "k"], ["mul", 0, 1]]}  # fmt: skip
    told = {
        "format": "perilune theorem 5", "bits": 64, "grid": [[0.0]], "weights": None, "objective": "[1.0 +/- 1e-2]",
        "problem": {
            "name": "roots", "phases": [phase], "given": {name: {"number": value} for name, value in numbers.items()},
            "free": [{"name": "q", **unbounded}],
            "tapes": {name: {"instructions": own, "outputs": [len(own) - 1]} for name, own in tapes.items()},
        },
        "arcs": [{"phase": 0, "regimes": {}, "switched": ""}], "on_bounds": {"free": {}, "ranges": [], "states": []},
        "unknowns": [
            {"name": "go.lambda_x(0)", "centre": "0", "enclosure": "[+/- 1e-5]"},
            {"name": "q", "centre": f"{2**98 + 1}/{2**98}", "enclosure": "[1.0 +/- 1e-19]"},
            {"name": "go.nu_meets", "centre": f"-{2**196}", "enclosure": "[+/- 1e90]"},
        ],
        "only_one_within": [1e-3, 1e-32, 2.0**208],
    }  # fmt: skip
    with pytest.raises(Failed, match="leaves the box"):
        confirm(told | {"theorem": checked_sentence(told)}, lambda _: None)


@pytest.mark.parametrize(
    ("make", "claim", "change", "why"),
    [(make, claim, *own)
     for make, false in ((least_time, FALSE), (staged_burns, FALSE_END), (staged_burns, FALSE_OPTIMUM),
                         (rolled, FALSE_CONTROL))
     for claim, own in false.items()],
)  # fmt: skip
def test_a_false_certificate_is_refused(
    make: Callable[[], pl.Problem], claim: str, change: Callable[[Told], Any], why: str
) -> None:
    told = certificate(make)
    change(told)
    told["theorem"] = checked_sentence(told)
    with pytest.raises(Failed, match=why):
        confirm(told, lambda _: None)


def test_a_certificate_says_nothing_else_than_what_is_seen() -> None:
    told = certificate(least_time) | {"theorem": "It is the global optimum."}
    with pytest.raises(Failed, match="says something else"):
        confirm(told, lambda _: None)


@pytest.mark.parametrize("make", [least_time, least_energy, staged_burns])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_least_is_told_from_the_greatest_however_small(make: Callable[[], pl.Problem], sign: int) -> None:
    """2^-44 J has the same extremal with costates as small; of its negative it is the greatest that H has."""
    told = certificate(make)
    tape = told["problem"]["tapes"]["objective"]
    count = len(tape["instructions"])
    tape["instructions"] += [["const", sign * 2.0**-44], ["mul", tape["outputs"][0], count]]
    tape["outputs"] = [count + 1]
    small = [".lambda" in u["name"] or ".nu" in u["name"] or ".mu" in u["name"] for u in told["unknowns"]]
    for i, u in enumerate(told["unknowns"]):
        mantissa, exponent = u["centre"].split("*2^")
        u["enclosure"] = "[0 +/- 1000]"
        if small[i]:
            u["centre"] = f"{sign * int(mantissa)}*2^{int(exponent) - 44}"
            told["only_one_within"][i] *= 2.0**-44
    told["weights"] = [[2.0**-44 * weight for weight in own] for own in told["weights"]]
    told["objective"] = "[0 +/- 1000]"
    told["theorem"] = checked_sentence(told)
    if sign > 0:
        confirm(told, lambda _: None)
    else:
        with pytest.raises(Failed, match=r"a sign is not seen|a bound .* would be left"):
            confirm(told, lambda _: None)


@pytest.mark.parametrize("word", ["sqrt", "exp", "log", "sin", "cos", "tan", "atan", "asin", "acos", "sinh", "cosh",
                                  "tanh", "neg", "add", "sub", "mul", "div", "atan2", "pow"])  # fmt: skip
def test_derivatives_of_the_checker_are_those_of_its_series(word: str) -> None:
    """Of each operation at 0.3 + t: the second order of its series is half of the slope of the slope."""
    two = [["const", 2.0], ["sub", 1, 0]]
    other = two if word in ("add", "sub", "mul", "div", "atan2") else [["const", 1.75]] if word == "pow" else []
    a, f = symbol(), traced(["x", "a"], *other, [word, 0, *[len(other)] * bool(other)])
    (slope,) = backward_gradient(f(a), [a])
    program = CertifiedProgram([[a]], [f(a), slope, *backward_gradient(slope, [a])])
    before, ctx.cap = ctx.cap, 3
    try:
        (series,) = CertifiedProgram([[a]], [f(a)])([arb_series([arb("0.3"), 1], 3)])
    finally:
        ctx.cap = before
    value, first, second = program([arb("0.3")])
    truth = [*series.coeffs(), *[arb(0)] * 3][:3]
    assert all(a.overlaps(b) and b.rad() < 1e-10 for a, b in zip((value, first, second / 2), truth, strict=True))


def traced(*instructions: list[Any]) -> Callable[[CertifiedExpression], CertifiedExpression]:
    """The last of the operations of a tape, as a function of its state a."""
    equations = object.__new__(CertifiedEquations)
    equations.given, equations.phases = {}, [{"states": [{"name": "a"}]}]
    equations.problem = {"tapes": {"f": {"instructions": instructions, "outputs": [len(instructions) - 1]}}}
    return lambda a: equations.traced("f", 0, [a], {}, {})[0]


def test_derivatives_of_the_checker_round_nothing() -> None:
    """Of 2^60 a + a - 2^60 a by sixty doublings, and of a to the power of nothing: 1 and 0; and a / a is none at 0."""
    doublings = [["add", i, i] for i in range(60)]
    a, f = symbol(), traced(["x", "a"], *doublings, ["add", 60, 0], ["sub", 61, 60])
    zero = traced(["x", "a"], ["const", 0.0], ["pow", 0, 1])
    with ctx.workprec(192):
        found = CertifiedProgram([[a]], [*backward_gradient(f(a), [a]), zero(a), *backward_gradient(zero(a), [a])])(
            [arb(3)]
        )
        assert all(value.contains(truth) and value.rad() < 1e-30 for value, truth in zip(found, (1, 1, 0), strict=True))
    assert not CertifiedProgram([[a]], [traced(["x", "a"], ["div", 0, 0])(a)])([arb(0, 1)])[0].is_finite()


def fastest() -> pl.Problem:
    """x(1) as large as it can be with x' = u, 0 < u < 1/2."""
    phase = pl.Phase(
        name="go", states=(pl.Variable(name="x", unit="m"),), duration="T",
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=0.0, upper=0.5),), dynamics=lambda x, u, p, xp: (u.u,),
    )  # fmt: skip
    return pl.Problem(
        name="fastest",
        phases=(phase,),
        start=lambda p, xp: (0.0 * p.T * p.half,),
        objective=lambda x, p, xp: -x.x,
        objective_unit="m",
        given={"T": pl.Parameter(value=1.0, unit="s"), "half": pl.Parameter(value=0.5, unit="m/s")},
    )


def test_a_control_keeps_both_its_bounds_wherever_it_is() -> None:
    """With a lower bound above the upper one there is no flight."""
    told = certificate(fastest)
    assert told["arcs"][0]["regimes"] == {"u": "upper"}
    confirm(told, lambda _: None)
    told["problem"]["phases"][0]["controls"][0]["lower"] = "3/4"
    with pytest.raises(Failed, match="a limit of arc 1 is broken"):
        confirm(told, lambda _: None)


@pytest.mark.parametrize(("sign", "kept"), [("sub", True), ("add", False)])
def test_a_limit_that_an_end_condition_meets_is_seen_by_its_slope(sign: str, kept: bool) -> None:
    """-v or v, which are 0 at rest, as (1e9 e -+ v) - 1e9 e: the effort e alone moves it by more than the tolerance."""
    told = certificate(partial(constant_mass, 1.62, 20.0, -5.0, 4.0))
    told["problem"]["phases"][0]["path"] = ["falling"]
    told["problem"]["tapes"]["path 0"] = {"outputs": [5], "instructions": [
        ["x", "v"], ["x", "effort"], ["const", 1e9], ["mul", 1, 2], [sign, 3, 0], ["sub", 4, 3],
    ]}  # fmt: skip
    if kept:
        confirm(told, lambda _: None)
    else:
        with pytest.raises(Failed, match="limit of arc"):
            confirm(told, lambda _: None)
