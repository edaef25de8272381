"""Write the page of answered problems, ``docs/validation.md``: ``python docs/make_validation.py``; some minutes.

Every problem of ``tests/problems`` is solved from nothing by each method that claims it, and proved to level 3. Rows
that miss their reference, or are not proved, are in the table like all others.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "validation.md"
HEAD = """# Validation: problems with a known answer

Each problem of the library of answered problems (`tests/problems`), solved from nothing by each method that claims
it and proved as far as level 3. *Known* is from the source beside it, whose uncertainty is half a unit of its last
digit; *error* is ours less that. Times are of one processor, the proof with them. `python docs/make_validation.py`
wrote this page; the same rows are tests (`tests/test_problems.py`). The papers' own numbers stand in the
[README](../README.md) and in the reports of `perilune reproduce`.

| problem | method | known | uncertainty | ours | error | level | CPU s | source |
|---|---|---|---|---|---|---|---|---|
"""


def rows() -> Iterator[str]:
    """One row for each problem and method."""
    from perilune import PeriluneError, solve
    from problems import LIBRARY

    for answered in LIBRARY:
        for method in answered.methods:
            began, problem = time.process_time(), answered.make()
            known, unit = answered.objective, problem.objective_unit
            try:
                found = solve(problem, method, level=3)
                ours, level = f"{found.objective:.12g}", str(found.verification.level)
                error = f"{found.objective - known:+.1e}"
                if abs(found.objective - known) > answered.error_allowed(method):
                    error = f"**{error}**"
            except PeriluneError as failed:
                ours, error, level = failed.what, "**none**", "none"
            took, told = time.process_time() - began, f"{answered.uncertainty:.0e}" if answered.uncertainty else "exact"
            yield (
                f"| {answered.name} | {type(method).__name__} | {known:.10g} {unit} | {told} | {ours} | {error} "
                f"| {level} | {took:.1f} | {answered.source} |"
            )


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT / "tests"))
    lines = list[str]()
    for row in rows():
        print(row, flush=True)
        lines.append(row)
    PAGE.write_text(HEAD + "\n".join(lines) + "\n", encoding="utf-8")
