"""Random scenarios through ``perilune check`` and ``perilune solve``: no fault of the program, no warning of a library.

    python benchmarks/fuzz_scenarios.py --seed 1 --check 10000 --solve 1000 [--limit 20] [--out failures/]

Scenarios are made from the declarations of all kinds, so that a new key is drawn as soon as it is declared. *Near* ones
are a template or an example with one to four keys changed; *far* ones have every key drawn, over thirty decades, zero,
negative, in other units, with choices exchanged and sections missing, doubled, swapped or of another kind. The command
line runs in this process, as ``perilune.cli.run_command_line``. What counts as a failure: an exit code that is not of
`CODES`, anything on stderr that is a warning or a traceback, and (in `solve`) `SILENCE` seconds without a line on
stderr. Each `solve` runs in a process of its own with ``--time-limit``; one that takes twice that is ended, and counts
as well. The scenarios depend on the seed alone; number N of a seed is drawn again with ``--only N``.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import os
import random
import signal
import sys
import tempfile
import time
import tomllib
import traceback
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from perilune.cli import run_command_line
from perilune.core import Key, Quantity
from perilune.models import KINDS, Kind, Section
from perilune.scenario import template
from perilune.scenario.reader import names_of

CODES = {"check": (0, 2, 3), "solve": (0, 2, 3, 4, 5)}
SILENCE = 20.0  # s
SUSPECT = ("Warning", "Traceback", "Error:", "CasADi", "Exit code")  # of Python and libraries, never in our messages
EXAMPLES = Path(__file__).parent.parent / "examples"
UNITS = ("m", "km", "s", "h", "day", "kg", "t", "g", "N", "kN", "m/s", "km/s", "deg", "rad", "deg/s", "rad/s", "m^2",
         "km^3/s^2", "kg/m^3", "W/m^2", "Pa", "K", "g0", "1", "", "furlong")  # fmt: skip
SAME = {
    "m": ("km", "cm", "ft"), "s": ("min", "h", "day", "ms"), "kg": ("t", "g", "lb"), "N": ("kN", "MN", "lbf"),
    "m/s": ("km/s", "km/h"), "rad": ("deg", "rad"), "rad/s": ("deg/s", "rad/s"), "m^3/s^2": ("km^3/s^2", "m^3/s^2"),
    "m^2": ("cm^2", "km^2"), "m/s^2": ("g0", "m/s^2"), "W/m^2": ("kW/m^2", "MW/m^2"), "J/m^2": ("MJ/m^2", "kJ/m^2"),
}  # fmt: skip
RUBBISH: tuple[Any, ...] = (
    "", "nan", "inf", "-inf kg", "1e400 m", "1,5 km", "ten km", "1 km km", True, [], 3, -2.5, "1e308 km", "1 kg^200",
    "0x10 m", "1_000 m",
)  # fmt: skip


@dataclass
class Failure:
    """One scenario and what was wrong with its run."""

    number: int
    command: str
    why: str
    text: str
    said: str


@dataclass
class Result:
    """How one run ended."""

    code: int
    said: str
    seconds: float
    silence: float = 0.0
    trace: str = ""


@dataclass
class Timed(io.StringIO):
    """A stream that remembers its longest time without a line."""

    last: float = field(default_factory=time.monotonic)
    longest: float = 0.0

    def __post_init__(self) -> None:
        super().__init__()

    def write(self, text: str) -> int:
        """Write, and remember when."""
        self.heard()
        return super().write(text)

    def heard(self) -> None:
        """Remember that something was written."""
        now = time.monotonic()
        self.longest, self.last = max(self.longest, now - self.last), now


# -- scenarios --------------------------------------------------------------------------------------------------------


def bases() -> list[dict[str, Any]]:
    """Documents to change a little: the template of each kind, and the examples."""
    texts = [template(kind) for kind in KINDS]
    texts += [path.read_text(encoding="utf-8") for path in sorted(EXAMPLES.glob("**/*.toml"))]
    read = [tomllib.loads(text) for text in texts]
    return [document for document in read if kind_of(document) in KINDS]


def kind_of(document: Mapping[str, Any]) -> str:
    """Name of the kind that a document states."""
    problem = document.get("problem", {})
    return str(problem.get("kind", "hybrid_landing")) if isinstance(problem, dict) else ""


def number_near(rng: random.Random, declared: Quantity) -> float:
    """A number in the unit of a declaration: of a size that is stated, at a limit of its range, or anywhere."""
    ends = [end for end in (declared.low, declared.high) if math.isfinite(end)]
    draw = rng.random()
    if draw < 0.15:
        return 0.0
    if draw < 0.3 and ends:
        return rng.choice(ends) * rng.choice((1.0, 1.0 + 1e-12, 1.0 - 1e-12, 0.999, 1.001))
    if draw < 0.5 and len(ends) == 2:
        return rng.uniform(*ends)
    size = 10.0 ** (rng.uniform(-15.0, 15.0) if draw < 0.75 else rng.uniform(-4.0, 6.0))
    number = size if rng.random() < 0.75 else -size
    return min(max(number, declared.low), declared.high) if rng.random() < 0.7 else number


def value_of(rng: random.Random, key: Key, near: Any = None) -> Any:
    """A value that may be right, or is wrong in a way that people and programs make."""
    declared = key.declared
    draw = rng.random()
    if draw < 0.03:
        return rng.choice(RUBBISH)
    if not isinstance(declared, Quantity):
        return rng.choice((*declared.choices, declared.example)) if draw < 0.95 else rng.choice(RUBBISH)
    spoken = declared.spoken_unit
    stated = near if isinstance(near, str) else declared.example
    head, _, unit = str(stated).partition(" ")
    if draw < 0.5:
        try:
            number = float(head) * math.exp(rng.gauss(0.0, rng.choice((0.05, 0.5, 3.0)))) * rng.choice((*[1] * 9, -1))
            return f"{number!r} {unit}" if unit else number
        except ValueError:
            return stated
    if declared.unit == "1":
        return number_near(rng, declared)
    number = number_near(rng, declared)
    if draw < 0.65:
        return f"{number!r} {rng.choice(SAME.get(declared.unit, (declared.unit,)))}"
    if draw < 0.68:
        return f"{number!r} {rng.choice(UNITS)}"
    return f"{number!r} {declared.unit if rng.random() < 0.7 else spoken}"


def near(rng: random.Random, known: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """A document that is right but for one to four changes."""
    document = json.loads(json.dumps(rng.choice(known)))
    kind = KINDS[kind_of(document)]
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        if rng.random() < 0.12:
            turn(rng, document)
            continue
        name = rng.choice(list(kind.in_file))
        section = kind.in_file[name]
        table = document.get(name)
        if not isinstance(table, dict):
            document[name] = filled(rng, section)
            continue
        if table and rng.random() < 0.1:
            table.pop(rng.choice(list(table)))
            continue
        keys = names_of(name, section)
        stated = [key for key in table if key in keys]
        key = rng.choice(stated) if stated and rng.random() < 0.75 else rng.choice(list(keys))
        if key != "kind":
            table[key] = value_of(rng, keys[key], table.get(key))
    return document


def filled(rng: random.Random, section: Section) -> dict[str, Any]:
    """A section with most of what it needs and some of what it may have."""
    table = dict[str, Any]()
    for key, declared in section.keys.items():
        if rng.random() < (0.95 if declared.required else 0.4):
            table[key] = declared.declared.example if rng.random() < 0.7 else value_of(rng, declared)
            if isinstance(declared.declared, Quantity) and declared.declared.unit == "1" and table[key] is not True:
                table[key] = plain(table[key])
    if section.known and rng.random() < 0.7:
        return {"name": rng.choice(list(section.known))}
    return table


def plain(value: Any) -> Any:
    """A number where a text is one."""
    try:
        return float(value)
    except (TypeError, ValueError):
        return value


def far(rng: random.Random) -> dict[str, Any]:
    """A document of which every key is drawn."""
    kind: Kind = rng.choice(list(KINDS.values()))
    document = dict[str, Any]()
    for name, section in kind.in_file.items():
        if rng.random() < (0.97 if section.required else 0.5):
            document[name] = filled(rng, section)
    document.setdefault("problem", {})["kind"] = kind.name
    if rng.random() < 0.3:
        turn(rng, document)
    return document


def turn(rng: random.Random, document: dict[str, Any]) -> None:
    """Swap, lose, exchange or borrow a section, or two values of one."""
    names = list(document)
    how = rng.randrange(5)
    if how == 0 and len(names) > 1:
        one, other = rng.sample(names, 2)
        document[one], document[other] = document[other], document[one]
    elif how == 1 and names:
        document.pop(rng.choice(names))
    elif how == 2:
        kind = rng.choice(list(KINDS.values()))
        name = rng.choice(list(kind.in_file))
        document[name] = filled(rng, kind.in_file[name])
    elif how == 3:
        table = document.get(rng.choice(names)) if names else None
        if isinstance(table, dict) and len(table) > 1:
            one, other = rng.sample(list(table), 2)
            table[one], table[other] = table[other], table[one]
    elif names:
        document[rng.choice(names)] = rng.choice(([], 3, "text", {}, {"": "1 m"}))


def scenario(seed: int, number: int, known: Sequence[dict[str, Any]]) -> str:
    """Scenario `number` of a seed, as the text of a file."""
    rng = random.Random(f"{seed}.{number}")
    document = far(rng) if rng.random() < 0.3 else near(rng, known)
    lines = []
    for name, table in document.items():
        head = name if rng.random() < 0.99 else f"{name}.{name}"
        if isinstance(table, dict):
            lines += [f"[{head}]", *(f"{key or '_'} = {json.dumps(value)}" for key, value in table.items()), ""]
            if rng.random() < 0.005:
                lines += [f"[{head}]", ""]  # doubled, which TOML refuses
        else:
            lines.insert(0, f"{head} = {json.dumps(table)}")
    return "\n".join(lines) + "\n"


# -- runs -------------------------------------------------------------------------------------------------------------


def run_here(arguments: Sequence[str]) -> Result:
    """One command line in this process; what Python and foreign code write to stderr is read as well."""
    began, timed, trace = time.monotonic(), Timed(), ""
    before, kept = sys.stderr, os.dup(2)
    with tempfile.TemporaryFile() as foreign:
        os.dup2(foreign.fileno(), 2)
        sys.stderr = timed
        try:
            with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
                warnings.simplefilter("always")
                code = run_command_line(arguments)
        except Exception:
            code, trace = 1, traceback.format_exc()
        finally:
            timed.heard()
            sys.stderr = before
            os.dup2(kept, 2)
            os.close(kept)
        foreign.seek(0)
        beside = foreign.read().decode("utf-8", "replace")
    return Result(code, timed.getvalue() + beside, time.monotonic() - began, timed.longest, trace)


def run_apart(arguments: Sequence[str], longest: float) -> Result:
    """The same in a child of this process, which is ended after so many seconds."""
    reading, writing = os.pipe()
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        os.close(reading)
        found = run_here(arguments)
        with os.fdopen(writing, "w", encoding="utf-8") as opened:
            json.dump(vars(found), opened)
        os._exit(0)
    os.close(writing)
    signal.signal(signal.SIGALRM, lambda *_: os.kill(child, signal.SIGKILL))
    signal.setitimer(signal.ITIMER_REAL, longest)
    with os.fdopen(reading, encoding="utf-8") as opened:
        told = opened.read()
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    _, status = os.waitpid(child, 0)
    if told:
        return Result(**json.loads(told))
    return Result(-os.waitstatus_to_exitcode(status), "", time.monotonic() - began, trace=f"ended, status {status}")


def judged(command: str, found: Result) -> str:
    """Why a run is a failure; empty where it is none."""
    if found.trace or found.code not in CODES[command]:
        last = found.trace.strip().splitlines()[-1:] or found.said.strip().splitlines()[-1:]
        return f"exit {found.code}: {''.join(last)[:200]}"
    for word in SUSPECT:
        at = next((line for line in found.said.splitlines() if word in line), None)
        if at is not None:
            return f"on stderr: {at.strip()[:200]}"
    if found.silence > SILENCE:
        return f"silent for {found.silence:.0f} s"
    return ""


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--check", type=int, default=10000)
    parser.add_argument("--solve", type=int, default=1000)
    parser.add_argument("--limit", type=float, default=20.0, help="time limit of one solve, s")
    parser.add_argument("--first", type=int, default=0, help="number of the first scenario, to go on with a seed")
    parser.add_argument("--only", type=int, help="one scenario, printed with what it says")
    parser.add_argument("--minutes", type=float, default=math.inf, help="end after so long")
    parser.add_argument("--out", type=Path, help="folder for scenarios that failed")
    asked = parser.parse_args()
    if asked.only is not None:
        os.environ.setdefault("PERILUNE_TRACEBACK", "1")
    known, began = bases(), time.monotonic()
    failures, codes = list[Failure](), {command: Counter[int]() for command in CODES}
    slowest = dict.fromkeys(CODES, 0.0)
    numbers = range(asked.first, max(asked.check, asked.solve)) if asked.only is None else [asked.only]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scenario.toml"
        for number in numbers:
            text = scenario(asked.seed, number, known)
            file.write_text(text, encoding="utf-8")
            for command, count in (("check", asked.check), ("solve", asked.solve)):
                if number >= count and asked.only is None:
                    continue
                if command == "solve":
                    found = run_apart(["solve", str(file), "--time-limit", f"{asked.limit} s"], 2 * asked.limit + 10)
                else:
                    found = run_here(["check", str(file)])
                codes[command][found.code] += 1
                slowest[command] = max(slowest[command], found.seconds)
                if why := judged(command, found):
                    failures.append(Failure(number, command, why, text, found.said + found.trace))
                    print(f"{command} {number}: {why}", flush=True)
                    if asked.out is not None:
                        asked.out.mkdir(parents=True, exist_ok=True)
                        (asked.out / f"{asked.seed}_{number}.toml").write_text(text, encoding="utf-8")
                if asked.only is not None:
                    print(text, found.said, found.trace, sep="\n")
            if time.monotonic() - began > 60.0 * asked.minutes:
                print(f"ended: go on with --first {number + 1}")
                break
    for command, counted in codes.items():
        print(f"{command}: {counted.total()} scenarios, exit codes {dict(sorted(counted.items()))}, "
              f"slowest {slowest[command]:.1f} s")  # fmt: skip
    print(f"{len(failures)} failures of seed {asked.seed}")
    for why, count in Counter(f"{f.command}: {f.why}" for f in failures).most_common():
        print(f"  {count:5d}  {why}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
