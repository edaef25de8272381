"""The documentation is run: its Python and console examples, its tables, its links.

In a page, ``python`` blocks run in order in one namespace, and ``console`` blocks line by line in a directory
that has the examples. What they print is compared with the ``output`` block that follows, or with the lines
below a ``$``; there ``...`` stands for anything.
"""

from __future__ import annotations

import contextlib
import doctest
import fnmatch
import importlib.util
import io
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from cho import cho_landing
from perilune.cli import run_command_line
from perilune.core import Outcome
from perilune.problem import Solution
from perilune.solve import solve
from perilune.verify import verify
from test_layers import ROOMS

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
MATCH = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def blocks(page: Path) -> list[tuple[str, str]]:
    """(language, text) of each fenced block; above Python as many blank lines as tracebacks must count."""
    text = page.read_text(encoding="utf-8")
    found = []
    for match in FENCE.finditer(text):
        above = text.count("\n", 0, match.start(2)) if match[1] == "python" else 0
        found.append((match[1], "\n" * above + match[2]))
    return found


def languages(page: Path) -> set[str]:
    """Which kinds of blocks a page has."""
    return {language for language, _ in blocks(page)}


def assert_shown(page: Path, shown: str, printed: str) -> None:
    """What a page shows is what was printed."""
    if not doctest.OutputChecker().check_output(shown, printed, MATCH):
        pytest.fail(f"{page.name} shows\n{shown}\nbut the program prints\n{printed}")


def commands(text: str) -> Iterator[tuple[str, str]]:
    """(command, what is shown below it) of a console block."""
    for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
        command, _, shown = part.partition("\n")
        yield command, shown


def run_python(page: Path) -> None:
    """Run a page's Python blocks in order in one namespace."""
    namespace: dict[str, object] = {}
    found = blocks(page)
    for (language, text), (after, shown) in zip(found, [*found[1:], ("", "")], strict=True):
        if language != "python":
            continue
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(text, str(page), "exec"), namespace)
        if after == "output":
            assert_shown(page, shown, printed.getvalue())


def said(arguments: list[str]) -> tuple[int, str]:
    """Exit code of a command, and what it prints. In this process: one of its own loads everything anew.

    For how long it is at work, which a page does not show, depends on the machine.
    """
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        code = run_command_line(arguments)
    return code, re.sub(r"^perilune: running for .*\n", "", printed.getvalue(), flags=re.MULTILINE)


def run_console(page: Path, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a page's console blocks; the exit code must be 0 unless ``$ echo $?`` below shows another."""
    consoles = [text for language, text in blocks(page) if language == "console"]
    if not any("$ perilune new examples\n" in text for text in consoles):
        shutil.copytree(ROOT / "examples", directory / "examples")
    monkeypatch.chdir(directory)
    monkeypatch.setenv("COLUMNS", "120")
    for text in consoles:
        pairs = list(commands(text))
        for (command, shown), (after, code) in zip(pairs, [*pairs[1:], ("", "")], strict=True):
            if command == "echo $?":
                continue
            program, *arguments = shlex.split(command)
            assert program == "perilune", f"{page.name}: only perilune is run here, not {program}"
            exit_code, printed = said(arguments)
            assert exit_code == (int(code) if after == "echo $?" else 0), f"{command}\n{printed}"
            assert_shown(page, shown, printed)


@pytest.mark.parametrize("page", [p for p in PAGES if "python" in languages(p)], ids=lambda p: p.stem)
def test_python_examples(page: Path) -> None:
    """Run, and print what the page shows."""
    run_python(page)


@pytest.mark.parametrize("page", [p for p in PAGES if "console" in languages(p)], ids=lambda p: p.stem)
def test_console_examples(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run, leave with the exit code shown, and print what the page shows."""
    run_console(page, tmp_path, monkeypatch)


def test_a_wrong_example_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tests above can fail: on an output, on an exit code, on an exception."""
    page = tmp_path / "page.md"
    page.write_text("```python\nprint(2 + 2)\n```\n\n```output\n5\n```\n", encoding="utf-8")
    with pytest.raises(pytest.fail.Exception, match="the program prints"):
        run_python(page)
    page.write_text("```console\n$ perilune check examples/nowhere.toml\n...\n```\n", encoding="utf-8")
    with pytest.raises(AssertionError, match="no scenario file"):
        run_console(page, tmp_path / "there", monkeypatch)
    page.write_text("```python\nimport perilune\nperilune.nothing\n```\n", encoding="utf-8")
    with pytest.raises(AttributeError):
        run_python(page)


def test_no_block_is_left_out() -> None:
    """Every block is of a kind that is known here, and what README has people run is run on another page."""
    known = {"python", "output", "console", "sh", ""}
    consoles = [text for page in PAGES for language, text in blocks(page) if language == "console"]
    shown = {command for text in consoles for command, _ in commands(text)}
    for page in PAGES:
        assert languages(page) <= known, page.name
        for language, text in blocks(page):
            for command in re.findall(r"\bperilune [a-z].*", text) if language == "sh" else []:
                assert command in shown, f"{page.name} shows {command!r}, which no page runs"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.stem)
def test_links(page: Path) -> None:
    """Relative links lead to files that are there, and to headings that are there."""
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", FENCE.sub("", text)):
        if target.startswith(("http://", "https://")):
            continue
        file, _, anchor = target.partition("#")
        there = (page.parent / file).resolve() if file else page
        assert there.exists(), f"{page.name} links to {target}"
        if anchor:
            headings = re.findall(r"^#+ (.*)$", there.read_text(encoding="utf-8"), re.MULTILINE)
            slugs = {re.sub(r"[^\w -]", "", h.lower()).replace(" ", "-") for h in headings}
            assert anchor in slugs, f"{page.name} links to {target}"


def rows(page: Path, columns: int) -> list[list[str]]:
    """Cells of all table rows with so many columns, backticks removed."""
    found = []
    for line in page.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.replace(r"\|", "¦").strip("|").split("|")]
        if line.startswith("|") and len(cells) == columns and not set(line) <= set("|- "):
            found.append(cells)
    return found


# Idioms of another language, or words of our own where the field has one; whole words, in any case.
BANNED = (
    "shorter than nothing", "most angle", "to and fro", "least share", "outdone", "beside it alone", "told apart",
    "from nothing", "begin anew", "begun anew", "flown again", "flown twice", "second flight of", "gone on with",
    "how far a fall", "rises again above", "look at its rights", "throw the ground", "takes hold of the control",
    "the faster the more", "is no list", "no tolerance but no proof", "says what no", "does not bear out",
    "ridden, and not touched", "one too many", "beside the turning",
)  # fmt: skip


def test_no_page_or_source_has_a_banned_phrase() -> None:
    """What users read is plain English; a phrase met in a review is added to the list."""
    banned = re.compile(rf"\b({'|'.join(BANNED)})\b", re.IGNORECASE)
    sources = [path for end in ("py", "js", "html") for path in sorted((ROOT / "src").rglob(f"*.{end}"))]
    found = [
        f"{path.relative_to(ROOT)}: {match[0]}"
        for path in [*PAGES, *sources]
        for match in banned.finditer(path.read_text(encoding="utf-8"))
    ]
    assert len(sources) > 300 and not found


def test_pages_import_from_faces_only() -> None:
    """Inner modules may move: a page that shows one teaches what will break."""
    imports = re.compile(r"^ *from perilune\.([\w.]+) import", re.MULTILINE)
    shown = {(page.name, room) for page in PAGES for room in imports.findall(page.read_text(encoding="utf-8"))}
    assert len(shown) > 5
    assert {one for one in shown if one[1] not in {"conditions", "models", "scenario"}} == set()


def test_layers() -> None:
    """The table of rooms names every room, from the ground up."""
    shown = [cells[0].strip("`") for cells in rows(DOCS / "architecture.md", 2)]
    assert [room for room in shown if room in ROOMS] == [room for room in ROOMS if not room.startswith("_")]


def test_exit_codes() -> None:
    """The table of exit codes agrees with the program."""
    shown = {
        name: int(code)
        for code, names, *_ in rows(DOCS / "my-solve-failed.md", 4)[1:]
        if code.isdigit()
        for name in re.findall(r"`([A-Z_]+)`", names)
    }
    assert shown == {outcome.name: outcome.exit_code for outcome in Outcome}


def test_messages() -> None:
    """The messages that are explained are those that the program has."""
    source = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "src" / "perilune").rglob("*.py"))
    explained = [re.findall("`([^`]+)`", cells[0]) for cells in rows(DOCS / "my-solve-failed.md", 3)]
    messages = [found[0] for found in explained if found and " " in found[0]]
    assert len(messages) > 10
    assert [message for message in messages if message not in source] == []


def test_checks(hybrid: Solution, ordinary: Solution) -> None:
    """Each check that is made is on the page, with its level and its limit."""
    shown = [
        (re.findall(r"`([^`]+)`", name)[0], int(level), float(limit.split()[0]), limit.endswith("g"))
        for name, level, limit, *_ in rows(DOCS / "verification.md", 5)[1:]
    ]
    met = set()
    for solution in (hybrid, ordinary):
        for check in verify(solution, 3).verification.checks:
            found = [row for row in shown if fnmatch.fnmatch(check.name, row[0]) and row[1] == check.level]
            assert found, f"{check.name} of level {check.level} is not on the page"
            pattern, _, limit, grows = found[0]
            limit *= solution.problem.scales.of(check.unit)
            if grows:  # errors of a landing grow little
                assert limit * (1 - 1e-9) <= check.limit < 30 * limit, check.name
            else:
                assert check.limit == pytest.approx(limit, rel=1e-9), check.name
            met.add(pattern)
    # A landing of constant thrust has no bounded control, so nothing that could switch, and holds nothing on the way.
    assert {pattern for pattern, *_ in shown} - met == {"switching_*", "held_*"}


def documentation_script(name: str) -> ModuleType:
    """A script of the documentation as a module."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def between(text: str, mark: str) -> list[str]:
    """Rows of the README's table behind a mark, without its two head lines."""
    table = text.partition(f"<!-- {mark} -->\n")[2].partition("<!-- end -->")[0]
    return table.splitlines()[2:]


def test_readme_tables(hybrid: Solution, ordinary: Solution) -> None:
    """What the README says is verified is what is computed."""
    script = documentation_script("readme_table")
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    low, high = (solve(cho_landing(isp), verify=0) for isp in script.BRACKET)
    assert between(text, "against the paper") == script.against_the_paper(hybrid, ordinary, (low, high))
    assert between(text, "not printed") == script.not_printed(hybrid, ordinary)


def test_images(hybrid: Solution, ordinary: Solution, tmp_path: Path) -> None:
    """The scripts draw every picture that the pages show; those of the gallery are not drawn here again."""
    gallery = documentation_script("make_gallery").NAMES
    drawn = {path.name for path in documentation_script("make_images").draw(hybrid, ordinary, tmp_path)}
    shown = {
        Path(target).name
        for page in PAGES
        for target in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    }
    assert shown == drawn | {f"{name}.png" for name in gallery} == {path.name for path in (DOCS / "images").iterdir()}
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in drawn)
