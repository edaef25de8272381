"""Pontryagin's conditions of a certificate's problem, in `expressions`.

Nothing of the prover is used. H = lambda . f and L = J + nu . psi + lambda(0) . x(0) give all:

    x' = f,  lambda' = -H_x,  u = argmin H;    psi = 0,  lambda(T) = dL/dx(T),  dL/dq = 0 (with H, of a duration q).

Scalars w that no formula gives are states: H_w = 0 where an arc begins, and w' = -H_ww^-1 (H_w)_z z' keeps it so.
"""

import re
from collections.abc import Sequence
from typing import Any

from flint import arb, fmpq

from perilune_checker.expressions import (
    DONE,
    ZERO,
    CertifiedExpression,
    CertifiedProgram,
    backward_gradient,
    make_operation,
    replace_symbols,
    require_claim,
    sum_of_products,
    symbol,
)

BY_EXPONENTIALS: dict[str, Any] = {
    "sinh": lambda up, down: (up - down) / 2, "cosh": lambda up, down: (up + down) / 2,
    "tanh": lambda up, down: (up - down) / (up + down),
}  # fmt: skip
Expressions = Sequence[CertifiedExpression]


def exact_number(text: str) -> Any:
    """A number written as p, p/q or p*2^e."""
    require_claim(re.fullmatch(r"-?\d+(/\d+)?(\*2\^-?\d{1,6})?", text, re.ASCII) is not None, f"{text} is no number")
    quotient, _, exponent = text.partition("*2^")
    return arb(fmpq(*map(int, quotient.split("/")))) * arb(2) ** int(exponent or 0)


def parse_given(told: dict[str, Any]) -> Any:
    """A given value: a rational number times a power of pi."""
    return exact_number(told["number"]) * arb.pi() ** told.get("power_of_pi", 0)


def exact_power(a: CertifiedExpression, b: CertifiedExpression) -> CertifiedExpression:
    """A power; whole ones of numbers as products.

    Parameters
    ----------
    a, b
        Base and exponent; for an exponent that is no integer, ``exp(b log(a))``.
    """
    ball = b.parts[0] if b.word == "number" else None
    if ball is None or not ball.is_integer() or abs(ball) > 64 or ball == 0:
        return make_operation("exp", b * make_operation("log", a))
    product = a
    for _ in range(abs(int(float(ball))) - 1):
        product = product * a
    return 1 / product if ball < 0 else product


def eliminate(rows: Sequence[list[Any]]) -> list[list[Any]]:
    """Rows that begin with a symmetric matrix, taken from each other: the matrix is positive if its pivots are."""
    rows = [*rows]
    for k in range(len(rows)):
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return rows


class CertifiedEquations:
    """The conditions of a certificate as programs.

    Unknowns y are lambda(0) of each phase, free parameters q, multipliers nu of what each phase ends on, lengths of
    arcs, and w where each begins; z = (x, lambda, w) of an arc, where a parameter that acts is a state that stays.
    """

    def __init__(self, told: dict[str, Any]) -> None:
        self.problem, self.arcs, self.on = told["problem"], told["arcs"], told["on_bounds"]
        self.weighed = told["weights"] is not None
        self.phases, self.free = self.problem["phases"], self.problem["free"]
        self.given = {
            name: CertifiedExpression("number", parse_given(own)) for name, own in self.problem["given"].items()
        }
        follows = [arc["phase"] for arc in self.arcs]
        self.first, self.last = ([f(i for i, own in enumerate(follows) if own == k) for k in range(len(self.phases))]
                                 for f in (min, max))  # fmt: skip
        self.stay = [[f["name"] for f in self.free if self.acts(k, f["name"])] for k in range(len(self.phases))]
        self.y = [symbol() for _ in told["unknowns"]]
        unnamed = [*zip((u["name"] for u in told["unknowns"]), self.y, strict=True)]

        def unknown(name: str) -> CertifiedExpression:
            require_claim(bool(unnamed) and unnamed[0][0] == name, "the unknowns are named otherwise")
            return unnamed.pop(0)[1]

        self.lam = [
            [unknown(f"{p['name']}.lambda_{name}(0)") for name in [*(s["name"] for s in p["states"]), *stay]]
            for p, stay in zip(self.phases, self.stay, strict=True)
        ]
        self.q = {f["name"]: unknown(f["name"]) for f in self.free}
        self.z = [[symbol() for _ in range(2 * len(self.lam[k]))] for k in follows]
        self.ends = [[(unknown(name), *own) for name, *own in self.end(k)] for k in range(len(self.phases))]
        self.lengths = {i: unknown(f"{self.phases[k]['name']}, length of arc {i - self.first[k] + 1}")
                        for i, k in enumerate(follows) if self.arcs[i]["switched"]}  # fmt: skip
        self.lasting = list[Any]()
        for i, k in enumerate(follows):
            whole = {**self.given, **self.q}[self.phases[k]["duration"]]
            self.lasting.append(self.lengths.get(i, whole - sum(self.lasting[self.first[k] : i], ZERO)))

        self.flown, before = [self.steered(i, z) for i, z in enumerate(self.z)], [[], *self.z[:-1]]
        arcs = [f"at the start of arc {i - self.first[k] + 1}" for i, k in enumerate(follows)]
        self.w = [[unknown(f"{self.phases[k]['name']}, {name} {arc}") for name in own["w"]]
                  for k, arc, own in zip(follows, arcs, self.flown, strict=True)]  # fmt: skip
        require_claim(not unnamed, "the unknowns are named otherwise")
        (self.J,) = self.traced("objective", len(self.phases) - 1, self.z[-1], {}, self.q)
        self.begins = [self.traced(f"links {k - 1}" if k else "start", max(k - 1, 0), before[i], {}, self.q)
                       for k, i in enumerate(self.first)]  # fmt: skip
        starts, residual, asked = self.conditions(before)
        self.residual = CertifiedProgram([self.y, *self.z], [*residual, self.J], 1 + len(self.z))
        self.asked = CertifiedProgram([self.y, *self.z], [*asked, *self.lasting])
        self.times = [CertifiedProgram([self.y], [own], 1) for own in self.lasting]
        self.starts = [CertifiedProgram([self.y, z], own, 2) for z, own in zip(before, starts, strict=True)]
        self.signed, along = [own["signed"] for own in self.flown], [*zip(self.z, self.flown, strict=True)]
        self.rates = [CertifiedProgram([z], own["rates"], 1) for z, own in along]
        self.limits, self.signs = (  # with their derivatives by time behind them
            [
                CertifiedProgram(
                    [self.y, z], own[what] + [sum_of_products(backward_gradient(v, z), own["rates"]) for v in own[what]]
                )
                for z, own in along
            ]
            for what in ("limits", "signs")
        )

    def acts(self, k: int, name: str) -> bool:
        """Return True if a free parameter moves a phase.

        Parameters
        ----------
        k
            Index of the phase.
        name
            Name of the free parameter.
        """
        limits = [c.get(side) for c in self.phases[k]["controls"] for side in ("lower", "upper")]
        return ["p", name] in self.problem["tapes"][f"dynamics {k}"]["instructions"] or name in limits

    def control(self, k: int, name: str) -> dict[str, Any]:
        """A scalar of a phase.

        Parameters
        ----------
        k
            Index of the phase.
        name
            Name of the scalar control.
        """
        (found,) = (c for c in self.phases[k]["controls"] if c["kind"] != "direction" and c["name"] == name)
        return found

    def limit(self, stated: str, free: dict[str, Any]) -> CertifiedExpression:
        """A bound: a number, or the name of one.

        Parameters
        ----------
        stated
            Exact number as text [SI], or name of a given or free parameter.
        free
            Expressions of the free parameters by name.
        """
        known = {**self.given, **free}
        require_claim(stated in known or not stated.isidentifier(), f"{stated} is no number that is given")
        return known[stated] if stated in known else CertifiedExpression("number", exact_number(stated))

    def room(self, value: Any, told: dict[str, Any], free: dict[str, Any]) -> list[CertifiedExpression]:
        """Return the distances of a value to its lower and its upper bound, where it has them, positive inside.

        Parameters
        ----------
        value
            Expression that is bounded.
        told
            Record of the certificate with the keys "lower" and "upper", None where there is no bound.
        free
            Expressions of the free parameters by name.
        """
        signs = (("lower", 1), ("upper", -1))
        return [(value - self.limit(told[s], free)) * sign for s, sign in signs if told[s] is not None]

    def traced(
        self, name: str, k: int, x: Expressions, u: dict[str, Any], free: dict[str, Any]
    ) -> list[CertifiedExpression]:
        """The outputs of a tape, with the states of phase k.

        Parameters
        ----------
        name
            Name of the tape; one that is not in the certificate has no outputs.
        k
            Index of the phase.
        x
            Expressions of its states, in order; more are ignored.
        u, free
            Expressions of the controls and of the free parameters by name.
        """
        values = {("p", n): v for n, v in {**self.given, **free}.items()} | {("u", n): v for n, v in u.items()}
        values |= {("x", s["name"]): v for s, v in zip(self.phases[k]["states"], x, strict=False)}
        tape, found = self.problem["tapes"].get(name, {"instructions": (), "outputs": ()}), list[CertifiedExpression]()
        for word, *rest in tape["instructions"]:
            if word in ("x", "u", "p", "const"):
                (own,) = rest
                if word == "const":  # a double, in the digits that distinguish it from others
                    require_claim(repr(float(own)) == str(own), f"{own} is no double")
                    values[word, own] = CertifiedExpression("number", arb(fmpq(*float(own).as_integer_ratio())))
                found.append(values[word, own])
                continue
            require_claim(all(type(j) is int and 0 <= j < len(found) for j in rest), "an operation has no such part")
            a, *b = (found[j] for j in rest)
            if word in BY_EXPONENTIALS and not b:
                found.append(BY_EXPONENTIALS[word](make_operation("exp", a), make_operation("exp", -a)))
            else:
                require_claim(word == "pow" or word in DONE, f"{word} is no operation")
                require_claim(
                    len(b) == (word in ("add", "sub", "mul", "div", "pow", "atan2")), f"{word} has other parts"
                )
                found.append(exact_power(a, *b) if word == "pow" else make_operation(word, a, *b))
        return [found[j] for j in tape["outputs"]]

    def end(self, k: int) -> list[tuple[Any, ...]]:
        """Return the end conditions of a phase: name of the multiplier, value, condition, and the side of a range."""
        phase, z = self.phases[k], self.z[self.last[k]]
        side, held = ({n: s for p, n, s in self.on[what] if p == phase["name"]} for what in ("ranges", "states"))
        conditions = zip(self.traced(f"end {k}", k, z, {}, self.q), phase["end"], strict=True)
        return [
            *((f"{phase['name']}.nu_{c['name']}", value, c, side.get(c["name"])) for value, c in conditions),
            *((f"{phase['name']}.mu_{s['name']}", z[j], s, held[s["name"]])
              for j, s in enumerate(phase["states"]) if s["name"] in held),
        ]  # fmt: skip

    def conditions(self, before: list[Any]) -> tuple[list[Any], list[Any], list[Any]]:
        """Return where arcs begin, what vanishes, and what has to be positive in addition."""
        L, F, asked = self.J, list[Any](), list[Any]()
        starts = [z[: 2 * len(self.lam[arc["phase"]])] for z, arc in zip(before, self.arcs, strict=True)]
        for k, i in enumerate(self.first):
            begins = [*self.begins[k], *(self.q[name] for name in self.stay[k])]
            starts[i], L = [*begins, *self.lam[k]], L + sum_of_products(self.lam[k], begins)
            for multiplier, value, c, side in self.ends[k]:
                L, held = L + multiplier * value, side in ("lower", "upper")
                require_claim((c["lower"] is c["upper"] is None) == (side is None), f"{c['name']} is no such condition")
                asked += self.room(value, {**c, side: None}, {})
                asked += [multiplier if side == "upper" else -multiplier] if held else []
                # whose bound is given: a free one would have a part in dL/dq
                F.append(value - self.limit(c[side], {}) if held else multiplier if side else value)
        for i, lam in zip(self.last, self.lam, strict=True):
            half = len(lam)
            slopes = backward_gradient(L, self.z[i][:half])
            F += [own - slope for own, slope in zip(self.z[i][half : 2 * half], slopes, strict=True)]
        for f in self.free:
            name, q, side = f["name"], self.q[f["name"]], self.on["free"].get(f["name"])
            lasting = [i for i, p in zip(self.last, self.phases, strict=True) if p["duration"] == name]
            slope = backward_gradient(L, [q])[0] + sum((self.flown[i]["H"] for i in lasting), ZERO)
            asked += [*self.room(q, {**f, side: None}, {}), *([slope if side == "lower" else -slope] if side else [])]
            F.append(q - self.limit(f[side], {}) if side else slope)
        for i, arc in enumerate(self.arcs):
            if name := arc["switched"]:
                c = self.control(arc["phase"], name)
                own, regime, follows = self.flown[i], arc["regimes"][name], self.arcs[i + 1]["regimes"][name]
                affine = "interior" in (regime, follows) or name not in own["curved"]
                require_claim(affine and regime != follows, f"{name} does not switch there")  # else H would jump
                inside = regime == "interior"
                F.append(own["u"][name] - self.limit(c[follows], {}) if inside else own["pulls"][name])
        for z, own, w, start in zip(self.z, self.flown, self.w, starts, strict=True):
            start += w
            F += replace_symbols([own["pulls"][name] for name in own["w"]], dict(zip(z, start, strict=True)))
        return starts, F, asked

    def steered(self, i: int, z: list[CertifiedExpression]) -> dict[str, Any]:
        """Return an arc's z', the u that minimises H, dH/du, H, limits, and signs by which that is the only minimum.

        Parameters
        ----------
        i
            Index of the arc.
        z
            Symbols of states, constant states and costates; those of w are appended.

        Returns
        -------
        dict
            Expressions by name, as the callers read them.
        """
        k, regimes, half = self.arcs[i]["phase"], self.arcs[i]["regimes"], len(z) // 2  # w comes behind it
        phase, n = self.phases[k], len(self.phases[k]["states"])
        u = {name: symbol() for c in phase["controls"] for name in c["names"]}
        moved = dict(zip(self.stay[k], z[n:half], strict=True))
        f = self.traced(f"dynamics {k}", k, z, u, moved)
        require_claim(len(f) == n, f"{phase['name']} has not as many rates as states")
        idle = self.unpriced(k, f, z, u)  # their costates vanish, as lambda' = -H_x and lambda(T) = 0 say
        bent = {j for j in idle if self.bends(f[j], u, regimes)}  # so that the control is chosen by H without them
        H = sum_of_products(z[half : half + n], f)
        told = (
            H
            if not bent
            else sum_of_products(z[half : half + n], [ZERO if j in bent else rate for j, rate in enumerate(f)])
        )
        scalars = {c["name"]: c for c in phase["controls"] if c["kind"] != "direction"}
        directions, found = [c for c in phase["controls"] if c["kind"] == "direction"], dict[str, Any]()
        curved, factors, joint = self.curved(told, u, scalars, directions)

        def at(values: dict[str, Any], *outputs: Any) -> list[Any]:
            return replace_symbols(outputs, {u[name]: value for name, value in values.items()})

        for c in directions:  # a scalar that multiplies it does not turn it
            g = at(dict.fromkeys(scalars, 1), *backward_gradient(told, [u[name] for name in c["names"]]))
            found |= {
                name: -own / make_operation("sqrt", sum_of_products(g, g))
                for name, own in zip(c["names"], g, strict=True)
            }
        of_scalars, *pulls = at(found, told, *backward_gradient(told, [u[name] for name in scalars]))
        held = {name: self.limit(c[regimes[name]], moved) for name, c in scalars.items() if regimes[name] != "interior"}
        w = {name: symbol() for name in scalars if joint and name not in held}
        known = {**held, **w}
        for name, pull in zip(scalars, pulls, strict=True):
            require_claim(name in held or name in curved, f"{name} is singular")
            found[name] = known[name] if name in known else -at({name: 0}, pull)[0] / curved[name]
        pulls = dict(zip(scalars, at(found, *pulls), strict=True))
        limits = self.traced(f"path {k}", k, z, found, self.q)
        bounded = [*zip(z, phase["states"], strict=False), *((found[name], scalars[name]) for name in scalars)]
        limits += [room for value, told in bounded for room in self.room(value, told, self.q)]
        adjoint = [
            -slope for slope in backward_gradient(at(held, H)[0], z[:half])
        ]  # a bound that holds u moves with what it is
        rates = at(found, *f, *[ZERO] * (half - n), *adjoint)
        rows = [
            [*backward_gradient(pulls[name], [*w.values()]), -sum_of_products(backward_gradient(pulls[name], z), rates)]
            for name in w
        ]
        moving, rows = list[CertifiedExpression](), eliminate(rows)
        for j, row in reversed([*enumerate(rows)]):
            moving = [(row[-1] - sum_of_products(row[j + 1 : -1], moving)) / row[j], *moving]
        twice = [row[j] for j, row in enumerate(rows)] if joint else at(found, *curved.values())
        signs = {f"{name} twice": own for name, own in zip(w if joint else curved, twice, strict=True)}
        signs |= {name: pulls[name] * (1 if regimes[name] == "lower" else -1) for name in held}
        if self.weighed:  # where nothing multiplied a direction, H would not ask for it
            signs |= {f"{name} multiplies": found[name] for name in factors if name not in held}
        z += w.values()
        return {
            "rates": [*rates, *moving], "u": found, "w": [*w], "pulls": pulls, "curved": curved, "factors": factors,
            "signed": [*signs], "signs": [*signs.values()], "limits": limits, "H": at(found, H)[0],
            "joint": (of_scalars, {name: u[name] for name in scalars}, self.ranges(scalars, moved)) if joint else None,
        }  # fmt: skip

    def bends(self, rate: CertifiedExpression, u: dict[str, Any], regimes: dict[str, str]) -> bool:
        """Return True if a rate is not linear in the controls together, and all those in it are on their bounds.

        Parameters
        ----------
        rate
            Rate of a state, an expression of the controls.
        u
            Symbols of the controls by name.
        regimes
            Regime of each scalar control by name, "lower", "upper" or "interior".
        """
        slopes = dict(zip(u, backward_gradient(rate, [*u.values()]), strict=True))
        held = all(slope is ZERO or regimes.get(name, "interior") != "interior" for name, slope in slopes.items())
        return held and any(d is not ZERO for slope in slopes.values() for d in backward_gradient(slope, [*u.values()]))

    def unpriced(self, k: int, f: Expressions, z: Expressions, u: dict[str, Any]) -> set[int]:
        """States of a phase in no condition, no bound, nothing behind it, and no rate of a state that is in one.

        Parameters
        ----------
        k
            Index of the phase.
        f
            Expressions of its rates, one for each state.
        z
            Symbols of its states, and those behind them.
        u
            Symbols of the controls by name.

        Returns
        -------
        set
            Indices of these states.
        """
        behind = f"links {k}" if k + 1 < len(self.phases) else "objective"
        asked = [e for name in (f"end {k}", behind) for e in self.traced(name, k, z, {}, self.q)]
        asked += self.traced(f"path {k}", k, z, u, self.q)
        told = self.phases[k]["states"]
        bounded = {j for j, own in enumerate(told) if own["lower"] is not None or own["upper"] is not None}

        def read(outputs: Expressions) -> set[int]:
            slopes = [backward_gradient(e, z[: len(f)]) for e in outputs]
            return {j for own in slopes for j, slope in enumerate(own) if slope is not ZERO}

        priced = bounded | read(asked)
        while more := read([f[j] for j in priced]) - priced:
            priced |= more
        return {*range(len(f))} - priced

    def ranges(self, scalars: dict[str, Any], moved: dict[str, Any]) -> list[CertifiedExpression]:
        """Both bounds of each scalar.

        Parameters
        ----------
        scalars
            Records of the scalar controls by name.
        moved
            Expressions of the free parameters by name.

        Returns
        -------
        list
            Lower and upper bound of the first scalar, then of the next.
        """
        bounds = [(c["lower"], c["upper"]) for c in scalars.values()]
        require_claim(
            all(bound is not None for own in bounds for bound in own), "a control without a formula has no range"
        )
        return [self.limit(bound, moved) for own in bounds for bound in own]

    def curved(
        self, H: CertifiedExpression, u: dict[str, Any], scalars: dict[str, Any], directions: list[Any]
    ) -> tuple[dict[str, Any], set[str], bool]:
        """d2H/du2 of scalars, which of them multiply directions, and whether no formula gives them.

        Parameters
        ----------
        H
            The Hamiltonian as an expression of the controls.
        u
            Symbols of the controls by name.
        scalars
            Records of the scalar controls by name.
        directions
            Records of the directions.
        """
        slopes = dict(zip(u, backward_gradient(H, [*u.values()]), strict=True))
        form = {(a, b): own for a in u for b, own in zip(u, backward_gradient(slopes[a], [*u.values()]), strict=True)}
        form, factors = {pair: own for pair, own in form.items() if own is not ZERO}, set[str]()
        moved = {
            pair for pair, own in form.items() if any(d is not ZERO for d in backward_gradient(own, [*u.values()]))
        }
        between = [(a, b) for a, b in form if a in scalars and b in scalars]
        require_claim(moved <= {*between}, "H has no formula for its minimum")
        for c in directions:
            own = {b for a, b in form if a in c["names"]}
            require_claim(any(slopes[name] is not ZERO for name in c["names"]), f"{c['names']} moves nothing")
            require_claim(own <= {*scalars} and len(own) < 2, "H has no formula for its minimum")
            factors |= own
            for s in own:
                rest = replace_symbols([slopes[name] for name in c["names"]], {u[s]: ZERO})
                require_claim(all(slope is ZERO for slope in rest), "a direction is multiplied and is not")
                least = scalars[s]["lower"]
                fine = least is not None and bool(self.limit(least, {}).parts[0] >= 0)
                require_claim(fine, "a factor of a direction may be negative")
        joint = bool(moved) or any(a != b for a, b in between)
        return {a: form.get((a, a), ZERO) for a, _ in between}, factors, joint
