"""Long programs in pieces: the same numbers, whatever the pieces hand on."""

import casadi as ca
import numpy as np
import pytest

from perilune.kernels import compile_arcs, compile_map
from perilune.kernels.algebra import split_program as dividing
from perilune.kernels.algebra.program import trace_function
from perilune.kernels.algebra.split_program import split_program
from perilune.kernels.algebra.system import ArcSystem
from perilune.kernels.code import emit
from perilune.kernels.flight.equations_code import equations_module

X = ca.SX.sym("x", 5)


def tangled() -> ca.Function:
    """Values of all ages: each operation takes two of those before, far and near."""
    values = [*ca.vertsplit(X), ca.SX(0.5), ca.pw_lin(X[0], ca.DM([-1, 0, 2]), ca.DM([1, -1, 3]))]
    rng = np.random.default_rng(5)
    for k in range(60):
        a, b = (values[int(i)] for i in rng.integers(len(values), size=2))
        values.append((ca.sin(a) + b, a * b, a - 2 * b, ca.fmin(a, ca.cos(b)))[k % 4])
    return ca.Function("tangled", [X], [ca.vertcat(*values[::3], X[1], 0, values[-1])])


@pytest.mark.parametrize("most", [1, 3, 10, 1000])
def test_pieces_compute_what_the_whole_does(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dividing, "MOST", most)
    function = tangled()
    points = np.random.default_rng(1).normal(size=(9, 5))
    (found,) = compile_map(function, cache=False)(points)
    expected = np.array([np.asarray(function(x)).ravel() for x in points])
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-14)


def test_arcs_fly_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    z, p = ca.SX.sym("z", 4), ca.SX.sym("p", 2)
    rates = ca.vertcat(z[2:], -p[0] * z[:2] / ca.norm_2(z[:2]) ** 3 + p[1] * ca.sin(z[2:]))
    rhs = ca.Function("rhs", [z, p], [rates])
    start, given, seeds = [[1.0, 0.1, 0.0, 1.1]], [[1.0, 1e-2]], np.eye(4)[None]
    ends = []
    for most in (1000, 6):
        monkeypatch.setattr(dividing, "MOST", most)
        ends.append(compile_arcs(rhs, columns=4, cache=False).propagate(start, given, [3.0], seeds))
    whole, divided = ends
    np.testing.assert_allclose(divided.z, whole.z, rtol=1e-10)
    np.testing.assert_allclose(divided.columns, whole.columns, rtol=1e-8, atol=1e-9)


def test_a_place_that_a_piece_writes_is_none_that_it_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dividing, "MOST", 4)
    parts, held = split_program(trace_function(tangled()))
    assert len(parts) > 10
    for part in parts:
        read = {one[2] for one in part.instructions if one[:2] == ("input", dividing.HELD)}
        assert not read & set(part.kept)
        assert {*read, *part.kept} <= set(range(held))
    assert held < sum(len(part.kept) for part in parts), "places are used again"


def test_a_short_program_is_one_piece() -> None:
    program = trace_function(tangled())
    (part,), held = split_program(program)
    assert (held, part.kept) == (0, {})
    assert len(part.instructions) == len(program.instructions)
    assert sorted(part.results) == list(range(len(program.outputs)))


def layer(slope: float, drift: float) -> ca.Function:
    """The same equations with other numbers, which are factors, terms and a rate of their own."""
    z, p = ca.SX.sym("z", 3), ca.SX.sym("p")
    return ca.Function("layer", [z, p], [ca.vertcat(slope * z[1], ca.sin(z[0]) - p * slope / (2 + z[1]), drift)])


@pytest.mark.parametrize("most", [2000, 4])
def test_modes_that_differ_in_constants_share_their_code(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dividing, "MOST", most)
    modes = [layer(1.5, 0.25), layer(-0.3, 7.0), layer(1.5, 0.25), layer(1.5, 1.5)]
    seeds, starts = np.eye(3, dtype=bool), np.random.default_rng(2).normal(size=(8, 3))
    system = ArcSystem(modes=tuple(modes), solved=(None,) * 4, events=(), seeds=seeds)
    found, texts = list[np.ndarray](), list[str]()
    for worth in (1, 10**9):
        monkeypatch.setattr(emit, "_WORTH_SHARING", worth)
        texts.append(equations_module(system, 4))
        arcs = compile_arcs(modes, columns=3, cache=False).propagate(
            starts, [0.7], 1.2, np.eye(3), mode=np.arange(8) % 4
        )
        found.append(np.concatenate([arcs.z.ravel(), arcs.columns.ravel()]))
    assert found[0].tobytes() == found[1].tobytes()
    together, apart = (text.count("call <4 x double> @perilune.sin(") for text in texts)
    assert 0 < 2 * together <= apart, "layers 0 to 2 are one function"
    for mode, (slope, drift) in enumerate([(1.5, 0.25), (-0.3, 7.0), (1.5, 0.25), (1.5, 1.5)]):
        alone = compile_arcs(layer(slope, drift), cache=False).propagate(starts[mode], [0.7], 1.2)
        np.testing.assert_allclose(found[0][:24].reshape(8, 3)[mode], alone.z[0], rtol=1e-11, atol=1e-12)
