"""Transfers between orbits round the Sun, of several revolutions."""

from __future__ import annotations

import math

import perilune as pl

UNIT, GRAVITY, DAY = 1.495978707e11, 1.32712440018e20, 86400.0
# Modified equinoctial elements p [astronomical units], f, g, h, k, L of the Earth and of Dionysus five revolutions on.
EARTH = (0.99969, -0.00376, 0.01628, -7.702e-6, 6.188e-7, 14.161)
DIONYSUS = (1.5536, 0.15303, -0.51994, 0.01618, 0.11814, 46.3302)


def dionysus() -> pl.Problem:
    """From the Earth to the asteroid Dionysus in 3534 days with 0.32 N: five revolutions, thrust in a dozen pieces.

    The elements of the two bodies, 4000 kg and 3000 s as in Taheri, Kolmanovsky, Atkins 2016.
    """

    def rates(x, u, p, xp):
        s, c = xp.sin(x.L), xp.cos(x.L)
        q, tilt, root, push = 1 + x.f * c + x.g * s, 1 + x.h**2 + x.k**2, xp.sqrt(x.p / p.mu), u.thrust / x.m
        across = (x.h * s - x.k * c) / q * root * push * u.n
        return (
            2 * x.p / q * root * push * u.t,
            root * push * (s * u.r + ((q + 1) * c + x.f) / q * u.t) - x.g * across,
            root * push * (-c * u.r + ((q + 1) * s + x.g) / q * u.t) + x.f * across,
            root * tilt * c / (2 * q) * push * u.n,
            root * tilt * s / (2 * q) * push * u.n,
            xp.sqrt(p.mu * x.p) * (q / x.p) ** 2 + across,
            -u.thrust / p.ve,
        )

    units = {"p": "m", "f": "1", "g": "1", "h": "1", "k": "1", "L": "rad"}
    cruise = pl.Phase(
        name="cruise",
        states=tuple(pl.Variable(name=name, unit=unit) for name, unit in {**units, "m": "kg"}.items()),
        controls=(
            pl.UnitVectorControl(names=("r", "t", "n")),
            pl.ScalarControl(name="thrust", unit="N", lower=0.0, upper=0.32),
        ),
        dynamics=rates,
        duration="flight_time",
        end=pl.Conditions(
            lambda x, p, xp: (x.p - p.p_end, *(getattr(x, name) - DIONYSUS[i + 1] for i, name in enumerate("fghkL"))),
            *tuple(pl.Variable(name=f"{name}_end", unit=unit) for name, unit in units.items()),
        ),
        end_guess=lambda p, xp: (p.p_end, *DIONYSUS[1:], 0.7 * p.mass),
    )
    given = {
        "mu": (GRAVITY, "m^3/s^2"), "p_start": (EARTH[0] * UNIT, "m"), "p_end": (DIONYSUS[0] * UNIT, "m"),
        "mass": (4000.0, "kg"), "ve": (3000 * 9.80665, "m/s"), "flight_time": (3534 * DAY, "s"),
    }  # fmt: skip
    return pl.Problem(
        name="dionysus",
        phases=(cruise,),
        start=lambda p, xp: (p.p_start, *EARTH[1:], p.mass),
        given={name: pl.Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        objective=lambda x, p, xp: -x.m,
        objective_unit="kg",
        scales=pl.Scales(length=UNIT, time=math.sqrt(UNIT**3 / GRAVITY), mass=4000.0),
    )
