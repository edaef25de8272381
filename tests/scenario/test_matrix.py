"""Everything that a scenario may state, carried the whole way: from its file to what others read of its flight.

Every kind, every section that is there or left out, every value of every choice and every key at least once, read from
the declarations: what is declared anew and reached by no scenario fails here. Landings are solved from nothing. Of
returns four are; the others, which take a solver its minutes, are flights from which a direct method would start: all
that is written, drawn and read of a flight asks for no optimum.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the explorer needs starlette: pip install 'perilune[explore]'")
pytest.importorskip("xarray", reason="exports need xarray: pip install 'perilune[data]'")

from carried import Carried, rough_flight
from matrix import QUICK_RETURNS, REFUSED, WAYS, cover, declared, reached, text_of, unreached
from perilune.core import PeriluneError, quantity, record, text_field
from perilune.models import KINDS, Kind, Section
from perilune.scenario import load_text

SINGLES = [
    (kind, number, picked) for kind, ways in WAYS.items() for number, picked in enumerate(cover(ways, pairs=False))
]
SOLVED = [case for case in SINGLES if case[0] != "deorbit_entry"]
SOLVED += [("deorbit_entry", number, picked) for number, picked in enumerate(QUICK_RETURNS)]
FLOWN = [case for case in SINGLES if case[0] == "deorbit_entry" and case[2] not in QUICK_RETURNS]


def _named(case: tuple[str, int, Any]) -> str:
    return f"{case[0]}-{case[1]}"


def test_every_kind_has_scenarios() -> None:
    assert WAYS.keys() == {name for name, kind in KINDS.items() if not kind.package}


@pytest.mark.parametrize("kind", WAYS)
def test_all_that_is_declared_is_reached(kind: str) -> None:
    """Sections that are there and left out, values of choices, keys; what the kind refuses it refuses in words."""
    trees = [WAYS[kind].document(picked) for name, _, picked in SINGLES if name == kind]
    assert unreached(kind, trees) == set()
    for part, message in REFUSED.get(kind, {}).items():
        section, _, key = part.removeprefix("no ").partition(".")
        tree = next(tree for tree in trees if key in tree.get(section, {}))
        less = {**tree, section: {name: value for name, value in tree[section].items() if name != key}}
        with pytest.raises(PeriluneError, match=message):
            load_text(text_of(less))


def test_a_section_or_choice_that_is_new_is_missed() -> None:
    """The count is of what records declare: a kind with a section, a choice and a key more is not reached."""

    @record("sails")
    class Sails:
        shape: str = text_field("square", "square", "round", default="square")
        area: float | None = quantity("m^2", "9 m^2", default=None)

    kind = KINDS["hybrid_landing"]
    more: Mapping[str, Section] = {**kind.sections, "sails": Section(record=Sails, required=False)}
    wider: Kind = replace(kind, sections=more)
    trees = [WAYS[kind.name].document(picked) for name, _, picked in SINGLES if name == kind.name]
    there = {part for tree in trees for part in reached(wider, tree)}
    assert declared(wider) - there == {
        "[sails]", "sails.shape", "no sails.shape", "sails.shape = square", "sails.shape = round", "sails.area",
        "no sails.area",
    }  # fmt: skip


@pytest.mark.parametrize("case", SOLVED, ids=_named)
def test_a_scenario_is_solved_and_carried_the_whole_way(case: tuple[str, int, Any], tmp_path: Path) -> None:
    kind, number, picked = case
    carried = Carried(tmp_path, text_of(WAYS[kind].document(picked)))
    carried.check()
    solution = carried.solved()
    carried.told(solution)
    carried.proved(carried.saved(solution))
    carried.exported(solution)
    carried.drawn(solution)
    carried.explored(solution)
    slow = kind == "deorbit_entry" and number > 0  # to sweep it takes four times what it takes to solve it
    (carried.paired if slow else carried.swept)(solution)
    if number == 0 and not slow:
        carried.by_command()


@pytest.mark.parametrize("case", FLOWN, ids=_named)
def test_a_return_is_carried_the_whole_way(case: tuple[str, int, Any], tmp_path: Path) -> None:
    kind, number, picked = case
    carried = Carried(tmp_path, text_of(WAYS[kind].document(picked)))
    carried.check()
    solution = rough_flight(carried.problem)
    carried.told(solution)
    carried.saved(solution)
    carried.exported(solution, timed=number == 0)
    carried.drawn(solution)
    carried.explored(solution)
    carried.paired(solution)
