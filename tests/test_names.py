"""One name for one thing: each function and class is defined in one file, and docstrings open with a verb or a noun."""

from __future__ import annotations

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

SOURCE = Path(__file__).parent.parent / "src"
# Two of the public faces have one each.
SHARED = {"Corridor": "perilune.models and perilune.views", "export": "perilune and perilune.atlas"}
OPENERS = re.compile(r"(What|Whether|How|Of|Which|Where|Those|That)\b")
MOST_FILES = 20  # of a folder


def modules() -> Iterator[tuple[Path, ast.Module]]:
    for path in sorted(SOURCE.rglob("*.py")):
        yield path, ast.parse(path.read_text(encoding="utf-8"))


def test_each_name_is_defined_in_one_file() -> None:
    """Leading underscores aside: who reads a call knows which function it is."""
    places = defaultdict(set)
    for path, tree in modules():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("__"):
                places[node.name.lstrip("_")].add(str(path.relative_to(SOURCE)))
    assert {name: files for name, files in places.items() if len(files) > 1 and name not in SHARED} == {}
    assert all(len(places[name]) == 2 for name in SHARED)


def test_docstrings_open_with_a_verb_or_a_noun() -> None:
    """Not with a relative clause."""
    found = [
        f"{path.relative_to(SOURCE)}: {text.partition(chr(10))[0]}"
        for path, tree in modules()
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef) and (text := ast.get_docstring(node))
        if OPENERS.match(text)
    ]
    assert found == []


def test_no_folder_is_a_heap() -> None:
    counts = Counter(path.parent for path in SOURCE.rglob("*.py") if path.name != "__init__.py")
    assert [str(folder) for folder, count in counts.items() if count > MOST_FILES] == []
