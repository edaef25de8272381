"""Reports, figures and saved solutions, on landings solved by SciPy alone (`landing_by_scipy`)."""

from __future__ import annotations

import csv
import io
import json
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from landing_by_scipy import cho_problem, shoot, solution_of
from perilune import load, save
from perilune.core import Outcome, PeriluneError
from perilune.io import (
    fresh_directory,
    hamiltonian,
    hash_of,
    json_text,
    per_unit,
    phase_columns,
    results_document,
    solution_document,
)
from perilune.io.save import trajectory_csv
from perilune.models import Retro
from perilune.problem import Check, Extremal, Nature, Problem, Solution, Statistics, Verification
from perilune.report import write_all
from perilune.report.summary import markdown_table, solution_markdown, solution_summary

SCENARIO = "[retro]\nspecific_impulse = '310 s'  # Cho's, µ\n"
CHECKS = (
    Check(
        name="touchdown altitude",
        level=1,
        value=2e-7,
        limit=1e-3,
        unit="m",
        meaning="re-flown from the export",
    ),
    Check(name="H", level=2, value=math.nan, limit=1e-9, unit="1", meaning="the Hamiltonian vanishes"),
)


@pytest.fixture(scope="module")
def hybrid() -> Solution:
    """Solve the paper's hybrid landing; the start is a rough one, the root SciPy's."""
    problem = cho_problem(Retro(specific_impulse=310.0))
    found = solution_of(problem, shoot(problem, np.array([-0.2, 0.29, 0.0, -0.9, 0.28, 0.7])))
    free = {name: float(value) for name, value in found.free.items()}
    return replace(
        found,
        free=free,
        outcome=Outcome.PROVED,
        multipliers={"descent.touchdown_altitude": 3.8e-4},
        extremals=(
            Extremal(free=free, objective=found.objective, nature=Nature.BEST),
            Extremal(
                free={"retro_delta_v": 0.0, "flight_time": 1005.0},
                objective=-154.5,
                nature=Nature.LOCAL_OPTIMUM_AT_BOUND,
            ),
        ),
        statistics=Statistics(initialization="test", attempts=("test",), iterations=7),
        verification=Verification(checks=CHECKS),
    )


@pytest.fixture(scope="module")
def ordinary() -> Solution:
    """Solve the paper's landing without a retro burn."""
    problem = cho_problem(None)
    return solution_of(problem, shoot(problem, np.array([0.1, 0.29, -0.1, -0.5, 0.97])))


def stand_in(text: str) -> Problem:
    """Stand-in for the scenario reader: there is one scenario."""
    assert text == SCENARIO
    return cho_problem(Retro(specific_impulse=310.0))


# --- documents ---


def test_results_are_the_papers(hybrid: Solution, ordinary: Solution) -> None:
    """Table 1, (25) and (26) within the error of the printed digits; units named."""
    found = results_document(hybrid)
    assert found["landed_mass"]["value"] == pytest.approx(160.6186, abs=5e-5)
    assert found["propellant"]["value"] == pytest.approx(139.3814, abs=5e-5)
    assert found["perilune_speed"]["value"] == pytest.approx(1691.96926, abs=5e-6)
    assert found["flight_time"]["value"] == pytest.approx(286.864, abs=1e-3)
    # Programs read these by name and in this order; what came later stands behind them.
    assert list(found)[:5] == ["landed_mass", "propellant", "delta_v", "flight_time", "perilune_speed"]
    assert [entry["unit"] for entry in found.values()][:5] == ["kg", "kg", "m/s", "s", "m/s"]
    assert results_document(ordinary)["landed_mass"]["value"] == pytest.approx(154.5413, abs=5e-5)
    assert results_document(ordinary)["delta_v"]["value"] == 0.0


def test_the_json_document_has_the_promised_shape(hybrid: Solution) -> None:
    """Keys of the issue, and a NaN leaves as null."""
    document = json.loads(json_text(solution_document(hybrid)))
    assert list(document) == [
        "problem",
        "title",
        "method",
        "outcome",
        "tolerance_used",
        "results",
        "extremals",
        "warnings",
        "verification",
        "statistics",
    ]
    assert document["outcome"] == "PROVED"
    assert set(document["extremals"][1]) == {"delta_v", "flight_time", "perilune_speed", "landed_mass", "nature"}
    assert document["extremals"][1]["delta_v"] == 0.0
    assert document["extremals"][1]["landed_mass"] == 154.5
    assert document["extremals"][1]["nature"] == "local optimum, at a bound"
    assert document["verification"]["level"] == 1
    assert document["verification"]["checks"][1]["value"] is None
    assert document["verification"]["checks"][1]["passed"] is False
    assert document["statistics"]["wall_time"] is None


@pytest.mark.parametrize(
    ("state", "unit"), [("m", "kg/m"), ("m/s", "kg/(m/s)"), ("kg", "1"), ("1", "kg"), ("rad", "kg/rad")]
)
def test_costate_units(state: str, unit: str) -> None:
    """A costate is measured in objective per state, and H in objective per second: where J is a time in nothing."""
    assert per_unit("kg", state) == unit
    assert per_unit("s", "s") == "1"


def test_columns_satisfy_the_optimality_conditions(hybrid: Solution) -> None:
    """H vanishes, the thrust is straight retro at first, and turning it either way can only raise H."""
    t = np.linspace(0.0, hybrid.trajectories[0].duration, 200)
    found = phase_columns(hybrid, 0, t)
    assert np.abs(found["H"].values).max() < 1e-9
    assert found["thrust_angle"].unit == "deg"
    assert found["thrust_angle"].values[0] == pytest.approx(180.0, abs=1e-8)
    assert found["thrust_acceleration"].values == pytest.approx(440.0 / found["m"].values)
    _, u = hybrid.evaluate(0, t)
    assert np.linalg.norm(u, axis=0) == pytest.approx(np.ones(200), abs=1e-15)
    for turn in (-0.1, 0.1, 3.0):
        c, s = math.cos(turn), math.sin(turn)
        turned = np.array([c * u[0] - s * u[1], s * u[0] + c * u[1]])
        assert (hamiltonian(hybrid, 0, t, turned) > found["H"].values).all()


def test_the_table_of_the_trajectory_is_exact_and_has_units(hybrid: Solution) -> None:
    """The CSV gives back the doubles; angles in degrees."""
    rows = list(csv.reader(io.StringIO(trajectory_csv(hybrid))))
    head = rows[0]
    assert head[:3] == ["time [s]", "altitude [m]", "thrust_angle [deg]"]
    assert {"m [kg]", "phi [deg]", "lambda_u [kg/(m/s)]", "H [kg/s]"} <= set(head)
    body = np.array(rows[1:], dtype=float)
    assert (body[:, 0] == hybrid.trajectories[0].time).all()
    assert (body[:, head.index("m [kg]")] == hybrid.trajectories[0].state.values[:, 4]).all()
    assert body[0, head.index("phi [deg]")] == pytest.approx(180.0)
    assert body[-1, 1] == pytest.approx(0.0, abs=1e-3)


# --- saved solutions ---


def test_a_saved_solution_comes_back_exactly_but_unproved(hybrid: Solution, tmp_path) -> None:
    """Every number survives; what the file claims of its proof is not believed."""
    save(hybrid, tmp_path / "a", SCENARIO)
    back = load(tmp_path / "a", stand_in)
    assert back.outcome is Outcome.SOLVED
    assert back.verification.checks == ()
    assert dict(back.free) == dict(hybrid.free)
    assert back.objective == hybrid.objective
    assert dict(back.multipliers) == dict(hybrid.multipliers)
    assert back.extremals == () and back.unverified_extremals == hybrid.extremals
    assert back.unknowns is not None and (back.unknowns == hybrid.unknowns).all()
    assert back.statistics.initialization == "test" and math.isnan(back.statistics.wall_time)
    old, new = hybrid.trajectories[0], back.trajectories[0]
    assert old.costate is not None and new.costate is not None
    for a, b in ((old.state, new.state), (old.control, new.control), (old.costate, new.costate)):
        assert (a.time == b.time).all() and (a.values == b.values).all() and (a.rates == b.rates).all()


def test_a_saved_solution_explains_itself(hybrid: Solution, tmp_path) -> None:
    """Format, interpolation rule, units, scenario and versions are in the file."""
    save(hybrid, tmp_path, SCENARIO)
    document = json.loads((tmp_path / "solution.json").read_text(encoding="utf-8"))
    assert document["format"]["name"] == "perilune-solution" and document["format"]["version"] == 3
    assert set(document["format"]["fields"]) - {"null"} <= {
        *document,
        *(f"phases.{key}" for key in document["phases"][0]),
        *(f"problem.{key}" for key in document["problem"]),
        *(f"verification.{key}" for key in document["verification"]),
    }
    assert document["phases"][0]["interpolation"]["control of kind direction"] == "cubic Hermite, then normalised"
    assert document["scenario"] == {"text": SCENARIO, "sha256": hash_of(SCENARIO)}
    assert document["free"]["flight_time"]["unit"] == "s"
    assert document["multipliers"]["descent.touchdown_altitude"]["unit"] == "kg/m"
    assert set(document["versions"]) >= {"perilune", "python", "numpy"}


def _set(document: Any, path: str, value: Any) -> None:
    *way, last = [int(key) if key.isdigit() else key for key in path.split("/")]
    for key in way:
        document = document[key]
    document[last] = value


CURVE = "phases/0/state"


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("format/version", 99, "not a saved solution"),
        ("format", None, "not a saved solution"),
        ("scenario/text", "[retro]\n", "scenario in the saved solution was altered"),
        ("scenario/text", 5, "text"),
        ("given/vehicle_mass/value", 301.0, "given.vehicle_mass"),
        ("given/vehicle_mass/value", 10**400, "finite"),
        ("given/wings", {"value": 2.0, "unit": "1"}, "wings"),
        ("free", {}, "free"),
        ("free/flight_time/value", "286", "a number"),
        ("free/flight_time/value", True, "a number"),
        ("outcome/name", "SPLENDID", "unknown word"),
        ("extremals/0/nature", "nice", "unknown word"),
        ("extremals", [3], "extremals"),
        ("phases", [], "phases"),
        ("phases/0/name", "ascent", "the phase descent"),
        (f"{CURVE}/time", [0.0], "increasing times"),
        (f"{CURVE}/time/0", 1.0, "increasing times"),
        (f"{CURVE}/values", [[1.0, 2.0], [3.0]], "table"),
        (f"{CURVE}/values/0/0", "1738140", "phases[0].state.values"),
        (f"{CURVE}/values/0/0", None, "phases[0].state.values"),
        (f"{CURVE}/rates", [], "phases[0].state.rates"),
        ("phases/0/control/time/0", -1.0, "times from 0"),
        ("phases/0/control/values/3", [0.0, 0.0], "direction of length 0"),
        ("free/flight_time/value", 1e9, "where the curves end"),
        ("extremals/0/objective", -999.0, "not this solution"),
        ("extremals/0/free/retro_delta_v", 3.0, "not this solution"),
        ("unknowns", [[1.0]], "unknowns"),
        ("statistics", [], "a record"),
    ],
)
def test_an_altered_file_is_refused(hybrid: Solution, tmp_path, path: str, value: Any, message: str) -> None:
    """Each alteration is named; nothing but a PeriluneError comes out."""
    save(hybrid, tmp_path, SCENARIO)
    file = tmp_path / "solution.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    _set(document, path, value)
    file.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(PeriluneError, match=re.escape(message)):
        load(tmp_path, stand_in)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"", "not readable JSON"),
        (b"\xff{}", "not text in UTF-8"),
        (b"[" * 200_000, "nested too deeply"),
        (b'"\\' * 2**24, "not readable JSON"),
        (b'{"format": 1, "format": 2}', "has a repeated name"),
        (b'{"format": Infinity}', "not finite"),
        (b"9" * 10_000, "not a saved solution"),
        (b"[]", "not a saved solution"),
        (b'{"format": NaN}', "not finite"),
        (b" " * (64 * 2**20 + 1), "too large"),
    ],
    ids=["empty", "binary", "deep", "quotes", "twice", "infinity", "long number", "list", "NaN", "huge"],
)
def test_a_strange_file_is_refused(tmp_path, raw: bytes, message: str) -> None:
    """Without a traceback and without reading more than the limit."""
    (tmp_path / "solution.json").write_bytes(raw)
    with pytest.raises(PeriluneError, match=message):
        load(tmp_path, stand_in)


def test_a_missing_file_is_refused(tmp_path) -> None:
    """With what would be right."""
    with pytest.raises(PeriluneError, match="perilune solve --out"):
        load(tmp_path / "nowhere", stand_in)


# --- files ---


def test_nothing_is_overwritten_without_force(tmp_path) -> None:
    """And with force only files of the same names."""
    target = tmp_path / "out"
    target.mkdir()
    (target / "mine.txt").write_text("keep")
    with pytest.raises(PeriluneError, match="not empty"), fresh_directory(target):
        pass
    with fresh_directory(target, force=True) as work:
        (work / "new.txt").write_text("new")
    assert sorted(path.name for path in target.iterdir()) == ["mine.txt", "new.txt"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_an_interruption_leaves_nothing(tmp_path, error: type[BaseException]) -> None:
    """Neither half a result nor the temporary directory."""
    with pytest.raises(error), fresh_directory(tmp_path / "out") as work:
        (work / "half.txt").write_text("half")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_no_directory(tmp_path) -> None:
    """Named, not a traceback."""
    (tmp_path / "out").write_text("")
    for target in (tmp_path / "out", tmp_path / "out" / "deeper"):
        with pytest.raises(PeriluneError, match="output directory"), fresh_directory(target):
            pass


# --- figures and reports ---


def test_everything_is_written(hybrid: Solution, ordinary: Solution, tmp_path) -> None:
    """Solution, table, report and every figure twice; the report's pictures exist."""
    write_all(hybrid, tmp_path / "out", scenario_text=SCENARIO, ordinary=ordinary)
    made = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert {"solution.json", "trajectory.csv", "report.md"} <= made
    report = (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    pictures = re.findall(r"\((figures/\w+\.png)\)", report)
    assert len(pictures) == 8
    for picture in pictures:
        assert picture in made and picture.replace(".png", ".svg") in made
        assert (tmp_path / "out" / picture).stat().st_size > 5000
    assert "160.618584" in report and "**FAILED**" in report and "specific_impulse = '310 s'" in report


def test_figures_are_deterministic_and_show_both_landings(hybrid: Solution, ordinary: Solution, tmp_path) -> None:
    """Equal bytes on equal input; what is drawn is what was computed."""
    from perilune.report.figures import save_figure, solution_figures

    for name in ("a", "b"):
        figure = solution_figures(hybrid, ordinary)["altitude"]
        save_figure(figure, tmp_path, name)
        drawn: list[Any] = [line for line in figure.axes[0].lines if len(np.asarray(line.get_xdata())) > 1]
        assert [line.get_ydata()[0] for line in drawn] == pytest.approx([15.0, 15.0])
        assert [line.get_xdata()[-1] for line in drawn] == pytest.approx([286.864, 1005.351], abs=1e-3)
        assert max(drawn[1].get_ydata()) > 20 > 15.0001 > max(drawn[0].get_ydata())
        assert figure.axes[0].get_ylabel() == "altitude (km)"
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_summary_says_what_failed(hybrid: Solution) -> None:
    """A failed check is not hidden, and extremals are listed with their nature."""
    text = solution_summary(hybrid, every_check=False)
    assert "level 1, feasible:         1 of 1 checks passed" in text
    assert "level 2, extremal:         1 of 1 checks FAILED" in text
    assert "FAIL 2 H: nan" in text and "the Hamiltonian vanishes" in text
    assert "ok   1" not in text
    text = solution_summary(hybrid)
    assert "160.618584 kg" in text and "local optimum, at a bound" in text
    assert "FAIL 2 H: nan" in text and "the Hamiltonian vanishes" in text
    assert "Not verified" in solution_markdown(replace(hybrid, verification=Verification()))


def test_a_bar_in_a_cell_does_not_break_the_table() -> None:
    """Markdown cells escape bars and line ends."""
    assert markdown_table(["a", "b"], [["|x|", "1\n2"]]).splitlines()[-1] == "| \\|x\\| | 1 2 |"
