"""Problems with known answers for the tests of direct methods; sources beside each."""

from __future__ import annotations

import math

from perilune.problem import Bounded, Direction, Free, Given, Phase, Problem, Variable
from perilune.units import Scales


def linear_tangent_steering(scheme_scales: Scales | None = None) -> Problem:
    """Least time to y = 5 m, vx = 45 m/s, vy = 0 at a = 100 m/s^2 from rest: t_f = 0.554570878334603 s.

    Bryson, Ho 1975, section 2.4; the digits from the closed form in `linear_tangent_truth`.
    """
    states = tuple(
        Variable(name=n, unit=u) for n, u in (("x", "m"), ("y", "m"), ("vx", "m/s"), ("vy", "m/s"))
    )
    phase = Phase(
        name="ascent",
        states=states,
        controls=(Direction(names=("ux", "uy")),),
        dynamics=lambda x, u, p, m: (x.vx, x.vy, p.a * u.ux, p.a * u.uy),
        duration="t_f",
        end=lambda x, p, m: (x.y - p.y_f, x.vx - p.vx_f, x.vy),
        end_conditions=(
            Variable(name="height", unit="m"),
            Variable(name="speed_along", unit="m/s"),
            Variable(name="speed_up", unit="m/s"),
        ),
        typical_end=lambda p, m: (0.5 * p.y_f, p.y_f, p.vx_f, 0 * p.vx_f),
    )
    return Problem(
        name="linear_tangent_steering",
        phases=(phase,),
        start=lambda p, m: (0.0, 0.0, 0.0, 0.0),
        given={
            "a": Given(value=100.0, unit="m/s^2"),
            "y_f": Given(value=5.0, unit="m"),
            "vx_f": Given(value=45.0, unit="m/s"),
        },
        free=(Free(name="t_f", unit="s", lower=0.0, upper=10.0, typical=1.0),),
        objective=lambda x, p, m: p.t_f,
        objective_unit="s",
        scales=scheme_scales or Scales(length=5.0, time=0.5, mass=1.0),
    )


def meditch() -> Problem:
    """Meditch's lander (1964): vertical soft landing of least propellant, throttle off and then full.

    The integral of the thrust is 1.42031259905 N s.
    """
    phase = Phase(
        name="descent",
        states=(
            Variable(name="h", unit="m"),
            Variable(name="v", unit="m/s"),
            Variable(name="m", unit="kg", lower=0.1),
        ),
        controls=(Bounded(name="thrust", unit="N", lower=0.0, upper=1.227),),
        dynamics=lambda x, u, p, m: (x.v, -p.g + u.thrust / x.m, -u.thrust / p.c),
        duration="t_f",
        end=lambda x, p, m: (x.h, x.v),
        end_conditions=(Variable(name="touchdown", unit="m"), Variable(name="touchdown_speed", unit="m/s")),
        typical_end=lambda p, m: (0 * p.h, 0 * p.v, 0.6 * p.m),
    )
    return Problem(
        name="meditch",
        phases=(phase,),
        start=lambda p, m: (p.h, p.v, p.m),
        given={
            "g": Given(value=1.0, unit="m/s^2"),
            "c": Given(value=2.349, unit="m/s"),
            "h": Given(value=1.0, unit="m"),
            "v": Given(value=-0.783, unit="m/s"),
            "m": Given(value=1.0, unit="kg"),
        },
        free=(Free(name="t_f", unit="s", lower=0.0, upper=10.0, typical=1.5),),
        objective=lambda x, p, m: -x.m,
        objective_unit="kg",
    )


def double_integrator(limit: float = math.inf) -> Problem:
    """Least integral of u^2/2 over 1 s from v = 1 back to v = -1 at the same place, x <= limit.

    Without limit J = 2 with u = -2; with limit <= 1/6 J = 4/(9 limit) and an arc on the limit: Bryson,
    Denham, Dreyfus 1963.
    """
    phase = Phase(
        name="swing",
        states=(
            Variable(name="x", unit="m", upper=limit),
            Variable(name="v", unit="m/s"),
            Variable(name="cost", unit="m^2/s^3"),
        ),
        controls=(Bounded(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, m: (x.v, u.u, 0.5 * u.u * u.u),
        duration="T",
        end=lambda x, p, m: (x.x, x.v + p.v0),
        end_conditions=(Variable(name="place", unit="m"), Variable(name="speed", unit="m/s")),
        typical_end=lambda p, m: (0 * p.v0 * p.T, -p.v0, p.v0 * p.v0 / p.T),
    )
    return Problem(
        name="double_integrator",
        phases=(phase,),
        start=lambda p, m: (0.0, p.v0, 0.0),
        given={"T": Given(value=1.0, unit="s"), "v0": Given(value=1.0, unit="m/s")},
        objective=lambda x, p, m: x.cost,
        objective_unit="m^2/s^3",
    )


def staged_ascent() -> Problem:
    """Two burns without gravity, the first stage dropped between them; the rocket equation is the answer.

    Fixed thrusts, free burn times, propellant as bounds of the masses: the greatest final speed burns all of
    it, v = c ln(100/60) + c ln(40/15).
    """

    def burn(name: str, duration: str, thrust: str, floor: float) -> Phase:
        return Phase(
            name=name,
            states=(Variable(name="v", unit="m/s"), Variable(name="m", unit="kg", lower=floor)),
            dynamics=lambda x, u, p, m: (getattr(p, thrust) / x.m, -getattr(p, thrust) / p.c),
            duration=duration,
            typical_end=lambda p, m: (p.c, 0.5 * p.mass),
        )

    return Problem(
        name="staged_ascent",
        phases=(burn("first", "t_1", "F_1", 60.0), burn("second", "t_2", "F_2", 15.0)),
        start=lambda p, m: (0.0, p.mass),
        links=(lambda x, p, m: (x.v, p.second_mass),),
        given={
            "c": Given(value=3000.0, unit="m/s"),
            "F_1": Given(value=2000.0, unit="N"),
            "F_2": Given(value=500.0, unit="N"),
            "mass": Given(value=100.0, unit="kg"),
            "second_mass": Given(value=40.0, unit="kg"),
        },
        free=(
            Free(name="t_1", unit="s", lower=0.0, upper=1000.0, typical=40.0),
            Free(name="t_2", unit="s", lower=0.0, upper=1000.0, typical=100.0),
        ),
        objective=lambda x, p, m: -x.v,
        objective_unit="m/s",
        scales=Scales(length=3e5, time=100.0, mass=100.0),
    )
