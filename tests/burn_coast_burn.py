"""Burn, coast, burn in the plane by collocation and IPOPT: what `test_strong_landers` compares with; nothing of ours.

Distance r, speeds upwards and ahead, mass, in units of the body's radius, its circular speed there and the first mass;
Radau points, three an interval. The coast ends its first part at its lowest point, on the ground: an inequality at the
points alone lets it dip 80 m below between them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

POINTS = 3
BURN, COAST = "burn", "coast"
STANDARD_GRAVITY = 9.80665


def rates_of_polynomials() -> tuple[np.ndarray, np.ndarray]:
    """Return the points of an interval, and the slopes of the Lagrange polynomials at them."""
    tau = np.append(0.0, ca.collocation_points(POINTS, "radau"))
    slopes = np.zeros((POINTS + 1, POINTS + 1))
    for j in range(POINTS + 1):
        others = np.delete(tau, j)
        polynomial = np.poly1d(others, r=True) / np.prod(tau[j] - others)
        slopes[j] = np.polyder(polynomial)(tau)
    return tau, slopes


def landed_mass(
    mu: float,
    radius: float,
    mass: float,
    thrust: float,
    isp: float,
    altitude: float,
    speed: float,
    *,
    touched: bool = True,
    grazing: str = COAST,
    intervals: Sequence[int] = (4, 60, 10, 40),
) -> tuple[float, list[float]]:
    """Return the landed mass [kg] from a level start, and the lengths of burn, coast (two parts) and burn [s].

    Where the last burn is `grazing` it has two parts, and the coast one.
    """
    unit, g = math.sqrt(mu / radius), mu / radius**2
    second, exhaust, push = radius / unit, isp * STANDARD_GRAVITY / unit, thrust / mass / g
    r0, v0 = 1 + altitude / radius, speed / unit
    semi = 0.5 * (r0 + 1)
    apex, lowest = math.sqrt(2 / r0 - 1 / semi), math.sqrt(2 - 1 / semi)
    first = exhaust / push * (1 - math.exp(-(v0 - apex) / exhaust))
    left = 1 - push / exhaust * first
    last = left * exhaust / push * (1 - math.exp(-lowest / exhaust))
    lengths = [first, math.pi * semi**1.5, 0.4 * last, last]

    def drawn(k: int, s: float) -> list[float]:
        if k == 0:
            return [r0, 0.0, v0 + (apex - v0) * s, 1 + (left - 1) * s]
        if k == 1:
            mean, e = math.pi * (1 + s), r0 / semi - 1
            E = mean
            for _ in range(40):
                E -= (E - e * math.sin(E) - mean) / (1 - e * math.cos(E))
            r = semi * (1 - e * math.cos(E))
            return [r, math.sqrt(semi) * e * math.sin(E) / r, math.sqrt(semi * (1 - e * e)) / r, left]
        return [1.0, 0.0, lowest, left] if k == 2 else [1.0001, 0.0, lowest * (1 - s), left - push / exhaust * last * s]

    w, start, low, high, g, least, most = [], [], [], [], [], [], []

    def unknown(values: Sequence[float], lower: Any, upper: Any) -> Any:
        w.append(ca.MX.sym("w", len(values)))
        start.extend(values)
        low.extend(np.broadcast_to(lower, len(values)).tolist())
        high.extend(np.broadcast_to(upper, len(values)).tolist())
        return w[-1]

    def condition(value: Any, lower: float = 0.0, upper: float = 0.0) -> None:
        g.append(value)
        least.extend([lower] * value.numel())
        most.extend([upper] * value.numel())

    tau, slopes = rates_of_polynomials()
    x: Any
    x, durations = ca.DM([r0, 0.0, v0, 1.0]), []
    for k, kind in enumerate((BURN, COAST, grazing, BURN)):
        durations.append(unknown([lengths[k]], 1e-5, 40.0))
        for i in range(intervals[k]):
            states = [x]
            for j in range(1, POINTS + 1):
                states.append(unknown(drawn(k, (i + tau[j]) / intervals[k]), [0.3, -10.0, -10.0, 0.01], 50.0))
            for j in range(1, POINTS + 1):
                r, up, ahead, m = ca.vertsplit(states[j])
                u, share = ca.DM([0.0, 0.0]), 0.0
                if kind == BURN:
                    u, share = unknown([0.3, -0.95] if k else [0.0, -1.0], -1.0, 1.0), 1.0
                    condition(ca.dot(u, u), 1.0, 1.0)
                    if touched:
                        condition(r - 1, 0.0, math.inf)
                a = push * share / m
                f = ca.vertcat(
                    up, ahead**2 / r - 1 / r**2 + a * u[0], -up * ahead / r + a * u[1], -push * share / exhaust
                )
                slope = sum(slopes[q, j] * states[q] for q in range(POINTS + 1))
                condition(slope - durations[k] / intervals[k] * f)
            x = states[-1]
        if k == (1 if grazing == COAST else 2) and touched:
            condition(x[0] - 1)
            condition(x[1])
    condition(ca.vertcat(x[0] - 1, x[1], x[2]))
    every = ca.vertcat(*w)
    options = {"ipopt.print_level": 0, "print_time": 0, "ipopt.sb": "yes", "ipopt.tol": 1e-10}
    solver = ca.nlpsol("truth", "ipopt", {"x": every, "f": -x[3], "g": ca.vertcat(*g)}, options)
    found = solver(x0=start, lbx=low, ubx=high, lbg=least, ubg=most)
    assert solver.stats()["success"], solver.stats()["return_status"]
    times = ca.Function("times", [every], [ca.vertcat(*durations)])(found["x"])
    return -float(found["f"]) * mass, (np.array(times).ravel() * second).tolist()
