"""Bound on how far lift moves an entry to the side, and how far it stays behind the orbit.

With lift = l drag, D the drag per mass, V the speed and u = V/V_c that of a circular orbit at the interface:

*Time.* The vertical motion of an entry from V on is, with at most sqrt(1 + l^2) D upwards,

    r'' = V_h^2/r - g + (lift and drag),   so   g (1 - u^2) T <= V_end + s V + sqrt(1 + l^2) W,   W = V + G >= int D dt

where s is the sine of the steepest climb at V, and G = int g (-sin gamma) dt what gravity gives back. Falling no slower
than steadily, this is no more than the integral of g/V_s over the altitude, V_s the speed of a steady fall there.

*Side.* While the speed falls from V_0 to V, from the interface downwards, path and heading turn by no more than
int l D/V dt <= l (ln V_0/V + g h/V^2), which bounds the climb as well, and leads no further to the side than by itself.
Later, at a speed v, it has turned by l (ln V/v + int g (-sin gamma)/v dt) more, which moves it by less than
l (v ln V/v + G) T <= l (V/e + G) T. The least over V of the sum holds.

*Behind.* It stays behind the orbit by n int (1 - u) dt <= n T of V_c, and as long the air carries it along.

What planar equations beside a body at rest leave out, a factor holds. The best glide has pi^2/48 l^2 to the side
(Eggers, Allen, Neice, NACA TN 4046, 1957), a tenth of this for l = 0.3.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from perilune.core import Vector

_SURELY = 1.2  # times what these equations say
_SPEEDS = np.linspace(0.1, 0.9, 17)  # of the circular one


def glide_limits(p: Any, altitudes: Vector, steady: Vector, fastest: float) -> tuple[float, float]:
    """Return the most that an entry with lift moves to the side, and stays behind the orbit; angles [rad].

    Parameters
    ----------
    p
        Parameters [SI], numbers all of them.
    altitudes, steady
        From the end of the entry to the interface [m], and speeds of a steady vertical fall there [m/s], (points,).
    fastest
        Largest speed V_0 at the interface [m/s].
    """
    lift, gate = p.vehicle_lift_to_drag, p.body_radius + p.interface_altitude
    pull = p.body_gravitational_parameter / (gate * gate)
    circular = math.sqrt(pull * gate)
    given_back = float(np.trapezoid(pull / np.minimum(steady, circular), altitudes))

    def lasts(speed: Any, climb: Any, left: Any) -> Any:
        upwards = p.site_speed_upper + climb * speed + math.hypot(1, lift) * (speed + given_back)
        return upwards / (pull * left)

    speed = _SPEEDS * circular
    turned = np.log(max(fastest / circular, 1.0) / _SPEEDS) + pull * p.interface_altitude / speed**2
    climb = np.sin(np.minimum(lift * turned, 0.5 * math.pi))
    later = (speed / math.e + given_back) * lasts(speed, climb, 1 - _SPEEDS**2) / gate
    slow = lasts(circular, 0.0, 1.0)
    aside = lift * float(np.min(turned + later)) + abs(p.body_rotation_rate) * slow
    return _SURELY * aside, _SURELY * slow * circular / gate
