"""Slices of atlases and their figures: what is shown is what a query says, and why there is no answer."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from cho import cho_landing
from command_line import read_json
from perilune.atlas.building import build as building
from perilune.atlas.query.batch_answers import Answered
from perilune.atlas.query.query import Atlas, open_atlas
from perilune.atlas.query.slices import sliced
from perilune.cli import run_command_line
from perilune.core import InfeasibleError, PeriluneError
from perilune.report import atlas_maps as drawing
from perilune.report.atlas_maps import atlas_maps
from perilune.solve import solve

build = partial(building.build, sample=0)  # proofs have tests of their own
AXES = {"vehicle.thrust": (430.0, 450.0), "retro.specific_impulse": (270.0, 310.0)}


@pytest.fixture(scope="module")
def jump(tmp_path_factory: pytest.TempPathFactory) -> Atlas:
    """Over two axes, where the answer changes from one sheet to another."""
    return open_atlas(build(cho_landing(), AXES, tmp_path_factory.mktemp("maps") / "jump"))


@pytest.fixture(scope="module")
def weak(tmp_path_factory: pytest.TempPathFactory) -> Atlas:
    """Over one axis, where physics refuses a part."""
    problem = cho_landing(dry_mass=100.0).with_given(retro_delta_v=0.0)
    return open_atlas(build(problem, {"vehicle.thrust": (120.0, 450.0)}, tmp_path_factory.mktemp("maps") / "weak"))


def test_a_slice_shows_what_queries_say(jump: Atlas) -> None:
    shown = sliced(jump, points=9)
    assert shown.shape == (9, 9) and shown.answers.good.all() and (shown.reason_index == -1).all()
    assert sum(shown.counts.values()) == 81 and len(shown.counts) == 2
    objective = shown.answers.objective.reshape(shown.shape)
    for i, k in ((0, 0), (3, 7), (8, 2)):
        found = jump.query(vehicle_thrust=shown.values[0][i], retro_specific_impulse=shown.values[1][k])
        assert objective[i, k] == pytest.approx(found.objective, rel=1e-12)
        number = i * 9 + k
        assert shown.answers.guess_error[number] == pytest.approx(found.query.guess_error, rel=1e-3, abs=1e-13)
        assert shown.size[number] == pytest.approx(found.query.cell)
        assert shown.sheets[shown.answers.sheet[number]] == found.query.sheet
    low, high = jump.region.low, jump.region.high
    assert ((shown.nodes >= low) & (shown.nodes <= high)).all() and len(shown.nodes) > 9


def test_a_slice_along_one_axis_lies_where_it_is_told_to(jump: Atlas) -> None:
    shown = sliced(jump, ["vehicle.thrust"], {"retro.specific_impulse": 305.0}, points=5)
    assert shown.shape == (5,) and dict(shown.at) == {"retro_specific_impulse": 305.0}
    alone = jump.query(vehicle_thrust=435.0, retro_specific_impulse=305.0)
    assert shown.answers.objective[1] == pytest.approx(alone.objective, rel=1e-12)
    assert sliced(jump, at={"vehicle_thrust": 440.0}, points=2).axes[0].name == "retro_specific_impulse"
    assert dict(sliced(jump, ["vehicle_thrust"], points=2).at) == {"retro_specific_impulse": 290.0}


def test_what_physics_refuses_is_said(weak: Atlas) -> None:
    """140 N hold up no mass that can be left at the end: there the map has no answer, and says why."""
    with pytest.raises(InfeasibleError) as alone:
        solve(cho_landing(dry_mass=100.0).with_given(retro_delta_v=0.0, vehicle_thrust=140.0))
    with pytest.raises(InfeasibleError) as mapped:
        weak.query(vehicle_thrust=140.0)
    assert mapped.value.what == alone.value.what
    found = weak.query_many(np.array([[120.0], [130.0], [140.0], [440.0]]))
    assert found.answered.tolist() == 3 * [Answered.IMPOSSIBLE] + [Answered.YES]


def test_where_physics_refuses_its_reason_is_shown(weak: Atlas) -> None:
    shown = sliced(weak, points=98)
    assert not shown.answers.good.all()
    for number in np.nonzero(~shown.answers.good)[0][::9].tolist():
        reason = shown.reasons[shown.reason_index[number]]
        thrust = float(shown.values[0][number])
        try:
            refused = ""
            weak.query(vehicle_thrust=thrust)
        except InfeasibleError as error:
            refused = error.what
        except PeriluneError:
            pass
        assert (reason == refused) == bool(refused)
    assert any("too weak" in reason for reason in shown.reasons)
    counted = {text: np.count_nonzero(shown.reason_index == k) for k, text in enumerate(shown.reasons)}
    assert len(counted) > 2 and {text: shown.counts.get(text, 0) for text in counted} == counted


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"axes": ["vehicle.mass"]}, "no axis"),
        ({"at": {"vehicle.mass": 300.0}}, "no axis"),
        ({"axes": ["vehicle.thrust"], "at": {"vehicle.thrust": 440.0}}, "given twice"),
        ({"axes": ["vehicle.thrust", "vehicle_thrust"]}, "given twice"),
        ({"at": {"vehicle.thrust": 440.0, "vehicle_thrust": 441.0}}, "given twice"),
        ({"at": {"vehicle.thrust": 440.0, "retro.specific_impulse": 300.0}}, "one axis or two"),
        ({"at": {"vehicle.thrust": 451.0}}, "outside"),
        ({"at": {"vehicle.thrust": float("nan")}}, "outside"),
        ({"at": {"vehicle.thrust": "much"}}, "numbers"),
        ({"points": 1}, "too few"),
        ({"points": 10.0}, "too few"),
    ],
)
def test_slices_that_are_none_are_refused(jump: Atlas, settings: dict, words: str) -> None:
    with pytest.raises(PeriluneError, match=words):
        sliced(jump, **settings)


def colours(panel: Any) -> np.ndarray:
    """What the colours of a map stand for."""
    return np.asarray(panel.collections[0].get_array()).reshape(9, 9)


def test_figures_have_colours_where_there_is_an_answer_and_name_what_they_show(jump: Atlas) -> None:
    shown = sliced(jump, points=9)
    drawn = atlas_maps(shown)
    assert set(drawn) == {"objective", "free_retro_delta_v", "free_flight_time", "sheets", "nodes", "errors"}
    panel, bar = drawn["free_retro_delta_v"].axes
    assert bar.get_ylabel() == "retro delta v (m/s)" and panel.get_ylabel() == "retro specific impulse (s)"
    best = drawn["objective"].axes[1]
    assert best.get_ylabel() == "landed mass (kg)" and best.get_ylim()[0] > 0.0  # J is minus that
    rows = colours(panel)
    np.testing.assert_allclose(rows.T.ravel(), shown.answers.free["retro_delta_v"])
    below = solve(cho_landing().with_given(vehicle_thrust=440.0, retro_specific_impulse=270.0), verify=0)
    assert rows[0, 4] == pytest.approx(below.free["retro_delta_v"], abs=1e-9)
    kinds = colours(drawn["sheets"].axes[0])
    assert kinds[0, 4] != kinds[8, 4]  # through the jump


def test_sheets_that_are_called_alike_are_counted_together(jump: Atlas) -> None:
    shown = sliced(jump, points=9)
    alike = replace(shown, sheets=("one",) * len(shown.sheets))
    assert alike.counts == {"one": 81} and len(shown.counts) == 2


def test_no_lines_are_drawn_through_what_is_but_rounding(jump: Atlas) -> None:
    """Where no retro burn pays it is zero, to the last bits."""
    shown = sliced(jump, points=9)
    burn, noise = shown.answers.free["retro_delta_v"], np.random.default_rng(1).normal(size=81)
    drawn = [
        atlas_maps(replace(shown, answers=replace(shown.answers, free={"retro_delta_v": values})))
        for values in (burn, burn + 1e-13 * noise)
    ]
    lines = [len(figures["free_retro_delta_v"].axes[0].collections) for figures in drawn]
    assert lines[0] == lines[1] > 1


def test_what_has_no_answer_is_left_out_and_said(weak: Atlas) -> None:
    drawn = atlas_maps(sliced(weak, points=50))
    assert np.isnan(drawn["objective"].axes[0].lines[0].get_ydata()).any()
    texts = [text.get_text().replace("\n", " ") for text in drawn["sheets"].legends[0].get_texts()]
    assert any("too weak" in text for text in texts)
    shown = sliced(weak, points=50)
    none = replace(shown.answers, answered=np.ones_like(shown.answers.answered))
    with pytest.raises(PeriluneError, match="nothing to draw"):
        atlas_maps(replace(shown, answers=none))


def test_the_command_line_plots(jump: Atlas, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place, out = str(jump.store.directory), str(tmp_path / "maps")
    assert (
        run_command_line(["atlas", "plot", place, "--points", "9", "--axes", "vehicle.thrust", "--out", out, "--json"])
        == 0
    )
    told = read_json(capsys.readouterr().out)
    assert told["answered"] == told["points"] == 9 and "sheets" in told["figures"]
    for name in told["figures"]:
        assert imread(Path(out) / f"{name}.png").std() > 0.01 and (Path(out) / f"{name}.svg").stat().st_size > 5000
    assert run_command_line(["atlas", "plot", place, "--points", "9", "--out", out]) == 2
    assert "not empty" in capsys.readouterr().err
    assert run_command_line(["atlas", "plot", place, "--points", "5", "--axes", "vehicle.thrust"]) == 0
    assert "slice over vehicle.thrust, retro.specific_impulse 290 s" in capsys.readouterr().out
    assert run_command_line(["atlas", "plot", place, "--at", "vehicle.thrust=1 km"]) == 2
    assert run_command_line(["atlas", "plot", place, "--points", "1"]) == 2
    assert run_command_line(["atlas", "plot", str(tmp_path / "nowhere")]) == 2


def test_a_figure_that_cannot_be_drawn_takes_no_other_with_it(
    jump: Atlas, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: Any) -> Any:
        raise ValueError("no such colour")

    monkeypatch.setitem(drawing._OF_CELLS, "nodes", broken)
    arguments = ["atlas", "plot", str(jump.store.directory), "--points", "5", "--axes", "vehicle.thrust"]
    assert run_command_line([*arguments, "--out", str(tmp_path / "maps"), "--json"]) == 0
    said = capsys.readouterr()
    assert "nodes is not drawn" in said.err and "no such colour" in said.err
    document = read_json(said.out)
    assert document["figures"] == ["errors", "free_flight_time", "free_retro_delta_v", "objective", "sheets"]
    assert len(document["not_written"]) == 1 and not list((tmp_path / "maps").glob("nodes*"))
