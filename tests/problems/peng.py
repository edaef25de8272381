"""The descent of Peng et al. 2012, as its printed numbers are read."""

from __future__ import annotations

from math import radians
from typing import Any

from perilune.models import Body, Ignition, Site, Steering, Vehicle, powered_descent
from perilune.problem import Problem

# Peng et al. 2012 (25)-(27) as decoded; mu is not printed, and the printed fuel needs g0 = 9.80.
PENG_MOON = Body(name="moon", gravitational_parameter=4902.8e9, radius=1738e3, rotation_rate=2.6617e-6)
LANDER = Vehicle(mass=15e3, thrust=45e3, specific_impulse=365.0, standard_gravity=9.80)
POLE = Ignition(
    altitude=15e3, longitude=0.0, latitude=radians(90), heading=radians(180), forward_speed=1694.3
)  # fmt: skip
SITE = Site(altitude=2e3, longitude=radians(5), latitude=radians(76))
PENG_STEERING = Steering(
    elevation=(radians(-50), radians(50)), azimuth=(radians(150), radians(220))
)  # fmt: skip


def peng(body: Body = PENG_MOON, start: Ignition = POLE, site: Site = SITE, **settings: Any) -> Problem:
    """The paper's descent."""
    return powered_descent(LANDER, start, site, body, **settings)
