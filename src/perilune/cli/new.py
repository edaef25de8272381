"""The command ``new``: the template of a kind, or the examples of the manual."""

from __future__ import annotations

import shutil
from argparse import Namespace
from pathlib import Path

from perilune import PeriluneError
from perilune.cli.output import CommandAnswer
from perilune.core import unknown_name

EXAMPLES = "examples"  # beside the kinds, as a word of `perilune new`


def new_answer(typed: Namespace) -> CommandAnswer:
    """Write a template or the examples; replace nothing unless forced."""
    from perilune.scenario import KINDS, kind_names, template

    kind, file = typed.kind, typed.place
    if kind == EXAMPLES:
        return _examples(file or Path(EXAMPLES), typed.force)
    if kind is not None and kind not in KINDS and file is None and kind not in (known := kind_names()):
        if Path(kind).name == kind and not Path(kind).suffix:  # else it is `perilune new FILE`
            raise unknown_name("kind", kind, [*known, EXAMPLES])
        kind, file = None, Path(kind)
    text = template(kind or "hybrid_landing")
    if file is None:
        return CommandAnswer(text=text, document={"template": text})
    try:
        with file.open("w" if typed.force else "x", encoding="utf-8") as opened:
            opened.write(text)
    except FileExistsError:
        raise _existing_path_error(file) from None
    return CommandAnswer(text=f"written to {file}\nsolve it: perilune solve {file}", document={"written": str(file)})


def _examples(directory: Path, force: bool) -> CommandAnswer:
    """Copy all examples, which lie inside an installed package, or in a folder of the source archive."""
    here = Path(__file__).parents[1]
    source = next(place for place in (here / EXAMPLES, here.parents[1] / EXAMPLES) if place.is_dir())
    if not force and directory.exists():
        raise _existing_path_error(directory)
    shutil.copytree(source, directory, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"), dirs_exist_ok=force)
    files = sorted(path.relative_to(directory).as_posix() for path in directory.rglob("*") if path.is_file())
    text = f"written to {directory}: {', '.join(files)}"
    return CommandAnswer(text=text, document={"written": str(directory), "files": files})


def _existing_path_error(place: Path) -> PeriluneError:
    what = "directory" if place.is_dir() else "file"
    return PeriluneError(f"the {what} already exists", got=str(place), advice="choose another name, or pass --force")
