"""Old names of what is public work for one minor version: each use warns once, and gives what the new name gives."""

from __future__ import annotations

import importlib
import json
import pickle
import pydoc
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, cast

import pytest

import perilune as pl
from perilune.core.deprecation import RenamedAttribute, renamed_keywords
from perilune.core.errors import PeriluneError
from perilune.problem import Solution

Old: Any = pl  # which names what it no longer lists
GOES = "goes with the next minor version"
ARC = pl.NamedArc(phase="descent", begin=0.0, end=1.0, description="along the floor")


def warned(ask: Callable[[], Any], *words: str) -> Any:
    """Return what an old form gives; it has to warn once, in these words, of the line that uses it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = ask()
    (warning,) = caught
    assert warning.category is DeprecationWarning and warning.filename == __file__
    assert all(word in str(warning.message) for word in (GOES, *words)), str(warning.message)
    return found


def test_prove_is_verify() -> None:
    assert warned(lambda: Old.prove, "perilune.prove is perilune.verify now") is pl.verify
    assert warned(lambda: importlib.import_module("perilune.solve").prove, "perilune.solve.prove") is pl.verify
    assert importlib.import_module("perilune.solve").verify is pl.verify
    assert "prove" not in pl.__all__ and "prove" not in dir(pl)


def test_a_solve_takes_its_old_keywords(landing: pl.Problem, hybrid: Solution) -> None:
    solve: Any = pl.solve
    found = warned(lambda: solve(landing, level=0, guess=hybrid), "level= of solve is verify= now")
    assert found.objective == solve(landing, verify=0, guess=hybrid).objective
    with pytest.raises(PeriluneError, match=r"not a callback(.|\n)*got: 3"):
        warned(lambda: solve(landing, watch=3), "watch= of solve is callback= now")
    with pytest.raises(PeriluneError, match=r"no such verification level(.|\n)*got: 9"):
        warned(lambda: Old.sweep(landing, {"vehicle.mass": [300.0]}, level=9), "level= of sweep is verify= now")


def test_methods_and_atlases_take_a_watch(landing: pl.Problem, hybrid: Solution, tmp_path: Path) -> None:
    lines: list[Any] = []
    method: Any = pl.Indirect()
    found = warned(lambda: method.run(landing, hybrid, watch=lines.append), "watch= of run is callback= now")
    assert lines and found.objective == pytest.approx(hybrid.objective, rel=1e-12)
    for name, given in (("build", (landing, {"vehicle.thrust": (400.0, 500.0)}, tmp_path)), ("extend", (tmp_path, {}))):
        verb: Callable[..., Any] = getattr(pl.atlas, name)
        ask: Callable[[], Any] = lambda verb=verb, given=given: verb(*given, watch=3)  # noqa: E731
        with pytest.raises(PeriluneError, match=r"not a callback(.|\n)*got: 3"):
            warned(ask, f"watch= of {name} is callback= now")


def test_old_and_new_together_are_refused(landing: pl.Problem) -> None:
    with pytest.raises(PeriluneError) as caught:
        Old.solve(landing, level=0, verify=3)
    for part in ("by one name only", "got: level=..., verify=...", "expected: verify=...", "leave level out"):
        assert part in str(caught.value)
    with pytest.raises(PeriluneError, match="did you mean 'verify'"):  # the names offered are the new ones
        Old.solve(landing, verifi=3)


def test_the_record_of_a_proof_is_found_on_what_verify_returns(hybrid: Solution) -> None:
    """`verify` returned the record itself."""
    proved = pl.verify(hybrid, level=1)
    assert isinstance(proved, Solution) and proved.outcome is pl.Outcome.PROVED
    for name in ("level", "passed", "checks", "failed", "notes", "title", "tolerance", "certificate"):
        asked: Callable[[], Any] = lambda name=name: getattr(proved, name)  # noqa: E731
        assert warned(asked, f"verify(...).verification.{name}") == getattr(proved.verification, name)
    with pytest.raises(AttributeError, match="'Solution' object has no attribute 'levels'"):
        _ = getattr(proved, "levels")  # noqa: B009
    assert pickle.loads(pickle.dumps(proved)) == proved


def test_nothing_is_verified_at_level_0(hybrid: Solution) -> None:
    assert pl.verify(hybrid, 0) == hybrid
    stated = pl.verify(hybrid, 0, pl.Tolerance(position=0.001))
    assert stated.verification.tolerance.position == 0.001 and stated.verification.checks == ()


def test_keywords_of_a_class_are_renamed_too() -> None:
    @renamed_keywords(size="length")
    class Rod:
        def __init__(self, *, length: float) -> None:
            self.length = length

    made: Any = Rod
    assert warned(lambda: made(size=2.0), "size= of Rod is length= now").length == made(length=2.0).length == 2.0


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Given", "Parameter"),
        ("Free", "FreeParameter"),
        ("Bounded", "ScalarControl"),
        ("Direction", "UnitVectorControl"),
    ],
)
def test_records_are_found_by_their_old_names(old: str, new: str) -> None:
    assert warned(lambda: getattr(pl, old), f"perilune.{old} is perilune.{new} now") is getattr(pl, new)
    assert old not in pl.__all__


def test_fields_are_stated_and_read_by_their_old_names(landing: pl.Problem, hybrid: Solution) -> None:
    free: Any = pl.FreeParameter
    made = warned(lambda: free(name="T", unit="s", typical=60.0), "typical= of FreeParameter is guess= now")
    assert made == pl.FreeParameter(name="T", unit="s", guess=60.0)
    assert warned(lambda: made.typical, "FreeParameter.typical is FreeParameter.guess now") == 60.0
    pairs = (
        (landing, "ranges", "parameter_bounds"), (landing, "bookkeeping", "consistency_checks"),
        (landing, "rough_flight", "initial_guess"), (landing.phases[0], "typical_end", "end_guess"),
        (landing.phases[0], "marks", "end_outputs"), (hybrid, "listed", "unverified_extremals"),
        (hybrid.statistics, "claimed", "from_file"), (hybrid.statistics, "rung", "initialization"),
        (hybrid.statistics, "tried", "attempts"), (landing, "declared", "records"),
        (landing.views, "beside", "comparison"), (pl.verify(hybrid, 1).verification, "text", "source"),
        (ARC, "words", "description"), (pl.models.MARS, "air", "surface_pressure"),
        (pl.models.EARTH, "air", "surface_pressure"),
    )  # fmt: skip
    for owner, old, new in pairs:
        kind = type(owner).__name__
        read: Callable[[], Any] = lambda owner=owner, old=old: getattr(owner, old)  # noqa: E731
        assert warned(read, f"{kind}.{old} is {kind}.{new} now") == getattr(owner, new)
        change: Any = {old: getattr(owner, new)}
        copy: Callable[[], Any] = lambda owner=owner, change=change: replace(owner, **change)  # noqa: E731
        assert warned(copy, f"{old}= of {kind} is {new}= now") == owner


def test_what_is_only_read_is_found_by_its_old_name(landing: pl.Problem, hybrid: Solution) -> None:
    proof = pl.verify(hybrid, 1).verification
    finding = pl.preflight(landing)[0]
    for owner, old, new in (
        (proof, "told", "summary"), (proof, "within", "tolerance_used"), (finding, "told", "formatted"),
        (landing, "text", "source"), (pl.models.MARS, "spoken", "display_name"), (pl.models.MARS, "titled", "heading"),
    ):  # fmt: skip
        kind = type(owner).__name__
        read: Callable[[], Any] = lambda owner=owner, old=old: getattr(owner, old)  # noqa: E731
        assert warned(read, f"{kind}.{old} is {kind}.{new} now") == getattr(owner, new)
    tolerance: Any = pl.Tolerance(position=1e-3)
    assert warned(lambda: tolerance.told(), "Tolerance.told is Tolerance.describe now") == "position 1 mm"
    check: Any = proof.checks[0]
    assert warned(lambda: check.limit_told(2), "Check.limit_told is") == check.format_limit(2)
    assert warned(lambda: Old.views.Beside, "ComparisonFlight") is pl.views.ComparisonFlight


def test_old_names_stand_in_no_help(hybrid: Solution) -> None:
    """They are found, and neither completed nor explained."""
    for kind, old in ((pl.Problem, "rough_flight"), (pl.Phase, "typical_end"), (pl.Check, "limit_told")):
        assert old not in dir(kind) and old not in pydoc.plain(pydoc.render_doc(kind))
    assert "ranges" not in dir(hybrid.problem) and not hasattr(pl.Check, "limit_told")
    with pytest.raises(AttributeError, match="'Statistics' object has no attribute 'runk'") as caught:
        _ = getattr(hybrid.statistics, "runk")  # noqa: B009
    assert (caught.value.name, caught.value.obj) == ("runk", hybrid.statistics)


def test_an_attribute_that_fails_is_not_taken_for_an_old_name() -> None:
    class Rod:
        size: ClassVar[RenamedAttribute] = RenamedAttribute("length")

        @property
        def length(self) -> float:
            return self.ends[1]  # type: ignore[attr-defined]

    for name in ("length", "size"):
        with pytest.raises(AttributeError, match="has no attribute 'ends'"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            getattr(Rod(), name)


def test_what_a_failure_keeps_is_found_by_its_old_name() -> None:
    partial = pl.NotConvergedError("no flight", partial={"attempts": ["one"], "free": {}}).partial
    assert warned(lambda: partial["tried"], "partial['tried'] is partial['attempts'] now") == ["one"]
    assert warned(lambda: partial.get("tried"), "partial['attempts']") == ["one"]
    assert partial.get("missed") is None and json.dumps(partial) == '{"attempts": ["one"], "free": {}}'
    with pytest.raises(KeyError, match="missed"):
        _ = partial["missed"]


def test_both_names_are_refused_with_every_field_too() -> None:
    """All fields beside an old name are what `dataclasses.replace` states; a user who does has stated two values."""
    free: Any = pl.FreeParameter
    with pytest.raises(PeriluneError, match=r"by one name only(.|\n)*got: typical=..., guess=..."):
        free(name="T", unit="s", lower=0.0, upper=9.0, typical=1.0, guess=2.0)


def test_a_pair_of_old_keywords_of_replace_warns_of_the_line_that_uses_it() -> None:
    change: Any = {"integral_variables": (pl.Variable(name="way", unit="m"),), "integrals": lambda x, u, p, xp: (u.u,)}
    found = warned(lambda: replace(hop(), **change), "integral_variables= of Phase is integrals=Quantities(")
    assert found.integrals.variables == change["integral_variables"]


def hop(**end: Any) -> pl.Phase:
    phase: Any = pl.Phase
    return phase(
        name="hop",
        states=(pl.Variable(name="x", unit="m"),),
        controls=(pl.ScalarControl(name="u", unit="m/s", lower=-1.0, upper=1.0),),
        dynamics=speed,
        duration="T",
        **end,
    )


def speed(x: Any, u: Any, p: Any, xp: Any) -> Any:
    return (u.u,)


def place(x: Any, p: Any, xp: Any) -> Any:
    return x.x, 2 * x.x


def room(x: Any, u: Any, p: Any, xp: Any) -> Any:
    return (x.x,)


def test_a_phase_takes_functions_and_rows_of_names() -> None:
    """As it did before `Conditions`; all in one warning, which says what to write."""
    near, far = (pl.Variable(name=name, unit="m") for name in ("near", "far"))
    old = warned(
        lambda: hop(end=place, end_conditions=(near, far), outputs=room, output_variables=(near,)),
        'end_conditions= of Phase is end=Conditions(function, name="unit") now',
    )
    new = hop(end=pl.Conditions(place, near="m", far="m"), outputs=pl.Quantities(room, near="m"))
    assert old == new and old.end_conditions == (near, far) and old.output_variables == (near,)
    row: Any = {"end_conditions": (replace(near, upper=2.0), far)}
    with pytest.warns(DeprecationWarning, match=GOES):
        bounded = replace(new, **row)
    assert bounded.end == pl.Conditions(place, replace(near, upper=2.0), far)
    with pytest.raises(PeriluneError, match="not a row of end conditions"):
        hop(end=place, end_conditions=None)
    assert warned(lambda: hop(end=None, end_conditions=()), "end_conditions=") == hop()
    with pytest.warns(DeprecationWarning, match="marks= of Phase"), pytest.warns(match="mark_variables= of Phase"):
        marked = hop(marks=place, mark_variables=(near, far))
    assert marked.end_outputs == pl.Quantities(place, near="m", far="m")


def test_a_problem_takes_its_results_and_a_row_of_names(landing: pl.Problem) -> None:
    assert landing.results is not None
    row: Any = {"result_variables": landing.results.variables}
    with pytest.warns(DeprecationWarning, match=r"result_variables= of Problem is results=Quantities"):
        assert replace(landing, **row) == landing
    changed: Any = landing.changed
    new = warned(lambda: changed(results=place, result_variables=(pl.Variable(name="way", unit="m"),)), "of changed")
    assert new.results == pl.Quantities(place, way="m")


@pytest.mark.parametrize(
    ("ask", "parts"),
    [
        (lambda: pl.Conditions(place, near="km", far="m"), ("numbers are in SI: near", "the unit 'km'", "try: ")),
        (lambda: pl.Conditions(place, **{"two words": "m"}), ("Python identifier", "got: 'two words'")),
        (lambda: pl.Conditions(place, cast("Any", "near")), ("not a value of", "got: 'near'", 'function, near="m")')),
        (lambda: pl.Conditions(), ("the function of Conditions", "got: None", "a function")),
        (lambda: pl.Conditions(place), ("names no value", "got: a function only", 'Conditions(function, alt')),
        (lambda: pl.Conditions(cast("Any", None), near="m"), ("the function of Conditions", "got: None", "a function")),
        (lambda: pl.Conditions(cast("Any", 3), near="m"), ("the function of Conditions", "got: 3", "a function")),
        (lambda: hop(end=place), ("`end` of a phase", "got: function", "Conditions(func", "with_function(f)")),
        (lambda: hop(integrals=place), ("this is not a valid value of `integrals` of a phase", "Quantities(")),
        (lambda: hop(end=pl.Quantities(place, near="m")), ("`end` of a phase", "got: Quantities", "Conditions(")),
        (lambda: started(end=pl.Conditions(place, near="m")), ("end of hop returns the wrong", "got: 2", "1: near")),
        (lambda: started(end=pl.Conditions(place, near="m", far="s")), ("end of hop, far", "x.x in m", "s")),
        (lambda: started(end=pl.Conditions(lambda x, p, xp: x.x, near="m")), ("got: one float", "return (value,)")),
        (lambda: started(end=pl.Conditions(lambda x: x.x, near="m")), ("takes 1 pos", "a function of (x, p, xp) that")),
        (lambda: pl.Quantities(place, pl.Variable(name="near"), near="m"), ("two quantities are called near",)),
        (lambda: pl.Conditions(place, pl.Variable(name="near"), near="m"), ("two conditions are called near",)),
    ],
)  # fmt: skip
def test_what_is_wrong_with_conditions_is_said(ask: Callable[[], Any], parts: tuple[str, ...]) -> None:
    with pytest.raises(PeriluneError) as caught:
        ask()
    assert all(part in str(caught.value) for part in parts), str(caught.value)


def started(**end: Any) -> pl.Problem:
    return pl.Problem(
        name="hop", phases=(hop(**end),), start=lambda p, xp: (p.x0,), objective=lambda x, p, xp: x.x,
        objective_unit="m", given={"x0": pl.Parameter(value=1.0, unit="m"), "T": pl.Parameter(value=1.0, unit="s")},
    )  # fmt: skip


def test_what_is_replaced_by_its_old_name_is_replaced(landing: pl.Problem) -> None:
    """`dataclasses.replace` states all fields, the new name of this one too."""
    change: Any = {"ranges": None}
    assert landing.parameter_bounds is not None
    with pytest.warns(DeprecationWarning, match=GOES):
        assert replace(landing, **change).parameter_bounds is None
    changed: Any = landing.changed
    assert warned(lambda: changed(ranges=None), "ranges= of changed").parameter_bounds is None


def test_curves_are_evaluated_by_their_old_names(hybrid: Solution) -> None:
    t, old = hybrid.trajectories[0].state.time[:3], cast("Any", hybrid)
    for found, now in zip(
        warned(lambda: old.flown(0, t), "Solution.flown is Solution.evaluate now"), hybrid.evaluate(0, t), strict=True
    ):
        assert (found == now).all()
    curve: Any = hybrid.trajectories[0].state
    assert (
        warned(lambda: curve.extended(1e4), "Curve.extended is Curve.extrapolate now") == curve.extrapolate(1e4)
    ).all()
