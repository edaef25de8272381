"""Level 5 on the library of answered problems and a return: which are theorems, J to 30 digits, how long each took.

``python benchmarks/rigorous.py [PART OF A NAME ...]`` prints one line for each.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path

import perilune as pl
from perilune.reproductions.liu2019.case import site_free
from perilune.rigorous.theorem import attempt

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))


def main() -> None:
    """Attempt each."""
    from problems import LIBRARY

    asked = sys.argv[1:]
    rows = [(answered.name, answered.make, answered.methods[:1]) for answered in LIBRARY]
    rows.append(("return to the interface, neighbour A", partial(site_free, "ascending"), ()))
    for name, make, methods in rows:
        if asked and not any(part in name for part in asked):
            continue
        try:
            solution = pl.solve(make(), *methods, level=0)
        except pl.PeriluneError as error:
            print(f"{name}: not solved: {error.what}", flush=True)
            continue
        began = time.process_time()
        found = attempt(solution, lambda _: None)
        took = f"{time.process_time() - began:.1f} s of CPU"
        if found.proved is None:
            print(f"{name}: no theorem, {found.unsaid}; {took}", flush=True)
            continue
        proved = found.proved
        missing = "; ".join(f"{s.words} {s.where}" for s in proved.missing)
        verdict = f"only in part, not {missing}" if missing else "theorem"
        optimum = "strict local optimum" if proved.optimum.proved else "extremal"
        told = f"J = {proved.objective.str(30)}, {proved.distance:.1e} from the answer"
        print(f"{name}: {verdict}, {optimum}; {told}; {took}", flush=True)


if __name__ == "__main__":
    main()
