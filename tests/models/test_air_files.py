"""Files of air that state their own units: every shape gives the table in metres, and nothing stated is lost."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import perilune as pl
from command_line import ROOT, read_json
from perilune.cli import run_command_line
from perilune.core import NUMERIC, PeriluneError, unit_as_written
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.records import Interface, Returner, ReturnOrbit
from perilune.models.physics import atmosphere, standard_atmosphere
from perilune.models.physics.air_table import LARGEST_FILE, read_air_table
from perilune.models.physics.bodies import EARTH
from perilune.problem import preflight
from perilune.report.summary import solution_markdown, solution_summary
from perilune.scenario import load_file

ALTITUDE = np.arange(0.0, 142e3, 2e3)
DENSITY = standard_atmosphere.density(ALTITUDE)
# International foot and slug: lbf s^2/ft, of 0.45359237 kg, 9.80665 m/s^2 and 0.3048 m.
FOOT, SLUG = 0.3048, 0.45359237 * 9.80665 / 0.3048
PLAIN = [(repr(float(h)), repr(float(rho))) for h, rho in zip(ALTITUDE, DENSITY, strict=True)]


def in_units(length: float, density: float) -> list[tuple[str, str]]:
    """The table in units of so many metres and kg/m^3."""
    return [(repr(float(h / length)), repr(float(r / density))) for h, r in zip(ALTITUDE, DENSITY, strict=True)]


def text(rows: list[tuple[str, ...]], *above: str, by: str = ",", end: str = "\n") -> str:
    return "".join(line + end for line in (*above, *(by.join(row) for row in rows)))


def commas(rows: list[tuple[str, str]]) -> list[tuple[str, ...]]:
    return [tuple(cell.replace(".", ",") for cell in row) for row in rows]


FEET, KILOMETRES, SWAPPED = in_units(FOOT, 1.0), in_units(1e3, 1.0), [row[::-1] for row in PLAIN]
SHAPES: dict[str, str] = {
    "no heading": text(PLAIN),
    "heading": text(PLAIN, "altitude,density"),
    "brackets": text(FEET, "alt (ft),rho (kg/m^3)"),
    "square": text(KILOMETRES, "altitude [km],density [kg/m3]"),
    "suffix": text(in_units(FOOT, SLUG / FOOT**3), "altitude_ft,density_slug_ft3"),
    "suffix km": text(KILOMETRES, "alt_km,rho_kg_m3"),
    "slug": text(in_units(FOOT, SLUG / FOOT**3), "altitude (ft),density (slug/ft^3)"),
    "pound": text(in_units(FOOT, 0.45359237 / FOOT**3), "Altitude (feet),Density (lbm/ft3)"),
    "gram": text(in_units(1.0, 1e3), "altitude (m),density (g/cm^3)"),
    "gram of litre": text(in_units(1.0, 1e3), "altitude (m),density (g/cc)"),
    "cubic kilometre": text(in_units(1.0, 1e-9), "altitude (m),rho (kg/km^3)"),
    "negative power": text(KILOMETRES, "z [km],mass density [kg m-3]"),
    "superscript": text(KILOMETRES, "z [km],ρ [kg·m⁻³]"),
    "division": text(KILOMETRES, "h/km,rho/(kg/m^3)"),
    "per": text(KILOMETRES, "height in kilometres,density in kg per m3"),
    "capitals": text(FEET, "ALTITUDE (FT),DENSITY (KG/M^3)"),
    "units alone": text(KILOMETRES, "km,kg/m^3"),
    "units row": text(KILOMETRES, "altitude,density", "km,kg/m^3"),
    "units row in brackets": text(FEET, "altitude,density", "(ft),(kg/m^3)"),
    "units twice": text(FEET, "altitude (ft),density", "feet,kg/m3"),
    "semicolons": text(PLAIN, "altitude;density", by=";"),
    "decimal commas": text(commas(PLAIN), "Hoehe;Dichte", by=";"),
    "decimal commas and km": text(commas(KILOMETRES), "Höhe [km];Dichte [kg/m³]", by=";"),
    "decimal commas and tabs": text(commas(KILOMETRES), "altitude (km)\tdensity", by="\t"),
    "decimal commas and blanks": text(commas(KILOMETRES), "altitude_km density", by="  "),
    "tabs": text(PLAIN, "altitude\tdensity", by="\t"),
    "blanks": text(PLAIN, "altitude density", by="   "),
    "blanks and brackets": text(FEET, "alt (ft)  rho (kg/m^3)", by="  "),
    "indented": text([(f"  {a}", b) for a, b in PLAIN], "  altitude density", by=" "),
    "blanks behind commas": text(PLAIN, "altitude, density", by=", "),
    "quoted": text([(f'"{a}"', f'"{b}"') for a, b in FEET], '"altitude, (ft)","density"'),
    "index": text([(str(k), *row) for k, row in enumerate(PLAIN)], ",altitude,density"),
    "index of R": text([(f'"{k + 1}"', *row) for k, row in enumerate(FEET)], '"alt (ft)" "rho"', by=" "),
    "last comma": text([(*row, "") for row in PLAIN], "altitude,density,"),
    "last comma without heading": text([(*row, "") for row in PLAIN]),
    "descending": text(PLAIN[::-1], "altitude,density"),
    "descending feet": text(FEET[::-1], "altitude [ft],density"),
    "swapped": text(SWAPPED, "density [kg/m3],altitude [m]"),
    "swapped and descending": text([row[::-1] for row in KILOMETRES[::-1]], "rho,alt_km"),
    "further columns": text([(b, "250.0", a, "5") for a, b in FEET], "density,temperature (K),altitude (ft),layer"),
    "columns of text": text([(a, b, "layer, 1") for a, b in PLAIN], "altitude\tdensity\tlayer", by="\t"),
    "scale height": text([(a, "7.2", b) for a, b in PLAIN], "altitude,scale_height_km,density"),
    "number density": text([(a, "2e25", b) for a, b in PLAIN], "altitude,number density [1/m^3],density"),
    "comments": text(PLAIN, "# US 1976, up to 80 km", "# m, kg/m3", "altitude,density"),
    "units in a comment": text(KILOMETRES, "altitude,density", "# km, kg/m^3"),
    "heading of numpy": text(FEET, "# alt (ft),rho (kg/m^3)"),
    "heading of numpy by hand": text(FEET, "# alt (ft), rho (kg/m^3)", by=" "),
    "heading of MATLAB": text(KILOMETRES, "% altitude km, density kg/m3"),
    "negative power joined": text(KILOMETRES, "z [km],rho [kgm-3]"),
    "geopotential beside": text([(a, a, b) for a, b in PLAIN], "Z (m),H (m),rho (kg/m3)"),
    "capital": text(KILOMETRES, "H [km],rho"),
    "prose below": text([*PLAIN, ("# of the standard atmosphere to 140 km",)], "altitude,density"),
    "prose with units": text(FEET, "# altitudes in feet, densities in kg/m^3"),
    "prose beside units": text(FEET, "# of a table in km (to 140 km), density (g/cm3) changed", "alt (ft),rho [kg/m3]"),
    "prose of no unit": text(PLAIN, "# US 1976 to 80 km, then (as said in text) in steps of 2 km", "altitude,density"),
    "comments between": text([*PLAIN[:5], ("# here",), *PLAIN[5:]], "# first"),
    "empty lines": text([*PLAIN[:5], ("",), (" ",), *PLAIN[5:], ("",)], "", "altitude,density", ""),
    "rows of nothing": text([*FEET, ("", "")], "altitude (ft),density"),
    "Excel": text(FEET, "sep=;", "alt (ft);rho", by=";"),
    "Fortran": text([(a, f"{float(b):.17E}".replace("E", "D")) for a, b in PLAIN]),
    "returns": text(FEET, "altitude (ft),density", end="\r\n"),
    "old returns": text(FEET, "altitude (ft),density", end="\r"),
}  # fmt: skip


def in_file(folder: Path, content: str, name: str = "own.csv", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes(content.encode(encoding))
    return path


@pytest.mark.parametrize("content", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_every_shape_is_the_table_in_metres(tmp_path: Path, content: str, encoding: str) -> None:
    found = read_air_table(in_file(tmp_path, content, encoding=encoding))
    np.testing.assert_allclose(found.altitude, ALTITUDE, rtol=1e-15, atol=0.0)
    np.testing.assert_allclose(found.density, DENSITY, rtol=1e-15, atol=0.0)
    assert found.said.startswith(f"{len(ALTITUDE)} rows; altitude in ")


@pytest.mark.parametrize("name", ["no heading", "tabs", "descending", "swapped", "index", "comments", "quoted", "slug"])
def test_the_air_is_that_of_the_table_in_metres(tmp_path: Path, name: str) -> None:
    plain, other = (atmosphere.from_file(in_file(tmp_path, SHAPES[one])) for one in ("heading", name))
    p = SimpleNamespace(**{key: given.value for key, given in plain.given.items()})
    at = np.linspace(0.0, 140e3, 1001)
    np.testing.assert_allclose(other.density(at, p, NUMERIC), plain.density(at, p, NUMERIC), rtol=1e-12)
    assert (other.bottom, other.top) == (plain.bottom, pytest.approx(plain.top, rel=1e-15))


def test_what_was_read_is_said(tmp_path: Path) -> None:
    feet = [(str(1000 * k), repr(float(np.exp(-k / 24.0)))) for k in range(461)]
    said = read_air_table(in_file(tmp_path, text(feet, "alt (ft),rho (kg/m^3),T"[:-2]))).said
    assert said.startswith("461 rows; altitude in ft, 0 to 460 000 (0 to 140 208 m); density in kg/m^3, ")
    plain = read_air_table(in_file(tmp_path, SHAPES["no heading"])).said
    assert "altitude in m (no unit is stated), 0 to 140 000; density in kg/m^3 (no unit is stated), " in plain
    more = read_air_table(in_file(tmp_path, SHAPES["further columns"])).said
    assert more.endswith("; not used: temperature (K), layer")
    assert read_air_table(in_file(tmp_path, SHAPES["index"])).said.endswith("; not used: column 1")
    capital = read_air_table(in_file(tmp_path, SHAPES["capital"])).said
    assert "(H is read as geometric, not geopotential); density" in capital
    assert read_air_table(in_file(tmp_path, SHAPES["geopotential beside"])).said.endswith("; not used: H (m)")


@pytest.mark.parametrize(
    ("written", "meant"),
    [("kg/m3", "kg/m^3"), ("kg/m**3", "kg/m^3"), ("kg m^-3", "kg*m^-3"), ("kg.m-3", "kg*m^-3"),
     ("kgm-3", "kg/m^3"), ("kgm^-3", "kg/m^3"), ("kg*m^-3", "kg*m^-3"), ("gcm-3", "g/cm^3"), ("KM", "km"),
     ("feet", "ft"), ("kgm3", "kg/m^3"), ("slug_ft3", "slug/ft^3"), ("(kg / m3)", "kg/m^3"), ("Mm", None), ("MM", None),
     ("furlong", None), ("", None), ("kg//m3", None), ("m3/", None), ("9**9**9", None), ("1/m^3", None)],
)  # fmt: skip
def test_units_are_read_as_programs_write_them(written: str, meant: str | None) -> None:
    assert unit_as_written(written) == meant


REFUSED: dict[str, tuple[str, str]] = {
    "pressure": (text(PLAIN, "altitude_m,pressure_Pa"), "of the table of air is its density[\\s\\S]*pressure_Pa"),
    "pressure alone": (text(PLAIN, "altitude,pressure"), "is its density[\\s\\S]*'altitude', 'pressure'"),
    "temperature": (text(PLAIN, "altitude (km),temperature (K)"), "is its density[\\s\\S]*temperature"),
    "pressure in a row": (text(PLAIN, "altitude,density", "km,Pa"), "unit of the density cannot be read[\\s\\S]*'Pa'"),
    "no altitude": (text(PLAIN, "time (s),density"), "is its altitude[\\s\\S]*'time \\(s\\)'"),
    "pressure altitude": (text(PLAIN, "pressure altitude (ft),density"), "no altitude that can be read"),
    "logarithm": (text(PLAIN, "altitude [m],log10 density"), "no density that can be read[\\s\\S]*log10 density"),
    "number density": (text(PLAIN, "altitude (km),density (1/cm^3)"), "no density that can be read[\\s\\S]*1/cm"),
    "relative density": (text(PLAIN, "altitude (km),density ratio"), "no density that can be read"),
    "wrong dimension": (text(PLAIN, "altitude (kg),density (kg/m^3)"), "no altitude that can be read[\\s\\S]*kg"),
    "weight density": (text(PLAIN, "altitude,density (lbf/ft^3)"), "no density that can be read[\\s\\S]*lbf"),
    "unknown unit": (text(PLAIN, "altitude (furlong),density"), "no altitude that can be read[\\s\\S]*furlong"),
    "unknown suffix": (text(PLAIN, "altitude_kft,density"), "no altitude that can be read[\\s\\S]*altitude_kft"),
    "joined suffix": (text(PLAIN, "altitudeft,density"), "is its altitude[\\s\\S]*altitudeft"),
    "unknown unit in a comment": (text(PLAIN, "# altitude (furlong), density"), "no altitude that can be read"),
    "a unit in prose": (text(PLAIN, "# altitudes are in feet", "altitude,density"), "line 1 .* mentions ft, but no"),
    "units listed": (text(PLAIN, "# units: km, kg/m^3", "altitude,density"), "line 1 .* mentions km, but no"),
    "a column said": (text(PLAIN, "# column 1: altitude, km", "# column 2: density"), "line 1 .* mentions km, but no"),
    "an equation": (text(PLAIN, "# alt = km; rho = kg/m3"), "line 1 .* mentions km, but no"),
    "a unit as": (text(PLAIN, "# altitude given as kilometers.", "altitude,density"), "line 1 .* mentions km, but no"),
    "columns numbered": (text(PLAIN, "# 1:alt_km 2:rho"), "line 1 .* mentions km, but no"),
    "a unit below": (text([*PLAIN, ("# altitudes are in km",)], "altitude,density"), "line 73 .* mentions km, but no"),
    "a unit far above": (text(PLAIN, "# altitudes are in km", *["# and so on"] * 30), "line 1 .* mentions km, but no"),
    "long comments": (text(PLAIN, "#" + " " * 60_000 + "x"), "comments of the table of air are too long"),
    "a unit in brackets": (text(PLAIN, "# mine", "# density (g/cm^3)", "altitude [m],density"), "2 .* mentions g/cm"),
    "multiples": (text(PLAIN, "altitude (1000 ft),density"), "no altitude that can be read[\\s\\S]*1000 ft"),
    "powers of ten": (text(PLAIN, "altitude,density (10^-3 kg/m^3)"), "no density that can be read"),
    "share": (text(PLAIN, "altitude (km),rho/rho0"), "no density that can be read"),
    "two units": (text(PLAIN, "altitude (m) (ft),density"), "no altitude that can be read"),
    "units that clash": (text(PLAIN, "altitude (km),density", "ft,kg/m3"), "unit of the altitude[\\s\\S]*km, as its"),
    "unknown unit in a row": (text(PLAIN, "altitude,density", "furlong,kg/m3"), "unit of the altitude[\\s\\S]*furlong"),
    "geopotential": (text(PLAIN, "geopotential altitude (km),density"), "no altitude that can be read[\\s\\S]*R h/"),
    "two altitudes": (text([(a, *row) for a, row in zip("123", PLAIN, strict=False)], "altitude_km,alt_ft,rho"),
                      "more than one column of the table of air can be its altitude"),
    "two densities": (text([(*row, row[1]) for row in PLAIN], "z,rho,density [g/cm3]"), "more than one column"),
    "no headings": (text([(*row, "250") for row in PLAIN]), "line 1 of the table of air has 3 cells, and no headings"),
    "unknown headings": (text(PLAIN, "foo,bar"), "is its altitude[\\s\\S]*'foo', 'bar'"),
    "a title": (text(PLAIN, "Air of Mars in km", "altitude,density"), "line 1 of the table of air does not have one"
    " heading"),
    "more text": (text(PLAIN, "a", "b", "c,d"), "line 1 of the table of air is neither a heading"),
    "one heading": (text(PLAIN, "altitude"), "line 1 of the table of air does not have one heading for each"),
    "a footer": (text([*PLAIN, ("source: NASA",)], "altitude,density"), "line 73 of the table of air has 1 cells"),
    "a footer of two": (text([*PLAIN, ("source", "NASA")], "# x", "altitude,density"), "line 74 .* in column 1"),
    "a word": (text([*PLAIN[:3], ("6500", "thin"), *PLAIN[4:]], "altitude,density"), "line 5 .* no number in column 2"),
    "a hole": (text([*PLAIN[:3], ("6500", ""), *PLAIN[4:]], "altitude,density", "m,kg/m3"), "line 6 .* in column 2"),
    "short": (text([*PLAIN[:3], ("6500",), *PLAIN[4:]], "altitude,density"), "line 5 of the table of air has 1 cells"),
    "thousands": (text([("0", "1.225"), ("10,000", "0.41"), ("20,000", "0.09")], "altitude;density", by=";"),
                  "commas and points both occur in the numbers of the table of air: line 3"),
    "thousands alone": (text([("0", "1225"), ("10,000", "414"), ("20,000", "89")], "z [ft];density [g/m^3]", by=";"),
                        "may separate thousands or decimals: line 3[\\s\\S]*10000 or 10.000"),
    "thousands by points": (text([("0", "1.225"), ("1.000", "1.112"), ("2.000", "1")], "z;rho", by=";"),
                            "points in the numbers .* may separate thousands or decimals: line 2[\\s\\S]*1225 or"
                            " 1.2250"),
    "thousands by points alone": (text([("500", "9e-1"), ("1.000", "8e-1"), ("2.000", "7e-1")], "z [m];rho", by=";"),
                                  "may separate thousands or decimals: line 3[\\s\\S]*1000 or 1.0000"),
    "open quotes": (text([*PLAIN[:3], ('"6500', "0.4")], "altitude,density"), "line 5 .* is not a row"),
    "underscores": (text([("1_000", "0.4"), *PLAIN[1:]], "altitude,density"), "neither units nor numbers"),
    "no rows": ("altitude,density\n", "needs rows"),
    "nothing": ("", "needs rows"),
    "prose": ("This is a letter.\nIt has two lines, and no number.\n", "needs rows"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "said"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_air_is_refused_by_name(tmp_path: Path, content: str, said: str) -> None:
    with pytest.raises(PeriluneError, match=said):
        read_air_table(in_file(tmp_path, content))


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([*PLAIN[:3], PLAIN[2], *PLAIN[3:]], "do not increase at line 8"),
        ([*PLAIN[:3], ("6500", "0"), *PLAIN[4:]], "line 8 is not an altitude with a density"),
        ([*PLAIN[:3], ("6500", "nan"), *PLAIN[4:]], "line 8 is not an altitude with a density"),
        ([*PLAIN[:3], ("6500", "-1"), *PLAIN[4:]][::-1], r"line \d+ is not an altitude with a density"),
        ([*PLAIN[:3], ("inf", "0.1"), *PLAIN[4:]], "line 8 is not an altitude with a density"),
        (PLAIN[:2], "needs rows"),
        ([("0", "1"), ("1", "0.9"), ("2", "0.8"), ("1e5", "0.7"), ("2e5", "0.6")], "swings between line 8 and line 9"),
    ],
)
def test_errors_name_the_line_of_the_file(tmp_path: Path, rows: Any, said: str) -> None:
    """Comments, empty lines, headings and units count."""
    content = text(rows, "# mine", "", "altitude,density", "m,kg/m^3")
    with pytest.raises(PeriluneError, match=said):
        atmosphere.from_file(in_file(tmp_path, content))


def test_a_descending_file_names_its_own_lines(tmp_path: Path) -> None:
    rows = [*PLAIN[:3], ("6500", "0"), *PLAIN[4:]][::-1]
    with pytest.raises(PeriluneError, match=f"line {1 + len(rows) - 3} is not an altitude"):
        atmosphere.from_file(in_file(tmp_path, text(rows, "altitude,density")))


def test_a_large_file_and_another_encoding_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PeriluneError, match="too large"):
        read_air_table(in_file(tmp_path, "1,1\n" * (LARGEST_FILE // 4 + 1)))
    with pytest.raises(PeriluneError, match="not text in UTF-8"):
        read_air_table(in_file(tmp_path, f"{SHAPES['division']}# é", encoding="latin-1"))
    in_file(tmp_path, "").write_bytes(SHAPES["heading"].encode("utf-16")[:-1])  # ends within a character
    with pytest.raises(PeriluneError, match="not text in UTF-8"):
        read_air_table(tmp_path / "own.csv")


def test_points_before_three_digits_are_decimals_between_commas(tmp_path: Path) -> None:
    rows = [("1.500", "1.058"), ("3.000", "1.009"), ("4.500", "1.007")]
    read = read_air_table(in_file(tmp_path, text(rows, "altitude (km),density")))
    assert read.altitude.tolist() == [1500.0, 3000.0, 4500.0]


def test_headings_stand_far_above_too_and_decimals_of_three_digits_are_no_thousands(tmp_path: Path) -> None:
    far = text(FEET, "# altitude [ft], density [kg/m^3]", *["# and so on"] * 30)
    assert read_air_table(in_file(tmp_path, far)).altitude == pytest.approx([float(a) for a, _ in PLAIN])
    rows = [("1,500", "1,058"), ("3,000", "0,909"), ("4,500", "0,777")]  # 0,909 has no thousands
    read = read_air_table(in_file(tmp_path, text(rows, "altitude (km);density", by=";")))
    assert read.altitude.tolist() == [1500.0, 3000.0, 4500.0]
    assert read.density.tolist() == [1.058, 0.909, 0.777]


def test_whatever_stands_in_a_file_is_read_or_refused(tmp_path: Path) -> None:
    """Files of random pieces, of the shapes above torn apart, and of any bytes; one error only, and no long wait."""
    random = np.random.default_rng(41)
    pieces = ["\n", ",", ";", "\t", " ", '"', "#", "%", "(", ")", "[", "/", "^", "1", "2.5", "1,5", "-", "e9",
              "altitude", "density", "kg/m3", "ft", "km", "ρ", "\x00", "\x85", "\u2028", "nan", "10,000"]  # fmt: skip
    read = 0
    for _ in range(600):
        kind = random.integers(3)
        if kind == 0:
            content = "".join(random.choice(pieces, size=random.integers(1, 60)))
        else:
            content = str(random.choice(list(SHAPES.values())))
            for _ in range(random.integers(1, 3)):
                at = int(random.integers(min(len(content), 200)))
                content = content[:at] + str(random.choice(pieces)) + content[at + int(random.integers(3)) :]
        path = in_file(tmp_path, content)
        if kind == 2 and random.random() < 0.1:
            path.write_bytes(random.bytes(300))
        try:
            found = read_air_table(path)
        except PeriluneError:
            continue
        read += 1
        assert len(found.altitude) == len(found.density) == len(found.lines) > 0
    assert 10 < read < 590


# -- returns --------------------------------------------------------------------------------------------------------


def capsule(folder: Path, content: str) -> Path:
    """The return of a capsule through the air of a file."""
    in_file(folder, content)
    scenario = (ROOT / "examples" / "maps" / "capsule.toml").read_text(encoding="utf-8")
    air = scenario[scenario.index("[atmosphere]") : scenario.index("[site]")]
    changed = scenario.replace(air, '[atmosphere]\nmodel = "file"\nfile = "own.csv"\n\n')
    (folder / "capsule.toml").write_text(changed, encoding="utf-8")
    return folder / "capsule.toml"


def folders(tmp_path: Path, *names: str) -> list[Path]:
    found = [tmp_path / name for name in names]
    for one in found:
        one.mkdir()
    return found


def test_a_return_through_feet_is_that_through_metres(tmp_path: Path) -> None:
    in_metres, in_feet = (
        load_file(capsule(folder, SHAPES[shape])).problem
        for folder, shape in zip(folders(tmp_path, "m", "ft"), ("heading", "brackets"), strict=True)
    )
    metres = pl.solve(in_metres, verify=1)
    feet = pl.solve(in_feet, guess=metres, verify=1)  # where feet were metres, it would lead elsewhere
    assert feet.results["peak_load"].value == pytest.approx(8.03, abs=0.01)  # 101.8 where feet are taken as metres
    for name, result in metres.results.items():
        assert feet.results[name].value == pytest.approx(result.value, rel=1e-6), name
    pl.save(feet, tmp_path / "out")
    again = pl.load(tmp_path / "out")
    assert again.problem.views.inputs == feet.problem.views.inputs and "altitude in ft" in feet.problem.views.inputs[0]
    for said in (solution_markdown(again), solution_summary(feet)):
        assert "air of own.csv: 71 rows; altitude in ft, 0 to 459 318 (0 to 140 000 m)" in said


def test_check_says_what_was_read_and_what_is_unlike_the_standard(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    right, wrong = folders(tmp_path, "right", "wrong")
    assert run_command_line(["check", str(capsule(right, SHAPES["brackets"]))]) == 0
    out = capsys.readouterr().out
    assert "read       air of own.csv: 71 rows; altitude in ft" in out and "warning" not in out
    assert run_command_line(["check", str(capsule(wrong, text(FEET))), "--json"]) == 0
    document = read_json(capsys.readouterr().out)
    assert document["warnings"] and "no unit is stated" in document["inputs"][0]
    found = next(f for f in document["findings"] if "US Standard Atmosphere 1976" in f["name"])
    assert found["verdict"] == "warning" and found["value"] > 10 and "its file was read as 71 rows" in found["meaning"]


def test_air_of_another_body_is_not_compared(tmp_path: Path) -> None:
    """Only of the Earth there is a standard."""
    air = atmosphere.from_file(in_file(tmp_path, text(FEET)))
    orbit = ReturnOrbit(radius=EARTH.radius + 300e3, inclination=0.9, node_longitude=0.0, argument_of_latitude=0.0)
    vehicle = Returner(mass=500.0, thrust=400.0, exhaust_velocity=3000.0, drag_area=0.6)
    other = replace(EARTH, name="other", rotation_rate=0.5 * EARTH.rotation_rate)
    for body, compared in ((EARTH, True), (other, False)):
        problem = deorbit_entry(vehicle, orbit, Interface(altitude=120e3, angle=-0.05), body, air=air)
        found = [f for f in preflight(problem) if "US Standard Atmosphere 1976" in f.name]
        assert [f.verdict for f in found] == ["warning"] * compared


def test_a_table_in_km_without_a_heading_is_refused_with_what_was_read(tmp_path: Path) -> None:
    with pytest.raises(PeriluneError, match="ends before the flight does") as error:
        load_file(capsule(tmp_path, text(KILOMETRES)))
    assert "altitude in m (no unit is stated), 0 to 140" in error.value.advice
