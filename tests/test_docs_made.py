"""Pages that scripts wrote are still what the scripts would write, as far as that is told in seconds."""

from __future__ import annotations

import re
import tomllib
from inspect import isclass, ismodule

import pytest

import perilune as pl
from test_docs import DOCS, ROOT, documentation_script, rows

VALIDATION, GALLERY = (documentation_script(f"make_{name}") for name in ("validation", "gallery"))
QUICK = ("linear tangent steering", "Meditch's lander", "two burns with a mass drop")


def shown() -> list[dict[str, str]]:
    """Rows of the page of answered problems, by column."""
    head, *body = rows(DOCS / "validation.md", len(VALIDATION.COLUMNS))
    assert tuple(head) == VALIDATION.COLUMNS
    return [dict(zip(head, cells, strict=True)) for cells in body]


def test_the_page_of_answered_problems_has_a_row_for_each() -> None:
    """With its method, its reference and its source; the head and the count are those of the script."""
    stated = [VALIDATION.known(*claim) for claim in VALIDATION.claims()]
    assert [{name: row[name] for name in stated[0]} for row in shown()] == stated
    text = (DOCS / "validation.md").read_text(encoding="utf-8")
    bare = [{name: cell.replace("`", "") for name, cell in row.items()} for row in shown()]
    assert text.startswith(f"{VALIDATION.HEAD}\n{VALIDATION.summary(bare)}\n") and text.endswith(VALIDATION.sources())


def test_the_page_of_all_modules_is_up_to_date() -> None:
    page = documentation_script("make_modules").modules_page()
    assert (DOCS / "modules.md").read_text(encoding="utf-8") == page, "python docs/make_modules.py"


@pytest.mark.parametrize("name", QUICK)
def test_its_rows_are_computed_again(name: str) -> None:
    """To ten digits, and to the same level."""
    found = {row["method"]: row for row in shown() if row["problem"] == name}
    for answered, method in VALIDATION.claims():
        if answered.name == name:
            again, row = VALIDATION.solved(answered, method), found.pop(type(method).__name__)
            assert float(again["ours"]) == pytest.approx(float(row["ours"]), rel=1e-10)
            assert again["level"] == row["level"]
            assert again.get("failed", "") in (DOCS / "validation.md").read_text(encoding="utf-8")
    assert not found


def test_no_bad_row_is_hidden() -> None:
    """A row is bold where its error is more than what is asked, and where it is not proved to level 3."""
    for (answered, method), row in zip(VALIDATION.claims(), shown(), strict=True):
        missed = abs(float(row["ours"]) - answered.objective) > answered.error_allowed(method)
        assert missed == ("**" in row["error"]) and (row["level"] == "3") == ("**" not in row["level"])


def test_theorems_have_25_digits_and_are_computed_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of every row that is one, J and what is free; some anew. The checker has confirmed each."""
    pytest.importorskip("flint")
    benchmark, number = documentation_script("../benchmarks/rigorous"), re.compile(r"\w+ = \[(\S+) \+/- (\S+)\].*")
    monkeypatch.setattr(benchmark, "confirmed", lambda _: "")  # other tests do
    head, *body = rows(DOCS / "validation.md", 5)
    found = {name: (theorem, values) for name, theorem, values, *_ in body if not theorem.startswith("none")}
    assert head == ["problem", "theorem", "J and what is free", "CPU s", "confirmed, CPU s"] and len(found) >= 20
    assert all(float(seen) >= 0 for name, *_, seen in body if name in found)

    def digits(values: str) -> list[str]:
        told = list[str]()
        for value in values.split("; "):
            centre, radius = number.sub(r"\1 \2", value).split()
            assert float(radius) <= 1e-25 * abs(float(centre))
            told.append(re.sub(r"\D", "", centre).lstrip("0")[:25])
        return told

    assert all(len(told) == 25 for _, values in found.values() for told in digits(values))
    for name in QUICK:
        for row in benchmark.rows([name]):
            theorem, values = found[row["problem"]]
            assert (row["theorem"], digits(row["values"])) == (theorem, digits(values))


def test_the_gallery_shows_what_its_script_draws() -> None:
    assert (DOCS / "gallery.md").read_text(encoding="utf-8") == GALLERY.page()
    assert {name for _, name, _ in GALLERY.pictures()} == set(GALLERY.NAMES)


def test_on_the_page_of_a_registry_no_link_leads_nowhere() -> None:
    """What the build makes of README: words and names of files in place of links and pictures of its own tree."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    build = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["metadata"]["hooks"]
    for rule in build["fancy-pypi-readme"]["substitutions"]:
        text = re.sub(rule["pattern"], rule["replacement"], text)
    assert re.findall(r"\]\((?!https?:)", text) == [] and "![" not in text
    assert "the first landing (`docs/first-landing.md`)" in text and "pip install ." in text


def test_one_version_and_one_date_are_told_everywhere() -> None:
    citation, changes = ((ROOT / name).read_text(encoding="utf-8") for name in ("CITATION.cff", "CHANGELOG.md"))
    (date,) = re.findall(r"^date-released: (\S+)$", citation, re.MULTILINE)
    assert f"\nversion: {pl.__version__}\n" in citation and f"\n## [{pl.__version__}] - {date}\n" in changes


def test_every_public_name_is_in_the_reference() -> None:
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    assert [name for name in pl.__all__ if f"::: perilune.{name}\n" not in text + "\n"] == []


def test_no_public_class_stands_twice_in_the_reference() -> None:
    """Links to one that does cannot be told apart, and now and then a strict build fails of that."""
    known = [getattr(pl, name) for name in pl.__all__]
    for block in (DOCS / "api.md").read_text(encoding="utf-8").split("::: perilune.")[1:]:
        name, _, options = block.partition("\n")
        if ismodule(module := getattr(pl, name)):
            members = {name: getattr(module, name) for name in module.__all__}
            twice = [n for n, one in members.items() if isclass(one) and any(one is other for other in known)]
            assert [n for n in twice if f'"!^{n}$"' not in options] == []
