"""Equality of records: field by field, arrays and NaN included."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def equal_values(one: Any, other: Any) -> bool:
    """Return True if two values are equal, where NaN equals NaN, and containers and arrays compare by their entries.

    Parameters
    ----------
    one, other
        Numbers, texts, arrays, containers or records.
    """
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return np.shape(one) == np.shape(other) and np.array_equal(one, other, equal_nan=True)
    if isinstance(one, float) and isinstance(other, float):
        return one == other or (math.isnan(one) and math.isnan(other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(equal_values(value, other[key]) for key, value in one.items())
    if isinstance(one, Sequence) and isinstance(other, Sequence) and not isinstance(one, str):
        return len(one) == len(other) and all(map(equal_values, one, other))
    if is_dataclass(one) and type(one) is type(other) and _by_fields(type(one)):
        return equal_fields(one, other)
    return bool(one == other)


def equal_fields(one: Any, other: Any) -> bool:
    """Return True if two records of one class have equal fields.

    Parameters
    ----------
    one, other
        Dataclass records of one class.
    """
    return all(equal_values(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))


def _by_fields(kind: Any) -> bool:
    """Return True if a record class is compared by its fields."""
    return kind.__dataclass_params__.eq
