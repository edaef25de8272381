"""What a saved solution is called and how large it may be, for those who write it and those who read it."""

from __future__ import annotations

import hashlib

FORMAT_NAME, FORMAT_VERSION, SOLUTION_FILE = "perilune-solution", 2, "solution.json"
# Of the first version the problem is nothing but its scenario's text.
WITH_SCENARIO_ONLY, KNOWN_VERSIONS = 1, (1, FORMAT_VERSION)
LARGEST_FILE = 64 * 2**20  # bytes; the largest trajectory (6401 nodes, 10 states) takes about 8 MB


def hash_of(scenario_text: str) -> str:
    """SHA-256 of the text in UTF-8, hexadecimal."""
    return hashlib.sha256(scenario_text.encode("utf-8")).hexdigest()
