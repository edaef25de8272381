"""The lander and its engines, as every model knows them. SI units."""

from __future__ import annotations

from typing import Any

from perilune.core import STANDARD_GRAVITY, PeriluneError, quantity, record
from perilune.problem import ScalarControl

# Cold gas has about 60 s and hydrogen with oxygen 465 s; exhaust velocities in m/s begin at several hundred.
_SPECIFIC_IMPULSE: dict[str, Any] = {
    "above": 20.0,
    "most": 1000.0,
    "hint": "an exhaust velocity in m/s, divided by 9.80665 m/s^2, is the specific impulse in seconds",
    "about": "in seconds, not an exhaust velocity",
    "also": ("isp", "exhaust_velocity", "exhaust_speed"),
}


@record("vehicle")
class Vehicle:
    """A lander before its first burn."""

    mass: float = quantity(
        "kg", "300 kg", above=0.0, about="before the first burn, propellant included", also=("wet_mass", "initial_mass")
    )  # fmt: skip
    thrust: float = quantity("N", "440 N", above=0.0, about="of the continuous engine at full throttle")
    specific_impulse: float = quantity("s", "310 s", **_SPECIFIC_IMPULSE)
    standard_gravity: float = quantity(
        "m/s^2",
        "9.80665 m/s^2",
        default=STANDARD_GRAVITY,
        above=9.7,
        most=9.9,
        hint="omit it: it converts seconds of specific impulse to m/s and is the same on every body",
        about="converts seconds to m/s, the same on every body",
    )
    dry_mass: float | None = quantity(
        "kg",
        "120 kg",
        default=None,
        above=0.0,
        about="mass that must be left at touchdown; default: any landed mass",
        also=("empty_mass", "final_mass", "landed_mass"),
    )

    def __post_init__(self) -> None:
        if self.dry_mass is not None and self.dry_mass >= self.mass:
            raise PeriluneError(
                "vehicle.dry_mass leaves no propellant",
                got=f"{self.dry_mass:g} kg of {self.mass:g} kg",
                expected="vehicle.dry_mass < vehicle.mass",
                advice="vehicle.mass is the mass before the first burn, including propellant; check for g in place of"
                " kg",
            )


@record("retro")
class Retro:
    """An impulsive retro burn at the perilune."""

    specific_impulse: float = quantity("s", "310 s", **_SPECIFIC_IMPULSE)
    delta_v: float | None = quantity(
        "m/s",
        "1200 m/s",
        default=None,
        least=0.0,
        hint="omit delta_v to have it optimised",
        about="fixes the burn; optimised by default",
    )


_SHARE: dict[str, Any] = {
    "least": 0.0, "most": 1.0, "hint": "a fraction of vehicle.thrust: divide a thrust in newtons by it",
}  # fmt: skip


@record("throttle")
class Throttle:
    """Range of the throttle, in shares of full thrust."""

    lower: float = quantity("1", "0.3", **_SHARE, about="smallest fraction of full thrust")
    upper: float = quantity("1", "0.9", **_SHARE, about="greatest fraction of full thrust")

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise PeriluneError(
                "the throttle's bounds are not a range of fractions of full thrust",
                got=f"{self.lower:g} to {self.upper:g}",
                expected="0 <= lower < upper <= 1",
            )


THROTTLE = ScalarControl(name="throttle", lower="throttle_lower", upper="throttle_upper")  # share of full thrust
