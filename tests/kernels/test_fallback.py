"""Without llvmlite the same interface works, and says once that it is slower."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from perilune.cli import run_command_line
from perilune.kernels import compile_arcs
from perilune.kernels.flight import engine
from perilune.shooting import integrate_plan as flyer, propagate


def decay() -> ca.Function:
    z, p = ca.SX.sym("z"), ca.SX.sym("p")
    return ca.Function("decay", [z, p], [-p * z])


@pytest.fixture
def without_llvmlite(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What was compiled before is not used, and what is made here not afterwards."""
    monkeypatch.setitem(sys.modules, "llvmlite", None)
    monkeypatch.setitem(sys.modules, "llvmlite.binding", None)
    monkeypatch.setattr(engine, "_told", [])
    kept = (propagate.arc_engine, flyer.fleet)
    for cache in kept:
        cache.cache_clear()
    yield
    for cache in kept:
        cache.cache_clear()


@pytest.mark.usefixtures("without_llvmlite")
def test_falls_back_and_says_so_once(caplog: pytest.LogCaptureFixture) -> None:
    for _ in range(2):
        arcs = compile_arcs(decay()).propagate([1.0], [1.0], 1.0)
    assert arcs.z[0, 0] == pytest.approx(np.exp(-1), rel=1e-12)
    assert [record.message.count("slower") for record in caplog.records] == [1]


@pytest.mark.usefixtures("without_llvmlite")
def test_a_landing_is_solved_and_proved(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command_line(["solve", str(Path(__file__).parents[2] / "examples" / "ordinary_lander.toml")]) == 0
    assert "154.5413" in capsys.readouterr().out  # kg landed, as with machine code


def test_the_default_is_machine_code() -> None:
    pytest.importorskip("llvmlite")
    assert compile_arcs(decay()).backend == "native"
    assert compile_arcs(decay(), backend="scipy").backend == "scipy"
