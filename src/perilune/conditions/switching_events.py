"""Switching events: zeros of switching functions along the flight change the regime of the control.

- a scalar on a bound leaves it where the slope of H changes its sign: to the other bound where H is linear in it, or as
  far as a condition of the path allows;
- one in which H is nonlinear leaves a bound so for the interior, or jumps to the other bound where H is as small there,
  whichever comes first: the one where H is convex, the other where it is concave, as a costate may make it either;
- one that is between its bounds comes to one of them; where H may have several minima in it, it jumps from one to
  another where H is as small there, between the bounds or on one (two of a quartic H may lie between them);
- a condition of the path that the control ignores becomes violated: it is made active;
- the multiplier of an active condition falls to zero: the condition is released.

A condition of a direction is released where the minimising direction without it keeps it, which is the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from perilune.conditions.active_constraints import Held, depends_on_direction
from perilune.conditions.scalar_regimes import FREE, INSIDE, Bend, Scalar, least_squares_multipliers
from perilune.problem import Phase, Regime

Named = tuple[Held, tuple[Regime, ...]]  # of a mode


@dataclass(frozen=True, kw_only=True)
class SwitchingEvent:
    """A zero of `function` rising (+1) or falling (-1) leads from mode to mode; a `steady` one without a jump of u."""

    function: ca.SX
    direction: int
    steady: bool
    switches: dict[int, int]


@dataclass(kw_only=True)
class Mode:
    """One combination of regimes.

    Attributes
    ----------
    held, regimes
        The conditions and regimes that identify it.
    kinds
        Its scalars, directions in place.
    own
        Conditions of scalars only that are held, those of every mode among them, by name.
    H, control
        The Hamiltonian as an expression of the scalars, directions in place; the whole control.
    """

    held: Held
    regimes: tuple[Regime, ...]
    kinds: Sequence[Scalar]
    own: Mapping[str, ca.SX]
    H: ca.SX
    control: ca.SX

    @property
    def name(self) -> Named:
        """Return the name of the mode: its active conditions, and its regimes."""
        return self.held, self.regimes

    @cached_property
    def multiplier(self) -> dict[str, ca.SX]:
        """mu of `own`, expressions of the scalars."""
        scalars = ca.vertcat(*(kind.symbol for kind, regime in zip(self.kinds, self.regimes, strict=True)
                               if regime == "held"))  # fmt: skip
        mu = least_squares_multipliers(self.H, scalars, ca.vertcat(*self.own.values()))
        return {name: mu[i] for i, name in enumerate(self.own)}

    def slope(self, kind: Scalar) -> ca.SX:
        """Return dL/du of a scalar, L = H - mu.c with the active conditions c."""
        acting = {name: c for name, c in self.own.items() if ca.depends_on(c, kind.symbol)}
        pull = (self.multiplier[name] * ca.gradient(c, kind.symbol) for name, c in acting.items())
        return kind.slope - sum(pull, ca.SX(0.0))

    def turned(self, i: int, regime: Regime) -> tuple[Regime, ...]:
        """Return the regimes with another one for the i-th scalar.

        Parameters
        ----------
        i
            Index of the scalar, in the order of `kinds`.
        regime
            Its new regime.
        """
        return *self.regimes[:i], regime, *self.regimes[i + 1 :]


@dataclass(kw_only=True)
class ModeSwitches:
    """The transitions between all modes of a phase."""

    phase: Phase
    u: ca.SX
    modes: Sequence[Mode]
    kept: Mapping[str, ca.SX]
    size: ca.SX

    @cached_property
    def places(self) -> dict[Named, int]:
        """Number of each mode by its name."""
        return {mode.name: i for i, mode in enumerate(self.modes)}

    def transitions(self) -> list[SwitchingEvent]:
        """Return all transitions; the same function in several modes is one of them."""
        found: dict[tuple[str, int, bool], SwitchingEvent] = {}
        for mode in self.modes:
            for before, after, function, direction, steady in self._from(mode):
                key = _serialise_expression(function), direction, steady
                new = SwitchingEvent(function=function, direction=direction, steady=steady, switches={})
                found.setdefault(key, new).switches[self.places[before]] = self.places[after]
        return list(found.values())

    def _from(self, mode: Mode) -> Iterator[tuple[Named, Named, ca.SX, int, bool]]:
        for i, (kind, regime) in enumerate(zip(mode.kinds, mode.regimes, strict=True)):
            if len(kind.regimes) == 1 and regime != "held":
                continue
            ways = self._to_bounds(mode, i) if regime in FREE else self._off_bound(mode, i)
            for after, function, direction, steady in (*ways, *self._jumps(mode, i)):
                yield mode.name, after, function, direction, steady
        for name, condition in self.kept.items():
            if name in mode.held:
                if name in mode.own:
                    yield from self._let_go(mode, name)
                continue
            after = self._holding(mode, name)
            if after is not None:
                # The minimising control without the condition violates it from here on.
                function = ca.substitute(condition, self.u, mode.control)
                yield mode.name, after, function, -1, True
                if depends_on_direction(self.phase, condition, self.u):  # or no longer does
                    yield after, mode.name, function, 1, True

    def _to_bounds(self, mode: Mode, i: int) -> Iterator[tuple[Named, ca.SX, int, bool]]:
        """Yield transitions of a scalar from between its bounds to one, where it can hold no condition."""
        kind, value = mode.kinds[i], mode.control[mode.kinds[i].at]
        others = tuple(n for n in mode.held if n not in mode.own or not ca.depends_on(mode.own[n], kind.symbol))
        sides: tuple[tuple[Regime, int], ...] = (("upper", 1), ("lower", -1))
        for side, direction in sides:
            for held in dict.fromkeys((mode.held, others)):
                after = held, mode.turned(i, side)
                if after in self.places:
                    yield after, value - kind.value(side), direction, True
                    break

    def _off_bound(self, mode: Mode, i: int) -> Iterator[tuple[Named, ca.SX, int, bool]]:
        """Yield transitions of a scalar off a bound."""
        kind, regime = mode.kinds[i], mode.regimes[i]
        slope, direction = ca.substitute(mode.slope(kind), self.u, mode.control), 1 if regime == "upper" else -1
        bent: tuple[Regime, ...] = ("held", *INSIDE)
        other: Regime = "lower" if regime == "upper" else "upper"
        after, gain = (mode.held, mode.turned(i, other)), slope
        for between in bent:
            if (inside := (mode.held, mode.turned(i, between))) in self.places:
                if between == "held" or not kind.weighed or after not in self.places:
                    yield inside, slope, direction, True
                    return
                bend, never = self._bend(mode, i), ca.SX(0.0)
                if kind.quartic:
                    low = ca.substitute(kind.third, self.u, mode.control) < 0
                    never = ca.logic_not(low) if between == "low_interior" else low
                yield inside, ca.if_else(ca.logic_or(bend.none, never), -direction, slope), direction, True
                gain = ca.if_else(bend.hollow, -direction, bend.gain)
        if after not in self.places:
            return
        there, free = self.modes[self.places[after]].control, ca.SX(1.0)
        for name, condition in self.kept.items():
            stopped = self._holding(self.modes[self.places[after]], name)
            if name not in mode.held and stopped is not None and stopped[1][i] == "held":
                kept = ca.substitute(condition, self.u, there) >= 0
                yield stopped, ca.if_else(kept, -direction, gain), direction, False
                free = ca.logic_and(free, kept)
        yield after, gain if free.is_constant() else ca.if_else(free, gain, -direction), direction, False

    def _bend(self, mode: Mode, i: int) -> Bend:
        """Return the curvature of H in a scalar, with the minima between its bounds where there may be several."""
        kind, inner = mode.kinds[i], dict[Regime, ca.SX]()
        for between in INSIDE if kind.curved_both_ways else ():
            if (inside := (mode.held, mode.turned(i, between))) in self.places:
                inner[between] = self.modes[self.places[inside]].control[kind.at]
        return Bend(kind=kind, H=mode.H, u=self.u, control=mode.control, size=self.size, inner=inner)

    def _jumps(self, mode: Mode, i: int) -> Iterator[tuple[Named, ca.SX, int, bool]]:
        """Yield jumps of a scalar to another minimum of H, between its bounds or on one, where H is as small."""
        kind, own = mode.kinds[i], mode.regimes[i]
        if not kind.curved_both_ways or own == "held":
            return
        bend = self._bend(mode, i)
        for other in bend.values:
            after = mode.held, mode.turned(i, other)
            if other == own or after not in self.places or not {own, other} & {*INSIDE}:
                continue
            apart, drop = bend.drop(own, other)
            yield after, ca.if_else(apart, drop, -1.0), 1, False
            if own in INSIDE and other in INSIDE:  # of one minimum the two are the same: its name changes
                third = ca.substitute(kind.third, self.u, mode.control)
                yield after, third, 1 if own == "low_interior" else -1, True

    def _holding(self, mode: Mode, name: str) -> Named | None:
        """Return the mode in which a condition is active as well, or instead of others kept by the same scalars."""
        condition = self.kept[name]
        acting = [i for i, kind in enumerate(mode.kinds) if ca.depends_on(condition, kind.symbol)]
        regimes: tuple[Regime, ...] = mode.regimes
        if not depends_on_direction(self.phase, condition, self.u):
            between = [i for i in acting if regimes[i] in FREE] or acting[:1]
            for i in between:
                regimes = *regimes[:i], "held", *regimes[i + 1 :]
        rivals = {n for n, c in mode.own.items() if any(ca.depends_on(c, mode.kinds[i].symbol) for i in acting)}
        for held in ({*mode.held, name}, {*mode.held, name} - rivals):
            after = tuple(n for n in self.kept if n in held), regimes
            if after in self.places:
                return after
        return None

    def _let_go(self, mode: Mode, name: str) -> Iterator[tuple[Named, Named, ca.SX, int, bool]]:
        """Yield transitions where the multiplier of a condition of scalars falls to zero."""
        held, condition = tuple(n for n in mode.held if n != name), mode.own[name]
        rest = [c for n, c in mode.own.items() if n != name]
        regimes, jumps = list(mode.regimes), list[int]()
        for i, kind in enumerate(mode.kinds):
            if regimes[i] == "held" and not any(ca.depends_on(c, kind.symbol) for c in rest):
                regimes[i] = "interior"
                jumps += [i] * kind.linear
        mu = ca.substitute(mode.multiplier[name], self.u, mode.control)
        if not jumps:
            after = held, tuple(regimes)
            if after in self.places:
                yield mode.name, after, mu, -1, True
            return
        if len(jumps) > 1:
            return
        (i,) = jumps
        rises = ca.substitute(ca.gradient(condition, mode.kinds[i].symbol), self.u, mode.control) > 0
        sides: tuple[tuple[Regime, ca.SX], ...] = (("upper", rises), ("lower", ca.logic_not(rises)))
        for side, there in sides:
            regimes[i] = side
            after = held, tuple(regimes)
            if after in self.places:
                yield mode.name, after, ca.if_else(there, mu, 1.0), -1, False


def _serialise_expression(expression: ca.SX) -> str:
    symbols = ca.symvar(expression)
    return ca.Function("f", symbols, [expression]).serialize()
