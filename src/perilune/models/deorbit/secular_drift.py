"""Secular drift of an orbit over hours and days: Kepler's ellipse, turned evenly by the second zonal harmonic.

With n = sqrt(mu/a^3), p = a (1 - e^2) and k = J2 (R/p)^2 the node, the perigee and the mean anomaly go on at

    -3/2 k n cos i,     3/4 k n (4 - 5 sin^2 i),     n (1 + 3/4 k sqrt(1 - e^2) (2 - 3 sin^2 i))

(Vallado, Fundamentals of Astrodynamics, 2013, section 9.6). The a in them is that of the mean orbit, which differs from
that of the osculating one where the vehicle stands, and far enough to be minutes off after a day: to first order

    a_mean = a - J2 R^2/a ((a/r)^3 (1 - 3/2 s + 3/2 s cos 2u) - (1 - 3/2 s) (1 - e^2)^(-3/2)),    s = sin^2 i

(Brouwer, Astronomical Journal 64, 1959). Periods of a turn and less are left out: about a tenth of a degree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from perilune.models.deorbit.orbit import AXIS
from perilune.models.physics.rotating_frame import combine, cross_product, scalar_product

_KEPLER = 8  # of Newton's steps, for eccentricities that an orbit above the air and below some planet radii has


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Elements of an orbit at t = 0 [rad], and their rates [rad/s]; the node is relative to the turning body."""

    eccentricity: float
    inclination: float
    node: float
    perigee: float
    anomaly: float
    node_rate: float
    perigee_rate: float
    anomaly_rate: float

    @property
    def turn_rate(self) -> float:
        """Return the rate of the mean argument of latitude [rad/s]."""
        return self.perigee_rate + self.anomaly_rate

    def later(self, time: float) -> Drift:
        """Return the same orbit with t = 0 at a time [s]."""
        return replace(
            self, node=self.node + self.node_rate * time, perigee=self.perigee + self.perigee_rate * time,
            anomaly=self.anomaly + self.anomaly_rate * time,
        )  # fmt: skip

    def at(self, time: Any) -> tuple[Any, Any]:
        """Argument of latitude and longitude of the node [rad] at times [s], not brought back to one turn."""
        mean, e = self.anomaly + self.anomaly_rate * time, self.eccentricity
        eccentric = mean + e * np.sin(mean)
        for _ in range(_KEPLER):
            eccentric = eccentric - (eccentric - e * np.sin(eccentric) - mean) / (1 - e * np.cos(eccentric))
        flat = e / (1 + math.sqrt(1 - e * e))
        true = eccentric + 2 * np.arctan2(flat * np.sin(eccentric), 1 - flat * np.cos(eccentric))
        return self.perigee + self.perigee_rate * time + true, self.node + self.node_rate * time


def drift(position: Sequence[float], velocity: Sequence[float], p: Any) -> Drift:
    """Return the orbit of a state [m], [m/s] relative to the turning body.

    Parameters
    ----------
    position, velocity
        In axes that turn with the body, (3,) each.
    p
        Parameters [SI].

    Returns
    -------
    Drift
        Mean elements at t = 0 [rad] and their secular rates [rad/s].
    """
    mu, r = p.body_gravitational_parameter, math.sqrt(scalar_product(position, position))
    v = combine((1, velocity), (p.body_rotation_rate, cross_product(AXIS, position)))
    momentum = cross_product(position, v)
    size = math.sqrt(scalar_product(momentum, momentum))
    inclination = math.acos(max(-1.0, min(1.0, momentum[2] / size)))
    node = math.atan2(momentum[0], -momentum[1])
    to_node = (math.cos(node), math.sin(node), 0.0)
    beyond = cross_product(combine((1 / size, momentum)), to_node)
    latitude = math.atan2(scalar_product(position, beyond), scalar_product(position, to_node))  # its argument
    # Components of the eccentricity along the position and ahead of it.
    along, ahead = size * size / (mu * r) - 1, -size * scalar_product(position, v) / (r * mu)
    e, true = math.hypot(along, ahead), math.atan2(-ahead, along)
    osculating = 1 / (2 / r - scalar_product(v, v) / mu)
    squared = math.sin(inclination) ** 2
    here = (osculating / r) ** 3 * (1 - 1.5 * squared + 1.5 * squared * math.cos(2 * latitude))
    usual = (1 - 1.5 * squared) / (1 - e * e) ** 1.5
    semi = osculating - p.body_j2 * p.body_radius**2 / osculating * (here - usual)
    n, k = math.sqrt(mu / semi**3), p.body_j2 * (p.body_radius / (semi * (1 - e * e))) ** 2
    eccentric = 2 * math.atan2(math.sqrt(1 - e) * math.sin(true / 2), math.sqrt(1 + e) * math.cos(true / 2))
    return Drift(
        eccentricity=e, inclination=inclination, node=node, perigee=latitude - true,
        anomaly=eccentric - e * math.sin(eccentric),
        node_rate=-1.5 * k * n * math.cos(inclination) - p.body_rotation_rate,
        perigee_rate=0.75 * k * n * (4 - 5 * squared),
        anomaly_rate=n * (1 + 0.75 * k * math.sqrt(1 - e * e) * (2 - 3 * squared)),
    )  # fmt: skip
