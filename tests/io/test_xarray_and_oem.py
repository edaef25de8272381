"""Solutions for other programs: read back by libraries that did not write them, the same to 1e-9.

By its name among the last, as `test_xarray_and_parquet.py`: these libraries scatter the memory of a process.
"""

from __future__ import annotations

import csv
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

import perilune as pl
from command_line import ROOT
from perilune.io.columns import node_times, phase_columns, times_around_switches
from perilune.io.exports.epochs import TICK
from perilune.io.exports.inertial_path import JUMP, legs, separate_jumps
from perilune.io.exports.orientation import axes_in_space
from perilune.problem import Solution
from perilune.scenario import load_file, load_text

NEEDS = "needs the extra 'test'"
EPOCH = "2026-06-01T12:00:00"
RETURN = ROOT / "examples" / "minimum_duration_return.toml"
QUIET = pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::DeprecationWarning")


@pytest.fixture(scope="module")
def returned() -> Solution:
    """Two phases of different columns, from orbit through the air; its epoch is the problem's own."""
    return pl.solve(load_file(RETURN, [f"problem.epoch={EPOCH}Z"]).problem, verify=0)


@pytest.fixture(scope="module")
def descent() -> Solution:
    """Its states are positions and velocities in axes that turn with the Moon."""
    return pl.solve(load_file(ROOT / "examples" / "polar_descent.toml").problem, verify=0)


@pytest.fixture(scope="module")
def gated() -> Solution:
    """At its gate the thrust swings upright, and before it the throttle is switched."""
    text = (ROOT / "examples" / "precision_landing.toml").read_text(encoding="utf-8")
    return pl.solve(load_text(text.replace("# [final]", "[final]").replace("# height", "height")), verify=0)


def expected(solution: Solution) -> dict[str, np.ndarray]:
    """Each column over all phases, NaN where a phase has none."""
    parts = [phase_columns(solution, k) for k in range(len(solution.trajectories))]
    names = dict.fromkeys(name for part in parts for name in part)
    return {
        name: np.concatenate([part[name].values if name in part else np.nan * part["time"].values for part in parts])
        for name in names
    }


def begins(solution: Solution) -> np.ndarray:
    """Begin of each row's phase."""
    lengths = [trajectory.duration for trajectory in solution.trajectories]
    return np.repeat(np.cumsum([0.0, *lengths[:-1]]), [len(t.time) for t in solution.trajectories])


def body_fixed(solution: Solution, k: int, t: np.ndarray) -> np.ndarray:
    """Position and velocity out of states that are Cartesian beside the body, (n, 6)."""
    return np.asarray(solution.trajectories[k].state(t))[:, :6]


@QUIET
def test_netcdf_is_read_by_another_library(returned: Solution, tmp_path: Path) -> None:
    netcdf4 = pytest.importorskip("netCDF4", reason=NEEDS)
    with netcdf4.Dataset(pl.export(returned, tmp_path / "flight.nc", scenario_text="a = 'ü'")) as found:
        rows, times = expected(returned), found["time"][:]
        told = rows.pop("time") + begins(returned)
        moved = np.flatnonzero(np.append(np.diff(told), 1.0) == 0)  # before a jump: of a microsecond earlier
        assert len(moved) and np.abs(told[moved] - times[moved] - JUMP).max() < 1e-5 * JUMP
        np.testing.assert_allclose(np.delete(times, moved), np.delete(told, moved), rtol=1e-15)
        for name, values in rows.items():
            read = np.ma.filled(found[name][:], np.nan)
            np.testing.assert_array_equal(np.delete(read, moved), np.delete(values, moved), err_msg=name)
            np.testing.assert_allclose(read[moved], values[moved], rtol=1e-6, atol=1e-6, err_msg=name)
        assert found["x"].dimensions == ("time",) and "microsecond" in found.comment
        assert found.Conventions.startswith("CF-") and found.featureType == "trajectory"
        assert (
            found["time"].units == "seconds since 2026-06-01 12:00:00.000000" and found["time"].standard_name == "time"
        )
        assert found["altitude"].standard_name == "height_above_reference_ellipsoid" and found["altitude"].units == "m"
        assert (found["longitude"].units, found["latitude"].units) == ("degrees_east", "degrees_north")
        assert found["path_angle"].units == "degree" and "costate of vx" in found["lambda_vx"].long_name
        assert found["load"].coordinates == "altitude longitude latitude"
        assert found["phase"].flag_meanings.split()[found["phase"][-1]] == "entry"
        assert found.frame.startswith("inertial axes that coincide with the body-fixed axes at the start of the flight")
        assert "perilune" in found.source and found.proof == "level 0: unverified" and found.scenario == "a = 'ü'"
        assert json.loads(found.results)["flight_time"] == [returned.results["flight_time"].value, "s"]


@QUIET
def test_xarray_opens_what_a_solution_makes(returned: Solution, hybrid: Solution, tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray", reason=NEEDS)
    made = returned.to_xarray()
    with xarray.open_dataset(pl.export(returned, tmp_path / "flight.nc"), engine="scipy") as found:
        assert found.attrs == made.attrs and {"time", "longitude", "altitude"} <= set(found.coords)
        for name in found.variables:
            np.testing.assert_array_equal(found[name], made[name], err_msg=str(name))
    assert made["time"][0] == np.datetime64("2026-06-01T12:00:00")
    whole = returned.results["flight_time"].value
    assert (made["time"][-1] - made["time"][0]) / np.timedelta64(1, "ns") == pytest.approx(1e9 * whole, abs=1.0)
    plain = hybrid.to_xarray()  # without an epoch, and with nothing that places it over the ground
    assert plain["time"].attrs["units"] == "s" and "featureType" not in plain.attrs
    np.testing.assert_array_equal(plain["r"], hybrid.trajectories[0].state.values[:, 0])


@QUIET
def test_xarray_looks_between_and_beside_the_times_of_a_file(
    returned: Solution, gated: Solution, tmp_path: Path
) -> None:
    """By its `interp` and `sel`, which refuse an index with a time twice; on both sides of jumps what was there."""
    xarray = pytest.importorskip("xarray", reason=NEEDS)
    for solution, name in ((returned, "altitude"), (gated, "m")):
        with xarray.open_dataset(pl.export(solution, tmp_path / f"{name}.nc"), engine="scipy") as found:
            assert found.indexes["time"].is_unique and found.indexes["time"].is_monotonic_increasing
            dated = found["time"].dtype.kind == "M"

            def at(seconds: Any, found: Any = found, dated: bool = dated) -> Any:
                whole = np.round(1e9 * np.asarray(seconds)).astype("timedelta64[ns]")
                return found["time"].values[0] + whole if dated else np.asarray(seconds)

            begin = 0.0
            for k, trajectory in enumerate(solution.trajectories):
                t = trajectory.time[0] + trajectory.duration * np.linspace(0.01, 0.99, 50)
                known = phase_columns(solution, k, t)[name].values
                off = found[name].interp(time=at(begin + t)).values - known
                assert np.abs(off).max() < 1e-3 * np.ptp(known)  # it is linear between the nodes
                near = found[name].sel(time=at(begin + t), method="nearest").values
                assert np.abs(near - known).max() < 0.05 * np.ptp(known)
                begin += trajectory.duration
    steps = np.concatenate([times_around_switches(trajectory)[1] for trajectory in gated.trajectories[:1]])
    jumps: list[float] = []
    with xarray.open_dataset(tmp_path / "m.nc", engine="scipy") as found:
        for step in steps:
            before, behind = (float(found["throttle"].interp(time=step + d)) for d in (-2 * JUMP, 0.0))
            values = phase_columns(gated, 0, np.array([step - 2 * JUMP, step]))["throttle"].values
            assert [before, behind] == pytest.approx(values.tolist(), abs=1e-6)
            jumps.append(abs(behind - before))
    assert max(jumps) > 0.5  # others are of costates


def test_phases_without_length_have_no_rows_of_a_file_with_a_time_each() -> None:
    told, kept = separate_jumps(np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0 + 1e-7, 2.0, 2.0]))
    assert told[kept] == pytest.approx([0.0, 1.0 + 1e-7 - JUMP, 1.0 + 1e-7, 2.0 - JUMP, 2.0], abs=1e-12)
    assert (np.diff(told[kept]) > 0).all()


def test_pandas_and_csv_agree(returned: Solution, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas", reason=NEEDS)
    frame, rows = returned.to_dataframe(), expected(returned)
    np.testing.assert_allclose(frame.index, rows.pop("time") + begins(returned), rtol=1e-15)
    for name, values in rows.items():
        np.testing.assert_array_equal(frame[name], values, err_msg=name)
    assert frame.attrs["units"]["load"] == "1" and frame["phase"].iloc[-1] == "entry"
    file = pl.export(returned, tmp_path / "flight.csv", "csv")
    read = pandas.read_csv(file)
    assert read["utc"].iloc[0] == "2026-06-01T12:00:00.000000000"
    for name in frame.columns[1:]:
        (heading,) = [h for h in read.columns if h.partition(" [")[0] == name]
        np.testing.assert_allclose(read[heading], frame[name], rtol=1e-14, err_msg=name)
    with file.open(newline="", encoding="utf-8") as opened:
        assert next(csv.reader(opened))[:4] == ["time [s]", "utc", "phase", "altitude [m]"]


def test_parquet_is_read_by_another_library(returned: Solution, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="needs the extra 'export'")
    duckdb = pytest.importorskip("duckdb", reason=NEEDS)
    file = pl.export(returned, tmp_path / "flight.parquet", "parquet")
    rows = expected(returned)
    rows["time"] = rows["time"] + begins(returned)
    found = duckdb.sql(f"SELECT {', '.join(rows)} FROM read_parquet('{file}')").fetchall()
    for (name, values), column in zip(rows.items(), zip(*found, strict=True), strict=True):
        np.testing.assert_allclose(np.array(column, dtype=float), values, rtol=1e-15, err_msg=name)
    (phases,) = duckdb.sql(f"SELECT list(DISTINCT phase ORDER BY phase) FROM read_parquet('{file}')").fetchall()[0]
    assert phases == ["burn", "entry"]
    about = duckdb.sql(f"SELECT key, value FROM parquet_kv_metadata('{file}')").fetchall()
    told = json.loads({bytes(key): bytes(value) for key, value in about}[b"perilune"])
    assert told["epoch"].startswith(EPOCH) and "perilune" in told["source"]


@pytest.mark.filterwarnings("ignore")  # of times that the tables of astropy do not reach
def test_an_orbit_message_is_read_by_another_library(returned: Solution, tmp_path: Path) -> None:
    oem = pytest.importorskip("oem", reason=NEEDS)
    message = oem.OrbitEphemerisMessage.open(pl.export(returned, tmp_path / "flight.oem", "oem"))
    begin, epoch = 0.0, datetime.fromisoformat(EPOCH).replace(tzinfo=UTC)
    to_icrf, rate = axes_in_space("earth", epoch), returned.parameters.body_rotation_rate
    for k, segment in enumerate(message):
        states, duration = list(segment.states), returned.trajectories[k].duration
        assert {s.frame for s in states} == {"ICRF"} and {s.center for s in states} == {"EARTH"}
        assert segment.metadata["TIME_SYSTEM"] == "UTC" and segment.metadata["INTERPOLATION_DEGREE"] == 3
        seconds = np.array([(s.epoch - message_start(message)).sec for s in states])
        state = body_fixed(returned, k, np.clip(seconds - begin, 0.0, duration))
        turn = Rotation.from_rotvec(np.outer(rate * seconds, [0.0, 0.0, 1.0]))
        carried = state[:, 3:] + rate * np.cross([0.0, 0.0, 1.0], state[:, :3])
        for said, fixed in (([s.position for s in states], state[:, :3]), ([s.velocity for s in states], carried)):
            inertial = turn.apply(fixed) @ to_icrf.T
            # Times have nanoseconds, in which 8 km/s go 8e-6 m.
            np.testing.assert_allclose(1e3 * np.array(said), inertial, rtol=0, atol=1e-9 * np.abs(inertial).max())
        begin += duration
    middle = segment.states and next(iter(segment.states)).epoch
    assert segment(middle).position == pytest.approx(next(iter(segment.states)).position, rel=1e-12)


def test_a_longitude_goes_on_over_the_meridian_of_the_date(returned: Solution, tmp_path: Path) -> None:
    """By 246 deg to the east in two phases, where each table jumped by 359.5 deg; the same places as before."""
    pl.save(returned, tmp_path / "run")
    trajectories = [path.read_text() for path in sorted((tmp_path / "run").glob("trajectory_*.csv"))]
    frame = returned.to_dataframe()
    table = pl.export(returned, tmp_path / "x.csv", "csv").read_text()
    for texts in (trajectories, [table]):
        rows = [row for text in texts for row in csv.DictReader(text.splitlines())]
        east = np.array([float(row["longitude [deg]"]) for row in rows])
        np.testing.assert_allclose(east, frame["longitude"], rtol=1e-14)
    assert (np.diff(east) >= 0).all() and np.diff(east).max() < 2 and east[[0, -1]] == pytest.approx([16.0, 262.0])
    for k, trajectory in enumerate(returned.trajectories):
        fixed = body_fixed(returned, k, node_times(trajectory))
        here = frame[frame["phase"] == returned.problem.phases[k].name]
        turned = np.exp(1j * np.radians(here["longitude"])) * np.hypot(fixed[:, 0], fixed[:, 1])
        np.testing.assert_allclose(turned, fixed[:, 0] + 1j * fixed[:, 1], rtol=1e-9)


LEAP = "2016-12-31T23:57:00"  # 179 s before the last leap second that is known


@pytest.mark.filterwarnings("ignore")  # of times that the tables of astropy do not reach
def test_a_flight_over_a_leap_second_has_it_in_every_file(descent: Solution, tmp_path: Path) -> None:
    """Seconds between times, by a library that knows the leap seconds, are those of the model."""
    oem, time = pytest.importorskip("oem", reason=NEEDS), pytest.importorskip("astropy.time", reason=NEEDS)
    begin = time.Time(LEAP, scale="utc")
    files = {form: pl.export(descent, tmp_path / f"x.{form}", epoch=LEAP) for form in ("oem", "czml", "csv")}
    (segment,) = message = oem.OrbitEphemerisMessage.open(files["oem"])
    states = list(segment.states)
    seconds = np.array([(state.epoch - begin).sec for state in states])
    assert seconds[-1] == pytest.approx(descent.duration, abs=1e-6) and (np.diff(seconds) > 0).all()
    for inside in ("2016-12-31T23:59:60.000000", "2016-12-31T23:59:60.500000", "2017-01-01T00:00:00.000000"):
        at = time.Time(inside, scale="utc")
        here = (
            axes_in_space("moon", datetime.fromisoformat(LEAP).replace(tzinfo=UTC))
            @ descent.inertial(0, np.array([(at - begin).sec]))[0]
        )
        np.testing.assert_allclose(1e3 * np.array(segment(at).position), here[:, 0], rtol=0, atol=2e-3)
    comments = " ".join(message.header["COMMENT"]) if "COMMENT" in message.header else files["oem"].read_text()
    assert "leap second 2016-12-31T23:59:60" in comments
    _, vehicle, *_ = json.loads(files["czml"].read_text())
    first, last = (time.Time(end.removesuffix("Z"), scale="utc") for end in vehicle["availability"].split("/"))
    assert (last - first).sec == pytest.approx(descent.duration, abs=1e-8)
    rows = list(csv.reader(files["csv"].read_text().splitlines()))[1:]
    stamped = np.array([(time.Time(row[1], scale="utc") - begin).sec for row in rows])
    np.testing.assert_allclose(stamped, [float(row[0]) for row in rows], rtol=0, atol=1e-8)
    assert rows[0][1].startswith("2016-12-31") and rows[-1][1].startswith("2017-01-01")


@QUIET
def test_netcdf_says_which_seconds_it_counts(descent: Solution, tmp_path: Path) -> None:
    """By the CF conventions 1.12, 4.4.3: with no leap second inside dates are UTC, else lengths of time are right."""
    netcdf4 = pytest.importorskip("netCDF4", reason=NEEDS)
    for epoch, name, seconds in ((EPOCH, "UTC", "utc"), (LEAP, "UTC until a leap second", "none")):
        with netcdf4.Dataset(pl.export(descent, tmp_path / "x.nc", epoch=epoch, force=True)) as found:
            time = found["time"]
            assert (time.long_name, time.units_metadata) == (name, f"leap_seconds: {seconds}")
            assert time[-1] - time[0] == descent.duration
            assert ("2016-12-31T23:59:60" in getattr(time, "comment", "")) == (epoch == LEAP)


def test_the_clocks_of_spice_read_the_leap_second(descent: Solution, tmp_path: Path) -> None:
    spice = pytest.importorskip("spiceypy", reason=NEEDS)
    kernel = tmp_path / "leap.tls"
    kernel.write_text(
        "KPL/LSK\n\\begindata\nDELTET/DELTA_T_A = 32.184\nDELTET/K = 1.657D-3\nDELTET/EB = 1.671D-2\n"
        "DELTET/M = ( 6.239996D0 1.99096871D-7 )\nDELTET/DELTA_AT = ( 36, @2015-JUL-1 37, @2017-JAN-1 )\n\\begintext\n"
    )
    text = pl.export(descent, tmp_path / "x.oem", epoch=LEAP).read_text()
    stamps = [line.split()[0] for line in text.splitlines() if line[:3] == "201"]
    spice.furnsh(str(kernel))
    seconds = np.array([spice.utc2et(at) for at in stamps])
    spice.kclear()
    model = [leg.time for leg in legs(descent, tick=TICK)]
    # TDB goes ahead of TT and back by 1.7 ms in a year: by 1e-7 s in the flight.
    np.testing.assert_allclose(seconds - seconds[0], model[0], rtol=0, atol=1e-6)


def test_states_are_those_of_whole_microseconds(returned: Solution) -> None:
    """Rounded alone a time would be off by 4 mm of the way of a return; the ends lie beyond the phase by as much."""
    begin = 0.0
    for k, leg in enumerate(legs(returned, tick=TICK)):
        trajectory = returned.trajectories[k]
        assert np.abs(leg.time / TICK - np.round(leg.time / TICK)).max() < 1e-3 and (np.diff(leg.time) > 0.5e-6).all()
        assert abs(leg.time[0] - begin) < TICK and abs(leg.time[-1] - begin - trajectory.duration) < TICK
        r, v, _ = returned.inertial(k, np.clip(leg.time - begin, 0.0, trajectory.duration))
        beyond = np.linalg.norm(leg.position - r, axis=0)
        assert beyond[1:-1].max() == 0 and beyond.max() < 0.5e-6 * 1.01 * np.linalg.norm(v, axis=0).max()
        begin += trajectory.duration


def message_start(message: Any) -> Any:
    """Epoch of the first line of all."""
    return next(iter(next(iter(message)).states)).epoch


def test_the_iau_library_sees_the_vehicle_where_it_begins(returned: Solution, tmp_path: Path) -> None:
    erfa = pytest.importorskip("erfa", reason=NEEDS)
    line = next(
        row.split()
        for row in pl.export(returned, tmp_path / "flight.oem", "oem").read_text().splitlines()
        if row.startswith("2026") and "=" not in row
    )
    day = 2451545.0 + (datetime.fromisoformat(EPOCH) - datetime(2000, 1, 1, 12)).total_seconds() / 86400
    fixed = erfa.c2t06a(day, 69.184 / 86400, day, 0.0, 0.0, 0.0) @ (1e3 * np.array(line[1:4], dtype=float))
    longitude, latitude = erfa.c2s(fixed)  # of a round Earth, as in this paper
    assert np.degrees([longitude, latitude]) == pytest.approx([16.0, 39.5], abs=3e-4)


def test_cesium_finds_position_attitude_and_thrust(descent: Solution, returned: Solution, tmp_path: Path) -> None:
    czml3 = pytest.importorskip("czml3", reason=NEEDS)
    for solution, given in ((descent, EPOCH), (returned, None)):
        text = pl.export(solution, tmp_path / f"{solution.problem.name}.czml", "czml", epoch=given).read_text()
        _, vehicle, thrust = packets = json.loads(text)
        for packet in packets:
            czml3.Packet(**packet)  # refuses what the format does not have
        assert "<pre>body-fixed axes (FIXED); at the start of the flight they coincide" in vehicle["description"]
        assert vehicle["position"]["referenceFrame"] == "FIXED" and vehicle["position"]["epoch"].startswith(EPOCH)
        samples = np.array(vehicle["position"]["cartesianVelocity"]).reshape(-1, 7)
        tips = np.array(thrust["position"]["cartesianVelocity"]).reshape(-1, 7)
        turned = np.array(vehicle["orientation"]["unitQuaternion"]).reshape(-1, 5)
        begin = 0.0
        for k, trajectory in enumerate(solution.trajectories):
            inside = (samples[:, 0] >= begin) & (samples[:, 0] < begin + trajectory.duration)
            state = body_fixed(solution, k, samples[inside, 0] - begin)
            sizes = np.abs(state).max(axis=0)
            np.testing.assert_allclose(samples[inside, 1:], state, rtol=0, atol=1e-9 * sizes.max())
            arrows = tips[inside, 1:4] - samples[inside, 1:4]
            if "toward_x" in solution.problem.phases[k].control_names:
                along = solution.evaluate(k, samples[inside, 0] - begin)[1][:3].T
                lengths = np.linalg.norm(arrows, axis=1)
                np.testing.assert_allclose(arrows, along * lengths[:, None], atol=1e-9 * np.abs(samples).max())
                here = (turned[:, 0] >= begin) & (turned[:, 0] < begin + trajectory.duration)
                up = Rotation.from_quat(turned[here, 1:]).apply([0.0, 0.0, 1.0])
                np.testing.assert_allclose(up, solution.evaluate(k, turned[here, 0] - begin)[1][:3].T, atol=1e-9)
            else:
                assert not arrows.any() and not thrust["polyline"]["show"][k]["boolean"]
            begin += trajectory.duration


@pytest.mark.parametrize("turned", ["descent", "returned", "gated"])
def test_between_its_samples_cesium_turns_and_thrusts_as_it_is_flown(
    turned: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Attitude and arrow to 0.1 deg, up to the moment before a gate or a switch of the throttle, and behind it."""
    solution = request.getfixturevalue(turned)
    given = None if solution.problem.views.space.epoch else EPOCH
    _, vehicle, thrust = json.loads(pl.export(solution, tmp_path / "flight.czml", epoch=given).read_text())
    samples, tips = (np.array(packet["position"]["cartesianVelocity"]).reshape(-1, 7).T for packet in (vehicle, thrust))
    turns = np.array(vehicle["orientation"]["unitQuaternion"]).reshape(-1, 5)
    assert len(turns) < 0.1 * samples.shape[1] and all((np.diff(time) > 0).all() for time in (samples[0], turns[:, 0]))
    here, there = (CubicHermiteSpline(way[0], way[1:4].T, way[4:].T) for way in (samples, tips))
    attitude = Slerp(turns[:, 0], Rotation.from_quat(turns[:, 1:]))
    begin, scale = 0.0, []
    for k, trajectory in enumerate(solution.trajectories):
        jumps = np.unique([0.0, trajectory.duration, *times_around_switches(trajectory)[1]])
        t = np.linspace(0.0, trajectory.duration, 5001)
        t = np.concatenate(
            [t[np.abs(t[:, None] - jumps).min(axis=1) > JUMP], jumps[:-1] + 2 * JUMP, jumps[1:] - 2 * JUMP]
        )
        push = solution.inertial(k, t)[2].T
        if push.any():
            strength, at = np.linalg.norm(push, axis=1), begin + t
            flown = Rotation.from_rotvec(np.outer(-solution.parameters.body_rotation_rate * at, [0.0, 0.0, 1.0])).apply(
                push
            )
            arrow, up = there(at) - here(at), attitude(np.clip(at, *turns[[0, -1], 0])).apply([0.0, 0.0, 1.0])
            scale.append(np.linalg.norm(arrow, axis=1) / strength)
            for seen in (up, arrow / np.linalg.norm(arrow, axis=1)[:, None]):
                off = np.linalg.norm(seen - flown / strength[:, None], axis=1)
                assert np.degrees(off.max()) < 0.1, (trajectory.phase, t[off.argmax()])
        begin += trajectory.duration
    np.testing.assert_allclose(np.concatenate(scale), scale[0][0], rtol=1e-3)
