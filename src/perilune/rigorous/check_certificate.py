"""Check the certificate of a theorem: ``python -m perilune.rigorous.check_certificate certificate.json``.

It needs this file and python-flint, nothing of the prover, and does the proof again in another way: adjoint equations
and tangents by forward differentiation (`Jet`) of the problem's tapes, Taylor polynomials by Picard's iteration in
power series. All that the theorem of a certificate says (`theorem`) is seen here, and its words are made here.
"""

import json
import sys
from itertools import pairwise
from operator import add, mul, sub, truediv
from typing import Any

from flint import arb, arb_mat, arb_series, ctx, fmpq

FORMAT = "perilune theorem 4"
TOLERANCE, WIDER, PIECES = 1e-6, 2.0**-20, 2.0**-20  # of limits in SI; of what encloses a step; least part of a step
ORDER, PARTS = 34, 3  # of the series, and of each step of the certificate: much is enclosed less closely here


class Failed(Exception):
    """What the certificate claims is not so, or cannot be seen."""


def demand(held: bool, told: str) -> None:
    """Go on only if it is so."""
    if not held:
        raise Failed(told)


class Jet:
    """A value with its first derivatives by some directions; jets of a higher level hold those of a lower."""

    def __init__(self, level: int, value: Any, slopes: dict[Any, Any]) -> None:
        self.level, self.value, self.slopes = level, value, slopes

    def _with(self, other: Any, value: Any, mine: Any, others: Any) -> Any:
        slopes = {key: mine * d for key, d in self.slopes.items()}
        for key, d in other.slopes.items() if level(other) == self.level else ():
            slopes[key] = slopes[key] + others * d if key in slopes else others * d
        return Jet(self.level, value, slopes)

    def __add__(self, other: Any) -> Any:
        if level(other) > self.level:
            return other + self
        return self._with(other, self.value + (other.value if level(other) == self.level else other), 1, 1)

    def __mul__(self, other: Any) -> Any:
        if level(other) > self.level:
            return other * self
        b = other.value if level(other) == self.level else other
        return self._with(other, self.value * b, b, self.value)

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> Any:
        return self * -1

    def __sub__(self, other: Any) -> Any:
        return self + other * -1

    def __rsub__(self, other: Any) -> Any:
        return self * -1 + other

    def __truediv__(self, other: Any) -> Any:
        return self * (1 / other)

    def __rtruediv__(self, other: Any) -> Any:
        inverse = 1 / self.value
        return other * Jet(self.level, inverse, {key: -inverse * inverse * d for key, d in self.slopes.items()})


def level(a: Any) -> int:
    """Of a jet; 0 of what is none."""
    return a.level if isinstance(a, Jet) else 0


def of(name: str, a: Any) -> Any:
    """A function of one value, of a ball, a series or a jet."""
    if not isinstance(a, Jet):
        return getattr(a, name)()
    v, value = a.value, of(name, a.value)
    slope = {
        "sqrt": lambda: 1 / (2 * value), "exp": lambda: value, "log": lambda: 1 / v, "sin": lambda: of("cos", v),
        "cos": lambda: -of("sin", v), "tan": lambda: 1 + value * value, "atan": lambda: 1 / (1 + v * v),
        "asin": lambda: 1 / of("sqrt", 1 - v * v), "acos": lambda: -1 / of("sqrt", 1 - v * v),
    }[name]()  # fmt: skip
    return Jet(a.level, value, {key: slope * d for key, d in a.slopes.items()})


def angle(y: Any, x: Any) -> Any:
    """atan2 away from its jump."""
    if top := max(level(y), level(x)):
        a, b = (v if level(v) == top else Jet(top, v, {}) for v in (y, x))
        w = a.value * a.value + b.value * b.value
        return a._with(b, angle(a.value, b.value), b.value / w, -a.value / w)
    if isinstance(y, arb_series) or isinstance(x, arb_series):
        y, x = arb_series(y), arb_series(x)
        turning = (x * y.derivative() - y * x.derivative()) / (x * x + y * y)
        return turning.integral() + angle(y[0], x[0])
    demand(bool(x > 0 or y > 0 or y < 0), "an angle may jump")
    return arb.atan2(y, x)


def power(a: Any, b: Any) -> Any:
    """A power; whole ones as products."""
    if isinstance(b, arb) and b.is_integer() and abs(float(b)) < 64:
        product = a
        for _ in range(abs(int(float(b))) - 1):
            product = product * a
        return arb(1) if float(b) == 0 else product if float(b) > 0 else 1 / product
    return of("exp", b * of("log", a))


def hyperbolic(word: str, a: Any) -> Any:
    """By exponentials."""
    up, down = of("exp", a), of("exp", -a)
    return {"sinh": (up - down) / 2, "cosh": (up + down) / 2, "tanh": (up - down) / (up + down)}[word]


TWO = {"add": add, "sub": sub, "mul": mul, "div": truediv, "pow": power, "atan2": angle}


def run(tape: dict[str, Any], values: dict[tuple[str, str], Any]) -> list[Any]:
    """The outputs of a tape."""
    found: list[Any] = []
    for word, *rest in tape["instructions"]:
        if word in ("x", "u", "p"):
            found.append(values[word, rest[0]])
        elif word == "const":
            found.append(arb(fmpq(*float(rest[0]).as_integer_ratio())))
        else:
            a, *b = (found[i] for i in rest)
            one = hyperbolic if word in ("sinh", "cosh", "tanh") else of
            found.append(TWO[word](a, b[0]) if b else -a if word == "neg" else one(word, a))
    return [found[i] for i in tape["outputs"]]


def products(tape: dict[str, Any]) -> set[tuple[str, ...]]:
    """Of which controls there are products in the outputs of a tape, if these are polynomials of them."""
    found: list[set[tuple[str, ...]]] = []
    for word, *rest in tape["instructions"]:
        parts = [found[i] for i in rest] if word not in ("x", "u", "p", "const") else []
        known = [i for i in parts if i != {()}]
        if word in ("add", "sub", "neg"):
            found.append(set().union(*parts))
        elif word == "mul" or (word == "pow" and known and tape["instructions"][rest[1]] == ["const", 2.0]):
            a, b = parts if word == "mul" else (parts[0], parts[0])
            found.append({tuple(sorted(s + t)) for s in a for t in b})
        else:
            demand(not known or (word == "div" and parts[1] == {()}), f"a control has no formula, {word} of it")
            found.append({(rest[0],)} if word == "u" else known[0] if known else {()})
    return set().union(*(found[i] for i in tape["outputs"]))


def slope(of_what: Any, key: Any) -> Any:
    """The derivative that the outermost jet holds."""
    return of_what.slopes.get(key, arb(0)) if level(of_what) == 2 else arb(0)


def dot(a: list[Any], b: list[Any]) -> Any:
    """The sum of products."""
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))


def horner(c: list[Any], t: Any) -> Any:
    """A polynomial, lowest order first."""
    total = c[-1]
    for k in range(len(c) - 2, -1, -1):
        total = total * t + c[k]
    return total


def over(c: list[Any], t: Any) -> Any:
    """A polynomial over an interval, by its slope there."""
    return horner(c, t.mid()) + horner([k * own for k, own in enumerate(c)][1:] or [arb(0)], t) * (t - t.mid())


def listed(series: Any, count: int) -> list[Any]:
    """Coefficients of a series that is known far enough, or of a constant."""
    series = series.value if isinstance(series, Jet) else series
    if not isinstance(series, arb_series):
        return [arb(series), *[arb(0)] * (count - 1)]
    demand(series.prec >= count, "a series is shorter than its use")  # it has cut something off
    return [*(c := series.coeffs()[:count]), *[arb(0)] * (count - len(c))]


def plain(value: Any) -> Any:
    """The ball without derivatives."""
    return plain(value.value) if isinstance(value, Jet) else value if isinstance(value, arb_series) else arb(value)


def matrix(rows: list[Any], kind: Any, columns: int) -> Any:
    """Derivatives of level 1 by one kind of directions."""
    held = [row.slopes if isinstance(row, Jet) else {} for row in rows]
    return arb_mat([[slopes.get((*kind, b), 0) for b in range(columns)] for slopes in held])


def column(values: list[Any]) -> Any:
    """A matrix of one column."""
    return arb_mat([[value] for value in values])


def rational(text: str) -> Any:
    """A number written as a quotient."""
    return arb(fmpq(*map(int, text.split("/"))) if "/" in text else int(text))


def given(told: dict[str, Any]) -> Any:
    """A given value: a rational number times a power of pi."""
    return rational(told["number"]) * arb.pi() ** told.get("power_of_pi", 0)


def exact(text: str) -> Any:
    """A number written as mantissa*2^exponent."""
    mantissa, exponent = text.split("*2^")
    return arb(int(mantissa)) * arb(2) ** int(exponent)


def sentence(told: dict[str, Any]) -> str:
    """The theorem of a certificate in words: what is seen here, all of it, and nothing else."""
    values = [("J", told["objective"]), *((u["name"], u["enclosure"]) for u in told["unknowns"])]
    return (
        f"The problem {told['problem']['name']!r} as it stands here has an extremal of {len(told['arcs'])} arcs, a "
        "flight that satisfies Pontryagin's conditions exactly, with "
        f"{', '.join(f'{name} = {value}' for name, value in values)} in SI. "
        "No other has every unknown within `only_one_within` of its `centre`. No condition of the path and no bound "
        f"of a state or a control is broken by more than {TOLERANCE:g} in SI, no range of a parameter or an end at "
        "all; no multiplier says that a bound or a range should be left; and but for switches, and for a direction "
        "that is multiplied by 0, the control is the only one that minimises H."
    )


class _Proof:
    """The boundary value problem of a certificate."""

    def __init__(self, told: dict[str, Any]) -> None:
        self.told, self.problem, self.order, self.arcs = told, told["problem"], ORDER, told["arcs"]
        self.tape = self.problem["tapes"].get
        self.given = {name: given(stated) for name, stated in self.problem["given"].items()}
        self.free, self.phases = [f["name"] for f in self.problem["free"]], self.problem["phases"]
        follows = [arc["phase"] for arc in self.arcs]
        self.first, self.last = ([f(i for i, p in enumerate(follows) if p == k) for k in range(len(self.phases))]
                                 for f in (min, max))  # fmt: skip
        demand(told["format"] == FORMAT, "it has another format")
        self.well_formed()
        demand(follows == sorted(follows), "arcs are out of order")
        for i, (arc, grid) in enumerate(zip(self.arcs, told["grid"], strict=True)):
            demand(bool(arc["switched"]) == (i not in self.last), f"arc {i + 1} does not end where it says")
            demand(grid[0] == 0.0, f"the steps of arc {i + 1} do not begin where it does")
        self.constants = [[name for name in self.free if self.acts(k, name)] for k in range(len(self.phases))]
        self.sizes = [len(phase["states"]) + len(c) for phase, c in zip(self.phases, self.constants, strict=True)]
        ranges, self.held = ({(phase, name): side for phase, name, side in told["on_bounds"][of_what]}
                             for of_what in ("ranges", "states"))  # fmt: skip
        sides = {*told["on_bounds"]["free"].values(), *ranges.values(), *self.held.values()}
        demand(sides <= {"lower", "upper", "inside"}, "a bound has no such side")
        self.ends = [  # what each phase ends on: its multiplier, itself, and its side where it has sides
            [(f"{p['name']}.nu_{c['name']}", c, ranges.get((p["name"], c["name"]))) for c in p["end"]]
            + [(f"{p['name']}.mu_{s['name']}", s, side) for s in p["states"]
               if (side := self.held.get((p["name"], s["name"])))] for p in self.phases
        ]  # fmt: skip
        self.quadratic = [self.formula(k, phase) for k, phase in enumerate(self.phases)]
        named = [[s["name"] for s in phase["states"]] + c for phase, c in zip(self.phases, self.constants, strict=True)]
        names = [f"{p['name']}.lambda_{n}(0)" for p, own in zip(self.phases, named, strict=True) for n in own]
        names += [*self.free, *(name for own in self.ends for name, _, _ in own)]
        names += [f"{self.phases[arc['phase']]['name']}, length of arc {i - self.first[arc['phase']] + 1}"
                  for i, arc in enumerate(self.arcs) if arc["switched"]]  # fmt: skip
        demand(names == [u["name"] for u in told["unknowns"]], "the unknowns are named otherwise")

    def well_formed(self) -> None:
        """Names say one thing each, and nothing that is stated goes unnamed."""
        everything = [[*self.given, *self.free], [p["name"] for p in self.phases]]
        for k, p in enumerate(self.phases):
            everything += [[one["name"] for one in p[what]] for what in ("states", "end")]
            everything += [[n for c in p["controls"] for n in c["names"]], p["path"]]
            for what in ("path", "end"):
                count = len((self.tape(f"{what} {k}") or {"outputs": ()})["outputs"])
                demand(count == len(p[what]), f"{p['name']} does not name what its {what} states")
            demand(all(c["kind"] == "direction" or c["names"] == [c["name"]] for c in p["controls"]), "a name is none")
        for own in everything:
            demand(len({*own}) == len(own), "two things have one name")
            demand(all(name.replace("-", "_").isidentifier() for name in own), "a name is none")
        regimes = {regime for arc in self.arcs for regime in arc["regimes"].values()}
        demand(regimes <= {"lower", "upper", "interior"}, "a control has no such regime")

    def formula(self, k: int, phase: dict[str, Any]) -> set[str]:
        """The scalars that H is quadratic in, if its minimum is that of each control by itself."""
        scalars = {c["name"]: c for c in phase["controls"] if c["kind"] != "direction"}
        found, factors = products(self.tape(f"dynamics {k}")), {}
        for own in found:
            s, d = [n for n in own if n in scalars], [n for n in own if n not in scalars]
            demand(len(s) + len(d) < 3 and len({*s}) < 2 and len(d) < 2, f"H has no formula for its minimum, {own}")
            for c in phase["controls"]:
                if d and d[0] in c["names"]:
                    demand(factors.setdefault(d[0], s) == s, "a direction is multiplied and is not")
                    demand(not s or rational(scalars[s[0]]["lower"]) >= 0, "a factor of a direction may be negative")
        for c in phase["controls"]:
            demand(len({str(factors[n]) for n in c["names"] if n in factors}) < 2, "a direction has two factors")
        return {own[0] for own in found if len(own) == 2 and own[0] == own[1]}

    def acts(self, k: int, name: str) -> bool:
        limits = [c.get(side) for c in self.phases[k]["controls"] for side in ("lower", "upper")]
        return ["p", name] in self.tape(f"dynamics {k}")["instructions"] or name in limits

    def limit(self, stated: str, free: dict[str, Any]) -> Any:
        known = {**self.given, **free}
        demand(stated in known or not stated.isidentifier(), f"{stated} is no number that is given")
        return known[stated] if stated in known else rational(stated)

    def values(self, k: int, x: Any, u: dict[str, Any], free: dict[str, Any]) -> dict[tuple[str, str], Any]:
        found = {("p", name): v for name, v in {**self.given, **free}.items()} | {("u", n): v for n, v in u.items()}
        return found | {("x", s["name"]): v for s, v in zip(self.phases[k]["states"], x, strict=False)}

    def steered(self, i: int, z: list[Any]) -> tuple[list[Any], dict[str, Any], Any, list[Any]]:
        """z', the control that minimises H, what gives dH/du of scalars, and d2H/du2 where H is quadratic, on arc i."""
        k, regimes = self.arcs[i]["phase"], self.arcs[i]["regimes"]
        half, n = self.sizes[k], len(self.phases[k]["states"])
        x, lam, free = z[:half], z[half:], dict(zip(self.constants[k], z[n:half], strict=True))
        tape, controls = self.tape(f"dynamics {k}"), self.phases[k]["controls"]

        def pulls(u: dict[str, Any], names: list[str]) -> list[Any]:
            jets = {name: Jet(2, v, {name: arb(1)}) if name in names else v for name, v in u.items()}
            f = run(tape, self.values(k, x, jets, free))
            return [dot(lam[:n], [slope(rate, name) for rate in f]) for name in names]

        u: dict[str, Any] = {name: arb(not c["kind"] == "direction") for c in controls for name in c["names"]}
        for c in controls:
            if c["kind"] == "direction":  # a scalar that multiplies it does not turn it
                g = pulls(u, c["names"])
                strength = of("sqrt", dot(g, g))
                u |= {name: -own / strength for name, own in zip(c["names"], g, strict=True)}
        convex = []
        for c in (c for c in controls if c["kind"] != "direction"):
            name, regime = c["name"], regimes[c["name"]]
            s0, s1 = (pulls({**u, name: arb(v)}, [name])[0] for v in (0, 1)) if name in self.quadratic[k] else (0, 0)
            convex += [s1 - s0] if name in self.quadratic[k] else []
            u[name] = -s0 / (s1 - s0) if regime == "interior" else self.limit(c[regime], free)
        jets = [Jet(2, v, {j: arb(1)}) for j, v in enumerate(x)]
        moved = dict(zip(self.constants[k], jets[n:], strict=True))  # and what is on a bound that one of them holds
        held = {c["name"]: self.limit(c[side], moved) for c in controls
                if (side := regimes.get(c.get("name"), "interior")) != "interior"}  # fmt: skip
        f = run(tape, self.values(k, jets, u | held, moved))
        rates = [rate.value if level(rate) == 2 else rate for rate in f]
        adjoint = [-dot(lam[:n], [slope(rate, j) for rate in f]) for j in range(half)]
        return [*rates, *([arb(0)] * (half - n)), *adjoint], u, lambda name: pulls(u, [name])[0], convex

    # -- the flow

    def coefficients(self, i: int, z: list[Any], V: Any, orders: int) -> tuple[list[list[Any]], list[Any]]:
        ctx.cap = 1
        series = [arb_series([v], 1) for v in z]
        for k in range(orders):
            ctx.cap = k + 1
            rates = [listed(rate, k + 1) for rate in self.steered(i, series)[0]]
            ctx.cap = k + 2
            series = [arb_series([v, *(c / (j + 1) for j, c in enumerate(rate))], k + 2)
                      for v, rate in zip(z, rates, strict=True)]  # fmt: skip
        found = [listed(s, orders + 1) for s in series]
        if V is None:
            return found, []
        ctx.cap, size, tangents = orders, len(z), [V]
        jets = [Jet(1, arb_series(own[:orders], orders), {j: arb(1)}) for j, own in enumerate(found)]
        A: list[Any] = [arb_mat(size, size) for _ in range(orders)]
        for a, rate in enumerate(self.steered(i, jets)[0]):
            for b, d in rate.slopes.items() if isinstance(rate, Jet) else ():
                for k, c in enumerate(listed(d, orders)):
                    A[k][a, b] = c
        for k in range(orders):
            total = sum((A[j] * tangents[k - j] for j in range(1, k + 1)), A[0] * tangents[k])
            tangents.append(total * (1 / arb(k + 1)))
        return found, tangents

    def step(self, i: int, z: list[Any], V: Any, length: Any) -> tuple[list[Any], Any, Any]:
        n, span = self.order, arb(0).union(length)
        reach = arb(0).union(length**n)
        c, T = self.coefficients(i, z, V, n - 1)
        ranges, W = [horner(own, span) for own in c], None if V is None else horner(T, span)
        Z = [r + arb(0, WIDER * float(r.abs_upper()) + 1e-60) for r in ranges]
        if W is not None:
            wide = WIDER * max(float(w.abs_upper()) for w in W.entries()) + 1e-60
            W = arb_mat(W.nrows(), W.ncols(), [w + arb(0, wide) for w in W.entries()])
        over_z, over_T = self.coefficients(i, Z, W, n)
        pairs = [(r + own[n] * reach, whole) for r, own, whole in zip(ranges, over_z, Z, strict=True)]
        if W is not None:
            pairs += zip((horner(T, span) + over_T[n] * reach).entries(), W.entries(), strict=True)
        demand(all(whole.contains_interior(part) for part, whole in pairs), f"a step of arc {i + 1} is not enclosed")
        end = [horner([*own, last[n]], length) for own, last in zip(c, over_z, strict=True)]
        return end, None if V is None else horner([*T, over_T[n]], length), (c, [own[n] for own in over_z], length)

    # -- the conditions at the ends

    def unpacked(self, y: list[Any]) -> tuple[list[list[Any]], dict[str, Any], list[list[Any]], dict[int, Any]]:
        values = iter(y)
        lam = [[next(values) for _ in range(size)] for size in self.sizes]
        free = {name: next(values) for name in self.free}
        nu = [[next(values) for _ in own] for own in self.ends]
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
        lam, plainly, nu, _ = self.unpacked(y)
        free = {name: Jet(2, v, {("q", name): arb(1)}) for name, v in plainly.items()}
        x = {k: [Jet(2, v, {("x", k, j): arb(1)}) for j, v in enumerate(ends[self.last[k]][: self.sizes[k]])]
             for k in range(len(self.phases))}  # fmt: skip
        final = len(self.phases) - 1
        J = run(self.tape("objective"), self.values(final, x[final], {}, free))[0]
        L, conditions, asked = J, [], [self.duration(i, y) for i in range(len(self.arcs))]
        for k, phase in enumerate(self.phases):
            L = L + dot(lam[k], self.opening(k, x[k - 1] if k else [], free))
            psi = run(self.tape(f"end {k}"), self.values(k, x[k], {}, free)) if phase["end"] else []
            psi += [v for v, s in zip(x[k], phase["states"], strict=False) if (phase["name"], s["name"]) in self.held]
            for (_, c, side), value, multiplier in zip(self.ends[k], psi, nu[k], strict=True):
                L, inner = L + multiplier * value, value.value if level(value) == 2 else value
                demand((c["lower"] is c["upper"] is None) == (side is None), f"{c['name']} is no such condition")
                if side in (None, "inside"):
                    conditions.append(multiplier if side else inner)
                    asked += self.room(inner, c, {}) if side else []
                else:  # whose bound is given: a free one would have a part in dL/dq
                    conditions.append(inner - self.limit(c[side], {}))
                    asked += [multiplier if side == "upper" else -multiplier, *self.room(inner, {**c, side: None}, {})]
        costates = [ends[self.last[k]][size + j] - slope(L, ("x", k, j))
                    for k, size in enumerate(self.sizes) for j in range(size)]  # fmt: skip
        stationary = [slope(L, ("q", name)) for name in self.free]
        for k, phase in enumerate(self.phases):
            if phase["duration"] in self.free:
                end, own, half = ends[self.last[k]], self.free.index(phase["duration"]), self.sizes[k]
                H = dot(end[half:], self.steered(self.last[k], end)[0][:half])
                stationary[own] = stationary[own] + H
        for own, f in enumerate(self.problem["free"]):
            side = self.told["on_bounds"]["free"].get(f["name"])
            asked += self.room(plainly[f["name"]], {**f, side: None}, {})
            if side:
                asked.append(stationary[own] if side == "lower" else -stationary[own])
                stationary[own] = plainly[f["name"]] - self.limit(f[side], {})
        switches = [self.switch(i, ends[i]) for i, arc in enumerate(self.arcs) if arc["switched"]]
        return [*conditions, *costates, *stationary, *switches], J.value if level(J) == 2 else J, asked

    def room(self, value: Any, told: dict[str, Any], free: dict[str, Any]) -> list[Any]:
        """How far a value is above its lower and below its upper bound, where it has them."""
        signs = (("lower", 1), ("upper", -1))
        return [(value - self.limit(told[s], free)) * sign for s, sign in signs if told[s] is not None]

    def switch(self, i: int, end: list[Any]) -> Any:
        name = self.arcs[i]["switched"]
        _, u, slopes, _ = self.steered(i, end)
        if self.arcs[i]["regimes"][name] != "interior":
            return slopes(name)
        control = next(c for c in self.phases[self.arcs[i]["phase"]]["controls"] if c.get("name") == name)
        return u[name] - self.limit(control[self.arcs[i + 1]["regimes"][name]], {})

    # -- the proof

    def fly(self, y: list[Any], centre: Any = None) -> tuple[Any, Any]:
        """z at every node of every arc, and dz/dy there if it is that of a box, which that of its centre narrows."""
        nodes, by_y, z, V, size = [], [], [], None, len(y)
        aside = column([v - v.mid() for v in y])
        jets = [Jet(1, v, {("y", j): arb(1)}) for j, v in enumerate(y)]
        for i, begins in enumerate(self.grid):
            opened = self.start(i, jets, [Jet(1, v, {("z", j): arb(1)}) for j, v in enumerate(z)])
            D, lasts, before = V, self.duration(i, jets), len(z)
            z, V = [plain(v) for v in opened], None
            if centre:
                V = matrix(opened, ("y",), size)
                V = V + matrix(opened, ("z",), before) * D if before else V
            nodes, by_y = [*nodes, [z]], [*by_y, [V]]
            for a, b in pairwise([*begins, plain(lasts)]):
                z, V, _ = self.step(i, z, V, b - a)
                if centre:
                    if len(nodes[i]) == len(begins):
                        V = V + column([plain(rate) for rate in self.steered(i, z)[0]]) * matrix([lasts], ("y",), size)
                    moved = zip(z, centre[i][len(nodes[i])], (V * aside).entries(), strict=True)
                    z = [direct.intersection(near + off) for direct, near, off in moved]
                nodes[i].append(z)
                by_y[i].append(V)
        return nodes, by_y

    def check(self, tell: Any = print) -> tuple[list[Any], Any]:
        centre, radii = [exact(u["centre"]) for u in self.told["unknowns"]], self.told["only_one_within"]
        demand(all(arb(r) > 0 for r in radii), "a box without an inside")
        inverse, size = arb_mat([[arb(v) for v in row] for row in self.told["inverse"]]).mid(), len(centre)
        grid = [[*map(arb, begins), self.duration(i, centre)] for i, begins in enumerate(self.told["grid"])]
        self.grid = [
            [(a + (b - a) * j / PARTS).mid() for a, b in pairwise(times) for j in range(PARTS)] for times in grid
        ]
        near, _ = self.fly(centre)
        F, J, _ = self.residual(centre, [own[-1] for own in near])
        defect = (inverse * column([plain(value) for value in F])).entries()
        tell("flight of the centre enclosed")
        box = [c + arb(0, r) for c, r in zip(centre, radii, strict=True)]
        nodes, by_y = self.fly(box, near)
        tell("flight of the box enclosed")
        jets = [Jet(1, v, {("y", j): arb(1)}) for j, v in enumerate(box)]
        ends = [[Jet(1, v, {("z", i, j): arb(1)}) for j, v in enumerate(own[-1])] for i, own in enumerate(nodes)]
        F_box, J_box, _ = self.residual(jets, ends)
        slopes = matrix([*F_box, J_box], ("y",), size)
        for i, own in enumerate(by_y):
            slopes = slopes + matrix([*F_box, J_box], ("z", i), len(ends[i])) * own[-1]
        rows = slopes.tolist()
        E = arb_mat([[int(a == b) for b in range(size)] for a in range(size)]) - inverse * arb_mat(rows[:-1])
        moved = (E * column([arb(0, r) for r in radii])).entries()
        root = [c - d + e for c, d, e in zip(centre, defect, moved, strict=True)]
        inside = all(b.contains_interior(r) for b, r in zip(box, root, strict=True))
        demand(inside, "Krawczyk's operator leaves the box")
        for _ in range(3 * self.told["bits"]):  # the root is in it, so that |y - c| <= |C F(c)| + |E| |y - c|
            wider = [r - c for r, c in zip(root, centre, strict=True)]
            root = [c - d + e for c, d, e in zip(centre, defect, (E * column(wider)).entries(), strict=True)]
        aside = column([r - c for r, c in zip(root, centre, strict=True)])
        J = plain(J) + (arb_mat([rows[-1]]) * aside)[0, 0]
        told = [self.told["objective"], *(u["enclosure"] for u in self.told["unknowns"])]
        for value, claimed in zip([J, *root], map(arb, told), strict=True):
            demand(claimed.is_finite() and claimed.contains(value), f"{claimed} does not hold what it should")
        demand(self.told["theorem"] == sentence(self.told), "the theorem says something else")
        nodes = [[[n + m for n, m in zip(z, (V * aside).entries(), strict=True)] for z, V in zip(*own, strict=True)]
                 for own in zip(near, by_y, strict=True)]  # fmt: skip
        asked = self.residual(root, [own[-1] for own in nodes])[2]
        demand(all(value > 0 for value in asked), "a bound is broken, or would be left")
        for i, begins in enumerate(self.grid):
            for number, (a, b) in enumerate(pairwise([*begins, self.duration(i, root)])):
                self.along(i, number, self.step(i, nodes[i][number], None, b - a)[2], self.unpacked(root)[1])
        return root, J

    def along(self, i: int, number: int, step: Any, free: dict[str, Any]) -> None:
        """Limits and signs along one step; what a switch makes zero at an end of its arc, by its slope there."""
        (c, lasts, length), waiting, k = step, [(0.0, 1.0)], self.arcs[i]["phase"]
        zeros = {(1.0, self.arcs[i]["switched"])} if number + 1 == len(self.grid[i]) else set()
        zeros |= {(0.0, self.arcs[i - 1]["switched"])} if number == 0 and i not in self.first else set()
        while waiting:
            a, b = waiting.pop()
            t = length * arb(a).union(arb(b))
            z = [over(own, t) + end * t**self.order for own, end in zip(c, lasts, strict=True)]
            limits, signs = self.signs(i, k, z, free)
            unseen = [name for name, value in signs.items() if not value > 0]
            if all(value > -TOLERANCE and not value < 0 for value in limits) and all(
                any((end, name) in zeros and end in (a, b) and self.rising(i, k, z, free, name) * (1 - 2 * end) > 0
                    for end in (0.0, 1.0)) for name in unseen):  # fmt: skip
                continue
            demand(b - a > PIECES, f"a limit of arc {i + 1} is broken, or a sign is not seen")
            waiting += [(a, (a + b) / 2), ((a + b) / 2, b)]

    def rising(self, i: int, k: int, z: list[Any], free: dict[str, Any], name: str) -> Any:
        """The derivative of a sign by time."""
        ctx.cap = 2
        moving = [arb_series([v, plain(rate)], 2) for v, rate in zip(z, self.steered(i, z)[0], strict=True)]
        return listed(self.signs(i, k, moving, free)[1][name], 2)[1]

    def signs(self, i: int, k: int, z: list[Any], free: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
        """What may not be negative, and what has to be positive: that H is convex, and least on the bound it is on."""
        _, u, slopes, convex = self.steered(i, z)
        phase, limits, found = self.phases[k], [], {f"convex {j}": own for j, own in enumerate(convex)}
        limits += run(self.tape(f"path {k}"), self.values(k, z, u, free)) if phase["path"] else []
        for value, told in zip(z[: len(phase["states"])], phase["states"], strict=True):
            limits += self.room(value, told, free)
        for c in phase["controls"]:
            if (regime := self.arcs[i]["regimes"].get(c.get("name"))) is not None:
                limits += self.room(u[c["name"]], c, free)
            if regime in ("lower", "upper"):
                found[c["name"]] = slopes(c["name"]) * (1 if regime == "lower" else -1)
        return limits, found


def confirm(certificate: dict[str, Any], tell: Any = print) -> tuple[list[Any], Any]:
    """The unknowns and J of the one extremal of a certificate.

    Raises
    ------
    Failed
        If anything that its theorem says is not seen.
    """
    before = ctx.cap
    try:
        with ctx.workprec(certificate["bits"] + 32):
            return _Proof(certificate).check(tell)
    finally:
        ctx.cap = before


def main() -> int:
    """Check the certificate that is named; the exit code."""
    try:
        with open(sys.argv[1], encoding="utf-8") as file:
            certificate = json.load(file)
        confirm(certificate)
    except (Failed, OSError, ValueError, ArithmeticError, LookupError, TypeError, AttributeError) as error:
        print(f"not confirmed: {error if isinstance(error, (Failed, OSError)) else f'no certificate ({error!r})'}")
        return 1
    print(f"confirmed: {certificate['theorem']}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
