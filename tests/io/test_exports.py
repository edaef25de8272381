"""What an export says of itself, what is refused, and the command."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import perilune as pl
from command_line import HYBRID, ROOT, read_json
from perilune.cli import run_command_line
from perilune.core import PeriluneError
from perilune.io.exports.czml import attitudes, join_legs
from perilune.io.exports.epochs import stamp
from perilune.io.exports.inertial_path import LOST, InertialLeg, legs
from perilune.io.exports.table import flight_table
from perilune.io.exports.tabular import write_netcdf
from perilune.io.exports.time_scales import leap_seconds_within
from perilune.models import MARS, MOON, Body, Orbit, Vehicle, hybrid_landing
from perilune.problem import Solution
from perilune.scenario import load_file

EPOCH = "2030-01-01T00:00:00"
LATE = "2199-12-31T23:59:59"
Loose: Any = pl


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda s, f: Loose.export(s.problem, f), ("not a solution to export", "Problem", "perilune.load")),
        (lambda s, f: Loose.export(s, None), ("not the file of an export", "None")),
        (lambda s, f: pl.export(s, f, "hdf5"), ("no format of this name", "'hdf5'", "netcdf")),
        (lambda s, f: pl.export(s, f.with_suffix(".xyz")), ("no known format", "flight.csv for csv", "--format")),
        (lambda s, f: Loose.export(s, f, 3), ("no format of this name", "'3'")),
        (lambda s, f: pl.export(s, f, "oem"), ("(OEM) needs the time", "--epoch 2030-01-01T00:00:00", "epoch=")),
        (lambda s, f: pl.export(s, f, "czml"), ("CZML needs the time", "hybrid_landing states none")),
        (lambda s, f: pl.export(s, f, "oem", epoch="tomorrow"), ("epoch is not a supported time", "'tomorrow'")),
        (lambda s, f: pl.export(s, f, "oem", epoch="9999-12-31T23:59:59"), ("supported time", "and before 2200")),
        (lambda s, f: pl.export(s, f, "czml", epoch="1899-12-31T23:59:59Z"), ("supported time", "and before 2200")),
        (lambda s, f: pl.export(s, f, "csv", epoch=datetime(2200, 1, 1)), ("supported time", "and before 2200")),
        (lambda s, f: s.to_xarray(epoch="9999-12-31T23:59:59"), ("supported time", "and before 2200")),
        *((lambda s, f, form=form: pl.export(s, f, form, epoch=LATE), ("beyond the year 2199", "earlier"))
          for form in ("oem", "czml", "netcdf")),
        (lambda s, f: s.to_xarray(epoch=LATE), ("beyond the year 2199", "earlier")),
        (lambda s, f: pl.export(s, f, "oem", epoch=f"{EPOCH}.123456789"), ("more digits", "microseconds at most")),
        (lambda s, f: pl.export(s, f, "oem", epoch="2016-12-31T23:59:60"), ("second 60", "before or after")),
        (lambda s, f: s.to_xarray(epoch="2017-01-01T00:59:60.5+01:00"), ("second 60", "second earlier or later")),
        *((lambda s, f, text=text, of=of: Loose.export(s, f, "oem", epoch=EPOCH, **{of: text}),
           (f"not a valid {of.upper()} of an orbit", "printable ASCII"))
          for of in ("object_name", "object_id") for text in ("", " x", "é", "a\nSTOP_TIME = 1", 81 * "x", 3)),
        (lambda s, f: pl.export(s, f, "csv", object_id="2030-001A"), ("csv has no place for object_id", "oem")),
        (lambda s, f: Loose.export(s, f, "oem", epoch=2030), ("not an epoch", "2030")),
        (lambda s, f: Loose.export(s, f, epoch=datetime), ("not an epoch", "the class datetime")),
        (lambda s, f: Loose.export(s, f, scenario_text=3), ("not the text of a scenario", "3")),
        (lambda s, f: pl.export(s, f.parent), ("is a directory",)),
        (lambda s, f: pl.export(s, "-", "csv"), ("not standard output", "./-")),
        (lambda s, f: pl.export(s, f.parent / "nowhere" / "x.nc"), ("cannot be written", "No such file")),
    ],
)  # fmt: skip
def test_an_export_that_cannot_be_made_is_refused(
    hybrid: Solution, tmp_path: Path, ask: Callable[[Any, Path], Any], words: tuple[str, ...]
) -> None:
    with pytest.raises(PeriluneError) as caught:
        ask(hybrid, tmp_path / "flight")
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert not os.listdir(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
def test_a_pipe_stays_a_pipe_and_a_link_leads_to_its_file(hybrid: Solution, tmp_path: Path) -> None:
    """Whatever may be replaced is a file: nothing else is turned into one."""
    pipe, link, behind = tmp_path / "pipe.csv", tmp_path / "link.csv", tmp_path / "behind.csv"
    os.mkfifo(pipe)
    out_of, into = os.pipe()  # as standard output may be
    for place in (pipe, Path(os.devnull), Path(f"/dev/fd/{into}")):
        if place.exists():
            with pytest.raises(PeriluneError, match="a device or a pipe, not a file"):
                pl.export(hybrid, place, "csv", force=True)
    os.close(out_of)
    os.close(into)
    assert pipe.is_fifo() and not Path(os.devnull).is_file()
    link.symlink_to(behind)
    pl.export(hybrid, link)
    with pytest.raises(PeriluneError, match="already exists"):
        pl.export(hybrid, link)
    pl.export(hybrid, link, force=True)
    assert link.is_symlink() and behind.stat().st_size > 1000


@pytest.mark.parametrize(("package", "form"), [("pyarrow", "parquet"), ("pandas", None), ("xarray", None)])
def test_what_is_not_installed_is_one_sentence(
    hybrid: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str, form: str | None
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(PeriluneError, match=package) as missing:
        if form is not None:
            pl.export(hybrid, tmp_path / "flight", form)
        elif package == "pandas":
            hybrid.to_dataframe()
        else:
            hybrid.to_xarray()
    assert missing.value.advice == "pip install 'perilune[export]'" and not os.listdir(tmp_path)


def test_flat_ground_is_nowhere_in_space(tmp_path: Path) -> None:
    flat = pl.solve(load_file(ROOT / "examples" / "mars_pinpoint.toml").problem, verify=0)
    for form in ("oem", "czml"):
        with pytest.raises(PeriluneError, match="needs a position in space, and precision_landing has none"):
            pl.export(flat, tmp_path / "flight", form, epoch=EPOCH)
    head, *rows = pl.export(flat, tmp_path / "flight.csv", "csv").read_text().splitlines()
    assert "inertial_x" not in head
    assert head.endswith(",proof") and all(row.endswith(",level 0: unverified") for row in rows)


def test_a_body_that_nobody_knows_is_not_placed(hybrid: Solution, tmp_path: Path) -> None:
    own = Body(name="vesta", gravitational_parameter=4.9e12, radius=1.9e6, rotation_rate=0.0)
    vehicle, orbit = Vehicle(mass=300.0, thrust=440.0, specific_impulse=310.0), Orbit(
        parking_altitude=100e3, perilune_altitude=15e3
    )  # fmt: skip
    space = hybrid_landing(vehicle, None, orbit, own).views.space
    assert space is not None and space.body == "vesta"
    views = replace(hybrid.problem.views, space=space)
    with pytest.raises(PeriluneError, match="no a body whose orientation in space is known") as refused:
        pl.export(replace(hybrid, problem=hybrid.problem.changed(views=views)), tmp_path / "x", "oem", epoch=EPOCH)
    assert "moon" in str(refused.value)
    named = replace(own, name="moon")
    slow, back, still = (replace(MOON, rotation_rate=rate) for rate in (2.66e-6, -2.6617e-6, 0.0))
    published = replace(MOON, gravitational_parameter=4902.7779e9, radius=1738.14e3, rotation_rate=2.6617e-6)
    for body, name in (
        (named, ""), (replace(MARS, name="red"), "mars"), (replace(MOON, gravitational_parameter=4990e9), ""),
        (back, ""), (replace(MOON, rotation_rate=2.8e-6), ""), (slow, "moon"), (still, "moon"), (published, "moon"),
    ):  # fmt: skip
        seen = hybrid_landing(replace(vehicle, thrust=2000.0), None, orbit, body).views.space
        assert seen is not None and seen.body == name


def test_a_planar_flight_says_which_plane_was_chosen(hybrid: Solution, tmp_path: Path) -> None:
    text = pl.export(hybrid, tmp_path / "flight.oem", "oem", epoch=EPOCH).read_text()
    comments = " ".join(line.removeprefix("COMMENT ") for line in text.splitlines() if line.startswith("COMMENT"))
    assert "its plane is the equator" in comments and "IAU/IAG elements" in comments and "level 0" in comments
    assert text.isascii() and max(map(len, text.splitlines())) <= 254


def test_an_object_is_called_as_is_asked(hybrid: Solution, tmp_path: Path) -> None:
    """And what a message has no place for, mass and thrust, stands at its segment; times are whole microseconds."""
    plain = pl.export(hybrid, tmp_path / "plain.oem", epoch=EPOCH).read_text().splitlines()
    assert "OBJECT_NAME = hybrid_landing" in plain and "OBJECT_ID = UNKNOWN" in plain
    named = pl.export(hybrid, tmp_path / "x.oem", epoch=EPOCH, object_name="LANDER 1", object_id="2030-001A")
    lines = named.read_text().splitlines()
    assert "OBJECT_NAME = LANDER 1" in lines and "OBJECT_ID = 2030-001A" in lines
    (said,) = [line for line in lines if line.startswith("COMMENT mass")]
    mass = hybrid.trajectories[0].state.values[:, hybrid.problem.phases[0].state_names.index("m")]
    assert f"mass {mass[0]:.6f} kg at the start and {mass[-1]:.6f} kg at the end" in said and "to 440 N" in said
    stamps = [line.split()[0] for line in lines if line.startswith("2030") and "=" not in line]
    assert all(len(at) == len("2030-01-01T00:00:00.000000") for at in stamps)
    assert all(datetime.fromisoformat(at) for at in stamps) and sorted(set(stamps)) == stamps


@pytest.mark.parametrize(
    ("seconds", "read"),
    [(0.4999999999, "2016-12-31T23:59:59.000000000"), (1.499999999, "2016-12-31T23:59:59.999999999"),
     (1.5, "2016-12-31T23:59:60.000000000"), (2.499999999, "2016-12-31T23:59:60.999999999"),
     (2.5, "2017-01-01T00:00:00.000000000"), (86402.5, "2017-01-02T00:00:00.000000000")],
)  # fmt: skip
def test_clocks_over_a_leap_second(seconds: float, read: str) -> None:
    assert stamp(datetime(2016, 12, 31, 23, 59, 58, 500000, tzinfo=UTC), seconds) == read


def test_clocks_over_many_leap_seconds_and_none() -> None:
    """By the list of the IERS: 27 from 1972 to 2017; the begin of 1972 was none, and behind one it is over."""
    begin = datetime(1971, 12, 31, 23, 59, 59, tzinfo=UTC)
    assert stamp(begin, 1.0) == "1972-01-01T00:00:00.000000000"
    whole = (datetime(2017, 1, 1, tzinfo=UTC) - begin).total_seconds()
    assert stamp(begin, whole + 26) == "2016-12-31T23:59:60.000000000"
    assert stamp(begin, whole + 27) == "2017-01-01T00:00:00.000000000"
    assert leap_seconds_within(begin, whole) == leap_seconds_within(begin, whole + 25) != ()
    assert len(leap_seconds_within(begin, whole + 26)) == 27 and not leap_seconds_within(begin, 1e7)
    after = datetime(2017, 1, 1, tzinfo=UTC)
    assert leap_seconds_within(after, 1e9) == () and stamp(after, 1.0) == "2017-01-01T00:00:01.000000000"


def test_names_of_the_problem_break_no_message(hybrid: Solution, tmp_path: Path) -> None:
    """A line break in one began a keyword of its own; letters beyond ASCII were a fault."""
    called = replace(hybrid, problem=hybrid.problem.changed(name="Möndlein\nSTOP_TIME = never", title="é\nMETA_STOP"))
    lines = pl.export(called, tmp_path / "flight.oem", epoch=EPOCH).read_text("ascii").splitlines()
    assert "OBJECT_NAME = M?ndlein STOP_TIME = never" in lines and lines.count("META_STOP") == 1


def test_a_column_that_netcdf_cannot_call_is_refused_in_words(hybrid: Solution, tmp_path: Path) -> None:
    table = flight_table(hybrid)
    greek = replace(table, fields=(replace(table.fields[0], name="λ"), *table.fields[1:]))
    with pytest.raises(PeriluneError, match=r"ASCII letters only\n *got: λ"):
        write_netcdf(greek, {}, None, tmp_path / "x.nc")
    assert not (tmp_path / "x.nc").exists()


def test_an_epoch_is_read_as_it_is_meant(hybrid: Solution, tmp_path: Path) -> None:
    east = timezone(timedelta(hours=2))
    said = [
        EPOCH,
        f"{EPOCH}.000000000",
        "2030-01-01T02:00:00+02:00",
        datetime(2030, 1, 1, 2, tzinfo=east),
        datetime(2030, 1, 1),
    ]
    files = [pl.export(hybrid, tmp_path / f"{i}", "csv", epoch=epoch) for i, epoch in enumerate(said)]
    assert len({file.read_bytes() for file in files}) == 1
    assert files[0].read_text().splitlines()[1].split(",")[1] == "2030-01-01T00:00:00.000000000"
    assert stamp(datetime(2030, 1, 1, 23, 59, 59, 999999, tzinfo=UTC), 1e-6) == "2030-01-02T00:00:00.000000000"
    own = load_file(ROOT / "examples" / "minimum_duration_return.toml", ["problem.epoch=2026-06-01T12:00:00Z"]).problem
    moved = replace(hybrid, problem=hybrid.problem.changed(views=replace(hybrid.problem.views, space=own.views.space)))
    with pytest.raises(PeriluneError, match="already has an epoch"):
        pl.export(moved, tmp_path / "x", "csv", epoch=EPOCH)


def test_numbers_that_are_none_are_not_exported(ordinary: Solution, tmp_path: Path) -> None:
    (flown,) = ordinary.trajectories
    lost = replace(flown, state=replace(flown.state, values=np.nan * flown.state.values))
    with pytest.raises(PeriluneError, match="this flight cannot be placed"), np.errstate(all="ignore"):
        pl.export(replace(ordinary, trajectories=(lost,)), tmp_path / "x", "czml", epoch=EPOCH)


def test_the_way_in_space_loses_no_millimetre(ordinary: Solution) -> None:
    (leg,) = legs(ordinary)
    assert 0 < leg.lost < LOST and np.all(np.diff(leg.time) > 0)
    still = leg.turning(0.0)
    np.testing.assert_array_equal(still.velocity, leg.velocity)


def test_a_thrust_that_turns_over_keeps_its_attitudes_apart() -> None:
    """Half-way to its opposite a direction is none, and arcs may be shorter than what Cesium tells apart."""
    times = [0.0, 1e-12, 1.0, np.nextafter(1.0, 2.0), 1.0 + 1e-7, 2.0, 3.0]
    zeros = np.zeros((3, len(times)))
    push = np.array([[0.0, 0.0, 1.0]] * 3 + [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).T
    leg = InertialLeg(
        phase="burn", time=np.array(times), position=zeros, velocity=zeros + 1, push=push, push_rate=zeros, lost=0
    )
    rows = np.array(attitudes(join_legs([leg]))).reshape(-1, 5)
    assert rows[0, 0] == 0 and rows[-1, 0] == 3 and (np.diff(rows[:, 0]) > 0).all()
    up = Rotation.from_quat(rows[:, 1:]).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(up[[0, -4, -3, -2, -1]], push.T[[0, 2, 4, 5, 6]], atol=1e-12)


def test_the_command_exports_what_was_solved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    place, file = str(tmp_path / "run"), tmp_path / "flight.czml"
    scenario = load_file(HYBRID)
    pl.save(pl.solve(scenario.problem, verify=1), place, scenario.text)
    ask = ["export", place, "--format", "czml", "--out", str(file), "--json"]
    assert run_command_line(ask) == 2
    assert "--epoch" in capsys.readouterr().out
    assert run_command_line([*ask, "--epoch", EPOCH]) == 0
    told = read_json(capsys.readouterr().out)
    assert (
        told["bytes"] == file.stat().st_size
        and told["proof"] == "not verified again; its file claims level 1: feasible"
    )
    (vehicle,) = [packet for packet in json.loads(file.read_text()) if packet["id"] == "vehicle"]
    assert "perilune_altitude" in vehicle["description"] and "its file claims level 1" in vehicle["description"]
    assert run_command_line([*ask, "--epoch", EPOCH]) == 2
    capsys.readouterr()
    assert run_command_line([*ask, "--epoch", EPOCH, "--force", "--verify", "1"]) == 0
    assert read_json(capsys.readouterr().out)["proof"] == "level 1: feasible"
    assert run_command_line(["export", str(tmp_path), "--out", str(tmp_path / "x")]) == 2
    assert (
        run_command_line(["export", place, "--out", str(tmp_path / "flight.oem"), "--format", "czml", "--epoch", EPOCH])
        == 2
    )
    assert "request oem" in capsys.readouterr().err
    assert run_command_line(["export", place, "--out", str(tmp_path / "flight.csv")]) == 0
    assert (tmp_path / "flight.csv").read_text().count(",") > 100
    (tmp_path / "flight.csv").unlink()
    monkeypatch.setattr(pl, "verify", None)  # it takes long, and is not begun
    assert run_command_line([*ask, "--epoch", "no time", "--force", "--verify", "3"]) == 2
    assert "is not a supported time" in capsys.readouterr().err
    assert sorted(os.listdir(tmp_path)) == ["flight.czml", "run"]


def test_both_sides_of_a_switch_stand_in_the_tables(tmp_path: Path) -> None:
    """A throttle of 0.9, 0.3 and 0.9: the row before a switch has what was before it."""
    flown = pl.solve(load_file(ROOT / "examples" / "precision_landing.toml").problem, verify=0)
    pl.save(flown, tmp_path / "landing")
    kept = pl.load(tmp_path / "landing")
    assert pl.verify(kept, 1).verification.level == 1
    frame = kept.to_dataframe()
    throttle, pushed = frame["throttle"].to_numpy(), frame["thrust_acceleration"].to_numpy()
    steps = np.flatnonzero(np.diff(throttle))
    assert len(steps) == 2 and (np.diff(frame.index)[steps] == 0).all()
    assert (np.abs(pushed[steps + 1] / pushed[steps] - (1 / 3, 3)) < 1e-9).all()


def test_what_is_not_proved_says_so_in_every_file(ordinary: Solution, tmp_path: Path) -> None:
    """Also where only the file of it says so."""
    wrong, told = ordinary.objective + 1.0, "level 0: unverified, NOT_PROVED: 1 of "
    first = replace(ordinary.extremals[0], objective=wrong)
    failed = pl.verify(replace(ordinary, objective=wrong, extremals=(first, *ordinary.extremals[1:])), 1)
    pl.save(failed, tmp_path / "run")
    for form in ("oem", "czml", "netcdf"):
        file = pl.export(failed, tmp_path / f"{form}.x", form, epoch=EPOCH)
        assert told.encode() in file.read_bytes(), form
    assert run_command_line(["export", str(tmp_path / "run"), "--out", str(tmp_path / "x.oem"), "--epoch", EPOCH]) == 0
    assert f"not verified again; its file claims {told}" in (tmp_path / "x.oem").read_text()
