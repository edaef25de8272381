"""Where quantities along a flight are largest: what `Views.peaks` names."""

from __future__ import annotations

from typing import Any

import numpy as np

from perilune.problem.variables import Variable

_POINTS, _NEARER, _ROUNDS = 401, 9, 12  # looked at first; then, each time, four times closer about the largest


def peaks(solution: Any) -> tuple[list[Variable], list[float]]:
    """The largest value of each and when it is reached, and what they are."""
    variables, values = list[Variable](), list[float]()
    for name in solution.problem.views.peaks:
        found, since = (-np.inf, 0.0, "1"), 0.0
        for k, (phase, flown) in enumerate(zip(solution.problem.phases, solution.trajectories, strict=True)):
            for unit in (v.unit for v in phase.output_variables if v.name == name):
                value, when = _largest(solution, k, name, flown.duration)
                found = max(found, (value, since + when, unit))
            since += flown.duration
        variables += [
            Variable(name=f"peak_{name}", unit=found[2], description="largest along the flight"),
            Variable(name=f"peak_{name}_time", unit="s", description="when, from the begin of the flight"),
        ]
        values += found[:2]
    return variables, values


def _largest(solution: Any, k: int, name: str, duration: float) -> tuple[float, float]:
    low, high, best, when = 0.0, duration, -np.inf, 0.0
    for count in (_POINTS, *(_NEARER,) * _ROUNDS):
        t = np.linspace(low, high, count)
        values = solution.outputs(k, t)[name]
        i = int(np.argmax(values))
        best, when = float(values[i]), float(t[i])
        low, high = t[max(i - 1, 0)], t[min(i + 1, count - 1)]
    return best, when
