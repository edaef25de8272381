"""What may be passed as a guess: a solution of any method, of a problem with as many phases."""

from __future__ import annotations

from perilune.problem.problem import Problem
from perilune.problem.solution import Solution
from perilune.words.outcome import PeriluneError


def fitting_guess(problem: Problem, guess: object) -> Solution:
    """The guess, where it is a solution with as many phases as the problem.

    Raises
    ------
    PeriluneError
        If it is anything else.
    """
    if not isinstance(guess, Solution):
        raise PeriluneError(
            "the guess is no solution",
            got=f"{type(guess).__name__}",
            expected="a Solution, as solve() returns it and load() reads it",
            advice="solve a nearby problem and pass its solution, or leave the guess out",
        )
    if len(guess.trajectories) != len(problem.phases):
        raise PeriluneError(
            "the guess has another number of phases",
            got=str(len(guess.trajectories)),
            expected=str(len(problem.phases)),
            advice="give a solution of a problem with the same phases, or none",
        )
    return guess
