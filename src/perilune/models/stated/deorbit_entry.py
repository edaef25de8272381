"""Statement of a return from orbit in a file."""

from __future__ import annotations

from perilune.models.deorbit import records as deorbit
from perilune.models.kind import Kind, Section
from perilune.models.physics.bodies import PLANETS, Planet
from perilune.models.physics.vehicle import Throttle
from perilune.problem import Problem


def _make_deorbit(
    problem: deorbit.Aim,
    body: Planet,
    orbit: deorbit.ReturnOrbit,
    manoeuvre: deorbit.Manoeuvre | None,
    vehicle: deorbit.Returner,
    throttle: Throttle | None,
    transition: deorbit.Transition,
    interface: deorbit.Interface,
    atmosphere: deorbit.Atmosphere | None,
    separation: deorbit.Separation | None,
    heating: deorbit.Heating | None,
    limits: deorbit.Limits | None,
    parachute: deorbit.Parachute | None,
    site: deorbit.Landing | None,
) -> Problem:
    from perilune.models.deorbit.problem import deorbit_entry

    return deorbit_entry(
        vehicle, orbit, interface, body, manoeuvre=manoeuvre, transition=transition, air=atmosphere, site=site,
        heating=heating, separation=separation, limits=limits, minimise=problem.minimise,
        epoch=problem.epoch, parachute=parachute, throttle=throttle,
    )  # fmt: skip


STATED = Kind(
    name="deorbit_entry",
    about="From an orbit by a finite burn to the entry interface, and through the atmosphere to a site.",
    sections={
        "problem": Section(record=deorbit.Aim),
        "body": Section(record=Planet, known=PLANETS),
        "orbit": Section(record=deorbit.ReturnOrbit),
        "manoeuvre": Section(record=deorbit.Manoeuvre, required=False, absent="omitted if [orbit] states it"),
        "vehicle": Section(record=deorbit.Returner),
        "throttle": Section(record=Throttle, required=False, absent="default: the engine burns at full thrust"),
        "transition": Section(record=deorbit.Transition, required=False, otherwise=deorbit.Transition()),
        "interface": Section(record=deorbit.Interface),
        "atmosphere": Section(
            record=deorbit.Atmosphere, required=False, absent="without it the flight ends at the interface"
        ),
        "separation": Section(
            record=deorbit.Separation, required=False, absent="default: the whole vehicle enters the atmosphere"
        ),
        "heating": Section(record=deorbit.Heating, required=False),
        "limits": Section(record=deorbit.Limits, required=False),
        "parachute": Section(record=deorbit.Parachute, required=False, absent="default: the entry ends at the site"),
        "site": Section(record=deorbit.Landing, required=False, absent="default: any place"),
    },
    make=_make_deorbit,
    example={
        "problem.minimise": "propellant",
        "body.name": "earth",
        "orbit.radius": "6778.14 km",
        "orbit.inclination": "51.6 deg",
        "manoeuvre.longitude": "16 deg",
        "manoeuvre.latitude": "39.5 deg",
        "vehicle.mass": "500 kg",
        "vehicle.thrust": "200 N",
        "vehicle.exhaust_velocity": "3000 m/s",
        "vehicle.drag_area": "0.6 m^2",
        "vehicle.nose_radius": "0.3 m",
        "transition.longest_coast": "3000 s",
        "interface.altitude": "120 km",
        "interface.angle": "-1.5 deg",
        "atmosphere.model": "us1976",
        "site.altitude": "10 km",
    },
)
