"""Level 5 on the library of answered problems and a return: which are theorems, with J and what is free in 30 digits.

The certificate of each is confirmed by the checker, which knows nothing of the prover.

    python benchmarks/rigorous.py [PART OF A NAME ...] [--out FILE]

It prints a line for each problem; with ``--out`` each is a row of JSON in FILE as well, of which
``docs/make_validation.py --theorems FILE`` makes a table.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import perilune as pl
from perilune.rigorous.theorem import ProvedExtremal, attempt_proof
from perilune.rigorous.verified import add_attempt
from perilune_checker.check import confirm
from perilune_checker.expressions import Failed
from perilune_papers.liu2019.case import site_free

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
DIGITS = 30


def told(proved: ProvedExtremal) -> dict[str, str]:
    """J and the free parameters with their digits, in SI, and whether they are those of a local optimum."""
    problem, y = proved.boundary.problem, dict(zip(proved.boundary.names, proved.root.y, strict=True))
    values = [("J", proved.objective, problem.objective_unit), *((f.name, y[f.name], f.unit) for f in problem.free)]
    return {
        "theorem": "strict local optimum" if proved.optimum.proved else "extremal",
        "values": "; ".join(f"{name} = {value.str(DIGITS)} {unit}".removesuffix(" 1") for name, value, unit in values),
    }


def confirmed(certificate: dict[str, Any]) -> str:
    """The processor time [s] that the checker takes for a certificate, or why it does not confirm it."""
    began = time.process_time()
    try:
        confirm(certificate, partial(print, file=sys.stderr, flush=True))
    except Failed as refused:
        return f"no: {refused}"
    return f"{time.process_time() - began:.1f}"


def rows(asked: list[str]) -> Iterator[dict[str, str]]:
    """A row for each problem whose name has one of the parts that are asked for; all if none is."""
    from problems import LIBRARY

    claims = [(answered.name, answered.make, answered.methods[:1]) for answered in LIBRARY]
    claims.append(("return to the interface, neighbour A", partial(site_free, "ascending"), ()))
    for name, make, methods in claims:
        if asked and not any(part in name for part in asked):
            continue
        try:
            solution = pl.solve(make(), *methods, verify=0)
        except pl.PeriluneError as error:
            yield {"problem": name, "theorem": f"none: it is not solved, {error.what}"}
            continue
        began = time.process_time()
        found = attempt_proof(solution, lambda _: None)
        verification, seconds = add_attempt(solution.verification, found), f"{time.process_time() - began:.1f}"
        if found.proved is None or verification.certificate is None:
            yield {"problem": name, "theorem": f"none: {verification.notes[0].partition(': ')[2]}", "CPU s": seconds}
        else:
            seen = confirmed(json.loads(json.dumps(verification.certificate)))
            yield {"problem": name, **told(found.proved), "CPU s": seconds, "confirmed, CPU s": seen}


def main() -> None:
    """Attempt each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*")
    parser.add_argument("--out", type=Path)
    typed = parser.parse_args()
    for row in rows(typed.parts):
        print(", ".join(f"{name} {value}" for name, value in row.items()), flush=True)
        if typed.out is not None:
            with typed.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
