"""Mutants of what an answer rests on, each against the tests that cover its line: who is killed, and who survives.

Drawn by cosmic-ray from eight rooms, as many from each: proof, conditions, shooting, extremals, structures, units,
preflight and atlas. They are written into the files one after the other, so that all this runs in a clone of its own,
in an environment where that is installed in place:

    pip install -e '.[test]' cosmic-ray pytest-cov
    python benchmarks/mutants.py cover             # once: all tests, what each covers and how long it takes
    python benchmarks/mutants.py draw [--count 320] [--seed 2015]
    cosmic-ray exec build/mutants/config.toml build/mutants/session.sqlite   # goes on where it was stopped
    python benchmarks/mutants.py told              # by rooms; and the survivors, as differences

Annotations are not drawn from, as they are never evaluated. The tests that cover a line are run from the fastest on
until one fails, `BUDGET` seconds of them at most: a mutant that outlives these counts as a survivor, though a slower
test might kill it. A line that no test covers is not spared: its mutants survive. What does not end is stopped, and
counts as killed.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

ROOT = Path(__file__).parent.parent
SOURCE = ROOT / "src" / "perilune"
AT = ROOT / "build" / "mutants"
CONFIG, SESSION, COVERED, TIMES = AT / "config.toml", AT / "session.sqlite", AT / "covered.sqlite", AT / "times.xml"
ROOMS = {
    "proof": ("proof/**/*.py",),
    "conditions": ("conditions/**/*.py",),
    "shooting": ("shooting/[!e]*.py",),
    "extremals": (
        "methods/indirect/continuation/parameter_scan.py",
        "problem/results/extremal.py",
        "methods/indirect/cold_search.py",
        "methods/indirect/continuation/family_search.py",
        "methods/indirect/search.py",
        "methods/indirect/result.py",
    ),
    "structures": ("structures/**/*.py",),
    "units": ("core/units.py", "core/untrusted_text.py", "problem/tracing/dimensions.py"),
    "preflight": ("problem/presolve.py", "models/**/presolve.py"),
    "atlas": ("atlas/**/*.py",),
}
BUDGET, STUCK = 240.0, 900.0  # seconds


def files() -> dict[str, str]:
    """The room of each file, by its path from the root."""
    return {
        path.relative_to(ROOT).as_posix(): room
        for room, patterns in ROOMS.items()
        for pattern in patterns
        for path in sorted(SOURCE.glob(pattern))
        if path.name != "__init__.py"
    }


def cover() -> None:
    """Run all tests once; which lines each test runs, and how long it takes."""
    AT.mkdir(parents=True, exist_ok=True)
    rc = AT / "coverage.ini"
    rc.write_text(f"[run]\nsource = {SOURCE}\ndata_file = {COVERED}\nparallel = true\n", encoding="utf-8")
    options = [f"--cov={SOURCE}", "--cov-context=test", f"--cov-config={rc}", "--cov-report=", f"--junitxml={TIMES}"]
    subprocess.run([sys.executable, "-m", "pytest", "-q", *options], cwd=ROOT, check=True)


def draw(count: int, seed: int) -> None:
    """A session of so many mutants, as many of each room; the others are marked as skipped."""
    from cosmic_ray.commands import init
    from cosmic_ray.work_db import WorkDB, use_db
    from cosmic_ray.work_item import WorkerOutcome, WorkResult

    AT.mkdir(parents=True, exist_ok=True)
    rooms, rng = files(), np.random.default_rng(seed)
    command = f"{sys.executable} {Path(__file__).relative_to(ROOT).as_posix()} test"
    lines = [
        f"test-command = {command!r}",
        f"timeout = {STUCK}",
        "distributor.name = 'local'",
        f"module-path = {[*rooms]}",
    ]
    CONFIG.write_text("\n".join(["[cosmic-ray]", *lines, "excluded-modules = []", ""]), encoding="utf-8")
    with use_db(str(SESSION), WorkDB.Mode.create) as session:
        init([Path(name) for name in rooms], session, {})
        spared = {name: list(annotations(ast.parse((ROOT / name).read_text(encoding="utf-8")))) for name in rooms}
        items: dict[str, list[str]] = {room: [] for room in ROOMS}
        for item in session.work_items:
            (mutation,) = item.mutations
            name = mutation.module_path.as_posix()
            if not any(begin <= mutation.start_pos < end for begin, end in spared[name]):
                items[rooms[name]].append(item.job_id)
        each = -(-count // len(ROOMS))
        drawn = {job for room in ROOMS for job in rng.permutation(sorted(items[room]))[:each]}
        left_out = [item.job_id for item in session.work_items if item.job_id not in drawn]
        session.set_multiple_results(left_out, WorkResult(worker_outcome=WorkerOutcome.SKIPPED))
    print(
        f"{len(drawn)} of {sum(map(len, items.values()))} mutants: "
        + ", ".join(f"{r} {len(i)}" for r, i in items.items())
    )


def annotations(tree: ast.Module) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Where annotations begin and end: (line, column) each."""
    for node in ast.walk(tree):
        for found in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            if isinstance(found, ast.expr) and found.end_lineno is not None and found.end_col_offset is not None:
                yield (found.lineno, found.col_offset), (found.end_lineno, found.end_col_offset)


def test() -> int:
    """Run the tests that cover what is changed here, from the fastest on; the exit status of pytest."""
    if not (chosen := covering(changed())):
        return 0
    (AT / "chosen").write_text("\n".join(chosen), encoding="utf-8")
    options = ["-q", "-x", "-n", "0", "-p", "no:cacheprovider", f"@{AT / 'chosen'}"]
    return subprocess.run([sys.executable, "-m", "pytest", *options], cwd=ROOT).returncode


def changed() -> dict[str, set[int]]:
    """Lines, by files from the root, that differ from what git knows: those that were there before."""
    git = ["git", "-C", str(ROOT)]
    named = subprocess.run([*git, "diff", "--name-only", "--", "src"], capture_output=True, text=True, check=True)
    found = dict[str, set[int]]()
    for name in named.stdout.split():
        before = subprocess.run([*git, "show", f"HEAD:{name}"], capture_output=True, text=True, check=True).stdout
        now = (ROOT / name).read_text(encoding="utf-8")
        pieces = difflib.SequenceMatcher(None, before.splitlines(), now.splitlines(), autojunk=False).get_opcodes()
        found[name] = {line + 1 for tag, a, b, _, _ in pieces if tag != "equal" for line in range(a, max(b, a + 1))}
    return found


def covering(lines: dict[str, set[int]]) -> list[str]:
    """Tests that run one of these lines, from the fastest on, as many as `BUDGET` allows.

    A line that is run as its file is imported alone belongs to all tests of the file.
    """
    from coverage import CoverageData

    data, names, times = CoverageData(str(COVERED)), set[str](), took()
    data.read()
    for name, numbers in lines.items():
        contexts = data.contexts_by_lineno(str(ROOT / name))
        here = {c.partition("|")[0] for number in numbers for c in contexts.get(number, ())} - {""}
        at_import = any("" in contexts.get(number, ()) for number in numbers) and not here
        names |= {c.partition("|")[0] for found in contexts.values() for c in found} - {""} if at_import else here
    left, chosen = BUDGET, list[str]()
    for name in sorted(names, key=lambda name: times.get(name, 1.0)):
        left -= times.get(name, 1.0)
        if left < 0.0:
            break
        chosen.append(name)
    return chosen


def took() -> dict[str, float]:
    """Seconds of each test, by its node id."""
    cases = ElementTree.parse(TIMES).getroot().iter("testcase")
    return {f"{c.get('classname', '').replace('.', '/')}.py::{c.get('name')}": float(c.get("time", 0.0)) for c in cases}


def told() -> None:
    """Killed of those that were tried, by rooms, and the survivors."""
    from cosmic_ray.work_db import WorkDB, use_db
    from cosmic_ray.work_item import WorkerOutcome

    rooms, killed, tried, alive = files(), Counter[str](), Counter[str](), list[str]()
    with use_db(str(SESSION), WorkDB.Mode.open) as session:
        left = session.num_work_items - session.num_results
        for item, result in session.completed_work_items:
            if result.worker_outcome == WorkerOutcome.SKIPPED:
                continue
            (mutation,) = item.mutations
            room = rooms[mutation.module_path.as_posix()]
            tried[room] += 1
            killed[room] += result.is_killed
            alive += (
                [] if result.is_killed else [f"{room}: {mutation.definition_name or ''}\n{only(result.diff or '')}"]
            )
    print("\n".join(alive))
    print("\n".join(f"{room:<12} {killed[room]:>4} of {tried[room]:>4}" for room in ROOMS))
    print(f"{killed.total()} of {tried.total()} killed, {killed.total() / max(tried.total(), 1):.1%}; {left} left")


def only(diff: str) -> str:
    """The lines of a difference that say where it is and what it changes."""
    return "\n".join(line for line in diff.splitlines() if line[:1] in "@+-" and not line.startswith("--- "))


def main() -> None:
    """One step."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("step", choices=["cover", "draw", "test", "told"])
    parser.add_argument("--count", type=int, default=320)
    parser.add_argument("--seed", type=int, default=2015)
    options = parser.parse_args()
    if options.step == "test":
        sys.exit(test())
    if options.step == "draw":
        draw(options.count, options.seed)
    else:
        {"cover": cover, "told": told}[options.step]()


if __name__ == "__main__":
    main()
