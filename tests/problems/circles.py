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
        controls=(pl.Direction(names=("a", "b")), pl.Bounded(name="T", unit="N", lower=0.0, upper=thrust)),
        dynamics=lambda x, u, p, m: (
            x.vx,
            x.vy,
            -p.mu * x.x / (x.x**2 + x.y**2) ** 1.5 + u.T / x.m * u.a,
            -p.mu * x.y / (x.x**2 + x.y**2) ** 1.5 + u.T / x.m * u.b,
            -u.T / p.exhaust_speed,
        ),
        duration="time",
        end=lambda x, p, m: (
            (x.vx**2 + x.vy**2) / 2 - p.mu / (2 * p.far),
            x.x * x.vx + x.y * x.vy,
            x.x**2 + x.y**2 - p.far**2,
        ),
        end_conditions=tuple(
            pl.Variable(name=n, unit=u) for n, u in (("energy", "m^2/s^2"), ("radial", "m^2/s"), ("radius", "m^2"))
        ),
        typical_end=lambda p, m: (p.far, 0 * p.far, 0 * p.speed, p.speed * m.sqrt(p.near / p.far), 0.75 * p.mass),
    )
    given = {
        "mu": (1.0, "m^3/s^2"), "near": (1.0, "m"), "far": (radius, "m"), "mass": (1.0, "kg"), "time": (time, "s"),
        "speed": (math.sqrt(1 + eccentricity), "m/s"), "exhaust_speed": (exhaust_speed, "m/s"),
    }  # fmt: skip
    return pl.Problem(
        name="transfer",
        phases=(phase,),
        start=lambda p, m: (p.near, 0.0, 0.0, p.speed, p.mass),
        given={name: pl.Given(value=value, unit=unit) for name, (value, unit) in given.items()},
        objective=lambda x, p, m: -x.m,
        objective_unit="kg",
    )


_UNITS = ("m", "m", "m/s", "m/s", "kg")
