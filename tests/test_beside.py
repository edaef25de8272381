"""What is written beside a proof is proved too, or is not repeated: files falsified one number at a time."""

from __future__ import annotations

import json
import pickle
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import perilune as pl
from command_line import HYBRID, ORDINARY, read_json
from perilune.cli import run
from perilune.io.export import save
from perilune.io.reading import LONGEST_TEXT
from perilune.problem.extremal import Nature
from perilune.problem.solution import Curve, Solution, Trajectory
from perilune.proof.crossed import agreement
from perilune.proof.listed import found_again
from perilune.report import REPORT_FILE
from perilune.report.beside import proved_directory
from perilune.report.summary import solution_markdown, solution_summary
from perilune.scenario import load_file
from perilune.solve import prove, solve
from perilune.words.outcome import Outcome, PeriluneError

Change = Callable[[dict[str, Any]], Any]


def written(solution: Solution, directory: Path, text: str | None) -> Path:
    """As ``solve --out``, without the figures, which nobody compares."""
    save(solution, directory, text)
    (directory / REPORT_FILE).write_text(solution_markdown(solution, scenario_text=text or ""), encoding="utf-8")
    return directory


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The two landings of the paper, each in a directory."""
    place, found = tmp_path_factory.mktemp("answers"), {}
    for file in (HYBRID, ORDINARY):
        scenario = load_file(file)
        solution = solve(scenario.problem, level=1)
        found[Path(file).stem] = written(solution, place / Path(file).stem, scenario.text)
    return found


@pytest.fixture
def hybrid_dir(answers: dict[str, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(answers["hybrid_lander"], tmp_path / "hybrid"))


@pytest.fixture
def ordinary_dir(answers: dict[str, Path], tmp_path: Path) -> Path:
    return Path(shutil.copytree(answers["ordinary_lander"], tmp_path / "ordinary"))


def edited(directory: Path, change: Change) -> Path:
    file = directory / "solution.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    change(document)
    file.write_text(json.dumps(document), encoding="utf-8")
    return directory


def told(directory: Path, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[int, str]:
    """Exit code and all that is said."""
    code = run(["verify", str(directory), "--level", "1", *more])
    said = capsys.readouterr()
    return code, said.out + said.err


def natures(solution: Solution) -> list[Nature]:
    return [e.nature for e in solution.extremals]


# -- the list of extremals ------------------------------------------------------------------------------------------


def test_what_is_true_is_confirmed(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Each listed extremal is found again, to the last digit that is printed, and is what it was."""
    code, said = told(hybrid_dir, capsys, "--json")
    document = read_json(said)
    assert code == 0
    rows = [(round(e["landed_mass"], 6), round(e["delta_v"]), e["nature"]) for e in document["extremals"]]
    assert rows == [
        (160.618584, 1201, "best of the extremals found"),
        (154.541347, 0, "local optimum, at a bound"),
        (154.501974, 129, "locally worst"),
    ]
    assert document["claimed"] == ["method", "statistics"]
    assert {c["name"] for c in document["verification"]["checks"]} >= {"solution.json", "trajectory.csv", "report.md"}


def test_a_loaded_list_is_no_list_of_extremals(hybrid_dir: Path) -> None:
    """Until `prove` has found them again; `pl.verify` has no word for them."""
    loaded = pl.load(edited(hybrid_dir, lambda d: d["extremals"][1].update(objective=-999.0)))
    assert loaded.extremals == () and len(loaded.listed) == 3
    assert loaded.statistics.claimed
    proved = pl.prove(loaded, level=2)
    assert proved.outcome is Outcome.PROVED and proved.listed == ()
    assert [round(e.objective, 3) for e in proved.extremals] == [-160.619, -154.502]
    (note,) = proved.verification.notes
    assert note == "1 of the 3 extremals that the file lists is not confirmed, and left out"


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["extremals"][1].update(objective=-999.0),
        lambda d: d["extremals"][2]["free"].update(retro_delta_v=999.0),
        lambda d: d["extremals"][1]["free"].update(flight_time=999.0),
        lambda d: d["extremals"][1]["free"].pop("flight_time"),
        lambda d: d["extremals"][1].update(unknowns=[1e300] * 10, objective=-999.0),
        lambda d: d["extremals"][1].update(unknowns=[0.0] * 3, objective=-999.0),
        lambda d: d["extremals"].append({**d["extremals"][1], "objective": -999.0}),
        lambda d: d["extremals"].append(d["extremals"][1]),  # the same twice is one
        lambda d: d.update(extremals=[d["extremals"][0], *d["extremals"][1:] * 400]),
    ],
)
def test_an_extremal_that_is_not_confirmed_is_left_out(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], change: Change
) -> None:
    """And the command says how many."""
    code, said = told(edited(hybrid_dir, change), capsys)
    assert code == 0
    assert "999" not in said
    assert re.search(r"note: \d+ of the \d+ extremals that the file lists (is|are) not confirmed, and left out", said)


@pytest.mark.parametrize("unknowns", [[1e300] * 10, [0.0] * 10, [0.0] * 3, []])
def test_of_a_solution_whose_unknowns_were_changed_the_curves_remain(hybrid_dir: Path, unknowns: list[float]) -> None:
    """They are a start and no more."""

    def change(document: dict[str, Any]) -> None:
        document["unknowns"] = unknowns

    proved = prove(pl.load(edited(hybrid_dir, change)), 3)
    assert proved.outcome is Outcome.PROVED
    assert natures(proved) in ([], [Nature.BEST, Nature.LOCAL_OPTIMUM_AT_BOUND, Nature.WORST])


def test_natures_follow_from_what_was_found(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def change(document: dict[str, Any]) -> None:
        words = ("locally worst", "best of the extremals found", "best of the extremals found, at a bound")
        for entry, word in zip(document["extremals"], words, strict=True):
            entry["nature"] = word

    found = prove(pl.load(edited(hybrid_dir, change)), 1)
    assert natures(found) == [Nature.BEST, Nature.LOCAL_OPTIMUM_AT_BOUND, Nature.WORST]
    assert told(hybrid_dir, capsys)[0] == 0


@pytest.mark.parametrize("word", ["locally worst", "best of the extremals found", "an extremal near the guess"])
def test_a_lone_extremal_is_called_what_it_is(
    ordinary_dir: Path, capsys: pytest.CaptureFixture[str], word: str
) -> None:
    """And of one alone there is no best."""
    code, said = told(edited(ordinary_dir, lambda d: d["extremals"][0].update(nature=word)), capsys)
    assert code == 0
    assert word not in said and "local optimum" in said


def test_the_best_may_be_left_out_of_a_list_but_is_not_invented(landing: Any, ordinary: Solution, hybrid: Solution,
                                                                tmp_path: Path) -> None:  # fmt: skip
    """A local optimum whose file claims to be the best of two is none; one that lists a better one says so."""
    lower = solve(landing, guess=ordinary, level=0)
    claims = replace(lower, extremals=(replace(hybrid.extremals[1], nature=Nature.BEST), hybrid.extremals[2]))
    save(claims, tmp_path / "without")
    beside_the_worst = prove(pl.load(tmp_path / "without"), 1)
    assert natures(beside_the_worst) == [Nature.LOCAL_OPTIMUM_AT_BOUND, Nature.WORST]
    alone = prove(pl.load(edited(tmp_path / "without", lambda d: d["extremals"].pop())), 1)
    assert natures(alone) == [Nature.LOCAL_OPTIMUM_AT_BOUND]
    save(replace(lower, extremals=(*lower.extremals, hybrid.extremals[0])), tmp_path / "with")
    beaten = prove(pl.load(tmp_path / "with"), 1)
    assert natures(beaten) == [Nature.LOCAL_OPTIMUM_AT_BOUND, Nature.LOCAL_OPTIMUM]
    assert any("a better extremal than this solution is known" in note for note in beaten.verification.notes)
    assert beaten.extremals[0].objective == lower.objective


def test_an_extremal_that_breaks_a_bound_is_not_confirmed(landing: Any, hybrid: Solution, tmp_path: Path) -> None:
    """Roots of the necessary conditions they are, but with less of a retro burn than the problem allows."""
    stricter = replace(landing, free=tuple(
        replace(f, lower=800.0) if f.name == "retro_delta_v" else f for f in landing.free
    ), ranges=None)  # fmt: skip
    solution = replace(solve(stricter, level=0), extremals=hybrid.extremals)
    save(solution, tmp_path / "s")
    proved = prove(pl.load(tmp_path / "s"), 1)
    assert len(proved.extremals) == 1
    assert "2 of the 3 extremals" in " ".join(proved.verification.notes)


def test_files_from_before_extremals_had_unknowns(hybrid_dir: Path) -> None:
    """What Newton reaches from the solution itself is confirmed; the rest is left out."""

    def change(document: dict[str, Any]) -> None:
        for entry in document["extremals"]:
            del entry["unknowns"]

    proved = prove(pl.load(edited(hybrid_dir, change)), 1)
    assert proved.outcome is Outcome.PROVED
    left = 3 - len(proved.extremals)
    assert natures(proved)[0] is (Nature.BEST if left < 2 else Nature.LOCAL_OPTIMUM)
    assert not left or f"{left} of the 3 extremals" in proved.verification.notes[0]


def reached(solution: Solution, *said: tuple[float, Nature]) -> tuple[Solution, Callable[..., Solution]]:
    """A solution whose file lists extremals of these objectives, and a Newton's method that reaches each of them."""
    entries = [
        replace(solution.extremals[0], objective=objective, nature=nature, unknowns=(float(k),))
        for k, (objective, nature) in enumerate(said)
    ]

    def resolve(problem: Any, guess: Solution) -> Solution:
        k = 0 if guess is listing else int(guess.unknowns[0])  # type: ignore[index]
        return replace(solution, extremals=(entries[k],))

    listing = replace(solution, extremals=(), listed=tuple(entries))
    return listing, resolve


def test_listed_extremals_stand_in_order_whatever_the_order_of_the_file(hybrid: Solution) -> None:
    """The solution itself, then the better before the worse, and last what is locally worst, however good its J."""
    itself = (hybrid.objective, Nature.LOCAL_OPTIMUM)
    others = [(-120.0, Nature.LOCAL_OPTIMUM), (-155.0, Nature.WORST), (-140.0, Nature.LOCAL_OPTIMUM_AT_BOUND),
              (-130.0, Nature.LOCAL_OPTIMUM), (-150.0, Nature.WORST)]  # fmt: skip
    extremals, notes = found_again(*reached(hybrid, itself, *others))
    assert [round(e.objective) for e in extremals] == [-161, -140, -130, -120, -155, -150]
    assert extremals[0].nature is Nature.BEST and notes == ()
    extremals, notes = found_again(*reached(hybrid, itself, *others, (-200.0, Nature.WORST)))
    assert extremals[0].nature is Nature.LOCAL_OPTIMUM and len(notes) == 1  # beside it something better still is near
    extremals, notes = found_again(*reached(hybrid, itself, (-200.0, Nature.LOCAL_OPTIMUM)))
    assert extremals[0].nature is Nature.LOCAL_OPTIMUM and len(notes) == 1


@pytest.mark.parametrize("which", ["state", "costate"])
def test_what_newton_reaches_is_proved_before_it_is_listed(hybrid: Solution, which: str) -> None:
    """An entry that is reached to the last digit, by a flight or costates that are wrong by a millionth."""
    itself, other = (hybrid.objective, Nature.LOCAL_OPTIMUM), (-150.0, Nature.LOCAL_OPTIMUM)
    listing, resolve = reached(hybrid, itself, other)
    assert len(found_again(listing, resolve)[0]) == 2
    (flown,) = hybrid.trajectories
    curve = getattr(flown, which)
    wrong = replace(flown, **{which: replace(curve, values=curve.values * (1 + 1e-6))})

    def misled(problem: Any, guess: Solution) -> Solution:
        return replace(resolve(problem, guess), trajectories=(wrong,))

    extremals, notes = found_again(listing, misled)
    assert len(extremals) == 1 and "1 of the 2 extremals" in notes[0]


# -- statistics, method, words --------------------------------------------------------------------------------------


def test_how_it_was_found_is_not_repeated(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def change(document: dict[str, Any]) -> None:
        document["statistics"].update(
            iterations=77777, rung="an oracle", wall_time=0.001, tried=["magic", "more magic"]
        )
        document["method"] = "clairvoyance"
        document["verification"] = {"level": 4, "text": "everything", "checks": []}
        document["outcome"] = {"name": "SOLVED", "advice": "land here"}

    code, said = told(edited(hybrid_dir, change), capsys)
    assert code == 0
    for word in ("77777", "oracle", "magic", "clairvoyance", "everything", "land here", "level 4"):
        assert word not in said
    document = read_json(told(hybrid_dir, capsys, "--json")[1])
    assert document["claimed"] == ["method", "statistics"]  # what is repeated is marked
    assert document["verification"]["level"] == 1


def test_a_claimed_mesh_error_opens_no_limit(hybrid: Solution) -> None:
    """Level 4 compares within the mesh error, which a file may not choose; nor which method is "another"."""
    import numpy as np

    from perilune.methods.pseudospectral import Pseudospectral

    told_error = replace(hybrid.statistics, residual=1e6, claimed=True)
    claimed = replace(hybrid, method="pseudospectral", statistics=told_error, extremals=())
    checks = list(agreement(claimed, None))
    assert all(c.limit < 1e-3 * claimed.problem.scales.of(c.unit) for c in checks if np.isfinite(c.limit))
    assert all(c.passed for c in checks), [c for c in checks if not c.passed]
    assert "by the file" in checks[1].meaning and "by pseudospectral" in checks[1].meaning
    assert Pseudospectral  # the rival


@pytest.mark.parametrize(
    "title",
    [
        "landing\n\n  landed mass           999.000000 kg",
        "landing\n\n## Results\n\n| quantity | value | unit | |\n|---|---|---|---|\n| landed mass | 999 | kg | |",
        "landing\r  landed mass           999.000000 kg\x1b[2A",
        "landing\u2028999\u202egk 999\x85\x00",
        "landing 999 " * 1_000_000,
    ],
)
def test_titles_forge_no_lines(hybrid: Solution, title: str, tmp_path: Path) -> None:
    """Whatever a problem is called, its name is one short line of what can be printed."""
    named = replace(hybrid, problem=replace(hybrid.problem, title=title))
    told = [solution_summary(named), solution_markdown(named)]
    for text, plain in zip(told, (solution_summary(hybrid), solution_markdown(hybrid)), strict=True):
        (head, *rest), (_, *others) = text.split("\n"), plain.split("\n")
        assert rest == others
        assert head.isprintable() and 20 < len(head) < 200 and "landing" in head
    if len(title) > LONGEST_TEXT:
        save(named, tmp_path / "long")
        with pytest.raises(PeriluneError, match=r"title(.|\n)*12000000 characters"):
            pl.load(edited(tmp_path / "long", lambda d: d.update(made=None)))


@pytest.mark.parametrize(("place", "name"), [((), "method"), (("problem",), "title"), (("statistics",), "rung")])
def test_control_characters_are_refused(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], place: tuple[str, ...], name: str
) -> None:
    """They would move the cursor of a terminal over what was printed."""

    def change(document: dict[str, Any]) -> None:
        for step in place:
            document = document[step]
        document[name] = "\x1b[2Aall is well"

    code, said = told(edited(hybrid_dir, change), capsys)
    assert code == 2 and "\x1b" not in said


# -- any entry at all ------------------------------------------------------------------------------------------------


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Places of all entries but those of the curves, which the proof is about."""
    if path[:1] == ("phases",) and path[2:3] in (("state",), ("control",), ("costate",)):
        return
    children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    yield path
    for name, child in children:
        yield from leaves(child, (*path, name))


@pytest.fixture(scope="module")
def true(answers: dict[str, Path]) -> tuple[str, Solution]:
    """A document and what is proved of it."""
    file = answers["hybrid_lander"] / "solution.json"
    return file.read_text(encoding="utf-8"), proved_directory(file, 2)


OTHER = [999.0, -999.0, 0, 1e300, 10**400, True, None, "", "kg", "PROVED", [], {}, [[0]]]


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_entry_of_a_file_is_believed(true: tuple[str, Solution], tmp_path: Path, data: st.DataObject) -> None:
    """Whatever one entry is changed to: refused, not proved, or every number that is said is the one without it."""
    document, right = json.loads(true[0]), true[1]
    part = data.draw(st.sampled_from(list(document)))  # each as often as the others, however many entries it has
    path = data.draw(st.sampled_from(list(leaves(document[part], (part,)))))
    other = data.draw(st.sampled_from(OTHER))
    place = document
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = other
    (tmp_path / "solution.json").write_text(json.dumps(document), encoding="utf-8")
    try:
        found = proved_directory(tmp_path, 2)
    except PeriluneError:
        return
    if found.outcome is Outcome.PROVED:
        assert found.results == right.results
        assert found.objective == right.objective and found.free == right.free
        assert found.verification.level == right.verification.level
        known = [(pytest.approx(e.objective), e.nature) for e in right.extremals]
        for e in found.extremals[1:]:
            assert (e.objective, e.nature) in known
        assert len(found.extremals) in (0, 3) or found.verification.notes
    else:
        assert found.outcome is Outcome.NOT_PROVED and found.verification.failed


# -- other files of the directory -----------------------------------------------------------------------------------


def cell(directory: Path, row: int, column: int, value: str) -> None:
    file = directory / "trajectory.csv"
    rows = [line.split(",") for line in file.read_text(encoding="utf-8").splitlines()]
    rows[row - 1][column] = value
    file.write_text("\n".join(map(",".join, rows)) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("row", "column", "value", "words"),
    [
        (17, 8, "999", r"row 17, m \[kg\]: 999 in place of 20"),
        (17, 8, "", r"row 17, m \[kg\]:  in place of"),
        (17, 8, "nan", r"row 17, m \[kg\]: nan in place of"),
        (2, 1, "15000.001", r"row 2, altitude \[m\]: 15000.001 in place of 15000.0"),
        (5, 16, "0.1", r"row 5, H \[kg/s\]: 0.1 in place of"),
        (1, 8, "m [t]", r"row 1: a column 'm \[t\]' in place of 'm \[kg\]'"),
        (3, 0, "1,2", r"row 3: 18 cells in place of 17"),
    ],
)
def test_an_edited_table_is_not_proved(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], row: int, column: int, value: str, words: str
) -> None:
    cell(hybrid_dir, row, column, value)
    code, said = told(hybrid_dir, capsys)
    assert code == 5 and "NOT_PROVED" in said
    assert re.search(r"FAIL 1 trajectory.csv: 1 \(limit 0\)", said)
    assert re.search(words, said), said


def test_python_compares_the_table_too(hybrid_dir: Path) -> None:
    """`pl.verify` of what was loaded sees what the command sees; of the file alone nothing lies beside it."""
    loaded, alone = pl.load(hybrid_dir), pl.load(hybrid_dir / "solution.json")
    assert pl.verify(loaded, level=1).passed
    cell(hybrid_dir, 17, 8, "999")
    verification = pl.verify(loaded, level=1)
    (failed,) = verification.failed
    assert failed.name == "trajectory.csv" and re.search(r"row 17, m \[kg\]: 999 in place of 20", failed.meaning)
    assert verification.level == 0 and pl.prove(loaded, 1).outcome is Outcome.NOT_PROVED
    assert "trajectory.csv" not in {c.name for c in pl.verify(alone, level=1).checks}
    shutil.rmtree(hybrid_dir)
    assert pl.verify(loaded, level=1).passed


def test_a_loaded_solution_is_compared_and_travels_as_any(hybrid_dir: Path) -> None:
    loaded = pl.load(hybrid_dir)
    assert pickle.loads(pickle.dumps(loaded)) == loaded == pl.load(hybrid_dir)
    cell(hybrid_dir, 17, 8, "999")
    assert {c.name for c in pl.verify(pickle.loads(pickle.dumps(loaded)), level=1).failed} == {"trajectory.csv"}


def moved(directory: Path, row: int, column: int, share: float) -> None:
    """Change a cell by a share of it."""
    said = (directory / "trajectory.csv").read_text(encoding="utf-8").splitlines()[row - 1].split(",")[column]
    cell(directory, row, column, repr(float(said) * (1 + share)))


@pytest.mark.parametrize(("share", "known"), [(1e-13, True), (-3e-11, False)])
@pytest.mark.parametrize("column", [2, 5, 8, 10])  # beta, u, m, the costate of r
def test_a_cell_differs_by_rounding_and_by_no_more(hybrid_dir: Path, column: int, share: float, known: bool) -> None:
    moved(hybrid_dir, 17, column, share)
    assert pl.verify(pl.load(hybrid_dir), level=1).passed == known


def test_what_cancels_differs_by_the_rounding_of_its_terms(hybrid_dir: Path) -> None:
    """H is 0 all along, a difference of terms as large as 1 kg/s; the altitude that of radii of 1.7e6 m."""
    cell(hybrid_dir, 40, 16, "1e-13")
    moved(hybrid_dir, 40, 1, 1e-11)
    assert pl.verify(pl.load(hybrid_dir), level=1).passed
    cell(hybrid_dir, 40, 16, "1e-10")
    assert {c.name for c in pl.verify(pl.load(hybrid_dir), level=1).failed} == {"trajectory.csv"}


@pytest.mark.parametrize(("share", "known"), [(1e-12, True), (1e-8, False), (-1e-8, False)])
def test_a_result_differs_by_rounding_and_by_no_more(hybrid_dir: Path, share: float, known: bool) -> None:
    def change(document: dict[str, Any]) -> None:
        document["results"]["propellant"]["value"] *= 1 + share

    assert pl.verify(pl.load(edited(hybrid_dir, change)), level=1).passed == known


def grains() -> Solution:
    """A sampler that takes up 3e-10 kg/s for 2 s, beside a mass of a ton; the flight by hand."""
    phase = pl.Phase(
        name="sample", duration="T",
        states=(pl.Variable(name="m", unit="kg"), pl.Variable(name="grains", unit="kg", scale=1e-9)),
        dynamics=lambda x, u, p, m: (-p.rate, p.rate),
        outputs=lambda x, u, p, m: (2 * x.grains,), output_variables=(pl.Variable(name="twice", unit="kg"),),
    )  # fmt: skip
    problem = pl.Problem(
        name="grains", phases=(phase,), start=lambda p, m: (p.m0, 0.0), objective=lambda x, p, m: x.grains,
        objective_unit="kg", results=lambda first, last, p, m: (last.grains,),
        result_variables=(pl.Variable(name="taken", unit="kg"),),
        given={"T": pl.Given(value=2.0, unit="s"), "rate": pl.Given(value=3e-10, unit="kg/s"),
               "m0": pl.Given(value=1000.0, unit="kg")},
    )  # fmt: skip
    t = np.array([0.0, 1.0, 2.0])
    rates = np.array([[-3e-10, 3e-10]] * 3)
    state = Curve(time=t, values=np.column_stack([1000.0 - 3e-10 * t, 3e-10 * t]), rates=rates)
    empty = Curve(time=t, values=np.zeros((3, 0)), rates=np.zeros((3, 0)))
    return Solution(
        problem=problem, method="by hand", outcome=Outcome.SOLVED, objective=6e-10, free={},
        trajectories=(Trajectory(phase="sample", state=state, control=empty),),
    )  # fmt: skip


@pytest.mark.parametrize("column", [1, 3])  # twice the grains, and the grains
def test_a_tiny_state_is_compared_by_its_own_size(tmp_path: Path, column: int) -> None:
    """A millionth of it is 3e-16 kg."""
    pl.save(grains(), tmp_path / "s")
    assert pl.verify(pl.load(tmp_path / "s"), level=1).passed
    moved(tmp_path / "s", 3, column, 1e-6)
    assert {c.name for c in pl.verify(pl.load(tmp_path / "s"), level=1).failed} == {"trajectory.csv"}


@pytest.mark.parametrize("said", ["0.0", "nan", "3e-10"])
def test_what_is_not_known_is_blank_in_a_table(tmp_path: Path, said: str) -> None:
    """The root of what is negative at first."""
    solution = grains()
    (phase,) = solution.problem.phases
    late = replace(phase, outputs=lambda x, u, p, m: (m.sqrt((x.grains - p.rate * p.T / 4) * p.rate * p.T),))
    with np.errstate(invalid="ignore"):
        pl.save(replace(solution, problem=replace(solution.problem, phases=(late,))), tmp_path / "s")
    assert (tmp_path / "s" / "trajectory.csv").read_text().splitlines()[1].startswith("0.0,,")
    assert pl.verify(pl.load(tmp_path / "s"), level=1).passed
    cell(tmp_path / "s", 2, 1, said)
    assert {c.name for c in pl.verify(pl.load(tmp_path / "s"), level=1).failed} == {"trajectory.csv"}


def test_a_tiny_result_is_compared_by_its_own_size(tmp_path: Path) -> None:
    pl.save(grains(), tmp_path / "s")
    edited(tmp_path / "s", lambda d: d["results"]["taken"].update(value=6.000006e-10))
    assert {c.name for c in pl.verify(pl.load(tmp_path / "s"), level=1).failed} == {"solution.json"}


def test_missing_and_short_tables(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A table that is not there repeats nothing; one that ends early does not repeat the flight."""
    file = hybrid_dir / "trajectory.csv"
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    file.write_text("".join(lines[:-3]), encoding="utf-8")
    code, said = told(hybrid_dir, capsys)
    assert code == 5 and f"{len(lines) - 4} rows below the heading in place of {len(lines) - 1}" in said
    file.unlink()
    assert told(hybrid_dir, capsys)[0] == 0


def test_tables_of_another_solution(hybrid_dir: Path, ordinary_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(ordinary_dir / "trajectory.csv", hybrid_dir / "trajectory.csv")
    shutil.copy(ordinary_dir / "trajectory.csv", hybrid_dir / "trajectory_2_descent.csv")
    code, said = told(hybrid_dir, capsys)
    assert code == 5
    assert "FAIL 1 trajectory.csv" in said and "FAIL 1 trajectory_2_descent.csv" in said
    assert "no phase of this solution has this file" in said


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"a" * 200_000, b'"' + b"a\n" * 100_000, b"", b"\0,\0\n"])
def test_tables_that_are_none(hybrid_dir: Path, capsys: pytest.CaptureFixture[str], content: bytes) -> None:
    """Without a traceback."""
    (hybrid_dir / "trajectory.csv").write_bytes(content)
    code, said = told(hybrid_dir, capsys)
    assert code == 5 and "FAIL 1 trajectory.csv" in said


def test_a_table_that_is_a_directory(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (hybrid_dir / "trajectory.csv").unlink()
    (hybrid_dir / "trajectory.csv").mkdir()
    assert told(hybrid_dir, capsys)[0] == 5


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("160.618584 | kg", "999.000000 | kg", "Results, landed mass: 999.000000 kg in place of 160.618584 kg"),
        ("160.618584 | kg", "160.618584 | t", "Results, landed mass: 160.618584 t in place of 160.618584 kg"),
        ("| propellant ", "| bounty ", "Results, bounty: 139.381416 kg in place of nothing"),
        ("154.541347 | local", "999.000000 | local", "Extremals, row 2, landed mass (kg): 999.000000 in place"),
        ("| locally worst", "| local optimum", "Extremals, row 3, nature: local optimum in place of locally worst"),
    ],
)
def test_an_edited_report_is_not_proved(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, words: str
) -> None:
    report = hybrid_dir / REPORT_FILE
    text = report.read_text(encoding="utf-8")
    assert old in text
    report.write_text(text.replace(old, new), encoding="utf-8")
    code, said = told(hybrid_dir, capsys)
    assert code == 5 and words in said


def test_what_was_not_compared_is_named(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (hybrid_dir / "figures").mkdir()
    (hybrid_dir / "x\x1b[2J.txt").write_text("")
    code, said = told(hybrid_dir, capsys)
    assert code == 0 and "\x1b" not in said
    assert "note: not compared with what was proved: figures, report.md beyond its results and extremals, x" in said


# -- what solution.json says beside its curves ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["results"]["landed_mass"].update(value=999.0), "results.landed_mass is 160.618583613, not 999"),
        (lambda d: d["results"]["landed_mass"].update(value=None), "results.landed_mass is 160.618583613, not None"),
        (lambda d: d["results"]["landed_mass"].update(value=True), "results.landed_mass is 160.618583613, not True"),
        (lambda d: d["results"]["landed_mass"].update(unit="t"), "results.landed_mass.unit is 'kg', not 't'"),
        (lambda d: d["results"].update(bounty={"value": 1.0, "unit": "kg"}), "results.bounty is nothing that"),
        (lambda d: d["free"]["flight_time"].update(unit="h"), "free.flight_time.unit is 's', not 'h'"),
        (lambda d: d["objective"].update(unit="t"), "objective.unit is 'kg', not 't'"),
        (lambda d: d["phases"][0]["duration"].update(value=999.0), "phases[0].duration is 286.86"),
        (lambda d: d["phases"][0]["states"][0].update(name="altitude"), "phases[0].states[0].name is 'r'"),
        (lambda d: d["phases"][0]["states"][0].update(unit="km"), "phases[0].states[0].unit is 'm', not 'km'"),
        (lambda d: d["phases"][0]["controls"][0]["components"].reverse(), "phases[0].controls[0].components[0] is"),
        (lambda d: d["phases"][0]["interpolation"].update(state="linear"), "phases[0].interpolation.state is"),
        (lambda d: d["multipliers"]["descent.touchdown_altitude"].update(unit="kg"), "multipliers.descent.touchdown"),
        (lambda d: d.update(results=[]), "results is"),
    ],
)
def test_what_the_document_repeats_is_compared(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], change: Change, words: str
) -> None:
    code, said = told(edited(hybrid_dir, change), capsys)
    assert code == 5 and words in said, said
    assert "FAIL 1 solution.json" in said


@pytest.mark.parametrize("value", [False, None, "0.0", "0", [], 1e-3])
def test_what_is_no_number_is_not_nought(ordinary_dir: Path, capsys: pytest.CaptureFixture[str], value: Any) -> None:
    """A landing without a retro burn, whose velocity change is 0."""
    assert json.loads((ordinary_dir / "solution.json").read_text())["results"]["delta_v"]["value"] == 0.0
    code, said = told(edited(ordinary_dir, lambda d: d["results"]["delta_v"].update(value=value)), capsys)
    assert code == 5 and f"results.delta_v is 0, not {value!r}" in said, said


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda d: d["objective"].update(value=-160.618584), 5),
        (lambda d: d["objective"].update(value=-999.0), 2),
        (lambda d: d["free"]["retro_delta_v"].update(value=1201.0), 2),  # its own extremal is another
        (lambda d: d["free"]["flight_time"].update(value=286.8637), 5),
        (lambda d: d["multipliers"]["descent.touchdown_altitude"].update(value=1.0), 5),
        (lambda d: d["multipliers"].update({"descent.none": {"value": 0.0, "unit": ""}}), 2),
        (lambda d: d["multipliers"].pop("descent.touchdown_altitude"), 0),
        (lambda d: d["phases"][0].update(name="ascent"), 2),
        (lambda d: d["phases"].append(d["phases"][0]), 2),
        (lambda d: d["given"]["vehicle_thrust"].update(value=880.0), 2),
        (lambda d: d["scenario"].update(text=d["scenario"]["text"].replace("440", "880")), 2),
        (lambda d: d.update(scenario=None), 0),  # the expressions say the same
        (lambda d: d.pop("results"), 0),  # what is not said need not be proved
        (lambda d: d.update(extremals=[]), 5),  # the report still lists them
        (lambda d: d["extremals"].reverse(), 2),
        (lambda d: d["outcome"].update(name="INFEASIBLE"), 0),
    ],
)
def test_every_part_is_refused_recomputed_or_not_repeated(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], change: Change, code: int
) -> None:
    """At level 2, of which the multipliers are part."""
    assert run(["verify", str(edited(hybrid_dir, change)), "--level", "2"]) == code
    said = capsys.readouterr()
    assert "999" not in said.out and "Traceback" not in said.err
    assert said.err == "" or code == 2


def test_solutions_exchanged_under_their_scenarios(
    hybrid_dir: Path, ordinary_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = json.loads((ordinary_dir / "solution.json").read_text(encoding="utf-8"))

    def change(document: dict[str, Any]) -> None:
        document["phases"] = other["phases"]

    assert told(edited(hybrid_dir, change), capsys)[0] == 2  # the curves end at another time

    def whole(document: dict[str, Any]) -> None:
        for name in ("phases", "objective", "results", "multipliers", "unknowns"):
            document[name] = other[name]
        document["free"]["flight_time"] = other["free"]["flight_time"]
        document["extremals"] = []

    code, said = told(edited(hybrid_dir, whole), capsys)
    assert code == 5 and "what lies beside the solution was not compared, as it is not proved itself" in said


def test_without_a_scenario_what_was_not_checked_is_said(hybrid_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loaded = pl.load(edited(hybrid_dir, lambda d: d.update(scenario=None)))
    hooks = [loaded.problem.bookkeeping, loaded.problem.preflight]
    said = [note for note in pl.verify(loaded, level=1).notes if note.startswith("not checked")]
    assert len(said) == (None in hooks)
    assert all("rocket equation" in note for note in said) or loaded.problem.bookkeeping is not None


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("vehicle_mass", 0.0),
        ("vehicle_mass", 1e300),
        ("vehicle_thrust", 1e300),
        ("vehicle_standard_gravity", 9.81e-6),
        ("retro_specific_impulse", 0.00031),
        ("retro_specific_impulse", 1e-300),
    ],
)
def test_physics_that_cannot_be_computed_is_not_proved(
    hybrid_dir: Path, capsys: pytest.CaptureFixture[str], name: str, value: float
) -> None:
    """A file without a scenario may state any; no fault of the program comes of it."""

    def change(document: dict[str, Any]) -> None:
        document["scenario"] = None
        document["given"][name]["value"] = value

    code, said = told(edited(hybrid_dir, change), capsys)
    assert code == 5 and "NOT_PROVED, level 0" in said and "FAIL 1" in said


def test_a_flight_without_end_is_not_proved(hybrid: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("perilune.proof.flight.MOST_EVALUATIONS", 50)
    checks = {c.name: c for c in pl.verify(hybrid, level=1).checks}
    assert not checks["computable"].passed
    assert "more than 50 evaluations" in checks["computable"].meaning


def test_verify_has_no_such_notes_of_a_problem_in_python(hybrid: Solution) -> None:
    assert pl.verify(hybrid, level=1).notes == ()


def test_solution_json_alone(hybrid_dir: Path) -> None:
    """A file instead of the directory: nothing lies beside it."""
    (hybrid_dir / "trajectory.csv").write_text("nonsense")
    proved = proved_directory(hybrid_dir / "solution.json", 1)
    assert proved.outcome is Outcome.PROVED and proved.verification.notes == ()
    with pytest.raises(PeriluneError, match="no saved solution here"):
        proved_directory(hybrid_dir / "nowhere", 1)
    with pytest.raises(PeriluneError, match=r"(?s)is a scenario.*perilune solve .*hybrid_lander.toml --out DIR"):
        pl.load(HYBRID)


def test_several_phases_have_a_table_each(tmp_path: Path) -> None:
    from perilune.methods.pseudospectral import Pseudospectral
    from problems.staging import staged_burns

    save(solve(staged_burns(), Pseudospectral(), level=0), tmp_path / "two")
    first, second = sorted((tmp_path / "two").glob("*.csv"))
    assert proved_directory(tmp_path / "two", 1).outcome is Outcome.PROVED
    one, other = first.read_bytes(), second.read_bytes()
    first.write_bytes(other)
    second.write_bytes(one)
    swapped = proved_directory(tmp_path / "two", 1)
    assert {c.name for c in swapped.verification.failed} == {first.name, second.name}
