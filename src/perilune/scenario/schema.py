"""The sections and keys of a scenario, each quantity with its unit, range and likely slip.

Errors in plain words.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from perilune.models.landing import STANDARD_GRAVITY
from perilune.outcome import PeriluneError
from perilune.problem import unknown_name
from perilune.scenario.quantity import LONGEST_VALUE, Quantity
from perilune.units import parse_quantity

MOST_STEPS = 10_000
# Cold gas has about 60 s and hydrogen with oxygen 465 s; exhaust velocities in m/s begin at several hundred.
SPECIFIC_IMPULSES = (20.0, 1000.0)


def _quantity(unit: str, example: str, **limits: Any) -> Any:
    return BeforeValidator(Quantity(unit, example, **limits))


_SpecificImpulse = Annotated[
    float,
    _quantity(
        "s",
        "310 s",
        low=SPECIFIC_IMPULSES[0],
        high=SPECIFIC_IMPULSES[1],
        hint="an exhaust velocity in m/s, divided by 9.80665 m/s^2, is the specific impulse in seconds",
    ),
]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class BodySection(_Section):
    """``[body]``: a name, or three quantities."""

    name: str | None = None
    gravitational_parameter: Annotated[float | None, _quantity("m^3/s^2", "4902.8 km^3/s^2", low=0.0)] = None
    radius: Annotated[float | None, _quantity("m", "1737.4 km", low=0.0)] = None
    rotation_rate: Annotated[
        float | None,
        _quantity(
            "rad/s", "2.6617e-6 rad/s", hint="write rad/s or deg/s; the sidereal day T gives 360 deg / T"
        ),
    ] = None


class VehicleSection(_Section):
    """``[vehicle]``: the lander before the retro burn."""

    mass: Annotated[float, _quantity("kg", "300 kg", low=0.0)]
    thrust: Annotated[float, _quantity("N", "440 N", low=0.0)]
    specific_impulse: _SpecificImpulse
    standard_gravity: Annotated[
        float,
        _quantity(
            "m/s^2",
            "9.80665 m/s^2",
            low=9.7,
            high=9.9,
            hint="leave it out: it turns seconds of specific impulse into m/s and is the same on every body",
        ),
    ] = STANDARD_GRAVITY
    dry_mass: Annotated[float | None, _quantity("kg", "120 kg", low=0.0)] = None


class RetroSection(_Section):
    """``[retro]``: the impulsive burn at the perilune."""

    specific_impulse: _SpecificImpulse
    delta_v: Annotated[
        float | None,
        _quantity(
            "m/s", "1200 m/s", low=0.0, above_low=False, hint="leave delta_v out and the best one is found"
        ),
    ] = None


class OrbitSection(_Section):
    """``[orbit]``: altitudes above the radius of the body."""

    parking_altitude: Annotated[float, _quantity("m", "100 km")]
    perilune_altitude: Annotated[float, _quantity("m", "15 km")]


class LandingSection(_Section):
    """``[landing]``: the site."""

    altitude: Annotated[float, _quantity("m", "0 km")] = 0.0


class Document(_Section):
    """The whole file."""

    body: BodySection
    vehicle: VehicleSection
    retro: RetroSection | None = None
    orbit: OrbitSection
    landing: LandingSection = LandingSection()


SECTIONS: dict[str, type[_Section]] = {
    "body": BodySection,
    "vehicle": VehicleSection,
    "retro": RetroSection,
    "orbit": OrbitSection,
    "landing": LandingSection,
}


def checked(document: Mapping[str, Any]) -> Document:
    """The sections of a tree, every quantity in SI.

    Raises
    ------
    PeriluneError
        For the first thing that is wrong, with its key.
    """
    try:
        return Document.model_validate(document)
    except ValidationError as error:
        raise _translated(error) from None


def quantity_of(key: str) -> Quantity:
    """How the text of a key such as ``"vehicle.thrust"`` is read.

    Raises
    ------
    PeriluneError
        If there is no such key or it is no quantity.
    """
    known = {
        f"{section}.{name}": validator.func
        for section, model in SECTIONS.items()
        for name, field in model.model_fields.items()
        for validator in field.metadata
        if isinstance(validator, BeforeValidator)
    }
    if key not in known:
        raise unknown_name("key with a quantity", key, list(known))
    found = known[key]
    assert isinstance(found, Quantity)
    return found


def values_of(key: str, text: str) -> list[float]:
    """Values in SI of ``"START:STOP:STEP"`` for a key; the unit may stand in each part or in the last only.

    STOP is included where a step meets it.

    Raises
    ------
    PeriluneError
        If it is no such range, has more than 10000 values, or the step leads away from STOP.
    """
    quantity, parts = quantity_of(key), [part.strip() for part in text[:LONGEST_VALUE].split(":")]
    if len(parts) != 3 or not all(parts):
        raise PeriluneError(
            f"the range of {key} must have three parts",
            got=repr(text[:60]),
            expected="START:STOP:STEP",
            advice=f'for example "{key}={quantity.example}:{quantity.example}:1 {quantity.unit}"',
        )
    last_unit = re.sub(r"^[-+\d.]+([eE][-+]?\d+)?\s*", "", parts[2])
    parts = [
        f"{part} {last_unit}" if re.fullmatch(r"[-+\d.]+([eE][-+]?\d+)?", part) else part for part in parts
    ]
    try:
        start, stop, step = quantity(parts[0]), quantity(parts[1]), parse_quantity(parts[2], quantity.unit)
    except PeriluneError as error:
        raise _named(key, error) from None
    steps = (stop - start) / step if step else math.inf
    if not 0 <= steps < 10_000:
        raise PeriluneError(
            f"the range of {key} has no end" if not step or steps < 0 else f"the range of {key} is too long",
            got=repr(text),
            expected="a step that leads from START to STOP in at most 10000 steps",
            advice="give the step the sign of STOP - START",
        )
    return [start + k * step for k in range(int(steps + 1e-9) + 1)]


def _translated(error: ValidationError) -> PeriluneError:
    """The first of pydantic's findings in this program's words.

    A misspelt key comes before what it leaves missing.
    """
    found = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = found[0]
    path = [str(part)[:60] for part in first["loc"]]
    key, kind = ".".join(path), first["type"]
    if kind == "extra_forbidden":
        fields = SECTIONS[path[0]].model_fields if len(path) > 1 else Document.model_fields
        unknown = unknown_name("key" if len(path) > 1 else "section", path[-1], list(fields))
        where = f" in [{path[0]}]" if len(path) > 1 else ""
        return PeriluneError(
            unknown.what + where, got=unknown.got, expected=unknown.expected, advice=unknown.advice
        )
    if kind == "missing":
        example = f'{path[-1]} = "{quantity_of(key).example}"' if len(path) > 1 else f"a section [{key}]"
        return PeriluneError(f"{key} is missing", expected=example, advice="compare with `perilune new`")
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, PeriluneError):
        return _named(key, cause)
    wanted = "a section" if kind in ("model_type", "model_attributes_type") else 'a text such as "moon"'
    return PeriluneError(f"{key} has the wrong type", got=str(first["input"])[:60], expected=wanted)


def _named(key: str, error: PeriluneError) -> PeriluneError:
    """The same error with the key in front."""
    what = error.what if error.what.startswith(("is ", "must ")) else f"- {error.what}"
    return PeriluneError(f"{key} {what}", got=error.got, expected=error.expected, advice=error.advice)
