"""A kind of problem that another package brings, as an entry point: examples/own_kind."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import perilune as pl
from carried import Carried
from perilune.cli import run_command_line
from perilune.core import PeriluneError
from perilune.io.model_records import model_document, read_model
from perilune.models.catalogue import KINDS
from perilune.scenario import load_file

ROOT = Path(__file__).parents[2]
PLACE = ROOT / "examples" / "own_kind"


def installed(place: Path, value: str) -> dict[str, str]:
    """The environment of a process in which a package is installed that says it brings the kind."""
    described = place / "lunar_hopper-1.0.dist-info"
    described.mkdir()
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: lunar-hopper\nVersion: 1.0\n", encoding="utf-8")
    (described / "entry_points.txt").write_text(f"[perilune.models]\nlunar_hop = {value}\n", encoding="utf-8")
    paths = [str(place), str(PLACE), *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def said(environment: dict[str, str], *arguments: str) -> tuple[int, str]:
    command = [sys.executable, "-m", "perilune", *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    return done.returncode, done.stdout + done.stderr


@pytest.fixture
def at_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The package is installed for this process."""
    installed(tmp_path, "lunar_hopper:LUNAR_HOP")
    for place in (tmp_path, PLACE):
        monkeypatch.syspath_prepend(place)
    yield
    KINDS.pop("lunar_hop", None)


def test_a_file_may_state_a_kind_that_a_package_brings(tmp_path: Path) -> None:
    """Solved, proved, saved, and verified from its files, by processes that know of it by its installation alone."""
    environment, out = installed(tmp_path, "lunar_hopper:LUNAR_HOP"), str(tmp_path / "out")
    code, text = said(environment, "solve", str(PLACE / "hop.toml"), "--out", out)
    assert code == 0 and "PROVED" in text and "956.8" in text
    assert said(environment, "verify", out)[0] == 0
    assert "lunar_hop" not in KINDS
    saved = pl.load(out)  # where it is not installed: the expressions beside it are the problem
    assert pl.verify(saved).verification.level == 3 and saved.problem.name == "lunar_hop"
    document = json.loads((Path(out) / "solution.json").read_text(encoding="utf-8"))
    assert document["scenario"]


@pytest.mark.usefixtures("at_hand")
def test_it_is_carried_the_whole_way(tmp_path: Path) -> None:
    """As all kinds of our own are: told, saved, exported, drawn, explored."""
    carried = Carried(tmp_path / "hop", (PLACE / "hop.toml").read_text(encoding="utf-8"))
    carried.check()
    solution = carried.solved()
    carried.told(solution)
    carried.proved(carried.saved(solution))
    for step in (carried.exported, carried.drawn, carried.explored, carried.paired):
        step(solution)


@pytest.mark.usefixtures("at_hand")
def test_its_keys_are_varied_and_refused_like_all_others(capsys: pytest.CaptureFixture[str]) -> None:
    hop = str(PLACE / "hop.toml")
    assert run_command_line(["new", "lunar_hop"]) == 0
    text = "".join(capsys.readouterr())
    assert 'kind = "lunar_hop"' in text and 'distance = "2 km"' in text and '--set "hopper.' in text
    assert run_command_line(["check", hop, "--set", "hopper.thrus=1 N"]) == 2
    assert "thrust" in "".join(capsys.readouterr())
    assert run_command_line(["check", hop, "--set", "hopper.mass=-1 kg"]) == 2
    assert "must be positive" in "".join(capsys.readouterr())
    problem = load_file(PLACE / "hop.toml").problem
    assert "hopper_mass 1010 kg" in problem.with_given(hopper_mass=1010).heading
    with pytest.raises(PeriluneError, match=r"hopper\.mass must be positive"):
        problem.with_given(hopper_mass=-1)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("lunar_hopper:nothing", "cannot be loaded"),
        ("no_such_module:LUNAR_HOP", "cannot be loaded"),
        ("lunar_hopper:Hop", "is not a kind of problem"),
    ],
)
def test_what_is_no_kind_is_refused_in_words(
    value: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    installed(tmp_path, value)
    for place in (tmp_path, PLACE):
        monkeypatch.syspath_prepend(place)
    assert run_command_line(["check", str(PLACE / "hop.toml")]) == 2
    text = "".join(capsys.readouterr())
    assert words in text and "Traceback" not in text


_DECLARED = """
from dataclasses import replace
from lunar_hopper import LUNAR_HOP
from perilune.models import Section
"""


@pytest.fixture
def brought(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], object]]:
    """What installs for this process a package whose kind K is made by a text."""
    installed(tmp_path, "bad_kind:K")
    for place in (tmp_path, PLACE):
        monkeypatch.syspath_prepend(place)
    monkeypatch.delitem(sys.modules, "bad_kind", raising=False)
    yield lambda text: (tmp_path / "bad_kind.py").write_text(_DECLARED + text, encoding="utf-8")
    KINDS.pop("lunar_hop", None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("raise SystemExit(7)", "cannot be loaded.*SystemExit: 7"),
        ("K = replace(LUNAR_HOP, sections=['hop'])", "cannot be loaded.*sections of the kind lunar_hop are not"),
        (
            "K = replace(LUNAR_HOP, sections={**LUNAR_HOP.sections, 'hop': int})",
            "cannot be loaded.*sections of the kind lunar_hop are not",
        ),
        ("K = replace(LUNAR_HOP, sections={'hop': Section(record=int)})", "cannot be loaded.*stated by a record"),
        ("K = replace(LUNAR_HOP, sections={'hop': LUNAR_HOP.sections['hop']})", "cannot be loaded.*problem, which"),
        ("K = replace(LUNAR_HOP, example=None)", "cannot be loaded.*what the example of the kind lunar_hop can be"),
        ("K = replace(LUNAR_HOP, example={'nosuch': 3})", "cannot be loaded.*bad_kind:K of .*example.*'nosuch'"),
        ("K = replace(LUNAR_HOP, make=lambda **records: 1 / 0)", "lunar_hop fails.*bad_kind:K of .*ZeroDivision"),
        ("K = replace(LUNAR_HOP, make=lambda problem: None)", "lunar_hop fails.*unexpected keyword"),
        ("K = replace(LUNAR_HOP, make=lambda **records: None)", "returns no problem.*NoneType"),
    ],
)
def test_a_fault_of_a_package_is_named_as_its_own(text: str, words: str, brought: Callable[[str], object]) -> None:
    brought(text)
    with pytest.raises(PeriluneError, match=f"(?s){words}"):
        load_file(PLACE / "hop.toml")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("hopper.mass", "2 m", "hopper.mass - the unit has the wrong dimension"),
        ("hopper.mass", "-2 kg", "hopper.mass must be positive"),
        ("proof.time", "2 kg", "proof.time - the unit has the wrong dimension"),
        ("hop.distance", 'a "hop"', "not valid TOML"),
    ],
)
def test_an_example_that_is_no_scenario_is_the_fault_of_its_package(
    key: str, value: str, words: str, brought: Callable[[str], object], capsys: pytest.CaptureFixture[str]
) -> None:
    brought(f"K = replace(LUNAR_HOP, example={{**LUNAR_HOP.example, {key!r}: {value!r}}})")
    assert run_command_line(["new", "lunar_hop"]) == 2
    said = capsys.readouterr()
    assert not said.out and words in said.err
    assert "the example of the kind of problem lunar_hop is not a scenario" in said.err and "bad_kind:K of" in said.err


@pytest.mark.usefixtures("at_hand")
def test_help_names_the_kinds_of_packages(capsys: pytest.CaptureFixture[str]) -> None:
    for asked in (["new", "--help"], ["help", "new"], ["new", "-h"]):
        assert run_command_line(asked) == 0
        assert "lunar_hop" in capsys.readouterr().out
    assert "lunar_hop" not in KINDS  # nothing of a package is loaded for it


def test_its_author_is_shown_where_it_fails(
    brought: Callable[[str], object], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    brought("K = replace(LUNAR_HOP, make=lambda **records: 1 / 0)")
    assert run_command_line(["check", str(PLACE / "hop.toml")]) == 2
    assert "PERILUNE_TRACEBACK=1" in (said := capsys.readouterr().err) and "Traceback" not in said
    monkeypatch.setenv("PERILUNE_TRACEBACK", "1")
    assert run_command_line(["check", str(PLACE / "hop.toml")]) == 2
    assert "1 / 0" in (said := capsys.readouterr().err) and "perilune: the kind of problem lunar_hop fails" in said


def test_two_packages_of_one_kind_are_both_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("lunar_hopper", "other_hopper"):
        place = tmp_path / f"{name}-1.0.dist-info"
        place.mkdir()
        (place / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
        (place / "entry_points.txt").write_text(f"[perilune.models]\nlunar_hop = {name}:K\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(PeriluneError, match=r"(?s)more than one.*lunar_hopper.*other_hopper.*uninstall"):
        load_file(PLACE / "hop.toml")


def test_without_the_package_the_known_kinds_are_named_and_what_to_do() -> None:
    with pytest.raises(PeriluneError, match=r"(?s)hybrid_landing.*install the package"):
        load_file(PLACE / "hop.toml")


@pytest.mark.usefixtures("at_hand")
def test_its_problems_are_read_back_where_nothing_of_it_was_loaded_yet() -> None:
    """As by whoever opens an atlas of one: the file names the kind, and the package is asked for it."""
    problem = load_file(PLACE / "hop.toml").problem
    document = model_document(problem)
    assert document is not None
    del KINDS["lunar_hop"]
    assert read_model(document, problem.given) == problem
    with pytest.raises(PeriluneError, match="lunar_hip"):
        read_model({**document, "kind": "lunar_hip"}, problem.given)
