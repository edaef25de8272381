"""Names and size limits of the files of a saved solution, for writing and for reading."""

from __future__ import annotations

import hashlib

FORMAT_NAME, FORMAT_VERSION, SOLUTION_FILE = "perilune-solution", 3, "solution.json"
# Of the first version the problem is nothing but its scenario's text; the second has other keys
# (`perilune.problem.renamed_keys`).
WITH_SCENARIO_ONLY, KNOWN_VERSIONS = 1, (1, 2, FORMAT_VERSION)
LARGEST_FILE = 64 * 2**20  # bytes; the largest trajectory (6401 nodes, 10 states) takes about 8 MB


def hash_of(scenario_text: str) -> str:
    """Return the SHA-256 of the text in UTF-8, hexadecimal."""
    return hashlib.sha256(scenario_text.encode("utf-8")).hexdigest()
