"""Programs put together from differentiated blocks, against CasADi's derivatives of the whole; errors of a mesh."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import get_lapack_funcs

from perilune import Pseudospectral
from perilune.direct import blocks, interior_point as interior, mesh_error as errors, nlp
from perilune.direct.collocated_solution import Segment
from perilune.direct.collocation import Mesh, Polynomial, rule
from perilune.direct.mesh import refine_mesh
from perilune.direct.nlp import TranscribedProgram
from perilune.direct.reduced_space import AddedWeights, ReducedEquations, count_negative_eigenvalues
from perilune.problem import Parameter, Phase, Problem, Unnumbered, Variable, canonical_given
from problems.ascents import tangent_steering
from problems.goddard import goddard
from problems.integrators import least_energy, least_time
from problems.landings import meditch
from problems.singular import aly
from problems.staging import staged_burns

UNEVEN = Mesh(degrees=(4, 3), joints=(0.0, 0.4, 1.0), free=(0.1,))


@pytest.mark.parametrize("nearest", [False, True])
@pytest.mark.parametrize("scheme", ["gauss", "radau"])
@pytest.mark.parametrize("problem", [staged_burns(), meditch(), least_energy(0.1), tangent_steering(), aly()])
def test_what_is_put_together_has_the_derivatives_of_the_whole(problem, scheme, nearest):
    program = TranscribedProgram(problem=problem, scheme=scheme, meshes=(UNEVEN,) * len(problem.phases))
    made = nlp._assemble_blocks(Unnumbered(problem), program.layouts, nearest)
    w, p, of_J = (ca.MX.sym("a", made.hessian.size_in(i)) for i in range(3))
    of_g = ca.MX.sym("b", made.hessian.size_in(3))
    J, g = made.value(w, p)
    assert J.is_dense()  # which IPOPT asks for, and of aly() nothing can be missed
    whole = ca.Function(
        "whole",
        [w, p, of_J, of_g],
        [ca.gradient(J, w), ca.jacobian(g, w), ca.triu(ca.hessian(of_J * J + ca.dot(of_g, g), w)[0])],
    )
    random = np.random.default_rng(0)
    point, weights = random.uniform(0.2, 1.0, w.numel()), random.normal(size=of_g.numel())
    given = canonical_given(problem)
    found = (
        made.gradient(point, given)[1],
        made.jacobian(point, given)[1],
        made.hessian(point, given, 0.7, weights),
    )
    for one, other in zip(found, whole(point, given, 0.7, weights), strict=True):
        assert np.abs(np.array(one) - np.array(other)).max(initial=0.0) < 1e-14


def test_the_gradient_of_J_is_no_work():
    """It takes of the rates what J depends on, which is nothing."""
    problem = staged_burns()
    program = TranscribedProgram(problem=problem, scheme="gauss", meshes=(UNEVEN,) * len(problem.phases))
    for nearest in (False, True):
        made = nlp._assemble_blocks(Unnumbered(problem), program.layouts, nearest)
        repeats = [
            any("map" in str(one.instruction_MX(k)) for k in range(one.n_instructions()))
            for one in (made.value, made.gradient)
        ]
        assert repeats == [True, False]


@pytest.mark.parametrize("scheme", ["gauss", "radau"])
def test_rows_vanish_on_the_closed_form(scheme):
    """x = t - t^2, v = 1 - 2 t, cost = 2 t under u = -2: a polynomial, which collocation holds exactly on any mesh."""
    problem = least_energy()
    program = TranscribedProgram(problem=problem, scheme=scheme, meshes=(UNEVEN,))
    (layout,) = program.layouts
    ends = [(0.0, 0.4), (0.4, 1.0)]
    t = np.concatenate([
        [a + 0.5 * (b - a) * (s + 1) for s in rule(scheme, n).support[: rule(scheme, n).stride]]
        for (a, b), n in zip(ends, UNEVEN.degrees, strict=True)
    ] + [[1.0]])  # fmt: skip
    states = np.column_stack([t - t * t, 1 - 2 * t, 2 * t])
    w = np.concatenate([np.zeros(len(problem.free)), [0.4], states.ravel(), np.full(layout.nodes, -2.0)])
    made = nlp._assemble_blocks(Unnumbered(problem), program.layouts, False)
    J, g = made.value(w, canonical_given(problem))
    assert float(J) == pytest.approx(2.0, abs=1e-14)
    assert np.abs(np.array(g)).max() < 1e-13


def test_a_second_solve_builds_nothing():
    problem = meditch()
    method = Pseudospectral(refine=0)
    method.run(problem)
    differentiated, built = blocks.phase_blocks.cache_info().misses, nlp._assemble_blocks.cache_info().misses
    other = problem.with_given(g=1.1 * problem.given["g"].value)
    assert method.run(other).objective != method.run(problem).objective
    assert nlp._assemble_blocks.cache_info().misses == built
    Pseudospectral(refine=0, nodes=7, segments=3).run(other)
    assert blocks.phase_blocks.cache_info().misses == differentiated
    assert nlp._assemble_blocks.cache_info().misses == built + 1


# our own search


SOLVED = [staged_burns, meditch, least_energy, least_time, tangent_steering, goddard]


@pytest.mark.parametrize("scheme", ["gauss", "radau"])
@pytest.mark.parametrize("make", SOLVED)
def test_our_search_and_ipopt_find_the_same(make, scheme, monkeypatch):
    """J to the tolerance of the programs, costates to its root where a control may hide a switch between points."""
    problem, method = make(), Pseudospectral(scheme=scheme, nodes=16, refine=0)
    searched = counted(monkeypatch)
    own = method.run(problem)
    assert searched == ([True] if make is not goddard else [False])  # its singular arc is for IPOPT
    monkeypatch.setattr(nlp, "MODERATE", 0)
    other = method.run(problem)
    assert len(searched) == 1
    assert own.objective == pytest.approx(other.objective, rel=1e-9)
    for one, two in zip(own.trajectories, other.trajectories, strict=True):
        assert one.costate is not None and two.costate is not None
        size = np.abs(two.costate.values).max()
        assert one.costate(0.0) == pytest.approx(two.costate(0.0), abs=1e-5 * size)


def counted(monkeypatch) -> list[bool]:
    """Whether each search that is made finds something."""
    found, search = list[bool](), nlp.find_local_optimum

    def counting(*arguments):
        answer = search(*arguments)
        found.append(answer is not None)
        return answer

    monkeypatch.setattr(nlp, "find_local_optimum", counting)
    return found


def test_what_our_search_does_not_find_is_for_ipopt(monkeypatch):
    """Two iterations are too few for it, so that its program is solved as it would be without it."""
    monkeypatch.setattr(nlp, "PATIENCE", 2)
    searched = counted(monkeypatch)
    answer = Pseudospectral(refine=0).run(tangent_steering())
    assert searched == [False]
    assert answer.objective == pytest.approx(0.554570878334603, abs=2e-11)


def test_a_user_may_stop_our_search(monkeypatch):
    def stopped(self, point):
        raise KeyboardInterrupt

    monkeypatch.setattr(interior._InteriorPointSearch, "directions", stopped)
    with pytest.raises(KeyboardInterrupt):
        Pseudospectral().run(meditch())


def test_threads_share_programs():
    problem = tangent_steering()
    alone = [Pseudospectral(nodes=n, refine=0).run(problem) for n in (12, 60)]  # one by our search, one by IPOPT
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda n: Pseudospectral(nodes=n, refine=0).run(problem), [12, 60] * 6))
    for k, answer in enumerate(together):
        assert answer.objective == alone[k % 2].objective
        assert answer.statistics.iterations == alone[k % 2].statistics.iterations


@pytest.mark.parametrize(("least", "added"), [(1.0, 0.0), (-3.0, 1e-4 * sum(8.0**k for k in range(6))), (-1e9, None)])
def test_a_step_solves_the_whole_system(least: float, added: float | None):
    """Against a dense solution of the whole; `least` curves H along what the equations leave, up or down.

    Then so much of the identity is added, in steps, that it curves up, or there is no step.
    """
    random = np.random.default_rng(3)
    n, m, rows, ranges = 11, 7, 9, 3
    A, c, right = random.normal(size=(rows + ranges, n)), random.normal(size=rows), random.normal(size=(n, 2))
    A[:3, 3:7] = 0.0  # the first three states are determined without the others
    H, weighed = least * np.eye(n), AddedWeights(random.uniform(0.1, 1.0, n), random.uniform(0.1, 1.0, ranges))
    sizes = 10.0 ** random.uniform(-3, 3, m)
    found = ReducedEquations(A, c, sizes, [slice(0, 3), slice(3, 7)]).step(H, weighed, right)
    if added is None:
        assert found is None
        return
    assert found is not None
    dw, ds, y = found
    equations, ranged = A[:rows], A[rows:]
    H = H + added * np.eye(n) + np.diag(weighed.unknowns) + ranged.T @ np.diag(weighed.ranges) @ ranged
    whole = np.block([[H, equations.T], [equations, np.zeros((rows, rows))]])
    wanted = -np.vstack([right, np.column_stack([c, np.zeros(rows)])])
    assert np.vstack([dw, y]) == pytest.approx(np.linalg.solve(whole, wanted), rel=1e-8, abs=1e-9)
    assert ds == pytest.approx(ranged @ dw, rel=1e-8, abs=1e-9)


def test_negative_eigenvalues_are_counted():
    random = np.random.default_rng(5)
    (sytrf,) = get_lapack_funcs(("sytrf",))
    for size in (1, 2, 7, 20):
        for _ in range(20):
            matrix = random.normal(size=(size, size))
            matrix = matrix + matrix.T
            matrix[: size // 2, : size // 2] = 0.0  # so that rows are pivoted in pairs
            factor, places, _ = sytrf(matrix)
            assert count_negative_eigenvalues(factor, places) == (np.linalg.eigvalsh(matrix) < 0).sum()


# errors of a mesh


@pytest.mark.parametrize("growth", [1.0, -5.0, -60.0, 60.0])
def test_the_error_of_a_segment_by_its_closed_form(growth):
    """x' = k x from 1 against the line x = 1: the error after 1 s is |exp(k) - 1|, whoever flies it."""
    error = error_of_a_line(growth)
    exact = max(abs(math.exp(growth) - 1), 1 - math.exp(growth))
    # Picard's iteration stops at a thousandth of the error; beyond it, the flight step by step is as exact as asked.
    assert error == pytest.approx(exact, rel=1e-3)


def test_a_segment_that_takes_steps_without_end_to_fly_has_no_error():
    """As those of an answer that was not found: x' = -1e6 x over 1 s takes DOP853 hundreds of thousands."""
    assert math.isnan(error_of_a_line(-1e6))


def error_of_a_line(growth: float) -> float:
    """The error of x = 1 as a flight of x' = k x over 1 s."""
    problem, tau = exponential(growth), rule("gauss", 6)
    line = Segment(
        begin=0.0,
        end=1.0,
        state=Polynomial(points=tau.support, values=np.ones((7, 1))),
        control=Polynomial(points=tau.points, values=np.zeros((6, 0))),
        costate=Polynomial(points=tau.support, values=np.ones((7, 1))),
    )
    ((error,),) = errors.mesh_errors(problem, [[line]], problem.parameters({}), 1e-6)[0]
    return error


def exponential(growth: float) -> Problem:
    """One state, x' = k x over 1 s."""
    phase = Phase(
        name="only",
        states=(Variable(name="x", unit="m"),),
        controls=(),
        dynamics=lambda x, u, p, xp: (p.k * x.x,),
        duration="T",
    )
    return Problem(
        name="exponential",
        phases=(phase,),
        start=lambda p, xp: (p.x0,),
        given={
            "T": Parameter(value=1.0, unit="s"),
            "k": Parameter(value=growth, unit="1/s"),
            "x0": Parameter(value=1.0, unit="m"),
        },
        objective=lambda x, p, xp: x.x,
        objective_unit="m",
    )


def test_a_phase_without_length_keeps_its_mesh() -> None:
    """An optimum may do without a phase; shares of no time are no numbers, and no mesh."""
    flat, mesh = Polynomial(points=np.array([-0.5, 0.5]), values=np.zeros((2, 1))), Mesh.uniform(2, 2)
    gone = [Segment(begin=0.0, end=0.0, state=flat, control=flat, costate=flat)] * 2
    assert refine_mesh(meditch().phases[0], mesh, gone, np.ones((2, 3)), 1e-6, meditch().parameters({})) is mesh
