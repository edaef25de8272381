"""The form of a problem: what it states without its numbers, traced once, with a content address.

Every function of a problem becomes an `Expression` of named states, controls and parameters; given and free parameters
stand in one record, so which of them are free is no part of the form. With names, units, kinds of controls and
conditions these expressions have a `digest`: equal physics has the same one, whoever's functions state it and in
whichever process. Values, numbers of bounds, titles and descriptions are left out.

The functions here take a `Problem` or a `Phase`, whose file stands above this one.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any

from perilune.problem.tape import Expression, NotAFormula, Recorder, Symbol
from perilune.words.maths import NUMERIC
from perilune.words.outcome import PeriluneError, unknown_name

# The functions of a phase, the records each takes before `m`, and the field with the names of its results.
PHASE_FUNCTIONS: dict[str, tuple[tuple[str, ...], str]] = {
    "dynamics": (("x", "u", "p"), "states"),
    "end": (("x", "p"), "end_conditions"),
    "path": (("x", "u", "p"), "path_conditions"),
    "outputs": (("x", "u", "p"), "output_variables"),
    "typical_end": (("p",), "states"),
}
OWN_TEXT = "the problem's own Python functions"
_KINDS = {"x": "state", "u": "control", "p": "parameter", "m": "function of m"}


@dataclass(frozen=True, kw_only=True)
class Stated:
    """One function of a problem, with what it is called in messages.

    Attributes
    ----------
    key
        Its place: the field of the problem, or (number of the phase, field of the phase), or ("links", number).
    what
        For example "dynamics of descent".
    function
        The user's.
    records
        What it takes before `m`, in order: "x", "u" and "p" with the type of each record.
    phase
        Number of the phase whose states and controls it takes.
    results
        (name, unit) of its values.
    """

    key: Any
    what: str
    function: Callable[..., Any]
    records: Mapping[str, Callable[..., Any]]
    phase: int
    results: tuple[tuple[str, str], ...]

    def ask(self, arguments: Mapping[str, Any], m: Any = NUMERIC) -> list[Any]:
        """Values of the function, every mistake in it told in the user's words.

        Parameters
        ----------
        arguments
            Values of x and u in order, and the record p; more than it takes may be there.
        m
            Maths namespace.
        """
        given = {
            role: arguments[role] if role == "p" else make(*arguments[role]) for role, make in self.records.items()
        }
        try:
            values = self.function(*given.values(), m)
        except PeriluneError:
            raise
        except NotAFormula as error:
            raise PeriluneError(f"{self.what} is no formula", got=error.got, advice=error.advice) from None
        except AttributeError as error:
            raise self._misspelt(error, {**given, "m": m}) from error
        except Exception as error:
            raise self._failing(error) from error
        return [values] if self.key == "objective" else self._listed(values)

    def numbers(self, arguments: Mapping[str, Any]) -> list[float]:
        """Values of the function at numbers."""
        values = self.ask(arguments)
        try:
            return [float(value) for value in values]
        except (TypeError, ValueError) as error:
            raise self._no_numbers(values) from error

    def traced(self, parameters: Sequence[str]) -> Expression:
        """The function as an expression."""
        if isinstance(self.function, Expression):
            return self.function
        recorder = Recorder()
        arguments: dict[str, Any] = {
            role: [recorder.input(role, name) for name in getattr(make, "_fields", ())]
            for role, make in self.records.items()
        }
        arguments["p"] = SimpleNamespace(**{name: recorder.input("p", name) for name in parameters})
        values = self.ask(arguments, recorder.namespace)
        try:
            tape = recorder.tape(values)
        except (TypeError, ValueError) as error:
            raise self._no_numbers(values) from error
        return Expression(tape, tuple(self.records), scalar=self.key == "objective", origin="a copy")

    @property
    def _wanted(self) -> str:
        return f"{len(self.results)}: " + ", ".join(name for name, _ in self.results)

    def _listed(self, values: Any) -> list[Any]:
        wrong = f"{self.what} returns the wrong number of values"
        if values is None or isinstance(values, (str, bytes)) or not hasattr(values, "__len__"):
            got = "None: is there a return?" if values is None else f"one {type(values).__name__}"
            raise PeriluneError(wrong, got=got, expected=self._wanted)
        if len(values) != len(self.results):
            raise PeriluneError(wrong, got=str(len(values)), expected=self._wanted)
        return list(values)

    def _no_numbers(self, values: Sequence[Any]) -> PeriluneError:
        strange = [v for v in values if not isinstance(v, (int, float, Symbol))]
        return PeriluneError(
            f"{self.what} returns what is no number", got=str(strange)[:80], expected=f"numbers, {self._wanted}"
        )

    def _failing(self, error: Exception) -> PeriluneError:
        return PeriluneError(
            f"{self.what} fails where it is tried",
            got=f"{type(error).__name__}: {error}",
            expected=f"a function of ({', '.join(self.records)}, m) that returns {self._wanted}",
            advice="call it yourself with such values; it computes with single values, by the functions of m",
        )

    def _misspelt(self, error: AttributeError, records: Mapping[str, Any]) -> PeriluneError:
        """The name that is not there, with the nearest one."""
        for role, record in records.items():
            if error.obj is record:
                known = sorted(getattr(record, "_fields", None) or vars(record))
                found = unknown_name(_KINDS[role], error.name or "", known)
                got = f"{role}.{error.name}"
                return PeriluneError(
                    f"{self.what}: {found.what}", got=got, expected=found.expected, advice=found.advice
                )
        return self._failing(error)


def stated(problem: Any) -> Iterator[Stated]:
    """Every function of a problem that is a formula."""
    phases = problem.phases
    last = len(phases) - 1

    def one(key: Any, what: str, function: Any, roles: Sequence[str], k: int, results: Sequence[Any], per: str = ""):
        of = {"x": phases[k].state_record, "u": phases[k].control_record, "p": SimpleNamespace}
        return Stated(
            key=key, what=what, function=function, phase=k, records={role: of[role] for role in roles},
            results=tuple((v.name, v.unit + per) for v in results),
        )  # fmt: skip

    yield one("start", "start", problem.start, ("p",), 0, phases[0].states)
    for k, phase in enumerate(phases):
        for name, (roles, results) in PHASE_FUNCTIONS.items():
            function, named = getattr(phase, name), getattr(phase, results)
            if function is not None:
                per = "/s" if name == "dynamics" else ""
                yield one((k, name), f"{name} of {phase.name}", function, roles, k, named, per)
            elif named and name != "typical_end":
                wanted = f"a function that returns {len(named)}: " + ", ".join(v.name for v in named)
                raise PeriluneError(f"{name} of {phase.name} is missing", got="None", expected=wanted)
    for k, link in enumerate(problem.links):
        yield one(("links", k), f"link to {phases[k + 1].name}", link, ("x", "p"), k, phases[k + 1].states)
    objective = one("objective", "objective", problem.objective, ("x", "p"), last, ())
    yield replace(objective, results=(("J", problem.objective_unit),))


@dataclass(frozen=True, eq=False)
class Form:
    """A problem without its numbers; forms are equal when their digests are.

    Attributes
    ----------
    structure
        Names, units, kinds of controls, conditions: a tree for JSON.
    expressions
        Every function of the problem by its `Stated.key`.
    """

    structure: Mapping[str, Any]
    expressions: Mapping[Any, Expression]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of structure and expressions, hexadecimal."""
        tapes = [[str(key), list(e.roles), e.tape.document()] for key, e in self.expressions.items()]
        text = json.dumps([self.structure, tapes], separators=(",", ":"), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Form) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)


def trace(problem: Any) -> Form:
    """Call every function of a problem once with symbols.

    Raises
    ------
    PeriluneError
        Naming the function that is no formula, misspells a name or returns the wrong number of values.
    """
    parameters = sorted({*problem.given, *problem.free_names})
    return Form(_structure(problem, parameters), {s.key: s.traced(parameters) for s in stated(problem)})


def _structure(problem: Any, parameters: Sequence[str]) -> dict[str, Any]:
    def pairs(variables: Sequence[Any]) -> list[list[str]]:
        return [[v.name, v.unit] for v in variables]

    return {
        "parameters": [[name, problem.unit_of(name)] for name in parameters],
        "objective": problem.objective_unit,
        "phases": [
            {
                "name": phase.name,
                "duration": phase.duration,
                "controls": [_control(c) for c in phase.controls],
                **{name: pairs(getattr(phase, results)) for name, (_, results) in PHASE_FUNCTIONS.items()},
            }
            for phase in problem.phases
        ],
    }


def _control(control: Any) -> list[Any]:
    """Kind, components, unit; a bound that is a number is none of the form, one that names a parameter is."""
    bounds = [getattr(control, side, None) for side in ("lower", "upper")]
    named = [bound if isinstance(bound, str) else None for bound in bounds]
    return [control.kind, list(control.names), control.unit, named]
