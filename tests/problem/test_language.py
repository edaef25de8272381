"""The language of physics: choices that end an arc, tables, fractional powers, in both methods and in the proof."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import perilune as pl
from perilune.core import NUMERIC, PeriluneError
from perilune.io.tape_json import tape_of
from test_control_law import given, variables


def refraction(slow: float = 0.5) -> pl.Problem:
    """Least time from (0, 1) to (1, -1): speed 1 above y = 0, slower below. Snell's law."""
    phase = pl.Phase(
        name="ray",
        states=variables(x="m", y="m"),
        controls=(pl.UnitVectorControl(names=("cx", "cy")),),
        dynamics=lambda x, u, p, xp: (
            xp.where(x.y > p.border, p.fast, p.slow) * u.cx,
            xp.where(x.y > p.border, p.fast, p.slow) * u.cy,
        ),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.far, x.y + p.far), across="m", down="m"),
    )
    return pl.Problem(
        name="refraction",
        phases=(phase,),
        start=lambda p, xp: (0.0, p.far),
        given=given(fast=(1.0, "m/s"), slow=(slow, "m/s"), far=(1.0, "m"), border=(0.0, "m")),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.0, upper=20.0, guess=3.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
    )


def test_light_bends_at_a_choice() -> None:
    """The costate along the surface is kept, the other jumps; sin(a)/sin(b) is the ratio of speeds."""
    from scipy.optimize import minimize_scalar

    best: Any = minimize_scalar(lambda c: math.hypot(c, 1) + 2 * math.hypot(1 - c, 1), bounds=(0, 1), method="bounded",
                           options={"xatol": 1e-12})  # fmt: skip
    solution = pl.solve(refraction(), verify=0)
    assert solution.objective == pytest.approx(best.fun, abs=1e-10)
    path = solution.trajectories[0]
    lam = path.costate
    assert lam is not None
    before, after = lam(0.0), lam(path.duration)
    assert before[0] == pytest.approx(after[0], abs=1e-10)
    assert np.linalg.norm(before) == pytest.approx(1.0, abs=1e-10)
    assert np.linalg.norm(after) == pytest.approx(2.0, abs=1e-10)


def test_a_costate_that_only_one_side_moves_is_kept() -> None:
    """A sail drifts at 1 m/s and beyond 1 m with its own speed y as well, whose costate is constant before.

    Over 3 m in 2 s the integral of y from 1 s on is 1 m: y' = c, then c (2 s - t), so c + c/3 = 1 and J = 2 c^2/3.
    """
    phase = pl.Phase(
        name="sail",
        states=variables(x="m", y="m/s", cost="m^2/s^3"),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (
            p.drift + xp.where(x.x > p.border, x.y, 0.0 * p.drift), u.u, 0.5 * u.u * u.u,
        ),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.far,), there="m"),
    )  # fmt: skip
    problem = pl.Problem(
        name="sail",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given=given(drift=(1.0, "m/s"), border=(1.0, "m"), far=(3.0, "m"), T=(2.0, "s")),
        objective=lambda x, p, xp: x.cost,
        objective_unit="m^2/s^3",
    )
    solution = pl.solve(problem)
    assert solution.outcome is pl.Outcome.PROVED
    assert solution.objective == pytest.approx(0.375, rel=1e-12)
    lam = solution.trajectories[0].costate
    assert lam is not None
    assert lam.values[[0, -1], 1] == pytest.approx([-0.75, 0.0], abs=1e-10)


def flipped() -> pl.Problem:
    """From rest to rest over 1 m in least time, thrust at most 1 m/s^2 either way, its sign turned beyond 0.3 m."""
    phase = pl.Phase(
        name="go",
        states=variables(x="m", v="m/s"),
        controls=(pl.ScalarControl(name="a", unit="m/s^2", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (x.v, xp.where(x.x > p.border, -1.0, 1.0) * u.a),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.far, x.v), place="m", rest="m/s"),
    )
    return pl.Problem(
        name="flipped",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0),
        given=given(far=(1.0, "m"), border=(0.3, "m")),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.0, upper=20.0, guess=3.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
    )


def test_a_control_changes_its_regime_at_a_choice() -> None:
    """Full thrust to 0.3 m, full thrust the other way, which goes on accelerating, and back at half way."""
    solution = pl.solve(flipped(), verify=0)
    assert solution.objective == pytest.approx(2.0, abs=1e-10)
    control, border = solution.trajectories[0].control, math.sqrt(0.6)
    times = [0.5 * border, 0.5 * (border + 1), 1.5]
    assert [control(t)[0] for t in times] == pytest.approx([1.0, -1.0, 1.0])


@pytest.mark.parametrize(("stream", "engine", "runs"), [(3.0, 2.0, 0.0), (0.5, 1.0, 1.0)])
def test_a_regime_behind_a_choice_is_that_of_the_costate_there(stream: float, engine: float, runs: float) -> None:
    """A ferry adds 1 m/s to a stream of 1 m/s, and other speeds beyond 1 m; 1 s of its engine costs as 1.25 s of time.

    Each metre is crossed as cheaply as it can be, at (0.8 + u)/(stream + engine u). The costate before the border would
    choose otherwise behind it.
    """
    phase = pl.Phase(
        name="cross",
        states=variables(x="m", fuel="s"),
        controls=(pl.ScalarControl(name="u", lower=0.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (
            xp.where(x.x > p.border, p.stream + p.engine * u.u, p.near * (1 + u.u)), u.u,
        ),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.far,), there="m"),
    )  # fmt: skip
    problem = pl.Problem(
        name="ferry",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0),
        given=given(near=(1.0, "m/s"), stream=(stream, "m/s"), engine=(engine, "m/s"),
                    border=(1.0, "m"), far=(2.0, "m")),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.0, upper=20.0, guess=2.0),),
        objective=lambda x, p, xp: x.fuel + 0.8 * p.T,
        objective_unit="s",
    )  # fmt: skip
    assert (0.8 / stream < 1.8 / (stream + engine)) == (runs == 0.0) == (1 - 0.8 * engine < 0)
    solution = pl.solve(problem)
    assert solution.outcome is pl.Outcome.PROVED
    assert solution.objective == pytest.approx(0.8 + min(0.8 / stream, 1.8 / (stream + engine)), rel=1e-12)
    control = solution.trajectories[0].control
    assert [control(0.5)[0], control(solution.free["T"])[0]] == pytest.approx([0.0, runs])


KNOTS = tuple(np.linspace(0.0, 1.0, 21))
FORCES = {
    "where": lambda x, p, xp: xp.where(x.x > p.start, x.x - p.start, 0.0 * p.start),
    "fmax": lambda x, p, xp: xp.fmax(x.x - p.start, 0.0 * p.start),
    "fmin": lambda x, p, xp: -xp.fmin(p.start - x.x, 0.0 * p.start),
    "fabs": lambda x, p, xp: 0.5 * (xp.fabs(x.x - p.start) + x.x - p.start),
    "table": lambda x, p, xp: p.far * xp.table(pl.Table((0.0, 0.3, 1.0), (0.0, 0.0, 0.7), "linear"), x.x / p.far),
    "many": lambda x, p, xp: (
        p.far * xp.table(pl.Table(KNOTS, tuple(np.fmax(np.array(KNOTS) - 0.3, 0.0)), "linear"), x.x / p.far)
    ),
}


def transfer(force: str, speed: float = 0.0) -> pl.Problem:
    """From (0, speed) to rest at 100 m in 20 s with least integral of a^2/2 against a spring that is met at 30 m."""
    phase = pl.Phase(
        name="go",
        states=variables(x="m", v="m/s", e="m^2/s^3"),
        controls=(pl.ScalarControl(name="a", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.a - p.stiff * FORCES[force](x, p, xp), u.a**2 / 2),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.far, x.v), place="m", rest="m/s"),
    )
    return pl.Problem(
        name="transfer",
        phases=(phase,),
        start=lambda p, xp: (0.0, p.speed, 0.0),
        given=given(far=(100.0, "m"), T=(20.0, "s"), stiff=(0.003, "1/s^2"), start=(30.0, "m"), speed=(speed, "m/s")),
        free=(),
        objective=lambda x, p, xp: x.e,
        objective_unit="m^2/s^3",
    )


def least_effort(speed: float) -> float:
    """Both parts of `transfer` are linear: J = r' W^-1 r / 2 with Gramians W, at the best (T1, v1) where they meet.

    W and exp(A T) from one matrix exponential: Van Loan 1978, doi 10.1109/TAC.1978.1101743.
    """
    from scipy.linalg import expm
    from scipy.optimize import minimize

    def part(stiff: float, start: Any, end: Any, T: float) -> float:
        A = np.array([[0.0, 1.0], [-stiff, 0.0]])
        both = expm(np.block([[-A, np.diag([0.0, 1.0])], [np.zeros((2, 2)), A.T]]) * T)
        flow = both[2:, 2:].T
        r, W = np.array(end) - flow @ np.array(start), flow @ both[:2, 2:]
        return float(0.5 * r @ np.linalg.solve(W, r))

    def whole(y: Any) -> float:
        return part(0.0, (0.0, speed), (30.0, y[1]), y[0]) + part(0.003, (0.0, y[1]), (70.0, 0.0), 20.0 - y[0])

    return float(minimize(whole, (7.0, 7.0), method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-13}).fun)


@pytest.mark.parametrize("speed", [0.0, -1.0])
def test_kinks_are_met_whatever_makes_them(speed: float) -> None:
    """At rest the flight begins and ends on a knot of the tables; at -1 m/s it leaves by the first and comes back."""
    best = least_effort(speed)
    for force in FORCES:
        solution = pl.solve(transfer(force, speed), verify=0)
        assert solution.objective == pytest.approx(best, abs=2e-10), force
        curve = solution.trajectories[0].state
        breaks = curve.time[1:][np.diff(curve.time) == 0]
        assert np.abs(curve(breaks)[:, 0] - 30.0).min() < 1e-9, force


def layered(kind: str) -> pl.Problem:
    """A fall with drag through air of two layers, its density continuous; the landing speed is known by quadrature."""

    def dynamics(x: Any, u: Any, p: Any, xp: Any) -> Any:
        if kind == "where":
            density = xp.where(x.h > p.H, 0.5 * xp.exp(-(x.h - p.H) / p.H), 1.0 - 0.5 * x.h / p.H)
        else:
            density = xp.table(AIR, x.h / p.H)
        return (x.v, -p.g + p.k * density * x.v * x.v)

    phase = pl.Phase(
        name="fall", states=variables(h="m", v="m/s"), dynamics=dynamics, duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.h,), ground="m"), 
    )  # fmt: skip
    return pl.Problem(
        name="layers",
        phases=(phase,),
        start=lambda p, xp: (p.h0, 0.0),
        given=given(h0=(3.0, "m"), H=(1.0, "m"), g=(1.0, "m/s^2"), k=(0.4, "1/m")),
        free=(pl.FreeParameter(name="T", unit="s", lower=0.1, upper=20.0, guess=3.0),),
        objective=lambda x, p, xp: p.T,
        objective_unit="s",
    )


HEIGHTS = np.linspace(0.0, 4.0, 21)
AIR = pl.Table(tuple(HEIGHTS), tuple(np.exp(-HEIGHTS)))


@pytest.mark.parametrize("kind", ["where", "table"])
def test_air_in_layers_and_in_a_table(kind: str) -> None:
    """d(v^2)/dh = -2 g + 2 k rho(h) v^2 backwards from rest, by SciPy."""
    from scipy.integrate import solve_ivp

    spline = make_interp_spline(AIR.x, AIR.y, k=5)

    def density(h: float) -> float:
        if kind == "table":
            return float(spline(h))
        return 0.5 * math.exp(1 - h) if h > 1 else 1 - 0.5 * h

    flown = solve_ivp(
        lambda h, w: -2.0 + 0.8 * density(h) * w, (3.0, 0.0), [0.0], rtol=1e-11, atol=1e-13, max_step=0.05
    )
    solution = pl.solve(layered(kind), verify=1)
    assert solution.outcome is pl.Outcome.PROVED
    end = solution.trajectories[0].state.values[-1]
    assert end[1] == pytest.approx(-math.sqrt(flown.y[0, -1]), abs=1e-7)


@pytest.mark.parametrize("kind", ["smooth", "smoother", "monotone", "linear"])
def test_a_table_is_its_data_everywhere(kind: Any) -> None:
    import casadi as ca

    from perilune.problem.casadi_trace import SYMBOLIC

    table = pl.Table((0.0, 1.0, 2.0, 4.0), (1.0, 3.0, 3.5, 3.6), kind)
    x = np.array([-0.5, 0.0, 0.3, 1.0, 1.7, 2.0, 3.9, 4.0, 5.0])
    s = ca.SX.sym("s")
    symbolic = np.array(ca.Function("t", [s], [SYMBOLIC.table(table, s)]).map(len(x))(x)).ravel()
    assert symbolic == pytest.approx(table(x), abs=1e-13)
    assert table(np.array(table.x)) == pytest.approx(table.y, abs=1e-14)
    slope = np.imag(table(x + 1e-30j)) / 1e-30
    assert slope[0] == pytest.approx((table(0.0) - table(-0.5)) / 0.5)
    if kind == "monotone":
        assert (np.diff(table(np.linspace(0, 4, 200))) >= 0).all()
    with pytest.raises(PeriluneError, match="increasing knots"):
        pl.Table((0.0, 2.0, 1.0), (1.0, 2.0, 3.0), kind)
    with pytest.raises(PeriluneError, match="finite"):
        pl.Table((0.0, 1.0, 2.0), (1.0, math.nan, 3.0), kind)


def test_choices_and_tables_travel() -> None:
    """A tape that reads a table and chooses, written as JSON and read back, computes the same."""
    for kind in ("where", "table"):
        expression = layered(kind).form.expressions[0, "dynamics"]
        names = {"x": ("h", "v"), "u": (), "p": ("T", "h0", "H", "g", "k")}
        back = replace(expression, tape=tape_of(expression.tape.document(), names, "fall"))
        phase = layered(kind).phases[0]
        p = layered(kind).parameters({"T": 3.0})
        for h in (0.3, 1.0, 2.7):
            at = phase.state_record(h, -0.5), phase.control_record(), p
            assert back(*at, NUMERIC) == pytest.approx(phase.dynamics(*at, NUMERIC), rel=1e-15)


def test_a_choice_by_a_control_is_refused_by_the_indirect_method() -> None:
    base = refraction()
    by_control = replace(
        base.phases[0], dynamics=lambda x, u, p, xp: (xp.where(u.cx > u.cy, p.fast, p.slow) * u.cx, p.fast * u.cy)
    )
    with pytest.raises(PeriluneError, match="depends on a control"):
        pl.solve(replace(base, phases=(by_control,)), verify=0)


def reentry() -> pl.Problem:
    """The Apollo re-entry of Stoer and Bulirsch, 7.3.7, lengths in 1e5 ft taken for metres: least heating."""

    def dynamics(x: Any, u: Any, p: Any, xp: Any) -> Any:
        density = p.rho0 * xp.exp(-p.beta * x.h)
        drag, lift = 1.174 - 0.9 * xp.cos(u.u), 0.6 * xp.sin(u.u)
        far = 1 + x.h / p.R
        push = 0.5 * p.area_per_mass * density * x.v
        return (
            -push * x.v * drag - p.g * xp.sin(x.gamma) / (far * far),
            push * lift + x.v * xp.cos(x.gamma) / (p.R * far) - p.g * xp.cos(x.gamma) / (x.v * far * far),
            x.v * xp.sin(x.gamma),
            p.heating * x.v * x.v * x.v * xp.sqrt(density),
        )

    phase = pl.Phase(
        name="entry",
        states=variables(v="m/s", gamma="rad", h="m", J="kg^0.5*m^1.5/s^3"),
        controls=(pl.ScalarControl(name="u", unit="rad"),),
        dynamics=dynamics,
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.v - p.v1, x.gamma, x.h - p.h1), speed="m/s", level="rad", height="m"),
        end_guess=lambda p, xp: (p.v1, 0.0, p.h1, 0.03 * p.heating * p.v1 * p.v1 * p.v1 * xp.sqrt(p.rho0) * p.T),
    )
    return pl.Problem(
        name="reentry",
        phases=(phase,),
        start=lambda p, xp: (p.v0, p.gamma0, p.h0, 0.0 * p.heating * p.v0**3 * xp.sqrt(p.rho0) * p.T),
        given=given(
            R=(209.0, "m"), beta=(4.26, "1/m"), rho0=(2.704e-3, "kg/m^3"), g=(3.2172e-4, "m/s^2"),
            area_per_mass=(53200.0, "m^2/kg"), heating=(10.0, "1/s"), v0=(0.36, "m/s"), v1=(0.27, "m/s"),
            gamma0=(math.radians(-8.1), "rad"), h0=(4.0, "m"), h1=(2.5, "m"),
        ),
        free=(pl.FreeParameter(name="T", unit="s", lower=100.0, upper=400.0, guess=135.0),),
        objective=lambda x, p, xp: x.J,
        objective_unit="kg^0.5*m^1.5/s^3",
        scales=pl.Scales(length=4.0, time=10.0, mass=1.0),
    )  # fmt: skip


def test_the_re_entry_of_stoer_and_bulirsch() -> None:
    """An angle in lift and drag; T = 224.900756, J = 0.027782408828, u from 68.2206 to -67.3773 degrees."""
    rough = pl.solve(reentry(), pl.Pseudospectral(segments=3, refine=0, polish=False), verify=0)
    solution = pl.solve(reentry(), guess=rough, verify=0)
    assert solution.objective == pytest.approx(0.027782408828, abs=1e-11)
    assert solution.free["T"] == pytest.approx(224.900756, abs=1e-5)
    control = solution.trajectories[0].control
    assert np.degrees(control(0.0))[0] == pytest.approx(68.2206, abs=1e-3)
    assert np.degrees(control(solution.free["T"]))[0] == pytest.approx(-67.3773, abs=1e-3)
