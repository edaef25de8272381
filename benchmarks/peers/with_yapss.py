"""yapss: automatic second derivatives, scales and straight guess as in its examples, its default mesh and method."""

from __future__ import annotations

import math
from typing import Any

from answer import Answer, Read, chained, main
from task import Task


def setup(task: Task) -> Any:
    """As in the package's Goddard example."""
    import yapss
    from yapss import math as m

    problem = yapss.Problem(name="peer", nx=[len(task.states)], nu=[1])

    def objective(arg: Any) -> None:
        arg.objective = task.objective(arg.phase[0].final_state[-1])

    def continuous(arg: Any) -> None:
        arg.phase[0].dynamics[:] = task.rates(tuple(arg.phase[0].state), arg.phase[0].control[0], m)

    problem.functions.objective, problem.functions.continuous = objective, continuous
    bounds, guess, scale = problem.bounds.phase[0], problem.guess.phase[0], problem.scale.phase[0]
    bounds.initial_time.lower = bounds.initial_time.upper = 0.0
    bounds.final_time.lower, bounds.final_time.upper = 0.1 * task.guess_time, 2 * task.guess_time
    bounds.initial_state.lower[:] = bounds.initial_state.upper[:] = task.start
    for i, name in enumerate(task.states):
        if name in task.end:
            bounds.final_state.lower[i] = bounds.final_state.upper[i] = task.end[name]
    bounds.state.lower[-1] = 0.1 * task.start[-1]
    bounds.control.lower[:], bounds.control.upper[:] = (task.bounds[0],), (task.bounds[1],)
    guess.time = (0.0, task.guess_time)
    guess.state = tuple(zip(task.start, task.guess_end, strict=True))
    guess.control = ((task.guess_control, task.guess_control),)
    scale.state = scale.dynamics = [float(s) for s in task.scale]
    scale.control, scale.time = [max(map(abs, task.bounds))], task.guess_time
    problem.scale.objective = abs(task.optimum)
    problem.derivatives.order, problem.derivatives.method = "second", "auto"
    problem.ipopt_options.print_level = 0

    def solve() -> Read:
        solution = problem.solve()
        if solution.nlp_info.ipopt_status not in (0, 1):  # solved, solved to acceptable level
            raise RuntimeError(f"IPOPT ended with status {solution.nlp_info.ipopt_status}")

        def read() -> Answer:
            phase, points = solution.phase[0], problem.mesh.phase[0].collocation_points
            assert problem.spectral_method == "lgl" and len(set(points)) == 1
            assert math.isclose(phase.time_c[-1], phase.final_time)
            return Answer(
                mass=float(phase.state[-1][-1]),
                time=float(phase.final_time),
                control=chained(phase.time_c.tolist(), phase.control[0].tolist(), points[0] - 1),
                grid=f"Legendre-Gauss-Lobatto, {len(points)} segments of {points[0]} nodes (its default)",
            )

        return read

    return solve


if __name__ == "__main__":
    main("yapss", "yapss", setup)
