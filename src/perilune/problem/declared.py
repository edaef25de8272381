"""Given parameters of a problem from the declared records of a model."""

from __future__ import annotations

from typing import Any

from perilune.problem.variables import Given
from perilune.words.declared import Quantity, keys_of, section_of, values_of


def given_of(*records: Any) -> dict[str, Given]:
    """Return given parameters ``section_key`` of records, with the text in which a value was stated; none of None."""
    found = {}
    for record in records:
        section, keys = section_of(type(record)), keys_of(type(record))
        for name, value in values_of(record).items():
            declared = keys[name].declared
            if isinstance(declared, Quantity) and value is not None:
                found[f"{section}_{name}"] = Given(value=value, unit=declared.unit)
    return found
