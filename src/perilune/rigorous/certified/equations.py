"""What a certificate states: Pontryagin's conditions of its problem in CasADi's symbols, done with balls.

Nothing of the prover is used. Derivatives are CasADi's, of the problem's tapes, in which every number is a symbol, so
that none is rounded, and nothing is cancelled. H = lambda . f and L = J + nu . psi + lambda(0) . x(0) give all:

    x' = f,  lambda' = -H_x,  u = argmin H;    psi = 0,  lambda(T) = dL/dx(T),  dL/dq = 0 (with H, of a duration q).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from operator import add, methodcaller, mul, neg, sub, truediv
from typing import Any

import casadi as ca
from flint import arb, arb_mat, arb_series, fmpq


class Failed(Exception):
    """What the certificate claims is not so, or cannot be seen."""


def demand(held: bool, told: str) -> None:
    """Go on only if it is so."""
    if not held:
        raise Failed(told)


@contextmanager
def simplified(on: bool) -> Iterator[None]:
    """Whether CasADi cancels what it can: x / x is 1 then, at 0 too."""
    before = ca.GlobalOptions.getSimplificationOnTheFly()
    ca.GlobalOptions.setSimplificationOnTheFly(on)
    try:
        yield
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(before)


def number(text: str) -> Any:
    """A number written as p, p/q or p*2^e."""
    quotient, _, exponent = text.partition("*2^")
    return arb(fmpq(*map(int, quotient.split("/")))) * arb(2) ** int(exponent or 0)


def given(told: dict[str, Any]) -> Any:
    """A given value: a rational number times a power of pi."""
    return number(told["number"]) * arb.pi() ** told.get("power_of_pi", 0)


def angle(y: Any, x: Any) -> Any:
    """atan2 away from its jump."""
    if isinstance(y, arb_series) or isinstance(x, arb_series):
        y, x = arb_series(y), arb_series(x)
        turning = (x * y.derivative() - y * x.derivative()) / (x * x + y * y)
        return turning.integral() + angle(y[0], x[0])
    demand(bool(x > 0 or y > 0 or y < 0), "an angle may jump")
    return arb.atan2(y, x)


ONE = ("sqrt", "exp", "log", "sin", "cos", "tan", "atan", "asin", "acos")
IN_SYMBOLS = {  # what tapes do; powers are `Equations.power`
    "add": add, "sub": sub, "mul": mul, "div": truediv, "neg": neg, "atan2": ca.atan2,
    **{word: getattr(ca, word) for word in ONE}, "sinh": lambda a: (ca.exp(a) - ca.exp(-a)) / 2,
    "cosh": lambda a: (ca.exp(a) + ca.exp(-a)) / 2, "tanh": lambda a: 1 - 2 / (ca.exp(2 * a) + 1),
}  # fmt: skip
IN_BALLS = {  # what CasADi's instructions do
    ca.OP_ADD: add, ca.OP_SUB: sub, ca.OP_MUL: mul, ca.OP_DIV: truediv, ca.OP_NEG: neg, ca.OP_ATAN2: angle,
    ca.OP_SQ: lambda a: a * a, ca.OP_TWICE: lambda a: a + a, ca.OP_INV: lambda a: 1 / a,
    **{getattr(ca, f"OP_{word.upper()}"): methodcaller(word) for word in ONE},
}  # fmt: skip


class Program:
    """Expressions, done with balls or with series of them, and their derivatives by the first groups of inputs."""

    def __init__(self, numbers: dict[int, Any], groups: list[Any], outputs: list[Any], slopes: int = 0) -> None:
        column, self.numbers = ca.vertcat(*outputs), [ball for _, ball in numbers.values()]
        inputs = [*groups, ca.vertcat(*(symbol for symbol, _ in numbers.values()))]
        f = ca.Function("f", inputs, [ca.cse(ca.densify(ca.vec(column.T)))])
        self.shape, self.instructions = column.shape, [
            (k := f.instruction_id(i), f.instruction_input(i), f.instruction_output(i),
             arb(f.instruction_constant(i)) if k == ca.OP_CONST else None) for i in range(f.n_instructions())
        ]  # fmt: skip
        self.slopes = [Program(numbers, groups, [ca.jacobian(column, own)]) for own in groups[:slopes]]

    def __call__(self, *groups: Any) -> list[Any]:
        """The outputs, row by row."""
        read, w, found = [*groups, self.numbers], dict[int, Any](), [arb(0)] * (self.shape[0] * self.shape[1])
        for word, come, go, constant in self.instructions:
            if word == ca.OP_OUTPUT:
                found[go[1]] = w[come[0]]
            elif word == ca.OP_INPUT:
                w[go[0]] = read[come[0]][come[1]]
            else:
                w[go[0]] = IN_BALLS[word](*(w[j] for j in come)) if constant is None else constant
        return found

    def matrix(self, *groups: Any) -> Any:
        """The outputs as a matrix."""
        return arb_mat(self.shape[0], self.shape[1], self(*groups))


class Equations:
    """The conditions of a certificate as programs.

    Unknowns y are lambda(0) of each phase, free parameters q, multipliers nu of what each phase ends on, and lengths of
    arcs; z = (x, lambda) of an arc, where a parameter that acts in its phase is a state that stays.
    """

    def __init__(self, told: dict[str, Any]) -> None:
        self.problem, self.arcs, self.on = told["problem"], told["arcs"], told["on_bounds"]
        self.phases, self.free, self.numbers = self.problem["phases"], self.problem["free"], dict[int, Any]()
        self.given = {name: self.number(given(own)) for name, own in self.problem["given"].items()}
        follows = [arc["phase"] for arc in self.arcs]
        self.first, self.last = ([f(i for i, own in enumerate(follows) if own == k) for k in range(len(self.phases))]
                                 for f in (min, max))  # fmt: skip
        self.stay = [[f["name"] for f in self.free if self.acts(k, f["name"])] for k in range(len(self.phases))]

        self.y = y = ca.SX.sym("y", len(told["unknowns"]))
        named = iter([*zip((u["name"] for u in told["unknowns"]), ca.vertsplit(y), strict=True), ("", None)])

        def unknown(name: str) -> Any:
            expected, symbol = next(named)
            demand(expected == name, "the unknowns are named otherwise")
            return symbol

        self.lam = [
            ca.vertcat(*(unknown(f"{p['name']}.lambda_{n}(0)") for n in [*(s["name"] for s in p["states"]), *stay]))
            for p, stay in zip(self.phases, self.stay, strict=True)
        ]
        self.q = {f["name"]: unknown(f["name"]) for f in self.free}
        self.z = [ca.SX.sym("z", 2 * self.lam[k].numel()) for k in follows]
        self.ends = [[(unknown(name), *own) for name, *own in self.end(k)] for k in range(len(self.phases))]
        self.lengths = {i: unknown(f"{self.phases[k]['name']}, length of arc {i - self.first[k] + 1}")
                   for i, k in enumerate(follows) if self.arcs[i]["switched"]}  # fmt: skip
        unknown("")
        self.lasting = list[Any]()
        for i, k in enumerate(follows):
            whole = {**self.given, **self.q}[self.phases[k]["duration"]]
            self.lasting.append(self.lengths.get(i, whole - sum(self.lasting[self.first[k] : i])))

        self.flown, before = [self.steered(i, z) for i, z in enumerate(self.z)], [ca.SX(0, 1), *self.z[:-1]]
        self.J = self.traced("objective", len(self.phases) - 1, self.z[-1], {}, self.q)[0]
        self.begins = [
            ca.vertcat(*self.traced(f"links {k - 1}" if k else "start", max(k - 1, 0), before[i], {}, self.q))
            for k, i in enumerate(self.first)
        ]
        starts, residual, asked = self.conditions(before)
        self.residual = self.program([y, *self.z], [*residual, self.J], 1 + len(self.z))
        self.asked = self.program([y, *self.z], [*asked, *self.lasting])
        self.times = [self.program([y], [own], 1) for own in self.lasting]
        self.starts = [self.program([y, z], [own], 2) for z, own in zip(before, starts, strict=True)]
        self.signed, along = [own["signed"] for own in self.flown], [*zip(self.z, self.flown, strict=True)]
        self.rates = [self.program([z], [own["rates"]], 1) for z, own in along]
        self.limits, self.signs = (  # with their derivatives by time behind them
            [self.program([y, z], own[what] + [ca.jtimes(v, z, own["rates"]) for v in own[what]]) for z, own in along]
            for what in ("limits", "signs")
        )

    def program(self, groups: list[Any], outputs: list[Any], slopes: int = 0) -> Program:
        """Expressions as a program."""
        return Program(self.numbers, groups, outputs, slopes)

    def number(self, ball: Any) -> Any:
        """A symbol for a number."""
        symbol = ca.SX.sym("number")
        self.numbers[symbol.element_hash()] = symbol, ball
        return symbol

    def acts(self, k: int, name: str) -> bool:
        """Whether a free parameter moves a phase."""
        limits = [c.get(side) for c in self.phases[k]["controls"] for side in ("lower", "upper")]
        return ["p", name] in self.problem["tapes"][f"dynamics {k}"]["instructions"] or name in limits

    def limit(self, stated: str, free: dict[str, Any]) -> Any:
        """A bound: a number, or the name of one."""
        known = {**self.given, **free}
        demand(stated in known or not stated.isidentifier(), f"{stated} is no number that is given")
        return known[stated] if stated in known else self.number(number(stated))

    def room(self, value: Any, told: dict[str, Any], free: dict[str, Any]) -> list[Any]:
        """How far a value is above its lower and below its upper bound, where it has them."""
        signs = (("lower", 1), ("upper", -1))
        return [(value - self.limit(told[s], free)) * sign for s, sign in signs if told[s] is not None]

    def power(self, a: Any, b: Any) -> Any:
        """A power; whole ones as products."""
        _, ball = self.numbers.get(b.element_hash(), (None, None))
        if ball is None or not ball.is_integer() or abs(ball) > 64:
            return ca.exp(b * ca.log(a))
        product = ca.SX(1)
        for _ in range(abs(int(float(ball)))):
            product = product * a
        return 1 / product if ball < 0 else product

    def traced(self, name: str, k: int, x: Any, u: dict[str, Any], free: dict[str, Any]) -> list[Any]:
        """The outputs of a tape, with the states of phase k."""
        values = {("p", n): v for n, v in {**self.given, **free}.items()} | {("u", n): v for n, v in u.items()}
        values |= {("x", s["name"]): v for s, v in zip(self.phases[k]["states"], ca.vertsplit(x), strict=False)}
        tape, found = self.problem["tapes"].get(name, {"instructions": (), "outputs": ()}), list[Any]()
        for word, *rest in tape["instructions"]:
            if word in ("x", "u", "p"):
                found.append(values[word, rest[0]])
            elif word == "const":
                found.append(self.number(arb(float(rest[0]))))
            else:
                found.append((self.power if word == "pow" else IN_SYMBOLS[word])(*(found[j] for j in rest)))
        return [found[j] for j in tape["outputs"]]

    def end(self, k: int) -> list[tuple[Any, ...]]:
        """What a phase ends on: the name of its multiplier, its value, itself, and its side if it has sides."""
        phase, z = self.phases[k], self.z[self.last[k]]
        side, held = ({n: s for p, n, s in self.on[what] if p == phase["name"]} for what in ("ranges", "states"))
        conditions = zip(self.traced(f"end {k}", k, z, {}, self.q), phase["end"], strict=True)
        return [
            *((f"{phase['name']}.nu_{c['name']}", value, c, side.get(c["name"])) for value, c in conditions),
            *((f"{phase['name']}.mu_{s['name']}", z[j], s, held[s["name"]])
              for j, s in enumerate(phase["states"]) if s["name"] in held),
        ]  # fmt: skip

    def conditions(self, before: list[Any]) -> tuple[list[Any], list[Any], list[Any]]:
        """Where arcs begin, what vanishes, and what has to be positive beside it."""
        L, starts, F, asked = self.J, [*before], list[Any](), list[Any]()
        for k, i in enumerate(self.first):
            begins = ca.vertcat(self.begins[k], *(self.q[name] for name in self.stay[k]))
            starts[i], L = ca.vertcat(begins, self.lam[k]), L + ca.dot(self.lam[k], begins)
            for multiplier, value, c, side in self.ends[k]:
                L, held = L + multiplier * value, side in ("lower", "upper")
                demand((c["lower"] is c["upper"] is None) == (side is None), f"{c['name']} is no such condition")
                asked += self.room(value, {**c, side: None}, {})
                asked += [multiplier if side == "upper" else -multiplier] if held else []
                # whose bound is given: a free one would have a part in dL/dq
                F.append(value - self.limit(c[side], {}) if held else multiplier if side else value)
        for i, lam in zip(self.last, self.lam, strict=True):
            F.append(self.z[i][lam.numel() :] - ca.gradient(L, self.z[i])[: lam.numel()])
        for f in self.free:
            name, q, side = f["name"], self.q[f["name"]], self.on["free"].get(f["name"])
            lasting = [i for i, p in zip(self.last, self.phases, strict=True) if p["duration"] == name]
            slope = ca.gradient(L, q) + sum(self.flown[i]["H"] for i in lasting)
            asked += [*self.room(q, {**f, side: None}, {}), *([slope if side == "lower" else -slope] if side else [])]
            F.append(q - self.limit(f[side], {}) if side else slope)
        for i, arc in enumerate(self.arcs):
            if name := arc["switched"]:
                (c,) = (c for c in self.phases[arc["phase"]]["controls"] if c["names"] == [name])
                inside, bound = arc["regimes"][name] == "interior", self.arcs[i + 1]["regimes"][name]
                own = self.flown[i]
                F.append(own["u"][name] - self.limit(c[bound], {}) if inside else own["pulls"][name])
        return starts, F, asked

    def steered(self, i: int, z: Any) -> dict[str, Any]:
        """Of an arc: z', the u that minimises H, dH/du, H, limits, and signs by which that is the only minimum."""
        k, regimes, half = self.arcs[i]["phase"], self.arcs[i]["regimes"], z.numel() // 2
        phase, n = self.phases[k], len(self.phases[k]["states"])
        u = {name: ca.SX.sym(name) for c in phase["controls"] for name in c["names"]}
        moved = dict(zip(self.stay[k], ca.vertsplit(z[n:half]), strict=True))
        f = ca.vertcat(*self.traced(f"dynamics {k}", k, z, u, moved))
        H = ca.dot(z[half : half + n], f)
        scalars = {c["name"]: c for c in phase["controls"] if c["kind"] != "direction"}
        directions, found = [c for c in phase["controls"] if c["kind"] == "direction"], dict[str, Any]()

        def put(into: Any, values: dict[str, Any]) -> Any:
            pairs = [(u[name], value) for name, value in values.items()]
            return ca.substitute(into, *(ca.vertcat(*own) for own in zip(*pairs, strict=True))) if pairs else into

        with simplified(True):  # to see what is 0
            curved, factors = self.curved(H, u, scalars, directions)
        for c in directions:  # a scalar that multiplies it does not turn it
            g = put(ca.gradient(H, ca.vertcat(*(u[name] for name in c["names"]))), dict.fromkeys(scalars, 1))
            found |= zip(c["names"], ca.vertsplit(-g / ca.sqrt(ca.dot(g, g))), strict=True)
        pulls = {name: put(ca.gradient(H, u[name]), found) for name in scalars}
        held = {name: self.limit(c[regimes[name]], moved) for name, c in scalars.items() if regimes[name] != "interior"}
        for name, pull in pulls.items():
            demand(name in held or name in curved, f"{name} is singular")
            found[name] = held[name] if name in held else -put(pull, {name: 0}) / curved[name]
        pulls = {name: put(pull, found) for name, pull in pulls.items()}
        signs = {f"{name} twice": put(own, found) for name, own in curved.items()}
        signs |= {name: pulls[name] * (1 if regimes[name] == "lower" else -1) for name in held}
        limits = self.traced(f"path {k}", k, z, found, self.q)
        bounded = [*zip(ca.vertsplit(z), phase["states"], strict=False), *((found[n], scalars[n]) for n in scalars)]
        limits += [room for value, told in bounded for room in self.room(value, told, self.q)]
        adjoint = -ca.gradient(put(H, held), z)[:half]  # a bound that holds a control moves with what it is
        return {
            "rates": put(ca.vertcat(f, ca.SX.zeros(half - n), adjoint), found), "u": found, "pulls": pulls,
            "factors": factors, "signed": [*signs], "signs": [*signs.values()], "limits": limits, "H": put(H, found),
        }  # fmt: skip

    def curved(self, H: Any, u: dict[str, Any], scalars: dict[str, Any], directions: list[Any]) -> tuple[Any, set[str]]:
        """d2H/du2 of scalars, if the minimum of H is that of each control by itself; and which multiply directions."""
        controls, names, form = ca.vertcat(*u.values()), [*u], ca.hessian(H, ca.vertcat(*u.values()))[0]
        demand(not ca.depends_on(form, controls), "H has no formula for its minimum")
        pairs = [(names[a], names[b]) for a, b in zip(*form.sparsity().get_triplet(), strict=True)]
        factors = set[str]()
        for c in directions:
            own = {b for a, b in pairs if a in c["names"]}
            demand(own <= {*scalars} and len(own) < 2, "H has no formula for its minimum")
            factors |= own
            for s in own:
                rest = ca.substitute(ca.gradient(H, ca.vertcat(*(u[name] for name in c["names"]))), u[s], 0)
                demand(rest.is_zero(), "a direction is multiplied and is not")
                _, least = self.numbers[self.limit(scalars[s]["lower"], {}).element_hash()]
                demand(bool(least >= 0), "a factor of a direction may be negative")
        twice = [(a, b) for a, b in pairs if a in scalars and b in scalars]
        demand(all(a == b for a, b in twice), "H has no formula for its minimum")
        return {a: form[names.index(a), names.index(a)] for a, _ in twice}, factors
