"""Deorbit opportunities over a site, for people as a table and for programs as a document."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from perilune.models import DOUBTFUL, OUT_OF_REACH, REACHABLE, Opportunity

_HEAD = f"{'ignition':>21} {'landing':>10}  {'pass':10} {'off the plane':>22} {'turn':>9} {'delta-V':>11}  verdict"


def opportunities_answer(found: Sequence[Opportunity], *, every: bool) -> tuple[dict[str, Any], str]:
    """Return a document for programs with all passes, and a table of those that can be flown, or of all.

    Parameters
    ----------
    found
        The passes, in the order of time.
    every
        True for a table of all of them.
    """
    return _opportunities_document(found), _opportunities_text(found, every=every)


def _opportunities_document(found: Sequence[Opportunity]) -> dict[str, Any]:
    """Return all passes with their numbers in SI and radians; None for numbers of a pass that no turn reaches."""
    rows = [
        {**vars(one), "utc": one.utc and f"{one.utc:%Y-%m-%dT%H:%M:%SZ}", "settings": dict(one.settings)}
        for one in found
    ]
    for row in rows:
        row |= {name: row[name] if math.isfinite(row[name]) else None for name in ("plane_change", "velocity_change")}
    return {"opportunities": rows}


def _opportunities_text(found: Sequence[Opportunity], *, every: bool) -> str:
    """Return a table of the passes that can be made, or of all, and the command that solves the first.

    Parameters
    ----------
    found
        Passes in order of time.
    every
        List those out of reach as well.
    """
    shown = [one for one in found if every or one.verdict != OUT_OF_REACH]
    if not shown:
        return f"none of {len(found)} passes can be flown"
    lines = [_HEAD, *map(_opportunity_row, shown)]
    good = (next((one for one in shown if one.verdict == verdict), None) for verdict in (REACHABLE, DOUBTFUL))
    best = next(filter(None, good), None)
    if not every and len(shown) < len(found):
        lines.append(f"{len(found) - len(shown)} more are out of reach: --all")
    if best is not None:
        changes = " ".join(f'--set "{key}={value}"' for key, value in best.settings.items())
        lines += [
            f"all propellant gives {best.available_velocity_change:.1f} m/s; of the first that is {best.verdict}:"
        ]
        lines += [f"  perilune solve FILE {changes}"]
    return "\n".join(lines)


def _opportunity_row(one: Opportunity) -> str:
    when = f"{one.utc:%Y-%m-%d %H:%M:%S}Z" if one.utc is not None else f"{one.ignition / 3600:.3f} h"
    side = "left" if one.out_of_plane_angle > 0 else "right"
    off = f"{math.degrees(abs(one.out_of_plane_angle)):.2f} deg {one.distance / 1e3:.0f} km {side}"
    turn = f"{math.degrees(one.plane_change):.2f} deg" if math.isfinite(one.plane_change) else "-"
    change = f"{one.velocity_change:.0f} m/s" if math.isfinite(one.velocity_change) else "-"
    after = f"{one.landing / 3600:.3f} h"
    return f"{when:>21} {after:>10}  {one.going:10} {off:>22} {turn:>9} {change:>11}  {one.verdict}"
