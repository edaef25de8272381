"""No scenario ends in a fault of the program: a sample of `benchmarks/fuzz_scenarios.py`, and what it found."""

from __future__ import annotations

import importlib.util
import sys
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest

from perilune.cli import run_command_line
from perilune.core import PeriluneError
from perilune.scenario import load_file

ROOT = Path(__file__).parents[2]
CAPSULE = str(ROOT / "examples" / "maps" / "capsule.toml")


@pytest.fixture(scope="module")
def fuzz() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fuzz_scenarios", ROOT / "benchmarks" / "fuzz_scenarios.py")
    assert spec is not None and spec.loader is not None
    module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_scenarios_of_every_kind_end_in_words(fuzz: ModuleType, tmp_path: Path) -> None:
    known, codes, file = fuzz.bases(), Counter[int](), tmp_path / "scenario.toml"
    for number in range(300):
        text = fuzz.scenario(41, number, known)
        file.write_text(text, encoding="utf-8")
        found = fuzz.run_here(["check", str(file)])
        assert fuzz.judged("check", found) == "", text
        codes[found.code] += 1
    assert codes[0] > 30 and codes[2] > 100 and codes[3] > 3  # none of the ways to end is all there is


def test_what_is_a_failure_is_seen(fuzz: ModuleType) -> None:
    assert fuzz.judged("check", fuzz.Result(1, "", 0.1)).startswith("exit 1")
    assert fuzz.judged("check", fuzz.Result(0, "a.py:3: RuntimeWarning: overflow", 0.1)).startswith("on stderr")
    assert fuzz.judged("solve", fuzz.Result(0, "", 30.0, silence=21.0)) == "silent for 21 s"
    assert fuzz.judged("solve", fuzz.Result(4, "perilune: no extremal was found", 1.0)) == ""


@pytest.mark.parametrize(
    ("changes", "code", "said"),
    [
        # Beyond where the ground turns as fast as it flies, there is no speed at the interface.
        (["interface.altitude=1e6 km"], 3, "the orbit enters the atmosphere by itself"),
        (["interface.altitude=1e15 m"], 3, "the orbit enters the atmosphere by itself"),
        # Of air that grows by e with each scale height down there is no end of it.
        (["site.altitude=-92617097280162.69 km"], 2, "site.altitude is deeper than any valley"),
        (["site.altitude=-6300 km"], 2, "site.altitude is deeper than any valley"),
        (["site.altitude=-600 km", "atmosphere.scale_height=100 m"], 0, ""),
        # No air is left where the entry ends: a steady fall has no speed.
        (["atmosphere.scale_height=4e-7 m"], 3, "no ballistic entry arrives as slowly"),
        (["atmosphere.density=1e-30 kg/m^3"], 3, "no ballistic entry arrives as slowly"),
    ],
)
def test_numbers_that_no_fall_bears_are_refused_in_words(
    changes: list[str], code: int, said: str, capfd: pytest.CaptureFixture[str], recwarn: pytest.WarningsRecorder
) -> None:
    assert run_command_line(["check", CAPSULE, *(word for change in changes for word in ("--set", change))]) == code
    told = capfd.readouterr()
    assert said in told.err
    assert "Warning" not in told.err
    assert not recwarn.list


def test_a_problem_whose_flight_ends_below_the_centre_is_refused_without_a_file_too(
    recwarn: pytest.WarningsRecorder,
) -> None:
    problem = load_file(Path(CAPSULE)).problem
    with pytest.raises(PeriluneError, match="below the centre of the body"):
        problem.with_given(site_altitude=-6.5e6)
    assert not recwarn.list
