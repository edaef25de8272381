"""Cases of Cho, Kim, Leeghim 2015, every one solved, for the report."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.optimize import brentq

from perilune import Extremal, Family, Outcome, PeriluneError, Solution, solve, sweep
from perilune.core import Watch
from perilune.models import Retro
from perilune_papers.cho2015.case import ACCELERATIONS, CONSTANTS, IMPULSES, PRINTED, RETRO_BURNS, cho_landing
from perilune_papers.paper import worst_solution


@dataclass(frozen=True, kw_only=True)
class ChoReproduction:
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
        """Return the outcome of the landing with the worse proof."""
        return self.proved.outcome

    @property
    def proved(self) -> Solution:
        """Return the landing with the worse proof of the two."""
        return worst_solution(self.hybrid, self.ordinary)


def compute_cho(watch: Watch, level: int = 3) -> ChoReproduction:
    """Solve every case of the paper.

    Parameters
    ----------
    watch
        Receives lines of text and iterations.
    level
        Verification level to prove of the two landings of Table 1.
    """
    whole = cho_landing(Retro(specific_impulse=CONSTANTS.specific_impulse))
    watch("the hybrid landing: Table 1, (26), Figs 4-7")
    hybrid = solve(whole, verify=level, callback=watch)
    watch("the ordinary landing: Table 1, Fig 2")
    ordinary = solve(cho_landing(), verify=level, callback=watch)
    by_thrust = {}
    for acceleration in ACCELERATIONS:
        watch(f"Fig 3: thrust to mass {acceleration:.2f} m/s^2")
        by_thrust[acceleration] = solve(cho_landing(thrust=acceleration * CONSTANTS.mass), verify=0, callback=watch)
    watch("Fig 8: landed mass for given retro burns")
    by_retro_burn = _refuse_partial_sweep(sweep(whole, {"retro.delta_v": RETRO_BURNS}, verify=0, callback=watch))
    watch("Figs 9 and 10: the impulsive engine's specific impulse")
    by_impulse = _refuse_partial_sweep(sweep(whole, {"retro.specific_impulse": IMPULSES}, verify=0, callback=watch))
    watch("the specific impulse at which the retro burn stops paying")
    break_even, at_break_even = break_even_impulse(by_impulse, watch)
    watch("the landing with the printed retro burn (26)")
    printed = Retro(specific_impulse=CONSTANTS.specific_impulse, delta_v=PRINTED["optimal retro burn"][0])
    return ChoReproduction(
        hybrid=hybrid,
        ordinary=ordinary,
        by_thrust=by_thrust,
        by_retro_burn=by_retro_burn,
        by_impulse=by_impulse,
        break_even_impulse=break_even,
        at_break_even=at_break_even,
        at_printed_burn=solve(cho_landing(printed), verify=0, callback=watch),
    )


def _refuse_partial_sweep(family: Family) -> Family:
    """Raise after Ctrl-C, which a sweep turns into a shorter family: a report on half the figures is useless."""
    if family.interrupted:
        raise KeyboardInterrupt
    return family


def break_even_impulse(family: Family, watch: Watch) -> tuple[float, Solution]:
    """Impulsive specific impulse [s] where the best retro burn lands as much as none, and the solution there.

    There the best extremal jumps from a large retro burn to none. It is the root of the gain of the best
    extremal with a burn over that without, bracketed by the members of the family between which it jumps.

    Parameters
    ----------
    family
        Landings over the specific impulse of the retro burn [s].
    watch
        Called with each iteration and with lines of text.

    Raises
    ------
    PeriluneError
        If the retro burn pays everywhere in the family, or nowhere.
    """
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
        solution = solve(cho_landing(Retro(specific_impulse=impulse)), verify=0, callback=watch)
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
    """Return the landed mass [kg] of the best extremal with a retro burn less that without."""
    without = next(extremal for extremal in solution.extremals if extremal.free["retro_delta_v"] == 0)
    return without.objective - best_with_retro_burn(solution).objective


def cho_numbers(made: ChoReproduction) -> dict[str, float]:
    """Our value of every number in `PRINTED`, from the solutions."""
    hybrid, ordinary = made.hybrid.results, made.ordinary.results
    return {
        "perilune speed V0": hybrid["perilune_speed"].value,
        "optimal retro burn": hybrid["delta_v"].value,
        "final mass, previous solution": ordinary["landed_mass"].value,
        "fuel, previous solution": ordinary["propellant"].value,
        "final mass, proposed solution": hybrid["landed_mass"].value,
        "fuel, proposed solution": hybrid["propellant"].value,
    }
