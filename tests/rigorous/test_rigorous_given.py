"""What a theorem is about: the decimals of a scenario or the doubles, and a place where there is a root."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from fractions import Fraction
from functools import cache
from types import MappingProxyType
from typing import Any

import pytest

import perilune as pl
from perilune.core import ignore_events
from problems.landings import constant_mass, meditch

pytest.importorskip("flint")
from flint import arb, ctx

from perilune.rigorous import enclosure as flight, krawczyk as root
from perilune.rigorous.krawczyk import NotProved, prove_root, refine_root
from perilune.rigorous.theorem import ProvedExtremal, attempt_proof
from perilune.rigorous.verified import add_theorem_checks
from perilune_checker.check import confirm
from perilune_checker.expressions import Failed


def test_a_theorem_says_which_numbers_it_is_about() -> None:
    solution = pl.solve(constant_mass(1.62, 20.0, -5.0, 4.0), verify=0)
    problem = solution.problem
    given = dict(problem.given)
    given["g"] = replace(given["g"], stated="1.62 m/s^2")
    stated = replace(solution, problem=problem.changed(given=MappingProxyType(given)))
    found = add_theorem_checks(stated.verification, stated)
    assert "the decimals of the scenario taken exactly (1 of" in found.notes[0]
    told = dict(found.certificate or {})
    assert told["problem"]["given"]["g"]["number"] == str(Fraction("1.62"))
    confirm(told, lambda _: None)
    told["problem"]["given"]["g"]["number"] = str(Fraction(1.62))
    with pytest.raises(Failed, match=r"box|does not hold"):
        confirm(told, lambda _: None)


@cache
def theorem() -> ProvedExtremal:
    """A lander that is proved."""
    found = attempt_proof(pl.solve(meditch(), verify=0), ignore_events).proved
    assert found is not None
    return found


@pytest.mark.parametrize(("away", "proved"), [(0.0, True), (1e-9, False)])
def test_no_root_is_proved_where_there_is_none(away: float, proved: bool) -> None:
    """A box smaller than its distance from the root, as `benchmarks/rigorous_landers.py` claims it of each theorem."""
    found = theorem()
    with ctx.workprec(found.settings.bits):
        sizes = [max(float(c.abs_upper()), 1e-9) for c in found.refined.y]
        place = [c + arb(away * size) for c, size in zip(found.refined.y, sizes, strict=True)]
        radii = [1e-12 * size for size in sizes]
        with nullcontext() if proved else pytest.raises(NotProved):
            prove_root(found.boundary, replace(found.refined, y=place), found.settings, ignore_events, radii)


@pytest.mark.parametrize(("off", "refused"), [(0.0, False), (1e-5, True)])
def test_newton_has_to_be_quadratic(off: float, refused: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """With derivatives that are a little off it still converges, linearly: the sign of a function that is cut off."""
    found = theorem()

    def slopes(*arguments: Any) -> tuple[Any, Any]:
        values, J = flight.slopes(*arguments)
        return values, J * arb(1 + off)

    monkeypatch.setattr(root, "slopes", slopes)
    told = pytest.raises(NotProved, match="quadratically") if refused else nullcontext()
    with ctx.workprec(found.settings.bits), told:
        refine_root(found.boundary, [c * arb(1 + 1e-9) for c in found.refined.y], found.settings, ignore_events)
