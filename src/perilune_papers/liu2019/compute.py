"""Computations on Liu, Liu, Wu 2019 for the report: why its example cannot be flown, and its neighbours solved."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from perilune import Outcome, PeriluneError, Solution, opposite, preflight, solve
from perilune.core import NUMERIC, Matrix, Vector, Watch
from perilune.models import angles_of_place, cross_product, local_axes, plane_axes, scalar_product
from perilune_papers.liu2019.case import (
    CASE,
    PRINTED_SITE,
    as_printed,
    dimensionless_constants,
    fixed_sweep,
    paper_state,
    paper_units,
    site_fixed,
    site_free,
)
from perilune_papers.liu2019.equations import Comparison, compare, corrected_rates, costate_matrix
from perilune_papers.liu2019.fast import Fast, time_fast_methods
from perilune_papers.liu2019.members import ManoeuvreMember, solve_members
from perilune_papers.liu2019.printed import TABLE_2, TABLES_1_AND_3, GridPoint
from perilune_papers.liu2019.searches import Searches, run_searches
from perilune_papers.paper import worst_solution

PASSES = ("descending", "ascending")


@dataclass(frozen=True, kw_only=True)
class PrintedFlight:
    """The printed costates of every grid point, flown for the printed time.

    `direction` says whether the thrust is that of (9) or the one that minimises H. Of each point at the printed t_a:
    altitude [km], speed [km/s], path angle [deg], and the costates that (12) wants to be 0.
    """

    direction: str
    altitude: Vector
    speed: Vector
    angle: Vector
    lambda_course: Vector
    lambda_mass: Vector


@dataclass(frozen=True, kw_only=True)
class OffPlane:
    """The printed site from one grid point.

    `away`, for each pass, is its angle [rad] from the plane of the orbit when the vehicle would land, and `reach` what
    all thrust sideways moves the vehicle by until then.
    """

    away: dict[str, Vector]
    reach: Vector


@dataclass(frozen=True, kw_only=True)
class LiuReproduction:
    """Everything that was computed for the report.

    Parameters
    ----------
    refusals
        For each pass, what is said of the printed example before it is solved.
    site_free
        Neighbour A, for each pass.
    site_fixed, slowest
        Neighbour B, and the longest flight between its ends.
    grid, experiments
        B at the manoeuvre points of Table 2, and of Tables 1 and 3.
    searches
        The paper's hybrid method, and ours, from `CASE.place`.
    fast
        The paper's fast method on B, and ours.
    """

    equations: Comparison
    off_plane: OffPlane
    refusals: dict[str, str]
    flown: tuple[PrintedFlight, ...]
    site_free: dict[str, Solution]
    site_fixed: Solution
    slowest: Solution
    grid: tuple[ManoeuvreMember, ...]
    experiments: tuple[ManoeuvreMember, ...]
    searches: Searches
    fast: Fast

    @property
    def outcome(self) -> Outcome:
        """Return the outcome of the flight with the worst proof."""
        return self.proved.outcome

    @property
    def proved(self) -> Solution:
        """Return the flight with the worst proof."""
        return worst_solution(self.site_fixed, self.slowest, *self.site_free.values())


def compute_liu(watch: Watch, level: int = 3, seeds: int = 5) -> LiuReproduction:
    """Compute everything.

    Parameters
    ----------
    watch
        Receives lines of text and iterations.
    level
        Verification level to prove of the neighbours from `CASE.place`; the other manoeuvre points are solved only.
    seeds
        Tries of the paper's hybrid method, and of its fast one.
    """
    watch("the paper's hybrid method, and ours")
    searches = run_searches(seeds, watch)
    watch("the printed equations")
    equations = compare()
    watch("the printed example")
    refusals = {going: printed_refusal(going) for going in PASSES}
    flown = (fly_printed(1.0), fly_printed(-1.0))
    watch("neighbour A: the site free")
    free = {going: solve(site_free(going), verify=level, callback=watch) for going in PASSES}
    watch("neighbour B: a site in the plane")
    fixed = solve(site_fixed(), verify=level, callback=watch)
    slowest = solve(opposite(fixed_sweep()), verify=level, callback=watch)
    watch("neighbour B from the points of Table 2")
    grid = solve_members(fixed, [(row.longitude, row.latitude) for row in TABLE_2], watch)
    watch("neighbour B from the points of Table 1")
    experiments = solve_members(fixed, [(row.longitude, row.latitude) for row in TABLES_1_AND_3], watch)
    with tempfile.TemporaryDirectory() as directory:
        asked = time_fast_methods(fixed.problem, grid, experiments, seeds, Path(directory) / "region", watch)
    return LiuReproduction(
        equations=equations,
        off_plane=compare_off_plane(fixed.results["entry_time"].value),
        refusals=refusals,
        flown=flown,
        site_free=free,
        site_fixed=fixed,
        slowest=slowest,
        grid=grid,
        experiments=experiments,
        searches=searches,
        fast=asked,
    )


# -- the printed example --------------------------------------------------------------------------------------------


def mass_after(burn_time: float) -> float:
    """Mass [kg] that full thrust leaves after a time [s]."""
    return CASE.mass - burn_time * CASE.thrust / CASE.exhaust_velocity


def burn_until(mass: float) -> float:
    """Time [s] after which full thrust leaves a mass [kg]."""
    return (CASE.mass - mass) * CASE.exhaust_velocity / CASE.thrust


def printed_refusal(going: str) -> str:
    """Return why physics excludes the printed example, with all the propellant that the longest printed t_a burns."""
    findings = preflight(as_printed(going, mass_after(max(row.time for row in TABLE_2))))
    return "; ".join(
        f"{f.name}: {f.value:.1f} {f.unit}, at most {f.limit:.1f} {f.unit}; {f.meaning}"
        for f in findings if f.verdict == "impossible"
    )  # fmt: skip


def compare_off_plane(entry_time: float) -> OffPlane:
    """Return the angle from the printed site to the plane of the orbit when each grid point's vehicle would land.

    Parameters
    ----------
    entry_time
        Time from the interface to the end [s], which is ours: the paper does not print it.
    """
    away = {
        going: np.array([
            away_from_plane(row.longitude, row.latitude, going, np.array([row.time + entry_time]))[0] for row in TABLE_2
        ])
        for going in PASSES
    }  # fmt: skip
    return OffPlane(away=away, reach=np.array([sideways_reach(row.time, row.time + entry_time) for row in TABLE_2]))


def away_from_plane(longitude: float, latitude: float, going: str, at: Vector) -> Vector:
    """Angle [rad] of the printed site from the plane of the orbit through a manoeuvre point [deg], at times [s].

    Parameters
    ----------
    longitude, latitude
        Manoeuvre point [deg].
    going
        Sense in which the orbit crosses its latitude, "ascending" or "descending".
    at
        Times from the manoeuvre, shape (n,) [s].
    """
    p = SimpleNamespace(
        body_radius=CASE.earth.radius, orbit_inclination=CASE.orbit.inclination,
        manoeuvre_longitude=math.radians(longitude), manoeuvre_latitude=math.radians(latitude),
    )  # fmt: skip
    angle, node = angles_of_place(going)(p, NUMERIC)
    up, ahead = plane_axes(angle, node, p, NUMERIC)
    turned = PRINTED_SITE + CASE.earth.rotation_rate * at
    site, _, _ = local_axes(turned, CASE.site_latitude, NUMERIC)
    return np.abs(np.arcsin(scalar_product(site, cross_product(up, ahead))))


def sideways_reach(burn_time: float, at: float) -> float:
    """Angle [rad] by which full thrust across the plane moves the vehicle out of it, at a time [s], to first order.

    Out of the plane z'' + n^2 z = T/m, so that thrust whose sense changes with that of sin n(at - t) gives
    z/r = 1/V times the integral of T/m |sin n(at - t)|.

    Parameters
    ----------
    burn_time
        Longest time that the engine can burn [s].
    at
        Time from the beginning of the burn [s].
    """
    radius = CASE.orbit.radius or CASE.earth.radius
    speed = math.sqrt(CASE.earth.gravitational_parameter / radius)
    t = np.linspace(0.0, min(burn_time, at), 4001)
    push = CASE.thrust / (CASE.mass - t * CASE.thrust / CASE.exhaust_velocity)
    return float(np.trapezoid(push * np.abs(np.sin(speed / radius * (at - t))), t)) / speed


def fly_printed(sign: float) -> PrintedFlight:
    """Fly the printed costates by the right equations; `sign` is 1 for the thrust of (9), -1 for the opposite one.

    lambda_Phi is not printed; H(t0) = -1 gives it, as the paper says.
    """
    unit = paper_units()
    x, costates = _printed_start(sign)
    y = propagate_extremals(x, costates, np.array([row.time for row in TABLE_2]) / unit.time, sign)
    return PrintedFlight(
        direction="as (9)" if sign > 0 else "opposite to (9)",
        altitude=(y[3] - 1) * unit.length / 1e3,
        speed=y[0] * unit.speed / 1e3,
        angle=np.degrees(y[1]),
        lambda_course=y[9],
        lambda_mass=y[13],
    )


def propagate_extremals(x: Matrix, costates: Matrix, times: Vector, sign: float) -> Matrix:
    """States and costates, shape (14, n), after times, all dimensionless; from states and costates, (7, n) each.

    Parameters
    ----------
    x, costates
        States and costates at the start, shape (7, n) each.
    times
        Durations, shape (n,).
    sign
        1.0 for thrust along the costates of the velocity, -1.0 for thrust opposite to them.

    Raises
    ------
    PeriluneError
        If the integrator does not reach the end.
    """
    size = x.shape[1]

    def rates(share: float, y: Vector) -> Vector:
        return (_extremal_rates(y.reshape(14, size), sign) * times).ravel()

    begin = np.concatenate([x, costates]).ravel()
    flown = solve_ivp(rates, (0.0, 1.0), begin, method="DOP853", rtol=1e-9, atol=1e-9)
    if not flown.success:
        raise PeriluneError("costates could not be flown to the end", got=flown.message)
    return flown.y[:, -1].reshape(14, size)


def _printed_start(sign: float) -> tuple[Matrix, Matrix]:
    """States and costates of the grid points at ignition, shape (7, n) each."""
    x = np.array([manoeuvre_state(row) for row in TABLE_2]).T
    known = np.array([
        [r.lambda_speed, r.lambda_angle, r.lambda_course, r.lambda_distance, r.lambda_longitude, 0.0, r.lambda_mass]
        for r in TABLE_2
    ]).T  # fmt: skip
    f = np.array(corrected_rates(x, *thrust_angles(x, known, sign)))
    known[5] = (-1.0 - (known * f).sum(axis=0)) / f[5]
    return x, known


@cache  # flown from under either sign, and looked at again by each report
def manoeuvre_state(row: GridPoint) -> Vector:
    """State in the paper's coordinates and units at a grid point, on the descending pass."""
    stated = site_free("descending").with_given(
        manoeuvre_longitude=math.radians(row.longitude), manoeuvre_latitude=math.radians(row.latitude)
    )
    p = SimpleNamespace(**{name: given.value for name, given in stated.given.items()})
    return paper_state(np.array(stated.start(p, NUMERIC), dtype=float))


def thrust_angles(x: Any, costates: Any, sign: float) -> tuple[Any, Any]:
    """Angles of a thrust along (lambda_V, lambda_gamma/V, lambda_psi/(V cos gamma)), or opposite to it.

    Parameters
    ----------
    x, costates
        States and costates, shape (7, n) each, dimensionless.
    sign
        1.0 for thrust along the vector, -1.0 for thrust opposite to it.

    Returns
    -------
    alpha, beta
        Elevation and azimuth from the velocity, shape (n,) [rad].
    """
    forward, upward, left = along_thrust(x, costates)
    level = np.hypot(forward, left)
    return np.arctan2(sign * upward, level), np.arctan2(sign * left, sign * forward)


def along_thrust(x: Any, costates: Any) -> tuple[Any, Any, Any]:
    """Return what a thrust along each of the path's axes adds to H, per acceleration.

    Parameters
    ----------
    x, costates
        States and costates, shape (7, n) each, dimensionless.
    """
    return costates[0], costates[1] / x[0], costates[2] / (x[0] * np.cos(x[1]))


def _extremal_rates(y: Matrix, sign: float) -> Matrix:
    x, costates = y[:7], y[7:]
    angles = thrust_angles(x, costates, sign)
    matrix = costate_matrix(corrected_rates, x, *angles)
    return np.concatenate([np.array(corrected_rates(x, *angles)), np.einsum("ijn,jn->in", matrix, costates)])


def hamiltonian_by_thrust() -> Vector:
    """Return how much H at t0 falls at every grid point with the thrust opposite to (9), paper's units."""
    x, costates = _printed_start(1.0)
    return 2 * dimensionless_constants().thrust / x[6] * np.linalg.norm(np.array(along_thrust(x, costates)), axis=0)
