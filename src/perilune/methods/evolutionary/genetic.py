"""Genetic algorithm over a box: selection, crossover, mutation, elitism; the k best *distinct* individuals.

Individuals are real vectors in the unit cube, mapped to the box. One generation:

1. *selection*: tournaments of `tournament` random individuals; the fittest becomes a parent;
2. *crossover*: pairs of parents exchange information gene by gene by simulated binary crossover, which
   spreads children around their parents as one-point crossover of bit strings does (Deb, Agrawal 1995);
3. *mutation*: now and then a gene is moved by a polynomially distributed step (Deb, Goyal 1996);
4. *elitism*: the best individuals of both generations survive unchanged, no two of them closer than
   `distinct`, so that one good place cannot take over the population.

These are the operators that Peng et al. 2012, section 3.2, describe on bit strings, here on real numbers.
Nothing is known of what is searched: a whole population is judged in one call, which may compute in parallel
as it likes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perilune.core import Matrix, PeriluneError, Vector, check_call, require_integers, require_number

Indices = NDArray[np.intp]
Objective = Callable[[Matrix], Vector]  # (population, n) -> (population,); smaller is better, non-finite is worst


@dataclass(frozen=True, kw_only=True)
class Generation:
    """The state of a search: number of the generation, its least and median objective."""

    number: int
    least: float
    median: float


@dataclass(frozen=True, kw_only=True)
class Survivors:
    """The result of a search.

    Parameters
    ----------
    points
        The best distinct individuals, shape (k, n), best first; fewer than asked for where the search found
        no more.
    values
        Their objective, shape (k,).
    generations
        One record for each generation.
    interrupted
        Whether the user stopped the search; the points are then the best until that moment.
    """

    points: Matrix
    values: Vector
    generations: tuple[Generation, ...]
    interrupted: bool = False


@check_call
@dataclass(frozen=True, kw_only=True)
class Genetic:
    """Settings of the search; the same settings give the same answer.

    Parameters
    ----------
    seed
        Of every random number.
    population, generations
        Individuals of a generation, and generations after the first.
    best
        How many distinct individuals are returned.
    distinct
        Least distance between two of them, in the unit cube, root mean square over the genes.
    elite
        Share of the population that survives unchanged.
    tournament
        Individuals of one tournament.
    crossover, mutation
        Probability that a pair of parents is crossed, and expected number of genes mutated in a child.
    spread
        Distribution index of crossover and mutation: large keeps children near their parents.
    """

    seed: int = 0
    population: int = 128
    generations: int = 60
    best: int = 3
    distinct: float = 0.05
    elite: float = 0.1
    tournament: int = 3
    crossover: float = 0.9
    mutation: float = 1.0
    spread: float = 5.0

    def __post_init__(self) -> None:
        require_integers(self, population=4, generations=0, best=1, tournament=1)
        for name in ("elite", "crossover", "distinct", "mutation", "spread"):
            require_number(getattr(self, name), name)
        for name in ("elite", "crossover", "distinct"):
            if not 0 <= getattr(self, name) <= 1:
                raise PeriluneError(f"{name} must lie between 0 and 1", got=str(getattr(self, name)))
        for name in ("mutation", "spread"):
            if not (getattr(self, name) >= 0 and np.isfinite(getattr(self, name))):
                raise PeriluneError(f"{name} must not be negative", got=str(getattr(self, name)))
        if self.best > self.population:
            raise PeriluneError(
                "more individuals are requested than exist",
                got=f"best={self.best}",
                expected=f"<= {self.population}",
            )

    def search(
        self,
        objective: Objective,
        lower: Vector,
        upper: Vector,
        watch: Callable[[Generation], None] | None = None,
    ) -> Survivors:
        """Minimise `objective` between `lower` and `upper`.

        Parameters
        ----------
        objective
            Judges a whole population (population, n) at once. What is not finite counts as worst.
        lower, upper
            Finite bounds, shape (n,).
        watch
            Called after each generation. A KeyboardInterrupt in it, or in `objective`, ends the search early.

        Raises
        ------
        PeriluneError
            If the bounds are not finite or empty, or the objective returns another shape.
        """
        lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
        _check_box(lower, upper)
        rng = np.random.default_rng(self.seed)
        records: list[Generation] = []

        def judge(genes: Matrix) -> Vector:
            values = np.asarray(objective(lower + genes * (upper - lower)), dtype=float)
            if values.shape != (len(genes),):
                raise PeriluneError(
                    "the objective must return one value for each individual",
                    got=f"shape {values.shape}",
                    expected=f"({len(genes)},)",
                )
            return np.where(np.isfinite(values), values, np.inf)

        genes = rng.random((self.population, len(lower)))
        values, interrupted = np.full(self.population, np.inf), False
        try:
            values = judge(genes)
            for number in range(self.generations + 1):
                records.append(Generation(number=number, least=float(values.min()), median=float(np.median(values))))
                if watch is not None:
                    watch(records[-1])
                if number < self.generations:
                    genes, values = self._next(rng, genes, values, judge)
        except KeyboardInterrupt:
            interrupted = True
        chosen = _distinct_individuals(genes, values, self.best, self.distinct)
        return Survivors(
            points=lower + genes[chosen] * (upper - lower),
            values=values[chosen],
            generations=tuple(records),
            interrupted=interrupted,
        )

    def _next(self, rng: np.random.Generator, genes: Matrix, values: Vector, judge: Objective) -> tuple[Matrix, Vector]:
        """Return the next generation: the elite of parents and children, and the best other children."""
        size = self.population
        children = self._mutated(rng, self._crossed(rng, genes[self._selected(rng, values)]))
        child_values = judge(children)
        everyone, all_values = np.vstack([genes, children]), np.concatenate([values, child_values])
        elite = _distinct_individuals(everyone, all_values, max(1, round(self.elite * size)), self.distinct)
        taken = np.zeros(len(everyone), dtype=bool)
        taken[elite] = True
        order = size + np.argsort(child_values, kind="stable")
        rest = [i for i in order.tolist() if not taken[i]][: size - len(elite)]
        kept = np.concatenate([elite, np.array(rest, dtype=np.intp)])
        return everyone[kept], all_values[kept]

    def _selected(self, rng: np.random.Generator, values: Vector) -> Indices:
        """Return the index of the winner of each tournament."""
        entrants = rng.integers(len(values), size=(len(values), self.tournament))
        return entrants[np.arange(len(values)), np.argmin(values[entrants], axis=1)]

    def _crossed(self, rng: np.random.Generator, parents: Matrix) -> Matrix:
        """Cross neighbours: children lie at +-b half-distances from the middle of their parents."""
        children, half = parents.copy(), len(parents) // 2
        a, b = parents[:half], parents[half : 2 * half]
        q = rng.random(a.shape)
        stretch = np.where(q < 0.5, 2 * q, 1 / (2 - 2 * q)) ** (1 / (self.spread + 1))
        # Each gene crosses with probability 1/2 in a pair that crosses at all, as positions of a string do.
        crosses = (rng.random((half, 1)) < self.crossover) & (rng.random(a.shape) < 0.5)
        stretch = np.where(crosses, stretch, 1.0)
        children[:half] = 0.5 * (a + b) + 0.5 * stretch * (a - b)
        children[half : 2 * half] = 0.5 * (a + b) - 0.5 * stretch * (a - b)
        return np.clip(children, 0.0, 1.0)

    def _mutated(self, rng: np.random.Generator, children: Matrix) -> Matrix:
        """Move some genes by polynomially distributed steps."""
        mutates = rng.random(children.shape) < self.mutation / children.shape[1]
        q = rng.random(children.shape)
        power = 1 / (self.spread + 1)
        step = np.where(q < 0.5, (2 * q) ** power - 1, 1 - (2 - 2 * q) ** power)
        return np.clip(children + np.where(mutates, step, 0.0), 0.0, 1.0)


def _distinct_individuals(genes: Matrix, values: Vector, count: int, distance: float) -> Indices:
    """Return indices of the best individuals no two of which are nearer than `distance`; at least the best one."""
    chosen: list[int] = []
    for i in np.argsort(values, kind="stable").tolist():
        if chosen:
            away = np.sqrt(np.mean((genes[chosen] - genes[i]) ** 2, axis=1))
            if not np.isfinite(values[i]) or away.min() < distance or not away.min() > 0:
                continue
        chosen.append(i)
        if len(chosen) == count:
            break
    return np.array(chosen, dtype=np.intp)


def _check_box(lower: Vector, upper: Vector) -> None:
    if lower.shape != upper.shape or lower.ndim != 1 or not len(lower):
        raise PeriluneError("the bounds have different lengths", got=f"shapes {lower.shape} and {upper.shape}")
    bad = np.nonzero(~(np.isfinite(lower) & np.isfinite(upper) & (lower <= upper)))[0]
    if len(bad):
        i = int(bad[0])
        raise PeriluneError(
            f"bounds of gene {i} are not a finite range",
            got=f"[{lower[i]}, {upper[i]}]",
            expected="finite, lower <= upper",
            advice="a population is drawn from within bounds: bound every variable",
        )
