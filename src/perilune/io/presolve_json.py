"""Presolve checks of a problem (`Problem.preflight`) as a tree for JSON and back.

Comparisons are formulas of the given parameters with constant texts: the formulas are saved as expressions, so that no
code is needed to evaluate them again. Those of a model come with its records, and are not saved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import PeriluneError
from perilune.io.json_checks import MOST_ENTRIES, refuse_entry, short_text
from perilune.io.tape_json import tape_of
from perilune.problem import Expression, Finding, NotAFormula, Problem, Recorder, preflight

_NUMBERS, _FLAGS = ("value", "limit"), ("at_least", "binding", "lasting", "contradiction")
_UNSTATED = {"lasting": False, "contradiction": False}  # in files that are older than the flag
_TEXTS = tuple(f.name for f in fields(Finding) if f.name not in (*_NUMBERS, *_FLAGS))


@dataclass(frozen=True)
class Comparisons:
    """Saved comparisons, called as ``preflight(p, xp)``."""

    found: tuple[Finding, ...]
    expression: Expression

    def __call__(self, p: Any, xp: Any) -> tuple[Finding, ...]:
        """Evaluate all of them at values of the parameters."""
        values = iter(self.expression(p, xp))
        return tuple(replace(f, value=next(values), limit=next(values)) for f in self.found)


Places = Sequence[Mapping[str, float]]  # values [SI] of given parameters


def same_comparisons(problem: Problem, other: Problem, places: Places) -> bool:
    """Return True if the comparisons of two problems of one form agree at all of some places.

    Parameters
    ----------
    problem, other
        Problems of one form.
    places
        Values of given parameters [SI], by name.
    """
    if problem.preflight is None or other.preflight is None:
        return problem.preflight is other.preflight
    return all(
        [_comparable_values(f) for f in preflight(problem, place)]
        == [_comparable_values(f) for f in preflight(other, place)]
        for place in places
    )


def comparisons_document(problem: Problem, places: Places) -> dict[str, Any]:
    """Return the comparisons of a problem as a tree.

    Parameters
    ----------
    problem
        Whose they are.
    places
        At each of them what is kept has to say what the function says.

    Raises
    ------
    PeriluneError
        If they are no formulas, or their words tell values.
    """
    ask, recorder = problem.preflight or (lambda p, xp: ()), Recorder()
    try:
        found = tuple(ask(SimpleNamespace(**{n: recorder.input("p", n) for n in problem.given}), recorder.namespace))
        tape = recorder.tape([getattr(f, name) for f in found for name in _NUMBERS])
        kept = Comparisons(found, Expression(tape, ("p",)))
        differing = next((d for place in places if (d := _differing_comparison(problem, kept, place))), None)
    except NotAFormula as error:
        raise _comparisons_not_kept(error.got, error.advice) from None
    except PeriluneError as error:
        raise _comparisons_not_kept(f"{error.what}, {error.got}", error.expected) from error
    except Exception as error:  # of a function that nobody has looked at
        raise _comparisons_not_kept(f"{type(error).__name__}: {error}"[:120]) from error
    if differing is not None:
        raise _comparisons_not_kept(differing)
    stated = [{name: getattr(f, name) for name in (*_TEXTS, *_FLAGS)} for f in found]
    return {"findings": stated, "values": tape.document()}


def read_comparisons(document: Any, problem: Problem) -> Comparisons:
    """Read and check the comparisons of a file.

    Parameters
    ----------
    document
        Tree that `comparisons_document` wrote.
    problem
        Problem whose given parameters the formulas read.

    Raises
    ------
    PeriluneError
        If they are not what `comparisons_document` writes.
    """
    stated = document.get("findings") if isinstance(document, dict) else None
    if not isinstance(stated, list) or len(stated) > MOST_ENTRIES or not all(isinstance(f, dict) for f in stated):
        refuse_entry("comparisons", str(stated)[:40], "a list of records")
    stated = [{**_UNSTATED, **f} for f in stated]
    if not all(isinstance(f.get(name), bool) for f in stated for name in _FLAGS):
        refuse_entry("comparisons", "a limit that is not stated", "true or false")
    tape = tape_of(document.get("values"), {"p": tuple(problem.given)}, "comparisons")
    if len(tape.outputs) != len(_NUMBERS) * len(stated):
        refuse_entry("comparisons", f"{len(tape.outputs)} values", f"two of each of {len(stated)}")
    found = tuple(
        Finding(value=0.0, limit=0.0, **{n: short_text(f, n) for n in _TEXTS}, **{n: f[n] for n in _FLAGS})
        for f in stated
    )
    return Comparisons(found, Expression(tape, ("p",), origin="a file"))


def _differing_comparison(problem: Problem, kept: Comparisons, place: Mapping[str, float]) -> str | None:
    """Describe the first comparison that differs, at a place, from its saved expressions; None if all agree."""
    said, again = preflight(problem, place), preflight(problem.changed(preflight=kept), place)
    if [_comparable_values(f) for f in said] == [_comparable_values(f) for f in again]:
        return None
    other = next((f for f, g in zip(said, again, strict=False) if _comparable_values(f) != _comparable_values(g)), None)
    got = "more or fewer of them" if other is None else f"'{other.name}', whose words or values differ"
    return f"{got} where " + ", ".join(f"{n} = {v:.6g}" for n, v in place.items())


def _comparable_values(found: Finding) -> list[Any]:
    """Return the content of a finding in a form that compares NaN as equal."""
    return [
        *(repr(np.asarray(getattr(found, n), dtype=float).tolist()) for n in _NUMBERS),
        *(getattr(found, n) for n in (*_TEXTS, *_FLAGS)),
    ]


def _comparisons_not_kept(got: str, advice: str = "") -> PeriluneError:
    return PeriluneError(
        "an atlas cannot store the physical bounds of this problem (its preflight)",
        got=got,
        expected="comparisons by formulas in the parameters, with words that contain no values",
        advice=f"{advice or 'state them so'}; or build an atlas of dataclasses.replace(problem, preflight=None),"
        f" without these bounds",
    )
