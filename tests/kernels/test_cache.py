"""The cache on disk: what is wrong with a file is found, and nothing is lost by it."""

from __future__ import annotations

import multiprocessing
import os
import shutil
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from perilune.kernels import compile_arcs
from perilune.kernels.code import cache, native

pytestmark = pytest.mark.skipif(not native.is_available(), reason="llvmlite is not installed")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for the equations of each test; the loop that flies any is loaded before."""
    fly()
    path = tmp_path / "cache"
    monkeypatch.setenv("PERILUNE_CACHE", str(path))
    return path


def decay(rate: float = 1.0) -> ca.Function:
    z, p = ca.SX.sym("z"), ca.SX.sym("p")
    return ca.Function("decay", [z, p], [-rate * p * z])


def fly(rate: float = 1.0, *, keep: bool = True) -> float:
    return float(compile_arcs(decay(rate), cache=keep, backend="native").propagate([1.0], [1.0], 1.0).z[0, 0])


def the_file(folder: Path) -> Path:
    (path,) = folder.glob("*.code")
    return path


def forbid_compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(text: str) -> bytes:
        raise AssertionError("compiled, though it is in the cache")

    monkeypatch.setattr(native, "compile_ir", refuse)


def test_a_second_engine_takes_the_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = fly()
    forbid_compiling(monkeypatch)
    assert fly() == first == pytest.approx(np.exp(-1), rel=1e-12)
    assert cache.report_cache().files == 1
    assert cache.report_cache().size == the_file(folder).stat().st_size
    assert cache.report_cache().path == folder


def test_another_expression_is_another_file(folder: Path) -> None:
    fly(1.0)
    assert fly(2.0) == pytest.approx(np.exp(-2), rel=1e-12)
    assert cache.report_cache().files == 2


@pytest.mark.parametrize(
    ("old", "new", "kept"),
    [
        ('"""Code generation: a straight-line', '"""Writing of code: a straight-line', True),
        ("    # Volatile, lest LLVM", "    # Volatile,\n    # lest LLVM", True),
        ('"add": "fadd", "sub"', '"add": "fadd",\n    "sub"', True),
        ("_RECENT = 20", "_RECENT = 21", False),
        ('"lt": "olt"', '"lt": "ult"', False),
    ],
    ids=["docstring", "comment", "layout", "number", "instruction"],
)
def test_only_what_changes_the_code_makes_it_anew(
    folder: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, kept: bool
) -> None:
    source = folder.parent / "kernels"
    shutil.copytree(Path(cache.__file__).parents[1], source, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(cache, "__file__", str(source / "code" / "cache.py"))
    monkeypatch.setattr(cache, "source_digest", cache.source_digest.__wrapped__)  # which is asked once for each process
    fly()
    files = {*folder.glob("*.code")}
    text = (source / "code" / "emit.py").read_text()
    assert old in text
    (source / "code" / "emit.py").write_text(text.replace(old, new))
    if kept:
        forbid_compiling(monkeypatch)
    assert fly() == pytest.approx(np.exp(-1), rel=1e-12)
    made = {*folder.glob("*.code")} - files
    assert len(made) == (1 if kept else 3), "the digest of the source; equations and loop"


@pytest.mark.parametrize("part", ["empty", "cut", "flipped", "garbage"])
def test_a_corrupted_file_is_made_anew(folder: Path, part: str) -> None:
    fly()
    path = the_file(folder)
    whole = path.read_bytes()
    damaged = {
        "empty": b"",
        "cut": whole[: len(whole) // 2],
        "garbage": os.urandom(500),
        "flipped": whole[:-40] + bytes([whole[-40] ^ 1]) + whole[-39:],
    }[part]
    path.write_bytes(damaged)
    assert cache.load_object(path.stem) is None
    assert fly() == pytest.approx(np.exp(-1), rel=1e-12)
    assert path.read_bytes() == whole


def test_a_foreign_file_under_this_name_is_not_taken(folder: Path) -> None:
    """An intact object of other equations, copied to this one's name, would answer wrongly."""
    fly(1.0)
    mine = the_file(folder)
    fly(2.0)
    (other,) = set(folder.glob("*.code")) - {mine}
    mine.write_bytes(other.read_bytes())
    assert fly(1.0) == pytest.approx(np.exp(-1), rel=1e-12)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="permissions of another kind")
def test_a_file_that_others_may_write_is_not_taken(folder: Path) -> None:
    fly()
    path = the_file(folder)
    path.chmod(0o666)
    assert cache.load_object(path.stem) is None


def test_a_killed_writer_leaves_nothing_that_is_read(folder: Path) -> None:
    folder.mkdir(mode=0o700)
    child = multiprocessing.get_context("spawn").Process(target=_write_and_die, args=(str(folder),))
    child.start()
    child.join(30)
    assert child.exitcode == 9
    assert list(folder.glob("*.part"))
    assert cache.load_object("key") is None
    assert cache.report_cache().files == 0
    assert cache.store_object("key", b"body")
    assert cache.load_object("key") == b"body"
    cache.clear_cache()
    assert not list(folder.iterdir())


def _write_and_die(folder: str) -> None:
    os.environ["PERILUNE_CACHE"] = folder
    os.replace = lambda *_: os._exit(9)  # the power goes before the file has its name
    cache.store_object("key", b"body")


def test_processes_at_once(folder: Path) -> None:
    context = multiprocessing.get_context("spawn")
    with context.Pool(2, initializer=_use, initargs=(str(folder),)) as pool:
        results = pool.map(fly, [1.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(results, np.exp(-1), rtol=1e-12)
    assert [p.suffix for p in folder.iterdir()] == [".code"] * 3  # the equations, the loop that flies any, the source


def _use(folder: str) -> None:
    os.environ["PERILUNE_CACHE"] = folder


def test_no_cache_writes_nothing(folder: Path) -> None:
    assert fly(keep=False) == pytest.approx(np.exp(-1), rel=1e-12)
    assert not folder.exists()
    assert cache.report_cache().files == 0


@pytest.mark.parametrize("homeless", [False, True])
def test_without_a_directory_nothing_is_kept_and_all_works(monkeypatch: pytest.MonkeyPatch, homeless: bool) -> None:
    if homeless:
        for name in ("PERILUNE_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
            monkeypatch.delenv(name, raising=False)
        monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("no home")))
    else:
        monkeypatch.setenv("PERILUNE_CACHE", "off")
    assert cache.directory() is None
    assert fly() == pytest.approx(np.exp(-1), rel=1e-12)
    assert cache.report_cache() == cache.CacheReport(path=None, files=0, size=0, usable=False)
    assert not cache.store_object("key", b"body")
    assert cache.load_object("key") is None
    assert cache.clear_cache() == 0
    assert not Path("off").exists()


def test_a_directory_that_cannot_be_made_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("PERILUNE_CACHE", str(tmp_path / "file" / "below"))
    assert fly() == pytest.approx(np.exp(-1), rel=1e-12)


def test_the_key_depends_on_the_processor(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fly()
    triple, name, _ = native.host_processor()
    monkeypatch.setattr(native, "host_processor", lambda: (triple, name, ""))
    fly()
    assert cache.report_cache().files == 3  # the loop depends on it as well


def test_what_is_not_used_for_longest_goes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "MOST_BYTES", 3500)
    for k, name in enumerate(("old", "used", "newer")):
        assert cache.store_object(name, b"x" * 1000)
        os.utime(folder / f"{name}.code", (k, k))
    (folder / "killed.part").write_bytes(b"half")
    os.utime(folder / "killed.part", (0, 0))
    (folder / "writing.part").write_bytes(b"half")
    assert cache.load_object("used") == b"x" * 1000
    assert cache.store_object("newest", b"x" * 1000)
    assert sorted(path.name for path in folder.iterdir()) == ["newer.code", "newest.code", "used.code", "writing.part"]
    assert cache.store_object("largest", b"x" * 9000)  # kept or not, nothing fails
    assert cache.report_cache().size <= 3500
