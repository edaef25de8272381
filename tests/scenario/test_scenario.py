"""Scenario files: what they say is what is solved, and what cannot be right is refused by name."""

from __future__ import annotations

import copy
import itertools
import pickle
import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from perilune.core import InfeasibleError, PeriluneError
from perilune.models import MOON
from perilune.problem import Parameter, is_possible, preflight, refuse_impossible
from perilune.scenario import KINDS, load_file, load_text, quantities_of, template, values_of
from perilune.scenario.reader import names_of
from perilune.scenario.reference import reference
from perilune.scenario.text import LARGEST_FILE

EXAMPLES = Path(__file__).parents[2] / "examples"
HYBRID = EXAMPLES / "hybrid_lander.toml"
TEXT = HYBRID.read_text(encoding="utf-8")


KEYS = quantities_of(HYBRID)


def refused(*changes: str) -> PeriluneError:
    """The refusal of the example with changes."""
    with pytest.raises(PeriluneError) as caught:
        load_file(HYBRID, changes)
    return caught.value


def test_the_example_is_the_papers_lander() -> None:
    # Cho et al. 2015, with the constants that reproduce its digits.
    problem = load_file(HYBRID).problem
    given = {name: g.value for name, g in problem.given.items()}
    assert given == {
        "body_gravitational_parameter": pytest.approx(4902.7779e9, rel=1e-15),
        "body_radius": pytest.approx(1738.14e3, rel=1e-15),
        "body_rotation_rate": 2.6617e-6,
        "vehicle_mass": 300.0,
        "vehicle_thrust": 440.0,
        "vehicle_specific_impulse": 310.0,
        "vehicle_standard_gravity": 9.81,
        "retro_specific_impulse": 310.0,
        "orbit_parking_altitude": 100e3,
        "orbit_perilune_altitude": 15e3,
        "landing_altitude": 0.0,
    }
    assert problem.free_names == ("retro_delta_v", "flight_time")


def test_without_retro_the_landing_is_ordinary() -> None:
    problem = load_file(EXAMPLES / "ordinary_lander.toml").problem
    assert problem.given["retro_delta_v"].value == 0.0
    assert problem.free_names == ("flight_time",)


def test_delta_v_zero_fixes_the_burn() -> None:
    problem = load_file(HYBRID, ["retro.delta_v=0 m/s"]).problem
    assert problem.given["retro_delta_v"].value == 0.0


def test_a_body_by_name_and_defaults() -> None:
    problem = load_text(template())
    assert problem.given["body_radius"].value == MOON.radius
    assert problem.given["vehicle_standard_gravity"].value == 9.80665


def test_the_template_names_every_key() -> None:
    # The template with every comment sign before a key removed holds all keys of all sections of its kind.
    for kind in KINDS.values():
        written = re.findall(r"^(?:# )?(\w+) +?= |^(?:# )?\[(\w+)\]", template(kind.name), re.MULTILINE)
        known = [(key, "") for name, section in kind.in_file.items() for key in names_of(name, section)]
        assert sorted(pair for pair in written if pair[0]) == sorted(known)
        assert [section for key, section in written if section] == list(kind.in_file)


@pytest.mark.parametrize("kind", KINDS)
def test_a_template_states_its_problem(kind: str, tmp_path: Path) -> None:
    problem = load_text(template(kind))
    assert problem.name == kind
    assert is_possible(preflight(problem))
    advised = re.findall(r'--set "(.+)"', template(kind))  # of its own keys
    assert len(advised) == 1
    path = tmp_path / "new.toml"
    path.write_text(template(kind), encoding="utf-8")
    assert load_file(path, advised).problem.name == kind
    if kind == "deorbit_entry":  # where keys stand in place of others
        return
    # With every key in use it is read as well: the examples of what may be left out are values of their kind.
    whole = re.sub(r"^# (?=\[|\w+ = )", "", template(kind), flags=re.MULTILINE)
    whole = re.sub(r"^(gravitational_parameter|radius|rotation_rate|gravity) = .*\n", "", whole, flags=re.MULTILINE)
    assert set(problem.given) <= set(load_text(whole).given)


def test_each_key_of_a_return_may_be_used() -> None:
    """One by one: what is read, or stands in place of another key, or needs one beside it."""
    text, read, tried, head = template("deorbit_entry"), 0, 0, ""
    for line in text.splitlines():
        head = line if re.match(r"(# )?\[", line) else head
        if not re.match(r"# \w+ = ", line):
            continue
        used = text.replace(head, head.removeprefix("# ")).replace(line, line.removeprefix("# "))
        tried += 1
        try:
            load_text(used)
            read += 1
        except PeriluneError as error:
            known = "same quantity|replaces other|one or|quantities of its own|belongs to|and a|is missing"
            known += "|names no file|not below|exceeds|lift is un"
            assert re.search(known, error.what), error
    assert tried > 25 and read > 12


def test_an_unknown_kind_offers_the_nearest() -> None:
    with pytest.raises(PeriluneError, match="did you mean 'powered_descent'"):
        template("power_descent")


def test_a_value_keeps_the_text_it_was_stated_in() -> None:
    problem = load_file(HYBRID, ["vehicle.thrust=0.5 kN"]).problem
    assert problem.given["body_gravitational_parameter"].stated == "4902.7779 km^3/s^2"
    assert problem.given["vehicle_thrust"].stated == "0.5 kN"
    assert problem.given["landing_altitude"].stated == "0 km"
    changed = replace(problem.with_given(vehicle_mass=310.0), title="another")
    assert changed.given["vehicle_mass"].stated == ""
    assert changed.given["vehicle_thrust"].stated == "0.5 kN"
    assert copy.deepcopy(changed).given["vehicle_thrust"].stated == "0.5 kN"
    assert pickle.loads(pickle.dumps(changed)).given["vehicle_thrust"] == Parameter(
        value=500.0, unit="N", stated="0.5 kN"
    )
    assert all(type(g.value) is float for g in problem.given.values())
    assert load_file(HYBRID, ["retro.delta_v=1.2 km/s"]).problem.given["retro_delta_v"].stated == "1.2 km/s"


def test_the_reference_page_is_up_to_date() -> None:
    page = EXAMPLES.parent / "docs" / "reference.md"
    assert page.read_text(encoding="utf-8") == reference(), "python docs/make_reference.py"


def test_changes_are_in_the_text_that_is_kept() -> None:
    scenario = load_file(HYBRID, ["vehicle.thrust=500 N", 'landing.altitude="-1 km"', "vehicle.dry_mass=100 kg"])
    assert scenario.problem.given["vehicle_thrust"].value == 500.0
    assert scenario.problem.given["vehicle_dry_mass"].value == 100.0
    assert scenario.text is not None
    again = load_text(scenario.text)
    assert dict(again.given) == dict(scenario.problem.given)
    assert load_file(HYBRID).text == TEXT


def test_a_change_may_add_a_section() -> None:
    problem = load_file(EXAMPLES / "ordinary_lander.toml", ["retro.specific_impulse=300 s"]).problem
    assert problem.free_names == ("retro_delta_v", "flight_time")


@pytest.mark.parametrize(
    ("change", "what", "advice"),
    [
        ("vehicle.specific_impulse=3041 s", "vehicle.specific_impulse is out of range", "exhaust velocity"),
        ("vehicle.specific_impulse=3041 m/s", "vehicle.specific_impulse - the unit", "exhaust velocity"),
        ("retro.specific_impulse=3.041 s", "retro.specific_impulse is out of range", "exhaust velocity"),
        ("vehicle.thrst=3 N", "no key of this name in [vehicle]", "'thrust'"),
        ("vehicle.Thrust=3 N", "no key of this name in [vehicle]", "'thrust'"),
        ("vehicel.thrust=3 N", "no section of this name", "'vehicle'"),
        ("vehicle.mass=300", "vehicle.mass - this is not a quantity", "quotes"),
        ("vehicle.mass=nan kg", "vehicle.mass - the value is not finite", "plausible magnitude"),
        ("vehicle.mass=-300 kg", "vehicle.mass is out of range", ""),
        ("vehicle.mass=0 kg", "vehicle.mass is out of range", ""),
        ("vehicle.mass=300 stone", "vehicle.mass - this is not a unit", ""),
        ("vehicle.mass=9**9**9 m", "vehicle.mass - this is not a unit", ""),
        ("vehicle.mass=300 g", "vehicle.thrust is more than a lander withstands", "g in place of kg"),
        ("vehicle.thrust=1e-12 N", "vehicle.thrust is too small for a lander", "N in place of kN"),
        ("vehicle.thrust=440 kN", "vehicle.thrust is more than a lander withstands", "kN in place of N"),
        ("vehicle.dry_mass=300 kg", "vehicle.dry_mass leaves no propellant", ""),
        ("vehicle.standard_gravity=1.62 m/s^2", "vehicle.standard_gravity is out of range", "omit it"),
        ("body.radius=1738.14 m", "do not belong together", "m in place of km"),
        ("body.radius=1738140 km", "do not belong together", "km in place of m"),
        ("body.gravitational_parameter=4902.8 m^3/s^2", "do not belong together", "m in place of km"),
        ("body.rotation_rate=1.52504e-4 rad/s", "mixes degrees and radians", "deg/s"),
        ("body.rotation_rate=2.6617e-6 deg/s", "mixes degrees and radians", "deg/s"),
        ("body.rotation_rate=13.2 rad/s", "exceeds the break-up rate", "deg/s"),
        ("body.rotation_rate=-13.2 rad/s", "exceeds the break-up rate", "deg/s"),
        ("body.rotation_rate=13.2 deg", "body.rotation_rate - the unit has the wrong dimension", "deg/s"),
        ("body.name=mars", "a name and quantities", "omit"),
        ("orbit.perilune_altitude=15 m", "lower than the terrain", "m in place of km"),
        ("orbit.parking_altitude=100000 km", "no longer rules the flight", "km in place of m"),
        ("orbit.parking_altitude=100 m", "lower than the terrain", "m in place of km"),
        ("landing.altitude=-2000 km", "deeper than any valley", "km in place of m"),
        ("vehicle.mass=1e999 kg", "not finite", "plausible magnitude"),
        ("vehicle.mass=-inf kg", "not finite", "plausible magnitude"),
        ("vehicle.mass=300 s", "wrong dimension", "write it in kg, or"),
        ("landing.altitude=30 degrees", "not a unit", 'did you mean "deg"'),
        ("vehicle.mass=300 stones", "not a unit", 'write for example "300 kg"'),
        ("vehicle.mass=" + "9" * 300 + " kg", "too long", "only a number and a unit"),
        ("retro.delta_v=-1 m/s", "retro.delta_v is out of range", ""),
        ("thrust=3 N", "this is not a change", "vehicle.thrust"),
        ("vehicle.thrust", "this is not a change", "vehicle.thrust"),
    ],
)
def test_a_slip_is_named_with_what_to_try(change: str, what: str, advice: str) -> None:
    error = refused(change)
    assert what in error.what
    assert advice in error.advice
    assert error.expected
    assert error.advice
    assert error.exit_code == 2


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ("orbit.perilune_altitude=-15 km", "below the surface"),
        ("orbit.perilune_altitude=0 km", "below the surface"),
        ("orbit.perilune_altitude=150 km", "above the parking orbit"),
        ("landing.altitude=20 km", "below the landing site"),
    ],
)
def test_an_impossible_orbit_is_infeasible(change: str, what: str) -> None:
    with pytest.raises(InfeasibleError, match=what):
        refuse_impossible(preflight(load_file(HYBRID, [change]).problem))


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('mass = "300 kg"', "mass = 300", "vehicle.mass must be a number and a unit in quotes"),
        ('mass = "300 kg"', "mass = nan", "vehicle.mass must be a number and a unit in quotes"),
        ('mass = "300 kg"', 'mass = ["300 kg"]', "vehicle.mass must be a number and a unit in quotes"),
        ('mass = "300 kg"', "", "vehicle.mass is missing"),
        ('mass = "300 kg"', 'mass = "300 kg" # kg\nmas = "3 kg"', "no key of this name in [vehicle]"),
        ('mass = "300 kg"', 'mass = "' + "0" * 250 + '1 kg"', "vehicle.mass the text is too long"),
        ("[landing]", "[lander]", "no section of this name"),
        ("[landing]\n", "[landing]\nsites.north = 1\n", "no key of this name in [landing]"),
        ("[vehicle]", "[vehicle", "not valid TOML"),
        ('radius = "1738.14 km"', "", "body.radius is missing"),
        ("[body]", '[body]\nname = "moon"', "a name and quantities"),
        ("[body]", "[body]\nname = 3", "body.name has the wrong type"),
    ],
)
def test_a_file_that_is_wrong_is_refused(old: str, new: str, what: str) -> None:
    assert old in TEXT
    with pytest.raises(PeriluneError) as caught:
        load_text(TEXT.replace(old, new))
    assert what in caught.value.what.replace(" - ", " ")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "empty"),
        ("# nothing\n", "empty"),
        ("body = 3\nvehicle = 3\norbit = 3\n", "wrong type"),
        ("x = " + "[" * 20_000 + "]" * 20_000, "too long"),
        ("x = " + "[\n" * 20_000 + "]" * 900, "nested too deeply"),
        ("x = " + "{y = " * 150 + "1" + "}" * 150, "nested too deeply"),
        (".".join("a" * 400) + " = 1", "no section of this name"),
        ("x = " + "9" * 900, "no section of this name"),
        ("a = 1\n" * 3, "not valid TOML"),
        (
            "[body]\nname = 'earth'\n[vehicle]\nmass='3 kg'\nthrust='3 N'\nspecific_impulse='300 s'\n"
            "[orbit]\nparking_altitude='9 km'\nperilune_altitude='8 km'",
            "no body of this name",
        ),
    ],
)
def test_a_hostile_or_empty_text_is_refused(text: str, what: str) -> None:
    with pytest.raises(PeriluneError) as caught:
        load_text(text)
    assert what in caught.value.what
    assert len(str(caught.value)) < 1000


def test_files_that_are_none(tmp_path: Path) -> None:
    for path, what in (
        (tmp_path / "none.toml", "no scenario file"),
        (tmp_path, "not a file"),
        (Path("/dev/zero"), "file"),
    ):
        with pytest.raises(PeriluneError, match=what):
            load_file(path)
    path = tmp_path / "large.toml"
    path.write_bytes(b"#" * (LARGEST_FILE + 1))
    with pytest.raises(PeriluneError, match="too large"):
        load_file(path)
    path.write_bytes(b"\xff[body]")
    with pytest.raises(PeriluneError, match="UTF-8") as caught:
        load_file(path)
    assert caught.value.expected and caught.value.advice


def test_a_line_that_is_too_long_is_counted() -> None:
    with pytest.raises(PeriluneError, match="3005 characters, 3004 in a line"):
        load_text("\nx = " + "[" * 1500 + "]" * 1500)


def test_a_byte_order_mark_and_windows_lines_are_read(tmp_path: Path) -> None:
    path = tmp_path / "windows.toml"
    path.write_bytes(b"\xef\xbb\xbf" + TEXT.replace("\n", "\r\n").encode())
    assert dict(load_file(path).problem.given) == dict(load_file(HYBRID).problem.given)


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=300))
def test_any_text_is_a_problem_or_a_refusal(text: str) -> None:
    with pytest.raises(PeriluneError):
        load_text(text)


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_file_with_one_line_damaged_is_a_problem_or_a_refusal(data: st.DataObject) -> None:
    lines = TEXT.split("\n")
    k = data.draw(st.integers(0, len(lines) - 1))
    lines[k] = data.draw(st.text(max_size=60))
    try:
        load_text("\n".join(lines))
    except PeriluneError as error:
        assert error.what


@pytest.mark.parametrize(
    ("change", "meant"),
    [
        ("orbit.apolune_altitude=100 km", "parking_altitude"),
        ("orbit.periapsis_altitude=15 km", "perilune_altitude"),
        ("vehicle.isp=310 s", "specific_impulse"),
        ("vehicle.wet_mass=300 kg", "mass"),
        ("vehicle.empty_mass=100 kg", "dry_mass"),
    ],
)
def test_another_name_of_a_key_is_understood(change: str, meant: str) -> None:
    assert refused(change).advice == f"did you mean {meant!r}?"


def test_what_the_parking_altitude_is_stands_where_it_is_stated() -> None:
    assert "apolune" in next(line for line in template().splitlines() if line.startswith("parking_altitude"))
    assert "apolune" in reference()


def test_a_message_names_the_template_of_its_kind() -> None:
    polar = EXAMPLES / "polar_descent.toml"
    with pytest.raises(PeriluneError, match="`perilune new powered_descent`"):
        load_text(polar.read_text(encoding="utf-8").partition("[start]")[0])
    with pytest.raises(PeriluneError, match="KIND`, hybrid_landing or powered_descent or precision_landing"):
        load_text("[vehicle")


def test_the_example_says_how_it_lands() -> None:
    text = (EXAMPLES / "precision_landing.toml").read_text(encoding="utf-8")
    assert "steeper" not in text and "47 deg from the vertical" in text


def test_the_range_of_a_sweep() -> None:
    assert values_of("retro.specific_impulse", "310s:300s:-5s", KEYS) == [310.0, 305.0, 300.0]
    assert values_of("retro.delta_v", "0:100:50 m/s", KEYS) == [0.0, 50.0, 100.0]
    assert values_of("orbit.perilune_altitude", "10 km : 12 km : 1000 m", KEYS) == [10e3, 11e3, 12e3]
    tenths = values_of("vehicle.mass", "1:2:0.1 kg", KEYS)
    assert len(tenths) == 11
    assert all(b > a for a, b in itertools.pairwise(tenths))


def test_the_list_of_a_sweep() -> None:
    """In its own order; the last unit is that of every part without one."""
    assert values_of("vehicle.thrust", "2800,3200,4400 N", KEYS) == [2800.0, 3200.0, 4400.0]
    assert values_of("vehicle.thrust", "4.4 kN, 2800 N,3.2kN", KEYS) == [4400.0, 2800.0, 3200.0]
    assert values_of("retro.delta_v", "1e3, 0 m/s", KEYS) == [1000.0, 0.0]


@pytest.mark.parametrize(
    ("key", "text", "what"),
    [
        ("vehicle.thrust", "2800,,4400 N", "the values of vehicle.thrust are not a list"),
        ("vehicle.thrust", "2800,4400 N,", "the values of vehicle.thrust are not a list"),
        ("vehicle.thrust", "2800,3200:4400:100 N", "the values of vehicle.thrust are not a list"),
        ("vehicle.thrust", ",".join(map(str, range(1, 6000))) + " N", "the values of vehicle.thrust are not a list"),
        ("vehicle.thrust", "2800,4400", "vehicle.thrust - this is not a quantity"),
        ("vehicle.thrust", "2800 m,4400 N", "wrong dimension"),
        ("vehicle.thrust", "2800,nan N", "not finite"),
        ("vehicle.thrust", "2800,-1 N", "vehicle.thrust is out of range"),
        ("vehicle.thrust", "2800,4400,2.8e3 N", "occurs twice in its list"),
        ("vehicle.thrust", "2800 N, 2.8 kN", "occurs twice in its list"),
        ("vehicle.thrust", "1 2,3 N", "vehicle.thrust - this is not a unit"),
        ("vehicle.thrust", "1:2:1 " + 300 * "N", "three parts"),
        ("vehicle.thrus", "1,2 N", "no key"),
    ],
)
def test_a_list_that_is_none_is_refused(key: str, text: str, what: str) -> None:
    with pytest.raises(PeriluneError, match=re.escape(what)) as caught:
        values_of(key, text, KEYS)
    assert what == "no key" or "retro.delta_v=0,400,1600 m/s" in caught.value.advice


@pytest.mark.parametrize(
    ("key", "text", "what"),
    [
        ("retro.delta_v", "nan:100:1 m/s", "retro.delta_v - the value is not finite"),
        ("retro.delta_v", "0:100", "three parts"),
        ("retro.delta_v", "", "three parts"),
        ("retro.delta_v", "0:100:-50 m/s", "no end"),
        ("retro.delta_v", "0:100:0 m/s", "no end"),
        ("retro.delta_v", "0:1e9:1e-3 m/s", "too long"),
        ("retro.delta_v", "0:100:50", "retro.delta_v - this is not a quantity"),
        ("retro.delta_v", "0:100:50 kg", "wrong dimension"),
        ("vehicle.specific_impulse", "300:3000:100 s", "out of range"),
        ("vehicle.thrus", "1:2:1 N", "no key"),
        ("body.name", "1:2:1", "no key"),
    ],
)
def test_a_range_that_is_none_is_refused(key: str, text: str, what: str) -> None:
    with pytest.raises(PeriluneError, match=re.escape(what)) as caught:
        values_of(key, text, KEYS)
    # Not what a scenario should say there, such as to leave the key out.
    if what != "no key":
        assert any(word in caught.value.advice for word in ("START", "larger step", "0:1600:50 m/s"))
