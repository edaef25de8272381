"""Proof that a control is the only minimiser of H where no formula says so: boxes of others, none as good.

In none of a box B is H as small as at the control u if H is larger there by enclosures, or by its slopes in the box
around both, or convex there: where u is on no bound, it is stationary, and where it is, H rises from that. What holds
for the rest is enough where H rises all along from the bounds that hold some.
"""

from typing import Any

from flint import arb, arb_mat, ctx

from perilune_checker.equations import CertifiedEquations, eliminate
from perilune_checker.expressions import CertifiedProgram, backward_gradient

BITS, BOXES, NARROWEST = 80, 4000, 2.0**-24  # of a piece of the flight; the least of a box relative to its range


def is_positive_definite(form: Any) -> bool:
    """Return True if every symmetric matrix in these balls is proved positive definite, by its elimination's pivots."""
    return all(row[k] > 0 for k, row in enumerate(eliminate(form.tolist())))


class OtherControls:
    """H of an arc by its scalars, and what these are and may be."""

    def __init__(self, equations: CertifiedEquations, i: int) -> None:
        z, (H, named, ranges) = equations.z[i], equations.flown[i]["joint"]
        u, own = [*named.values()], [equations.flown[i]["u"][name] for name in named]
        slopes = backward_gradient(H, u)
        self.H = CertifiedProgram([z, u], [H])
        self.slopes = CertifiedProgram([z, u], [*slopes, *(d for own in slopes for d in backward_gradient(own, u))])
        self.controls, self.ranges = CertifiedProgram([z], own), CertifiedProgram([z], ranges)
        self.sides = [{"lower": 1, "upper": -1}.get(equations.arcs[i]["regimes"][name], 0) for name in named]

    def are_worse(self, z: list[Any]) -> bool:
        """Return True if all other controls are proved worse, for all z of a box."""
        with ctx.workprec(BITS):
            own, bounds = self.controls(z), self.ranges(z)
            waiting = [[a.union(b) for a, b in zip(bounds[::2], bounds[1::2], strict=True)]]
            (best,), sizes = self.H(z, own), [float(whole.rad()) for whole in waiting[0]]
            for _ in range(BOXES):
                if not waiting:
                    return True
                B = waiting.pop()
                found = self.slopes(z, [a.union(b) for a, b in zip(B, own, strict=True)])
                rest = [j for j, side in enumerate(self.sides) if not found[j] * side > 0]
                rises = sum((found[j] * (B[j] - own[j]) for j in rest), arb(0)) > 0
                form = arb_mat([[found[len(B) * (j + 1) + k] for k in rest] for j in rest]) if rest else arb_mat(0, 0)
                if self.H(z, B)[0] > best or rises or is_positive_definite(form):
                    continue
                widths = [float(b.rad()) / max(size, 1e-300) for b, size in zip(B, sizes, strict=True)]
                i = max(range(len(B)), key=widths.__getitem__)
                if not widths[i] > NARROWEST:
                    return False
                waiting += [[*B[:i], part, *B[i + 1 :]]
                            for part in (B[i].lower().union(B[i].mid()), B[i].mid().union(B[i].upper()))]  # fmt: skip
        return False
