"""Cases of Peng, Li, Shen, Tang 2012, every one solved: by Pontryagin, by Gauss points, from a genetic search."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from perilune import Genetic, Hybrid, Outcome, PeriluneError, Pseudospectral, Solution, solve
from perilune.core import NUMERIC, Matrix, Vector, Watch
from perilune.methods import ControlFitness
from perilune.models import combine, heading_axes, spherical_coordinates
from perilune_papers.peng2012.case import (
    CASE,
    PRINTED,
    PRINTED_POINTS,
    other_readings,
    peng_descent,
    problem_of_the_paper,
)
from perilune_papers.starts import Starts, run_starts

POINTS = (4, 5, 6, 7, 8, 9, 10, 12, 15, 20, 30, 40, 50, 60, 80)
RANDOM_STARTS = 12  # most; some of them take a minute each, and the genetic search is what the paper is about
AT_FIFTY = Pseudospectral(nodes=PRINTED_POINTS, refine=0)


@dataclass(frozen=True, kw_only=True)
class Convergence:
    """Gauss points on one segment against the indirect method, largest difference at the points.

    Parameters
    ----------
    points
        N.
    flight_time
        Difference [s].
    position, velocity, angle
        [m], [m/s], [deg].
    processor_time
        Of the solution, from no guess [s].
    """

    points: int
    flight_time: float
    position: float
    velocity: float
    angle: float
    processor_time: float


@dataclass(frozen=True, kw_only=True)
class PengReproduction:
    """Everything that was computed for the report.

    Parameters
    ----------
    indirect, fastest
        Cartesian, by Pontryagin, for least propellant (29) and least time (19).
    direct, direct_fastest
        In the paper's coordinates at its 50 points, for the same.
    direct_cartesian
        At 50 points in Cartesian coordinates.
    convergence
        By number of points.
    missed
        Re-integration of `direct`: distance from the site [m] and speed [m/s] at the end.
    genetic, random
        From random values, with and without the genetic search.
    readings
        Other readings of what the paper leaves open, by name.
    fitting_gravity
        Gravitational parameter at which the printed flight time comes out [m^3/s^2].
    """

    indirect: Solution
    fastest: Solution
    direct: Solution
    direct_fastest: Solution
    direct_cartesian: Solution
    convergence: tuple[Convergence, ...]
    missed: tuple[float, float]
    genetic: Starts
    random: Starts
    readings: dict[str, Solution]
    fitting_gravity: float

    @property
    def outcome(self) -> Outcome:
        """Return the outcome of the solution that is proved."""
        return self.proved.outcome

    @property
    def proved(self) -> Solution:
        """The solution that is proved."""
        return self.indirect


def compute_peng(watch: Watch, level: int = 3, seeds: int = 3) -> PengReproduction:
    """Solve every case of the paper.

    Parameters
    ----------
    watch
        Receives lines of text and iterations.
    level
        Verification level to prove of the indirect solution.
    seeds
        Random starts of the genetic search; without it at most `RANDOM_STARTS` of them are tried.
    """
    watch("the indirect method: flight time, fuel, Figs 2-4")
    indirect = solve(peng_descent(), verify=level, callback=watch)
    fastest = solve(peng_descent(minimise="flight_time"), verify=0, callback=watch)
    watch("Gauss points: Figs 2-4, Hamiltonian, convergence")
    direct = AT_FIFTY.run(problem_of_the_paper(), callback=watch)
    converged = tuple(convergence_at(n, indirect, watch) for n in POINTS)
    watch("from random values")
    genetic = run_starts(from_a_population, seeds, watch)
    random = run_starts(from_random_values, min(seeds, RANDOM_STARTS), watch)
    watch("other readings of what the paper leaves open")
    readings = {name: solve(peng_descent(case), verify=0) for name, case in other_readings().items()}
    return PengReproduction(
        indirect=indirect,
        fastest=fastest,
        direct=direct,
        direct_fastest=AT_FIFTY.run(problem_of_the_paper(minimise="flight_time"), callback=watch),
        direct_cartesian=AT_FIFTY.run(peng_descent(), callback=watch),
        convergence=converged,
        missed=missed_by_reintegration(direct),
        genetic=genetic,
        random=random,
        readings=readings,
        fitting_gravity=fitting_gravity(indirect),
    )


def convergence_at(points: int, reference: Solution, watch: Watch) -> Convergence:
    """Solve at N Gauss points from no guess and compare with the indirect method at these points.

    Parameters
    ----------
    points
        Number N of Gauss points, in one segment.
    reference
        Solution of the indirect method.
    watch
        Called with each iteration and with lines of text.
    """
    began = time.process_time()
    # The tolerance that is usual would be the floor before the points are.
    method = Pseudospectral(nodes=points, refine=0, nlp_tolerance=1e-12)
    solution = method.run(problem_of_the_paper(), callback=watch)
    processor_time = time.process_time() - began
    duration = solution.free["flight_time"]
    t = 0.5 * (np.polynomial.legendre.leggauss(points)[0] + 1.0) * duration
    # Beyond its own end the reference has nothing to say; the difference in time is counted apart.
    at = np.minimum(t, reference.trajectories[0].duration)
    state = reference.trajectories[0].state(at)
    ours = np.array([peng_cartesian(x) for x in solution.trajectories[0].state(t)])
    mine, other = solution.outputs(0, t), reference.outputs(0, at)
    angles = [np.abs(mine[name] - other[name]).max() for name in ("thrust_elevation", "thrust_azimuth")]
    return Convergence(
        points=points,
        flight_time=duration - reference.free["flight_time"],
        position=float(np.linalg.norm(ours[:, :3] - state[:, :3], axis=1).max()),
        velocity=float(np.linalg.norm(ours[:, 3:6] - state[:, 3:6], axis=1).max()),
        angle=math.degrees(max(angles)),
        processor_time=processor_time,
    )


def peng_cartesian(x: Vector) -> Vector:
    """Cartesian state of a state in the paper's coordinates, at the paper's heading."""
    r, theta, phi, u, v, w, mass = x
    up, oy, oz = heading_axes(theta, phi, CASE.start.heading, NUMERIC)
    return np.array([*combine((r, up)), *combine((u, oy), (v, oz), (w, up)), mass])


def missed_by_reintegration(direct: Solution) -> tuple[float, float]:
    """Fly the angles of a solution in the paper's coordinates by SciPy's DOP853, in Cartesian coordinates.

    The paper's own (17) cannot be flown from its start: tan(phi) is infinite over the pole.

    Returns
    -------
    tuple
        Distance from the site [m] and speed relative to it [m/s] at the end.
    """
    stated, duration = peng_descent(), direct.free["flight_time"]
    phase, p = stated.phases[0], stated.parameters(direct.free)
    law = direct.trajectories[0].control

    def rates(t: float, x: Matrix) -> Any:
        alpha, beta = law(t)
        _, longitude, latitude = spherical_coordinates(tuple(x[:3]), NUMERIC)
        up, oy, oz = heading_axes(longitude, latitude, p.start_heading, NUMERIC)
        level = math.cos(alpha)
        thrust = combine((math.sin(alpha), up), (level * math.cos(beta), oy), (level * math.sin(beta), oz))
        return phase.rates(x, thrust, p)

    x0 = np.array(stated.start(p, NUMERIC), dtype=float)
    flown = solve_ivp(rates, (0.0, duration), x0, method="DOP853", rtol=1e-12, atol=1e-6)
    if not flown.success:
        raise PeriluneError("the re-integration did not reach the end", got=flown.message)
    end = phase.evaluate("end", list(flown.y[:, -1]), (), p)
    return float(np.linalg.norm(end[:3])), float(np.linalg.norm(end[3:]))


def from_a_population(seed: int) -> float:
    """Flight time [s] as the paper finds it: a genetic search from random values within the bounds, 50 Gauss points."""
    return Hybrid(Genetic(seed=seed, best=1), AT_FIFTY).run(problem_of_the_paper()).free["flight_time"]


def from_random_values(seed: int) -> float:
    """Flight time [s] at 50 points from one random individual: what the genetic search begins with, without it."""
    stated = problem_of_the_paper()
    fitness = ControlFitness(stated)
    share = np.random.default_rng(seed).random(len(fitness.lower))
    guess = fitness.guess(fitness.lower + share * (fitness.upper - fitness.lower))
    return AT_FIFTY.run(stated, guess).free["flight_time"]


def fitting_gravity(indirect: Solution) -> float:
    """Gravitational parameter [m^3/s^2] at which the flight time is the printed one."""
    printed, near = PRINTED["flight time"][0], CASE.body.gravitational_parameter

    def excess(mu: float) -> float:
        changed = indirect.problem.with_given(body_gravitational_parameter=mu)
        return solve(changed, guess=indirect, verify=0).free["flight_time"] - printed

    # Far below the last printed digit of any published value.
    return float(brentq(excess, 0.99 * near, 1.01 * near, xtol=1e-7 * near))  # type: ignore[arg-type]


def peng_numbers(made: PengReproduction) -> dict[str, float]:
    """Our value of every number in `PRINTED`, from the indirect solution."""
    found = made.indirect.results
    return {"flight time": found["flight_time"].value, "fuel": found["propellant"].value}
