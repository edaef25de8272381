"""Flights of a phase's canonical equations: machine code for its modes, events where its controls switch.

Algebra first: entries of z that vanish on every extremal are set to zero, and what neither the wanted entries nor
their rates depend on is left out before anything is compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.kernels import Engine, Event, compile_arcs
from perilune.kernels.prune import prune
from perilune.pontryagin import PhaseExtremal


@dataclass(frozen=True, kw_only=True, eq=False)
class Equations:
    """What is integrated: the entries `kept` of z, one right-hand side for each mode, and the switches between them."""

    kept: NDArray[np.int64]
    modes: tuple[ca.Function, ...]
    switches: tuple[Event, ...]


@lru_cache(maxsize=256)
def equations(extremal: PhaseExtremal, wanted: tuple[int, ...], silent: tuple[int, ...]) -> Equations:
    """Equations for the entries of z that are `wanted` at the end, with the `silent` ones zero.

    An empty `wanted` keeps all of z.
    """
    size, numbers = extremal.modes[0].size1_in(0), extremal.modes[0].size1_in(1)
    kept = list(range(size))
    if wanted:
        fixed = dict.fromkeys(silent, 0.0)
        parts = [prune(mode, [*wanted, extremal.switching], fixed=fixed) for mode in extremal.modes]
        # What a mode holds constant may still be an unknown: it stays in z, for its columns.
        kept = sorted({i for part in parts for i in (*part.kept, *part.constant)} - set(silent))
    z, p = ca.SX.sym("z", len(kept)), ca.SX.sym("p", numbers)
    whole = ca.SX.zeros(size, 1)
    whole[kept] = z
    modes = tuple(ca.Function("rhs", [z, p], [ca.cse(ca.simplify(mode(whole, p)[kept]))]) for mode in extremal.modes)
    return Equations(kept=np.array(kept), modes=modes, switches=tuple(_switches(extremal, z, p, whole)))


@lru_cache(maxsize=256)
def engine(flown: Equations, columns: int) -> Engine:
    """Engine with the given number of variational columns, made once."""
    return compile_arcs(flown.modes, columns=columns, events=flown.switches)


def _switches(extremal: PhaseExtremal, z: ca.SX, p: ca.SX, whole: ca.SX) -> list[Event]:
    """Two events for each switched control: S rises through zero, off the upper bound; S falls, onto it."""
    events = []
    count = extremal.switching.size1_out(0)
    for i in range(count):
        function = ca.Function("S", [z, p], [extremal.switching(whole, p)[i]])
        upper = [mode for mode in range(2**count) if mode >> i & 1]
        events.append(Event(function=function, direction=1, switches={m: m & ~(1 << i) for m in upper}))
        events.append(Event(function=function, direction=-1, switches={m & ~(1 << i): m for m in upper}))
    return events
