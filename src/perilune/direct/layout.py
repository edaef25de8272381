"""Layout of one phase in a program: positions of its unknowns and rows, all that a mesh changes, as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import accumulate, pairwise
from typing import NamedTuple

import numpy as np

from perilune.core import Matrix, Vector
from perilune.direct.collocation import Mesh, Rule, Scheme, rule
from perilune.problem import Phase, directions


class Layout(NamedTuple):
    """Places of one phase's unknowns and rows; hashable, it is half of the key of a program."""

    scheme: Scheme
    degrees: tuple[int, ...]
    states: int
    controls: int
    directions: tuple[tuple[int, int], ...]
    held: int
    path: int
    end: int

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The rule of each segment."""
        return _rules(self.scheme, self.degrees)

    @property
    def nodes(self) -> int:
        """Collocation points."""
        return sum(self.degrees)

    @property
    def starts(self) -> tuple[int, ...]:
        """Index of the state point at which each segment starts, and of the last one."""
        return tuple(accumulate((r.stride for r in self.rules), initial=0))

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Unknowns: inner joints, state values, control values."""
        return len(self.degrees) - 1, self.states * (self.starts[-1] + 1), self.controls * self.nodes

    @property
    def collocated(self) -> list[int]:
        """State points at which the dynamics are collocated."""
        return [s + r.first + i for s, r in zip(self.starts, self.rules, strict=False) for i in range(r.degree)]

    @property
    def rows(self) -> dict[str, int]:
        """Number of rows of each kind of condition, in their order."""
        gauss = self.states * len(self.degrees) if self.scheme == "gauss" else 0
        return {
            "start": self.states,
            "defect": self.states * self.nodes,
            "quadrature": gauss,
            "direction": len(self.directions) * self.nodes,
            "held": self.held * self.nodes,
            "path": self.path * self.nodes,
            "end": self.end,
        }


@lru_cache(maxsize=256)
def _rules(scheme: Scheme, degrees: tuple[int, ...]) -> tuple[Rule, ...]:
    return tuple(rule(scheme, degree) for degree in degrees)


@dataclass(frozen=True, kw_only=True)
class PhaseValues:
    """Values of one phase in canonical units: joints (K + 1,), state (points, nx), control (nodes, nu)."""

    joints: Vector
    state: Matrix
    control: Matrix


def layout_of(scheme: Scheme, phase: Phase, mesh: Mesh) -> Layout:
    """Return the layout of a phase on a mesh.

    Parameters
    ----------
    scheme
        "gauss" or "radau".
    phase, mesh
        The phase and its mesh.
    """
    return Layout(
        scheme, mesh.degrees, len(phase.states), len(phase.control_names), directions(phase.controls),
        len(phase.held_conditions), len(phase.path_conditions), len(phase.end_conditions),
    )  # fmt: skip


def packed(values: PhaseValues) -> Vector:
    """Return the unknowns of one phase in their order."""
    return np.concatenate([values.joints[1:-1], values.state.ravel(), values.control.ravel()])


def unpacked(layouts: tuple[Layout, ...], w: Vector) -> tuple[PhaseValues, ...]:
    """Return the values of every phase from the unknowns behind the free parameters.

    Parameters
    ----------
    layouts
        Of each phase.
    w
        Unknowns without the free parameters, canonical.
    """
    at, found = 0, []
    for layout in layouts:
        ends = [at, *(at + end for end in accumulate(layout.sizes))]
        joints, states, controls = (w[a:b] for a, b in pairwise(ends))
        at = ends[-1]
        found.append(
            PhaseValues(
                joints=np.concatenate([[0.0], joints, [1.0]]),
                state=states.reshape(-1, layout.states),
                control=controls.reshape(layout.nodes, layout.controls),
            )
        )
    return tuple(found)


def by_kind(layouts: tuple[Layout, ...], values: Vector) -> dict[tuple[int, str], Vector]:
    """Return the values of all rows by (phase, kind of condition).

    Parameters
    ----------
    layouts
        Of each phase.
    values
        One value for each row of the program.
    """
    at, found = 0, {}
    for k, layout in enumerate(layouts):
        for kind, size in layout.rows.items():
            found[k, kind] = values[at : at + size]
            at += size
    return found


@lru_cache(maxsize=64)
def determined_states(layouts: tuple[Layout, ...], free: int) -> tuple[Vector, Vector, list[slice]]:
    """Return unknowns that are states, rows that determine them when all else is known, and the segments of both.

    The first segment of a phase has its start too; of each the rows are as many as the states, and take those before
    only.

    Parameters
    ----------
    layouts
        Of each phase.
    free
        Number of free parameters, which stand before all other unknowns.
    """
    states, dynamics, at, row = list[Vector](), list[Vector](), free, 0
    for layout in layouts:
        states.append(at + layout.sizes[0] + np.arange(layout.sizes[1]))
        sizes = list(layout.rows.values())
        start, defect, over, *_ = np.split(row + np.arange(sum(sizes)), np.cumsum(sizes))
        ends = layout.states * np.cumsum(layout.degrees)[:-1]
        last = np.split(over, len(layout.degrees))
        first, *others = (np.concatenate(both) for both in zip(np.split(defect, ends), last, strict=True))
        dynamics += [np.concatenate([start, first]), *others]
        at += sum(layout.sizes)
        row += sum(sizes)
    ends = [0, *np.cumsum([len(rows) for rows in dynamics]).tolist()]
    return np.concatenate(states), np.concatenate(dynamics), [slice(a, b) for a, b in pairwise(ends)]


@lru_cache(maxsize=64)
def unit_lengths(layouts: tuple[Layout, ...], free: int) -> list[tuple[Vector, Matrix]]:
    """Return rows that hold directions at length one, and the unknowns in each, an entry for each direction.

    Parameters
    ----------
    layouts
        Of each phase.
    free
        Number of free parameters, which stand before all other unknowns.

    Returns
    -------
    list
        (rows, (n,); unknowns, (n, components)) of each direction of a phase.
    """
    found, at, row = list[tuple[Vector, Matrix]](), free, 0
    for layout in layouts:
        count, before = len(layout.directions), dict(layout.rows)
        first = row + sum(size for kind, size in before.items() if kind in ("start", "defect", "quadrature"))
        rows = first + np.arange(count * layout.nodes).reshape(layout.nodes, count)
        controls = at + sum(layout.sizes[:2]) + np.arange(layout.sizes[2]).reshape(layout.nodes, layout.controls)
        found += [(rows[:, k], controls[:, a:b]) for k, (a, b) in enumerate(layout.directions)]
        at, row = at + sum(layout.sizes), row + sum(before.values())
    return found
