"""Limits that are only just reached: the multiplier of a condition goes through zero, and the structure changes.

The named points are of issue lists and of `benchmarks/structure_changes.py`. On the open side of a limit the answer is
that without it; on the closed side it is no better, and by how much it is worse goes to zero.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import perilune as pl
from perilune.methods.indirect.coarse_direct import Coarse
from perilune.methods.indirect.diagnosis import bound_unreachable_objective, explain_refusal
from perilune.methods.indirect.indirect import Indirect
from perilune.methods.indirect.search import Search
from perilune.methods.indirect.violations import ConstraintViolation, solution_violations
from perilune.models import EUROPA, MARS, MOON, Approach, Corridor, Site, Vehicle, precision_landing
from perilune.problem import Check
from perilune.proof import levels
from perilune.proof.sufficient.second_variation import KeptConditions
from perilune.scenario import load_file
from perilune.structures import Arc, Structure
from perilune.structures.detect_arcs import CLOSEST
from perilune.structures.multiphase import restate
from perilune.structures.state_margins import refine_minima
from problems.constrained import bryson_denham, bryson_denham_truth

EXAMPLE = Path(__file__).parents[2] / "examples" / "precision_landing.toml"
CAPSULE = EXAMPLE.parent / "maps" / "capsule.toml"


def on_mars(slope: float | None, pad: float = 16.11334209455876, tilt: float | None = None) -> pl.Problem:
    """A point of `benchmarks/structure_changes.py --seed 41`: the slope is touched from 0.258322949 rad on."""
    return precision_landing(
        Vehicle(mass=1848.038059249582, thrust=21576.721841930816, specific_impulse=297.9322600446545),
        Approach(
            east=513.748160051656, north=-715.8536607805378, up=415.74843919233984,
            east_speed=-3.9368234734330416, north_speed=5.2435490545354915, up_speed=-38.0246292004458,
        ),
        Site(altitude=0.0, longitude=0.0, latitude=-0.4206080573391944),
        Corridor(slope=slope, pad_radius=pad, tilt=tilt),
        (0.4374897261851311, 0.8344560982905019),
        MARS,
    )  # fmt: skip


@cache
def without_slope() -> pl.Solution:
    """Return its answer without a limit."""
    return pl.solve(on_mars(None), verify=0)


def heavy(dry: float | None) -> pl.Problem:
    """Another of these, of which no random costates lead to an extremal."""
    return precision_landing(
        Vehicle(
            mass=15511.26567218037, thrust=46922.88905031691, specific_impulse=382.9089746325629, dry_mass=dry
        ),
        Approach(
            east=-576.0376250966674, north=146.65635454162845, up=300.65108568807295,
            east_speed=-13.97987478720896, north_speed=1.2284710162196337, up_speed=-5.602327752456119,
        ),
        Site(altitude=0.0, longitude=0.0, latitude=1.0808314864901511),
        Corridor(),
        (0.15348108354062415, 0.8055220394822586),
        MOON,
    )  # fmt: skip


@cache
def without_dry_mass() -> pl.Solution:
    """Return its answer without a limit."""
    return pl.solve(heavy(None), verify=0)


def on_europa(dry: float) -> pl.Problem:
    """Number 27 of these: 2838.8906350965 kg can be landed, and a mesh of an error of 0.9 % lands 2838.92 kg."""
    return precision_landing(
        Vehicle(
            mass=3071.157863960569, thrust=11415.83599533059, specific_impulse=314.1856678500278, dry_mass=dry
        ),
        Approach(
            east=-4085.281411942996, north=-3401.472078351617, up=3121.283464784284,
            east_speed=-19.064266898368583, north_speed=34.46748325602054, up_speed=-42.11849377820856,
        ),
        Site(altitude=0.0, longitude=0.0, latitude=1.0158488023067789),
        Corridor(),
        (0.38648358880075145, 0.914902465195474),
        EUROPA,
    )  # fmt: skip


def kept(solution: pl.Solution) -> bool:
    """Whether its tables keep every limit to the accuracy of the proof's first level."""
    return not any(solution_violations(solution, 1e-9)) and solution.verification.level >= 1


def test_a_slope_that_is_broken_by_a_quarter_of_a_millimetre_is_touched() -> None:
    """1926.19507 kg by an independent transcription; the mesh showed no touch, and every extremal broke the slope."""
    given = ("approach.east=-1416.2094665883978 m", "corridor.slope=0.5367892139328801 rad")
    solution = pl.solve(load_file(str(EXAMPLE), given).problem)
    assert -solution.objective == pytest.approx(1926.19507, abs=5e-6)
    assert [arc.description for arc in solution.structure if "slope" in arc.description] == [
        "contact point of height above glide slope"
    ]
    # J changes by 2.7e-7 kg per metre of the touch: too little to tell its sign. The second variation needs no touch.
    assert solution.verification.level == 3, str(solution.verification)
    multiplier = next(check for check in solution.verification.checks if check.name == "landing-1_strict_touch")
    assert -1e-6 < multiplier.value <= 0 and "need not be strictly negative" in multiplier.meaning


@pytest.mark.parametrize("without", [0.5, 1.5])
def test_a_touch_of_no_multiplier_is_excused_by_what_is_positive_without_it(
    monkeypatch: pytest.MonkeyPatch, without: float
) -> None:
    """And by nothing else: where the second variation is positive for flights that touch alone, its sign is missing."""
    strict = [Check(name="strict_touch", level=3, value=-1e-9, limit=-1e-6, unit="1", meaning="multiplier: negative")]
    kept, idle = {0: KeptConditions(boundary_rates=("kept",))}, {0: KeptConditions()}

    def second_variation(_: Any, by: dict[int, KeptConditions]) -> list[Check]:
        value = 0.5 if by is kept else without
        return [Check(name="conjugate_point", level=3, value=value, limit=1.0, unit="1", meaning="")]

    monkeypatch.setattr(levels, "check_local_optimality", second_variation)
    found = list(levels._local_optimality_checks(pl.solve(bryson_denham(0.3), verify=0), kept, idle, strict))
    assert [check.value for check in found] == [-1e-9, 0.5]
    assert [check.passed for check in found] == [without < 1.0, True]


@pytest.mark.parametrize("offset", [1e-3, 3e-5, 1e-6, 1e-7])
def test_a_slope_that_is_broken_between_the_looks_of_the_search_is_touched(offset: float) -> None:
    """Parabolas of 0.1 mm below the slope lie between any two of 6400 looks; they were found by the proof alone."""
    without = without_slope()
    up = 0.25832294869638345
    solution = pl.solve(on_mars(up * (1.0 + offset)), verify=2)
    assert kept(solution) and solution.verification.level >= 2, str(solution.verification)
    worse = solution.objective - without.objective
    assert -1e-9 <= worse <= 20.0 * offset**2 + 1e-9  # kg: the price of a touch begins with its square
    beside = pl.solve(on_mars(up * (1.0 - offset)))
    assert beside.objective == pytest.approx(without.objective, abs=1e-9) and beside.verification.level == 3


@pytest.mark.parametrize("offset", [-1e-4, -1e-6, -1e-9, -5e-10, 0.0, 1e-9, 1e-6])
def test_a_ceiling_just_below_the_free_flight_is_touched(offset: float) -> None:
    """Bryson, Denham, Dreyfus 1963: J = 2 + 6 (1 - 4 l)^2 from l = 1/4 down. Between 1e-10 and 1e-9 it was level 0."""
    ceiling = 0.25 * (1.0 + offset)
    solution = pl.solve(bryson_denham(ceiling))
    truth = bryson_denham_truth(ceiling) if offset < 0 else 2.0
    assert solution.objective == pytest.approx(truth, abs=1e-12)
    assert solution.verification.level >= 2, str(solution.verification)
    assert [arc.description for arc in solution.structure] == (["contact point of room"] if offset < 0 else [])


@pytest.mark.parametrize("offset", [-1e-4, -1e-6, -1e-9, 0.0, 1e-9, 1e-6, 1e-4])
def test_a_touch_that_becomes_an_arc_is_either(offset: float) -> None:
    """The same at l = 1/6, where the flight begins to stay on its ceiling: J = 4/(9 l) below."""
    ceiling = (1.0 + offset) / 6.0
    solution = pl.solve(bryson_denham(ceiling))
    truth = 4.0 / (9.0 * ceiling) if offset < 0 else 2.0 + 6.0 * (1.0 - 4.0 * ceiling) ** 2
    assert solution.objective == pytest.approx(truth, abs=1e-10)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3


@pytest.mark.parametrize("offset", [-1e-6, -1e-9, 0.0])
def test_a_dry_mass_that_is_just_landed_is_answered(offset: float) -> None:
    """A program whose bound leaves no room has no inside: no mesh was solved, and no costates led to an extremal."""
    landed = -without_dry_mass().objective
    solution = pl.solve(heavy(landed * (1.0 + offset)))
    assert -solution.objective == pytest.approx(landed, rel=1e-12)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3


@pytest.mark.parametrize("offset", [1e-6, 1e-3])
def test_a_dry_mass_that_is_just_not_landed_is_named(offset: float) -> None:
    landed = 15070.989266540137
    with pytest.raises(pl.InfeasibleError, match=r"violates vehicle\.dry_mass by") as caught:
        pl.solve(heavy(landed * (1.0 + offset)))
    assert caught.value.exit_code == 3
    assert float(caught.value.what.split(" by ")[1].split()[0]) == pytest.approx(landed * offset, rel=1e-4)


@pytest.mark.parametrize("offset", [1e-6, 1e-9])
def test_a_dry_mass_that_a_mesh_lands_by_its_own_error_is_named(offset: float) -> None:
    """The first was said to be flown by the direct method; the second was an answer of level 0."""
    landed = 2838.8906350965017
    with pytest.raises(pl.InfeasibleError, match=r"violates vehicle\.dry_mass by") as caught:
        pl.solve(on_europa(landed * (1.0 + offset)))
    assert float(caught.value.what.split(" by ")[1].split()[0]) == pytest.approx(landed * offset, rel=1e-4)
    told = re.search(r"falls to ([\d.]+) kg, below vehicle\.dry_mass of ([\d.]+) kg", caught.value.got)
    assert told and float(told[1]) < float(told[2])  # told with as many digits as it takes


def test_a_flight_that_finer_meshes_bear_out_is_no_error_of_a_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    """Then a better extremal is missing, and that nothing can be flown is not said."""
    free = without_dry_mass()
    bound = -free.objective + 1.0
    missed = ConstraintViolation(
        name="m", text="mass falls", miss=1.0, unit="kg", canonical=1e-4, limit="vehicle.dry_mass",
    )  # fmt: skip

    def refused(finer: float | None) -> pl.PeriluneError | None:
        coarse = Coarse(Indirect(), heavy(bound), [])
        vars(coarse)["flight"] = replace(free, objective=-(bound + 30.0))
        found = None if finer is None else replace(free, objective=-(bound + finer))
        monkeypatch.setattr(Coarse, "without_bounds", lambda *_: found)
        return explain_refusal(coarse, [missed])

    assert isinstance(refused(-1.0), pl.InfeasibleError)  # lands less than is asked for
    assert isinstance(refused(1.0), pl.InfeasibleError)  # more, by less than it changed
    assert isinstance(refused(29.0), pl.NotConvergedError)
    assert isinstance(refused(None), pl.NotConvergedError)
    assert bound_unreachable_objective(heavy(bound), replace(missed, limit="the upper bound of m")) is None
    assert bound_unreachable_objective(heavy(bound), replace(missed, name="up")) is None


def test_what_is_told_of_a_flight_whose_phases_have_parts_names_none_of_them() -> None:
    """Its neighbours were asked for the track of the entry, which begins in the first of them: an error, exit 1."""
    problem = load_file(CAPSULE, ["limits.load=7 g0"]).problem
    structure = Structure(((Arc(),), (Arc(),), (Arc(touches=("load_left",)), Arc())))
    restated = restate(problem, structure)
    names = {phase.name for phase in restated.phases}
    assert problem.views.dispersion is not None and problem.views.dispersion.track not in names
    assert restated.views.dispersion is None


@pytest.mark.parametrize("offset", [-1e-4, -1e-6, -1e-8])
def test_a_tilt_that_binds_for_a_moment_is_proved(offset: float) -> None:
    """Its multiplier is next to nothing there, and no time of the proof lies within: it was level 2 from 1e-6 on."""
    problem, free = on_mars(None), without_slope()
    up = problem.phases[-1].control_names.index("toward_up")
    largest = math.acos(free.trajectories[-1].control.values[:, up].min())
    solution = pl.solve(on_mars(None, tilt=largest * (1.0 + offset)))
    assert solution.objective == pytest.approx(free.objective, abs=20.0 * abs(offset))
    assert solution.verification.level == 3, str(solution.verification)


@pytest.mark.parametrize(("depth", "seen"), [(-1e-12, False), (1e-9, False), (1e-7, True), (1e-4, True)])
def test_closer_looks_find_what_lies_between(depth: float, seen: bool) -> None:
    """A parabola that is below zero for a ten-thousandth of the time, at a place that no look is at."""

    def room(t: Any) -> Any:
        return 10.0 * (t - 1.0 / math.pi) ** 2 - depth

    t = np.linspace(0.0, 1.0, 201)
    for _ in range(CLOSEST):
        t = np.union1d(t, refine_minima(t, room(t), 1e-9))
    assert bool(room(t).min() < -1e-9) is seen
    assert len(t) < 201 + 33 * CLOSEST


def test_closer_looks_go_on_behind_a_time_that_rounding_doubles() -> None:
    """The least value behind it was not looked for: the doubled time passed for the neighbour."""
    doubled = np.nextafter(0.9, 0.0)

    def room(t: Any) -> Any:
        return 10.0 * (t - 0.90003) ** 2 - 1e-9 - 1e-16 * (t == doubled)

    t = np.union1d(np.linspace(0.0, 1.0, 201), [doubled])
    assert {doubled, 0.9} <= {*t.tolist()}
    for _ in range(CLOSEST):
        t = np.union1d(t, refine_minima(t, room(t), 1e-10))
    assert room(t).min() < -0.9e-9


def test_closer_looks_end_where_there_is_nothing_to_see() -> None:
    t = np.linspace(0.0, 1.0, 201)
    assert not len(refine_minima(t, 1.0 + (t - 0.3) ** 2, 1e-9))  # far above its limit
    assert not len(refine_minima(t, np.zeros(201), 1e-9))  # on it all along
    assert not len(refine_minima(t[:1], np.zeros(1), 1e-9))  # one look
    both = refine_minima(t, (t - 0.2012) ** 2 * (t - 0.7013) ** 2, 1e-12)
    assert np.ptp(both) > 0.4 and len(both) == 66  # two places, each its own looks
    assert (
        len(refine_minima(t, t * (t - 1e-3), 1e-12)) == 33
    )  # from the limit down and up again between the first two looks


def test_an_atlas_answers_where_a_tilt_begins_to_bind_beside_a_touch(tmp_path: Path) -> None:
    """Each was refused for a touch that broke the tilt: no point solved by the survey has both, so no touch kept it.

    The masses are those of `perilune.solve` there, each PROVED 3.
    """
    region = {"approach_east": (-3000.0, -1000.0), "corridor_slope": (0.2, 0.55)}
    directory = pl.atlas.build(load_file(str(EXAMPLE)).problem, region, tmp_path / "slopes", bricks=2, sample=0)
    atlas = pl.atlas.open(directory)
    landed = {
        (-2944.881773513863, 0.2879436523598786): 1901.009571222,  # the tilt alone
        (-2788.157526585351, 0.32228452560523346): 1903.531052518,  # both
        (-2274.6062858843034, 0.33440539647195844): 1912.124072936,
    }
    for (east, slope), mass in landed.items():
        assert -atlas.query(approach_east=east, corridor_slope=slope).objective == pytest.approx(mass, abs=1e-7)
    solved = pl.solve(load_file(str(EXAMPLE), ("approach.east=-2788.157526585351 m",)).problem.with_given(
        corridor_slope=0.32228452560523346
    ))  # fmt: skip
    assert -solved.objective == pytest.approx(1903.531052518, abs=1e-7) and solved.verification.level == 3
    with pytest.raises(pl.InfeasibleError, match="starts below the glide slope"):
        atlas.query(approach_east=-2711.68, corridor_slope=0.47708)


def on_the_moon(slope: float) -> pl.Problem:
    """Number 29 of these: from 0.1233769 rad on the engine is throttled for a moment before the slope is touched."""
    return precision_landing(
        Vehicle(mass=524.2230903236141, thrust=1506.6269475701417, specific_impulse=250.23911526570197),
        Approach(
            east=-730.2244768458867, north=-903.8394973622208, up=502.6656882915424,
            east_speed=-4.298649762587121, north_speed=7.078558817300382, up_speed=-15.769613686613555,
        ),
        Site(altitude=0.0, longitude=0.0, latitude=-1.1672140501849122),
        Corridor(slope=slope, pad_radius=3.1845544516259325),
        (0.189878026163245, 0.7631975668033675),
        MOON,
    )  # fmt: skip


def test_a_pair_of_switches_that_begins_is_found_from_its_first_instant() -> None:
    """The time between them rises in proportion from nothing (0.5 ms at the point drawn), J is smooth: none was found.

    What an instant on the other bound gains is linear in the slope, and what it loses a square of it: so is the best.
    """
    slopes, between, landed = (0.12337, 0.12338, 0.12339879781006839, 0.12345), list[float](), list[float]()
    for slope in slopes:
        solution = pl.solve(on_the_moon(slope), verify=2)
        assert solution.outcome is pl.Outcome.PROVED, str(solution.verification)
        coasts = [arc for arc in solution.structure if "lower" in arc.description]
        between.append(sum(arc.end - arc.begin for arc in coasts))
        landed.append(-solution.objective)
    assert between[0] == 0.0 and 5e-5 < between[1] < 1e-4
    rate = [(w - between[1]) / (slope - slopes[1]) for w, slope in zip(between[2:], slopes[2:], strict=True)]
    assert rate[0] == pytest.approx(rate[1], rel=2e-3)
    assert slopes[1] - between[1] / rate[0] == pytest.approx(0.12337692, abs=3e-8)  # where no instant gains anything
    falls = np.diff(landed) / np.diff(slopes)
    assert falls == pytest.approx(falls.mean(), rel=1e-3)


@pytest.mark.parametrize(("slope", "little"), [("0.5367892139328801 rad", True), ("0.8 rad", False)])
def test_arcs_are_looked_for_from_extremals_that_break_a_limit_by_little(slope: str, little: bool) -> None:
    """Extremals that break the slope by a quarter of the way cost a refusal seconds, and lead to no arcs."""
    problem = load_file(EXAMPLE, ["approach.east=-1416.2094665883978 m", f"corridor.slope={slope}"]).problem
    search = Search(Indirect(), problem, lambda _: None)
    with pytest.raises(pl.PeriluneError):
        search.solve()
    assert search.better_inadmissible
    assert bool(list(search.breaking_path())) == little
