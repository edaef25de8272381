"""How the suite runs, and the paper's landing, solved once for all tests that look at it."""

from __future__ import annotations

import gc
import os
import shutil
import sysconfig
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest

from cho import cho_landing
from perilune.problem import Problem, Solution
from perilune.solve import solve

#: Files with tests of ten seconds to a minute: they come first, so that at the end no process waits for one of them.
_LONG = {
    "test_capsule.py", "test_problems.py", "test_matrix.py", "test_structure_changes.py", "test_first_mesh.py",
    "test_smoothing.py", "test_return_starts.py",
}  # fmt: skip

#: Folders of which hardly a file is imported: nearly half of all bytecode that is installed.
_NOT_IMPORTED = {
    "site-packages", "test", "tests", "pip", "setuptools", "pkg_resources", "distutils", "idlelib", "lib2to3",
}  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the longest first."""
    items.sort(key=lambda item: item.path.name not in _LONG)


def pytest_configure(config: pytest.Config) -> None:
    """Give each of several processes one core: threads of linear algebra that wait for one take ten times as long.

    As in the command line, what was made long ago and stays is not looked through for garbage again and again. Where
    no bytecode may be written beside the source, all processes of a run share it elsewhere: hundreds are started.
    """
    gc.set_threshold(50_000)
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", "") and "PYTHONPYCACHEPREFIX" not in os.environ:
        os.environ["PYTHONPYCACHEPREFIX"] = folder = tempfile.mkdtemp(prefix="perilune-bytecode-")
        config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))
        _link_bytecode(folder)
    if config.getoption("numprocesses", None):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def _link_bytecode(folder: str) -> None:
    """Link the bytecode of what is installed into another place: each process would compile all of it first."""
    installed = sysconfig.get_path("purelib")
    for root in {sysconfig.get_path("stdlib"), installed, sysconfig.get_path("platlib")}:
        for here, inner, names in os.walk(root):
            inner[:] = [name for name in inner if name not in _NOT_IMPORTED]
            if os.path.basename(here) == "__pycache__":
                to = Path(folder).joinpath(*Path(here).parent.parts[1:])
                with suppress(OSError):  # where links may not be made, all is compiled
                    to.mkdir(parents=True, exist_ok=True)
                    for name in names:
                        os.symlink(os.path.join(here, name), to / name)


@pytest.fixture(scope="session")
def landing() -> Problem:
    """The paper's problem, delta_v free."""
    return cho_landing()


@pytest.fixture(scope="session")
def hybrid(landing: Problem) -> Solution:
    """Its optimum, unverified."""
    return solve(landing, verify=0)


@pytest.fixture(scope="session")
def ordinary(landing: Problem) -> Solution:
    """The landing without a retro burn, unverified."""
    return solve(landing.with_given(retro_delta_v=0.0), verify=0)
