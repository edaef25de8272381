"""Names of quantities and limits in messages: those of the problem statement, not of the code.

A state, condition or control is called by its description (``mass``), with its name where that differs; a limit by
the key that states it (``vehicle.dry_mass``), where it is a parameter of a record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from perilune.core import format_quantity, record_keys, section_of
from perilune.problem.problem import Problem

_SHOWN = ("outputs", "integrals", "end_outputs", "inertial", "track", "end_guess")  # functions that decide no optimum


def quantity_name(named: Any) -> str:
    """Return the name of a variable, a control or a parameter in a sentence: ``mass (m)``."""
    name, about = named.name.replace("_", " "), getattr(named, "description", "")
    return f"{about} ({named.name})" if about and about != name else name


def parameter_key(problem: Problem, name: str) -> str:
    """Return the key that states a parameter, as ``vehicle.dry_mass``; its name where no record of the problem does.

    Parameters
    ----------
    problem
        Problem with the records that declare its parameters.
    name
        Name of a parameter, as ``vehicle_dry_mass``.
    """
    for record in problem.records:
        section = section_of(type(record))
        key = name.removeprefix(f"{section}_")
        if key != name and key in record_keys(type(record)):
            return f"{section}.{key}"
    return name


def only_in_path(problem: Problem) -> list[str]:
    """Return the given parameters on which conditions of the path depend, and nothing else that decides a flight."""
    inside, elsewhere = set[str](), set[str]()
    for key, expression in problem.form.expressions.items():
        names = {name for name in problem.given if ("p", name) in expression.tape.instructions}
        if isinstance(key, tuple) and key[1] == "path":
            inside |= names
        elif not (isinstance(key, tuple) and key[1] in _SHOWN) and key != "results":
            elsewhere |= names
    return [name for name in problem.given if name in inside - elsewhere]


def stating_keys(problem: Problem, k: int, kind: str, row: int) -> list[str]:
    """Return the keys that state a condition of the path or of the end of phase k, and nothing else.

    Parameters
    ----------
    problem, k
        The problem and the number of the phase.
    kind
        "path" or "end".
    row
        Number of the condition among those of its kind.
    """
    condition = getattr(problem.phases[k], f"{kind}_conditions")[row]
    names = [limit for limit in (condition.lower, condition.upper) if isinstance(limit, str)]
    if kind == "path":
        inside = problem.form.expressions[k, kind].tape.needed(row)
        names += [name for name in only_in_path(problem) if ("p", name) in inside]
    return [parameter_key(problem, name) for name in names]


def free_name(problem: Problem, name: str) -> str:
    """Return the name of a free parameter in a sentence: the key that states it, or its name in words.

    Parameters
    ----------
    problem
        Problem with the records that declare its parameters.
    name
        Name of a free parameter.
    """
    key = parameter_key(problem, name)
    return key if key != name else name.replace("_", " ")


def kept_text(problem: Problem, names: Sequence[str]) -> str:
    """Return what conditions of the path are called: the keys that state them, or their names in words.

    Parameters
    ----------
    problem
        Problem with the records that declare its parameters.
    names
        Names of conditions of the path.
    """
    keys, rest = list[str](), list[str]()
    for k, phase in enumerate(problem.phases):
        for row, condition in enumerate(phase.path_conditions):
            if condition.name in names:
                stated = stating_keys(problem, k, "path", row)
                keys += stated
                rest += [] if stated else [quantity_name(condition)]
    return ", ".join(dict.fromkeys((*keys, *rest)))


def end_text(problem: Problem, name: str) -> str:
    """Return what is stated of the end of a phase, each key with its value: ``interface.angle -8 deg``.

    Parameters
    ----------
    problem
        Problem with the records that declare its parameters.
    name
        Name of the phase.
    """
    phase = next(phase for phase in problem.phases if phase.name == name)
    ends = phase.end_conditions
    limits = [limit for one in ends for limit in (one.name, one.lower, one.upper) if isinstance(limit, str)]
    stated = {name: problem.given[name] for name in limits if name in problem.given}
    return ", ".join(
        f"{parameter_key(problem, name)} {g.stated or format_quantity(g.value, g.unit)}" for name, g in stated.items()
    )


def limit_name(problem: Problem, bounded: Any, side: str) -> str:
    """Return the name of a limit of a state, an end or a control: its key, or the lower (upper) bound of what.

    Parameters
    ----------
    problem
        The problem.
    bounded
        State, end condition or control.
    side
        "lower" or "upper".
    """
    limit = getattr(bounded, side)
    if isinstance(limit, str):
        return parameter_key(problem, limit)
    return f"the {side} bound of {quantity_name(bounded)}"


def objective_text(solution: Any, digits: int = 6) -> str:
    """Return the objective of a flight in the words of its problem: ``landed mass 1201.5 kg``, or J with its unit.

    Parameters
    ----------
    solution
        Solution with its results.
    digits
        Number of significant digits.
    """
    problem = solution.problem
    name = problem.maximised or problem.minimised
    result = solution.results.get(name) if name else None
    if result is not None and math.isfinite(result.value):
        return f"{result.label or name.replace('_', ' ')} {format_quantity(result.value, result.unit, digits)}"
    return f"J = {format_quantity(solution.objective, problem.objective_unit, digits)}"
