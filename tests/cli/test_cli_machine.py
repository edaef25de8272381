"""What the command line shows and asks of the machine it runs on: versions, machine code on disk, threads."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from command_line import read_json
from perilune.cli import main, run_command_line
from perilune.kernels.code import cache


def test_doctor_shows_and_clears_the_machine_code(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PERILUNE_CACHE", str(tmp_path / "cache"))
    cache.store_object("one", b"body")
    assert run_command_line(["doctor"]) == 0
    assert f"1 files, 0.0 MB, in {tmp_path / 'cache'}\n" in capsys.readouterr().out
    assert run_command_line(["doctor", "--clear-cache", "--json"]) == 0
    found = read_json(capsys.readouterr().out)["cache"]
    assert found == {"path": str(tmp_path / "cache"), "files": 0, "bytes": 0, "usable": True, "removed": 1}
    assert list((tmp_path / "cache").iterdir()) == []
    (tmp_path / "cache").rmdir()
    (tmp_path / "cache").write_text("in the way")
    assert run_command_line(["doctor"]) == 0
    assert "cannot be used" in capsys.readouterr().out
    monkeypatch.setenv("PERILUNE_CACHE", "off")
    assert run_command_line(["doctor"]) == 0
    assert "none is stored" in capsys.readouterr().out


@pytest.mark.parametrize("command", ["solve", "sweep", "verify", "reproduce"])
def test_without_cache_none_is_used(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, command: str
) -> None:
    monkeypatch.setenv("PERILUNE_CACHE", str(tmp_path))
    run_command_line(
        [command, "nowhere", "--no-cache", *{"sweep": ["--vary", ""], "reproduce": ["--out", ""]}.get(command, [])]
    )
    assert cache.directory() is None
    assert "No such option" not in capsys.readouterr().err


def test_the_console_script_keeps_small_matrices_in_one_thread(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["perilune", "--version"])
    for chosen, expected in ((None, "1"), ("3", "3")):
        monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
        if chosen:
            monkeypatch.setenv("OPENBLAS_NUM_THREADS", chosen)
        with pytest.raises(SystemExit) as left:
            main()
        assert left.value.code == 0
        assert os.environ["OPENBLAS_NUM_THREADS"] == expected
