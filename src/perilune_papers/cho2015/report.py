"""Report and figures on Cho, Kim, Leeghim 2015: printed and computed values, claims, discrepancies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.figure import Figure

from perilune import Solution
from perilune.io import extremals_document, flight_columns, json_text
from perilune.report import (
    family_csv,
    family_document,
    line_figure,
    markdown_table,
    solution_drawings,
    solution_summary,
)
from perilune_papers.cho2015.case import CONSTANTS, PRINTED, PRINTED_NO_BENEFIT_BELOW
from perilune_papers.cho2015.compute import ChoReproduction, best_with_retro_burn, cho_numbers
from perilune_papers.paper import (
    claim_verdict,
    claims_section,
    figure_markdown,
    largest_value,
    numbers_section,
    slips_section,
    versions_line,
    write_paper_report,
)

_CAPTIONS = {
    "fig2": "Fig 2. The ordinary landing: it climbs first, to have time to lose its horizontal velocity.",
    "fig3": "Fig 3. The ordinary landing for several thrust-to-mass ratios (ours; the paper's: not legible).",
    "fig4": "Fig 4. Altitude.",
    "fig5": "Fig 5. Horizontal velocity.",
    "fig6": "Fig 6. Vertical velocity.",
    "fig7": "Fig 7. Thrust angle.",
    "fig8": "Fig 8. Landed mass for given retro burns, 0 to 1600 m/s by 50 m/s, and the extremals found.",
    "fig9": "Fig 9. Best retro burn against the impulsive engine's specific impulse.",
    "fig10": "Fig 10. Landed mass against the impulsive engine's specific impulse.",
    "path": "Not in the paper: the path over the limb of the Moon. Strokes show the exhaust.",
    "mass": "Not in the paper: mass. The hybrid begins lighter by the propellant of the retro burn.",
    "costates": "Not in the paper: costates of the hybrid landing.",
    "hamiltonian": "Not in the paper: the Hamiltonian, which must vanish, and what turned thrust adds to it.",
}

_SLIPS = (
    ("(7)", "r_p is called a radial distance and given as 100 km, which is the altitude", "r_p = R + 100 km"),
    ("(9)", "m exp(...)", "M exp(...), as in (8)"),
    ("(10)", "u_f is the ground speed R ω in an inertial frame", "used so"),
    ("(12)", "λ' = -H_r", "λ' = -H_x"),
    ("(15)", "arc tangent of the quotient, which loses the quadrant", "atan2(-λ_v, -λ_u)"),
    (
        "(24)",
        "the inverse of a 7 × 11 matrix",
        "unknowns λ_r, λ_u, λ_v, λ_m, u_0 and t_f only; λ_φ = 0 throughout",
    ),
    (
        "Figs 9, 10",
        "one I_sp in all equations",
        "the impulsive engine's in (8), (9), (17), (19), (20); the main engine's in (5) and H",
    ),
)


def write_cho_report(made: ChoReproduction, directory: Path) -> None:
    """Write ``report.md``, its data and its figures into a directory that exists.

    Parameters
    ----------
    made
        Everything that was computed.
    directory
        Where to write.
    """
    families = {"fig8": made.by_retro_burn, "fig9_fig10": made.by_impulse}
    data = {f"{name}.csv": family_csv(family) for name, family in families.items()}
    data |= {f"{name}.json": json_text(family_document(family)) for name, family in families.items()}
    write_paper_report(directory, cho_report(made), cho_figures(made), data)


def cho_figures(made: ChoReproduction) -> dict[str, Figure]:
    """Return all figures of the paper, and four that are not in it, by file name."""
    ours = {name: draw() for name, draw in solution_drawings(made.hybrid, made.ordinary).items()}
    return {
        "fig2": solution_drawings(made.ordinary)["altitude"](),
        "fig3": _altitudes(made.by_thrust),
        "fig4": ours["altitude"],
        "fig5": ours["horizontal_velocity"],
        "fig6": ours["vertical_velocity"],
        "fig7": ours["thrust_angle"],
        "fig8": _mass_by_burn(made),
        "fig9": _by_impulse(made, "delta_v", "best retro burn ΔV (m/s)"),
        "fig10": _by_impulse(made, "landed_mass", "landed mass (kg)"),
        **{name: ours[name] for name in ("path", "mass", "costates", "hamiltonian") if name in ours},
    }


def cho_report(made: ChoReproduction) -> str:
    """Write the report."""
    parts = [
        "# Optimal lunar landing with a hybrid engine: the paper and our numbers",
        "D.-H. Cho, D. Kim, H. Leeghim, *Optimal Lunar Landing Trajectory Design for Hybrid Engine*, "
        "Mathematical Problems in Engineering 2015, 462072. Columns *printed* hold what the paper prints. "
        "Everything else was computed when this report was made, without a guess.",
        numbers_section(PRINTED, cho_numbers(made)),
        claims_section(_cho_claims(made)),
        "## Discrepancies",
        _cho_discrepancies(made),
        slips_section(_SLIPS),
        "## Figures",
        *figure_markdown(_CAPTIONS),
        "## Data",
        "`fig8.csv` and `fig9_fig10.csv` (and the same as JSON) hold the points of Figs 8, 9 and 10.",
        *_unsolved_members(made),
        "## The two landings",
        f"```text\n{solution_summary(made.hybrid)}\n\n{solution_summary(made.ordinary)}\n```",
        "## Constants",
        "The paper prints mass, thrust, specific impulse and altitudes. Gravitational parameter, radius, "
        "rotation rate and standard gravity are not printed; these reproduce its digits.",
        markdown_table(
            ["constant (SI)", "value"],
            [[f.name.replace("_", " "), f"{getattr(CONSTANTS, f.name):.8g}"] for f in fields(CONSTANTS)],
        ),
        versions_line(),
    ]
    return "\n\n".join(parts) + "\n"


def _cho_claims(made: ChoReproduction) -> list[list[str]]:
    """Return each claim of the paper, the number that decides it, and whether it holds."""
    hybrid, ordinary = made.hybrid, made.ordinary
    ratio = hybrid.results["flight_time"].value / ordinary.results["flight_time"].value
    saved = ordinary.results["propellant"].value - hybrid.results["propellant"].value
    share = saved / ordinary.results["propellant"].value
    climb = largest_value(ordinary, "altitude") - CONSTANTS.perilune_altitude
    climbs = [largest_value(s, "altitude") - CONSTANTS.perilune_altitude for _, s in sorted(made.by_thrust.items())]
    rising, beta = largest_value(hybrid, "v"), largest_value(hybrid, "thrust_angle")
    burns = _solved_points(made, "by_retro_burn", "landed_mass")
    best = max(burns, key=lambda row: row[1])[0]
    paying = [
        (isp, dv, m)
        for (isp, dv), (_, m) in zip(
            _solved_points(made, "by_impulse", "delta_v"),
            _solved_points(made, "by_impulse", "landed_mass"),
            strict=True,
        )
        if dv > 0
    ]
    falls = all(a[1] > b[1] and a[2] > b[2] for a, b in pairwise(paying))
    return [
        ["the ordinary landing climbs first", "Fig 2", f"by {climb / 1e3:.2f} km", claim_verdict(climb > 0)],
        [
            "more thrust to mass, less climb", "Fig 3", ", ".join(f"{c / 1e3:.2f}" for c in climbs) + " km",
            claim_verdict(all(b < a or a <= 1e-6 for a, b in pairwise(climbs))),
        ],
        ["the hybrid never climbs (v ≤ 0)", "Figs 4, 6", f"v ≤ {rising:.1e} m/s", claim_verdict(rising <= 1e-6)],
        ["its thrust angle stays below 180°", "Fig 7", f"β ≤ {beta:.9f}°", claim_verdict(beta <= 180 + 1e-9)],
        ["flight time falls to a third", "text", f"{ratio:.4f} of the ordinary one", claim_verdict(ratio < 1 / 3)],
        ["about 6 kg of fuel saved", "text", f"{saved:.4f} kg", claim_verdict(abs(saved - 6) < 0.5)],
        ["that is about 4 % of the fuel", "text", f"{100 * share:.2f} %", claim_verdict(abs(100 * share - 4) < 0.5)],
        ["landed mass peaks near 1200 m/s", "Fig 8", f"at {best:g} m/s of 33", claim_verdict(abs(best - 1200) < 25)],
        [
            "retro burn and landed mass fall with the impulsive specific impulse", "Figs 9, 10",
            f"{len(paying)} values down to {paying[-1][0]:g} s", claim_verdict(falls),
        ],
        [
            "no benefit below about 280 s", "Fig 10", f"below {made.break_even_impulse:.3f} s",
            claim_verdict(abs(made.break_even_impulse - PRINTED_NO_BENEFIT_BELOW) < 5),
        ],
    ]  # fmt: skip


def _cho_discrepancies(made: ChoReproduction) -> str:
    computed = cho_numbers(made)["optimal retro burn"]
    printed = PRINTED["optimal retro burn"][0]
    lost = made.hybrid.results["landed_mass"].value - made.at_printed_burn.results["landed_mass"].value
    jump = best_with_retro_burn(made.at_break_even)
    rows = [
        [f"{e.get('delta_v', 0.0):.3f}", f"{e.get('landed_mass', 0.0):.6f}", e["nature"]]
        for e in extremals_document(made.hybrid)
    ]
    return "\n\n".join(
        [
            f"**The printed ΔV is not quite stationary.** (26) prints {printed:.4f} m/s; the root is at "
            f"{computed:.4f} m/s, {computed - printed:.4f} m/s more. The optimum is flat: the printed value "
            f"costs {lost:.1e} kg of landed mass, far below the last digit of Table 1, and a loose tolerance "
            "on (20) would not notice.",
            "**A root of the conditions is not an answer.** The transversality condition (19) has more than "
            "one root, and the bound ΔV = 0 is an extremal of its own, which the paper does not mention:",
            markdown_table(["ΔV (m/s)", "landed mass (kg)", "nature"], rows),
            f"**The best retro burn does not shrink to nothing in Fig 9; it jumps.** At "
            f"{made.break_even_impulse:.3f} s the best extremal with a retro burn "
            f"({jump.free['retro_delta_v']:.1f} m/s) lands as much as no burn, and below it no burn is best. "
            f"The paper says 'less than {PRINTED_NO_BENEFIT_BELOW:g} s', to the accuracy of a plot.",
        ]
    )


def _unsolved_members(made: ChoReproduction) -> list[str]:
    """List the members of a family that could not be solved, so that no gap is silent."""
    missing = [
        f"- {family.parameter} = {point.value:g} {family.unit}: {' '.join(point.message.split())}"
        for family in (made.by_retro_burn, made.by_impulse)
        for point in family.points
        if point.solution is None
    ]
    return ["Not solved, and missing in the figures:", "\n".join(missing)] if missing else []


def _altitudes(by_thrust: Mapping[float, Solution]) -> Figure:
    curves = []
    for (acceleration, solution), dash in zip(by_thrust.items(), ("-", "--", "-.", ":", "-"), strict=False):
        time, column = flight_columns(solution, "altitude")[0]
        curves.append((time, column.values / 1e3, dash, f"{acceleration:.2f} m/s²"))
    return line_figure(curves, ("time from ignition (s)", "altitude (km)"), height=2.5, from_zero=True)


def _mass_by_burn(made: ChoReproduction) -> Figure:
    rows = np.array(_solved_points(made, "by_retro_burn", "landed_mass"))
    marks = [
        (e["delta_v"], e["landed_mass"], f"{fill(e['nature'], 15)}\n{e['delta_v']:.1f} m/s", offset)
        for e, offset in zip(
            sorted(extremals_document(made.hybrid), key=lambda e: e["delta_v"]),
            ((40, 40), (14, -30), (-16, -86)),
            strict=False,
        )
    ]
    return line_figure(
        [(rows[:, 0], rows[:, 1], "o-", "")], ("retro burn ΔV (m/s)", "landed mass (kg)"), marks, height=2.6
    )


def _by_impulse(made: ChoReproduction, quantity: str, text: str) -> Figure:
    """Draw the two branches, with the jump between them at the computed specific impulse."""
    rows = _solved_points(made, "by_impulse", quantity)
    burns = dict(_solved_points(made, "by_impulse", "delta_v"))
    at = made.break_even_impulse
    best = best_with_retro_burn(made.at_break_even)
    mass = -best.objective
    ends = (best.free["retro_delta_v"], 0.0) if quantity == "delta_v" else (mass, mass)
    pays = [(at, ends[0]), *sorted(row for row in rows if burns[row[0]] > 0)]
    not_any_more = [*sorted(row for row in rows if burns[row[0]] == 0), (at, ends[1])]
    curves = [
        (*zip(*pays, strict=True), "o-", "with a retro burn"),
        (*zip(*not_any_more, strict=True), "s--", "without"),
    ]
    mark = (at, ends[0], f"{at:.2f} s", (22, -16) if quantity == "delta_v" else (-22, 18))
    return line_figure(curves, ("impulsive specific impulse (s)", text), [mark])


def _solved_points(made: ChoReproduction, family: str, quantity: str) -> list[tuple[float, float]]:
    """(value, result) of the members that were solved."""
    return [
        (point.value, point.solution.results[quantity].value)
        for point in getattr(made, family).points
        if point.solution is not None
    ]
