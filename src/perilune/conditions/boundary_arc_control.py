"""Minimising thrust on a boundary arc: direction and magnitude at once, in closed form.

Along a boundary arc of S >= 0, S^(q) = a + s b.d = 0 is held, for a thrust of the direction d and the size s, and the
Hamiltonian is h + s (g.d + k). Where s lies between its bounds it is -a/(b.d), and it remains to minimise

    rho = (g.d + k) / (b.d)     over b.d of the sign of -a.

At its least value (g - rho b).d + k has the minimum 0 over all d (Dinkelbach, Management Science 13 (7), 1967): so
|g - rho b| = k, a quadratic in rho, and d points against g - rho b. Where d also keeps e.d = c, with |e| = 1, it is
c e + sqrt(1 - c^2) w with w across e, and the same holds for w. No square root here vanishes in planar flight, as one
does when d is solved for at a given s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from perilune.conditions.active_constraints import real_root, unit_share
from perilune.problem import Phase, directions, elements, scalars


def boundary_arc_control(
    phase: Phase, hamiltonian: ca.SX, u: ca.SX, held: Mapping[str, ca.SX]
) -> tuple[ca.SX, ca.SX] | None:
    """Return the control of a phase whose one scalar, off its bounds, keeps a condition active with its one direction.

    Parameters
    ----------
    phase, hamiltonian, u
        H as an expression of the symbols u of the phase's controls, among others.
    held
        What vanishes, by name.

    Returns
    -------
    (control, room) or None
        As of `boundary_arc_optimum`.
    """
    both, sizes = [*directions(phase.controls)], [*scalars(phase.controls)]
    if len(both) != 1 or len(sizes) != 1:
        return None
    (first, last), at = both[0], sizes[0][0]
    sized = [c for c in held.values() if ca.depends_on(c, u[at])]
    others = [c for c in held.values() if not ca.depends_on(c, u[at])]
    found = boundary_arc_optimum(hamiltonian, u[first:last], u[at], sized[0], others) if len(sized) == 1 else None
    if found is None:
        return None
    whole = elements(u)
    direction, whole[at], room = found
    whole[first:last] = elements(direction)
    return ca.vertcat(*whole), room


def boundary_arc_optimum(
    hamiltonian: ca.SX, d: ca.SX, size: ca.SX, condition: ca.SX, held: Sequence[ca.SX]
) -> tuple[ca.SX, ca.SX, ca.SX] | None:
    """Return the minimising direction and size that keep a condition active.

    Parameters
    ----------
    hamiltonian
        As an expression of d and size, among others.
    d, size
        Symbols of the direction and of the scalar that scales it.
    condition
        What vanishes.
    held
        At most one more condition, linear in d, that is held.

    Returns
    -------
    (direction, size, room) or None
        No size does it where the room, a column, has a negative number; None where the condition or H have another
        form than that above.
    """
    none = ca.SX.zeros(d.numel(), 1)
    a = ca.substitute(condition, d, none)
    g, b = (ca.substitute(ca.gradient(e, d), size, 1.0) for e in (hamiltonian, condition))
    k = ca.substitute(ca.gradient(hamiltonian, size), d, none)
    known = ca.vertcat(d, size)
    if (
        len(held) > 1
        or any(ca.depends_on(e, known) for e in (a, g, b, k))
        or not _scales_direction_only((hamiltonian, condition), d, size)
    ):
        return None
    sign = ca.if_else(a > 0, -1.0, 1.0)
    b = sign * b
    e, c, radius = none, ca.SX(0.0), ca.SX(1.0)
    if held:
        e, c = unit_share(held[0], d)
        radius = real_root(1 - c * c)
    more, less = k + c * ca.dot(g, e), c * ca.dot(b, e)
    g, b = radius * (g - ca.dot(g, e) * e), radius * (b - ca.dot(b, e) * e)
    square, half, rest = ca.dot(b, b) - less**2, ca.dot(g, b) - more * less, ca.dot(g, g) - more**2
    inside = half**2 - square * rest
    root = real_root(inside)
    # The form of the root without cancellation.
    rho = ca.if_else(half > 0, (half + root) / square, rest / (half - root))
    across = g - rho * b
    size_there = -a * sign / (less - ca.dot(b, across) / ca.norm_2(across))
    room = ca.vertcat(inside, 1 - c * c, more - rho * less)
    return c * e - radius * across / ca.norm_2(across), size_there, room


def _scales_direction_only(expressions: Sequence[ca.SX], d: ca.SX, size: ca.SX) -> bool:
    """Return True if the size scales the direction, and nothing else of d enters, as seen at a few points."""
    twice = [ca.substitute(e, ca.vertcat(d, size), ca.vertcat(2.0 * d, 0.5 * size)) for e in expressions]
    none = [ca.substitute(e, d, ca.SX.zeros(d.numel(), 1)) for e in expressions]
    half = [ca.substitute(e, size, 0.5 * size) for e in none]
    # e(2 d, s/2) - e(0, s/2) = e(d, s) - e(0, s) for e = h + s (g.d + k)
    left = ca.vertcat(*(t - h for t, h in zip(twice, half, strict=True)))
    right = ca.vertcat(*(e - n for e, n in zip(expressions, none, strict=True)))
    symbols = ca.symvar(ca.vertcat(left, right))
    evaluate = ca.Function("scaled", [ca.vertcat(ca.SX(0, 1), *symbols)], [left, right])
    rng = np.random.default_rng(0)
    for _ in range(3):
        one, other = (np.array(v).ravel() for v in evaluate(rng.uniform(0.5, 1.5, len(symbols))))
        if not np.allclose(one, other, rtol=1e-9, atol=1e-12):
            return False
    return True
