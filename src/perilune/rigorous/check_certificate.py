"""Check the certificate of a theorem: ``python -m perilune.rigorous.check_certificate certificate.json``.

It needs python-flint, this file and `jets`, nothing of the prover, and does the proof again in another way: adjoint
equations and tangents by forward differentiation (`Jet`) of the problem's tapes, Taylor polynomials by Picard's
iteration in power series. It proves that a box around the certificate's centre holds one extremal and no other, that
this is where the certificate says and has the J that it says, and that no condition of the path, no bound of a state
and no sign of a switched control is broken by more than `TOLERANCE`.
"""

from __future__ import annotations

import json
import sys
from itertools import pairwise
from typing import Any

from flint import arb, arb_mat, arb_series, ctx

from perilune.rigorous.jets import (
    Failed,
    Jet,
    dot,
    exact,
    given,
    horner,
    listed,
    matrix,
    of,
    over,
    plain,
    rational,
    run,
    slope,
)

TOLERANCE = 1e-6  # SI: by so much a sign may be missed where a condition is met, as at touchdown
WIDER, ROOM = 2.0**-20, 1e3


class _Proof:
    """The boundary value problem of a certificate."""

    def __init__(self, certificate: dict[str, Any]) -> None:
        self.told, self.problem, self.order = certificate, certificate["problem"], certificate["order"]
        self.given = {name: given(stated) for name, stated in self.problem["given"].items()}
        self.free, self.phases = [f["name"] for f in self.problem["free"]], self.problem["phases"]
        self.arcs = certificate["arcs"]
        self.last = {arc["phase"]: i for i, arc in enumerate(self.arcs)}
        self.first = {arc["phase"]: i for i, arc in reversed(list(enumerate(self.arcs)))}
        self.constants = [[name for name in self.free if self.acts(k, name)] for k in range(len(self.phases))]
        self.sizes = [len(phase["states"]) + len(c) for phase, c in zip(self.phases, self.constants, strict=True)]
        self.ranges = {(phase, name): side for phase, name, side in certificate["on_bounds"]["ranges"]}

    def tape(self, name: str) -> Any:
        return self.problem["tapes"].get(name)

    def acts(self, k: int, name: str) -> bool:
        limits = [c.get(side) for c in self.phases[k]["controls"] for side in ("lower", "upper")]
        return ["p", name] in self.tape(f"dynamics {k}")["instructions"] or name in limits

    def limit(self, stated: str, free: dict[str, Any]) -> Any:
        known = {**self.given, **free}
        return known[stated] if stated in known else rational(stated)

    def values(self, k: int, x: Any, u: dict[str, Any], free: dict[str, Any]) -> dict[tuple[str, str], Any]:
        found = {("p", name): v for name, v in {**self.given, **free}.items()} | {("u", n): v for n, v in u.items()}
        return found | {("x", s["name"]): v for s, v in zip(self.phases[k]["states"], x, strict=False)}

    def steered(self, i: int, z: list[Any]) -> tuple[list[Any], dict[str, Any], dict[str, Any]]:
        """z', the control that minimises H, and dH/du of each scalar, on arc i."""
        k, regimes = self.arcs[i]["phase"], self.arcs[i]["regimes"]
        half, n = self.sizes[k], len(self.phases[k]["states"])
        x, lam, free = z[:half], z[half:], dict(zip(self.constants[k], z[n:half], strict=True))
        tape, controls = self.tape(f"dynamics {k}"), self.phases[k]["controls"]

        def pulls(u: dict[str, Any], names: list[str]) -> list[Any]:
            jets = {name: Jet(2, v, {name: arb(1)}) if name in names else v for name, v in u.items()}
            f = run(tape, self.values(k, x, jets, free))
            return [dot(lam[:n], [slope(rate, name) for rate in f]) for name in names]

        u = {name: arb(not c["kind"] == "direction") for c in controls for name in c["names"]}
        for c in controls:
            if c["kind"] == "direction":  # a scalar that multiplies it does not turn it
                g = pulls(u, c["names"])
                strength = of("sqrt", dot(g, g))
                u |= {name: -own / strength for name, own in zip(c["names"], g, strict=True)}
        for c in controls:
            if c["kind"] != "direction":
                name, regime = c["name"], regimes[c["name"]]
                if regime == "interior":
                    s0, s1 = (pulls({**u, name: arb(v)}, [name])[0] for v in (0, 1))
                    u[name] = -s0 / (s1 - s0)
                else:
                    u[name] = self.limit(c[regime], free)
        jets = [Jet(2, v, {j: arb(1)}) for j, v in enumerate(x)]
        moved = dict(zip(self.constants[k], jets[n:], strict=True))  # and what is on a bound that one of them holds
        held = {c["name"]: self.limit(c[side], moved) for c in controls
                if (side := regimes.get(c.get("name"), "interior")) != "interior"}  # fmt: skip
        f = run(tape, self.values(k, jets, u | held, moved))
        rates = [rate.value if isinstance(rate, Jet) and rate.level == 2 else rate for rate in f]
        adjoint = [-dot(lam[:n], [slope(rate, j) for rate in f]) for j in range(half)]
        names = [c["name"] for c in controls if c["kind"] != "direction"]
        return [*rates, *([arb(0)] * (half - n)), *adjoint], u, dict(zip(names, pulls(u, names), strict=True))

    # -- the flow

    def coefficients(self, i: int, z: list[Any], V: Any, orders: int) -> tuple[list[list[Any]], list[Any]]:
        ctx.cap = 1
        series = [arb_series([v], 1) for v in z]
        for k in range(orders):
            ctx.cap = k + 1
            rates = [arb_series(listed(rate, k + 1), k + 1) for rate in self.steered(i, series)[0]]
            ctx.cap = k + 2
            series = [arb_series([v, *(c / (j + 1) for j, c in enumerate(listed(rate, k + 1)))], k + 2)
                      for v, rate in zip(z, rates, strict=True)]  # fmt: skip
        if V is None:
            return [listed(s, orders + 1) for s in series], []
        ctx.cap = orders
        jets = [Jet(1, arb_series(listed(s, orders), orders), {j: arb(1)}) for j, s in enumerate(series)]
        rates, size = self.steered(i, jets)[0], len(z)
        rows = [
            {j: listed(d, orders) for j, d in rate.slopes.items()} if isinstance(rate, Jet) else {} for rate in rates
        ]
        A = [arb_mat(size, size) for _ in range(orders)]
        for a, row in enumerate(rows):
            for b, c in row.items():
                for k in range(orders):
                    A[k][a, b] = c[k]
        tangents = [V]
        for k in range(orders):
            tangents.append(
                sum((A[j] * tangents[k - j] for j in range(1, k + 1)), A[0] * tangents[k]) * (1 / arb(k + 1))
            )
        return [listed(s, orders + 1) for s in series], tangents

    def step(self, i: int, z: list[Any], V: Any, length: Any) -> tuple[list[Any], Any, Any]:
        n, span = self.order, arb(0).union(length)
        reach = arb(0).union(length**n)
        c, T = self.coefficients(i, z, V, n - 1)
        ranges, W = [horner(own, span) for own in c], None if V is None else horner(T, span)
        Z = [r + arb(0, WIDER * float(r.abs_upper()) + 1e-60) for r in ranges]
        if W is not None:
            wide = WIDER * max(float(w.abs_upper()) for w in W.entries()) + 1e-60
            W = arb_mat(W.nrows(), W.ncols(), [w + arb(0, wide) for w in W.entries()])
        over, over_T = self.coefficients(i, Z, W, n)
        pairs = [(r + own[n] * reach, whole) for r, own, whole in zip(ranges, over, Z, strict=True)]
        if W is not None:
            moved = horner(T, span) + over_T[n] * reach
            pairs += zip(moved.entries(), W.entries(), strict=True)
        if not all(whole.contains_interior(part) for part, whole in pairs):
            raise Failed(f"a step of arc {i + 1} is not enclosed")
        end = [horner([*own, last[n]], length) for own, last in zip(c, over, strict=True)]
        return end, None if V is None else horner([*T, over_T[n]], length), (c, [own[n] for own in over], length)

    # -- the conditions at the ends

    def unpacked(self, y: list[Any]) -> tuple[list[list[Any]], dict[str, Any], list[list[Any]], dict[int, Any]]:
        values = iter(y)
        lam = [[next(values) for _ in range(size)] for size in self.sizes]
        free = {name: next(values) for name in self.free}
        nu = [[next(values) for _ in phase["end"]] for phase in self.phases]
        return lam, free, nu, {i: next(values) for i, arc in enumerate(self.arcs) if arc["switched"]}

    def opening(self, k: int, before: list[Any], free: dict[str, Any]) -> list[Any]:
        tape = self.tape(f"links {k - 1}" if k else "start")
        return [*run(tape, self.values(max(k - 1, 0), before, {}, free)), *(free[name] for name in self.constants[k])]

    def start(self, i: int, y: list[Any], before: list[Any]) -> list[Any]:
        k = self.arcs[i]["phase"]
        lam, free, _, _ = self.unpacked(y)
        return [*self.opening(k, before, free), *lam[k]] if i == self.first[k] else list(before)

    def duration(self, i: int, y: list[Any]) -> Any:
        k = self.arcs[i]["phase"]
        _, free, _, lengths = self.unpacked(y)
        whole = {**self.given, **free}[self.phases[k]["duration"]]
        return lengths[i] if i in lengths else whole - sum((lengths[j] for j in range(self.first[k], i)), arb(0))

    def residual(self, y: list[Any], ends: list[list[Any]]) -> tuple[list[Any], Any, list[Any]]:
        """F, J and what has to be positive beside them: all by derivatives of L = J + nu . psi + lambda(0) . x(0)."""
        lam, plain, nu, _ = self.unpacked(y)
        free = {name: Jet(2, v, {("q", name): arb(1)}) for name, v in plain.items()}
        x = {k: [Jet(2, v, {("x", k, j): arb(1)}) for j, v in enumerate(ends[self.last[k]][: self.sizes[k]])]
             for k in range(len(self.phases))}  # fmt: skip
        final = len(self.phases) - 1
        J = run(self.tape("objective"), self.values(final, x[final], {}, free))[0]
        L, conditions, asked = J, [], [self.duration(i, y) for i in range(len(self.arcs))]
        for k, phase in enumerate(self.phases):
            L = L + dot(lam[k], self.opening(k, x[k - 1] if k else [], free))
            psi = run(self.tape(f"end {k}"), self.values(k, x[k], {}, free)) if phase["end"] else []
            for c, value, multiplier in zip(phase["end"], psi, nu[k], strict=True):
                L = L + multiplier * value
                side = self.ranges.get((phase["name"], c["name"]))
                inner = value.value if isinstance(value, Jet) else value
                conditions.append(
                    multiplier if side == "inside" else inner - self.limit(c[side], plain) if side else inner
                )
                if side == "inside":
                    asked += self.room(inner, c, plain)
                elif side:
                    asked.append(multiplier if side == "upper" else -multiplier)
        costates = [
            ends[self.last[k]][size + j] - slope(L, ("x", k, j))
            for k, size in enumerate(self.sizes)
            for j in range(size)
        ]
        stationary = [slope(L, ("q", name)) for name in self.free]
        for k, phase in enumerate(self.phases):
            if phase["duration"] in self.free:
                end, size = ends[self.last[k]], self.sizes[k]
                own = self.free.index(phase["duration"])
                stationary[own] = stationary[own] + dot(end[size:], self.steered(self.last[k], end)[0][:size])
        for f in self.problem["free"]:
            side, own = self.told["on_bounds"]["free"].get(f["name"]), self.free.index(f["name"])
            asked += self.room(plain[f["name"]], {**f, side: None}, {})
            if side:
                asked.append(stationary[own] if side == "lower" else -stationary[own])
                stationary[own] = plain[f["name"]] - self.limit(f[side], {})
        switches = [self.switch(i, ends[i]) for i, arc in enumerate(self.arcs) if arc["switched"]]
        return [*conditions, *costates, *stationary, *switches], J.value if isinstance(J, Jet) else J, asked

    def room(self, value: Any, told: dict[str, Any], free: dict[str, Any]) -> list[Any]:
        """How far a value is above its lower and below its upper bound, where it has them."""
        signs = (("lower", 1), ("upper", -1))
        return [(value - self.limit(told[s], free)) * sign for s, sign in signs if told[s] is not None]

    def switch(self, i: int, end: list[Any]) -> Any:
        name = self.arcs[i]["switched"]
        _, u, slopes = self.steered(i, end)
        if self.arcs[i]["regimes"][name] != "interior":
            return slopes[name]
        control = next(c for c in self.phases[self.arcs[i]["phase"]]["controls"] if c.get("name") == name)
        return u[name] - self.limit(control[self.arcs[i + 1]["regimes"][name]], {})

    # -- the proof

    def fly(
        self, y: list[Any], tangents: bool, centre: list[list[list[Any]]] | None = None
    ) -> tuple[Any, Any, Any, Any]:
        """Ends, dz/dy there, z at every node and the steps, of all y of a box; narrowed by the flight of its centre."""
        ends, by_y, nodes, flown, D, size = [], [], [], [], arb_mat(0, 0), len(y)
        aside = arb_mat([[v - v.mid()] for v in y])
        for i, begins in enumerate(self.told["grid"]):
            before = ends[-1] if ends else []
            jets = [Jet(1, v, {("y", j): arb(1)}) for j, v in enumerate(y)]
            opened = self.start(i, jets, [Jet(1, v, {("z", j): arb(1)}) for j, v in enumerate(before)])
            lasts = self.duration(i, jets)
            z, V = [plain(v) for v in opened], None
            if tangents:
                V = matrix(opened, "y", size)
                V = V + matrix(opened, "z", len(before)) * D if before else V
            own, steps = [z], []
            for a, b in pairwise([*map(arb, begins), plain(lasts)]):
                z, V, step = self.step(i, z, V, b - a)
                steps.append(step)
                if tangents and len(steps) == len(begins):
                    rates = [plain(rate) for rate in self.steered(i, z)[0]]
                    V = V + arb_mat([[rate] for rate in rates]) * matrix([lasts], "y", size)
                if centre is not None:
                    moved = zip(z, centre[i][len(steps)], (V * aside).entries(), strict=True)
                    z = [direct.intersection(near + off) for direct, near, off in moved]
                own.append(z)
            D = V
            ends, by_y, nodes, flown = [*ends, z], [*by_y, V], [*nodes, own], [*flown, steps]
        return ends, by_y, nodes, flown

    def check(self, tell: Any = print) -> tuple[list[Any], Any]:
        centre = [exact(u["centre"]) for u in self.told["unknowns"]]
        inverse, size = arb_mat([[arb(v) for v in row] for row in self.told["inverse"]]).mid(), len(centre)
        ends, _, nodes, _ = self.fly(centre, False)
        defect = inverse * arb_mat([[plain(value)] for value in self.residual(centre, ends)[0]])
        tell("flight of the centre enclosed")
        # Room for the errors of this proof, which encloses a little worse.
        radii = [max(u["radius"], ROOM * float(d.abs_upper()))
                 for u, d in zip(self.told["unknowns"], defect.entries(), strict=True)]  # fmt: skip
        box = [c + arb(0, r) for c, r in zip(centre, radii, strict=True)]
        ends, by_y, _, flown = self.fly(box, True, nodes)
        tell("flight of the box enclosed")
        jets = [Jet(1, v, {("y", j): arb(1)}) for j, v in enumerate(box)]
        z = [[Jet(1, v, {("z", i, j): arb(1)}) for j, v in enumerate(end)] for i, end in enumerate(ends)]
        rows, _, _ = self.residual(jets, z)
        slopes = matrix(rows, "y", size)
        for i, end in enumerate(ends):
            slopes = slopes + matrix(rows, ("z", i), len(end)) * by_y[i]
        unit = arb_mat([[int(a == b) for b in range(size)] for a in range(size)])
        aside = arb_mat([[b - c] for b, c in zip(box, centre, strict=True)])
        moved = (unit - inverse * slopes) * aside - defect
        root = [c + m for c, m in zip(centre, moved.entries(), strict=True)]
        if not all(b.contains_interior(r) for b, r in zip(box, root, strict=True)):
            raise Failed("Krawczyk's operator leaves the box of the certificate")
        for value, told in zip(root, self.told["unknowns"], strict=True):
            if not (claimed := arb(told["enclosure"])).is_finite() or not claimed.overlaps(value):
                raise Failed(f"{told['name']} is not where the certificate says")
        _, J, asked = self.residual(root, ends)
        if not all(value > 0 for value in asked):
            raise Failed("a bound is broken, or the extremal would leave the one that it is on")
        if not (told := arb(self.told["objective"])).is_finite() or not told.overlaps(J):
            raise Failed("J is not what the certificate says")
        for i, steps in enumerate(flown):
            self.limits(i, steps, root)
        return root, J

    def limits(self, i: int, steps: list[Any], y: list[Any]) -> None:
        """Conditions of the path, bounds of states and of scalars, and the signs of switched controls, on one arc."""
        k, (_, free, _, _) = self.arcs[i]["phase"], self.unpacked(y)
        for c, last, length in steps:
            waiting = [(0.0, 1.0)]
            while waiting:
                a, b = waiting.pop()
                t = length * arb(a).union(arb(b))
                z = [over(own, t) + end * t**self.order for own, end in zip(c, last, strict=True)]
                if all(not value < 0 and value > -TOLERANCE for value in self.signs(i, k, z, free)):
                    continue
                if b - a < 2.0**-20:
                    raise Failed(f"a limit of arc {i + 1} is broken, or its sign is not seen")
                waiting += [(a, (a + b) / 2), ((a + b) / 2, b)]

    def signs(self, i: int, k: int, z: list[Any], free: dict[str, Any]) -> list[Any]:
        _, u, slopes = self.steered(i, z)
        phase, found = self.phases[k], []
        if phase["path"]:
            found += run(self.tape(f"path {k}"), self.values(k, z, u, free))
        for value, told in zip([*z[: len(phase["states"])]], phase["states"], strict=True):
            found += self.room(value, told, free)
        for c in phase["controls"]:
            if (regime := self.arcs[i]["regimes"].get(c.get("name"))) == "interior":
                found += self.room(u[c["name"]], c, free)
            elif regime:
                found.append(slopes[c["name"]] if regime == "lower" else -slopes[c["name"]])
        return found


def confirm(certificate: dict[str, Any], tell: Any = print) -> tuple[list[Any], Any]:
    """The unknowns and J of the one extremal of a certificate.

    Raises
    ------
    Failed
        If anything that it claims is not seen.
    """
    before = ctx.cap
    try:
        with ctx.workprec(certificate["bits"]):
            return _Proof(certificate).check(tell)
    finally:
        ctx.cap = before


def main() -> int:
    """Check the certificate that is named; the exit code."""
    try:
        with open(sys.argv[1], encoding="utf-8") as file:
            certificate = json.load(file)
        root, J = confirm(certificate)
    except (Failed, OSError, ValueError, ArithmeticError, LookupError, TypeError, AttributeError) as error:
        print(f"not confirmed: {error if isinstance(error, (Failed, OSError)) else f'no certificate ({error!r})'}")
        return 1
    print(f"confirmed: one extremal of {certificate['problem']['name']} in the box, J = {J.str(30)}")
    print("not looked at: the words of the theorem, the larger box, convexity of H, the second variation")
    for value, told in zip(root, certificate["unknowns"], strict=True):
        print(f"  {told['name']} = {value.str(30)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
