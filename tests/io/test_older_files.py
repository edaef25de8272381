"""Files of the version before, whose keys have other names now, are read; they were written by that version."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

import perilune as pl
from perilune import atlas
from perilune.atlas.building.verify import verify_atlas
from perilune.io.save import whole_document
from perilune.problem import with_new_keys
from problems.integrators import CEILING, least_time

OLDER = Path(__file__).parent / "older"
DISTANCES = [1.0, 1.5]


def copied(name: str, tmp_path: Path) -> Path:
    """Return a copy of one of the directories, which a test may write into."""
    return Path(shutil.copytree(OLDER / name, tmp_path / name))


def test_a_solution_of_version_2_is_read_and_proved() -> None:
    loaded = pl.load(OLDER / "arcs")
    [arc] = loaded.structure
    assert arc.description == "along the upper bound of x" and loaded.statistics.initialization == "structure"
    assert len(loaded.statistics.attempts) == 4 and loaded.problem.phases[0].end_outputs is not None
    assert loaded.results["last_place"].value == pytest.approx(0.0, abs=1e-12)
    assert loaded.objective == pytest.approx(4 / (9 * CEILING), rel=1e-12)
    assert pl.verify(loaded, level=3).outcome is pl.Outcome.PROVED


def test_a_model_of_version_2_is_made_again() -> None:
    loaded = pl.load(OLDER / "landing")
    assert loaded.problem.source == "the problem's own Python functions" and loaded.problem.parameter_bounds is not None
    assert loaded.problem.free[0].guess == pytest.approx(845.98, abs=0.01)
    assert loaded.problem.views.comparison is not None and loaded.verification.claimed.startswith("level 0")


def test_what_was_read_is_written_with_the_new_keys(tmp_path: Path) -> None:
    pl.save(pl.load(OLDER / "landing"), tmp_path / "again")
    document = json.loads((tmp_path / "again" / "solution.json").read_text())
    old = json.loads((OLDER / "landing" / "solution.json").read_text())
    assert document["format"]["version"] == 3 and "within" not in document["outcome"]
    assert document["model"] == old["made"] and document["problem"]["digest"] == old["problem"]["digest"]
    assert set(document["problem"]["functions"]) == set(with_new_keys(old, "solution")["problem"]["functions"])


def test_a_file_of_this_version_needs_the_new_keys(tmp_path: Path) -> None:
    """The old names are those of the old version; a mixture is nobody's file."""
    file = copied("arcs", tmp_path) / "solution.json"
    document = json.loads(file.read_text())
    document["format"]["version"] = 3
    file.write_text(json.dumps(document))
    with pytest.raises(pl.PeriluneError, match="problem"):
        pl.load(file)


def test_a_sweep_of_version_1_goes_on_where_it_stood(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(*arguments: Any, **keywords: Any) -> NoReturn:
        raise AssertionError("a member is solved again")

    monkeypatch.setattr(pl.Indirect, "run", run)
    family = pl.sweep(least_time(), {"distance": DISTANCES}, store=copied("sweep", tmp_path), verify=1)
    found = [(point.outcome, point.solution) for point in family.points]
    assert [outcome for outcome, _ in found] == [pl.Outcome.PROVED] * 2 and not family.notes
    for distance, (_, solution) in zip(DISTANCES, found, strict=True):
        assert solution is not None and solution.objective == pytest.approx(2 * np.sqrt(distance), rel=1e-9)
        assert solution.statistics.initialization and solution.statistics.attempts[0].count("starts, ") == 1


def test_an_atlas_of_version_6_answers_and_is_verified(tmp_path: Path) -> None:
    opened = atlas.open(copied("atlas", tmp_path))
    answer = opened.query(distance=1.05)
    assert answer.objective == pytest.approx(2 * np.sqrt(1.05), rel=1e-9) and answer.query.sample_level == 3
    found = verify_atlas(opened, sample=3, seed=1)
    assert found.passed and found.complete and not found.damaged


def test_an_atlas_of_version_6_is_extended(tmp_path: Path) -> None:
    directory = copied("atlas", tmp_path)
    atlas.build(least_time(), {"distance": (1.0, 1.2)}, directory, tolerance=1e-4)  # is complete
    atlas.extend(directory, {"distance": (1.0, 1.3)})
    opened = atlas.open(directory)
    for distance in (1.05, 1.27):
        assert opened.query(distance=distance).objective == pytest.approx(2 * np.sqrt(distance), rel=1e-9)


def test_only_the_programs_own_keys_are_renamed() -> None:
    """A parameter, a result or a free parameter may be called like one of them."""
    names = {"within": 1.0, "text": 2.0, "made": 3.0, "rung": 4.0}
    document = {"given": names, "free": names, "results": names, "statistics": {"rung": "", "tried": []}}
    found = with_new_keys(document, "solution")
    assert found == {**document, "statistics": {"initialization": "", "attempts": []}}
    assert with_new_keys({"thin": 2, "nodes": {"thin": 1}}, "manifest") == {"thin_margin": 2, "nodes": {"thin": 1}}


def test_no_old_key_is_written() -> None:
    """What is written is what the new names read: nothing in it is renamed once more."""
    document = json.loads(json.dumps(whole_document(pl.load(OLDER / "arcs"))))
    assert with_new_keys(document, "solution") == document
