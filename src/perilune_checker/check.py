"""Check the certificate of a theorem: ``python -m perilune_checker certificate.json``.

It needs this package and python-flint, nothing of the prover, and does the proof again in another
way: derivatives of the problem's tapes backwards, Taylor polynomials by Picard's iteration in power series. All that
the theorem of a certificate says (`theorem`) is seen here, and its words are made here.
"""

import json
import re
import sys
from fractions import Fraction
from itertools import pairwise
from typing import Any

from flint import arb, arb_mat, ctx, fmpq

from perilune_checker.certificate import require_form, unique_members
from perilune_checker.equations import CertifiedEquations, exact_number
from perilune_checker.expressions import Failed, StepTooLong, require_claim
from perilune_checker.hamiltonian_minimum import OtherControls
from perilune_checker.second_variation import SecondVariation
from perilune_checker.taylor_steps import LEAST, ball_power, certified_step, polynomial_over_interval, unit_matrix

TOLERANCE, PIECES = 1e-6, 2.0**-20  # of limits in SI; least part of a step
REMAINDERS = (1e-36, 1e-45, 1e-60)  # of a step, relative to what moves there, tried in order
BESIDE, STEPS = 1e-9, 10**5  # the most that these are of the box; of an arc


def checked_sentence(told: dict[str, Any]) -> str:
    """The theorem of a certificate in words: what is seen here, all of it, and nothing else."""
    values = [("J", told["objective"]), *((u["name"], u["enclosure"]) for u in told["unknowns"])]
    optimum = (
        " It is a strict local minimum of J: of flights that meet the same conditions where phases begin and end, keep "
        "all ranges and bounds of controls, states and parameters, and whose states, controls and free parameters are "
        "close enough to its own, controls but for short times about switches, every other has a larger J."
    )
    return (
        f"The problem {told['problem']['name']!r} as it stands here has an extremal of {len(told['arcs'])} "
        f"arc{'s' if len(told['arcs']) > 1 else ''}, a flight that satisfies Pontryagin's conditions exactly, with "
        f"{', '.join(f'{name} = {value}' for name, value in values)} in SI. "
        "No other with these arcs and sides, and controls that are continuous along each arc, has every unknown within "
        "`only_one_within` of its `centre`. No condition of the path and no bound of a state or a control is broken by "
        f"more than {TOLERANCE:g} in SI, no range of a parameter or an end at all; no multiplier says that a bound or "
        "a range should be left; and but for switches, and for a direction that is multiplied by 0, the control is the "
        "only one that minimises H."
        f"{'' if told['weights'] is None else optimum}"
    )


def ball_of_text(text: str) -> list[Any]:
    """The middle and the radius of a ball in decimals, as they stand there."""
    one = r"(-?\d+(?:\.\d+)?(?:e[-+]?\d{1,4})?)"
    found = re.fullmatch(rf"{one}|\[{one} \+/- {one}\]|\[\+/- {one}\]", text, re.ASCII)
    require_claim(found is not None, f"{text!r} does not hold anything")
    alone, middle, radius, about_zero = found.groups()  # type: ignore[union-attr]
    return [arb(fmpq(*Fraction(part or "0").as_integer_ratio())) for part in (alone or middle, radius or about_zero)]


def bounded_step(rates: Any, z: list[Any], length: Any, most: float) -> list[Any]:
    """z behind a step whose remainder is no larger than a part of it, or than what `certified_step` adds to nothing.

    Parameters
    ----------
    rates
        Program of z' on the arc.
    z
        States, costates and w where the step begins, balls [SI].
    length
        Duration of the step, a ball [s].
    most
        Largest remainder allowed, as a share of the larger of z before and behind the step.

    Raises
    ------
    StepTooLong
        If the step is not enclosed, or with a larger remainder.
    """
    end, _, c = certified_step(rates, z, arb_mat(len(z), 0), length)
    remainders = [(own[-1].rad() * ball_power(length, len(own) - 1)).abs_upper() for own in c]
    fine = [r <= most * (a.abs_upper() + b.abs_upper()) + LEAST for r, a, b in zip(remainders, z, end, strict=True)]
    require_claim(all(fine), "a remainder is large", StepTooLong)
    return end


def split_middles(z: list[Any]) -> tuple[list[Any], Any]:
    """Return the middles, and the balls about 0 that are left."""
    return [v.mid() for v in z], column_of([v - v.mid() for v in z])


def middle_and_inverse(V: Any) -> tuple[Any, Any]:
    """The middle of a matrix and its inverse; of one that has none, the unit matrix."""
    middle = V.mid()
    try:
        return middle, middle.inv()
    except ZeroDivisionError:
        return unit_matrix(V.nrows()), unit_matrix(V.nrows())


def intersect_enclosures(a: list[Any], b: list[Any]) -> list[Any]:
    """Return the intersection of two enclosures of the same.

    Parameters
    ----------
    a, b
        Balls, component by component.
    """
    return [own.intersection(other) for own, other in zip(a, b, strict=True)]


def move_along(z: list[Any], V: Any, by: Any) -> list[Any]:
    """z + V by.

    Parameters
    ----------
    z
        Balls, n of them.
    V
        ``arb_mat`` of shape (n, m).
    by
        ``arb_mat`` of shape (m, 1).
    """
    return [a + b for a, b in zip(z, (V * by).entries(), strict=True)]


def column_of(values: list[Any]) -> Any:
    """A matrix of one column."""
    return arb_mat([[value] for value in values])


class _Proof:
    """The boundary value problem of a certificate, enclosed."""

    def __init__(self, told: dict[str, Any]) -> None:
        require_form(told)
        self.told, self.equations, self.grid = told, CertifiedEquations(told), list[list[Any]]()
        self.others = [own["joint"] and OtherControls(self.equations, i) for i, own in enumerate(self.equations.flown)]

    def fly(self, box: list[Any], most: float) -> tuple[Any, Any]:
        """z at every node of the flight from the centre of a box, and dz/dy there for all of the box.

        That is z = m + B (S (y - c) + r) too, with a frame B that goes with the tangents, so that balls do not grow by
        wrapping (Lohner's parallelepiped). Steps halve those of the certificate until their remainders are small.
        """
        (y, aside), self.grid = split_middles(box), []
        nodes, by_y = list[Any](), list[Any]()
        near, V = list[Any](), arb_mat(0, len(y))
        for start, time, rates, grid in zip(
            self.equations.starts, self.equations.times, self.equations.rates, self.told["grid"], strict=True
        ):
            ends, Z = [*map(arb, grid), *time(y)], move_along(near, V, aside)
            V = start.slopes[0].matrix(box, Z) + start.slopes[1].matrix(box, Z) * V
            near, Z = start(y, near), start(box, Z)
            (m, r), B, S = split_middles(near), unit_matrix(len(near)), V
            longest, least, waiting = arb("inf"), PIECES * ends[-1] / len(ends), [*pairwise(ends)][::-1]
            nodes, by_y, self.grid = [*nodes, [near]], [*by_y, [V]], [*self.grid, []]
            while waiting:
                a, b = waiting.pop()
                require_claim(len(nodes[-1]) < STEPS, "it takes too many steps")
                whole = b - a if waiting else time(box)[0] - a
                try:
                    require_claim(b - a < longest, "it is longer than the last one twice", StepTooLong)
                    end = bounded_step(rates, m, b - a, most)
                    around = [own.union(middle) for own, middle in zip(Z, m, strict=True)]
                    Z_end, by_start, _ = certified_step(rates, around, unit_matrix(len(m)), whole)
                except StepTooLong:
                    require_claim(b - a > least, "a step is not enclosed", StepTooLong)
                    waiting += [(((a + b) / 2).mid(), b), (a, ((a + b) / 2).mid())]
                    continue
                longer = 0 * V if waiting else column_of(rates(Z_end)) * time.slopes[0].matrix(box)
                near, by_frame = move_along(end, by_start, column_of(near) - column_of(m)), by_start * B
                (m, off), (B, inverse) = split_middles(end), middle_and_inverse(by_frame)
                turned = inverse * by_frame  # nearly 1: in another order balls would grow
                S, r = turned * S + inverse * longer, turned * r + inverse * off
                near = intersect_enclosures(near, move_along(m, B, r))
                V = arb_mat(len(m), len(y), intersect_enclosures((by_start * V + longer).entries(), (B * S).entries()))
                Z, longest = intersect_enclosures(Z_end, move_along(near, V, aside)), 2.5 * (b - a) + 2 * least
                nodes[-1].append(near)
                by_y[-1].append(V)
                self.grid[-1].append(a)
        return nodes, by_y

    def check(self, remainder: float, tell: Any = print) -> tuple[list[Any], Any]:
        """The unknowns and J of the root that Krawczyk's operator proves, if all else is seen too."""
        equations, radii = self.equations, self.told["only_one_within"]
        require_claim(all(arb(r) > 0 for r in radii), "a box without an inside")
        box = [exact_number(u["centre"]) + arb(0, r) for u, r in zip(self.told["unknowns"], radii, strict=True)]
        centre, aside = split_middles(box)
        most = min(remainder, *(BESIDE * r / (abs(float(c)) + r) for c, r in zip(centre, radii, strict=True)))
        near, by_y = self.fly(box, most)
        tell(f"flights of the box enclosed in {sum(map(len, self.grid))} steps")
        ends = [move_along(z[-1], V[-1], aside) for z, V in zip(near, by_y, strict=True)]
        slopes = equations.residual.slopes[0].matrix(box, *ends)
        for own, V in zip(equations.residual.slopes[1:], by_y, strict=True):
            slopes = slopes + own.matrix(box, *ends) * V[-1]
        *rows, row = slopes.tolist()
        *F, J = equations.residual(centre, *(own[-1] for own in near))
        inverse = arb_mat(rows).mid().inv().mid()
        E = unit_matrix(len(box)) - inverse * arb_mat(rows)
        steps = (inverse * column_of(F)).entries()
        root = [c - d + e for c, d, e in zip(centre, steps, (E * aside).entries(), strict=True)]
        require_claim(
            all(b.contains_interior(r) for b, r in zip(box, root, strict=True)), "Krawczyk's operator leaves the box"
        )
        for _ in range(3 * self.told["bits"]):  # the root is in it, so that |y - c| <= |C F(c)| + |E| |y - c|
            aside = column_of([r - c for r, c in zip(root, centre, strict=True)])
            root = [c - d + e for c, d, e in zip(centre, steps, (E * aside).entries(), strict=True)]
        aside = column_of([r - c for r, c in zip(root, centre, strict=True)])
        J = J + (arb_mat([row]) * aside)[0, 0]
        told = [self.told["objective"], *(u["enclosure"] for u in self.told["unknowns"])]
        for value, text in zip([J, *root], told, strict=True):
            middle, radius = ball_of_text(text)
            require_claim(
                bool(abs(value - middle) < radius or value == middle),
                f"{text} does not hold what it should",
                StepTooLong,
            )
        require_claim(self.told["theorem"] == checked_sentence(self.told), "the theorem says something else")
        nodes = [[move_along(z, V, aside) for z, V in zip(*own, strict=True)] for own in zip(near, by_y, strict=True)]
        require_claim(
            all(v > 0 for v in equations.asked(root, *(own[-1] for own in nodes))),
            "a bound is broken, or would be left",
        )
        for i, begins in enumerate(self.grid):
            for at, (a, b) in enumerate(pairwise([*begins, *equations.times[i](root)])):
                flown = certified_step(equations.rates[i], nodes[i][at], arb_mat(len(nodes[i][at]), 0), b - a)
                self.along(i, at, b - a, flown[2], root)
        if self.told["weights"] is not None:
            tell("limits and signs seen")
            SecondVariation(equations, self.told["weights"]).check(self.grid, nodes, root)
        return root, J

    def along(self, i: int, at: int, length: Any, polynomials: list[Any], y: list[Any]) -> None:
        """Limits and signs along one step: what is monotone by its least, what a switch makes zero by its slope."""
        arcs, waiting = self.told["arcs"], [(0.0, 1.0)]
        zeros = {(1.0, arcs[i]["switched"])} if at + 1 == len(self.grid[i]) else set()
        zeros |= {(0.0, arcs[i - 1]["switched"])} if at == 0 and i not in self.equations.first else set()

        def least(program: Any, *places: Any) -> list[tuple[Any, Any]]:
            """The least over a piece, the first of the places, and the slope: by the ends if that has a sign."""
            whole, first, last = (program(y, z) for z in places)
            rises = whole[len(whole) // 2 :]
            return [(last[j] if r < 0 else first[j] if r > 0 else whole[j], r) for j, r in enumerate(rises)]

        while waiting:
            a, b = waiting.pop()
            spans = (arb(a).union(arb(b)), arb(a), arb(b))
            places = [[polynomial_over_interval(own, length * t) for own in polynomials] for t in spans]
            limits, signs = least(self.equations.limits[i], *places), least(self.equations.signs[i], *places)
            seen = all(value > -TOLERANCE and not value < 0 for value, _ in limits)
            for name, (value, rise) in zip(self.equations.signed[i], signs, strict=True):
                turned = any((end, name) in zeros and rise * (1 - 2 * end) > 0 for end in (0.0, 1.0) if end in (a, b))
                seen &= bool(value > 0) or turned
            if not seen or (self.others[i] and not self.others[i].are_worse(places[0])):
                require_claim(b - a > PIECES, f"a limit of arc {i + 1} is broken, or a sign is not seen")
                waiting += [(a, (a + b) / 2), ((a + b) / 2, b)]


def confirm(certificate: dict[str, Any], tell: Any = print) -> tuple[list[Any], Any]:
    """The unknowns and J of the one extremal of a certificate.

    Parameters
    ----------
    certificate
        The certificate as read from JSON.
    tell
        Called with each line on what was seen.

    Raises
    ------
    Failed
        If anything that its theorem says is not seen. What is no certificate at all may raise other errors.
    """
    before = ctx.cap
    try:
        with ctx.workprec(certificate["bits"] + 32):
            proof = _Proof(certificate)
            for remainder in REMAINDERS[:-1]:
                try:
                    return proof.check(remainder, tell)
                except StepTooLong as error:
                    tell(f"{error}: shorter steps")
            return proof.check(REMAINDERS[-1], tell)
    except ZeroDivisionError as error:
        raise Failed("something is divided by 0") from error
    finally:
        ctx.cap = before


def run_checker() -> int:
    """Check the certificate that is named; the exit code."""
    sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        with open(sys.argv[1], encoding="utf-8") as file:
            certificate = json.load(file, object_pairs_hook=unique_members)
        confirm(certificate)
    except (
        Failed,
        OSError,
        ValueError,
        ArithmeticError,
        LookupError,
        TypeError,
        AttributeError,
        RuntimeError,
    ) as error:
        print(f"not confirmed: {error if isinstance(error, (Failed, OSError)) else f'no certificate ({error!r})'}")
        return 1
    print(f"confirmed: {certificate['theorem']}")
    return 0


if __name__ == "__main__":
    sys.exit(run_checker())
