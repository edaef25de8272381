"""Assembly of a program on given meshes from its blocks by sparse matrices, without any differentiation.

With w the unknowns and z_i those of them that the i-th repetition of a block f takes, and J in a row below the rows,

    g(w) = A w + sum B_i f(z_i),    dg/dw = A + sum B_i f'(z_i),    (lambda . g)'' = sum (B_i' lambda) . f''(z_i).

A holds what collocation makes of the states (differentiation, ends), B the signs and weights of the rates in it. So a
new mesh costs some index arithmetic, and its program evaluates blocks and multiplies sparse matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from perilune.core import Matrix, Vector
from perilune.direct.blocks import Block
from perilune.direct.layout import Layout

# Rows, columns and values of a sparse matrix.
Triplets = tuple[Vector, Vector, Vector]
# Places behind the unknowns: the numbers 0 and 1, at which a phase begins and ends.
BEGIN, END = -2, -1


@dataclass(frozen=True, kw_only=True)
class RepeatedBlock:
    """A block with the unknowns of each repetition and what its values add to the rows.

    Parameters
    ----------
    block
        The function.
    takes
        Index of each unknown it takes, `BEGIN` and `END` among them, shape (repetitions, unknowns of the block).
    adds
        Rows, places among the values of all repetitions, and factors.
    """

    block: Block
    takes: Matrix
    adds: Triplets


@dataclass(frozen=True, kw_only=True, eq=False)
class Assembled:
    """The functions of a program as CasADi's solvers take them, by their names there.

    `everything` is all of them at once. `jacobian_at` and `hessian_at` are row and column of each nonzero, shape
    (2, nonzeros); of the Hessian the upper ones.
    """

    value: ca.Function
    gradient: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    everything: ca.Function
    jacobian_at: Matrix
    hessian_at: Matrix


def assemble_program(
    layouts: Sequence[Layout], blocks: Sequence[tuple[Block, Block]], free: int, nearest: bool
) -> Assembled:
    """Assemble the program of phases laid out one after the other.

    With `nearest` every path condition may be missed by as much all along, and every end condition to either side; the
    sum of all misses, which are unknowns behind all others, stands in place of J.

    Parameters
    ----------
    layouts
        Of each phase.
    blocks
        Of each phase: what is repeated at its points, and what is there once.
    free
        Number of free parameters.
    nearest
        True to minimise the misses.
    """
    rows = sum(sum(layout.rows.values()) for layout in layouts)
    parts, linear = list[RepeatedBlock](), list[Triplets]()
    before, at, row = np.zeros(0, dtype=int), free, 0
    missed = free + sum(sum(layout.sizes) for layout in layouts)
    for k, (layout, (point, once)) in enumerate(zip(layouts, blocks, strict=True)):
        place = _Place(layout, free, at, row)
        objective = rows if k == len(layouts) - 1 and not nearest else None
        linear.append(place.linear())
        parts += [
            RepeatedBlock(block=point, takes=place.taken(), adds=place.added()),
            RepeatedBlock(block=once, takes=place.taken_once(before), adds=place.added_once(objective)),
        ]
        if nearest:
            linear.append(place.missed(missed, rows))
            missed += layout.path + 2 * layout.end
        before, at, row = place.states[-1], at + sum(layout.sizes), row + sum(layout.rows.values())
    return _functions(parts, _concatenate_triplets(linear), missed, rows)


class _Place:
    """Index arithmetic of one phase whose unknowns and rows begin at `at` and `row`."""

    def __init__(self, layout: Layout, free: int, at: int, row: int) -> None:
        self.layout, self.free = layout, np.arange(free)
        joints, states, controls = np.split(np.arange(at, at + sum(layout.sizes)), np.cumsum(layout.sizes)[:-1])
        self.ends = np.concatenate([[BEGIN], joints, [END]])
        self.states = states.reshape(-1, layout.states)
        self.controls = controls.reshape(layout.nodes, layout.controls)
        ends = row + np.cumsum(list(layout.rows.values()))
        self.rows = {
            kind: np.arange(end - size, end) for (kind, size), end in zip(layout.rows.items(), ends, strict=True)
        }

    def at_nodes(self, kind: str) -> Matrix:
        """Return the rows of a kind that every collocation point has, shape (nodes, rows of one)."""
        return self.rows[kind].reshape(self.layout.nodes, -1)

    def linear(self) -> Triplets:
        """Return the entries of the rows that are constants times states."""
        layout, states = self.layout, self.states
        defects, node = self.at_nodes("defect"), 0
        found = [_broadcast_triplets(self.rows["start"], states[0], 1.0)]
        for at, r in zip(layout.starts, layout.rules, strict=False):
            support = states[at : at + r.degree + 1]
            found.append(
                _broadcast_triplets(defects[node : node + r.degree, None], support[None], r.differentiation[:, :, None])
            )
            node += r.degree
        if layout.scheme == "gauss":
            over = self.rows["quadrature"].reshape(-1, layout.states)
            found.append(_broadcast_triplets(over, states[list(layout.starts[1:])], 1.0))
            found.append(_broadcast_triplets(over, states[list(layout.starts[:-1])], -1.0))
        return _concatenate_triplets(found)

    def taken(self) -> Matrix:
        """Return the unknowns that the dynamics and conditions at each collocation point take."""
        segment = np.repeat(np.arange(len(self.layout.degrees)), self.layout.degrees)
        free = np.tile(self.free, (self.layout.nodes, 1))
        return np.hstack([
            self.states[self.layout.collocated], self.controls, free,
            self.ends[segment][:, None], self.ends[segment + 1][:, None],
        ])  # fmt: skip

    def added(self) -> Triplets:
        """Return the entries that the blocks at collocation points add to the rows."""
        layout, n = self.layout, self.layout.states
        widths = [n, len(layout.directions), layout.held, layout.path]
        values = np.arange(layout.nodes * sum(widths)).reshape(layout.nodes, -1)
        flow, *others = np.split(values, np.cumsum(widths)[:-1], axis=1)
        found = [_broadcast_triplets(self.at_nodes("defect"), flow, -1.0)]
        for kind, own in zip(("direction", "held", "path"), others, strict=True):
            found.append(_broadcast_triplets(self.at_nodes(kind), own, 1.0))
        if layout.scheme == "gauss":
            over = np.repeat(self.rows["quadrature"].reshape(-1, n), layout.degrees, axis=0)
            weights = np.concatenate([r.weights for r in layout.rules])
            found.append(_broadcast_triplets(over, flow, -weights[:, None]))
        return _concatenate_triplets(found)

    def taken_once(self, before: Vector) -> Matrix:
        """Return the unknowns that start, end and J take."""
        return np.concatenate([before, self.states[-1], self.free])[None]

    def added_once(self, objective: int | None) -> Triplets:
        """Return the entries that the block of start, end and J adds to the rows, J to its own row, if any."""
        n, end = self.layout.states, self.layout.end
        found = [
            _broadcast_triplets(self.rows["start"], np.arange(n), -1.0),
            _broadcast_triplets(self.rows["end"], n + np.arange(end), 1.0),
        ]
        if objective is not None:
            found.append(_broadcast_triplets(np.array([objective]), np.array([n + end]), 1.0))
        return _concatenate_triplets(found)

    def missed(self, at: int, objective: int) -> Triplets:
        """Return the entries that misses, unknowns from `at` on, add to path, end and the sum of them."""
        path, end = self.layout.path, self.layout.end
        below, above = np.split(np.arange(at, at + path + 2 * end), [path + end])
        return _concatenate_triplets([
            _broadcast_triplets(self.at_nodes("path"), below[:path], 1.0),
            _broadcast_triplets(self.rows["end"], below[path:], 1.0),
            _broadcast_triplets(self.rows["end"], above, -1.0),
            _broadcast_triplets(np.array([objective]), np.concatenate([below, above]), 1.0),
        ])  # fmt: skip


def _functions(parts: Sequence[RepeatedBlock], linear: Triplets, unknowns: int, rows: int) -> Assembled:
    w, given = ca.MX.sym("w", unknowns), ca.MX.sym("p", parts[0].block.value.numel_in(1))
    factors = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", rows)
    everything = ca.vertcat(w, 0, 1)
    weights = ca.vertcat(factors[1], factors[0])
    total, slopes, curvatures = _constant_matrix(linear, (rows + 1, unknowns)) @ w, list[ca.MX](), list[ca.MX]()
    J = _constant_matrix(_of_row(linear, rows), (1, unknowns)) @ w
    for part in parts:
        block, times = part.block, len(part.takes)
        z = ca.reshape(everything[(part.takes % (unknowns + 2)).ravel().tolist()], block.unknowns, times)
        shared = ca.repmat(given, 1, times)
        adds = _constant_matrix(part.adds, (rows + 1, times * block.values))
        values = ca.vec(block.value.map(times)(z, shared))
        total += adds @ values
        # By itself, as J is asked for without the rows, and depends on little of what they do.
        if len((of_objective := _of_row(part.adds, rows))[0]):
            J += _constant_matrix(of_objective, (1, times * block.values)) @ values
        slopes.append(ca.vec(block.slopes.map(times)(z, shared)))
        own = ca.reshape(adds.T @ weights, block.values, times)
        curvatures.append(ca.vec(block.curvature.map(times)(z, shared, own)))
    pattern, constant, mixed = _first_derivatives(parts, linear)
    of_J = pattern[0] == rows
    gradient, jacobian = (_combine_slopes(slopes, constant, mixed, own) for own in (of_J, ~of_J))
    gradient = ca.densify(_sparse(pattern[::-1, of_J] * [[1], [0]], gradient, (unknowns, 1)))
    jacobian = _sparse(pattern[:, ~of_J], jacobian, (rows, unknowns))
    upper, summed = _second_derivatives(parts)
    curvature = _constant_matrix(summed, (upper.shape[1], sum(c.numel() for c in curvatures))) @ ca.vertcat(*curvatures)
    hessian = _sparse(upper, curvature, (unknowns, unknowns))
    J, g = ca.densify(J), total[:rows]  # of no terms where nothing can be missed
    return Assembled(
        value=ca.Function("nlp", [w, given], [J, g], ["x", "p"], ["f", "g"]),
        gradient=ca.Function("nlp_grad_f", [w, given], [J, gradient], ["x", "p"], ["f", "grad_f_x"]),
        jacobian=ca.Function("nlp_jac_g", [w, given], [g, jacobian], ["x", "p"], ["g", "jac_g_x"]),
        hessian=ca.Function(
            "nlp_hess_l", [w, given, *factors], [hessian], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        ),
        everything=ca.Function("everything", [w, given, *factors], [J, g, gradient, jacobian, hessian]),
        jacobian_at=pattern[:, ~of_J],
        hessian_at=upper,
    )


def _first_derivatives(parts: Sequence[RepeatedBlock], linear: Triplets) -> tuple[Matrix, Vector, Triplets]:
    """Return nonzeros of dg/dw, column by column: places, constant values, and what all slopes of blocks add."""
    rows, columns, found, at = [linear[0]], [linear[1]], list[tuple[Vector, Vector]](), 0
    for part in parts:
        row, place, factor = part.adds
        times, slot = np.divmod(place, part.block.values)
        of, by = part.block.slopes_at
        # Every value that is added meets every slope of it.
        entry, slope = np.nonzero(slot[:, None] == of[None, :])
        column = part.takes[times[entry], by[slope]]
        own = column >= 0
        entry, slope = entry[own], slope[own]
        rows.append(row[entry])
        columns.append(column[own])
        found.append((at + times[entry] * len(of) + slope, factor[entry]))
        at += len(part.takes) * len(of)
    pattern, place = _unique(np.concatenate(rows), np.concatenate(columns))
    known = len(linear[0])
    constant = np.bincount(place[:known], linear[2], minlength=pattern.shape[1])
    source, factor = (np.concatenate(values) for values in zip(*found, strict=True))
    return pattern, constant, (place[known:], source, factor)


def _second_derivatives(parts: Sequence[RepeatedBlock]) -> tuple[Matrix, Triplets]:
    """Return upper nonzeros of the Hessian, column by column, and which curvatures of blocks add up in each."""
    rows, columns, sources, at = list[Vector](), list[Vector](), list[Vector](), 0
    for part in parts:
        row, column = (part.takes[:, of] for of in part.block.curvature_at)
        source = at + np.arange(row.size).reshape(row.shape)
        own = (row >= 0) & (column >= row)
        rows.append(row[own])
        columns.append(column[own])
        sources.append(source[own])
        at += row.size
    pattern, place = _unique(np.concatenate(rows), np.concatenate(columns))
    return pattern, (place, np.concatenate(sources), np.ones(len(place)))


def _unique(rows: Vector, columns: Vector) -> tuple[Matrix, Vector]:
    """Return places in the order of CasADi's nonzeros, each once, shape (2, nonzeros), and which one each entry is."""
    height = int(rows.max(initial=0)) + 1
    places, which = np.unique(columns * height + rows, return_inverse=True)
    return np.array([places % height, places // height]), which


def _combine_slopes(slopes: Sequence[ca.MX], constant: Vector, mixed: Triplets, own: Vector) -> ca.MX:
    """Return some of the nonzeros of dg/dw, which depend on those slopes only that add to them."""
    ends: Vector = np.cumsum([0, *(slope.numel() for slope in slopes)])
    here = own[mixed[0]]
    place, source, factor = (values[here] for values in mixed)
    used = np.unique(np.searchsorted(ends, source, side="right") - 1)
    found = ca.MX(ca.DM(constant[own]))
    if not len(used):
        return found
    kept = np.concatenate([np.arange(int(ends[k]), int(ends[k + 1])) for k in used])
    entries = np.cumsum(own)[place] - 1, np.searchsorted(kept, source), factor
    return found + _constant_matrix(entries, (found.numel(), len(kept))) @ ca.vertcat(*(slopes[k] for k in used))


def _of_row(triplets: Triplets, row: int) -> Triplets:
    """Return the entries of one row, as those of a matrix of one row."""
    rows, columns, values = triplets
    own = rows == row
    return np.zeros(np.count_nonzero(own), dtype=int), columns[own], values[own]


def _sparse(pattern: Matrix, values: ca.MX, shape: tuple[int, int]) -> ca.MX:
    """Return the matrix with values at the places of a pattern, which is in the order of nonzeros."""
    return ca.MX(ca.Sparsity.triplet(*shape, *(part.tolist() for part in pattern)), values)


def _constant_matrix(triplets: Triplets, shape: tuple[int, int]) -> ca.MX:
    rows, columns, values = triplets
    return ca.MX(ca.DM.triplet(rows.tolist(), columns.tolist(), ca.DM(values), *shape))


def _broadcast_triplets(rows: Vector, columns: Vector, values: Vector | float) -> Triplets:
    """Broadcast places and values to one entry for each place."""
    a, b, c = np.broadcast_arrays(rows, columns, np.asarray(values, dtype=float))
    return a.ravel(), b.ravel(), c.ravel()


def _concatenate_triplets(groups: Sequence[Triplets]) -> Triplets:
    rows, columns, values = (np.concatenate(parts) for parts in zip(*groups, strict=True))
    return rows, columns, values
