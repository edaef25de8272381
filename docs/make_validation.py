"""Write the page of answered problems, ``docs/validation.md``: ``python docs/make_validation.py``; some minutes.

Every problem of ``tests/problems``, and some that are too slow to be swept with these, is solved without a guess by
each method that claims it and proved to level 3. Rows that miss their reference, or are not proved, are in the table
like all others. ``--landers ROWS`` and ``--theorems ROWS`` put in what ``random_landers.py`` and ``rigorous.py`` of
``benchmarks`` wrote by ``--out``, and leave the rest of the page as it is. ``tests/test_docs_made.py`` computes some
rows again and compares what stands beside all of them.
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
import sys
import time
from collections.abc import Iterable, Iterator
from functools import partial
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from problems import Answered
    from problems.answered import Method

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "validation.md"
HEAD = """# Validation: problems with a known answer

Each problem of the library of answered problems (`tests/problems`), solved without an initial guess by each method that
claims it and proved as far as level 3. *Known* is from the [source](#sources) below, whose uncertainty is half a unit
of its last digit; *error* is ours less that, in bold where it is more than this and more than the method's tolerance.
A level below 3 is in bold. Times are of one processor, the proof with them, the machine code of an earlier run on
disk. `python docs/make_validation.py` wrote this page; the same problems are tests. The papers' own numbers stand in
the [README](../README.md) and in the reports of `perilune reproduce`.
"""
LANDERS = """## Landers drawn at random

Nobody knows their answers, but each can be proved. `python benchmarks/random_landers.py --seed {seed}` drew {count}
over nine bodies, with a seed not used during development, and solved each without an initial guess: {proved} of
{flown} that were not refused are proved to level 3, in {median:.2f} s of a processor in the median,
at most {longest:.1f} s. *Refused* is what physics says of an orbit that meets the ground before its site.
*No answer* is exit code 4, all but once of a
lander whose thrust does not hold half its weight: its optimal path has a boundary arc along the ground,
for a good part of an orbit.
Two rows were computed once more, after a refusal of them had turned out to be wrong; they have no answer now.

"""
THEOREMS = """## Theorems

[Level 5](theory-rigorous.md) of the same problems and of a return: proved by enclosures, $J$ and what is free in thirty
digits, in SI, with the numbers of each problem taken as the doubles that they are. Times are of one processor, the last
that in which `perilune_checker` confirmed the certificate. `python benchmarks/rigorous.py` computed them.

"""
COLUMNS = ("problem", "method", "known", "uncertainty", "ours", "error", "level", "CPU s")


def answered_problems() -> tuple[Answered, ...]:
    """The library, and what has tests of its own."""
    from perilune import Indirect, Pseudospectral
    from problems import LIBRARY, Answered
    from problems.circles import meeting
    from problems.constrained import bryson_denham, bryson_denham_truth, mars_glide_slope
    from problems.reentries import COOL_RANGE, shuttle

    return (
        *LIBRARY,
        Answered(
            name="least energy, state bound touched once",
            make=partial(bryson_denham, 0.2),
            objective=bryson_denham_truth(0.2),
            source="Bryson, Denham, Dreyfus 1963: 2 + 6 (1 - 4 l)^2 for 1/6 < l < 1/4",
        ),
        Answered(
            name="shuttle's cross range below 70 BTU/ft2/s",
            make=partial(shuttle, 70.0),
            objective=-radians(COOL_RANGE),
            uncertainty=radians(5e-5),
            source="Betts 2010, section 6.1",
        ),
        Answered(
            name="Mars landing above a glide slope",
            make=mars_glide_slope,
            objective=-1506.930326,
            uncertainty=5e-7,
            source="problem of Acikmese, Ploen 2007; by the two methods here, independent of each other",
        ),
        Answered(
            name="eight revolutions, 17 switches",
            make=partial(meeting, 8, thrust=0.02),
            objective=-0.8669708299,
            uncertainty=5e-11,
            source="by the two methods here, independent of each other",
            methods=(Indirect(), Pseudospectral(segments=10, nodes=8, refine=0)),
        ),
    )


def known(answered: Answered, method: Method) -> dict[str, str]:
    """What stands in a row without solving anything, by column."""
    told = f"{answered.uncertainty:.0e}" if answered.uncertainty else "exact"
    value = f"{answered.objective:.10g} {answered.make().objective_unit}"
    return {
        "problem": answered.name,
        "method": type(method).__name__,
        "known": value,
        "uncertainty": told,
    }


def solved(answered: Answered, method: Method) -> dict[str, str]:
    """What solving gives, by column."""
    from perilune import PeriluneError, solve

    began = time.process_time()
    try:
        found = solve(answered.make(), method, verify=3)
        off, proof = found.objective - answered.objective, found.verification
        bold = "**" if abs(off) > answered.error_allowed(method) else ""
        row = {"ours": f"{found.objective:.12g}", "error": f"{bold}{off:+.1e}{bold}", "level": "3"}
        if proof.level < 3:
            row |= {"level": f"**{proof.level}**", "failed": f"`{proof.failed[0].name}`"}
    except PeriluneError as failed:
        row = {"ours": failed.what, "error": "**none**", "level": "**none**", "failed": "no answer"}
    return {**row, "CPU s": f"{time.process_time() - began:.1f}"}


def claims() -> Iterator[tuple[Answered, Method]]:
    """Each problem with each of its methods, as the rows stand."""
    return ((answered, method) for answered in answered_problems() for method in answered.methods)


def line(cells: Iterable[str]) -> str:
    """A line of the table."""
    return f"| {' | '.join(cells)} |"


def table(columns: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A whole table."""
    columns = tuple(columns)
    return "\n".join([line(columns), "|" + "---|" * len(columns), *map(line, rows), ""])


def sources() -> str:
    """Where each answer is known from."""
    return "## Sources\n\n" + table(("problem", "source"), ((a.name, a.source) for a in answered_problems()))


def landers(text: str) -> str:
    """What became of the landers of a file of rows."""
    from random_landers import PROVED, table as ends

    rows = [json.loads(line) for line in text.splitlines()]
    took, refused = [row["cpu"] for row in rows], sum(row["class"] == "refused" for row in rows)
    told = LANDERS.format(
        seed=rows[0]["seed"], count=len(rows), proved=sum(row["class"] == PROVED for row in rows),
        flown=len(rows) - refused, median=statistics.median(took), longest=max(took),
    )  # fmt: skip
    head, *body = ends(rows)
    return told + table(head, body)


def theorems(text: str) -> str:
    """What of the rows of a file is a theorem."""
    rows = [json.loads(line) for line in text.splitlines()]
    columns = {"problem": "problem", "theorem": "theorem", "J and what is free": "values", "CPU s": "CPU s",
               "confirmed, CPU s": "confirmed, CPU s"}  # fmt: skip
    return THEOREMS + table(columns, ([row.get(name, "") for name in columns.values()] for row in rows))


def summary(rows: list[dict[str, str]]) -> str:
    """How many of the rows are good."""
    hit, proved = (sum("**" not in row[name] for row in rows) for name in ("error", "level"))
    return f"{len(rows)} rows: {hit} hit what is known, {proved} are proved to level 3."


def short(rows: list[dict[str, str]]) -> str:
    """What stands in the way of level 3, where it was not reached."""
    told = [f"{row['problem']} ({row['method']}): {row['failed']}" for row in rows if "failed" in row]
    what = "The first [check](verification.md#the-checks) that fails where level 3 is not reached"
    return f"{what}: {'; '.join(told)}.\n" if told else ""


def answered() -> str:
    """The page down to its first section."""
    rows = list[dict[str, str]]()
    for claim in claims():
        rows.append(known(*claim) | solved(*claim))
        print(line(rows[-1].values()), flush=True)
    results = table(COLUMNS, ([row[column] for column in COLUMNS] for row in rows))
    return "\n".join([HEAD, summary(rows), "", results, short(rows)])


def main() -> None:
    """Write the requested pages again."""
    parser = argparse.ArgumentParser(description="docs/validation.md")
    parser.add_argument("--landers", type=Path)
    parser.add_argument("--theorems", type=Path)
    typed = parser.parse_args()
    head, *parts = re.split("^(?=## )", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    sections = {part.partition("\n")[0]: part for part in parts}
    for file, made in ((typed.theorems, theorems), (typed.landers, landers)):
        if file is not None:
            section = made(file.read_text(encoding="utf-8")) + "\n"
            sections[section.partition("\n")[0]] = section
    if typed.landers is None and typed.theorems is None:
        head = answered() + "\n"
    titles = [told.partition("\n")[0] for told in (THEOREMS, LANDERS)]
    page = [head, *(sections[title] for title in titles if title in sections), sources()]
    PAGE.write_text("".join(page), encoding="utf-8")


if __name__ == "__main__":
    sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "benchmarks")]
    main()
