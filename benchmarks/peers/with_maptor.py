"""maptor: adaptive meshing at its default tolerance, straight guess for every state as its documentation shows.

It scales nothing by itself, and its larger examples divide by scales by hand; so does this.
"""

from __future__ import annotations

from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from answer import Answer, Read, main, pieces
from task import Task, straight

DEGREES = (6, 6, 6)
TOLERANCE = 1e-6


def setup(task: Task) -> Any:
    """As in the package's container crane example."""
    import casadi
    import maptor

    problem = maptor.Problem("peer")
    phase = problem.set_phase(1)
    clock = task.guess_time
    phase.time(initial=0.0, final=(0.1, 2.0))
    states = [
        phase.state(name, initial=first / size, **({"final": task.end[name] / size} if name in task.end else {}))
        for name, first, size in zip(task.states, task.start, task.scale, strict=True)
    ]
    control = phase.control(task.control, boundary=task.bounds)
    rates = task.rates([x * size for x, size in zip(states, task.scale, strict=True)], control, casadi)
    phase.dynamics({x: clock * rate / size for x, rate, size in zip(states, rates, task.scale, strict=True)})
    problem.minimize(task.objective(states[-1].final * task.scale[-1]) / abs(task.optimum))
    breaks = np.linspace(-1.0, 1.0, len(DEGREES) + 1)
    phase.mesh(list(DEGREES), breaks.tolist())
    line = [
        np.array([straight(task, f) for f in 0.5 * (1 + np.linspace(a, b, n + 1))]).T / np.array(task.scale)[:, None]
        for a, b, n in zip(breaks[:-1], breaks[1:], DEGREES, strict=True)
    ]
    phase.guess(states=line, controls=[np.full((1, n), task.guess_control) for n in DEGREES], terminal_time=1.0)

    def solve() -> Read:
        solution = maptor.solve_adaptive(
            problem,
            error_tolerance=TOLERANCE,
            nlp_options={"ipopt.print_level": 0, "print_time": 0},
            show_summary=False,
        )
        if not solution.status["success"]:
            raise RuntimeError(solution.status["message"])

        def read() -> Answer:
            mesh, end = solution.phases[1]["mesh"], solution.phases[1]["times"]["final"] * clock
            degrees = [int(n) for n in mesh["polynomial_degrees"]]
            first = [0, *accumulate(degrees)]
            time, value = solution[(1, "time_controls")] * clock, solution[(1, task.control)]
            parts = [slice(a, b) for a, b in pairwise(first)]
            return Answer(
                mass=float(solution[(1, task.states[-1])][-1] * task.scale[-1]),
                time=float(end),
                control=pieces(
                    (0.5 * (1 + np.asarray(mesh["mesh_nodes"])) * end).tolist(),
                    [time[s].tolist() for s in parts],
                    [value[s].tolist() for s in parts],
                ),
                grid=f"Radau, mesh to {TOLERANCE:g} (its default): {sum(degrees)} nodes in {len(degrees)} intervals",
            )

        return read

    return solve


if __name__ == "__main__":
    main("maptor", "maptor", setup)
