"""Units: text to SI, and nothing else that the text might ask for."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given, strategies as st

from perilune.core.errors import PeriluneError
from perilune.core.units import (
    _UNITS,
    Scales,
    dimension_text,
    exact_quantity,
    format_quantity,
    parse_quantity,
    parse_unit,
)


@pytest.mark.parametrize(
    ("text", "wanted", "value"),
    [
        ("15 km", "m", 15e3),
        ("4902.7779 km^3/s^2", "m^3/s^2", 4902.7779e9),
        ("4902.7779km**3/s**2", "m^3/s^2", 4902.7779e9),
        ("2.6617e-6 rad/s", "rad/s", 2.6617e-6),
        ("180 deg", "rad", math.pi),
        ("360 deg/day", "rad/s", 2 * math.pi / 86400),
        (" 1.5 t ", "kg", 1500.0),
        ("3 kN*s", "kg*m/s", 3000.0),
        ("-.5 m/s", "km/h", -0.5),
        ("0.25", "1", 0.25),
        ("72 km/h", "m/s", 20.0),
        ("4.5 g0", "m/s^2", 44.129925),
        ("1 g", "kg", 1e-3),
        ("100 lbf", "N", 444.82216152605),
        ("10 lb/ft^2", "kg/m^2", 48.8242763638305),
        ("2.5 kPa", "N/m^2", 2500.0),
        ("1 MW/m^2", "kg/s^3", 1e6),
        ("3 J/kg*K^-1", "m^2/s^2/K", 3.0),
        ("85 %", "1", 0.85),
        ("1.7415e-4 kg^0.5/m", "kg^0.5/m", 1.7415e-4),
        ("4 g^0.5", "kg^0.5", 4 * math.sqrt(1e-3)),
    ],
)
def test_a_quantity_becomes_si(text: str, wanted: str, value: float) -> None:
    assert parse_quantity(text, wanted) == pytest.approx(value, rel=1e-15)


# In SI, from the definitions: the SI brochure (2019), 3rd CGPM (1901), the yard and pound agreement (1959).
EACH = {
    "m": 1.0, "km": 1000.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048,
    "s": 1.0, "ms": 0.001, "min": 60.0, "h": 3600.0, "day": 86400.0,
    "kg": 1.0, "g": 0.001, "t": 1000.0, "lb": 0.45359237, "slug": 14.593902937206364,
    "N": 1.0, "kN": 1000.0, "MN": 1000000.0, "lbf": 4.4482216152605, "g0": 9.80665, "Pa": 1.0, "kPa": 1000.0,
    "J": 1.0, "kJ": 1000.0, "MJ": 1000000.0, "W": 1.0, "kW": 1000.0, "MW": 1000000.0,
    "K": 1.0, "%": 0.01, "rad": 1.0, "deg": 0.017453292519943295, "1": 1.0,
}  # fmt: skip


@pytest.mark.parametrize("name", _UNITS)
def test_each_unit_has_the_size_of_its_definition(name: str) -> None:
    assert parse_unit(name)[0] == pytest.approx(EACH[name], rel=1e-15)


def test_a_slug_is_exactly_that_of_its_definition() -> None:
    """One pound-force over one foot per second squared, which no decimal of a few digits is."""
    slug = Fraction(45359237 * 980665, 10**13) / Fraction(3048, 10**4)
    assert exact_quantity("2 slug") == (2 * slug, 0)
    assert exact_quantity("1 slug/ft^3") == (slug / Fraction("0.3048") ** 3, 0)
    assert exact_quantity("3 ft") == (Fraction("0.9144"), 0) and exact_quantity("1 slug^0.5") is None


@pytest.mark.parametrize(
    ("text", "wanted", "said"),
    [
        ("15", "m", "not a quantity"),
        ("", "m", "not a quantity"),
        ("km", "m", "not a quantity"),
        ("15 miles", "m", "not a unit"),
        ("9**9**9 m", "m", "not a unit"),
        ("2*3 m", "m", "not a unit"),
        ("15 km km", "m", "not a unit"),
        ("1 m^99999999", "m", "not a unit"),
        ("1 m//s", "m/s", "not a unit"),
        ("1 __import__('os')", "m", "not a unit"),
        ("1 m; import os", "m", "not a unit"),
        ("nan m", "m", "not finite"),
        ("-Inf m", "m", "not finite"),
        ("infinity m", "m", "not finite"),
        ("1e308 km", "m", "not finite"),
        ("nan", "m", "not a quantity"),
        ("information m", "m", "not a quantity"),
        ("30 meters", "m", 'try: write for example "100 m"'),
        ("30 degrees", "rad", 'did you mean "deg"'),
        ("30 Kgs", "kg", 'did you mean "kg"'),
        ("1e999 m", "m", "not finite"),
        ("15 kg", "m", "wrong dimension"),
        ("20 C", "K", "not a unit"),
        ("1 kg^0.3", "kg", "not a unit"),
        ("3 g", "m/s^2", "wrong dimension"),
        ("310 m/s", "s", "wrong dimension"),
        ("1 deg", "rad/s", "wrong dimension"),
        ("9" * 5000 + " m", "m", "not a quantity"),
    ],
)
def test_what_is_no_quantity_is_refused_with_its_reason(text: str, wanted: str, said: str) -> None:
    with pytest.raises(PeriluneError, match=said) as caught:
        parse_quantity(text, wanted)
    assert caught.value.got
    assert len(str(caught.value)) < 600


@given(st.text(max_size=200))
def test_any_text_is_a_finite_number_or_a_refusal(text: str) -> None:
    try:
        assert math.isfinite(parse_quantity(text, "m"))
    except PeriluneError:
        pass


@given(st.floats(-1e30, 1e30), st.sampled_from([("km", 1e3), ("m", 1.0), ("mm", 1e-3)]))
def test_a_written_number_is_read_back(value: float, length: tuple[str, float]) -> None:
    name, factor = length
    assert parse_quantity(f"{value!r} {name}", "m") == pytest.approx(value * factor, rel=1e-15)


@given(*[st.integers(-9, 9).map(lambda k: k / 2)] * 4)
def test_a_dimension_is_written_so_that_it_can_be_read(a: float, b: float, c: float, d: float) -> None:
    assert parse_unit(dimension_text((a, b, c, d))) == (1.0, (a, b, c, d))


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), 1e16, 1e-16, "3"])
def test_what_is_no_scale_is_refused(value: Any) -> None:
    with pytest.raises(PeriluneError, match="not a valid scale of a length") as caught:
        Scales(length=value)
    assert caught.value.expected == "1e-15 to 1e+15"


def test_scales_divide_what_has_their_dimension() -> None:
    scales = Scales(length=2.0, time=3.0, mass=5.0)
    assert scales.of("N") == pytest.approx(5.0 * 2.0 / 9.0)
    assert scales.of("km/s") == scales.of("m/s") == pytest.approx(2.0 / 3.0)
    assert scales.of("rad") == 1.0


def test_a_value_is_told_as_people_say_it() -> None:
    assert format_quantity(math.radians(30.0), "rad") == "30 deg"
    assert format_quantity(-0.6, "1") == "-0.6"
    assert format_quantity(1234.5678, "m", 4) == "1235 m"


def test_a_decimal_comma_is_called_by_its_name() -> None:
    """8,5 kN is 8.5 kN to half of the world, and no unit is misspelt there."""
    with pytest.raises(PeriluneError, match="a decimal point in place of the comma"):
        parse_quantity("8,5 kN", "N")
