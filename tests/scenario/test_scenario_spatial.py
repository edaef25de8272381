"""Scenarios of descents in three dimensions: what they say is what is solved, proved, saved and proved again."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import pytest

import perilune as pl
from command_line import ROOT, read_json
from perilune.cli import run_command_line
from perilune.cli.methods import NAMES, method_of
from perilune.core import InfeasibleError, PeriluneError
from perilune.scenario import KINDS, load_file, load_text
from perilune.solve import solve
from perilune_papers.peng2012.case import CASE, peng_descent

POLAR = ROOT / "examples" / "polar_descent.toml"
HYBRID = ROOT / "examples" / "hybrid_lander.toml"
PRECISION = ROOT / "examples" / "precision_landing.toml"


# --- what a file says


def test_the_example_is_the_papers_descent() -> None:
    """Number for number the case that the report solves."""
    stated, ours = load_file(POLAR).problem, peng_descent(steering=CASE.steering)
    said, meant = ({name: g.value for name, g in p.given.items()} for p in (stated, ours))
    assert said == pytest.approx(meant, rel=1e-12, abs=1e-15)
    assert stated.objective_unit == "kg"
    assert stated.phases[0].state_names == ours.phases[0].state_names


def test_choices_reach_the_model() -> None:
    """Coordinates, target, objective, throttle and oblateness."""
    changes = ["problem.coordinates=spherical", "problem.target=anywhere", "problem.minimise=flight_time"]
    stated = load_file(POLAR, [*changes, "throttle.lower=0.2", "throttle.upper=0.9", "body.j2=2.03e-4"]).problem
    phase = stated.phases[0]
    assert phase.state_names == ("r", "theta", "phi", "u", "v", "w", "m")
    assert len(phase.end_conditions) == 4
    assert stated.objective_unit == "s"
    bounds = {c.names[0]: stated.bounds(c) for c in phase.controls}
    assert bounds["throttle"] == (0.2, 0.9)
    assert bounds["beta"] == pytest.approx((math.radians(150), math.radians(220)))
    assert stated.given["body_j2"].value == 2.03e-4


def test_the_precision_landing_is_the_file_s() -> None:
    given = {name: g.value for name, g in load_file(PRECISION).problem.given.items()}
    assert given["approach_east"] == -1800.0
    assert given["corridor_tilt"] == pytest.approx(math.radians(50))
    assert given["corridor_pad_radius"] == 10.0
    assert given["site_altitude"] == 0.0
    assert given["vehicle_dry_mass"] == 1200.0
    problem = load_file(PRECISION).problem
    assert problem.bounds(problem.phases[0].controls[1]) == (0.3, 0.9)
    assert problem.bounds(problem.phases[0].states[-1])[0] == 1200.0


def test_a_share_may_be_written_with_and_without_quotes() -> None:
    """There is no unit that could be guessed wrongly."""
    text = PRECISION.read_text(encoding="utf-8")
    quoted = text.replace("lower = 0.3", 'lower = "0.3"').replace("upper = 0.9", "upper = 1")
    assert load_text(quoted).given["throttle_upper"].value == 1.0


def test_every_kind_is_stated_by_an_example() -> None:
    """And each section that its kind needs is in it."""
    kinds = {
        "hybrid_lander": "hybrid_landing",
        "polar_descent": "powered_descent",
        "precision_landing": "precision_landing",
        "minimum_duration_return": "deorbit_entry",
    }
    assert set(kinds.values()) == set(KINDS)
    for name, kind in {**kinds, "mars_pinpoint": "precision_landing"}.items():
        text = (ROOT / "examples" / f"{name}.toml").read_text(encoding="utf-8")
        needed = [name for name, section in KINDS[kind].sections.items() if section.required]
        assert len(needed) >= 3
        assert all(f"[{section}]" in text for section in needed)


@pytest.mark.parametrize(
    ("file", "change", "what", "also"),
    [
        (POLAR, "problem.kind=descent", "no problem.kind of this name", "powered_descent"),
        (POLAR, "problem.target=crater", "unknown target", "downrange"),
        (POLAR, "problem.coordinates=polar", "unknown coordinates", "spherical"),
        (POLAR, "problem.minimise=cost", "unknown minimise", "propellant"),
        (POLAR, "start.latitude=91 deg", "latitude lies beyond the pole", "91 deg"),
        (POLAR, "start.latitude=90", "start.latitude - this is not a quantity", "90 deg"),
        (POLAR, "start.heading=3 km", "start.heading - the unit has the wrong dimension", "north"),
        (POLAR, "steering.elevation_upper=-60 deg", "elevation are not a range", "-60 deg"),
        (POLAR, "orbit.parking_altitude=100 km", "[orbit] belongs to another kind", "hybrid_landing"),
        (POLAR, "throttle.upper=0.9", "throttle.lower is missing", "0.3"),
        (POLAR, "vehicle.thrust=45 MN", "more than a lander withstands", "kN in place of N"),
        (POLAR, "body.name=moon", "a name and quantities", "omit"),
        (PRECISION, "throttle.lower=0.95", "throttle's bounds are not a range", "0.95 to 0.9"),
        (PRECISION, "throttle.lower=-0.1", "throttle.lower is out of range", "between 0 and 1"),
        (PRECISION, "throttle.upper=90 deg", "throttle.upper is out of range", "between 0 and 1"),
        (PRECISION, "corridor.tilt=95 deg", "corridor.tilt is not an angle", "95 deg"),
        (PRECISION, "approach.longest_coast=0 s", "approach.longest_coast is out of range", "900 s"),
        (PRECISION, "approach.east=-1e5 km", "so far away", "km in place of m"),
        (PRECISION, "body.j3=1", "no key of this name in [body]", "'j2'"),
        (PRECISION, "problem.target=site", "no key of this name in [problem]", "kind"),
        (HYBRID, "start.altitude=3 km", "[start] belongs to another", "powered_descent"),
        (HYBRID, "body.j2=0", "no key of this name in [body]", "radius"),
    ],
)  # fmt: skip
def test_a_slip_is_named(file: Path, change: str, what: str, also: str) -> None:
    """With the key or the section, and with what would do."""
    with pytest.raises(PeriluneError) as caught:
        load_file(file, [change])
    assert what in caught.value.what
    assert also in str(caught.value)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("file", "change", "what"),
    [
        (POLAR, "vehicle.dry_mass=12 t", "propellant cannot remove the initial speed"),
        (POLAR, "site.altitude=16 km", "does not start above its site"),
        (POLAR, "site.altitude=15 km", "does not start above its site"),
        (PRECISION, "approach.up=-1 m", "does not start above its site"),
        (PRECISION, "approach.up=0 m", "does not start above its site"),
        (PRECISION, "corridor.slope=60 deg", "starts below the glide slope"),
        (PRECISION, "throttle.lower=0.85", "hovers or climbs"),
        (PRECISION, "vehicle.thrust=2 kN", "cannot stop the descent"),
        (PRECISION, "approach.up_speed=-300 m/s", "descent is too fast"),
        (POLAR, "start.vertical_speed=-400 m/s", "descent is too fast"),
    ],
)
def test_the_impossible_is_infeasible(file: Path, change: str, what: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InfeasibleError, match=what) as caught:
        solve(load_file(file, [change]).problem)
    assert caught.value.reason == "cannot be flown"
    assert run_command_line(["check", str(file), "--set", change, "--json"]) == 3
    assert read_json(capsys.readouterr().out)["error"]["what"] == caught.value.what


@pytest.mark.parametrize(
    "text", ["problem = 3", "[problem]\nkind = 3", "[problem]\nkind = ['a']", "[problem.kind]\na = 1"]
)
def test_a_kind_that_is_no_text_is_refused(text: str) -> None:
    with pytest.raises(PeriluneError):
        load_text(text + "\n")


# --- the command line


@pytest.mark.parametrize(
    ("file", "truth", "drawn"),
    [
        (POLAR, {"flight_time": (472.796, 2e-3), "propellant": (5947.95, 0.03)}, "altitude"),
        (PRECISION, {"propellant": (79.74, 0.01)}, "mass"),
    ],
)  # fmt: skip
def test_an_example_is_solved_proved_and_written(
    file: Path, truth: dict[str, tuple[float, float]], drawn: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """At level 3; what is written is proved again from its file alone; the throttle's switches do not prevent it."""
    out = tmp_path / "out"
    assert run_command_line(["solve", str(file), "--out", str(out), "--json"]) == 0
    document = read_json(capsys.readouterr().out)
    assert document["outcome"] == "PROVED"
    assert document["verification"]["level"] == 3
    for name, (value, error) in truth.items():
        assert document["results"][name]["value"] == pytest.approx(value, abs=error)
    if file == PRECISION:  # as the head of the file says
        last = list(csv.DictReader((out / "trajectory.csv").read_text(encoding="utf-8").splitlines()))[-1]
        assert float(last["thrust_tilt [deg]"]) == pytest.approx(47.0, abs=0.5)
    figures = {path.stem for path in (out / "figures").glob("*.png")}
    assert {"track", "velocities", "steering", "hamiltonian", drawn} <= figures
    assert all(f"(figures/{name}.png)" in (out / "report.md").read_text(encoding="utf-8") for name in figures)
    assert run_command_line(["verify", str(out), "--level", "2"]) == 0
    assert "PROVED" in capsys.readouterr().out


def test_check_answers_without_solving(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["check", str(POLAR), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["outcome"] == "POSSIBLE"
    value = {f["name"]: f["value"] for f in document["findings"]}
    assert value["thrust-to-weight ratio at ignition"] == pytest.approx(45e3 / (15e3 * 4902.8e9 / 1740e3**2))


@pytest.mark.parametrize("name", NAMES)
def test_methods_by_name(name: str) -> None:
    assert (
        type(method_of(name)).__name__ == {"indirect": "Indirect", "direct": "Pseudospectral", "hybrid": "Hybrid"}[name]
    )


@pytest.mark.parametrize(
    ("name", "typed", "made"),
    [
        ("indirect", {"starts": 7, "seed": 3}, pl.Indirect(starts=7, seed=3)),
        ("direct", {"nodes": 9, "tolerance": 1e-5}, pl.Pseudospectral(nodes=9, tolerance=1e-5)),
        ("hybrid", {"nodes": 9, "seed": 2}, pl.Hybrid(pl.Genetic(seed=2), pl.Pseudospectral(nodes=9))),
        ("hybrid", {"tolerance": 1e-5}, pl.Hybrid(pl.Genetic(), pl.Pseudospectral(tolerance=1e-5))),
        ("direct", {"nodes": None, "starts": None}, pl.Pseudospectral()),
        ("direct", {"polish": False}, pl.Pseudospectral(polish=False)),
    ],
)
def test_settings_of_methods_by_name(name: str, typed: dict[str, Any], made: Any) -> None:
    assert method_of(name, typed) == made


def test_settings_reach_the_method(capsys: pytest.CaptureFixture[str]) -> None:
    """Four points are refined to the tolerance that is asked for, and one family is solved on as few."""
    told = [str(POLAR), "--method", "direct", "--no-polish", "--nodes", "4", "--level", "0"]
    assert run_command_line(["solve", *told, "--tolerance", "1e-3", "--json"]) == 5  # as no proof is asked for
    loose = read_json(capsys.readouterr().out)
    assert run_command_line(["solve", *told, "--json"]) == 5
    tight = read_json(capsys.readouterr().out)
    assert "4 nodes" in loose["statistics"]["initialization"]
    assert 1e-6 < loose["statistics"]["residual"] < 1e-3
    assert tight["statistics"]["residual"] <= 1e-6
    assert run_command_line(["sweep", *told, "--tolerance", "1e-3", "--vary", "site.longitude=0:3:3 deg"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_the_direct_method_starts_at_the_pole_of_the_papers_coordinates(capsys: pytest.CaptureFixture[str]) -> None:
    """Bounded angles in the paper's coordinates, singular at the start; the same flight time."""
    spherical = ["solve", str(POLAR), "--set", "problem.coordinates=spherical", "--json"]
    run_command_line([*spherical, "--method", "direct", "--level", "0"])
    document = read_json(capsys.readouterr().out)
    assert document["method"] == "pseudospectral"
    assert document["results"]["flight_time"]["value"] == pytest.approx(472.79556231, abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["solve", str(POLAR), "--method", "shooting"], "no method of this name"),
        (["sweep", str(PRECISION), "--vary", "problem.kind=0.1:0.3:0.1"], "no key with a quantity of this name"),
        (["reproduce", "peng-2013", "--out", "x"], "no paper of this name"),
        (["solve", str(POLAR), "--nodes", "12"], "the indirect method has no setting nodes"),
        (["solve", str(POLAR), "--tolerance", "1e-4"], "try: --method direct or --method hybrid"),
        (["solve", str(POLAR), "--method", "direct", "--seed", "1"], "expected: --nodes, --tolerance"),
        (["solve", str(POLAR), "--method", "hybrid", "--starts", "9"], "the hybrid method has no setting starts"),
        (["sweep", str(POLAR), "--vary", "site.longitude=0:6:3 deg", "--nodes", "9"], "no setting nodes"),
        (["solve", str(POLAR), "--method", "direct", "--nodes", "1"], "at least two collocation points"),
        (["solve", str(POLAR), "--method", "direct", "--nodes", "few"], "invalid whole number value: 'few'"),
        (["solve", str(POLAR), "--method", "direct", "--tolerance", "nan"], "tolerance must lie between 0 and 1"),
        (["solve", str(POLAR), "--method", "direct", "--tolerance", "1 mm"], "invalid number value: '1 mm'"),
        (["solve", str(POLAR), "--starts", "0"], "starts is too small"),
        (["solve", str(POLAR), "--seed", "-1"], "-1 is not at least 0"),
    ],
)
def test_commands_refuse_by_name(arguments: list[str], what: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(arguments) == 2
    assert what in capsys.readouterr().err


def test_a_sweep_over_the_site(capsys: pytest.CaptureFixture[str]) -> None:
    """Degrees in, degrees out; a site further aside costs more."""
    assert run_command_line(["sweep", str(POLAR), "--vary", "site.longitude=0:6:3 deg", "--level", "0"]) == 0
    rows = [line.split(",") for line in capsys.readouterr().out.splitlines()]
    assert rows[0][0] == "site_longitude [deg]"
    assert [float(row[0]) for row in rows[1:]] == pytest.approx([0.0, 3.0, 6.0])
    masses = [float(row[1]) for row in rows[1:]]
    assert masses == sorted(masses, reverse=True)


def test_anywhere_is_stated_without_a_site() -> None:
    """Neither a place nor the section; of another target what is missing is named, with the way out."""
    text = POLAR.read_text(encoding="utf-8")
    begin = text.index("[site]")
    bare = text[:begin] + text[text.index("[steering]") :]
    free = load_text(bare.replace('target = "site"', 'target = "anywhere"'))
    assert free.given["site_altitude"].value == 0.0 and "site_longitude" not in free.given
    for target in ("site", "downrange"):
        with pytest.raises(PeriluneError, match=r"site\.longitude is missing") as error:
            load_text(bare.replace('target = "site"', f'target = "{target}"'))
        assert 'target "anywhere"' in error.value.advice and error.value.exit_code == 2
