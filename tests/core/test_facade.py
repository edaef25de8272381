"""Faces of rooms: names are offered once, imported on first use, and cost nothing before."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path

import pytest

from perilune.core.facade import face_imports

SOURCE = Path(__file__).parents[2] / "src"
FACE = """
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune_face.shapes import Square, area as surface
    from perilune_face import tools
else:
    from perilune.core import lazy_face

    __getattr__, __dir__ = lazy_face(__name__)
"""


def test_a_face_imports_what_it_offers_on_first_use(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "perilune_face"
    package.mkdir()
    (package / "__init__.py").write_text(FACE)
    (package / "shapes.py").write_text("class Square: ...\ndef area(): return 4\n")
    (package / "tools.py").write_text("HAMMER = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    face = importlib.import_module("perilune_face")
    assert dir(face) == ["Square", "surface", "tools"]
    assert not {"perilune_face.shapes", "perilune_face.tools"} & {*sys.modules}
    assert face.surface() == 4 and "perilune_face.tools" not in sys.modules
    assert face.tools.HAMMER == 1
    with pytest.raises(AttributeError, match="'perilune_face' has no attribute 'area'"):
        _ = face.area
    with pytest.raises(ImportError, match="cannot import name 'Circle'"):
        exec("from perilune_face import Circle")


@pytest.mark.parametrize("room", sorted(p.parent.name for p in SOURCE.glob("perilune/*/__init__.py")))
def test_all_that_a_face_offers_is_there(room: str) -> None:
    face = importlib.import_module(f"perilune.{room}")
    if "lazy_face" in Path(str(face.__file__)).read_text(encoding="utf-8"):
        assert face_imports(face.__name__)
        assert all(getattr(face, name) is not None for name in face_imports(face.__name__))


def test_a_landing_loads_only_the_rooms_that_it_needs() -> None:
    """Faces load nothing beside what is taken."""
    job = (
        "import json, sys; import perilune as pl; from perilune.scenario import load_file;"
        "pl.solve(load_file('examples/hybrid_lander.toml').problem, verify=0);"
        "print(json.dumps(sorted({m.split('.')[1] for m in sys.modules if m.startswith('perilune.')})))"
    )
    run = subprocess.run([sys.executable, "-c", job], cwd=SOURCE.parent, capture_output=True, text=True, check=True)
    loaded = set(json.loads(run.stdout))
    assert {"methods", "shooting", "models"} <= loaded
    assert not loaded & {"atlas", "charts", "families", "report", "app", "cli", "rigorous", "proof"}, loaded
