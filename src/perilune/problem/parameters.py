"""Given parameters of a problem from the declared records of a model."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from perilune.core import Named, Quantity, record_keys, record_values, section_of
from perilune.problem.variables import Parameter


def given_of(*records: Any) -> dict[str, Parameter]:
    """Return given parameters ``section_key`` of records, with the text in which a value was stated; none of None."""
    found = {}
    for record in records:
        section, keys = section_of(type(record)), record_keys(type(record))
        for name, value in record_values(record).items():
            declared = keys[name].declared
            if isinstance(declared, Quantity) and value is not None:
                found[f"{section}_{name}"] = Parameter(value=value, unit=declared.unit)
    return found


def read_only_given(values: Mapping[str, Parameter]) -> Mapping[str, Parameter]:
    """Return a read-only mapping of given parameters, which names what it lacks."""
    return MappingProxyType(Named("given parameter", values))
