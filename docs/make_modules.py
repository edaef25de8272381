"""Write the page of all modules from the first lines of their docstrings: ``python docs/make_modules.py``."""

from __future__ import annotations

import ast
from pathlib import Path

PAGE = Path(__file__).parent / "modules.md"
SOURCE = PAGE.parent.parent / "src"
HEAD = """# Modules

Every file of the source by folder, with the first line of its docstring. Written by
`docs/make_modules.py`; the order of the rooms and what may import what is on
[the page of the architecture](architecture.md).
"""
OLD = "Old place of"


def first_line(path: Path) -> str:
    """Return the first line of a module's docstring."""
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n")[0]


def modules_page() -> str:
    """Return the page as Markdown, a table for each folder."""
    parts = [HEAD]
    for folder in sorted({path.parent for path in SOURCE.rglob("*.py")}):
        about = first_line(folder / "__init__.py")
        if about.startswith(OLD):
            continue
        parts.append(f"\n## `{folder.relative_to(SOURCE).as_posix()}`\n\n{about}\n")
        files = [path for path in sorted(folder.glob("*.py")) if path.name != "__init__.py"]
        files = [path for path in files if not first_line(path).startswith(OLD)]
        if files:
            rows = (f"| `{path.name}` | {first_line(path).replace('|', chr(92) + '|')} |\n" for path in files)
            parts.append("\n| file | what it is for |\n|---|---|\n" + "".join(rows))
    old = [path for path in sorted(SOURCE.rglob("*.py")) if first_line(path).startswith(OLD)]
    lines = (f"- `{path.relative_to(SOURCE).as_posix()}`: {first_line(path)}\n" for path in old)
    return "".join([*parts, "\n## Old places, which go with the next minor version\n\n", *lines])


if __name__ == "__main__":
    PAGE.write_text(modules_page(), encoding="utf-8")
    print(PAGE.name)
