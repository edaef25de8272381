"""Flights of a phase's canonical equations: machine code for its modes, events where its controls switch."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from perilune.kernels import Engine, Event, compile_arcs
from perilune.pontryagin import PhaseExtremal


@lru_cache(maxsize=256)
def engine(extremal: PhaseExtremal, columns: int) -> Engine:
    """Engine of a phase with the given number of variational columns, made once."""
    return compile_arcs(extremal.modes, columns=columns, events=_switches(extremal))


def _switches(extremal: PhaseExtremal) -> list[Event]:
    """Two events for each switched control: S rises through zero, off the upper bound; S falls, onto it."""
    events = []
    z, p = ca.SX.sym("z", extremal.switching.size1_in(0)), ca.SX.sym("p", extremal.switching.size1_in(1))
    count = extremal.switching.size1_out(0)
    for i in range(count):
        function = ca.Function("S", [z, p], [extremal.switching(z, p)[i]])
        upper = [mode for mode in range(2**count) if mode >> i & 1]
        events.append(Event(function=function, direction=1, switches={m: m & ~(1 << i) for m in upper}))
        events.append(Event(function=function, direction=-1, switches={m & ~(1 << i): m for m in upper}))
    return events
