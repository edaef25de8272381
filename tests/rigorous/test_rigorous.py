"""Level 5: the prover by closed forms, and what it says."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any, cast

import pytest

import perilune as pl
from perilune.problem import Check, Verification
from problems.integrators import least_time
from problems.landings import meditch
from problems.singular import nearest_to_zero

pytest.importorskip("flint")
import prover_checks
from perilune.rigorous.verified import add_theorem_checks


@pytest.mark.parametrize("check", prover_checks.CHECKS, ids=lambda check: check.__name__)
def test_the_prover(check: Callable[[], bool]) -> None:
    assert prover_checks.holds(check)


def test_a_theorem_is_a_level_of_the_verification() -> None:
    solution = prover_checks.solved(meditch)
    found = pl.verify(solution, level=5).verification
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
            "no theorem: near the answer only another extremal is proved",
        ),
    ):
        found = add_theorem_checks(Verification(checks=(check,)), solution)
        assert found.level == 1 and found.passed and found.certificate is None
        assert found.notes[0].startswith(note)


def test_without_ball_arithmetic_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    solution = prover_checks.solved(meditch)
    for name in [name for name in sys.modules if name.startswith("perilune.rigorous")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(pl.PeriluneError, match=r"pip install 'perilune\[rigorous\]'"):
        pl.verify(solution, level=5)
    never = SimpleNamespace(run=lambda *_: pytest.fail("solved, where the proof was to be refused first"))
    with pytest.raises(pl.PeriluneError, match="python-flint"):
        pl.solve(solution.problem, cast("Any", never), verify=5)


def test_a_theorem_is_tried_of_what_is_proved_to_level_3_and_it_is_said() -> None:
    solution = prover_checks.solved(least_time)
    found = pl.verify(replace(solution, objective=1.001 * solution.objective), level=5).verification
    assert not found.passed and found.certificate is None
    note = f"no theorem: it is attempted only from level 3, and this solution reaches level {found.level}"
    assert found.notes[0] == note
