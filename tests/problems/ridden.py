"""Answers by hand that ride along a condition on states, from closed forms, right ones and wrong ones.

A *string*, u = x', and a *beam*, u = x'', bend away from the middle at a rate k and may not come above x = l:

    J = int (u^2 - k^2 x^2)/2 dt   or   int (u^2 - k^4 x^2)/2 dt,   S = l - x >= 0.

They rise to l, ride along it and fall. Along the arc u = 0, and its multiplier is k^2 l or k^4 l. What is left to vary
are the rise and the fall, whose ends are fixed, those of the beam clamped: both have a conjugate point where k times
their length is pi (string), 4.7300407 (beam), so that kappa is (k L/pi)^2 and (k L/4.73)^4.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

import perilune as pl
from perilune.problem import Parameter, Solution, Variable
from problems.by_hand import Formula, Piece, by_hand, parted, polynomial
from problems.constrained import bryson_denham, parked

CLAMPED = 4.730040744862704  # the first root of cos z cosh z = 1


def _variables(**units: str) -> tuple[Variable, ...]:
    return tuple(Variable(name=name, unit=unit) for name, unit in units.items())


def _given(**values: tuple[float, str]) -> dict[str, Parameter]:
    return {name: Parameter(value=value, unit=unit) for name, (value, unit) in values.items()}


def string(
    k: float,
    rise: float,
    ride: float,
    fall: float,
    *,
    push: float | None = None,
    bait: float = 0.0,
    start_is_free: bool = False,
    bent: float | None = None,
) -> Solution:
    """The string with l = 1; lengths of its arcs in radians of k, a rise or fall of 0 being none.

    With a `push` the end is free and J has push times x there; with a free start J has `bait` times it. Where J is
    `bent` over its duration T that is free too, and costs k^2 l^2/2 T, as much as the ride gains, + bent (T - T0)^2/2.
    """
    l, total = 1.0, (rise + ride + fall) / k
    phase = _string_phase("string", "T", end=push is None)
    x0, x1 = l * math.cos(rise), l * math.cos(fall)
    problem = pl.Problem(
        name="string",
        phases=(phase,),
        start=lambda p, xp: (p.x0, 0.0),
        given=_given(k=(k, "1/s"), l=(l, "m"), x1=(x1, "m"), push=(push or 0.0, "m/s"), bait=(bait, "m/s"),
                     cost=(0.0 if bent is None else 0.5 * (k * l) ** 2, "m^2/s^2"), bent=(bent or 0.0, "m^2/s^3"),
                     T0=(total, "s"), **({} if start_is_free else {"x0": (x0, "m")}),
                     **({} if bent is not None else {"T": (total, "s")})),
        free=(*((pl.FreeParameter(name="x0", unit="m", lower=-5.0, upper=5.0, guess=1.0),) if start_is_free else ()),
              *(() if bent is None else (pl.FreeParameter(name="T", unit="s", lower=0.0, upper=99.0, guess=total),))),
        objective=lambda x, p, xp: x.c + p.push * x.x + p.bait * p.x0 + p.cost * p.T + 0.5 * p.bent * (p.T - p.T0) ** 2,
        objective_unit="m^2/s",
    )  # fmt: skip
    pieces = string_pieces(k, rise, ride, fall, push or 0.0)
    chosen = ({"x0": x0} if start_is_free else {}) | ({} if bent is None else {"T": total})
    return by_hand(problem, pieces, free=chosen)


def string_pieces(k: float, rise: float, ride: float, fall: float, push: float = 0.0) -> list[Piece]:
    t1, w, t3, l = rise / k, ride / k, fall / k, 1.0
    pieces = []
    if t1:
        pieces.append(_swing(k, l, t1, lambda t: k * (t1 - t), -1.0, 0.0))
    reached = pieces[-1].state[1][0](t1) if pieces else 0.0
    # Where the arc ends the multiplier of its rate is 0, or holds what the push asks for.
    pieces.append(Piece(
        w, [polynomial(l), polynomial(reached, -0.5 * (k * l) ** 2)], [polynomial(0.0)],
        [polynomial(push - k * k * l * w, k * k * l), polynomial(1.0)],
    ))  # fmt: skip
    if t3:
        pieces.append(_swing(k, l, t3, lambda t: k * t, 1.0, reached - 0.5 * (k * l) ** 2 * w))
    return pieces


def _string_phase(name: str, duration: str, end: bool = True) -> pl.Phase:
    return pl.Phase(
        name=name,
        states=_variables(x="m", c="m^2/s"),
        controls=(pl.ScalarControl(name="u", unit="m/s"),),
        dynamics=lambda x, u, p, xp: (u.u, 0.5 * (u.u * u.u - p.k * p.k * x.x * x.x)),
        duration=duration,
        end=pl.Conditions.of((lambda x, p, xp: (x.x - p.x1,)) if end else None, _variables(there="m") if end else ()),
        path=pl.Conditions(lambda x, u, p, xp: (p.l - x.x,), room="m"),
    )


def string_in_two_phases(k: float, rise: float, ride: float, fall: float, share: float, stop: bool = False) -> Solution:
    """The string, its flight stated in two phases whose joint lies at this share of what is ridden.

    With a `stop` it is stated that the first ends at l.
    """
    one = _string_phase("one", "T1", end=False)
    if stop:
        one = replace(one, end=pl.Conditions(lambda x, p, xp: (x.x - p.l,), stop="m"))
    joint, total = (rise + share * ride) / k, (rise + ride + fall) / k
    problem = pl.Problem(
        name="two_phases",
        phases=(one, _string_phase("two", "T2")),
        start=lambda p, xp: (p.x0, 0.0),
        links=(lambda x, p, xp: (x.x, x.c),),
        given=_given(T1=(joint, "s"), T2=(total - joint, "s"), k=(k, "1/s"), l=(1.0, "m"), x0=(math.cos(rise), "m"),
                     x1=(math.cos(fall), "m")),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s",
    )  # fmt: skip
    pieces = parted(string_pieces(k, rise, ride, fall), [joint])
    count = 1 if share == 0 else 2
    return by_hand(problem, pieces[:count], pieces[count:])


def two_strings(first: tuple[float, ...], second: tuple[float, ...]) -> Solution:
    """Two strings at once, each (k, rise, ride, fall), of one duration: what is ridden overlaps."""
    phase = pl.Phase(
        name="strings",
        states=_variables(x="m", y="m", c="m^2/s"),
        controls=(pl.ScalarControl(name="u", unit="m/s"), pl.ScalarControl(name="w", unit="m/s")),
        dynamics=lambda x, u, p, xp: (
            u.u, u.w, 0.5 * (u.u * u.u + u.w * u.w - p.k * p.k * x.x * x.x - p.h * p.h * x.y * x.y),
        ),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.x1, x.y - p.y1), there="m", beside="m"),
        path=pl.Conditions(lambda x, u, p, xp: (p.l - x.x, p.l - x.y), room="m", space="m"),
    )  # fmt: skip
    (k, *own), (h, *other) = first, second
    problem = pl.Problem(
        name="two_strings",
        phases=(phase,),
        start=lambda p, xp: (p.x0, p.y0, 0.0),
        given=_given(T=(sum(own) / k, "s"), k=(k, "1/s"), h=(h, "1/s"), l=(1.0, "m"), x0=(math.cos(own[0]), "m"),
                     y0=(math.cos(other[0]), "m"), x1=(math.cos(own[2]), "m"), y1=(math.cos(other[2]), "m")),
        objective=lambda x, p, xp: x.c,
        objective_unit="m^2/s",
    )  # fmt: skip
    of_each = [string_pieces(*first), string_pieces(*second)]
    times = [np.cumsum([piece.length for piece in pieces]).tolist() for pieces in of_each]
    halves = zip(parted(of_each[0], times[1]), parted(of_each[1], times[0]), strict=True)
    return by_hand(problem, [_at_once(a, b) for a, b in halves])


def _at_once(a: Piece, b: Piece) -> Piece:
    """Both with one cost."""
    (cost, rate), (more, faster) = a.state[1], b.state[1]
    spent = (lambda t: cost(t) + more(t), lambda t: rate(t) + faster(t))
    return Piece(a.length, [a.state[0], b.state[0], spent], [*a.control, *b.control],
                 [a.costate[0], b.costate[0], polynomial(1.0)])  # fmt: skip


def _swing(k: float, l: float, length: float, angle: Formula, way: float, cost: float) -> Piece:
    """x = l cos(angle), the angle growing (way 1) or falling (-1) at the rate k; J is int -(k l)^2 cos(2 angle)/2."""

    def spent(t: Any) -> Any:
        return cost - way * k * l * l * (np.sin(2 * angle(t)) - math.sin(2 * float(angle(0.0)))) / 4

    return Piece(
        length,
        [
            (lambda t: l * np.cos(angle(t)), lambda t: -way * k * l * np.sin(angle(t))),
            (spent, lambda t: -((k * l) ** 2) * np.cos(2 * angle(t)) / 2),
        ],
        [(lambda t: -way * k * l * np.sin(angle(t)), lambda t: -k * k * l * np.cos(angle(t)))],
        [(lambda t: way * k * l * np.sin(angle(t)), lambda t: k * k * l * np.cos(angle(t))), polynomial(1.0)],
    )


def beam(k: float, rise: float, ride: float, *, bend: float = 0.6, level: float = 0.0) -> Solution:
    """The beam with l = 1, rising and falling alike; lengths of its arcs in radians of k.

    It bends away from x = level, J = int (u^2 - k^4 (x - level)^2)/2 dt, and leaves l as x = level +
    a (cos z + cosh z)/2 - bend (sinh z - sin z), z = k t, a = l - level. Its multiplier along the arc is k^4 a.
    """
    l, t1, w = 1.0, rise / k, ride / k
    a = l - level

    def shape(order: int) -> Formula:
        """The derivative of that order of x - level by z."""

        def value(z: Any) -> Any:
            c, s, ch, sh = np.cos(z), np.sin(z), np.cosh(z), np.sinh(z)
            even = ((c, ch), (-s, sh), (-c, ch), (s, sh))[order % 4]
            odd = ((sh, s), (ch, c), (sh, -s), (ch, -c))[order % 4]
            return 0.5 * a * (even[0] + even[1]) - bend * (odd[0] - odd[1])

        return value

    node, weight = np.polynomial.legendre.leggauss(40)

    def spent(z: Any) -> Any:
        """J along the fall, from l."""
        at = 0.5 * np.asarray(z)[..., None] * (1 + node)
        return 0.25 * k**3 * np.asarray(z) * ((shape(2)(at) ** 2 - shape(0)(at) ** 2) @ weight)

    def x(order: int, way: float) -> Formula:
        """Derivative by time, on the way down (1) or up (-1)."""
        return lambda t: (way * k) ** order * shape(order)(k * t if way > 0 else k * (t1 - t))

    def swing(way: float, before: float) -> Piece:
        total = float(spent(rise))

        def cost(t: Any) -> Any:
            return before + (spent(k * t) if way > 0 else total - spent(k * (t1 - t)))

        return Piece(
            t1,
            [(lambda t: level + x(0, way)(t), x(1, way)), (x(1, way), x(2, way)),
             (cost, lambda t: 0.5 * (x(2, way)(t) ** 2 - k**4 * x(0, way)(t) ** 2))],
            [(x(2, way), x(3, way))],
            [(x(3, way), x(4, way)), (lambda t: -x(2, way)(t), lambda t: -x(3, way)(t)), polynomial(1.0)],
        )  # fmt: skip

    phase = pl.Phase(
        name="beam",
        states=_variables(x="m", v="m/s", c="m^2/s^3"),
        controls=(pl.ScalarControl(name="u", unit="m/s^2"),),
        dynamics=lambda x, u, p, xp: (x.v, u.u, 0.5 * (u.u * u.u - p.k**4 * (x.x - p.level) ** 2)),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x - p.x0, x.v + p.v0), there="m", speed="m/s"),
        path=pl.Conditions(lambda x, u, p, xp: (p.l - x.x,), room="m"),
    )
    problem = pl.Problem(
        name="beam", phases=(phase,), start=lambda p, xp: (p.x0, p.v0, 0.0),
        given=_given(T=(2 * t1 + w, "s"), k=(k, "1/s"), l=(l, "m"), level=(level, "m"),
                     x0=(level + float(shape(0)(rise)), "m"),
                     v0=(-k * float(shape(1)(rise)), "m/s")),
        objective=lambda x, p, xp: x.c, objective_unit="m^2/s^3",
    )  # fmt: skip
    third, up, load = -2 * bend * k**3, float(spent(rise)), k**4 * a  # of x, as it leaves
    ridden = Piece(
        w, [polynomial(l), polynomial(0.0), polynomial(up, -0.5 * load * a)], [polynomial(0.0)],
        [polynomial(third - load * w, load), polynomial(third * w - 0.5 * load * w * w, load * w - third, -0.5 * load),
         polynomial(1.0)],
    )  # fmt: skip
    pieces = [swing(-1.0, 0.0), ridden, swing(1.0, up - 0.5 * load * a * w)]
    return by_hand(problem, pieces, nodes=900)  # its fourth derivative is not small


def bryson_denham_ridden(ceiling: float, met: float) -> Solution:
    """Bryson and Denham's flight along x = l from `met` to 1 - `met` [s]; met = 3 l is the best of them, up to 1/2.

    At any other time u jumps there, and so do the costates, along the slope of x' too.
    """
    # x = t + a t^2 + b t^3 with x = l and x' = 0 at the time that it is met.
    a, b = np.linalg.solve([[met**2, met**3], [2 * met, 3 * met**2]], [ceiling - met, -1.0]).tolist()
    up, u = Polynomial([0.0, 1.0, a, b]), Polynomial([2 * a, 6 * b])
    cost, w, last = (u * u).integ() / 2, 1 - 2 * met, float(u(met))
    at = Polynomial([met, -1.0])  # the time left until it is met, seen from the way down

    def rows(*values: Polynomial) -> list[tuple[Formula, Formula]]:
        return [(value, value.deriv()) for value in values]

    one, spent = Polynomial([1.0]), float(cost(met))
    rise = Piece(met, rows(up, up.deriv(), cost), rows(u), rows(6 * b * one, -u, one))
    ride = Piece(w, rows(ceiling * one, 0 * one, spent * one), rows(0 * one),
                 rows(-6 * b * one, Polynomial([-last - 6 * b * w, 6 * b]), one))  # fmt: skip
    fall = Piece(met, rows(up(at), -up.deriv()(at), 2 * spent - cost(at)), rows(u(at)), rows(-6 * b * one, -u(at), one))
    return by_hand(bryson_denham(ceiling), [rise, ride, fall])


def parked_ridden(ceiling: float, met: float) -> Solution:
    """Rising to x = l until `met` and resting there to the end; met = 3 l is the best. At others u jumps there."""
    a, b = np.linalg.solve([[met**2, met**3], [2 * met, 3 * met**2]], [ceiling - met, -1.0]).tolist()
    up, u, one = Polynomial([0.0, 1.0, a, b]), Polynomial([2 * a, 6 * b]), Polynomial([1.0])
    cost = (u * u).integ() / 2

    def rows(*values: Polynomial) -> list[tuple[Formula, Formula]]:
        return [(value, value.deriv()) for value in values]

    rise = Piece(met, rows(up, up.deriv(), cost), rows(u), rows(6 * b * one, -u, one))
    rest = Piece(1 - met, rows(ceiling * one, 0 * one, float(cost(met)) * one), rows(0 * one),
                 rows(0 * one, 0 * one, one))  # fmt: skip
    return by_hand(parked(ceiling), [rise, rest])


def floor(depth: float) -> Solution:
    """Lying at x = 0 for 2 s under J = int u^2/2 + (s^2 - depth) x, s the time from -1 on: x' = u, S = x >= 0.

    The multiplier is s^2 - depth: where it is negative, x would better be above 0.
    """
    phase = pl.Phase(
        name="floor",
        states=_variables(x="m", s="s", c="m^2/s"),
        controls=(pl.ScalarControl(name="u", unit="m/s"),),
        dynamics=lambda x, u, p, xp: (
            u.u,
            p.T / p.T,
            0.5 * u.u * u.u + p.pull * (x.s * x.s / p.second**2 - p.depth) * x.x,
        ),
        duration="T",
        end=pl.Conditions(lambda x, p, xp: (x.x,), there="m"),
        path=pl.Conditions(lambda x, u, p, xp: (x.x,), above="m"),
    )
    problem = pl.Problem(
        name="floor",
        phases=(phase,),
        start=lambda p, xp: (0 * p.pull * p.second**2, -p.second, 0 * p.pull**2 * p.second**3),
        given=_given(T=(2.0, "s"), second=(1.0, "s"), pull=(1.0, "m/s^2"), depth=(depth, "1")),
        objective=lambda x, p, xp: x.c, objective_unit="m^2/s",
    )  # fmt: skip
    pieces = []
    for begin in (-1.0, 0.0):
        s = Polynomial([begin, 1.0])
        whole = depth * s - s**3 / 3  # lam' = -(s^2 - depth)
        pieces.append(Piece(1.0, [polynomial(0.0), polynomial(begin, 1.0), polynomial(0.0)], [polynomial(0.0)],
                            [(whole, whole.deriv()), polynomial(0.0), polynomial(1.0)]))  # fmt: skip
    return by_hand(problem, pieces)


def ditch(deep: float, wide: float, *, load: tuple[float, float] = (1.0, 0.0), pull: float = 0.0) -> Solution:
    """Down at a speed of 1 to x = l, along it for 2 s, and up for `wide` seconds: x' = u from -1 to 1, S = x - l >= 0.

    J = int (q + dip s^2) x dt - (r x + pull x^2/2) at the free end, s counted from the middle of the ride, (q, dip) the
    load and r such that to leave the arc when it does is stationary. H is linear in u, and its multiplier along the arc
    is q + dip s^2; J over the time of leaving bends by q + dip - pull at least, where dip is 0 exactly.
    """
    q, dip = load
    begin, ends = -1.0 - deep, (-1.0, 1.0, 1.0 + wide)
    weight = Polynomial([q, 0.0, dip])  # over s
    gone, low = weight.integ(), 0.2
    phase = pl.Phase(
        name="ditch",
        states=_variables(x="m", s="s", c="m*s"),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-1.0, upper=1.0),),
        dynamics=lambda x, u, p, xp: (u.u, p.T / p.T, (p.q + p.dip * x.s * x.s) * x.x),
        duration="T",
        path=pl.Conditions(lambda x, u, p, xp: (x.x - p.l,), above="m"),
    )
    top = low + wide
    r = float(gone(ends[2]) - gone(1.0)) - pull * top  # lam(T) = -r - pull x(T), and lam(1) = 0
    problem = pl.Problem(
        name="ditch", phases=(phase,), start=lambda p, xp: (p.x0, p.begin, 0 * p.x0 * p.begin),
        given=_given(T=(ends[2] - begin, "s"), q=(q, "1"), dip=(dip, "1/s^2"), l=(low, "m"), x0=(low + deep, "m"),
                     begin=(begin, "s"), r=(r, "s"), pull=(pull, "s/m")),
        objective=lambda x, p, xp: x.c - p.r * x.x - 0.5 * p.pull * x.x * x.x, objective_unit="m*s",
    )  # fmt: skip
    pieces, spent, at = [], 0.0, begin
    for end, x, u in zip(ends, ([low - 1.0, -1.0], [low], [low - 1.0, 1.0]), (-1.0, 0.0, 1.0), strict=True):
        s, zero = Polynomial([at, 1.0]), -1.0 if u < 0 else 1.0  # where the costate of x vanishes
        cost = (weight * Polynomial(x)).integ()
        lam, rate = gone(zero) - gone(s), -weight(s)
        of_s = -(Polynomial([0.0, 2 * dip]) * Polynomial(x)).integ()
        pieces.append((at, end, x, u, cost, lam, rate, of_s))
        at = end
    # The costate of s at the end is 0, and goes on through both joints.
    tables, left = [], 0.0
    for at, end, x, u, cost, lam, rate, of_s in reversed(pieces):
        s = Polynomial([at, 1.0])
        own = of_s(s) - of_s(end) + left
        left = float(own(0.0))
        tables.insert(0, (at, end, s, x, u, cost, lam, rate, own))
    flown = []
    for at, end, s, x, u, cost, lam, rate, own in tables:
        place, used = Polynomial(x)(s), cost(s) - cost(at) + spent
        spent = float(used(end - at))
        flown.append(Piece(
            end - at, [(place, place.deriv()), polynomial(at, 1.0), (used, used.deriv())], [polynomial(u)],
            [(lam, rate), (own, own.deriv()), polynomial(1.0)],
        ))  # fmt: skip
    return by_hand(problem, flown)
