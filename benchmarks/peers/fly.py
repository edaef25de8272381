"""The one external integration: an answer's control, flown from the start by SciPy's DOP853, piece by piece."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from task import Task

RELATIVE = 1e-13


@dataclass(frozen=True, kw_only=True)
class Flight:
    """What a control really does: J, misses of the end conditions, how far the control leaves its bounds; SI."""

    objective: float
    misses: tuple[float, ...]
    outside: float


def fly(task: Task, control: list[dict[str, Any]]) -> Flight:
    """Fly the control; each piece is started anew, so that its jumps cost no accuracy."""
    x, outside, clock = np.array(task.start), 0.0, 0.0
    functions = SimpleNamespace(sin=math.sin, cos=math.cos)
    for piece in control:
        begin, end = piece["begin"], piece["end"]
        assert abs(begin - clock) <= 1e-9 * task.guess_time, "the control has a gap"
        if end <= begin:
            continue
        u = np.polynomial.Chebyshev.fit(
            piece["nodes"], piece["values"], deg=len(piece["nodes"]) - 1, domain=[begin, end]
        )
        values = u(np.linspace(begin, end, 33))
        outside = max(outside, float(np.max(values)) - task.bounds[1], task.bounds[0] - float(np.min(values)))
        flown = solve_ivp(
            lambda t, y, u=u: task.rates(y, float(u(t)), functions),
            (begin, end), x, method="DOP853", rtol=RELATIVE, atol=RELATIVE * np.array(task.scale),
        )  # fmt: skip
        assert flown.success, flown.message
        x, clock = flown.y[:, -1], end
    return Flight(
        objective=task.objective(float(x[-1])),
        misses=tuple(float(x[task.states.index(name)]) - value for name, value in task.end.items()),
        outside=max(outside, 0.0),
    )
