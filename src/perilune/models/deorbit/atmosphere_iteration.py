"""Iteration of a return and the air of its day: flown and tabulated in turn until the table stays as it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from perilune.core import NotConvergedError, PeriluneError, require_type
from perilune.models.deorbit import records
from perilune.models.deorbit.problem import deorbit_entry
from perilune.models.deorbit.trajectory_atmosphere import NEAR, air_along, largest_density_change, profile_of_states
from perilune.models.physics.bodies import Planet
from perilune.models.physics.vehicle import Throttle
from perilune.problem import Problem, Solution

_ROUNDS = 6


def solve_with_epoch_air(problem: Problem, solve: Callable[..., Solution], *, near: float = NEAR) -> Solution:
    """Solve a return whose air is of a day (``nrlmsis``) in the air that its own flight meets.

    Parameters
    ----------
    problem
        A return of `perilune.models.deorbit.problem.deorbit_entry` with a record of such air.
    solve
        What finds a solution, called with a problem and with a ``guess``, as `perilune.solve`.
    near
        Largest change of the density, as a share of it, at which the table counts as the same.

    Returns
    -------
    Solution
        Of the last problem, whose air is a table and no record any more.

    Raises
    ------
    PeriluneError
        If there is no such air, or the table does not settle, or as `solve`.
    """
    require_type(problem, Problem, "a problem to solve in the atmosphere along its flight")
    air, solution, last = _air_of(problem), solve(problem), float("inf")
    for _ in range(_ROUNDS):
        again = with_air_along_flight(problem, solution)
        last = largest_density_change(air, _air_of(again))
        if last < near:
            return solution
        air, solution = _air_of(again), solve(again, guess=solution)
    raise NotConvergedError(
        "the atmosphere along the flight does not converge", got=f"densities that change by {100 * last:.2g} %",
        expected=f"at most {100 * near:.2g} %", advice="a greater `near`",
    )  # fmt: skip


def with_air_along_flight(problem: Problem, solution: Solution) -> Problem:
    """Return the same problem in the air of its epoch along a flight of it.

    Parameters
    ----------
    problem
        A return through the air of its epoch (``atmosphere.model = "nrlmsis"``).
    solution
        A flight of it, whose entry is tabulated at 401 times.

    Raises
    ------
    PeriluneError
        If the air of the problem is not that of an epoch.
    """
    stated = {type(record): record for record in problem.records}
    air, aim = stated.get(records.Atmosphere), stated.get(records.Aim, records.Aim())
    epoch = aim.instant()
    if air is None or air.model != "nrlmsis" or epoch is None:
        raise PeriluneError(
            "this problem has no atmosphere of an epoch", got=f"a problem called {problem.name}"[:80],
            expected='a return with atmosphere.model = "nrlmsis" and problem.epoch',
        )  # fmt: skip
    k = [trajectory.phase for trajectory in solution.trajectories].index("entry")
    entry = solution.trajectories[k]
    since = sum(trajectory.duration for trajectory in solution.trajectories[:k])
    time = np.linspace(0.0, entry.duration, 401)
    way = profile_of_states(entry.state(time), since + time, solution.parameters)
    made = deorbit_entry(
        stated[records.Returner], stated[records.ReturnOrbit], stated[records.Interface], stated[Planet],
        manoeuvre=stated.get(records.Manoeuvre), transition=stated.get(records.Transition),
        air=air_along(air, epoch, way), site=stated.get(records.Landing), heating=stated.get(records.Heating),
        separation=stated.get(records.Separation), limits=stated.get(records.Limits),
        parachute=stated.get(records.Parachute), minimise=aim.minimise, epoch=aim.epoch, throttle=stated.get(Throttle),
    )  # fmt: skip
    moved: dict[str, Any] = {
        name: given.value for name, given in problem.given.items() if made.given[name].value != given.value
    }
    return made.with_given(**moved) if moved else made


def _air_of(problem: Problem) -> Any:
    return problem.phases[[phase.name for phase in problem.phases].index("entry")].dynamics.keywords["air"]
