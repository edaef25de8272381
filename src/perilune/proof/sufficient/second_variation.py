"""Second variation of a phase: its pieces between breaks, with the first and second derivatives it needs.

Time is normalised on each piece, so that the times of the cuts are parameters as durations are. A direction moves in
its tangent plane, and not at all where no thrust gives it an effect; a scalar on its bound does not vary. Where path
conditions hold the control, it varies along them, and L = H - mu.c has the place of H (`held`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from perilune.core import Matrix, Vector, complex_step_jacobian, sign_of_life
from perilune.problem import ScalarControl, control_slices, normalised, tangents
from perilune.proof.feasible.numerics import hessian
from perilune.proof.feasible.phase_data import PhaseData
from perilune.proof.necessary.minimum_principle import control_rates, limit_derivatives, on_bounds, varied_sizes
from perilune.proof.sufficient.active_controls import active_conditions_along
from perilune.proof.sufficient.singular_arcs import Singular, goh_transform
from perilune.proof.sufficient.strict_complementarity import end_switches, switch_slopes

STEPS, FEWEST = 100, 20  # of a phase, and of a piece of it
_WITHOUT_EFFECT = 1e-12  # of a direction, against the largest derivative of the dynamics


@dataclass(frozen=True, kw_only=True)
class KeptConditions:
    """Constraints on variations from conditions S >= 0 on states, active along a phase or from one of its ends.

    Attributes
    ----------
    boundary_rates, released
        Names of the conditions S^(q) = 0 along it, and of those that variations need not keep.
    holds
        Values that vanish to first order all along it, and so have to where it begins.
    end
        Values that have to vanish where it ends, in addition to the end conditions.
    dropped_ends
        Names of the end conditions that need not be kept.
    tied
        True if its duration stays in proportion to that of the phase before.
    steady
        True if no control jumps where a boundary arc begins or ends at its ends.
    least_multiplier
        Least multiplier of a boundary arc over its largest, where that decides: H is linear in the control.
    """

    boundary_rates: tuple[str, ...] = ()
    released: tuple[str, ...] = ()
    holds: tuple[Any, ...] = ()
    end: tuple[Any, ...] = ()
    dropped_ends: tuple[str, ...] = ()
    tied: bool = False
    steady: bool = True
    least_multiplier: float | None = None


def variation_pieces(
    arcs: Sequence[PhaseData], names: Sequence[str], kept: Mapping[int, KeptConditions], finer: int = 1
) -> list[VariationPiece]:
    """Return all arcs from edge to edge, with `names`, the times of crossings and the switching times as parameters.

    And of singular arcs what is left of their impulses, behind `names`. `finer` times as many steps as are usual, and
    its square where nothing is steered; where nothing of the control can vary these are of the fourth order.

    Parameters
    ----------
    arcs
        All phases of the flight, in order.
    names
        Names of the parameters that vary.
    kept
        Constraints on variations from boundary arcs and contact points, by the index of the phase.
    finer
        Factor on the usual number of steps.
    """
    switches = {
        (arc.index, float(time)): float(slope)
        for arc in arcs
        for at in [np.nonzero(arc.jumps.any(axis=0) & ~Singular.of(arc).junctions)[0]]
        for time, slope in zip(arc.breaks[at], switch_slopes(arc)[at], strict=True)
    }
    switches |= {(arc.index, end.time): end.slope for arc in arcs for end in end_switches(arc)}
    met = [(arc.index, crossing.time) for arc in arcs for crossing in arc.crossings if crossing.jump.any()]
    times = {(i, time): f"{arcs[i].phase.name} at {time!r}" for i, time in (*met, *switches)}
    known, found = [Singular.of(arc) for arc in arcs], list[VariationPiece]()
    impulses = {
        (i, k): f"impulse {k + 1} of {arcs[i].phase.name}"
        for i, singular in enumerate(known)
        for k in range(len(singular.places))
        if singular.ends(k)
    }
    values = {name: time for (_, time), name in times.items()} | dict.fromkeys(impulses.values(), 0.0)
    p = SimpleNamespace(**vars(arcs[0].p), **values)
    varied = (*names, *impulses.values(), *times.values())
    for arc in arcs:
        stretches = _stretches(arc, {time: name for (i, time), name in times.items() if i == arc.index})
        for stretch in stretches:
            sign_of_life("proof: level 3, the second variation")
            own = kept.get(arc.index, KeptConditions())
            found.append(VariationPiece(arc, p, varied, list(switches.values()), stretch, own, finer))
            if stretch.place is not None:
                k = stretch.place
                found[-1].transform(known[arc.index].places[k], impulses.get((arc.index, k)))
    return found


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """Stretch of an arc from one edge to the next.

    Attributes
    ----------
    span, edges
        Times at both ends [s], and the same as numbers or as names of parameters.
    first, last
        True if the arc begins, and ends, with it.
    place
        Of the stretch between the edges of the arc; None for one of no length beyond a switch at an end of the flight.
    across
        Component of the control that differs from the neighbouring arc: its place, and its value [SI].
    """

    span: tuple[float, float]
    edges: tuple[str | float, str | float]
    first: bool
    last: bool
    place: int | None = None
    across: tuple[int, float] | None = None


def _stretches(arc: PhaseData, names: Mapping[float, str]) -> list[Stretch]:
    """Return every stretch of an arc, whose times have `names` where they are parameters."""
    times, places = arc.edges.tolist(), list[int | None](range(len(arc.edges) - 1))
    edges: list[str | float] = [0.0, *(names.get(t, t) for t in times[1:-1]), arc.phase.duration]
    across = dict[int, tuple[int, float]]()
    for end in end_switches(arc):
        k = 0 if end.time == 0.0 else len(places)
        times.insert(k + bool(k), end.time)
        edges.insert(1 if k == 0 else len(edges) - 1, names[end.time])
        places.insert(k, None)
        across = {i + (k == 0): value for i, value in across.items()} | {k: (end.at, end.across)}
    return [
        Stretch(
            span=(times[k], times[k + 1]), edges=(edges[k], edges[k + 1]), first=k == 0, last=k == len(places) - 1,
            place=place, across=across.get(k),
        ) for k, place in enumerate(places)
    ]  # fmt: skip


class VariationPiece:
    """First and second derivatives of an arc between breaks, at the middles of steps.

    Steps are equal, of `lengths` (N,) that add up to 1; finer ones on which no control varies are threes of the fourth
    order (`_fourth_order_lengths`), as a coast may last a thousand times as long as the burns next to it.

    Time is divided by the length of the piece. `F` (n, d, N): derivatives of the length times f; `W` (d, d, N): of
    the length times L; `yields` (d, N): those of the length times mu.c, of
    what variations leave; d counts states, the parameters `names` and the tangent directions of the control that may
    vary. The last of `names` are the switching times, whose D are `curvature`. `crossing` is where the rates jump at
    its end, if they do. On a singular piece
    (`perilune.proof.sufficient.singular_arcs`) the integral of the singular control has its place, `kelley` is its
    curvature, and `leap` how it is left, with the place of its impulse among `names`, where the singular arc ends with
    the piece.
    """

    def __init__(
        self,
        arc: PhaseData,
        p: SimpleNamespace,
        names: Sequence[str],
        curvature: Sequence[float],
        stretch: Stretch,
        kept: KeptConditions,
        finer: int = 1,
    ) -> None:
        self.arc, self.p, self.names, self.curvature, self.stretch = arc, p, tuple(names), curvature, stretch
        self.kept, self.edges, self.span = kept, stretch.edges, stretch.span
        self.first, self.last = stretch.first, stretch.last
        left, right = self.span
        self.crossing = next((c for c in arc.crossings if c.time == right and c.jump.any()), None)
        times = finer if arc.phase.controls else finer**2  # where nothing is steered they add no variations
        usual = max(FEWEST, round(STEPS * (right - left) / arc.duration))
        self.steps, self.lengths = times * usual, np.full(times * usual, 1.0 / (times * usual))
        x, basis, partly_held = self._looked(np.arange(self.steps) + 0.5)
        if finer > 1 and arc.phase.controls and not basis.shape[1]:
            self.lengths = _fourth_order_lengths(finer**2 * usual)
            self.steps = len(self.lengths)
            x, basis, partly_held = self._looked((np.cumsum(self.lengths) - 0.5 * self.lengths) * self.steps)
        self.held, self.basis, settled = active_conditions_along(arc, x, self.u, self.lam, basis, kept.released)
        if stretch.across is not None:  # for no time: nothing of the control can vary there
            self.u[stretch.across[0]], self.basis = stretch.across[1], basis[:, :0]
        self.partly_held = partly_held or not settled
        n, m, k = len(x), len(names), self.basis.shape[1]
        self.sizes = n, m, k
        of, problem = arc.problem.scales.of, arc.problem
        known = {*problem.given, *problem.free_names}
        self.parameter_scale = np.array([of(problem.unit_of(name) if name in known else "s") for name in names])
        self.scale = np.concatenate([arc.state_scale, self.parameter_scale, np.ones(k)])
        self.parameter_values = np.array([float(getattr(p, name)) for name in names])
        z = np.concatenate(
            [x, np.repeat(self.parameter_values[:, None], self.steps, axis=1), np.zeros((k, self.steps))]
        )
        self.F = complex_step_jacobian(self._rates, z, self.scale)
        self.yields = np.zeros(self.F.shape[1:])
        if self.held and kept.released:
            self.yields = complex_step_jacobian(self._work, z, self.scale)[0]
        self.W = hessian(self._lagrangian, z, self.scale)
        self.H_uu = self.W[n + m :, n + m :].transpose(2, 0, 1)
        self.bends, self.kelley, self.leap = self.H_uu, np.zeros(0), None
        self.settled = True

    def _looked(self, middles: Vector) -> tuple[Matrix, Any, bool]:
        """Look at the arc at the middles of the steps, in steps from its beginning: states, and `_free_moves` there."""
        left, right = self.span
        t = left + middles * (right - left) / self.steps
        x, self.u, self.lam = self.arc.state(t), self.arc.control(t), self.arc.costate(t)
        return x, *_free_moves(self.arc, x, self.u)

    def transform(self, at: int | None, impulse: str | None) -> None:
        """Put the integral of the singular scalar, a component of the control, in its place.

        Parameters
        ----------
        at
            Index of the singular scalar among the components of the control; None leaves the piece as it is.
        impulse
            Name of the parameter for its impulse at the end of the singular arc; None if the arc does not end here.
        """
        if at is None:
            return
        n, m, _ = self.sizes
        columns = np.nonzero(self.basis[at].any(axis=1))[0]
        left, right = self.span
        found = (
            goh_transform(self.F, self.W, n + m + int(columns[0]), (n, m), right - left) if len(columns) == 1 else None
        )
        # A kink of the rates within the arc would break B; a condition that is held along with it changes with it.
        if found is None or self.held or (self.crossing is not None and impulse is None):
            self.settled = False
            return
        self.F, self.W, leap = found
        self.H_uu = self.W[n + m :, n + m :].transpose(2, 0, 1)
        column = int(columns[0])
        self.bends = np.delete(np.delete(self.H_uu, column, axis=1), column, axis=2)
        self.kelley = self.H_uu[:, column, column]
        self.leap = None if impulse is None else (self.names.index(impulse), leap)

    @property
    def regular(self) -> bool:
        """Return True if L is strictly convex all along in the control's free moves."""
        return not self.partly_held and self.settled and bool(np.all(np.linalg.eigvalsh(self.H_uu) > 0))

    @property
    def loosened(self) -> VariationPiece:
        """Return the same with variations that also leave the boundary arcs."""
        if self.kept.boundary_rates == self.kept.released:
            return self
        kept = KeptConditions(released=self.kept.boundary_rates)
        return VariationPiece(self.arc, self.p, self.names, self.curvature, self.stretch, kept)

    def parameters(self, values: Any) -> SimpleNamespace:
        """Return all parameters in SI with `names` replaced."""
        return SimpleNamespace(**{**vars(self.p), **dict(zip(self.names, values, strict=True))})

    def _flown(self, z: Any) -> tuple[Any, Any, Any]:
        """The length, the control (components, ..., N) and the parameters."""
        n, m, _ = self.sizes
        p = self.parameters(z[n : n + m])
        middle = (1,) * (z.ndim - 2)
        u = self.u.reshape(len(self.u), *middle, self.steps) + 0 * z[0]
        for column in range(self.basis.shape[1]):
            u = u + self.basis[:, column].reshape(len(self.u), *middle, self.steps) * z[n + m + column]
        for name, value, was in zip(self.names, z[n : n + m], self.parameter_values, strict=True):
            u = u + limit_derivatives(self.arc, self.u, name).reshape(len(u), *middle, self.steps) * (value - was)
        u = normalised(self.arc.phase.controls, u) if len(self.u) else u
        u = normalised(self.arc.phase.controls, self.held.kept(z[:n], u, p)) if self.held else u
        left, right = (getattr(p, edge) if isinstance(edge, str) else edge for edge in self.edges)
        return right - left, u, p

    def _rates(self, z: Any) -> Any:
        (length, u, p), scale = self._flown(z), self.arc.state_scale.reshape(-1, *(1,) * (z.ndim - 1))
        return length * self.arc.rates(z[: self.sizes[0]], u, p) / scale

    def _work(self, z: Any) -> Any:
        length, u, p = self._flown(z)
        assert self.held is not None, "asked for where conditions hold"
        return (length * self.held.work(z[: self.sizes[0]], u, p) / self.arc.objective_scale)[None]

    def _lagrangian(self, z: Any) -> Any:
        lam, x = self.lam.reshape(len(self.lam), *(1,) * (z.ndim - 2), self.steps), z[: self.sizes[0]]
        length, u, p = self._flown(z)
        H = (lam * self.arc.rates(x, u, p)).sum(axis=0)
        return length * (H - self.held.work(x, u, p) if self.held else H) / self.arc.objective_scale


def _fourth_order_lengths(count: int) -> Vector:
    """Return lengths of about so many steps, in threes that make a midpoint rule one of the fourth order.

    Source: Yoshida, "Construction of higher order symplectic integrators", Physics Letters A 150, 1990, (2.11).
    """
    outer = 1.0 / (2.0 - 2.0 ** (1.0 / 3.0))
    threes = max(1, round(count / 3))
    return np.tile([outer, 1.0 - 2.0 * outer, outer], threes) / threes


def _variation_sizes(arc: PhaseData) -> Vector:
    """Return the sizes of the control components in variations [SI]; a direction turns by radians."""
    return np.concatenate([
        varied_sizes(arc)[here] if control.scalar else arc.control_scale[here]
        for here, control in control_slices(arc.phase.controls)
    ])  # fmt: skip


def _free_moves(arc: PhaseData, x: Matrix, u: Matrix) -> tuple[Any, bool]:
    """Tangents along which the control may vary, (components, k, N), and whether a bound holds a scalar for a part."""
    basis = tangents(arc.phase.controls, _variation_sizes(arc), u) if len(u) else np.zeros((0, 0, u.shape[1]))
    varying, partly, row = [], False, 0
    f = control_rates(arc, x, u, basis) / arc.state_scale[:, None, None]
    effect = np.abs(f).max(axis=(0, 2)) > _WITHOUT_EFFECT * np.abs(f).max(initial=0.0)
    for here, control in control_slices(arc.phase.controls):
        rows = range(row, row + control.freedom)
        row = rows.stop
        if isinstance(control, ScalarControl):
            lower, upper = on_bounds(arc, here.start, control, u)
            always = bool(lower.all() or upper.all())
            partly |= not always and bool((lower | upper).any())
            varying += [] if always else rows
        else:
            varying += [i for i in rows if effect[i]]
    return basis[:, varying], partly
