"""The tables of README.md: what the paper prints, what is computed here.

``python docs/readme_table.py`` prints them; ``tests/test_docs.py`` computes the rows again and compares them
with those in the file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from perilune.problem import Solution

DIGITS = {"m/s": 5, "kg": 5, "s": 3, "deg": 5}
# Specific impulses [s] around that at which the retro burn stops paying; between them its gain is linear.
BRACKET = (277.85, 277.90)


def against_the_paper(hybrid: Solution, ordinary: Solution, near_break_even: tuple[Solution, Solution]) -> list[str]:
    """Rows of the first table: every number that Cho et al. 2015 print, beside ours.

    Parameters
    ----------
    hybrid, ordinary
        The paper's landing with a free retro burn and without one.
    near_break_even
        The hybrid landing at each specific impulse of `BRACKET`.
    """
    from perilune_papers.cho2015.case import PRINTED
    from perilune_papers.cho2015.compute import gain_of_retro_burn

    with_burn, without = hybrid.results, ordinary.results
    ours = {
        "perilune speed V0": with_burn["perilune_speed"],
        "optimal retro burn": with_burn["delta_v"],
        "final mass, previous solution": without["landed_mass"],
        "fuel, previous solution": without["propellant"],
        "final mass, proposed solution": with_burn["landed_mass"],
        "fuel, proposed solution": with_burn["propellant"],
    }
    rows = []
    for quantity, (printed, unit, where) in PRINTED.items():
        value = ours[quantity].value
        digits = len(repr(printed).partition(".")[2])
        agrees = "all digits agree" if round(value, digits) == printed else "differs"
        name = quantity.replace("previous solution", "no retro burn").replace("proposed solution", "hybrid")
        computed, difference = f"{value:.{DIGITS[unit]}f} {unit}", f"{value - printed:+.1e}, {agrees}"
        rows.append(f"| {name}, {where} | {printed} {unit} | {computed} | {difference} |")
    ratio = with_burn["flight_time"].value / without["flight_time"].value
    rows.append(f"| flight time, hybrid over ordinary, section 4 | a third | {ratio:.4f} | |")
    (low, high), (loss, gain) = BRACKET, (gain_of_retro_burn(s) for s in near_break_even)
    limit = low - loss * (high - low) / (gain - loss)
    rows.append(f"| impulsive Isp below which no retro burn pays, Fig 10 | about 280 s | {limit:.2f} s | |")
    return rows


def not_printed(hybrid: Solution, ordinary: Solution) -> list[str]:
    """Rows of the second table: what the paper does not print."""
    import math

    import numpy as np

    angle = math.degrees(hybrid.outputs(0, np.zeros(1))["thrust_angle"][0])
    rows = [
        f"| flight time, no retro burn | {ordinary.free['flight_time']:.4f} s |",
        f"| flight time, hybrid | {hybrid.free['flight_time']:.4f} s |",
        f"| thrust angle at ignition, hybrid | {angle:.9f}° |",
    ]
    for extremal in hybrid.extremals[1:]:
        burn, mass = extremal.free["retro_delta_v"], -extremal.objective
        rows.append(f"| another extremal: {extremal.nature.value} | ΔV {burn:.3f} m/s, {mass:.5f} kg |")
    return rows


if __name__ == "__main__":
    from perilune.models import Retro
    from perilune.solve import solve
    from perilune_papers.cho2015.case import CONSTANTS, cho_landing

    whole = cho_landing(Retro(specific_impulse=CONSTANTS.specific_impulse))
    best, plain = solve(whole, verify=0), solve(cho_landing(), verify=0)
    low_isp, high_isp = (solve(whole.with_given(retro_specific_impulse=s), verify=0) for s in BRACKET)
    print("\n".join([*against_the_paper(best, plain, (low_isp, high_isp)), "", *not_printed(best, plain)]))
