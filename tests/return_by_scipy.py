"""Returns from orbit flown forward by SciPy, under any control: nothing of the solver, and nothing optimal."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import perilune as pl
from perilune.core import NUMERIC

EXACT: dict[str, Any] = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-6}


def fly(problem: pl.Problem, free: Any, law: Any, changed: Any = {}, late: float = 0.0) -> list[Any]:  # noqa: B006
    """Each phase in turn, to its length or to where its first end condition is met: times, states, rates.

    Parameters
    ----------
    problem, free
        The return, and the lengths of the phases without end conditions.
    law
        ``law(k, t, x)`` returns the control of phase k.
    changed
        Parameters with other values.
    late
        By how many seconds ignition is late.
    """
    p = SimpleNamespace(**{**vars(problem.parameters(free)), **changed})
    x, found = np.array(problem.start(p, NUMERIC), dtype=float), list[Any]()
    for k, phase in enumerate(problem.phases):
        if k:
            x = np.array(problem.links[k - 1](problem.phases[k - 1].state_record(*x), p, NUMERIC), dtype=float)

        def slope(t: float, y: Any, phase: Any = phase, k: int = k) -> Any:
            return np.array(phase.rates(y, law(k, t, y), p), dtype=float)

        if phase.name == "burn" and late:
            idle = SimpleNamespace(**{**vars(p), "vehicle_thrust": 0.0})
            x = solve_ivp(lambda t, y: phase.rates(y, law(1, 0.0, y), idle), (0.0, late), x, **EXACT).y[:, -1]  # noqa: B023

        def met(t: float, y: Any, phase: Any = phase) -> float:
            return float(phase.evaluate("end", y, (), p)[0]) if t > 1 else 1.0

        met.terminal = True  # type: ignore[attr-defined]
        stops = [met] if phase.end_conditions else []
        length = 1e4 if stops else getattr(p, phase.duration)
        flown = solve_ivp(slope, (0.0, length), x, events=stops, dense_output=True, **EXACT)
        assert not stops or flown.status == 1
        t = np.linspace(0.0, flown.t[-1], 1501)
        found.append((t, flown.sol(t).T, slope))
        x = flown.y[:, -1]
    return found


def backwards(x: Any, p: Any) -> Any:
    """Unit vector against the inertial velocity."""
    back = -np.array([x[3] - p.body_rotation_rate * x[1], x[4] + p.body_rotation_rate * x[0], x[5]])
    return back / np.linalg.norm(back)
