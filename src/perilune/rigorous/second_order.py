"""Sufficient conditions of the second order, enclosed: the extremal is a strict local optimum.

Each arc is flown in a time from 0 to 1. Its length, where that is an unknown, is a constant state as every free
parameter is, all along the flight; scalars on a bound are held there, and are no variation. So arcs that follow each
other in a phase are one smooth problem, though their equations differ. Let W be symmetric with

    W' = -H_xx - W f_x - f_x' W + (H_xu + W f_u) H_uu^-1 (H_ux + f_u' W)

on an arc, the same on both sides of a switch, and passed on by the start and by links as `junctions` says. Then the
second variation is no less than

    dx' (Phi_xx - W) dx at the last end + int |du + ...|^2_H_uu dt,    Phi = J + nu . psi,

for all variations that the start, the links and the end conditions allow. So it suffices that H_uu > 0 (`limits`), that
W exists, that no junction has too little weight, and that Phi_xx - W is positive on the kernel of psi_x at the last end
(Zeidan, *Sufficient conditions for the generalized problem of Bolza*, 1983; Maurer, Pickenhain, *Second-order
sufficient conditions for control problems with mixed control-state constraints*, 1995). W = Lambda X^-1 with the
tangents (X, Lambda) of the canonical equations that begin with (1, W); it exists as long as X is regular (`regular`).
They restart with every step, where W may be replaced by a larger one: what lies before is still no less. As X
begins with 1, nothing is singular at the start; large M come as close as one likes to the condition that no point is
conjugate to it. Where no formula gives scalars w, (dx, dlambda) move them by dw = -H_ww^-1 H_wz dz where a step
begins; H_ww > 0 there, and it stays so, as w' divides by the pivots of its elimination all along.

A scalar on a bound is none of this: dH/du has to have its sign strictly, up to both ends of the arc but where it
switches, and to pass through 0 with a slope there, with H affine in it. Then that arcs may have other lengths is all
that matters of other controls (Osmolovskii, Maurer, *Applications to Regular and Bang-Bang Control*, 2012, part II;
Agrachev, Stefani, Zezza, *Strong optimality for a bang-bang trajectory*, 2002). A free parameter on a bound where J has
a slope, or an end at such a bound of its range, moves no more than one that is given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from flint import arb, arb_mat

from perilune.rigorous.boundary_equations import arc_duration
from perilune.rigorous.boundary_value_problem import BoundaryProblem, Differentiated
from perilune.rigorous.enclosure import ball_identity
from perilune.rigorous.enclosure_step import NotEnclosed, enclose_step
from perilune.rigorous.equations import CanonicalArc, ProblemReader
from perilune.rigorous.graph import GraphExpression
from perilune.rigorous.hamiltonian_minimum import positive_definite
from perilune.rigorous.inequalities import SignedQuantity, Statement
from perilune.rigorous.krawczyk import EnclosedRoot
from perilune.rigorous.riccati_junctions import Junction, first_irregular_time, pass_junction, upper_bound_matrix
from perilune.rigorous.taylor import Ball

_WEIGHTS = (1e2, 1e4, 1e6)  # times the size of J over the square of that of a state
_NOT_POSITIVE = "the second variation is not shown to be positive at the end"
_HALVED = 5  # times at most is a step


@dataclass(frozen=True, kw_only=True)
class OptimumStatement(Statement):
    """Statement that an extremal is a strict local optimum.

    Attributes
    ----------
    weights
        M of each phase, of its states and of what is free and on no bound, by which it was seen.
    """

    words: str = "a strict local optimum"
    weights: Sequence[Sequence[float]] = ()


def prove_local_optimum(
    boundary: BoundaryProblem, root: EnclosedRoot, order: int, tell: Callable[[str], None]
) -> OptimumStatement:
    """Prove, if possible, that a proved extremal is a strict local optimum.

    Parameters
    ----------
    boundary, root
        The equations and their root.
    order
        Of the steps.
    tell
        Called with a line for every part.
    """
    where = next(_unsupported_cases(boundary, root), "")
    if where:
        return OptimumStatement(proved=False, where=f"as {where}")
    form, found = _SecondVariationForm(boundary, root), list[str]()
    for weight in _WEIGHTS:
        try:
            found.append(form.fails(order, weight))
        except (NotEnclosed, ZeroDivisionError) as error:
            found.append(error.what if isinstance(error, NotEnclosed) else "a matrix is singular")
        tell(f"second variation, weight {weight:.0e}: {found[-1] or 'positive'}")
        if not found[-1]:
            return OptimumStatement(proved=True, weights=form.weights_of_moving(weight))
    last = next((where for where in found if where == _NOT_POSITIVE), found[-1])  # it says the most
    return OptimumStatement(proved=False, where=f"as {last}")


def _unsupported_cases(boundary: BoundaryProblem, root: EnclosedRoot) -> Iterator[str]:
    """Yield the requirements on scalars on bounds and at switches that are not proved, in words."""
    for i, (piece, arc) in enumerate(zip(boundary.pieces, boundary.arcs, strict=True)):
        if arc.idle:
            yield "the factor of a direction may vanish on an interval"
        if piece.switched and arc.joint:
            yield "the control without a formula has switches"
        if piece.switched:
            following = boundary.pieces[i + 1].regimes
            if [name for name in piece.regimes if piece.regimes[name] != following[name]] != [piece.switched]:
                yield f"{piece.switched} does not switch separately"
        flown = root.flight.nodes[i]
        before = boundary.pieces[i - 1].switched if i else ""
        for scalar in arc.scalars:
            name = scalar.control.name
            zeros = [1 if name == before else 0, -1 if name == piece.switched else 0]
            if any(zeros) and (scalar.regime == "interior" or not scalar.curvature.vanishes()):
                yield f"H is not affine in {name}, which switches"
            if scalar.regime == "interior":
                continue
            sign, slope = 1 if scalar.regime == "lower" else -1, SignedQuantity(arc, scalar.slope, root.y)
            for z, zero in zip((flown[0], flown[-1]), zeros, strict=True):
                if not sign * (zero * slope.value(z, 1) if zero else slope.value(z)) > 0:
                    what = "cross 0 with a slope" if zero else "keep its sign to an end"
                    yield f"dH/d({name}) is not shown to {what}"


class _SecondVariationForm:
    """The second variation of a flight."""

    def __init__(self, boundary: BoundaryProblem, root: EnclosedRoot) -> None:
        problem, pieces = boundary.problem, boundary.pieces
        self.boundary, self.phases = boundary, problem.phases
        reader = self.reader = ProblemReader(problem)
        self.names = (*problem.free_names, *boundary.lengths.values())
        self.free = {name: reader.graph.input(("p", name)) for name in self.names}
        named = dict(zip(boundary.names, root.y, strict=True))
        self.constants = [named[name] for name in self.names]
        # Not by name: a free parameter may be called as a state is, and an end condition as another.
        self.costates = [
            [root.y[i] for i in own[: len(phase.states)]]
            for own, phase in zip(boundary.costates, self.phases, strict=True)
        ]
        self.multipliers = [[root.y[i] for i in own] for own in boundary.multipliers]
        lengths = {i: self.free[name] for i, name in boundary.lengths.items()}
        given = {**reader.given, **self.free}
        self.arcs: list[list[tuple[int, CanonicalArc]]] = [[] for _ in self.phases]
        for i, piece in enumerate(pieces):
            length = arc_duration(pieces, i, lengths, given[self.phases[piece.phase].duration])
            self.arcs[piece.phase].append((i, reader.arc(piece.phase, piece.regimes, length, self.names)))
        self.moving = [("p", name) for name in self.names if name not in boundary.sides.free]
        self.junctions = [self._junction(k) for k in range(len(self.phases) + 1)]
        self.sizes = _state_sizes(boundary, root)
        self.durations = [duration.values(root.y)[0] for duration in boundary.durations]
        self.times = [
            [*(own.begin / duration for own in steps), arb(1)]
            for steps, duration in zip(root.flight.steps, self.durations, strict=True)
        ]
        self.nodes = [
            [_without_constants(z, arc) for z in nodes]
            for nodes, arc in zip(root.flight.nodes, boundary.arcs, strict=True)
        ]
        self.w = [nodes[0][2 * arc.half :] for nodes, arc in zip(root.flight.nodes, boundary.arcs, strict=True)]

    def _junction(self, k: int) -> tuple[Junction, list[Ball]]:
        """Return the junction before phase k, or behind the last one, and its multipliers."""
        graph, reader = self.reader.graph, self.reader
        psi, nu = list[GraphExpression](), list[Ball]()
        if k == 0:
            before, inputs = None, [("p", name) for name in self.names]
            at, free = [], self.free
        else:
            before = self.phases[k - 1]
            inputs = [("z", i) for i in range(len(before.states) + len(self.names))]
            at = [graph.input(key) for key in inputs]
            free = dict(zip(self.names, at[len(before.states) :], strict=True))
            values, held = list[GraphExpression](), self.boundary.sides.held(before)
            if before.end_conditions:
                values = reader.function((k - 1, "end"), at, free=free, phase=before)
            sides = [self.boundary.sides.ranges.get((before.name, c.name)) for c in before.end_conditions]
            ends = zip(
                [*values, *(at[i] for i in held)], [*sides, *(None for _ in held)], self.multipliers[k - 1], strict=True
            )
            for value, side, own in ends:
                if side != "inside":  # the bound of a range, or of a state, is given, so that it moves nothing
                    psi.append(value)
                    nu.append(own)
        if k < len(self.phases):
            follows = reader.function(("links", k - 1) if k else "start", at, free=free, phase=before)
            costates = self.costates[k]
            lagrangian = sum((graph.input(("lam", i)) * e for i, e in enumerate(follows)), graph.constant(0))
            follows = [*follows, *free.values()]
        else:
            follows, costates = [], []
            lagrangian = reader.function("objective", at, free=free, phase=before)[0]
        for i, value in enumerate(psi):
            lagrangian = lagrangian + graph.input(("nu", i)) * value
        others = [*(("lam", i) for i in range(len(costates))), *(("nu", i) for i in range(len(nu)))]
        varied = inputs if k else self.moving
        return Junction(graph, [*inputs, *others], varied, follows, lagrangian, psi), [*costates, *nu]

    def _weights(self, weight: float) -> list[list[float]]:
        """M of each phase: as much as moving by its size would cost, by its costate, times the weight."""
        costs = [
            abs(float(c)) * s
            for own, sizes in zip(self.costates, self.sizes, strict=True)
            for c, s in zip(own, sizes, strict=True)
        ]
        together = max(costs) or 1.0
        constant = [max(abs(float(value)), 1e-3) for value in self.constants]
        return [[weight * together / (size * size) for size in (*sizes, *constant)] for sizes in self.sizes]

    def weights_of_moving(self, weight: float) -> list[list[float]]:
        """Return the weights without parameters on a bound."""
        moving = [("p", name) in self.moving for name in self.names]
        return [
            [m for m, kept in zip(own, [True] * len(sizes) + moving, strict=True) if kept]
            for own, sizes in zip(self._weights(weight), self.sizes, strict=True)
        ]

    def fails(self, order: int, weight: float) -> str:
        """Return the condition that is not enclosed, in words; "" where all are."""
        W, z, before = None, self.constants, [1.0] * len(self.moving)
        for k, weights in enumerate(self._weights(weight)):
            (junction, multipliers), half = self.junctions[k], len(weights)
            at = [*z, *multipliers]
            W = pass_junction(*junction.form(at, W, before), weights)
            if W is None:
                return f"the weights do not dominate the curvature of the start of {self.phases[k].name}"
            z = [*junction.follows(at), *self.costates[k], *([arb(0)] * len(self.names))]
            for i, arc in self.arcs[k]:
                z = [*z[: 2 * half], *self.w[i]]
                z, W, t = _propagate_bound(arc, z, W, self.times[i], self.nodes[i], weights, order)
                if t is not None:
                    place = f"{arc.phase.name}, arc {i + 1}" if len(self.arcs[k]) > 1 else arc.phase.name
                    seconds = float((t * self.durations[i]).mid())
                    return f"no solution of Riccati's equation is enclosed at {seconds:.6g} s ({place})"
            z, before = z[:half], weights
        junction, multipliers = self.junctions[-1]
        _, C = junction.form([*z, *multipliers], W, before)
        return "" if positive_definite(C) else _NOT_POSITIVE


def _propagate_bound(
    arc: CanonicalArc,
    z: list[Ball],
    W: Any,
    times: Sequence[Ball],
    nodes: Sequence[Sequence[Ball]],
    weights: Sequence[float],
    order: int,
) -> tuple[list[Ball], Any, Ball | None]:
    """Return z and an exact W at the end of an arc, and a time at which X is not seen to be regular, else None.

    Each step begins with X = 1 and an exact W, hardly larger than where the one before ends it: tangents of a whole arc
    would be lost by wrapping, whatever W is like. Where z is at the times is known from the flight, as
    `_without_constants` has it: by steps only it would be lost too. Steps are halved where V is not enclosed, or X not
    seen to be regular.
    """
    own, half = _without_constants(range(len(z)), arc), arc.half
    kept = Differentiated(arc.graph, arc.stationary, [arc.keys[: 2 * half], arc.keys[2 * half :]])
    waiting = [(*pair, 0, node) for pair, node in zip(pairwise(times), nodes[1:], strict=True)]
    while waiting:
        begin, end, depth, node = waiting.pop(0)
        try:
            ahead, V, proved = enclose_step(arc, z, _tangents_with_control(kept, z, W), begin, end - begin, order)
            t, rows = first_irregular_time(proved, half), V.tolist()
        except NotEnclosed:
            if depth == _HALVED:
                raise
            ahead, t, rows = z, begin, []
        if t is None:
            z = ahead
            W = upper_bound_matrix(arb_mat(rows[half : 2 * half]) * arb_mat(rows[:half]).inv(), weights)
            for i, known in zip(own, node, strict=True) if node else ():
                if not z[i].overlaps(known):
                    raise NotEnclosed("two enclosures of one flight are disjoint")
                z[i] = z[i].intersection(known)
        elif depth == _HALVED:
            return z, W, t
        else:
            middle = ((begin + end) / 2).mid()
            waiting[:0] = [(begin, middle, depth + 1, ()), (middle, end, depth + 1, node)]
    return z, W, None


def _without_constants(z: Sequence[Any], arc: CanonicalArc) -> list[Any]:
    """Return the entries of z without constant states and their costates."""
    n = len(arc.phase.states)
    return [*z[:n], *z[arc.half : arc.half + n], *z[2 * arc.half :]]


def _state_sizes(boundary: BoundaryProblem, root: EnclosedRoot) -> list[list[float]]:
    """About how large the states of each phase are; 1 where nothing is known but that one may be 0 all along."""
    found = list[list[float]]()
    for k, phase in enumerate(boundary.problem.phases):
        own = [i for i, piece in enumerate(boundary.pieces) if piece.phase == k]
        along = [one.at(arb(0).union(one.length)) for i in own for one in root.flight.steps[i]]
        nodes = [z for i in own for z in root.flight.nodes[i]]
        found.append([
            max(float(z[j].abs_upper()) for z in along) if any(not z[j].contains(0) for z in nodes) else 1.0
            for j in range(len(phase.states))
        ])  # fmt: skip
    return found


def _tangents_with_control(kept: Differentiated, z: Sequence[Ball], W: Any) -> Any:
    """(1, W), and below how that moves what no formula gives of the control: so that dH/dw is kept 0."""
    half = W.nrows()
    V = arb_mat(ball_identity(half).tolist() + W.tolist())
    if not kept.count:
        return V
    _, (by_z, by_w) = kept.slopes(z[: 2 * half], z[2 * half :])
    if not positive_definite(by_w):
        raise NotEnclosed("H is not shown to be convex in the control without a formula")
    return arb_mat(V.tolist() + (by_w.inv() * by_z * V * -1).tolist())
