"""What the tests of the explorer share: an atlas across the jump of the hybrid lander, and a page that is served."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from perilune.atlas import building
from perilune.scenario import load_file

ROOT = Path(__file__).parent.parent
CHROMIUM = next(
    (p for p in ("/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome") if os.path.exists(p)), ""
)
QUIET = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
).split()


def atlas_of_the_jump(directory: Path) -> Path:
    """Around 277.867 s of impulsive Isp, at which a retro burn begins to pay."""
    axes = {"retro.specific_impulse": (272.0, 284.0), "vehicle.thrust": (420.0, 460.0)}
    problem = load_file(ROOT / "examples" / "hybrid_lander.toml").problem
    building.build(problem, axes, directory, sample=0)
    return directory


@contextmanager
def served(*arguments: str) -> Iterator[str]:
    """The address of `perilune explore`, which is ended behind it as by Ctrl-C."""
    command = [sys.executable, "-m", "perilune", "explore", "--no-open", *arguments]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        assert process.stderr is not None
        said = ""
        while not (found := re.search(r"http://\S+", said)):
            line = process.stderr.readline()
            assert line, f"it ended: {said}"
            said += line
        try:
            yield found.group()
        finally:
            process.send_signal(2)
            code = process.wait(20)
    assert code == 0, f"it ended with {code}"


def until(page: Any, expression: str, seconds: float = 30.0) -> None:
    """Wait until an expression is true on a page."""
    end = time.monotonic() + seconds
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"never: {expression}"
        time.sleep(0.03)


class Left:
    """Which share of the machine others have left since this was made: all of it where it is quiet.

    What is said of so many frames a second is said of a machine that does nothing else. Where the system does not tell
    how busy it is, all was left.
    """

    def __init__(self) -> None:
        self._began, self._others = time.monotonic(), _others()

    @property
    def seconds(self) -> float:
        """By the clock."""
        return time.monotonic() - self._began

    @property
    def share(self) -> float:
        """From 0 to 1."""
        return 1.0 - (_others() - self._others) / (self.seconds * (os.cpu_count() or 1))


def _others() -> float:
    """What all cores did for other programs than this test and what it began, and for other machines [s]."""
    try:
        busy = [int(told) for told in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
        idle, waiting = busy[3:5]
        return (sum(busy) - idle - waiting - _own()) / os.sysconf("SC_CLK_TCK")
    except OSError:
        return 0.0


def _own() -> int:
    """What this process and all that it began have done [ticks]."""
    begun, took = dict[int, list[int]](), dict[int, int]()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            told, process = stat.read_text().rpartition(")")[2].split(), int(stat.parent.name)
            begun.setdefault(int(told[1]), []).append(process)
            took[process] = int(told[11]) + int(told[12])
    found = [os.getpid()]
    for process in found:
        found += begun.get(process, [])
    return sum(took[process] for process in found)
