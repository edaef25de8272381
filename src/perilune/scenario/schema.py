"""A tree of sections checked against `perilune.scenario.sections`; errors in plain words, ranges of a sweep."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from pydantic import BeforeValidator, ValidationError

from perilune.scenario.quantity import LONGEST_VALUE, Quantity
from perilune.scenario.sections import DOCUMENTS, HYBRID, Document, sections_of
from perilune.words.outcome import PeriluneError, unknown_name
from perilune.words.units import parse_quantity

MOST_STEPS = 10_000
_RANGE = 'for example --vary "retro.delta_v=0:1600:50 m/s", or with a unit in each part'


def checked(document: Mapping[str, Any]) -> Document:
    """The sections of a tree, every quantity in SI.

    Raises
    ------
    PeriluneError
        For the first thing that is wrong, with its key.
    """
    stated = document.get("problem")
    kind = stated.get("kind", HYBRID) if isinstance(stated, Mapping) else HYBRID
    if isinstance(kind, str) and kind not in DOCUMENTS:
        raise unknown_name("problem.kind", kind[:60], list(DOCUMENTS))
    form = DOCUMENTS[kind if isinstance(kind, str) else HYBRID]
    try:
        return form.model_validate(document)
    except ValidationError as error:
        raise _translated(error, form) from None


def quantity_of(key: str) -> Quantity:
    """How the text of a key such as ``"vehicle.thrust"`` is read.

    Raises
    ------
    PeriluneError
        If there is no such key or it is no quantity.
    """
    known = {
        f"{section}.{name}": validator.func
        for form in DOCUMENTS.values()
        for section, model in sections_of(form).items()
        for name, field in model.model_fields.items()
        for validator in field.metadata
        if isinstance(validator, BeforeValidator)
    }
    if key not in known:
        raise unknown_name("key with a quantity", key, list(known))
    found = known[key]
    assert isinstance(found, Quantity)
    return found


def values_of(key: str, text: str) -> list[float]:
    """Values in SI of ``"START:STOP:STEP"`` for a key; the unit may stand in each part or in the last only.

    STOP is included where a step meets it.

    Raises
    ------
    PeriluneError
        If it is no such range, has more than `MOST_STEPS` values, or the step leads away from STOP.
    """
    quantity, parts = quantity_of(key), [part.strip() for part in text[:LONGEST_VALUE].split(":")]
    if len(parts) != 3 or not all(parts):
        raise PeriluneError(
            f"the range of {key} must have three parts",
            got=repr(text[:60]),
            expected="START:STOP:STEP",
            advice=_RANGE,
        )
    last_unit = re.sub(r"^[-+\d.]+([eE][-+]?\d+)?\s*", "", parts[2])
    parts = [f"{part} {last_unit}" if re.fullmatch(r"[-+\d.]+([eE][-+]?\d+)?", part) else part for part in parts]
    try:
        start, stop, step = quantity(parts[0]), quantity(parts[1]), parse_quantity(parts[2], quantity.unit)
    except PeriluneError as error:
        named = _named(key, error)
        raise PeriluneError(named.what, got=named.got, expected=named.expected, advice=_RANGE) from None
    steps = (stop - start) / step if step else math.inf
    if not 0 <= steps < MOST_STEPS:
        endless = not step or steps < 0
        raise PeriluneError(
            f"the range of {key} has no end" if endless else f"the range of {key} is too long",
            got=repr(text[:60]),
            expected=f"a step that leads from START to STOP in less than {MOST_STEPS} steps",
            advice="give the step the sign of STOP - START" if endless else "take a larger step",
        )
    return [start + k * step for k in range(int(steps + 1e-9) + 1)]


def _translated(error: ValidationError, form: type[Document]) -> PeriluneError:
    """The first of pydantic's findings in this program's words.

    A misspelt key comes before what it leaves missing.
    """
    found = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = found[0]
    path = [str(part)[:60] for part in first["loc"]]
    key, kind = ".".join(path), first["type"]
    if kind == "extra_forbidden":
        sections = sections_of(form)
        if len(path) == 1 and (kinds := [k for k, other in DOCUMENTS.items() if path[0] in sections_of(other)]):
            return _of_another_kind(path[0], kinds)
        fields = sections[path[0]].model_fields if len(path) > 1 else sections
        unknown = unknown_name("key" if len(path) > 1 else "section", path[-1], list(fields))
        where = f" in [{path[0]}]" if len(path) > 1 else ""
        return PeriluneError(unknown.what + where, got=unknown.got, expected=unknown.expected, advice=unknown.advice)
    if kind == "missing":
        example = f'{path[-1]} = "{quantity_of(key).example}"' if len(path) > 1 else f"a section [{key}]"
        return PeriluneError(f"{key} is missing", expected=example, advice="compare with `perilune new`")
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, PeriluneError):
        return _named(key, cause)
    wanted = f"a section [{key}]" if kind in ("model_type", "model_attributes_type") else 'a text such as "moon"'
    return PeriluneError(
        f"{key} has the wrong type", got=str(first["input"])[:60], expected=wanted, advice="compare with `perilune new`"
    )


def _of_another_kind(section: str, kinds: list[str]) -> PeriluneError:
    return PeriluneError(
        f"[{section}] belongs to another kind of problem",
        got=f"a section [{section}]",
        expected="sections of the problem.kind that the file states",
        advice="or ".join(f'kind = "{kind}" ' for kind in kinds).strip() + " in a section [problem]",
    )


def _named(key: str, error: PeriluneError) -> PeriluneError:
    """The same error with the key in front."""
    what = error.what if error.what.startswith(("is ", "must ")) else f"- {error.what}"
    return PeriluneError(f"{key} {what}", got=error.got, expected=error.expected, advice=error.advice)
