"""Boundary value problem of an extremal as equations F(y) = 0, with their derivatives.

The unknowns y are lambda(0) of each phase, the free parameters, the multipliers nu of the end conditions, the length of
every arc of a phase but its last one, and what no formula gives of the control, w, where its arc begins. A state that
is held by a bound where its phase ends is one more end condition, psi = x - bound, whose multiplier has a sign. Arcs
follow each other; the start of each is a function of y and of the end of the one before. With L = J + nu . psi +
lambda_k(0) . x_k(0) the equations are

    psi = 0,    lambda(T) = dL/dx(T),    dL/dq = 0 (and H added where q is the duration),    dH/du = 0 at a switch,

and dH/dw = 0 where an arc begins.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from flint import arb, arb_mat

from perilune.problem import Phase, Problem
from perilune.rigorous.equations import CanonicalArc, Key, Regimes
from perilune.rigorous.graph import Graph, GraphExpression
from perilune.rigorous.taylor import Ball, TaylorProgram


@dataclass(frozen=True, kw_only=True)
class ArcPiece:
    """An arc of a phase: its phase, the regimes, and by which scalar's switch it ends, "" at the phase's end."""

    phase: int
    regimes: Regimes
    switched: str = ""


@dataclass(frozen=True, kw_only=True)
class Sides:
    """Bounds on which the extremal lies.

    Attributes
    ----------
    free
        ``lower`` or ``upper`` of the free parameters that are on a bound, by name.
    ranges
        Of end conditions that are ranges, by phase and name: ``lower``, ``upper``, or ``inside``.
    states
        ``lower`` or ``upper`` of the states that a bound holds where their phase ends, by phase and name.
    """

    free: Mapping[str, str] = field(default_factory=dict)
    ranges: Mapping[tuple[str, str], str] = field(default_factory=dict)
    states: Mapping[tuple[str, str], str] = field(default_factory=dict)

    def held(self, phase: Phase) -> list[int]:
        """Return the states of a phase that a bound holds at its end."""
        return [i for i, name in enumerate(phase.state_names) if (phase.name, name) in self.states]


class Differentiated:
    """Expressions of y and of one or more ends, with their derivatives, sparse."""

    def __init__(self, graph: Graph, outputs: Sequence[GraphExpression], groups: Sequence[Sequence[Key]]) -> None:
        self.count = len(outputs)
        keys = [key for group in groups for key in group]
        rows = graph.jacobian(outputs, keys)
        self._places: list[list[tuple[int, int]]] = []
        slopes = list[GraphExpression]()
        at = 0
        for group in groups:
            here = [(i, j) for i in range(self.count) for j in range(len(group)) if not rows[i][at + j].vanishes()]
            self._places.append(here)
            slopes += [rows[i][at + j] for i, j in here]
            at += len(group)
        self._shapes = [(self.count, len(group)) for group in groups]
        self._values = TaylorProgram(graph, keys, outputs)
        self._all = TaylorProgram(graph, keys, [*outputs, *slopes])

    def values(self, *groups: Sequence[Ball]) -> list[Ball]:
        """The outputs."""
        return self._values.values([value for group in groups for value in group])

    def slopes(self, *groups: Sequence[Ball]) -> tuple[list[Ball], list[Any]]:
        """The outputs, and a matrix of derivatives for each group."""
        found = self._all.values([value for group in groups for value in group])
        rest, matrices = iter(found[self.count :]), []
        for shape, places in zip(self._shapes, self._places, strict=True):
            matrix = arb_mat(*shape)
            for place in places:
                matrix[place] = next(rest)
            matrices.append(matrix)
        return found[: self.count], matrices

    def moved_by(self, group: int) -> set[int]:
        """Return the entries of a group on which any output depends."""
        return {j for _, j in self._places[group]}


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundaryProblem:
    """F(y) = 0.

    Attributes
    ----------
    problem, pieces, sides, arcs
        What is flown: the arcs in order.
    names
        Of the entries of y.
    starts
        For each arc (y, z before) -> z(0).
    durations
        For each arc y -> its length.
    residual
        (y, end of each arc) -> F.
    rows
        What each entry of F is, in words.
    meets
        What vanishes at the end of each arc: end conditions of its phase, or what a switch asks for.
    objective
        (y, last end) -> J.
    signs
        (y, ends) -> what has to be positive at the bounds that the extremal is on, and its room in other ranges.
    signed
        What each of these is, in words.
    lengths
        Names of the lengths of arcs among the unknowns, by arc.
    """

    problem: Problem
    graph: Graph
    pieces: tuple[ArcPiece, ...]
    sides: Sides
    arcs: tuple[CanonicalArc, ...]
    names: tuple[str, ...]
    starts: tuple[Differentiated, ...]
    durations: tuple[Differentiated, ...]
    residual: Differentiated
    rows: tuple[str, ...]
    meets: tuple[tuple[GraphExpression, ...], ...]
    objective: Differentiated
    signs: Differentiated
    signed: tuple[str, ...]
    lengths: Mapping[int, str]

    @cached_property
    def costates(self) -> tuple[range, ...]:
        """Return for each phase the entries of y that are costates of its states, and then of constant states."""
        found, at = list[range](), 0
        for k in range(len(self.problem.phases)):
            half = next(arc.half for arc in self.arcs if arc.phase_index == k)
            found.append(range(at, at + half))
            at += half
        return tuple(found)

    @cached_property
    def multipliers(self) -> tuple[range, ...]:
        """Return for each phase the entries of y that are multipliers of its end conditions, which may share a name.

        Behind these stand those of states that a bound holds there.
        """
        found, at = list[range](), self.costates[-1].stop + len(self.problem.free)
        for phase in self.problem.phases:
            found.append(range(at, at + len(phase.end_conditions) + len(self.sides.held(phase))))
            at = found[-1].stop
        return tuple(found)

    @property
    def unguessed(self) -> set[int]:
        """Return the entries of y that no solution gives: costates of constant states, whose names states may share."""
        return {i for own, phase in zip(self.costates, self.problem.phases, strict=True)
                for i in own[len(phase.states) :]}  # fmt: skip

    @cached_property
    def columns(self) -> tuple[tuple[int, ...], ...]:
        """Return for each arc the entries of y that move its start."""
        found = list[tuple[int, ...]]()
        before = set[int]()
        for start, duration in zip(self.starts, self.durations, strict=True):
            own = start.moved_by(0) | (before if start.moved_by(1) else set())
            found.append(tuple(sorted(own)))
            before = own | duration.moved_by(0)
        return tuple(found)


def matrix_columns(columns: Sequence[int], of: Any) -> Any:
    """Return a matrix made of some columns of another.

    Parameters
    ----------
    columns
        Indices of the columns, in the order wanted; with none the result has no column.
    of
        ``arb_mat`` to take them from.
    """
    return arb_mat([[of[i, j] for j in columns] for i in range(of.nrows())]) if columns else arb_mat(of.nrows(), 0)


def balls(values: Sequence[Any]) -> list[Ball]:
    """Return numbers as exact balls."""
    return [arb(value) for value in values]
