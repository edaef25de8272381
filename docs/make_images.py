"""Draw the pictures of the documentation: ``python docs/make_images.py`` writes them into ``docs/images``.

They show the landing of Cho, Kim, Leeghim 2015 as solved here, drawn by the program's own report.
"""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.problem import Solution

IMAGES = Path(__file__).parent / "images"


def draw(hybrid: Solution, ordinary: Solution, directory: Path) -> list[Path]:
    """Write every picture as PNG and return their paths."""
    from perilune.report.figures import save_figure, solution_figures

    made = solution_figures(hybrid, ordinary)
    names = {"path": "hybrid_landing", "thrust_angle": "thrust_angle"}
    for figure, name in names.items():
        save_figure(made[figure], directory, name)
        (directory / f"{name}.svg").unlink()
    return [*(directory / f"{name}.png" for name in names.values()), draw_engines(directory)]


def draw_engines(directory: Path) -> Path:
    """Draw the map of `docs/ten-thousand-landings.md` as its own blocks of Python do."""
    page = (Path(__file__).parent / "ten-thousand-landings.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    drawn = next(i for i, block in enumerate(blocks) if "savefig" in block)
    with contextlib.chdir(Path(__file__).parent.parent), contextlib.redirect_stdout(None):
        code = "\n".join(blocks[: drawn + 1]).replace('"engines.png"', repr(str(directory / "engines.png")))
        exec(compile(code, "ten-thousand-landings.md", "exec"), {})  # our own page
    return directory / "engines.png"


if __name__ == "__main__":
    from perilune.models import Retro
    from perilune.solve import solve
    from perilune_papers.cho2015.case import CONSTANTS, cho_landing

    IMAGES.mkdir(exist_ok=True)
    with_burn = cho_landing(Retro(specific_impulse=CONSTANTS.specific_impulse))
    for path in draw(solve(with_burn), solve(cho_landing()), IMAGES):
        print(path.name)
