"""Boundary arcs of a flight: checks of their multipliers to first order, and their variations to second order.

Where an arc begins or ends the costates of S itself (`boundary_arc`) may jump, as at a contact point
(`contact_points`), only by nu dS/dx with nu <= 0. Where a phase ends there its end conditions may take any part of the
jump, and at the start of the flight all that no free parameter moves.

**To second order** every feasible flight close by has

    J - J* >= L - L* = d2L/2 + o(|du|^2),   L = J - int S d(eta),

as S >= 0 and the measure of mu and nu is none that is negative; and those for which dL = int S d(eta) is not of first
order keep dS = 0 wherever mu > 0 or nu < 0. So it is enough that d2L > 0 for all variations with dS = 0 there, and that
L is strictly convex in *all* that may vary of the control, also in what leaves the arc. The times at which arcs begin
and end do not join in: in time normalised over the phase they stay where they are, and leaving the arc earlier is a
variation like others. What keeps S^(q) = 0 along an arc and S = ... = S^(q-1) = 0 where it begins has dS = 0 on it; and
there d2L is the second variation of the flight restated. Where mu is not strictly positive dS is left open, but for
times of a strict jump: Bryson and Denham's arc has mu = 0 and two jumps.

At a contact point with negligible nu it is enough as well that d2L > 0 for all variations whether they keep dS = 0 or
not, the time of the contact being that of the least S: J - J* >= L - L* holds for nu <= 0, and no strict sign is asked
for.

So it is at a contact point where S'' is negligible: to let its time vary gains what S'' takes, nu (dS')^2/S'', and
where that is most of a variation nothing can be distinguished from rounding.

Where H is linear in a scalar control, and S of order 1, that convexity fails, and another order of things holds: as
S' determines the control, all of the second variation is in S, and mu > 0 up to both ends of the arc makes every S > 0
pay to first order. What is left are the times, at which the control jumps: the restated flight's second variation with
all of them free, that at which S = 0 is reached by its own condition.

Source: Bryson and Ho (1975), section 3.11; Hartl, Sethi, Vickson (1995), sections 4 and 5; Maurer (1981), First and
second order sufficient optimality conditions in mathematical programming and optimal control, Math. Programming Study
14; Bonnans and Hermant (2009), Second-order analysis for optimal control problems with pure state constraints and mixed
control-state constraints, Ann. Inst. H. Poincare (C) 26, theorem 4.3; Aronna, Bonnans, Goh (2016), Second order
analysis of control-affine problems with scalar state constraint, Math. Program. 160, for what is linear.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from perilune.core import COMPLEX, STEP, Matrix, Vector, stack_broadcast
from perilune.problem import Check, Solution, control_slices, scalars
from perilune.proof.feasible.phase_data import PhaseData, end_slopes, free_size, phase_data_of, slopes_at_end
from perilune.proof.necessary.boundary_arc import ALONG, BoundaryArc
from perilune.proof.necessary.contact_points import MET, SIDEWAYS, STRICT
from perilune.proof.necessary.first_order import phase_end_multipliers, unbounded_parameters
from perilune.proof.necessary.minimum_principle import control_sizes, hamiltonian_gain, product_of
from perilune.proof.sufficient.second_variation import KeptConditions
from perilune.structures import Condition, Structure, conditions_of

_LEAST, _LOOKS = 1e-8, 200  # of H, and the points of an arc at which other controls are tried
_TURNS = 1e-3  # of the most that S'' is before a contact: what turns no faster is as near to an arc as to a contact
_STEADY, _CLEAR = 1e-5, 1e-3  # of the size of a control: a jump that is none, and one that shows when an arc begins


@dataclass(frozen=True, kw_only=True)
class BoundaryArcs:
    """Boundary arcs and contact points of a flight that `restate_with_contacts` has cut.

    Attributes
    ----------
    whole, parts
        The flight, and the same restated.
    boundary_arcs
        Boundary arcs along each of its parts.
    touches
        Conditions with a contact point at the end of each.
    begins
        Numbers of the parts with which the user's phases begin.
    """

    whole: Solution
    parts: Solution
    boundary_arcs: tuple[tuple[BoundaryArc, ...], ...]
    touches: tuple[tuple[Condition, ...], ...]
    begins: frozenset[int]

    @classmethod
    def of(cls, solution: Solution, parts: Solution, structure: Structure) -> BoundaryArcs:
        """Build from the results of `restate_with_contacts`.

        Parameters
        ----------
        solution
            The flight in the user's phases.
        parts
            The same flight, with a phase for each arc.
        structure
            Arcs of each of the user's phases.
        """
        sums = structure.sums(solution.problem)
        along, touches, begins = list[tuple[BoundaryArc, ...]](), list[tuple[Condition, ...]](), set[int]()
        for k, arcs in enumerate(structure.phases):
            known = conditions_of(solution.problem, k, structure.named(k))
            conditions = {  # in the durations of the parts
                name: c.with_sums(sums) for name, c in known.items()
            }
            begins.add(len(along))
            for arc in arcs:
                part = phase_data_of(parts)[len(along)]
                along.append(tuple(BoundaryArc(part=part, condition=conditions[name]) for name in arc.along))
                touches.append(tuple(conditions[name] for name in arc.touches))
        return cls(
            whole=solution, parts=parts, boundary_arcs=tuple(along), touches=tuple(touches), begins=frozenset(begins)
        )

    @cached_property
    def arcs(self) -> list[PhaseData]:
        """The parts."""
        return list(phase_data_of(self.parts))

    def inner(self, joint: int) -> bool:
        """Return True if a joint, the one before the part of its number, lies inside one of the user's phases."""
        return 0 < joint < len(self.boundary_arcs) and joint not in self.begins

    def entered(self, ridden: BoundaryArc) -> dict[int, float]:
        """Multipliers nu_i [J per unit] of the conditions S^(i) = 0 with which an arc is entered, by i."""
        k, condition = ridden.part.index, ridden.condition
        if not self.inner(k):
            return {}
        nu = phase_end_multipliers(self.arcs[k - 1])[0]
        rows = [c.name for c in self.arcs[k - 1].phase.end_conditions]
        names = [condition.rated(i, "enter_", 1.0).name for i in range(condition.order)]
        return {i: float(nu[rows.index(name)]) for i, name in enumerate(names) if name in rows}

    def scale(self, ridden: BoundaryArc, i: int) -> float:
        """Size of S^(i) where an arc begins [SI].

        Parameters
        ----------
        ridden
            Boundary arc of a condition S of order q.
        i
            Order of the time derivative of S, 0 to q - 1.
        """
        if i in self.entered(ridden):
            before = self.arcs[ridden.part.index - 1]
            names = [c.name for c in before.phase.end_conditions]
            return float(before.end_scale[names.index(ridden.condition.rated(i, "enter_", 1.0).name)])
        return float(np.abs(ridden.slope(i, ridden.edge(0.0))).max())

    def other(self, ridden: BoundaryArc, step: int) -> BoundaryArc | None:
        """Return the same condition along the part before (-1) or after (1), inside one of the user's phases.

        Parameters
        ----------
        ridden
            Boundary arc along one part of the flight.
        step
            -1 for the part before, 1 for the part after.
        """
        k = ridden.part.index + step
        if not self.inner(max(k, ridden.part.index)):
            return None
        return next((r for r in self.boundary_arcs[k] if r.condition.name == ridden.condition.name), None)

    def jump(self, joint: int) -> float:
        """Return the rest of the costates' jump after dS/dx with nu <= 0 and the user's conditions, scaled."""
        from scipy.optimize import nnls

        before = self.boundary_arcs[joint - 1] if joint else ()
        after = self.boundary_arcs[joint] if joint < len(self.boundary_arcs) else ()
        if not before and not after:
            return 0.0
        found = [r.costates(1.0) for r in before]
        cones = [r.slope(0, r.edge(1.0))[:, 0] for r in before]
        back = self._back(joint)
        for ridden in after:
            first = ridden.edge(0.0)
            slopes = [ridden.slope(i, first)[:, 0] @ back for i in range(ridden.condition.order)]
            found += [-ridden.costates(0.0) @ back]
            found += [nu * slopes[i] for i, nu in self.entered(ridden).items()]
            cones.append(slopes[0])
        wanted = np.sum(found, axis=0)
        if not np.isfinite(wanted).all():
            return float("nan")
        free = self._explained(joint)
        columns = np.column_stack([*(-c for c in cones), *free, *(-row for row in free)])
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        reach = max([r.reach(1.0) for r in before] + [r.reach(0.0) for r in after])
        return float(nnls(columns, wanted / reach)[1])

    def _back(self, joint: int) -> Matrix:
        """Return the matrix from derivatives by states after a joint to those by states before it, both scaled."""
        n = len(self.arcs[min(joint, len(self.arcs) - 1)].state_scale)
        if joint in (0, len(self.arcs)):
            return np.eye(n)
        before, after = self.arcs[joint - 1], self.arcs[joint]
        link, record = before.problem.links[joint - 1], before.phase.state_record
        through = slopes_at_end(before, lambda z: link(record(*z), before.p, COMPLEX))
        return through / after.state_scale[:, None]

    def _explained(self, joint: int) -> Sequence[Vector]:
        """Return the directions in which the user's own conditions let the costates jump, boundary arcs or not."""
        if self.inner(joint):
            return []
        if joint:
            before = self.arcs[joint - 1]
            # The user's own, as some may be left out of the restated ones.
            own = phase_data_of(self.whole)[sum(begin < joint for begin in self.begins) - 1]
            stated = [not c.ranged for c in own.phase.end_conditions]
            return list(end_slopes(own)[stated] / own.state_scale * before.state_scale)
        return list(_fixed_directions(self.arcs[0], unbounded_parameters(self.parts, self.arcs)))

    def checks(self) -> Iterator[Check]:
        """Checks of level 2."""
        for along in self.boundary_arcs:
            for ridden in along:
                yield from _check_arc_multiplier(
                    self, ridden, f"_{ridden.condition.variable.name}" if len(along) > 1 else ""
                )
            if along:
                value, why = _check_lowered_hamiltonian(along), ""
                if value > _LEAST and (name := _concave_scalar(along[0].part)):
                    why = f"; H is concave in {name} there: faster switching between its bounds lowers J "
                    why += "further, so that no optimal flight follows it (chattering)"
                yield Check(
                    name=f"{along[0].part.prefix}along_minimum", level=2, unit="1", limit=_LEAST, value=value,
                    meaning="largest decrease, by a control that leaves the arc, of the Hamiltonian with the"
                    " multiplier of "
                    f"{' and '.join(r.condition.name for r in along)} itself (scaled){why}",
                )  # fmt: skip

    def strictly(self, ridden: BoundaryArc, s: float) -> bool:
        """Return True if the costates of S jump by a strictly negative nu where an arc begins (0) or ends (1).

        Parameters
        ----------
        ridden
            Boundary arc of a condition S.
        s
            0.0 for the begin of the arc, 1.0 for its end.
        """
        joint = ridden.part.index + round(s)
        if not self.inner(joint) or self.other(ridden, 1 if s else -1) is not None:
            return False
        nu = self.entered(ridden).get(0, 0.0) if not s else 0.0
        nu += ridden.weights(s)[0] * (1 if s else -1)
        size = float(np.abs(ridden.slope(0, ridden.edge(s))).max()) / ridden.part.objective_scale
        return nu * size < -STRICT

    def kept_conditions(self, *, idle: bool = True) -> dict[int, KeptConditions]:
        """Return the conditions of boundary arcs that variations keep, by part: for the second variation.

        Parameters
        ----------
        idle
            Whether they also keep contact points whose multipliers are negligible.
        """
        found = {}
        for k, along in enumerate(self.boundary_arcs):
            ahead = self.boundary_arcs[k + 1] if self.inner(k + 1) else ()
            slow = self._slow(k), self._slow(k + 1)
            loose = [] if idle else self._idle(k)
            if along or ahead or self._turns(k) or any(slow) or loose:
                left = [*loose, *(name for r in ahead for name in self._left(r))]
                # Where the time of a contact does not vary nor does that of its least value: it is kept in the mean.
                left += [name for name in self._contact_rates(k) if self._turns(k + 1) or slow[1]]
                found[k] = KeptConditions(
                    boundary_rates=tuple(r.rate for r in along),
                    released=tuple(r.rate for r in along if not r.strict),
                    holds=tuple(value for r in along if r.strict for value in r.condition.values[:-1]),
                    end=tuple(r.condition.values[0] for r in along if self._ends(r)),
                    dropped_ends=tuple(left),
                    tied=slow[0] or (self._turns(k) and not (self._jumps_on(k) or self._jumps_on(k - 1))),
                    steady=all(self._jump(joint) <= _STEADY for joint in (k, k + 1) if self._turns(joint)),
                    least_multiplier=along[0].relative_multiplier if self._jumps_on(k) else None,
                )
        return found

    def _turns(self, joint: int) -> bool:
        """Return True if a boundary arc begins or ends at a joint inside one of the user's phases."""
        if not self.inner(joint):
            return False
        before, after = ({r.condition.name for r in self.boundary_arcs[k]} for k in (joint - 1, joint))
        return before != after

    def _slow(self, joint: int) -> bool:
        """Return True if a condition in contact at a joint hardly turns there: its time hardly matters and is fixed."""
        touches = self.touches[joint - 1] if self.inner(joint) else ()
        if not touches:
            return False
        part = self.arcs[joint - 1]
        t = np.linspace(0.0, part.duration, _LOOKS)
        x, u = part.phase.state_record(*part.state(t)), part.phase.control_record(*part.control(t))
        for condition in touches:
            turn = np.abs(np.broadcast_to(condition.values[2](x, u, part.p, COMPLEX)[0].real, t.shape))
            if turn[-1] <= _TURNS * turn.max():
                return True
        return False

    def _jumps_on(self, k: int) -> bool:
        """Return True if the control of a part is linear, and jumps at both ends of its only boundary arc."""
        near = [self.boundary_arcs[k + step] for step in (-1, 1) if self._turns(k + max(step, 0))]
        if len(self.boundary_arcs[k]) != 1 or any(near) or not self.boundary_arcs[k][0].linear:
            return False
        return all(self._jump(joint) > _CLEAR for joint in (k, k + 1) if self._turns(joint))

    def _jump(self, joint: int) -> float:
        """Return by how much a control jumps at a joint, over its size."""
        before, after = self.arcs[joint - 1], self.arcs[joint]
        jump = before.control(np.array([before.duration])) - after.control(np.zeros(1))
        return float((np.abs(jump[:, 0]) / after.control_scale).max())

    def _contact_rates(self, k: int) -> list[str]:
        """Names of the conditions S' = 0 of contact points at the end of a part."""
        return [condition.rated(1, "touch_", 1.0).name for condition in self.touches[k]]

    def _idle(self, k: int) -> list[str]:
        """Names of the conditions S = 0 of contact points at the end of a part whose multipliers are negligible."""
        part = self.arcs[k]
        nu = phase_end_multipliers(part)[0] * part.end_scale / part.objective_scale
        rows = [c.name for c in part.phase.end_conditions]
        names = [condition.rated(0, "touch_", 1.0).name for condition in self.touches[k]]
        return [name for name in names if nu[rows.index(name)] >= -STRICT]

    def _ends(self, ridden: BoundaryArc) -> bool:
        """Return True if variations keep S = 0 at the end of an arc on which they do not keep it."""
        after = self.other(ridden, 1)
        return not ridden.strict and after is None and self.strictly(ridden, 1.0)

    def _left(self, ridden: BoundaryArc) -> list[str]:
        """Conditions of the entry to an arc that variations need not keep."""
        first = 1 if self.strictly(ridden, 0.0) else 0
        names = [ridden.condition.rated(i, "enter_", 1.0).name for i in self.entered(ridden) if i >= first]
        return [] if ridden.strict else names


def _fixed_directions(arc: PhaseData, names: Sequence[str]) -> Matrix:
    """Directions of the states at the start of the flight that no free parameter of these names changes, in rows."""
    from types import SimpleNamespace

    problem, moved = arc.problem, np.zeros((len(arc.state_scale), 0))
    for free in (f for f in problem.free if f.name in names):
        step = 1j * STEP * free_size(arc.solution, free)
        p = SimpleNamespace(**{**vars(arc.p), free.name: getattr(arc.p, free.name) + step})
        column = np.imag(stack_broadcast(problem.start(p, COMPLEX), ())) / STEP / arc.state_scale
        moved = np.column_stack([moved, column])
    if not moved.shape[1]:
        return np.eye(len(moved))
    left, sizes, _ = np.linalg.svd(moved)
    return left[:, int((sizes > 1e-12).sum()) :].T


def _check_arc_multiplier(rides: BoundaryArcs, ridden: BoundaryArc, of: str) -> Iterator[Check]:
    """Check the signs of the multiplier along an arc and at both ends; `of` distinguishes several active conditions."""
    part, name, q = ridden.part, ridden.condition.name, ridden.condition.order
    beyond = "" if q <= 2 else f"; not available for a condition of order {q}"
    yield _check_arc_start(rides, ridden, of)
    yield Check(
        name=f"{part.prefix}along{of}", level=2, unit="1", limit=ALONG, value=float(np.maximum(0.0, -ridden.mu.min())),
        meaning=f"multiplier of {name} along the boundary arc, where it is negative (scaled): the decrease of J if"
        f" the flight left it{beyond}; not available where it is not a smooth function of time",
    )  # fmt: skip
    yield Check(
        name=f"{part.prefix}along_ends{of}", level=2, unit="1", limit=SIDEWAYS,
        value=float(np.max([rides.jump(part.index), rides.jump(part.index + 1)])),
        meaning=f"jumps of the costates at entry to and exit from {name}, of the wrong sign or not along its"
        f" gradient, unless explained by an end condition of a phase or a given start (scaled){beyond}",
    )  # fmt: skip


def _check_arc_start(rides: BoundaryArcs, ridden: BoundaryArc, of: str) -> Check:
    """Check that S and its rates vanish where a boundary arc begins."""
    part, condition, x = ridden.part, ridden.condition, ridden.edge(0.0)
    u = part.phase.control_record(*part.control(np.zeros(1))[:, 0].tolist())
    worst = 0.0
    for i, value in enumerate(condition.values[:-1]):
        off = float(value(part.phase.state_record(*x[:, 0].tolist()), u, part.p, COMPLEX)[0].real)
        worst = float(np.max([worst, abs(off) / rides.scale(ridden, i)]))
    return Check(
        name=f"{part.prefix}met{of}", level=2, unit="1", limit=MET, value=worst,
        meaning=f"{condition.name} and its rates along the stated boundary arc (scaled): they vanish",
    )  # fmt: skip


def _concave_scalar(part: PhaseData) -> str:
    """Return the name of a scalar inside its bounds in which H is concave all along, and what is held linear; or ""."""
    inside = part.sampled
    x, u, lam = inside.x, inside.u, inside.lam
    for at, control in scalars(part.phase.controls):
        lower, upper = (float(limit) for limit in control.limits(part.p))
        if not (np.isfinite(upper - lower) and ((u[at] > lower) & (u[at] < upper)).all()):
            continue
        share, sides = (u[at] - lower) / (upper - lower), [np.array(u), np.array(u)]
        sides[0][at], sides[1][at] = lower, upper
        H, S = ([of(value) for value in (u, *sides)] for of in (
            lambda value: part.hamiltonian(x, value, lam), lambda value: part.held(x, value)))  # fmt: skip
        drop, bend = (own[0] - (1 - share) * own[1] - share * own[2] for own in (H, S))
        straight = np.abs(bend) <= _STEADY * (np.abs(S[1]) + np.abs(S[2]))
        if (drop > _LEAST * part.rate_scale).all() and straight.all():
            return control.name
    return ""


def _check_lowered_hamiltonian(along: Sequence[BoundaryArc]) -> float:
    """Return the most that any admissible control lowers H of lam - eta dS^(q-1)/dx, scaled, as S >= 0 itself requires.

    With the multiplier of S in the place of that of S^(q), u minimises H among all controls, and not only those that
    keep S^(q) = 0 (Hartl, Sethi, Vickson 1995, section 5). The rest of lam's difference is across all controls.
    """
    part = along[0].part
    inside, lam = part.sampled, part.sampled.lam
    for ridden in along:
        lam = lam - ridden.eta * ridden.slope(ridden.condition.order - 1, inside.x) / part.state_scale[:, None]
    few = np.unique(np.linspace(0, len(inside.t) - 1, _LOOKS).astype(int))
    x, u, lam = inside.x[:, few], inside.u[:, few], lam[:, few]
    sizes = control_sizes(part)
    parts = [
        np.stack(control.samples(u[here], float(sizes[here.start]), part.p), axis=1)
        for here, control in control_slices(part.phase.controls)
    ]
    lowered = hamiltonian_gain(part, x[:, None], u[:, None], product_of(parts), lam[:, None], leaving=True)
    return lowered * part.time_scale / part.objective_scale
