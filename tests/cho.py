"""Cho, Kim, Leeghim 2015, section 4, as a problem."""

from __future__ import annotations

from perilune.models import Body, Orbit, Retro, Vehicle, hybrid_landing
from perilune.problem import Problem

# Not printed by Cho et al. 2015; these reproduce every digit it prints.
CHO_MOON = Body(name="moon", gravitational_parameter=4902.7779e9, radius=1738.14e3, rotation_rate=2.6617e-6)


def cho_landing(retro_isp: float = 310.0, dry_mass: float | None = None) -> Problem:
    """Cho et al. 2015, section 4."""
    return hybrid_landing(
        Vehicle(mass=300.0, thrust=440.0, specific_impulse=310.0, standard_gravity=9.81, dry_mass=dry_mass),
        Retro(specific_impulse=retro_isp),
        Orbit(parking_altitude=100e3, perilune_altitude=15e3),
        CHO_MOON,
    )
