"""Draw the gallery, ``docs/gallery.md`` and its pictures: ``python docs/make_gallery.py``; one needs a browser.

Each picture stands with the command that makes it; the pictures are those that the command writes.
``tests/test_docs_made.py`` compares the page with what would be written here, and draws nothing.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
IMAGES, PAGE = ROOT / "docs" / "images", ROOT / "docs" / "gallery.md"
SOLVED = (  # scenario, figure of it, caption
    ("precision_landing", "track", "A landing on a site at 85 deg south, thrust tilted by no more than 50 deg"),
    ("mars_pinpoint", "track", "Down to a place on Mars above a glide slope, which the flight touches once"),
    (
        "polar_descent",
        "track",
        "A powered descent in three dimensions, from the Moon's pole to a site 14 deg away",
    ),
    ("minimum_duration_return", "ground_track", "From orbit to the ground in the least time"),
    ("minimum_duration_return", "corridor", "The same entry in height and speed, with lines of equal load"),
)
ATLAS = (
    "examples/hybrid_lander.toml",
    "--vary",
    "retro.specific_impulse=270:310 s",
    "--vary",
    "vehicle.thrust=350:650 N",
)
NAMES = (*(f"{scenario}_{figure}" for scenario, figure, _ in SOLVED), "atlas_cost", "explorer")
HEAD = """# Gallery

Each picture, and the command that makes it; `perilune new examples` writes the scenarios.
`python docs/make_gallery.py` wrote this page and drew them all.
"""


def pictures() -> Iterator[tuple[str, str, str]]:
    """Caption, name and command of each picture."""
    known = set[str]()
    for scenario, figure, caption in SOLVED:
        if scenario in known:
            yield caption, f"{scenario}_{figure}", f"# of the same command: {scenario}/figures/{figure}.png"
            continue
        known.add(scenario)
        command = f"perilune solve examples/{scenario}.toml --out {scenario}   # {scenario}/figures/{figure}.png"
        yield caption, f"{scenario}_{figure}", command
    built = " ".join(f'"{part}"' if " " in part else part for part in ATLAS)
    built = f"perilune atlas build {built} --out map\nperilune atlas plot map --out maps   # maps/objective.png"
    yield "An atlas: landed mass over thrust and impulsive Isp", "atlas_cost", built
    yield "The explorer on that atlas", "explorer", "perilune explore map"


def page() -> str:
    """The page, whose pictures are drawn by `draw`."""
    parts = [HEAD]
    for caption, name, command in pictures():
        parts.append(f"## {caption}\n\n```\n{command}\n```\n\n![{caption}](images/{name}.png)\n")
    return "\n".join(parts)


def perilune(*arguments: str) -> None:
    """Run a command."""
    subprocess.run([sys.executable, "-m", "perilune", *arguments], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)


def draw(work: Path) -> None:
    """Run the commands and keep their pictures."""
    for scenario in dict.fromkeys(scenario for scenario, *_ in SOLVED):
        perilune("solve", f"examples/{scenario}.toml", "--out", str(work / scenario))
    for scenario, figure, _ in SOLVED:
        small(work / scenario / "figures" / f"{figure}.png", IMAGES / f"{scenario}_{figure}.png")
    perilune("atlas", "build", *ATLAS, "--out", str(work / "map"))
    perilune("atlas", "plot", str(work / "map"), "--out", str(work / "maps"))
    small(work / "maps" / "objective.png", IMAGES / "atlas_cost.png")
    screenshot(work / "map", IMAGES / "explorer.png")


def small(source: Path, target: Path) -> None:
    """A picture with few colours, as a repository keeps it for ever."""
    from PIL import Image

    picture = Image.open(source).convert("RGB")
    picture.thumbnail((1000, 1000))
    # Median cut, which is the rule, gives a thin line of one colour to its grey neighbours.
    picture.quantize(256, method=Image.Quantize.MAXCOVERAGE).save(target, optimize=True)


def screenshot(atlas: Path, target: Path) -> None:
    """The page on an atlas, when it is proved."""
    sys.path.insert(0, str(ROOT / "tests"))
    from playwright.sync_api import sync_playwright

    from explored import CHROMIUM, QUIET, served, until

    with sync_playwright() as started, served(str(atlas)) as address:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        page = browser.new_page(viewport={"width": 1280, "height": 860})
        page.goto(address)
        until(page, "perilune.frames > 0 && !!perilune.flight.proved", 60.0)
        page.wait_for_timeout(300)
        page.screenshot(path=str(target))
        browser.close()
    small(target, target)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        draw(Path(place))
    PAGE.write_text(page(), encoding="utf-8")
