"""Proofs of answers at nodes, drawn while an atlas is built: how many, of which, and what they say of the rest."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cho import cho_landing
from command_line import HYBRID, read_json
from perilune.atlas.building import audit as sampling
from perilune.atlas.building.audit import Certificate, Sample, assured_share, drawn_at_random, drawn_thin, sample_of
from perilune.atlas.building.build import build
from perilune.atlas.building.extend import extend
from perilune.atlas.building.merge import merge
from perilune.atlas.building.verify import AtlasVerification
from perilune.atlas.query.query import Atlas, open_atlas
from perilune.atlas.query.reader import are_possible_answers
from perilune.atlas.store.manifest import written_line
from perilune.atlas.store.store import MANIFEST, AtlasStore
from perilune.cli import run_command_line
from perilune.core import PeriluneError
from perilune.verify import verify

THRUST = {"vehicle.thrust": (430.0, 450.0)}
AXES = {**THRUST, "retro.specific_impulse": (270.0, 310.0)}
VARY = ["--vary", "vehicle.thrust=430:450 N"]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(cho_landing(), THRUST, tmp_path_factory.mktemp("sampled") / "whole", sample=3)


@pytest.fixture
def copy(built: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(built, tmp_path / "copy"))


def proofs(place: Path) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in (place / MANIFEST).read_text().splitlines()]
    return [line for line in lines if line["kind"] == "sample"]


def test_what_is_drawn_are_nodes_and_their_certificates_are_kept(built: Path) -> None:
    (line,) = proofs(built)
    atlas, sample = open_atlas(built), sample_of(open_atlas(built))
    assert line["level"] == 3 and sample.proved == len(sample.drawn) == 3 and not sample.unproved
    nodes = np.concatenate([np.load(built / one["nodes"]["file"])["values"] for one in atlas.said.values()])
    for one in sample.drawn:
        assert one.values in map(tuple, nodes.tolist())
        again = verify(atlas.query(vehicle_thrust=one.values[0]), 3)  # as anyone may
        assert again.verification.level == one.level == 3 and one.failed == ()
    assert len({one.values for one in sample.drawn}) == 3


def test_a_merge_keeps_the_proofs_of_nodes_whose_bricks_it_takes(built: Path, tmp_path: Path) -> None:
    """They say nothing of the whole. At the common side the other one's brick answers: a proof there is dropped."""
    beside = Path(shutil.copytree(built, tmp_path / "copy"))
    other = build(cho_landing(), {"vehicle.thrust": (450.0, 455.0)}, tmp_path / "other", sample=1)
    line = proofs(beside)[0]
    at_side = {**line["drawn"][0], "values": [450.0]}
    text = (beside / MANIFEST).read_text().replace(json.dumps(line), written_line({**line, "thin_margin": [at_side]}))
    (beside / MANIFEST).write_text(text)
    atlas = open_atlas(merge(beside, other, tmp_path / "merged"))
    own, others = sample_of(open_atlas(built)).drawn, sample_of(open_atlas(other)).drawn
    sample, before = sample_of(atlas), [*own, *others]
    assert not sample.drawn and not sample.thin and sample.share == 0.0
    kept = [one.values for one in own if one.values != (450.0,)] + [one.values for one in others]
    assert sorted(one.values for one in sample.merged) == sorted(kept) and len(kept) >= 3
    told = f"{len(kept)} of {len(kept)} drawn from the merged atlases proved to level 3"
    assert told in sample.describe(atlas)
    lost = 1 + len(before) - len(kept)
    assert any(note.startswith(f"{lost} proofs of the merged atlases are dropped") for note in atlas.survey["notes"])
    for one in sample.merged:
        assert verify(atlas.query(vehicle_thrust=one.values[0]), 3).verification.level == one.level == 3
    extend(atlas.store.directory, {}, sample=2)
    assert len(sample_of(open_atlas(atlas.store.directory)).drawn) == 2


def test_what_a_draw_says_of_all_is_the_binomial_bound() -> None:
    assert (
        assured_share(459, 459) == pytest.approx(0.99, abs=1e-4)
        and assured_share(458, 459) == assured_share(0, 0) == 0.0
    )
    for n in (1, 10, 459):  # with that share of good ones n good ones in a row come once in a hundred draws
        assert assured_share(n, n) ** n == pytest.approx(0.01)
    good = Certificate(values=(1.0,), level=3, failed=())
    assert Sample(drawn=(good,) * 10).share == assured_share(10, 10)
    assert Sample(drawn=(good, replace(good, level=2, failed=("x",)))).share == 0.0


def test_more_proofs_are_added_and_none_is_made_twice(copy: Path) -> None:
    whole = (copy / MANIFEST).read_bytes()
    build(cho_landing(), THRUST, copy, sample=3)
    build(cho_landing(), THRUST, copy, sample=1)
    build(cho_landing(), THRUST, copy)
    assert (copy / MANIFEST).read_bytes() == whole
    build(cho_landing(), THRUST, copy, sample=5)
    assert [line["requested"] for line in proofs(copy)] == [3, 2]
    assert len(sample_of(open_atlas(copy)).drawn) == 5


def test_of_a_wider_atlas_is_drawn_anew(copy: Path) -> None:
    extend(copy, {"vehicle.thrust": (430.0, 460.0)}, sample=4)
    sample = sample_of(open_atlas(copy))
    assert len(sample.drawn) == 4 and [line["requested"] for line in proofs(copy)] == [3, 4]


def test_draws_go_all_over_and_are_answers(tmp_path: Path) -> None:
    """Of two sheets, one the worse of the two at many nodes, and one that can be no answer."""
    atlas = open_atlas(build(cho_landing(), AXES, tmp_path / "two", sample=0))
    drawn = list(drawn_at_random(atlas, 30, np.random.default_rng(1), {}))
    assert len(drawn) == len({at for at, _ in drawn}) == 30
    places = np.array([at for at, _ in drawn])
    assert len(np.unique(atlas.region.bricks_of(places), axis=0)) >= 8
    for at, solution in drawn[::10]:
        assert (solution.parameters.vehicle_thrust, solution.parameters.retro_specific_impulse) == at
    thin = list(drawn_thin(atlas, 3, np.random.default_rng(1)))
    count = 0
    for key, line in atlas.said.items():
        nodes, sheets = np.load(atlas.store.directory / line["nodes"]["file"]), atlas.charted[key[0]].sheets
        found = are_possible_answers(nodes, sheets) & (nodes["margin"] < 1e-3)
        assert line["thin_margin"] == found.sum()
        count += int(found.sum())
    assert sample_of(atlas).thin_nodes == count and len(thin) == min(3, count)
    assert not list(drawn_at_random(atlas, 0, np.random.default_rng(1), {}))


def test_places_that_a_query_refuses_are_counted_and_said(
    copy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """They were left out without a word; the confidence speaks of what is answered."""
    query, asked = Atlas.query, list[float]()

    def refusing_first(atlas: Atlas, **at: float) -> Any:
        asked.extend(at.values())
        if len(asked) == 1:
            raise PeriluneError("no answer here")
        return query(atlas, **at)

    monkeypatch.setattr(Atlas, "query", refusing_first)
    assert run_command_line(["atlas", "verify", str(copy), "--sample", "2", "--json"]) == 0
    found = read_json(capsys.readouterr().out)
    assert found["drawn"] == found["proved"] == 2 and found["share"] == assured_share(2, 2)
    assert found["refused"] == len(found["refusals"]) == 1 and found["refusals"][0].endswith(" N: no answer here")
    told = str(AtlasVerification(**{name: found[name] for name in (f.name for f in fields(AtlasVerification))}))
    assert "of 3 places that were drawn, a query refuses 1" in told and found["refusals"][0] in told
    asked.clear()
    build(cho_landing(), THRUST, copy, sample=4)
    assert [line["refused"] for line in proofs(copy)] == [0, 1]
    atlas = open_atlas(copy)
    assert "of 5 places that were drawn, a query refuses 1" in "\n".join(sample_of(atlas).describe(atlas))


def test_what_is_not_proved_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing that this program can build is known to fail, so the proof is made to."""

    def strict(solution: Any, level: int) -> Any:
        proved = verify(solution, level)
        if solution.parameters.vehicle_thrust > 440.0:
            first, *others = proved.verification.checks
            wrong = replace(first, value=2.0 * abs(first.limit) + 1.0)
            return replace(proved, verification=replace(proved.verification, checks=(wrong, *others)))
        return proved

    monkeypatch.setattr(sampling, "verify", strict)
    out = str(tmp_path / "out")
    assert run_command_line(["atlas", "build", HYBRID, *VARY, "--out", out, "--sample", "12", "--json"]) == 5
    told = read_json(capsys.readouterr().out)["proofs"]
    assert told["drawn"] > told["proved"] > 0 and told["share"] == 0.0
    assert all(one["values"][0] > 440.0 and one["failed"] for one in told["unproved"])
    assert run_command_line(["atlas", "info", out]) == 0
    assert "not " in (said := capsys.readouterr().out) and "confidence" not in said


def test_the_command_line_says_what_the_sample_says(built: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["atlas", "info", str(built)]) == 0
    assert "3 of 3 answers drawn at random proved to level 3: at least 21.5 % of all" in capsys.readouterr().out


@pytest.mark.parametrize("sample", [-1, 2.5, True, "3"])
def test_numbers_of_proofs_that_are_none_are_refused(sample: Any, copy: Path) -> None:
    with pytest.raises(PeriluneError, match="a valid number of answers"):
        build(cho_landing(), THRUST, copy, sample=sample)
    with pytest.raises(PeriluneError, match="a valid number of answers"):
        extend(copy, {}, sample=sample)


@pytest.mark.parametrize(
    "change",
    [
        lambda line: line.update(asked="many"),
        lambda line: line.update(drawn={}),
        lambda line: line.update(drawn=[7]),
        lambda line: line["drawn"][0].update(values=["x"]),
        lambda line: line["drawn"][0].update(values=[1.0, 2.0]),
        lambda line: line["drawn"][0].update(level=None),
        lambda line: line["drawn"][0].update(failed="all"),
        lambda line: line.pop("thin_margin"),
    ],
)
def test_proofs_of_another_hand_are_refused_in_words(change: Callable[[dict[str, Any]], object], copy: Path) -> None:
    lines = [json.loads(line) for line in (copy / MANIFEST).read_text().splitlines()]
    change(lines[-1])
    (copy / MANIFEST).write_text("".join(written_line(line) + "\n" for line in lines))
    with pytest.raises(PeriluneError, match="damaged"):
        sample_of(open_atlas(copy))
    assert run_command_line(["atlas", "info", str(copy)]) == 2


def test_an_answer_says_what_those_reached_that_were_drawn(built: Path, copy: Path) -> None:
    """Of an atlas of which none was drawn nothing; where one of them failed, no more than it reached."""
    assert open_atlas(built).query(vehicle_thrust=440.0).query.sample_level == 3
    lines = AtlasStore(copy).lines()
    others = [line for line in lines if line["kind"] != "sample"]
    AtlasStore(copy).write_lines(others)
    assert open_atlas(copy).query(vehicle_thrust=440.0).query.sample_level == 0
    (sample,) = [line for line in lines if line["kind"] == "sample"]
    sample["drawn"][0]["level"] = 1
    AtlasStore(copy).write_lines([*others, sample])
    assert open_atlas(copy).query(vehicle_thrust=440.0).query.sample_level == 1
