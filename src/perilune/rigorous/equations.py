"""The canonical equations of one smooth arc, derived from the problem's tapes by the rules of `graph` alone.

With H = lambda . f(x, u, p), which the control minimises: x' = f, lambda' = -dH/dx, and a free parameter q in the
dynamics is a constant state, whose costate collects the integral of dH/dq (`perilune.conditions.pontryagin` states the
same, and is not used). The control is eliminated in closed form: a direction d that enters H as g . d is -g/|g|; a
scalar is on the bound that its regime names, or where dH/du = 0 if H is quadratic in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from perilune.problem.controls import Bounded, Direction, Settled, scalars
from perilune.problem.phase import Phase
from perilune.problem.problem import Problem
from perilune.rigorous.given import exactly
from perilune.rigorous.graph import Expression, Graph
from perilune.rigorous.reading import Unsupported, read
from perilune.rigorous.taylor import Program

Key = tuple[Any, ...]
Regimes = Mapping[str, str]  # of each scalar by name: lower, upper or interior


@dataclass(frozen=True, kw_only=True, eq=False)
class Scalar:
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

    control: Bounded
    regime: str
    value: Expression
    limits: tuple[Expression | None, Expression | None]
    slope: Expression
    curvature: Expression


@dataclass(frozen=True, kw_only=True, eq=False)
class Arc:
    """Canonical equations of a phase in one regime, z = (x, constant states, lambda) in SI.

    Attributes
    ----------
    graph
        Of all expressions here, whose inputs are ``("z", i)``.
    phase, phase_index
        Whose.
    constants
        Names of the free parameters that are states.
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
    rates: tuple[Expression, ...]
    hamiltonian: Expression
    control: Mapping[Any, Expression]
    scalars: tuple[Scalar, ...]
    strengths: tuple[Expression, ...]

    @property
    def half(self) -> int:
        """Length of lambda."""
        return len(self.rates) // 2

    @property
    def keys(self) -> list[Key]:
        """Keys of z."""
        return [("z", i) for i in range(len(self.rates))]

    @cached_property
    def plain(self) -> Program:
        """The rates."""
        return Program(self.graph, self.keys, self.rates)

    @cached_property
    def pattern(self) -> list[tuple[int, int]]:
        """Where the Jacobian of the rates does not vanish for all z."""
        return [place for place, _ in self._slopes]

    @cached_property
    def slopes(self) -> Program:
        """The derivatives of the rates in the order of `pattern`."""
        return Program(self.graph, self.keys, [slope for _, slope in self._slopes])

    @cached_property
    def with_slopes(self) -> Program:
        """The rates, and these."""
        return Program(self.graph, self.keys, [*self.rates, *(slope for _, slope in self._slopes)])

    @cached_property
    def _slopes(self) -> list[tuple[tuple[int, int], Expression]]:
        rows = self.graph.jacobian(self.rates, self.keys)
        return [((i, j), e) for i, row in enumerate(rows) for j, e in enumerate(row) if not e.vanishes()]


class Reader:
    """Reads the functions of a problem into one graph, given parameters as the exact numbers that they are."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.graph = problem, Graph()
        self.given = {name: exactly(g).expression(self.graph) for name, g in problem.given.items()}

    def function(self, key: Any, x: Sequence[Any] = (), u: Sequence[Any] = (), free: Mapping[str, Any] | None = None,
                 phase: Phase | None = None) -> list[Expression]:  # fmt: skip
        """Values of a function of the problem by its key in `perilune.problem.form`."""
        values: dict[tuple[str, str], Any] = {("p", name): value for name, value in self.given.items()}
        values |= {("p", name): value for name, value in (free or {}).items()}
        if phase is not None:
            values |= {("x", name): value for name, value in zip(phase.state_names, x, strict=False)}
            values |= {("u", name): value for name, value in zip(phase.control_names, u, strict=False)}
        return read(self.graph, self.problem.form.expressions[key], values)

    def arc(self, k: int, regimes: Regimes, whole: bool = False) -> Arc:
        """The canonical equations of a phase.

        Parameters
        ----------
        k, regimes
            Which phase, and where its scalars are.
        whole
            Whether every free parameter is a constant state, the duration too: time then runs from 0 to 1.

        Raises
        ------
        Unsupported
            If the control has no closed form here.
        """
        phase, graph = self.problem.phases[k], self.graph
        if phase.held is not None:
            raise Unsupported(f"the phase {phase.name} is held to a condition")
        free = {name: graph.input(("p", name)) for name in self.problem.free_names}
        x = [graph.input(("x", i)) for i in range(len(phase.states))]
        u = [graph.input(("u", name)) for name in phase.control_names]
        f = self.function((k, "dynamics"), x, u, free, phase)
        limits = {control.name: self._limits(control, free) for _, control in scalars(phase.controls)}
        named = [e for pair in limits.values() for e in pair if e is not None]
        acting = set[Any]().union(*(e.inputs() for e in (*f, *named)))
        constants = tuple(name for name in self.problem.free_names if whole or ("p", name) in acting)
        half = len(x) + len(constants)
        z = [graph.input(("z", i)) for i in range(2 * half)]
        known: dict[Any, Expression] = {("x", i): z[i] for i in range(len(x))}
        known |= {("p", name): z[len(x) + j] for j, name in enumerate(constants)}
        duration = {**self.given, **free}[phase.duration] if whole else graph.constant(1)
        f = graph.substitute([duration * rate for rate in f], known)
        limits = {name: (_put(graph, low, known), _put(graph, high, known)) for name, (low, high) in limits.items()}
        H = sum((z[half + i] * rate for i, rate in enumerate(f)), graph.constant(0))
        control, strengths = _control(graph, phase, H, regimes, limits)
        # A free parameter moves what is on a bound that it holds; what is not moves by the minimum, without effect.
        held = {
            ("u", c.name): control["u", c.name] for _, c in scalars(phase.controls) if regimes[c.name] != "interior"
        }
        slopes = graph.gradient(graph.substitute([H], held)[0], [("z", i) for i in range(half)])
        zero = graph.constant(0)
        rates = [*f, *([zero] * len(constants)), *(-slope for slope in slopes)]
        rates = graph.substitute(rates, control)
        found = []
        for _, one in scalars(phase.controls):
            slope = graph.gradient(H, [("u", one.name)])[0]
            curvature = graph.gradient(slope, [("u", one.name)])[0]
            slope, curvature = graph.substitute([slope, curvature], control)
            found.append(Scalar(control=one, regime=regimes[one.name], value=control["u", one.name],
                                limits=limits[one.name], slope=slope, curvature=curvature))  # fmt: skip
        return Arc(
            graph=graph, phase=phase, phase_index=k, constants=constants, rates=tuple(rates),
            hamiltonian=graph.substitute([H], control)[0], control=control, scalars=tuple(found), strengths=strengths,
        )  # fmt: skip

    def _limits(self, control: Bounded, free: Mapping[str, Expression]) -> tuple[Expression | None, Expression | None]:
        if isinstance(control, Settled):
            raise Unsupported(f"the control {control.name} is settled to an arc of its own")

        def limit(stated: Any) -> Expression | None:
            if isinstance(stated, str):
                return free.get(stated) or self.given[stated]
            return None if abs(stated) == float("inf") else self.graph.constant(stated)

        return limit(control.lower), limit(control.upper)


def _put(graph: Graph, limit: Expression | None, known: Mapping[Any, Expression]) -> Expression | None:
    return None if limit is None else graph.substitute([limit], known)[0]


Limits = Mapping[str, tuple[Expression | None, Expression | None]]


def _control(
    graph: Graph, phase: Phase, H: Expression, regimes: Regimes, limits: Limits
) -> tuple[dict[Any, Expression], tuple[Expression, ...]]:
    """The control that minimises H in these regimes, by key; and how strongly it asks for each direction."""
    found: dict[Any, Expression] = {}
    strengths = []
    for direction in phase.controls:
        if isinstance(direction, Direction):
            pull = _pull(graph, phase, H, direction, limits)
            strength = graph.do("sqrt", sum((g * g for g in pull), graph.constant(0)))
            found |= {("u", name): -g / strength for name, g in zip(direction.names, pull, strict=True)}
            strengths.append(strength)
    reduced = graph.substitute([H], found)[0]
    own = dict[Any, Expression]()
    for _, control in scalars(phase.controls):
        own["u", control.name] = _scalar(graph, phase, reduced, control, regimes[control.name], limits[control.name])
    found = {key: graph.substitute([e], own)[0] for key, e in found.items()} | own
    return found, tuple(graph.substitute(strengths, own))


def _pull(graph: Graph, phase: Phase, H: Expression, direction: Direction, limits: Limits) -> list[Expression]:
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


def _scalar(
    graph: Graph, phase: Phase, H: Expression, control: Bounded, regime: str,
    limits: tuple[Expression | None, Expression | None],
) -> Expression:  # fmt: skip
    key, free = ("u", control.name), {("u", name) for name in phase.control_names}
    slope = graph.gradient(H, [key])[0]
    curvature = graph.gradient(slope, [key])[0]
    if curvature.inputs() & free:
        raise Unsupported(f"the control {control.name} of {phase.name} has no formula")
    if slope.inputs() & (free - {key}):  # then what is least for each alone is no minimum of both
        raise Unsupported(f"the minimum of H over {control.name} of {phase.name} depends on another control")
    if regime != "interior":
        found = limits[regime == "upper"]
        if found is None:
            raise Unsupported(f"the control {control.name} has no {regime} bound")
        return found
    if curvature.vanishes():
        raise Unsupported(f"the control {control.name} of {phase.name} is singular")
    return -graph.substitute([slope], {key: graph.constant(0)})[0] / curvature
