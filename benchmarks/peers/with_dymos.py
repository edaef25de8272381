"""dymos: Gauss-Lobatto, straight guess and scales as in its examples.

What the registry installs brings SciPy's SLSQP alone, a dense method; its examples prefer IPOPT or SNOPT through
pyOptSparse. The rates are differentiated by complex steps.
"""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
from typing import Any

import numpy as np
from answer import Answer, Read, main, pieces
from task import Task, straight

SEGMENTS, ORDER = 20, 3
TOLERANCE = 1e-9


def ode_of(task: Task) -> Any:
    """The class of the rates."""
    import openmdao.api as om

    class Ode(om.ExplicitComponent):  # type: ignore[misc]
        """The rates."""

        def initialize(self) -> None:
            self.options.declare("num_nodes", types=int)

        def setup(self) -> None:
            n = self.options["num_nodes"]
            for name in (*task.states, task.control):
                self.add_input(name, val=np.ones(n))
            for name in task.states:
                self.add_output(f"{name}_dot", val=np.ones(n), units="1/s")
            self.declare_partials("*", "*", method="cs")
            self.declare_coloring(wrt="*", method="cs", show_summary=False)

        def compute(self, inputs: Any, outputs: Any) -> None:
            rates = task.rates([inputs[name] for name in task.states], inputs[task.control], np)
            for name, rate in zip(task.states, rates, strict=True):
                outputs[f"{name}_dot"] = rate

    return Ode


def setup(task: Task) -> Any:
    """As in the package's brachistochrone and moon landing examples."""
    os.environ["OPENMDAO_REPORTS"] = "0"
    import dymos
    import openmdao.api as om

    problem = om.Problem(model=om.Group(), reports=None)
    problem.driver = om.ScipyOptimizeDriver(optimizer="SLSQP", tol=TOLERANCE, maxiter=500, disp=False)
    problem.driver.declare_coloring(show_summary=False)
    phase = dymos.Phase(ode_class=ode_of(task), transcription=dymos.GaussLobatto(num_segments=SEGMENTS, order=ORDER))
    problem.model.add_subsystem("traj", dymos.Trajectory()).add_phase("phase", phase)
    low, high = 0.1 * task.guess_time, 2 * task.guess_time
    phase.set_time_options(fix_initial=True, duration_bounds=(low, high), duration_ref=task.guess_time)
    for name, size in zip(task.states, task.scale, strict=True):
        phase.add_state(
            name, rate_source=f"{name}_dot", targets=[name], fix_initial=True, fix_final=name in task.end, ref=size,
            defect_ref=size,
        )  # fmt: skip
    phase.add_control(task.control, targets=[task.control], lower=task.bounds[0], upper=task.bounds[1])
    phase.add_objective(task.states[-1], loc="final", ref=-task.scale[-1])
    problem.setup(force_alloc_complex=True)
    phase.set_time_val(initial=0.0, duration=task.guess_time)
    end = straight(task, 1.0)
    for name, first, last in zip(task.states, task.start, end, strict=True):
        phase.set_state_val(name, [first, last])
    phase.set_control_val(task.control, [task.guess_control, task.guess_control])

    def solve() -> Read:
        if dymos.run_problem(problem, run_driver=True, simulate=False):
            raise RuntimeError("SLSQP did not converge")

        def read() -> Answer:
            ends = phase.options["transcription"].grid_data.segment_indices  # first and one past the last node
            time, value, mass = (
                problem.get_val(f"traj.phase.timeseries.{name}").ravel()
                for name in ("time", task.control, task.states[-1])
            )
            rows = [slice(int(first), int(last)) for first, last in ends]
            breaks = [float(time[s.start]) for s in rows] + [float(time[-1])]
            return Answer(
                mass=float(mass[-1]),
                time=float(time[-1]),
                control=pieces(breaks, [time[s].tolist() for s in rows], [value[s].tolist() for s in rows]),
                grid=f"Gauss-Lobatto, {SEGMENTS} segments of order {ORDER}; SciPy's SLSQP, tolerance {TOLERANCE:g}",
            )

        return read

    return solve


if __name__ == "__main__":
    sys.argv[2] = os.path.abspath(sys.argv[2])
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):  # it writes files where it stands
        main("dymos", "dymos", setup)
