"""Level 5: mutants of the prover, each caught by the check that is there for what is wrong with it.

Caught is a mutant whose check sees a wrong enclosure or statement, or that the prover then refuses (`PeriluneError`);
one that breaks down in any other way is not. A mutant shows that its check looks, and a check is none without one.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from math import pi
from pathlib import Path
from unittest.mock import Mock

import pytest

import perilune as pl

pytest.importorskip("flint")

import prover_checks as checks
import test_rigorous_claims as claims
import test_rigorous_optimum as optimum

SOURCE = Path(__file__).parents[2] / "src" / "perilune"


@contextmanager
def mutated(name: str, old: str, new: str) -> Iterator[None]:
    """The prover with one file changed: of its own, or of another room."""
    room, _, file = name.rpartition(".")
    path = SOURCE.joinpath(*(room or "rigorous").split("."), f"{file}.py")
    source = path.read_text(encoding="utf-8")
    assert source.count(old) == 1, f"{source.count(old)} places in {name}: {old}"
    full = f"perilune.{room or 'rigorous'}.{file}"
    own = ("perilune.rigorous", full)
    kept = {key: module for key, module in sys.modules.items() if key.startswith(own)}
    for key in kept:
        del sys.modules[key]
    spec = importlib.util.spec_from_file_location(full, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[full] = module
    try:
        exec(compile(source.replace(old, new), str(path), "exec"), module.__dict__)
        yield
    finally:
        for key in [key for key in sys.modules if key.startswith(own)]:
            del sys.modules[key]
        sys.modules.update(kept)


Mutant = tuple[str, str, str]  # a file, a place in it, what stands there then
_well = claims.test_another_minimum_of_h_that_is_lower_at_any_time_is_seen
_side = claims.test_an_end_or_a_parameter_is_on_the_side_where_it_would_cost_less_beyond
_linked = partial(optimum.test_a_link_at_a_harmless_place_moves_no_conjugate_point, monkeypatch=Mock())
_bent = optimum.test_a_link_that_is_curved_weighs_against_what_lies_before
_convex = claims.test_a_control_on_a_bound_is_the_least_where_h_is_convex_in_it
_circle = claims.test_the_nearest_point_of_a_circle_is_a_minimum_and_the_farthest_is_none
_small = partial(claims.test_a_control_on_the_wrong_bound_is_seen_however_small_its_effect, 1e-13)
_end = claims.test_a_bound_holds_an_end_only_where_it_would_cost_less_beyond
_anyway = claims.test_a_bound_that_is_met_anyway_or_holds_nothing_back_has_no_multiplier
_touched = claims.test_a_limit_that_is_touched_at_the_end_is_not_broken_before
_limits = claims.test_every_limit_that_is_broken_is_named_and_no_other
MUTANTS: dict[str, tuple[Mutant, Callable[[], object]]] = {
    name: (mutant, check)
    for check, own in (
        (checks.series_agree, {
            "series cut off":
                ("taylor", "in range(orders):\n            for step", "in range(2):\n            for step"),
            "known series cut off":
                ("taylor", "arb_series(inputs[k][:orders], orders)", "arb_series(inputs[k][:2], 2)"),
            "product without its last term":
                ("taylor", "sum(map(mul, a, b[::-1]))),", "sum(map(mul, a[:-1], b[::-1]))),"),
            "square without its middle term": ("taylor", "half + a[k // 2] * a[k // 2]", "half"),
            "quotient without its memory": ("taylor", "(a[k] - sum(map(mul, b[1:]", "(a[k] - sum(map(mul, b[2:]"),
            "root without its memory": ("taylor", "c[1:], c[:0:-1]", "c[2:], c[:0:-1]"),
            "sine with the wrong sign": ("taylor", "cosine.append(-sum(", "cosine.append(sum("),
            "logarithm's derivative off": ("graph", '"log": lambda: 1 / a,', '"log": lambda: here / a,'),
            "quotient's derivative off": ("graph", "(at[1], -here / b)", "(at[1], here / b)"),
        }),
        (checks.growth_is_enclosed, {
            "remainder dropped": ("enclosure_step", "length) + r * length**order", "length)"),
            "remainder halved": ("enclosure_step", "length) + r * length**order", "length) + r * length**order / 2"),
            "remainder of tangents dropped": ("enclosure_step", " + last * length**m", ""),
            "order of the remainder off by one":
                ("enclosure_step", "[c[order] for c in arc", "[c[order - 1] for c in arc"),
            "tangents off by a factor": ("enclosure_step", "total * (1 / arb(k + 1))", "total * (2 / arb(k + 1))"),
            "rates off by a factor": ("taylor", "following / (k + 1)", "following / (k + 2)"),
        }),
        (checks.tangents_are_enclosed, {
            "remainder along a step dropped":
                ("enclosure_step", "_enclose_over(c, since) + last * since**order", "_enclose_over(c, since)"),
        }),
        (checks.a_step_over_a_pole_is_refused, {
            "inclusion unchecked":
                ("enclosure_step", "if all(inside) and all(tangent_inside):", "if all(tangent_inside):"),
            "every component taken for a constant":
                ("enclosure_step", "[rate.vanishes() for rate in", "[True for rate in"),
            "range of the end alone": ("enclosure_step", "span = arb(0).union(length)", "span = length"),
        }),
        (checks.a_step_that_tangents_outgrow_is_refused, {
            "inclusion of tangents unchecked":
                ("enclosure_step", "if all(inside) and all(tangent_inside):", "if all(inside):"),
        }),
        (checks.a_step_over_a_jump_is_refused, {
            "angle beyond its jump": ("taylor", "if x > 0 or y > 0 or y < 0 else arb.nan()", ""),
            "constants rounded":
                ("graph", "fmpq(*float(value).as_integer_ratio())", "fmpq(round(float(value) * 1e12), 10**12)"),
        }),
        (checks.flights_stay_in_their_enclosures, {
            "remainder at the start alone":
                ("enclosure_step", "Z = [r if s else r + arb(0, w)", "Z = [z[0] + r - r.mid() - arb(0, r.rad())"),
            "tangents by the transposed slopes": ("enclosure_step", "A[place] = c[k]", "A[place[::-1]] = c[k]"),
            "mean value about the centre alone": ("enclosure", "self._S * aside + self._r", "self._r"),
            "mean value over half of the box":
                ("enclosure", "ball_column([value - value.mid()", "ball_column([(value - value.mid()) / 2"),
            "mean value over half of the box at the end":
                ("enclosure", "+ more * aside", "+ more * aside * arb(0)"),
            "mean value over half of the box before it":
                ("enclosure", "self._S * aside + ", "self._S * aside * arb(0.5) + "),
            "duration without the rate at its end":
                ("enclosure", "D = frame.tangents + by_length", "D = frame.tangents"),
            "arc without the derivative of the one before":
                ("enclosure", "by_y + by_before * D if i else by_y", "by_y"),
        }),
        (checks.a_frame_turns_with_the_flow, {
            "rounding forgotten": ("enclosure", "M * self._r + back *", "M * self._r * arb(0) + back *"),
            "rounding not turned": ("enclosure", "+ back * ball_column", "+ ball_column"),
            "frame of the step before forgotten": ("enclosure", "together = moved * self._B", "together = moved"),
        }),
        (checks.frames_keep_remainders, {
            "remainder of a step left out": ("enclosure", "+ last * length**order for c", "+ 0 * last for c"),
            "tangents of a frame at their middle": ("enclosure", "self._S, self._B = M * self._S, B",
                                                    "self._S, self._B = M.mid() * self._S, B"),
        }),
        (checks.meditch_lands, {
            "no H in what a duration costs":
                ("boundary_equations", "if phase.duration in problem.free_names:", "if False:"),
        }),
        (checks.a_wide_box_is_refused, {
            "Krawczyk unchecked": ("krawczyk", "all(b.contains_interior(k)", "all(b.overlaps(k)"),
            "contraction left out": ("krawczyk", "[c - d + e for", "[c - d for"),
            "derivative at the centre alone": ("krawczyk", "refined.inverse * J\n", "refined.inverse * J.mid()\n"),
        }),
        (checks.tangent_is_linear, {
            "adjoint with the wrong sign": ("equations", "*(-slope for slope in slopes)]", "*slopes]"),
            "direction with the wrong sign": ("equations", "-g / strength", "g / strength"),
        }),
        (checks.newton_is_quadratic, {
            "derivatives off by a millionth":
                ("enclosure", "total += by_end * D", "total += by_end * D * (1 + 2**-20)"),
        }),
        (checks.J_is_that_of_the_root, {
            "J at the centre":
                ("theorem", "objective.values(root.y, root.flight.ends",
                 "objective.values(refined.y, root.flight.centre"),
            "defect left out": ("krawczyk", "[c - d + e for", "[c + e for"),
            "the least distance": ("theorem", "max(far, default", "min(far, default"),
        }),
        (checks.what_is_missing_is_no_theorem, {
            "what is missing ignored": ("verified", "if found.proved.missing:", "if False:"),
            "a local optimum in words alone":
                ("statement", "if not proved.optimum.proved:", "if False:"),
        }),
        (checks.numbers_are_exact, {
            "a text that is another number": ("exact_tape", "given.unit) == given.value", "given.unit) != 0"),
            "pi left out of an expression": ("exact_tape", "graph.power(graph.pi(), self.power)", "1"),
            "pi left out of a ball": ("exact_tape", "arb.pi() ** self.power", "1"),
            "pi left out of a certificate": ("exact_tape", "if self.power else {}", "if self.power > 0 else {}"),
            "a decimal taken as its double": ("exact_tape", "rational=found[0],", "rational=Fraction(given.value),"),
        }),
        (checks.signs_are_seen, {
            "sign at the end ignored": ("inequalities", "(-1) ** at_end * ", ""),
            "sign at the deepest halving taken": ("inequalities", "SignResult(proved=False", "SignResult(proved=True"),
            "sign at one point": ("inequalities", "z = step.at(span)", "z = step.at(span.mid())"),
            "half of a step unseen": ("inequalities", ", (middle, b, depth + 1)]", "]"),
        }),
        (checks.forms_are_positive, {
            "diagonal alone": ("hamiltonian_minimum", "[a - factor * b for a, b", "[a for a, b"),
        }),
        (checks.conjugate_points_are_seen, {
            "Riccati's equation past a conjugate point":
                ("riccati_junctions", "return proved.begin + middle", "continue"),
            "W left where a step began":
                ("second_order", "            W = upper_bound_matrix(", "            upper_bound_matrix("),
            "tangents of higher order unseen": ("riccati_junctions", "own * inverse * away**k", "own * inverse * 0"),
            "form at the end unseen": ("second_order", '"" if positive_definite(C) else', '"" if True else'),
            "second variation with the wrong sign":
                ("riccati_junctions", "upper_bound_matrix(M * -1, weights)", "upper_bound_matrix(M, weights)"),
            "second variation from nothing":
                ("riccati_junctions", "upper_bound_matrix(M * -1, weights)", "upper_bound_matrix(M * 0, weights)"),
            "end conditions left out": ("riccati_junctions", "if not normals.nrows():", "if True:"),
            "duration left out of time": ("equations", "[lasting * rate for", "[1 * rate for"),
        }),
        (partial(_circle, True, 1), {
            "curvature of the start left out":
                ("riccati_junctions", "C if W is None else C - W", "C * 0 if W is None else C - W"),
        }),
        (partial(_circle, True, 0), {
            "costates by their names":
                ("second_order", "[root.y[i] for i in own[: len(phase.states)]]",
                 '[named[f"{phase.name}.lambda_{name}(0)"] for name in phase.state_names]'),
        }),
        (partial(_circle, False, 1), {
            "curvature of the end left out":
                ("second_order", 'graph.input(("nu", i)) * value', 'graph.input(("nu", i)) * value * 0'),
        }),
        (partial(_linked, 3.0, "held", pi), {
            "what lies before a link left out": ("riccati_junctions", "C if W is None else C - W", "C"),
            "what lies before a link with the wrong sign": ("riccati_junctions", "else C - W)", "else C + W)"),
            "derivative of a link left out":
                ("riccati_junctions", "return G * N, N.", "return G * N if W is None else N, N."),
        }),
        (partial(_linked, 0.0, "range", pi / 2), {
            "an end inside its range held": ("second_order", '!= "inside"', '!= ""'),
        }),
        (partial(_bent, 0.48, False), {
            "curvature of a link left out":
                ("second_order", 'graph.input(("lam", i)) * e for', 'graph.input(("lam", i)) * e * (not k) for'),
            "curvature of a link with the wrong sign":
                ("second_order", 'graph.input(("lam", i)) * e for', 'graph.input(("lam", i)) * e * (-1) ** k for'),
            "costates before a link in the place of those behind":
                ("second_order", "costates = self.costates[k]\n",
                 "costates = [*self.costates[k - 1], self.costates[k][0]] if k else self.costates[k]\n"),
        }),
        (partial(optimum.test_the_end_of_a_phase_is_curved_where_another_follows, False), {
            "curvature of an end before a link left out":
                ("second_order", 'graph.input(("nu", i)) * value',
                 'graph.input(("nu", i)) * value * (k == len(self.phases))'),
        }),
        (optimum.test_end_conditions_have_multipliers_of_their_own, {
            "multipliers by their names":
                ("second_order", "nu.append(own)", 'nu.append(self.multipliers[k - 1][-1])'),
        }),
        (partial(optimum.test_a_switch_is_a_minimum_in_its_time_and_the_control_together, 1.0, -0.25, 0.0, Mock()), {
            "times of switches left out":
                ("second_order", 'for name in self.names if name not', 'for name in problem.free_names if name not'),
            "length of an arc left out of the last":
                ("boundary_equations", "duration = duration - lengths[j]", "duration = duration"),
        }),
        (optimum.test_a_switch_has_a_slope, {
            "slope at a switch unseen": ("second_order", "zero * slope.value(z, 1) if zero", "sign if zero"),
        }),
        (optimum.test_a_control_on_a_bound_is_so_strictly_up_to_the_end, {
            "sign at an end unseen": ("second_order", "else slope.value(z)) > 0", "else sign) > 0"),
        }),
        (optimum.test_what_is_not_covered_is_named, {
            "a bound that is reached": ("second_order", "if any(zeros) and (", "if False and ("),
            "a direction that nothing multiplies": ("second_order", "if arc.idle:", "if False:"),
        }),
        (optimum.test_a_parameter_on_its_bound_is_not_moved, {
            "a parameter on its bound moved": ("second_order", "if name not in boundary.sides.free]", "if name]"),
            "no parameter moved": ("second_order", "if name not in boundary.sides.free]", "if not name]"),
        }),
        (partial(optimum.test_a_control_without_a_formula_has_its_conjugate_points, 3.0), {
            "a control without a formula that stays": ("second_order", "by_z * V * -1", "by_z * V * 0"),
        }),
        (_small, {
            "any quantity taken to vanish":
                ("inequalities", "            return order\n    return 0",
                 "            return max(order, 1)\n    return 0"),
            "slack for all": ("inequalities", "touching\n                and b == 1.0", "b == 1.0"),
        }),
        (partial(claims.test_a_limit_that_is_missed_at_the_end_is_named, 1e-06, ["x > 0.0 (go)"]), {
            "slack wide": ("inequalities", "_SLACK = 1e-12", "_SLACK = 1e-2"),
        }),
        (_touched, {
            "slack of any size": ("inequalities", "if lost < _SLACK else None", ""),
        }),
        (_limits, {
            "convexity unseen":
                ("inequalities", 'in {name} ({where})", scalar.curvature)',
                 'in {name} ({where})", scalar.curvature * -1)'),
            "bounds of a control unseen": ("inequalities", "if limit is not None:", "if False:"),
            "upper bounds of states unseen":
                ("inequalities", "((state.lower, 1), (state.upper, -1))", "((state.lower, 1),)"),
            "conditions of the path unseen":
                ("inequalities", "if taped is not None and phase.path_conditions:", "if False:"),
            "range of a free parameter unseen": ("inequalities", "proved=bool(room > 0)", "proved=True"),
        }),
        (claims.test_an_arc_of_negative_length_is_seen, {
            "length of an arc unseen": ("inequalities", "proved=bool(length > 0)", "proved=True"),
        }),
        (partial(_convex, 2.0, 1, []), {
            "transversality with the wrong sign":
                ("boundary_equations", "end[half + i] - slope", "end[half + i] + slope"),
            "wrong sign of dH/du":
                ("inequalities", 'bound ({where})", sign * scalar.slope', 'bound ({where})", -sign * scalar.slope'),
        }),
        (partial(_convex, 2.0, -1, ["convex"]), {
            "convexity on a bound unseen":
                ("inequalities", 'scalar.regime != "interior" and scalar.curvature.vanishes()',
                 'scalar.regime != "interior"'),
        }),
        (partial(_convex, 0.5, 1, ["least"]), {
            "sign on a bound unseen":
                ("inequalities", 'bound ({where})", sign * scalar.slope',
                 'bound ({where})", sign**2 * self.boundary.graph.constant(1)'),
        }),
        (partial(_side, "lower", (2.0, 7.0)), {
            "wrong sign of a multiplier":
                ("boundary_equations", 'nu if side == "upper" else -nu', '-nu if side == "upper" else nu'),
        }),
        (partial(_end, "upper", False), {
            "bound of an end on the other side":
                ("boundary_equations", "self.sides.states[phase.name, state.name])", '"lower")'),
            "bound of an end without its multiplier":
                ("boundary_equations", "psi += [end[i] for", "psi += [self.graph.constant(0) * end[i] for"),
        }),
        (partial(_end, "lower", False), {
            "multiplier of a bound with the wrong sign":
                ("boundary_equations", 'nu if side == "upper" else -nu', 'nu if c.name != "x" else nu'),
        }),
        (_anyway, {
            "two multipliers of one end": ("proof.necessary.terminal_bounds", "np.linalg.norm(unsaid) > _FELT", "True"),
            "multiplier of nothing": ("proof.necessary.terminal_bounds", "sign * value > least", "True"),
            "multiplier of the wrong sign": ("candidate", '"upper" if mu > 0 else', '"upper" if mu < 0 else'),
        }),
        (claims.test_a_bound_that_is_touched_and_not_crossed_is_not_seen_to_be_kept, {
            "first derivative unlooked at":
                ("inequalities", "(-1) ** at_end * quantity.value(z, at_end) > 0", "quantity.value(z, at_end + 1) > 0"),
        }),
        (checks.stages_burn_out, {
            "an end on its bound unknown to its limit":
                ("boundary_equations", "met[self.last[k]] += equations", "met[self.last[k]] += equations[:0]"),
        }),
        (partial(_side, "inside", (-2.0, 7.0)), {
            "wrong sign inside a range":
                ("boundary_equations", 'is above its lower bound", value - lower',
                 'is above its lower bound", lower - value'),
        }),
        (partial(_side, "lower", None), {
            "wrong sign of a slope":
                ("boundary_equations", 'slopes[i] if side == "lower" else -slopes[i]',
                 '-slopes[i] if side == "lower" else slopes[i]'),
        }),
        (claims.test_a_corner_that_each_control_alone_would_keep_is_no_minimum, {
            "corner": ("inequalities", "if arc.joint:", "if False:"),
            "faces at bounds left out":
                ("hamiltonian_minimum", '(side == "upper" and B[i] < bound)', 'side == "upper"'),
        }),
        (partial(_well, 0.1, 0.0, 1.0, False), {
            "lower halves of boxes unseen": ("hamiltonian_minimum", "left[i].lower().union(left[i].mid()), ", "*(), "),
            "the control's own box alone":
                ("hamiltonian_minimum", "[[a.union(b) for a, b in zip(low, high, strict=True)]]", "[W]"),
            "convexity around a box unseen":
                ("hamiltonian_minimum", "if not other or positive_definite(arb_mat(form)) else B", ""),
            "a box in doubt taken":
                ("hamiltonian_minimum", "if widths[i] <= 1.0:\n                return False",
                 "if widths[i] <= 1.0:\n                continue"),
        }),
        (partial(_well, -0.1, 0.0, -1.0, False), {
            "upper halves of boxes unseen": ("hamiltonian_minimum", ", left[i].mid().union(left[i].upper()))", ",)"),
        }),
        (partial(_well, 1 - 1e-9, -1.0, -1.0, False), {
            "minimum in the middle of steps alone": ("hamiltonian_minimum", "step.at(span)", "step.at(span.mid())"),
            "minimum in the first halves of steps alone":
                ("hamiltonian_minimum", ", ((a + b) / 2, b, depth + 1)]", "]"),
        }),
        (partial(_well, 1.001, -1.0, -1.0, True), {
            "control that turns the other way": ("equations", "right = [-sum(", "right = [sum("),
            "control that does not turn": ("equations", "right = [-sum(", "right = [0 * sum("),
        }),
        (claims.test_an_arc_begins_with_no_control_of_the_one_before_but_by_a_formula, {
            "control of the arc before": ("inequalities", "2 * arc.half if side else len(arc.rates)", "len(arc.rates)"),
        }),
        (claims.test_a_parameter_that_is_a_bound_is_chosen_for_what_it_bounds, {
            "bound without its derivative": ("equations", "graph.substitute([H], held)[0]", "H"),
        }),
    )
    for name, mutant in own.items()
}  # fmt: skip


def caught(check: Callable[[], object]) -> bool:
    """Whether a check is not met, or refused."""
    try:
        return checks.holds(check) is False
    except (AssertionError, pl.PeriluneError, pytest.fail.Exception):
        return True


@pytest.mark.parametrize("name", MUTANTS)
def test_mutants_of_the_prover_are_caught(name: str) -> None:
    mutant, check = MUTANTS[name]
    with mutated(*mutant):
        assert caught(check), f"nobody noticed: {name}"
