"""The matrix of scenarios: what kinds declare, scenarios that reach all of it, and every step that a flight may go.

What there is to reach is read from the records of each kind: its sections, there and left out, each value of each key
that has choices or names, and each key. How it is reached stands in `WAYS`: for every kind what may be stated in one
way or another, independently of the rest, and what cannot stand together. `cover` combines them, each once or in pairs.

    python tests/all_pairs.py [KIND ...]

carries all pairs; the suite has each value once.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

from perilune.core import Key, TextField, record_keys
from perilune.models import KINDS, Kind, Section

Layer = Mapping[str, str | None]  # by "section.key" the text of its value; None takes the key, or the section, away
Picked = Mapping[str, str]  # by way the name of what was picked


@dataclass(frozen=True)
class Ways:
    """What a kind may state: a base, and by name what there is to choose from in addition to it."""

    base: Layer
    ways: Mapping[str, Mapping[str, Layer]]
    together: Callable[[Picked], bool] = field(default=lambda picked: True)

    def document(self, picked: Picked) -> dict[str, dict[str, str]]:
        """The tree of sections of what was picked."""
        tree: dict[str, dict[str, str]] = {}
        for layer in (self.base, *(self.ways[way][name] for way, name in picked.items())):
            for place, value in layer.items():
                section, _, key = place.partition(".")
                if not key:
                    if value is None:
                        tree.pop(section, None)
                    else:
                        tree.setdefault(section, {})
                elif value is None:
                    tree.get(section, {}).pop(key, None)
                else:
                    tree.setdefault(section, {})[key] = value
        return tree


def text_of(tree: Mapping[str, Mapping[str, str]]) -> str:
    """The scenario as a file has it."""
    return "\n".join(
        "\n".join([f"[{section}]", *(f'{key} = "{value}"' for key, value in values.items())])
        for section, values in tree.items()
    )


# -- what is declared, and what of it a scenario reaches -----------------------------------------------------------


def declared(kind: Kind) -> set[str]:
    """Everything that a scenario of this kind may have, or not have."""
    found = set[str]()
    for name, section in kind.in_file.items():
        found |= {f"[{name}]"} | (set() if section.required else {f"no [{name}]"})
        for key, about in section.keys.items():
            found |= {f"{name}.{key}"} | {f"{name}.{key} = {value}" for value in _values(section, key, about)}
            if not about.required and key not in section.alone:
                found.add(f"no {name}.{key}")
    return found


def reached(kind: Kind, tree: Mapping[str, Mapping[str, str]]) -> set[str]:
    """What of it one scenario has."""
    found = set[str]()
    for name, section in kind.in_file.items():
        if name not in tree:
            found.add(f"no [{name}]")
            continue
        found.add(f"[{name}]")
        record = section.stated(tree[name])
        for key, about in section.keys.items():
            if key in tree[name]:
                found |= {f"{name}.{key}"}
                found |= {f"{name}.{key} = {tree[name][key]}"} if _values(section, key, about) else set()
            elif key in record_keys(record) and not about.required:
                found.add(f"no {name}.{key}")
    return found


def _values(section: Section, key: str, about: Key) -> tuple[str, ...]:
    if key == "name" and section.known:
        return tuple(section.known)
    return about.declared.choices if isinstance(about.declared, TextField) else ()


# -- combinations ----------------------------------------------------------------------------------------------------


def cover(ways: Ways, *, pairs: bool, seed: int = 1, tries: int = 60) -> list[dict[str, str]]:
    """Combinations in which each value of each way appears, or each pair of values that may stand together.

    Greedy: of some that are drawn around one that is missing, that which brings the most that is new.
    """
    rng, chosen = random.Random(seed), list[dict[str, str]]()
    size = 2 if pairs else 1
    missing = set(_parts_of_all(ways, size))
    while missing:
        aim = dict(min(missing))
        drawn = [found for _ in range(tries) if (found := _drawn(ways, aim, rng)) is not None]
        if not drawn:  # these two cannot stand together
            missing.remove(tuple(aim.items()))
            continue
        best = max(drawn, key=lambda picked: len(missing & set(_parts(picked, size))))
        missing -= set(_parts(best, size))
        chosen.append(best)
    return chosen


def _parts(picked: Picked, size: int) -> Iterator[tuple[tuple[str, str], ...]]:
    return combinations(picked.items(), size)


def _parts_of_all(ways: Ways, size: int) -> Iterator[tuple[tuple[str, str], ...]]:
    single = [[(way, name) for name in names] for way, names in ways.ways.items()]
    if size == 1:
        yield from (((pair),) for group in single for pair in group)
        return
    for one, other in combinations(single, 2):
        yield from ((a, b) for a in one for b in other)


def _drawn(ways: Ways, aim: Picked, rng: random.Random) -> dict[str, str] | None:
    for _ in range(40):
        picked = {way: aim.get(way) or rng.choice(list(names)) for way, names in ways.ways.items()}
        if ways.together(picked):
            return picked
    return None


# -- what there is to pick ------------------------------------------------------------------------------------------

_PROOF = {
    "proof.position": "1 mm", "proof.speed": "1 mm/s", "proof.mass": "1 g", "proof.angle": "1e-4 deg",
    "proof.time": "1 ms", "proof.optimality": "1e-6",
}  # fmt: skip
_NOTHING: Layer = {}
_PROOFS: Mapping[str, Layer] = {"none": _NOTHING, "empty": {"proof": ""}, "stated": _PROOF}
_GRAVITY: Mapping[str, Layer] = {"usual": _NOTHING, "stated": {"vehicle.standard_gravity": "9.80665 m/s^2"}}
_MOON: Layer = {
    "body.name": None, "body.gravitational_parameter": "4902.8 km^3/s^2", "body.radius": "1737.4 km",
    "body.rotation_rate": "2.6617e-6 rad/s",
}  # fmt: skip
# By name the thrust over that which suits the Moon and the speed of a low orbit, so that everything is flyable.
_BODIES = {
    "moon": (1.0, 1694),
    "mercury": (2.3, 2990),
    "mars": (2.3, 3540),
    "europa": (0.8, 1420),
    "ceres": (0.17, 355),
}


def _bodies(thrust: float, **more: Layer) -> dict[str, Layer]:
    named = {name: {"body.name": name, "vehicle.thrust": f"{thrust * by:g} N"} for name, (by, _) in _BODIES.items()}
    return {**named, **more}


def _in_orbit(bodies: Mapping[str, Layer]) -> dict[str, Layer]:
    speeds = {name: f"{_BODIES.get(name, _BODIES['moon'])[1]} m/s" for name in bodies}
    return {name: {**layer, "start.forward_speed": speeds[name]} for name, layer in bodies.items()}


HYBRID = Ways(
    base={
        "problem.kind": "hybrid_landing", "vehicle.mass": "300 kg", "vehicle.specific_impulse": "310 s",
        "orbit.parking_altitude": "100 km", "orbit.perilune_altitude": "15 km",
    },
    ways={
        "body": _bodies(440.0, quantities={**_MOON, "vehicle.thrust": "440 N"}),
        "kind": {"stated": _NOTHING, "left out": {"problem": None}, "empty": {"problem.kind": None}},
        "retro": {
            "none": _NOTHING, "best": {"retro.specific_impulse": "310 s"},
            "fixed": {"retro.specific_impulse": "310 s", "retro.delta_v": "200 m/s"},
        },
        "landing": {"none": _NOTHING, "empty": {"landing": ""}, "stated": {"landing.altitude": "1 km"}},
        "dry": {"any": _NOTHING, "stated": {"vehicle.dry_mass": "20 kg"}},
        "gravity": _GRAVITY,
        "proof": _PROOFS,
    },
)  # fmt: skip

DESCENT = Ways(
    base={
        "problem.kind": "powered_descent", "vehicle.mass": "15 t", "vehicle.specific_impulse": "365 s",
        "start.altitude": "15 km", "start.longitude": "0 deg", "start.latitude": "88 deg", "start.heading": "180 deg",
        "site.longitude": "5 deg", "site.latitude": "74 deg",
    },
    ways={
        "body": _in_orbit(_bodies(45e3, quantities={**_MOON, "vehicle.thrust": "45 kN"}, oblate={
            **_MOON, "body.j2": "2.03e-4", "vehicle.thrust": "45 kN"})),
        "coordinates": {"left out": _NOTHING, **{
            name: {"problem.coordinates": name} for name in ("cartesian", "spherical")}},
        "target": {"left out": _NOTHING, **{
            name: {"problem.target": name} for name in ("site", "downrange", "anywhere")}},
        "minimise": {"left out": _NOTHING, **{
            name: {"problem.minimise": name} for name in ("propellant", "flight_time")}},
        "site": {
            "low": _NOTHING, "high": {"site.altitude": "2 km"}, "none": {"site": None},
            "anywhere": {"site.longitude": None, "site.latitude": None, "site.altitude": "1 km"}},
        "steering": {
            "none": _NOTHING, "empty": {"steering": ""},
            "stated": {
                "steering.elevation_lower": "-85 deg", "steering.elevation_upper": "89 deg",
                "steering.azimuth_lower": "1 deg", "steering.azimuth_upper": "359 deg"},
        },
        "throttle": {"none": _NOTHING, "stated": {"throttle.lower": "0.3", "throttle.upper": "0.95"}},
        "coast": {"none": _NOTHING, "stated": {"start.longest_coast": "200 s"}},
        "speeds": {"forward": _NOTHING, "all": {"start.sideways_speed": "5 m/s", "start.vertical_speed": "-3 m/s"}},
        "dry": {"any": _NOTHING, "stated": {"vehicle.dry_mass": "2 t"}},
        "gravity": _GRAVITY,
        "proof": _PROOFS,
    },
    together=lambda picked: picked["target"] == "anywhere" or picked["site"] in ("low", "high"),
)  # fmt: skip

_SITE: Layer = {"site.longitude": "0 deg", "site.latitude": "-85 deg"}
PRECISION = Ways(
    base={
        "problem.kind": "precision_landing", "vehicle.mass": "2 t", "vehicle.specific_impulse": "310 s",
        "throttle.lower": "0.3", "throttle.upper": "0.9", "approach.east": "-1800 m", "approach.north": "300 m",
        "approach.up": "1 km",
    },
    ways={
        "body": {
            **{name: {**layer, **_SITE} for name, layer in _bodies(8e3).items()},
            "ceres": {"body.name": "ceres", "vehicle.thrust": "4 kN", **_SITE},
            "high site": {"body.name": "moon", "vehicle.thrust": "8 kN", **_SITE, "site.altitude": "1 km"},
            "quantities": {**_MOON, "vehicle.thrust": "8 kN", **_SITE},
            "oblate": {**_MOON, "body.j2": "2.03e-4", "vehicle.thrust": "8 kN", **_SITE},
            "flat": {"body.gravity": "1.62 m/s^2", "vehicle.thrust": "8 kN"},
        },
        "corridor": {
            "none": _NOTHING, "empty": {"corridor": ""}, "tilt": {"corridor.tilt": "60 deg"},
            "slope": {"corridor.slope": "15 deg"},
            "all": {"corridor.tilt": "60 deg", "corridor.slope": "15 deg", "corridor.pad_radius": "20 m"},
        },
        "final": {
            "none": _NOTHING, "at rest": {"final.height": "50 m"},
            "moving": {"final.height": "50 m", "final.touchdown_speed": "1 m/s"},
        },
        "coast": {"none": _NOTHING, "stated": {"approach.longest_coast": "30 s"}},
        "speeds": {"east": {"approach.east_speed": "50 m/s"}, "all": {
            "approach.east_speed": "40 m/s", "approach.north_speed": "5 m/s", "approach.up_speed": "-30 m/s"},
            "at rest": _NOTHING},
        "dry": {"any": _NOTHING, "stated": {"vehicle.dry_mass": "1200 kg"}},
        "gravity": _GRAVITY,
        "proof": _PROOFS,
    },
)  # fmt: skip

_ELLIPSE: Layer = {
    "orbit.perigee_altitude": "380 km", "orbit.apogee_altitude": "400 km", "orbit.argument_of_perigee": "30 deg",
}  # fmt: skip
_CIRCLE: Layer = {"orbit.radius": "6778.14 km"}
_THERE: Layer = {"orbit.node_longitude": "-27 deg", "orbit.argument_of_latitude": "120 deg"}
_PASS: Layer = {"manoeuvre.longitude": "16 deg", "manoeuvre.latitude": "39.5 deg"}


def _return_is_possible(picked: Picked) -> bool:
    air, lift = picked["air"] != "none", picked["lift"] != "none"
    needs_air = (
        picked["site"] != "none" or picked["separation"] != "none" or picked["limits"] != "none"
        or picked["parachute"] != "none" or picked["heat"] in ("default", "heating")
        or picked["minimise"] == "heat_load"
    )  # fmt: skip
    nose = picked["heat"] != "none" or picked["drag"] == "cone"
    moved = picked["minimise"] in ("flight_time", "heat_load", "left out") or picked["site"] == "place"
    return (
        (air or not needs_air)
        and (air or picked["drag"] == "none") and (not air or picked["drag"] != "none")
        and (nose or (picked["limits"] != "all" and picked["minimise"] != "heat_load"))
        and (not lift or (air and moved))
        and (picked["parachute"] == "none" or picked["site"] in ("none", "place"))
        and (picked["air"] != "nrlmsis" or picked["epoch"] == "stated")
        and (picked["air"] != "file" or picked["site"] != "none")
    )  # fmt: skip


DEORBIT = Ways(
    base={
        "problem.kind": "deorbit_entry", "orbit.inclination": "51.6 deg", "vehicle.mass": "500 kg",
        "vehicle.thrust": "200 N", "interface.altitude": "120 km",
    },
    ways={
        "minimise": {"left out": _NOTHING, **{name: {"problem.minimise": name} for name in (
            "flight_time", "transition_time", "propellant", "heat_load")}},
        "epoch": {"none": _NOTHING, "stated": {"problem.epoch": "2026-06-01T12:00:00Z"}},
        "body": {
            "earth": {"body.name": "earth"},
            "sphere": {"body.gravitational_parameter": "398600.4418 km^3/s^2", "body.radius": "6378.137 km",
                       "body.rotation_rate": "7.292115e-5 rad/s"},
            "ellipsoid": {
                "body.gravitational_parameter": "398600.4418 km^3/s^2", "body.radius": "6378.137 km",
                "body.rotation_rate": "7.292115e-5 rad/s", "body.j2": "1.0826e-3", "body.j3": "-2.53e-6",
                "body.j4": "-1.62e-6", "body.flattening": "3.353e-3"},
        },
        "orbit": {
            "from place, descending": {**_CIRCLE, **_PASS, "manoeuvre.pass": "descending"},
            "from place, ascending": {**_CIRCLE, **_PASS, "manoeuvre.pass": "ascending"},
            "circle": {**_CIRCLE, **_THERE}, "ellipse": {**_ELLIPSE, **_THERE},
        },
        "coast": {"none": _NOTHING, "stated": {"orbit.longest_coast": "1200 s"}},
        "engine": {"speed": {"vehicle.exhaust_velocity": "3000 m/s"}, "impulse": {"vehicle.specific_impulse": "306 s"}},
        "dry": {"any": _NOTHING, "stated": {"vehicle.dry_mass": "300 kg"}},
        "drag": {
            "none": _NOTHING, "area": {"vehicle.drag_area": "0.6 m^2"},
            "ballistic": {"vehicle.ballistic_coefficient": "400 kg/m^2"},
            "cone": {"vehicle.base_radius": "0.5 m", "vehicle.cone_angle": "20 deg", "vehicle.nose_radius": "0.3 m"},
        },
        "heat": {
            "none": _NOTHING, "nose": {"vehicle.nose_radius": "0.3 m"},
            "default": {"vehicle.nose_radius": "0.3 m", "heating": ""},
            "heating": {"vehicle.nose_radius": "0.3 m", "heating.constant": "1.7415e-4 kg^0.5/m"},
        },
        "lift": {
            "none": _NOTHING, "unsaid": {"vehicle.lift_to_drag": "0.25"},
            "free": {"vehicle.lift_to_drag": "0.25", "vehicle.bank": "free"},
            "reversed": {"vehicle.lift_to_drag": "0.25", "vehicle.bank": "reversed"},
        },
        "throttle": {"none": _NOTHING, "stated": {"throttle.lower": "0.3", "throttle.upper": "0.9"}},
        "transition": {
            "none": _NOTHING, "empty": {"transition": ""}, "coast": {"transition.longest_coast": "3000 s"}},
        "interface": {
            "angle": {"interface.angle": "-1.5 deg"}, "speed": {"interface.speed": "7.6 km/s"},
            "angles": {"interface.angle_lower": "-3 deg", "interface.angle_upper": "-1 deg"},
            "speeds": {"interface.speed_lower": "7 km/s", "interface.speed_upper": "8 km/s"},
            "ranges": {
                "interface.angle_lower": "-3 deg", "interface.angle_upper": "-1 deg",
                "interface.speed_upper": "8 km/s"},
        },
        "air": {
            "none": _NOTHING,
            "exponential": {
                "atmosphere.model": "exponential", "atmosphere.density": "1.225 kg/m^3",
                "atmosphere.scale_height": "7.2 km"},
            "us1976": {"atmosphere.model": "us1976"},
            "nrlmsis": {
                "atmosphere.model": "nrlmsis", "atmosphere.f107": "150", "atmosphere.f107a": "150",
                "atmosphere.ap": "4"},
            "file": {"atmosphere.model": "file", "atmosphere.file": "air.csv"},
        },
        "separation": {"none": _NOTHING, "stated": {"separation.mass": "290 kg"}},
        "limits": {
            "none": _NOTHING, "empty": {"limits": ""}, "load": {"limits.load": "30 g0"},
            "all": {"limits.load": "30 g0", "limits.heat_rate": "20 MW/m^2", "limits.dynamic_pressure": "300 kPa"},
        },
        "parachute": {"none": _NOTHING, "stated": {"parachute.altitude": "12 km", "parachute.drag_area": "200 m^2"}},
        "site": {
            "none": _NOTHING, "high": {"site.altitude": "10 km", "site.speed_upper": "600 m/s"},
            "place": {"site.longitude": "-98 deg", "site.latitude": "38 deg"},
        },
        "proof": _PROOFS,
    },
    together=_return_is_possible,
)  # fmt: skip

WAYS: Mapping[str, Ways] = {
    "hybrid_landing": HYBRID, "powered_descent": DESCENT, "precision_landing": PRECISION, "deorbit_entry": DEORBIT,
}  # fmt: skip
# What a kind's records declare, and the kind refuses: each with what it says.
REFUSED: Mapping[str, Mapping[str, str]] = {
    "precision_landing": {f"no site.{key}": f"site.{key} is missing" for key in ("longitude", "latitude")},
}  # fmt: skip
# Returns that are solved from nothing in seconds, and what of them is picked: the parachute, an orbit left alone, a
# coast whose best is its longest, and a bank through air of a day.
_PLAIN: Picked = {
    "minimise": "propellant", "epoch": "none", "body": "earth", "orbit": "from place, descending", "coast": "none",
    "engine": "speed", "dry": "any", "drag": "area", "heat": "none", "lift": "none", "throttle": "none",
    "transition": "coast", "interface": "angle", "air": "exponential", "separation": "none", "limits": "none",
    "parachute": "none", "site": "none", "proof": "none",
}  # fmt: skip
QUICK_RETURNS: Sequence[Picked] = (
    {**_PLAIN, "air": "none", "drag": "none", "orbit": "ellipse", "coast": "stated", "proof": "stated"},
    {**_PLAIN, "throttle": "stated", "separation": "stated", "heat": "nose", "parachute": "stated"},
    {
        **_PLAIN,
        "minimise": "transition_time",
        "epoch": "stated",
        "body": "sphere",
        "orbit": "ellipse",
        "coast": "stated",
        "engine": "impulse",
        "dry": "stated",
        "heat": "heating",
        "transition": "none",
        "interface": "speeds",
        "air": "nrlmsis",
        "separation": "stated",
        "limits": "empty",
    },
    {
        **_PLAIN,
        "epoch": "stated",
        "body": "sphere",
        "coast": "stated",
        "dry": "stated",
        "heat": "nose",
        "lift": "free",
        "air": "nrlmsis",
        "limits": "load",
        "site": "place",
        "proof": "empty",
    },
)


def unreached(kind: str, trees: Sequence[Mapping[str, Mapping[str, str]]]) -> set[str]:
    """What a kind declares and no scenario of these has."""
    there = {part for tree in trees for part in reached(KINDS[kind], tree)}
    return declared(KINDS[kind]) - there - REFUSED.get(kind, {}).keys()
