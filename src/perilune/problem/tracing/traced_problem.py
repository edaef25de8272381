"""Traced problem: its statement without its numbers, traced once, with a content address.

Every function of a problem becomes an `Expression` of named states, controls and parameters; given and free parameters
stand in one record, so which of them are free is no part of the form. With names, units, kinds of controls and
conditions these expressions have a `digest`: equal physics has the same one, whatever functions state it and in
whichever process. Values, numbers of bounds, titles and descriptions are left out.

The functions here take a `Problem` or a `Phase`, whose file stands above this one.
"""

from __future__ import annotations

import hashlib
import json
import marshal
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import NUMERIC, PeriluneError, unknown_name
from perilune.problem.controls import Settled
from perilune.problem.named_values import NamedValues
from perilune.problem.renamed_keys import FUNCTIONS
from perilune.problem.tracing.tape import Expression, NotAFormula, Recorder, Symbol

# The functions of a phase, what each takes before `xp`, and the field of the phase with the names of its results.
PHASE_FUNCTIONS: dict[str, tuple[tuple[str, ...], str]] = {
    "dynamics": (("x", "u", "p"), "states"),
    "end": (("x", "p"), "end_conditions"),
    "path": (("x", "u", "p"), "path_conditions"),
    "held": (("x", "u", "p"), "held_conditions"),
    "outputs": (("x", "u", "p"), "output_variables"),
    "integrals": (("x", "u", "p"), "integral_variables"),
    "end_outputs": (("x", "p"), "end_output_variables"),
    "inertial": (("x", "u", "t", "p"), ""),
    "track": (("x", "p"), ""),
    "end_guess": (("p",), "states"),
}
_IN_DIGESTS = {new: old for old, new in FUNCTIONS.items()}  # which keep the old names
_RATES = ("dynamics", "integrals")
_INERTIAL = tuple((f"{what} {axis}", unit) for what, unit in
                  (("position", "m"), ("velocity", "m/s"), ("thrust", "m/s^2")) for axis in "xyz")  # fmt: skip
_TRACK = (("along", "m"), ("across", "m"), ("height", "m"), ("least height", "m"))
# The functions of the problem itself; ("links", number) stands under "links".
_OTHER_FUNCTIONS = {
    "start": ("p",), "links": ("x", "p"), "objective": ("x", "p"), "results": ("first", "last", "p")
}  # fmt: skip
_DIFFERENTIATED = {"start", "links", "dynamics", "end", "objective"}
OWN_TEXT = "the problem's own Python functions"
_KINDS = {"u": "control", "p": "parameter", "xp": "function of xp"}  # the others are states


@dataclass(frozen=True, kw_only=True)
class StatedFunction:
    """One function of a problem, with what it is called in messages.

    Attributes
    ----------
    key
        Its place: the field of the problem, or (number of the phase, field of the phase), or ("links", number).
    what
        For example "dynamics of descent".
    function
        The user's function.
    records
        Its arguments before `xp`, in order, each with the type of its record; None where it is passed as it is.
    phase
        Number of the phase whose states and controls it takes.
    results
        (name, unit) of its values.
    rough
        Whether only the order of magnitude of its values matters, so that no units are checked.
    """

    key: Any
    what: str
    function: Callable[..., Any]
    records: Mapping[str, Callable[..., Any] | None]
    phase: int
    results: tuple[tuple[str, str], ...]
    rough: bool = False

    def ask(self, arguments: Mapping[str, Any], xp: Any = NUMERIC) -> list[Any]:
        """Return the values of the function; describe every mistake in it in the user's words.

        Parameters
        ----------
        arguments
            By role: the values of a record in order, the record p itself, the time t; more may be there.
        xp
            Maths namespace.
        """
        given = {role: make(*arguments[role]) if make else arguments[role] for role, make in self.records.items()}
        try:
            values = self.function(*given.values(), xp)
        except PeriluneError:
            raise
        except NotAFormula as error:
            raise PeriluneError(f"{self.what} is not a formula", got=error.got, advice=error.advice) from None
        except AttributeError as error:
            raise self._misspelt(error, {**given, "xp": xp}) from error
        except Exception as error:
            raise self._failing(error) from error
        return [values] if self.key == "objective" else self._listed(values)

    def numbers(self, arguments: Mapping[str, Any]) -> list[float]:
        """Evaluate the function at numbers."""
        with np.errstate(all="ignore"):  # of values that nobody has looked at
            values = self.ask(arguments)
        try:
            return [float(value) for value in values]
        except (TypeError, ValueError) as error:
            raise self._no_numbers(values) from error

    def traced(self, parameters: Sequence[str]) -> Expression:
        """Trace the function as an expression."""
        if isinstance(self.function, Expression):
            self._listed(self.function.tape.outputs)
            return self.function
        recorder = Recorder(self.differentiated)
        arguments: dict[str, Any] = {
            role: [recorder.input(role, name) for name in getattr(make, "_fields", ())]
            for role, make in self.records.items()
        }
        arguments["p"] = SimpleNamespace(**{name: recorder.input("p", name) for name in parameters})
        arguments["t"] = recorder.input("t", "")
        values = self.ask(arguments, recorder.namespace)
        try:
            tape = recorder.tape(values)
        except (TypeError, ValueError) as error:
            raise self._no_numbers(values) from error
        return Expression(tape, tuple(self.records), scalar=self.key == "objective", origin="a copy")

    @property
    def differentiated(self) -> bool:
        """Return True if the proof takes derivatives of it; the others are only reported or bounded."""
        return not _DIFFERENTIATED.isdisjoint([self.key] if isinstance(self.key, str) else self.key)

    def told(self, k: int) -> str:
        """Return the name of one of its values."""
        return f"{self.what}, {self.results[k][0]}"

    @property
    def _wanted(self) -> str:
        return f"{len(self.results)}: " + ", ".join(name for name, _ in self.results)

    def _listed(self, values: Any) -> list[Any]:
        wrong = f"{self.what} returns the wrong number of values"
        if values is None or isinstance(values, (str, bytes)) or not hasattr(values, "__len__"):
            got = "None: is there a return?" if values is None else f"one {type(values).__name__}"
            advice = "return a tuple, of a single value with a comma: return (value,)"
            raise PeriluneError(wrong, got=got, expected=self._wanted, advice=advice)
        if len(values) != len(self.results):
            raise PeriluneError(wrong, got=str(len(values)), expected=self._wanted)
        if isinstance(values, np.ndarray) and values.dtype == object:  # which cannot hold a number beside many
            raise PeriluneError(
                f"{self.what} returns an array of NumPy",
                got="np.array(...) of values that are known only in flight",
                expected=f"a tuple or a list of {self._wanted}",
                advice="return (..., ...) in place of np.array([..., ...])",
            )
        return list(values)

    def _no_numbers(self, values: Sequence[Any]) -> PeriluneError:
        strange = [v for v in values if not isinstance(v, (int, float, Symbol))]
        return PeriluneError(
            f"{self.what} returns a value that is not a number",
            got=str(strange)[:80],
            expected=f"numbers, {self._wanted}",
        )

    def _failing(self, error: Exception) -> PeriluneError:
        return PeriluneError(
            f"{self.what} fails when it is tried",
            got=f"{type(error).__name__}: {error}",
            expected=f"a function of ({', '.join(self.records)}, xp) that returns {self._wanted}",
            advice="call it yourself with such values; it must compute with single values, using the functions of xp",
        )

    def _misspelt(self, error: AttributeError, records: Mapping[str, Any]) -> PeriluneError:
        """Return the error for a name that is not there, with the nearest one."""
        for role, record in records.items():
            if error.obj is record:
                known = sorted(getattr(record, "_fields", None) or vars(record))
                found = unknown_name(_KINDS.get(role, "state"), error.name or "", known)
                got = f"{role}.{error.name}"
                return PeriluneError(
                    f"{self.what}: {found.what}", got=got, expected=found.expected, advice=found.advice
                )
        return self._failing(error)


def _key_in_digests(key: Any) -> Any:
    """Return the `StatedFunction.key` of a function as it stands in digests."""
    return key if isinstance(key, str) else (key[0], _IN_DIGESTS.get(key[1], key[1]))


def roles_of(key: Any) -> tuple[str, ...]:
    """Return the records that a function takes before `xp`, by its `StatedFunction.key`."""
    name = key if isinstance(key, str) else key[0]
    return _OTHER_FUNCTIONS[name] if name in _OTHER_FUNCTIONS else PHASE_FUNCTIONS[key[1]][0]


def stated_functions(problem: Any) -> Iterator[StatedFunction]:
    """Yield every function of a problem that is a formula."""
    phases = problem.phases
    shared = {"p": None, "t": None, "first": phases[0].state_record, "last": phases[-1].state_record}

    def one(key: Any, what: str, function: Any, k: int, results: Any) -> StatedFunction:
        of = {"x": phases[k].state_record, "u": phases[k].control_record, **shared}
        records, rough = {role: of[role] for role in roles_of(key)}, what.startswith("end_guess")
        return StatedFunction(
            key=key, what=what, function=function, phase=k, records=records, results=results, rough=rough
        )

    yield one("start", "start", problem.start, 0, _names_and_units(phases[0].states))
    for k, phase in enumerate(phases):
        for name, (_, field) in PHASE_FUNCTIONS.items():
            function, what = _own_function(getattr(phase, name)), f"{name} of {phase.name}"
            results = _results_of(problem, phase, name, field)
            if function is not None:
                yield one((k, name), what, function, k, results)
            elif name == "dynamics":
                raise _missing_function_error(what, results)
    for k, link in enumerate(problem.links):
        yield one(("links", k), f"link to {phases[k + 1].name}", link, k, _names_and_units(phases[k + 1].states))
    objective = (("J", problem.objective_unit),)
    yield one("objective", "objective", problem.objective, len(phases) - 1, objective)
    if problem.results is not None:
        yield one("results", "results", _own_function(problem.results), 0, _names_and_units(problem.result_variables))


def _own_function(stated: Any) -> Any:
    """Return a function without the names of its values."""
    return stated.function if isinstance(stated, NamedValues) else stated


def _names_and_units(variables: Sequence[Any], per: str = "") -> tuple[tuple[str, str], ...]:
    return tuple((v.name, v.unit + per) for v in variables)


def _results_of(problem: Any, phase: Any, name: str, field: str) -> tuple[tuple[str, str], ...]:
    """Return (name, unit) of what a function of a phase returns."""
    if name == "inertial":
        return _INERTIAL
    if name == "track":
        return _TRACK[: 4 if problem.views.floor else 3]
    return _names_and_units(getattr(phase, field), "/s" if name in _RATES else "")


def _missing_function_error(what: str, results: Sequence[tuple[str, str]]) -> PeriluneError:
    wanted = f"a function that returns {len(results)}: " + ", ".join(name for name, _ in results)
    return PeriluneError(f"{what} is missing", got="None", expected=wanted)


@dataclass(frozen=True, eq=False)
class TracedProblem:
    """A problem without its numbers; forms are equal when their digests are.

    Attributes
    ----------
    structure
        Names, units, kinds of controls, and what each function takes and returns: a tree for JSON.
    expressions
        Every function of the problem by its `StatedFunction.key`.
    """

    structure: Mapping[str, Any]
    expressions: Mapping[Any, Expression]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of structure and expressions, hexadecimal."""
        tapes = [e.tape.document() for e in self.expressions.values()]
        return _digest(marshal.dumps([self.structure, tapes], 2))  # which writes what is equal in one way

    def chooses(self, k: int) -> bool:
        """Return True if the dynamics of phase k have a choice (``xp.where``) in them, and so perhaps a jump."""
        return any(op[0] == "where" for op in self.expressions[k, "dynamics"].tape.instructions)

    def limits_control(self, k: int) -> bool:
        """Return True if a control acts in the path conditions of phase k."""
        path = self.expressions.get((k, "path"))
        return path is not None and any(op[0] == "u" for op in path.tape.instructions)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, TracedProblem) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)


@lru_cache(maxsize=256)
def _digest(content: bytes) -> str:
    """Return the hash of structure and tapes: a problem is often stated again, with other numbers."""
    text = json.dumps(marshal.loads(content), separators=(",", ":"), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def trace(problem: Any) -> TracedProblem:
    """Call every function of a problem once with symbols.

    Raises
    ------
    PeriluneError
        Naming the function that is no formula, misspells a name or returns the wrong number of values.
    """
    parameters = sorted({*problem.given, *problem.free_names})
    functions = list(stated_functions(problem))
    structure = {
        "parameters": [[name, problem.unit_of(name)] for name in parameters],
        "phases": [
            [
                phase.name,
                phase.duration,
                [[s.name, s.unit, _named_limits(s)] for s in phase.states],
                [
                    [c.kind, c.names, c.unit, _named_limits(c), *([c.regime] if isinstance(c, Settled) else [])]
                    for c in phase.controls
                ],
            ]
            for phase in problem.phases
        ],
        "functions": [[str(_key_in_digests(s.key)), list(s.records), s.results] for s in functions],
    }
    return TracedProblem(structure, {s.key: s.traced(parameters) for s in functions})


def canonical_expressions(problem: Any) -> dict[Any, Expression]:
    """Return every function of a problem, by its `StatedFunction.key`, as an expression of canonical values.

    It is the traced one but for what has a scale of its own, which is in other units inside the function.
    """
    phases, ratio = problem.phases, lambda variable: problem.size_of(variable) / problem.scales.of(variable.unit)
    objective = problem.objective_size / problem.scales.of(problem.objective_unit)
    found = {}
    for s in stated_functions(problem):
        taken = {"x": phases[s.phase].states, "first": phases[0].states, "last": phases[-1].states}
        inputs = {(role, v.name): ratio(v) for role in s.records for v in taken.get(role, ())}
        outputs = [objective] if s.key == "objective" else [ratio(v) for v in _returned(problem, s.key)]
        found[s.key] = problem.form.expressions[s.key].rescaled(inputs, outputs)
    return found


def _returned(problem: Any, key: Any) -> tuple[Any, ...]:
    """Return the variables that a function returns, rates as what they are rates of; none without names."""
    if key == "results":
        return problem.result_variables
    if key == "start":
        return problem.phases[0].states
    if key[0] == "links":
        return problem.phases[key[1] + 1].states
    field = PHASE_FUNCTIONS[key[1]][1]
    return getattr(problem.phases[key[0]], field) if field else ()


def _named_limits(bounded: Any) -> list[str | None]:
    """Return limits that name a parameter, which are of the form; None for numbers, which are not."""
    limits = [getattr(bounded, side, None) for side in ("lower", "upper")]
    return [limit if isinstance(limit, str) else None for limit in limits]
