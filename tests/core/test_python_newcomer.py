"""What a newcomer to the Python side mistypes: refused in words, never by an error of Python or CasADi."""

from __future__ import annotations

import inspect
import json
import math
import pickle
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import perilune as pl
from cho import cho_landing
from command_line import ENVIRONMENT
from perilune.core.errors import PeriluneError
from perilune.models import MARS, MOON, Body, Orbit, Retro, Vehicle, hybrid_landing, powered_descent, precision_landing
from perilune.problem import Solution
from perilune.scenario import load_file

LANDING = cho_landing()
FREE, (DESCENT,) = LANDING.free[0], LANDING.phases
VEHICLE = Vehicle(mass=300.0, thrust=440.0, specific_impulse=310.0)
ORBIT = Orbit(parking_altitude=100e3, perilune_altitude=15e3)
# As who types it without a type checker.
Loose: Any = pl
LOOSE: Any = LANDING
TURN: Any = pl.UnitVectorControl(names=("x", "y"))
Lander: Any = Vehicle
hybrid_of: Any = hybrid_landing
precision_of: Any = precision_landing
descent_of: Any = powered_descent
load_any: Any = load_file


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda: Loose.solve(None), ("not a problem to solve", "None", "load_file")),
        (lambda: Loose.solve("lander.toml"), ("not a problem to solve", "'lander.toml'", "load_file")),
        (lambda: LOOSE.changed(5), ("changed takes none of its arguments by position", "changed(NAME=VALUE)")),
        (lambda: LOOSE.changed(phase=()), ("no part of a problem", "'phase'", "did you mean 'phases'")),
        (lambda: LOOSE.changed(given=3), ("not a valid given of a problem", "3", "Mapping")),
        (lambda: LOOSE.changed(phases=3), ("not a valid phases of a problem", "3", "tuple")),
        (lambda: Loose.solve(LANDING, "direct"), ("not a method", "'direct'", "Pseudospectral()")),
        (lambda: Loose.solve(LANDING, pl.Indirect), ("not a method", "the class Indirect instead of Indirect()")),
        (lambda: Loose.solve(LANDING, verify=9), ("no such verification level", "9", "0, 1, 2, 3, 4 or 5")),
        (lambda: Loose.solve(LANDING, verify="3"), ("no such verification level", "'3'")),
        (lambda: Loose.verify(LANDING, 3), ("not a solution to verify", "Problem", "Solution")),
        (lambda: Loose.verify(None), ("not a solution to verify", "None")),
        (lambda: Loose.save(LANDING, "nowhere"), ("not a solution to save", "Problem")),
        (lambda: Loose.preflight(None), ("not a problem to compare",)),
        (lambda: Loose.solve(LANDING, callback=3), ("not a callback", "3", "a function, or None")),
        (lambda: Loose.sweep(LANDING, {"vehicle.mass": [300.0]}, callback=3), ("not a callback",)),
        (lambda: Loose.verify(3), ("not a solution to verify", "3", "Solution")),
        (lambda: Loose.load(None), ("not the directory of a saved solution", "None", "a path")),
        (lambda: Loose.load(b"out"), ("not the directory of a saved solution", "bytes", "a path")),
        (lambda: Loose.load("a\0b"), ("cannot be the directory of a saved solution", "'a\\x00b'", "null byte")),
        (lambda: Loose.load("a" * 5000), ("cannot be the directory of a saved solution", "File name too long")),
        (lambda: load_any(None), ("not a scenario file", "None")),
        (lambda: Loose.preflight(LANDING, 3), ("not a valid set of parameter values", "{name: values}")),
        (lambda: Loose.sweep(LANDING, 3), ("not a valid set of values to sweep", "3", "{name: values}")),
        (lambda: Loose.sweep(LANDING, [3]), ("not a point of a family", "3", "{name: value, ...}")),
        (lambda: Loose.sweep(LANDING, {3: [1.0]}), ("not the name of a parameter", "3")),
        (lambda: Loose.sweep(LANDING, {"vehicle.mass": [300.0]}, executor=3), ("not an executor", "Executor")),
        (lambda: Loose.sweep(LANDING, {"vehicle.mass": [300.0]}, store=3), ("not the directory of a store", "3")),
        (lambda: LANDING.given["vehicle_trust"], ("no given parameter", "did you mean 'vehicle_thrust'")),
        (lambda: Loose.preflight(LANDING, {"thrust": [1.0]}), ("no parameter of this name", "vehicle_thrust")),
        (lambda: Loose.sweep(None, {}), ("not a problem to sweep",)),
        (lambda: Loose.sweep(LANDING, None), ("not a valid set of values to sweep", "None", "{name: values}")),
        (lambda: Loose.sweep(LANDING, "vehicle.thrust"), ("not a valid set of values to sweep", "'vehicle.thrust'")),
        (
            lambda: Loose.sweep(LANDING, {"vehicle.thrust": 440.0}),
            ("not a valid set of values of vehicle.thrust", "440", "a list"),
        ),
        (lambda: Loose.sweep(LANDING, {"vehicle.thrst": [1.0]}), ("no parameter", "did you mean 'vehicle_thrust'")),
        (lambda: Loose.sweep(LANDING, {"vehicle.thrust": [440.0]}, "direct"), ("not a method",)),
        (
            lambda: hybrid_of(VEHICLE, None, ORBIT).with_given(vehicle_thrust="440 N"),
            ("not a value of vehicle_thrust", "'440 N'", "parse_quantity"),
        ),
        (lambda: LOOSE.with_given(vehicle_thrust="440"), ("not a value of vehicle_thrust", "'440'", "in SI")),
        (lambda: LOOSE.with_given(vehicle_thrust=True), ("not a value of vehicle_thrust", "True", "in SI")),
        (lambda: LOOSE.with_given(vehicle_thrust=np.True_), ("not a value of vehicle_thrust",)),
        (lambda: Loose.Parameter(value="3 km", unit="m"), ("not a given value", "'3 km'")),
        (
            lambda: Lander(mass="300 kg", thrust=440.0, specific_impulse=310.0),
            ("vehicle.mass must be a number in SI", "'300 kg'", "scenario"),
        ),
        (lambda: Lander(mass=None, thrust=440.0, specific_impulse=310.0), ("vehicle.mass must be a number", "None")),
        (lambda: Lander(mas=300.0, thrust=440.0, specific_impulse=310.0), ("no field of Vehicle", "'mass'")),
        (lambda: Lander(mass=300.0, thrust=440.0, isp=310.0), ("no field", "did you mean 'specific_impulse'")),
        (lambda: Lander(mass=300.0, thrust=440.0), ("Vehicle.specific_impulse is missing", "310 s")),
        (
            lambda: Lander(mass=1e308, thrust=440.0, specific_impulse=310.0),
            ("vehicle.mass has an implausible magnitude",),
        ),
        (lambda: hybrid_of(None, None, None), ("not a Vehicle", "None")),
        (lambda: hybrid_of(VEHICLE, None, ORBIT, "moon"), ("not a Body", "'moon'")),
        (lambda: hybrid_of(VEHICLE, 1200.0, ORBIT), ("not a Retro", "1200")),
        (lambda: precision_of(VEHICLE, ORBIT, None, None, (0.3, 0.9)), ("not an Approach", "Orbit")),
        (lambda: Loose.solve(LANDING, verfy=1), ("no keyword of solve", "'verfy'", "did you mean 'verify'")),
        (lambda: Loose.Indirect(strats=4), ("no keyword of Indirect", "did you mean 'starts'")),
        (lambda: Loose.atlas.build(LANDING, {}, "map", brick=3), ("no keyword of build", "did you mean 'bricks'")),
        (lambda: Loose.solve(), ("solve needs problem",)),
        (
            lambda: Loose.solve(LANDING, None, 3),
            ("solve takes at most 2", "Problem, None, 3", "solve(problem, method, guess=..."),
        ),
        (lambda: Loose.Indirect(24), ("Indirect takes none of its arguments by position", "24", "starts=...")),
        (lambda: Loose.Parameter(3.0), ("Parameter takes none", "Parameter(value=..., unit=...")),
        (lambda: Lander(300.0), ("Vehicle takes none", "300.0", "mass=...")),
        (lambda: Loose.scenario.load_file(pth="x.toml"), ("no keyword of load_file", "did you mean 'path'")),
        (lambda: Loose.Solution.animate(None, "a.gif", 3), ("animate takes at most 1", "animate(file, seconds=...")),
        (lambda: Loose.Solution.plot(None, nme="path"), ("no keyword of plot", "did you mean 'name'")),
        (lambda: Loose.atlas.Atlas.query(None, 440.0, 300.0), ("query takes none", "440.0", "query(NAME=VALUE)")),
        (lambda: Loose.atlas.Atlas.query_many(None), ("query_many needs points",)),
        (lambda: pl.Indirect(starts=0), ("starts is too small", "0", ">= 1")),
        (lambda: pl.Indirect(scan_points=1), ("scan_points is too small",)),
        (lambda: Loose.Indirect(starts="many"), ("starts must be a whole number", "'many'")),
        (lambda: Loose.Pseudospectral(nodes="few"), ("nodes must be a whole number",)),
        (lambda: Loose.Pseudospectral(tolerance="fine"), ("tolerance must be a number", "'fine'")),
        (lambda: Loose.Genetic(population=2.5), ("population must be a whole number", "2.5")),
        (lambda: Loose.Genetic(crossover=None), ("crossover must be a number", "None")),
        (lambda: Loose.Variable(name=3), ("not a name", "3", "a text")),
        (lambda: Loose.Variable(name="two words"), ("Python identifier", "'two words'")),
        (lambda: Loose.UnitVectorControl(names="up"), ("not names of components", "'up'", "toward_x")),
        (lambda: Loose.Scales(length=[1.0]), ("not a valid scale of a length", "[1.0]")),
        (lambda: Loose.Scales().of([]), ("not a unit", "[]", "a text")),
        (
            lambda: TURN.normalised([1.0, 2.0]),
            ("normalised of a UnitVectorControl cannot be", "[1.0, 2.0]", "arrays of NumPy"),
        ),
        (lambda: TURN.samples(3.0, 1.0, None), ("samples of a UnitVectorControl cannot be", "3.0, 1.0, None")),
        (lambda: TURN.tangents(np.zeros((2, 3))), ("tangents needs scale",)),
        (lambda: TURN.example(iter(()), None, "x", 3), ("example takes at most 3",)),
        (
            lambda: Loose.ScalarControl(name="a", lower="b").limits(3),
            ("limits of a ScalarControl cannot be", "3", "parameters"),
        ),
        (lambda: Loose.Table("x", [1.0]), ("not a column x of a table", "'x'", "a list of numbers")),
        (
            lambda: Loose.Problem(name="p", phases=LANDING.phases[0], start=None, objective=None),
            ("not a row of phases", "Phase"),
        ),
        (
            lambda: Loose.Problem(name="p", phases=("descent",), start=None, objective=None),
            ("not a phase", "'descent'"),
        ),
        (
            lambda: replace(LOOSE, given={**LANDING.given, "vehicle_mass": 300.0}),
            ("not a given value of vehicle_mass", "300.0", "Parameter", 'write pl.Parameter(value=300.0, unit="m/s")'),
        ),
        (lambda: replace(LOOSE, given=None), ("not a valid given of a problem", "None", "Mapping", "pl.Parameter(")),
        (lambda: replace(LOOSE, given={3: LANDING.given["vehicle_mass"]}), ("name of a given parameter", "3")),
        (lambda: replace(LOOSE, free=None), ("not a row of free parameters", "None", "(FreeParameter(...), ...)")),
        (
            lambda: replace(LOOSE, free=("T",)),
            ("not a free parameter", "'T'", "FreeParameter(...)", "try: FreeParameter(name='T', ...)"),
        ),
        (lambda: replace(LOOSE, free=FREE), ("not a row of free parameters", "FreeParameter", "ends with a comma")),
        (lambda: replace(LOOSE, links=3), ("not a row of links", "3", "(a function, ...)")),
        (lambda: replace(LOOSE, phases=2 * LANDING.phases, links=("x",)), ("not a link", "'x'", "a function")),
        (lambda: replace(LOOSE, scales=None), ("not a valid scales of a problem", "None", "Scales", "omit it")),
        (lambda: replace(LOOSE, scales=3), ("not a valid scales of a problem", "3", "Scales")),
        (lambda: replace(LOOSE, views=3), ("not a valid views of a problem", "3", "Views")),
        (
            lambda: replace(LOOSE, parameter_bounds=3),
            ("not a valid parameter_bounds of a problem", "3", "a function, or None"),
        ),
        (lambda: replace(LOOSE, records=("x",)), ("not a record of a problem", "'x'", "@record")),
        (lambda: pl.Quantities(len, cast("Any", "x")), ("not a value of Quantities", "'x'", 'function, x="m")')),
        (lambda: replace(DESCENT, states=cast("Any", None)), ("not a row of states", "None", "(Variable(...), ...)")),
        (lambda: replace(DESCENT, states=cast("Any", ("x",))), ("not a state", "'x'", "Variable(...)")),
        (
            lambda: replace(DESCENT, controls=cast("Any", None)),
            ("a row of controls", "UnitVectorControl(...) or ScalarControl(...)"),
        ),
        (
            lambda: replace(DESCENT, controls=cast("Any", ("thrust",))),
            ("not a control", "try: ScalarControl(name='thrust',"),
        ),
        (
            lambda: replace(DESCENT, end=cast("Any", len)),
            ("not a valid value of `end` of a phase", 'Conditions(function, altitude="m", ...)'),
        ),
        (lambda: pl.Conditions(len), ("Conditions names no value", 'altitude="m"')),
        *(
            (lambda make=make, unit=unit: make(unit), ("not the unit of", repr(unit), "a text", '"m/s"'))
            for unit in (3, [], None)
            for make in (
                lambda unit: Loose.Variable(name="a", unit=unit),
                lambda unit: Loose.Parameter(value=1.0, unit=unit),
                lambda unit: Loose.FreeParameter(name="a", unit=unit),
                lambda unit: Loose.ScalarControl(name="a", unit=unit),
            )
        ),
        (lambda: Loose.FreeParameter(name=3), ("not the name of a free parameter", "3")),
        (lambda: pl.ScalarControl(name="thrust", unit="kN"), ("numbers are in SI: thrust", "'kN'")),
        (
            lambda: pl.ScalarControl(name="a", lower=math.nan),
            ("not the lower bound of a", "nan", "a finite number in SI"),
        ),
        (lambda: pl.Variable(name="a", upper=math.nan), ("not the upper bound of a", "nan")),
        (lambda: pl.FreeParameter(name="a", lower=math.nan), ("not the lower bound of a", "nan")),
        (lambda: pl.FreeParameter(name="a", guess=math.nan), ("not the guess of a", "nan")),
        (lambda: pl.Parameter(value=math.nan), ("not a given value", "nan")),
        (lambda: LANDING.with_given(vehicle_thrust=math.nan), ("not a value of vehicle_thrust", "nan")),
        *(
            (lambda called=called: getattr(Loose, called)(3), (f"{called} takes none of its arguments by position",))
            for called in (
                "Check",
                "Curve",
                "Extremal",
                "Family",
                "FamilyPoint",
                "Finding",
                "NamedArc",
                "Result",
                "Solution",
                "Statistics",
                "Trajectory",
                "Verification",
            )
        ),
        (lambda: Loose.Curve(), ("Curve needs time, values, rates",)),
        (lambda: Loose.NamedArc(), ("NamedArc needs phase, begin, end, description",)),
        (lambda: Loose.views.Space(body=3), ("not a valid body of Space", "3", "a text")),
        (lambda: Loose.views.Space(epoch=3), ("not a valid epoch of Space", "3", "a text")),
        (lambda: Loose.views.Space(chosen=3), ("not a valid chosen of Space", "3", "a text")),
        (lambda: Loose.views.Space(epoch="nope"), ("the epoch is not a supported time", "'nope'", "ISO 8601")),
        (lambda: Loose.Views(space=3), ("not a valid space of Views", "3", "Space", "or None")),
        (lambda: Loose.Views(histories=3), ("not a row of figures", "3", "History(...)")),
        (lambda: Loose.Views(height=3), ("not a valid height of Views", "3", "a text")),
        (lambda: replace(LANDING, name=" "), ("a name of one line", "' '", 'as "landing"')),
        (lambda: replace(LANDING, name="a\nb"), ("a name of one line", "'a\\nb'")),
        (lambda: LOOSE.size_of("r"), ("not a state, condition", "'r'", "problem.phases[0].states[0]")),
        (lambda: LOOSE.bounds(3), ("not a state or a control", "3", "problem.phases[0].states[0]")),
        (lambda: LOOSE.unit_of([]), ("not the name of a parameter", "[]", "a text")),
        (lambda: LANDING.unit_of("thrust"), ("no parameter of this name", "did you mean 'vehicle_thrust'")),
        (lambda: LOOSE.parameters([("mass", 3.0)]), ("not a mapping of values of free", "list", "Mapping")),
        (lambda: LANDING.parameters({"vehicle_mass": 3.0}), ("no free parameter", "'vehicle_mass'", "flight_time")),
        (lambda: LOOSE.parameters({1: 2}), ("no free parameter", "'1'")),
        (
            lambda: Loose.Pseudospectral(scheme=["radau"]),
            ("not a collocation scheme", "['radau']", "'gauss' or 'radau'"),
        ),
        (lambda: Loose.scenario.template([]), ("not a kind of problem", "[]", "a text")),
        (lambda: Loose.scenario.bounds_of("a", 3, {}), ("not a range", "3", "a text")),
        (lambda: Loose.preflight(LANDING, {1: 2}), ("no parameter of this name", "'1'")),
        (lambda: descent_of(VEHICLE, None, None), ("not an Ignition", "None")),
        (lambda: Loose.atlas.sliced("map"), ("not an atlas", "'map'", "atlas.open(DIRECTORY)")),
        (lambda: Loose.solve(LANDING, verify=np.zeros(2)), ("no such verification level",)),
    ],
)
def test_a_slip_is_refused_in_words(ask: Callable[[], Any], words: tuple[str, ...]) -> None:
    with pytest.raises(PeriluneError) as caught:
        ask()
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_records_keep_their_signature() -> None:
    assert list(inspect.signature(Vehicle).parameters) == [
        "mass", "thrust", "specific_impulse", "standard_gravity", "dry_mass",
    ]  # fmt: skip
    assert [*inspect.signature(pl.solve).parameters][:2] == ["problem", "method"]
    assert (
        pickle.loads(pickle.dumps(pl.solve)) is pl.solve
        and pickle.loads(pickle.dumps(pl.Indirect(starts=3))).starts == 3
    )


def test_a_misspelt_verb_is_offered_the_right_one() -> None:
    program = "import perilune\nperilune.solv"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=ENVIRONMENT)
    assert "Did you mean: 'solve'?" in done.stderr
    assert {"solve", "Curve", "Trajectory", "Pseudospectral"} <= set(dir(pl))


def test_bodies_are_called_by_their_names() -> None:
    def title(body: Body) -> str:
        return hybrid_landing(VEHICLE, None, ORBIT, body).title

    assert title(MOON).endswith("to the Moon")
    own = Body(name="body", gravitational_parameter=4.9e12, radius=1.7e6, rotation_rate=0.0)
    assert title(own).endswith("to the body")
    assert title(MARS).endswith("to Mars, without its atmosphere")


def test_air_is_told_beside_every_answer_and_before() -> None:
    at_mars = hybrid_landing(Vehicle(mass=300.0, thrust=1500.0, specific_impulse=310.0), None, ORBIT, MARS)
    (air,) = [f for f in pl.preflight(at_mars) if "atmospheric" in f.name]
    assert air.verdict == "warning" and "Mars has an atmosphere" in air.meaning
    assert not [f for f in pl.preflight(LANDING) if "atmospheric" in f.name]


def test_a_retro_burn_that_is_no_record_is_not_taken_for_none() -> None:
    with pytest.raises(PeriluneError, match="not a Retro"):
        hybrid_of(VEHICLE, 0, ORBIT)
    assert "retro_delta_v" in hybrid_landing(VEHICLE, Retro(specific_impulse=310.0), ORBIT).free_names


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda s, _: s.results["typo"], ("no result of this name", "'typo'", "landed_mass", "flight_time")),
        (lambda s, _: s.results["landed_mas"], ("did you mean 'landed_mass'",)),
        (lambda s, _: s.free["retro"], ("no free parameter of this name", "retro_delta_v")),
        (lambda s, _: s.multipliers["altitude"], ("no multiplier of this name", "descent.touchdown_altitude")),
        (lambda s, _: Loose.save(s, None), ("not an output directory", "None", "a path")),
        (lambda s, path: pl.save(s, f"{path}/a\0b"), ("cannot be an output directory", "null byte")),
        (lambda s, path: Loose.save(s, path / "s", 3), ("not the text of a scenario", "3")),
        (lambda s, _: Loose.verify(s, 4, other=3), ("not a method", "3")),
        (lambda s, _: Loose.verify(s, 3, resolve=3), ("not the method that solves again", "3")),
        (lambda s, _: s.trajectories[0].state("end"), ("not a time at which to evaluate a curve", "'end'")),
        (lambda s, _: s.trajectories[0].state(None), ("not a time at which to evaluate a curve", "None")),
        (lambda s, _: s.trajectories[0].state("3"), ("not a time at which to evaluate a curve", "'3'")),
        (lambda s, _: s.trajectories[0].state([1.0, None]), ("not a time at which to evaluate a curve", "[1.0, None]")),
        (lambda s, _: s.trajectories[0].state(True), ("not a time at which to evaluate a curve", "True")),
        (lambda s, _: s.trajectories[0].state.extrapolate("end"), ("not a time at which to evaluate a curve", "'end'")),
        (lambda s, _: s.inertial(1, 0.0), ("not a phase of hybrid_landing", "1", "its number, 0 to 0")),
        (lambda s, _: s.outputs("descent", 0.0), ("not a phase of hybrid_landing", "'descent'")),
    ],
)
def test_a_slip_with_a_solution_is_refused_in_words(
    hybrid: Solution, tmp_path: Path, ask: Callable[[Any, Path], Any], words: tuple[str, ...]
) -> None:
    with pytest.raises(PeriluneError) as caught:
        ask(hybrid, tmp_path)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_names_that_refuse_others_are_dictionaries_still(hybrid: Solution) -> None:
    results = hybrid.results
    assert results.get("typo") is None and "typo" not in results and "typo" not in hybrid.free
    assert hybrid.free.get("typo", 3.0) == 3.0
    for copied in (pickle.loads(pickle.dumps(hybrid)), pickle.loads(pickle.dumps(results))):
        names = copied if copied == results else copied.free
        with pytest.raises(PeriluneError, match="of this name"):
            names["typo"]
    assert json.loads(json.dumps({name: r.value for name, r in results.items()})).keys() == results.keys()


def test_a_file_that_is_no_directory_is_named(hybrid: Solution, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(PeriluneError, match="is a file"):
        pl.save(hybrid, tmp_path / "out")
