"""An hour of abuse: falsified files, killed builders, contested caches, full disks, malformed requests to the explorer.

    python benchmarks/abuse/run.py [--minutes 60] [--seed 2015] [--only builders] [--number 17] [--out FILE]

Every trial is drawn from the seed and its number alone. What has happened is counted; a fault is a false answer that is
accepted, something that is lost, someone who is let in, a traceback, or a command that does not end. Disks are small
file systems in memory, which takes the right to mount them: without it these trials are left out, and that is said.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from itertools import count
from pathlib import Path

import files
import numpy as np
import pages
import processes
from abused import Fault, Material, made

TRIALS: dict[str, Callable[[np.random.Generator, Material, Path], str]] = {
    "scenario": files.scenario,
    "saved": files.saved,
    "certificate": files.certificate,
    "atlas": files.atlas,
    "builders": processes.builders,
    "caches": processes.caches,
    "disks": processes.disks,
    "requests": pages.requests,
}
_SHARE = {"scenario": 1.0, "saved": 2.0, "certificate": 1.0, "atlas": 2.0}  # of the time, where it is not 1.5
_USUAL = 1.5


def main() -> int:
    """Go on until the time is over; 1 if there was a fault."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=2015)
    parser.add_argument("--only", choices=[*TRIALS], nargs="*", default=[*TRIALS])
    parser.add_argument("--number", type=int, help="this trial alone")
    parser.add_argument("--out", default="", help="a line for each fault as it comes")
    options = parser.parse_args()
    ended, faults, spent = Counter[tuple[str, str]](), list[str](), dict.fromkeys(options.only, 0.0)
    with tempfile.TemporaryDirectory() as directory:
        material, chosen = made(Path(directory)), list(options.only)
        if "disks" in chosen and not processes.may_mount(Path(directory)):
            print("no disks: nothing can be mounted here", file=sys.stderr)
            chosen.remove("disks")
        numbers = {name: count(options.number or 0) for name in chosen}
        until = time.monotonic() + 60.0 * options.minutes
        while time.monotonic() < until:
            name = min(chosen, key=lambda name: spent[name] / _SHARE.get(name, _USUAL))
            number, began = next(numbers[name]), time.monotonic()
            how = tried(name, number, options.seed, material)
            spent[name] += time.monotonic() - began
            ended[name, "FAULT" if how.startswith("FAULT") else how] += 1
            if how.startswith("FAULT"):
                faults.append(json.dumps({"trial": name, "seed": options.seed, "number": number, "what": how}))
                print(faults[-1], file=sys.stderr, flush=True)
                if options.out:
                    with open(options.out, "a", encoding="utf-8") as file:
                        file.write(faults[-1] + "\n")
            if options.number is not None:
                break
    for name in chosen:
        of = {how: n for (trial, how), n in sorted(ended.items()) if trial == name}
        print(f"{name:<12} {sum(of.values()):>6} in {spent[name]:.0f} s: {of}")
    print(f"{ended.total()} trials, {len(faults)} faults")
    return 1 if faults else 0


def tried(name: str, number: int, seed: int, material: Material) -> str:
    """How a trial ended."""
    rng = np.random.default_rng([seed, [*TRIALS].index(name), number])
    with tempfile.TemporaryDirectory() as directory:
        try:
            return TRIALS[name](rng, material, Path(directory))
        except Fault as fault:
            return f"FAULT: {fault}"
        except Exception:  # what is no word of ours is what this looks for
            return f"FAULT: {traceback.format_exc()[-800:]}"


if __name__ == "__main__":
    sys.exit(main())
