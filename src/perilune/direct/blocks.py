"""Blocks of a program: a few small functions of each phase, differentiated once for each traced problem.

A transcription repeats one function of a few unknowns at every collocation point, and is linear otherwise. At a point
with the state x, the control u, the free parameters q, between the joints a and b of its segment, the function is

    (T(q) (b - a)/2 F(x, u, q),   |d|^2 - 1 of every direction d in u,   held(x, u, q),   path(x, u, q)),

and once for each phase there is another one, of the end x- of the phase before and its own end x+:

    (start or link(x-, q),   end(x+, q),   J(x+, q) in the last phase).

Each comes with its first derivatives and with the second ones of any combination of its values, as columns of their
nonzeros. No mesh is known here; `perilune.direct.assembly` puts any number of them together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from perilune.core import Vector
from perilune.problem import (
    SYMBOLIC,
    Parameters,
    Phase,
    Problem,
    Unnumbered,
    column,
    directions,
    elements,
    trace_at_end,
    trace_parameters,
    trace_rates,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Block:
    """A function of some unknowns z and the given parameters, and its derivatives with respect to z.

    Parameters
    ----------
    value
        ``value(z, given)``, a column.
    slopes
        ``slopes(z, given)``: the nonzeros of its Jacobian.
    curvature
        ``curvature(z, given, weights)``: the nonzeros of the Hessian of weights . value, both triangles.
    slopes_at, curvature_at
        Row and column of each of these, shape (2, nonzeros).
    """

    value: ca.Function
    slopes: ca.Function
    curvature: ca.Function
    slopes_at: Vector
    curvature_at: Vector

    @property
    def values(self) -> int:
        """Return the number of its values."""
        return self.value.numel_out(0)

    @property
    def unknowns(self) -> int:
        """Return the number of unknowns that it takes."""
        return self.value.numel_in(0)


@lru_cache(maxsize=32)
def phase_blocks(unnumbered: Unnumbered) -> tuple[tuple[Block, Block], ...]:
    """Return for each phase what is repeated at its points and what is there once, in canonical units."""
    problem, p = unnumbered.problem, trace_parameters(unnumbered.problem)
    return tuple((_at_point(phase, p), _boundary_block(problem, k, p)) for k, phase in enumerate(problem.phases))


def _at_point(phase: Phase, p: Parameters) -> Block:
    x, u, ends = (
        ca.SX.sym(name, n) for name, n in (("x", len(phase.states)), ("u", len(phase.control_names)), ("t", 2))
    )
    duration = ca.SX(getattr(p.record, phase.duration))
    flow = 0.5 * duration * (ends[1] - ends[0]) * trace_rates(phase, x, u, p.record)
    norms = [ca.sumsqr(u[a:b]) - 1 for a, b in directions(phase.controls)]
    held, path = (
        column(phase.evaluate(name, elements(x), elements(u), p.record, SYMBOLIC)) for name in ("held", "path")
    )
    return _block(ca.vertcat(flow, *norms, held, path), ca.vertcat(x, u, p.free, ends), p.given)


def _boundary_block(problem: Problem, k: int, p: Parameters) -> Block:
    phase, first = problem.phases[k], k == 0
    before = ca.SX.sym("before", 0 if first else len(problem.phases[k - 1].states))
    if first:
        start = problem.start(p.record, SYMBOLIC)
    else:
        start = problem.links[k - 1](problem.phases[k - 1].state_record(*elements(before)), p.record, SYMBOLIC)
    x = ca.SX.sym("x", len(phase.states))
    values = [column(start), trace_at_end(phase, x, p.record)]
    if k == len(problem.phases) - 1:
        values.append(ca.SX(problem.objective(phase.state_record(*elements(x)), p.record, SYMBOLIC)))
    return _block(ca.vertcat(*values), ca.vertcat(before, x, p.free), p.given)


def _block(value: ca.SX, z: ca.SX, given: ca.SX) -> Block:
    weights = ca.SX.sym("weights", value.numel())
    slopes = ca.jacobian(value, z)
    curvature = ca.hessian(ca.dot(weights, value), z)[0]
    return Block(
        value=ca.Function("value", [z, given], [ca.densify(value)]),
        slopes=ca.Function("slopes", [z, given], [slopes.nz[:]]),
        curvature=ca.Function("curvature", [z, given, weights], [curvature.nz[:]]),
        slopes_at=_places(slopes),
        curvature_at=_places(curvature),
    )


def _places(matrix: ca.SX) -> Vector:
    return np.array(matrix.sparsity().get_triplet(), dtype=int).reshape(2, -1)
