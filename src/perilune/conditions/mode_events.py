"""Modes of the canonical equations of a phase, and the events that lead from one to another.

A mode is a regime for each scalar control and a side for each kink of the dynamics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import accumulate

import casadi as ca

from perilune.conditions.control_law import ControlLaw
from perilune.kernels import Event
from perilune.problem import Kinked

_REFRACTIONS = 7  # steps of Newton's method for the costate behind a surface; a step too many changes nothing


def number_of_mode(dynamics: Kinked, laws: list[ControlLaw], flows: list[ca.SX], z: ca.SX) -> ca.SX:
    """Return the number of the mode at a point: the side of each choice, and there the regimes in which H is least.

    Exactly on a knot it is the side to which the flight moves.

    Parameters
    ----------
    dynamics
        Dynamics on each side of their kinks.
    laws
        Control law on each side, in the order of `dynamics.sides`.
    flows
        z' in each mode, expressions of shape (nz, 1): the modes of one law after the other.
    z
        States and costates, symbols of shape (nz, 1), canonical.
    """
    number, first = ca.SX(0.0), 0
    for sides, law in zip(dynamics.sides, laws, strict=True):
        own = flows[first : first + len(law.control)]
        flow = select_by_mode(own, law.mode)

        def beyond(margin: ca.SX, flow: ca.SX = flow) -> ca.SX:
            rate = ca.jtimes(margin, z, flow)
            rate_of_rate = ca.jtimes(rate, z, flow)
            return ca.if_else(margin == 0, ca.if_else(rate == 0, rate_of_rate, rate), margin) > 0

        here = ca.SX(1.0)
        for side, choice in zip(sides, dynamics.choices, strict=True):
            if side:
                here = ca.logic_and(here, beyond(choice.argument - choice.knots[side - 1]))
            if side < len(choice.knots):
                here = ca.logic_and(here, ca.logic_not(beyond(choice.argument - choice.knots[side])))
        number = ca.if_else(here, first + law.initial_mode(z, own), number)
        first += len(law.control)
    return number


def select_by_mode(values: list[ca.SX], mode: ca.SX) -> ca.SX:
    """Return the value that belongs to the number of a mode.

    Parameters
    ----------
    values
        Expressions of one shape, in the order of the modes.
    mode
        Number of the mode, an expression; values[0] stands for any number that is none.
    """
    chosen = values[0]
    for k, value in enumerate(values[1:], 1):
        chosen = ca.if_else(mode == k, value, chosen)
    return chosen


def events_between_modes(
    dynamics: Kinked, laws: list[ControlLaw], flows: list[ca.SX], z: ca.SX, function: Callable[..., ca.Function]
) -> Iterator[Event]:
    """Yield the events that lead from mode to mode: the control's transitions, kinks, and jumps of the rates.

    Parameters
    ----------
    dynamics, laws, flows, z
        As for `number_of_mode`.
    function
        ``function(name, expression)`` makes a function of z and p of an expression.
    """
    firsts = list(accumulate((len(law.control) for law in laws), initial=0))
    grouped: dict[tuple[str, int, bool], Event] = {}

    def together(
        expression: ca.SX, direction: int, steady: bool, switches: dict[int, int], level: float | None = None
    ) -> None:
        """Add to the event of the same function, its value `level` in the modes switched from."""
        S = function("S", expression)
        key = S.serialize(), direction, steady
        known = grouped.get(key, Event(function=S, direction=direction, steady=steady))
        levels = {} if level is None else dict.fromkeys(switches, level)
        grouped[key] = replace(known, switches={**known.switches, **switches}, levels={**known.levels, **levels})

    for first, law in zip(firsts, laws, strict=False):
        for way in law.transitions:
            switches = {first + a: first + b for a, b in way.switches.items()}
            together(way.function, way.direction, way.steady, switches)
    jumping = list[Event]()
    for number, (sides, law) in enumerate(zip(dynamics.sides, laws, strict=True)):
        for i, choice in enumerate(dynamics.choices):
            for side, direction in ((sides[i] + 1, 1), (sides[i] - 1, -1)):
                if not 0 <= side <= len(choice.knots):
                    continue
                other = dynamics.sides.index((*sides[:i], side, *sides[i + 1 :]))
                knot = choice.knots[min(side, sides[i])]
                if choice.steady and law.regimes == laws[other].regimes:
                    # A control's regime changes by its own event: H goes on without a jump, its slopes unless bent.
                    switches = {firsts[number] + k: firsts[other] + k for k in range(len(law.regimes))}
                    together(choice.argument, direction, not choice.bent, switches, knot)
                    continue
                margin, behind = choice.argument - knot, flows[firsts[other] : firsts[other + 1]]
                for before in range(firsts[number], firsts[number + 1]):
                    reached, least = _cross_rate_jump(z, margin, flows[before], behind, laws[other].mode)
                    for k in range(len(behind)):
                        # Each mode behind has its own event, without effect where H is not least in it.
                        met = margin if len(behind) == 1 else ca.if_else(least == k, margin, -direction)
                        jumping.append(
                            Event(
                                function=function("kink", met),
                                direction=direction,
                                switches={before: firsts[other] + k},
                                jump=function("jump", reached),
                            )
                        )
    yield from grouped.values()
    yield from jumping


def _cross_rate_jump(z: ca.SX, margin: ca.SX, before: ca.SX, behind: list[ca.SX], least: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return z beyond a surface g = 0 on which the rates jump, and which of the modes `behind` it is in.

    lambda+ = lambda- - nu g_x, and H goes on as it was; nu is 0 where the rates are continuous (Bryson, Ho 1975,
    section 3.7). As the control behind the surface is the one that is best for lambda+, nu is found by Newton's method:
    dH+/dnu = -g_x . f+, H being stationary in the control.
    """
    half = z.numel() // 2
    x, lam = z[:half], z[half:]
    normal, kept = ca.gradient(margin, x), ca.dot(lam, before[:half])
    rates = select_by_mode([rate[:half] for rate in behind], least)
    at = lam
    for _ in range(_REFRACTIONS):
        rate = ca.substitute(rates, lam, at)
        at = at - (ca.dot(at, rate) - kept) / ca.dot(normal, rate) * normal
    return ca.vertcat(x, at), ca.substitute(least, lam, at)
