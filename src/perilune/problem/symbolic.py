"""Trace a user's physics on CasADi SX: the one text that is also flown by the verifier becomes expressions.

Everything is traced in canonical units: because the physics is dimensionally homogeneous (tested by `Problem`), the
same text holds when states and parameters are divided by their `Scales`; what has a scale of its own is brought to them
in `Problem.canonical`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from perilune.problem.problem import Free, Phase, Problem
from perilune.words.maths import NUMPY_NAMES, Table
from perilune.words.outcome import PeriluneError
from perilune.words.types import Vector


def _read(table: Table, value: Any) -> Any:
    return table.chosen(value, ca.if_else)


SYMBOLIC = SimpleNamespace(**{name: getattr(ca, name) for name in NUMPY_NAMES}, where=ca.if_else, table=_read)


@dataclass(frozen=True, eq=False)
class Unnumbered:
    """A problem as the key of what is derived from it: equal where the form is, and what is given, free and bounded.

    Values and bounds do not count, so that a whole family shares one derivation. Trace from `problem`, whose functions
    are expressions here: a cache then keeps none of the user's objects alive.
    """

    stated: Problem

    @cached_property
    def problem(self) -> Problem:
        """The problem with its functions as expressions of canonical values."""
        return self.stated.canonical.expressed

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Unnumbered) and self.stated.structure == other.stated.structure

    def __hash__(self) -> int:
        return hash(self.stated.structure)


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """Symbols of a problem's parameters: `given` in the order of `Problem.given`, `free` in that of `Problem.free`."""

    given: ca.SX
    free: ca.SX
    record: SimpleNamespace


def trace_parameters(problem: Problem) -> Parameters:
    """One symbol for each given and each free parameter."""
    given = ca.SX.sym("given", len(problem.given))
    free = ca.SX.sym("free", len(problem.free))
    record = SimpleNamespace(
        **{name: given[i] for i, name in enumerate(problem.given)},
        **{name: free[i] for i, name in enumerate(problem.free_names)},
    )
    return Parameters(given=given, free=free, record=record)


def column(values: Any) -> ca.SX:
    """A user's returned sequence as one column of expressions."""
    return ca.vertcat(ca.SX(0, 1), *[ca.SX(v) for v in values])


def elements(vector: ca.SX) -> list[ca.SX]:
    """The entries of a column, as the user's functions receive them."""
    return [vector[i] for i in range(vector.numel())]


def trace_rates(phase: Phase, x: ca.SX, u: ca.SX, p: SimpleNamespace) -> ca.SX:
    """The phase's dynamics as a column."""
    return column(phase.rates(elements(x), elements(u), p, SYMBOLIC))


MOST_KINKS = 4  # of one phase: each doubles the modes


@dataclass(frozen=True, kw_only=True)
class Kinked:
    """The dynamics of a phase side by side.

    Parameters
    ----------
    margins
        One expression of x for each condition of an ``m.where`` that changes in flight, positive where it holds.
    sides
        Each combination of conditions that hold (True) or do not.
    rates
        The rates on each of `sides`.
    """

    margins: tuple[ca.SX, ...]
    sides: tuple[tuple[bool, ...], ...]
    rates: tuple[ca.SX, ...]


def trace_sides(phase: Phase, x: ca.SX, u: ca.SX, p: SimpleNamespace) -> Kinked:
    """The phase's dynamics with each ``m.where`` decided one way and the other.

    Raises
    ------
    PeriluneError
        If a condition depends on a control, compares for equality, or there are too many.
    """
    margins: list[ca.SX] = []

    def rates(sides: tuple[bool, ...]) -> ca.SX:
        def where(condition: ca.SX, yes: Any, no: Any) -> Any:
            number = _kink(phase, condition, x, u, margins)
            if number is None:
                return ca.if_else(condition, yes, no)
            return yes if number >= len(sides) or sides[number] else no

        namespace = SimpleNamespace(**{**vars(SYMBOLIC), "where": where})
        return column(phase.rates(elements(x), elements(u), p, namespace))

    rates(())
    sides = tuple(product((True, False), repeat=len(margins)))
    return Kinked(margins=tuple(margins), sides=sides, rates=tuple(rates(side) for side in sides))


def _kink(phase: Phase, condition: Any, x: ca.SX, u: ca.SX, margins: list[ca.SX]) -> int | None:
    """Number of the margin of a condition that may change in flight; None where it cannot."""
    condition = ca.SX(condition)
    if not ca.depends_on(condition, ca.vertcat(x, u)):
        return None
    order = condition.is_op(ca.OP_LT) or condition.is_op(ca.OP_LE)
    if ca.depends_on(condition, u) or not order:
        raise PeriluneError(
            f"m.where in the dynamics of {phase.name} takes a condition that cannot be met in flight",
            got="one that depends on a control" if order else "a condition that is no < or >",
            expected="a comparison by < or > of functions of the states and parameters",
            advice="m.where(x.h > p.h1, above, below); what depends on a control belongs into its bounds",
        )
    margin = condition.dep(1) - condition.dep(0)
    for number, known in enumerate(margins):
        if ca.is_equal(known, margin, 30):
            return number
    margins.append(margin)
    if len(margins) > MOST_KINKS:
        raise PeriluneError(
            f"too many choices in the dynamics of {phase.name}",
            got=f"more than {MOST_KINKS} different conditions in m.where",
            advice="m.table for tabulated data; phases of their own for what follows in a known order",
        )
    return len(margins) - 1


def trace_at_end(phase: Phase, x: ca.SX, p: SimpleNamespace) -> ca.SX:
    """The phase's end conditions as a column."""
    return column(phase.evaluate("end", elements(x), [], p, SYMBOLIC))


def canonical_given(problem: Problem) -> Vector:
    """Values of the given parameters in canonical units."""
    return np.array([g.value / problem.scales.of(g.unit) for g in problem.given.values()])


def canonical_free(problem: Problem, free: Mapping[str, float]) -> Vector:
    """Values of the free parameters in canonical units, from SI."""
    return np.array([free[f.name] / problem.scales.of(f.unit) for f in problem.free])


def free_scales(parameters: tuple[Free, ...], problem: Problem) -> Vector:
    """SI size of the canonical unit of each free parameter."""
    return np.array([problem.scales.of(f.unit) for f in parameters])


def state_scales(problem: Problem, phase: Phase) -> Vector:
    """SI size of the canonical unit of each state."""
    return np.array([problem.size_of(s) for s in phase.states])
