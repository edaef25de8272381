"""Checksums of an atlas's header and survey, so that damage shows."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from perilune.io import finite

FORMAT: dict[str, str | int] = {"name": "perilune-atlas", "version": 7}
# The first has other keys (`perilune.problem.renamed_keys`).
KNOWN_FORMATS: tuple[dict[str, str | int], ...] = ({**FORMAT, "version": 6}, FORMAT)
CHECKSUM = "sha256"  # of all else in the header


def digest_of(said: Any) -> str:
    """Return the SHA-256 of a tree as JSON with sorted keys."""
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()


def end_line(survey: Mapping[str, Any], bricks: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the line by which a builder states that these are all blocks, so that a lost line shows.

    Parameters
    ----------
    survey
        Line of the survey.
    bricks
        Lines of all its blocks.
    """
    return {"kind": "end", "survey": survey["digest"], "bricks": len({line["name"] for line in bricks})}


def with_checksum(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return a header with the checksum of its content."""
    said = {name: value for name, value in header.items() if name != CHECKSUM}
    return {**said, CHECKSUM: digest_of(said)}


def seal_of(header: Mapping[str, Any]) -> str:
    """Return the checksum that a header will have."""
    return sealed_header(header)[CHECKSUM]


def sealed_header(header: Mapping[str, Any]) -> dict[str, Any]:
    """Return a header with the format's name and version, and its checksum."""
    return with_checksum({"format": FORMAT, **finite(dict(header))})
