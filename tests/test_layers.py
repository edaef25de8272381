"""Imports go one way, from room to room and from file to file; read off the syntax trees, so lazy imports count too."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Mapping, Set
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent.parent / "src"
# From the ground up: a room imports only from rooms before it. `docs/architecture.md` says what lives in each.
ROOMS = (
    "perilune_checker",
    "core",
    "words",
    "problem",
    "kernels",
    "conditions",
    "shooting",
    "structures",
    "direct",
    "methods",
    "charts",
    "proof",
    "rigorous",
    "verify",
    "solve",
    "models",
    "scenario",
    "io",
    "families",
    "atlas",
    "report",
    "perilune_papers",
    "app",
    "cli",
    "__main__",
)
FACE = "__init__"  # of the package: it names what is handed on, lazily
# Folders are entered by their face only: by what `room/__init__.py` offers, and so many names at most that are not
# for users too.
FACED = tuple(room for room in ROOMS if (SOURCE / "perilune" / room / "__init__.py").exists() and room != "words")
MOST_NAMES = {
    "core": 96,
    "problem": 120,
    "structures": 25,
    "charts": 24,
    "models": 27,
    "io": 56,
    "atlas": 18,
    "report": 22,
}
FILES = sorted(SOURCE.rglob("*.py"))
MATHEMATICS = ROOMS[: ROOMS.index("models")]


def module_of(path: Path) -> str:
    """Return the dotted name of a module, without `perilune.`; a package's own file has the package's name."""
    dotted = ".".join(path.relative_to(SOURCE).with_suffix("").parts)
    return dotted.removeprefix("perilune.").removesuffix(".__init__")


def is_ours(dotted: str) -> bool:
    return dotted.partition(".")[0] in ("perilune", "perilune_checker", "perilune_papers")


def room_of(module: str) -> str:
    return module.partition(".")[0]


@cache
def modules() -> frozenset[str]:
    return frozenset(module_of(path) for path in FILES)


@cache
def imported_and_named(path: Path) -> tuple[frozenset[str], frozenset[str]]:
    """Modules below perilune that a file imports anywhere in it, and all names that it uses.

    Of a package, the submodule where one is named.
    """
    found, names = set(), set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Name):
            names.add(node.id)
        elif isinstance(node, ast.Import):
            found |= {a.name.removeprefix("perilune.") for a in node.names if is_ours(a.name)}
        elif isinstance(node, ast.ImportFrom) and node.module and is_ours(node.module):
            base = f"{node.module}.".removeprefix("perilune.").removesuffix(".")
            for alias in node.names:
                inner = f"{base}.{alias.name}".removeprefix(".")
                found.add(inner if inner in modules() else base or FACE)
    return frozenset(found), frozenset(names)


def imported(path: Path) -> frozenset[str]:
    return imported_and_named(path)[0]


@pytest.mark.parametrize("path", FILES, ids=module_of)
def test_rooms_are_built_upwards(path: Path) -> None:
    """No import from a room above."""
    room = room_of(module_of(path))
    if room == FACE:
        return
    assert room in ROOMS, f"{room} has no place: name it in ROOMS and in docs/architecture.md"
    above = {m for m in imported(path) if room_of(m) in ROOMS[ROOMS.index(room) + 1 :]}
    assert not above, f"{module_of(path)} imports from above: {sorted(above)}"


@cache
def named_imports(path: Path) -> frozenset[tuple[str, str]]:
    """Return (module, name) of what a file takes by name of modules below perilune, anywhere in it."""
    tree = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    froms = (node for node in tree if isinstance(node, ast.ImportFrom) and node.module and is_ours(node.module))
    return frozenset(
        (node.module.removeprefix("perilune."), a.name) for node in froms if node.module for a in node.names
    )


@pytest.mark.parametrize("room", FACED)
def test_a_room_with_a_face_is_entered_by_it(room: str) -> None:
    """Its own files import one another; all others only what it offers, and that is little."""
    face, taken = importlib.import_module(f"perilune.{room}"), set[str]()
    for path in FILES:
        if room_of(module_of(path)) not in (room, FACE):
            inner = {m for m in imported(path) if m.startswith(f"{room}.")}
            assert not inner, f"{module_of(path)} imports {sorted(inner)}"
            taken |= {name for module, name in named_imports(path) if module == room}
    inside = taken - set(getattr(face, "__all__", ()))  # what users are offered may be as much as they need
    assert taken and len(inside) <= MOST_NAMES.get(room, 15), sorted(inside)
    assert all(getattr(face, name) is not None for name in taken)


def circle(graph: Mapping[str, Set[str]]) -> list[str]:
    """The files of a circle of imports, or none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_no_files_import_each_other_in_a_circle() -> None:
    graph = {module_of(path): imported(path) - {module_of(path)} for path in FILES if module_of(path) != FACE}
    assert not circle(graph)


def test_the_checks_see_what_is_wrong(tmp_path: Path) -> None:
    file = tmp_path / "problem.py"
    file.write_text("def f():\n    from perilune.cli.commands import obey\n    import perilune.core.units\n")
    assert imported(file) == {"cli.commands", "core.units"}
    assert circle({"a": {"b"}, "b": {"c"}, "c": {"a"}})
    assert not circle({"a": {"b"}, "b": {"c"}, "c": set()})


def test_the_checker_of_certificates_stands_alone() -> None:
    """Its confirmation is worth something only if nothing of the prover takes part in it."""
    checker = [path for path in FILES if room_of(module_of(path)) == "perilune_checker"]
    assert checker
    for path in checker:
        assert {room_of(module) for module in imported(path)} <= {"perilune_checker"}, path


def test_mathematics_knows_no_rockets() -> None:
    """Words of the subject do not appear in the code of the rooms below it."""
    for path in FILES:
        if room_of(module_of(path)) in MATHEMATICS:
            names = imported_and_named(path)[1]
            assert not names & {"thrust", "specific_impulse", "perilune_altitude", "landed_mass"}, path
