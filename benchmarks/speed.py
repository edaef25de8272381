"""Speed of what users wait for, each beside an alternative in the same run: the table of the page on speed.

    OPENBLAS_NUM_THREADS=1 python benchmarks/speed.py [--only NAME] [--page docs/speed.md]

Seconds are those of a processor, of the process and its children. Rows that miss their goal come first.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import perilune as pl

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
IMPORTS = [sys.executable, "-c", "import casadi, scipy.integrate"]
HEAD = "| | in the same run | measured | goal |\n|---|---|---|---|"


@dataclass(frozen=True)
class Row:
    """One line of the table; `met` is True where the goal is reached."""

    what: str
    ratio: str
    measured: str
    goal: str
    met: bool

    @property
    def text(self) -> str:
        """Return the line."""
        return f"| {self.what} | {self.ratio} | {self.measured} | {'' if self.met else '**short**: '}{self.goal} |"


def example(name: str) -> pl.Problem:
    """Return the problem of an example."""
    return pl.scenario.load_file(EXAMPLES / f"{name}.toml").problem


def processor(action: Callable[[], object], times: int = 1) -> float:
    """Return seconds of this process for one of some calls, after a first that is not counted."""
    action()
    begun = time.process_time()
    for _ in range(times):
        action()
    return (time.process_time() - begun) / times


def process(command: list[str], **environment: str) -> tuple[float, float]:
    """Return seconds of a processor of a whole process, and the most memory that it had [MiB]."""
    timed = [sys.executable, "-c", _CHILD, *command]
    ran = subprocess.run(timed, check=True, capture_output=True, text=True, env={**os.environ, **environment})
    seconds, memory = json.loads(ran.stdout.splitlines()[-1])
    return seconds, memory


_CHILD = (  # rusage of exactly one child
    "import json, resource, subprocess, sys\n"
    "ran = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)\n"
    "used = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
    "print(json.dumps([used.ru_utime + used.ru_stime, used.ru_maxrss / 1024]))\n"
    "sys.exit(ran.returncode if ran.returncode not in (0, 5) else 0)\n"
)


def command(*arguments: str) -> list[str]:
    """Return the command line of the program."""
    return [sys.executable, "-m", "perilune", *arguments]


def solving(name: str, *more: str) -> list[str]:
    """Return the command that solves an example."""
    return command("solve", str(EXAMPLES / f"{name}.toml"), "--json", *more)


def points_together() -> Iterator[Row]:
    """Points of one problem by `solve_many`, beside one by one from the known solution."""
    for name, goal, times in (("ordinary_lander", 15_000, 25), ("precision_landing", 5_000, 8)):
        problem, rng = example(name), np.random.default_rng(43)
        known = pl.solve(problem, verify=0)
        varied = ("vehicle_thrust", "vehicle_specific_impulse")
        table = {n: problem.given[n].value * (1 + 0.1 * rng.uniform(-1, 1, 10_000)) for n in varied}
        pl.solve_many(problem, {n: v[:8] for n, v in table.items()}, known)
        begun = time.process_time()
        batch = pl.solve_many(problem, table, known, search=False)
        rate = len(batch) / (time.process_time() - begun)
        some = [batch.problem_of(i) for i in np.nonzero(batch.solved)[0][:30].tolist()]
        begun = time.process_time()
        for one in some:
            pl.solve(one, guess=known, verify=0)
        alone = len(some) / (time.process_time() - begun)
        yield Row(
            f"10 000 points of `{name}` by `solve_many`, each integrated twice",
            f"{rate / alone:.0f} times as many as by `solve(guess=...)`, which integrates once",
            f"{rate:.0f} a second", f"{goal} a second, {times} times", rate >= goal and rate >= times * alone,
        )  # fmt: skip


def points_proved() -> Iterator[Row]:
    """The same, each proved to level 3."""
    problem = example("hybrid_lander")
    known = pl.solve(problem, verify=0)
    points = {"vehicle.thrust": np.linspace(420.0, 460.0, 60)}
    seconds = processor(lambda: pl.solve_many(problem, points, known, verify=3)) / 60
    search = processor(lambda: pl.solve(problem, verify=0), 3)
    yield Row(
        "points of `hybrid_lander` by `solve_many`, each PROVED 3",
        f"{seconds / search:.2f} of a search without a guess",
        f"{1 / seconds:.0f} a second", "200 a second", seconds <= 1 / 200,
    )  # fmt: skip


def sweep_together() -> Iterator[Row]:
    """A sweep of 100 by 100 members from the command line."""

    def swept(place: str, thrust: float, impulse: float, *more: str) -> list[str]:
        vary = f"vehicle.thrust=303.5:650:{thrust} N", f"vehicle.specific_impulse=290.4:330:{impulse} s"
        scenario = str(EXAMPLES / "hybrid_lander.toml")
        return command("sweep", scenario, "--vary", vary[0], "--vary", vary[1], "--out", place, *more)

    with tempfile.TemporaryDirectory() as folder:
        seconds, memory = process(swept(f"{folder}/a", 3.5, 0.4, "--batch"))
        files = [path for path in Path(folder, "a").rglob("*") if path.is_file()]
        size, count = sum(path.stat().st_size for path in files) / 1e4 / 1024, len(files)
        started = process(command("check", str(EXAMPLES / "hybrid_lander.toml")))[0]
        each = (process(swept(f"{folder}/b", 115.0, 13.0, "--level", "0"))[0] - started) / 16
    yield Row(
        "`perilune sweep --batch`, 100 by 100 members, table and map",
        f"{seconds / (1e4 * each):.4f} of the same without `--batch` at level 0 (by 16 of its members)",
        f"{seconds:.1f} s, {memory:.0f} MiB, {size:.1f} KiB a member, {count} files",
        "8 s, 300 MiB, 5 KiB a member, a file for 1000", seconds <= 8 and memory <= 300 and size <= 5 and count <= 14,
    )  # fmt: skip


def many_points_stored() -> Iterator[Row]:
    """Very many points with a store: memory."""
    problem, rng = example("ordinary_lander"), np.random.default_rng(6)
    known = pl.solve(problem, verify=0)
    used = list[tuple[float, float]]()
    for count in (20_000, 400_000):
        table = {
            n: problem.given[n].value * (1 + 0.1 * rng.uniform(-1, 1, count))
            for n in ("vehicle_thrust", "vehicle_specific_impulse")
        }
        with tempfile.TemporaryDirectory() as folder:
            begun = time.process_time()
            pl.solve_many(problem, table, known, store=f"{folder}/s")
            used.append(
                ((time.process_time() - begun) / count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
            )
    each = 1024 * 1024 * (used[1][1] - used[0][1]) / 380_000
    yield Row(
        "400 000 points with a store", f"{used[1][0] / used[0][0]:.2f} of the time a point of 20 000",
        f"{1 / used[1][0]:.0f} a second; {each:.0f} bytes a point resident", "memory that does not grow", each < 1,
    )  # fmt: skip


def proofs() -> Iterator[Row]:
    """Verification beside the search that it follows."""
    for name, goal in (("hybrid_lander", 40), ("precision_landing", 90), ("mars_pinpoint", 200),
                       ("minimum_duration_return", 400)):  # fmt: skip
        problem = example(name)
        solution = pl.solve(problem, verify=0)
        search = processor(lambda problem=problem: pl.solve(problem, verify=0))
        low, high = (processor(lambda level=level, s=solution: pl.verify(s, level), 3) for level in (1, 3))
        yield Row(
            f"`verify` of `{name}` to level 1, 3",
            f"{low / search:.2f}, {high / search:.2f} of its search without a guess",
            f"{1e3 * low:.0f}, {1e3 * high:.0f} ms", f"5, {goal} ms", low <= 5e-3 and 1e3 * high <= goal,
        )  # fmt: skip


def main_job() -> Iterator[Row]:
    """Whole processes."""
    imports = min(process(IMPORTS)[0] for _ in range(5))
    process(solving("hybrid_lander"))
    solved = min(process(solving("hybrid_lander"))[0] for _ in range(5))
    with tempfile.TemporaryDirectory() as folder:
        empty = process(solving("hybrid_lander"), PERILUNE_CACHE=folder)[0]
    yield Row(
        "`perilune solve examples/hybrid_lander.toml`, PROVED 3",
        f"{solved / imports:.2f} of `import casadi, scipy.integrate`",
        f"{solved:.2f} s", "0.6", solved <= 0.6 * imports,
    )  # fmt: skip
    yield Row(
        "the same with an empty cache of machine code", f"{empty / imports:.2f} of these imports",
        f"{empty:.2f} s", "1.1", empty <= 1.1 * imports,
    )  # fmt: skip
    for name, goal, most in (
        ("mars_pinpoint", 1.2, 1e9),
        ("minimum_duration_return", 2.0, 1e9),
        ("capsule_return", 6.0, 250),
    ):
        process(solving(name))
        seconds, memory = process(solving(name))
        yield Row(
            f"`perilune solve examples/{name}.toml`", f"{seconds / imports:.1f} of these imports",
            f"{seconds:.1f} s, {memory:.0f} MiB", f"{goal:g} s" + (f", {most} MiB" if most < 1e9 else ""),
            seconds <= goal and memory <= most,
        )  # fmt: skip


def queries() -> Iterator[Row]:
    """Queries of an atlas, one by one."""
    problem, rng = example("hybrid_lander"), np.random.default_rng(15)
    ranges = {"vehicle.thrust": (400.0, 480.0), "retro.specific_impulse": (290.0, 310.0)}
    with tempfile.TemporaryDirectory() as folder:
        atlas = pl.atlas.open(pl.atlas.build(problem, ranges, f"{folder}/map"))
        points = [{n: float(rng.uniform(*span)) for n, span in ranges.items()} for _ in range(2000)]
        taken = list[float]()
        for point in [*points[:200], *points]:
            begun = time.process_time()
            atlas.query(**point)
            taken.append(time.process_time() - begun)
    near = pl.solve(problem, verify=0)
    each = processor(lambda: pl.solve(problem.with_given(vehicle_thrust=441.0), guess=near, verify=0), 30)
    median, late = 1e3 * np.percentile(taken[200:], [50, 99])
    yield Row(
        "query of an atlas of two parameters, integrated twice", f"{1e-3 * median / each:.3f} of `solve(guess=...)`",
        f"{median:.3f} ms at the median, {late:.3f} at 99 %", "0.15, 0.4 ms", bool(median <= 0.15 and late <= 0.4),
    )  # fmt: skip


def theorem() -> Iterator[Row]:
    """Level 5."""
    solution = pl.solve(example("ordinary_lander"), verify=4)
    begun = time.process_time()
    proved = pl.verify(solution, 5)
    seconds = time.process_time() - begun
    three = processor(lambda: pl.verify(solution, 3), 3)
    assert proved.verification.level == 5
    yield Row(
        "level 5 of the ordinary landing",
        f"{seconds / three:.0f} times level 3",
        f"{seconds:.1f} s",
        "3 s",
        seconds <= 3,
    )


ROWS = {
    "points": points_together, "points-proved": points_proved, "sweep": sweep_together, "stored": many_points_stored,
    "proofs": proofs, "processes": main_job, "queries": queries, "theorem": theorem,
}  # fmt: skip


def main() -> int:
    """Measure and print, and replace the table of the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=[*ROWS], action="append")
    parser.add_argument("--page", type=Path)
    given, rows = parser.parse_args(), list[Row]()
    for name in given.only or ROWS:
        for row in ROWS[name]():
            print(row.text, flush=True)
            rows.append(row)
    if given.page is not None and not given.only:
        before, _, rest = given.page.read_text(encoding="utf-8").partition(HEAD)
        behind = rest.partition("\n\n")[2]
        lines = [row.text for row in sorted(rows, key=lambda row: row.met)]
        given.page.write_text("\n".join([f"{before}{HEAD}", *lines, "", behind]), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
