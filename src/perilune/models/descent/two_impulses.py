"""Landing by two impulses from a bound orbit: the least velocity change that burn-coast-burn comes near to.

From a bound orbit that clears the ground, or almost: coast for a time tau, one impulse along the velocity onto the
ellipse that grazes the radius r_s of the site, half a turn or so of free fall to its lowest point, one impulse that
leaves the velocity of the ground there,

    dv(tau) = |v - v_1| + |v_2 - omega x r_2|,      r_p(v_1) = r_s.

By the vis-viva equation v_2^2 = v_1^2 + 2 mu (1/r_s - 1/r), so that d(dv)/d|v_1| = -1 + |v_1|/|v_2| < 0: the less the
first impulse lowers the orbit the better, and the ground decides. tau is where dv is least over one turn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.core import Vector

_LOOKS = 48  # times of one turn at which the first impulse is tried
_SAME = 1e-9  # relative difference of velocity changes that are the same
_FASTER = 1.05  # the greatest share of the velocity with which a fall that meets the ground is made to graze it
_BISECTIONS = 60
_KEPLER_STEPS = 60  # of Newton's method for Kepler's equation


@dataclass(frozen=True, kw_only=True)
class LandingStart:
    """State at the begin of a landing, in inertial axes that agree with the body's at that instant.

    Parameters
    ----------
    position, velocity
        At the start [m, m/s].
    mu, radius
        Gravitational parameter [m^3/s^2], and distance of the ground from the centre [m].
    turning
        Angular velocity of the body [rad/s].
    """

    position: Vector
    velocity: Vector
    mu: float
    radius: float
    turning: Vector


@dataclass(frozen=True, kw_only=True)
class TwoImpulses:
    """A landing by two impulses.

    Parameters
    ----------
    wait, fall
        How long the orbit is kept, and from the first impulse to the lowest point [s].
    before, after
        Place and velocity at the first impulse [m, m/s], and the velocity behind it.
    lowest
        Place and velocity before the second impulse.
    ground
        Velocity of the ground there [m/s].
    """

    wait: float
    fall: float
    before: tuple[Vector, Vector]
    after: Vector
    lowest: tuple[Vector, Vector]
    ground: Vector

    @property
    def first(self) -> float:
        """Size of the first impulse [m/s]."""
        return float(np.linalg.norm(self.before[1] - self.after))

    @property
    def second(self) -> float:
        """Size of the second impulse [m/s]."""
        return float(np.linalg.norm(self.lowest[1] - self.ground))

    @property
    def velocity_change(self) -> float:
        """Both [m/s]."""
        return self.first + self.second


def propagate_kepler(position: Vector, velocity: Vector, mu: float, time: float) -> tuple[Vector, Vector]:
    """Return place and velocity after free fall on an ellipse, by Lagrange's f and g (Battin 1999, section 4.3).

    Parameters
    ----------
    position, velocity
        In inertial axes, (3,) each [m, m/s, or any such units].
    mu, time
        Gravitational parameter and duration of the fall, in the same units.
    """
    r = float(np.linalg.norm(position))
    semi = 1 / (2 / r - float(velocity @ velocity) / mu)
    rate, x = math.sqrt(mu / semi**3), anomaly_after(position, velocity, mu, time)
    f, g = 1 - semi / r * (1 - math.cos(x)), time - (x - math.sin(x)) / rate
    there = f * position + g * velocity
    far = float(np.linalg.norm(there))
    f_rate, g_rate = -math.sqrt(mu * semi) / (r * far) * math.sin(x), 1 - semi / far * (1 - math.cos(x))
    return there, f_rate * position + g_rate * velocity


def anomaly_after(position: Vector, velocity: Vector, mu: float, time: float) -> float:
    """Return by how much the eccentric anomaly [rad] grows in a free fall of so long, by Kepler's equation.

    Parameters
    ----------
    position, velocity
        In inertial axes, (3,) each [m, m/s, or any such units].
    mu, time
        Gravitational parameter and duration of the fall, in the same units.
    """
    r = float(np.linalg.norm(position))
    semi = 1 / (2 / r - float(velocity @ velocity) / mu)
    rate, rising, beside = math.sqrt(mu / semi**3), float(position @ velocity) / math.sqrt(mu * semi), 1 - r / semi
    x = rate * time
    for _ in range(_KEPLER_STEPS):
        miss = x - beside * math.sin(x) + rising * (1 - math.cos(x)) - rate * time
        step = miss / (1 - beside * math.cos(x) + rising * math.sin(x))
        x -= step
        if abs(step) < 1e-14 * (1 + abs(x)):
            break
    return x


def orbit_shape(position: Vector, velocity: Vector, mu: float) -> tuple[float, float]:
    """Return half the great axis [m] and the eccentricity of an orbit.

    Parameters
    ----------
    position, velocity
        In inertial axes [m, m/s], (3,) each.
    mu
        Gravitational parameter [m^3/s^2].
    """
    r, speed = float(np.linalg.norm(position)), float(velocity @ velocity)
    eccentric = ((speed - mu / r) * position - float(position @ velocity) * velocity) / mu
    return 1 / (2 / r - speed / mu), float(np.linalg.norm(eccentric))


def _lowest_radius(position: Vector, velocity: Vector, mu: float) -> float:
    semi, eccentricity = orbit_shape(position, velocity, mu)
    return semi * (1 - eccentricity)


def time_to_periapsis(position: Vector, velocity: Vector, mu: float) -> float:
    """Return the time [s] to the lowest point of an ellipse, less than one turn.

    Parameters
    ----------
    position, velocity
        In inertial axes [m, m/s], (3,) each.
    mu
        Gravitational parameter [m^3/s^2].
    """
    semi, _ = orbit_shape(position, velocity, mu)
    sine, cosine = float(position @ velocity) / math.sqrt(mu * semi), 1 - float(np.linalg.norm(position)) / semi
    mean = math.atan2(sine, cosine) - sine
    return (-mean % (2 * math.pi)) * math.sqrt(semi**3 / mu)


def _landing_after_wait(around: LandingStart, wait: float) -> TwoImpulses:
    """Return the landing that begins after a wait [s]."""
    mu, before = around.mu, propagate_kepler(around.position, around.velocity, around.mu, wait)
    position, velocity = before
    low, high = 0.0, _FASTER  # shares of the velocity that is left
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _lowest_radius(position, middle * velocity, mu) > around.radius else (middle, high)
    after = low * velocity
    fall = time_to_periapsis(position, after, mu)
    lowest = propagate_kepler(position, after, mu, fall)
    ground = np.cross(around.turning, lowest[0])
    return TwoImpulses(wait=wait, fall=fall, before=before, after=after, lowest=lowest, ground=ground)


def _may_graze(around: LandingStart, wait: float) -> bool:
    """Return True if a flight is above the ground after a wait [s], and may be made to graze it."""
    position, velocity = propagate_kepler(around.position, around.velocity, around.mu, wait)
    above = float(np.linalg.norm(position)) > around.radius
    return above and _lowest_radius(position, _FASTER * velocity, around.mu) > around.radius


def two_impulses(around: LandingStart) -> list[TwoImpulses]:
    """Return the landings by two impulses whose velocity change is least among those that begin sooner or later.

    Over a body that turns these are several within one turn of the orbit. Long burns choose another wait than impulses
    where these differ by little, so that some between them follow.

    Parameters
    ----------
    around
        Where it begins.

    Returns
    -------
    list
        The least first; the one that begins at once where waiting changes nothing. None where the start is on no
        ellipse, or on one that meets the ground with more than a few hundredths of the speed to spare.
    """
    from scipy.optimize import minimize_scalar

    semi, _ = orbit_shape(around.position, around.velocity, around.mu)
    if not semi > 0:
        return []
    turn = 2 * math.pi * math.sqrt(semi**3 / around.mu)
    waits = np.linspace(0.0, turn, _LOOKS + 1)
    last = int(np.argmin([*(_may_graze(around, wait) for wait in waits), False])) - 1
    waits = waits[: last + 1]
    if last < 0:
        return []

    def spent(wait: float) -> float:
        return _landing_after_wait(around, wait).velocity_change

    changes = np.array([spent(wait) for wait in waits])
    if changes.max() <= changes.min() * (1 + _SAME):
        return [_landing_after_wait(around, 0.0)]
    ahead, behind = (np.append(changes[1:], np.inf), np.append(np.inf, changes[:-1]))
    least = np.nonzero((changes <= ahead) & (changes <= behind))[0].tolist()
    found = list[TwoImpulses]()
    for k in least[:-1] if {0, _LOOKS} <= {*least} else least:  # the first, a turn later
        near = waits[max(k - 1, 0)], waits[min(k + 1, last)]
        nearest: Any = minimize_scalar(spent, method="bounded", bounds=near)
        found.append(_landing_after_wait(around, min((float(waits[k]), float(nearest.x)), key=spent)))
    between = (k for k in range(0, last, _LOOKS // 4) if min(abs(k - known) for known in least) > _LOOKS // 8)
    return [
        *sorted(found, key=lambda one: one.velocity_change),
        *(_landing_after_wait(around, float(waits[k])) for k in between),
    ]


def landing_start_of(p: Any, state: Any) -> LandingStart:
    """Return where a flight begins.

    Parameters
    ----------
    p
        Parameters of a descent.
    state
        x, y, z, vx, vy, vz in axes that turn with the body.
    """
    position, seen = (np.array(state[a : a + 3], dtype=float) for a in (0, 3))
    turning = np.array([0.0, 0.0, p.body_rotation_rate])
    return LandingStart(
        position=position, velocity=seen + np.cross(turning, position), mu=p.body_gravitational_parameter,
        radius=p.body_radius + p.site_altitude, turning=turning,
    )  # fmt: skip
