"""Bodies, vehicles and the problems made of them: landings, descents, returns from orbit.

The orbit before a return is `ReturnOrbit` here, and `Orbit` the one before a landing.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.models.catalogue import KINDS, key_of, kind_named, kind_names, one_line_error, unknown_kind
    from perilune.models.deorbit.opportunities import (
        DOUBTFUL,
        OUT_OF_REACH,
        REACHABLE,
        Opportunity,
        opportunities,
        refuse_no_opportunity,
    )
    from perilune.models.deorbit.orbit import AXIS, angles_of_place, plane_axes
    from perilune.models.deorbit.problem import deorbit_entry
    from perilune.models.deorbit.records import (
        Atmosphere,
        Heating,
        Interface,
        Landing,
        Limits,
        Manoeuvre,
        Parachute,
        Returner,
        ReturnOrbit,
        Separation,
        Transition,
    )
    from perilune.models.descent.problem import Ignition, Site, Steering, powered_descent
    from perilune.models.kind import PROOF, Kind, Section
    from perilune.models.landing.problem import LandingSite, Orbit, hybrid_landing
    from perilune.models.physics.atmosphere import Air
    from perilune.models.physics.bodies import (
        BODIES,
        CERES,
        EARTH,
        EUROPA,
        MARS,
        MERCURY,
        MOON,
        Body,
        Planet,
        UniformGravity,
        matching_known_body,
        recognise_body,
    )
    from perilune.models.physics.rotating_frame import (
        Triple,
        combine,
        cross_product,
        free_acceleration,
        heading_axes,
        local_axes,
        scalar_product,
        spherical_coordinates,
    )
    from perilune.models.physics.vehicle import Retro, Throttle, Vehicle
    from perilune.models.precision.final_descent import FinalDescent
    from perilune.models.precision.path_constraints import Corridor
    from perilune.models.precision.problem import Approach, precision_landing
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)

__all__ = [
    "BODIES",
    "CERES",
    "EARTH",
    "EUROPA",
    "MARS",
    "MERCURY",
    "MOON",
    "Air",
    "Approach",
    "Atmosphere",
    "Body",
    "Corridor",
    "FinalDescent",
    "Heating",
    "Ignition",
    "Interface",
    "Kind",
    "Landing",
    "Limits",
    "Manoeuvre",
    "Opportunity",
    "Orbit",
    "Parachute",
    "Planet",
    "Retro",
    "ReturnOrbit",
    "Returner",
    "Section",
    "Separation",
    "Site",
    "Steering",
    "Throttle",
    "Transition",
    "UniformGravity",
    "Vehicle",
    "deorbit_entry",
    "hybrid_landing",
    "opportunities",
    "powered_descent",
    "precision_landing",
]
