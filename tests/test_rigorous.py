"""Level 5: the prover by closed forms, and by mutants of it, each of which has to be caught."""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import pytest

import perilune as pl
from perilune.problem.verification import Check, Verification
from problems.integrators import least_time
from problems.landings import meditch
from problems.singular import nearest_to_zero

pytest.importorskip("flint")
from flint import arb

import prover_checks
from perilune.rigorous.check_certificate import confirm
from perilune.rigorous.jets import Failed
from perilune.rigorous.told import exact
from perilune.rigorous.verified import with_theorem

ROOM = Path(__file__).parent.parent / "src" / "perilune" / "rigorous"


@pytest.mark.parametrize("check", prover_checks.CHECKS, ids=lambda check: check.__name__)
def test_the_prover(check: Callable[[], bool]) -> None:
    assert prover_checks.holds(check)


@contextmanager
def mutated(name: str, old: str, new: str) -> Iterator[None]:
    """The prover with one file changed."""
    path = ROOM / f"{name}.py"
    source = path.read_text(encoding="utf-8")
    assert source.count(old) == 1, f"{source.count(old)} places in {name}: {old}"
    kept = {key: module for key, module in sys.modules.items() if key.startswith("perilune.rigorous")}
    for key in kept:
        del sys.modules[key]
    full = f"perilune.rigorous.{name}"
    spec = importlib.util.spec_from_file_location(full, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[full] = module
    try:
        exec(compile(source.replace(old, new), str(path), "exec"), module.__dict__)
        yield
    finally:
        for key in [key for key in sys.modules if key.startswith("perilune.rigorous")]:
            del sys.modules[key]
        sys.modules.update(kept)


# What is wrong: (file, a place in it, what stands there then).
MUTANTS = {
    "remainder dropped": ("flow", "length) + r * length**order", "length)"),
    "remainder halved": ("flow", "length) + r * length**order", "length) + r * length**order / 2"),
    "remainder of tangents dropped": ("flow", "+ tangents_over[order] * length**order", ""),
    "remainder along a step dropped": ("flow", "_over(c, since) + last * since**order", "_over(c, since)"),
    "remainder at the start alone": (
        "flow",
        "Z = [r if s else r + arb(0, w)",
        "Z = [z[0] + r - r.mid() - arb(0, r.rad())",
    ),
    "inclusion unchecked": ("flow", "if all(inside) and all(tangent_inside):", "if all(tangent_inside):"),
    "order of the remainder off by one": ("flow", "[c[order] for c in over]", "[c[order - 1] for c in over]"),
    "series cut off": ("taylor", "in range(orders):\n            for step", "in range(2):\n            for step"),
    "tangents off by a factor": ("flow", "total * (1 / arb(k + 1))", "total * (2 / arb(k + 1))"),
    "tangents by the transposed slopes": ("flow", "A[place] = c[k]", "A[place[::-1]] = c[k]"),
    "rates off by a factor": ("taylor", "following / (k + 1)", "following / (k + 2)"),
    "product without its last term": ("taylor", "sum(map(mul, a, b[::-1]))),", "sum(map(mul, a[:-1], b[::-1]))),"),
    "square without its middle term": ("taylor", "half + a[k // 2] * a[k // 2]", "half"),
    "quotient without its memory": ("taylor", "(a[k] - sum(map(mul, b[1:]", "(a[k] - sum(map(mul, b[2:]"),
    "root without its memory": ("taylor", "c[1:], c[:0:-1]", "c[2:], c[:0:-1]"),
    "sine with the wrong sign": ("taylor", "cosine.append(-sum(", "cosine.append(sum("),
    "angle beyond its jump": ("taylor", "if x > 0 or y > 0 or y < 0 else arb.nan()", ""),
    "logarithm's derivative off": ("graph", '"log": lambda: 1 / a,', '"log": lambda: here / a,'),
    "quotient's derivative off": ("graph", "(at[1], -here / b)", "(at[1], here / b)"),
    "adjoint with the wrong sign": ("equations", "*(-slope for slope in slopes)]", "*slopes]"),
    "direction with the wrong sign": ("equations", "-g / strength", "g / strength"),
    "duration without the rate at its end": ("flight", "D = rates * by_y", "D = rates * by_y * 0"),
    "link without its derivative": ("flight", "by_y + by_before * D if i else by_y", "by_y"),
    "Krawczyk unchecked": ("root", "all(b.contains_interior(k)", "all(b.overlaps(k)"),
    "defect left out": ("root", "[c - d + e for", "[c + e for"),
    "contraction left out": ("root", "[c - d + e for", "[c - d for"),
    "derivative at the centre alone": ("root", "refined.inverse * J\n", "refined.inverse * J.mid()\n"),
    "sign at the end ignored": ("signs", "(-1) ** at_end * ", ""),
    "sign at the deepest halving taken": ("signs", "Seen(proved=False", "Seen(proved=True"),
    "sign at one point": ("signs", "z = step.at(span)", "z = step.at(span.mid())"),
    "half of a step unseen": ("signs", ", (middle, b, depth + 1)]", "]"),
    "Riccati's equation past a conjugate point": (
        "second_order",
        "return float((proved.begin + span).mid())",
        "continue",
    ),
    "form at the end unseen": ("second_order", "kernel.transpose() * form * kernel", "kernel.transpose() * kernel"),
    "second variation with the wrong sign": ("second_order", "W = M * -1", "W = M"),
    "constants rounded": (
        "graph",
        "fmpq(*float(value).as_integer_ratio())",
        "fmpq(round(float(value) * 1e12), 10**12)",
    ),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_of_the_prover_are_caught(name: str) -> None:
    with mutated(*MUTANTS[name]):
        assert prover_checks.complaint(), f"nobody noticed: {name}"


def test_a_theorem_is_a_level_of_the_verification() -> None:
    solution = prover_checks.solved(meditch)
    found = pl.verify(solution, level=5)
    assert found.level == 5 and "theorem" in found.title
    assert found.notes[0].startswith("Theorem. ") and "1.42031259904919781546735996764" in found.notes[0]
    certificate = json.loads(json.dumps(found.certificate))
    assert certificate["problem"]["given"]["c"]["number"] == str(Fraction(2.349)) and len(certificate["unknowns"]) == 8


def test_what_is_not_proved_is_named_and_lowers_nothing() -> None:
    check = Check(name="known", level=1, value=0.0, limit=1.0, unit="1", meaning="something")
    right = prover_checks.solved(least_time)
    for solution, note in (
        (prover_checks.solved(nearest_to_zero), "no theorem: the control u of go is singular"),
        (
            replace(right, free={"t_f": 1.00001 * right.free["t_f"]}),
            "no theorem: beside the answer only another extremal is proved",
        ),
    ):
        found = with_theorem(Verification(checks=(check,)), solution)
        assert found.level == 1 and found.passed and found.certificate is None
        assert found.notes[0].startswith(note)


def test_without_ball_arithmetic_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    solution = prover_checks.solved(meditch)
    for name in [name for name in sys.modules if name.startswith("perilune.rigorous")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(pl.PeriluneError, match=r"pip install 'perilune\[rigorous\]'"):
        pl.verify(solution, level=5)


@cache
def certificate(make: Callable[[], pl.Problem]) -> str:
    """The certificate of a problem, as a file has it."""
    return json.dumps(pl.verify(prover_checks.solved(make), level=5).certificate)


@pytest.mark.parametrize("make", [meditch, least_time])
def test_a_certificate_is_confirmed_without_the_prover(make: Callable[[], pl.Problem]) -> None:
    told = json.loads(certificate(make))
    found, J = confirm(told, lambda _: None)
    assert J.overlaps(arb(told["objective"])) and J.rad() < 1e-25 and len(found) == len(told["unknowns"])


@pytest.mark.parametrize("claim", ["place", "J", "nothing", "problem", "bound", "range", "sign"])
def test_a_false_certificate_is_refused(claim: str) -> None:
    told = json.loads(certificate(least_time))
    if claim == "place":  # 1e-9 away, with a radius that says otherwise
        place = arb(2) * (1 + arb(1e-9))
        told["unknowns"][2] |= {"centre": exact(place), "enclosure": f"[{place.str(20, radius=False)} +/- 1e-15]"}
    elif claim == "J":
        told["objective"] = "[2.0000000001 +/- 1e-15]"
    elif claim == "nothing":
        told["objective"] = "nan"
    elif claim == "range":
        told["problem"]["free"][0]["upper"] = "1"
    elif claim == "problem":
        told["problem"]["given"]["distance"]["number"] = "1000000001/1000000000"
    elif claim == "bound":
        told["problem"]["phases"][0]["states"][1]["upper"] = "1/2"
    else:
        told["arcs"][0]["regimes"]["u"], told["arcs"][1]["regimes"]["u"] = "lower", "upper"
    with pytest.raises((Failed, ArithmeticError, ValueError)):
        confirm(told, lambda _: None)
