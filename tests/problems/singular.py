"""Problems with a singular arc and a closed form: H is linear in the control, and its slope vanishes for a while."""

from __future__ import annotations

import math
from functools import lru_cache

from numpy.polynomial import Polynomial

import perilune as pl
from perilune.problem import Parameter, Variable
from problems.answered import Answered
from problems.goddard import goddard


def _variables(**units: str) -> tuple[Variable, ...]:
    return tuple(Variable(name=name, unit=unit) for name, unit in units.items())


def nearest_to_zero(end: float = 0.5, most: float = 1.0, way: float = 1.0) -> pl.Problem:
    """From x = 1 m to `end` in 2 s with the least `way` int x^2, |x'| <= 1 m/s: down, along x = 0, and up.

    The slope of H is the costate of x, whose second derivative is -2 u: the singular control is 0.
    """
    phase = pl.Phase(
        name="go",
        states=_variables(x="m", c="m^2*s"),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-1.0, upper=most),),
        dynamics=lambda x, u, p, xp: (u.u, way * x.x * x.x),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.end,), there="m"),
    )
    return pl.Problem(
        name="nearest_to_zero",
        phases=(phase,),
        start=lambda p, xp: (p.start, 0.0),
        given={
            "T": Parameter(value=2.0, unit="s"),
            "start": Parameter(value=1.0, unit="m"),
            "end": Parameter(value=end, unit="m"),
        },
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2*s",
    )


def aly(duration: float = 5.0) -> pl.Problem:
    """From x = 0, v = 1 m/s with the least int (x^2 + (k v)^2)/2, |v'| <= 1 m/s^2, k = 1 s, and an end that is free.

    Aly 1978: full brake, then a singular arc to the end, along which v' = x/k^2.
    """
    phase = pl.Phase(
        name="go",
        states=_variables(x="m", v="m/s", c="m^2*s"),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * (x.x * x.x + p.k * p.k * x.v * x.v)),
        duration="T",
    )
    return pl.Problem(
        name="aly",
        phases=(phase,),
        start=lambda p, xp: (0.0, p.speed, 0.0),
        given={
            "T": Parameter(value=duration, unit="s"),
            "k": Parameter(value=1.0, unit="s"),
            "speed": Parameter(value=1.0, unit="m/s"),
        },
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2*s",
    )


@lru_cache
def aly_switch(duration: float = 5.0) -> float:
    """When the singular arc begins [s]: there v = -x tanh of what is left, as v vanishes at the end."""
    low, high = 1.0, 2.0
    for _ in range(80):
        t = 0.5 * (low + high)
        x, v = t - 0.5 * t * t, 1.0 - t
        low, high = (t, high) if v + x * math.tanh(duration - t) > 0 else (low, t)
    return 0.5 * (low + high)


def aly_truth(duration: float = 5.0) -> float:
    """J of `aly` [m^2 s]: the polynomial of the brake, then x = a cosh(T - t)."""
    t = aly_switch(duration)
    brake = 0.5 * (t**3 / 3 - t**4 / 4 + t**5 / 20 + t - t * t + t**3 / 3)
    left = duration - t
    a = (t - 0.5 * t * t) / math.cosh(left)
    return brake + 0.25 * a * a * math.sinh(2 * left)


def fuller() -> pl.Problem:
    """From rest at x = 1 m to rest at 0 in 8 s with the least int x^2, |v'| <= 1 m/s^2: switches without end.

    The slope of H is the costate of v, whose fourth derivative is the first with the control in it.
    """
    phase = pl.Phase(
        name="go",
        states=_variables(x="m", v="m/s", c="m^2*s"),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, x.x * x.x),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x, x.v), there="m", still="m/s"),
    )
    return pl.Problem(
        name="fuller",
        phases=(phase,),
        start=lambda p, xp: (p.start, 0 * p.start / p.T, 0.0),
        given={"T": Parameter(value=8.0, unit="s"), "start": Parameter(value=1.0, unit="m")},
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2*s",
    )


def swinging(duration: float, end: float | None = None, bent: float = 0.0) -> pl.Problem:
    """From s = 0 with x = s' = 1 m/s to x = 0.3 m/s, the least int (x^2 - (s/k)^2)/2, |x'| <= 4 m/s^2, k = 1 s.

    Along its singular arc s'' = -s/k^2, as if x were the control. `end` is s at the end [m], free where None. With
    `bent` [s^2/m] the first state is not s but s + bent x^2, which changes formulas and nothing else.
    """

    def place(x, p):
        return x.s - p.bent * x.x * x.x

    def dynamics(x, u, p, xp):
        s = place(x, p) / p.k
        return (x.x + 2.0 * p.bent * x.x * u.u, u.u, 0.5 * (x.x * x.x - s * s))

    phase = pl.Phase(
        name="go",
        states=_variables(s="m", x="m/s", c="m^2/s"),
        controls=(pl.ScalarControl(name="u", unit="m/s^2", lower=-4.0, upper=4.0),),
        dynamics=dynamics,
        duration="T",
        end=pl.Conditions(
            lambda x, p, xp: (x.x - p.slow, *(() if end is None else (place(x, p) - p.end,))),
            *_variables(slow="m/s", **({} if end is None else {"there": "m"})),
        ),
    )
    return pl.Problem(
        name="swinging",
        phases=(phase,),
        start=lambda p, xp: (p.bent * p.fast * p.fast, p.fast, 0.0),
        given={
            "T": Parameter(value=duration, unit="s"),
            "k": Parameter(value=1.0, unit="s"),
            "bent": Parameter(value=bent, unit="s^2/m"),
            "fast": Parameter(value=1.0, unit="m/s"),
            "slow": Parameter(value=0.3, unit="m/s"),
            "end": Parameter(value=0.0 if end is None else end, unit="m"),
        },
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s",
    )


def swinging_at_bounds(duration: float) -> float:
    """J of the flight of `swinging` that is at its upper bound first and then at its lower, a polynomial [m^2/s]."""
    x, s, cost, switch = 1.0, 0.0, 0.0, (4.0 * duration - 0.7) / 8.0
    for rate, length in ((4.0, switch), (-4.0, duration - switch)):
        speed = Polynomial([x, rate])
        place = speed.integ(k=s)
        cost += (0.5 * (speed * speed - place * place)).integ()(length)
        x, s = speed(length), place(length)
    return float(cost)


def following() -> pl.Problem:
    """From x = 0.8 m to 1.2 m in 6 s with the least int (x - a sin(phi))^2, |x'| <= 1 m/s, where a sin(phi) is faster.

    On its singular arcs x is at the target, a sin(phi).
    """
    phase = pl.Phase(
        name="go",
        states=_variables(x="m", phi="1", c="m^2*s"),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (u.u, p.w, (x.x - p.a * xp.sin(x.phi)) ** 2),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.end,), there="m"),
    )
    return pl.Problem(
        name="following",
        phases=(phase,),
        start=lambda p, xp: (p.start, 0 * p.w * p.T, 0.0),
        given={
            "T": Parameter(value=6.0, unit="s"),
            "a": Parameter(value=1.0, unit="m"),
            "w": Parameter(value=1.3, unit="1/s"),
            "start": Parameter(value=0.8, unit="m"),
            "end": Parameter(value=1.2, unit="m"),
        },
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2*s",
    )


def planar_goddard(down: float = 2500.0) -> pl.Problem:
    """Goddard's rocket in a vertical plane, its thrust in a free direction: greatest altitude so far `down` range [m].

    It begins at 5 m/s across and 40 m/s up, and ends with as much across.
    """
    upright = goddard()

    def dynamics(x, u, p, xp):
        drag = p.drag * xp.sqrt(x.across * x.across + x.up * x.up) * xp.exp(-x.h / p.scale_height)
        return (
            x.across,
            x.up,
            (u.thrust * u.sideways - drag * x.across) / x.m,
            (u.thrust * u.upwards - drag * x.up) / x.m - p.g,
            -u.thrust / p.c,
        )

    phase = pl.Phase(
        name="ascent",
        states=_variables(s="m", h="m", across="m/s", up="m/s", m="kg"),
        controls=(*upright.phases[0].controls, pl.UnitVectorControl(names=("sideways", "upwards"))),
        dynamics=dynamics,
        duration="t_f",
        end=pl.Conditions(
            lambda x, p, xp: (x.s - p.down, x.across - p.across, x.m - p.dry_mass),
            down="m",
            as_before="m/s",
            dry="kg",
        ),
        end_guess=lambda p, xp: (p.down, p.scale_height, 0 * p.c, 0 * p.c, p.dry_mass),
    )
    return pl.Problem(
        name="planar_goddard",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, p.across, p.up, p.mass),
        given={
            **upright.given,
            "down": Parameter(value=down, unit="m"),
            "across": Parameter(value=5.0, unit="m/s"),
            "up": Parameter(value=40.0, unit="m/s"),
        },
        free=upright.free,
        objective=lambda x, p, xp: -x.h,
        objective_unit="m",
        scales=upright.scales,
    )


ANSWERED = (
    Answered(
        name="nearest to zero, a singular arc between two bounds",
        make=nearest_to_zero,
        objective=0.375,
        source="1/3 + 1/24: 1 s down, 0.5 s along zero, 0.5 s up",
        truth=lambda: 1 / 3 + 1 / 24,
        switches=(1.0, 1.5),
    ),
    Answered(
        name="Aly's problem, a singular arc to the end",
        make=aly,
        objective=aly_truth(),
        source="Aly 1978, J = 0.37699193; x = a cosh(T - t) after the brake",
        truth=aly_truth,
        switches=(aly_switch(),),
    ),
)
