"""Our two methods beside the peers, on the same two problems, in one run, flown by one integrator outside all of them.

    python benchmarks/peers/run.py --peers PEERS_PYTHON [--only NAME ...] [--markdown]

PEERS_PYTHON is the interpreter of a virtual environment with ``yapss maptor dymos rockit-meco asset_asrl``; what it
lacks is skipped with a sentence. Each package runs in a process of its own, alone, for at most 60 s on each problem.
The README says what is measured and what is not.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from fly import fly
from task import OTHERS, TASKS, Task

HERE = Path(__file__).parent
LIMIT = 60.0
ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
OURS = {"perilune, direct": "direct", "perilune, indirect": "indirect"}
PEERS = {  # name: script and module
    "asset_asrl": ("with_asset.py", "asset_asrl"),
    "dymos": ("with_dymos.py", "dymos"),
    "maptor": ("with_maptor.py", "maptor"),
    "rockit-meco": ("with_rockit.py", "rockit"),
    "yapss": ("with_yapss.py", "yapss"),
}
HEADS = (
    "package", "claimed J - J*", "flown J - J*", "flown misses", "import", "first: set-up + solve (CPU)",
    "other values: set-up + solve (CPU)", "other values: J - J*", "grid",
)  # fmt: skip


def installed(python: str, module: str) -> bool:
    """Whether the interpreter finds the module."""
    find = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({module!r}) is None)"
    return subprocess.run([python, "-c", find], capture_output=True).returncode == 0


def answer(command: list[str]) -> dict[str, Any] | str:
    """What the script wrote, or in one sentence why it wrote nothing."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "answer.json"
        command = [part.replace("FILE", str(file)) for part in command]
        try:
            done = subprocess.run(
                command,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=LIMIT,
                env={**os.environ, **ONE_THREAD},
            )
        except subprocess.TimeoutExpired:
            return f"no answer within {LIMIT:g} s"
        if done.returncode:
            return "failed: " + (done.stderr.strip().splitlines() or ["without a word"])[-1]
        return json.loads(file.read_text(encoding="utf-8"))


def row(name: str, task: Task, other: Task, found: dict[str, Any]) -> list[str]:
    """One line of the table, in the order of `HEADS`; `other` is the task with other values."""
    flown = fly(task, found["control"])
    unit = "kg" if task.control == "beta" else "N s"
    misses = ", ".join(f"{miss:+.0e} {u}" for miss, u in zip(flown.misses, task.end_units, strict=True))
    if flown.outside > 1e-9:
        misses += f"; {task.control} outside its bounds by {flown.outside:.0e}"
    first, others = found["first"], found["others"]
    later = {name: statistics.median(times[name] for times in others) for name in first} if others else None
    return [
        f"{name} {found['version']}",
        f"{task.objective(found['mass']) - task.optimum:+.1e} {unit}",
        f"{flown.objective - task.optimum:+.1e} {unit}",
        misses,
        f"{found['imported']:.2f} s",
        _told(first),
        "not run" if later is None else _told(later),
        "not run" if later is None else f"{other.objective(found['other_mass']) - other.optimum:+.1e} {unit}",
        found["grid"],
    ]


def _told(times: dict[str, float]) -> str:
    setup, solve = times["setup"], times["solve"]
    return (
        f"{1e3 * setup:.1f} + {1e3 * solve:.1f} ms ({1e3 * times['setup_busy']:.1f} + {1e3 * times['solve_busy']:.1f})"
    )


def main() -> None:
    """Run, print, and say what was left out."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers", default=sys.executable, help="interpreter that has the peers")
    parser.add_argument("--only", nargs="*", default=(), help="names of the packages to run")
    parser.add_argument("--markdown", action="store_true", help="print the tables of the README")
    options = parser.parse_args()
    commands = {
        name: [sys.executable, str(HERE / "with_perilune.py"), "TASK", "FILE", method] for name, method in OURS.items()
    }
    for name, (script, module) in PEERS.items():
        if installed(options.peers, module):
            commands[name] = [options.peers, str(HERE / script), "TASK", "FILE"]
        else:
            print(f"{name} is not installed for the interpreter of --peers and is left out.")
    for title, task in TASKS.items():
        rows, refused = [list(HEADS)], []
        for name, command in commands.items():
            if options.only and name not in options.only:
                continue
            found = answer([part.replace("TASK", title) for part in command])
            if isinstance(found, str):
                refused.append(f"{name}: {found}")
            else:
                rows.append(row(name, task, OTHERS[title], found))
        show(f"{title}: J* = {task.optimum:.12g}", rows, refused, options.markdown)


def show(title: str, rows: list[list[str]], refused: list[str], markdown: bool) -> None:
    """One table."""
    if markdown:
        rows = [rows[0], ["---"] * len(HEADS), *rows[1:]]
        lines = ["| " + " | ".join(cells) + " |" for cells in rows]
        print("\n".join([f"\n### {title}\n", *lines, "", *refused]), flush=True)
        return
    print(f"\n{title}")
    for cells in rows[1:]:
        print("\n" + cells[0])
        for head, cell in zip(HEADS[1:], cells[1:], strict=True):
            print(f"    {head:36s}{cell}")
    print(*refused, sep="\n", flush=True)


if __name__ == "__main__":
    main()
