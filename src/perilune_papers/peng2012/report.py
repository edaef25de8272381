"""Report and figures on Peng, Li, Shen, Tang 2012: printed and computed values, claims, discrepancies."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import astuple, fields
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from perilune import Solution
from perilune.io import hamiltonian, required_hamiltonian
from perilune.report import (
    history_figure,
    line_figure,
    markdown_table,
    solution_drawings,
    solution_summary,
    track_figure,
)
from perilune_papers.paper import (
    claim_verdict,
    claims_section,
    figure_markdown,
    numbers_section,
    slips_section,
    versions_line,
    write_paper_report,
)
from perilune_papers.peng2012.case import (
    CASE,
    PRINTED,
    PRINTED_AXES,
    PRINTED_GRAVITY,
    PRINTED_POINTS,
    PRINTED_TIME_LIMIT,
    implied_gravity,
    parking_altitude,
)
from perilune_papers.peng2012.compute import Convergence, PengReproduction, peng_numbers
from perilune_papers.starts import Starts

_CAPTIONS = {
    "fig2": "Fig 2. The path from the side and from above. Both methods; the lines cover each other.",
    "fig3": "Fig 3. Velocity relative to the Moon: u along the first heading, v to its left, w up.",
    "fig4": "Fig 4. Thrust direction: α above the horizon, β from the heading to the left.",
    "hamiltonian": "Section 4.3.2. Hamiltonian of the Gauss points' own costates, less the value it must have: 0 for "
    "J = -m(t_f), -1 for J = t_f.",
    "convergence": "Not in the paper: difference of N Gauss points from the indirect method. A straight line is "
    "spectral convergence; the floor is the accuracy to which the program of (12)-(16) is solved.",
    "altitude": "Not in the paper: altitude of the indirect solution.",
    "costates": "Not in the paper: its costates, along the axes that turn with the Moon.",
}

_SLIPS = (
    ("(15)", "boundary conditions 'discretized at the LG points'", "at the ends, which are no LG points; X_f is (13)"),
    ("(18), (19), (29)", "three objectives", "one optimum; H = 0 belongs to (29), and H = -1 to (19)"),
    ("(27)", "μ of the Moon is not printed", f"{CASE.body.gravitational_parameter / 1e9:.1f} km³/s²"),
    (
        "appendix",
        f"g0 = {PRINTED_GRAVITY} m/s²",
        f"{CASE.vehicle.standard_gravity:.2f} m/s²: printed fuel and time force it",
    ),
    (
        "3.2",
        "the genetic algorithm solves the program of (12)-(16) itself",
        "it searches thrust angles at five times and t_f, with the dynamics flown; the program is solved from there",
    ),
)

_DECODED = """The text that the paper survives in has lost (17) and the layout of (25).

*Equation (17).* Only the frames, (20)-(23) and the nomenclature are left. Velocities are relative to the Moon, as
(21) subtracts its rotation from the orbital speed; oy keeps a constant angle γ from north, as γ stands among the
constants; ox is radial. Mechanics beside a rotating sphere then leave no choice; the equations stand in
`perilune.models.descent.coordinates`. That they are right does not rest on the reading: the same flights in Cartesian
coordinates and in inertial axes, where there is nothing to decode, end alike to rounding (tests), and the two
solutions below, in different coordinates by different methods, agree.

*Equation (25).* What is left reads "2 15 / 50 / 7690 / 1.6943 / 0 ...": two columns run into each other. Heights of 15
and 2 km are in the text. "7690" can only be latitudes of 90° and 76°, and a polar orbit (i = 90°) begins over the pole;
"50" is then longitudes 0° and 5°. Read the other way round the site lies on the other side of the orbit, which is a
different flight (table above).

*Over the pole* tan φ is infinite, so that (17) cannot be evaluated at the start. Gauss points leave the ends out, and
the paper never noticed; shooting and re-integration need coordinates without that point, and are Cartesian here."""


def write_peng_report(made: PengReproduction, directory: Path) -> None:
    """Write ``report.md``, its data and its figures into a directory that exists.

    Parameters
    ----------
    made
        Everything that was computed.
    directory
        Where to write.
    """
    write_paper_report(directory, peng_report(made), peng_figures(made), {"convergence.csv": convergence_csv(made)})


def peng_figures(made: PengReproduction) -> dict[str, Figure]:
    """Return all figures of the paper, and three that are not in it, by file name."""
    flights = {"indirect": made.indirect, f"{PRINTED_POINTS} Gauss points": made.direct}
    shown = {h.name: h for h in made.indirect.problem.views.histories}
    ours = solution_drawings(made.indirect)
    return {
        "fig2": track_figure(flights),
        "fig3": history_figure(flights, shown["velocities"]),
        "fig4": history_figure(flights, shown["steering"]),
        "hamiltonian": _hamiltonian_figure(made),
        "convergence": _convergence_figure(made.convergence),
        "altitude": ours["altitude"](),
        "costates": ours["costates"](),
    }


def convergence_csv(made: PengReproduction) -> str:
    """Table of the convergence as comma-separated values; units in the header."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    units = {
        "points": "1",
        "flight_time": "s",
        "position": "m",
        "velocity": "m/s",
        "angle": "deg",
        "processor_time": "s",
    }
    writer.writerow([f"{field.name} [{units[field.name]}]" for field in fields(Convergence)])
    writer.writerows(astuple(c) for c in made.convergence)
    return text.getvalue()


def peng_report(made: PengReproduction) -> str:
    """Write the report."""
    parts = [
        "# Powered descent by Gauss points and a genetic search: the paper and our numbers",
        "Q. Peng, H. Li, H. Shen, G. Tang, *Genetic Algorithm for finite-thrust trajectory optimization*, in *Genetic "
        "Algorithms in Applications*, InTech 2012. Columns *printed* hold what the paper prints. Everything else was "
        "computed when this report was made, without a guess.",
        numbers_section(PRINTED, peng_numbers(made)),
        claims_section(_peng_claims(made)),
        "## One landing by every method",
        markdown_table(
            ["method", "coordinates", "flight time (s)", "less the first (s)", "propellant (kg)"], _methods_table(made)
        ),
        "## Discrepancies",
        _peng_discrepancies(made),
        "### What was lost, and how it was found again",
        _DECODED,
        slips_section(_SLIPS),
        "## Gauss points against the indirect method",
        "Largest difference at the collocation points, each N solved from no guess on one segment in the paper's "
        "coordinates; processor time.",
        markdown_table(
            ["N", "flight time (s)", "position (m)", "velocity (m/s)", "angle (deg)", "solved in (s)"],
            [
                [
                    c.points,
                    f"{c.flight_time:+.1e}",
                    f"{c.position:.1e}",
                    f"{c.velocity:.1e}",
                    f"{c.angle:.1e}",
                    f"{c.processor_time:.2f}",
                ]
                for c in made.convergence
            ],
        ),
        _convergence_rate(made.convergence),
        "## From random values",
        _random_start_section(made),
        "## Figures",
        *figure_markdown(_CAPTIONS),
        "## Data",
        "`convergence.csv` holds the convergence.",
        "## The landing",
        f"```text\n{solution_summary(made.indirect)}\n```",
        "## Constants",
        markdown_table(["constant (SI, rad)", "value"], _case_constants()),
        versions_line(),
    ]
    return "\n\n".join(parts) + "\n"


def scaled_hamiltonian(solution: Solution, t: Sequence[float] | np.ndarray) -> np.ndarray:
    """H less its required value at times t, in canonical units.

    Parameters
    ----------
    solution
        Extremal of one phase, with costates.
    t
        Times from the start of the flight, shape (n,) [s].
    """
    scales = solution.problem.scales
    unit = scales.of(solution.problem.objective_unit) / scales.time
    return (hamiltonian(solution, 0, np.asarray(t)) - required_hamiltonian(solution, 0)) / unit


def point_times(solution: Solution) -> np.ndarray:
    """Return the times of the Gauss points [s], only at which the equations hold exactly."""
    return 0.5 * (np.polynomial.legendre.leggauss(PRINTED_POINTS)[0] + 1.0) * solution.free["flight_time"]


def _peng_claims(made: PengReproduction) -> list[list[str]]:
    """Return each claim of the paper, the number that decides it, and whether it holds."""
    at = next(c for c in made.convergence if c.points == PRINTED_POINTS)
    error = float(np.abs(scaled_hamiltonian(made.direct, point_times(made.direct))).max())
    t = np.linspace(0.0, made.direct.trajectories[0].duration, 601)[1:]
    angles = {name: np.degrees(values) for name, values in made.direct.outputs(0, t).items() if name in PRINTED_AXES}
    ranges = {name: (float(v.min()), float(v.max())) for name, v in angles.items()}
    within = all(low <= ranges[name][0] and ranges[name][1] <= high for name, (low, high) in PRINTED_AXES.items())
    elevation, azimuth = ranges["thrust_elevation"], ranges["thrust_azimuth"]
    found, seeds = made.genetic.found(made.indirect.free["flight_time"]), len(made.genetic.flight_times)
    slowest = max(made.genetic.processor_times)
    return [
        [
            "both methods yield practically the same",
            "Fig 2",
            f"paths within {at.position:.1e} m",
            claim_verdict(at.position < 1.0),
        ],
        [
            "thrust angles keep to the bounds of (26), which do not bind, and to the axes shown",
            "Fig 4",
            f"α from {elevation[0]:.2f}° to {elevation[1]:.2f}°, β from {azimuth[0]:.2f}° to {azimuth[1]:.2f}°",
            claim_verdict(within),
        ],
        [
            "re-integrated, the controls meet the end conditions",
            "4.3.1",
            f"DOP853: {made.missed[0]:.1e} m and {made.missed[1]:.1e} m/s from rest on the site",
            claim_verdict(made.missed[0] < 1.0 and made.missed[1] < 1e-2),
        ],
        [
            "the Hamiltonian is almost 0",
            "4.3.2",
            f"at most {error:.1e} at the points, scaled",
            claim_verdict(error < 1e-5),
        ],
        [
            "it converges from random values within the bounds",
            "text",
            f"{found} of {seeds} seeds",
            claim_verdict(found >= 0.96 * seeds),
        ],
        [
            "in less than 2 minutes",
            "text",
            f"median {made.genetic.median_time:.1f} s, at most {slowest:.1f} s, on another machine than a 3 GHz "
            f"Pentium 4",
            claim_verdict(slowest < PRINTED_TIME_LIMIT),
        ],
    ]


def _methods_table(made: PengReproduction) -> list[list[str]]:
    first = made.indirect.free["flight_time"]
    direct = f"{PRINTED_POINTS} Gauss points"
    return [
        [
            name,
            where,
            f"{s.free['flight_time']:.9f}",
            f"{s.free['flight_time'] - first:+.1e}",
            f"{s.results['propellant'].value:.6f}",
        ]
        for name, where, s in (
            ("indirect, J = -m(t_f)", "Cartesian", made.indirect),
            ("indirect, J = t_f", "Cartesian", made.fastest),
            (f"{direct}, J = -m(t_f)", "the paper's", made.direct),
            (f"{direct}, J = t_f", "the paper's", made.direct_fastest),
            (f"{direct}, J = -m(t_f)", "Cartesian", made.direct_cartesian),
        )
    ]


def _peng_discrepancies(made: PengReproduction) -> str:
    time, fuel = PRINTED["flight time"][0], PRINTED["fuel"][0]
    computed = peng_numbers(made)
    cases = {"as solved here": made.indirect, **made.readings}
    rows = []
    for name, solution in cases.items():
        t, m = (solution.results[key].value for key in ("flight_time", "propellant"))
        rows.append([name, f"{t:.4f}", f"{t - time:+.3f}", f"{m:.3f}", f"{m - fuel:+.2f}"])
    nearest = min(cases, key=lambda name: abs(cases[name].free["flight_time"] - time))
    mu, fitting = CASE.body.gravitational_parameter, made.fitting_gravity
    return "\n\n".join(
        [
            f"**g0 is {CASE.vehicle.standard_gravity:.2f}, not {PRINTED_GRAVITY} m/s².** Constant thrust burns "
            f"T t/(I_sp g0). The printed {time} s and {fuel} kg give g0 = {implied_gravity():.5f} m/s² whatever the "
            f"trajectory is; with {PRINTED_GRAVITY} the fuel is kilograms off.",
            f"**What remains is {computed['flight time'] - time:+.3f} s, "
            f"{computed['fuel'] - fuel:+.2f} kg**, {abs(computed['flight time'] / time - 1):.0e} of the whole. It is "
            "far above the error of either method here (next tables), and of the size of what the paper leaves open:",
            markdown_table(["reading", "flight time (s)", "less printed", "fuel (kg)", "less printed"], rows),
            f"The printed time comes out with μ = {fitting / 1e9:.2f} km³/s², {(fitting / mu - 1) * 100:+.2f} % from "
            f"the Moon's: too far for a rounded or an older value. Nearest to the printed time is "
            f"{nearest}. Which it was, the text does not tell.",
            f"**The start fits the story.** {CASE.start.forward_speed:.1f} m/s at {CASE.start.altitude / 1e3:g} km is "
            f"the perilune speed of a Hohmann descent from a circular orbit at {parking_altitude() / 1e3:.1f} km, with "
            "our μ; the paper prints no H_0.",
        ]
    )


def _convergence_rate(convergence: Sequence[Convergence]) -> str:
    """The observed rate, from the first N to the floor: the first error within ten times the least."""
    least = min(c.position for c in convergence)
    first, floor = convergence[0], next(c for c in convergence if c.position <= 10 * least)
    factor = (first.position / floor.position) ** (1 / (floor.points - first.points))
    orders = [
        math.log(a.position / b.position) / math.log(b.points / a.points)
        for a, b in pairwise(c for c in convergence if c.points <= floor.points)
    ]
    worst = max(c.position for c in convergence if c.points >= floor.points)
    in_time = next(c.points for c in convergence if abs(c.flight_time) < 1e-7)
    return (
        f"From N = {first.points} to {floor.points} each point divides the error in position by {factor:.1f}: "
        f"spectral. Read as a power of N the order would be between {min(orders):.0f} and {max(orders):.0f}, which "
        "no method of fixed order has. From there on it is the accuracy to which the program is solved, at most "
        f"{worst:.1e} m. The flight time is within 1e-7 s with N = {in_time}."
    )


def _random_start_section(made: PengReproduction) -> str:
    truth = made.indirect.free["flight_time"]

    def row(name: str, tried: Starts) -> list[str]:
        times = tried.processor_times
        counts = [f"{tried.found(truth)} of {len(times)}", str(tried.elsewhere(truth))]
        return [name, *counts, f"{tried.median_time:.1f}", f"{max(times):.1f}"]

    straight = next(c for c in made.convergence if c.points == PRINTED_POINTS)
    rows = [
        row("genetic search, then Gauss points (the paper's)", made.genetic),
        row("Gauss points from one random individual", made.random),
        ["Gauss points from a straight line, no random values", "1 of 1", "0", f"{straight.processor_time:.1f}", ""],
    ]
    return "\n\n".join(
        [
            f"{PRINTED_POINTS} points in the paper's coordinates; success is the optimum's flight time. Times are of "
            "the processor.",
            markdown_table(["start", "found the optimum", "ended elsewhere", "median time (s)", "longest (s)"], rows),
            "The use of the search shows with many seeds (`--seeds 50`): random starts become reliable, "
            "in a predictable time. It does not beat the straight line from the start to the site, which needs none.",
        ]
    )


def _hamiltonian_figure(made: PengReproduction) -> Figure:
    curves = []
    for solution, text in ((made.direct, "J = -m(t_f)"), (made.direct_fastest, "J = t_f")):
        t = point_times(solution)
        curves.append((t, np.maximum(np.abs(scaled_hamiltonian(solution, t)), 1e-17), ".", text))
    return line_figure(curves, ("time from ignition (s)", "error of H at the points, scaled"), from_zero=True, log=True)


def _convergence_figure(convergence: Sequence[Convergence]) -> Figure:
    N = [c.points for c in convergence]
    curves = [
        (N, [abs(getattr(c, name)) for c in convergence], style, text)
        for name, style, text in (
            ("flight_time", "o-", "time (s)"),
            ("position", "s--", "position (m)"),
            ("velocity", "^-.", "velocity (m/s)"),
            ("angle", "v:", "angle (deg)"),
        )
    ]
    return line_figure(curves, ("Gauss points N", "largest difference"), height=2.8, log=True)


def _case_constants() -> list[list[str]]:
    sections = {"body": CASE.body, "vehicle": CASE.vehicle, "start": CASE.start, "site": CASE.site}
    rows = [
        [f"{section}.{name}", f"{value:.8g}"]
        for section, record in sections.items()
        for name, value in vars(record).items()
        if isinstance(value, float | int)
    ]
    return [*rows, *([f"steering.{name}", "{:.8g} to {:.8g}".format(*v)] for name, v in vars(CASE.steering).items())]
