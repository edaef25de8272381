"""Catalogue of the kinds of problems that a file can state: the records of each, and the function that makes it.

Nothing else knows of them: the reader of scenarios, the templates and the reference page follow from here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, wraps
from typing import TYPE_CHECKING, Any

from perilune.core import PeriluneError, UnknownKindError, parameter_name, unknown_name
from perilune.models.deorbit import records as deorbit
from perilune.models.descent.problem import Choices, Ignition, Site, Steering, powered_descent
from perilune.models.kind import Kind, Section, Undecided
from perilune.models.landing.problem import LandingSite, Orbit, hybrid_landing
from perilune.models.physics.bodies import BODIES, PLANETS, Body, OblateBody, Planet, UniformGravity
from perilune.models.physics.vehicle import Retro, Throttle, Vehicle
from perilune.models.precision.final_descent import FinalDescent
from perilune.models.precision.problem import Approach, Corridor, precision_landing
from perilune.problem import Problem

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP = "perilune.models"  # of entry points


def _make_hybrid(
    problem: Undecided, body: Body, vehicle: Vehicle, retro: Retro | None, orbit: Orbit, landing: LandingSite
) -> Problem:
    return hybrid_landing(vehicle, retro, orbit, body, landing.altitude)


def _make_descent(
    problem: Choices,
    body: OblateBody,
    vehicle: Vehicle,
    start: Ignition,
    site: Site,
    steering: Steering | None,
    throttle: Throttle | None,
) -> Problem:
    shares = None if throttle is None else (throttle.lower, throttle.upper)
    return powered_descent(
        vehicle, start, site, body, **vars(problem), steering=steering, throttle=shares, j2=body.j2
    )  # fmt: skip


def _make_precision(
    problem: Undecided,
    body: OblateBody | UniformGravity,
    vehicle: Vehicle,
    throttle: Throttle,
    approach: Approach,
    site: Site | None,
    corridor: Corridor | None,
    final: FinalDescent | None,
) -> Problem:
    shares, j2 = (throttle.lower, throttle.upper), getattr(body, "j2", 0.0)
    return precision_landing(vehicle, approach, site, corridor, shares, body, final=final, j2=j2)


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


_ANY = Section(record=Undecided, required=False, otherwise=Undecided())
HYBRID = Kind(
    name="hybrid_landing",
    about="A lander on its way from a circular parking orbit to the ground: an impulsive retro burn, then thrust.",
    sections={
        "problem": _ANY,
        "body": Section(record=Body, known=BODIES),
        "vehicle": Section(record=Vehicle),
        "retro": Section(record=Retro, required=False),
        "orbit": Section(record=Orbit),
        "landing": Section(record=LandingSite, required=False, otherwise=LandingSite()),
    },
    make=_make_hybrid,
    example={"retro.specific_impulse": "310 s", "landing.altitude": "0 km"},
)
DESCENT = Kind(
    name="powered_descent",
    about="A descent in three dimensions from a state over a body to rest above it.",
    sections={
        "problem": Section(record=Choices),
        "body": Section(record=OblateBody, known=BODIES),
        "vehicle": Section(record=Vehicle),
        "start": Section(record=Ignition),
        "site": Section(record=Site, required=False, otherwise=Site(), absent='may be omitted if target = "anywhere"'),
        "steering": Section(record=Steering, required=False),
        "throttle": Section(record=Throttle, required=False),
    },
    make=_make_descent,
    example={
        "problem.target": "site",
        "vehicle.mass": "15 t",
        "vehicle.thrust": "45 kN",
        "vehicle.specific_impulse": "365 s",
        "vehicle.dry_mass": "8 t",
        "site.altitude": "2 km",
        "site.longitude": "5 deg",
        "site.latitude": "76 deg",
    },
)
PRECISION = Kind(
    name="precision_landing",
    about="The last kilometres: to a given point with the least propellant, within a corridor.",
    sections={
        "problem": Section(record=Undecided),
        "body": Section(record=OblateBody, known=BODIES, instead=UniformGravity),
        "vehicle": Section(record=Vehicle),
        "throttle": Section(record=Throttle),
        "approach": Section(record=Approach),
        "site": Section(record=Site, required=False, absent="omitted over flat ground"),
        "corridor": Section(record=Corridor, required=False),
        "final": Section(record=FinalDescent, required=False),
    },
    make=_make_precision,
    example={
        "vehicle.mass": "2 t",
        "vehicle.thrust": "8 kN",
        "vehicle.dry_mass": "1200 kg",
        "approach.east_speed": "50 m/s",
        "approach.up_speed": "-30 m/s",
        "site.longitude": "0 deg",
        "site.latitude": "-85 deg",
        "corridor.tilt": "50 deg",
        "corridor.slope": "20 deg",
    },
)
DEORBIT = Kind(
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
KINDS = {kind.name: kind for kind in (HYBRID, DESCENT, PRECISION, DEORBIT)}


def kind_names() -> list[str]:
    """Names of all kinds, and of those that installed packages bring."""
    from importlib.metadata import entry_points

    return list(dict.fromkeys([*KINDS, *sorted(entry.name for entry in entry_points(group=GROUP))]))


def unknown_kind(called: str, name: str) -> UnknownKindError:
    """Error for a kind of this name.

    Parameters
    ----------
    called
        Description of the value in the message, such as "problem.kind".
    name
        Kind that no record and no entry point provides.
    """
    error = unknown_name(called, name, kind_names())
    advice = error.advice or f"install the package that provides it (an entry point of the group {GROUP})"
    return UnknownKindError(error.what, got=error.got, expected=error.expected, advice=advice)


def kind_named(name: str) -> Kind:
    """A kind by its name: one of these, or one that an installed package brings as an entry point of `GROUP`.

    Nothing of a package is loaded before a file asks for its kind.

    Raises
    ------
    PeriluneError
        If there is none of this name, packages bring more than one, or it cannot be loaded.
    """
    if name in KINDS:
        return KINDS[name]
    from importlib.metadata import entry_points

    brought = {_describe_entry_point(entry): entry for entry in entry_points(group=GROUP, name=name)}
    if not brought:
        raise unknown_kind("problem.kind", name)
    if len(brought) > 1:
        got = ", ".join(sorted(brought))[:300]
        raise PeriluneError(
            f"packages provide more than one kind {name}", got=got, advice="uninstall all but one of them"
        )
    package, entry = next(iter(brought.items()))
    try:
        found = entry.load()
    except (Exception, SystemExit) as error:
        raise PeriluneError(
            f"the kind of problem {name} cannot be loaded", got=f"{package}: {one_line_error(error)}"
        ) from error
    if not isinstance(found, Kind) or found.name != name:
        raise PeriluneError(
            f"the object provided by {package} is not a kind of problem", expected=f"Kind(name={name!r}, ...)"
        )
    found = replace(found, make=_check_package_kind(found, package), package=package)
    KINDS[name] = found  # its keys are known like those of the others from now on
    _keys_by_parameter.cache_clear()
    return found


def _describe_entry_point(entry: EntryPoint) -> str:
    return f"{entry.value} of {entry.dist.name if entry.dist is not None else 'a package'}"


def one_line_error(error: BaseException) -> str:
    """Return the message of a package's error in one line, to be quoted in our own."""
    return f"{type(error).__name__}: {'; '.join(map(str.strip, str(error).splitlines()))}"[:300]


def _check_package_kind(kind: Kind, package: str) -> Callable[..., Problem]:
    """Return the kind's `make`, with errors in it reported as the package's, not as ones of this program."""

    @wraps(kind.make)
    def make(**records: Any) -> Problem:
        try:
            made = kind.make(**records)
        except PeriluneError:
            raise
        except Exception as error:
            raise PeriluneError(
                f"the kind of problem {kind.name} fails", got=f"{package}: {one_line_error(error)}",
                advice="it is called with the record of each section by name; PERILUNE_TRACEBACK=1 shows where",
            ) from error  # fmt: skip
        if not isinstance(made, Problem):
            got = f"{package}: {type(made).__name__}"
            raise PeriluneError(f"the kind of problem {kind.name} returns no problem", got=got, expected="Problem")
        return made

    return make


@cache
def _keys_by_parameter() -> dict[str, str]:
    """Keys of all files by the names of the parameters that they state."""
    stated = [
        f"{name}.{key}" for kind in KINDS.values() for name, section in kind.sections.items() for key in section.keys
    ]
    return {parameter_name(key): key for key in stated}


def key_of(parameter: str) -> str:
    """The key of a file that states a parameter, as ``vehicle.thrust``; its name where it is of another making."""
    return _keys_by_parameter().get(parameter, parameter)
