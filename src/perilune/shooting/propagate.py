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

from perilune.conditions.pontryagin import PhaseExtremal
from perilune.kernels import DenseArc, Engine, Event, compile_arcs, prune
from perilune.words.types import Vector


@dataclass(frozen=True, kw_only=True, eq=False)
class Equations:
    """What is integrated: the entries `kept` of z, one right-hand side for each mode, and the switches between them.

    They take only those of the parameters that they know, `numbers`: problems that differ in others share the code.
    """

    kept: NDArray[np.int64]
    numbers: NDArray[np.int64]
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
    rates = [ca.simplify(mode(whole, p)[kept]) for mode in extremal.modes]
    switching = extremal.switching(whole, p)
    known = [i for i in range(numbers) if ca.depends_on(ca.vertcat(*rates, switching), p[i])]
    modes = tuple(ca.Function("rhs", [z, p[known]], [ca.cse(rate)]) for rate in rates)
    crossings = [ca.Function("S", [z, p[known]], [switching[i]]) for i in range(switching.numel())]
    return Equations(
        kept=np.array(kept), numbers=np.array(known, dtype=int), modes=modes, switches=tuple(_switches(crossings))
    )


@lru_cache(maxsize=256)
def engine(flown: Equations, columns: int) -> Engine:
    """Engine with the given number of variational columns, made once."""
    return compile_arcs(flown.modes, columns=columns, events=flown.switches)


def flight(extremal: PhaseExtremal, z0: Vector, p: Vector, duration: float, **settings: float) -> DenseArc:
    """All of z along one arc, as a function of time; settings as for the engine's `dense`."""
    whole = equations(extremal, (), ())
    return engine(whole, 0).dense(z0, p[whole.numbers], duration, mode=extremal.mode(z0, p), **settings)


def _switches(crossings: list[ca.Function]) -> list[Event]:
    """Two events for each switched control: S rises through zero, off the upper bound; S falls, onto it."""
    events = []
    for i, function in enumerate(crossings):
        upper = [mode for mode in range(2 ** len(crossings)) if mode >> i & 1]
        events.append(Event(function=function, direction=1, switches={m: m & ~(1 << i) for m in upper}))
        events.append(Event(function=function, direction=-1, switches={m & ~(1 << i): m for m in upper}))
    return events
