"""Second variation of a certificate's extremal: by a solution of Riccati's equation, it is positive.

On each arc time is s = t / T; lengths of arcs and free parameters p that are on no bound are constant states of every
phase, xi = (x, p). With H = T lambda . f at the u that minimises it, W = Lambda X^-1 of the tangents (X, Lambda) of
xi' = H_lambda, lambda' = -H_xi, which restart with (1, W) at each step, W being replaced there by a larger one.
With K = (lambda . l + nu . psi)_vv at the start and at links, where xi = l(v) and psi(v) = 0 behind a phase,

    -dx' W dx <= min over dv of |dx - l_v dv|^2_M + dv' (K - W_before) dv + R |psi_v dv|^2,

and (J + nu . psi)_vv - W + R psi_v' psi_v > 0 at the last end: the second variation is no less than that on the kernel
of psi_v. M are weights that the certificate states; R does not matter but for how little it costs.
"""

from itertools import pairwise
from typing import Any

from flint import arb, arb_mat

from perilune_checker.equations import CertifiedEquations
from perilune_checker.expressions import (
    ZERO,
    CertifiedProgram,
    Failed,
    backward_gradient,
    replace_symbols,
    require_claim,
    sum_of_products,
    symbol,
)
from perilune_checker.hamiltonian_minimum import is_positive_definite
from perilune_checker.taylor_steps import certified_step, evaluate_polynomial, polynomial_over_interval, unit_matrix

DEEPEST, PENALTY = 12, 2.0**40  # halvings of a step; R, times M of what a condition weighs


def diagonal_matrix(weights: list[Any]) -> Any:
    """A diagonal matrix."""
    return arb_mat([[w if a == b else arb(0) for b in range(len(weights))] for a, w in enumerate(weights)])


def upper_symmetric_matrix(W: Any, weights: list[Any]) -> Any:
    """An exact symmetric matrix no less than W: what they differ by is diagonally dominant, in units of one size.

    Parameters
    ----------
    W
        Symmetric ``arb_mat`` of balls.
    weights
        Positive weights of its rows, by which they are scaled.
    """
    size, found, units = W.nrows(), ((W.mid() + W.mid().transpose()) * arb(0.5)).mid(), [1 / w.sqrt() for w in weights]
    gap = found - W
    for i in range(size):
        most = sum(((gap[i, j].abs_upper() + gap[j, i].abs_upper()) * units[j] for j in range(size)), arb(0)) / units[i]
        found[i, i] = (found[i, i] + most).upper()
    return found


def is_regular_step(c: list[Any], size: int, length: Any) -> bool:
    """Return True if X, given by its polynomials, is regular all along a step: |E|^k 1 < 1 with X C = 1 + E.

    Parameters
    ----------
    c
        Taylor coefficients of the entries of X, row by row, the last with the remainder.
    size
        Number of rows of X.
    length
        Duration of the step, a ball, as a share of the arc's.
    """
    C = arb_mat(size, size, [evaluate_polynomial(own, length / 2) for own in c]).mid().inv().mid()
    E = arb_mat(size, size, [polynomial_over_interval(own, arb(0).union(length)) for own in c]) * C - unit_matrix(size)
    sizes, sums = [[e.abs_upper() for e in row] for row in E.tolist()], [arb(1)] * size
    for _ in range(size):
        sums = [sum((e * s for e, s in zip(row, sums, strict=True)), arb(0)) for row in sizes]
        if all(s < 1 for s in sums):
            return True
    return False


class SecondVariation:
    """The second variation of what `CertifiedEquations` state."""

    def __init__(self, equations: CertifiedEquations, weights: list[list[float]]) -> None:
        self.equations, self.weights = equations, [[arb(w) for w in own] for own in weights]
        require_claim(all(w > 0 and w.is_finite() for own in self.weights for w in own), "a weight is none")
        require_claim(len(weights) == len(equations.phases), "there are not as many weights as phases")
        free = [q for name, q in equations.q.items() if name not in equations.on["free"]]
        self.p = [*free, *equations.lengths.values()]
        sizes = [len(phase["states"]) + len(self.p) for phase in equations.phases]
        require_claim([len(own) for own in weights] == sizes, "there are not as many weights as states")
        self.rates, self.pulls = zip(*map(self.programs_of, range(len(equations.arcs))), strict=True)
        v, groups, self.junctions = self.p, [equations.y, *equations.z], list[Any]()
        for k in range(len(equations.phases) + 1):
            psi = [(nu, value) for nu, value, _, side in equations.ends[k - 1] if side != "inside"] if k else []
            L, follows = equations.J, list[Any]()
            if k < len(equations.phases):
                L = sum_of_products(equations.lam[k][: len(equations.begins[k])], equations.begins[k])
                follows = [*equations.begins[k], *self.p]
            L = L + sum_of_products((nu for nu, _ in psi), (value for _, value in psi))
            self.junctions.append([
                CertifiedProgram(groups, [d for own in of for d in backward_gradient(own, v)], rows=len(of))
                for of in (follows, [value for _, value in psi], backward_gradient(L, v))
            ])  # fmt: skip
            if k < len(equations.phases):
                v = [*equations.z[equations.last[k]][: len(equations.begins[k])], *self.p]

    def programs_of(self, i: int) -> tuple[CertifiedProgram, CertifiedProgram]:
        """The canonical equations of an arc for (x, p, lambda of both, w), and H_w."""
        equations, k, p = self.equations, self.equations.arcs[i]["phase"], self.p
        z, own, T, stay = equations.z[i], equations.flown[i], equations.lasting[i], equations.stay[k]
        half, n = len(equations.lam[k]), len(equations.lam[k]) - len(stay)
        by_p = [-own["H"] * slope for slope in backward_gradient(T, p)]
        for j, name in enumerate(stay):  # lambda' of a parameter that acts is -H_q
            by_p = [b + (own["rates"][half + n + j] * T if equations.q[name] is q else ZERO)
                    for b, q in zip(by_p, p, strict=True)]  # fmt: skip
        x, moved, costate, still = ([symbol() for _ in of] for of in (range(n), p, range(n), p))
        parts = own["rates"][:n], [ZERO] * len(p), own["rates"][half : half + n]
        w, turning = z[2 * half :], [T * rate for rate in own["rates"][2 * half :]]
        rates = [*(T * rate for part in parts for rate in part), *by_p, *turning]
        told = {**dict(zip(z[:n], x, strict=True)), **dict(zip(z[half : half + n], costate, strict=True))}
        told |= dict(zip(z[n:half], (equations.q[name] for name in stay), strict=True))
        pulls = [own["pulls"][name] for name in own["w"]]
        rates, pulls = (
            replace_symbols(replace_symbols(of, told), dict(zip(p, moved, strict=True))) for of in (rates, pulls)
        )
        canonical = [*x, *moved, *costate, *still]
        return CertifiedProgram([[*canonical, *w], equations.y], rates, 1), CertifiedProgram(
            [canonical, w, equations.y], pulls, 2
        )

    def demand_order(self) -> None:
        """Switches are jumps of one scalar each in which H is affine, and nothing makes a direction vanish from H."""
        arcs, flown = self.equations.arcs, self.equations.flown
        for i, arc in enumerate(arcs):
            for name in flown[i]["factors"]:
                c, regime = self.equations.control(arc["phase"], name), arc["regimes"][name]
                turned = regime == "interior" or bool(self.equations.limit(c[regime], {}).parts[0] > 0)
                require_claim(turned, "the factor of a direction may vanish on an interval")
            if name := arc["switched"]:
                a, b = arc["regimes"], arcs[i + 1]["regimes"]
                require_claim([own for own in a if a[own] != b[own]] == [name], f"{name} does not switch alone")
                affine = name not in flown[i]["curved"] and name not in flown[i + 1]["curved"]
                require_claim(
                    affine and "interior" not in (a[name], b[name]), f"H is not affine in {name}, which switches"
                )

    def check(self, grid: list[list[Any]], nodes: list[Any], y: list[Any]) -> None:
        """See that it is positive, for the flight that has these enclosures at the times of the grid.

        Parameters
        ----------
        grid
            For each arc the times at which its steps begin [s].
        nodes
            For each arc z at these times and at its end, balls [SI].
        y
            Unknowns, balls [SI].

        Raises
        ------
        Failed
            If it is not seen to be positive.
        """
        self.demand_order()
        equations, ends, W = self.equations, [own[-1] for own in nodes], None
        p = CertifiedProgram([equations.y], self.p)(y)
        for k, (slopes, conditions, form) in enumerate(self.junctions):
            G, psi, C = (own.matrix(y, *ends) for own in (slopes, conditions, form))
            C = C if W is None else C - W
            for row in psi.tolist():
                weight = sum((v * v / w for v, w in zip(row, self.weights[k - 1], strict=True)), arb(0))
                C = C + arb_mat([[a * b * (PENALTY / weight) for b in row] for a in row])
            if k == len(equations.phases):
                require_claim(is_positive_definite(C), "the second variation is not seen to be positive")
                return
            M = diagonal_matrix(self.weights[k])
            core = G.transpose() * M * G + C
            require_claim(is_positive_definite(core), "weights do not outweigh the curvature of a start")
            W = upper_symmetric_matrix(
                (M * G * core.inv() * G.transpose() * M if core.nrows() else 0 * M) - M, self.weights[k]
            )
            for i, arc in enumerate(equations.arcs):
                if arc["phase"] == k:
                    (T,) = equations.times[i](y)
                    for z, (a, b) in zip(nodes[i], pairwise([*grid[i], T]), strict=False):
                        n, half = W.nrows() - len(p), len(equations.lam[k])
                        zeta = [*z[:n], *p, *z[half : half + n], *([arb(0)] * len(p)), *z[2 * half :]]
                        _, W = self.carried(i, zeta, W, (b - a) / T, y, self.weights[k])

    def carried(
        self, i: int, z: list[Any], W: Any, length: Any, y: list[Any], weights: list[Any], depth: int = 0
    ) -> Any:
        """Return z behind a step, and no less than W there; the step is halved where X is not seen to be regular.

        Parameters
        ----------
        i
            Index of the arc.
        z
            States, constant states, costates and w where the step begins, balls [SI].
        W
            Matrix there, ``arb_mat``.
        length
            Duration of the step, as a share of the arc's.
        y
            Unknowns, balls [SI].
        weights
            Positive weights of the rows of W.
        depth
            Times that the step was halved already.

        Raises
        ------
        Failed
            If X is not seen to be regular even on the shortest steps.
        """
        size, start = W.nrows(), unit_matrix(W.nrows()).tolist() + W.tolist()
        try:
            if z[2 * size :]:  # H_w stays 0
                by_z, by_w = (own.matrix(z[: 2 * size], z[2 * size :], y) for own in self.pulls[i].slopes)
                start += (-by_w.inv() * by_z * arb_mat(start)).tolist()
            end, V, c = certified_step(self.rates[i], z, arb_mat(start), length, y)
            seen = is_regular_step(c[len(z) : len(z) + size * size], size, length)
        except (Failed, ZeroDivisionError):
            seen, end, V = False, z, W
        if seen:
            rows = V.tolist()
            return end, upper_symmetric_matrix(arb_mat(rows[size : 2 * size]) * arb_mat(rows[:size]).inv(), weights)
        require_claim(depth < DEEPEST, f"no solution of Riccati's equation is seen on arc {i + 1}")
        for _ in range(2):
            z, W = self.carried(i, z, W, length / 2, y, weights, depth + 1)
        return z, W
