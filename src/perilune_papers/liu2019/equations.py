"""Equations (1), (6), (7) of the paper as printed, compared with those of mechanics and differentiation.

Everything is dimensionless, as in the paper: x = (V, gamma, psi, r, Theta, Phi, m), costates in the same order. Where
the text that the paper survives in has lost the layout of a fraction, the right reading is taken. Two judges decide:

* (1): Newton's law in Cartesian coordinates relative to the turning Earth, carried into the paper's coordinates by the
  derivatives of these coordinates. `perilune_papers.liu2019.flight_path.flight_path_rates` passes; the printed
  right-hand sides do not.
* (6): lambda' = -(df/dx)^T lambda, the derivatives by complex steps; of the printed f, and of the right one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from perilune.core import NUMERIC, Matrix, Stack, Vector
from perilune.models import AXIS, combine, free_acceleration
from perilune_papers.liu2019.case import STEP, dimensionless_constants, paper_units
from perilune_papers.liu2019.flight_path import (
    FlightPath,
    flight_path_rates,
    gravity_components,
    path_axes,
    to_cartesian,
)

NAMES = ("V", "γ", "ψ", "r", "Θ", "Φ", "m")
SAMPLES = 200
_SAME = 1e-9  # relative: far above rounding, far below any slip
_NEGLIGIBLE = 1e-13  # of a coefficient that is there

Rates = Callable[[Any, Any, Any], Any]  # (x, alpha, beta): seven rates


@dataclass(frozen=True, kw_only=True)
class Slip:
    """A term of (1): largest difference of the printed one over the sampled states, in `unit`."""

    row: str
    printed: str
    right: str
    size: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class Coefficient:
    """A coefficient of (6) that is wrong: of which costate in which row, and by how much, relative to the right one.

    `own` is the difference from the derivative of the printed (1), `right` from that of the corrected one; infinite
    where the right coefficient is 0.
    """

    row: str
    costate: str
    own: float
    right: float


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Printed equations compared with the right ones at the sampled states.

    Parameters
    ----------
    off
        Largest difference from Newton's law of V', gamma', psi', printed and corrected; dimensionless.
    slips
        Of (1), which together are all of the difference: `unexplained` is what they leave.
    gravity
        Printed derivative of (7) over the right one: g_rr, g_Fr, g_rF, g_FF.
    coefficients
        Of (6).
    """

    off: dict[str, tuple[float, float]]
    slips: tuple[Slip, ...]
    unexplained: float
    gravity: dict[str, float]
    coefficients: tuple[Coefficient, ...]


def compare(samples: int = SAMPLES, seed: int = 0) -> Comparison:
    """Compare at states of a transition, with any course and any thrust direction.

    Parameters
    ----------
    samples
        Number of states.
    seed
        Seed of the random states and directions.
    """
    x, alpha, beta = _sample_states(samples, seed)
    newton = _by_newton(x, alpha, beta)
    printed, right = np.array(printed_rates(x, alpha, beta)), np.array(corrected_rates(x, alpha, beta))
    off = {
        NAMES[i]: (float(np.abs(printed[i] - newton[i]).max()), float(np.abs(right[i] - newton[i]).max()))
        for i in range(3)
    }
    terms = _printed_slips(x)
    explained = sum(difference for *_, difference in terms)
    unit = paper_units()
    size = {"V": (unit.gravity, "m/s²"), "γ": (math.degrees(1 / unit.time), "°/s")}
    slips = tuple(
        Slip(
            row=f"{name}'", printed=text, right=correct,
            size=float(np.abs(difference).max()) * size.get(name, size["γ"])[0], unit=size.get(name, size["γ"])[1],
        )
        for name, text, correct, difference in terms
    )  # fmt: skip
    return Comparison(
        off=off, slips=slips, unexplained=float(np.abs(printed - right - explained).max()), gravity=_gravity_ratios(x),
        coefficients=_wrong_coefficients(x, alpha, beta),
    )  # fmt: skip


def _sample_states(samples: int, seed: int) -> tuple[Matrix, Vector, Vector]:
    """States (7, n) and angles of the thrust."""
    rng = np.random.default_rng(seed)
    ranges = ((0.9, 1.1), (-0.2, 0.2), (-3.0, 3.0), (1.02, 1.1), (-3.0, 3.0), (-0.87, 0.87), (0.7, 1.0))
    x = np.array([rng.uniform(*bounds, samples) for bounds in ranges])
    return x, rng.uniform(-1.0, 1.0, samples), rng.uniform(-3.0, 3.0, samples)


def _flight_path_of(x: Any) -> FlightPath:
    return FlightPath(speed=x[0], angle=x[1], course=x[2], distance=x[3], longitude=x[4], latitude=x[5])


# -- right-hand sides -----------------------------------------------------------------------------------------------


def corrected_rates(x: Any, alpha: Any, beta: Any) -> tuple[Any, ...]:
    """(1) as it should be, with m'.

    Parameters
    ----------
    x
        States (V, gamma, psi, r, Theta, Phi, m), shape (7, n), dimensionless.
    alpha, beta
        Elevation and azimuth of the thrust from the velocity, shape (n,) [rad].
    """
    c = dimensionless_constants()
    push = c.thrust / x[6]
    pushed = (
        push * np.cos(alpha) * np.cos(beta), push * np.sin(alpha), push * np.cos(alpha) * np.sin(beta)
    )  # fmt: skip
    return *flight_path_rates(_flight_path_of(x), pushed, c, NUMERIC), np.full_like(x[6], -c.thrust / c.exhaust)


def printed_rates(x: Any, alpha: Any, beta: Any) -> tuple[Any, ...]:
    """(1) as printed, with g_Phi where it prints g_theta, which it does not define.

    Parameters
    ----------
    x
        States (V, gamma, psi, r, Theta, Phi, m), shape (7, n), dimensionless.
    alpha, beta
        Elevation and azimuth of the thrust from the velocity, shape (n,) [rad].
    """
    c = dimensionless_constants()
    V, _, _, r, _, _, m = x
    sg, cg, sc, cc, sF, cF = _trigonometry(x)
    gr, gF = gravity_components(r, x[5], c, NUMERIC)
    w, T = c.body_rotation_rate, c.thrust
    sa, ca, sb, cb = np.sin(alpha), np.cos(alpha), np.sin(beta), np.cos(beta)
    return (
        T * ca * cb / m - gr * sg - gF * cg * sc + w * w * r * cF * (sg * cF - cg * sF * cc),
        T * sa / (m * V) + V * cg / r - gr * cg / V + gF * sg * sc / V + 2 * w * cF * sc
        + w * w * r * cF / V * (cg * cF - sg * sF * cc),
        T * ca * sb / (m * V * cg) - V * cg * cc * sF / cF / r - gF * cc / (V * cg)
        - 2 * w * (cF * cc * sg / cg - sF) + w * w * r / (V * cg) * sc * sF * cF,
        V * sg,
        V * cg * cc / (r * cF),
        V * cg * sc / r,
        np.full_like(m, -T / c.exhaust),
    )  # fmt: skip


def _trigonometry(x: Any) -> tuple[Any, ...]:
    """Sines and cosines of gamma, psi, Phi."""
    return tuple(f(x[i]) for i in (1, 2, 5) for f in (np.sin, np.cos))


def _printed_slips(x: Matrix) -> list[tuple[str, str, str, Stack]]:
    """Row, printed term, right term, and their difference in all seven rows, shape (7, n)."""
    c, (V, _, _, r, *_) = dimensionless_constants(), x
    sg, cg, sc, cc, sF, cF = _trigonometry(x)
    w = c.body_rotation_rate
    tg = sg / cg
    found = (
        (0, "-cos γ sin Φ cos ψ", "-cos γ sin Φ sin ψ, in the term of ω²", w * w * r * cF * cg * sF * (sc - cc)),
        (1, "2ω cos Φ sin ψ", "2ω cos Φ cos ψ", 2 * w * cF * (sc - cc)),
        (1, "-sin γ sin Φ cos ψ", "+sin γ sin Φ sin ψ, in the term of ω²", -w * w * r * cF / V * sg * sF * (cc + sc)),
        (2, "-2ω (cos Φ cos ψ tan γ - sin Φ)", "+2ω (cos Φ sin ψ tan γ - sin Φ)",
         -2 * w * (cF * cc * tg - sF) - 2 * w * (cF * sc * tg - sF)),
        (2, "+ω² r sin ψ sin Φ cos Φ/(V cos γ)", "-ω² r cos ψ sin Φ cos Φ/(V cos γ)",
         w * w * r / (V * cg) * (sc + cc) * sF * cF),
    )  # fmt: skip
    rows = []
    for row, printed, right, difference in found:
        whole = np.zeros_like(x)
        whole[row] = difference
        rows.append((NAMES[row], printed, right, whole))
    return rows


def _by_newton(x: Matrix, alpha: Vector, beta: Vector) -> Matrix:
    """Rates of the six coordinates, shape (6, n), by way of Cartesian ones."""
    c, path = dimensionless_constants(), _flight_path_of(x)
    position, velocity = to_cartesian(path, NUMERIC)
    forward, upward, leftward = path_axes(path, NUMERIC)
    push = c.thrust / x[6]
    acceleration = combine(
        (1, free_acceleration(position, velocity, AXIS, c, NUMERIC)),
        (push * np.cos(alpha) * np.cos(beta), forward), (push * np.sin(alpha), upward),
        (push * np.cos(alpha) * np.sin(beta), leftward),
    )  # fmt: skip

    def placed(shifted: Any) -> Any:
        r, v = to_cartesian(_flight_path_of(shifted), NUMERIC)
        return np.array([np.broadcast_to(value, x[0].shape) for value in (*r, *v)])

    slopes = np.array([np.imag(placed(_complex_step(x, i))) / STEP for i in range(6)])  # (coordinate, Cartesian, n)
    known = np.array([np.broadcast_to(value, x[0].shape) for value in (*velocity, *acceleration)])
    return np.linalg.solve(slopes.transpose(2, 1, 0), known.T[:, :, None])[:, :, 0].T


def _complex_step(x: Any, i: int) -> Any:
    """The states with a complex step along one coordinate."""
    shifted = np.array(x, dtype=complex)
    shifted[i] += 1j * STEP
    return shifted


# -- derivatives ----------------------------------------------------------------------------------------------------


def costate_matrix(of: Rates, x: Any, alpha: Any, beta: Any) -> Any:
    """Coefficients -df_j/dx_i of lambda_j in lambda_i', shape (7, 7, n).

    Parameters
    ----------
    of
        Right-hand sides, ``of(x, alpha, beta)``, complex-safe.
    x
        States, shape (7, n), dimensionless.
    alpha, beta
        Elevation and azimuth of the thrust from the velocity, shape (n,) [rad].
    """
    return np.array([-np.imag(of(_complex_step(x, i), alpha, beta)) / STEP for i in range(7)])


def _printed_gravity(r: Any, latitude: Any) -> tuple[Any, Any, Any, Any]:
    """g_rr, g_Fr, g_rF, g_FF of (7): derivatives with respect to r and Phi."""
    c = dimensionless_constants()
    gr, _ = gravity_components(r, latitude, c, NUMERIC)
    J2, sF = c.body_j2, np.sin(latitude)
    twice, cosine = np.sin(2 * latitude), np.cos(2 * latitude)
    return (
        -2 * gr / r + 3 * J2 / r**5 * (3 * sF * sF - 1),
        -6 * J2 * twice / r**5,
        6 * J2 * twice / (2 * r**4),
        3 * J2 * cosine / r**4,
    )


def _gravity_ratios(x: Matrix) -> dict[str, float]:
    """Printed over right derivative, where it is largest."""
    c = dimensionless_constants()
    slopes = []
    for i in (3, 5):
        shifted = _complex_step(x, i)
        slopes.append([g.imag / STEP for g in gravity_components(shifted[3], shifted[5], c, NUMERIC)])
    right = (slopes[0][0], slopes[0][1], slopes[1][0], slopes[1][1])
    names = ("∂g_r/∂r", "∂g_Φ/∂r", "∂g_r/∂Φ", "∂g_Φ/∂Φ")
    found = {}
    for name, mine, theirs in zip(names, right, _printed_gravity(x[3], x[5]), strict=True):
        k = int(np.argmax(np.abs(mine)))
        found[name] = float(theirs[k] / mine[k])
    return found


def printed_costate_matrix(x: Any, alpha: Any, beta: Any) -> Any:
    """Coefficients of (6) as printed, shape (7, 7, n); g_Phi's derivatives as in (7).

    Parameters
    ----------
    x
        States, shape (7, n), dimensionless.
    alpha, beta
        Elevation and azimuth of the thrust from the velocity, shape (n,) [rad].
    """
    c, (V, _, _, r, _, _, m) = dimensionless_constants(), x
    sg, cg, sc, cc, sF, cF = _trigonometry(x)
    gr, gF = gravity_components(r, x[5], c, NUMERIC)
    grr, gFr, grF, gFF = _printed_gravity(r, x[5])
    w, T = c.body_rotation_rate, c.thrust
    sa, ca, sb, cb = np.sin(alpha), np.cos(alpha), np.sin(beta), np.cos(beta)
    tF, tg, w2r = sF / cF, sg / cg, w * w * r
    inner, other = cg * cF - sg * sF * cc, sg * cF - cg * sF * cc  # the brackets of (1)
    found: dict[tuple[str, str], Any] = {
        ("V", "γ"): gF * sg * sc / V**2 - (1 / r + gr / V**2) * cg + w2r * cF / V**2 * inner + T * sa / (m * V**2),
        ("V", "Θ"): -cg * cc / (r * cF),
        ("V", "r"): -sg,
        ("V", "Φ"): -cg * sc / r,
        ("V", "ψ"): T * ca * sb / (m * V**2 * cg) + cg * cc * tF / r - gF * cc / (V**2 * cg)
        + w2r / (V**2 * cg) * sc * sF * cF,
        ("γ", "V"): gr * cg - gF * sg * sc - w2r * cF * (cg * cF + sg * sF * cc),
        ("γ", "γ"): V * sg / r - (gr * sg + gF * cg * sc) / V + w2r * cF / V * (sg * cF + cg * sF * cc),
        ("γ", "Θ"): V * sg * cc / (r * cF),
        ("γ", "Φ"): V * sg * sc / r,
        ("γ", "ψ"): -(
            T * ca * sb * tg / (m * V * cg) + V * sg * cc * tF / r - gF * tg * cc / (V * cg) - 2 * w * cF * cc / cg**2
            + w2r * tg / (V * cg) * sc * sF * cF
        ),
        ("γ", "r"): -V * cg,
        ("ψ", "V"): gF * cg * cc - w2r * cF * sg * sF * cc,
        ("ψ", "Θ"): V * cg * sc / (r * cF),
        ("ψ", "γ"): -(gF * sg * cc / V + 2 * w * cF * cc + w2r * cF / V * sg * sF * sc),
        ("ψ", "Φ"): -V * cg * cc / r,
        ("ψ", "ψ"): -(
            V * cg * sc * tF / r + gF * sc / (V * cg) + 2 * w * cF * sc * tg + w2r / (V * cg) * cc * sF * cF
        ),
        ("r", "V"): -(grr * sg + gFr * cg * sc + w * w * cF * other),
        ("r", "γ"): -(grr * cg / V - gFr * sg * sc / V + w * w * cF / V * inner),
        ("r", "Θ"): V * cg * sc / (r**2 * cF),
        ("r", "Φ"): V * cg * cc / r**2,
        ("r", "ψ"): -(V * sg * cc * tF / r**2 + gFr * cc / (V * cg) + w * w / (V * cg) * sc * sF * cF),
        ("Φ", "V"): -(grF * sg + gFF * cg * sc - w2r * sF * other - w2r * cF * (sg * sF + cg * cF * cc)),
        ("Φ", "γ"): -(
            (grF * cg - gFF * sg * sc) / V + 2 * w * sF * sc - w2r * sF / V * inner
            - w2r * cF / V * (cg * sF + sg * cF * cc)
        ),
        ("Φ", "ψ"): V * cg * cc / (r * cF**2) - gFF * cc / (V * cg) - 2 * w * (sF * cc * tg - cF)
        + w2r / (V * cg) * sc * (sF**2 - cF**2),
        ("Φ", "Θ"): -V * cg * cc * tF / (r * cF),
        ("m", "V"): T / m**2 * ca * cb,
        ("m", "γ"): T / m**2 * sa / V,
        ("m", "ψ"): T / m**2 * ca * sb / (V * cg),
    }  # fmt: skip
    whole = np.zeros((7, 7, *np.shape(V)))
    for (row, costate), value in found.items():
        whole[NAMES.index(row), NAMES.index(costate)] = value
    return whole


def _wrong_coefficients(x: Matrix, alpha: Vector, beta: Vector) -> tuple[Coefficient, ...]:
    """Return the coefficients of (6) that no differentiation of the right (1) gives."""
    printed = printed_costate_matrix(x, alpha, beta)
    own, right = (costate_matrix(of, x, alpha, beta) for of in (printed_rates, corrected_rates))
    found = []
    for i, row in enumerate(NAMES):
        for j, name in enumerate(NAMES):
            away = [_largest_relative_difference(printed[i, j], of[i, j]) for of in (own, right)]
            if max(away) > _SAME:
                found.append(Coefficient(row=f"λ_{row}'", costate=f"λ_{name}", own=away[0], right=away[1]))
    return tuple(found)


def _largest_relative_difference(printed: Vector, right: Vector) -> float:
    """Largest difference over the largest right value."""
    difference, size = float(np.abs(printed - right).max()), float(np.abs(right).max())
    if difference <= _NEGLIGIBLE:
        return 0.0
    return difference / size if size > _NEGLIGIBLE else math.inf
