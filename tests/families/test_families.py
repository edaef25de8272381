"""Families anywhere: grids, lists, executors, a store that a killed sweep goes on from."""

from __future__ import annotations

import errno
import json
import os
import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cho import cho_landing
from command_line import read_json
from perilune import Pseudospectral
from perilune.cli import run_command_line
from perilune.core import InfeasibleError, NotConvergedError, Outcome, PeriluneError
from perilune.families.family import Family, FamilyPoint
from perilune.families.sweep import sweep
from perilune.problem import Problem
from perilune.report.family import family_csv
from perilune.solve import solve
from perilune.verify import verify
from problems.landings import meditch

GRID = {"vehicle.thrust": [440.0, 500.0], "vehicle.mass": [290.0, 300.0, 310.0]}
EXAMPLE = str(Path(__file__).parents[2] / "examples" / "ordinary_lander.toml")


@pytest.fixture(scope="module")
def fixed() -> Problem:
    return cho_landing(dry_mass=30.0).with_given(retro_delta_v=0.0)


@pytest.fixture(scope="module")
def grid(fixed: Problem) -> Family:
    """Two parameters, one after the other, proved feasible."""
    return sweep(fixed, GRID, verify=1)


def objectives(family: Family) -> list[float]:
    return [p.solution.objective if p.solution else np.nan for p in family.points]


def test_a_grid_changes_its_last_parameter_fastest(fixed: Problem, grid: Family) -> None:
    assert grid.parameters == ("vehicle_thrust", "vehicle_mass")
    assert grid.units == ("N", "kg")
    assert [p.values for p in grid.points] == [(t, m) for t in (440.0, 500.0) for m in (290.0, 300.0, 310.0)]
    assert {p.outcome for p in grid.points} == {Outcome.PROVED}
    alone = solve(fixed.with_given(vehicle_thrust=500.0, vehicle_mass=310.0), verify=0)
    assert objectives(grid)[-1] == alone.objective


def test_a_list_of_points(fixed: Problem, grid: Family) -> None:
    points = [{"vehicle.mass": 310.0, "vehicle.thrust": 500.0}, {"vehicle.mass": 290.0, "vehicle.thrust": 440.0}]
    family = sweep(fixed, points)
    assert family.parameters == ("vehicle_mass", "vehicle_thrust")
    assert objectives(family) == [objectives(grid)[-1], objectives(grid)[0]]


def test_processes_answer_as_one_after_the_other(fixed: Problem, grid: Family) -> None:
    """Bit for bit; what comes back is of the caller's own problem."""
    lines: list[Any] = []
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        family = sweep(fixed, GRID, verify=1, executor=pool, callback=lines.append)
    assert [p.values for p in family.points] == [p.values for p in grid.points]
    assert objectives(family) == objectives(grid)
    assert {p.outcome for p in family.points} == {Outcome.PROVED}
    last = family.points[-1].solution
    assert last is not None
    assert last.problem == fixed.with_given(vehicle_thrust=500.0, vehicle_mass=310.0)
    assert last.problem.source == "the problem's own Python functions"
    assert last.verification.source == "expressions from a copy"
    said = [str(line).rpartition(", ")[2] for line in lines if str(line).endswith(" done")]
    assert said == [f"{n} of 6 done" for n in range(1, 7)]


def test_another_method_on_threads(fixed: Problem) -> None:
    """And a member that physics refuses is a member with its reason."""
    with ThreadPoolExecutor(1) as pool:
        family = sweep(
            fixed, {"vehicle.thrust": [440.0, 1.0]}, Pseudospectral(nodes=20, refine=0, polish=False), executor=pool
        )
    assert family.points[0].solution and family.points[0].solution.method == "pseudospectral"
    assert family.points[1].outcome is Outcome.INFEASIBLE
    assert "too weak" in family.points[1].message


def test_what_cannot_be_flown_is_refused_in_a_sweep_too() -> None:
    """Not SOLVED with 0.56 kg landed: the gate is that of `solve`."""
    (point,) = sweep(cho_landing(), {"retro_delta_v": [9999.0]}).points
    assert point.outcome is Outcome.INFEASIBLE


class Client:
    """A stand-in for a Dask client: futures that are none of the standard library, in any order."""

    def __init__(self) -> None:
        self.held: list[tuple[Future[Any], Any, Any]] = []

    def submit(self, function: Any, *arguments: Any) -> Any:
        future: Future[Any] = Future()
        self.held.append((future, *pickle.loads(pickle.dumps((function, arguments)))))
        if len(self.held) == 2:
            for future_, call, given in reversed(self.held):
                future_.set_result(call(*given))
            self.held.clear()
        return future


def test_any_client_that_submits(fixed: Problem, grid: Family) -> None:
    assert objectives(sweep(fixed, GRID, executor=Client())) == objectives(grid)


def test_a_lost_worker_is_said(fixed: Problem) -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        pool.submit(os.getpid).result()
        os.kill(pool.submit(os.getpid).result(), signal.SIGKILL)
        with pytest.raises(PeriluneError, match="a worker, or the connection to it, was lost"):
            sweep(fixed, GRID, executor=pool)


@pytest.mark.parametrize(
    ("over", "words"),
    [
        ([], "one parameter or several"),
        ([{"vehicle.mass": 300.0}, {"vehicle.thrust": 440.0}], "same parameters"),
        ({"vehicle.mass": [300.0], "vehicle_mass": [300.0]}, "one parameter or several"),
        ({"vehicle.mass": ["heavy"]}, "must be finite numbers"),
        ({"vehicle.mass": [300.0], "vehicle.thrust": []}, "must be finite numbers"),
        ({"vehicle.mas": [300.0]}, "did you mean 'vehicle_mass'"),
    ],
)
def test_unusable_families(fixed: Problem, over: Any, words: str) -> None:
    with pytest.raises(PeriluneError, match=words):
        sweep(fixed, over)


@pytest.mark.parametrize("error", [PeriluneError, InfeasibleError, NotConvergedError])
def test_refusals_cross_process_borders(error: type[PeriluneError]) -> None:
    made = error("too weak", got="4 N", expected="more", advice="try it")
    there = pickle.loads(pickle.dumps(made))
    assert type(there) is error
    assert str(there) == str(made) and vars(there) == vars(made)


# -- the store ------------------------------------------------------------------------------------------------------


def test_a_store_gives_back_what_was_put_there(fixed: Problem, grid: Family, tmp_path: Path) -> None:
    """Also reasons; nothing is solved again, and everything is proved anew."""
    over = {**GRID, "vehicle.thrust": [440.0, 1.0]}
    first = sweep(fixed, over, verify=1, store=tmp_path)
    lines: list[Any] = []
    again = sweep(fixed, over, verify=1, store=tmp_path, callback=lines.append)
    assert lines[0] == "6 of 6 members are in the store"
    assert lines[1:] == [f"stored members proved again: {n} of 3" for n in (1, 2, 3)]
    assert again.notes == ()
    for one, other in zip(first.points, again.points, strict=True):
        assert (one.values, one.outcome, one.message) == (other.values, other.outcome, other.message)
    here, there = first.points[0].solution, again.points[0].solution
    assert here is not None and there is not None
    assert there.verification.source == "the problem's own Python functions"
    assert [vars(c) for c in there.verification.checks] == [vars(c) for c in here.verification.checks]
    assert there.trajectories[0].state == here.trajectories[0].state
    assert there.problem == here.problem
    assert verify(there, 3).outcome is Outcome.PROVED


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"over": {"vehicle.thrust": [440.0]}}, "members"),
        ({"verify": 2}, "level"),
        ({"method": Pseudospectral(nodes=20)}, "method"),
        ({"given": {"orbit_perilune_altitude": 14e3}}, "problem"),
    ],
)
def test_a_store_of_another_sweep_is_refused(
    fixed: Problem, tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    sweep(fixed, {"vehicle.thrust": [440.0, 450.0]}, store=tmp_path)
    problem = fixed.with_given(**changes.get("given", {}))
    options = {name: changes[name] for name in ("verify", "method") if name in changes}
    with pytest.raises(PeriluneError, match=rf"cannot be used(.|\n)*sweep that differs in its {words}"):
        sweep(problem, changes.get("over", {"vehicle.thrust": [440.0, 450.0]}), store=tmp_path, **options)


def test_a_full_disk_is_said_and_loses_no_member(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put, left = os.replace, iter([True, True, True, False])  # the record, and both files of the first member

    def replaced(*arguments: Any) -> None:
        if not next(left):
            raise OSError(errno.ENOSPC, "No space left on device")
        put(*arguments)

    with monkeypatch.context() as patched:
        patched.setattr("perilune.families.store_directory.os.replace", replaced)
        with pytest.raises(PeriluneError, match=r"000001 .* cannot be stored(.|\n)*No space left(.|\n)*free space"):
            sweep(meditch(), {"h": [1.0, 1.1]}, store=tmp_path)
    assert sorted(file.name for file in tmp_path.glob("0*.json")) == ["000000.json"]
    assert all(point.solution for point in sweep(meditch(), {"h": [1.0, 1.1]}, store=tmp_path).points)


def test_a_store_of_other_ranges_is_refused(tmp_path: Path) -> None:
    """What a parameter may be decides on the answer: at a bound it is another."""
    wide = meditch()
    sweep(wide, {"h": [1.0]}, store=tmp_path)
    (t_f,) = wide.free
    with pytest.raises(PeriluneError, match=r"sweep that differs in its problem"):
        sweep(replace(wide, free=(replace(t_f, upper=1.4),)), {"h": [1.0]}, store=tmp_path)
    assert len(sweep(meditch(), {"h": [1.0]}, store=tmp_path).points) == 1


def test_the_problems_own_value_does_not_matter_to_the_store(fixed: Problem, tmp_path: Path) -> None:
    sweep(fixed, {"vehicle.thrust": [440.0]}, store=tmp_path)
    lines: list[Any] = []
    sweep(fixed.with_given(vehicle_thrust=470.0), {"vehicle.thrust": [440.0]}, store=tmp_path, callback=lines.append)
    assert lines == ["1 of 1 members are in the store"]


def test_a_foreign_directory_is_left_alone(fixed: Problem, tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(PeriluneError, match="no sweep"):
        sweep(fixed, {"vehicle.thrust": [440.0]}, store=tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["letter.txt"]


def test_a_damaged_record_of_a_sweep_is_refused(fixed: Problem, tmp_path: Path) -> None:
    sweep(fixed, {"vehicle.thrust": [440.0]}, store=tmp_path)
    (tmp_path / "sweep.json").write_bytes(b"\xff")
    with pytest.raises(PeriluneError, match="cannot be used"):
        sweep(fixed, {"vehicle.thrust": [440.0]}, store=tmp_path)


@pytest.mark.parametrize("level", [0, 1])
@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("000000.json", b"{"),
        ("000000.json", b"[]"),
        ("000000.json", b"[" * 100_000),
        ("000000.json", b'{"values": [NaN]}'),
        ("000000.json", b'{"values": [440.0], "values": [440.0]}'),
        ("000000.json", b'{"values": [440.0], "message": "", "failure": "PROVED", "solution": 3}'),
        ("000000.json", b'{"values": [440.0], "message": "", "failure": "PROVED", "solution": null}'),
        ("000000.json", b'{"values": [3.0], "message": "", "failure": "PROVED", "solution": null}'),
        ("000000.npz", pickle.dumps({"0.state.time": 1})),
        ("000000.npz", b""),
        ("000000.npz", b"PK"),
        ("000000.npz", b"\x93NUMPY\x01\x00"),
    ],
)
def test_a_damaged_member_is_solved_again(
    fixed: Problem, tmp_path: Path, file: str, content: bytes, level: int
) -> None:
    """With a note, and afterwards it is there."""
    first = sweep(fixed, {"vehicle.thrust": [440.0]}, verify=level, store=tmp_path)
    (tmp_path / file).write_bytes(content)
    again = sweep(fixed, {"vehicle.thrust": [440.0]}, verify=level, store=tmp_path)
    assert objectives(again) == objectives(first)
    (note,) = again.notes
    assert note.startswith("stored member 000000 cannot be used") and note.endswith("is solved again")
    assert sweep(fixed, {"vehicle.thrust": [440.0]}, verify=level, store=tmp_path).notes == ()


def test_missing_curves_are_solved_again(fixed: Problem, tmp_path: Path) -> None:
    sweep(fixed, {"vehicle.thrust": [440.0]}, store=tmp_path)
    (tmp_path / "000000.npz").unlink()
    assert len(sweep(fixed, {"vehicle.thrust": [440.0]}, store=tmp_path).notes) == 1


TWO = {"vehicle.thrust": [440.0, 500.0]}


def test_members_that_changed_places_are_solved_again(fixed: Problem, tmp_path: Path) -> None:
    """One that could not be solved, under the number of another: it says for which values it was tried."""
    first = sweep(fixed, TWO, verify=0, store=tmp_path)
    failed = {"values": [500.0], "message": "no flight", "failure": "NOT_CONVERGED", "solution": None}
    (tmp_path / "000000.json").write_text(json.dumps(failed))
    again = sweep(fixed, TWO, verify=0, store=tmp_path)
    assert objectives(again) == objectives(first)
    (note,) = again.notes
    assert "stored member 000000 cannot be used" in note and "values; got [500.0]" in note


def falsified(store: Path, change: Any) -> None:
    """The first member of a store, changed."""
    file = store / "000000.json"
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))


@pytest.mark.parametrize("workers", [False, True])
@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["solution"]["objective"].update(value=-999.0),
        lambda d: d["solution"].update(objective={"value": -999.0}, extremals=[]),
        lambda d: d["solution"]["free"]["flight_time"].update(value=999.0),
        lambda d: d["solution"]["free"]["flight_time"].update(value=1005.36),
        lambda d: d["solution"].pop("free"),
    ],
)
def test_an_edited_member_is_solved_again(fixed: Problem, tmp_path: Path, change: Any, workers: bool) -> None:
    """Never PROVED with a number of the file."""
    first = sweep(fixed, TWO, verify=1, store=tmp_path)
    falsified(tmp_path, change)
    with ThreadPoolExecutor(1) as pool:
        again = sweep(fixed, TWO, verify=1, store=tmp_path, executor=pool if workers else None)
    assert len(again.notes) == 1 and "stored member 000000" in again.notes[0]
    assert objectives(again) == objectives(first)
    assert {p.outcome for p in again.points} == {Outcome.PROVED}


def test_curves_of_another_member_are_solved_again(fixed: Problem, tmp_path: Path) -> None:
    """Member by member everything is as written, and yet it is not the answer."""
    first = sweep(fixed, TWO, verify=1, store=tmp_path)
    one, other = (tmp_path / f"00000{i}.npz" for i in range(2))
    content = one.read_bytes(), other.read_bytes()
    one.write_bytes(content[1])
    other.write_bytes(content[0])
    again = sweep(fixed, TWO, verify=1, store=tmp_path)
    assert len(again.notes) == 2
    assert objectives(again) == objectives(first)


def test_what_a_member_says_of_itself_counts_for_nothing(fixed: Problem, tmp_path: Path) -> None:
    """Outcome, checks, a failure beside a solution: the proof of this run stands in their place."""
    first = sweep(fixed, TWO, verify=1, store=tmp_path)
    document = json.loads((tmp_path / "000000.json").read_text())
    assert "failure" not in document

    def change(document: dict[str, Any]) -> None:
        document["failure"] = "NOT_CONVERGED"
        document["solution"]["outcome"]["name"] = "NOT_PROVED"
        document["solution"]["verification"] = {"level": 4, "text": "nobody", "checks": []}
        document["solution"]["extremals"][0]["nature"] = "locally worst"
        document["solution"]["results"]["landed_mass"]["value"] = 999.0

    falsified(tmp_path, change)
    again = sweep(fixed, TWO, verify=1, store=tmp_path)
    assert again.notes == ()
    here, there = first.points[0].solution, again.points[0].solution
    assert here is not None and there is not None
    assert there.verification == here.verification
    assert there.results == here.results and there.extremals == ()
    assert "NOT_CONVERGED" not in family_csv(again)


def test_what_was_not_proved_is_marked_as_stored(fixed: Problem, tmp_path: Path) -> None:
    """At level 0, and where a member was not found: both are the file's word. What physics refuses is refused anew."""
    family = sweep(fixed, TWO, store=tmp_path / "zero")
    falsified(tmp_path / "zero", lambda d: d["solution"]["outcome"].update(name="PROVED"))
    again = sweep(fixed, TWO, store=tmp_path / "zero")
    assert {p.outcome for p in again.points} == {Outcome.SOLVED}
    assert [p.message for p in (*family.points, *again.points)] == ["", "", "as stored", "as stored"]
    sweep(fixed, TWO, verify=1, store=tmp_path / "one")
    message = "the Moon is closed"
    (tmp_path / "one" / "000000.json").write_text(
        json.dumps({"values": [440.0], "message": message, "failure": "INFEASIBLE", "solution": None})
    )
    claimed = sweep(fixed, TWO, verify=1, store=tmp_path / "one").points[0]
    assert (claimed.outcome, claimed.message) == (Outcome.INFEASIBLE, f"as stored: {message}")
    weak = {"vehicle.thrust": [1.0]}
    sweep(fixed, weak, verify=1, store=tmp_path / "weak")
    falsified(tmp_path / "weak", lambda d: d.update(message=message))
    assert "too weak" in sweep(fixed, weak, verify=1, store=tmp_path / "weak").points[0].message


@pytest.mark.parametrize("failure", [None, Outcome.PROVED, Outcome.SOLVED])
def test_a_member_without_a_solution_has_a_reason(failure: Outcome | None) -> None:
    with pytest.raises(PeriluneError, match="a solution or a reason"):
        FamilyPoint(values=(1.0,), solution=None, failure=failure)


def test_a_solved_member_has_no_failure(grid: Family) -> None:
    with pytest.raises(PeriluneError, match="a solution or a reason"):
        replace(grid.points[0], failure=Outcome.NOT_CONVERGED)


COUNTED = """
import sys, time
from pathlib import Path
from cho import cho_landing
from perilune.families.sweep import sweep

store, log = map(Path, sys.argv[1:3])

def watch(event):
    if " of 6)" in str(event):
        with log.open("a") as file:
            print(event, file=file, flush=True)
    if "(4 of 6)" in str(event) and sys.argv[3] == "wait":
        time.sleep(600)

fixed = cho_landing().with_given(retro_delta_v=0.0)
over = {"vehicle.thrust": [440.0, 500.0], "vehicle.mass": [290.0, 300.0, 310.0]}
sweep(fixed, over, verify=1, store=store, callback=watch)
"""


def test_a_killed_sweep_goes_on_without_repeating_anything(grid: Family, tmp_path: Path) -> None:
    """SIGKILL at the fourth of six, then the same program: that one is begun again, and no other."""
    store, log = tmp_path / "store", tmp_path / "log"
    command = [sys.executable, "-c", COUNTED, str(store), str(log)]
    killed = subprocess.Popen([*command, "wait"], cwd=Path(__file__).parents[1])
    deadline = time.monotonic() + 120
    while not (log.exists() and "(4 of 6)" in log.read_text()):
        assert killed.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    killed.send_signal(signal.SIGKILL)
    assert killed.wait() == -signal.SIGKILL
    assert sorted(p.name for p in store.glob("00*.json")) == ["000000.json", "000001.json", "000002.json"]
    stamps = {p.name: p.stat().st_mtime_ns for p in store.iterdir()}
    subprocess.run([*command, "go"], cwd=Path(__file__).parents[1], check=True)
    begun = [line.split("(")[1] for line in log.read_text().splitlines()]
    assert begun == [f"{n} of 6)" for n in (1, 2, 3, 4, 4, 5, 6)]
    assert {name: (store / name).stat().st_mtime_ns for name in stamps} == stamps
    assert not list(store.glob(".writing-*"))
    resumed = sweep(cho_landing().with_given(retro_delta_v=0.0), GRID, verify=1, store=store)
    assert objectives(resumed) == objectives(grid)
    for one, other in zip(resumed.points, grid.points, strict=True):
        assert one.solution is not None and other.solution is not None
        assert one.solution.trajectories[0] == other.solution.trajectories[0]
        assert dict(one.solution.free) == dict(other.solution.free)
        assert one.outcome is other.outcome


# -- the command line -----------------------------------------------------------------------------------------------


def test_a_grid_from_the_command_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Two keys; stopped in the middle by nothing, but begun again it computes nothing."""
    out = tmp_path / "out"
    vary = ["--vary", "vehicle.thrust=440:460:20 N", "--vary", "vehicle.mass=290:300:10 kg"]
    arguments = ["sweep", EXAMPLE, *vary, "--out", str(out), "--json"]
    assert run_command_line(arguments) == 0
    document = read_json(capsys.readouterr().out)
    assert document["parameters"] == [{"name": "vehicle_thrust", "unit": "N"}, {"name": "vehicle_mass", "unit": "kg"}]
    assert [p["values"] for p in document["points"]] == [[440.0, 290.0], [440.0, 300.0], [460.0, 290.0], [460.0, 300.0]]
    assert (out / "family.csv").read_text().startswith("vehicle_thrust [N],vehicle_mass [kg],landed_mass [kg]")
    stamps = {p.name: p.stat().st_mtime_ns for p in (out / "members").iterdir()}
    assert run_command_line([*arguments, "--resume"]) == 0
    assert read_json(capsys.readouterr().out)["points"][3]["outcome"] == "PROVED"
    assert {p.name: p.stat().st_mtime_ns for p in (out / "members").iterdir()} == stamps
    falsified(out / "members", lambda d: d["solution"].update(objective={"value": -999.0}, extremals=[]))
    assert run_command_line([*arguments, "--resume"]) == 0
    said = capsys.readouterr()
    assert "perilune: stored member 000000 does not prove and is solved again" in said.err
    assert read_json(said.out)["notes"] == ["stored member 000000 does not prove and is solved again"]
    assert run_command_line(arguments) == 2  # the directory is not empty
    assert run_command_line([*arguments, "--force"]) == 0
    assert {p.name: p.stat().st_mtime_ns for p in (out / "members").iterdir()} != stamps


def test_workers_from_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["sweep", EXAMPLE, "--vary", "vehicle.thrust=440:460:20 N", "--json", "--level", "1"]
    assert run_command_line([*arguments, "--workers", "2"]) == 0
    found = read_json(capsys.readouterr().out)
    assert [p["outcome"] for p in found["points"]] == ["PROVED", "PROVED"]


def test_resuming_needs_a_directory(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["sweep", EXAMPLE, "--vary", "vehicle.thrust=440:460:20 N", "--resume", "--json"]) == 2
    assert "--out DIR" in json.dumps(read_json(capsys.readouterr().out))
