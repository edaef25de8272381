"""What a search lists: every extremal once, and the better one among them."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import perilune as pl
from perilune.core import Matrix, ignore_events
from perilune.methods.indirect import cold_search
from perilune.methods.indirect.coarse_direct import Coarse
from perilune.methods.indirect.continuation import family_search
from perilune.methods.indirect.continuation.homotopy import Smoothing
from perilune.methods.indirect.indirect import Indirect
from perilune.methods.indirect.initializers import StartMembers
from perilune.methods.indirect.newton_trials import Trials
from perilune.methods.indirect.search_state import SearchState
from perilune.problem import Nature
from perilune.shooting.shooting_function import Roots, Shooting
from problems.circles import meeting, to_circle
from problems.constrained import brachistochrone, bryson_denham, bryson_denham_truth, speed_limit, speed_limit_truth


def test_mirror_images_are_listed_once() -> None:
    """Cycloids from rest to the line x = 1 m, free of the slope: T = sqrt((2k + 1) pi) s, and v may be negative."""
    problem = brachistochrone()
    free = replace(problem, phases=(replace(problem.phases[0], path=None),))
    times = [extremal.free["T"] for extremal in pl.solve(free, verify=0).extremals]
    assert times[0] == pytest.approx(np.sqrt(np.pi), abs=1e-9) and len(times) > 2
    turns = np.square(times) / np.pi
    assert turns == pytest.approx(np.round(turns), abs=1e-8)
    assert len(set(np.round(turns))) == len(turns)


def test_finer_meshes_are_asked_where_none_has_followed_a_smooth_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not where a condition on states holds the flight, beside which the control wavers on any mesh."""
    bound = brachistochrone()
    far_below = bound.with_given(offset=5.0)
    monkeypatch.setattr("perilune.methods.indirect.coarse_direct._CLOSE", 1e-3)
    said: list[object] = []
    assert len(list(Coarse(Indirect(), far_below, [], said.append).resolved())) == 1
    assert str(said[0]).startswith("direct method: ")
    monkeypatch.setattr("perilune.methods.indirect.coarse_direct._CLOSE", 1e-15)
    meshes = [len(found.trajectories[0].time) for found in Coarse(Indirect(), far_below, []).resolved()]
    assert len(meshes) == 4 and meshes == sorted(set(meshes))
    assert len(list(Coarse(Indirect(), bound, []).resolved())) == 1


def test_a_mesh_that_has_followed_a_flight_is_made_finer_where_newton_fails_from_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At 5e-4 its costates were too rough for a return, at 2e-5 not; a control that wavers does so on each."""
    coarse = Coarse(Indirect(), brachistochrone().with_given(offset=5.0), [])
    known = coarse.solve()
    assert known is not None
    for error, wavers, blurred in ((5e-4, False, True), (5e-4, True, False), (2e-3, True, True), (2e-5, False, False)):
        coarse.solution = replace(known, statistics=replace(known.statistics, residual=error))
        monkeypatch.setattr(
            "perilune.methods.indirect.coarse_direct.stays_between_bounds", lambda _, wavers=wavers: wavers
        )
        assert coarse.blurred is blurred


def mass(time: float, **orbits: float) -> float:
    return -pl.solve(to_circle(time, **orbits), verify=0).objective


def test_more_time_is_no_loss_on_the_way_to_a_circle() -> None:
    """Who has arrived may wait there: 0.87905 in 15 s; random costates alone find 0.548 in 30 s."""
    orbits = {"radius": 3.0, "exhaust_speed": 2.0, "eccentricity": 0.3}
    quick = pl.solve(to_circle(15.0, **orbits), verify=3)
    assert quick.outcome is pl.Outcome.PROVED
    slow = pl.solve(to_circle(30.0, **orbits), verify=0)
    assert -slow.objective >= -quick.objective - 1e-9
    assert slow.statistics.initialization == "continuation in the duration"
    assert any("fractions of the duration" in line for line in slow.statistics.attempts)
    listed = [extremal.objective for extremal in slow.extremals]
    assert listed == sorted(listed) and len(listed) > 4
    assert any(line.startswith("smoothed controls") for line in slow.statistics.attempts)


def test_smoothed_extremals_lead_to_a_better_one() -> None:
    """50 s with 0.03 N: 0.879549 of the mass by switched extremals alone, 0.879997 known from many trials by hand."""
    problem = to_circle(50.0, radius=3.0, exhaust_speed=2.0, eccentricity=0.3, thrust=0.03)
    found = Smoothing(trials=Trials(problem, ignore_events), segments=1).from_short_flights(24, 0)
    masses = sorted((-root.cost for root in found), reverse=True)
    assert masses[0] == pytest.approx(0.880026989, abs=1e-8)
    assert any(mass == pytest.approx(0.879996864, abs=1e-8) for mass in masses)


def test_from_circle_to_circle_it_may_wait_at_both_ends() -> None:
    """Extremals that are not isolated are found, listed once, and said to be such."""
    orbits = {"radius": 2.0, "exhaust_speed": 1.0, "eccentricity": 0.0}
    solution = pl.solve(to_circle(10.0, **orbits), verify=2)
    assert -solution.objective == pytest.approx(mass(9.0, **orbits), abs=1e-9)
    assert len(solution.extremals) == 1
    assert any("not isolated" in line for line in solution.statistics.attempts)
    assert mass(20.0, **orbits) >= -solution.objective - 1e-9


def test_four_revolutions_with_nine_switches() -> None:
    """The first mesh cannot follow it; called a singular arc once, for what that mesh made of its thrust."""
    problem = meeting(4)
    solution = pl.solve(problem, verify=0)
    assert (np.diff(solution.trajectories[0].time) == 0).sum() == 9
    # Refined, as a first mesh is wrong by 5e-3; from a straight line it ends at a local optimum beside, 7e-5 worse.
    direct = pl.Pseudospectral(nodes=5, segments=24, refine=4, tolerance=1e-4).run(problem)
    assert direct.objective == pytest.approx(solution.objective, abs=1e-4)
    assert direct.objective > solution.objective - 1e-6


def test_where_none_is_reached_it_is_said_that_they_are_not_isolated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method alone comes as near as rounding lets it, which is no root; said with the nearest approach."""

    def isolated(shooting: Shooting, roots: Roots, p: Matrix) -> Roots:
        return roots.failed(np.array([root.open_directions > 0 for root in roots]))

    monkeypatch.setattr("perilune.methods.indirect.newton_trials.complete_open_roots", isolated)
    monkeypatch.setattr(
        "perilune.methods.indirect.continuation.duration_continuation.FinalTimeContinuation.extremals", lambda self: []
    )
    monkeypatch.setattr("perilune.methods.indirect.continuation.homotopy.Smoothing.root", lambda self, choice: None)
    with pytest.raises(pl.NotConvergedError, match=r"(?s)nearest approach.*not isolated.*an additional end condition"):
        pl.solve(to_circle(12.0, radius=2.0, exhaust_speed=1.0, eccentricity=0.0), pl.Indirect(starts=48), verify=0)


def test_a_root_beside_which_nothing_is_known_ends_no_solve() -> None:
    """J^-1 of what one of the starts leads to is not finite: the flight that keeps the limit is found by others."""
    found = pl.solve(speed_limit(25.0).with_given(g=2.2), verify=0)
    assert -found.objective == pytest.approx(speed_limit_truth(25.0, g=2.2)[2], rel=1e-10)


def wells(tied: float) -> pl.Problem:
    """x(1) = q at least int u^2/2, which is taken off again, with two wells of J along q and two along r."""

    def price(q: Any, r: Any) -> Any:
        along_q = 8.0 * (q - 0.2) ** 2 * (q - 0.97) ** 2 - 0.3 * q
        return along_q + 8.0 * (r - 0.3) ** 2 * (r - 0.95) ** 2 - 0.2 * r + tied * q * r

    phase = pl.Phase(
        name="way",
        states=(pl.Variable(name="x", unit="1"), pl.Variable(name="c", unit="1/s")),
        controls=(pl.ScalarControl(name="u", unit="1/s"),),
        dynamics=lambda x, u, p, xp: (u.u, 0.5 * u.u * u.u),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.q,), there="1"),
    )
    return pl.Problem(
        name="wells",
        phases=(phase,),
        start=lambda p, xp: (0.0 * p.one / p.T, 0.0 / p.T),
        given={"T": pl.Parameter(value=1.0, unit="s"), "one": pl.Parameter(value=1.0, unit="s")},
        free=tuple(pl.FreeParameter(name=name, unit="1", lower=0.0, upper=1.0, guess=0.5) for name in "qr"),
        objective=lambda x, p, xp: p.one * x.c - 0.5 * p.q * p.q + price(p.q, p.r),
        objective_unit="1",
    )


@pytest.mark.parametrize("tied", [0.3, 0.0, -0.3])
def test_of_several_parameters_between_bounds_each_is_looked_along_from_every_extremal(tied: float) -> None:
    """Along q alone r stayed in its well; where its well ended the corner, which is the best, was not found at all."""
    found = pl.solve(wells(tied), verify=3)
    q, r = np.meshgrid(*2 * (np.linspace(0.0, 1.0, 501),), indexing="ij")
    J = 8.0 * ((q - 0.2) * (q - 0.97)) ** 2 - 0.3 * q + 8.0 * ((r - 0.3) * (r - 0.95)) ** 2 - 0.2 * r + tied * q * r
    assert found.outcome is pl.Outcome.PROVED and found.objective == pytest.approx(J.min(), abs=1e-4)
    least = np.pad(J, 1, constant_values=np.inf)
    around = [np.roll(least, shift, (0, 1))[1:-1, 1:-1] for shift in product((-1, 0, 1), repeat=2) if any(shift)]
    at = np.nonzero(np.all([J <= other for other in around], axis=0))
    optima = [e.free for e in found.extremals if e.nature is not Nature.WORST]
    truth = sorted(zip(J[at].tolist(), q[at].tolist(), r[at].tolist(), strict=True))
    assert [(e["q"], e["r"]) for e in optima] == [pytest.approx(there, abs=3e-3) for _, *there in truth]


def test_the_better_well_is_found_where_in_it_alone_the_flight_is_held_back() -> None:
    """Below 0.8 m/s the ceiling is far, and no answer that is met touches it; the direct method begins there, too."""

    def price(v: Any) -> Any:
        return 100.0 * (v - 0.65) ** 2 * (v - 1.5) ** 2 - 9.0 * v

    plain = bryson_denham(0.2)
    given = {name: one for name, one in plain.given.items() if name != "speed"}
    units = {"one": pl.Parameter(value=1.0, unit=plain.objective_unit), "pace": pl.Parameter(value=1.0, unit="m/s")}
    problem = replace(
        plain,
        free=(pl.FreeParameter(name="speed", unit="m/s", lower=0.6, upper=1.6, guess=0.65),),
        given={**given, **units},
        objective=lambda x, p, xp: plain.objective(x, p, xp) + p.one * price(p.speed / p.pace),
    )
    v = np.linspace(1.3, 1.6, 30_001)  # the other well, at 0.7 m/s, is worse by 0.96
    truth = min(v**2 * np.array([bryson_denham_truth(0.2 / v) for v in v.tolist()]) + price(v))
    found = pl.solve(problem, verify=3)
    assert found.outcome is pl.Outcome.PROVED and found.objective == pytest.approx(truth, abs=1e-7)
    assert [e.free["speed"] for e in found.extremals] == pytest.approx([1.45822, 0.70201], abs=1e-5)


def test_members_beyond_a_bound_do_not_hide_those_behind_them() -> None:
    """Nor does one that was walked through; one that breaks a condition comes last, and is said."""
    out, old, breaking, kept = (
        SimpleNamespace(root=SimpleNamespace(name=n, open_directions=0)) for n in ("out", "", "bad", "")
    )
    state = SimpleNamespace(
        trials=SimpleNamespace(outside=lambda root: "T" if root.name == "out" else None),
        judge=SimpleNamespace(breach=lambda root: root.name or None),
        walked_through=lambda member: member is old, tried=[], broken=[], breaking=[], base=None,
    )  # fmt: skip
    ways = [StartMembers(cast("Any", [out, old, breaking, kept]), "family", "walked")]
    met = cold_search._members_in_bounds(cast("SearchState", state), ways)
    assert list(met) == [(kept, "family"), (breaking, "family")]
    assert state.broken == ["bad"] and state.tried == ["walked, 3 extremals, 1 of them breaks a condition"]


@pytest.mark.parametrize(("converged", "held", "known"), [(True, True, 3), (False, True, 1), (True, False, 1)])
def test_at_the_limits_of_a_range_what_newton_loses_or_lets_go_is_no_extremal(
    converged: bool, held: bool, known: int
) -> None:
    """Beside a maximum of J over the range; the limit that is infinite is nothing to look at."""
    places = iter((2.0, 3.0))

    def settled(Y: Any, choice: Any, limits: Any) -> list[Any]:
        root = SimpleNamespace(y=Y[0] + next(places), converged=converged, choice=choice.copy())
        root.choice[0] = float(held)
        return [root]

    plan = SimpleNamespace(free=0, hold=lambda choice, i, limit: choice.__setitem__(i, 1.0))
    root = SimpleNamespace(y=np.zeros(1), converged=True, choice=np.zeros(2))
    shooting = SimpleNamespace(plan=plan, curving_down=lambda one, p: [0] if one is root else [])
    limits = SimpleNamespace(lower=np.array([-1.0]), upper=np.array([1.0]))
    state = SimpleNamespace(trials=SimpleNamespace(shooting=shooting, limits=limits, p=None, settled=settled))
    found = family_search._over_ranges(cast(SearchState, state), cast(Any, root))
    assert [f.minimum for f in found] == [False, True, True][:known]
