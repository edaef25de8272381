"""Atlases made wider, and two made one: what is kept, what is added, what is refused, what a kill leaves."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cho import cho_landing
from command_line import ENVIRONMENT, read_json, snapshot
from perilune.atlas.building import build as building, extend as extending
from perilune.atlas.building.merge import merge
from perilune.atlas.building.verify import verify_atlas
from perilune.atlas.query.query import Atlas, open_atlas
from perilune.atlas.region import region_of, wider
from perilune.atlas.store.checksums import CHECKSUM, with_checksum
from perilune.atlas.store.manifest import written_line
from perilune.atlas.store.store import HEADER, MANIFEST, AtlasStore
from perilune.atlas.survey.surveyed_chart import SurveyedChart
from perilune.cli import run_command_line
from perilune.core import PeriluneError
from perilune.solve import solve

build = partial(building.build, sample=0)  # proofs have tests of their own
extend = partial(extending.extend, sample=0)
ISP = {"retro.specific_impulse": (290.0, 310.0)}
LOW, HIGH, BOTH = ({"vehicle.thrust": ends, **ISP} for ends in ((430.0, 440.0), (440.0, 450.0), (430.0, 450.0)))


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two atlases side by side."""
    place = tmp_path_factory.mktemp("parts")
    return build(cho_landing(), LOW, place / "low"), build(cho_landing(), HIGH, place / "high")


@pytest.fixture
def low(parts: tuple[Path, Path], tmp_path: Path) -> Path:
    """A copy of the lower one."""
    return Path(shutil.copytree(parts[0], tmp_path / "low"))


def shards(place: Path) -> list[bytes]:
    return [content for name, content in sorted(snapshot(place).items()) if name.endswith(".npy")]


def assert_right(atlas: Atlas, ends: dict[str, tuple[float, float]]) -> None:
    """All over a region there are the answers of a solve from nothing."""
    low, high = np.array(list(ends.values())).T
    points = np.random.default_rng(4).uniform(low, high, (400, 2))
    found = atlas.query_many(points)
    assert found.good.all() and found.error_bound.max() < 1e-9
    for i in (0, 200):
        given = dict(zip(("vehicle_thrust", "retro_specific_impulse"), points[i].tolist(), strict=True))
        alone = solve(cho_landing().with_given(**given), verify=0)
        assert found.objective[i] == pytest.approx(alone.objective, rel=1e-10)
        assert atlas.query(**given).objective == pytest.approx(alone.objective, rel=1e-10)


# -- wider -------------------------------------------------------------------------------------------------------------


def test_a_wider_region_keeps_its_bricks_and_has_more() -> None:
    region = region_of(cho_landing(), LOW)
    wide = wider(region, {"vehicle.thrust": (424.0, 441.0)})
    axis = wide.axes[0]
    np.testing.assert_allclose(axis.edges, [424.0, 426.0, 428.0, 430.0, 432.5, 435.0, 437.5, 440.0, 441.0])
    assert axis.first == -3 and wide.axes[1] == region.axes[1] and wider(region, {}) == region
    for brick in region.bricks:
        np.testing.assert_array_equal(wide.box(brick), region.box(brick))
    for brick in wide.bricks:
        low, high = wide.box(brick)
        assert wide.brick_of(0.5 * (low + high)) == brick == tuple(wide.bricks_of(0.5 * (low + high)[None])[0])
    assert wide.brick_of(wide.low) == (-3, 0) and wide.brick_of(wide.high) == (4, 3)


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ({"vehicle.mass": (1.0, 2.0)}, "no axis"),
        ({"vehicle.thrust": (431.0, 450.0)}, "excludes a part"),
        ({"vehicle.thrust": (430.0, float("inf"))}, "excludes a part"),
        ({"vehicle.thrust": (float("nan"), 440.0)}, "excludes a part"),
        ({"vehicle.thrust": (-5.0, 440.0)}, "thrust"),
    ],
)
def test_regions_that_are_not_wider_are_refused(low: Path, axes: dict, words: str) -> None:
    whole = snapshot(low)
    with pytest.raises(PeriluneError, match=words):
        extend(low, axes)
    assert {k: v for k, v in snapshot(low).items() if "claim" not in k} == {
        k: v for k, v in whole.items() if "claim" not in k
    }


def test_an_atlas_grows_and_nothing_is_computed_again(low: Path) -> None:
    before = snapshot(low)
    atlas = open_atlas(low)
    extend(low, {"vehicle.thrust": (424.0, 445.0), "retro.specific_impulse": (280.0, 310.0)})
    after = snapshot(low)
    assert all(after[name] == content for name, content in before.items() if name != MANIFEST)
    assert after[MANIFEST].startswith(before[MANIFEST])
    ends = {"vehicle.thrust": (424.0, 445.0), "retro.specific_impulse": (280.0, 310.0)}
    assert_right(open_atlas(low), ends)
    with pytest.raises(PeriluneError, match="outside"):
        atlas.query(vehicle_thrust=445.0, retro_specific_impulse=300.0)
    atlas.refresh()  # a reader sees what is added when it looks
    assert atlas.query(vehicle_thrust=445.0, retro_specific_impulse=300.0).objective < 0
    whole = snapshot(low)
    extend(low, ends)
    build(cho_landing(), LOW, low)  # the first order goes on with all of it
    assert snapshot(low) == whole
    assert verify_atlas(open_atlas(low), 0).passed
    with pytest.raises(PeriluneError, match="differs in its axes"):
        build(cho_landing(), BOTH, low)


def test_units_of_what_is_there_stay_when_the_region_grows(tmp_path: Path) -> None:
    """The canonical unit of a parameter follows its range where that is narrow; nodes are in that of their chart."""
    mu = cho_landing().given["body_gravitational_parameter"].value
    key, (low, middle, high) = "body.gravitational_parameter", (mu * (1 + k * 6e-5) for k in (0, 1, 3))
    one, other = (
        build(cho_landing(), {key: ends}, tmp_path / str(ends[0]), bricks=2) for ends in ((low, middle), (middle, high))
    )
    sheets = len(open_atlas(one).charted[0].sheets)
    merge(one, other, tmp_path / "merged")
    extend(one, {key: (low, high)})
    assert len(open_atlas(one).charted) == 1 and len(open_atlas(one).charted[0].sheets) == sheets
    for place in (one, tmp_path / "merged"):
        found = open_atlas(place).query_many(np.linspace(low, high, 9)[:, None])
        assert found.good.all() and found.guess_error.max() < 1e-9


def test_sheets_that_are_new_reach_into_what_was_there(low: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first survey is made to miss the better sheet; a wider one finds it, and no brick of it was there."""
    lines = [json.loads(line) for line in (low / MANIFEST).read_text().splitlines()]
    survey = lines[0]
    labels = [sheet.label for sheet in open_atlas(low).charted[0].sheets]
    kept = next(i for i, label in enumerate(labels) if "at a bound" in label and "lower" in label)
    seeds = np.load(low / survey["charts"][0]["seeds"]["file"])
    seeds = seeds[seeds["sheet"] == kept]
    seeds["sheet"] = 0
    store = AtlasStore(low)
    chart = {**survey["charts"][0], "sheets": [survey["charts"][0]["sheets"][kept]]}
    chart["seeds"] = store.put("survey-0.npy", seeds)
    (low / MANIFEST).write_text(written_line({**survey, "charts": [chart]}) + "\n")
    build(cho_landing(), LOW, low)
    at = {"vehicle_thrust": 435.0, "retro_specific_impulse": 305.0}
    assert open_atlas(low).query(**at).free["retro_delta_v"] == 0.0
    extend(low, {"vehicle.thrust": (430.0, 445.0)})
    atlas = open_atlas(low)
    assert len(atlas.charted) == 2 and len(atlas.charted[0].sheets) == 1
    assert atlas.query(**at).free["retro_delta_v"] > 900.0
    assert_right(atlas, {"vehicle.thrust": (430.0, 445.0), **ISP})


@pytest.mark.parametrize("kept", [None, 0, 1])
def test_sheets_that_are_not_found_again_are_carried_on(
    kept: int | None, low: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Forgetful(extending.Survey):
        def run(self) -> list[SurveyedChart]:
            if kept is None:
                raise PeriluneError("there is nothing to map")
            return [replace(one, sheets=one.sheets[:1], y=one.y[:1]) for one in super().run()[:kept]]

    monkeypatch.setattr(extending, "Survey", Forgetful)
    extend(low, {"vehicle.thrust": (425.0, 440.0)})
    assert_right(open_atlas(low), {"vehicle.thrust": (425.0, 440.0), **ISP})


def test_an_atlas_without_a_survey_is_not_extended(low: Path) -> None:
    (low / MANIFEST).write_text("")
    with pytest.raises(PeriluneError, match="no survey"):
        extend(low, {"vehicle.thrust": (420.0, 440.0)})
    with pytest.raises(PeriluneError):
        extend(low / "nowhere", {})


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="a POSIX signal")
def test_a_killed_extension_goes_on(low: Path) -> None:
    order = [sys.executable, "-m", "perilune", "atlas", "extend", str(low), "--vary", "vehicle.thrust=430:460 N"]
    killed = subprocess.Popen(order, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until, size = time.monotonic() + 60, (low / MANIFEST).stat().st_size
    while time.monotonic() < until and (low / MANIFEST).stat().st_size == size and killed.poll() is None:
        time.sleep(0.005)
    killed.kill()
    killed.wait()
    before = open_atlas(low)
    assert before.region.high[0] == 460.0 and len(before.said) >= 16
    lines = (low / MANIFEST).read_bytes()
    extend(low, {})
    assert (low / MANIFEST).read_bytes().startswith(lines) and len(open_atlas(low).said) == 48
    assert_right(open_atlas(low), {"vehicle.thrust": (430.0, 460.0), **ISP})


# -- two made one ------------------------------------------------------------------------------------------------------


def test_two_side_by_side_make_one(parts: tuple[Path, Path], tmp_path: Path) -> None:
    before = [snapshot(part) for part in parts]
    for number, (one, other) in enumerate((parts, parts[::-1])):
        atlas = open_atlas(merge(one, other, tmp_path / str(number)))
        assert atlas.region.low[0] == 430.0 and atlas.region.high[0] == 450.0
        assert len(atlas.said) == sum(len(open_atlas(part).said) for part in parts)
    assert shards(tmp_path / "0") == shards(tmp_path / "1")
    assert_right(atlas, BOTH)
    assert [snapshot(part) for part in parts] == before
    whole = snapshot(tmp_path / "0")
    build(cho_landing(), BOTH, tmp_path / "0")  # there is nothing left to compute
    assert {k for k, v in snapshot(tmp_path / "0").items() if whole.get(k) != v and ".claim" not in k} == set()
    extend(tmp_path / "0", {"vehicle.thrust": (430.0, 451.0)})
    assert_right(open_atlas(tmp_path / "0"), {"vehicle.thrust": (430.0, 451.0), **ISP})


def put_header(directory: Path, header: dict[str, Any]) -> None:
    """Another header, which the lines of its manifest name as well."""
    said, manifest = with_checksum(header), directory / MANIFEST
    lines = [json.loads(line) for line in manifest.read_text().splitlines()]
    own = ({**line, "header": said[CHECKSUM]} if line["kind"] == "survey" else line for line in lines)
    manifest.write_text("".join(written_line(line) + "\n" for line in own))
    (directory / HEADER).write_text(json.dumps(said))


def test_a_merged_atlas_names_the_versions_that_computed_it(parts: tuple[Path, Path], tmp_path: Path) -> None:
    other = Path(shutil.copytree(parts[1], tmp_path / "other"))
    header = json.loads((other / HEADER).read_text())
    ours, header["versions"]["perilune"] = header["versions"]["perilune"], "0.0.1"
    put_header(other, header)
    versions = json.loads((merge(parts[0], other, tmp_path / "both") / HEADER).read_text())["versions"]
    assert versions == {**header["versions"], "perilune": f"{ours} and 0.0.1"}


def test_two_parts_of_one_survey_make_a_whole(low: Path, parts: tuple[Path, Path], tmp_path: Path) -> None:
    other = Path(shutil.copytree(low, tmp_path / "other"))
    lines = (low / MANIFEST).read_text().splitlines(keepends=True)
    (low / MANIFEST).write_text("".join(lines[:9]))
    (other / MANIFEST).write_text("".join([lines[0], *lines[7:]]))
    atlas = open_atlas(merge(low, other, tmp_path / "whole"))
    assert len(atlas.charted) == 1 and len(atlas.said) == 16
    assert_right(atlas, LOW)


def test_a_place_that_one_has_whole_is_taken_from_it(low: Path, parts: tuple[Path, Path], tmp_path: Path) -> None:
    """Of two surveys of one region the bricks of the second fill what the first lacks."""
    other = build(cho_landing(), LOW, tmp_path / "other", method=None)
    lines = [json.loads(line) for line in (other / MANIFEST).read_text().splitlines()]
    for line in lines:
        line["digest" if line["kind"] == "survey" else "survey"] = "another"
    (other / MANIFEST).write_text("".join(written_line(line) + "\n" for line in lines))
    kept = (low / MANIFEST).read_text().splitlines(keepends=True)
    (low / MANIFEST).write_text("".join(kept[:12]))
    atlas = open_atlas(merge(low, other, tmp_path / "filled"))
    assert len(atlas.charted) == 2 and len(atlas.said) == 16
    assert [key[0] for key in sorted(atlas.said)].count(1) == 5
    assert_right(atlas, LOW)


def test_atlases_that_do_not_go_together_are_refused(low: Path, parts: tuple[Path, Path], tmp_path: Path) -> None:
    def refused(words: str, one: Path, other: Path, out: Path = tmp_path / "out") -> None:
        with pytest.raises(PeriluneError, match=words):
            merge(one, other, out)

    changed = Path(shutil.copytree(parts[1], tmp_path / "changed"))
    header = json.loads((changed / HEADER).read_text())

    def change(**more: object) -> Path:
        put_header(changed, {**header, **more})
        return changed

    refused("different tolerance", low, change(tolerance=1e-8))
    refused("different axes", low, change(axes=header["axes"][::-1]))
    wide = extend(Path(shutil.copytree(low, tmp_path / "wide")), {"vehicle.thrust": (430.0, 445.0)})
    refused("do not form one", low, wide)
    refused("no atlas", low, tmp_path / "nowhere")
    refused("holds an atlas already", low, parts[1], parts[1])
    mapped = open_atlas(low)
    file = low / next(iter(mapped.said.values()))["cells"]["file"]
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    refused(file.name, low, parts[1])
    assert not (tmp_path / "out" / HEADER).exists()
    with pytest.raises(PeriluneError, match="no atlas"):
        open_atlas(tmp_path / "out")


def test_a_merge_that_was_stopped_goes_on(
    parts: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stop(Exception):
        pass

    def stopping(text: object) -> None:
        if str(text).startswith("20 of"):
            raise Stop

    with pytest.raises(Stop):
        merge(*parts, tmp_path / "out", callback=stopping)
    left = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "out").glob("brick-*")}
    assert left
    merge(*parts, tmp_path / "out")
    assert all((tmp_path / "out" / name).stat().st_mtime_ns == at for name, at in left.items())
    assert len(open_atlas(tmp_path / "out").said) == 32


def test_a_merge_that_fails_leaves_the_atlas_that_it_was_to_replace(
    parts: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It had removed that one first, and a full disk left nothing."""
    out = Path(shutil.copytree(parts[0], tmp_path / "out"))
    before, put = snapshot(out), AtlasStore.put

    def full(store: AtlasStore, name: str, array: Any) -> dict[str, Any]:
        if name.startswith("brick"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return put(store, name, array)

    with monkeypatch.context() as patch:
        patch.setattr(AtlasStore, "put", full)
        with pytest.raises(OSError, match="space"):
            merge(*parts, out, force=True)
    assert snapshot(out) == before and list(tmp_path.iterdir()) == [out]
    merge(*parts, out, force=True)
    assert snapshot(out) == snapshot(merge(*parts, tmp_path / "anew")) and len(open_atlas(out).said) == 32


# -- the command line --------------------------------------------------------------------------------------------------


def test_the_command_line_extends_and_merges(
    low: Path, parts: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command_line(["atlas", "extend", str(low), "--vary", "vehicle.thrust=425:440 N", "--json"]) == 0
    told = read_json(capsys.readouterr().out)
    assert told["axes"][0]["low"] == 425.0 and told["bricks"] == 24
    for vary in ("vehicle.thrust=426:440 N", "vehicle.thrust=420 N", "vehicle.thrust=420:440 s", "mass=1:2 kg"):
        assert run_command_line(["atlas", "extend", str(low), "--vary", vary]) == 2
        assert capsys.readouterr().err.startswith("perilune: ")
    twice = ["--vary", "vehicle.thrust=425:440 N"]
    assert run_command_line(["atlas", "extend", str(low), *twice, *twice]) == 2
    out = str(tmp_path / "out")
    assert run_command_line(["atlas", "merge", *map(str, parts), "--out", out, "--json"]) == 0
    assert read_json(capsys.readouterr().out)["bricks"] == 32
    assert run_command_line(["atlas", "merge", *map(str, parts), "--out", out]) == 2
    assert "--force" in capsys.readouterr().err
    assert run_command_line(["atlas", "merge", *map(str, parts), "--out", out, "--force"]) == 0
    assert run_command_line(["atlas", "merge", str(parts[0]), "--out", out]) == 2
