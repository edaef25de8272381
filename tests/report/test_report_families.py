"""Tables of families, and what is said of a paper beside its printed numbers."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from perilune import Family, FamilyPoint
from perilune.core import NotConvergedError, Outcome, PeriluneError
from perilune.families.family import failed_point
from perilune.problem import Extremal, Nature, Solution
from perilune.report.family import family_csv, family_document, family_figure, write_family
from perilune_papers.cho2015.case import PRINTED
from perilune_papers.cho2015.compute import best_with_retro_burn, cho_numbers, compute_cho, gain_of_retro_burn

# --- families ---


@pytest.fixture
def family(hybrid: Solution, ordinary: Solution) -> Family:
    """Three members, the middle one failed."""
    return Family(
        problem=hybrid.problem,
        parameters=("retro_specific_impulse",),
        points=(
            FamilyPoint(values=(310.0,), solution=hybrid),
            failed_point((290.0,), NotConvergedError("no solution", advice="less")),
            FamilyPoint(values=(270.0,), solution=ordinary),
        ),
    )


def test_a_family_is_a_table_with_its_failures(family: Family) -> None:
    """A failed member has empty cells and its reason on the same row."""
    rows = list(csv.reader(io.StringIO(family_csv(family))))
    assert rows[0][0] == "retro_specific_impulse [s]" and "landed_mass [kg]" in rows[0]
    assert [row[0] for row in rows[1:]] == ["310.0", "290.0", "270.0"]
    assert rows[0][-3:] == ["outcome", "verification_level", "message"]
    assert rows[2][-3:] == ["NOT_CONVERGED", "0", "no solution try: less"]
    assert set(rows[2][1:-3]) == {""}
    document = family_document(family)
    assert document["points"][0]["results"]["landed_mass"]["value"] == pytest.approx(160.6186, abs=5e-5)
    assert document["points"][1]["results"] == {}
    assert document["interrupted"] is False
    assert family_document(replace(family, interrupted=True))["interrupted"] is True


def test_a_family_is_written_with_its_figure(family: Family, tmp_path) -> None:
    """CSV, JSON, PNG and SVG; refuses to overwrite."""
    write_family(family, tmp_path / "f")
    assert sorted(path.name for path in (tmp_path / "f").iterdir()) == [
        "family.csv", "family.json", "family.png", "family.svg",
    ]  # fmt: skip
    json.loads((tmp_path / "f" / "family.json").read_text(encoding="utf-8"))
    with pytest.raises(PeriluneError, match="--force"):
        write_family(family, tmp_path / "f")


def test_a_member_that_is_not_proved_is_seen_in_the_figure(family: Family, ordinary: Solution) -> None:
    doubted = FamilyPoint(values=(250.0,), solution=replace(ordinary, outcome=Outcome.NOT_PROVED))
    panel = family_figure(replace(family, points=(*family.points, doubted))).axes[0]
    assert panel.get_title("right") == "hollow: NOT_PROVED, dotted: no solution"
    hollow = [line for line in panel.lines if line.get_markerfacecolor() == "none"]
    assert [np.asarray(line.get_xdata()).tolist() for line in hollow] == [[250.0]]
    assert family_figure(family).axes[0].get_title("right") == "dotted: no solution"


# --- the paper ---


def test_printed_numbers_are_never_passed_off_as_computed(hybrid: Solution, ordinary: Solution) -> None:
    """The computed column follows the solutions: swap them and it changes, the printed column does not."""
    right: Any = SimpleNamespace(hybrid=hybrid, ordinary=ordinary)
    swapped: Any = SimpleNamespace(hybrid=ordinary, ordinary=hybrid)
    for name, (printed, _, _) in PRINTED.items():
        computed = cho_numbers(right)[name]
        assert computed != printed
        assert computed == pytest.approx(printed, abs=5e-2 if name == "optimal retro burn" else 5e-5)
        if name != "perilune speed V0":
            assert abs(cho_numbers(swapped)[name] - printed) > 1.0


def test_gain_of_the_retro_burn_compares_the_best_of_each_kind() -> None:
    """The locally worst extremal does not count."""

    def extremal(delta_v: float, mass: float, nature: Nature) -> Extremal:
        return Extremal(free={"retro_delta_v": delta_v}, objective=-mass, nature=nature)

    solution: Any = SimpleNamespace(
        extremals=(
            extremal(0.0, 154.0, Nature.BEST_AT_BOUND),
            extremal(130.0, 152.0, Nature.WORST),
            extremal(1080.0, 153.5, Nature.LOCAL_OPTIMUM),
        )
    )
    assert best_with_retro_burn(solution).free["retro_delta_v"] == 1080.0
    assert gain_of_retro_burn(solution) == pytest.approx(-0.5)
    with pytest.raises(PeriluneError, match="no extremal with a retro burn"):
        best_with_retro_burn(SimpleNamespace(extremals=solution.extremals[:1]))  # type: ignore[arg-type]


def test_a_stopped_family_stops_the_reproduction(monkeypatch: pytest.MonkeyPatch, hybrid: Solution) -> None:
    """A sweep answers Ctrl-C with what it has, which must not be taken for the whole figure."""
    stopped = Family(problem=hybrid.problem, parameters=("retro_delta_v",), points=(), interrupted=True)
    monkeypatch.setattr("perilune_papers.cho2015.compute.solve", lambda *_, **__: hybrid)
    monkeypatch.setattr("perilune_papers.cho2015.compute.sweep", lambda *_, **__: stopped)
    with pytest.raises(KeyboardInterrupt):
        compute_cho(lambda _: None, level=0)
