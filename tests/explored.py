"""What the tests of the explorer share: an atlas across the jump of the hybrid lander, and a page that is served."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from perilune.atlas.building import build as building
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
def served(*arguments: str, end: int = signal.SIGINT) -> Iterator[str]:
    """The address of `perilune explore`, which is ended behind it as by Ctrl-C, or by another signal."""
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
            process.send_signal(end)
            code, more = process.wait(20), process.stderr.read()
    assert code == 0, f"it ended with {code}"
    assert more.splitlines()[1:] == [], f"more than that Ctrl-C ends it: {more}"


def until(page: Any, expression: str, seconds: float = 30.0) -> None:
    """Wait until an expression is true on a page."""
    end = time.monotonic() + seconds
    while not page.evaluate(expression):
        assert time.monotonic() < end, f"never: {expression}"
        time.sleep(0.03)


def drag(page: Any, slider: str, begin: float, end: float, seconds: float) -> int:
    """Drag a slider between two shares of its range; how many frames the page showed meanwhile."""
    box = page.locator(slider).bounding_box()
    x, y, first, began = box["x"] + 8, box["y"] + box["height"] / 2, page.evaluate("perilune.frames"), time.monotonic()
    width = box["width"] - 16
    page.mouse.move(x + begin * width, y)
    page.mouse.down()
    while (gone := time.monotonic() - began) < seconds:
        page.mouse.move(x + (begin + (end - begin) * gone / seconds) * width, y)
        time.sleep(0.008)  # as a mouse tells its place
    page.mouse.move(x + end * width, y)
    page.mouse.up()
    return int(page.evaluate("perilune.frames") - first)
