"""Physics before solving: what a landing cannot do, and what will make it hard, in the user's words.

Each finding compares a value with a limit. A *binding* one that is missed means that there is no landing;
the others are warnings. The bounds on the landed mass m_f hold for every steering law, as r never falls below
the site's r_s:

- Touchdown from above at rest needs r'' >= 0 there, so T/m_f >= mu/r_s^2 - omega^2 r_s.
- Let w^2 = V^2 + 2 mu (1/r_s - 1/r) with the inertial speed V, so w >= V. Gravity leaves w as it is, and
  thrust acceleration a gives w w' >= -a V >= -a w. Hence the whole ideal velocity change is at least w(start)
  - |omega| r_s, and the rocket equation turns it into mass. An impulsive burn lowers w by at most its size.

An ideal vehicle can burn all of its mass, so nothing above is fatal without a least landed mass. It is
`vehicle_dry_mass` where that is given, and else 10 % of the mass: that much propellant is found in the first
stages of launchers, which do not carry it to another body. Stating the dry mass replaces this judgement by a
fact.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from perilune.models.landing import perilune_speed
from perilune.problem.problem import Problem
from perilune.problem.solution import Solution
from perilune.words.maths import NUMERIC
from perilune.words.outcome import InfeasibleError, PeriluneError

LEAST_LANDED_SHARE = 0.1


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One comparison: ``value <= limit``, or ``value >= limit`` where `at_least`.

    Missing a binding one is fatal.
    """

    name: str
    value: float
    limit: float
    at_least: bool
    unit: str
    binding: bool
    meaning: str
    advice: str = ""

    @property
    def passed(self) -> bool:
        """Whether the value is on the right side of the limit; NaN never is."""
        return bool(self.value >= self.limit if self.at_least else self.value <= self.limit)

    @property
    def verdict(self) -> str:
        """``ok``, ``warning`` or ``impossible``."""
        return "ok" if self.passed else "impossible" if self.binding else "warning"


def preflight(problem: Problem) -> tuple[Finding, ...]:
    """Check a landing before it is solved.

    Parameters
    ----------
    problem
        A landing of `perilune.models.landing`, or a descent of `perilune.models.descent` or `precision`.

    Returns
    -------
    tuple of Finding
        All comparisons; those that did not pass are warnings.

    Raises
    ------
    InfeasibleError
        If a binding comparison is missed.
    """
    found = findings(problem)
    refuse_impossible(found)
    return found


def refuse_impossible(found: Iterable[Finding]) -> None:
    """InfeasibleError for the first binding comparison that is missed."""
    for f in found:
        if f.binding and not f.passed:
            raise InfeasibleError(
                f.meaning,
                got=f"{f.name} {f.value:.6g} {f.unit}",
                expected=f"{'at least' if f.at_least else 'at most'} {f.limit:.6g} {f.unit}",
                advice=f.advice,
            )


def findings(problem: Problem) -> tuple[Finding, ...]:
    """Every comparison, in the order in which they make sense; nothing is raised for a miss."""
    p = problem.parameters({})
    if "orbit_perilune_altitude" not in problem.given:
        if "site_altitude" not in problem.given:
            raise PeriluneError("pre-flight knows landings only", got=problem.name, expected="a landing or descent")
        # What a descent in three dimensions cannot do is refused where its problem is made.
        return (_thrust_against_weight(p, p.site_altitude),)
    where = geometry(p.orbit_perilune_altitude, p.orbit_parking_altitude, p.landing_altitude)
    if not all(f.passed for f in where):
        return where  # the rest would compute with an orbit that is none
    return (*where, *_burns(p), *_warnings(p))


def geometry(perilune: float, parking: float, site: float) -> tuple[Finding, ...]:
    """Comparisons of the three altitudes [m] above the body's radius."""
    # A millimetre stands for "strictly above".
    return (
        Finding(
            name="perilune above the surface",
            value=perilune,
            limit=1e-3,
            at_least=True,
            unit="m",
            binding=True,
            meaning="the perilune lies below the surface: the orbit hits the ground",
            advice="raise orbit.perilune_altitude",
        ),
        Finding(
            name="perilune above the landing site",
            value=perilune - site,
            limit=1e-3,
            at_least=True,
            unit="m",
            binding=True,
            meaning="the perilune lies below the landing site: the orbit hits the ground",
            advice="raise orbit.perilune_altitude or lower landing.altitude",
        ),
        Finding(
            name="perilune below the parking orbit",
            value=parking - perilune,
            limit=0.0,
            at_least=True,
            unit="m",
            binding=True,
            meaning="the perilune lies above the parking orbit",
            advice="exchange the two, or look for km in place of m",
        ),
    )


def _burns(p: Any) -> tuple[Finding, ...]:
    """Comparisons of velocity changes and masses, all binding."""
    speed = perilune_speed(p, NUMERIC)
    retro = getattr(p, "retro_delta_v", None)
    dry_mass = getattr(p, "vehicle_dry_mass", None)
    least = LEAST_LANDED_SHARE * p.vehicle_mass if dry_mass is None else dry_mass
    said = "vehicle.dry_mass" if dry_mass is not None else f"{LEAST_LANDED_SHARE:.0%} of vehicle.mass"
    found = []
    if retro is not None:
        found.append(
            Finding(
                name="retro.delta_v",
                value=retro,
                limit=speed,
                at_least=False,
                unit="m/s",
                binding=True,
                meaning="the retro burn exceeds the speed at the perilune: the lander would fly backwards",
                advice="lower retro.delta_v, or leave it out and the best one is found",
            )
        )
        # Whatever follows, the impulsive burn alone must leave the least mass.
        found.append(
            Finding(
                name="retro.delta_v",
                value=retro,
                at_least=False,
                unit="m/s",
                binding=True,
                limit=p.retro_specific_impulse * p.vehicle_standard_gravity * math.log(p.vehicle_mass / least),
                meaning=f"the retro burn needs more propellant than there is above {said}",
                advice="lower retro.delta_v, or leave it out and the best one is found",
            )
        )
    found.append(
        Finding(
            name="landed mass that the thrust can hold",
            value=_mass_held(p),
            limit=least,
            at_least=True,
            unit="kg",
            binding=True,
            meaning=f"the lander is too weak: its thrust cannot carry {said} at touchdown",
            advice="raise vehicle.thrust, lower vehicle.mass, or state what must land as vehicle.dry_mass",
        )
    )
    found.append(
        Finding(
            name="landed mass by the rocket equation",
            value=_mass_by_rocket_equation(p, speed, retro),
            limit=least,
            at_least=True,
            unit="kg",
            binding=True,
            meaning=f"there is not enough propellant: even an ideal landing leaves less than {said}",
            advice="raise the specific impulse, or state what must land as vehicle.dry_mass",
        )
    )
    return tuple(found)


def _mass_held(p: Any) -> float:
    """Largest mass [kg] that can come to rest on the ground from above."""
    r = p.body_radius + p.landing_altitude
    weight = p.body_gravitational_parameter / r**2 - p.body_rotation_rate**2 * r
    return p.vehicle_thrust / weight if weight > 0 else math.inf


def _mass_by_rocket_equation(p: Any, speed: float, retro: float | None) -> float:
    """Upper bound of the landed mass [kg] from the least ideal velocity change."""
    r_site, r_start = p.body_radius + p.landing_altitude, p.body_radius + p.orbit_perilune_altitude
    fall = 2 * p.body_gravitational_parameter * (1 / r_site - 1 / r_start)
    ground = abs(p.body_rotation_rate) * r_site
    main, impulsive = (
        isp * p.vehicle_standard_gravity for isp in (p.vehicle_specific_impulse, p.retro_specific_impulse)
    )
    if retro is None:
        return p.vehicle_mass * math.exp(-max(math.sqrt(speed**2 + fall) - ground, 0.0) / max(main, impulsive))
    rest = max(math.sqrt((speed - retro) ** 2 + fall) - ground, 0.0)
    return p.vehicle_mass * math.exp(-retro / impulsive - rest / main)


def _warnings(p: Any) -> tuple[Finding, ...]:
    """Comparisons that make a landing hard or look like a slip, none binding."""
    r = p.body_radius + p.landing_altitude
    gravity = p.body_gravitational_parameter / r**2
    speed, ground = perilune_speed(p, NUMERIC), abs(p.body_rotation_rate) * r
    return (
        _thrust_against_weight(p, p.landing_altitude),
        Finding(
            name="braking distance without gravity",
            value=_braking_distance(p, speed) / 1e3,
            limit=math.pi * p.body_radius / 1e3,
            at_least=False,
            unit="km",
            binding=False,
            meaning="braking takes more than half a revolution: expect a long spiral that is hard to solve",
            advice="raise vehicle.thrust",
        ),
        Finding(
            name="speed of the ground",
            value=ground,
            limit=0.1 * math.sqrt(gravity * r),
            at_least=False,
            unit="m/s",
            binding=False,
            meaning="the ground moves at more than a tenth of orbital speed",
            advice="check that body.rotation_rate is in rad/s and not in deg/s",
        ),
        Finding(
            name="perilune altitude",
            value=p.orbit_perilune_altitude / 1e3,
            limit=0.2 * p.body_radius / 1e3,
            at_least=False,
            unit="km",
            binding=False,
            meaning="the perilune is very high for a landing",
            advice="altitudes are above the surface, not distances from the centre",
        ),
    )


def _thrust_against_weight(p: Any, altitude: float) -> Finding:
    """Whether the lander could hover when it ignites, with the weight at an altitude [m]."""
    gravity = p.body_gravitational_parameter / (p.body_radius + altitude) ** 2
    return Finding(
        name="thrust against weight at ignition",
        value=p.vehicle_thrust / (p.vehicle_mass * gravity),
        limit=1.0,
        at_least=True,
        unit="1",
        binding=False,
        meaning="the lander cannot hover when it ignites: it must brake while its speed still carries it",
    )


def _braking_distance(p: Any, speed: float) -> float:
    """Distance [m] to stop from `speed` by thrust alone in free space: V tau - c t_b, tau = M c/T."""
    exhaust = p.vehicle_specific_impulse * p.vehicle_standard_gravity
    tau = p.vehicle_mass * exhaust / p.vehicle_thrust
    return speed * tau + exhaust * tau * math.expm1(-speed / exhaust)


def check_propellant(solution: Solution) -> None:
    """InfeasibleError if a solved landing leaves less than the dry mass.

    Nothing where no dry mass is given.
    """
    dry_mass = getattr(solution.parameters, "vehicle_dry_mass", None)
    landed = float(solution.trajectories[-1].state.values[-1][solution.problem.phases[-1].state_names.index("m")])
    if dry_mass is not None and landed < dry_mass:
        raise InfeasibleError(
            "there is not enough propellant: the best landing found burns more than the lander carries",
            got=f"landed mass {landed:.6g} kg, {dry_mass - landed:.3g} kg short",
            expected=f"at least vehicle.dry_mass, {dry_mass:.6g} kg",
            advice="raise the specific impulse or the thrust, or take more propellant",
        )
