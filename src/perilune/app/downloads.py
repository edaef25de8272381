"""Downloads of the flight on a page: the scenario, a table, figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from zipfile import ZipFile

from perilune import PeriluneError, Solution
from perilune.app.client import Shown
from perilune.app.source import Subject
from perilune.io import provenance, write_export


def _scenario(subject: Subject, shown: Shown) -> bytes:
    return subject.scenario(shown.values).encode()


def _flight_csv(subject: Subject, shown: Shown) -> bytes:
    with TemporaryDirectory() as folder:
        file = write_export(
            _shown_solution(shown), Path(folder) / "flight.csv", "csv", provenance(_shown_solution(shown), None)
        )
        return file.read_bytes()


def _figures_archive(subject: Subject, shown: Shown) -> bytes:
    from perilune.report import solution_drawings

    made = BytesIO()
    with ZipFile(made, "w") as archive:
        for name, draw in solution_drawings(_shown_solution(shown)).items():
            drawn = BytesIO()
            draw().savefig(drawn, format="svg")
            archive.writestr(f"{name}.svg", drawn.getvalue())
    return made.getvalue()


def _shown_solution(shown: Shown) -> Solution:
    if shown.solution is None:
        raise PeriluneError("there is no flight at these values")
    return shown.solution


# By name; each raises PeriluneError if there is no such thing of what is shown.
TAKEN: Mapping[str, Callable[[Subject, Shown], bytes]] = MappingProxyType(
    {"scenario.toml": _scenario, "flight.csv": _flight_csv, "figures.zip": _figures_archive}
)
