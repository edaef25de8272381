"""Kinks and jumps of the physics: the proof finds them by itself, crosses them, and knows when it cannot."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import perilune as pl
from perilune.core import NUMERIC
from perilune.problem import Curve, Solution, Trajectory
from perilune.proof.feasible.branch_guards import watched_rates
from perilune.proof.feasible.phase_data import PhaseData
from perilune.proof.feasible.switching_surfaces import Guarded
from perilune.proof.necessary.first_order import parameter_gradient, phase_end_multipliers
from test_control_law import given, variables
from test_language import layered, refraction


def _built_up(x: Any, p: Any, xp: Any) -> Any:
    above = p.k * x.x / p.L
    above -= p.k * p.xs / p.L
    return xp.fmax(above, 0 * p.k)


STEP = pl.Table((0.0, 0.3, 1.0), (0.0, 0.0, 0.7), "linear")
# The same kink at x = 30 m of a slope that rises from there, in five ways of writing it, and a jump.
SLOPES: dict[str, Any] = {
    "jump": lambda x, p, xp: xp.where(x.x > p.xs, p.k, 0 * p.k),
    "where": lambda x, p, xp: xp.where(x.x > p.xs, p.k * (x.x - p.xs) / p.L, 0 * p.k),
    "fmax": lambda x, p, xp: xp.fmax(p.k * (x.x - p.xs) / p.L, 0 * p.k),
    "built up": _built_up,
    "fabs": lambda x, p, xp: 0.5 * p.k * (x.x - p.xs + xp.fabs(x.x - p.xs)) / p.L,
    "linear": lambda x, p, xp: p.k * xp.table(STEP, x.x / p.L),
}


def push(slope: Any, **numbers: tuple[float, str]) -> pl.Problem:
    """From rest to rest over 100 m in 20 s with the least int a^2/2, up a slope that begins at 30 m."""
    phase = pl.Phase(
        name="push",
        states=variables(x="m", v="m/s", e="m^2/s^3"),
        controls=(pl.ScalarControl(name="a", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.a - slope(x, p, xp), u.a**2 / 2),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.L, x.v), place="m", stop="m/s"),
        end_guess=lambda p, xp: (p.L, 0.0, 1.0),
    )
    return pl.Problem(
        name="push", phases=(phase,), start=lambda p, xp: (0.0, 0.0, 0.0),
        given=given(T=(20.0, "s"), L=(100.0, "m"), xs=(30.0, "m"), k=(0.3, "m/s^2"), **numbers),
        objective=lambda x, p, xp: x.e, objective_unit="m^2/s^3", scales=pl.Scales(length=100.0, time=10.0, mass=1.0),
    )  # fmt: skip


@pytest.fixture(scope="module")
def jump() -> Solution:
    return pl.solve(push(SLOPES["jump"]))


def arc_of(solution: Solution) -> PhaseData:
    return PhaseData(solution=solution, index=0)


# --- right answers


@pytest.mark.parametrize("kind", list(SLOPES))
def test_an_answer_across_a_kink_is_proved(kind: str) -> None:
    solution = pl.solve(push(SLOPES[kind]))
    assert solution.outcome is pl.Outcome.PROVED, str(solution.verification)
    assert solution.verification.level == 3
    assert len(arc_of(solution).crossings) == 1
    if kind == "jump":
        assert solution.objective == pytest.approx(by_hand(), rel=1e-9)
    else:
        assert solution.objective == pytest.approx(6.28570121266, abs=1e-10)


def by_hand() -> float:
    """Two arcs of cubic splines, the speed and time at the jump chosen by Nelder and Mead's method."""
    from scipy.optimize import minimize

    def energy(d: float, a: float, b: float, T: float) -> float:
        return 6 * d * d / T**3 - 6 * d * (a + b) / T**2 + 2 * (a * a + a * b + b * b) / T

    k = 0.3

    def total(z: Any) -> float:
        # Uphill (a - k)^2 / 2 is what counts: a^2/2 = b^2/2 + k b + k^2/2 with b = v'.
        w, t = z
        return energy(30.0, 0.0, w, t) + energy(70.0, w, 0.0, 20.0 - t) - k * w + k * k * (20.0 - t) / 2

    starts = [(w, t) for w in (3.0, 6.0, 9.0) for t in (5.0, 8.0, 11.0)]
    options = {"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000}
    return float(min(minimize(total, s, method="Nelder-Mead", options=options).fun for s in starts))


@pytest.mark.parametrize("slow", [0.5, 0.9, 1.5])
def test_refracted_light_is_proved(slow: float) -> None:
    assert pl.solve(refraction(slow)).verification.level == 3


@pytest.mark.parametrize("kind", ["where", "table"])
def test_a_fall_through_layers_is_proved(kind: str) -> None:
    assert pl.solve(layered(kind)).verification.level == 3


def test_a_loaded_problem_is_proved_the_same(jump: Solution, tmp_path: Any) -> None:
    """Its physics are expressions, whose comparisons are found likewise."""
    pl.save(jump, tmp_path / "push")
    loaded = pl.load(tmp_path / "push")
    again = pl.verify(loaded, level=3).verification
    assert again.level == 3
    assert "expressions" in again.source
    assert arc_of(loaded).crossings[0].time == arc_of(jump).crossings[0].time


# --- what crosses


def test_a_deviation_crosses_by_the_saltation_matrix(jump: Solution) -> None:
    """Against two neighbouring flights by SciPy with an event at the jump, the control as in the tables."""
    arc = arc_of(jump)
    (crossing,) = arc.crossings
    t0, t1 = crossing.time - 0.5, crossing.time + 0.5
    k = jump.problem.given["k"].value

    def flown(d: np.ndarray) -> np.ndarray:
        x, t = arc.state(np.array([t0]))[:, 0] + d, t0

        def event(t: float, x: np.ndarray) -> float:
            return x[0] - 30.0

        event.terminal = True  # type: ignore[attr-defined]
        for up in (0.0, k):

            def rates(t: float, x: np.ndarray, up: float = up) -> list[float]:
                a = float(arc.control(np.array([t]))[0, 0])
                return [x[1], a - up, 0.5 * a * a]

            out = solve_ivp(
                rates, (t, t1), x, method="DOP853", rtol=1e-11, atol=1e-12, events=event if up == 0 else None
            )
            x, t = out.y[:, -1], out.t[-1]
        return x

    h = 1e-3
    numeric = np.column_stack([(flown(h * e) - flown(-h * e)) / (2 * h) for e in np.eye(3)])
    smooth = np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    scale = np.diag(arc.state_scale)
    S = scale @ crossing.saltation @ np.linalg.inv(scale)
    assert numeric == pytest.approx(smooth @ S @ smooth, abs=1e-5)
    assert abs(S[1, 0]) > 0.01
    assert crossing.adjoint == pytest.approx(np.linalg.inv(crossing.saltation).T, abs=1e-13)


def test_the_optimum_changes_with_the_place_of_the_jump_as_the_multiplier_says(jump: Solution) -> None:
    """dJ/dxs through the guard alone, against problems solved with the slope a little further on."""
    arc = arc_of(jump)
    slope = parameter_gradient([arc], [phase_end_multipliers(arc)[0]], "xs")
    ahead, behind = (pl.solve(push(SLOPES["jump"]).with_given(xs=30.0 + h), verify=0).objective for h in (0.01, -0.01))
    assert slope == pytest.approx((ahead - behind) / 0.02, rel=1e-5)
    assert abs(slope) > 1e-2


def test_a_guard_is_held_on_either_side() -> None:
    phase = push(SLOPES["fmax"]).phases[0]
    p = push(SLOPES["fmax"]).parameters({})
    x, u = np.array([[20.0, 40.0], [1.0, 1.0], [0.0, 0.0]]), np.zeros((1, 2))
    f, s, answers = watched_rates(phase, x, u, p)
    assert s.real[0] == pytest.approx([-0.03, 0.03])
    assert answers.tolist() == [[False, True]]
    assert f.real[1] == pytest.approx([0.0, -0.03])
    assert watched_rates(phase, x, u, p, held=[True])[0].real[1] == pytest.approx([0.03, -0.03])
    assert watched_rates(phase, x, u, p, held=[False])[0].real[1] == pytest.approx([0.0, 0.0])


@pytest.mark.parametrize("kind", ["smooth", "smoother", "monotone", "linear"])
def test_watched_tables_and_functions_are_what_they_are_unwatched(kind: Any) -> None:
    table = pl.Table((0.0, 1.0, 2.0, 4.0), (1.0, 3.0, 3.5, 3.6), kind)
    phase = pl.Phase(
        name="a", states=variables(x="1", y="1"), duration="T",
        dynamics=lambda x, u, p, xp: (
            xp.table(table, x.x) + xp.atan2(x.y, 2.0 + x.x) * xp.fmin(x.x, x.y) - abs(x.y) ** 2 / xp.fabs(x.y - 3.0),
            2.0 * xp.where(p.c <= x.x, xp.sin(x.x), -x.y) - xp.fmax(1.0, x.x),
        ),
    )  # fmt: skip
    p = type("P", (), {"c": 1.5})
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1, 5, (2, 50)), np.zeros((0, 50))
    found, differences, _ = watched_rates(phase, x, u, p)
    assert found.real == pytest.approx(np.array(phase.rates(x, u, p, NUMERIC)), abs=1e-14)
    assert len(differences) == {"smooth": 2, "smoother": 2, "monotone": 4, "linear": 4}[kind] + 5


@pytest.mark.parametrize("at", np.linspace(0.11, 0.87, 7))
def test_a_short_dip_across_a_guard_is_two_crossings(at: float) -> None:
    """y = (t - c)^2 - d inside one piece of a table, its ends far above."""
    depth = 1e-6
    phase = pl.Phase(
        name="dive", states=variables(y="m", w="m/s"), duration="T",
        dynamics=lambda x, u, p, xp: (x.w, xp.where(x.y > p.ground, p.g, 2 * p.g)),
    )  # fmt: skip
    problem = pl.Problem(
        name="dive", phases=(phase,), start=lambda p, xp: (p.ground, p.w0), objective=lambda x, p, xp: x.y,
        objective_unit="m", given=given(g=(2.0, "m/s^2"), T=(1.0, "s"), ground=(0.0, "m"), w0=(-1.0, "m/s")),
    )  # fmt: skip
    t = np.array([0.0, 1.0])
    state = Curve(
        time=t, values=np.column_stack([(t - at) ** 2 - depth, 2 * (t - at)]),
        rates=np.column_stack([2 * (t - at), np.full(2, 2.0)]),
    )  # fmt: skip
    empty = Curve(time=t, values=np.zeros((2, 0)), rates=np.zeros((2, 0)))
    solution = Solution(
        problem=problem, method="by hand", outcome=pl.Outcome.SOLVED, objective=0.0, free={},
        trajectories=(Trajectory(phase="dive", state=state, control=empty),),
    )  # fmt: skip
    assert arc_of(solution).crossed == pytest.approx([at - 1e-3, at + 1e-3], abs=1e-9)


# --- wrong ones


STRIPS: dict[str, Any] = {
    "square": lambda x, p, xp: (x.x - p.xs) ** 2 < p.half**2,
    "built up": _built_up,
    "fabs": lambda x, p, xp: xp.fabs(x.x - p.xs) < p.half,
    "power": lambda x, p, xp: p.L**6 * p.half**2 > (x.x - p.xs) ** 4 * (x.x + p.xs) ** 2 * x.x**2,
    "sine": lambda x, p, xp: xp.sin(20 * (x.x - p.xs) / p.L) ** 2 < (p.half / p.L) ** 2,
}


@pytest.mark.parametrize("form", list(STRIPS))
@pytest.mark.parametrize("half", [1.0, 1e-2, 1e-4, 1e-6])
def test_a_narrow_strip_that_nobody_saw_is_found(half: float, form: str) -> None:
    """The best flight on the flat, claimed to be one where a strip around 43.21 m slows it, however narrow that is."""
    problem = push(lambda x, p, xp: xp.where(STRIPS[form](x, p, xp), p.k, 0 * p.k), half=(half, "m"))
    problem = problem.with_given(xs=43.21, k=0.1 / half)
    flat = pl.solve(push(lambda x, p, xp: 0 * p.k), verify=0)
    missed = pl.verify(replace(flat, problem=problem), level=1).verification
    assert {"place", "stop", "state_x", "state_v"} <= {c.name for c in missed.failed}
    meaning = next(c.meaning for c in missed.failed if c.name == "state_x")
    assert "a switch by x changes the rates, but the table has no break" in meaning


def test_costates_that_do_not_jump_fail(jump: Solution) -> None:
    flown = jump.trajectories[0]
    assert flown.costate is not None
    (k,) = np.nonzero(np.diff(flown.costate.time) == 0)[0]
    change = flown.costate.values[k] - flown.costate.values[k + 1]
    assert abs(change[0]) > 1e-3
    values = flown.costate.values.copy()
    values[k + 1 :] += change
    same = replace(flown, costate=replace(flown.costate, values=values))
    names = {c.name for c in pl.verify(replace(jump, trajectories=(same,)), level=2).verification.failed}
    assert {"costate_x", "hamiltonian_constant"} <= names


@pytest.mark.parametrize("late", [1e-5, -1e-5])
def test_a_break_of_the_tables_away_from_the_jump_fails(jump: Solution, late: float) -> None:
    def moved(curve: Curve) -> Curve:
        time = curve.time.copy()
        (k,) = np.nonzero(np.diff(time) == 0)[0]
        time[k : k + 2] += late
        return replace(curve, time=time)

    flown = jump.trajectories[0]
    assert flown.costate is not None
    wrong = replace(flown, state=moved(flown.state), costate=moved(flown.costate), control=moved(flown.control))
    names = {c.name for c in pl.verify(replace(jump, trajectories=(wrong,)), level=2).verification.failed}
    assert {"state_x", "costate_x"} <= names


def lens(radius: float) -> Solution:
    """Light along the axis of a lens: from (-1, 0) to (1, 0), the glass (speed 1/2) behind x = y^2/(2 R).

    Fermat's time over the height at which it crosses is 3 + (3 - 1/R) y^2/2: the least for R > 1/3, and for less a
    better ray lies beside it.
    """
    phase = pl.Phase(
        name="ray",
        states=variables(x="m", y="m"),
        controls=(pl.UnitVectorControl(names=("cx", "cy")),),
        dynamics=lambda x, u, p, xp: tuple(
            xp.where(x.x > 0.5 * x.y * x.y / p.R, p.slow, p.fast) * c for c in (u.cx, u.cy)
        ),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.far, x.y), across="m", height="m"),
    )
    problem = pl.Problem(
        name="lens", phases=(phase,), start=lambda p, xp: (-p.far, 0.0),
        given=given(fast=(1.0, "m/s"), slow=(0.5, "m/s"), far=(1.0, "m"), R=(radius, "m")),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.0, upper=20.0, guess=3.0),),
        objective=lambda x, p, xp: p.T, objective_unit="s",
    )  # fmt: skip
    t = np.array([0.0, 0.5, 1.0, 1.0, 2.0, 3.0])
    after = np.arange(6) > 2
    speed, zero = np.where(after, 0.5, 1.0), np.zeros(6)
    state = Curve(
        time=t, values=np.column_stack([np.where(after, 0.5 * (t - 1), t - 1), zero]),
        rates=np.column_stack([speed, zero]),
    )  # fmt: skip
    costate = Curve(time=t, values=np.column_stack([-1 / speed, zero]), rates=np.zeros((6, 2)))
    control = Curve(time=t, values=np.column_stack([zero + 1, zero]), rates=np.zeros((6, 2)))
    return Solution(
        problem=problem, method="closed form", outcome=pl.Outcome.SOLVED, objective=3.0, free={"T": 3.0},
        trajectories=(Trajectory(phase="ray", state=state, control=control, costate=costate),),
    )  # fmt: skip


@pytest.mark.parametrize("radius", [0.2, 0.32, 0.33, 0.336, 0.35, 1.0, 1e3, -1.0])
def test_a_ray_through_a_lens_is_the_fastest_until_its_focus(radius: float) -> None:
    checks = {
        c.name: c for c in pl.verify(lens(radius), level=3, resolve=lambda problem, guess: guess).verification.checks
    }
    assert all(c.passed for c in checks.values() if c.level <= 2), [c for c in checks.values() if not c.passed]
    assert checks["conjugate_point"].passed == (radius < 0 or radius > 1 / 3)


def slide(start: float) -> Solution:
    """x' = -sign(x): from `start` to 0, and then along it, claimed to stay there with x = 0."""
    phase = pl.Phase(
        name="slide", states=variables(x="m"), duration="T",
        dynamics=lambda x, u, p, xp: (xp.where(x.x > 0 * p.one, -p.rate, p.rate),),
    )  # fmt: skip
    problem = pl.Problem(
        name="slide", phases=(phase,), start=lambda p, xp: (p.x0,), objective=lambda x, p, xp: x.x, objective_unit="m",
        given=given(T=(2.0, "s"), one=(1.0, "m"), rate=(1.0, "m/s"), x0=(start, "m")),
    )  # fmt: skip
    t, x = np.array([0.0, 1.0, 1.0, 2.0]), np.array([start, start - 1.0, start - 1.0, start - 2.0])
    state = Curve(time=t, values=x[:, None], rates=np.full((4, 1), -1.0))
    empty = Curve(time=t, values=np.zeros((4, 0)), rates=np.zeros((4, 0)))
    return Solution(
        problem=problem, method="by hand", outcome=pl.Outcome.SOLVED, objective=float(x[-1]), free={},
        trajectories=(Trajectory(phase="slide", state=state, control=empty),),
    )  # fmt: skip


def test_a_flight_that_would_have_to_slide_is_not_proved() -> None:
    assert pl.verify(slide(3.0), level=1).verification.passed
    verification = pl.verify(slide(1.0), level=1).verification
    assert "state_x" in {c.name for c in verification.failed}
    assert math.isnan(next(c.value for c in verification.checks if c.name == "state_x"))


def crossing_two(
    rates: Any, t: np.ndarray, xy: np.ndarray, slopes: np.ndarray, control: float | None = None
) -> Solution:
    """A flight of x and y by hand, its tables given at times t, and a constant control where there is one."""
    phase = pl.Phase(
        name="go", states=variables(x="m", y="m"), duration="T", dynamics=rates,
        controls=() if control is None else (pl.ScalarControl(name="a", unit="m"),),
    )  # fmt: skip
    problem = pl.Problem(
        name="go", phases=(phase,), start=lambda p, xp: (p.x0, p.y0), objective=lambda x, p, xp: x.x,
        objective_unit="m", given=given(T=(float(t[-1]), "s"), x0=(float(xy[0, 0]), "m"), y0=(float(xy[0, 1]), "m"),
                                        v=(1.0, "m/s"), L=(1.0, "m"), zero=(0.0, "m")),
    )  # fmt: skip
    u = np.zeros((len(t), 0)) if control is None else np.full((len(t), 1), control)
    flown = Trajectory(
        phase="go", state=Curve(time=t, values=xy, rates=slopes), control=Curve(time=t, values=u, rates=0 * u)
    )
    return Solution(
        problem=problem, method="by hand", outcome=pl.Outcome.SOLVED, objective=float(xy[-1, 0]), free={},
        trajectories=(flown,),
    )  # fmt: skip


@pytest.mark.parametrize("apart", [0.0, 0.2])
def test_at_a_corner_of_two_jumps_nothing_is_known_of_neighbours(apart: float) -> None:
    """Which of the two a neighbour crosses first decides where it goes; one after the other they are understood."""

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
        return xp.where(x.y > p.zero, p.v, 2 * p.v), xp.where(x.x > p.zero, 2 * p.v, p.v)

    # x meets its border at 0.5 s; y goes twice as fast from there, and meets its own `apart` s later.
    meets = 0.5 + apart
    t = np.repeat([0.0, 0.5, meets, 1.0], [1, 2, 2, 1]) if apart else np.array([0.0, 0.5, 0.5, 1.0])
    before_x, before_y = t <= 0.5, t <= meets
    x = np.where(before_y, 2 * (t - 0.5), 2 * apart + t - meets)
    y = np.where(before_x, t - 0.5 - 2 * apart, 2 * (t - meets))
    sides = np.array([*([0] * 2), *([1] * (len(t) - 4)), *([2] * 2)])
    slopes = np.column_stack([np.where(sides == 2, 1.0, 2.0), np.where(sides == 0, 1.0, 2.0)])
    solution = crossing_two(rates, t, np.column_stack([x, y]), slopes)
    verification = pl.verify(solution, level=1).verification
    assert verification.passed == bool(apart), str(verification)
    assert np.isnan(arc_of(solution).crossings[0].speeds).all() == (not apart)


def test_a_corner_of_two_kinks_without_a_jump_is_passed() -> None:
    """x' = v (1 + |x|/L), and y likewise: from -1 both reach 0 at log 2 s, by 1 - 2 e^-t, then e^(t - log 2) - 1."""

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
        return p.v * (1 + xp.fabs(x.x) / p.L), p.v * (1 + xp.fabs(x.y) / p.L)

    t = np.linspace(0.0, 2 * math.log(2), 801)
    x = np.where(t <= math.log(2), 1 - 2 * np.exp(-t), 0.5 * np.exp(t) - 1)
    solution = crossing_two(rates, t, np.column_stack([x, x]), np.column_stack([1 + np.abs(x)] * 2))
    assert pl.verify(solution, level=1).verification.passed, str(pl.verify(solution, level=1).verification)


def test_a_kink_that_a_control_moves_without_a_jump_is_passed() -> None:
    """y' = v |x + a|/L: what is zero there but for rounding is no jump."""

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
        return p.v, p.v * xp.fabs(x.x + u.a) / p.L

    t = np.array([0.0, 0.5, 1.0])
    xy = np.column_stack([t - 0.6, np.sign(t - 0.5) * (t - 0.5) ** 2 / 2])
    solution = crossing_two(rates, t, xy, np.column_stack([np.ones(3), np.abs(t - 0.5)]), control=0.1)
    assert pl.verify(solution, level=1).verification.passed, str(pl.verify(solution, level=1).verification)


def test_rounding_at_a_kink_is_no_jump() -> None:
    """The same where the place of the kink is only known to 1e-13, being a difference of large numbers."""

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
        return p.v, p.v * xp.fabs((1000 * p.L + x.x) + u.a - 1000 * p.L) / p.L

    t = np.array([0.0, 0.5, 1.0])
    xy = np.column_stack([t - 0.6, np.sign(t - 0.5) * (t - 0.5) ** 2 / 2])
    solution = crossing_two(rates, t, xy, np.column_stack([np.ones(3), np.abs(t - 0.5)]), control=0.1)
    assert pl.verify(solution, level=1).verification.passed, str(pl.verify(solution, level=1).verification)


@pytest.mark.parametrize("share", [1e-2, 1e-7, 1e-11])
def test_a_small_jump_is_one(share: float) -> None:
    """y' = v behind x = 0, and more by a share of it."""

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
        return p.v, xp.where(x.x > p.zero, (1 + share) * p.v, p.v)

    t = np.array([0.0, 0.5, 0.5, 1.0])
    faster = np.where(np.arange(4) > 1, 1 + share, 1.0)
    xy = np.column_stack([t - 0.5, faster * (t - 0.5)])
    (crossing,) = arc_of(crossing_two(rates, t, xy, np.column_stack([np.ones(4), faster]))).crossings
    # Sizes of x and y are 1 m here, and so are speeds.
    assert crossing.jump == pytest.approx([0.0, share], rel=1e-4, abs=0)
    assert crossing.saltation == pytest.approx(np.array([[1.0, 0.0], [share, 1.0]]), rel=1e-4, abs=0)


def test_a_jump_that_a_control_moves_is_not_understood() -> None:
    """Where neighbours cross depends on what the control does there."""

    def rates(x: Any, u: Any, p: Any, xp: Any) -> Any:
        return p.v, xp.where(x.x + u.a > p.zero, 2 * p.v, p.v)

    t = np.array([0.0, 0.5, 0.5, 1.0])
    x, y = t - 0.6, np.where(t <= 0.5, t, 2 * t - 0.5)
    slopes = np.column_stack([np.ones(4), [1.0, 1.0, 2.0, 2.0]])
    solution = crossing_two(rates, t, np.column_stack([x, y]), slopes, control=0.1)
    assert not pl.verify(solution, level=1).verification.passed
    assert np.isnan(arc_of(solution).crossings[0].speeds).all()


@pytest.mark.parametrize(("before", "after", "zeros"), [(-1.0, 1.0, []), (1.0, -1.0, []), (-2.0, -1.0, [3.0])])
def test_a_control_that_jumps_across_a_guard_has_no_zero_of_it(before: float, after: float, zeros: list[float]) -> None:
    """A break at which the guard stays on its side hides none behind it: there u = t - 3."""
    phase = push(SLOPES["jump"]).phases[0]
    phase = replace(phase, dynamics=lambda x, u, p, xp: (x.v, xp.where(u.a > 0 * p.k, u.a, 2 * u.a), 0 * u.a**2))
    t = np.array([0.0, 2.0, 2.0, 4.0])
    u, rate = np.array([before, before, after, after + 2.0 * bool(zeros)]), np.array([0.0, 0.0, 1.0, 1.0]) * bool(zeros)
    flown = Trajectory(
        phase=phase.name, state=Curve(time=t, values=np.zeros((4, 3)), rates=np.zeros((4, 3))),
        control=Curve(time=t, values=u[:, None], rates=rate[:, None]),
    )  # fmt: skip
    p = SimpleNamespace(T=4.0, L=100.0, xs=30.0, k=0.3)
    guarded = Guarded(phase=phase, p=p, trajectory=flown, duration=4.0, scale=np.ones(3))
    assert list(guarded._located(1.0, 3.5, 0)) == pytest.approx(zeros, abs=1e-9)
