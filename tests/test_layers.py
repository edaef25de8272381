"""A file imports only from its own layer or one above it; checked on the syntax tree, so lazy imports count too."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent.parent / "src" / "perilune"

LAYERS = {
    "words": {"outcome", "units", "types", "maths"},
    "records": {"problem", "verification", "solution"},
    "mathematics": {
        "symbolic", "pontryagin", "kernels", "propagate", "collocation", "mesh", "nlp", "rootfind", "shooting",
        "lanes",
        "control_law", "continuation", "extremals", "genetic", "first_guess",
        "contradictions", "segments",
    },
    "methods": {"methods"},
    "use": {"verify", "solve", "sweep"},
    "subject": {"models"},
    "outside": {"scenario", "report", "cli", "__main__", "__init__"},
}  # fmt: skip
RANK = {module: rank for rank, modules in enumerate(LAYERS.values()) for module in modules}
# `solve` hands its answer to `verify`, which re-solves neighbours: the two verbs of one layer know each other.
FILES = sorted(SOURCE.rglob("*.py"))


def top_module(path: Path) -> str:
    """Name of the module or package directly below perilune."""
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imported(path: Path) -> set[str]:
    """Modules below perilune that a file imports anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("perilune.")}
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "perilune":
            parts = node.module.split(".")
            found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(SOURCE)))
def test_imports_go_one_way(path: Path) -> None:
    """No import from a layer below."""
    module = top_module(path)
    assert module in RANK, f"{module} has no layer: name it in LAYERS and in docs/architecture.md"
    wrong = {name for name in imported(path) if RANK.get(name, -1) > RANK[module]}
    assert not wrong, f"{path.name} ({module}) imports from below its layer: {sorted(wrong)}"


def test_the_check_sees_a_wrong_import(tmp_path: Path) -> None:
    """The check itself can fail."""
    file = tmp_path / "problem.py"
    file.write_text("def f():\n    from perilune.cli import main\n")
    assert imported(file) == {"cli"}
    assert RANK["cli"] > RANK["problem"]


def test_mathematics_knows_no_rockets() -> None:
    """Words of the subject do not appear in the code of the layers above it."""
    for path in FILES:
        if RANK[top_module(path)] <= RANK["methods"]:
            names = {n.id for n in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(n, ast.Name)}
            assert not names & {"thrust", "specific_impulse", "perilune_altitude", "landed_mass"}, path
