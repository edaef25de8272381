"""Messages to the page: a solution, a refusal, a proof, each as one JSON document."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from perilune import InfeasibleError, PeriluneError, Solution, Verification
from perilune.app.source import Subject
from perilune.core import CANNOT_BE_FLOWN, Matrix, Vector
from perilune.io import display_times, extremals_document, finite, phase_columns, results_document
from perilune.problem import full
from perilune.report import plane_of_flight

POINTS = 96  # of a flight, shared among its phases by their durations
_LEAST = 25  # of a phase, however short it is
_DIGITS = 6  # significant, more than a screen has
ALL_DIGITS = 17  # with which a number is read back as it was
_MOST_PLACES = 300
_TENS = np.array([float(f"1e{k}") for k in range(_MOST_PLACES + 1)])
_FLAT = 1e-9  # of its size: what spans less is rounding


def opening_message(subject: Subject) -> dict[str, Any]:
    """Return the first message to a page: the problem, its title, and what can be moved."""
    problem = subject.problem
    return {
        "title": subject.title,
        "kind": problem.name,
        "mapped": subject.atlas is not None,
        "scenario": bool(subject.text),
        "unwritten": subject.unwritten,
        "maximised": problem.maximised or "",
        "knobs": [vars(knob) for knob in subject.knobs],
        "coasts": _coasts() if problem.views.ground is not None and problem.views.ground.coasts else [],
    }


def _coasts() -> list[list[list[float]]]:
    from perilune.report import coastline

    return [line.round(1).tolist() for line in coastline()]


def flight_message(solution: Solution, points: int = POINTS, digits: int = _DIGITS) -> dict[str, Any]:
    """Return the message of a flight with all that is drawn of it; numbers in the units given with them.

    It has about `points` points, and at least `digits` significant digits in its columns.

    Parameters
    ----------
    solution
        The flight.
    points
        Number of times in all phases together.
    digits
        Significant digits of the columns.
    """
    lasting = [trajectory.duration for trajectory in solution.trajectories]
    phases, begin = list[dict[str, Any]](), 0.0
    over_limb = solution.problem.views.radius and all(p.inertial is not None for p in solution.problem.phases)
    plane = plane_of_flight(solution) if over_limb else None
    for k, (phase, duration) in enumerate(zip(solution.problem.phases, lasting, strict=True)):
        count = max(_LEAST, round(points * duration / max(sum(lasting), 1e-300)))
        t = display_times(solution.trajectories[k], count)
        shown = {
            name: {"unit": column.unit, "values": round_curve(column.values, digits)}
            for name, column in phase_columns(solution, k, t).items()
            if name != "time"
        }
        phases.append(
            {
                "name": phase.name,
                "time": round_to_digits(begin + t, digits),
                "columns": shown,
                "way": _path_message(solution, k, t, plane),
            }
        )
        begin += duration
    return {
        "title": solution.problem.heading,
        "objective": float(solution.objective),
        "unit": solution.problem.objective_unit,
        "results": finite(results_document(solution)),
        "labels": _labels(solution),
        "free": dict(solution.free),
        **extremals_message(solution),
        "phases": phases,
        "proof": proof_message(solution.verification),
        "views": _views_message(solution),
    }


def _labels(solution: Solution) -> dict[str, str]:
    """Return the labels of quantities for axes and numbers, except those equal to the label of another.

    A figure of several may leave to its caption that they are speeds; a panel of one may not.
    """
    variables = (v for phase in solution.problem.phases for v in (*phase.states, *phase.output_variables))
    panels, numbers = ({v.name: v.label for v in variables}, {name: r.label for name, r in solution.results.items()})
    called = Counter(label or name for name, label in panels.items())
    alone = {name: label for name, label in panels.items() if called[label] == 1}
    return {name: label for name, label in {**alone, **numbers}.items() if label}


def extremals_message(solution: Solution) -> dict[str, Any]:
    """Return the message of all extremals found, best first: in words, and free parameters and J of each [SI]."""
    found = [{"free": dict(extremal.free), "objective": extremal.objective} for extremal in solution.extremals]
    return finite({"extremals": extremals_document(solution), "roots": found})


def _views_message(solution: Solution) -> dict[str, Any]:
    """Return the histories to draw, the coordinates of the ground track, and the names of the controls."""
    views = solution.problem.views
    ground = views.ground or views.space
    return {
        "histories": [{"caption": shown.caption, "quantities": list(shown.quantities)} for shown in views.histories],
        "ground": [ground.longitude, ground.latitude] if ground is not None and ground.longitude else None,
        "coasts": bool(views.ground and views.ground.coasts),
        "controls": list(dict.fromkeys(name for phase in solution.problem.phases for name in phase.control_names)),
    }


def proof_message(verification: Verification) -> dict[str, Any]:
    """Return the message of the checks: each with its value, its limit and its meaning."""
    return {
        "level": verification.level,
        "tolerance_used": verification.tolerance_used,
        "checks": [
            {
                "name": check.name,
                "level": check.level,
                "value": _short(check.value),
                "limit": _short(check.limit),
                "unit": check.unit,
                "passed": check.passed,
                "meaning": check.meaning,
            }
            for check in verification.checks
        ],
    }


def refusal_message(error: PeriluneError) -> dict[str, Any]:
    """Return the message of an error in place of a flight."""
    reason = error.reason if isinstance(error, InfeasibleError) else ""
    return {
        "what": error.what,
        "got": error.got,
        "expected": error.expected,
        "try": error.advice,
        "reason": reason,
        "impossible": reason == CANNOT_BE_FLOWN,
    }


def round_to_digits(values: Vector | Sequence[float], digits: int = _DIGITS) -> list[float | None]:
    """Round numbers to significant digits, None for those not finite; with all digits they stay as they are.

    Parameters
    ----------
    values
        Numbers, shape (n,).
    digits
        Number of significant digits.
    """
    told = np.asarray(values, dtype=float)
    good = np.isfinite(told)
    if digits < ALL_DIGITS:
        size = np.abs(told, out=np.ones(told.shape), where=good & (told != 0.0))
        places = np.clip(digits - 1 - np.floor(np.log10(size)), -_MOST_PLACES, _MOST_PLACES).astype(int)
        up, down = _TENS[np.maximum(places, 0)], _TENS[np.maximum(-places, 0)]
        told = np.rint(told * up / down) * down / up  # the double nearest to a short decimal, as powers are exact
    numbers = told.tolist()
    return numbers if good.all() else [v if there else None for v, there in zip(numbers, good, strict=True)]


def round_curve(values: Vector, digits: int = _DIGITS) -> list[float | None]:
    """Round a curve; one far from zero relative to its span needs more digits to show its shape.

    Parameters
    ----------
    values
        Values along the curve, shape (n,).
    digits
        Significant digits of a curve that begins at zero.
    """
    seen = values[np.isfinite(values)]
    span, most = (np.ptp(seen), np.abs(seen).max()) if len(seen) else (0.0, 0.0)
    return round_to_digits(values, digits + (math.ceil(math.log10(most / span)) if span > most * _FLAT else 0))


def _short(value: float, digits: int = _DIGITS) -> float | None:
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def _path_message(solution: Solution, k: int, t: Vector, plane: Matrix | None) -> dict[str, Any] | None:
    """Return the path of a phase: angle and height over the limb, or a track over flat ground; None with neither."""
    phase = solution.problem.phases[k]
    if plane is not None:
        r, _, push = solution.inertial(k, t)
        above, ahead = plane @ r
        angle, strength = np.unwrap(np.arctan2(ahead, above)), np.linalg.norm(push, axis=0)
        out, on = plane @ push / np.where(strength > 0, strength, 1.0)
        cosine, sine = np.cos(angle), np.sin(angle)
        thrust = [round_to_digits(out * cosine + on * sine), round_to_digits(on * cosine - out * sine)]
        radius = float(getattr(solution.parameters, solution.problem.views.radius))
        height = np.linalg.norm(r, axis=0) - radius
        return {
            "kind": "limb",
            "radius": radius,
            "along": round_to_digits(angle),
            "height": round_to_digits(height),
            "thrust": thrust,
        }
    if phase.track is not None:
        x, u = solution.evaluate(k, t)
        rows = [full(value, t) for value in phase.evaluate("track", x, u, solution.parameters)]
        named = zip(("along", "across", "height", "floor"), rows, strict=False)
        return {"kind": "flat", **{name: round_to_digits(row) for name, row in named}}
    return None
