"""asset_asrl: adaptive mesh and automatic scaling as in its tutorials, guess and line search as in its examples.

Where the control jumps, the scheme whose control is linear between nodes, and nodes put at jumps
(``DetectControlSwitches``, which its tutorials do not mention) serve it best; where it is smooth, the fifth order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from answer import Answer, Read, chained, main
from task import Task, straight

SEGMENTS = 32
TOLERANCE = 1e-6  # of the mesh; its default
DEGREE = {"LGL3": 1, "LGL5": 2, "LGL7": 3}


def setup(task: Task) -> Any:
    """As in the package's Brachistochrone example and mesh and scaling tutorials."""
    import asset_asrl.OptimalControl as oc
    import asset_asrl.VectorFunctions as vf

    size, scheme = len(task.states), "LGL5" if task.control == "beta" else "LGL3"

    class Ode(oc.ODEBase):  # type: ignore[misc]
        """The rates."""

        def __init__(self) -> None:
            x = oc.ODEArguments(size, 1)
            super().__init__(vf.stack(list(task.rates(x.XVec().tolist(), x.UVar(0), vf))), size, 1)

    line = [
        np.array([*straight(task, f), f * task.guess_time, task.guess_control]) for f in np.linspace(0, 1, SEGMENTS + 1)
    ]
    phase = Ode().phase(scheme, line, SEGMENTS)
    phase.setThreads(1, 1)  # as run.py grants every package one thread
    phase.setAutoScaling(True)
    phase.setUnits(np.array([*task.scale, task.guess_time, 1.0]))
    phase.addBoundaryValue("Front", range(size + 1), [*task.start, 0.0])
    fixed = [i for i, name in enumerate(task.states) if name in task.end]
    phase.addBoundaryValue("Back", fixed, [task.end[task.states[i]] for i in fixed])
    phase.addLUVarBound("Path", size + 1, *task.bounds)
    phase.addLowerDeltaTimeBound(0.1 * task.guess_time)
    phase.addValueObjective("Back", size - 1, -1.0)  # most mass: J falls with it in both tasks
    phase.setAdaptiveMesh(True)
    phase.setMeshTol(TOLERANCE)
    phase.DetectControlSwitches = True
    phase.optimizer.set_tols(1e-9, 1e-9, 1e-9)
    phase.optimizer.set_OptLSMode("L1")
    phase.optimizer.set_MaxLSIters(2)
    phase.optimizer.set_PrintLevel(3)
    phase.PrintMeshInfo = False

    def solve() -> Read:
        flag = str(phase.optimize()).rsplit(".", 1)[-1].lower()
        if flag not in ("converged", "acceptable"):
            raise RuntimeError(f"the optimizer ended {flag}")

        def read() -> Answer:
            table = np.array(phase.returnTraj())
            segments = (len(table) - 1) // DEGREE[scheme]
            mesh = "converged" if phase.MeshConverged else "not converged"
            return Answer(
                mass=float(table[-1, size - 1]),
                time=float(table[-1, size]),
                control=chained(table[:, size].tolist(), table[:, size + 1].tolist(), DEGREE[scheme]),
                grid=f"{scheme}, mesh to {TOLERANCE:g} (its default), {mesh}: {segments} segments; optimizer {flag}",
            )

        return read

    return solve


if __name__ == "__main__":
    main("asset_asrl", "asset_asrl", setup)
