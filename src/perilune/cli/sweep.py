"""The command ``sweep``: ranges from the command line to a family, and the family to a table."""

from __future__ import annotations

import math
import signal
from argparse import Namespace
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from perilune import InfeasibleError, Outcome, PeriluneError
from perilune.cli.arguments import method_settings
from perilune.cli.methods import method_of
from perilune.cli.options import time_limit
from perilune.cli.output import INTERRUPTED, CommandAnswer, WrittenFiles
from perilune.cli.progress import LONGEST_LOG, print_note, progress, refuse_unusable_target

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from perilune.families import MemberTable, Submits
    from perilune.methods import Method
    from perilune.problem import Problem
    from perilune.scenario import Scenario

Kind = TypeVar("Kind")
MEMBERS = "members"  # in the output directory: what a sweep goes on from


def sweep_answer(order: Namespace) -> CommandAnswer:
    """Solve the family and show it."""
    if order.resume and order.out is None:
        raise PeriluneError("--resume continues the sweep in a directory", expected="--out DIR", advice="name it")
    level = order.level if order.level is not None else 0 if order.batch else 1
    method, limit = _method_of_sweep(order), time_limit(order)
    from perilune.scenario import values_of

    over = ranges_of_keys(order, values_of)
    scenario = scenario_with_ranges(order.file, order.changes, over)
    axes = _axes_of_map(order, scenario.problem, over)
    if order.batch and level and scenario.tolerance.stated:
        print_note("--batch proves without the tolerances under [proof], as if none were stated")
    options: dict[str, Any] = {"verify": level, "time_limit": limit}
    if order.out is not None:
        _refuse_used_directory(order)
        options["store"] = order.out / MEMBERS
        if not order.resume:
            from perilune.families import clear_family

            clear_family(options["store"])
    from perilune import solve_many, sweep
    from perilune.families import grid_points, member_table

    with progress(order.verbose, deque(maxlen=LONGEST_LOG)) as watch, worker_pool(order.workers) as executor:
        options |= {"callback": watch, "executor": executor}
        if order.batch:
            found = solve_many(_with_own_values(order, scenario.problem, list(over)), grid_points(over), **options)
        else:
            found = sweep(scenario.problem, over, method=method, tolerance=scenario.tolerance, **options)
    table = member_table(found)
    for outcome, error in ((Outcome.INFEASIBLE, InfeasibleError), (Outcome.REFUSED, PeriluneError)):
        if len(table) and set(table.outcomes) == {outcome.name}:
            first, names = table.messages[0], " and ".join(table.parameters)
            raise error(f"every value of {names} is invalid", got=first, advice="try another range")
    return _answer_of_table(order, table, level, axes, math.prod(len(values) for values in over.values()))


def _answer_of_table(
    order: Namespace, table: MemberTable, level: int, axes: Mapping[str, str | None], total: int
) -> CommandAnswer:
    """Write the files of a sweep of so many values, and return its table with the exit code."""
    from perilune.report import family_csv, family_document, write_family

    files = WrittenFiles()
    if order.out is not None:
        with files.written():
            write_family(table, order.out, force=True, axes=axes)  # what may not be replaced was refused before
    ended = {*zip(table.outcomes, table.solved.tolist(), strict=True)}
    codes = [Outcome[name].exit_code if solved else 4 for name, solved in ended]
    # At level 0 no proof was asked for, so none is missing.
    worst = max((c for c in codes if c != 5 or level), default=0, key=(0, 5, 4).index)
    for text in table.notes:
        print_note(text)
    if table.interrupted:
        done = sum(name != Outcome.INTERRUPTED.name for name in table.outcomes)
        print_note(f"stopped by the user with {done} of {total} values done, which are kept")
    code = INTERRUPTED if table.interrupted else worst
    # Of very many members each takes seconds, and only one is printed.
    text, document = ("", family_document(table)) if order.as_json else (family_csv(table), {})
    return files.noted(CommandAnswer(text=text, document=document, exit_code=code))


def _method_of_sweep(order: Namespace) -> Method:
    settings = method_settings(order)
    typed = [f"--{name}" for name, value in settings.items() if value is not None]
    typed += [f"--method {order.method}"] if order.method != "indirect" else []
    if order.batch and typed:
        raise PeriluneError(
            "--batch is of the indirect method as it is", got=", ".join(typed), expected="no settings of a method",
            advice=f"leave out --batch, or {typed[0]}",
        )  # fmt: skip
    return method_of(order.method, settings)


def _axes_of_map(order: Namespace, problem: Problem, over: Mapping[str, Any]) -> dict[str, str | None]:
    """Return what was asked for as the axes of the map, which is refused here if it cannot be drawn."""
    axes = {name: getattr(order, name) for name in ("x", "y", "z")}
    if any(axes.values()):
        if order.out is None:
            raise PeriluneError(
                "--x, --y and --z choose the axes of a figure", expected="--out DIR", advice="state where it goes"
            )
        from perilune.core import parameter_name
        from perilune.report import require_map

        require_map(problem, tuple(map(parameter_name, over)), axes, order.batch)
    return axes


def _with_own_values(order: Namespace, problem: Problem, keys: Sequence[str]) -> Problem:
    """Return a problem with the values that the file has for the varied keys: a batch begins with a solution there."""
    from perilune.core import parameter_name
    from perilune.scenario import load_file

    with suppress(PeriluneError):
        own, names = load_file(order.file, order.changes).problem.given, {*map(parameter_name, keys)} & {*problem.given}
        return problem.with_given(**{name: own[name].value for name in names if name in own})
    return problem


@contextmanager
def worker_pool(count: int) -> Iterator[Executor | None]:
    """Enter a pool of processes to compute in; None for a single one."""
    if count < 2:
        yield None
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    from perilune.families import ignore_interrupt_in_children

    class Pool(ProcessPoolExecutor):
        def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Any:
            with (
                ignore_interrupt_in_children()
            ):  # a process may begin here: until it ignores Ctrl-C that would end it with a traceback
                return super().submit(fn, *args, **kwargs)

    # Spawned: a forked process would share the threads' locks of the libraries that are loaded here.
    with Pool(count, mp_context=get_context("spawn"), initializer=_initialize_sweep_worker) as pool:
        yield pool


@contextmanager
def sweep_executor(order: Namespace) -> Iterator[Submits | None]:
    """Enter the executor of a sweep: the cluster of ``--scheduler``, or ``--workers`` processes; None for one."""
    if order.scheduler is None:
        with worker_pool(order.workers) as pool:
            yield pool
        return
    if order.workers > 1:
        raise PeriluneError("--workers and --scheduler exclude each other", expected="one of the two")
    from perilune.families import cluster

    with cluster(order.scheduler, print_note) as machines:
        yield machines


def _initialize_sweep_worker() -> None:
    """Initialise a process of the pool: leave Ctrl-C to the parent, and end if that is killed."""
    from perilune.families import end_with_parent

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()


def ranges_of_keys(order: Namespace, read: Callable[[str, str, Mapping[str, Any]], Kind]) -> dict[str, Kind]:
    """Return what `read` makes of the range of each key that is varied.

    Parameters
    ----------
    order
        Parsed command line, with `file`, `changes` and `vary`.
    read
        ``read(key, text, quantities)`` interprets the text of a range.

    Raises
    ------
    PeriluneError
        If a key is varied twice, or both varied and set.
    """
    from perilune.scenario import quantities_of

    known, over = quantities_of(order.file, order.changes), dict[str, Kind]()
    changed = {change.partition("=")[0].strip() for change in order.changes}
    for range_ in order.vary:
        key, _, text = (part.strip() for part in range_.partition("="))
        if key in over:
            raise PeriluneError(
                f"--vary names {key} twice", got=range_, expected="each key once", advice="give each range separately"
            )
        if key in changed:
            raise PeriluneError(
                f"{key} is both varied and set", got=f"--vary and --set {key}", expected="one of the two"
            )
        over[key] = read(key, text, known)
    return over


def _refuse_used_directory(order: Namespace) -> None:
    """Refuse a directory with other content, or with a sweep that is neither to be resumed nor replaced."""
    from perilune.families import MANIFEST
    from perilune.io import in_use

    stored = (order.out / MEMBERS / MANIFEST).is_file()
    if stored and not (order.force or order.resume):
        raise PeriluneError(
            "the output directory already holds a sweep",
            got=str(order.out),
            expected="a new or empty directory",
            advice="--resume to continue it, --force to start over, or another directory",
        )
    if order.resume and not stored and in_use(order.out) and not order.force:
        raise PeriluneError(
            "there is no sweep in the output directory to continue",
            got=str(order.out),
            expected=f"the directory of an earlier sweep, with {MEMBERS}/{MANIFEST}",
            advice="omit --resume, or choose the directory of an earlier sweep",
        )
    refuse_unusable_target(order.out, order.force or order.resume)


def scenario_with_ranges(file: Path, changes: Sequence[str], over: Mapping[str, Sequence[float]]) -> Scenario:
    """Return the scenario with values of the keys; both ends of ranges and lists are checked as the file itself is.

    Parameters
    ----------
    file
        File of the scenario.
    changes
        Texts ``key=value`` that replace values of the file.
    over
        Values of each varied key [SI].

    Raises
    ------
    PeriluneError
        If the scenario cannot be read with one of the ends.
    """
    from perilune.scenario import load_file, quantities_of

    known, found = quantities_of(file, changes), None
    corners = [[pick(values) for values in over.values()] for pick in (max, min, itemgetter(-1), itemgetter(0))]
    for k, corner in enumerate(corners):
        if corner in corners[k + 1 :]:
            continue
        with suppress(InfeasibleError):  # the table will say so
            ends = [f"{key}={value!r} {known[key].unit}" for key, value in zip(over, corner, strict=True)]
            found = load_file(file, [*changes, *ends])
    return found or load_file(file, changes)
