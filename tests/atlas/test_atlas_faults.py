"""What goes wrong around an atlas: refused builds, files of another hand, Ctrl-C, no space left."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from cho import cho_landing
from command_line import ENVIRONMENT, HYBRID, read_json, snapshot
from perilune import Indirect
from perilune.atlas.building import build as building, extend as extending, merge as merging
from perilune.atlas.building.audit import covered_share
from perilune.atlas.building.extend import extend
from perilune.atlas.building.merge import merge
from perilune.atlas.building.verify import verify_atlas
from perilune.atlas.query import reader as read
from perilune.atlas.query.batch_answers import Answered
from perilune.atlas.query.query import open_atlas
from perilune.atlas.store.cells import Status
from perilune.atlas.store.manifest import is_cut_off, read_line, written_line
from perilune.atlas.store.schema import cell_type
from perilune.atlas.store.store import HEADER, MANIFEST, AtlasStore
from perilune.cli import run_command_line
from perilune.core import NotConvergedError, PeriluneError
from perilune.models import key_of

build = partial(building.build, sample=0)  # proofs have tests of their own
AXES = {"vehicle.thrust": (430.0, 450.0), "retro.specific_impulse": (290.0, 310.0)}
LADEN, WEAK = cho_landing(dry_mass=30.0), {"vehicle.thrust": (1.0, 2.0)}  # of which physics refuses every point
VARY = ["--vary", "vehicle.thrust=430:450 N", "--vary", "retro.specific_impulse=290:310 s"]
posix = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals and limits")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(cho_landing(), AXES, tmp_path_factory.mktemp("faults") / "whole")


@pytest.fixture
def copy(built: Path, tmp_path: Path) -> Path:
    """The same, to be damaged."""
    return Path(shutil.copytree(built, tmp_path / "copy"))


# -- builds that are refused -------------------------------------------------------------------------------------------


def test_a_refused_build_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refused by physics, and where no search finds anything, which takes a real one ten seconds."""
    with pytest.raises(PeriluneError, match="nothing to map"):
        build(LADEN, WEAK, tmp_path / "new")
    assert not (tmp_path / "new").exists()
    (tmp_path / "empty").mkdir()
    monkeypatch.setattr(Indirect, "answer", Mock(side_effect=NotConvergedError("no extremal was found")))
    with pytest.raises(PeriluneError, match="nothing to map"):
        build(cho_landing(), AXES, tmp_path / "empty")
    assert (tmp_path / "empty").is_dir() and not snapshot(tmp_path / "empty")


def test_a_range_in_which_numbers_are_one_is_too_narrow(tmp_path: Path) -> None:
    with pytest.raises(PeriluneError, match=r"the range of vehicle\.thrust is too narrow"):
        build(cho_landing(), {"vehicle.thrust": (430.0, 430.0000000000001)}, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_an_atlas_is_replaced_only_by_one_that_can_be_made(copy: Path) -> None:
    whole = snapshot(copy)
    with pytest.raises(PeriluneError, match="nothing to map"):
        build(LADEN, WEAK, copy, force=True)
    with pytest.raises(PeriluneError, match="tolerance"):
        build(cho_landing(), AXES, copy, tolerance=1.0, force=True)
    assert {k: v for k, v in snapshot(copy).items() if "claim" not in k} == whole
    (copy / "letter.txt").write_text("dear")
    with pytest.raises(PeriluneError, match="other files"):
        build(cho_landing(), {"vehicle.thrust": (430.0, 440.0)}, copy, force=True)
    (copy / "letter.txt").unlink()
    build(cho_landing(), {"vehicle.thrust": (430.0, 440.0)}, copy, force=True)
    assert open_atlas(copy).region.names == ("vehicle_thrust",) and len(open_atlas(copy).said) == 8


# -- files of another hand ---------------------------------------------------------------------------------------------


def of_survey(change: Callable[[dict[str, Any]], object]) -> Callable[[dict[str, Any]], object]:
    return lambda line: change(line) if line["kind"] == "survey" else None


def of_bricks(change: Callable[[dict[str, Any]], object]) -> Callable[[dict[str, Any]], object]:
    return lambda line: change(line) if line["kind"] == "brick" else None


FOREIGN = {
    "no charts": of_survey(lambda line: line.update(charts=[])),
    "charts by name": of_survey(lambda line: line.update(charts={})),
    "a chart that is a number": of_survey(lambda line: line.update(charts=[7])),
    "notes that are a number": of_survey(lambda line: line.update(notes=7)),
    "notes of numbers": of_survey(lambda line: line.update(notes=[7])),
    "very many unknowns": of_survey(lambda line: line["charts"][0].update(unknowns=1e9)),
    "too many unknowns": of_survey(lambda line: line["charts"][0].update(unknowns=10**9)),
    "other unknowns": of_survey(lambda line: line["charts"][0].update(unknowns=3)),
    "a digest that is a number": of_survey(lambda line: line.update(digest=7)),
    "a digest that is a path": of_survey(lambda line: line.update(digest="../../../x")),
    "no sheets": of_survey(lambda line: line["charts"][0].update(sheets=[])),
    "a sheet on no side": of_survey(lambda line: line["charts"][0]["sheets"][0].update(orientation=0.5)),
    "a sheet of another nature": of_survey(lambda line: line["charts"][0]["sheets"][0].update(nature="GOOD")),
    "a sheet that holds a list": of_survey(lambda line: line["charts"][0]["sheets"][0].update(holds=[1])),
    "no seeds": of_survey(lambda line: line["charts"][0].pop("seeds")),
    "edges that fall": of_survey(lambda line: line.update(edges=2 * [{"first": 0, "at": [3.0, 2.0]}])),
    "edges of one axis": of_survey(lambda line: line.update(edges=[{"first": 0, "at": [1.0, 2.0]}])),
    "edges that are texts": of_survey(lambda line: line.update(edges=2 * [{"first": "x", "at": ["1"]}])),
    "a brick of another chart": of_bricks(lambda line: line.update(chart=5)),
    "a brick that is a text": of_bricks(lambda line: line.update(brick="00")),
    "a brick of three numbers": of_bricks(lambda line: line.update(brick=[0, 0, 0])),
    "a brick without nodes": of_bricks(lambda line: line.pop("nodes")),
    "nodes that are a list": of_bricks(lambda line: line.update(nodes=[])),
    "rows that are a text": of_bricks(lambda line: line["nodes"].update(rows="many")),
}


@pytest.mark.parametrize("change", FOREIGN.values(), ids=FOREIGN.keys())
def test_lines_of_another_hand_are_refused_in_words(
    change: Callable[[dict[str, Any]], object], copy: Path, built: Path, tmp_path: Path
) -> None:
    lines = [json.loads(line) for line in (copy / MANIFEST).read_text().splitlines()]
    for line in lines:
        change(line)
    (copy / MANIFEST).write_text("".join(written_line(line) + "\n" for line in lines))

    def opened() -> None:
        open_atlas(copy).query(vehicle_thrust=440.0, retro_specific_impulse=300.0)

    for use in (opened, lambda: merge(copy, built, tmp_path / "out"), lambda: extend(copy, {})):
        with pytest.raises(PeriluneError, match="damaged"):
            use()
    assert run_command_line(["atlas", "info", str(copy)]) == 2


# -- what is said ------------------------------------------------------------------------------------------------------


def test_keys_are_those_of_a_file_and_units_are_those_of_people(built: Path, tmp_path: Path) -> None:
    assert key_of("retro_specific_impulse") == "retro.specific_impulse" and key_of("my_own") == "my_own"
    atlas = open_atlas(built)
    with pytest.raises(PeriluneError) as missing:
        atlas.query(vehicle_thrust=440.0)
    assert missing.value.got == "none of retro.specific_impulse"
    with pytest.raises(PeriluneError) as outside:
        atlas.query(vehicle_thrust=440.0, retro_specific_impulse=320.0)
    assert outside.value.got == "retro.specific_impulse 320 s, which is mapped from 290 s to 310 s"
    assert outside.value.expected == "for instance vehicle.thrust 440 N, retro.specific_impulse 310 s"
    near = {"vehicle_thrust": 440.0, "retro_specific_impulse": 310.0}
    assert atlas.query(**near).objective < 0  # what is named is there


# -- Ctrl-C ------------------------------------------------------------------------------------------------------------


@posix
@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_stops_a_build_that_goes_on_later(workers: str, built: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    order = [sys.executable, "-m", "perilune", "atlas", "build", HYBRID, *VARY, "--out", str(out)]
    order += ["--workers", workers, "--sample", "50"]  # so that it is at work for a while
    stopped = subprocess.Popen(
        order, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    until = time.monotonic() + 60
    while time.monotonic() < until and not (out / MANIFEST).exists() and stopped.poll() is None:
        time.sleep(0.005)
    os.killpg(stopped.pid, signal.SIGINT)  # as a terminal does: all processes of the job
    printed, said = stopped.communicate(timeout=60)
    advice = "  try: the same command with --resume continues\n"
    ending = re.sub(r"^perilune: running for .*\n", "", said, flags=re.MULTILINE)
    assert (stopped.returncode, printed, ending) == (130, "", f"perilune: stopped by the user\n{advice}")
    kept = {name: content for name, content in snapshot(out).items() if name.endswith(".npy")}
    assert not [name for name in snapshot(out) if "writing" in name]
    build(cho_landing(), AXES, out)
    again = snapshot(out)
    assert all(again[name] == content for name, content in kept.items())
    assert len(open_atlas(out).said) == len(open_atlas(built).said) == 16
    assert not [name for name in again if "claim" in name and "survey" not in name]


def test_ctrl_c_says_how_to_go_on_where_something_is_there(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not of an atlas that `--force` did not replace yet, nor of one whose wider region is not surveyed yet."""
    there, new = str(built), str(tmp_path / "new")

    def stopped(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(building, "build", stopped)
    monkeypatch.setattr(extending, "extend", stopped)
    wider, order = ["--vary", "vehicle.thrust=430:460 N"], ["atlas", "build", HYBRID, *VARY, "--out"]
    for typed, advice in (
        ([*order, there, "--resume"], "the same command with --resume continues"),
        ([*order, there, "--force"], ""),
        ([*order, new], ""),
        (["atlas", "extend", there], f"perilune atlas extend {there} builds what is missing"),
        (["atlas", "extend", there, *wider], ""),
    ):
        assert run_command_line([*typed, "--json"]) == 130
        told = capsys.readouterr()
        assert read_json(told.out)["error"]["try"] == advice and ("try:" in told.err) == bool(advice)


def test_ctrl_c_of_a_merge_and_an_export_says_what_is_there(
    built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    half, file, there = tmp_path / "half", str(tmp_path / "nodes.nc"), str(built)
    half.mkdir()
    (half / "brick-0.nodes.npy").touch()
    monkeypatch.setattr(merging, "merge", stopped)
    monkeypatch.setattr(os, "replace", stopped)
    for order, advice in (
        (
            ["merge", there, there, "--out", str(half)],
            f"{half} is not a complete atlas; repeat the same command to merge again",
        ),
        (["merge", there, there, "--out", str(tmp_path / "new")], ""),
        (["merge", there, there, "--out", there, "--force"], ""),
        (["export", there, "--out", file], f"nothing was written to {file}"),
    ):
        assert run_command_line(["atlas", *order, "--json"]) == 130
        assert read_json(capsys.readouterr().out)["error"]["try"] == advice
    assert list(tmp_path.iterdir()) == [half]


# -- no space left -----------------------------------------------------------------------------------------------------

LIMITED = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
from perilune.cli import run_command_line as run
sys.exit(run(sys.argv[2:]))
"""


@posix
def test_no_space_left_is_said_and_what_is_there_is_kept(built: Path, tmp_path: Path) -> None:
    """A limit on the size of files, met in the middle of a line of the manifest."""
    out, sizes = tmp_path / "full", {path.name: path.stat().st_size for path in built.iterdir()}
    least = max(size for name, size in sizes.items() if name != MANIFEST)
    if sizes[MANIFEST] <= least + 200:
        shutil.copytree(built, out)
        lines = (out / MANIFEST).read_text().splitlines(keepends=True)
        padded = json.loads(lines[0])
        padded["notes"] = ["x" * (least + 200)]
        (out / MANIFEST).write_text(written_line(padded) + "\n" + "".join(lines[1:4]))
        limit = (out / MANIFEST).stat().st_size + 60
    else:
        limit = sizes[MANIFEST] - 700
    order = [sys.executable, "-c", LIMITED, str(limit), "atlas", "build", HYBRID, *VARY, "--out", str(out), "--resume"]
    done = subprocess.run(order, env=ENVIRONMENT, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("perilune: the atlas cannot be written") and "space" in done.stderr
    before = open_atlas(out).said
    build(cho_landing(), AXES, out)
    after = open_atlas(out)
    assert len(after.said) == 16 and all(after.said[key] == line for key, line in before.items())


@pytest.mark.parametrize(
    ("number", "helps"),
    [(errno.ENOSPC, "free space"), (errno.EACCES, "its permissions"), (errno.EROFS, "its permissions")],
)
def test_what_cannot_be_written_is_said_with_what_helps(
    number: int, helps: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", full)
    store = AtlasStore(tmp_path / "full")
    store.prepare({})
    for write in (lambda: store.begin({}), lambda: store.add({}), lambda: store.put("survey-0.npy", np.zeros(3))):
        with pytest.raises(PeriluneError, match="cannot be written") as said:
            write()
        assert os.strerror(number) in said.value.got
        assert helps in said.value.advice and "--resume" in said.value.advice
    assert [path.name for path in (tmp_path / "full").iterdir()] == [MANIFEST]


def test_what_dead_and_other_builders_leave_is_removed(copy: Path) -> None:
    whole = snapshot(copy)
    shard = next(name for name in whole if name.endswith(".npy"))
    (copy / f".writing-1-{shard}").write_bytes(whole[shard][:50])  # of one that was killed
    (copy / ".claim-0-0-0").touch()  # of one that looked when another had just let go
    build(cho_landing(), AXES, copy)
    assert snapshot(copy) == whole


def test_an_atlas_without_its_survey_is_not_built_and_nothing_of_it_is_verified(copy: Path) -> None:
    """A manifest that is lost, or was cut in its first line, says nothing of where sheets have answers."""
    (copy / MANIFEST).write_bytes((copy / MANIFEST).read_bytes()[:200])
    atlas = open_atlas(copy)
    with pytest.raises(PeriluneError, match="not built yet"):
        atlas.query(vehicle_thrust=440.0, retro_specific_impulse=300.0)
    assert atlas.query_many(np.array([[440.0, 300.0]])).answered == Answered.NOT_BUILT
    with pytest.raises(PeriluneError, match="no survey"):
        verify_atlas(atlas, 0)


def test_a_header_that_was_altered_is_refused(copy: Path) -> None:
    """Else extremals of the one problem are polished to those of another, each with its proof."""
    header = copy / HEADER
    said = json.loads(header.read_text())
    said["given"]["body_rotation_rate"]["value"] *= 10.0
    header.write_text(json.dumps(said))
    with pytest.raises(PeriluneError, match=f"{HEADER} is not as it was written"):
        open_atlas(copy)
    header.write_text(header.read_text()[:100])
    with pytest.raises(PeriluneError, match="the atlas is not readable JSON") as cut:
        open_atlas(copy)
    assert "atlas build" in cut.value.advice


def test_a_header_beside_the_manifest_of_another_atlas_is_refused(built: Path, tmp_path: Path) -> None:
    """As where a copy of one onto another stops halfway: best flights of one problem were given for those of another.

    And a map that is replaced while it is open is not taken for the one that was opened.
    """
    problem, axes = cho_landing().with_given(retro_specific_impulse=270.0), {"vehicle.thrust": (430.0, 450.0)}
    other = build(problem, axes, tmp_path / "other", bricks=1)
    opened = open_atlas(other)
    shutil.copy(built / HEADER, other)
    for orders in (
        lambda: open_atlas(other),
        lambda: extend(other, {}),
        lambda: merge(other, built, tmp_path / "both"),
    ):
        with pytest.raises(PeriluneError, match="belong to two atlases"):
            orders()
    build(cho_landing(), axes, other, bricks=1, force=True)
    assert len(open_atlas(other).said) > 0
    with pytest.raises(PeriluneError, match="belong to two atlases"):
        opened.refresh()


def test_lines_that_cannot_be_read_any_more_are_named(copy: Path) -> None:
    """One that was not written whole, of a builder that was killed, is not among them."""
    lines = (copy / MANIFEST).read_bytes().splitlines(keepends=True)
    broken = lines[1].replace(b'"rows": ', b'"rows": x', 1)
    (copy / MANIFEST).write_bytes(b"".join([lines[0], lines[1][:90] + b"\n", broken, *lines[2:]]))
    found = verify_atlas(open_atlas(copy), 0)
    assert not found.passed and len(found.damaged) == 1 and found.damaged[0].startswith("1 line of manifest.jsonl")


def test_a_line_of_which_one_bit_has_changed_says_nothing(copy: Path) -> None:
    """Edges of bricks that had moved led points into cells of others: wrong answers, each with its proof."""
    lines = (copy / MANIFEST).read_bytes().splitlines(keepends=True)
    edges = {**json.loads(lines[0]), "edges": [{"first": 0, "at": [425.0, 450.0]}]}
    whole = (written_line(edges) + "\n").encode()
    for place in range(len(whole) - 2):  # a line without its end is one of a builder that was killed
        for bit in (1, 16):
            broken = whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :]
            if b"\n" not in broken[:-1] and b"\r" not in broken:
                assert read_line(broken.strip()) is None, broken
                assert not is_cut_off(broken.strip()), broken
    assert all(is_cut_off(whole[:size]) for size in range(1, len(whole) - 1) if whole[size - 1 : size] != b"}")
    assert read_line(whole.strip()) == {name: value for name, value in edges.items() if name != "crc32"}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="POSIX forks")
def test_a_worker_that_is_forked_holds_nothing_of_its_builders(tmp_path: Path) -> None:
    """It may outlive a builder that was killed, and others would wait for it for ever."""
    kept, (hears, says) = AtlasStore(tmp_path), os.pipe()
    with kept.claimed("sample") as ours:
        assert ours
        child = os.fork()
        if not child:
            os.write(says, b"!")
            time.sleep(20)
            os._exit(0)
        assert os.read(hears, 1) == b"!"
    try:
        with kept.claimed("sample") as again:
            assert again
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        for end in (hears, says):
            os.close(end)


def test_a_brick_that_is_lost_is_named_and_nothing_answers_in_its_place(built: Path, copy: Path) -> None:
    """Also where another sheet of the place is there: what is left need not be the best."""
    lines = (copy / MANIFEST).read_bytes().splitlines(keepends=True)
    lost = next(json.loads(line) for line in lines if json.loads(line)["kind"] == "brick")
    (copy / MANIFEST).write_bytes(b"".join(line for line in lines if json.loads(line).get("name") != lost["name"]))
    atlas = open_atlas(copy)
    low, high = atlas.region.box(tuple(lost["brick"]))
    middle = 0.5 * (low + high)
    assert open_atlas(built).query_many(middle[None]).good.all()
    assert atlas.unbuilt == {(lost["chart"], *lost["brick"])}
    assert atlas.query_many(middle[None]).answered[0] == Answered.NOT_BUILT
    with pytest.raises(PeriluneError, match="not built yet"):
        atlas.query(**dict(zip(atlas.region.names, middle.tolist(), strict=True)))
    found = verify_atlas(atlas, 0)
    assert not found.passed and "bricks are missing" in str(found)
    extend(copy, {}, sample=0)
    again = open_atlas(copy)
    assert not again.unbuilt and again.query_many(middle[None]).good.all()
    vars(again)["unbuilt"] = {(1, *lost["brick"])}  # of another chart
    assert again.query_many(middle[None]).answered[0] == Answered.NOT_BUILT
    with pytest.raises(PeriluneError, match="not built yet"):
        again.query(**dict(zip(atlas.region.names, middle.tolist(), strict=True)))


def test_a_manifest_that_lacks_its_last_lines_is_not_whole(built: Path, copy: Path) -> None:
    """As a copy that was broken off leaves it: bricks into which sheets went on come last."""
    assert verify_atlas(open_atlas(built), 0).passed
    lines = (copy / MANIFEST).read_bytes().splitlines(keepends=True)
    for count in (len(lines) - 1, len(lines) - 2):
        (copy / MANIFEST).write_bytes(b"".join(lines[:count]))
        found = verify_atlas(open_atlas(copy), 0)
        assert not found.passed and not found.damaged and "bricks are missing" in str(found)
    extend(copy, {}, sample=0)
    assert verify_atlas(open_atlas(copy), 0).passed


def test_a_damaged_shard_of_the_survey_is_found(copy: Path) -> None:
    """No query reads it, but who extends or merges the atlas does; it is named once, with what is wrong of it."""
    file = copy / "survey-0.npy"
    content = bytearray(file.read_bytes())
    content[-9] ^= 1
    file.write_bytes(content)
    found = verify_atlas(open_atlas(copy), 0)
    assert not found.passed and len(found.damaged) == 1
    assert found.damaged[0].count(file.name) == 1 and "that does not match its checksum" in found.damaged[0]


@pytest.mark.parametrize("kind", ["nodes", MANIFEST])
def test_a_file_that_may_not_be_read_is_not_called_damaged(
    kind: str, copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who is told so removes its line, and what it stands for is lost."""

    def denied(path: Path, *_: Any) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    atlas = open_atlas(copy)
    monkeypatch.setattr(Path, "read_bytes" if kind == "nodes" else "open", denied)
    with pytest.raises(PeriluneError, match="cannot be read: ") as said:
        atlas.query(vehicle_thrust=440.0, retro_specific_impulse=300.0) if kind == "nodes" else atlas.refresh()
    assert kind in said.value.what and "damaged" not in said.value.what


def test_a_line_that_was_not_written_whole_is_no_line(tmp_path: Path) -> None:
    store = AtlasStore(tmp_path)
    store.add({"kind": "brick", "name": "a"})
    with (tmp_path / MANIFEST).open("a") as opened:
        opened.write('{"kind": "brick", "na')
    assert [line["name"] for line in store.lines()] == ["a"]
    store.add({"kind": "brick", "name": "b"})
    assert (
        [line["name"] for line in store.lines()]
        == ["a", "b"]
        == [line["name"] for line in AtlasStore(tmp_path).lines()]
    )
    assert store.there("b") and not store.there("na")


def test_many_bricks_open_few_files(built: Path, copy: Path) -> None:
    """Each brick that is at work is claimed by a file that is open, and no longer."""
    if not Path("/proc/self/fd").exists():
        pytest.skip("no list of open files here")
    (copy / MANIFEST).write_text((copy / MANIFEST).read_text().splitlines(keepends=True)[0])
    most = list[int]()
    build(cho_landing(), AXES, copy, callback=lambda _: most.append(len(os.listdir("/proc/self/fd"))))
    assert max(most) - min(most) <= 2
    assert np.array_equal(sorted(snapshot(built)), sorted(snapshot(copy)))


def test_many_small_bricks_make_the_same_answers(built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More bricks than are kept open, and sheets that go on from one into the next."""
    many = open_atlas(build(cho_landing(), {**AXES, "vehicle.thrust": (350.0, 450.0)}, tmp_path / "many", bricks=7))
    assert len(many.said) == 49
    monkeypatch.setattr(read, "_MOST_OPEN", 3)
    points = np.random.default_rng(5).uniform(many.region.low, many.region.high, (200, 2))
    points[:, 0] = np.maximum(points[:, 0], 430.0)
    found, few = many.query_many(points), open_atlas(built).query_many(points)
    assert found.good.all() and len(many._bricks) <= 3
    np.testing.assert_allclose(found.objective, few.objective, rtol=1e-10)
    whole = snapshot(tmp_path / "many")
    build(cho_landing(), {**AXES, "vehicle.thrust": (350.0, 450.0)}, tmp_path / "many")  # they stay
    assert snapshot(tmp_path / "many") == whole


@pytest.mark.parametrize("bricks", [0, -1, 2.5, True, "4", 10**4])
def test_numbers_of_bricks_that_are_none_are_refused(bricks: Any, tmp_path: Path) -> None:
    with pytest.raises(PeriluneError, match="bricks"):
        build(cho_landing(), AXES, tmp_path / "out", bricks=bricks)
    assert not (tmp_path / "out").exists()


# -- what answers nowhere ----------------------------------------------------------------------------------------------


def silenced(directory: Path, keep: int = 0) -> None:
    """Let the sheets of all bricks but the first few end in each of their cells."""
    store = AtlasStore(directory)
    survey = store.survey()
    assert survey is not None
    for line in list(store.latest(survey, 2).values())[keep:]:
        cells = np.array(store.shard(line["cells"], cell_type(2)))
        cells["status"] = np.where(cells["child"] >= 0, cells["status"], Status.ENDS)
        store.add({**line, "cells": store.put(line["cells"]["file"], cells)})


def test_how_much_of_the_region_has_cells_that_answer_is_told(copy: Path) -> None:
    atlas = open_atlas(copy)
    drawn = np.random.default_rng(7).uniform(atlas.region.low, atlas.region.high, (200, 2))
    assert covered_share(atlas) == (1.0, 0.0) and atlas.query_many(drawn).good.all()
    silenced(copy, keep=4)
    atlas = open_atlas(copy)
    good = atlas.query_many(drawn).good.mean()
    assert 0.1 < covered_share(atlas).answered < 0.4 and good == pytest.approx(covered_share(atlas).answered, abs=0.08)


def test_what_physics_refuses_is_not_counted_as_answered(tmp_path: Path) -> None:
    """From 100 km on perilune lies above the parking orbit."""
    atlas = open_atlas(build(cho_landing(), {"orbit.perilune_altitude": (80e3, 120e3)}, tmp_path / "high", bricks=2))
    found = covered_share(atlas)
    assert found.impossible == pytest.approx(0.5, abs=0.05) and found.answered == pytest.approx(1 - found.impossible)


def test_a_build_that_answers_nowhere_is_refused_and_kept(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    silenced(copy, keep=1)
    build(cho_landing(), AXES, copy)  # one brick answers
    silenced(copy)
    whole = snapshot(copy)
    with pytest.raises(NotConvergedError, match=r"answers nowhere.*\n  got: \d+ extremals in \d+ bricks\n"):
        build(cho_landing(), AXES, copy)
    assert {k: v for k, v in snapshot(copy).items() if "claim" not in k} == whole
    assert (
        run_command_line(["atlas", "build", str(HYBRID), *VARY, "--out", str(copy), "--resume", "--sample", "0"]) == 4
    )
    assert "answers nowhere" in capsys.readouterr().err
    assert run_command_line(["atlas", "info", str(copy)]) == 0
    assert "cells that answer: 0.0 % of the region, by 1000 points" in capsys.readouterr().out
