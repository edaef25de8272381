"""Canonical equations of one smooth arc, derived from the problem's tapes only by the rules of `graph`.

With H = lambda . f(x, u, p), which the control minimises: x' = f, lambda' = -dH/dx, and a free parameter q in the
dynamics is a constant state, whose costate collects the integral of dH/dq (`perilune.conditions.pontryagin` states the
same, and is not used). The control is eliminated in closed form: a direction d that enters H as g . d is -g/|g|; a
scalar is on the bound that its regime names, or where dH/du = 0 if H is quadratic in it. Where no formula gives all
scalars that are on no bound, these are states w behind the costate: dH/dw = 0 where the arc begins, and as

    w' = -(H_ww)^-1 (dH/dw)_z z'

keeps it so, all along. A state that nothing asks for has no costate, lambda = 0 being what lambda' = -dH/dx and
lambda(T) = 0 say: where its rate bends H in controls on their bounds these are chosen by H without it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from perilune.problem import Phase, Problem, ScalarControl, Settled, UnitVectorControl, scalars
from perilune.rigorous.exact_tape import Unsupported, exact_value, read_tape
from perilune.rigorous.graph import Graph, GraphExpression
from perilune.rigorous.taylor import TaylorProgram

Key = tuple[Any, ...]
Regimes = Mapping[str, str]  # of each scalar by name: lower, upper or interior


@dataclass(frozen=True, kw_only=True, eq=False)
class ArcScalar:
    """A scalar control on an arc: where it is, and what must hold there.

    Attributes
    ----------
    control, regime
        Which, and whether it is on its ``lower`` or ``upper`` bound or ``interior``.
    value, limits
        What it is, and its bounds.
    slope, curvature
        dH/du and d2H/du2 on the extremal.
    """

    control: ScalarControl
    regime: str
    value: GraphExpression
    limits: tuple[GraphExpression | None, GraphExpression | None]
    slope: GraphExpression
    curvature: GraphExpression


@dataclass(frozen=True, kw_only=True, eq=False)
class CanonicalArc:
    """Canonical equations of a phase in one regime, z = (x, constant states, lambda, w) in SI.

    Attributes
    ----------
    graph
        Of all expressions here, whose inputs are ``("z", i)``.
    phase, phase_index
        Whose.
    constants
        Names of the free parameters that are states.
    half
        Length of lambda.
    joint
        True if the least for each scalar by itself may be no minimum of all, which has to be proved (`minimum`).
    implicit
        Names of the scalars w that no formula gives.
    stationary
        dH/dw of these.
    reduced
        H of z without w, directions eliminated: its inputs are z and ``("u", name)`` of each scalar.
    rates
        z'.
    hamiltonian
        H.
    control
        The control that minimises H, by the key of each component.
    scalars
        Every scalar control.
    strengths
        |dH/dd| of each direction d, which has to be positive: what the strengthened Legendre condition asks of it.
    """

    graph: Graph
    phase: Phase
    phase_index: int
    constants: tuple[str, ...]
    half: int
    joint: bool
    implicit: tuple[str, ...]
    stationary: tuple[GraphExpression, ...]
    reduced: GraphExpression
    rates: tuple[GraphExpression, ...]
    hamiltonian: GraphExpression
    control: Mapping[Any, GraphExpression]
    scalars: tuple[ArcScalar, ...]
    strengths: tuple[GraphExpression, ...]

    @property
    def idle(self) -> bool:
        """Return True if the factor of a direction in H may vanish."""
        return bool(self.strengths) and any(scalar.regime == "lower" for scalar in self.scalars)

    @property
    def keys(self) -> list[Key]:
        """Keys of z."""
        return [("z", i) for i in range(len(self.rates))]

    @cached_property
    def plain(self) -> TaylorProgram:
        """The rates."""
        return TaylorProgram(self.graph, self.keys, self.rates)

    @cached_property
    def pattern(self) -> list[tuple[int, int]]:
        """Return the places where the Jacobian of the rates does not vanish for all z."""
        return [place for place, _ in self._slopes]

    @cached_property
    def slopes(self) -> TaylorProgram:
        """The derivatives of the rates in the order of `pattern`."""
        return TaylorProgram(self.graph, self.keys, [slope for _, slope in self._slopes])

    @cached_property
    def with_slopes(self) -> TaylorProgram:
        """The rates, and these."""
        return TaylorProgram(self.graph, self.keys, [*self.rates, *(slope for _, slope in self._slopes)])

    @cached_property
    def _slopes(self) -> list[tuple[tuple[int, int], GraphExpression]]:
        rows = self.graph.jacobian(self.rates, self.keys)
        return [((i, j), e) for i, row in enumerate(rows) for j, e in enumerate(row) if not e.vanishes()]


class ProblemReader:
    """Reads the functions of a problem into one graph, given parameters as the exact numbers that they are."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.graph = problem, Graph()
        self.given = {name: exact_value(g).expression(self.graph) for name, g in problem.given.items()}

    def function(self, key: Any, x: Sequence[Any] = (), u: Sequence[Any] = (), free: Mapping[str, Any] | None = None,
                 phase: Phase | None = None) -> list[GraphExpression]:  # fmt: skip
        """Values of a function of the problem by its key in `perilune.problem.tracing.traced_problem`.

        Parameters
        ----------
        key
            ``(phase index, name)``, ``("links", index)``, "start" or "objective".
        x, u
            Expressions of the states and of the controls, in the order of the phase [SI].
        free
            Expressions of the free parameters by name [SI].
        phase
            Phase that the names of x and u are taken from; None for a function of parameters only.
        """
        values: dict[tuple[str, str], Any] = {("p", name): value for name, value in self.given.items()}
        values |= {("p", name): value for name, value in (free or {}).items()}
        if phase is not None:
            values |= {("x", name): value for name, value in zip(phase.state_names, x, strict=False)}
            values |= {("u", name): value for name, value in zip(phase.control_names, u, strict=False)}
        return read_tape(self.graph, self.problem.form.expressions[key], values)

    def arc(
        self, k: int, regimes: Regimes, lasting: GraphExpression | None = None, constants: Sequence[str] | None = None
    ) -> CanonicalArc:
        """The canonical equations of a phase.

        Parameters
        ----------
        k, regimes
            Which phase, and where its scalars are.
        lasting
            Where it is given, how long the arc lasts, of ``("p", name)``: time then runs from 0 to 1.
        constants
            Names of the parameters ``("p", name)`` that are constant states; by default the free ones that act.

        Raises
        ------
        Unsupported
            If the control has no closed form here.
        """
        phase, graph = self.problem.phases[k], self.graph
        if phase.held is not None:
            raise Unsupported(f"the phase {phase.name} keeps an active condition")
        free = {name: graph.input(("p", name)) for name in self.problem.free_names}
        x = [graph.input(("x", i)) for i in range(len(phase.states))]
        u = [graph.input(("u", name)) for name in phase.control_names]
        f = self.function((k, "dynamics"), x, u, free, phase)
        limits = {control.name: self._limits(control, free) for _, control in scalars(phase.controls)}
        named = [e for pair in limits.values() for e in pair if e is not None]
        acting = set[Any]().union(*(e.inputs() for e in (*f, *named)))
        if constants is None:
            constants = [name for name in self.problem.free_names if ("p", name) in acting]
        half = len(x) + len(constants)
        z = [graph.input(("z", i)) for i in range(2 * half)]
        known: dict[Any, GraphExpression] = {("x", i): z[i] for i in range(len(x))}
        known |= {("p", name): z[len(x) + j] for j, name in enumerate(constants)}
        if lasting is not None:
            f = [lasting * rate for rate in f]
        f = graph.substitute(f, known)
        limits = {
            name: (_substitute_limit(graph, low, known), _substitute_limit(graph, high, known))
            for name, (low, high) in limits.items()
        }
        terms = [z[half + i] * rate for i, rate in enumerate(f)]
        H, idle = sum(terms, graph.constant(0)), self._unpriced(k, f, z)
        # For the control, which is on a bound in each of these rates, H is what it is with their costates zero.
        bent = {i for i in idle if _bends_on_bounds(graph, f[i], phase, regimes)}
        told = H if not bent else sum((term for i, term in enumerate(terms) if i not in bent), graph.constant(0))
        control, strengths, reduced, joint, implicit = _control_by_regime(graph, phase, told, regimes, limits, 2 * half)
        # A free parameter moves what is on a bound that it holds; what is not moves by the minimum, without effect.
        held = {
            ("u", c.name): control["u", c.name] for _, c in scalars(phase.controls) if regimes[c.name] != "interior"
        }
        slopes = graph.gradient(graph.substitute([H], held)[0], [("z", i) for i in range(half)])
        zero = graph.constant(0)
        rates = [*f, *([zero] * len(constants)), *(-slope for slope in slopes)]
        rates = graph.substitute(rates, control)
        stationary = graph.substitute(graph.gradient(reduced, [("u", name) for name in implicit]), control)
        rates += _stationary_rates(graph, stationary, rates)
        found = []
        for _, one in scalars(phase.controls):
            slope = graph.gradient(told, [("u", one.name)])[0]
            curvature = graph.gradient(slope, [("u", one.name)])[0]
            slope, curvature = graph.substitute([slope, curvature], control)
            found.append(ArcScalar(control=one, regime=regimes[one.name], value=control["u", one.name],
                                limits=limits[one.name], slope=slope, curvature=curvature))  # fmt: skip
        return CanonicalArc(
            graph=graph, phase=phase, phase_index=k, constants=tuple(constants), half=half, joint=joint,
            implicit=implicit, stationary=tuple(stationary), reduced=reduced, rates=tuple(rates),
            hamiltonian=graph.substitute([H], control)[0], control=control, scalars=tuple(found), strengths=strengths,
        )  # fmt: skip

    def _unpriced(self, k: int, f: Sequence[GraphExpression], z: Sequence[GraphExpression]) -> set[int]:
        """Return the places of states that nothing asks for, whose costates vanish: lambda' = -H_x, lambda(T) = 0.

        No condition and no bound has them, nor what follows the phase, nor the rate of a state that something asks for.
        """
        problem, phase = self.problem, self.problem.phases[k]
        x, free = z[: len(f)], {name: self.graph.input(("p", name)) for name in problem.free_names}
        u = [self.graph.input(("u", name)) for name in phase.control_names]
        behind = "objective" if k + 1 == len(problem.phases) else ("links", k)
        asking = [behind, *(key for name in ("end", "path") if (key := (k, name)) in problem.form.expressions)]
        asked = [e for key in asking for e in self.function(key, x, u, free, phase)]
        read = set[Any]().union(*(e.inputs() for e in asked))
        read |= {("z", i) for i, state in enumerate(phase.states) if state.ranged}
        while more := set[Any]().union(*(rate.inputs() for i, rate in enumerate(f) if ("z", i) in read)) - read:
            read |= more
        return {i for i in range(len(f)) if ("z", i) not in read}

    def _limits(
        self, control: ScalarControl, free: Mapping[str, GraphExpression]
    ) -> tuple[GraphExpression | None, GraphExpression | None]:
        if isinstance(control, Settled):
            raise Unsupported(f"the control {control.name} is determined on an arc of its own")

        def limit(stated: Any) -> GraphExpression | None:
            if isinstance(stated, str):
                return free.get(stated) or self.given[stated]
            return None if abs(stated) == float("inf") else self.graph.constant(stated)

        return limit(control.lower), limit(control.upper)


def _bends_on_bounds(graph: Graph, rate: GraphExpression, phase: Phase, regimes: Regimes) -> bool:
    """Return True if a rate is not linear in the controls together, and all those in it are on their bounds."""
    keys = {("u", name) for name in phase.control_names} & rate.inputs()
    held = all(regimes.get(name, "interior") != "interior" for _, name in keys)
    return held and any(keys & slope.inputs() for slope in graph.gradient(rate, [*keys]))


def _substitute_limit(
    graph: Graph, limit: GraphExpression | None, known: Mapping[Any, GraphExpression]
) -> GraphExpression | None:
    return None if limit is None else graph.substitute([limit], known)[0]


Limits = Mapping[str, tuple[GraphExpression | None, GraphExpression | None]]


def _control_by_regime(
    graph: Graph, phase: Phase, H: GraphExpression, regimes: Regimes, limits: Limits, behind: int
) -> tuple[dict[Any, GraphExpression], tuple[GraphExpression, ...], GraphExpression, bool, tuple[str, ...]]:
    """Return the control that minimises H in these regimes.

    Returns
    -------
    Each component by key; how strongly it asks for each direction; H without directions; whether its minimum is not
    that of each scalar by itself; and then the scalars that are entries of z themselves, from `behind` on.
    """
    found: dict[Any, GraphExpression] = {}
    strengths = []
    for direction in phase.controls:
        if isinstance(direction, UnitVectorControl):
            pull = _direction_vector(graph, phase, H, direction, limits)
            strength = graph.do("sqrt", sum((g * g for g in pull), graph.constant(0)))
            found |= {("u", name): -g / strength for name, g in zip(direction.names, pull, strict=True)}
            strengths.append(strength)
    reduced = graph.substitute([H], found)[0]
    own, implicit = dict[Any, GraphExpression](), tuple[str, ...]()
    every = [control for _, control in scalars(phase.controls)]
    formulas = [_formula(graph, phase, reduced, control) for control in every]
    joint = any(formula is None for formula in formulas)
    if joint:
        implicit = tuple(control.name for control in every if regimes[control.name] == "interior")
    for control, formula in zip(every, formulas, strict=True):
        regime, key = regimes[control.name], ("u", control.name)
        if control.name in implicit:
            own[key] = graph.input(("z", behind + implicit.index(control.name)))
        elif regime != "interior":
            bound = limits[control.name][regime == "upper"]
            if bound is None:
                raise Unsupported(f"the control {control.name} has no {regime} bound")
            own[key] = bound
        else:
            assert formula is not None  # else it would be a state
            slope, curvature = formula
            if curvature.vanishes():
                raise Unsupported(f"the control {control.name} of {phase.name} is singular")
            own[key] = -graph.substitute([slope], {key: graph.constant(0)})[0] / curvature
    found = {key: graph.substitute([e], own)[0] for key, e in found.items()} | own
    return found, tuple(graph.substitute(strengths, own)), reduced, joint, implicit


def _direction_vector(
    graph: Graph, phase: Phase, H: GraphExpression, direction: UnitVectorControl, limits: Limits
) -> list[GraphExpression]:
    """The vector g of H = a + g . d, or w where that is u w . d with a scalar u that is never negative."""
    pull = graph.gradient(H, [("u", name) for name in direction.names])
    others = [("u", control.name) for _, control in scalars(phase.controls)]
    acting = [key for key in others if any(key in g.inputs() for g in pull)]
    if acting:
        factor = acting[0]
        least = limits[factor[1]][0]
        per = [graph.gradient(g, [factor])[0] for g in pull]
        without = graph.substitute(pull, {factor: graph.constant(0)})
        fine = least is not None and least.constant is not None and least.constant >= 0
        if not fine or not all(e.vanishes() for e in without):
            raise Unsupported(f"the direction of {phase.name} depends on {factor[1]}")
        pull = per
    controls = {("u", name) for name in phase.control_names}
    if any(g.inputs() & controls for g in pull):
        raise Unsupported(f"H is not linear in the direction of {phase.name}")
    return pull


def _formula(
    graph: Graph, phase: Phase, H: GraphExpression, control: ScalarControl
) -> tuple[GraphExpression, GraphExpression] | None:
    """dH/du and d2H/du2 of a scalar, if H is quadratic in it and its minimum over it is that over all together."""
    key, free = ("u", control.name), {("u", name) for name in phase.control_names}
    slope = graph.gradient(H, [key])[0]
    curvature = graph.gradient(slope, [key])[0]
    fine = not curvature.inputs() & free and not slope.inputs() & (free - {key})
    return (slope, curvature) if fine else None


def _stationary_rates(
    graph: Graph, stationary: Sequence[GraphExpression], rates: Sequence[GraphExpression]
) -> list[GraphExpression]:
    """w' that keeps dH/dw = 0 as z' moves the rest: by elimination, without a choice of pivots, as H_ww > 0."""
    count, z = len(stationary), [("z", i) for i in range(len(rates) + len(stationary))]
    rows = graph.jacobian(stationary, z)
    right = [-sum((d * rate for d, rate in zip(row, rates, strict=False)), graph.constant(0)) for row in rows]
    left = [row[len(rates) :] for row in rows]
    for k in range(count):
        for i in range(k + 1, count):
            factor = left[i][k] / left[k][k]
            left[i] = [a - factor * b for a, b in zip(left[i], left[k], strict=True)]
            right[i] = right[i] - factor * right[k]
    found = [graph.constant(0)] * count
    for k in reversed(range(count)):
        known = sum((left[k][j] * found[j] for j in range(k + 1, count)), graph.constant(0))
        found[k] = (right[k] - known) / left[k][k]
    return found
