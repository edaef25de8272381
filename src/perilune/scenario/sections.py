"""The sections of a scenario and their keys: each quantity with its unit, an example, its range and likely slip.

``problem.kind`` says which sections a file has; without it the file states a landing from orbit.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict

from perilune.models.landing import STANDARD_GRAVITY
from perilune.scenario.quantity import Quantity

HYBRID = "hybrid_landing"
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
        _quantity("rad/s", "2.6617e-6 rad/s", hint="write rad/s or deg/s; the sidereal day T gives 360 deg / T"),
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
        _quantity("m/s", "1200 m/s", low=0.0, above_low=False, hint="leave delta_v out and the best one is found"),
    ] = None


class OrbitSection(_Section):
    """``[orbit]``: altitudes above the radius of the body."""

    parking_altitude: Annotated[float, _quantity("m", "100 km")]
    perilune_altitude: Annotated[float, _quantity("m", "15 km")]


class LandingSection(_Section):
    """``[landing]``: the site."""

    altitude: Annotated[float, _quantity("m", "0 km")] = 0.0


# -- descents in three dimensions


class ProblemSection(_Section):
    """``[problem]``: which one the file states; what the choices are, the model says."""

    kind: str = HYBRID


class DescentProblemSection(ProblemSection):
    """``[problem]`` of a powered descent."""

    coordinates: str = "cartesian"
    target: str = "site"
    minimise: str = "propellant"


class SpatialBodySection(BodySection):
    """``[body]`` with its oblateness."""

    j2: Annotated[float, _quantity("1", "2.03e-4", low=-1.0, high=1.0, hint="unnormalised; 0 for a sphere")] = 0.0


class StartSection(_Section):
    """``[start]``: where the powered descent begins, relative to the turning body."""

    altitude: Annotated[float, _quantity("m", "15 km")]
    longitude: Annotated[float, _quantity("rad", "0 deg")]
    latitude: Annotated[float, _quantity("rad", "90 deg")]
    heading: Annotated[float, _quantity("rad", "180 deg", hint="from north towards east")]
    forward_speed: Annotated[float, _quantity("m/s", "1694.3 m/s")]
    sideways_speed: Annotated[float, _quantity("m/s", "0 m/s")] = 0.0
    vertical_speed: Annotated[float, _quantity("m/s", "0 m/s")] = 0.0


class SiteSection(_Section):
    """``[site]``: where it ends."""

    altitude: Annotated[float, _quantity("m", "2 km")] = 0.0
    longitude: Annotated[float, _quantity("rad", "5 deg")]
    latitude: Annotated[float, _quantity("rad", "76 deg")]


class SteeringSection(_Section):
    """``[steering]``: bounds of the thrust direction."""

    elevation_lower: Annotated[float, _quantity("rad", "-50 deg")] = -math.pi / 2
    elevation_upper: Annotated[float, _quantity("rad", "50 deg")] = math.pi / 2
    azimuth_lower: Annotated[float, _quantity("rad", "150 deg")] = 0.0
    azimuth_upper: Annotated[float, _quantity("rad", "220 deg")] = 2 * math.pi


class ThrottleSection(_Section):
    """``[throttle]``: shares of full thrust."""

    lower: Annotated[float, _quantity("1", "0.3", low=0.0, high=1.0, above_low=False)]
    upper: Annotated[float, _quantity("1", "0.9", low=0.0, high=1.0, above_low=False)]


class ApproachSection(_Section):
    """``[approach]``: where a precision landing begins, from the site."""

    east: Annotated[float, _quantity("m", "-1800 m")]
    north: Annotated[float, _quantity("m", "300 m")]
    up: Annotated[float, _quantity("m", "1 km")]
    east_speed: Annotated[float, _quantity("m/s", "50 m/s")] = 0.0
    north_speed: Annotated[float, _quantity("m/s", "0 m/s")] = 0.0
    up_speed: Annotated[float, _quantity("m/s", "-30 m/s")] = 0.0


class CorridorSection(_Section):
    """``[corridor]``: what a precision landing keeps to."""

    tilt: Annotated[float, _quantity("rad", "50 deg")]
    slope: Annotated[float, _quantity("rad", "20 deg")]
    pad_radius: Annotated[float, _quantity("m", "10 m")] = 10.0


# -- whole files


class LandingDocument(_Section):
    """A landing from orbit."""

    problem: ProblemSection = ProblemSection()
    body: BodySection
    vehicle: VehicleSection
    retro: RetroSection | None = None
    orbit: OrbitSection
    landing: LandingSection = LandingSection()


class DescentDocument(_Section):
    """A powered descent in three dimensions."""

    problem: DescentProblemSection
    body: SpatialBodySection
    vehicle: VehicleSection
    start: StartSection
    site: SiteSection
    steering: SteeringSection | None = None
    throttle: ThrottleSection | None = None


class PrecisionDocument(_Section):
    """The last kilometres of a landing, in a corridor."""

    problem: ProblemSection
    body: SpatialBodySection
    vehicle: VehicleSection
    throttle: ThrottleSection
    approach: ApproachSection
    site: SiteSection
    corridor: CorridorSection


Document = LandingDocument | DescentDocument | PrecisionDocument
DOCUMENTS: dict[str, type[Document]] = {
    HYBRID: LandingDocument,
    "powered_descent": DescentDocument,
    "precision_landing": PrecisionDocument,
}


def sections_of(document: type[Document]) -> dict[str, type[_Section]]:
    """Sections of a kind of file, by name."""
    found = {}
    for name, field in document.model_fields.items():
        kinds = (field.annotation, *get_args(field.annotation))
        found[name] = next(k for k in kinds if isinstance(k, type) and issubclass(k, _Section))
    return found
