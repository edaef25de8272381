"""Boundary arc of a condition on states: its multiplier, and the costates of the condition itself.

Along an arc of order q the multiplier eta of S^(q) = 0, L = H - eta S^(q), stands for that of S >= 0 itself, which is

    mu = (-1)^q d^q eta/dt^q >= 0.

The costates of S itself differ from those of the table by - eta dS/dx at q = 1, by - eta dS'/dx + eta' dS/dx at q = 2.

Source: Bryson and Ho (1975), section 3.11; Hartl, Sethi, Vickson (1995), sections 4 and 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev

from perilune.core import COMPLEX, Matrix, Vector, complex_step_jacobian, stack_broadcast
from perilune.problem import ScalarControl, unpriced_states
from perilune.proof.feasible.phase_data import PhaseData
from perilune.structures import Condition

# The multiplier along an arc is a polynomial in time, to rounding; its derivatives are noise below a share of it.
# Twice the degree is for what nearly has a root in it, as a control that S^(q) = 0 has to the square.
_DEGREES, _ROUGH, ALONG = (12, 24), 1e-6, 1e-4
_STRAIGHT = 1e-12  # of rates: they are linear in a control
_POSITIVE, _AT_ENDS = 1e-3, 0.02  # of its largest value mu is strictly positive; near the ends it may vanish


@dataclass(frozen=True, kw_only=True)
class BoundaryArc:
    """Condition that is active all along a part of the flight restated (a boundary arc).

    Attributes
    ----------
    part
        The part.
    condition
        The condition, of order q.
    """

    part: PhaseData
    condition: Condition

    @property
    def rate(self) -> str:
        """Name of S^(q) = 0 among what the part holds."""
        return self.condition.rated(self.condition.order, "", 1.0).name

    @cached_property
    def eta(self) -> Vector:
        """Multiplier of S^(q) at the times of `PhaseData.sampled`, J per second and its unit; else NaN."""
        inside, allowed = self.part.sampled, self.part.allowed
        names = [] if allowed is None else [c.name for c in allowed.conditions]
        if allowed is None or self.rate not in names:
            return np.full(len(inside.t), np.nan)
        return allowed.multipliers(inside.x, inside.u, inside.lam).mu[names.index(self.rate)]

    @property
    def shares(self) -> Vector:
        """Return the times of the samples, as shares of the arc."""
        return self.part.sampled.t / self.part.duration

    @property
    def size(self) -> float:
        """The largest eta."""
        return float(np.abs(self.eta).max()) or 1.0

    @cached_property
    def _fitted(self) -> tuple[Chebyshev, float]:
        """A polynomial of eta over its size on [0, 1], and how far that is from it."""
        s, eta = self.shares, self.eta / self.size
        curve = Chebyshev([np.nan], domain=[0.0, 1.0])
        for degree in _DEGREES if np.isfinite(eta).all() and self.condition.order <= 2 else ():
            curve = Chebyshev.fit(s, eta, min(degree, len(s) // 2), domain=[0.0, 1.0])
            if np.abs(curve(s) - eta).max() <= _ROUGH:
                break
        return curve, float(np.abs(curve(s) - eta).max())

    @property
    def curve(self) -> Chebyshev:
        """Eta over its size on [0, 1]; NaN where it is no smooth function, or q is more than 2."""
        curve, rough = self._fitted
        return curve if rough <= _ROUGH else Chebyshev([np.nan], domain=[0.0, 1.0])

    @cached_property
    def mu(self) -> Vector:
        """Multiplier of S itself at the times of `PhaseData.sampled`, in units of `size` and of the arc's length."""
        q = self.condition.order
        return (-1) ** q * self.curve.deriv(q)(self.shares)

    @property
    def noise(self) -> float:
        """Return by how much the fit may be wrong in mu (Markov's inequality)."""
        curve, rough = self._fitted
        return rough * (2.0 * curve.degree() ** 2) ** self.condition.order

    @property
    def relative_multiplier(self) -> float:
        """The least mu over the largest, up to both ends of the arc; 0 where it may be none."""
        least = float(self.mu.min())
        return least / float(self.mu.max()) if least > max(self.noise, ALONG) else 0.0

    @cached_property
    def linear(self) -> bool:
        """Return True if S is of order 1, and the phase's one control, a scalar, is linear in the equations of motion.

        States that only count are left out: without them the flight is the same.
        """
        part, controls = self.part, self.part.phase.controls
        if self.condition.order != 1 or len(controls) != 1 or not isinstance(controls[0], ScalarControl):
            return False
        inside, size = part.sampled, float(part.control_scale[0])
        ends = [
            v if np.isfinite(v) else side * size for v, side in zip(controls[0].limits(part.p), (-1, 1), strict=True)
        ]
        tried = np.array([ends[0], 0.5 * (ends[0] + ends[1]), ends[1]])[None, :, None] + 0 * inside.t
        f = part.rates(inside.x[:, None], tried).real
        idle = unpriced_states(part.problem)[part.index]
        f = f[[name not in idle for name in part.phase.state_names]]
        bent = np.abs(f[:, 0] - 2 * f[:, 1] + f[:, 2]).max(axis=1)
        return bool((bent <= _STRAIGHT * np.abs(f).max(axis=(1, 2))).all())

    @property
    def strict(self) -> bool:
        """Return True if mu is strictly positive between the ends of the arc, by more than the fit may be wrong."""
        inner = self.mu[(self.shares > _AT_ENDS) & (self.shares < 1 - _AT_ENDS)]
        return bool(len(inner)) and bool(inner.min() > max(_POSITIVE * inner.max(), self.noise, ALONG))

    def slope(self, i: int, x: Matrix) -> Matrix:
        """d(S^(i))/dx, i < q, at states x (n, N): (n, N), scaled by the states.

        Parameters
        ----------
        i
            Order of the time derivative of the condition, 0 to q - 1.
        x
            States, shape (n, N) [SI].
        """
        part, value, names = self.part, self.condition.values[i], self.part.phase.control_names

        def values(z: Any) -> Any:
            u = part.phase.control_record(*[np.zeros(z.shape[1:])] * len(names))
            return stack_broadcast([value(part.phase.state_record(*z), u, part.p, COMPLEX)[0]], z.shape[1:])

        return complex_step_jacobian(values, x, part.state_scale)[0]

    def edge(self, s: float) -> Matrix:
        """The state where the arc begins (s = 0) or ends (1), (n, 1)."""
        return self.part.state(np.array([s * self.part.duration]))

    def weights(self, s: float) -> tuple[float, ...]:
        """Return what the costates of S add to the table's at s = 0 or 1, along dS/dx and dS'/dx [J/unit]."""
        eta = float(self.curve(s)) * self.size
        rate = float(self.curve.deriv(1)(s)) * self.size / self.part.duration
        return (-eta,) if self.condition.order == 1 else (rate, -eta)

    def costates(self, s: float) -> Vector:
        """Return the same as a vector (n,), J per canonical unit of each state."""
        x = self.edge(s)
        return np.sum([w * self.slope(i, x)[:, 0] for i, w in enumerate(self.weights(s))], axis=0)

    def reach(self, s: float) -> float:
        """Size of that: eta where it is largest, along d(S^(q-1))/dx."""
        return self.size * float(np.linalg.norm(self.slope(self.condition.order - 1, self.edge(s))))
