"""Celestial bodies: gravitational parameter, radius, rotation rate, each with its source. SI units."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any, ClassVar

from perilune.core import (
    RenamedAttribute,
    quantity,
    record,
    renamed_keywords,
    text_field,
)

# Of each harmonic alone: above 1/(n + 1) a pole would push away, and far below 0 another place on the surface.
_ZONAL: dict[int, dict[str, Any]] = {
    n: {"least": low, "most": high, "outside": "is more than a body has whose gravity attracts everywhere"}
    for n, low, high in ((2, -0.66, 0.33), (3, -0.25, 0.25), (4, -0.46, 0.2))
}
LIKE = 0.02  # of its radius and of its pull: constants of a body differ by less, from paper to paper
_SAME = 1e-3  # of its pull and its rotation; radii are those of the mean, the equator or a site


@renamed_keywords(air="surface_pressure")
@record("body")
class Body:
    """A spherical, uniformly rotating body with point-mass gravity."""

    name: str = text_field("moon", about="moon, mercury, mars, europa or ceres, in place of the quantities")
    gravitational_parameter: float = quantity("m^3/s^2", "4902.8 km^3/s^2", above=0.0, about="mu")
    radius: float = quantity("m", "1737.4 km", above=0.0, about="altitudes are above it")
    rotation_rate: float = quantity(
        "rad/s",
        "2.6617e-6 rad/s",
        hint="write rad/s or deg/s; the sidereal day T gives 360 deg / T",
        about="inertial (sidereal); negative is retrograde, 0 rad/s does not rotate",
    )

    surface_pressure: float = 0.0  # Pa, of the atmosphere; the equations of every model leave it out, and say so
    air: ClassVar[RenamedAttribute] = RenamedAttribute("surface_pressure")
    spoken: ClassVar[RenamedAttribute] = RenamedAttribute("display_name")
    titled: ClassVar[RenamedAttribute] = RenamedAttribute("heading")

    @property
    def display_name(self) -> str:
        """Return the name used in a sentence: the Moon, Mars; "the body" where it has no name of its own.

        The name of a known body with the size or the pull of another is given only as a name.
        """
        known = BODIES.get(self.name.lower())
        if known is not None and not self.resembles(known):
            return f"a body called {self.name}"
        name = self.name[:1].upper() + self.name[1:]
        return {"Moon": "the Moon", "Body": "the body"}.get(name, name)

    def resembles(self, other: Body) -> bool:
        """Return True if size and pull match another body's: Callisto has Mercury's size, but a third of its mass."""
        pairs = (self.radius, other.radius), (self.gravitational_parameter, other.gravitational_parameter)
        return all(abs(own - its) <= LIKE * abs(its) for own, its in pairs)

    @property
    def heading(self) -> str:
        """Return the same in addition to an answer, which must mention the air."""
        return f"{self.display_name}, without its atmosphere" if self.surface_pressure else self.display_name


@renamed_keywords(air="surface_pressure")
@record("body")
class OblateBody(Body):
    """A body and its second zonal harmonic."""

    j2: float = quantity(
        "1", "2.03e-4", **_ZONAL[2], default=0.0, hint="unnormalised; 0 for a sphere",
        about="second zonal harmonic, unnormalised; 0 for a sphere",
    )  # fmt: skip


@renamed_keywords(air="surface_pressure")
@record("body")
class Planet(OblateBody):
    """A body with further zonal harmonics, and an ellipsoid for its surface where it has a flattening."""

    name: str = text_field("earth", about="earth, in place of the quantities")
    gravitational_parameter: float = quantity("m^3/s^2", "398600.4418 km^3/s^2", above=0.0, about="mu")
    radius: float = quantity("m", "6378.137 km", above=0.0, about="altitudes are above it; that of the equator")
    rotation_rate: float = quantity("rad/s", "7.292115e-5 rad/s", about="inertial (sidereal); negative is retrograde")
    j2: float = quantity(
        "1", "1.0826e-3", **_ZONAL[2], default=0.0, about="second zonal harmonic, unnormalised"
    )  # fmt: skip
    j3: float | None = quantity(
        "1", "-2.53e-6", **_ZONAL[3], default=None, about="third zonal harmonic, unnormalised"
    )  # fmt: skip
    j4: float | None = quantity(
        "1", "-1.62e-6", **_ZONAL[4], default=None, about="fourth zonal harmonic, unnormalised"
    )  # fmt: skip
    flattening: float | None = quantity(
        "1", "3.353e-3", above=0.0, below=0.5, default=None,
        hint="1/298.257 for the Earth; omit it for a sphere",
        about="of the ellipsoid whose equatorial radius is body.radius; altitudes and latitudes are then geodetic",
    )  # fmt: skip


@record("body")
class UniformGravity:
    """Flat ground that does not turn, under gravity that is the same everywhere."""

    gravity: float = quantity(
        "m/s^2", "3.7114 m/s^2", above=0.0, most=300.0, hint="write it with its unit; the Earth has 9.8 m/s^2",
        about="uniform gravity over flat ground that does not rotate, in place of the others",
    )  # fmt: skip

    titled: ClassVar[RenamedAttribute] = RenamedAttribute("heading")

    @property
    def heading(self) -> str:
        """Return the name used in a sentence."""
        return f"flat ground under {self.gravity:g} m/s^2"


def with_j2(body: Body, j2: float) -> OblateBody:
    """The body with its second zonal harmonic.

    Parameters
    ----------
    body
        A sphere.
    j2
        Coefficient of the second zonal harmonic, unnormalised [1].
    """
    return OblateBody(**{f.name: getattr(body, f.name) for f in fields(Body)}, j2=j2)


def _sidereal_rate(days: float) -> float:
    return 2 * math.pi / (days * 86400.0)


# mu: JPL DE440 (Park et al. 2021) for planets' systems and the Moon, JPL satellite ephemerides for Europa,
# Dawn (Konopliv et al. 2018) for Ceres. Mean radii and rotation: IAU WGCCRE 2015 (Archinal et al. 2018). Air: NASA
# planetary fact sheets; those of Europa, Mercury and Ceres are no air to a lander.
MOON = Body(name="moon", gravitational_parameter=4.902800118e12, radius=1737.4e3, rotation_rate=2.6616995e-6)
MERCURY = Body(
    name="mercury", gravitational_parameter=2.2031868551e13, radius=2439.4e3, rotation_rate=_sidereal_rate(58.6461)
)
MARS = Body(
    name="mars",
    gravitational_parameter=4.282837362e13,
    radius=3389.5e3,
    rotation_rate=7.088218e-5,
    surface_pressure=636.0,
)
EUROPA = Body(
    name="europa", gravitational_parameter=3.20271e12, radius=1560.8e3, rotation_rate=_sidereal_rate(3.551181)
)
CERES = Body(name="ceres", gravitational_parameter=6.26274e10, radius=470.0e3, rotation_rate=1.923e-4)

BODIES = {body.name: body for body in (MOON, MERCURY, MARS, EUROPA, CERES)}

# WGS 84 and EGM 2008 (tide-free). Its air is that of the model that flies through it.
EARTH = Planet(
    name="earth", gravitational_parameter=3.986004418e14, radius=6378137.0, rotation_rate=7.292115e-5,
    j2=1.08262617e-3, j3=-2.5324105e-6, j4=-1.6198976e-6, flattening=1 / 298.257223563,
)  # fmt: skip
PLANETS = {EARTH.name: EARTH}


def matching_known_body(body: Body) -> Body | None:
    """The known body of this size and pull."""
    return next((known for known in BODIES.values() if body.resembles(known)), None)


def catalogue_name(body: Body) -> str:
    """Return the name under which other programs know a body: of the known one with its pull and turning, else its own.

    A model may leave out that the body turns. "" where its own is that of another.
    """
    known = {**BODIES, **PLANETS}
    like = next((name for name, one in known.items() if body.resembles(one) and _matches_known(body, one)), "")
    return like or ("" if body.name.lower() in known else body.name)


def _matches_known(body: Body, known: Body) -> bool:
    pulls = math.isclose(body.gravitational_parameter, known.gravitational_parameter, rel_tol=_SAME)
    return pulls and (body.rotation_rate == 0 or math.isclose(body.rotation_rate, known.rotation_rate, rel_tol=_SAME))


def recognise_body(body: Body) -> Body:
    """The body with the name and the air of the known one of its size and pull, if there is one."""
    like = matching_known_body(body)
    return replace(body, name=like.name, surface_pressure=like.surface_pressure) if like else body
