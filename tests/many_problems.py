"""Problems by the thousand: four kinds that are solved in lanes, each with its dispersed parameters and a first guess.

A smooth landing in one phase, an ascent in two stages with a link, a transfer with thrust, coast and brake (two
switches), and the landing again in multiple shooting.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from perilune import Indirect
from perilune.conditions.canonical_equations import extremal_parameters
from perilune.conditions.pontryagin import derive
from perilune.core import Matrix, Scales, Vector
from perilune.problem import (
    Conditions,
    FreeParameter,
    Parameter,
    Phase,
    Problem,
    ScalarControl,
    UnitVectorControl,
    Variable,
)
from perilune.shooting.shooting_function import Shooting
from problems.ascents import TWO_STAGES, staged_launch

RADIUS, MU = 1737.4e3, 4.9028e12  # of the Moon


def landing() -> Problem:
    """Shortest powered descent at constant thrust from 15 km, 1692 m/s to rest on the Moon."""
    descent = Phase(
        name="descent",
        states=tuple(Variable(name=n, unit=u) for n, u in (("r", "m"), ("u", "m/s"), ("v", "m/s"), ("m", "kg"))),
        controls=(UnitVectorControl(names=("transverse", "radial")),),
        dynamics=lambda x, u, p, xp: (
            x.v,
            -x.u * x.v / x.r + p.thrust / x.m * u.transverse,
            x.u * x.u / x.r - p.mu / (x.r * x.r) + p.thrust / x.m * u.radial,
            -p.thrust / p.exhaust_speed,
        ),
        duration="time",
        end=Conditions(
            lambda x, p, xp: (x.r - p.radius, x.u, x.v),
            *tuple(Variable(name=n, unit=u) for n, u in (("ground", "m"), ("along", "m/s"), ("up", "m/s"))),
        ),
        end_guess=lambda p, xp: (p.radius, 0 * p.along, 0 * p.along, 0.7 * p.mass),
    )
    given = {
        "mu": (MU, "m^3/s^2"), "radius": (RADIUS, "m"), "thrust": (440.0, "N"), "exhaust_speed": (3040.0, "m/s"),
        "height": (15e3, "m"), "along": (1692.0, "m/s"), "up": (0.0, "m/s"), "mass": (300.0, "kg"),
    }  # fmt: skip
    return Problem(
        name="landing",
        phases=(descent,),
        start=lambda p, xp: (p.radius + p.height, p.along, p.up, p.mass),
        given={name: Parameter(value=value, unit=unit) for name, (value, unit) in given.items()},
        free=(FreeParameter(name="time", unit="s", lower=0.0, guess=1000.0),),
        objective=lambda x, p, xp: p.time,
        objective_unit="s",
        scales=Scales(length=RADIUS, time=1035.0, mass=300.0),
    )


def transfer() -> Problem:
    """Rest to rest over 1 m in 3 s with the least effort |u|: thrust, coast, brake."""
    phase = Phase(
        name="transfer",
        states=(Variable(name="x", unit="m"), Variable(name="v", unit="m/s"), Variable(name="effort", unit="m/s")),
        controls=tuple(ScalarControl(name=n, unit="m/s^2", lower=0.0, upper=1.0) for n in ("push", "brake")),
        dynamics=lambda x, u, p, xp: (x.v, u.push - u.brake, u.push + u.brake),
        duration="T",
        end=Conditions(lambda x, p, xp: (x.x - p.length, x.v), place="m", speed="m/s"),
        end_guess=lambda p, xp: (p.length, 0 * p.length / p.T, p.length / p.T),
    )
    return Problem(
        name="transfer",
        phases=(phase,),
        start=lambda p, xp: (0.0, 0.0, 0.0),
        given={"length": Parameter(value=1.0, unit="m"), "T": Parameter(value=3.0, unit="s")},
        objective=lambda x, p, xp: x.effort,
        objective_unit="m/s",
    )


@dataclass(frozen=True, kw_only=True)
class Kind:
    """Many problems of one kind.

    Parameters
    ----------
    name
        What they are.
    make
        Returns the nominal problem.
    spread
        Relative half-width of each dispersed given parameter; "height" and such, by name.
    segments
        Arcs of a phase.
    """

    name: str
    make: Callable[[], Problem]
    spread: dict[str, float]
    segments: int = 1

    def batch(self, lanes: int, seed: int = 1) -> tuple[Shooting, Matrix, Matrix]:
        """Shooting function, first guesses (lanes, unknowns): all the nominal answer, and parameters (lanes, np)."""
        problem = self.make()
        nominal = Indirect().run(problem)
        shooting, p = Shooting(derive(problem), self.segments), extremal_parameters(problem)
        assert nominal.unknowns is not None
        guess = shooting.joints(nominal.unknowns, p)
        assert guess is not None
        return shooting, np.tile(guess, (lanes, 1)), self._dispersed(problem, p, lanes, seed)

    def _dispersed(self, problem: Problem, p: Vector, lanes: int, seed: int) -> Matrix:
        """Lane 0 is the nominal problem."""
        many, random = np.tile(p, (lanes, 1)), np.random.default_rng(seed)
        names = list(problem.given)
        for name, width in self.spread.items():
            many[1:, names.index(name)] *= 1 + width * random.uniform(-1, 1, lanes - 1)
        return many


DISPERSED = {"height": 0.33, "along": 0.018, "mass": 0.03}
KINDS = (
    Kind(name="landing, one smooth phase", make=landing, spread=DISPERSED),
    Kind(
        name="ascent, two phases with a link",
        make=partial(staged_launch, TWO_STAGES, 60e3, 1700.0),
        spread={"height": 0.05, "speed": 0.02, "mass_0": 0.01},
    ),
    Kind(name="transfer, bang-bang with two switches", make=transfer, spread={"length": 0.1, "T": 0.1}),
    Kind(name="landing, multiple shooting in four", make=landing, spread=DISPERSED, segments=4),
)
