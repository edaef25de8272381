"""Root of F(y) = 0: refined by Newton's method in many digits, then proved by Krawczyk's operator.

With c the centre of a box Y, and C about the inverse of F'(c),

    K(Y) = c - C F(c) + (1 - C F'(Y)) (Y - c)  in the interior of Y

proves that Y holds one root and no other, and that it lies in K(Y) (Krawczyk 1969; Neumaier, *Interval Methods for
Systems of Equations*, 1990, chapter 5).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from flint import arb, arb_mat

from perilune.core import PeriluneError
from perilune.rigorous.boundary_value_problem import BoundaryProblem
from perilune.rigorous.enclosure import (
    EnclosedFlight,
    Grid,
    ball_centres,
    ball_column,
    ball_identity,
    enclose_flight,
    fly_unproved,
    residual,
    slopes,
)
from perilune.rigorous.enclosure_step import NotEnclosed
from perilune.rigorous.taylor import Ball

_ZERO = 1e-9  # of the largest unknown: what is smaller may be zero
_FARTHEST, _SMALLER = 1e-6, 4  # of an unknown, at most so far; boxes that are tried, each 1000 times smaller
_QUADRATIC = 1e4  # a Newton step, relative to the square of the one before; 210 at most on answered problems
_REMAINDER = 1e-9  # of a step, relative to the radius of the box: what hundreds leave in a bad frame is still less
Tell = Callable[[str], None]


class NotProved(PeriluneError):
    """A statement that could not be proved."""


@dataclass(frozen=True, kw_only=True)
class ProofEffort:
    """Effort of a proof: precision, orders and tolerances.

    Attributes
    ----------
    bits
        Of all numbers.
    order
        Of the Taylor series.
    tolerance
        Size of a step's last terms relative to those that count.
    box
        Radius of the box in which the root is proved, relative to the unknowns.
    enough
        Step of Newton's method, relative to the unknowns, after which there is nothing more to gain.
    newton
        How many of them at most.
    """

    bits: int = 192
    order: int = 45
    tolerance: float = 1e-62
    box: float = 1e-37
    enough: float = 1e-46
    newton: int = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class RefinedRoot:
    """Result of Newton's method: y, the inverse of F' there, the grid of the flights, and the steps it took."""

    y: list[Ball]
    inverse: Any
    grid: Grid
    steps: list[float] = field(default_factory=list)

    @property
    def sizes(self) -> list[float]:
        """Return the sizes of the unknowns; one that may be zero relative to the others has a part of the largest."""
        each = [abs(float(c)) for c in self.y]
        return [max(size, _ZERO * max(each)) for size in each]


@dataclass(frozen=True, kw_only=True, eq=False)
class EnclosedRoot:
    """A root that is proved to be the only one in a box.

    Attributes
    ----------
    y
        Balls that hold it.
    box
        Balls in which there is no other.
    flight
        Of every y of the box.
    contraction
        Norm of 1 - C F'(Y), by the radii of the box; below 1.
    defect
        The largest ratio of C F(c) to those radii.
    """

    y: list[Ball]
    box: list[Ball]
    flight: EnclosedFlight
    contraction: float
    defect: float


def refine_root(boundary: BoundaryProblem, y: Sequence[Ball], settings: ProofEffort, tell: Tell) -> RefinedRoot:
    """Newton's method from a guess.

    Raises
    ------
    NotProved
        If it does not converge, or not quadratically.

    Parameters
    ----------
    boundary, y
        The problem, and a guess of its unknowns.
    settings
        Effort.
    tell
        Receives lines of text.
    """
    grid, moved, y, enough = None, list[float](), ball_centres(y), settings.enough
    inverse, slowly = arb_mat(0, 0), False
    for number in range(settings.newton):
        flown, chosen = fly_unproved(boundary, y, settings.order, settings.tolerance, grid)
        grid = chosen if number == 0 else grid
        F, J = slopes(boundary, y, flown)
        inverse = _inverse_of_middle(J)
        change = (inverse * ball_column(ball_centres(F))).entries()
        least = _ZERO * max(abs(float(a)) for a in y)
        largest = max(abs(float(b)) / max(abs(float(a)), least) for a, b in zip(y, change, strict=True))
        moved.append(largest)
        y = ball_centres([a - b for a, b in zip(y, change, strict=True)])
        tell(f"Newton's method in {settings.bits} bits: step {largest:.2g}, {sum(map(len, chosen))} steps of the flow")
        # What converges only linearly is not the function that its derivatives are of: one of the two is cut off. An
        # unknown that is small relative to the others may come out once as if it did, and not again.
        slow = number > 0 and largest > max(enough, _QUADRATIC * moved[-2] ** 2)
        if slow and slowly:
            raise NotProved("high-precision Newton's method does not converge quadratically", got=f"steps {moved}")
        if not slow and (largest < enough or (number and _QUADRATIC * largest**2 < enough)):
            break
        slowly = slow
    else:
        raise NotProved("high-precision Newton's method does not converge", got=f"steps {moved}")
    assert grid is not None
    return RefinedRoot(y=y, inverse=inverse, grid=grid, steps=moved)


def _inverse_of_middle(J: Any) -> Any:
    try:
        return J.mid().inv().mid()
    except ZeroDivisionError:
        raise NotProved("the extremal is not isolated: the matrix of its conditions is singular") from None


def enlarge_uniqueness_box(
    boundary: BoundaryProblem, refined: RefinedRoot, root: EnclosedRoot, settings: ProofEffort, tell: Tell
) -> EnclosedRoot:
    """Return the same root in about the largest box in which it can be proved to be the only one.

    Parameters
    ----------
    boundary, refined, root
        The problem, Newton's result, and the proved root.
    settings
        Effort.
    tell
        Receives lines of text.
    """
    first = [float(b.rad()) for b in root.box]
    factor = min(_FARTHEST * size / r for size, r in zip(refined.sizes, first, strict=True))
    proved = replace(refined, grid=[[float(step.begin) for step in steps] for steps in root.flight.steps])
    for _ in range(_SMALLER):
        if factor <= 1.0:
            break
        try:
            return prove_root(boundary, proved, settings, tell, [factor * r for r in first])
        except (NotProved, NotEnclosed):
            factor *= 1e-3
    return root


def prove_root(
    boundary: BoundaryProblem, refined: RefinedRoot, settings: ProofEffort, tell: Tell,
    radii: Sequence[float] | None = None,
) -> EnclosedRoot:  # fmt: skip
    """Krawczyk's operator on a box around a refined root.

    Parameters
    ----------
    boundary, refined, settings, tell
        What is to be proved, with what effort.
    radii
        Of the box; by default those of the settings.

    Raises
    ------
    NotProved
        If K(Y) does not lie in Y.
    NotEnclosed
        If a flight is not enclosed.
    """
    own = [settings.box * size for size in refined.sizes] if radii is None else list(radii)
    box = [c + arb(0, r) for c, r in zip(refined.y, own, strict=True)]
    centre = ball_centres(box)  # of which F is: in fewer bits than before it is another number
    finest = _REMAINDER * settings.box if radii is None else math.inf
    flown = enclose_flight(boundary, box, refined.grid, settings.order, finest)
    F = residual(boundary, box, flown)
    off = (refined.inverse * ball_column(F)).entries()
    defects = [float(value.abs_upper()) for value in off]
    _, J = slopes(boundary, box, flown)
    rest = ball_identity(len(box)) - refined.inverse * J
    moved = (rest * ball_column([b - c for b, c in zip(box, centre, strict=True)])).entries()
    krawczyk = [c - d + e for c, d, e in zip(centre, off, moved, strict=True)]
    contraction = max(float(e.abs_upper()) / r for e, r in zip(moved, own, strict=True))
    tell(f"box enclosed: defect {max(defects):.2g}, contraction {contraction:.2g}")
    if not all(b.contains_interior(k) for b, k in zip(box, krawczyk, strict=True)):
        raise NotProved(
            "no root is proved: Krawczyk's operator leaves the box",
            got=f"contraction {contraction:.3g}, defect {max(defects):.3g}",
        )
    return EnclosedRoot(y=krawczyk, box=box, flight=flown, contraction=contraction,
                defect=max(d / r for d, r in zip(defects, own, strict=True)))  # fmt: skip
