"""The report on Peng et al. 2012: what it computes, that its verdicts can be "no", and figures in three dimensions."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from perilune import Pseudospectral
from perilune.cli import run_command_line
from perilune.core import Outcome, PeriluneError
from perilune.io import required_hamiltonian
from perilune.models import Approach, Corridor, Site, Vehicle, precision_landing
from perilune.problem import Solution
from perilune.report.figures import solution_figures
from perilune.report.side_and_top_view import track_path
from perilune.solve import solve
from perilune_papers.papers import PAPERS, reproduce_paper
from perilune_papers.peng2012.case import (
    CASE,
    PRINTED,
    implied_gravity,
    other_readings,
    parking_altitude,
    peng_descent,
    problem_of_the_paper,
)
from perilune_papers.peng2012.compute import (
    AT_FIFTY,
    PengReproduction,
    convergence_at,
    fitting_gravity,
    missed_by_reintegration,
    peng_numbers,
)
from perilune_papers.peng2012.report import (
    convergence_csv,
    peng_figures,
    peng_report,
    point_times,
    scaled_hamiltonian,
)
from perilune_papers.starts import Starts


def silent(_: Any) -> None:
    """Nobody watches."""


@pytest.fixture(scope="module")
def made() -> PengReproduction:
    """Everything that the report is made of, with a short convergence and seeds that were not run."""
    indirect = solve(peng_descent(), verify=0)
    return PengReproduction(
        indirect=indirect,
        fastest=solve(peng_descent(minimise="flight_time"), verify=0),
        direct=AT_FIFTY.run(problem_of_the_paper()),
        direct_fastest=AT_FIFTY.run(problem_of_the_paper(minimise="flight_time")),
        direct_cartesian=Pseudospectral(nodes=20, refine=0).run(peng_descent()),
        convergence=tuple(convergence_at(n, indirect, silent) for n in (4, 8, 50)),
        missed=(1e-4, 1e-6),
        genetic=Starts(flight_times=(indirect.free["flight_time"],) * 2, processor_times=(1.0, 3.0)),
        random=Starts(flight_times=(math.nan, 500.0), processor_times=(1.0, 3.0)),
        readings={name: solve(peng_descent(case), verify=0) for name, case in other_readings().items()},
        fitting_gravity=4895e9,
    )


# -- what is computed
# ------------------------------------------------------------------------------------------------------


def test_computed_numbers_follow_the_solution(made: PengReproduction) -> None:
    """Truth of the issue; of another solution they are another's, the printed ones never."""
    found = peng_numbers(made)
    assert found["flight time"] == pytest.approx(472.796, abs=2e-3)
    assert found["fuel"] == pytest.approx(5947.95, abs=0.03)
    other = peng_numbers(replace(made, indirect=made.readings["a Moon that does not turn"]))
    assert other["flight time"] == pytest.approx(472.73, abs=5e-3)
    for name, (printed, _, _) in PRINTED.items():
        assert found[name] != printed
        assert other[name] != found[name]


def test_gauss_points_converge_spectrally(made: PengReproduction) -> None:
    """Four points more are worth a factor of a thousand; fifty agree to 1e-6 s with the indirect method."""
    four, eight, fifty = made.convergence
    assert four.position > 1e3 * eight.position > 1e5 * fifty.position
    assert abs(fifty.flight_time) < 1e-6
    assert fifty.angle < 1e-4


@pytest.mark.parametrize("name", ["direct", "direct_fastest"])
def test_hamiltonian_has_its_required_value(made: PengReproduction, name: str) -> None:
    """Along the Gauss points: 0 for the mass, -1 for the time."""
    solution: Solution = getattr(made, name)
    assert required_hamiltonian(solution, 0) == (0.0 if name == "direct" else -1.0)
    assert np.abs(scaled_hamiltonian(solution, point_times(solution))).max() < 1e-5


def test_reintegration_meets_the_site_and_sees_a_wrong_control(made: PengReproduction) -> None:
    """Millimetres; with the angles a hundredth of a degree off, tens of metres."""
    metres, speed = missed_by_reintegration(made.direct)
    assert metres < 0.01
    assert speed < 1e-4
    flown = made.direct.trajectories[0]
    wrong = replace(flown.control, values=flown.control.values + math.radians(0.01))
    spoilt = replace(made.direct, trajectories=(replace(flown, control=wrong),))
    assert missed_by_reintegration(spoilt)[0] > 10.0


def test_printed_numbers_imply_what_is_not_printed(made: PengReproduction) -> None:
    """g0 from fuel and time; a parking orbit at a round altitude; mu that gives the printed time gives it."""
    assert implied_gravity() == pytest.approx(9.80, abs=5e-4)
    assert parking_altitude() == pytest.approx(110e3, abs=200.0)
    mu = fitting_gravity(made.indirect)
    at = solve(made.indirect.problem.with_given(body_gravitational_parameter=mu), guess=made.indirect, verify=0)
    assert at.free["flight_time"] == pytest.approx(PRINTED["flight time"][0], abs=1e-4)


# -- what is written
# -------------------------------------------------------------------------------------------------------


def test_report_states_what_was_computed(made: PengReproduction) -> None:
    """Every verdict yes; every figure that the text shows is drawn."""
    text, drawn = peng_report(made), peng_figures(made)
    assert "**no**" not in text
    assert "472.7956" in text
    assert "nan" not in text
    assert "2 of 2 | 0 |" in text
    assert "0 of 2 | 1 |" in text
    assert sorted(f"](figures/{name}.png)" in text for name in drawn) == [True] * 7
    assert text.count("](figures/") == len(drawn)
    rows = list(csv.reader(io.StringIO(convergence_csv(made))))
    assert rows[0][:3] == ["points [1]", "flight_time [s]", "position [m]"]
    assert [row[0] for row in rows[1:]] == ["4", "8", "50"]


def test_the_command_writes_it_all(
    made: PengReproduction, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Report, data and figures; the exit code is that of the solution that was to be proved."""
    doubtful = replace(made, indirect=replace(made.indirect, outcome=Outcome.NOT_PROVED))
    monkeypatch.setattr("perilune_papers.peng2012.compute.compute_peng", lambda watch: doubtful)
    out = tmp_path / "report"
    assert run_command_line(["reproduce", "peng-2012", "--out", str(out)]) == Outcome.NOT_PROVED.exit_code
    assert "report.md" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"report.md", "convergence.csv", "figures"}
    assert len(list((out / "figures").glob("*.png"))) == 7


def test_papers_are_known_by_name(tmp_path: Path) -> None:
    """Another is refused before anything is computed, and leaves nothing."""
    with pytest.raises(PeriluneError, match="cho-2015"):
        reproduce_paper("cho-2051", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert set(PAPERS) == {"cho-2015", "peng-2012", "liu-2019"}


@pytest.mark.parametrize(
    ("spoil", "claim"),
    [
        (lambda m: {"missed": (100.0, 0.0)}, "re-integrated"),
        (lambda m: {"genetic": Starts(flight_times=(math.nan, 472.8), processor_times=(1.0, 1.0))}, "random values"),
        (lambda m: {"genetic": replace(m.genetic, processor_times=(1.0, 130.0))}, "less than 2 minutes"),
        (lambda m: {"convergence": (*m.convergence[:2], replace(m.convergence[2], position=5e3))}, "practically"),
        (lambda m: {"direct": replace(m.direct, trajectories=(turned(m.direct),))}, "thrust angles"),
        (lambda m: {"direct": replace(m.direct, trajectories=(turned(m.direct),))}, "Hamiltonian"),
    ],
)
def test_claims_can_fail(made: PengReproduction, spoil: Any, claim: str) -> None:
    """A number on the wrong side is a "no" in its own row."""
    text = peng_report(replace(made, **spoil(made)))
    row = next(line for line in text.splitlines() if line.startswith("|") and claim in line)
    assert row.endswith("**no** |")


def turned(solution: Solution) -> Any:
    """Its trajectory with the thrust ten degrees up."""
    flown = solution.trajectories[0]
    shift = np.array([math.radians(10.0), 0.0])
    return replace(flown, control=replace(flown.control, values=flown.control.values + shift))


# -- figures in three dimensions
# -------------------------------------------------------------------------------------------


def test_path_over_the_pole(made: PengReproduction) -> None:
    """From the origin along the heading; to the site by the sides of its spherical triangle; alike in both frames."""
    along, across, height = track_path(made.indirect)[1]
    radius, site = CASE.body.radius, CASE.site
    assert site.latitude is not None and site.longitude is not None
    assert (along[0], across[0], height[0]) == pytest.approx((0.0, 0.0, 15e3), abs=1e-6)
    # Right-angled at the foot: colatitude 14 deg, angle at the pole 5 deg.
    colatitude = math.pi / 2 - site.latitude
    assert along[-1] == pytest.approx(radius * math.atan(math.tan(colatitude) * math.cos(site.longitude)), abs=1e-3)
    assert across[-1] == pytest.approx(radius * math.asin(math.sin(colatitude) * math.sin(site.longitude)), abs=1e-3)
    for one, other in zip(track_path(made.direct)[1], (along, across, height), strict=True):
        assert one == pytest.approx(other, abs=0.1)


@pytest.mark.parametrize("name", ["indirect", "direct"])
def test_a_spatial_descent_has_its_own_figures(made: PengReproduction, name: str) -> None:
    """None of the planar ones, whose u, v and phi are other quantities."""
    drawn = solution_figures(getattr(made, name))
    assert set(drawn) == {"altitude", "mass", "track", "velocities", "steering", "costates", "hamiltonian"}


def test_a_precision_landing_is_seen_along_its_line() -> None:
    """It ends at the origin; the glide slope is drawn with it, and the throttle with the tilt."""
    landing = precision_landing(
        Vehicle(mass=2000.0, thrust=8000.0, specific_impulse=310.0),
        Approach(east=-2400.0, north=300.0, up=1000.0, east_speed=50.0, up_speed=-30.0),
        Site(altitude=0.0, longitude=0.0, latitude=math.radians(-85)),
        Corridor(tilt=math.radians(80), slope=math.radians(5)),
        (0.3, 0.9),
    )
    solution = Pseudospectral(nodes=20, refine=0).run(landing)
    along, across, height, least = track_path(solution)[1]
    assert (height >= least - 1e-6).all()  # the slope was kept
    assert (along[-1], across[-1], height[-1]) == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert along[0] == pytest.approx(-math.hypot(2400.0, 300.0))
    assert across[0] == pytest.approx(0.0, abs=1e-9)
    drawn = solution_figures(solution)
    assert set(drawn) == {"mass", "track", "velocities", "steering", "costates", "hamiltonian"}
    assert [text.get_text() for text in drawn["track"].legends[0].get_texts()][-1] == "glide slope"
    assert [ax.get_ylabel() for ax in drawn["steering"].axes] == ["tilt\n(deg)", "throttle"]
