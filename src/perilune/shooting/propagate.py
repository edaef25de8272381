"""Propagation of canonical equations: machine code for each mode, events at the switches of its controls.

Algebra first: entries of z that vanish on every extremal are set to zero, and what neither the wanted entries nor
their rates depend on is left out before anything is compiled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from perilune.conditions import PhaseExtremal
from perilune.core import Matrix, Vector
from perilune.kernels import Arcs, DenseArc, Engine, Event, compile_arcs, prune


@dataclass(frozen=True, kw_only=True, eq=False)
class Equations:
    """Equations of integration: the entries `kept` of z, a right-hand side for each mode, the switches between them.

    They take only the parameters that they depend on, `numbers`: problems that differ in others share the code.
    """

    kept: NDArray[np.int64]
    numbers: NDArray[np.int64]
    modes: tuple[ca.Function, ...]
    solved: tuple[ca.Function | None, ...]
    switches: tuple[Event, ...]


@lru_cache(maxsize=256)
def reduced_equations(extremal: PhaseExtremal, wanted: tuple[int, ...], silent: tuple[int, ...]) -> Equations:
    """Return equations for the entries of z that are `wanted` at the end, with the `silent` ones zero.

    An empty `wanted` keeps all of z.

    Parameters
    ----------
    extremal
        The canonical equations of the phase.
    wanted
        Entries of z that are asked for at the end.
    silent
        Entries that are zero all along.
    """
    size, numbers = extremal.modes[0].size1_in(0), extremal.modes[0].size1_in(1)
    kept = list(range(size))
    if wanted:
        fixed = dict.fromkeys(silent, 0.0)
        switching = [f for event in extremal.events for f in (event.function, event.jump) if f is not None]
        parts = [prune(mode, [*wanted, *switching], fixed=fixed) for mode in extremal.modes]
        # An entry that a mode holds constant may still be an unknown: it stays in z, for its columns.
        kept = sorted({i for part in parts for i in (*part.kept, *part.constant)} - set(silent))
    z, p = ca.SX.sym("z", len(kept)), ca.SX.sym("p", numbers)
    whole = ca.SX.zeros(size, 1)
    whole[kept] = z
    rates = [ca.simplify(mode(whole, p)[kept]) for mode in extremal.modes]
    crossings = [ca.simplify(event.function(whole, p)) for event in extremal.events]
    jumps = [None if event.jump is None else ca.simplify(event.jump(whole, p)[kept]) for event in extremal.events]
    used = ca.vertcat(*rates, *crossings, *(jump for jump in jumps if jump is not None))
    known = [i for i in range(numbers) if ca.depends_on(used, p[i])]
    modes, solved = list[ca.Function](), list[ca.Function | None]()
    for rate, found in zip(rates, extremal.solved, strict=True):
        w = ca.SX(0, 1)
        if found is None:
            solved.append(None)
        else:  # the control is solved for inside the arc: derivatives need not go through Newton's method
            values = found[0](whole, p)
            w = ca.SX.sym("w", values.numel())
            rate = found[1](whole, ca.vertcat(p, w))[kept]
            solved.append(_own_symbols("solved", [z, p[known]], values))
        modes.append(_own_symbols("rhs", [z, ca.vertcat(p[known], w)], ca.cse(rate)))
    switches = tuple(
        replace(
            event,
            function=_own_symbols("S", [z, p[known]], S),
            jump=None if jump is None else _own_symbols("jump", [z, p[known]], jump),
        )
        for event, S, jump in zip(extremal.events, crossings, jumps, strict=True)
    )
    return Equations(
        kept=np.array(kept),
        numbers=np.array(known, dtype=int),
        modes=tuple(modes),
        solved=tuple(solved),
        switches=switches,
    )


def _own_symbols(name: str, arguments: list[ca.SX], value: ca.SX) -> ca.Function:
    """Return a function of symbols that tell nothing of p: equations that differ in no more are compiled once."""
    own = [ca.SX.sym(f"a{i}", a.numel()) for i, a in enumerate(arguments)]
    return ca.Function(name, own, ca.Function(name, arguments, [value]).call(own))


Pattern = tuple[tuple[bool, ...], ...]  # which entries of the columns S(0) may be nonzero, row by row


@lru_cache(maxsize=256)
def arc_engine(flown: Equations, seeds: Pattern = ()) -> Engine:
    """Return the engine with the variational columns that such seeds need, which is made once.

    Parameters
    ----------
    flown
        Canonical equations with their modes and switches.
    seeds
        Which entries of dz(0)/dw may be nonzero, rows of bool, shape (nz, nc); none for no variational columns.
    """
    return compile_arcs(
        flown.modes, solved=flown.solved, columns=np.array(seeds) if seeds else 0, events=flown.switches
    )


def propagate_arc(
    extremal: PhaseExtremal, z0: Vector, p: Vector, duration: float, states_only: bool = False, /, **settings: float
) -> DenseArc:
    """Propagate z along one arc.

    Parameters
    ----------
    extremal
        The canonical equations of the phase.
    z0
        State and costate at the start, canonical, (nz,).
    p
        Numbers of the canonical equations, `extremal_parameters`.
    duration
        Duration of the arc, canonical.
    states_only
        True if costates that do not act upon the states are left out.
    settings
        As for the engine's `dense`.

    Returns
    -------
    DenseArc
        z, or its first entries, as a function of time.
    """
    flown = reduced_equations(extremal, tuple(range(extremal.half)) if states_only else (), ())
    mode = mode_at(extremal, z0, p)
    return arc_engine(flown).dense(z0[flown.kept], p[flown.numbers], duration, mode=mode, **settings)


def propagate_lanes(
    extremal: PhaseExtremal, z: Matrix, p: Matrix, duration: Vector, mode: NDArray[np.int64], **settings: float
) -> Arcs:
    """Propagate all of z along arcs, in lanes.

    Parameters
    ----------
    extremal
        The canonical equations of the phase.
    z
        States and costates at the starts, canonical, (lanes, nz).
    p
        Numbers of the canonical equations, (np,), (1, np) or (lanes, np).
    duration
        Durations, canonical, (lanes,).
    mode
        Modes at the starts, (lanes,).
    settings
        As for the engine's `propagate`.
    """
    whole = reduced_equations(extremal, (), ())
    return arc_engine(whole).propagate(z, p[..., whole.numbers], duration, mode=mode, **settings)


def mode_at(extremal: PhaseExtremal, z: Vector, p: Vector) -> int:
    """Return the mode in which H is least at a point.

    Parameters
    ----------
    extremal
        The canonical equations of the phase.
    z
        State and costate, canonical, (nz,).
    p
        Numbers of the canonical equations.
    """
    return int(extremal.mode(z, p)) if len(extremal.modes) > 1 else 0
