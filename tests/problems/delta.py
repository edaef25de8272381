"""A Delta III to a transfer orbit in four phases, with the most mass: Benson 2004; Betts 2010, section 6.15."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

import perilune as pl
from perilune.problem import Parameter, Variable
from problems.answered import Answered

MU, RADIUS, TURNS = 3.986012e14, 6378145.0, 7.29211585e-5
PAYLOAD = 4164.0
# Of one solid booster, and of both stages: mass with propellant, propellant [kg], thrust [N], burning time [s].
SOLID = (19290.0, 17010.0, 628.5e3, 75.2)
FIRST = (104380.0, 95550.0, 1083.1e3, 261.0)
SECOND = (19300.0, 16820.0, 110.094e3, 700.0)
BOOSTERS = (6, 3, 0)  # that burn in the first three phases
BURNS = (75.2, 75.2, 110.6)
DEGREE = math.pi / 180
AXIS, ECCENTRICITY, INCLINATION, NODE, PERIGEE = 24361.14e3, 0.7308, 28.5 * DEGREE, 269.8 * DEGREE, 130.5 * DEGREE


def delta() -> pl.Problem:
    """Three phases of given length, then the second stage until the orbit is reached; all direct their thrust."""
    thrusts = [FIRST[2] + count * SOLID[2] for count in BOOSTERS] + [SECOND[2]]
    flows = [FIRST[1] / FIRST[3] + count * SOLID[1] / SOLID[3] for count in BOOSTERS] + [SECOND[1] / SECOND[3]]
    masses = [PAYLOAD + SECOND[0] + FIRST[0] + sum(BOOSTERS) * SOLID[0]]
    for flow, count, burn in zip(flows, BOOSTERS[:2], BURNS[:2], strict=False):
        masses.append(masses[-1] - flow * burn - count * (SOLID[0] - SOLID[1]))
    masses.append(PAYLOAD + SECOND[0])
    ahead, across, normal = _axes()
    momentum = math.sqrt(MU * AXIS * (1 - ECCENTRICITY**2))

    def rates(stage: int, x: Any, u: Any, p: Any, xp: Any) -> Sequence[Any]:
        r = xp.sqrt(x.x**2 + x.y**2 + x.z**2)
        wind = x.vx + p.turns * x.y, x.vy - p.turns * x.x, x.vz
        # At rest in the air the speed has no slope; a hundredth of a metre a second is no drag.
        speed = xp.sqrt(sum(w * w for w in wind) + p.calm**2)
        pull, drag = -p.mu / r**3, -0.5 * p.density * xp.exp(-(r - p.radius) / p.decay) * p.area * p.drag * speed / x.m
        push = getattr(p, f"thrust{stage}") / x.m
        place, pointing = (x.x, x.y, x.z), (u.a, u.b, u.c)
        speeds = (pull * at + drag * w + push * d for at, w, d in zip(place, wind, pointing, strict=True))
        return x.vx, x.vy, x.vz, *speeds, -getattr(p, f"flow{stage}")

    def orbit(x: Any, p: Any, xp: Any) -> Sequence[Any]:
        """Its momentum, and its eccentricity along and across the line of apsides: five elements in six numbers."""
        h = x.y * x.vz - x.z * x.vy, x.z * x.vx - x.x * x.vz, x.x * x.vy - x.y * x.vx
        r = xp.sqrt(x.x**2 + x.y**2 + x.z**2)
        e = (
            (x.vy * h[2] - x.vz * h[1]) / p.mu - x.x / r,
            (x.vz * h[0] - x.vx * h[2]) / p.mu - x.y / r,
            (x.vx * h[1] - x.vy * h[0]) / p.mu - x.z / r,
        )
        along, aside = (sum(a * b for a, b in zip(e, axis.tolist(), strict=True)) for axis in (ahead, across))
        return *(a - p.momentum * b for a, b in zip(h, normal.tolist(), strict=True)), along - p.eccentricity, aside

    def phase(stage: int) -> pl.Phase:
        last = stage == len(BURNS)
        left = PAYLOAD + 4000.0 if last else masses[stage] - flows[stage] * BURNS[stage]
        return pl.Phase(
            name=f"stage{stage}",
            states=STATES,
            controls=(pl.UnitVectorControl(names=("a", "b", "c")),),
            dynamics=partial(rates, stage),
            duration=f"burn{stage}",
            end=pl.Conditions.of(orbit if last else None, ORBIT if last else ()),
            end_guess=lambda p, xp: (*map(float, _typical(stage)), left),
        )

    place, speed = _launch()
    given: dict[str, tuple[float, str]] = {
        "mu": (MU, "m^3/s^2"), "turns": (TURNS, "rad/s"), "calm": (0.01, "m/s"), "density": (1.225, "kg/m^3"),
        "radius": (RADIUS, "m"), "decay": (7200.0, "m"), "area": (4 * math.pi, "m^2"), "drag": (0.5, "1"),
        "momentum": (momentum, "m^2/s"), "eccentricity": (ECCENTRICITY, "1"),
        **{name: (float(value), "m") for name, value in zip(("x0", "y0", "z0"), place, strict=True)},
        **{name: (float(value), "m/s") for name, value in zip(("vx0", "vy0", "vz0"), speed, strict=True)},
        **{f"thrust{k}": (value, "N") for k, value in enumerate(thrusts)},
        **{f"flow{k}": (value, "kg/s") for k, value in enumerate(flows)},
        **{f"mass{k}": (value, "kg") for k, value in enumerate(masses)},
        **{f"burn{k}": (value, "s") for k, value in enumerate(BURNS)},
    }  # fmt: skip
    return pl.Problem(
        name="delta",
        phases=tuple(phase(stage) for stage in range(4)),
        start=lambda p, xp: (p.x0, p.y0, p.z0, p.vx0, p.vy0, p.vz0, p.mass0),
        links=tuple(partial(_dropped, stage) for stage in (1, 2, 3)),
        given={name: Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        free=(pl.FreeParameter(name="burn3", unit="s", lower=100.0, upper=SECOND[3], guess=650.0),),
        objective=lambda x, p, xp: -x.m,
        objective_unit="kg",
        scales=pl.Scales(length=RADIUS, time=math.sqrt(RADIUS**3 / MU), mass=3e4),
    )


STATES = (
    *(Variable(name=name, unit="m") for name in ("x", "y", "z")),
    *(Variable(name=name, unit="m/s") for name in ("vx", "vy", "vz")),
    Variable(name="m", unit="kg", lower=0.0),
)
ORBIT = (
    *(Variable(name=name, unit="m^2/s") for name in ("hx", "hy", "hz")),
    *(Variable(name=name) for name in ("eccentric", "turned")),
)


def _dropped(stage: int, x: Any, p: Any, xp: Any) -> Sequence[Any]:
    return x.x, x.y, x.z, x.vx, x.vy, x.vz, getattr(p, f"mass{stage}")


def _launch() -> tuple[Any, Any]:
    """Place and velocity at rest on the ground, in inertial axes."""
    place = RADIUS * np.array([math.cos(28.5 * DEGREE), 0.0, math.sin(28.5 * DEGREE)])
    return place, np.cross([0.0, 0.0, TURNS], place)


def _axes() -> tuple[Any, Any, Any]:
    """Unit vectors of the orbit: to its perigee, a quarter on, and normal to it."""
    node = np.array([math.cos(NODE), math.sin(NODE), 0.0])
    normal = np.array([
        math.sin(NODE) * math.sin(INCLINATION), -math.cos(NODE) * math.sin(INCLINATION), math.cos(INCLINATION)
    ])  # fmt: skip
    beside = np.cross(normal, node)
    ahead = node * math.cos(PERIGEE) + beside * math.sin(PERIGEE)
    return ahead, np.cross(normal, ahead), normal


def _typical(stage: int) -> Any:
    """Roughly where a phase ends: over the ground to the east, and at last in the perigee of the orbit."""
    if stage == 3:
        ahead, across, _ = _axes()
        speed = math.sqrt(MU / AXIS * (1 + ECCENTRICITY) / (1 - ECCENTRICITY))
        return np.concatenate([AXIS * (1 - ECCENTRICITY) * ahead, speed * across])
    turned, height, speed = ((0.1, 20e3, 900.0), (1.0, 60e3, 2300.0), (4.0, 130e3, 5000.0))[stage]
    place, moving = _launch()
    up, east = place / RADIUS, moving / np.linalg.norm(moving)
    c, s = math.cos(turned * DEGREE), math.sin(turned * DEGREE)
    return np.concatenate([(RADIUS + height) * (up * c + east * s), speed * (east * c - up * s)])


ANSWERED = (
    Answered(
        name="Delta III ascent",
        make=delta,
        objective=-7529.7123,
        uncertainty=5e-5,
        source="Benson 2004, a Gauss pseudospectral transcription for optimal control",
    ),
)
