"""Batches from stores and executors: the same to the last bit, nothing taken for proved, and jumps followed."""

from __future__ import annotations

import csv
import io
import json
import pickle
import zipfile
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from command_line import ROOT, read_json
from perilune import PeriluneError, Problem, Solution
from perilune.cli import run_command_line
from perilune.families.batch import Batch
from perilune.families.batch_solver import BatchSolver
from perilune.families.solve_many import solve_many
from problems.constrained import bryson_denham
from problems.folded import cusp, cusp_cost

POINTS = {"vehicle.thrust": [*np.linspace(400.0, 480.0, 7), -1.0], "landing.altitude": [*[0.0] * 6, 20e3, 0.0]}


class Pickling:
    """Executor that sends calls and results as a pool of processes does."""

    def submit(self, function: Any, /, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        call, given = pickle.loads(pickle.dumps((function, arguments)))
        future.set_result(pickle.loads(pickle.dumps(call(*given))))
        return future


def same(one: Batch, other: Batch) -> bool:
    columns = zip(one._rows.columns, other._rows.columns, strict=True)
    return one.messages == other.messages and all(
        np.array_equal(a, b, equal_nan=True) and name == also for (name, a), (also, b) in columns
    )


@pytest.fixture(scope="module")
def known(landing: Problem) -> Solution:
    return pl.solve(landing, verify=0)


@pytest.fixture(scope="module")
def whole(landing: Problem, known: Solution) -> Batch:
    batch = solve_many(landing, POINTS, known)
    assert batch.outcomes.tolist() == [*["SOLVED"] * 6, "INFEASIBLE", "REFUSED"]
    return batch


def test_a_batch_goes_on_where_it_was_broken_off(
    landing: Problem, known: Solution, whole: Batch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("perilune.families.solve_many._TOGETHER", 3)

    def stop(event: Any) -> None:
        if event == "6 of 8 points":
            raise KeyboardInterrupt

    first = solve_many(landing, POINTS, known, store=tmp_path / "s", callback=stop)
    assert first.interrupted and first.solved.sum() == 6
    names = sorted(path.name for path in (tmp_path / "s").iterdir())
    assert names == ["points-000000.npz", "points-000003.npz", "sweep.json"]
    (tmp_path / "s" / ".writing-1-points-000006.npz").write_bytes(b"half")
    written = (tmp_path / "s" / names[0]).stat().st_mtime_ns
    again = solve_many(landing, POINTS, known, store=tmp_path / "s")
    assert (tmp_path / "s" / names[0]).stat().st_mtime_ns == written  # what is there is not written again
    assert same(again, whole) and again.notes == ("6 of 8 points are as stored",)
    assert again.solution(1).objective == whole.solution(1).objective


def test_an_executor_finds_the_same_bits(
    landing: Problem, known: Solution, whole: Batch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("perilune.families.solve_many._TOGETHER", 2)
    with ThreadPoolExecutor(2) as threads:
        assert same(solve_many(landing, POINTS, known, executor=threads), whole)
    batch = solve_many(landing, POINTS, known, executor=Pickling())
    assert same(batch, whole) and pl.verify(batch.solution(0), 1).outcome is pl.Outcome.PROVED
    with pytest.raises(PeriluneError, match="executor"):
        solve_many(landing, POINTS, known, executor=3)  # type: ignore[arg-type]


def changed(place: Path, **columns: Any) -> None:
    (file,) = place.glob("points-*.npz")
    with np.load(file) as tables:
        arrays = {name: tables[name].copy() for name in tables.files} | columns
    np.savez(file, **arrays)


@pytest.mark.parametrize(
    "forged",
    [
        {"codes": np.full(8, list(pl.Outcome).index(pl.Outcome.PROVED), dtype=np.int8)},
        {"codes": np.full(8, 99, dtype=np.int8)},
        {"origin": np.full(8, 5, dtype=np.int16)},
        {"values": np.zeros((8, 2))},
        {"objective": np.full(8, np.nan)},
        {"slopes": np.zeros(3)},
        {"messages": np.frombuffer(b'{"99": "x"}', dtype=np.uint8)},
        {"messages": np.zeros(2)},
    ],
    ids=lambda forged: next(iter(forged)),
)
def test_forged_rows_are_solved_again(
    landing: Problem, known: Solution, whole: Batch, tmp_path: Path, forged: dict[str, Any]
) -> None:
    solve_many(landing, POINTS, known, store=tmp_path)
    changed(tmp_path, **forged)
    batch = solve_many(landing, POINTS, known, store=tmp_path)
    assert same(batch, whole) and any("cannot be used" in note for note in batch.notes)


@pytest.mark.parametrize("damage", ["cut", "bits", "compression", "password", "text"])
def test_damaged_files_are_solved_again(
    landing: Problem, known: Solution, whole: Batch, tmp_path: Path, damage: str
) -> None:
    """Whatever a damaged archive makes zipfile, zlib and NumPy raise, its points are solved again."""
    solve_many(landing, POINTS, known, store=tmp_path)
    (file,) = tmp_path.glob("points-*.npz")
    content = bytearray(file.read_bytes())
    with zipfile.ZipFile(file) as packed:
        first = packed.infolist()[-1]
    begin = content.index(b"PK\x01\x02")  # entry of the first array in the directory of the archive
    if damage == "cut":
        del content[len(content) // 2 :]
    elif damage == "bits":
        content[first.header_offset + 60 : first.header_offset + 100] = bytes(range(170, 210))
    elif damage == "compression":
        content[begin + 10] = 99
    elif damage == "password":
        content[begin + 8] |= 1
    file.write_bytes(content)
    if damage == "text":
        with zipfile.ZipFile(file, "a") as packed:
            packed.writestr("words.txt", "no array")
    batch = solve_many(landing, POINTS, known, store=tmp_path)
    assert same(batch, whole) and any("cannot be used" in note for note in batch.notes)


def test_a_point_that_is_broken_off_between_two_known_solutions_has_no_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the first one leads to is the worse minimum where b > 0."""
    of_both, at = [pl.solve(cusp(-1.0, b), verify=0) for b in (-0.2, 0.2)], np.linspace(-0.3, 0.3, 4)
    solve_from = BatchSolver._solve_from

    def stop(self: BatchSolver, *given: Any) -> None:
        if given[-1] == 1:
            raise KeyboardInterrupt
        solve_from(self, *given)

    with monkeypatch.context() as patched:
        patched.setattr(BatchSolver, "_solve_from", stop)
        batch = solve_many(cusp(-1.0, -0.2), {"b": at}, of_both, store=tmp_path)
    assert batch.interrupted and set(batch.outcomes) == {"INTERRUPTED"} and not batch.solved.any()
    again = solve_many(cusp(-1.0, -0.2), {"b": at}, of_both, store=tmp_path)
    assert again.objective == pytest.approx([cusp_cost(-1.0, b) for b in at], rel=1e-9)


def test_what_was_solved_alone_before_an_interruption_is_kept(
    landing: Problem, known: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = {"vehicle.thrust": [430.0, 440.0, 450.0]}
    monkeypatch.setattr(BatchSolver, "_solver", lambda *given: None)  # no lanes

    def stop(event: Any) -> None:
        if event == "3 of 3 points solved alone":
            raise KeyboardInterrupt

    first = solve_many(landing, points, known, store=tmp_path, callback=stop)
    assert first.outcomes.tolist() == ["SOLVED", "SOLVED", "INTERRUPTED"]
    calls = list[Any]()
    again = solve_many(landing, points, known, store=tmp_path, callback=calls.append)
    assert "1 of 1 points solved alone" in calls and again.notes == ("2 of 3 points are as stored",)
    assert np.array_equal(again.objective[:2], first.objective[:2]) and again.solved.all()


def test_what_a_store_calls_proved_is_proved_again(landing: Problem, known: Solution, tmp_path: Path) -> None:
    points = {"vehicle.thrust": [430.0, 450.0]}
    proved = solve_many(landing, points, known, store=tmp_path, verify=1)
    assert proved.outcomes.tolist() == ["PROVED", "PROVED"] and proved.levels.tolist() == [1, 1]
    calls = list[Any]()
    again = solve_many(landing, points, known, store=tmp_path, verify=1, callback=calls.append)
    assert same(again, proved) and "2 of 2 points proved" in calls


def test_a_store_of_another_batch_is_refused(landing: Problem, known: Solution, tmp_path: Path) -> None:
    solve_many(landing, POINTS, known, store=tmp_path)
    with pytest.raises(PeriluneError, match="points"):
        solve_many(landing, {"vehicle.thrust": [430.0]}, known, store=tmp_path)
    with pytest.raises(PeriluneError, match="differs in its search"):
        solve_many(landing, POINTS, known, store=tmp_path, search=False)
    with pytest.raises(PeriluneError, match="differs"):
        pl.sweep(landing, {"vehicle.thrust": [430.0]}, store=tmp_path)


def test_more_time_solves_again_what_was_not_found(tmp_path: Path) -> None:
    points = {"ceiling": [0.28, 0.2]}

    def solved(time_limit: float) -> Batch:
        known = pl.solve(bryson_denham(0.3), verify=0)
        return solve_many(bryson_denham(0.3), points, known, search=False, store=tmp_path, time_limit=time_limit)

    assert solved(10.0).outcomes.tolist() == ["SOLVED", "NOT_CONVERGED"] and solved(5.0).notes == (
        "2 of 2 points are as stored",
    )
    again = solved(20.0)
    assert again.outcomes.tolist() == ["SOLVED", "NOT_CONVERGED"] and again.notes == ("1 of 2 points are as stored",)


def test_jumps_of_the_best_extremal_are_followed() -> None:
    """J jumps from one minimum to another at b = 0, far from where the guess is."""
    at = np.linspace(-0.3, 0.3, 101)
    batch = solve_many(cusp(-1.0, -0.2), {"b": at})
    assert batch.objective == pytest.approx([cusp_cost(-1.0, b) for b in at], rel=1e-9)
    assert not batch.solved_alone.size
    of_both = [pl.solve(cusp(-1.0, b), verify=0) for b in (-0.2, 0.2)]
    few = solve_many(cusp(-1.0, -0.2), {"b": at[::10]}, of_both)
    assert few.objective == pytest.approx(batch.objective[::10], rel=1e-12)


def test_points_can_be_solved_where_the_problem_as_it_is_cannot(landing: Problem) -> None:
    """A scenario may stand at a corner of a grid that nothing reaches; the other points lose nothing by it."""
    lines = list[Any]()
    high = landing.with_given(landing_altitude=20e3)
    batch = solve_many(high, {"landing.altitude": [20e3, 0.0, 500.0]}, callback=lines.append)
    assert batch.outcomes.tolist() == ["INFEASIBLE", "SOLVED", "SOLVED"]
    assert batch.objective[1] == pytest.approx(pl.solve(landing, verify=0).objective, rel=1e-9)
    assert any("points are solved in its place" in str(line) for line in lines)
    with pytest.raises(pl.InfeasibleError):
        solve_many(high, {"landing.altitude": [20e3, 21e3]})


SWEEP = [
    "sweep", str(ROOT / "examples" / "hybrid_lander.toml"), "--batch",
    "--vary", "vehicle.thrust=430:450:10 N", "--vary", "vehicle.specific_impulse=300,310 s",
]  # fmt: skip


def test_the_command_solves_members_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = str(tmp_path / "out")
    assert run_command_line([*SWEEP, "--out", place]) == 0
    rows = list(csv.reader(io.StringIO(capsys.readouterr().out)))
    assert rows[0][:3] == ["vehicle_thrust [N]", "vehicle_specific_impulse [s]", "landed_mass [kg]"]
    assert [row[:2] for row in rows[1:3]] == [["430.0", "300.0"], ["430.0", "310.0"]]
    assert [row[-3:] for row in rows[1:]] == [["SOLVED", "0", ""]] * 6
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "family.csv", "family.json", "family.png", "family.svg", "members",
    }  # fmt: skip
    written = json.loads((tmp_path / "out" / "family.json").read_text(encoding="utf-8"))
    alone = pl.solve(pl.scenario.load_file(SWEEP[1]).problem.with_given(vehicle_thrust=430.0), verify=0)
    told = written["points"][1]["results"]
    assert told["landed_mass"]["value"] == pytest.approx(alone.results["landed_mass"].value, rel=1e-9)
    assert run_command_line([*SWEEP, "--out", place]) == 2  # it is there already
    assert "--resume" in capsys.readouterr().err
    assert run_command_line([*SWEEP, "--out", place, "--resume", "--json"]) == 0
    out, err = capsys.readouterr()
    assert read_json(out)["points"] == written["points"] and "6 of 6 points are as stored" in err


def test_the_command_begins_with_the_values_of_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ends of a range may have no solution that begins a batch."""
    begun = list[float]()

    def stop(problem: Problem, *given: Any, **options: Any) -> None:
        begun.append(problem.given["vehicle_thrust"].value)
        raise PeriluneError("seen enough")

    monkeypatch.setattr("perilune.solve_many", stop)
    assert run_command_line([*SWEEP[:3], "--vary", "vehicle.thrust=50:900:170 N"]) == 2
    assert begun == [440.0]


def test_what_a_batch_does_not_have_is_no_axis_of_its_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line([*SWEEP, "--out", str(tmp_path / "out"), "--z", "gravity_loss"]) == 2
    assert "leave out --batch" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_batch_says_that_it_takes_no_tolerance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "lander.toml"
    file.write_text(Path(SWEEP[1]).read_text(encoding="utf-8") + '\n[proof]\nposition = "1 m"\n', encoding="utf-8")
    assert (
        run_command_line(["sweep", str(file), *SWEEP[2:3], "--vary", "vehicle.thrust=440,450 N", "--level", "1"]) == 0
    )
    out, err = capsys.readouterr()
    assert out.count("PROVED") == 2 and "[proof]" in err


@pytest.mark.parametrize("more", [["--method", "direct"], ["--starts", "3"], ["--nodes", "30"]])
def test_a_batch_takes_no_settings_of_a_method(more: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line([*SWEEP, *more]) == 2
    assert "--batch" in capsys.readouterr().err
