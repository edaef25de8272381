"""Frames a second that the explorer's page shows while a slider is dragged: over an atlas, and with none.

``python benchmarks/explorer.py [--times 7]``, on a machine that does nothing else: browser and server share it. The
goal is 20 frames a second. The hand at the slider is a timer of the page: a mouse that is moved through the browser's
protocol waits for the page at every step, and on a slow machine comes to 16 to 22 steps a second, and no more frames.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
SLIDER, SECONDS = "#knob-retro_specific_impulse", 2.0
HAND = """([place, begin, end, seconds]) => new Promise((done) => {
  const slider = document.querySelector(place), low = +slider.min, wide = +slider.max - low;
  const first = perilune.frames, from = performance.now();
  const timer = setInterval(() => {
    const gone = (performance.now() - from) / 1000 / seconds;
    if (gone >= 1) { clearInterval(timer); done((perilune.frames - first) / seconds); return; }
    slider.value = low + (begin + (end - begin) * gone) * wide; slider.dispatchEvent(new Event("input"));
  }, 8);
})"""  # frames a second while a slider goes from one share of its range to another


def main() -> None:
    """Drag across the jump of the hybrid lander, to and fro, and print what was shown each time."""
    from explored import CHROMIUM, QUIET, atlas_of_the_jump, served, until

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=7)
    times = parser.parse_args().times

    def measured(page: Any, *arguments: str) -> str:
        with served(*arguments) as address:
            page.goto(address)
            until(page, "perilune.frames > 0")
            rates = list[float]()
            for turn in range(times):
                begin, end = ((0.95, 0.05), (0.05, 0.95))[turn % 2]
                rates.append(page.evaluate(HAND, [SLIDER, begin, end, SECONDS]))
            said = ", ".join(f"{rate:.0f}" for rate in rates)
            return f"{said}; in the middle {sorted(rates)[times // 2]:.0f} frames/s"

    with sync_playwright() as started, tempfile.TemporaryDirectory() as folder:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        print("over an atlas:", measured(page, str(atlas_of_the_jump(Path(folder) / "map"))), flush=True)
        print("without one:  ", measured(page), flush=True)
        browser.close()


if __name__ == "__main__":
    main()
