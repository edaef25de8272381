"""Admissible names of phases and of their quantities.

Tables, figures and files have one column for each name, in addition to their own: a quantity named like one of these
would replace it, or be lost.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from perilune.core import PeriluneError, require_distinct, require_identifier, wrong_type_error
from perilune.problem.phase import Phase
from perilune.problem.results.dispersion import dispersion_variables
from perilune.problem.results.extrema import peak_names

_OWN = {"time": "the time since the phase began", "phase": "the phase of a row", "H": "the Hamiltonian"}
_KINDS = {"state": "a state", "control": "a control", "output": "an output"}


def check_names(problem: Any) -> None:
    """Refuse invalid names, and quantities of one phase that are called alike or as columns of the program's own.

    Raises
    ------
    PeriluneError
        For the first.
    """
    if not isinstance(problem.name, str):
        raise wrong_type_error(problem.name, "a text", "the name of a problem")
    if not problem.name.strip() or not problem.name.isprintable():
        raise PeriluneError("a problem needs a name of one line", got=repr(problem.name)[:60], expected='as "landing"')
    if not isinstance(problem.title, str):
        raise wrong_type_error(problem.title, "a text", "the title of a problem")
    for phase in problem.phases:
        require_identifier(phase.name.replace("-", "_") if isinstance(phase.name, str) else phase.name)
        for kind, names in (("state", phase.state_names), ("control", phase.control_names)):
            require_distinct(f"{kind}s of the phase {phase.name}", names)
            for name in names:
                require_identifier(name)
        _check_columns(phase)
    require_distinct("phases", [phase.name for phase in problem.phases])
    require_distinct("free parameters", problem.free_names)
    _check_units(problem.phases)
    _check_results(problem)


def _check_columns(phase: Phase) -> None:
    taken = _OWN | {f"lambda_{name}": f"the costate of {name}" for name in phase.state_names}
    kinds = {
        "state": phase.state_names, "control": phase.control_names,
        "output": [v.name for v in phase.output_variables],
    }  # fmt: skip
    for kind, names in kinds.items():
        for name in names:
            if name in taken:
                raise PeriluneError(
                    f"{name} cannot be the name of {_KINDS[kind]} of the phase {phase.name}",
                    got=f"it is the name of {taken[name]} in tables and files", advice="another name",
                )  # fmt: skip
            taken[name] = _KINDS[kind]


def _check_units(phases: Iterable[Phase]) -> None:
    """Refuse a column that goes on from phase to phase with another unit."""
    units = dict[str, str]()
    for phase in phases:
        steered = [(name, control.unit) for control in phase.controls for name in control.names]
        for name, unit in (*((v.name, v.unit) for v in (*phase.states, *phase.output_variables)), *steered):
            if units.setdefault(name, unit) != unit:
                raise PeriluneError(
                    f"{name} has a different unit in the phase {phase.name} than before", got=unit or "none",
                    expected=units[name] or "none", advice="another name, because tables have one column for both",
                )  # fmt: skip


def _check_results(problem: Any) -> None:
    """Refuse two results of one name, of which a solution would have one; integrals of phases add up."""
    taken, added = dict[str, str](), dict[str, str]()

    def take(name: str, what: str) -> None:
        if name in taken:
            other = "; or state `results`, which replace those of every problem" if "every" in taken[name] else ""
            raise PeriluneError(
                f"two results are called {name}", got=f"{taken[name]}, and {what}", expected="different names",
                advice=f"another name for the latter{other}",
            )  # fmt: skip
        taken[name] = what

    if problem.results is None:
        take("flight_time", "the flight time of every problem without `results`")
        take("objective", "the objective of every problem without `results`")
    for variable in problem.result_variables:
        take(variable.name, "one of `results`")
    for phase in problem.phases:
        for variable in phase.end_output_variables:
            take(variable.name, f"one of `end_outputs` of the phase {phase.name}")
        for variable in phase.integral_variables:
            if variable.name not in added:
                take(variable.name, f"one of `integrals` of the phase {phase.name}")
            elif added[variable.name] != variable.unit:
                raise PeriluneError(
                    f"integrals of two phases that add up, {variable.name}, have different units",
                    got=f"{variable.unit} in the phase {phase.name}", expected=added[variable.name],
                    advice="the same unit, or another name",
                )  # fmt: skip
            added[variable.name] = variable.unit
    for name in problem.views.peaks:
        for found in peak_names(name):
            take(found, "one of `peaks` of the views")
    for variable in dispersion_variables(problem.views):
        take(variable.name, "one of `dispersion` of the views")
