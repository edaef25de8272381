"""Extremals from boxes of starts, enclosed step by step, thousands at once: in doubles, with one direction as control.

A box of starts is a centre and two columns, z(0) = c + V (d_1, d_2) with |d_i| <= 1. By the mean value theorem every
flight from it is c(t) + V(t) d + w, with the flight of the centre, an enclosure V of the tangents of the whole box and
a small w for what the centre may be off. A step is enclosed by Picard's inclusion; the centre's Taylor polynomial gets
the remainder of the whole tube, and columns v' = A v with A in [A] over the tube are

    v(h)  in  v + h [A] v + h^2/2 [A]([A] W)    with    v + [0, h] [A] W  in  W.

Where the vector that the direction is opposite to may vanish, the maximum principle says nothing of the direction: it
is any, in the whole disc, and the box goes on as a ball without columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from doubles import Doubles, ball, between, joined
from perilune.core import Stack
from perilune.problem import Problem, UnitVectorControl
from perilune.rigorous.equations import ProblemReader
from perilune.rigorous.exact_tape import Unsupported
from perilune.rigorous.taylor import TaylorProgram

Vector = list[Doubles]
_WIDER = 0.1  # of what a step adds: by so much an enclosure is wider than its first guess
_ATTEMPTS = 4
_PARTS = 8  # of a step in which any direction is allowed


class Equations:
    """Canonical equations of states that matter, and of their costates, for a problem of one phase and one direction.

    Parameters
    ----------
    problem
        As stated.
    cyclic
        States that no rate depends on and no end condition holds: their costates are zero.
    alone
        States that no control moves, as a mass: they move by themselves, and their costates are not asked for.
    """

    def __init__(self, problem: Problem, cyclic: Sequence[str], alone: Sequence[str]) -> None:
        (phase,) = problem.phases
        if not all(isinstance(control, UnitVectorControl) for control in phase.controls):
            raise Unsupported(f"{phase.name} has controls other than a direction")
        reader = ProblemReader(problem)
        arc, graph = reader.arc(0, {}), reader.graph
        names = list(phase.state_names)
        states = [i for i, name in enumerate(names) if name not in cyclic]
        costates = [arc.half + i for i in states if names[i] not in alone]
        self.names = [names[i] for i in states] + [f"lambda_{names[i - arc.half]}" for i in costates]
        self.places, self.count = [*states, *costates], len(states)
        zero = {("z", arc.half + i): graph.constant(0) for i, name in enumerate(names) if name in cyclic}
        still = graph.substitute([arc.rates[arc.half + names.index(name)] for name in cyclic], zero)
        rates = graph.substitute([arc.rates[i] for i in self.places], zero)
        keys = [("z", i) for i in self.places]
        pushed = [arc.rates[names.index(name)].inputs() for name in alone]
        if not all(e.vanishes() for e in still) or set[Any]().union(*(e.inputs() for e in rates)) - set(keys):
            raise Unsupported(f"{', '.join(cyclic)} is not cyclic, or a costate that is left out acts")
        if any(own - {("z", names.index(name)) for name in alone} for own in pushed):
            raise Unsupported(f"something moves {', '.join(alone)}")
        self.closed = TaylorProgram(graph, keys, rates)
        rows = graph.jacobian(rates, keys)
        slopes = [((i, j), e) for i, row in enumerate(rows) for j, e in enumerate(row) if not e.vanishes()]
        self.pattern = [place for place, _ in slopes]
        self.slopes = TaylorProgram(graph, keys, [e for _, e in slopes])
        control = [graph.substitute([e], zero)[0] for e in arc.control.values()]
        self.control = TaylorProgram(graph, keys, control)
        self.open = self._opened(reader, keys, costates, zero, arc.half)
        x = [graph.input(("z", i)) for i in range(len(names))]
        psi = reader.function((0, "end"), x, phase=phase)
        self.end = TaylorProgram(graph, keys[: self.count], psi)
        slopes = [e.constant for row in graph.jacobian(psi, keys[: self.count]) for e in row]
        self.end_slopes = np.array([float(e) for e in slopes]).reshape(len(psi), -1)
        start = TaylorProgram(graph, [], reader.function("start")).values([])
        self.start = [ball(start[i]) for i in states]

    def _opened(self, reader: ProblemReader, keys: Any, costates: Any, zero: Any, half: int) -> TaylorProgram:
        """The same rates of z and any control."""
        graph, phase = reader.graph, reader.problem.phases[0]
        x = [graph.input(("z", i)) for i in range(half)]
        u = [graph.input(("u", name)) for name in phase.control_names]
        f = reader.function((0, "dynamics"), x, u, phase=phase)
        H = sum((graph.input(("z", half + i)) * rate for i, rate in enumerate(f)), graph.constant(0))
        slopes = graph.gradient(H, [("z", i - half) for i in costates])
        rates = [f[i] for i in self.places[: self.count]] + [-slope for slope in slopes]
        return TaylorProgram(
            graph, [*keys, *(("u", name) for name in phase.control_names)], graph.substitute(rates, zero)
        )


@dataclass(kw_only=True)
class Bundle:
    """Flights from boxes at one time, lane by lane: z = centre + columns d + off.

    Attributes
    ----------
    centre
        Doubles, exactly.
    columns
        Two vectors, the derivatives by d.
    off
        What is to be added.
    """

    centre: list[Stack]
    columns: list[Vector]
    off: Vector

    @property
    def hull(self) -> Vector:
        """Balls that hold all flights."""
        return [w.wider(sum(v[i].size for v in self.columns)) + Doubles(self.centre[i]) for i, w in enumerate(self.off)]

    def taken(self, lanes: Any) -> Bundle:
        """Some of the lanes."""
        return Bundle(
            centre=[c[lanes] for c in self.centre],
            columns=[[x[lanes] for x in v] for v in self.columns],
            off=[x[lanes] for x in self.off],
        )

    def put(self, lanes: Any, others: Bundle) -> None:
        """Others in the place of some lanes."""
        for own, new in zip(self.centre, others.centre, strict=True):
            own[lanes] = new
        pairs = zip([*self.columns, self.off], [*others.columns, others.off], strict=True)
        for own, new in ((a, b) for v, w in pairs for a, b in zip(v, w, strict=True)):
            own.c[lanes], own.r[lanes] = new.c, new.r


@dataclass(kw_only=True)
class Moved:
    """A step: where it ends, and what holds all flights, their rates and the tangents during it."""

    end: Bundle
    tube: Vector
    rates: Vector
    columns: list[Vector]


def step(equations: Equations, bundle: Bundle, length: float, order: int) -> Moved:
    """All lanes one step on; what is not enclosed is not a number.

    Parameters
    ----------
    equations, bundle
        What flies.
    length, order
        Of the step, in the unit of time, and of the remainder.
    """
    with np.errstate(all="ignore"):
        moved = _closed(equations, bundle, length, order)
        # Where any direction at all leaves less in doubt, it is better not to use the maximum principle.
        bad = _doubtful(moved.end, bundle, moved.rates, length)
        if bad.any():
            _put(moved, bad, _any_direction(equations, bundle.taken(bad), length))
        return moved


def _doubtful(end: Bundle, begin: Bundle, rates: Vector, length: float) -> Any:
    """Lanes whose velocity has become more uncertain than what a step adds to it at most, or is not a number."""
    bad = np.zeros(len(end.centre[0]), bool)
    for new, old, rate in zip(end.hull, begin.hull, rates, strict=True):
        bad |= ~(new.r <= 2 * old.r + 2 * length * rate.size)
    return bad


def _closed(equations: Equations, bundle: Bundle, h: float, order: int) -> Moved:
    span = Doubles(0.5 * h, 0.5 * h)
    tube, rates = _tube(bundle.hull, lambda Z: _values(equations.closed, Z), span)
    rates = _values(equations.closed, tube)
    remainder = equations.closed.flow(tube, order)[0]
    polynomial = equations.closed.flow([Doubles(c, np.zeros_like(c)) for c in bundle.centre], order - 1)[0]
    powers = [Doubles(1.0)]
    for _ in range(order):
        powers.append(powers[-1] * h)
    A = equations.slopes.values(tube)
    centre, off = list[Stack](), list[Doubles]()
    ends, tubes = zip(*(_linear(equations, A, v, h, span) for v in (*bundle.columns, bundle.off)), strict=True)
    for own, last, w in zip(polynomial, remainder, ends[-1], strict=True):
        total = ball(own[0])
        for c, power in zip(own[1:], powers[1:-1], strict=True):
            total = total + c * power
        total = total + last[order] * powers[order]
        centre.append(total.c)
        off.append(w.wider(total.r))
    return Moved(
        end=Bundle(centre=centre, columns=list(ends[:-1]), off=off), tube=tube, rates=rates, columns=list(tubes[:-1])
    )


def _values(program: TaylorProgram, z: Vector) -> Vector:
    """Outputs in every lane, those that are constants too."""
    none = Doubles(np.zeros_like(z[0].c), np.zeros_like(z[0].r))
    return [value if isinstance(value, Doubles) else none + value for value in program.values(z)]


def _tube(z: Vector, rates: Any, span: Doubles) -> tuple[Vector, Vector]:
    """What holds the flights from z over a step: z + [0, h] F(Z) in Z."""
    F = rates(z)
    Z = [a + span * f for a, f in zip(z, F, strict=True)]
    Z = [a.wider(_WIDER * span.size * f.size) for a, f in zip(Z, F, strict=True)]
    for attempt in range(_ATTEMPTS):
        F = rates(Z)
        inner = [a + span * f for a, f in zip(z, F, strict=True)]
        held = np.all([a.holds(b) for a, b in zip(Z, inner, strict=True)], axis=0)
        if held.all() or attempt + 1 == _ATTEMPTS:
            break
        Z = [joined(a, b).wider(_WIDER * b.r) for a, b in zip(Z, inner, strict=True)]
    return [Doubles(np.where(held, a.c, np.nan), np.where(held, a.r, np.nan)) for a in inner], F


def _applied(equations: Equations, A: Sequence[Any], v: Vector) -> Vector:
    found: list[Any] = [None] * len(v)
    for (i, j), a in zip(equations.pattern, A, strict=True):
        term = a * v[j]
        found[i] = term if found[i] is None else found[i] + term
    zero = Doubles(np.zeros_like(v[0].c), np.zeros_like(v[0].r))
    return [zero if x is None else x for x in found]


def _linear(equations: Equations, A: Sequence[Any], v: Vector, h: float, span: Doubles) -> tuple[Vector, Vector]:
    """A column at the end of a step, and over all of it."""
    Av = _applied(equations, A, v)
    inner, held = list[Doubles](), np.zeros(0, bool)
    guess = [a + span * b for a, b in zip(v, Av, strict=True)]
    AW = _applied(equations, A, guess)
    for attempt in range(_ATTEMPTS):
        inner = [a + span * b for a, b in zip(v, AW, strict=True)]
        W = [a.wider(_WIDER * (attempt + 1) * span.size * b.size) for a, b in zip(inner, AW, strict=True)]
        AW = _applied(equations, A, W)
        inner = [a + span * b for a, b in zip(v, AW, strict=True)]
        held = np.all([a.holds(b) for a, b in zip(W, inner, strict=True)], axis=0)
        if held.all():
            break
    last = [a * (Doubles(h) * h * 0.5) for a in _applied(equations, A, AW)]
    end = [a + b * h + c for a, b, c in zip(v, Av, last, strict=True)]
    lost = np.where(held, 0.0, np.nan)
    return [a.wider(lost) for a in end], [a.wider(lost) for a in inner]


def _any_direction(equations: Equations, bundle: Bundle, length: float) -> Moved:
    h = length / _PARTS  # a power of two: exactly
    span = Doubles(0.5 * h, 0.5 * h)
    z = bundle.hull
    zero = np.zeros_like(z[0].c)
    tubes, all_rates = list[Vector](), list[Vector]()
    for _ in range(_PARTS):
        u = [Doubles(zero, zero + 1.0) for _ in equations.control.outputs]
        for _ in range(2):
            Z, _ = _tube(z, lambda Z, u=u: _values(equations.open, [*Z, *u]), span)
            told = equations.control.values(Z)
            u = [between(np.fmax(a.low, -1.0), np.fmin(a.high, 1.0)) for a in told]
        Z, _ = _tube(z, lambda Z, u=u: _values(equations.open, [*Z, *u]), span)
        F = _values(equations.open, [*Z, *u])
        z = [a + f * h for a, f in zip(z, F, strict=True)]
        tubes.append(Z)
        all_rates.append(F)
    none = [Doubles(zero, zero) for _ in z]
    end = Bundle(centre=[a.c for a in z], columns=[list(none), list(none)], off=[Doubles(zero, a.r) for a in z])
    return Moved(end=end, tube=_joined(tubes), rates=_joined(all_rates), columns=[list(none), list(none)])


def _joined(vectors: Sequence[Vector]) -> Vector:
    found = vectors[0]
    for own in vectors[1:]:
        found = [joined(a, b) for a, b in zip(found, own, strict=True)]
    return found


def _put(moved: Moved, lanes: Any, others: Moved) -> None:
    moved.end.put(lanes, others.end)
    pairs = zip([moved.tube, moved.rates, *moved.columns], [others.tube, others.rates, *others.columns], strict=True)
    for v, w in pairs:
        for i, new in enumerate(w):
            c, r = (np.array(np.broadcast_to(x, moved.end.centre[0].shape)) for x in (v[i].c, v[i].r))
            c[lanes], r[lanes] = new.c, new.r
            v[i] = Doubles(c, r)
