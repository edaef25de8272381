"""Largest values of quantities along a flight and their times, for the names in `Views.peaks`."""

from __future__ import annotations

from typing import Any

import numpy as np

from perilune.problem.variables import Variable

_POINTS, _NEARER, _ROUNDS = 401, 9, 12  # looked at first; then, each time, four times closer about the largest


def peaks(solution: Any) -> tuple[list[Variable], list[float]]:
    """Return the variables, and their values: the largest of each quantity and the time at which it is reached [s]."""
    variables, values = list[Variable](), list[float]()
    for name in solution.problem.views.peaks:
        best, since, of = (-np.inf, 0.0), 0.0, Variable(name=name)
        for k, (phase, flown) in enumerate(zip(solution.problem.phases, solution.trajectories, strict=True)):
            for variable in (v for v in phase.output_variables if v.name == name):
                of = variable
                value, when = _largest(solution, k, name, flown.duration)
                best = max(best, (value, since + when))
            since += flown.duration
        what = "largest along the flight" + (f": {of.description}" if of.description else "")
        label = f"peak {of.label}" if of.label else ""
        largest, at = peak_names(name)
        variables += [
            Variable(name=largest, unit=of.unit, description=what, label=label),
            Variable(name=at, unit="s", description="time from the start of the flight"),
        ]
        values += best
    return variables, values


def peak_names(name: str) -> tuple[str, str]:
    """Return the names of the largest value of a quantity, and of its time."""
    return f"peak_{name}", f"peak_{name}_time"


def _largest(solution: Any, k: int, name: str, duration: float) -> tuple[float, float]:
    low, high, best, when = 0.0, duration, -np.inf, 0.0
    for count in (_POINTS, *(_NEARER,) * _ROUNDS):
        t = np.linspace(low, high, count)
        values = solution.outputs(k, t)[name]
        i = int(np.argmax(values))
        best, when = float(values[i]), float(t[i])
        low, high = t[max(i - 1, 0)], t[min(i + 1, count - 1)]
    return best, when
