"""Level 3, locally optimal: strict Legendre and Kelley conditions, and a second variation without conjugate point.

Among all admissible small variations of control, initial state, durations and switching times, those that keep
the end conditions, the second variation

    d2J = [dx, dp]' (d2 Phi) [dx, dp] at the end + lam(0).d2x0[dp, dp] + int [dx, dp, du]' (d2 H) [dx, dp,
    du] dt, dx' = f_x dx + f_u du + f_p dp,     psi_x dx(t_f) + psi_p dp = 0

must be positive. Measured against int du' H_uu du it is 1 - kappa, with kappa the largest eigenvalue of the
rest. By the Morse index theorem the eigenvalues beyond 1 count the conjugate
points of the arc, and kappa = 1 is one exactly at the start: for x'' = -x, kappa = (T/pi)^2. In contrast to
the determinant of the field of extremals this has no singular end, sees double conjugate points, and takes
free parameters along.

Where a bounded control switches the phase is cut into pieces, and the times t_k of the cuts join p: time is
normalised on each piece, so they enter f and H as durations do. They have a curvature of their own: the measure
becomes int du' H_uu du + sum D_k dt_k^2 with D_k > 0 of `strict_complementarity`. Where no control varies otherwise
(bang-bang) d2J is the Hessian of the Lagrangian of the finite-dimensional problem in switching times and free
parameters, whose positivity on the critical cone is sufficient together with the strict conditions of
`strict_complementarity`. A switch may lie at an end of the flight, with an arc of no length beyond it. Where the end
conditions leave no variation at all, only these are needed, and kappa is 0.

On a singular arc the integral of its control has the control's place (`singular_arcs`). The control jumps at both ends,
the times of which have no curvature of their own; what is left of its impulse at the end is a free parameter.

Where the flight crosses a jump of the physics, s(x) = 0, the time of that joins p as well, without a curvature of its
own: s = 0 there is one more condition to be kept, and nu s of `switch_slopes` one more term of the Lagrangian.

On which side of 1 kappa lies does not depend on how time is normalised; how far from it does, where u varies.

The form is discretised on equal steps with a constant control each (implicit midpoint rule), what of the control
varies as `second_variation` says. Source:
Gelfand and Fomin (1963), sections 27-29; Bryson and Ho (1975), chapter 6; Hestenes (1966); Maurer, Buskens, Kim,
Kaya (2005) and Osmolovskii and Maurer (2012), chapters 5-7, for switching times, without and with a regular control.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache

import numpy as np

from perilune.problem import Check, Solution, scalars
from perilune.proof.feasible.phase_data import PhaseData, phase_data_of
from perilune.proof.necessary.first_order import unbounded_parameters
from perilune.proof.sufficient.active_controls import check_strict_conditions
from perilune.proof.sufficient.assemble_form import assemble_second_variation
from perilune.proof.sufficient.quadratic_form import QuadraticForm, destabilising_eigenvalue, newton_gain
from perilune.proof.sufficient.second_variation import KeptConditions, VariationPiece, variation_pieces
from perilune.proof.sufficient.singular_arcs import Singular
from perilune.proof.sufficient.strict_complementarity import check_strictness, end_switches, switch_slopes

CURVATURE_LIMIT = -1e-4
# Discretisation lowers kappa by 1.6e-4 of itself (oscillator).
KAPPA_LIMIT = 0.999
# Of J. What the steps leave of a first variation that is 0 gains 3e-8 at most on good answers.
GAIN_LIMIT = 1e-6
_FINER, _BY_STEPS = (2, 4), 1.0  # times as many steps, where they may be what leaves it
# Times as many steps for kappa, where it is between its limit and this; how near to 1 rounding leaves it open.
_LEVELS, _DOUBTFUL, _ROUNDED = (2, 3, 4), 1.1, 1e-8


def check_local_optimality(solution: Solution, kept: Mapping[int, KeptConditions] | None = None) -> Iterator[Check]:
    """Checks of level 3 that need no other solve.

    Parameters
    ----------
    solution
        An extremal with costates.
    kept
        Of `BoundaryArcs.kept_conditions`, where it has boundary arcs.
    """
    arcs = phase_data_of(solution)
    inner = unbounded_parameters(solution, arcs)
    durations = [name for name in inner if name in solution.problem.duration_names]
    pieces = variation_pieces(arcs, inner, kept or {})
    for arc in arcs:
        own = [piece for piece in pieces if piece.arc is arc]
        yield _check_legendre_clebsch(arc, own)
        yield from _check_kelley(arc, own)
        if own[0].kept.boundary_rates:
            yield _check_legendre_on_arcs(arc, own)
        yield from check_strictness(arc)
        yield from check_strict_conditions(arc, [(*piece.span, piece.held) for piece in pieces if piece.arc is arc])
    regular = all(piece.regular for piece in pieces) and not any(_has_unsupported_switch(arc) for arc in arcs)
    form_of = cache(
        lambda finer: assemble_second_variation(
            pieces if finer == 1 else variation_pieces(arcs, inner, kept or {}, finer)
        )
    )
    forms = form_of if regular else None
    others = [name for name in inner if name not in durations]
    yield _check_positive(forms, [inner.index(name) for name in others], name="conjugate_point",
        meaning="extent of the arc relative to a conjugate point: 1 means a conjugate point at its start, beyond 1 a"
        " better neighbouring arc exists",
    )  # fmt: skip
    if others:
        yield _check_positive(forms, [], name="second_variation",
            meaning=f"the same with {', '.join(others)} varied together with the control: beyond 1 a better"
            f" neighbouring choice exists",
        )  # fmt: skip
    if forms is not None:
        gain = newton_gain(forms(1))
        for finer in _FINER:  # what the steps owe falls with the fourth power of their number
            if GAIN_LIMIT < gain < _BY_STEPS:
                gain = newton_gain(forms(finer))
        yield Check(
            name="nothing_gained", level=3, value=gain, limit=GAIN_LIMIT, unit="1",
            meaning="decrease of J by one Newton step on the second variation, over its magnitude: almost zero if the"
            " flight is the minimum itself, independent of the scales of costates and gradients",
        )  # fmt: skip


def _check_positive(
    forms: Callable[[int], QuadraticForm] | None, fixed: Sequence[int], *, name: str, meaning: str
) -> Check:
    value, limit = float("nan"), KAPPA_LIMIT
    if forms is None:
        meaning += (
            "; not available: H is not strictly convex in a control between its bounds, a scalar reaches its bound "
            "without a switch in the table, a path condition becomes active without a break in the table, or the jump"
            " there is not that of one scalar whose switching function crosses zero by more than rounding (at an"
            " instantaneous one it does not)"
        )
    else:
        value, variations = _kappa_with_fixed(forms(1), fixed)
        if KAPPA_LIMIT < value < _DOUBTFUL:
            value, limit = _extrapolate_kappa(lambda finer: _kappa_with_fixed(forms(finer), fixed)[0])
            meaning += "; extrapolated to zero step size, with a limit of 1 less the uncertainty of the extrapolation"
        if np.isnan(value):
            meaning += "; not available: the second variation vanishes for a free parameter or for an impulse at the "
            meaning += "end of a singular arc"
        if not variations:
            meaning += "; the end conditions leave no variation, so that strict switching suffices for a minimum"
    return Check(name=name, level=3, value=value, limit=limit, unit="1", meaning=meaning)


def _kappa_with_fixed(form: QuadraticForm, fixed: Sequence[int]) -> tuple[float, int]:
    """Return `destabilising_eigenvalue` of a form with some of its parameters fixed."""
    without = np.delete(np.delete(form.form, fixed, axis=0), fixed, axis=1)
    return destabilising_eigenvalue(without, np.delete(form.constraints, fixed, axis=1), form.m - len(fixed))


def _extrapolate_kappa(kappa_of: Callable[[int], float]) -> tuple[float, float]:
    """Return kappa of steps of no length, and the limit below which it is said to be less than 1.

    Its error falls with the square of the number of steps: Richardson's extrapolation takes that out, and what two of
    these differ by is many times what the better one leaves.
    """
    coarse, middle, fine = (kappa_of(finer) for finer in _LEVELS)
    rough, value = (
        (after * n**2 - before * k**2) / (n**2 - k**2)
        for before, after, k, n in ((coarse, middle, *_LEVELS[:2]), (middle, fine, *_LEVELS[1:]))
    )
    return value, min(1.0 - abs(value - rough), 1.0 - _ROUNDED)


def _has_unsupported_switch(arc: PhaseData) -> bool:
    """Return True if not just a single scalar jumps at a break, or its switching function does not cross zero there."""
    places = [at for at, _ in scalars(arc.phase.controls)]
    jumps = arc.jumps != 0
    alone = bool((jumps.sum(axis=0) <= 1).all()) and not np.delete(jumps, places, axis=0).any()
    switches = jumps.any(axis=0) & ~(singular := Singular.of(arc).junctions)
    smooth = singular & ~jumps.any(axis=0)  # a junction without a jump is no end of an impulse
    bends = [*switch_slopes(arc)[switches], *(end.slope for end in end_switches(arc))]
    return not alone or bool(smooth.any() or (np.array(bends) <= 0.0).any())


def _check_legendre_clebsch(arc: PhaseData, pieces: Sequence[VariationPiece]) -> Check:
    curvature = [np.linalg.eigvalsh(piece.bends) for piece in pieces if piece.bends.shape[1]]
    value = max((-float(c.min() / np.abs(c).max()) for c in curvature), default=-1.0)
    return Check(
        name=f"{arc.prefix}legendre_clebsch", level=3, value=value, limit=CURVATURE_LIMIT, unit="1",
        meaning="minus the smallest second derivative of the Hamiltonian in the control, over its largest: below 0 if"
        " a control that is not on a bound is a strict minimum along the whole arc (-1: there is none)",
    )  # fmt: skip


def _check_kelley(arc: PhaseData, pieces: Sequence[VariationPiece]) -> Iterator[Check]:
    """Check Kelley's condition on singular arcs."""
    own = [piece.kelley for piece in pieces if len(piece.kelley)]
    if own:
        yield Check(
            name=f"{arc.prefix}kelley", level=3, limit=CURVATURE_LIMIT, unit="1",
            value=max(-float(along.min() / np.abs(along).max()) for along in own),
            meaning="minus the smallest curvature of H in the integral of a singular control, over its largest: below "
            "0 where Kelley's condition holds strictly, -d/du d^2(H_u)/dt^2 > 0",
        )  # fmt: skip


def _check_legendre_on_arcs(arc: PhaseData, pieces: Sequence[VariationPiece]) -> Check:
    """Check the Legendre-Clebsch condition in the control's free moves on boundary arcs of conditions on states."""
    if pieces[0].kept.least_multiplier is not None:
        return Check(
            name=f"{arc.prefix}along_sufficient", level=3,
            value=-pieces[0].kept.least_multiplier, limit=CURVATURE_LIMIT, unit="1",
            meaning="minus the least multiplier of the boundary arc over its largest, where H is linear in the"
            " control: below 0 if J rises to first order for flights that leave it briefly",
        )  # fmt: skip
    value, loose = float("nan"), [piece.loosened for piece in pieces]
    if all(piece.regular for piece in loose) and pieces[0].kept.steady:
        curvature = [np.linalg.eigvalsh(piece.H_uu) for piece in loose if piece.sizes[2]]
        value = max((-float(c.min() / np.abs(c).max()) for c in curvature), default=float("nan"))
    return Check(
        name=f"{arc.prefix}along_sufficient", level=3, value=value, limit=CURVATURE_LIMIT, unit="1",
        meaning="minus the smallest second derivative of the Hamiltonian with the multiplier of the boundary arc, in"
        " the controls that may leave it, over the largest: below 0 if J rises to second order for flights that leave"
        " it briefly; not available where it is linear in a control, or where a control reaches a bound or jumps as"
        " the arc begins or ends",
    )  # fmt: skip
