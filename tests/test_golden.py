"""The golden file: what does not hang on a machine's libraries is what it was; every bit is compared on request."""

from __future__ import annotations

import copy
import json
from typing import Any

import pytest

from golden import FOLDER
from golden.answers import SLOW, golden_problems
from golden.compare import Difference, record_differences
from make_golden import main, records_of


def golden_records(part: str) -> dict[str, Any]:
    """Return the records of a part, as the file has them."""
    return json.loads((FOLDER / f"{part}.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("parts", [("answers", "proofs"), ("theorems", "sweep", "atlases"), ("commands",)])
def test_answers_are_what_they_were(parts: tuple[str, ...]) -> None:
    """Levels, checks, exit codes, keys and words to the letter; numbers to the digits that other libraries leave."""
    for part in parts:
        now, was = records_of(part, quick=True), golden_records(part)
        assert len(now) >= {"theorems": 1, "sweep": 3}.get(part, 20)
        assert not [
            str(one) for name in now for one in record_differences(was.get(name), now[name], exact=False, where=name)
        ]


def test_the_file_has_every_problem_and_no_other() -> None:
    wanted = {f"{name}, {type(m).__name__}" for name, (_, methods) in golden_problems().items() for m in methods}
    assert set(golden_records("answers")) == wanted
    assert set(golden_records("proofs")) == set(golden_problems())
    assert {*golden_problems(), *golden_records("theorems")} >= SLOW


RECORD: dict[str, Any] = {
    "objective": 160.61858361287182, "level": 3, "says": "lands with 160.618584 kg, off by 3.1e-12",
    "last": [1738140.0, 0.3, 2.1e-9], "checks": [["tables", 1, "1", True]], "effort": {"arcs": 84, "sha256": "ab"},
    "check": {"value": 1.2e-13, "limit": 1e-9, "passed": True},
}  # fmt: skip


def with_entry(record: dict[str, Any], *path: Any, to: Any) -> dict[str, Any]:
    """Return a copy with one entry another."""
    other = copy.deepcopy(record)
    inner: Any = other
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = to
    return other


@pytest.mark.parametrize(
    ("path", "to"),
    [
        (("objective",), 160.61858361287185),
        (("last", 2), -1.3e-9),
        (("says",), "lands with 160.618585 kg, off by 7.9e-13"),
        (("effort", "arcs"), 85),
        (("check", "value"), 3.1e-13),
    ],
)
def test_what_libraries_explain_is_seen_by_those_alone_who_ask_for_every_bit(path: tuple[Any, ...], to: Any) -> None:
    other = with_entry(RECORD, *path, to=to)
    assert [one.kind for one in record_differences(RECORD, other, exact=True)] == [
        "words" if path == ("says",) else "number"
    ]  # fmt: skip
    assert not list(record_differences(RECORD, other, exact=False))


@pytest.mark.parametrize(
    ("path", "to", "kind"),
    [
        (("objective",), 160.6188, "number"),
        (("objective",), None, "words"),
        (("level",), 2, "number"),
        (("last", 1), 0.30001, "number"),
        (("last", 2), 2.1e-5, "number"),
        (("last",), [1738140.0, 0.3], "number"),
        (("says",), "lands with 160.618594 kg, off by 3.1e-12", "words"),
        (("says",), "falls with 160.618584 kg, off by 3.1e-12", "words"),
        (("checks", 0, 0), "table", "words"),
        (("checks", 0, 3), False, "words"),
        (("check", "passed"), False, "words"),
    ],
)
def test_what_no_library_explains_is_seen_by_all(path: tuple[Any, ...], to: Any, kind: str) -> None:
    other = with_entry(RECORD, *path, to=to)
    for exact in (True, False):
        assert kind in [one.kind for one in record_differences(RECORD, other, exact)]


def test_a_renamed_key_is_one_difference_and_a_lost_one_too() -> None:
    renamed = {("verification" if key == "level" else key): value for key, value in RECORD.items()}
    assert list(record_differences(RECORD, renamed, exact=True)) == [
        Difference(kind="key", where="", was="level", now="verification")
    ]
    lost = {key: value for key, value in RECORD.items() if key != "level"}
    assert list(record_differences(RECORD, lost, exact=True)) == [
        Difference(kind="key", where="", was="level", now=None)
    ]


def test_the_script_says_the_last_bit_that_differs(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Made and compared it is equal; with one bit of one number changed the exit code is 1, and the place is named."""
    monkeypatch.setattr("golden.answers.GRID", {"vehicle.thrust": [440.0]})
    monkeypatch.setattr("sys.argv", ["make_golden.py", "--to", str(tmp_path), "sweep"])
    assert main() == 0
    monkeypatch.setattr("sys.argv", ["make_golden.py", "--compare", "--to", str(tmp_path), "sweep"])
    assert main() == 0 and "sweep: equal" in capsys.readouterr().out
    file = tmp_path / "sweep.json"
    record = json.loads(file.read_text(encoding="utf-8"))
    (member,) = record.values()
    member["objective"] += 2.9e-14
    file.write_text(json.dumps(record), encoding="utf-8")
    assert main() == 1 and "number: /440; 300/objective: " in capsys.readouterr().out
