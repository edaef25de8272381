"""The two problems that every package is given, in numbers that no package owns: SI, and rates by plain arithmetic.

*landing*: Cho, Kim, Leeghim 2015 without the retro burn. Altitude h, transverse and radial velocity u and v, mass m;
constant thrust at the angle beta from transverse towards radial; J = -m(t_f). Ours has the distance from the centre for
the altitude and a fifth state, the position angle, on which nothing depends; the peers are spared it.

*meditch*: Meditch 1964, vertical soft landing of least integral of thrust, which the mass measures: J = c (m0 - m_f).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

MU, RADIUS, ROTATION = 4902.7779e9, 1738.14e3, 2.6617e-6
MASS, THRUST, SPECIFIC_IMPULSE, STANDARD_GRAVITY = 300.0, 440.0, 310.0, 9.81
EXHAUST_SPEED = SPECIFIC_IMPULSE * STANDARD_GRAVITY
PERILUNE, PARKING = RADIUS + 15e3, RADIUS + 100e3
PERILUNE_SPEED = math.sqrt(MU * (2 / PERILUNE - 2 / (PERILUNE + PARKING)))
MASS_FLOW = THRUST / EXHAUST_SPEED
LANDED_MASS = 154.541346870902  # kg: ../../tests/landing_by_scipy.py; certified to 154.54134687
HEAVIER, LANDED_HEAVIER = 303.0, 155.700211020163  # kg: the same, for another mass at ignition

GRAVITY, EXHAUST, FULL = 1.0, 2.349, 1.227


@dataclass(frozen=True, kw_only=True)
class Task:
    """One problem for every package.

    Parameters
    ----------
    states
        Their names; mass is the last.
    rates
        Of the states, from the states, the control and the module that has sin and cos.
    start, guess_end, scale
        Values of the states at the start, at the end of the straight line that every peer starts from, and their sizes.
    end
        Required end values by state.
    control, guess_control, bounds
        Name, guess and bounds of the one control.
    guess_time
        Of the flight [s].
    objective
        J of the end mass.
    optimum
        J of the optimum.
    end_units
        Of the end conditions, in the order of `end`.
    """

    states: tuple[str, ...]
    rates: Callable[[Sequence[Any], Any, Any], tuple[Any, ...]]
    start: tuple[float, ...]
    guess_end: tuple[float, ...]
    scale: tuple[float, ...]
    end: dict[str, float]
    control: str
    guess_control: float
    bounds: tuple[float, float]
    guess_time: float
    objective: Callable[[float], float]
    optimum: float
    end_units: tuple[str, ...]


def _landing_rates(x: Sequence[Any], beta: Any, xp: Any) -> tuple[Any, ...]:
    """Cho et al. (1), (3)-(5)."""
    h, u, v, mass = x
    r, a = RADIUS + h, THRUST / mass
    return (
        v,
        a * xp.cos(beta) - u * v / r,
        u * u / r - MU / (r * r) + a * xp.sin(beta),
        -MASS_FLOW + 0.0 * mass,
    )


def _meditch_rates(x: Sequence[Any], thrust: Any, xp: Any) -> tuple[Any, ...]:
    _, v, mass = x
    return (v, thrust / mass - GRAVITY, -thrust / EXHAUST)


def _meditch_optimum(height: float, speed: float) -> float:
    """Free fall, then full thrust: the rocket equation in closed form, its one unknown, the burn, by bisection."""
    flow = FULL / EXHAUST

    def missed(burn: float) -> float:
        left = 1 - flow * burn
        ignition_speed = GRAVITY * burn + EXHAUST * math.log(left)
        ignition_height = height + (speed**2 - ignition_speed**2) / (2 * GRAVITY)
        risen = EXHAUST * (left * math.log(left) - left + 1) / flow
        return ignition_height + ignition_speed * burn - GRAVITY * burn**2 / 2 + risen

    low, high = 0.5, 1.8
    assert missed(low) * missed(high) < 0
    for _ in range(200):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if missed(low) * missed(middle) > 0 else (low, middle)
    return FULL * low


LANDING = Task(
    states=("h", "u", "v", "m"),
    rates=_landing_rates,
    start=(PERILUNE - RADIUS, PERILUNE_SPEED, 0.0, MASS),
    guess_end=(0.0, RADIUS * ROTATION, 0.0, 150.0),
    scale=(15e3, 1700.0, 50.0, MASS),
    end={"h": 0.0, "u": RADIUS * ROTATION, "v": 0.0},
    control="beta",
    guess_control=3.0,  # not pi, where a derivative vanishes: dymos did not converge from there
    bounds=(math.pi / 2, 3 * math.pi / 2),
    guess_time=1000.0,
    objective=lambda mass: -mass,
    optimum=-LANDED_MASS,
    end_units=("m", "m/s", "m/s"),
)

MEDITCH = Task(
    states=("h", "v", "m"),
    rates=_meditch_rates,
    start=(1.0, -0.783, 1.0),
    guess_end=(0.0, 0.0, 0.4),
    scale=(1.0, 1.0, 1.0),
    end={"h": 0.0, "v": 0.0},
    control="thrust",
    guess_control=0.5 * FULL,
    bounds=(0.0, FULL),
    guess_time=1.5,
    objective=lambda mass: EXHAUST * (1.0 - mass),
    optimum=_meditch_optimum(1.0, -0.783),
    end_units=("m", "m/s"),
)

TASKS = {"landing": LANDING, "meditch": MEDITCH}
# The same tasks with other values: a heavier lander, a higher start.
HIGHER = 1.02
OTHERS = {
    "landing": replace(LANDING, start=(*LANDING.start[:-1], HEAVIER), optimum=-LANDED_HEAVIER),
    "meditch": replace(MEDITCH, start=(HIGHER, *MEDITCH.start[1:]), optimum=_meditch_optimum(HIGHER, MEDITCH.start[1])),
}


def straight(task: Task, fraction: float) -> list[float]:
    """States on the straight line from the start to the guessed end, at a fraction of the time."""
    return [a + (b - a) * fraction for a, b in zip(task.start, task.guess_end, strict=True)]
