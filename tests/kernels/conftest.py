"""Every test of the kernels runs on machine code and on SciPy, with a cache of its own."""

from __future__ import annotations

import pytest

from perilune.kernels.code import native


@pytest.fixture(autouse=True, scope="module")  # not of the session: others behind it share what all have compiled
def _cache_of_the_kernels(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PERILUNE_CACHE", str(tmp_path_factory.getbasetemp() / "kernels"))
        yield


@pytest.fixture(params=["native", "scipy"])
def backend(request: pytest.FixtureRequest) -> str:
    """Machine code, where it can be made, and SciPy's."""
    if request.param == "native" and not native.is_available():
        pytest.skip("llvmlite is not installed")
    return request.param
