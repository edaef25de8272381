"""Equations of an arc with its variational columns, as programs, and the events along it.

An event is a zero of g(z, p), at which the arc ends, or goes on in another mode of the dynamics (thrust off, next
layer of the atmosphere) and from another state if the event has a jump.

With Y = (z, S) stacked, the field of mode m is (f_m(z, p), df_m/dz S), by CasADi's differentiation of the
traced right-hand side. At an event g = 0 that switches mode i to j and maps z to J(z) the columns jump by the
saltation matrix

    S+ = [dJ/dz + (f_j(z+) - dJ/dz f_i(z-)) (dg/dz) / (dg/dz f_i(z-))] S-.

Source: Hiskens & Pai, *Trajectory sensitivity analysis of hybrid systems*, IEEE Trans. CAS-I 47 (2000), eqs
(24)-(30). Entries of S that are zero for every arc, by the sparsity of df/dz and of the seeds, are left out
of Y.

A mode may need numbers w(z, p) that an iteration finds (a control with no closed form). The iteration is not
differentiated: the mode closes with a Newton step from w, whose partial derivative by z is then the total one
(Griewank & Walther, *Evaluating Derivatives*, 2nd ed., SIAM 2008, section 15.3), and w is put in afterwards.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perilune.core import PeriluneError
from perilune.kernels.algebra.program import Program, trace_function


@dataclass(frozen=True, kw_only=True)
class Event:
    """A zero crossing to be located.

    Parameters
    ----------
    function
        SX ``casadi.Function`` (z, p) -> g, a scalar, smooth near its zero.
    levels
        Where it occurs at another value of g than 0: mode -> value.
    direction
        -1: g falls through zero as the flight proceeds, +1: rises, 0: either.
    terminal
        Whether the arc ends there.
    switches
        Mode before -> mode after. An event that switches is watched in the modes it names, others in every
        mode.
    jump
        SX ``casadi.Function`` (z, p) -> z after the event; None for a continuous state.
    steady
        Whether the rates of the two modes agree at the event, so that nothing is carried over it. A flight may then
        touch the zero without crossing it.
    """

    function: Any
    direction: int = 0
    terminal: bool = False
    switches: Mapping[int, int] = field(default_factory=dict)
    jump: Any = None
    steady: bool = False
    levels: Mapping[int, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the direction and that something happens only once."""
        if self.direction not in (-1, 0, 1):
            raise PeriluneError("the direction of an event", got=str(self.direction), expected="-1, 0 or 1")
        if self.terminal and (self.switches or self.jump is not None):
            raise PeriluneError(
                "an event cannot end the arc and change its dynamics as well",
                advice="drop terminal=True, or the switches and the jump",
            )

    def watched(self, mode: int) -> bool:
        """Return True if the event is looked for in a mode."""
        return mode in self.switches if self.switches else True


@dataclass(frozen=True, kw_only=True, eq=False)
class ArcSystem:
    """Right-hand sides, events and the pattern of the seeds.

    Parameters
    ----------
    modes
        SX functions (z, p) -> z', one for each mode; (z, [p; w]) -> z' where w is solved for.
    solved
        For each mode None or an SX function (z, p) -> w, k numbers. Derivatives of the mode are taken at fixed w.
    events
        Events, in the order of their indices.
    seeds
        Which entries of S(0) may be nonzero, bool (nz, nc).
    """

    modes: tuple[Any, ...]
    solved: tuple[Any | None, ...]
    events: tuple[Event, ...]
    seeds: NDArray[np.bool_]

    def __post_init__(self) -> None:
        """Check that modes, what they solve for and events speak of the same z and p."""
        if len(self.solved) != len(self.modes):
            raise PeriluneError(
                "each mode states the unknowns it solves for",
                got=f"{len(self.solved)} entries",
                expected=str(len(self.modes)),
            )
        taken = [(mode, self._unknowns(i)) for i, mode in enumerate(self.modes)]
        taken += [
            (function, 0) for function in (*self.solved, *(e.function for e in self.events)) if function is not None
        ]
        for function, unknowns in taken:
            sizes = (function.size1_in(0), function.size1_in(1) - unknowns)
            if sizes != (self.nz, self.np):
                raise PeriluneError(
                    f"{function.name()!r} has a z or p of another shape than the first right-hand side",
                    got=str(sizes),
                    expected=str((self.nz, self.np)),
                )
        for event in self.events:
            named = {*event.switches, *event.switches.values()}
            if not named <= set(range(len(self.modes))):
                raise PeriluneError(
                    "an event switches between modes that do not exist",
                    got=str(dict(event.switches)),
                    expected=f"modes 0 to {len(self.modes) - 1}",
                )

    @cached_property
    def nz(self) -> int:
        """Number of entries of z."""
        return self.modes[0].size1_in(0)

    @cached_property
    def np(self) -> int:
        """Number of parameters."""
        return self.modes[0].size1_in(1) - self._unknowns(0)

    @cached_property
    def nc(self) -> int:
        """Number of columns."""
        return self.seeds.shape[1]

    def without_columns(self) -> ArcSystem:
        """Return the same arcs without S."""
        return replace(self, seeds=np.zeros((self.nz, 0), dtype=bool))

    @cached_property
    def key(self) -> str:
        """Digest of the expressions: equal for equal traced systems."""
        digest = hashlib.sha256()
        for function in (*self.modes, *self.solved):
            digest.update(_serialise_function(function))
        for event in self.events:
            ways = sorted(event.switches.items()), sorted(event.levels.items())
            digest.update(repr((event.direction, event.terminal, event.steady, *ways)).encode())
            for function in (event.function, event.jump):
                digest.update(_serialise_function(function))
        digest.update(repr(self.seeds.shape).encode() + self.seeds.tobytes())
        return digest.hexdigest()

    @cached_property
    def pattern(self) -> Any:
        """Sparsity of S along the arc: the seeds', closed under the dynamics and the jumps."""
        import casadi as ca

        rows, columns = np.nonzero(self.seeds)
        pattern = ca.Sparsity.triplet(self.nz, self.nc, rows.tolist(), columns.tolist())
        while True:
            grown = pattern
            for mode in self.modes:
                grown = _fill_in_pattern(grown, _rate_jacobian(mode).sparsity())
            for event, before in self.carried:
                slope, change, gradient = self._saltation(event, before)[2]
                grown = _fill_in_pattern(grown, (slope + ca.mtimes(change, gradient)).sparsity())
            if grown.nnz() == pattern.nnz():
                return pattern
            pattern = grown

    @property
    def offsets(self) -> NDArray[np.int64]:
        """Return the places of the entries of S kept in Y in a (nz, nc) array, row by row."""
        rows, columns = self.pattern.get_triplet()
        return np.array(rows, dtype=np.int64) * self.nc + np.array(columns, dtype=np.int64)

    @property
    def size(self) -> int:
        """Length of Y."""
        return self.nz + self.pattern.nnz()

    @property
    def transitions(self) -> list[tuple[int, int, int]]:
        """(event, mode before, mode after) of every event that changes something without ending the arc."""
        found = []
        for number, event in enumerate(self.events):
            if event.switches:
                found += [(number, i, j) for i, j in sorted(event.switches.items())]
            elif event.jump is not None:
                found += [(number, i, i) for i in range(len(self.modes))]
        return found

    # -- functions
    # -------------------------------------------------------------------------------------------------
    def field(self, mode: int) -> list[Any]:
        """Return (Y, p) -> Y' in the two forms worth comparing: the Jacobian times S, and directional."""
        import casadi as ca

        y, z, columns, p = self._symbols()
        w = ca.SX.sym("w", self._unknowns(mode))
        rate = ca.densify(self.modes[mode](z, ca.vertcat(p, w)))
        forms = [rate]
        if self.size > self.nz:
            products = ca.mtimes(ca.jacobian(rate, z), columns), ca.jtimes(rate, z, columns)
            forms = [ca.vertcat(rate, ca.project(product, self.pattern).nz[:]) for product in products]
        found = self._found(mode, z, p)
        return [
            ca.Function(f"field{mode}", [y, p], ca.Function("at_fixed", [y, p, w], [form]).call([y, p, found]))
            for form in forms
        ]

    def crossings(self) -> Any:
        """Return (z, z', mode, p) -> (g, g') of all events, g counted from its level."""
        import casadi as ca

        z, rate, p, mode = (
            ca.SX.sym("z", self.nz),
            ca.SX.sym("rate", self.nz),
            ca.SX.sym("p", self.np),
            ca.SX.sym("mode"),
        )
        values = []
        for event in self.events:
            level = ca.SX(0.0)
            for number, value in event.levels.items():
                level = ca.if_else(mode == number, value, level)
            values.append(event.function(z, p) - level)
        g = ca.densify(ca.vertcat(*values))
        return ca.Function("crossings", [z, rate, mode, p], [ca.vertcat(g, ca.densify(ca.jtimes(g, z, rate)))])

    @property
    def course(self) -> str:
        """Return a key of how events are located, whatever they are: all that the stepping loop depends on."""
        met = [
            (e.direction, e.terminal, e.steady, bool(e.levels), *map(e.watched, range(len(self.modes))))
            for e in self.events
        ]
        return repr((met, self.transitions, self.carried))

    @property
    def carried(self) -> list[tuple[int, int]]:
        """(event, mode before) of the transitions that change Y."""
        return [(event, before) for event, before, _ in self.transitions if not self.events[event].steady]

    def transition(self, event: int, before: int) -> Any:
        """Return (Y, p) -> Y after an event in a mode, one of those `carried`.

        Parameters
        ----------
        event
            Index of the event in `events`.
        before
            Mode of the dynamics in which the arc meets the event.

        Returns
        -------
        casadi.Function
            Of Y = (z, kept entries of S) and p: z is mapped by the jump, S by the saltation matrix.
        """
        import casadi as ca

        z, p, (slope, change, gradient), after = self._saltation(event, before)
        y, _, columns, _ = self._symbols()
        whole = ca.Function("at", [z, p], [after, slope, change, gradient])(y[: self.nz], p)
        new = [ca.densify(whole[0])]
        if self.size > self.nz:
            # One product with the gradient for each column: the matrix itself would take one for each entry.
            moved = ca.mtimes(whole[1], columns) + ca.mtimes(whole[2], ca.mtimes(whole[3], columns))
            new.append(ca.project(moved, self.pattern).nz[:])
        return ca.Function(f"transition{event}_{before}", [y, p], [ca.vertcat(*new)])

    def _saltation(self, number: int, before: int) -> tuple[Any, Any, tuple[Any, Any, Any], Any]:
        """Return z, p, the parts of dJ/dz + change gradient, and the state after."""
        import casadi as ca

        event = self.events[number]
        z, p = ca.SX.sym("z", self.nz), ca.SX.sym("p", self.np)
        after = event.jump(z, p) if event.jump is not None else z
        slope = ca.jacobian(after, z)
        old, new = (
            self.modes[mode](at, ca.vertcat(p, self._found(mode, at, p)))
            for mode, at in ((before, z), (event.switches.get(before, before), after))
        )
        gradient = ca.jacobian(event.function(z, p), z)
        change = (new - ca.mtimes(slope, old)) / ca.mtimes(gradient, old)
        return z, p, (slope, change, gradient), after

    def _unknowns(self, mode: int) -> int:
        solved = self.solved[mode]
        return solved.size1_out(0) if solved is not None else 0

    def _found(self, mode: int, z: Any, p: Any) -> Any:
        """Return w of a mode, (k, 1)."""
        import casadi as ca

        solved = self.solved[mode]
        return ca.densify(solved(z, p)) if solved is not None else ca.SX(0, 1)

    def _symbols(self) -> tuple[Any, Any, Any, Any]:
        import casadi as ca

        y, p = ca.SX.sym("Y", self.size), ca.SX.sym("p", self.np)
        return y, y[: self.nz], ca.SX(self.pattern, y[self.nz :]), p

    # -- programs
    # --------------------------------------------------------------------------------------------------
    def field_program(self, mode: int) -> Program:
        """Return the shorter form of the field: reading both would give the same in three times the time."""
        return trace_function(min(self.field(mode), key=lambda form: form.n_instructions()))


def _serialise_function(function: Any) -> bytes:
    return function.serialize().encode() if function is not None else b"none"


def _rate_jacobian(function: Any) -> Any:
    import casadi as ca

    z, p = ca.SX.sym("z", function.size1_in(0)), ca.SX.sym("p", function.size1_in(1))
    return ca.jacobian(function(z, p), z)


def _fill_in_pattern(pattern: Any, factor: Any) -> Any:
    """Return the pattern of S + factor S."""
    import casadi as ca

    return pattern.unite(ca.mtimes(ca.DM.ones(factor), ca.DM.ones(pattern)).sparsity())
