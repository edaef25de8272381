"""A stated tolerance raises limits and nothing else, is said beside PROVED where it was needed, and is no way round."""

from __future__ import annotations

import csv
import json
import math
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import perilune as pl
from command_line import HYBRID, ROOT, read_json
from many_problems import transfer
from perilune import save
from perilune.cli import run_command_line
from perilune.core import Outcome, PeriluneError
from perilune.io import SOLUTION_FILE, solution_document, whole_document
from perilune.problem.results.solution import Solution
from perilune.problem.tolerance import format_tolerance, quantity_in
from perilune.report.family import family_csv, family_document
from perilune.report.summary import solution_markdown, solution_summary
from perilune.scenario import KINDS, load_file, load_text, template
from perilune.scenario.reader import tolerance_of
from perilune.scenario.text import parse
from test_verify import shifted_values, with_curve

PRECISION = str(ROOT / "examples" / "precision_landing.toml")
POLAR = str(ROOT / "examples" / "polar_descent.toml")
UP, MILLIMETRE = 2, pl.Tolerance(position=1e-3)
WITHIN = "within the stated tolerance (position 1 mm)"


@pytest.fixture(scope="module")
def precise() -> Solution:
    """The last kilometres, whose coordinates begin at the site: its limits of lengths are below a micrometre."""
    return pl.solve(load_file(PRECISION).problem, verify=0)


@pytest.fixture(scope="module")
def direct() -> Solution:
    """The paper's landing by the direct method: feasible, and with costates as good as its mesh."""
    return pl.solve(load_file(HYBRID).problem, pl.Pseudospectral(polish=False), verify=0)


def raised_by(solution: Solution, millimetres: float) -> Solution:
    """The table of the altitude, off by so much all along."""
    return with_curve(solution, "state", shifted_values(UP, 1e-3 * millimetres))


# --- what it does
# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("off", "tolerance", "level", "failed"),
    [
        (0.3, pl.Tolerance(), 0, ["state_up"]),
        (0.3, MILLIMETRE, 3, []),
        (3.0, MILLIMETRE, 0, ["state_up"]),
        (0.3, pl.Tolerance(speed=1e-3, mass=1e-3, time=1e-3, angle=1e-6, optimality=1e-3), 0, ["state_up"]),
    ],
)
def test_a_table_that_is_off(
    precise: Solution, off: float, tolerance: pl.Tolerance, level: int, failed: list[str]
) -> None:
    found = pl.verify(raised_by(precise, off), tolerance=tolerance).verification
    assert [check.name for check in found.failed] == failed
    assert found.level == level
    assert found.title == ("level 0: unverified" if failed else f"level 3: locally optimal, {WITHIN}")
    assert str(found).startswith("level 0 (unverified)" if failed else f"level 3 (locally optimal), {WITHIN}")


def test_what_was_not_needed_qualifies_nothing(precise: Solution) -> None:
    found = pl.verify(precise, tolerance=MILLIMETRE).verification
    assert found.passed and found.tolerance_used == "" and found.title == "level 3: locally optimal"
    assert found.notes == ("no part of the stated tolerance (position 1 mm) was needed",)
    failing = pl.verify(raised_by(precise, 3.0), level=1, tolerance=MILLIMETRE).verification
    assert not any("needed" in note for note in failing.notes)


def test_only_limits_of_the_quantity_are_raised_and_none_is_lowered(precise: Solution) -> None:
    plain = {check.name: check for check in pl.verify(precise).verification.checks}
    for tolerance, units in (
        (MILLIMETRE, {"m"}),
        (pl.Tolerance(speed=1e-3), {"m/s"}),
        (pl.Tolerance(mass=1e-3), {"kg"}),
        (pl.Tolerance(time=1e-3), {"s"}),
        (pl.Tolerance(optimality=1e-5), {"1"}),
        (pl.Tolerance(position=1e-9), set()),  # less than the limits' own
    ):
        found = pl.verify(precise, tolerance=tolerance).verification
        (name, stated) = next(iter(tolerance.stated.items()))
        changed = {check.name for check in found.checks if check.own_limit is not None}
        assert {plain[n].unit for n in changed} == units
        for check in found.checks:
            if check.name in changed:
                own = plain[check.name]
                assert check.limit == stated > own.limit == check.own_limit
                assert check.raised_by == name and own.level == (2 if name == "optimality" else 1)
            elif check.name != f"stated_{name}":
                assert check.limit == plain[check.name].limit
        if units == {"m"}:
            assert {"site_up", "state_east", "path_height_above_glide_slope"} <= changed
        if units == {"1"}:  # all of level 2, and none of the others that have no unit
            assert changed == {n for n, check in plain.items() if check.level == 2}


def test_what_failed_needed_nothing_and_what_counts_is_not_raised(precise: Solution) -> None:
    flown = precise.trajectories[0]
    found = pl.verify(
        raised_by(replace(precise, trajectories=(replace(flown, costate=None),)), 3.0),
        level=2, tolerance=pl.Tolerance(position=1e-3, optimality=1e-3),
    ).verification  # fmt: skip
    checks = {check.name: check for check in found.checks}
    assert checks["costates"].limit == 0.0 and checks["costates"].own_limit is None
    assert checks["state_up"].own_limit is not None and not checks["state_up"].lenient


def test_a_time_stored_twice_is_one_time(precise: Solution) -> None:
    """By however much times may be off: the tables end where the flight does."""
    longer = replace(precise, free={"flight_time": precise.free["flight_time"] + 1e-4})
    found = pl.verify(
        longer, level=1, tolerance=pl.Tolerance(time=1e-3, position=0.1, speed=0.01, mass=0.01)
    ).verification
    assert "flight_time" in {check.name for check in found.failed}


def test_a_direct_answer_is_proved_to_what_its_mesh_gives(direct: Solution) -> None:
    assert pl.verify(direct).verification.level == 1
    found = pl.verify(direct, tolerance=pl.Tolerance(optimality=1e-4)).verification
    assert found.passed and found.title == "level 3: locally optimal, within the stated tolerance (optimality 0.0001)"
    short = pl.verify(direct, tolerance=pl.Tolerance(optimality=1e-5)).verification
    assert [check.name for check in short.failed] == ["costate_r", "costate_v"] and short.title == "level 1: feasible"


def test_the_level_says_what_it_needed_itself(direct: Solution) -> None:
    """What a level that was not reached needed is nothing that the one below needed."""
    found = pl.verify(
        raised_by_radius(direct, 30.0), tolerance=pl.Tolerance(position=1.0, optimality=1e-5)
    ).verification
    assert found.title == "level 1: feasible, within the stated tolerance (position 1 m)"
    assert any(check.lenient and check.level == 2 for check in found.checks)


def raised_by_radius(solution: Solution, millimetres: float) -> Solution:
    return with_curve(solution, "state", shifted_values(0, 1e-3 * millimetres))


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    off=st.floats(-8.0, 3.0).map(lambda e: 10.0**e),
    stated=st.floats(-9.0, 6.0).map(lambda e: 10.0**e),
    column=st.sampled_from(range(7)),
)
def test_however_much_is_stated(precise: Solution, off: float, stated: float, column: int) -> None:
    """What passes is off by no more than is stated, a thousandth of the flight at most, and says so."""
    units = [state.unit for state in precise.problem.phases[0].states]
    name, alike = quantity_in(units[column]), [unit == units[column] for unit in units]
    most = 1e-3 * np.ptp(precise.trajectories[0].state.values[:, alike], axis=0).max()
    wrong = with_curve(precise, "state", shifted_values(column, off))
    strict = pl.verify(wrong, level=1).verification
    found = pl.verify(wrong, level=1, tolerance=pl.Tolerance(**{name: stated})).verification
    if found.passed:
        assert stated <= most and (strict.passed or off <= 1.001 * stated)
    if strict.passed and stated < 0.999 * most:
        assert found.passed
    assert bool(found.tolerance_used) == (found.passed and not strict.passed)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda s: with_curve(s, "control", lambda c: replace(c, values=c.values * [-1, -1, -1, 1])),
        lambda s: with_curve(s, "costate", lambda c: replace(c, values=-c.values, rates=-c.rates)),
        lambda s: replace(s, objective=s.objective * 1.01),
        lambda s: with_curve(s, "state", lambda c: replace(c, values=0.99 * c.values)),
        lambda s: with_curve(s, "control", lambda c: replace(c, values=c.values * math.nan)),
    ],
)
def test_a_wrong_answer_fails_with_the_largest_tolerance(
    precise: Solution, wrong: Callable[[Solution], Solution]
) -> None:
    largest = pl.Tolerance(position=1.7, speed=0.049, mass=0.079, time=0.046, angle=1e-3, optimality=1e-3)
    assert pl.verify(precise, level=1, tolerance=largest).verification.passed
    assert not pl.verify(wrong(precise), level=2, tolerance=largest).verification.passed


def test_a_worse_extremal_fails_with_any_tolerance(landing: pl.Problem) -> None:
    near = pl.solve(landing.with_given(retro_delta_v=129.0), verify=0)
    worst = pl.solve(landing, guess=near, tolerance=pl.Tolerance(position=1.0, optimality=1e-3))
    assert worst.outcome is Outcome.NOT_PROVED and worst.verification.level == 2


# --- what is no tolerance
# ---------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stated", "value", "limit"),
    [
        (pl.Tolerance(position=2.0), 2.0, 1.8),
        (pl.Tolerance(position=1e9), 1e9, 1.8),
        (pl.Tolerance(speed=0.06), 0.06, 0.0527),
        (pl.Tolerance(mass=0.1), 0.1, 0.0797),
        (pl.Tolerance(time=0.05), 0.05, 0.0460),
    ],
)
def test_what_is_as_large_as_the_flight_is_no_tolerance(
    precise: Solution, stated: pl.Tolerance, value: float, limit: float
) -> None:
    """More than a thousandth of what the flight changes: even a perfect answer is not proved."""
    found = pl.verify(precise, 3, stated)
    assert found.outcome is Outcome.NOT_PROVED and found.verification.level == 0
    (check,) = found.verification.failed
    (name,) = stated.stated
    assert check.name == f"stated_{name}" and check.value == value
    assert check.limit == pytest.approx(limit, rel=0.01)
    assert "would prove nothing" in check.meaning


def test_a_spike_in_the_table_makes_no_room_for_a_tolerance(precise: Solution) -> None:
    """What the flight changes is read off its tables; who falsifies them has to be as far off as the limit."""

    def spike(curve: pl.Curve) -> pl.Curve:
        values = curve.values.copy()
        values[len(values) // 2, UP] += 1e6
        return replace(curve, values=values)

    found = pl.verify(with_curve(precise, "state", spike), level=1, tolerance=pl.Tolerance(position=900.0)).verification
    assert {"state_up"} <= {check.name for check in found.failed} and "stated_position" not in str(found.failed)


def test_a_tolerance_of_what_no_state_is_measured_in() -> None:
    found = pl.solve(transfer(), verify=1, tolerance=pl.Tolerance(mass=1e-9))
    assert [check.name for check in found.verification.failed] == ["stated_mass"]


def turned(slip: float) -> Solution:
    """Numbers of the size 1e-6 that are called angles: one that turns to where it should be, but for a slip."""
    phase = pl.Phase(
        name="turn",
        states=(pl.Variable(name="x", unit="rad"),),
        controls=(),
        dynamics=lambda x, u, p, xp: (p.rate,),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.target,), there="rad"),
    )
    problem = pl.Problem(
        name="turn", phases=(phase,), start=lambda p, xp: (0.0,),
        given={"rate": pl.Parameter(value=1e-6, unit="rad/s"), "T": pl.Parameter(value=1.0, unit="s"),
               "target": pl.Parameter(value=1e-6 + slip, unit="rad")},
        objective=lambda x, p, xp: x.x, objective_unit="rad",
    )  # fmt: skip
    time, flat = np.array([0.0, 1.0]), np.zeros((2, 0))
    state = pl.Curve(time=time, values=1e-6 * time[:, None], rates=np.full((2, 1), 1e-6))
    flown = pl.Trajectory(phase="turn", state=state, control=pl.Curve(time=time, values=flat, rates=flat))
    return Solution(
        problem=problem, method="by hand", outcome=Outcome.SOLVED, objective=1e-6, free={}, trajectories=(flown,)
    )


def test_an_angle_is_no_larger_than_what_turns() -> None:
    """A thousandth of a radian is all there is of a flight that turns by a millionth."""
    assert pl.verify(turned(0.0), level=1).verification.passed
    assert pl.verify(turned(5e-10), level=1).verification.level == 0
    assert pl.verify(turned(5e-10), level=1, tolerance=pl.Tolerance(angle=9e-10)).verification.level == 1
    for slip, stated in ((5e-7, 1e-3), (5e-7, 9e-10), (0.0, 2e-9)):
        assert pl.verify(turned(slip), level=1, tolerance=pl.Tolerance(angle=stated)).verification.level == 0


@pytest.mark.parametrize("value", [0.0, -1e-3, math.nan, math.inf, "1 mm", object(), 1e40, 1e-40])
@pytest.mark.parametrize("name", ["position", "speed", "mass", "angle", "time", "optimality"])
def test_what_is_no_size_is_refused(name: str, value: Any) -> None:
    with pytest.raises(PeriluneError, match=f"proof.{name}"):
        pl.Tolerance(**{name: value})


@pytest.mark.parametrize(("name", "value"), [("optimality", 2e-3), ("angle", math.radians(0.06))])
def test_what_has_a_size_of_its_own_is_refused_at_once(name: str, value: float) -> None:
    with pytest.raises(PeriluneError, match="too large for a proof"):
        pl.Tolerance(**{name: value})


def test_what_is_no_tolerance_is_refused_by_each_verb(precise: Solution) -> None:
    wrong: Any = 1e-3
    for call in (
        lambda: pl.solve(precise.problem, tolerance=wrong),
        lambda: pl.verify(precise, 1, wrong),
        lambda: pl.verify(precise, tolerance=wrong).verification,
        lambda: pl.sweep(precise.problem, {"vehicle.thrust": [8e3]}, tolerance=wrong),
    ):
        with pytest.raises(PeriluneError, match="not a tolerance of the proof"):
            call()
    with pytest.raises(PeriluneError, match="did you mean 'position'"):
        pl.Tolerance(**{"positon": 1.0})


@pytest.mark.parametrize(
    ("unit", "name"),
    [
        ("m", "position"), ("m*s/s", "position"), ("m/s", "speed"), ("kg", "mass"), ("s", "time"), ("rad", "angle"),
        ("1", ""), ("", ""), ("rad/s", ""), ("1/s", ""), ("m/s^2", ""), ("N", ""), ("kg/m", ""), ("rad*m/m", ""),
    ],
)  # fmt: skip
def test_a_quantity_is_known_by_its_unit(unit: str, name: str) -> None:
    """What has no unit is not an angle: a state in lengths of its author's own is raised by nothing."""
    assert quantity_in(unit) == name


def test_a_value_is_told_in_one_way() -> None:
    stated = {"position": ("1 mm", "1 m", "2.5 km", "0.2 mm"), "angle": ("0.001 deg",), "mass": ("1 g", "3 kg")}
    for name, texts in stated.items():
        for text in texts:
            assert scenario(f'[proof]\n{name} = "{text}"\n').describe() == f"{name} {text}"
    assert (
        scenario('[proof]\nposition = "1e-6 km"\n').describe()
        == pl.Tolerance(position=1e-3).describe()
        == "position 1 mm"
    )
    assert format_tolerance("angle", math.radians(1e-3)) == "0.001 deg"


# --- where it is stated
# ---------------------------------------------------------------------------------------------------------------------


def scenario(section: str, kind: str = "hybrid_landing") -> pl.Tolerance:
    text = template(kind) + section
    load_text(text)
    return tolerance_of(parse(text))


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_scenario_takes_it(kind: str) -> None:
    section = (
        '[proof]\nposition = "1 mm"\nspeed = "1 mm/s"\nmass = "1 g"\n'
        'angle = "1e-4 deg"\ntime = "1 ms"\noptimality = 1e-6\n'
    )
    found = scenario(section, kind)
    values = (1e-3, 1e-3, 1e-3, math.radians(1e-4), 1e-3, 1e-6)
    assert tuple(found.stated.values()) == pytest.approx(values)
    assert scenario("", kind) == scenario("[proof]\n", kind) == pl.Tolerance()
    assert "[proof]" in template(kind) and "# position =" in template(kind)


@pytest.mark.parametrize("file", [HYBRID, PRECISION, POLAR])
def test_it_is_no_part_of_the_problem(file: str) -> None:
    stated, plain = load_file(file, ["proof.position=1 mm", "proof.mass=1 g"]), load_file(file)
    assert stated.problem == plain.problem and stated.tolerance == pl.Tolerance(position=1e-3, mass=1e-3)
    assert plain.tolerance == pl.Tolerance()
    assert stated.text is not None and 'position = "1 mm"' in stated.text


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("proof.position=1 kg", "wrong dimension"),
        ("proof.position=1", "a number and a unit"),
        ("proof.position=-1 mm", "out of range"),
        ("proof.position=0 mm", "out of range"),
        ("proof.position=1e999 m", "not finite"),
        ("proof.angle=1 deg", "too large for a proof"),
        ("proof.angle=0.1", "a number and a unit"),
        ("proof.optimality=0.5", "too large for a proof"),
        ("proof.posiion=1 mm", "did you mean 'position'"),
        ("prof.position=1 mm", "did you mean 'proof'"),
    ],
)
def test_a_scenario_is_refused_in_words(change: str, said: str) -> None:
    with pytest.raises(PeriluneError, match=said):
        load_file(HYBRID, [change])


# --- where it goes
# ---------------------------------------------------------------------------------------------------------------------


def test_it_is_said_wherever_the_outcome_is(precise: Solution) -> None:
    proved = pl.verify(raised_by(precise, 0.3), 3, MILLIMETRE)
    assert proved.outcome is Outcome.PROVED
    said = f"PROVED, level 3: locally optimal, {WITHIN}"
    assert said in solution_summary(proved) and said in solution_markdown(proved)
    assert f"verification: level 3 (locally optimal), {WITHIN}" in solution_summary(proved, every_check=False)
    assert "(limit 0.001 stated, its own 1.7e-06)" in solution_summary(proved)
    assert "state_up | 0.0003 | 0.001 stated, its own 1.73e-06" in solution_markdown(proved)
    document = read_json(json.dumps(solution_document(proved)))
    assert document["tolerance_used"] == document["verification"]["tolerance_used"] == WITHIN
    assert document["verification"]["tolerance"] == {"position": {"value": 1e-3, "unit": "m"}}
    check = next(c for c in document["verification"]["checks"] if c["name"] == "state_up")
    assert check["own_limit"] < check["value"] < check["limit"] == 1e-3 and check["raised_by"] == "position"
    assert whole_document(proved)["outcome"]["tolerance_used"] == WITHIN
    plain = read_json(json.dumps(solution_document(pl.verify(precise, 1))))
    assert plain["tolerance_used"] == "" and plain["verification"]["tolerance"] == {}
    assert not any("own_limit" in c for c in plain["verification"]["checks"])


def test_it_goes_with_a_solution(precise: Solution, tmp_path: Path) -> None:
    """Through files and processes, at level 0 too; and who proves again may state another, or none."""
    asked = pl.verify(raised_by(precise, 0.3), 0, MILLIMETRE)
    assert asked.outcome is Outcome.SOLVED and asked.verification.tolerance == MILLIMETRE
    assert pl.verify(asked, level=1).verification.tolerance_used == WITHIN
    assert pl.verify(pickle.loads(pickle.dumps(asked)), level=1).verification.tolerance_used == WITHIN
    save(asked, tmp_path)
    loaded = pl.load(tmp_path)
    assert not loaded.verification.checks and loaded.verification.tolerance_used == ""
    assert pl.verify(loaded, 3).verification.title.endswith(WITHIN)
    assert pl.verify(pl.load(tmp_path), 1).verification.title == f"level 1: feasible, {WITHIN}"
    again = pl.verify(loaded, 1, pl.Tolerance())
    assert again.outcome is Outcome.NOT_PROVED and again.verification.tolerance == pl.Tolerance()
    assert pl.verify(loaded, level=1, tolerance=pl.Tolerance(position=1e-4)).verification.level == 0
    assert pl.solve(precise.problem, guess=asked, verify=1).verification.tolerance == pl.Tolerance()


@pytest.fixture(scope="module")
def saved(precise: Solution, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    place = tmp_path_factory.mktemp("saved")
    save(pl.verify(raised_by(precise, 0.3), 1, MILLIMETRE), place)
    return json.loads((place / SOLUTION_FILE).read_text(encoding="utf-8"))


def loaded_as(document: dict[str, Any], place: Path) -> Solution:
    """What a file of this content gives."""
    (place / SOLUTION_FILE).write_text(json.dumps(document), encoding="utf-8")
    return pl.load(place)


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ({"position": {"value": 1e-3, "unit": "km"}}, "tolerance.position.unit"),
        ({"position": {"value": 1e-3, "unit": "1"}}, "tolerance.position.unit"),
        ({"angle": {"value": 1e-3, "unit": "deg"}}, "tolerance.angle.unit"),
        ({"position": {"value": -1e-3, "unit": "m"}}, "proof.position"),
        ({"position": {"value": 1e300, "unit": "m"}}, "proof.position"),
        ({"optimality": {"value": 1.0, "unit": "1"}}, "too large for a proof"),
        ({"position": {"value": "1e-3", "unit": "m"}}, "tolerance.position"),
        ({"position": {"value": True, "unit": "m"}}, "tolerance.position"),
        ({"position": {"value": 1e-3}}, "unit"),
        ({"position": 1e-3}, "position"),
        ({"everything": {"value": 1e-3, "unit": "m"}}, "tolerance.everything"),
        (["position"], "tolerance"),
        ("position 1 mm", "tolerance"),
    ],
)
def test_a_strangers_tolerance_is_checked(saved: dict[str, Any], stated: Any, said: str, tmp_path: Path) -> None:
    document = {**saved, "verification": {**saved["verification"], "tolerance": stated}}
    with pytest.raises(PeriluneError, match=said):
        loaded_as(document, tmp_path)


@pytest.mark.parametrize("claims", [None, "PROVED", {}, {"tolerance": None}, {"tolerance": {}}])
def test_a_file_that_states_none_has_none(saved: dict[str, Any], claims: Any, tmp_path: Path) -> None:
    """As those of earlier versions; what it claims of its checks, that they needed none, opens nothing."""
    found = pl.verify(loaded_as({**saved, "verification": claims}, tmp_path), 1)
    assert found.outcome is Outcome.NOT_PROVED and found.verification.tolerance == pl.Tolerance()


def test_a_stranger_cannot_hide_what_was_needed(saved: dict[str, Any], tmp_path: Path) -> None:
    """A wrong answer with room made for it is called what it is, and beyond a thousandth of the flight not proved."""
    for metres, proved in ((1.0, True), (10.0, False), (1e9, False)):
        stated = {"position": {"value": metres, "unit": "m"}}
        claims = {**saved["verification"], "tolerance_used": "", "tolerance": stated, "checks": []}
        document = {**saved, "tolerance_used": "", "verification": claims}
        (tmp_path / SOLUTION_FILE).write_text(json.dumps(document), encoding="utf-8")
        found = pl.verify(pl.load(tmp_path), 1)
        assert (found.outcome is Outcome.PROVED) == proved
        assert found.verification.tolerance_used == ("within the stated tolerance (position 1 m)" if proved else "")


@dataclass(frozen=True)
class Sloppy:
    """The indirect method, with tables that are off."""

    millimetres: float = 0.3

    def run(self, problem: pl.Problem, guess: Any = None, callback: Any = None) -> Solution:
        return raised_by(pl.Indirect().run(problem, guess, callback), self.millimetres)


@pytest.mark.parametrize("elsewhere", [False, True])
def test_a_sweep_and_its_store(precise: Solution, tmp_path: Path, elsewhere: bool) -> None:
    over = {"vehicle.thrust": [8e3, 8.5e3]}

    def swept(tolerance: pl.Tolerance, level: int = 1) -> Any:
        lines: list[str] = []
        with ThreadPoolExecutor(1) as pool:
            family = pl.sweep(
                precise.problem, over, Sloppy(), verify=level, tolerance=tolerance, store=tmp_path / "store",
                executor=pool if elsewhere else None, callback=lambda event: lines.append(str(event)),
            )  # fmt: skip
        return family, "\n".join(lines)

    family, lines = swept(MILLIMETRE)
    assert [point.outcome for point in family.points] == [Outcome.PROVED] * 2
    assert [point.tolerance_used for point in family.points] == [WITHIN] * 2
    assert not elsewhere or f"PROVED {WITHIN}" in lines
    assert [point["tolerance_used"] for point in family_document(family)["points"]] == [WITHIN] * 2
    rows = list(csv.reader(StringIO(family_csv(family))))
    assert [row[-3:] for row in rows[1:]] == [["PROVED", "1", WITHIN]] * 2
    again, lines = swept(MILLIMETRE)
    assert "proved again: 2 of 2" in lines and not again.notes
    assert [point.solution.verification.title for point in again.points] == [f"level 1: feasible, {WITHIN}"] * 2
    with pytest.raises(PeriluneError, match="a sweep that differs in its tolerance"):
        swept(pl.Tolerance())


def test_a_sweep_from_neighbour_to_neighbour(precise: Solution) -> None:
    (point,) = pl.sweep(precise.problem, {"vehicle.thrust": [8e3]}, verify=1, tolerance=MILLIMETRE).points
    assert point.solution is not None and point.solution.verification.tolerance == MILLIMETRE
    assert point.outcome is Outcome.PROVED and point.tolerance_used == ""


def test_a_stored_member_states_nothing_for_a_sweep(precise: Solution, tmp_path: Path) -> None:
    """What a member's file says of its tolerance is not looked at: the sweep has its own."""
    over, place = {"vehicle.thrust": [8e3]}, tmp_path / "store"
    assert pl.sweep(precise.problem, over, Sloppy(), verify=1, store=place).points[0].outcome is Outcome.NOT_PROVED
    file = place / "000000.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    document["solution"]["verification"]["tolerance"] = {"position": {"value": 1e-3, "unit": "m"}}
    file.write_text(json.dumps(document), encoding="utf-8")
    again = pl.sweep(precise.problem, over, Sloppy(), verify=1, store=place)
    assert again.notes == ("stored member 000000 does not prove and is solved again",)
    assert again.points[0].outcome is Outcome.NOT_PROVED


def test_the_families_own_stores_of_before_are_read(precise: Solution, tmp_path: Path) -> None:
    over, place = {"vehicle.thrust": [8e3]}, tmp_path / "store"
    pl.sweep(precise.problem, over, verify=1, store=place)
    manifest = place / "sweep.json"
    said = json.loads(manifest.read_text(encoding="utf-8"))
    assert said.pop("tolerance") is None
    manifest.write_text(json.dumps(said), encoding="utf-8")
    assert pl.sweep(precise.problem, over, verify=1, store=place).points[0].outcome is Outcome.PROVED


# --- the command line
# ---------------------------------------------------------------------------------------------------------------------

STATED = ["--set", "proof.position=0.1 mm", "--set", "proof.optimality=1e-4"]
NEEDED = "within the stated tolerance (optimality 0.0001)"


def test_the_command_line_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "out")
    arguments = ["solve", HYBRID, "--method", "direct", "--no-polish", *STATED, "--out", out]
    assert run_command_line(arguments) == 0
    assert f"PROVED, level 3: locally optimal, {NEEDED}" in capsys.readouterr().out
    assert f"**PROVED, level 3: locally optimal, {NEEDED}.**" in (tmp_path / "out" / "report.md").read_text("utf-8")
    assert run_command_line(["verify", out]) == 0
    assert f"PROVED, level 3: locally optimal, {NEEDED}" in capsys.readouterr().out
    assert run_command_line(["verify", out, "--json", "--level", "2"]) == 0
    document = read_json(capsys.readouterr().out)
    assert document["outcome"] == "PROVED" and document["tolerance_used"] == NEEDED
    assert set(document["verification"]["tolerance"]) == {"position", "optimality"}


def test_the_command_line_refuses_what_is_no_tolerance(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["solve", HYBRID, "--set", "proof.position=1 kg", "--json"]) == 2
    assert "wrong dimension" in read_json(capsys.readouterr().out)["error"]["what"]
    assert run_command_line(["solve", PRECISION, "--set", "proof.position=1 km", "--level", "1"]) == 5
    assert "would prove nothing" in capsys.readouterr().out
    assert run_command_line(["sweep", HYBRID, "--vary", "proof.position=1:2:1 mm"]) == 2
    assert "key with a quantity" in capsys.readouterr().err


def test_a_sweep_by_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [
        "sweep",
        HYBRID,
        "--method",
        "direct",
        "--no-polish",
        "--level",
        "2",
        "--vary",
        "retro.delta_v=1000:1000:1 m/s",
    ]
    assert run_command_line([*arguments, *STATED]) == 0
    assert capsys.readouterr().out.rstrip().endswith(f"PROVED,2,{NEEDED}")
    assert run_command_line([*arguments, *STATED, "--json"]) == 0
    (point,) = read_json(capsys.readouterr().out)["points"]
    assert point["outcome"] == "PROVED" and point["tolerance_used"] == NEEDED
