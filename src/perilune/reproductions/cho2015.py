"""Cho, Kim, Leeghim 2015, reproduced: every table, number and figure of the paper beside our own.

`PRINTED` holds what the paper prints and is used for comparison only; every number in a column "computed"
comes from a solution made while the report is. The paper does not print the Moon's constants: `CONSTANTS` are
those that reproduce its digits, so that a difference shows a slip and not another Moon.

Source: D.-H. Cho, D. Kim, H. Leeghim, Optimal Lunar Landing Trajectory Design for Hybrid Engine, Mathematical
Problems in Engineering 2015, 462072.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from perilune.io.export import results, versions
from perilune.io.files import fresh_directory, json_text
from perilune.models.bodies import Body
from perilune.models.landing import Orbit, Retro, Vehicle, hybrid_landing
from perilune.problem.problem import Problem
from perilune.problem.solution import Extremal, Solution
from perilune.words.outcome import Outcome, PeriluneError
from perilune.words.watch import Watch

if TYPE_CHECKING:
    from perilune.families.sweep import Family


@dataclass(frozen=True, kw_only=True)
class Constants:
    """The paper's case; the first three and g0 are not printed there and were found from its digits."""

    gravitational_parameter: float = 4902.7779e9  # m^3/s^2
    radius: float = 1738.14e3  # m
    rotation_rate: float = 2.6617e-6  # rad/s
    standard_gravity: float = 9.81  # m/s^2
    mass: float = 300.0  # kg
    thrust: float = 440.0  # N
    specific_impulse: float = 310.0  # s
    parking_altitude: float = 100e3  # m
    perilune_altitude: float = 15e3  # m


CONSTANTS = Constants()

# (quantity, unit): the printed value and its place in the paper. For comparison, never for computing.
PRINTED = MappingProxyType(
    {
        "perilune speed V0": (1691.96926, "m/s", "(25)"),
        "optimal retro burn": (1200.9011, "m/s", "(26)"),
        "final mass, previous solution": (154.5413, "kg", "Table 1"),
        "fuel, previous solution": (145.4587, "kg", "Table 1"),
        "final mass, proposed solution": (160.6186, "kg", "Table 1"),
        "fuel, proposed solution": (139.3814, "kg", "Table 1"),
    }
)
PRINTED_NO_BENEFIT_BELOW = 280.0  # s, the paper's text on Fig 10

RETRO_BURNS = tuple(50.0 * k for k in range(33))  # m/s, Fig 8
IMPULSES = tuple(310.0 - 2.0 * k for k in range(21))  # s, Figs 9 and 10: steps are not printed
ACCELERATIONS = (
    440.0 / 300.0,
    2.0,
    3.0,
    4.0,
    6.0,
)  # m/s^2, Fig 3: the ratios are ours, the paper's are not legible


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """Everything that was computed for the report."""

    hybrid: Solution
    ordinary: Solution
    by_thrust: dict[float, Solution]
    by_retro_burn: Family
    by_impulse: Family
    break_even_impulse: float
    at_break_even: Solution
    at_printed_burn: Solution

    @property
    def outcome(self) -> Outcome:
        """Of the landing that is proved worse."""
        return max((self.hybrid.outcome, self.ordinary.outcome), key=lambda outcome: outcome.exit_code)


def problem(retro: Retro | None = None, *, thrust: float = CONSTANTS.thrust) -> Problem:
    """State the paper's landing; without `retro`, the ordinary one."""
    c = CONSTANTS
    return hybrid_landing(
        Vehicle(
            mass=c.mass,
            thrust=thrust,
            specific_impulse=c.specific_impulse,
            standard_gravity=c.standard_gravity,
        ),
        retro,
        Orbit(parking_altitude=c.parking_altitude, perilune_altitude=c.perilune_altitude),
        Body(
            name="moon",
            gravitational_parameter=c.gravitational_parameter,
            radius=c.radius,
            rotation_rate=c.rotation_rate,
        ),
    )


def reproduce(out_dir: str | Path, force: bool = False, watch: Watch | None = None, level: int = 3) -> Reproduction:
    """Compute everything in the paper and write ``report.md``, its data and its figures.

    Parameters
    ----------
    out_dir
        Directory; its files appear together when all are complete.
    force
        Whether files of the same names may be replaced.
    watch
        Receives lines of text and iterations.
    level
        Verification level to prove of the two landings of Table 1.

    Returns
    -------
    Reproduction
        What was computed.
    """
    from perilune.report.family import family_csv, family_document
    from perilune.reproductions.cho2015_report import figures, markdown
    from perilune.reproductions.paper import save_figures

    with fresh_directory(out_dir, force) as work:
        made = compute(watch or (lambda _: None), level)
        save_figures(figures(made), work)
        for name, family in (("fig8", made.by_retro_burn), ("fig9_fig10", made.by_impulse)):
            (work / f"{name}.csv").write_text(family_csv(family), encoding="utf-8", newline="")
            (work / f"{name}.json").write_text(json_text(family_document(family)), encoding="utf-8")
        (work / "report.md").write_text(markdown(made, versions()), encoding="utf-8")
    return made


def compute(watch: Watch, level: int = 3) -> Reproduction:
    """Solve every case of the paper."""
    from perilune.families.sweep import sweep
    from perilune.solve import solve

    whole = problem(Retro(specific_impulse=CONSTANTS.specific_impulse))
    watch("the hybrid landing: Table 1, (26), Figs 4-7")
    hybrid = solve(whole, level=level, watch=watch)
    watch("the ordinary landing: Table 1, Fig 2")
    ordinary = solve(problem(), level=level, watch=watch)
    by_thrust = {}
    for acceleration in ACCELERATIONS:
        watch(f"Fig 3: thrust to mass {acceleration:.2f} m/s^2")
        by_thrust[acceleration] = solve(problem(thrust=acceleration * CONSTANTS.mass), level=0, watch=watch)
    watch("Fig 8: landed mass for given retro burns")
    by_retro_burn = _whole(sweep(whole, {"retro.delta_v": RETRO_BURNS}, level=0, watch=watch))
    watch("Figs 9 and 10: the impulsive engine's specific impulse")
    by_impulse = _whole(sweep(whole, {"retro.specific_impulse": IMPULSES}, level=0, watch=watch))
    watch("the specific impulse at which the retro burn stops paying")
    break_even, at_break_even = break_even_impulse(by_impulse, watch)
    watch("the landing with the printed retro burn (26)")
    printed = Retro(specific_impulse=CONSTANTS.specific_impulse, delta_v=PRINTED["optimal retro burn"][0])
    return Reproduction(
        hybrid=hybrid,
        ordinary=ordinary,
        by_thrust=by_thrust,
        by_retro_burn=by_retro_burn,
        by_impulse=by_impulse,
        break_even_impulse=break_even,
        at_break_even=at_break_even,
        at_printed_burn=solve(problem(printed), level=0, watch=watch),
    )


def _whole(family: Family) -> Family:
    """Pass on Ctrl-C, which a sweep turns into a shorter family: a report on half the figures is none."""
    if family.interrupted:
        raise KeyboardInterrupt
    return family


def break_even_impulse(family: Family, watch: Watch) -> tuple[float, Solution]:
    """Impulsive specific impulse [s] where the best retro burn lands as much as none, and the solution there.

    There the global optimum jumps from a large retro burn to none. It is the root of the gain of the best
    extremal with a burn over that without, bracketed by the members of the family between which it jumps.
    """
    from scipy.optimize import brentq

    from perilune.solve import solve

    solved = [(point.value, point.solution) for point in family.points if point.solution is not None]
    pays = [value for value, solution in solved if solution.free["retro_delta_v"] > 0]
    not_any_more = [value for value, solution in solved if solution.free["retro_delta_v"] == 0]
    if not pays or not not_any_more:
        raise PeriluneError(
            "the retro burn does not stop paying in this range of specific impulses",
            got=f"{min(v for v, _ in solved):g} to {max(v for v, _ in solved):g} s",
        )
    last: list[Solution] = []

    def gain(impulse: float) -> float:
        solution = solve(problem(Retro(specific_impulse=impulse)), level=0, watch=watch)
        last[:] = [solution]
        return gain_of_retro_burn(solution)

    # 1e-6 s is far below the last digit shown.
    root = float(brentq(gain, max(not_any_more), min(pays), xtol=1e-6))  # type: ignore[arg-type]
    return root, last[0]


def best_with_retro_burn(solution: Solution) -> Extremal:
    """Pick the best of a solution's extremals that have a retro burn."""
    found = [extremal for extremal in solution.extremals if extremal.free["retro_delta_v"] > 0]
    if not found:
        raise PeriluneError("no extremal with a retro burn was found", advice="nearer to the jump there are two")
    return min(found, key=lambda extremal: extremal.objective)


def gain_of_retro_burn(solution: Solution) -> float:
    """Landed mass [kg] of the best extremal with a retro burn less that of the one without."""
    without = next(extremal for extremal in solution.extremals if extremal.free["retro_delta_v"] == 0)
    return without.objective - best_with_retro_burn(solution).objective


def computed_numbers(made: Reproduction) -> dict[str, float]:
    """Our value of every number in `PRINTED`, from the solutions."""
    hybrid, ordinary = results(made.hybrid), results(made.ordinary)
    return {
        "perilune speed V0": hybrid["perilune_speed"]["value"],
        "optimal retro burn": hybrid["delta_v"]["value"],
        "final mass, previous solution": ordinary["landed_mass"]["value"],
        "fuel, previous solution": ordinary["propellant"]["value"],
        "final mass, proposed solution": hybrid["landed_mass"]["value"],
        "fuel, proposed solution": hybrid["propellant"]["value"],
    }
