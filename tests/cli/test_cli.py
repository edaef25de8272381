"""The command line: one document on stdout, everything else on stderr, the exit code that is written down."""

from __future__ import annotations

import csv
import importlib
import json
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import perilune as pl
from command_line import HYBRID, ORDINARY, ROOT, read_json, snapshot
from perilune import Family, FamilyPoint
from perilune.cli import options, run_command_line
from perilune.cli.arguments import parse_command_line
from perilune.core import InfeasibleError, Iteration, NotConvergedError, Outcome
from perilune.families.continuation import Continuation
from perilune.problem import LEVELS, Problem, Solution
from perilune.verify import verify


def answer_with(monkeypatch: pytest.MonkeyPatch, act: Callable[..., Solution]) -> None:
    """Put another solver in place of `perilune.solve`."""
    monkeypatch.setattr(pl, "solve", act)


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch, hybrid: Solution, ordinary: Solution) -> list[Problem]:
    """A solver that knows the two landings of the paper already; the list of what it was asked."""
    asked: list[Problem] = []

    def solve(problem: Problem, method: Any = None, *, callback: Any = None, **_: Any) -> Solution:
        asked.append(problem)
        if callback is not None:
            callback("rung: known")
            callback(Iteration(number=7, residual=1e-12, step=2e-3, damping=1.0))
        known = ordinary if "retro_delta_v" in problem.given else hybrid
        # The answer to a problem of the same numbers, so it is the answer to this one.
        assert {k: g.value for k, g in problem.given.items() if k in known.problem.given} == pytest.approx(
            {k: g.value for k, g in known.problem.given.items()}
        )
        return replace(known, problem=problem)

    answer_with(monkeypatch, solve)
    return asked


# --- refusals


@pytest.mark.parametrize(
    ("arguments", "code", "outcome"),
    [
        (["solve", HYBRID, "--set", "vehicle.mass=-300 kg"], 2, "REFUSED"),
        (["solve", HYBRID, "--set", "vehicle.thrst=1 N"], 2, "REFUSED"),
        (["solve", "none.toml"], 2, "REFUSED"),
        (["solve", HYBRID, "--level", "9"], 2, "REFUSED"),
        (["solve", HYBRID, "--no-such-option"], 2, "REFUSED"),
        (["solve"], 2, "REFUSED"),
        (["slve", HYBRID], 2, "REFUSED"),
        (["solve", HYBRID, "--set", "orbit.perilune_altitude=-1 km"], 3, "INFEASIBLE"),
        (["solve", HYBRID, "--set", "vehicle.thrust=4 N", "--set", "vehicle.dry_mass=30 kg"], 3, "INFEASIBLE"),
        (["check", HYBRID, "--set", "vehicle.thrust=4 N", "--set", "vehicle.dry_mass=30 kg"], 3, "INFEASIBLE"),
        (["solve", HYBRID, "--out", "flight.json"], 2, "REFUSED"),  # else a folder of that name
        (["sweep", HYBRID, "--vary", "vehicle.thrust=430:450:10 N", "--out", "family.PNG"], 2, "REFUSED"),
        (["atlas", "build", HYBRID, "--vary", "vehicle.thrust=430:450 N", "--out", "map.nc"], 2, "REFUSED"),
        (["sweep", HYBRID, "--vary", "vehicle.thrust=4 N"], 2, "REFUSED"),
        (["sweep", HYBRID, "--vary", "vehicle.thrust=1:4:1 N", "--set", "vehicle.dry_mass=30 kg"], 3, "INFEASIBLE"),
        (["sweep", HYBRID], 2, "REFUSED"),
        (["sweep", ORDINARY, "--vary", "retro.delta_v=0:100:50 m/s"], 2, "REFUSED"),
        (["sweep", HYBRID, "--vary", "body.rotation_rate=0:1.52504e-4:1.52504e-4 rad/s"], 2, "REFUSED"),
        (["new", "no/such/directory/x.toml"], 2, "REFUSED"),
        (["verify", "nowhere"], 2, "REFUSED"),
        (["reproduce", "nobody-1900", "--out", "x"], 2, "REFUSED"),
    ],
)
def test_a_refusal_has_its_code_and_its_parts(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    code: int,
    outcome: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command_line([*arguments, "--json"]) == code
    told = capsys.readouterr()
    document = read_json(told.out)
    assert document["outcome"] == outcome
    assert set(document["error"]) == {"what", "got", "expected", "try"} | ({"reason"} if code == 3 else set())
    assert document["error"]["what"] in told.err
    assert run_command_line(arguments) == code
    told = capsys.readouterr()
    assert told.out == "" or arguments[0] == "check"
    assert "Traceback" not in told.err
    assert list(tmp_path.iterdir()) == []


def test_every_level_of_the_library_may_be_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    assert options.THEOREM == LEVELS[-1]
    for words in (["solve", HYBRID], ["sweep", HYBRID, "--vary", "a=1:2:1 N"], ["verify", "there"]):
        assert parse_command_line([*words, "--level", str(LEVELS[-1])]).level == LEVELS[-1]
    for words in (["export", "there", "--out", "x.nc"], ["atlas", "query", "there"]):
        for flag in ("--verify", "--prove"):  # the name of it until the next minor version
            assert parse_command_line([*words, flag, str(LEVELS[-1])]).verify == LEVELS[-1]
            said = "warning: --prove is --verify now; the old name goes with the next minor version\n"
            assert capsys.readouterr().err == (said if flag == "--prove" else "")
        assert parse_command_line(words).verify == 0


def test_no_command_shows_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line([]) == 2
    assert "Commands:" in capsys.readouterr().err


def test_a_solve_that_fails_says_and_saves_what_was_tried(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fails(problem: Problem, method: Any, *, callback: Any, **_: Any) -> Solution:
        callback("rung: one")
        raise NotConvergedError(
            "no solution was found",
            got="touchdown_altitude 12 m",
            advice="raise vehicle.thrust",
            partial={"residuals": {"touchdown_altitude": 12.0, "worst": float("nan")}, "attempts": ["one"]},
        )

    answer_with(monkeypatch, fails)
    out = tmp_path / "out"
    assert run_command_line(["solve", HYBRID, "--out", str(out), "--json"]) == 4
    told = capsys.readouterr()
    document = read_json(told.out)
    assert document["outcome"] == "NOT_CONVERGED"
    assert document["partial"]["residuals"] == {"touchdown_altitude": 12.0, "worst": None}
    assert "touchdown_altitude 12 m" in told.err
    kept = read_json((out / "failure.json").read_text(encoding="utf-8"))
    assert kept["log"] == ["rung: one"]
    assert kept["partial"] == document["partial"]
    assert kept["scenario"]["text"] == Path(HYBRID).read_text(encoding="utf-8")
    assert snapshot(tmp_path).keys() == {"out/failure.json"}


@pytest.mark.parametrize(
    ("error", "code", "outcome"),
    [
        (InfeasibleError("too weak"), 3, "INFEASIBLE"),
        (KeyboardInterrupt(), 130, "INTERRUPTED"),
        (OSError(28, "No space left on device"), 2, "REFUSED"),
        (ZeroDivisionError("oops"), 1, "FAULT"),
    ],
)
def test_whatever_happens_there_is_one_document(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    error: BaseException,
    code: int,
    outcome: str,
) -> None:
    def fails(*_: Any, **__: Any) -> Solution:
        raise error

    answer_with(monkeypatch, fails)
    assert run_command_line(["solve", HYBRID, "--json"]) == code
    told = capsys.readouterr()
    assert read_json(told.out)["outcome"] == outcome
    assert "Traceback" not in told.err


def test_a_used_directory_is_refused_before_the_work(
    capsys: pytest.CaptureFixture[str], solved: list[Problem], tmp_path: Path
) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert run_command_line(["solve", HYBRID, "--out", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert "--force" in told
    assert "warning" not in told
    assert not solved
    assert snapshot(tmp_path) == {"mine.txt": b"mine"}


# --- answers


def test_solve_says_its_answer_and_shows_every_iteration(
    capsys: pytest.CaptureFixture[str], solved: list[Problem]
) -> None:
    assert run_command_line(["solve", HYBRID, "--verbose"]) == Outcome.SOLVED.exit_code == 5
    told = capsys.readouterr()
    assert "160.618584 kg" in told.out
    assert "iteration   7  residual 1.000e-12  step 2.000e-03  damping 1" in told.err
    assert "residual" not in told.out
    assert len(solved) == 1


def test_checks_are_counted_unless_all_are_asked_for(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, hybrid: Solution
) -> None:
    proved = verify(hybrid, 1)
    answer_with(monkeypatch, lambda problem, method, **_: proved)
    assert run_command_line(["solve", HYBRID]) == 0
    count = len(proved.verification.checks)
    short = capsys.readouterr().out
    assert f"level 1, feasible:         {count} of {count} checks passed" in short
    assert not any(f"{check.name}: " in short for check in proved.verification.checks)
    assert run_command_line(["solve", HYBRID, "--verbose"]) == 0
    long = capsys.readouterr().out
    assert all(f"ok   1 {check.name}: " in long for check in proved.verification.checks)


def test_what_solve_writes_can_be_verified_again(
    capsys: pytest.CaptureFixture[str], solved: list[Problem], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run_command_line(["solve", ORDINARY, "--out", str(out), "--json", "--set", "vehicle.dry_mass=100 kg"])
    document = read_json(capsys.readouterr().out)
    files = snapshot(out)
    assert {"solution.json", "trajectory.csv", "report.md"} <= files.keys()
    assert {Path(name).suffix for name in files if name.startswith("figures")} == {".png", ".svg"}
    assert run_command_line(["verify", str(out), "--level", "1", "--json"]) == 0
    again = read_json(capsys.readouterr().out)
    assert again["outcome"] == "PROVED"
    assert again["results"] == document["results"]
    assert snapshot(out) == files

    saved = json.loads(files["solution.json"])
    saved["phases"][0]["control"]["values"] = [[-b, a] for a, b in saved["phases"][0]["control"]["values"]]
    (out / "solution.json").write_text(json.dumps(saved))
    assert run_command_line(["verify", str(out), "--level", "1", "--json"]) == 5
    assert read_json(capsys.readouterr().out)["outcome"] == "NOT_PROVED"


def test_a_landing_below_the_dry_mass_is_infeasible(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    # 160.62 kg land at best, more than the rocket equation alone forbids; what is left says nothing but the refusal.
    out = tmp_path / "out"
    arguments = ["solve", HYBRID, "--set", "vehicle.dry_mass=161 kg", "--out", str(out), "--json"]
    assert run_command_line(arguments) == 3
    document = read_json(capsys.readouterr().out)
    assert "mass (m) falls to 160.6" in document["error"]["got"]
    assert snapshot(out).keys() == {"failure.json"}
    assert "PROVED" not in (out / "failure.json").read_text(encoding="utf-8")


def test_what_cannot_be_flown_leaves_its_refusal(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    weak = ["--set", "vehicle.thrust=4 N", "--set", "vehicle.dry_mass=30 kg"]
    assert run_command_line(["solve", HYBRID, *weak, "--out", str(out), "--json"]) == 3
    error = read_json(capsys.readouterr().out)["error"]
    assert error["reason"] == "cannot be flown"
    assert snapshot(out).keys() == {"failure.json"}
    assert read_json((out / "failure.json").read_text(encoding="utf-8"))["error"] == error


def test_check_lists_its_comparisons(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["check", HYBRID, "--json"]) == 0
    document = read_json(capsys.readouterr().out)
    assert document["outcome"] == "POSSIBLE"
    verdicts = {f["name"]: f["verdict"] for f in document["findings"]}
    assert verdicts["thrust-to-weight ratio at ignition"] == "warning"
    assert set(verdicts.values()) == {"ok", "warning"}
    assert run_command_line(["check", HYBRID]) == 0
    told = capsys.readouterr().out
    assert "cannot hover" in told
    assert "at ignition: 0.903772 (at least 1)" in told
    assert "perilune altitude: 15 km (at most 347.628 km)" in told


def test_sweep_reports_what_is_impossible_and_goes_on(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, ordinary: Solution, tmp_path: Path
) -> None:
    def solve_one(_: Any, problem: Problem, *_watch: Any) -> Any:
        if problem.given["vehicle_thrust"].value < 440.0:
            raise NotConvergedError("did not\nconverge")
        return ordinary

    monkeypatch.setattr(Continuation, "solve", solve_one)
    out = tmp_path / "family"
    arguments = ["sweep", ORDINARY, "--vary", "vehicle.thrust=440:0.4:-219.8 N", "--out", str(out)]
    arguments += ["--set", "vehicle.dry_mass=30 kg"]
    assert run_command_line([*arguments, "--json"]) == 4
    document = read_json(capsys.readouterr().out)
    assert [p["value"] for p in document["points"]] == pytest.approx([440.0, 220.2, 0.4])
    assert "did not" in document["points"][1]["message"]
    assert "too weak" in document["points"][2]["message"]
    assert [p["outcome"] for p in document["points"]] == ["PROVED", "NOT_CONVERGED", "INFEASIBLE"]
    family = {name for name in snapshot(out) if not name.startswith("members")}
    assert family == {"family.csv", "family.json", "family.png", "family.svg"}
    assert run_command_line([*arguments, "--force"]) == 4
    assert capsys.readouterr().out == (out / "family.csv").read_text(encoding="utf-8")


def family_of(solution: Solution, *, interrupted: bool = False) -> Callable[..., Family]:
    """A sweep that answers every value with one solution, or is stopped after the first."""

    def sweep(problem: Problem, over: dict[str, list[float]], *, verify: int, callback: Any, **options: Any) -> Family:
        ((name, values),) = over.items()
        points = [FamilyPoint(values=(value,), solution=solution) for value in values]
        points = points[:1] if interrupted else points
        return Family(
            problem=problem, parameters=(name.replace(".", "_"),), points=tuple(points), interrupted=interrupted
        )

    return sweep


def test_a_stopped_sweep_says_how_far_it_came(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, ordinary: Solution, tmp_path: Path
) -> None:
    monkeypatch.setattr(pl, "sweep", family_of(ordinary, interrupted=True))
    out = tmp_path / "family"
    assert (
        run_command_line(["sweep", ORDINARY, "--vary", "vehicle.thrust=440:460:10 N", "--out", str(out), "--json"])
        == 130
    )
    told = capsys.readouterr()
    document = read_json(told.out)
    assert document["interrupted"] is True
    assert len(document["points"]) == 1
    assert "1 of 3 values" in told.err
    assert read_json((out / "family.json").read_text(encoding="utf-8")) == document


@pytest.mark.parametrize(
    ("file", "vary", "given"),
    [
        (HYBRID, "vehicle.dry_mass=50:100:50 kg", {"vehicle_dry_mass": 50.0}),
        # The section comes with its key, so that the burn is free as in a file that has it.
        (ORDINARY, "retro.specific_impulse=310:300:-10 s", {"retro_specific_impulse": 310.0}),
    ],
)
def test_a_sweep_may_bring_its_key_into_the_scenario(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    hybrid: Solution,
    file: str,
    vary: str,
    given: dict[str, float],
) -> None:
    monkeypatch.setattr(pl, "sweep", family_of(hybrid))
    families: list[Any] = []
    monkeypatch.setattr(
        importlib.import_module("perilune.report.family"), "family_csv", lambda family: families.append(family) or ""
    )
    assert run_command_line(["sweep", file, "--vary", vary, "--level", "0"]) == 0
    problem = families[0].problem
    assert problem.free_names == ("retro_delta_v", "flight_time")
    assert {name: problem.given[name].value for name in given} == given


def test_a_list_is_swept_in_its_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each value of it is tried as the file's own is, wherever it stands."""
    out = tmp_path / "family"
    assert (
        run_command_line(
            ["sweep", ORDINARY, "--vary", "vehicle.thrust=480, 0.44 kN, 460 N", "--level", "0", "--out", str(out)]
        )
        == 0
    )
    rows = list(csv.reader(capsys.readouterr().out.splitlines()))
    assert [float(row[0]) for row in rows[1:]] == [480.0, 440.0, 460.0]
    masses = [float(row[1]) for row in rows[1:]]
    assert masses[1] < masses[2] < masses[0] and (out / "family.png").is_file()
    assert run_command_line(["sweep", ORDINARY, "--vary", "vehicle.thrust=480,200000,440 N"]) == 2
    assert "more than a lander withstands" in capsys.readouterr().err


def test_a_real_sweep_through_the_jump(capsys: pytest.CaptureFixture[str]) -> None:
    # The retro burn stops paying at an impulsive Isp of 277.9 s: Cho et al. 2015 read about 280 s off their
    # Fig 10.
    assert (
        run_command_line(["sweep", HYBRID, "--vary", "retro.specific_impulse=278:277:-1 s", "--json", "--level", "1"])
        == 0
    )
    points = read_json(capsys.readouterr().out)["points"]
    assert [round(p["results"]["delta_v"]["value"]) for p in points] == [1087, 0]
    assert all(p["outcome"] == "PROVED" for p in points)


def test_new_writes_a_scenario_that_may_be_solved(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "mine.toml"
    assert run_command_line(["new", str(path)]) == 0
    assert run_command_line(["check", str(path)]) == 0
    path.write_text("mine")
    assert run_command_line(["new", str(path)]) == 2
    assert path.read_text() == "mine"
    assert run_command_line(["new", str(path), "--force"]) == 0
    written = path.read_text(encoding="utf-8")
    capsys.readouterr()
    assert run_command_line(["new"]) == 0
    assert capsys.readouterr().out == written
    assert run_command_line(["new", "hybrid_landing"]) == 0
    assert capsys.readouterr().out == written
    monkeypatch.chdir(tmp_path)
    assert run_command_line(["new", "hybrid_landing.toml"]) == 0 and Path("hybrid_landing.toml").exists()
    capsys.readouterr()
    assert (
        run_command_line(["new", "moon_walk"]) == 2 and not Path("moon_walk").exists()
    )  # a kind, and not the name of a file
    assert "no kind of this name" in capsys.readouterr().err


def test_new_hands_out_the_examples(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_command_line(["new", "examples", "--json"]) == 0
    files = read_json(capsys.readouterr().out)["files"]
    assert {"hybrid_lander.toml", "maps/build.py", "own_kind/hop.toml"} <= set(files)
    assert all((ROOT / "examples" / name).read_bytes() == (tmp_path / "examples" / name).read_bytes() for name in files)
    assert run_command_line(["check", "examples/hybrid_lander.toml"]) == 0
    (tmp_path / "examples/hybrid_lander.toml").write_text("mine")
    assert run_command_line(["new", "examples"]) == 2 and "the directory already exists" in capsys.readouterr().err
    assert (tmp_path / "examples/hybrid_lander.toml").read_text() == "mine"
    assert (
        run_command_line(["new", "examples", "--force"]) == 0
        and run_command_line(["check", "examples/hybrid_lander.toml"]) == 0
    )
    assert run_command_line(["new", "examples", "there"]) == 0 and Path("there/own_problem.py").is_file()


@pytest.mark.parametrize("kind", ["hybrid_landing", "powered_descent", "precision_landing"])
def test_new_knows_every_kind(kind: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    assert run_command_line(["new", kind, str(path)]) == 0
    assert run_command_line(["solve", str(path), "--level", "1", "--json"]) == 0
    document = read_json(capsys.readouterr().out.partition("\n")[2].partition("\n")[2])
    assert (document["problem"], document["outcome"]) == (kind, "PROVED")
    assert run_command_line(["new", "landing_on_paper", str(tmp_path / "other.toml")]) == 2
    assert not (tmp_path / "other.toml").exists()


def test_version_and_doctor(capsys: pytest.CaptureFixture[str]) -> None:
    from perilune import __version__

    assert run_command_line(["--version"]) == 0
    assert capsys.readouterr().out == f"perilune {__version__}\n"
    assert run_command_line(["doctor", "--json"]) == 0
    told = read_json(capsys.readouterr().out)
    assert {"python", "numpy", "casadi"} <= told["versions"].keys()
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert told["parts"].keys() == declared.keys() - {"docs", "test"}


def test_ctrl_c_before_the_work_has_begun(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("perilune.cli.commands"), "emit_answer", stopped)
    assert run_command_line(["solve", HYBRID, "--json"]) == 130
    assert read_json(capsys.readouterr().out)["outcome"] == "INTERRUPTED"


def test_a_misspelt_kind_is_no_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["new", "powerd_descent"]) == 2
    assert "powered_descent" in capsys.readouterr().err
