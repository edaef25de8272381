"""Singular arcs by the indirect method: found without a guess, joined to arcs on bounds, and proved as extremals."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest

import perilune as pl
from perilune.conditions.singular_control import singular_control
from perilune.core import ignore_events
from perilune.methods.indirect.search import Search
from perilune.problem import Solution
from perilune.structures import Arc, Structure
from perilune.structures.detect_arcs import detect_structures
from perilune.structures.detect_regimes import EXACT, Stay, _between_breaks, read_stays
from perilune.structures.multiphase import restate
from perilune.structures.revise_regimes import revised_stays
from perilune.structures.split_join import join_solution
from problems.goddard import FOOT, goddard
from problems.singular import aly, aly_switch, aly_truth, following, fuller, nearest_to_zero, planar_goddard

THREE = ("upper", "singular", "lower")


@lru_cache
def climbed() -> Solution:
    return pl.solve(goddard(), verify=2)


@lru_cache
def rough() -> Solution:
    """A control that chatters along the singular arc."""
    return pl.Pseudospectral(nodes=5, segments=8, refine=0).run(goddard())


@pytest.mark.parametrize("middle", ["singular", "upper"])
def test_regimes_are_read_between_breaks_where_one_is_singular(middle: str) -> None:
    """From the lower bound to what has no gain, with a break within, to the upper; of bounds alone nothing is said."""
    t = np.linspace(0.0, 4.0, 401)
    inside = (t > 1.0) & (t < 3.0)
    share = np.where(t < 2.0, 0.0, 1.0) if middle == "upper" else np.where(inside, 0.5, t > 2.0)
    gain = np.where(inside & (middle == "singular"), 0.0, 2.0 - t)
    nodes = np.array([0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 4.0])
    found = _between_breaks("thrust", nodes, t, gain, share)
    wanted = [("lower", 0.0, 1.0), ("singular", 1.0, 3.0), ("upper", 3.0, 4.0)] if middle == "singular" else []
    assert found == [Stay(control="thrust", regime=r, begin=a, end=b) for r, a, b in wanted]


def structured(*arcs: tuple[str, float]) -> Structure:
    return Structure((tuple(Arc(regimes=(("thrust", regime),), until=until) for regime, until in arcs),))


def test_goddards_rocket_climbs_as_in_the_literature() -> None:
    """Betts 2010: 18550.872 ft; the rest by three phases of a direct method."""
    solution = climbed()
    assert -solution.objective / FOOT == pytest.approx(18550.87186382, abs=1e-6)
    assert solution.free["t_f"] == pytest.approx(42.8879117, abs=1e-6)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 2
    assert [arc.description for arc in solution.structure] == [
        "thrust at its upper bound", "thrust singular", "thrust at its lower bound",
    ]  # fmt: skip
    assert [arc.begin for arc in solution.structure] == pytest.approx([0.0, 13.75127, 21.98736], abs=1e-5)
    assert solution.extremals[0].nature.value == "best of the extremals found"


@pytest.mark.parametrize(
    "mesh",
    [
        pl.Pseudospectral(),
        pl.Pseudospectral(nodes=20, refine=0),
        pl.Pseudospectral(nodes=5, segments=16, refine=0),
        pl.Pseudospectral(nodes=3, segments=40, refine=0),
        pl.Pseudospectral(nodes=6, segments=60, refine=0),
    ],
)
def test_the_arcs_are_read_off_any_mesh(mesh: pl.Pseudospectral) -> None:
    found, *_ = detect_structures(goddard(), mesh.run(goddard()))
    assert [dict(arc.regimes)["thrust"] for arc in found.phases[0]] == list(THREE)


def test_arcs_that_are_none_are_dropped() -> None:
    """Aly's problem from a mesh that shows one arc too many: the extremal gives it no length."""
    coarse = pl.Pseudospectral(nodes=5, segments=8, refine=0).run(aly())
    solution = pl.solve(aly(), guess=coarse, verify=2)
    *_, dropped, kept = solution.statistics.attempts
    assert dropped == (
        "structure u at its lower bound, u at its upper bound, u singular: an extremal of another structure"
    )
    assert kept == "structure u at its lower bound, u singular: an extremal"
    assert len(solution.structure) == 2
    assert solution.objective == pytest.approx(aly_truth(), abs=1e-12)


def test_an_answer_is_its_own_guess() -> None:
    solution = climbed()
    again = pl.solve(goddard(), guess=solution, verify=2)
    assert again.objective == pytest.approx(solution.objective, rel=1e-12)
    assert again.extremals[0].nature.value == "an extremal near the guess"


def test_a_scalar_problem_has_its_closed_form() -> None:
    solution = pl.solve(nearest_to_zero(), verify=2)
    assert solution.outcome is pl.Outcome.PROVED
    assert solution.objective == pytest.approx(0.375, abs=1e-12)
    flown = solution.trajectories[0]
    assert np.abs(flown.state(np.linspace(1.05, 1.45, 9))[:, 0]).max() < 1e-12


def test_an_arc_may_be_singular_to_the_end() -> None:
    solution = pl.solve(aly(), verify=2)
    assert solution.outcome is pl.Outcome.PROVED
    assert solution.objective == pytest.approx(aly_truth(), abs=1e-12)
    assert solution.structure[1].begin == pytest.approx(aly_switch(), abs=1e-9)


def test_a_direction_may_turn_beside_the_singular_thrust() -> None:
    """In a plane: 2500 m down range at 5 m/s, which takes a burst of full thrust at the end; no mesh climbs higher."""
    problem = planar_goddard()
    solution = pl.solve(problem)
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    assert not any(c.name.endswith("_along") for c in solution.verification.checks)  # an empty tank holds nothing back
    assert [arc.description.removeprefix("thrust ") for arc in solution.structure] == [
        "at its upper bound", "singular", "at its lower bound", "at its upper bound",
    ]  # fmt: skip
    direct = pl.Pseudospectral(nodes=6, segments=32, refine=0).run(problem, guess=solution)
    assert direct.objective == pytest.approx(solution.objective, rel=1e-4)
    assert direct.objective > solution.objective


def test_switches_without_end_are_no_list_of_arcs() -> None:
    with pytest.raises(pl.NotConvergedError) as caught:
        pl.solve(fuller())
    assert "the control first appears in derivative 4 of dH/du" in str(caught.value.partial["attempts"])


def law(rate: ca.SX, slope: ca.SX, z: ca.SX, u: ca.SX) -> float:
    return float(ca.DM(ca.evalf(singular_control("u", slope, u, z, rate))))


def test_the_control_comes_from_the_second_derivative() -> None:
    """x'' = u, Phi = x: u = 0; with x'' = u - 2 - x at x = 1, u = 3."""
    z, u = ca.SX.sym("z", 2), ca.SX.sym("u")
    assert law(ca.vertcat(z[1], u), z[0], z, u) == 0.0
    found = singular_control("u", z[0], u, z, ca.vertcat(z[1], u - 2 - z[0]))
    assert float(ca.Function("f", [z], [found])([1.0, 0.0])) == 3.0


@pytest.mark.parametrize(
    ("rate", "says"),
    [
        (lambda z, u: ca.vertcat(u, 0, 0, 0), "derivative 1"),
        (lambda z, u: ca.vertcat(z[1], z[2], u, 0), "derivative 3"),
        (lambda z, u: ca.vertcat(z[1], z[2], z[3], u), "derivative 4"),
        (lambda z, u: ca.vertcat(z[1], z[0], 0, u), "none of the first 4"),
        (lambda z, u: ca.vertcat(z[1], u * u, 0, 0), "not linear"),
    ],
)
def test_other_orders_are_refused(rate, says: str) -> None:
    z, u = ca.SX.sym("z", 4), ca.SX.sym("u")
    with pytest.raises(pl.PeriluneError, match=says):
        singular_control("u", z[0], u, z, rate(z, u))


def test_what_only_cancels_is_no_control() -> None:
    """Phi' = z1 + (z0 - z0) u: the control is in its formula and not in it."""
    z, u = ca.SX.sym("z", 2), ca.SX.sym("u")
    rate = ca.vertcat(z[1] + u * (ca.sin(z[0]) ** 2 + ca.cos(z[0]) ** 2 - 1), u)
    assert law(rate, z[0], z, u) == pytest.approx(0.0, abs=1e-15)


def forced(durations: dict[str, float], *arcs: tuple[str, float]) -> Solution:
    """The extremal of a structure with some of its durations given: what a wrong structure leads to."""
    problem, structure = goddard(), structured(*arcs)
    restated = restate(problem, structure)
    given = {name: pl.Parameter(value=value, unit="s") for name, value in durations.items()}
    free = tuple(f for f in restated.free if f.name not in durations)
    fixed = restated.changed(given={**restated.given, **given}, free=free, form=None)
    near = pl.Pseudospectral(nodes=10, segments=2, refine=0).run(fixed)
    found = Search(pl.Indirect(), fixed, ignore_events).solve(near)
    every = {**found.free, **durations}
    whole = replace(found, problem=restated, free={name: every[name] for name in restated.free_names}, extremals=())
    return join_solution(problem, whole, structure)


@pytest.mark.parametrize("longer", [1.0, 1e-3])
def test_a_singular_arc_that_is_too_long_is_no_extremal(longer: float) -> None:
    wrong = forced({"t_f-2": 8.2360925 + longer}, ("upper", 13.75), ("singular", 21.99), ("lower", 42.89))
    assert pl.verify(wrong, level=1).verification.passed
    assert wrong.objective > climbed().objective
    failed = {check.name for check in pl.verify(wrong, level=2).verification.failed}
    assert any(name.endswith(("switching_thrust", "switch_thrust", "minimum_of_hamiltonian")) for name in failed)


def test_what_chatters_is_no_extremal() -> None:
    """A direct answer with its own costates, from a coarse mesh and from a fine one that was not refined."""
    for nodes, segments in ((5, 8), (5, 16), (20, 1)):
        mesh = pl.Pseudospectral(nodes=nodes, segments=segments, refine=0)
        dressed = replace(mesh.run(goddard()), method="indirect")
        assert not pl.verify(dressed, level=1).verification.passed


def test_a_control_that_is_averaged_flies_as_high_and_is_no_extremal() -> None:
    """The proved costates beside half the thrust of the singular arc for a moment, twice of it for the next."""
    solution = climbed()
    flown = solution.trajectories[0]
    at = (flown.control.time > 15.0) & (flown.control.time < 20.0)
    values = flown.control.values.copy()
    values[at] *= 1 + 1e-3 * (-1.0) ** np.arange(at.sum())[:, None]
    changed = replace(flown, control=replace(flown.control, values=values))
    assert not pl.verify(replace(solution, trajectories=(changed,)), level=2).verification.passed


def test_an_arc_on_the_worse_bound_is_cut() -> None:
    """A coast that begins too early: H is less at the upper bound for a while."""
    solution = climbed()
    (first, _, last) = read_stays(rough(), 0)[0, 5e-3]
    known = [replace(first, end=10.0), replace(last, begin=10.0, end=solution.trajectories[0].duration)]
    asked = revised_stays(solution, 0, known, 1e-5)
    assert asked is not None
    assert [stay.regime for stay in asked] == ["upper", "lower"]
    assert asked[0].end == pytest.approx(solution.structure[0].end, abs=0.1)


def test_regimes_that_an_extremal_keeps_are_kept() -> None:
    solution = climbed()
    ends = [arc.end for arc in solution.structure]
    seen = read_stays(rough(), 0)[0, 5e-3]
    stays = [replace(s, begin=begin, end=end) for s, begin, end in zip(seen, [0.0, *ends[:-1]], ends, strict=True)]
    assert revised_stays(solution, 0, stays, 1e-5) == stays
    gone = [stays[0], replace(stays[1], end=stays[1].begin + 1e-6), replace(stays[2], begin=stays[1].begin + 1e-6)]
    shorter = revised_stays(solution, 0, gone, 1e-5)
    assert shorter is None or [stay.regime for stay in shorter][:1] == ["upper"]


def test_a_speed_limit_is_ridden_in_the_place_of_the_singular_arc() -> None:
    """At 225 m/s, which the singular arc exceeds: what rides holds the thrust, and no regime beside it."""
    free = goddard()
    (phase,) = free.phases
    states = tuple(replace(s, upper=225.0) if s.name == "v" else s for s in phase.states)
    limited = free.changed(phases=(replace(phase, states=states),), form=None)
    solution = pl.solve(limited, verify=2)
    assert solution.outcome is pl.Outcome.PROVED
    assert climbed().objective < solution.objective < climbed().objective + 20.0
    assert "along the upper bound of v" in [arc.description for arc in solution.structure]


def test_a_target_too_fast_to_follow_is_left_and_met_again() -> None:
    """Two singular arcs between bounds, of which a coarse mesh shows one: every arc by the signs of the one before."""
    solution = pl.solve(following())
    assert solution.outcome is pl.Outcome.PROVED and solution.verification.level == 3
    words = [arc.description.removeprefix("u ") for arc in solution.structure]
    down, up, singular = "at its lower bound", "at its upper bound", "singular"
    assert words == [down, up, singular, down, singular, up]
    direct = pl.Pseudospectral(nodes=4, segments=60, refine=0).run(following(), guess=solution)
    assert direct.objective == pytest.approx(solution.objective, rel=1e-4)


def test_regimes_are_read_exactly_off_exact_tables() -> None:
    """As neighbours need them, for which no arc may be dropped or joined."""
    stays = read_stays(climbed(), 0)[EXACT]
    assert [stay.regime for stay in stays] == list(THREE)
    assert [stay.end for stay in stays] == [arc.end for arc in climbed().structure]
    assert read_stays(rough(), 0)[EXACT] == []
