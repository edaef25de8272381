"""What lift moves an entry to the side: a bound that no flown entry passes, and what is refused by it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import perilune as pl
from perilune.core import NUMERIC, InfeasibleError
from perilune.models.deorbit.ballistic_fall import terminal_speed
from perilune.models.physics.crossrange import glide_limits
from perilune.problem import preflight
from perilune.scenario import load_file

CAPSULE = Path(__file__).parents[2] / "examples" / "capsule_return.toml"
FAR = ("site.longitude=-173 deg", "site.latitude=33.42 deg")


def flown(p: Any, air: Any, angle: float, speed: float, banks: tuple[float, ...], lasts: float) -> tuple[float, float]:
    """Angle to the side of its first plane, and behind the orbit [rad], of an entry in its steps of bank."""
    mu, spin, density = p.body_gravitational_parameter, np.array([0.0, 0.0, p.body_rotation_rate]), air.density
    up, aside = (
        np.array([1.0, 0.0, 0.0]),
        np.array([0.0, -math.sin(p.orbit_inclination), math.cos(p.orbit_inclination)]),
    )
    ahead, gate = np.cross(aside, up), p.body_radius + p.interface_altitude

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        r, v = y[:3], y[3:]
        distance, wind = np.linalg.norm(r), v - np.cross(spin, r)
        fast = np.linalg.norm(wind)
        drag = (
            float(density(distance - p.body_radius, p, NUMERIC))
            * fast**2
            * p.vehicle_drag_area
            / (2 * p.separation_mass)
        )
        level = np.cross(r, wind) / np.linalg.norm(np.cross(r, wind))
        bank = banks[min(int(len(banks) * t / lasts), len(banks) - 1)]
        lifted = math.cos(bank) * np.cross(wind / fast, level) + math.sin(bank) * level
        return np.concatenate([v, -mu * r / distance**3 - drag * (wind / fast - p.vehicle_lift_to_drag * lifted)])

    def landed(_: float, y: np.ndarray) -> float:
        return float(np.linalg.norm(y[:3])) - p.body_radius - p.site_altitude

    landed.terminal = True  # type: ignore[attr-defined]
    start = [*(gate * up), *(speed * (math.cos(angle) * ahead + math.sin(angle) * up))]
    found = solve_ivp(slope, (0.0, 8000.0), start, rtol=1e-7, atol=1e-2, events=landed)
    assert found.status == 1
    r = found.y[:3, -1] / np.linalg.norm(found.y[:3, -1])
    swept = math.atan2(float(r @ ahead), float(r @ up)) % (2 * math.pi)
    return abs(math.asin(float(r @ aside))), found.t[-1] * math.sqrt(mu / gate**3) - swept


@pytest.mark.parametrize("lift", [0.25, 0.6])
def test_no_entry_is_moved_further(lift: float) -> None:
    """Banked by 45 and 90 degrees, and in turn: less than a third of the bound, with which it grows."""
    problem = load_file(CAPSULE, [f"vehicle.lift_to_drag={lift}"]).problem
    p, air = problem.parameters({}), problem.preflight.keywords["air"]  # type: ignore[union-attr]
    altitudes = np.linspace(p.site_altitude, p.interface_altitude, 101)
    aside, behind = glide_limits(
        p, altitudes, np.array([terminal_speed(p, air, float(at)) for at in altitudes]), 7900.0
    )
    degree, far, late = math.radians(1.0), list[float](), list[float]()
    for angle, banks in (
        (-1.5, (45.0,)), (-2.5, (45.0,)), (-4.0, (60.0,)), (-2.5, (0.0, 90.0)), (-2.5, (90.0, 0.0)),
        (-3.5, (20.0, 70.0)),
    ):  # fmt: skip
        one, other = flown(p, air, angle * degree, 7800.0, tuple(bank * degree for bank in banks), 500.0)
        far.append(one)
        late.append(other)
    assert math.pi**2 / 100 * lift**2 < max(far) < aside / 3
    assert 0.05 < max(late) < behind


def test_a_site_beside_what_lift_reaches_is_refused_at_once() -> None:
    """5000 km aside: there is no answer that 13 s of search could find; 800 km are only warned of."""
    with pytest.raises(InfeasibleError, match="lift moves to the side"):
        pl.solve(load_file(CAPSULE, FAR).problem)
    found = {f.name: f for f in preflight(load_file(CAPSULE, ("site.longitude=-158 deg",)).problem)}
    assert found["distance of the site from the plane of the orbit"].verdict == "warning"
    assert all(f.passed for f in preflight(load_file(CAPSULE).problem))
    high = load_file(
        CAPSULE, (*FAR, "vehicle.dry_mass=4000 kg")
    ).problem  # its propellant could make it so fast that it skips out for hours
    assert all(f.verdict != "impossible" for f in preflight(high) if f.name.startswith("distance of the site"))
