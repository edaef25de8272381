"""Nodes of an atlas for other programs: read back by libraries that did not write them, the same to the last bit.

Last by its name: these libraries scatter the memory of a process, in which machine code is then made for anywhere.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from cho import cho_landing
from command_line import ROOT, read_json
from perilune import Family, FamilyPoint, sweep
from perilune.atlas.building import export as exporting
from perilune.atlas.building.build import build
from perilune.atlas.building.export import NodeTable, export
from perilune.atlas.building.merge import merge
from perilune.atlas.query.query import Atlas, open_atlas
from perilune.atlas.store.store import MANIFEST
from perilune.cli import run_command_line
from perilune.core import Outcome, PeriluneError
from perilune.scenario import load_file
from perilune.solve import solve

AXES = {"vehicle.thrust": (430.0, 440.0), "retro.specific_impulse": (290.0, 310.0)}
NEEDS = "needs the extra 'test'"


@pytest.fixture(scope="module")
def atlas(tmp_path_factory: pytest.TempPathFactory) -> Atlas:
    return open_atlas(build(cho_landing(), AXES, tmp_path_factory.mktemp("export") / "atlas", sample=2))


@pytest.fixture(scope="module")
def expected(atlas: Atlas) -> dict[str, np.ndarray]:
    """All columns, brick after brick."""
    parts = list(NodeTable(atlas).parts())
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def test_the_table_says_what_a_solve_from_nothing_says(atlas: Atlas, expected: dict[str, np.ndarray]) -> None:
    rows = sum(len(np.load(atlas.store.directory / line["nodes"]["file"])) for line in atlas.said.values())
    assert {len(values) for values in expected.values()} == {rows} == {NodeTable(atlas).rows}
    thrust, isp = expected["vehicle_thrust"], expected["retro_specific_impulse"]
    at = (thrust == 435.0) & (isp == 300.0) & (expected["answer"] == 1)
    best = np.nonzero(at)[0][expected["objective"][at].argmin()]
    alone = solve(cho_landing().with_given(vehicle_thrust=435.0, retro_specific_impulse=300.0), verify=0)
    assert expected["objective"][best] == pytest.approx(alone.objective, rel=1e-10)
    for name, value in alone.free.items():
        assert expected[name][best] == pytest.approx(value, rel=1e-9)
    step = 0.01
    ends = [
        solve(cho_landing().with_given(vehicle_thrust=435.0 + way * step, retro_specific_impulse=300.0), verify=0)
        for way in (-1, 1)
    ]
    slope = (ends[1].objective - ends[0].objective) / (2 * step)
    assert expected["slope_vehicle_thrust"][best] == pytest.approx(slope, rel=1e-6)
    assert "at its lower bound" in NodeTable(atlas).sheets[int(expected["sheet"][expected["retro_delta_v"] == 0.0][0])]
    assert {column.name: column.unit for column in NodeTable(atlas).columns}["slope_vehicle_thrust"] == "s^2/m"


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of a library compiled for another NumPy
def test_netcdf_is_read_by_another_library(atlas: Atlas, expected: dict[str, np.ndarray], tmp_path: Path) -> None:
    reader = pytest.importorskip("netCDF4", reason=NEEDS)
    file = export(atlas, tmp_path / "nodes.nc", "netcdf")
    with reader.Dataset(file) as found:
        found.set_auto_mask(False)
        assert set(found.variables) == set(expected)
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name][:], values)
            assert found[name].dtype == values.dtype
        assert found["objective"].units == "kg" and found["vehicle_thrust"].units == "N"
        assert "perilune" in found.source and "lander" in found.title and "2 of 2" in found.proofs
        assert json.loads(found.axes)["vehicle_thrust"] == [430.0, 440.0, "N"]
        assert json.loads(found.sheets) == NodeTable(atlas).sheets


@pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::DeprecationWarning")
def test_xarray_opens_it(atlas: Atlas, expected: dict[str, np.ndarray], tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray", reason=NEEDS)
    with xarray.open_dataset(export(atlas, tmp_path / "nodes.nc", "netcdf"), engine="scipy") as found:
        assert found["terms"].dims == ("node", "term", "unknown") and found["margin"].attrs["units"] == "1"
        best = found.where(found["answer"] == 1, drop=True)
        assert float(best["objective"].min()) == expected["objective"][expected["answer"] == 1].min()


def test_parquet_is_read_by_another_library(atlas: Atlas, expected: dict[str, np.ndarray], tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="needs the extra 'export'")
    duckdb = pytest.importorskip("duckdb", reason=NEEDS)
    file = export(atlas, tmp_path / "nodes.parquet", "parquet")
    names = ", ".join(expected)
    rows = duckdb.sql(f"SELECT {names} FROM read_parquet('{file}')").fetchall()
    for (name, values), found in zip(expected.items(), zip(*rows, strict=True), strict=True):
        np.testing.assert_array_equal(np.array(found, dtype=values.dtype), values, err_msg=name)
    about = duckdb.sql(f"SELECT key, value FROM parquet_kv_metadata('{file}')").fetchall()
    told = json.loads({bytes(key): bytes(value) for key, value in about}[b"perilune"])
    assert json.loads(told["sheets"]) == NodeTable(atlas).sheets and told["tolerance"] == "1e-09"


def test_charts_of_another_making_stand_beside_each_other(atlas: Atlas, tmp_path: Path) -> None:
    high = build(cho_landing(), {**AXES, "vehicle.thrust": (440.0, 445.0)}, tmp_path / "high", sample=0)
    both = open_atlas(merge(atlas.store.directory, high, tmp_path / "both"))
    parts = list(NodeTable(both).parts())
    sheet, chart = (np.concatenate([part[name] for part in parts]) for name in ("sheet", "chart"))
    assert set(chart) == {0, 1} and sheet[chart == 1].min() == len(both.charted[0].sheets)


def test_exports_that_cannot_be_made_are_refused(atlas: Atlas, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "nodes.nc"
    with pytest.raises(PeriluneError, match="no format"):
        export(atlas, file, "hdf5")
    with pytest.raises(PeriluneError, match="an atlas to export"):
        export("map", file, "netcdf")  # pyright: ignore[reportArgumentType]
    with pytest.raises(PeriluneError, match="cannot be written"):
        export(atlas, tmp_path / "nowhere" / "nodes.nc", "netcdf")
    with pytest.raises(PeriluneError, match="the ending of csv") as other:
        export(atlas, tmp_path / "nodes.csv")
    assert other.value.expected == "nodes.nc for netcdf or nodes.parquet for parquet"
    with pytest.raises(PeriluneError, match="the ending of netcdf"):
        export(atlas, file, "parquet")
    export(atlas, file)
    before = file.read_bytes()
    with pytest.raises(PeriluneError, match="already exists"):
        export(atlas, file, "netcdf")
    export(atlas, file, "netcdf", force=True)
    assert file.read_bytes() == before and os.listdir(tmp_path) == ["nodes.nc"]
    monkeypatch.setattr(exporting, "_LARGEST", 1000)
    with pytest.raises(PeriluneError, match="too large"):
        export(atlas, file, "netcdf", force=True)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(PeriluneError, match="pyarrow") as missing:
        export(atlas, tmp_path / "nodes.parquet", "parquet")
    assert "pip install 'perilune[export]'" in missing.value.advice
    assert file.read_bytes() == before and os.listdir(tmp_path) == ["nodes.nc"]


def test_damage_is_named_and_nothing_is_written(atlas: Atlas, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(atlas.store.directory, tmp_path / "copy"))
    damaged = copy / next(iter(atlas.said.values()))["nodes"]["file"]
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"x")
    with pytest.raises(PeriluneError, match=damaged.name):
        export(open_atlas(copy), tmp_path / "nodes.nc", "netcdf")
    lines = (copy / MANIFEST).read_text().splitlines(keepends=True)
    (copy / MANIFEST).write_text(lines[0])
    with pytest.raises(PeriluneError, match="nothing to export"):
        export(open_atlas(copy), tmp_path / "nodes.nc", "netcdf")
    assert os.listdir(tmp_path) == ["copy"]


def test_the_command_line_exports(atlas: Atlas, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place, file = str(atlas.store.directory), tmp_path / "nodes.nc"
    assert run_command_line(["atlas", "export", place, "--out", str(file), "--json"]) == 0
    assert read_json(capsys.readouterr().out)["bytes"] == file.stat().st_size
    assert run_command_line(["atlas", "export", place, "--out", str(file)]) == 2
    assert run_command_line(["atlas", "export", place, "--out", str(file), "--force"]) == 0
    assert run_command_line(["atlas", "export", place, "--out", str(file), "--force", "--format", "zarr"]) == 2
    assert run_command_line(["atlas", "export", place]) == 2
    assert run_command_line(["atlas", "export", str(tmp_path), "--out", str(tmp_path / "x")]) == 2


def test_a_family_is_a_data_set_over_its_parameters(tmp_path: Path) -> None:
    """Each value where its parameters are, by xarray; the same as of a member solved alone; through a file and back."""
    xarray, pandas = pytest.importorskip("xarray", reason=NEEDS), pytest.importorskip("pandas", reason=NEEDS)
    problem = cho_landing().with_given(retro_delta_v=0.0)
    thrusts, masses = [500.0, 440.0], [290.0, 310.0, 300.0]  # in no order
    family = sweep(problem, {"vehicle.thrust": thrusts, "vehicle.mass": masses}, verify=1)
    found, frame = family.to_xarray(), family.to_dataframe()
    assert found["propellant"].dims == ("vehicle_thrust", "vehicle_mass") and found["propellant"].shape == (2, 3)
    assert found["vehicle_thrust"].values.tolist() == thrusts and found["vehicle_mass"].values.tolist() == masses
    alone = solve(problem.with_given(vehicle_thrust=440.0, vehicle_mass=310.0), verify=1)
    here = found.sel(vehicle_thrust=440.0, vehicle_mass=310.0)
    for name, result in alone.results.items():
        factor = 180 / np.pi if result.unit == "rad" else 1.0
        assert float(here[name]) == pytest.approx(factor * result.value, rel=1e-9), name
    assert str(here["outcome"].values) == "PROVED" and int(here["verification_level"]) == 1
    assert found["vehicle_mass"].attrs["units"] == "kg" and found["propellant"].attrs["units"] == "kg"
    assert float(found["retro_delta_v"]) == 0.0 and found["retro_delta_v"].dims == ()
    found.to_netcdf(tmp_path / "family.nc", engine="netcdf4")
    with xarray.open_dataset(tmp_path / "family.nc", engine="netcdf4") as back:
        np.testing.assert_array_equal(back["propellant"], found["propellant"])
    assert found["propellant"].sortby("vehicle_mass").interp(vehicle_mass=295.0).shape == (2,)
    assert isinstance(frame, pandas.DataFrame) and len(frame) == 6
    row = frame[(frame["vehicle_thrust"] == 440.0) & (frame["vehicle_mass"] == 310.0)].iloc[0]
    assert row["propellant"] == float(here["propellant"]) and row["outcome"] == "PROVED"
    assert frame.attrs["units"]["vehicle_thrust"] == "N" and frame.attrs["given"]["retro_delta_v"] == (0.0, "m/s")


def test_points_that_are_no_grid_are_points_and_failures_are_kept() -> None:
    """A member that physics refuses has its reason and no number; one point of a grid may be missing, or come twice."""
    xarray = pytest.importorskip("xarray", reason=NEEDS)
    problem = cho_landing(dry_mass=30.0).with_given(retro_delta_v=0.0)
    points = [(440.0, 300.0), (500.0, 310.0), (20.0, 300.0)]
    family = sweep(problem, [{"vehicle.thrust": t, "vehicle.mass": m} for t, m in points])
    found = family.to_xarray()
    assert isinstance(found, xarray.Dataset) and dict(found.sizes) == {"point": 3}
    assert found["vehicle_thrust"].dims == ("point",) and found["vehicle_thrust"].values.tolist() == [
        440.0,
        500.0,
        20.0,
    ]
    assert np.isfinite(found["propellant"].values).tolist() == [True, True, False]
    assert str(found["outcome"].values[2]) == "INFEASIBLE" and "thrust" in str(found["message"].values[2])
    twice = sweep(problem, {"vehicle.thrust": [440.0, 440.0]}).to_xarray()
    assert dict(twice.sizes) == {"point": 2}
    one = sweep(problem, {"vehicle.thrust": [440.0, 450.0]}).to_xarray()
    assert dict(one.sizes) == {"vehicle_thrust": 2}


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_a_family_without_the_package_is_one_sentence(package: str, monkeypatch: pytest.MonkeyPatch) -> None:
    family = Family(problem=cho_landing(), parameters=("vehicle_thrust",), points=())
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(PeriluneError, match=package) as missing:
        family.to_dataframe() if package == "pandas" else family.to_xarray()
    assert missing.value.advice == "pip install 'perilune[export]'"


def test_angles_of_a_family_are_in_degrees() -> None:
    pytest.importorskip("xarray", reason=NEEDS)
    problem = load_file(ROOT / "examples" / "polar_descent.toml").problem
    refused = FamilyPoint(values=(np.radians(76.0),), solution=None, message="none", failure=Outcome.INFEASIBLE)
    family = Family(problem=problem, parameters=("site_latitude",), points=(refused,))
    found, frame = family.to_xarray(), family.to_dataframe()
    assert float(found["site_latitude"][0]) == pytest.approx(76.0) and found["site_latitude"].attrs["units"] == "degree"
    assert frame["site_latitude"].to_list() == pytest.approx([76.0])
    assert frame.attrs["units"] == {"site_latitude": "deg"}


def test_a_family_of_nothing_is_empty() -> None:
    pytest.importorskip("xarray", reason=NEEDS)
    family = Family(problem=cho_landing(), parameters=("vehicle_thrust",), points=(), interrupted=True)
    assert len(family.to_dataframe()) == 0 and dict(family.to_xarray().sizes) == {"point": 0}
