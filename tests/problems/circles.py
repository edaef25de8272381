"""Transfers in a plane with little thrust, in a given time: many extremals, of very different cost."""

from __future__ import annotations

import math

import perilune as pl


def to_circle(
    time: float, radius: float, exhaust_speed: float, eccentricity: float, thrust: float = 0.05
) -> pl.Problem:
    """Most mass on a circle, from the nearest point of an ellipse; canonical numbers (1 m, mu = 1), any angle."""
    phase = pl.Phase(
        name="transfer",
        states=tuple(pl.Variable(name=n, unit=u) for n, u in zip(("x", "y", "vx", "vy", "m"), _UNITS, strict=True)),
        controls=(
            pl.UnitVectorControl(names=("a", "b")),
            pl.ScalarControl(name="T", unit="N", lower=0.0, upper=thrust),
        ),
        dynamics=lambda x, u, p, xp: (
            x.vx,
            x.vy,
            -p.mu * x.x / (x.x**2 + x.y**2) ** 1.5 + u.T / x.m * u.a,
            -p.mu * x.y / (x.x**2 + x.y**2) ** 1.5 + u.T / x.m * u.b,
            -u.T / p.exhaust_speed,
        ),
        duration="time",
        end=pl.Conditions(
            lambda x, p, xp: (
                (x.vx**2 + x.vy**2) / 2 - p.mu / (2 * p.far),
                x.x * x.vx + x.y * x.vy,
                x.x**2 + x.y**2 - p.far**2,
            ),
            *tuple(
                pl.Variable(name=n, unit=u) for n, u in (("energy", "m^2/s^2"), ("radial", "m^2/s"), ("radius", "m^2"))
            ),
        ),
        end_guess=lambda p, xp: (p.far, 0 * p.far, 0 * p.speed, p.speed * xp.sqrt(p.near / p.far), 0.75 * p.mass),
    )
    given = {
        "mu": (1.0, "m^3/s^2"), "near": (1.0, "m"), "far": (radius, "m"), "mass": (1.0, "kg"), "time": (time, "s"),
        "speed": (math.sqrt(1 + eccentricity), "m/s"), "exhaust_speed": (exhaust_speed, "m/s"),
    }  # fmt: skip
    return pl.Problem(
        name="transfer",
        phases=(phase,),
        start=lambda p, xp: (p.near, 0.0, 0.0, p.speed, p.mass),
        given={name: pl.Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        objective=lambda x, p, xp: -x.m,
        objective_unit="kg",
    )


_UNITS = ("m", "m", "m/s", "m/s", "kg")


def meeting(revolutions: int, thrust: float = 0.03, parameter: float = 2.0, f: float = 0.2) -> pl.Problem:
    """Most mass at a place on an ellipse after so many revolutions, from a circle; equinoctial elements p, f, g, L."""

    def rates(x, u, p, xp):
        s, c = xp.sin(x.L), xp.cos(x.L)
        q, root = 1 + x.f * c + x.g * s, xp.sqrt(x.p / p.mu) * u.T / x.m
        return (
            2 * x.p / q * root * u.t,
            root * (s * u.r + ((q + 1) * c + x.f) / q * u.t),
            root * (-c * u.r + ((q + 1) * s + x.g) / q * u.t),
            xp.sqrt(p.mu * x.p) * (q / x.p) ** 2,
            -u.T / p.exhaust_speed,
        )

    units = {"p": "m", "f": "1", "g": "1", "L": "rad"}
    phase = pl.Phase(
        name="meeting",
        states=tuple(pl.Variable(name=n, unit=u) for n, u in {**units, "m": "kg"}.items()),
        controls=(
            pl.UnitVectorControl(names=("r", "t")),
            pl.ScalarControl(name="T", unit="N", lower=0.0, upper=thrust),
        ),
        dynamics=rates,
        duration="time",
        end=pl.Conditions(
            lambda x, p, xp: (x.p - p.far, x.f - p.f, x.g, x.L - p.angle),
            *tuple(pl.Variable(name=f"{n}_end", unit=u) for n, u in units.items()),
        ),
        end_guess=lambda p, xp: (p.far, p.f, 0 * p.f, p.angle, 0.8 * p.mass),
    )
    time = revolutions * 2 * math.pi * ((1 + parameter / (1 - f**2)) / 2) ** 1.5
    given = {
        "mu": (1.0, "m^3/s^2"), "near": (1.0, "m"), "far": (parameter, "m"), "f": (f, "1"), "mass": (1.0, "kg"),
        "angle": (2 * math.pi * revolutions, "rad"), "exhaust_speed": (2.0, "m/s"), "time": (time, "s"),
    }  # fmt: skip
    return pl.Problem(
        name="meeting",
        phases=(phase,),
        start=lambda p, xp: (p.near, 0.0, 0.0, 0.0, p.mass),
        given={name: pl.Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        objective=lambda x, p, xp: -x.m,
        objective_unit="kg",
    )
