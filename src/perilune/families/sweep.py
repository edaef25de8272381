"""Sweep: solve a problem along some of its parameters, anywhere, and go on after a break."""

from __future__ import annotations

from pathlib import Path

from perilune.core import (
    Watch,
    check_call,
    ignore_events,
    renamed_keywords,
    require_callable,
    require_level,
    require_path,
    require_type,
)
from perilune.families.executors import Submits, require_executor
from perilune.families.family import Family, FamilyPoint, Over, member_values
from perilune.families.members import Members
from perilune.families.store import FamilyStore
from perilune.methods import Method
from perilune.problem import LEVELS, Problem, Tolerance
from perilune.solve import require_time_limit
from perilune.verify import method_or_default, require_tolerance


@renamed_keywords(level="verify", watch="callback")
@check_call
def sweep(
    problem: Problem,
    over: Over,
    method: Method | None = None,
    *,
    verify: int = 0,
    tolerance: Tolerance | None = None,
    executor: Submits | None = None,
    store: str | Path | None = None,
    callback: Watch | None = None,
    time_limit: float | None = None,
) -> Family:
    """Solve along parameters.

    Without an executor, members of the indirect method along one parameter are continued from neighbour to neighbour.

    Parameters
    ----------
    problem
        The problem; its own values of the parameters are not used.
    over
        ``{name: values, ...}``, of which the family is the grid (the last name changes fastest), or a list of points
        ``{name: value, ...}``; values in SI. A dot in a name may stand for an underscore. A free parameter named here
        is fixed to the values.
    method
        ``Indirect()`` unless another is given.
    verify
        Verification level of each member, 0 for none.
    tolerance
        Differences that do not matter to the proof of any member, as of `perilune.solve.solve`.
    executor
        Where the members are computed: a `concurrent.futures.Executor` (a process pool, say) or a Dask client.
    store
        Directory into which each member is written as soon as it is there. The same sweep with the same directory goes
        on where it was broken off, whatever broke it off: what is there is proved again to the level, and solved again
        where that fails. At level 0, and of a member that was not found, the message begins with "as stored".
    callback
        Receives lines of text, ``... (n of N)`` for each member, and each iteration that is made here.
    time_limit
        Of each member [s], as of `perilune.solve.solve`; one whose time is over is not found, and says so.

    Returns
    -------
    Family
        In the order that was asked for. Members that physics refuses or that are not found say why. What was done
        before Ctrl-C, if it was pressed.

    Raises
    ------
    PeriluneError
        If `over` names what is no parameter, the store is of another sweep, or a worker was lost.
    """
    require_type(problem, Problem, "a problem to sweep")
    require_level(verify, (0, *LEVELS))
    require_tolerance(tolerance)
    names, values = member_values(problem, over)
    require_callable(callback, "a callback")
    require_executor(executor)
    say = callback or ignore_events
    members = Members(
        problem=problem, names=names, values=values, method=method_or_default(method), level=verify,
        tolerance=tolerance or Tolerance(), watch=say, time_limit=require_time_limit(time_limit, verify),
    )  # fmt: skip
    notes: list[str] = []

    def note(text: str) -> None:
        notes.append(text)
        say(text)

    kept = None if store is None else FamilyStore(require_path(store, "the directory of a store"), members)
    stored = {} if kept is None else kept.open(note)
    if stored:
        say(f"{len(stored)} of {len(values)} members are in the store")
    done: dict[int, FamilyPoint] = {}
    interrupted = False
    try:
        for i, point in members.taken_over(stored, executor, note):
            done[i] = point
        for i, point in members.solved([i for i in range(len(values)) if i not in done], executor):
            done[i] = point
            if kept is not None:
                kept.write(i, point)
    except KeyboardInterrupt:
        interrupted = True
    points = tuple(done[i] for i in sorted(done))
    return Family(problem=problem, parameters=names, points=points, interrupted=interrupted, notes=tuple(notes))
