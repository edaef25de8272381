"""Statement of the boundary value problem of an extremal: its unknowns, equations and signs, arc by arc."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from perilune.problem import Problem
from perilune.rigorous.boundary_value_problem import ArcPiece, BoundaryProblem, Differentiated, Sides
from perilune.rigorous.equations import ArcScalar, Key, ProblemReader
from perilune.rigorous.exact_tape import Unsupported
from perilune.rigorous.graph import GraphExpression


def boundary_problem(problem: Problem, pieces: Sequence[ArcPiece], sides: Sides | None = None) -> BoundaryProblem:
    """The equations of an extremal that is made of these arcs, and on these bounds.

    Parameters
    ----------
    problem
        The problem whose extremals are the roots.
    pieces
        Arcs in order of flight, each with its phase and the regimes of its scalar controls.
    sides
        Bounds on which the extremal lies; None for none.

    Raises
    ------
    Unsupported
        If the problem has what no theorem can be stated for yet.
    """
    return _EquationBuilder(problem, pieces, sides or Sides()).stated()


class _EquationBuilder:
    def __init__(self, problem: Problem, pieces: Sequence[ArcPiece], sides: Sides) -> None:
        self.problem, self.pieces, self.sides = problem, tuple(pieces), sides
        self.signs: dict[str, GraphExpression] = {}
        reader = self.reader = ProblemReader(problem)
        graph = self.graph = reader.graph
        self.arcs = tuple(reader.arc(piece.phase, piece.regimes) for piece in pieces)
        phases = range(len(problem.phases))
        self.first = [next(i for i, piece in enumerate(pieces) if piece.phase == k) for k in phases]
        self.last = [max(i for i, piece in enumerate(pieces) if piece.phase == k) for k in phases]
        names = list[str]()
        self.lam, self.nu = list[Any](), list[Any]()
        self.length, self.lengths = dict[int, GraphExpression](), dict[int, str]()
        for k, phase in enumerate(problem.phases):
            own = [*phase.state_names, *self.arcs[self.first[k]].constants]
            self.lam.append([graph.input(("y", len(names) + i)) for i in range(len(own))])
            names += [f"{phase.name}.lambda_{name}(0)" for name in own]
        self.free = {f.name: graph.input(("y", len(names) + i)) for i, f in enumerate(problem.free)}
        self.free_at = len(names)
        names += problem.free_names
        for phase in problem.phases:
            own = [f"nu_{c.name}" for c in phase.end_conditions]
            own += [f"mu_{phase.states[i].name}" for i in sides.held(phase)]
            self.nu.append([graph.input(("y", len(names) + i)) for i in range(len(own))])
            names += [f"{phase.name}.{name}" for name in own]
        for i, piece in enumerate(pieces):
            if piece.switched:
                self.length[i] = graph.input(("y", len(names)))
                number = i - self.first[piece.phase] + 1
                self.lengths[i] = f"{problem.phases[piece.phase].name}, length of arc {number}"
                names.append(self.lengths[i])
        self.w = list[list[GraphExpression]]()
        for i, (piece, arc) in enumerate(zip(pieces, self.arcs, strict=True)):
            self.w.append([graph.input(("y", len(names) + j)) for j in range(len(arc.implicit))])
            number = i - self.first[piece.phase] + 1
            names += [f"{arc.phase.name}, {name} at the start of arc {number}" for name in arc.implicit]
        self.ends = [[graph.input(key) for key in keys] for keys in self._end_keys()]
        self.names = tuple(names)
        if alike := [name for name in problem.free_names if names.count(name) > 1]:  # they are looked up by name
            raise Unsupported(f"{alike[0]} is the name of another unknown too")

    def stated(self) -> BoundaryProblem:
        graph, problem = self.graph, self.problem
        zero = graph.constant(0)
        last = problem.phases[-1]
        objective = self.reader.function("objective", self.ends[-1], free=self.free, phase=last)[0]
        lagrangian, conditions, costates = objective, list[GraphExpression](), list[GraphExpression]()
        rows, costate_rows = list[str](), list[str]()
        met: list[list[GraphExpression]] = [[] for _ in self.pieces]
        for k, phase in enumerate(problem.phases):
            end, half = self.ends[self.last[k]], self.arcs[self.last[k]].half
            psi = []
            if phase.end is not None and phase.end_conditions:
                psi = self.reader.function((k, "end"), end, free=self.free, phase=phase)
            psi += [end[i] for i in self.sides.held(phase)]
            boundary = sum((nu * value for nu, value in zip(self.nu[k], psi, strict=True)), zero)
            equations = self._equations(k, psi)
            conditions += equations
            met[self.last[k]] += equations
            rows += [f"{phase.name}: {c.name}" for c in phase.end_conditions]
            rows += [f"{phase.name}: {phase.states[i].name} on its bound" for i in self.sides.held(phase)]
            start = sum((a * b for a, b in zip(self.lam[k], self._opening(k), strict=True)), zero)
            lagrangian = lagrangian + boundary + start
            if k + 1 < len(problem.phases):
                following = zip(self.lam[k + 1], self._opening(k + 1), strict=True)
                boundary = boundary + sum((a * b for a, b in following), zero)
            else:
                boundary = boundary + objective
            slopes = graph.gradient(boundary, [("end", self.last[k], i) for i in range(half)])
            costates += [end[half + i] - slope for i, slope in enumerate(slopes)]
            names = [*phase.state_names, *self.arcs[self.last[k]].constants]
            costate_rows += [f"{phase.name}: transversality of {name}" for name in names]
        stationary = graph.gradient(lagrangian, [("y", self.free_at + i) for i in range(len(problem.free))])
        for k, phase in enumerate(problem.phases):
            if phase.duration in problem.free_names:
                stationary[problem.free_names.index(phase.duration)] += self._at(
                    self.last[k], self.arcs[self.last[k]].hamiltonian
                )
        stationary = self._stationary(stationary)
        switches = [
            (i, scalar) for i, piece in enumerate(self.pieces) for scalar in self.arcs[i].scalars
            if scalar.control.name == piece.switched
        ]  # fmt: skip
        switching = [self._at(i, self._switching(i, scalar)) for i, scalar in switches]
        for (i, _), e in zip(switches, switching, strict=True):
            met[i].append(e)
        openings = [self._start(i) for i in range(len(self.arcs))]
        implicit = [
            e for opening, arc in zip(openings, self.arcs, strict=True)
            for e in graph.substitute(arc.stationary, {("z", j): e for j, e in enumerate(opening)})
        ]  # fmt: skip
        all_rows = [*conditions, *costates, *stationary, *switching, *implicit]
        rows += [*costate_rows, *(f"stationarity in {name}" for name in problem.free_names)]
        rows += [f"switch of {scalar.control.name} at the end of arc {i + 1}" for i, scalar in switches]
        rows += [f"{name} at the start of arc {i + 1}" for i, arc in enumerate(self.arcs) for name in arc.implicit]
        y = [("y", i) for i in range(len(self.names))]
        ends = self._end_keys()
        starts, durations = [], []
        for i, piece in enumerate(self.pieces):
            k = piece.phase
            starts.append(Differentiated(graph, openings[i], [y, ends[i - 1] if i else []]))
            given = {**self.reader.given, **self.free}
            length = arc_duration(self.pieces, i, self.length, given[problem.phases[k].duration])
            durations.append(Differentiated(graph, [length], [y]))
        return BoundaryProblem(
            problem=problem, graph=graph, pieces=self.pieces, sides=self.sides, arcs=self.arcs,
            names=self.names, starts=tuple(starts),
            durations=tuple(durations), residual=Differentiated(graph, all_rows, [y, *ends]), rows=tuple(rows),
            meets=tuple(map(tuple, met)), objective=Differentiated(graph, [objective], [y, ends[-1]]),
            signs=Differentiated(graph, [*self.signs.values()], [y, *ends]), signed=tuple(self.signs),
            lengths=self.lengths,
        )  # fmt: skip

    def _end_keys(self) -> list[list[Key]]:
        return [[("end", i, j) for j in range(len(arc.rates))] for i, arc in enumerate(self.arcs)]

    def _start(self, i: int) -> list[GraphExpression]:
        """z where arc i begins."""
        k = self.pieces[i].phase
        first = i == self.first[k]
        before = [*self._opening(k), *self.lam[k]] if first else self.ends[i - 1][: 2 * self.arcs[i].half]
        return [*before, *self.w[i]]

    def _equations(self, k: int, psi: list[GraphExpression]) -> list[GraphExpression]:
        """Return what vanishes where a phase ends; for a range its distance to the bound that it is on, or else nu."""
        phase, found = self.problem.phases[k], list[GraphExpression]()
        held = [phase.states[i] for i in self.sides.held(phase)]
        sided = [(c, c.name, self.sides.ranges.get((phase.name, c.name), "")) for c in phase.end_conditions]
        sided += [(state, f"{state.name} at its end", self.sides.states[phase.name, state.name]) for state in held]
        for (c, told, side), value, nu in zip(sided, psi, self.nu[k], strict=True):
            if not c.ranged:
                found.append(value)
                continue
            name = f"{phase.name}: {told}"
            lower, upper = (self._limit(limit) for limit in (c.lower, c.upper))
            bound = {"lower": lower, "upper": upper, "inside": None}[side]
            if side == "inside":
                found.append(nu)
                if lower is not None:
                    self._sign(f"{name} is above its lower bound", value - lower)
                if upper is not None:
                    self._sign(f"{name} is below its upper bound", upper - value)
            else:
                if bound is None:
                    raise Unsupported(f"{name} has no {side} bound")
                found.append(value - bound)
                told = f"{name} would cost less beyond its {side} bound, where it is"
                self._sign(told, nu if side == "upper" else -nu)
        return found

    def _sign(self, words: str, value: GraphExpression) -> None:
        """State that something is positive; each in words of its own."""
        if words in self.signs:
            raise Unsupported(f"two conditions have the same name: {words}")
        self.signs[words] = value

    def _stationary(self, slopes: list[GraphExpression]) -> list[GraphExpression]:
        """dJ/dq = 0 of each free parameter, or where it is on a bound its distance to that."""
        found = list(slopes)
        for i, f in enumerate(self.problem.free):
            if f.name in self.sides.free:
                side = self.sides.free[f.name]
                found[i] = self.free[f.name] - (f.lower if side == "lower" else f.upper)
                told = f"J would be less with {f.name} beyond its {side} bound, where it is"
                self._sign(told, slopes[i] if side == "lower" else -slopes[i])
        return found

    def _limit(self, limit: Any) -> GraphExpression | None:
        if isinstance(limit, str):
            return self.free[limit] if limit in self.free else self.reader.given[limit]
        return None if abs(limit) == float("inf") else self.graph.constant(limit)

    def _opening(self, k: int) -> list[GraphExpression]:
        """States and constant states where phase k begins."""
        constants = [self.free[name] for name in self.arcs[self.first[k]].constants]
        if k == 0:
            return [*self.reader.function("start", free=self.free), *constants]
        end, phase = self.ends[self.last[k - 1]], self.problem.phases[k - 1]
        return [*self.reader.function(("links", k - 1), end, free=self.free, phase=phase), *constants]

    def _switching(self, i: int, scalar: ArcScalar) -> GraphExpression:
        """Return what vanishes where a scalar leaves its regime: dH/du on a bound, else its distance to the bound."""
        follows = self.pieces[i + 1].regimes[scalar.control.name]
        if scalar.regime != "interior":
            if follows != "interior" and not scalar.curvature.vanishes():
                what = f"H is nonlinear in {scalar.control.name}, which jumps from bound to bound"
                raise Unsupported(f"{what}: level 5 covers such jumps only where H is linear in it")
            return scalar.slope
        limit = scalar.limits[follows == "upper"]
        assert limit is not None  # else it would not be on it
        return scalar.value - limit

    def _at(self, i: int, of: GraphExpression) -> GraphExpression:
        """An expression of z at the end of an arc."""
        known: Mapping[Any, GraphExpression] = {("z", j): e for j, e in enumerate(self.ends[i])}
        return self.graph.substitute([of], known)[0]


def arc_duration(
    pieces: Sequence[ArcPiece], i: int, lengths: Mapping[int, GraphExpression], duration: GraphExpression
) -> GraphExpression:
    """Return the duration of an arc: a length of its own, or what others leave of its phase's duration.

    Parameters
    ----------
    pieces
        All arcs in order of flight.
    i
        Index of the arc.
    lengths
        Durations of the arcs that have an unknown of their own, by the index of the arc [s].
    duration
        Duration of the phase [s].
    """
    if i in lengths:
        return lengths[i]
    for j in lengths:
        if pieces[j].phase == pieces[i].phase:
            duration = duration - lengths[j]
    return duration
