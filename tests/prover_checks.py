"""What a sound prover of level 5 shows, and a faulty one does not: closed forms, overlaps, refusals.

Every check imports the prover when it is called, so that it can be run on a mutant of it.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import chain, pairwise
from typing import Any

import numpy as np
import pytest
from flint import arb, arb_mat, arb_series, ctx, fmpq

import perilune as pl
import perilune_checker.equations
from perilune.core import parse_quantity
from perilune.problem import Parameter, Verification
from problems.ascents import tangent_steering
from problems.integrators import least_time
from problems.landings import meditch
from problems.staging import ANSWERED, staged_burns

BITS, DIGITS = 160, 1e-25
METHODS = {staged_burns: ANSWERED[0].methods[0]}  # where it is not the indirect one


def room(name: str) -> Any:
    return importlib.import_module(f"perilune.rigorous.{name}")


@cache
def solved(make: Callable[..., pl.Problem], *options: Any) -> pl.Solution:
    return pl.solve(make(*options), METHODS.get(make), verify=0)


def settings(order: int = 30, tolerance: float = 1e-44) -> Any:
    return room("krawczyk").ProofEffort(
        bits=BITS, order=order, tolerance=tolerance, enough=1e6 * tolerance, box=1e8 * tolerance
    )


def stated(solution: pl.Solution, off: float = 0.0) -> tuple[Any, list[Any]]:
    """The boundary value problem, and a guess that is off by a part of itself."""
    pieces, lengths = room("candidate").suggested_pieces(solution)
    boundary = room("boundary_equations").boundary_problem(
        solution.problem, pieces, room("candidate").sides_of(solution)
    )
    return boundary, [value * (1 + off) for value in room("candidate").unknowns_of(solution, boundary, lengths)]


def proved(solution: pl.Solution, effort: Any = None, off: float = 1e-4) -> tuple[Any, Any, Any]:
    """Boundary value problem, refined and proved root; found once by each prover."""
    root, effort = room("krawczyk"), effort or settings()
    known = root.__dict__.setdefault("_checked", {})
    key = (id(solution), effort.order)
    if key not in known:
        boundary, guess = stated(solution, off)
        refined = root.refine_root(boundary, guess, effort, lambda _: None)
        known[key] = boundary, refined, root.prove_root(boundary, refined, effort, lambda _: None)
    return known[key]


def near(value: Any, truth: Any) -> bool:
    """Whether a value holds what is true, to 25 digits."""
    return value.overlaps(truth) and float(value.rad()) < DIGITS * max(1.0, abs(float(value.mid())))


def meditch_lands() -> bool:
    """Free fall, then full thrust by the rocket equation: height and speed vanish at the end."""
    boundary, _, root = proved(solved(meditch))
    y = dict(zip(boundary.names, root.y, strict=True))
    p = {name: arb(given.value) for name, given in boundary.problem.given.items()}
    fall = y["descent, length of arc 1"]
    burn, flow = y["t_f"] - fall, arb(1.227) / p["c"]
    height, speed = p["h"] + p["v"] * fall - p["g"] * fall**2 / 2, p["v"] - p["g"] * fall
    left = 1 - flow * burn / p["m"]
    met = height + speed * burn - p["g"] * burn**2 / 2 + p["c"] * p["m"] / flow * (left * left.log() + 1 - left)
    return near(met, arb(0)) and near(speed - p["g"] * burn - p["c"] * left.log(), arb(0))


def stages_burn_out() -> bool:
    """Both masses end on their bounds, by the rocket equation: mu = -c/m."""
    boundary, _, root = proved(solved(staged_burns))
    y = dict(zip(boundary.names, root.y, strict=True))
    (J,) = boundary.objective.values(root.y, root.flight.ends[-1])
    times = near(y["t_1"], arb(60)) and near(y["t_2"], arb(150))
    multipliers = near(y["first.mu_m"], arb(-50)) and near(y["second.mu_m"], arb(-200))
    kept = all(
        statement.proved and not statement.slack
        for statement in room("inequalities").FlightLimits(boundary, root).all()
    )
    return times and multipliers and kept and near(J, -3000 * (arb(100) / 60 * 40 / 15).log())


def tangent_is_linear() -> bool:
    """tan(beta) falls linearly from tau to -tau; speed and height by quadrature of that."""
    boundary, _, root = proved(solved(tangent_steering))
    y = dict(zip(boundary.names, root.y, strict=True))
    tau, T = y["only.lambda_vy(0)"] / y["only.lambda_vx(0)"], y["t2"]
    steep = (1 + tau * tau).sqrt()
    area = tau.asinh() / tau
    return near(100 * T * area, arb(45)) and near(100 * T * T / (4 * tau) * (steep - area), arb(5))


def phases_do_not_matter() -> bool:
    """The same in two phases: the link and its derivative."""
    _, _, whole = proved(solved(tangent_steering))
    boundary, _, split = proved(solved(tangent_steering, True))
    own = split.y[boundary.names.index("t2")] + arb(0.2)
    return near(own - whole.y[3], arb(0))


def efforts_agree() -> bool:
    """Two orders and numbers of steps: roots and tangents overlap."""
    for make in (meditch, tangent_steering):
        (_, _, one), (_, _, other) = proved(solved(make)), proved(solved(make), settings(26, 1e-42))
        pairs = [*zip(one.y, other.y, strict=True)]
        for D, E in zip(one.flight.tangents, other.flight.tangents, strict=True):
            pairs += zip(D.entries(), E.entries(), strict=True)
        if not all(a.overlaps(b) for a, b in pairs) or one.contraction > 1e-15:
            return False
    return True


def newton_is_quadratic() -> bool:
    for make in (meditch, tangent_steering):
        _, refined, _ = proved(solved(make))
        steps = [step for step in refined.steps if step > 1e-40]
        if len(steps) < 3 or any(b > 1e4 * a * a for a, b in pairwise(steps)):
            return False
    return True


def refused(call: Callable[[], Any]) -> bool:
    try:
        call()
    except (room("krawczyk").NotProved, room("enclosure_step").NotEnclosed):
        return True
    return False


def a_wrong_centre_is_refused() -> bool:
    root = room("krawczyk")
    boundary, refined, _ = proved(solved(tangent_steering))
    radii = [1e-11 * abs(float(value)) for value in refined.y]
    moved = [refined.y[0] * (1 + arb(1e-9)), *refined.y[1:]]
    held = root.RefinedRoot(y=moved, inverse=refined.inverse, grid=refined.grid)
    return refused(lambda: root.prove_root(boundary, held, settings(), lambda _: None, radii))


def a_wide_box_is_refused() -> bool:
    """One whose flights are enclosed, but on which nothing contracts."""
    root = room("krawczyk")
    boundary, refined, _ = proved(solved(meditch))
    radii = [0.02 * abs(float(value)) for value in refined.y]
    return refused(lambda: root.prove_root(boundary, refined, settings(), lambda _: None, radii))


def pole(rate: Callable[[Any, Any], Any]) -> Any:
    """An arc of one state and a costate without rate."""
    graph = room("graph").Graph()
    x = graph.input(("z", 0))
    rates = (rate(graph, x), graph.constant(0))
    phase = solved(tangent_steering).problem.phases[0]
    return room("equations").CanonicalArc(graph=graph, phase=phase, phase_index=0, constants=(), rates=rates, half=1,
                                     joint=False, implicit=(), stationary=(), reduced=x,
                                 hamiltonian=x, control={}, scalars=(), strengths=())  # fmt: skip


def a_step_over_a_pole_is_refused() -> bool:
    """x' = 1 + x^2 from 0 is tan t; a step beyond its pole has no enclosure, one before it has."""
    flow, arc = room("enclosure_step"), pole(lambda graph, x: 1 + x * x)
    start = [arb(0), arb(1)]
    end = flow.enclose_step(arc, start, None, arb(0), arb(0.25), 20)[0][0]
    late = refused(lambda: flow.enclose_step(arc, start, None, arb(0), arb(1.75), 20))
    return late and end.overlaps(arb(0.25).tan()) and 0 < float(end.rad()) < 1e-9


def a_step_over_a_jump_is_refused() -> bool:
    """The angle of (cos t, sin t) jumps at pi, though its slope does not."""
    flow, meaning = room("enclosure_step"), room("exact_tape")._MEANING
    arc = pole(lambda graph, x: 1 + meaning["atan2"](graph, graph.do("sin", x), graph.do("cos", x)) * 2.0**-60)
    before = not refused(lambda: flow.enclose_step(arc, [arb(3), arb(1)], None, arb(0), arb(0.125), 12))
    return before and refused(lambda: flow.enclose_step(arc, [arb(3), arb(1)], None, arb(0), arb(0.25), 12))


def tangents_are_enclosed() -> bool:
    """Of tan t the tangent is 1/cos^2 t, at every t of the step."""
    flow, arc = room("enclosure_step"), pole(lambda graph, x: 1 + x * x)
    _, V, step = flow.enclose_step(arc, [arb(0), arb(1)], arb_mat([[1], [0]]), arb(0), arb(0.25), 12)
    along = all(step.at(arb(t))[0].overlaps(arb(t).tan()) for t in np.linspace(0.01, 0.25, 7).tolist())
    return along and V[0, 0].overlaps(1 / arb(0.25).cos() ** 2) and 0 < float(V[0, 0].rad()) < 1e-3


def a_step_that_tangents_outgrow_is_refused() -> bool:
    """x' = 50 x stays at 0, which is enclosed; its tangent e^(50 h) not, at (50 h)^12/12! = 0.995."""
    flow, arc = room("enclosure_step"), pole(lambda graph, x: 50 * x)

    def enclosed(share: float, V: Any) -> bool:
        length = arb((share * math.factorial(12)) ** (1 / 12) / 50)
        return not refused(lambda: flow.enclose_step(arc, [arb(0), arb(1)], V, arb(0), length, 12))

    beside = arb_mat([[1], [0]])
    return enclosed(0.995, None) and enclosed(0.1, beside) and not enclosed(0.995, beside)


def flights_stay_in_their_enclosures() -> bool:
    """Flights in many digits from the ends of a box lie in its enclosure at every node; their differences in dz/dy."""
    flight, effort = room("enclosure"), settings()
    boundary, refined, root = proved(solved(meditch))
    for k in (0, boundary.names.index("t_f"), len(boundary.names) - 1):
        away = arb(1e-9 * max(1.0, abs(float(refined.y[k]))))
        box = [c + arb(0, away) if j == k else c for j, c in enumerate(refined.y)]
        whole = flight.enclose_flight(boundary, box, refined.grid, effort.order)
        for sign in (1, -1):
            y = [c + sign * away if j == k else c for j, c in enumerate(refined.y)]
            flown, _ = flight.fly_unproved(boundary, y, effort.order, effort.tolerance, refined.grid)
            for balls, points in zip(chain(*whole.nodes), chain(*flown.nodes), strict=True):
                if not all((a + arb(0, 1e-38)).contains(b) for a, b in zip(balls, points, strict=True)):
                    return False
            for D, end, centre in zip(whole.tangents, flown.ends, root.flight.centre, strict=True):
                # What a flight in many digits leaves at each step is no part of its differences.
                left = arb(0, effort.tolerance * sum(map(len, flown.nodes))) / away
                slopes = [(z - near) / (sign * away) + left for z, near in zip(end, centre, strict=True)]
                if not all(D[row, k].overlaps(slope) for row, slope in enumerate(slopes)):
                    return False
    return True


def frames_keep_remainders() -> bool:
    """In a few orders a flight and its tangents are known to some digits; those of many orders lie in what is left."""
    flight = room("enclosure")
    boundary, refined, root = proved(solved(tangent_steering))
    try:
        rough = flight.enclose_flight(boundary, refined.y, refined.grid, 6)
    except room("enclosure_step").NotEnclosed:
        return False
    for near, D, end, exact in zip(rough.centre, rough.tangents, root.flight.ends, root.flight.tangents, strict=True):
        pairs = [*zip(near, end, strict=True), *zip(D.entries(), exact.entries(), strict=True)]
        if not all(a.overlaps(b) and float(a.rad()) < 1e-2 * (1 + abs(float(b))) for a, b in pairs):
            return False
    return True


def a_frame_turns_with_the_flow() -> bool:
    """Quarter turns, each known to 0.1 along x: along y as much is left of the one before, and nothing more."""
    frame, turn = (
        room("enclosure")._ParallelepipedFrame([arb(1), arb(0)], arb_mat([[1], [0]])),
        arb_mat([[0, -1], [1, 0]]),
    )
    for number in (1, 2):
        x, y = frame.middle
        frame.go([[-y], [x]], [arb(0, 0.1), arb(0)], arb(1), turn)
        known = [float(z.rad()) for z in frame.near]
        if not all(abs(a - b) < 1e-6 for a, b in zip(known, (0.1, 0.1 * (number - 1)), strict=True)):
            return False
    return frame.near[0].contains(arb(-1)) and frame.tangents == turn * turn * arb_mat([[1], [0]])


def steps_follow_each_other() -> bool:
    """Each begins where the one before ends, and none loses more than was asked for."""
    boundary, refined, root = proved(solved(meditch))
    most = room("krawczyk")._REMAINDER * settings().box
    for steps, duration in zip(root.flight.steps, boundary.durations, strict=True):
        ends = [step.begin + step.length for step in steps]
        together = all(step.begin == end for step, end in zip(steps[1:], ends[:-1], strict=True))
        if not together or steps[0].begin != 0 or not ends[-1].contains(duration.values(refined.y)[0]):
            return False
        for step in steps:
            order = len(step.polynomial[0])
            lost = [abs(own * step.length**order) for own in step.remainder]
            if any(a > most * abs(b).upper() for a, b in zip(lost, step.at(arb(0).union(step.length)), strict=True)):
                return False
    return True


def growth_is_enclosed() -> bool:
    """x' = x: the remainder is no larger than it has to be, so that a part of it would not do."""
    flow, arc = room("enclosure_step"), pole(lambda graph, x: 1 * x)
    end, V, _ = flow.enclose_step(arc, [arb(1), arb(1)], arb_mat([[1], [0]]), arb(0), arb(0.25), 12)
    truth = arb(0.25).exp()
    return all(value.overlaps(truth) and 0 < float(value.rad()) < 1e-12 for value in (end[0], V[0, 0]))


def signs_are_seen() -> bool:
    """Along x = tan t, t in [0, 1/4]: what dips below zero, touches it or begins with it."""
    flow, signs = room("enclosure_step"), room("inequalities")
    arc = pole(lambda graph, x: 1 + x * x)
    _, _, step = flow.enclose_step(arc, [arb(0), arb(1)], None, arb(0), arb(0.25), 20)
    x = arc.graph.input(("z", 0))

    def positive(of: Any, zeros: tuple[int, int] = (0, 0)) -> bool:
        return signs.prove_positive(signs.SignedQuantity(arc, of, []), [step], zeros).proved

    dips, above = (x - 0.125) * (x - 0.125) - 1e-6, (x - 0.125) * (x - 0.125) + 1e-6
    inside, falls = x * (0.125 - x), 1 - x * 4
    good = positive(above) and positive(x, (1, 0)) and positive(x * x, (2, 0))
    bad = [positive(dips), positive(x), positive(-x, (1, 0)), positive(inside, (1, 0)), positive(falls),
           positive(x - 0.2, (0, 1)), positive(x * x)]  # fmt: skip
    return good and not any(bad)


def swinging(duration: float, free: bool) -> pl.Problem:
    """Least integral of (u^2 - x^2)/2 from x = 0 to 1, x' = u: minima until the conjugate point at pi, none beyond.

    Or from x = 0 to anywhere: until pi/2.
    """
    phase = pl.Phase(
        name="go",
        states=(pl.Variable(name="x", unit="m"), pl.Variable(name="cost", unit="m^2*s")),
        controls=(pl.ScalarControl(name="u", unit="m/s"),),
        dynamics=lambda x, u, p, xp: (u.u, 0.5 * (u.u * u.u / (p.w * p.w) - x.x * x.x)),
        duration="T",
        end=pl.Conditions.of(
            None if free else lambda x, p, xp: (x.x - p.e,), () if free else (pl.Variable(name="place", unit="m"),)
        ),
    )
    given = {"T": (duration, "s"), "e": (1.0, "m"), "w": (1.0, "1/s")}
    return pl.Problem(
        name="swinging",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0),
        given={name: pl.Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        objective=lambda x, p, xp: x.cost,
        objective_unit="m^2*s",
    )


def a_minimum(duration: float, free: bool = False) -> bool:
    """Whether the extremal sin(t)/sin(T), or 0 with a free end, is proved to be one."""
    boundary = room("boundary_equations").boundary_problem(
        swinging(duration, free), [room("boundary_value_problem").ArcPiece(phase=0, regimes={"u": "interior"})]
    )
    rough = settings(24, 1e-36)
    slope = -1 / np.sin(duration)
    guess = [arb(0), arb(1)] if free else [arb(slope), arb(1), arb(float(slope * np.cos(duration)))]
    refined = room("krawczyk").refine_root(boundary, guess, rough, lambda _: None)
    root = room("krawczyk").prove_root(boundary, refined, rough, lambda _: None)
    return room("second_order").prove_local_optimum(boundary, root, rough.order, lambda _: None).proved


def conjugate_points_are_seen() -> bool:
    ends = a_minimum(1.5, True) and not a_minimum(1.65, True)
    return ends and a_minimum(3.0) and not a_minimum(4.0)


def operations() -> list[tuple[str, Callable[[Any, Any], Any], Callable[[Any], Any]]]:
    """(name, expression of x, the same of a series)."""
    meaning = room("exact_tape")._MEANING

    def named(name: str) -> Callable[[Any, Any], Any]:
        return lambda graph, x: meaning[name](graph, x)

    return [
        *((name, named(name), lambda s, name=name: getattr(s, name)())
          for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "atan", "asin", "acos")),
        ("pow", lambda g, x: g.power(x, 1.75), lambda s: (s.log() * arb(1.75)).exp()),
        ("cube", lambda g, x: g.power(x, 3), lambda s: s * s * s),
        ("both", lambda g, x: g.do("sin", x) * g.do("cos", x), lambda s: s.sin() * s.cos()),
        ("div", lambda g, x: x / (1 + x * x), lambda s: s / (1 + s * s)),
        ("under", lambda g, x: 3 / (x - 2) - x, lambda s: 3 / (s - 2) - s),
        ("atan2", lambda g, x: meaning["atan2"](g, x, 2 - x * x), lambda s: (s / (2 - s * s)).atan()),
        ("tanh", named("tanh"), lambda s: (s.exp() - (-s).exp()) / (s.exp() + (-s).exp())),
    ]  # fmt: skip


def series_agree(orders: int = 14) -> bool:
    """Recurrences beside FLINT's power series, and derivatives beside series of order 1."""
    before, ctx.cap = ctx.cap, orders + 2
    try:
        for _, expression, series in operations():
            graph = room("graph").Graph()
            x = graph.input("x")
            e = expression(graph, x)
            program = room("taylor").TaylorProgram(graph, ["x"], [e])
            moved, (found,) = program.flow([arb("0.3")], orders)
            (again,) = program.along(moved, orders)
            truth = series(arb_series(moved[0][:orders], orders)).coeffs()
            truth += [arb(0)] * (orders - len(truth))
            if not len(found) == len(again) == orders or not all(
                arb(a).overlaps(b) and float(a.rad()) < 1e-30 * max(1, abs(float(b)))
                for a, b in zip([*found, *again], [*truth, *truth], strict=True)
            ):
                return False
            slope = room("taylor").TaylorProgram(graph, ["x"], graph.gradient(e, ["x"])).values([arb("0.3")])[0]
            if not slope.overlaps(series(arb_series([arb("0.3"), 1], 2)).coeffs()[1]):
                return False
        return True
    finally:
        ctx.cap = before


def forms_are_positive() -> bool:
    definite = room("second_order").positive_definite
    return definite(arb_mat([[2, 1], [1, 2]])) and not definite(arb_mat([[1, 2], [2, 1]]))


def J_is_that_of_the_root() -> bool:
    """Least time of the double integrator is 2 s; no step of it has a remainder, and its centre is a little off."""
    boundary, guess = stated(solved(least_time), 1e-4)
    found = room("theorem")._prove_extremal(boundary, guess, replace(settings(24, 1e-24), box=1e-34), lambda _: None)
    y = found.root.y
    far = room("theorem")._distance(boundary, found.root, [2 * y[0], *y[1:]])
    return found.objective.contains(arb(2)) and not found.refined.y[2] == 2 and far == pytest.approx(0.5)


def what_is_missing_is_no_theorem() -> bool:
    theorem, verified, before = room("theorem"), room("verified"), Verification(checks=())
    found = theorem.attempt_proof(solved(least_time), lambda _: None)
    held = room("inequalities").Statement(words="it holds", proved=False)
    broken = replace(found, proved=replace(found.proved, statements=(*found.proved.statements, held)))
    whole, less = (verified.add_attempt(before, one) for one in (found, broken))
    unseen = room("second_order").Statement(words="it is", proved=False, where="as nobody looked")
    modest = verified.add_attempt(before, replace(found, proved=replace(found.proved, optimum=unseen)))
    honest = "a strict local optimum" in whole.notes[0] and "a strict local optimum" not in modest.notes[0]
    return honest and whole.certificate is not None and less.certificate is None and not less.checks


def numbers_are_exact() -> bool:
    """What a value is taken for: its decimal, if that is what was flown, or else the double."""
    exactly, graph, program = room("exact_tape").exact_value, room("graph"), room("taylor").TaylorProgram
    for stated, unit, number, power in (
        ("4902.7779 km^3/s^2", "m^3/s^2", "4902777900000", 0), ("0.1", "1", "1/10", 0),
        ("12 deg", "rad", "1/15", 1), ("90 s/deg", "s/rad", "16200", -1), ("3 cm^0.5", "m^0.5", "3/10", 0),
    ):  # fmt: skip
        value = parse_quantity(stated, unit)
        found, own = exactly(Parameter(value=value, unit=unit, stated=stated)), graph.Graph()
        truth = arb(fmpq(*Fraction(number).as_integer_ratio())) * arb.pi() ** power
        (read,) = program(own, [], [found.expression(own)]).values([])
        told = found.document()
        written = perilune_checker.equations.parse_given(told)
        if not all(ball.overlaps(truth) and ball.rad() < 1e-30 * truth for ball in (found.ball(), read, written)):
            return False
        if (Fraction(number), power) != (found.rational, found.power) or told["taken"] != "text":
            return False
    for value, stated in ((0.1, ""), (0.2, "0.1"), (0.1, "about a tenth")):
        told = exactly(Parameter(value=value, unit="1", stated=stated)).document()
        if told != {"taken": "double", "text": "", "number": str(Fraction(value))}:
            return False
    return True


CHECKS: tuple[Callable[[], bool], ...] = (
    series_agree, a_step_over_a_pole_is_refused, a_step_over_a_jump_is_refused, growth_is_enclosed,
    tangents_are_enclosed, a_step_that_tangents_outgrow_is_refused, signs_are_seen, forms_are_positive,
    numbers_are_exact, J_is_that_of_the_root, what_is_missing_is_no_theorem, meditch_lands,
    stages_burn_out,
    flights_stay_in_their_enclosures, frames_keep_remainders, a_frame_turns_with_the_flow,
    steps_follow_each_other, a_wide_box_is_refused,
    tangent_is_linear, a_wrong_centre_is_refused,
    newton_is_quadratic, phases_do_not_matter, conjugate_points_are_seen,
    efforts_agree,
)  # fmt: skip


def holds(check: Callable[[], Any]) -> Any:
    """What a check says."""
    with ctx.workprec(BITS):
        return check()
