"""Bounds by speed, energy and angular momentum: which states no landing in time can pass through, whatever it does."""

from __future__ import annotations

from typing import Any

import numpy as np

from doubles import Doubles
from perilune.problem import Problem

_ROOM = 1 + 1e-9  # far above what rounding does to the bounds of `Viable`
_SAMPLE, _FASTER = 0.5, 20.0  # of these bounds [s], and what a sample adds to a speed at most [m/s]


class Viable:
    """What every state of a flight must satisfy that touches down by a time.

    With sigma seconds left, the speed is W at most and the height differs by D at most from that of the site, where
    W' = a + g, D' = W backward from touchdown; and the angular momentum changes by no more than the largest radius
    times the speed that the engine still gives.

    Attributes
    ----------
    lowest
        No flight that touches down in time is ever nearer to the centre: by the same bounds from both its ends.
    """

    def __init__(self, problem: Problem, latest: float) -> None:
        p = {name: given.value for name, given in problem.given.items()}
        self.mu, self.latest = p["body_gravitational_parameter"], latest
        self.r = p["body_radius"] + p["landing_altitude"]
        self.u = self.r * p["body_rotation_rate"]
        self.exhaust = p["vehicle_specific_impulse"] * p["vehicle_standard_gravity"]
        self.thrust, self.mass = p["vehicle_thrust"], p["vehicle_mass"]
        self.times = _SAMPLE * np.arange(int(latest / _SAMPLE) + 3)
        self.speeds, self.depths = self._fall(self.r, self.u, self.push(latest - self.times))
        # How far it can turn around the centre, and so whether gravity always pulls back where it is looked at from.
        with np.errstate(invalid="ignore"):
            turns = np.cumsum(self.speeds * _SAMPLE / (self.r - self.depths)) * _ROOM
        self.turns = np.where(self.depths < self.r, turns, np.inf)
        high = p["body_radius"] + p["orbit_perilune_altitude"]
        low, top = high, p["body_radius"] + p["orbit_parking_altitude"]
        begins = np.sqrt(2 * self.mu * (1 / low - 1 / (low + top)))
        _, fallen = self._fall(high, begins, self.push(self.times + _SAMPLE))
        ends = np.minimum(np.ceil((latest - self.times[:-1]) / _SAMPLE).astype(int).clip(0), len(self.depths) - 1)
        self.lowest = float(np.maximum(high - fallen[1:], self.r - self.depths[ends]).min())

    def _fall(self, r: float, speed: float, pushes: Any) -> tuple[Any, Any]:
        """Bounds of speed and way at each time from a radius, as long as it stays above a third of it."""
        speeds, depths = np.full((2, len(self.times)), np.inf)
        speeds[0], depths[0] = speed * _ROOM, 0.0
        for k in range(len(self.times) - 1):
            low = r - depths[k] - _SAMPLE * (speeds[k] + _FASTER)
            gained = _SAMPLE * (pushes[k] + self.mu / low**2)
            if low < r / 3 or gained > _FASTER:
                break
            speeds[k + 1] = (speeds[k] + gained) * (1 + 1e-13)
            depths[k + 1] = (depths[k] + _SAMPLE * speeds[k + 1]) * (1 + 1e-13)
        return speeds * _ROOM, depths * _ROOM

    def push(self, t: Any) -> Any:
        """Thrust over mass."""
        return self.thrust / (self.mass - self.thrust / self.exhaust * t)

    def impulse(self, t: float) -> float:
        """What the engine still gives."""
        return self.exhaust * np.log(self.push(self.latest) / self.push(t)) * _ROOM

    def excludes(self, z: list[Doubles], t: float) -> Any:
        """In which lanes no state can be part of a flight that touches down by the latest time."""
        r, u, v = z[:3]
        left = self.latest - t
        k = min(int(np.ceil(left / _SAMPLE)), len(self.speeds) - 1)
        W, D = self.speeds[k], self.depths[k]
        out = (r.low > self.r + D) | (r.high < self.r - D)
        for speed in (u, v):
            out |= (speed.low > W) | (speed.high < -W)
        s = np.linspace(0.0, left, 41)
        ends = np.minimum(np.ceil((left - s[:-1]) / _SAMPLE).astype(int), len(self.depths) - 1)
        highest = back = np.broadcast_to(self.r + self.depths[ends], (len(r.c), 40))
        if self.turns[k] < 0.5 * np.pi:
            # Seen along where it is at s, gravity has not pushed it there: it is no farther than without it.
            rise, along = np.maximum(v.high, 0.0)[:, None], u.size[:, None]
            up = np.maximum(r.high[:, None] + rise * s[1:], -(r.low[:, None] + v.low[:, None] * s[1:]))
            highest = np.minimum(np.hypot(up, along * s[1:]) + 0.5 * self.push(t + s[1:]) * s[1:] ** 2, back)
        highest = highest.max(axis=1) * _ROOM
        off = r * u - self.r * self.u
        nearest = np.maximum(off.low, -off.high) - 1e-6 * self.r
        return out | (nearest > highest * self.impulse(t))
