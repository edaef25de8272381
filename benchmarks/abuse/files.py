"""Falsified files: scenarios, saved answers, certificates, atlases. Nothing false may be accepted."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from abused import EXAMPLES, OURS, Fault, Material, demand, falsified, replaced

import perilune as pl
from perilune.cli import run_command_line
from perilune.problem import preflight
from perilune.scenario import load_text

_SAME = 1e-6  # relative: answers that agree so far are the same
_QUERIED = 1e-9  # the same of answers of an atlas


def scenario(rng: np.random.Generator, material: Material, at: Path) -> str:
    """An example with something else in it: read, and compared with what physics allows."""
    examples = sorted(EXAMPLES.glob("*.toml"))
    example = examples[rng.integers(len(examples))]
    content = falsified(rng, example.read_bytes())
    (at / "scenario.toml").write_bytes(content)
    code, said = _told("check", str(at / "scenario.toml"))
    try:
        problem = load_text(content.decode())
    except (pl.PeriluneError, UnicodeDecodeError):
        demand(code == 2, f"the library refuses what the command line takes: {code}, {said}")
        return "refused"
    preflight(problem)
    values = [given.value for given in problem.given.values()]
    demand(bool(np.isfinite(values).all()), "a value that is not finite is taken")
    return f"another scenario, {code}"


def saved(rng: np.random.Generator, material: Material, at: Path) -> str:
    """A saved answer with something else in it: what is proved of it has to be so."""
    source = material.own if rng.random() < 0.5 else material.modelled
    directory = Path(shutil.copytree(source, at / "saved"))
    where = replaced(rng, directory, ("solution.json",))
    code, said = _told("verify", str(directory))
    with _words():
        found = pl.load(directory)
        if pl.verify(found).verification.level < 3:
            demand(code in (2, 5), f"proved by the command line alone: {code}, {said}")
            return "not proved"
        demand(code in (0, 2), f"proved by the library alone: {code}, {said}")
        truth = pl.solve(found.problem)
        near = abs(found.objective - truth.objective) <= _SAME * max(abs(truth.objective), 1.0)
        demand(near, f"J {found.objective!r} proved, {truth.objective!r} from nothing; {where}")
        return "the same answer"
    return "refused"


def certificate(rng: np.random.Generator, material: Material, at: Path) -> str:
    """A certificate with something else in it: what is confirmed has to hold what is so."""
    if not material.certificate:
        return "no python-flint"
    from flint import arb, ctx

    from perilune_checker.check import confirm
    from perilune_checker.expressions import Failed

    content = falsified(rng, material.certificate.encode())
    try:
        told = json.loads(content)
        root, J = confirm(told, lambda _: None)
    except (Failed, ValueError, ArithmeticError, LookupError, TypeError, AttributeError, RuntimeError):
        return "refused"
    first = json.loads(material.certificate)
    if told["problem"] != first["problem"]:
        with ctx.workprec(first["bits"]):
            demand(bool(J.overlaps(arb(first["objective"]))), f"another problem is confirmed, J {J}")
        return "a problem with the same answer"
    with ctx.workprec(first["bits"]):
        known = [first["objective"], *(u["enclosure"] for u in first["unknowns"])]
        demand(all(a.overlaps(arb(b)) for a, b in zip([J, *root], known, strict=True)), "another root is confirmed")
    return "the same theorem"


def atlas(rng: np.random.Generator, material: Material, at: Path) -> str:
    """A map with something else in it: every answer is that of the map as it was, or refused."""
    directory = Path(shutil.copytree(material.atlas, at / "atlas"))
    where = replaced(rng, directory)
    code, said = _told("atlas", "info", str(directory))
    answered = 0
    with _words():
        found = pl.atlas.open(directory)
        demand(code == 0, f"the library opens what the command line does not: {said}; {where}")
        for point, right in zip(material.points, material.objectives, strict=True):
            with _words():
                J = found.query(**dict(zip(found.region.names, map(float, point), strict=True))).objective
                demand(abs(J - right) <= _QUERIED * abs(right), f"J {J!r} for {right!r}; {where}")
                answered += 1
        return f"{'all' if answered == len(material.points) else 'some'} answered"
    return "refused"


def _told(*words: str) -> tuple[int, str]:
    """What a command ends with, in this process; a `Fault` where it is one of the program."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as err:
        code = run_command_line([*words])
    said = err.getvalue()
    demand(code != 1 and not any(word in said for word in OURS), said[-500:])
    return code, said[-200:]


@contextlib.contextmanager
def _words() -> Iterator[None]:
    """What is refused in words of ours ends here; all else is a fault."""
    try:
        yield
    except (pl.PeriluneError, Fault) as error:
        if isinstance(error, Fault):
            raise
