"""rockit: multiple shooting with Runge-Kutta steps as in its first example, scales as in its scaling example.

The control is constant on each interval, its default, where the optimum jumps, and linear (``order=1``) where it is
smooth.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from answer import Answer, Read, main, pieces
from task import Task, straight

INTERVALS, STEPS = 50, 2


def setup(task: Task) -> Any:
    """As in the package's first example."""
    import casadi
    import rockit

    smooth = task.control == "beta"
    ocp = rockit.Ocp(T=rockit.FreeTime(task.guess_time))
    states = [ocp.state(scale=size) for size in task.scale]
    control = ocp.control(order=1 if smooth else 0)
    for x, rate, size in zip(states, task.rates(states, control, casadi), task.scale, strict=True):
        ocp.set_der(x, rate, scale=size / task.guess_time)
    for name, x, first, size in zip(task.states, states, task.start, task.scale, strict=True):
        ocp.subject_to(ocp.at_t0(x) == first, scale=size)
        if name in task.end:
            ocp.subject_to(ocp.at_tf(x) == task.end[name], scale=size)
    ocp.subject_to(task.bounds[0] <= (control <= task.bounds[1]))
    ocp.add_objective(task.objective(ocp.at_tf(states[-1])) / abs(task.optimum))
    for i, x in enumerate(states):
        ocp.set_initial(x, np.array([straight(task, f)[i] for f in np.linspace(0, 1, INTERVALS + 1)]))
    ocp.set_initial(control, task.guess_control)
    ocp.solver("ipopt", {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False})
    ocp.method(rockit.MultipleShooting(N=INTERVALS, M=STEPS, intg="rk"))

    def solve() -> Read:
        solution = ocp.solve()

        def read() -> Answer:
            time, value = solution.sample(control, grid="control")
            mass = solution.sample(states[-1], grid="control")[1]
            nodes = np.column_stack((time[:-1], time[1:])) if smooth else time[:-1, None]
            values = np.column_stack((value[:-1], value[1:])) if smooth else value[:-1, None]
            return Answer(
                mass=float(mass[-1]),
                time=float(time[-1]),
                control=pieces(time.tolist(), nodes.tolist(), values.tolist()),
                grid=f"multiple shooting, {INTERVALS} intervals of {STEPS} Runge-Kutta steps, "
                f"control piecewise {'linear' if smooth else 'constant'}",
            )

        return read

    return solve


if __name__ == "__main__":
    main("rockit", "rockit-meco", setup)
