"""Celestial bodies: gravitational parameter, radius, rotation rate, each with its source. SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass

from perilune.words.outcome import PeriluneError


@dataclass(frozen=True, kw_only=True)
class Body:
    """A spherical, uniformly rotating body with point-mass gravity.

    Parameters
    ----------
    gravitational_parameter
        mu [m^3/s^2].
    radius
        [m].
    rotation_rate
        Inertial (sidereal) rotation rate [rad/s]; negative is retrograde.
    """

    name: str
    gravitational_parameter: float
    radius: float
    rotation_rate: float

    def __post_init__(self) -> None:
        for what in ("gravitational_parameter", "radius"):
            value = getattr(self, what)
            if not (math.isfinite(value) and value > 0):
                raise PeriluneError(f"{what} of {self.name} must be positive", got=str(value), expected="> 0")
        if not math.isfinite(self.rotation_rate):
            raise PeriluneError(f"rotation_rate of {self.name} must be finite", got=str(self.rotation_rate))

    @property
    def surface_gravity(self) -> float:
        """mu/R^2 [m/s^2]."""
        return self.gravitational_parameter / self.radius**2


def _sidereal(days: float) -> float:
    return 2 * math.pi / (days * 86400.0)


# mu: JPL DE440 (Park et al. 2021) for planets' systems and the Moon, JPL satellite ephemerides for Europa,
# Dawn (Konopliv et al. 2018) for Ceres. Mean radii and rotation: IAU WGCCRE 2015 (Archinal et al. 2018).
MOON = Body(name="moon", gravitational_parameter=4.902800118e12, radius=1737.4e3, rotation_rate=2.6616995e-6)
MERCURY = Body(
    name="mercury", gravitational_parameter=2.2031868551e13, radius=2439.4e3, rotation_rate=_sidereal(58.6461)
)
MARS = Body(name="mars", gravitational_parameter=4.282837362e13, radius=3389.5e3, rotation_rate=7.088218e-5)
EUROPA = Body(name="europa", gravitational_parameter=3.20271e12, radius=1560.8e3, rotation_rate=_sidereal(3.551181))
CERES = Body(name="ceres", gravitational_parameter=6.26274e10, radius=470.0e3, rotation_rate=1.923e-4)

BODIES = {body.name: body for body in (MOON, MERCURY, MARS, EUROPA, CERES)}
