"""Mixed state-control constraints, and the multipliers of the active ones.

Where a path condition c(x, u, p) >= 0 is zero it is *active*; what a phase holds, c = 0, is active all along: u
minimises H among the controls that keep it. Along the tangents of the control (Karush-Kuhn-Tucker)

    dH/du = sum of mu_i dc_i/du,   mu_i >= 0 for c_i >= 0, of any sign for c_i = 0, and 0 where it is not active,

and L = H - mu.c has H's place: lam' = -dL/dx, and a parameter's derivative of J is that of L. No table holds the mu.
They are read off dH/du at each time, by least squares; what they leave of it is another check's, as is their sign. A
scalar on its bound has a multiplier of its own, so that its row says nothing of the mu. Source: Bryson and Ho (1975),
section 3.10; Hartl, Sethi, Vickson (1995), A survey of the maximum principles for problems with state constraints,
section 4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from perilune.core import COMPLEX, NUMERIC, STEP, Matrix, Vector, complex_step_jacobian, stack_broadcast
from perilune.problem import Phase, ScalarControl, Variable, admissible, control_slices, normalised, tangents

ON_BOUND = 1e-7  # a control this close to its bound or to a condition, in canonical units, lies on it
_DEPENDENT = 1e-10  # of the largest: conditions whose slopes differ by less leave their multipliers open
_ROUNDS, _FARTHEST = 10, 0.5  # of Newton's method, and of each of its steps in canonical units
KEPT = 1e-11  # the same of sampled controls: by so much they may leave a condition
_REACHED = 1e-12  # how far from a condition's surface it may end


@dataclass(frozen=True, kw_only=True)
class Multipliers:
    """Multipliers of r conditions at N points, and the slopes of the conditions.

    Attributes
    ----------
    mu
        J per second and unit of the condition, (r, N); 0 where it is not active.
    slopes
        Derivatives of the conditions along the control's tangents, (r, k, N); 0 where none is active.
    """

    mu: Matrix
    slopes: Any

    @property
    def pull(self) -> Matrix:
        """Return the part of dH/du that the multipliers explain, (k, N)."""
        return (self.mu[:, None] * self.slopes).sum(axis=0)

    @property
    def falls(self) -> Matrix:
        """Return by how much H falls (rises where negative) as the control leaves each condition the steepest way."""
        return self.mu * np.sqrt((self.slopes**2).sum(axis=1))


@dataclass(frozen=True, kw_only=True)
class MixedConstraints:
    """The conditions of one phase in which its control appears; `along` makes it.

    Attributes
    ----------
    phase, p
        The phase, and all parameters in SI.
    state_scale, control_scale
        Sizes of the components [SI].
    places
        Of the conditions among those of the path and those held, in that order.
    sizes
        The most that each condition changes with the control, per canonical unit of it, (r,).
    """

    phase: Phase
    p: Any
    state_scale: Vector
    control_scale: Vector
    places: tuple[int, ...]
    sizes: Vector

    @classmethod
    def along(
        cls, phase: Phase, p: Any, scales: tuple[Vector, Vector], x: Matrix, u: Matrix
    ) -> MixedConstraints | None:
        """Return the constraints of a phase; None if none depends on the control at the points x (n, N), u (k, N).

        Parameters
        ----------
        phase
            Phase with path conditions and held conditions.
        p
            Record of all parameters [SI].
        scales
            Sizes of the states, shape (n,), and of the controls, shape (k,) [SI].
        x, u
            States, shape (n, N), and controls, shape (k, N), at N points of the phase [SI].
        """
        count = len(phase.path_conditions) + len(phase.held_conditions)
        every = cls(
            phase=phase, p=p, state_scale=scales[0], control_scale=scales[1], places=tuple(range(count)),
            sizes=np.ones(count),
        )  # fmt: skip
        sizes = np.nan_to_num(np.sqrt((every.slopes(x, u) ** 2).sum(axis=1)), posinf=0.0).max(axis=1)
        places = np.nonzero(sizes)[0]
        return replace(every, places=tuple(places.tolist()), sizes=sizes[places]) if len(places) else None

    @cached_property
    def conditions(self) -> tuple[Variable, ...]:
        """The conditions, in order."""
        every = *self.phase.path_conditions, *self.phase.held_conditions
        return tuple(every[place] for place in self.places)

    @cached_property
    def equal(self) -> Any:
        """Return which conditions are equalities, held all along, (r,)."""
        return np.array(self.places) >= len(self.phase.path_conditions)

    @property
    def of_path(self) -> Vector:
        """Sizes of all conditions of the path, 0 of one that does not depend on the control."""
        sizes = np.zeros(len(self.phase.path_conditions) + len(self.phase.held_conditions))
        sizes[list(self.places)] = self.sizes
        return sizes[: len(self.phase.path_conditions)]

    def values(self, x: Any, u: Any, p: Any = None, xp: Any = COMPLEX, dtype: Any = complex) -> Any:
        """The conditions, complex-safe, (r, ...), for x (n, ...) and u (k, ...).

        Parameters
        ----------
        x, u
            States, shape (n, ...), and controls, shape (k, ...) [SI].
        p
            Record of all parameters [SI]; None for those of the phase.
        xp
            Namespace of mathematical functions.
        dtype
            Type of the entries: complex for derivatives by complex steps, float for `NUMERIC`.
        """
        p = self.p if p is None else p
        values = [v for which in ("path", "held") for v in self.phase.evaluate(which, list(x), list(u), p, xp)]
        shape = np.broadcast_shapes(np.shape(x)[1:], np.shape(u)[1:])
        return stack_broadcast([values[place] for place in self.places], shape, dtype)

    def slopes(self, x: Matrix, u: Matrix, moves: Any = None) -> Any:
        """Derivatives (r, k, N) as the control moves along `moves` (components, k, N), by default its tangents.

        Parameters
        ----------
        x, u
            States, shape (n, N), and controls, shape (k, N) [SI].
        moves
            Directions in the space of the controls, shape (components, k, N); None for the tangents.
        """
        return self._moved(lambda x, u: self.values(x, u), x, u, moves)

    def _moved(self, function: Any, x: Matrix, u: Matrix, moves: Any = None) -> Any:
        moves = tangents(self.phase.controls, self.control_scale, u) if moves is None else moves
        moved = normalised(self.phase.controls, u[:, None] + 1j * STEP * moves)
        return function(np.broadcast_to(x[:, None], (len(x), *moved.shape[1:])), moved).imag / STEP

    def by_state(self, x: Matrix, u: Matrix) -> Any:
        """Derivatives (r, n, N) in the states, each over its size.

        Parameters
        ----------
        x, u
            States, shape (n, N), and controls, shape (k, N) [SI].
        """
        return complex_step_jacobian(
            lambda z: self.values(z, u.reshape(len(u), *(1,) * (z.ndim - 2), -1)), x, self.state_scale
        )

    def active(self, x: Matrix, u: Matrix) -> Any:
        """Return True where each condition is active, (r, N).

        Parameters
        ----------
        x, u
            States, shape (n, N), and controls, shape (k, N) [SI].
        """
        rows = self.values(x, u, xp=NUMERIC, dtype=float)
        return (np.abs(rows) <= ON_BOUND * self.sizes[:, None]) | self.equal[:, None]

    def multipliers(self, x: Matrix, u: Matrix, lam: Matrix) -> Multipliers:
        """Multipliers at points x, lam (n, N) and u (components, N), directions normalised.

        Parameters
        ----------
        x, u
            States, shape (n, N), and controls, shape (components, N) [SI].
        lam
            Costates, shape (n, N) [J per SI unit of the state].
        """
        active = self.active(x, u)
        freedom = sum(control.freedom for control in self.phase.controls)
        mu, slopes = np.zeros(active.shape), np.zeros((len(active), freedom, active.shape[1]))
        at = np.nonzero(active.any(axis=0))[0]
        if len(at):
            x, u, lam = x[:, at], u[:, at], lam[:, at]
            slopes[:, :, at] = C = self.slopes(x, u) * active[:, None, at]
            g = self._moved(lambda x, u: (lam[:, None] * self._rates(x, u)).sum(axis=0), x, u)
            least = _least_multipliers(C / self.sizes[:, None, None] * self._open(u), g * self._open(u), self.equal)
            mu[:, at] = least / self.sizes[:, None]
        return Multipliers(mu=mu, slopes=slopes)

    def _rates(self, x: Any, u: Any) -> Any:
        return stack_broadcast(self.phase.rates(x, u, self.p, COMPLEX), np.shape(u)[1:])

    def _open(self, u: Matrix) -> Matrix:
        """Tangents (k, N) along which no bound of a scalar holds: 1 or 0."""
        rows = []
        for here, control in control_slices(self.phase.controls):
            held = np.zeros(u.shape[1], dtype=bool)
            if isinstance(control, ScalarControl):
                near = ON_BOUND * float(self.control_scale[here.start])
                held = np.logical_or(*control.on_bounds(u[here.start], near, self.p))
            rows += [~held] * control.freedom
        return np.array(rows, dtype=float)

    def onto(self, rows: list[int], x: Matrix, tried: Any, along: Vector) -> tuple[Any, Any]:
        """Controls `tried` (components, S, N) moved to where conditions are 0, and where they get there.

        By Newton's method, each of its steps the shortest `along` some tangents (k,): 1 or 0; x is (n, N).

        Parameters
        ----------
        rows
            Indices of the conditions that are made 0, among those of this record.
        x
            States, shape (n, N) [SI].
        tried
            Controls to move, shape (components, S, N) [SI].
        along
            1 for each tangent that may be used and 0 for the others, shape (k,).

        Returns
        -------
        controls, reached
            Controls, shape (components, S, N) [SI], and True where all conditions are 0, shape (S, N).
        """
        controls, sizes, shape = self.phase.controls, self.sizes[rows, None], tried.shape
        u = np.array(tried).reshape(len(tried), -1)
        x = np.broadcast_to(x[:, None], (len(x), *shape[1:])).reshape(len(x), -1)
        far = np.arange(u.shape[1])
        for _ in range(_ROUNDS):
            c = self.values(x[:, far], u[:, far])[rows].real / sizes
            left = (np.abs(c) > _REACHED).any(axis=0)
            far, c = far[left], c[:, left]
            if not len(far):
                break
            C = self.slopes(x[:, far], u[:, far])[rows] * along[:, None] / sizes[:, None]
            step = _least_multipliers(C.swapaxes(0, 1), -c, np.ones(len(along), dtype=bool))
            long = np.sqrt((step**2).sum(axis=0)) / _FARTHEST
            moves = tangents(controls, self.control_scale, u[:, far])
            moved = u[:, far] + (moves * (step / np.maximum(long, 1.0))).sum(axis=1)
            u[:, far] = admissible(controls, moved, self.p)
        there = (np.abs(self.values(x, u)[rows].real) <= _REACHED * sizes).all(axis=0)
        return u.reshape(shape), there.reshape(shape[1:])

    def push(self, x: Matrix, u: Matrix, lam: Matrix) -> Matrix:
        """Return sum of mu dc/dx that lam' adds to -dH/dx: J per second and canonical unit of each state, (n, N).

        Parameters
        ----------
        x, u
            States, shape (n, N), and controls, shape (components, N) [SI].
        lam
            Costates, shape (n, N) [J per SI unit of the state].
        """
        mu = self.multipliers(x, u, lam).mu
        out, at = np.zeros(x.shape), np.nonzero(mu.any(axis=0))[0]
        if len(at):
            out[:, at] = (mu[:, None, at] * self.by_state(x[:, at], u[:, at])).sum(axis=0)
        return out


def _least_multipliers(C: Any, g: Matrix, equal: Any) -> Matrix:
    """Return mu (r, N) with g = sum of mu C in the sense of least squares: C (r, k, N), g (k, N).

    Where conditions whose slopes depend on each other leave it open, the shortest; where that is negative but where
    `equal` (r,) allows it, one that is not.
    """
    if len(C) == 1 or C.shape[1] == 1:  # one condition, or one way to go
        square = (C**2).sum(axis=(0, 1))
        mu = np.divide((C * g).sum(axis=1), square, out=np.zeros((len(C), g.shape[1])), where=square > 0)
    else:
        mu = (np.linalg.pinv(C.transpose(2, 1, 0), rcond=_DEPENDENT) @ g.T[:, :, None])[:, :, 0].T
    count = (C != 0).any(axis=1).sum(axis=0)
    at = np.nonzero((mu[~equal] < 0).any(axis=0) & (count > 1))[0]
    if len(at):
        A = C[:, :, at].transpose(2, 1, 0)
        dependent = np.linalg.matrix_rank(A, tol=_DEPENDENT * np.abs(A).max(axis=(1, 2))) < count[at]
        at, A = at[dependent], A[dependent]
    if len(at):
        from scipy.optimize import nnls

        A = np.concatenate([A, -A[:, :, equal]], axis=2)
        found = np.array([nnls(*each)[0] for each in zip(A, g.T[at], strict=True)]).T
        mu[:, at] = found[: len(C)]
        mu[np.ix_(equal, at)] -= found[len(C) :]
    return mu
