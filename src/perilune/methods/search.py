"""One run of the indirect method: the ladder of starts, the walk along a bounded free parameter, the choice.

`Search` holds what is known so far, so that a failure can say what was tried and how near it came.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from perilune.conditions.pontryagin import Conditions, derive, extremal_parameters
from perilune.methods.assemble import (
    beyond_shooting,
    controls,
    fly,
    free_values,
    joints_from,
    multipliers,
    objective,
    residual_scales,
    trajectories,
    unknowns_from,
)
from perilune.problem.problem import Problem
from perilune.problem.solution import Deferred, Extremal, Nature, Solution, Statistics
from perilune.problem.symbolic import Unnumbered, canonical_free, free_scales, state_scales
from perilune.shooting.continuation import Member
from perilune.shooting.extremals import Found, HeldFamily, scan
from perilune.shooting.function import Shooting
from perilune.shooting.lanes import lanes
from perilune.shooting.rootfind import Root
from perilune.words.outcome import InfeasibleError, NotConvergedError, Outcome, PeriluneError
from perilune.words.types import Matrix, Vector
from perilune.words.watch import Iteration, Watch

if TYPE_CHECKING:
    from perilune.methods.indirect import Indirect

_SPHERE = "costates on the unit sphere"
_ROUGHEST = 0.05  # relative mesh error beyond which a direct solution is not worth quoting


@dataclass
class Search:
    """One run on one problem."""

    settings: Indirect
    problem: Problem
    watch: Watch
    tried: list[str] = field(default_factory=list)
    iterations: int = 0
    best_failure: Root | None = None

    def __post_init__(self) -> None:
        self.began = time.perf_counter()
        self.conditions: Conditions = derive(self.problem)
        self.p: Vector = extremal_parameters(self.problem)
        self.shooting = Shooting(self.conditions)
        self.history: list[Iteration] = []
        self.scanned = self._bounded_parameter()
        self.base: Member | None = None
        self.rung, self.met = "", 0
        self.refusal: PeriluneError | None = None
        self.rough: Solution | None = None

    # -- the two ways in ------------------------------------------------------------------------------------------

    def solve(self, guess: Solution | None = None, base: Member | None = None) -> Solution:
        """From a guess; or by the ladder, after the family through `base` (of another run) where there is one."""
        if guess is not None:
            return self._compose(self._from_guess(guess), "guess")  # whether it keeps the path is for the proof to say
        found: list[Found] = []
        walked: list[Member] = []
        rungs = [[(base, "continuation")] if base is not None else [], self._sphere_members(), self._transcription()]
        for i, rung in enumerate(rungs):
            if i == 2 and self._answers(found):
                break  # the last rung is for those that the others left without an answer
            for first, name in rung:
                if not any(m.value == first.value and np.allclose(m.root.y, first.root.y, atol=1e-5) for m in walked):
                    new, members = self._all_extremals(first)
                    if self._answers(new) and self.base is None:
                        self.base, self.rung = first, name
                    found += new
                    walked += members
        if not self._answers(found):
            raise self._refusal(found) or self._failure()
        return self._compose(self._admissible(found), self.rung)

    def correct(self, y: Vector, held: float, p: Vector | None = None) -> Root:
        """Newton with the bounded free parameter, if there is one, held; at other given parameters p where asked."""
        return self._newton(y, self._hold(held), p)

    def residual(self, y: Vector, held: float, p: Vector) -> Vector:
        """Shooting residual with the bounded free parameter, if there is one, held."""
        return self.shooting(y, p, self._hold(held))[0]

    def _hold(self, value: float) -> dict[int, float]:
        return {} if self.scanned is None else {self.scanned: value}

    def _held_scale(self) -> float:
        return 1.0 if self.scanned is None else self.problem.scales.of(self.problem.free[self.scanned].unit)

    def _all_extremals(self, first: Member) -> tuple[list[Found], list[Member]]:
        if self.scanned is None:
            return [Found(root=first.root, value=0.0, bound=0, minimum=True)], [first]
        self.watch(f"following the family of extremals along {self.problem.free[self.scanned].name}")
        family = HeldFamily(shooting=self.shooting, p=self.p, index=self.scanned)
        return scan(family, first, self._bounds(self.scanned), self.settings.scan_points, self.watch)

    def _admissible(self, found: list[Found]) -> list[Found]:
        return [f for f in found if self._breach(f.root.y) is None]

    def _answers(self, found: list[Found]) -> bool:
        return any(f.minimum and self._breach(f.root.y) is None for f in found)

    def _from_guess(self, guess: Solution) -> list[Found]:
        """Newton from a guess; a bounded parameter that wants out of its bounds is held at the bound."""
        y = self._known(guess)
        scanned = self.scanned
        if scanned is not None:
            bounds = self._bounds(scanned)
            at = self.conditions.free_at.start + scanned
            family = HeldFamily(shooting=self.shooting, p=self.p, index=scanned)
            for bound, limit in zip((-1, 1), bounds, strict=True):
                if y[at] == limit:
                    root = self.correct(y, limit)
                    if root.converged and family.slope(root) * bound < 0:
                        return [Found(root=root, value=limit, bound=bound, minimum=True)]
        root = self._newton(y)
        if not root.converged:
            self.tried.append("Newton from the guess")
            raise self._failure()
        if scanned is None:
            return [Found(root=root, value=0.0, bound=0, minimum=True)]
        value = float(root.y[at])
        if not bounds[0] <= value <= bounds[1]:
            raise NotConvergedError(
                f"from this guess the extremal lies outside the bounds of {self.problem.free[scanned].name}",
                got=f"{free_values(self.problem, self.conditions, root.y)[self.problem.free[scanned].name]:.6g}",
                advice="solve without a guess",
            )
        return [Found(root=root, value=value, bound=0, minimum=family.curvature(root) > 0)]

    def _known(self, guess: Solution) -> Vector:
        """Unknowns of a guess: its own where it is of this method and form, else read off its curves."""
        own = guess.unknowns is not None and guess.method == self.settings.name
        same = guess.problem.scales == self.problem.scales and Unnumbered(guess.problem) == Unnumbered(self.problem)
        if own and same:
            return np.array(guess.unknowns)
        return unknowns_from(self.problem, guess)

    # -- the ladder -----------------------------------------------------------------------------------------------

    def _sphere_members(self) -> Iterator[tuple[Member, str]]:
        """Extremals from random costates with the bounded parameter held at several values.

        One family need not reach from bound to bound, so each value gives a chance to meet another. Those that break
        a path condition come last, and only where nothing else was found.
        """
        name = "" if self.scanned is None else self.problem.free[self.scanned].name
        holds = [0.0] if self.scanned is None else np.linspace(*self._bounds(self.scanned), 5).tolist()
        breaking: list[Member] = []
        self.met = 0
        for held in holds:
            where = f" with {name} held at {held * self._held_scale():.6g}" if name else ""
            self.watch("rung: costates on the unit sphere" + where)
            for root in self._sphere(held, self.settings.starts if held == holds[0] else self.settings.starts // 2):
                member = Member(value=held, root=root)
                if self._breach(root.y) is None:
                    yield member, _SPHERE
                else:
                    breaking.append(member)
        self.tried.append(f"{_SPHERE}: {self.met} extremals, {len(breaking)} of them break a path condition")
        if self.base is None:
            yield from ((member, _SPHERE) for member in breaking)

    def _transcription(self) -> Iterator[tuple[Member, str]]:
        """An extremal from a coarse direct solution, in one piece or, where that fails, by multiple shooting."""
        from perilune.methods.pseudospectral import Pseudospectral  # and with it much of SciPy

        try:
            rough = (self.settings.transcription or Pseudospectral(nodes=40, refine=0)).run(self.problem)
        except PeriluneError as error:
            self.tried.append(f"direct transcription: {error.what}")
            self.refusal = error
            return
        if rough.statistics.residual < _ROUGHEST:
            self.rough = rough
        y = unknowns_from(self.problem, rough)
        held = 0.0 if self.scanned is None else float(y[self.conditions.free_at.start + self.scanned])
        for segments, rung in ((1, "direct transcription"), (self.settings.segments, "multiple shooting")):
            shooting = Shooting(self.conditions, segments=segments)
            Y = np.concatenate([y, joints_from(self.problem, self.conditions, rough, segments)])
            root = self._count(shooting.root(Y, self.p, self._hold(held), self._iteration))
            self.shooting.arcs += shooting.arcs
            if root.converged:
                root = self.correct(root.y[: len(y)], held)  # one piece again, for what follows
            if root.converged:
                yield Member(value=held, root=root), rung
                return
            self.tried.append(f"{rung}: Newton ended at residual {np.abs(root.residual).max():.2g}")

    def _sphere(self, held: float, starts: int) -> Iterator[Root]:
        """Distinct roots from random directions of the initial costates, best first."""
        roots: list[Root] = []
        for root in self._roots_from(self._sphere_starts(starts), held):
            if self._within_bounds(root.y) and not any(np.allclose(r.y, root.y, rtol=0, atol=1e-6) for r in roots):
                roots.append(root)
        self.met += len(roots)
        yield from sorted(roots, key=lambda root: self._objective(root.y))

    def _sphere_starts(self, count: int) -> Matrix:
        """Unknowns with random costates of length one and free parameters around their typical values."""
        rng, c = np.random.default_rng(self.settings.seed), self.conditions
        Y = np.zeros((count, len(c.unknowns)))
        directions = rng.normal(size=(count, c.free_at.start))
        Y[:, : c.free_at.start] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        typical = canonical_free(self.problem, {f.name: f.typical for f in self.problem.free})
        Y[:, c.free_at] = typical * np.exp(rng.uniform(-0.4, 0.4, size=(count, len(typical))))
        return Y

    def _roots_from(self, Y: Matrix, held: float) -> Iterator[Root]:
        """Roots from many starts: in lanes where the problem allows, and those polished; else one after another."""
        together, found = lanes(self.conditions, self.scanned), None
        if together is not None:
            if self.scanned is not None:
                Y[:, self.conditions.free_at.start + self.scanned] = held
            ends, converged = together.solve(Y, self.p, np.full(len(Y), held))
            distinct = np.unique(np.round(ends[converged], 6), axis=0, return_index=True)[1]
            if converged.any():
                found = (self.correct(y, held) for y in ends[converged][np.sort(distinct)])
        if found is None:  # not for lanes, or beyond them: they damp more simply than `rootfind` does
            found = (self._newton(y, self._hold(held), max_step=0.5) for y in Y)
        yield from (root for root in found if root.converged)

    def _newton(
        self, y: Vector, held: dict[int, float] | None = None, p: Vector | None = None, **settings: float
    ) -> Root:
        numbers = self.p if p is None else p
        return self._count(self.shooting.root(y, numbers, held or {}, self._iteration, **settings))

    def _count(self, root: Root) -> Root:
        if not root.converged and np.all(np.isfinite(root.residual)):
            worst = self.best_failure
            if worst is None or np.abs(root.residual).max() < np.abs(worst.residual).max():
                self.best_failure = root
        return root

    def _iteration(self, event: Iteration | str) -> None:
        if isinstance(event, Iteration):
            self.iterations += 1
            self.history.append(event)
        self.watch(event)

    # -- what makes a root an answer ------------------------------------------------------------------------------

    def _bounded_parameter(self) -> int | None:
        """Index of the free parameter between finite bounds that is no duration; None where there is none."""
        bounded = [
            i
            for i, f in enumerate(self.problem.free)
            if f.name not in self.problem.duration_names and np.isfinite(f.upper - f.lower)
        ]
        if len(bounded) > 1:
            raise PeriluneError(
                "the indirect method follows extremals along one bounded free parameter",
                got=", ".join(self.problem.free[i].name for i in bounded),
                advice="give all but one of them a value, or leave their bounds open",
            )
        return bounded[0] if bounded else None

    def _bounds(self, index: int) -> tuple[float, float]:
        free = self.problem.free[index]
        scale = self.problem.scales.of(free.unit)
        return free.lower / scale, free.upper / scale

    def _within_bounds(self, y: Vector) -> bool:
        values = y[self.conditions.free_at] * free_scales(self.problem.free, self.problem)
        return all(f.lower <= v <= f.upper for f, v in zip(self.problem.free, values, strict=True))

    def _objective(self, y: Vector) -> float:
        end = self.shooting.ends(y[: len(self.conditions.unknowns)], self.p)[-1]
        return objective(self.problem, end, free_values(self.problem, self.conditions, y))

    def _breach(self, y: Vector) -> str | None:
        """A broken path condition or bound of a state, in the user's words, or None."""
        p = self.problem.parameters(free_values(self.problem, self.conditions, y))
        for phase, extremal, arc in zip(
            self.problem.phases, self.conditions.phases, fly(self.problem, self.conditions, y), strict=True
        ):
            t = np.linspace(0.0, arc.t[-1], 201)
            z, u = arc(t).T, controls(extremal, arc, t, self.p).T
            scales = state_scales(self.problem, phase)
            x = z[: extremal.state_count] * scales[:, None]
            for state, values, scale in zip(phase.states, x, scales, strict=True):
                for side, limit, reached in (("below", state.lower, min(values)), ("above", state.upper, max(values))):
                    if not np.clip(reached, state.lower - 1e-9 * scale, state.upper + 1e-9 * scale) == reached:
                        return f"{state.name} reaches {reached:.6g} {state.unit}, {side} its bound {limit:g}"
            conditions = phase.evaluate("path", list(x), list(u), p)
            for condition, values in zip(phase.path_conditions, conditions, strict=True):
                least = float(np.min(values))
                if not least >= -1e-9 * self.problem.scales.of(condition.unit):
                    return f"{condition.name} falls to {least:.6g} {condition.unit}"
        return None

    # -- the answer, or why there is none -------------------------------------------------------------------------

    def _compose(self, found: list[Found], rung: str) -> Solution:
        ranked = sorted(
            ((not f.minimum, self._objective(f.root.y), i) for i, f in enumerate(found)),
            key=lambda key: key[:2],
        )
        extremals = tuple(
            Extremal(
                free=free_values(self.problem, self.conditions, found[i].root.y),
                objective=value,
                nature=_nature(found[i], best=place == 0, guessed=rung == "guess"),
            )
            for place, (_, value, i) in enumerate(ranked)
        )
        best = found[ranked[0][2]].root
        y = best.y[: len(self.conditions.unknowns)]
        return Solution(
            problem=self.problem,
            method=self.settings.name,
            outcome=Outcome.SOLVED,
            objective=extremals[0].objective,
            free=extremals[0].free,
            trajectories=Deferred(len(self.problem.phases), lambda: trajectories(self.problem, self.conditions, y)),
            multipliers=multipliers(self.problem, self.conditions, y),
            extremals=extremals,
            unknowns=y,
            statistics=Statistics(
                rung=rung,
                tried=tuple(self.tried),
                iterations=self.iterations,
                arcs=self.shooting.arcs,
                residual=float(np.abs(best.residual).max()),
                wall_time=time.perf_counter() - self.began,
                history=tuple(self.history),
            ),
        )

    def _refusal(self, found: list[Found]) -> InfeasibleError | None:
        """Physics' reason, where there is one: the direct method found no feasible path, or extremals break one."""
        if isinstance(self.refusal, InfeasibleError):
            return self.refusal
        broken = next((b for f in found if (b := self._breach(f.root.y))), None)
        ridden = self._ridden()
        if broken is None and ridden is None:
            return None
        beside = ""
        if self.rough is not None and ridden is not None:
            best = f"J = {self.rough.objective:.6g} {self.problem.objective_unit}"
            beside = f"the best path that keeps {ridden} rides along it (direct method: {best})"
        return InfeasibleError(
            "every extremal breaks a condition of the path",
            got="; ".join(text for text in (f"{broken} on the way" if broken else "", beside) if text),
            expected="not negative, and not zero along the way",
            advice="more thrust or a higher start; the direct method (--method direct, Pseudospectral()) may ride it",
        )

    def _ridden(self) -> str | None:
        """Path condition along which the direct solution runs, away from its ends."""
        if self.rough is None:
            return None
        for phase, flown in zip(self.problem.phases, self.rough.trajectories, strict=True):
            t = np.linspace(0.05, 0.95, 400) * flown.duration
            values = phase.evaluate("path", flown.state(t).T, flown.control(t).T, self.rough.parameters)
            for condition, value in zip(phase.path_conditions, values, strict=True):
                if np.min(value) <= 1e-4 * self.problem.scales.of(condition.unit):
                    return condition.name
        return None

    def _failure(self) -> NotConvergedError:
        partial: dict[str, Any] = {"tried": list(self.tried), "iterations": self.iterations}
        got = "no start could even be flown to its end"
        if self.best_failure is not None:
            root = self.best_failure
            scaled = root.residual[: len(self.conditions.residuals)]
            values = scaled * residual_scales(self.problem, self.conditions)
            partial["residuals"] = {
                name: {"value": float(v), "unit": unit}
                for (name, unit), v in zip(self.conditions.residuals, values, strict=True)
            }
            partial["free"] = free_values(self.problem, self.conditions, root.y)
            k = int(np.argmax(np.abs(scaled)))
            name, unit = self.conditions.residuals[k]
            got = f"nearest approach leaves {name} = {values[k]:.4g} {unit}"
        advice = "perilune check for what physics says; then more starts (Indirect(starts=100)) or a nearby guess"
        if self.rough is not None and (beyond := beyond_shooting(self.rough, self.conditions)) is not None:
            got, advice = beyond
        return NotConvergedError(
            "no extremal was found",
            got=got,
            expected="all residuals zero; tried " + "; ".join(self.tried or ["nothing"]),
            advice=advice,
            partial=partial,
        )


def _nature(found: Found, *, best: bool, guessed: bool) -> Nature:
    """What a root is; the one that a guess leads to was compared with no other."""
    if not found.minimum and not found.bound:
        return Nature.WORST
    if guessed:
        return Nature.NEAR_GUESS_AT_BOUND if found.bound else Nature.NEAR_GUESS
    if found.bound:
        return Nature.BEST_AT_BOUND if best else Nature.LOCAL_OPTIMUM_AT_BOUND
    return Nature.BEST if best else Nature.LOCAL_OPTIMUM
