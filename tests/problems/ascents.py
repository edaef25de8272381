"""Ascents over flat ground in least time: the tangent of the thrust angle falls linearly in time.

Linear tangent steering with constant acceleration (Bryson, Ho 1975, section 2.4), a launch from the Moon (after
Longuski, Guzman, Prussing 2014), and one in two stages. `flat_ascent` solves all three by quadrature of that law, with
nothing of the library.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from perilune.core import Scales
from perilune.problem import Conditions, FreeParameter, Parameter, Phase, Problem, UnitVectorControl, Variable
from problems.answered import Answered

END = tuple(Variable(name=n, unit=u) for n, u in (("height", "m"), ("along", "m/s"), ("up", "m/s")))
STATES = tuple(Variable(name=n, unit=u) for n, u in (("y", "m"), ("vx", "m/s"), ("vy", "m/s")))


def tangent_steering(split: bool = False) -> Problem:
    """Constant acceleration from rest to height 5, speed (45, 0) in least time; in one phase or two."""

    def phase(name: str, duration: str, last: bool) -> Phase:
        return Phase(
            name=name,
            states=STATES,
            controls=(UnitVectorControl(names=("cx", "cy")),),
            dynamics=lambda x, u, p, xp: (x.vy, p.a * u.cx, p.a * u.cy),
            duration=duration,
            end=Conditions.of(
                (lambda x, p, xp: (x.y - p.height, x.vx - p.speed, x.vy)) if last else None, END if last else ()
            ),
            end_guess=lambda p, xp: (p.height, p.speed, 0 * p.speed),
        )

    first = Parameter(value=0.2, unit="s")
    return Problem(
        name="linear_tangent_steering",
        phases=(phase("first", "t1", False), phase("second", "t2", True)) if split else (phase("only", "t2", True),),
        links=(lambda x, p, xp: (x.y, x.vx, x.vy),) if split else (),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given={
            "a": Parameter(value=100.0, unit="m/s^2"),
            "height": Parameter(value=5.0, unit="m"),
            "speed": Parameter(value=45.0, unit="m/s"),
            "t1": first,
        },
        free=(FreeParameter(name="t2", unit="s", lower=0.0, guess=0.6),),
        objective=lambda x, p, xp: p.t2 + p.t1 if split else p.t2,
        objective_unit="s",
        scales=Scales(length=20.0, time=0.5),
    )


def lunar_ascent(acceleration: float, gravity: float, height: float, speed: float) -> Problem:
    """From rest on a flat Moon to horizontal flight at a height, with constant acceleration in least time; SI."""
    phase = Phase(
        name="ascent",
        states=STATES,
        controls=(UnitVectorControl(names=("cx", "cy")),),
        dynamics=lambda x, u, p, xp: (x.vy, p.a * u.cx, p.a * u.cy - p.g),
        duration="time",
        end=Conditions(lambda x, p, xp: (x.y - p.height, x.vx - p.speed, x.vy), *END),
        end_guess=lambda p, xp: (p.height, p.speed, 0 * p.speed),
    )
    given = {"a": (acceleration, "m/s^2"), "g": (gravity, "m/s^2"), "height": (height, "m"), "speed": (speed, "m/s")}
    return Problem(
        name="lunar_ascent",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given={name: Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        free=(FreeParameter(name="time", unit="s", lower=0.0, guess=300.0),),
        objective=lambda x, p, xp: p.time,
        objective_unit="s",
        scales=Scales(length=height, time=100.0),
    )


class Stage(NamedTuple):
    """Mass at its ignition [kg], thrust [N], exhaust speed [m/s], burning time [s] (None: to the end)."""

    mass: float
    thrust: float
    exhaust_speed: float
    burn: float | None = None


LUNAR_GRAVITY = 1.61544
# Isp 1e6 s with 9.80665 m/s^2; with the Moon's own gravity instead, the answer would be 0.19 s off the printed one.
LUNAR_LAUNCH = Stage(5e4, 3 * 5e4 * LUNAR_GRAVITY, 1e6 * 9.80665)
TWO_STAGES = (Stage(15e3, 60e3, 3000.0, 200.0), Stage(8e3, 20e3, 3000.0))


def staged_launch(stages: Sequence[Stage], height: float, speed: float) -> Problem:
    """Launch from the flat Moon to horizontal flight at a height in least time; one phase for each stage."""
    given = {
        "g": Parameter(value=LUNAR_GRAVITY, unit="m/s^2"),
        "height": Parameter(value=height, unit="m"),
        "speed": Parameter(value=speed, unit="m/s"),
    }
    for k, stage in enumerate(stages):
        for name, unit in (("mass", "kg"), ("thrust", "N"), ("exhaust_speed", "m/s"), ("burn", "s")):
            value = getattr(stage, name)
            if value is not None:
                given[f"{name}_{k}"] = Parameter(value=value, unit=unit)
    last = len(stages) - 1
    duration = f"burn_{last}"

    def phase(k: int) -> Phase:
        def rates(x, u, p, xp):
            thrust = getattr(p, f"thrust_{k}")
            a = thrust / x.m
            return x.vy, a * u.cx, a * u.cy - p.g, -thrust / getattr(p, f"exhaust_speed_{k}")

        def typical_end(p, xp):
            share = (k + 1) / len(stages)
            return share * p.height, share * p.speed, 0 * p.speed, 0.7 * getattr(p, f"mass_{k}")

        return Phase(
            name=f"stage_{k}",
            states=(*STATES, Variable(name="m", unit="kg", lower=0.0)),
            controls=(UnitVectorControl(names=("cx", "cy")),),
            dynamics=rates,
            duration=f"burn_{k}",
            end=Conditions.of(
                (lambda x, p, xp: (x.y - p.height, x.vx - p.speed, x.vy)) if k == last else None,
                END if k == last else (),
            ),
            end_guess=typical_end,
        )

    def dropped(k: int, x, p, xp):
        return x.y, x.vx, x.vy, getattr(p, f"mass_{k}")

    return Problem(
        name="launch",
        phases=tuple(phase(k) for k in range(len(stages))),
        start=lambda p, xp: (0.0, 0.0, 0.0, p.mass_0),
        links=tuple(partial(dropped, k) for k in range(1, len(stages))),
        given=given,
        free=(FreeParameter(name=duration, unit="s", lower=0.0, guess=400.0),),
        objective=lambda x, p, xp: sum(getattr(p, f"burn_{k}") for k in range(len(stages))),
        objective_unit="s",
        scales=Scales(length=height, time=300.0, mass=stages[0].mass),
    )


class FlatAscent(NamedTuple):
    """tan(angle) = tangent - rate t until time."""

    tangent: float
    rate: float
    time: float


def flat_ascent(stages: Sequence[Stage], gravity: float, height: float, speed: float, guess: FlatAscent) -> FlatAscent:
    """The three numbers of the law that ends at (height, speed, 0), by Gauss quadrature and Powell's method."""
    from scipy.optimize import root

    node, weight = np.polynomial.legendre.leggauss(60)

    def misses(z):
        tangent, rate, time = z * guess
        ends = np.cumsum([stage.burn or 0.0 for stage in stages])
        ends[-1] = time
        y = vx = vy = begin = 0.0
        for stage, end in zip(stages, ends, strict=True):
            half = 0.5 * (end - begin)
            t = begin + half * (1 + node)
            a = stage.thrust / (stage.mass - stage.thrust / stage.exhaust_speed * (t - begin))
            angle = np.arctan(tangent - rate * t)
            up = a * np.sin(angle) - gravity
            y += vy * 2 * half + half * (weight @ (up * (end - t)))
            vx, vy, begin = vx + half * (weight @ (a * np.cos(angle))), vy + half * (weight @ up), end
        return [y / height - 1, vx / speed - 1, vy / speed]

    found = root(misses, np.ones(3), tol=1e-13)
    assert np.abs(found.fun).max() < 1e-12
    return FlatAscent(*(found.x * guess))


FOOT = 0.3048
BRYSON = (20.8 * FOOT, 5.32 * FOOT, 50000 * FOOT, 5444 * FOOT)
APOLLO = (15.9 * FOOT, 5.3 * FOOT, 50000 * FOOT, 5780 * FOOT)


def lunar_law(acceleration: float, gravity: float, height: float, speed: float) -> FlatAscent:
    """The steering of `lunar_ascent`."""
    return flat_ascent(
        (Stage(1.0, acceleration, math.inf),),
        gravity,
        height,
        speed,
        FlatAscent(0.8, 0.003, 1.2 * speed / acceleration),
    )


LINEAR_TANGENT = partial(flat_ascent, (Stage(1.0, 100.0, math.inf),), 0.0, 5.0, 45.0, FlatAscent(1.5, 5.0, 0.6))
LUNAR = partial(flat_ascent, (LUNAR_LAUNCH,), LUNAR_GRAVITY, 185e3, 1627.0, FlatAscent(2.7, 0.008, 480.0))
STAGED = partial(flat_ascent, TWO_STAGES, LUNAR_GRAVITY, 60e3, 1700.0, FlatAscent(1.0, 0.003, 550.0))


def _time(numbers: tuple[float, float, float, float]) -> float:
    return lunar_law(*numbers).time


def linear_tangent_costate() -> tuple[float, float, float]:
    """lambda(0) of `tangent_steering`: along -thrust, of length 1/a as H = -1 where the speed is still 0."""
    law = LINEAR_TANGENT()
    along = -math.cos(math.atan(law.tangent)) / 100.0
    return along * law.rate, along, along * law.tangent


ANSWERED = (
    Answered(
        name="linear tangent steering",
        make=tangent_steering,
        objective=0.554570878334603,
        source="Bryson, Ho 1975, section 2.4; closed form",
        costate=linear_tangent_costate(),
        free={"t2": 0.554570878334603},
        truth=lambda: LINEAR_TANGENT().time,
    ),
    Answered(
        name="linear tangent steering, two phases",
        make=partial(tangent_steering, split=True),
        objective=0.554570878334603,
        source="the same, cut in two by a link that passes the state on",
        costate=linear_tangent_costate(),
        free={"t2": 0.354570878334603},
        truth=lambda: LINEAR_TANGENT().time,
    ),
    Answered(
        name="lunar ascent",
        make=partial(staged_launch, (LUNAR_LAUNCH,), 185e3, 1627.0),
        objective=481.909686,
        uncertainty=5e-7,
        source="flat-Moon launch after Longuski, Guzman, Prussing 2014; quadrature of the steering law",
        truth=lambda: LUNAR().time,
    ),
    Answered(
        name="two-stage ascent with a mass drop",
        make=partial(staged_launch, TWO_STAGES, 60e3, 1700.0),
        objective=STAGED().time,
        source="quadrature of the steering law; lambda of the velocity passes the drop unchanged",
        truth=lambda: STAGED().time,
    ),
    *(
        Answered(
            name=f"lunar ascent from rest in {time:.0f} s",
            make=partial(lunar_ascent, *numbers),
            objective=time,
            uncertainty=uncertainty,
            source="steering law by quadrature; the numbers are those of textbooks, in feet",
            truth=partial(_time, numbers),
        )
        for numbers, time, uncertainty in ((APOLLO, 386.874111928, 5e-10), (BRYSON, 272.706050, 5e-7))
    ),
)
