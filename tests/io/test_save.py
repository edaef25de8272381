"""Saved and loaded: a solution of any problem is proved again from its file alone; the file is not trusted."""

from __future__ import annotations

import json
import re
import runpy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from command_line import read_json
from perilune import Pseudospectral
from perilune.cli import run_command_line
from perilune.core import Outcome, PeriluneError
from perilune.io.model_records import model_document, read_model
from perilune.io.problem_json import physics_document, read_physics
from perilune.problem import Problem, Solution, Verification
from perilune.report.summary import solution_summary
from perilune.scenario import load_file, load_text
from perilune.solve import solve
from perilune.verify import verify

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def hop() -> Solution:
    """The problem of the documentation, which is made of lambdas."""
    return runpy.run_path(str(EXAMPLES / "own_problem.py"))["exact"]


def edited(directory: Path, change: Callable[[dict[str, Any]], Any]) -> Path:
    file = directory / "solution.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    change(document)
    file.write_text(json.dumps(document), encoding="utf-8")
    return directory


def test_the_papers_landing_proves_again(hybrid: Solution, tmp_path: Path) -> None:
    """Without a scenario, and as a file of before models were saved: the expressions are flown, and level 3 holds."""
    pl.save(hybrid, tmp_path / "landing")
    edited(tmp_path / "landing", lambda document: document.pop("model"))
    back = pl.load(tmp_path / "landing")
    assert back.problem == hybrid.problem
    assert back.outcome is Outcome.SOLVED and back.verification.level == 0
    np.testing.assert_array_equal(back.trajectories[0].state.values, hybrid.trajectories[0].state.values)
    assert back.results == hybrid.results
    proved = verify(back, 3)
    assert proved.outcome is Outcome.PROVED
    assert proved.verification.source == "expressions from a file"


def test_what_a_file_says_of_its_proof_is_told_as_its_word(hybrid: Solution, tmp_path: Path) -> None:
    """A flight that was not proved does not come back as one that nobody has looked at."""
    first, *others = verify(hybrid, 1).verification.checks
    failed = Verification(checks=(replace(first, value=1.0), *others))
    pl.save(replace(hybrid, outcome=Outcome.NOT_PROVED, verification=failed), tmp_path)
    back, count = pl.load(tmp_path), len(others) + 1
    words = f"not verified again; its file claims level 0: unverified, NOT_PROVED: 1 of {count} checks failed"
    assert back.verification.level == 0 and not back.verification.passed
    assert all(words in said for said in (repr(back), back._repr_html_(), solution_summary(back)))
    proved = verify(back, 1).verification
    assert proved.title == "level 1: feasible"
    pl.save(replace(back, verification=Verification()), tmp_path, force=True)
    assert pl.load(tmp_path).verification.title == "level 0: unverified"  # nothing was claimed


def test_a_models_problem_is_made_again(hybrid: Solution, tmp_path: Path) -> None:
    """With what is not a formula: ranges, preflight, and the bookkeeping that the proof looks at."""
    pl.save(hybrid, tmp_path / "landing")
    problem = pl.load(tmp_path / "landing").problem
    assert problem == hybrid.problem and problem.title == hybrid.problem.title
    assert problem.consistency_checks is not None and problem.source == "the problem's own Python functions"
    assert [f.name for f in pl.preflight(problem)] == [f.name for f in pl.preflight(hybrid.problem)]
    checks = [{c.name for c in verify(s, 1).verification.checks} for s in (pl.load(tmp_path / "landing"), hybrid)]
    assert checks[1] >= {"rocket_equation", "propellant", "retro_mass"}
    assert checks[0] == checks[1]
    with pytest.raises(PeriluneError, match=r"vehicle\.thrust"):
        problem.with_given(vehicle_thrust=-1.0)
    assert problem.with_given(vehicle_thrust=500.0).free != problem.free  # its ranges follow


@pytest.mark.parametrize(
    ("example", "change"),
    [
        ("hybrid_lander", ()),
        ("ordinary_lander", ()),
        ("polar_descent", ()),
        ("polar_descent", ("problem.coordinates=spherical",)),
        ("polar_descent", ("start.longest_coast=200 s",)),
        ("precision_landing", ()),
    ],
)
def test_every_kind_is_made_again(example: str, change: tuple[str, ...]) -> None:
    """With other given values and fewer free parameters too, through JSON."""
    problem = load_file(EXAMPLES / f"{example}.toml", change).problem
    heavier = problem.with_given(vehicle_mass=1.01 * problem.given["vehicle_mass"].value)
    for one in (problem, heavier, problem.with_given(**{problem.free_names[0]: problem.free[0].guess})):
        made = model_document(one)
        assert made is not None
        again = read_model(json.loads(json.dumps(made)), one.given)
        assert again == one and again.preflight is not None


def test_what_no_model_makes_is_saved_as_expressions(hybrid: Solution, hop: Solution) -> None:
    """A model's problem that was changed, and one that only has the name of a kind."""
    assert model_document(replace(hybrid.problem, objective=lambda x, p, xp: -2.0 * x.m)) is None
    assert model_document(replace(hybrid.problem, scales=pl.Scales(mass=7.0))) is None
    assert model_document(replace(hop.problem, name="hybrid_landing")) is None
    assert model_document(replace(hop.problem, name="hybrid_landing", records=hybrid.problem.records)) is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda made: made.update(kind="powered_descent"), "model.sections"),
        (lambda made: made["sections"].update(extra={}), "model.sections.extra"),
        (lambda made: made["sections"]["vehicle"].update(wings=2.0), "vehicle.wings"),
        (lambda made: made["sections"]["vehicle"].pop("mass"), "vehicle.mass"),
        (lambda made: made["sections"]["vehicle"].update(mass="300 kg"), "vehicle.mass"),
        (lambda made: made["sections"]["vehicle"].update(mass=-300.0), "vehicle.mass"),
        (lambda made: made["sections"].update(vehicle=[1.0]), "model.sections.vehicle"),
        (lambda made: made["sections"].pop("orbit"), "orbit"),
        (lambda made: made["sections"]["vehicle"].update(mass=310.0), "the model in the saved solution and its"),
        (lambda made: made["sections"].pop("retro"), "the model in the saved solution and its"),
    ],
)  # fmt: skip
def test_a_tampered_model_is_refused(
    change: Callable[[dict[str, Any]], Any], said: str, hybrid: Solution, tmp_path: Path
) -> None:
    pl.save(hybrid, tmp_path / "landing")
    edited(tmp_path / "landing", lambda document: change(document["model"]))
    with pytest.raises(PeriluneError, match=re.escape(said)):
        pl.load(tmp_path / "landing")


def test_where_no_package_brings_the_kind_the_expressions_are_the_problem(hybrid: Solution, tmp_path: Path) -> None:
    """As of a file without a model: it is proved again, and what is not a formula, such as ranges, is not there."""
    pl.save(hybrid, tmp_path / "landing")
    edited(tmp_path / "landing", lambda document: document["model"].update(kind="own"))
    loaded = pl.load(tmp_path / "landing")
    assert not loaded.problem.records and loaded.problem.form == hybrid.problem.form
    assert pl.verify(loaded, level=1).verification.level == 1


def test_another_choice_of_the_model_is_refused(tmp_path: Path) -> None:
    """The digest is another: what was solved aims at the site."""
    problem = load_file(EXAMPLES / "polar_descent.toml").problem
    made = model_document(problem)
    assert made is not None and made["sections"]["problem"]["target"] == "site"
    made["sections"]["problem"]["target"] = "anywhere"
    assert read_model(made, problem.given).form != problem.form


def test_an_own_problem_proves_again(hop: Solution, tmp_path: Path) -> None:
    """Two controls, a throttle that switches, functions without a name."""
    pl.save(hop, tmp_path / "hop")
    back = pl.load(tmp_path / "hop")
    assert back.problem == hop.problem
    proved = verify(back, 3)
    assert proved.outcome is Outcome.PROVED, str(proved.verification)
    found, first = ({c.name for c in s.verification.checks} for s in (proved, hop))
    assert found == first


def test_the_command_line_verifies_what_python_saved(
    hop: Solution, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And says which text it flew."""
    pl.save(hop, tmp_path / "hop")
    assert run_command_line(["verify", str(tmp_path / "hop")]) == 0
    assert "flown: expressions from a file" in capsys.readouterr().out
    assert run_command_line(["verify", str(tmp_path / "hop"), "--json"]) == 0
    assert read_json(capsys.readouterr().out)["verification"]["source"] == "expressions from a file"


def test_several_phases_and_links_come_back(tmp_path: Path) -> None:
    from problems.staging import staged_burns

    solution = solve(staged_burns(), Pseudospectral(), verify=0)
    pl.save(solution, tmp_path / "two")
    assert pl.load(tmp_path / "two").problem == solution.problem


def test_a_loaded_problem_is_solved_as_the_first(hop: Solution, tmp_path: Path) -> None:
    """Its parameters vary as ever."""
    pl.save(hop, tmp_path / "hop")
    farther = pl.load(tmp_path / "hop").problem.with_given(distance=2500.0)
    here, there = (solve(p, verify=0) for p in (hop.problem.with_given(distance=2500.0), farther))
    assert here.objective == there.objective


def test_no_file_is_overwritten(hop: Solution, tmp_path: Path) -> None:
    pl.save(hop, tmp_path / "hop")
    with pytest.raises(PeriluneError, match="not empty"):
        pl.save(hop, tmp_path / "hop")
    pl.save(hop, tmp_path / "hop", force=True)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Solution]:
    """A landing saved with its scenario."""
    stated = load_file(EXAMPLES / "ordinary_lander.toml")
    solution = solve(stated.problem, verify=0)
    pl.save(solution, tmp_path_factory.mktemp("scenario") / "out", stated.text)
    return tmp_path_factory.getbasetemp(), solution


@pytest.fixture
def saved(scenario: tuple[Path, Solution], tmp_path: Path) -> Path:
    solution = scenario[1]
    pl.save(solution, tmp_path / "s", load_file(EXAMPLES / "ordinary_lander.toml").text)
    return tmp_path / "s"


def test_with_a_scenario_the_models_own_text_is_flown(saved: Path) -> None:
    proved = verify(pl.load(saved), 1)
    assert proved.verification.source == "the problem's own Python functions"
    assert "propellant" in {c.name for c in proved.verification.checks}  # the model's bookkeeping


def test_a_file_of_the_first_version_still_loads(saved: Path) -> None:
    """Which had nothing of the problem but its scenario."""

    def older(document: dict[str, Any]) -> None:
        document["format"]["version"] = 1
        document["problem"] = {name: document["problem"][name] for name in ("name", "title")}

    assert verify(pl.load(edited(saved, older)), 1).outcome is Outcome.PROVED


def test_scenario_and_expressions_must_agree(saved: Path) -> None:
    """Numbers that the scenario does not give, or physics that it does not have."""

    def heavier(document: dict[str, Any]) -> None:
        document["problem"]["scales"]["mass"] = 2.0

    with pytest.raises(PeriluneError, match="state different problems"):
        pl.load(edited(saved, heavier))


def test_another_physics_under_the_same_scenario_is_refused(saved: Path, hop: Solution, tmp_path: Path) -> None:
    pl.save(hop, tmp_path / "hop")
    other = json.loads((tmp_path / "hop" / "solution.json").read_text(encoding="utf-8"))

    def foreign(document: dict[str, Any]) -> None:
        document["problem"]["functions"]["0.outputs"]["outputs"].reverse()
        document["problem"]["digest"] = other["problem"]["digest"]

    with pytest.raises(PeriluneError):
        pl.load(edited(saved, foreign))


def problem_of(document: dict[str, Any]) -> dict[str, Any]:
    return document["problem"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["problem"].pop("functions"), "functions"),
        (lambda d: d["problem"]["functions"].pop("start"), "functions.start"),
        (lambda d: d["problem"]["functions"].pop("0.dynamics"), "dynamics of hop is missing"),
        (lambda d: d["problem"]["functions"].pop("0.end"), "functions.0.end"),
        (lambda d: d["problem"]["functions"]["0.dynamics"]["outputs"].pop(), "wrong number of values"),
        (lambda d: d["problem"]["functions"]["0.dynamics"]["instructions"].insert(0, ["exec", 0]), "cannot be read"),
        (lambda d: d["problem"]["functions"]["start"]["instructions"].append(["x", "m"]), "cannot be read"),
        (lambda d: d["problem"].update(digest="0" * 64), "problem.digest"),
        (lambda d: d["problem"].update(title=5), "title"),
        (lambda d: d["problem"]["phases"][0].update(name="../../etc"), "letters, digits"),
        (lambda d: d["problem"]["phases"][0]["controls"][0].update(kind="lambda"), "a control of kind"),
        (lambda d: d["problem"]["phases"][0]["states"][0].update(lower=True), "a number"),
        (lambda d: d["problem"]["phases"][0]["states"][0].update(colour="red"), "an unknown field"),
        (lambda d: d["problem"]["phases"][0]["states"][0].pop("name"), "nothing"),
        (lambda d: d["problem"]["phases"][0]["states"][0].update(unit="furlong"), "not a unit"),
        (lambda d: d["problem"].update(views={"label": "{mass:999999999}"}), "views.label"),
        (lambda d: d["problem"].update(views={"histories": [{"name": "/tmp/x", "quantities": []}]}), "histories"),
        (lambda d: d["problem"].update(scales={"length": None}), "a number"),
        (lambda d: d["problem"].update(scales={"length": 0.0}), "scale"),
        (lambda d: d["problem"].update(free=[]), "."),
        (lambda d: d["given"]["g"].update(unit="km"), "numbers are in SI"),
        (lambda d: d["phases"][0]["state"]["values"][3].__setitem__(0, True), "phases[0].state.values"),
        (lambda d: d["phases"][0]["state"]["time"].__setitem__(0, False), "phases[0].state.time"),
        (lambda d: d["given"].pop("g"), "."),
        (lambda d: d["given"]["g"].update(value=None), "a number"),
        (lambda d: d["format"].update(version=99), "not a saved solution"),
        (lambda d: d["format"].update(version=1), "scenario"),
    ],
)
def test_an_altered_problem_is_refused(hop: Solution, tmp_path: Path, change: Any, words: str) -> None:
    """Each by a PeriluneError that names it."""
    pl.save(hop, tmp_path / "hop")
    with pytest.raises(PeriluneError, match=re.escape(words) if words != "." else words):
        pl.load(edited(tmp_path / "hop", change))


def test_what_was_changed_in_the_physics_fails_the_proof(hop: Solution, tmp_path: Path) -> None:
    """A file may state other physics consistently; then its trajectory is none of it."""
    pl.save(hop, tmp_path / "hop")

    def weaker(document: dict[str, Any]) -> None:
        document["given"]["g"]["value"] = 1.63

    assert verify(pl.load(edited(tmp_path / "hop", weaker)), 1).outcome is Outcome.NOT_PROVED


def test_scenarios_are_untouched_by_saving(scenario: tuple[Path, Solution]) -> None:
    stated = load_file(EXAMPLES / "ordinary_lander.toml")
    assert stated.text is not None and load_text(stated.text) == scenario[1].problem
    assert isinstance(scenario[1].problem, Problem)


def test_digests_hold_though_names_have_changed() -> None:
    """Atlases and sweeps are found by the digest of their problem: fields and functions have other names now."""
    hop = pl.Phase(
        name="hop",
        states=(pl.Variable(name="x", unit="m"),),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (u.u,),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.d,), there="m"),
        end_outputs=pl.Quantities(lambda x, p, xp: (x.x,), reached="m"),
        end_guess=lambda p, xp: (p.d,),
    )
    problem = pl.Problem(
        name="hop",
        phases=(hop,),
        start=lambda p, xp: (0 * p.d,),
        given={"d": pl.Parameter(value=1.0, unit="m")},
        free=(pl.FreeParameter(name="T", unit="s", lower=0.0, upper=9.0, guess=2.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
    )
    document = physics_document(problem)
    assert document["free"] == [{"name": "T", "unit": "s", "lower": 0.0, "upper": 9.0, "guess": 2.0}]
    assert document["phases"][0]["end_output_variables"] == [{"name": "reached", "unit": "m"}]
    assert {"0.end", "0.end_outputs", "0.end_guess"} <= set(document["functions"])
    # Of the same problem, by the version before the names were changed.
    assert problem.form.digest == "11d7ae7a7c41af18fc238ebe150b5919cb9edbc4c84fddf3ceffe9450ea15018"
    assert read_physics(json.loads(json.dumps(document)), problem.given) == problem
