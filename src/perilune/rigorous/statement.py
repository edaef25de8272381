"""Statement of the theorem in words and numbers, and as a certificate for an independent program."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from decimal import ROUND_CEILING, Context
from fractions import Fraction
from typing import Any

from flint import arb, ctx

from perilune.problem import Problem
from perilune.rigorous.exact_tape import exact_value
from perilune.rigorous.inequalities import Statement
from perilune.rigorous.taylor import Ball
from perilune.rigorous.theorem import ProvedExtremal
from perilune_checker.certificate import FORMAT
from perilune_checker.check import checked_sentence

TRUSTED = (
    "FLINT's ball arithmetic (arb), through python-flint",
    "perilune.rigorous: derivatives of expressions, Taylor recurrences, remainder, Krawczyk's operator, signs",
    "perilune.problem.tracing.tape: that the recorded operations are those of the functions that state the problem",
    "perilune.core.units: the exact number of a quantity that is stated in decimals",
    "the interpreter of Python and the machine",
)
_DIGITS = 30
_CLAIMED = 27  # digits of a certificate
_ROOM, _ROOM_OF_BOX = 1e-26, 1e-20  # relative to a value, and to the box that holds no other root


def _ball(value: Ball) -> str:
    """A ball with its digits and its radius, for a reader."""
    return str(value.str(_DIGITS))


def _rounded_up(value: float) -> str:
    """A number in two digits that is no smaller."""
    return format(Context(prec=2, rounding=ROUND_CEILING).create_decimal_from_float(value), ".2g")


def theorem_text(proved: ProvedExtremal) -> str:
    """Return the theorem that is proved, in one paragraph."""
    boundary, problem = proved.boundary, proved.boundary.problem
    y = dict(zip(boundary.names, proved.root.y, strict=True))
    told = [f"J = {_ball(proved.objective)} {problem.objective_unit}"]
    told += [f"{f.name} = {_ball(y[f.name])} {f.unit}".removesuffix(" 1") for f in problem.free]
    arcs = f" It consists of {len(boundary.arcs)} arcs." if len(boundary.arcs) > 1 else ""
    around = "in which the verified answer lies" if proved.reached else "around it"
    if any(arc.implicit for arc in boundary.arcs):  # two such controls may be as good as each other at a time
        around += ", of flights whose controls are continuous along each arc"
    values = ", ".join(told)
    return (
        f"Theorem. With {_numbers_sentence(problem)}, the problem {problem.name} has an extremal: a flight that "
        f"satisfies "
        f"Pontryagin's conditions exactly, with {values}.{arcs} Its unknowns are within "
        f"{_rounded_up(proved.distance)} of "
        "those of the verified answer, relative to their size (a millionth of the largest for smaller ones), and the "
        f"only ones in a box {around} (contraction {_rounded_up(proved.unique.contraction)}). "
        f"{_limits_sentence(proved)} "
        f"{_optimum_sentence(proved)}"
    )


def _numbers_sentence(problem: Problem) -> str:
    """Return which numbers a theorem is about, in words."""
    stated = sum(bool(exact_value(given).text) for given in problem.given.values())
    doubles = "number taken as the rational number that its double is"
    if not stated:
        return f"every {doubles}"
    return (
        f"the decimals of the scenario taken exactly ({stated} of {len(problem.given)} values), every other {doubles}"
    )


def _optimum_sentence(proved: ProvedExtremal) -> str:
    if not proved.optimum.proved:
        return f"That it is a local optimum is not part of the theorem, {proved.optimum.where}."
    but = ", controls but for short times about its switches," if _has_switches(proved) else ","
    return (
        "It is a strict local optimum: every other flight whose states, controls and free parameters stay close "
        f"enough to it{but} and that meets the same conditions, has a larger J."
    )


def _has_switches(proved: ProvedExtremal) -> bool:
    return any(piece.switched for piece in proved.boundary.pieces)


def _limits_sentence(proved: ProvedExtremal) -> str:
    slack = [statement for statement in proved.statements if statement.slack > 0]
    idle = any(arc.idle for arc in proved.boundary.arcs)
    states = " and ".join(f"{state} of {phase}" for phase, state in proved.boundary.sides.states)
    held = f", or a bound holds it there ({states})" if states else ""
    but = ["at its switches"] * _has_switches(proved) + ["for a direction while what multiplies it vanishes"] * idle
    text = (
        f"Along the whole flight every limit is kept strictly, but where an end lies on it by condition{held}; "
        f"the control is the only one that minimises H{', but ' if but else ''}{' and '.join(but)}."
    )
    if not slack:
        return text
    most = ", ".join(f"{statement.words} to within {_rounded_up(statement.slack)}" for statement in slack)
    return f"{text} At an end that touches a limit: {most}."


def unproved_sentence(missing: Sequence[Statement]) -> str:
    """Return what could not be proved, in one sentence."""
    told = "; ".join(f"{s.words}{f' {s.where}' if s.where else ''}" for s in missing)
    return f"an extremal is proved, but not that {told}"


def certificate_document(proved: ProvedExtremal, text: str) -> dict[str, Any]:
    """Return everything on which the proof rests and that it claims, for JSON; balls and exact numbers as texts.

    Its theorem is what the checker sees again, in its words; what the prover says beyond it stands apart.

    Parameters
    ----------
    proved
        Extremal with all that was proved of it.
    text
        The theorem in the words of the prover.
    """
    boundary, root = proved.boundary, proved.root
    told = {
        "format": FORMAT,
        "trusted": list(TRUSTED),
        "problem": tape_document(boundary.problem),
        "arcs": [
            {"phase": piece.phase, "regimes": dict(piece.regimes), "switched": piece.switched}
            for piece in boundary.pieces
        ],
        "on_bounds": {
            "free": dict(boundary.sides.free),
            "ranges": [[*place, side] for place, side in boundary.sides.ranges.items()],
            "states": [[*place, side] for place, side in boundary.sides.states.items()],
        },
        "bits": proved.settings.bits,
        "grid": [list(begins) for begins in proved.refined.grid],
        "unknowns": [
            {
                "name": name,
                "centre": _exact_centre(c),
                "enclosure": _rounded_claim(k, _ROOM_OF_BOX * alone.rad(), proved),
            }
            for name, c, k, alone in zip(boundary.names, proved.refined.y, root.y, proved.unique.box, strict=True)
        ],
        "only_one_within": [float(b.rad()) for b in proved.unique.box],
        "weights": proved.optimum.weights if proved.optimum.proved else None,
        "objective": _rounded_claim(proved.objective, arb(0), proved),
        "by_the_prover_alone": {
            "theorem": text,
            "distance": proved.distance,
            "statements": [
                {
                    "words": s.words,
                    "proved": s.proved,
                    "least": s.least if math.isfinite(s.least) else None,
                    "slack": s.slack,
                }
                for s in proved.statements
            ],
        },
    }
    return told | {"theorem": checked_sentence(told)}


def _rounded_claim(value: Ball, room: Ball, proved: ProvedExtremal) -> str:
    """A ball in fewer digits, and a little wider: another proof encloses it less closely."""
    with ctx.workprec(proved.settings.bits):
        return str((value + arb(0, room + _ROOM * value.abs_upper())).str(_CLAIMED))


def _exact_centre(value: Ball) -> str:
    """The centre of a ball, exactly: ``mantissa*2^exponent``."""
    mantissa, exponent = value.mid().man_exp()
    return f"{int(mantissa)}*2^{int(exponent)}"


def tape_document(problem: Problem) -> dict[str, Any]:
    """The problem as the proof takes it: names, exact numbers and tapes."""

    def limit(value: Any) -> Any:
        return value if isinstance(value, str) else _rational_text(value) if math.isfinite(value) else None

    def limits(bounded: Any) -> dict[str, Any]:
        return {"name": bounded.name, "lower": limit(bounded.lower), "upper": limit(bounded.upper)}

    phases = [
        {
            "name": phase.name,
            "duration": phase.duration,
            "states": [limits(state) for state in phase.states],
            "controls": [
                {"kind": c.kind, "names": list(c.names), **({} if c.kind == "direction" else limits(c))}
                for c in phase.controls
            ],
            "end": [limits(c) for c in phase.end_conditions],
            "path": [c.name for c in phase.path_conditions],
        }
        for phase in problem.phases
    ]
    wanted = ("dynamics", "end", "path", "links", "start", "objective")
    tapes = {
        _function_name(key): expression.tape.document()
        for key, expression in problem.form.expressions.items()
        if _function_name(key).split()[0] in wanted
    }
    return {
        "name": problem.name,
        "digest": problem.form.digest,
        "phases": phases,
        "given": {name: exact_value(given).document() for name, given in problem.given.items()},
        "free": [limits(f) for f in problem.free],
        "tapes": tapes,
    }


def _function_name(key: Any) -> str:
    """The name of a function: ``start``, ``dynamics 0``, ``links 0``."""
    if isinstance(key, str):
        return key
    k, name = key if isinstance(key[0], int) else key[::-1]
    return f"{name} {k}"


def _rational_text(value: float) -> str:
    return str(Fraction(float(value)))


Certificate = Mapping[str, Any]
