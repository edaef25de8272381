"""What Python and a notebook show of problems, solutions and proofs, and what loading the package costs."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

import perilune as pl
from command_line import ENVIRONMENT, ROOT
from perilune.core.errors import Outcome, PeriluneError
from perilune.problem import Problem, Solution
from perilune.report.plot import plot
from perilune.scenario import load_file


def test_a_line_says_what_it_is(landing: Problem, hybrid: Solution) -> None:
    proved = pl.verify(hybrid, 1)
    assert repr(landing) == (
        "<Problem hybrid_landing: 300 kg lander from 15 km to the Moon; descent (5 states); "
        "free: retro_delta_v, flight_time; least J in kg>"
    )
    assert repr(hybrid) == (
        "<Solution of hybrid_landing by indirect: SOLVED, level 0: unverified; J = -160.619 kg, "
        "retro_delta_v = 1200.94 m/s, flight_time = 286.864 s>"
    )
    assert re.fullmatch(r"<Verification level 1: feasible; (\d+) of \1 checks passed>", repr(proved.verification))
    assert repr(pl.Verification()) == "<Verification level 0: unverified>"
    first, *others = proved.verification.checks
    failed = replace(proved.verification, checks=(replace(first, value=1.0), *others))
    assert repr(failed).endswith(f"checks passed; failed: {first.name}>")


def test_records_of_arrays_are_a_line_too(hybrid: Solution, tmp_path: Path) -> None:
    assert repr(load_file(ROOT / "examples" / "hybrid_lander.toml")).startswith(
        "Scenario(problem=<Problem hybrid_landing"
    )
    flown = hybrid.trajectories[0]
    nodes = len(flown.time)
    assert repr(flown.state) == f"<Curve of 5 values at {nodes} nodes, 0 s to 286.864 s>"
    parts = "5 states, 2 values of the control, 5 costates"
    assert repr(flown) == f"<Trajectory of descent: {nodes} nodes, 0 s to 286.864 s; {parts}>"
    assert repr(hybrid.problem.phases[0]) == (
        "<Phase descent: r [m], phi [rad], u [m/s], v [m/s], m [kg]; steered by transverse, radial; lasts flight_time>"
    )
    table = pl.Table(tuple(range(30)), tuple(x**2 for x in range(30)))
    assert repr(table) == "<Table of 30 points, smooth: 0 to 29 onto 0 to 841>"
    members = tuple(pl.FamilyPoint(values=(value,), solution=hybrid) for value in (1000.0, 1200.0))
    family = pl.Family(problem=hybrid.problem, parameters=("retro_delta_v",), points=members)
    assert repr(family) == "<Family of hybrid_landing: retro_delta_v 1000 m/s to 1200 m/s; 2 of 2 members solved>"
    assert repr(replace(family, points=())) == "<Family of hybrid_landing: retro_delta_v; 0 of 0 members solved>"
    assert "unknowns" not in repr(hybrid.extremals[0])
    pl.atlas.build(hybrid.problem, {"retro.specific_impulse": (300.0, 301.0)}, tmp_path / "map", tolerance=1e-6)
    mapped = pl.atlas.open(tmp_path / "map")
    assert repr(mapped) == "<Atlas of hybrid_landing: retro.specific_impulse from 300 s to 301 s>"
    assert repr(mapped.query(retro_specific_impulse=301.0)).startswith(
        "<Solution of hybrid_landing by indirect: SOLVED"
    )
    assert repr(mapped.query_many(np.array([[300.5], [400.0]]))) == "<Answers at 1 of 2 points>"
    assert re.fullmatch(
        r"<Slice of hybrid_landing, retro.specific_impulse from 300 s to 301 s: 5 of 5 points; J -1\S+ kg to -1\S+ kg>",
        repr(pl.atlas.sliced(mapped, points=5)),
    )


def test_a_notebook_shows_pages_without_a_network(hybrid: Solution) -> None:
    proved = pl.verify(hybrid, 1)
    page = proved._repr_html_()
    assert "PROVED, level 1: feasible" in page and "landed mass" in page and "160.61858" in page
    (source,) = re.findall(r'src="([^"]{30})', page)
    assert source.startswith("data:image/svg+xml;base64,") and "http" not in re.sub(r'src="[^"]*"', "", page)
    assert "retro_delta_v" in proved.problem._repr_html_() and "objective" in proved.verification._repr_html_()
    evil = replace(hybrid, problem=hybrid.problem.changed(title="<script>alert(1)</script>"))
    assert "<script" not in evil._repr_html_() + evil.problem._repr_html_()


def test_figures_are_asked_for_by_name(hybrid: Solution) -> None:
    assert isinstance(hybrid.plot(), Figure) and isinstance(hybrid.plot("altitude"), Figure)
    asks: list[tuple[Callable[[], Any], str]] = [
        (lambda: hybrid.plot("altitud"), "did you mean 'altitude'"),
        (lambda: hybrid.plot("alt"), "did you mean 'altitude'"),
        (lambda: hybrid.plot(3), "not a figure to show"),  # pyright: ignore[reportArgumentType]
        (lambda: plot(hybrid.problem), "not a solution to show"),  # pyright: ignore[reportArgumentType]
        (lambda: hybrid.animate(seconds=0), "seconds, 0.2 to 120"),
        (lambda: hybrid.animate("flight.mp4"), "ends in .gif"),
        (lambda: pl.scenario.load_text(ROOT), "load_file(FILE) reads a file"),  # pyright: ignore[reportArgumentType]
    ]
    for ask, words in asks:
        with pytest.raises(PeriluneError) as refused:
            ask()
        assert words in str(refused.value)


def test_a_flight_moves(hybrid: Solution, tmp_path: Path) -> None:
    file = tmp_path / "flight.gif"
    hybrid.animate(file, seconds=0.4)
    with Image.open(file) as shown:
        assert shown.n_frames == 6  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(PeriluneError, match="already exists"):
        hybrid.animate(file)
    said: list[Any] = [
        replace(hybrid, outcome=outcome).animate(file, seconds=0.2, force=True)
        for outcome in (Outcome.SOLVED, Outcome.PROVED)
    ]
    assert [drawn._fig.get_supxlabel() for drawn in said] == ["level 0: unverified", ""]


def test_flights_that_are_nowhere_in_space_move_too(tmp_path: Path) -> None:
    flat = pl.solve(load_file(ROOT / "examples" / "mars_pinpoint.toml").problem, verify=0)
    for solution, label in ((flat, "downrange (km)"), (_bare(flat), "time (s)")):
        drawn: Any = solution.animate(tmp_path / "flight.gif", seconds=0.2, force=True)
        assert drawn._fig.axes[0].get_xlabel() == label


def _bare(solution: Solution) -> Solution:
    """The same flight without any view of its way."""
    phases = tuple(replace(phase, track=None) for phase in solution.problem.phases)
    return replace(solution, problem=solution.problem.changed(phases=phases))


def test_only_public_names_are_offered() -> None:
    assert set(dir(pl)) == {*pl.__all__, "__all__", "__doc__", "__version__"}
    for module in (pl, pl.models, pl.atlas, pl.scenario, pl.views):
        assert all(getattr(module, name) is not None for name in module.__all__)
    # Two records are called Orbit: that of a return has another name beside the other.
    assert pl.models.ReturnOrbit is not pl.models.Orbit
    for module in (pl.models, pl.atlas, pl.scenario, pl.views):
        assert set(dir(module)) == {*module.__all__, "__all__", "__doc__"}
    for name in ("importlib", "sys", "annotations", "Any"):
        assert name not in dir(pl)


def test_loading_the_package_loads_nothing_large() -> None:
    large = "numpy scipy casadi matplotlib pandas xarray pyarrow rich llvmlite"
    program = f"import sys, perilune, perilune.cli; print([n for n in {large.split()} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=ENVIRONMENT, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ("perilune.models.bodies", "perilune.models.physics.bodies", "MOON"),
        ("perilune.words.declared", "perilune.core.fields", "quantity"),
        ("perilune.problem.declared", "perilune.problem.parameters", "given_of"),
        ("perilune.methods.pseudospectral", "perilune.methods", "Pseudospectral"),
    ],
)
def test_modules_that_the_manual_named_are_found_at_their_old_place(old: str, new: str, name: str) -> None:
    """For one minor version, with a warning."""
    with pytest.warns(DeprecationWarning, match="goes with the next minor version"):
        found = importlib.import_module(old)
    assert getattr(found, name) is getattr(importlib.import_module(new), name)
    sys.modules.pop(old)


def test_the_orbit_of_a_return_is_found_by_its_old_name() -> None:
    records = importlib.import_module("perilune.models.deorbit.records")
    with pytest.warns(DeprecationWarning, match="ReturnOrbit now"):
        assert records.Orbit is pl.models.ReturnOrbit
