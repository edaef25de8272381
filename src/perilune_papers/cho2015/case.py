"""Landing of Cho, Kim, Leeghim 2015 as data: its constants, what it prints, the values its figures run over.

`PRINTED` is for comparison only. The paper does not print the Moon's constants: `CONSTANTS` are those that reproduce
its digits, so that a difference shows a slip and not another Moon.
"""

from __future__ import annotations

from dataclasses import dataclass

from perilune import Problem
from perilune.models import Body, Orbit, Retro, Vehicle, hybrid_landing
from perilune_papers.paper import Printed


@dataclass(frozen=True, kw_only=True)
class Constants:
    """The paper's case; the first three and g0 are not printed there and were found from its digits."""

    gravitational_parameter: float = 4902.7779e9  # m^3/s^2
    radius: float = 1738.14e3  # m
    rotation_rate: float = 2.6617e-6  # rad/s
    standard_gravity: float = 9.81  # m/s^2
    mass: float = 300.0  # kg
    thrust: float = 440.0  # N
    specific_impulse: float = 310.0  # s
    parking_altitude: float = 100e3  # m
    perilune_altitude: float = 15e3  # m


CONSTANTS = Constants()

# (quantity, unit): the printed value and its place in the paper. For comparison, never for computing.
PRINTED = Printed(
    {
        "perilune speed V0": (1691.96926, "m/s", "(25)"),
        "optimal retro burn": (1200.9011, "m/s", "(26)"),
        "final mass, previous solution": (154.5413, "kg", "Table 1"),
        "fuel, previous solution": (145.4587, "kg", "Table 1"),
        "final mass, proposed solution": (160.6186, "kg", "Table 1"),
        "fuel, proposed solution": (139.3814, "kg", "Table 1"),
    }
)
PRINTED_NO_BENEFIT_BELOW = 280.0  # s, the paper's text on Fig 10

RETRO_BURNS = tuple(50.0 * k for k in range(33))  # m/s, Fig 8
IMPULSES = tuple(310.0 - 2.0 * k for k in range(21))  # s, Figs 9 and 10: steps are not printed
ACCELERATIONS = (
    440.0 / 300.0,
    2.0,
    3.0,
    4.0,
    6.0,
)  # m/s^2, Fig 3: the ratios are ours, the paper's are not legible


def cho_landing(retro: Retro | None = None, *, thrust: float = CONSTANTS.thrust) -> Problem:
    """State the paper's landing; without `retro`, the ordinary one.

    Parameters
    ----------
    retro
        Retro burn with its specific impulse [s]; None for a landing without one.
    thrust
        Thrust of the main engine [N].
    """
    c = CONSTANTS
    return hybrid_landing(
        Vehicle(
            mass=c.mass,
            thrust=thrust,
            specific_impulse=c.specific_impulse,
            standard_gravity=c.standard_gravity,
        ),
        retro,
        Orbit(parking_altitude=c.parking_altitude, perilune_altitude=c.perilune_altitude),
        Body(
            name="moon",
            gravitational_parameter=c.gravitational_parameter,
            radius=c.radius,
            rotation_rate=c.rotation_rate,
        ),
    )
