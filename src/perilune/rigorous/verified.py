"""Level 5 of a verification: its checks, the theorem among its notes, and the certificate."""

from __future__ import annotations

from dataclasses import replace

from perilune.core import Watch, ignore_events
from perilune.problem import THEOREM, Check, Solution, Verification
from perilune.rigorous.statement import certificate_document, theorem_text, unproved_sentence
from perilune.rigorous.theorem import Attempt, ProvedExtremal, attempt_proof

_FAR = 1e-6  # of an unknown: an extremal that is farther away is another one


def add_theorem_checks(verification: Verification, solution: Solution, watch: Watch | None = None) -> Verification:
    """A verification with what of level 5 can be proved; what cannot is a note, and changes no other level.

    Parameters
    ----------
    verification
        Of levels 1 to 3.
    solution
        What was verified.
    watch
        Receives a line for every part.
    """
    return add_attempt(verification, attempt_proof(solution, watch or ignore_events))


def add_attempt(verification: Verification, found: Attempt) -> Verification:
    """Return the verification with the result of an attempt.

    Parameters
    ----------
    verification
        Checks of the levels below.
    found
        What an attempt at a theorem proved, or why it proved nothing.
    """
    if found.proved is None:
        return _note_no_theorem(verification, found.unsaid)
    if not found.proved.distance <= _FAR:
        return _note_no_theorem(
            verification, f"near the answer only another extremal is proved, {found.proved.distance:.2g} away"
        )
    if found.proved.missing:
        return _note_no_theorem(verification, unproved_sentence(found.proved.missing))
    text = theorem_text(found.proved)
    return replace(
        verification,
        checks=(*verification.checks, *_theorem_checks(found.proved)),
        notes=(text, *verification.notes),
        certificate=certificate_document(found.proved, text),
    )


def _note_no_theorem(verification: Verification, why: str) -> Verification:
    return replace(verification, notes=(f"no theorem: {why}", *verification.notes))


def _theorem_checks(proved: ProvedExtremal) -> tuple[Check, ...]:
    return (
        Check(
            name="extremal_proved", level=THEOREM, value=proved.root.contraction, limit=1.0, unit="1",
            meaning="contraction of Krawczyk's operator on a box: below 1 it holds exactly one extremal",
        ),
        Check(
            name="distance_proved", level=THEOREM, value=proved.distance, limit=_FAR, unit="1",
            meaning="distance of the answer from the proved extremal, the largest over the unknowns relative to their"
            " magnitude",
        ),
        Check(
            name="limits_proved", level=THEOREM, value=float(len(proved.missing)), limit=0.0, unit="1",
            meaning=f"of {len(proved.statements)} statements on limits and the minimum of H those not proved",
        ),
    )  # fmt: skip
