"""Every pair of what may stand together in a scenario, carried the whole way but for a solver; failures are listed.

    python tests/all_pairs.py [KIND ...]

The suite (`test_matrix.py`) has each value once. Flights are those from which a direct method would start.
"""

from __future__ import annotations

import sys
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from carried import Carried, rough_flight
from matrix import WAYS, cover, text_of


def carry(text: str, folder: Path) -> list[str]:
    """Carry a scenario; return its steps."""
    carried = Carried(folder, text)
    carried.check()
    solution = rough_flight(carried.problem)
    for step in (carried.told, carried.saved, carried.drawn, carried.explored, carried.paired):
        step(solution)
    carried.exported(solution, timed=False)
    return carried.steps


def main(kinds: Sequence[str]) -> int:
    """Carry all pairs of these kinds; the number of scenarios that failed."""
    warnings.simplefilter("error")
    failed, steps = 0, Counter[str]()
    for kind in kinds or WAYS:
        combinations = cover(WAYS[kind], pairs=True)
        for picked in combinations:
            with TemporaryDirectory() as folder:
                try:
                    steps.update(carry(text_of(WAYS[kind].document(picked)), Path(folder)))
                except Exception as error:
                    failed += 1
                    print(f"{kind} {picked}\n  {type(error).__name__}: {error}", flush=True)
        print(f"{kind}: {len(combinations)} scenarios", flush=True)
    print(f"{sum(steps.values())} steps, {failed} scenarios failed")
    return failed


if __name__ == "__main__":
    sys.exit(1 if main(sys.argv[1:]) else 0)
