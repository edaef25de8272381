"""The commands, each a thin order of work over the library; nothing is computed here."""

from __future__ import annotations

import os
from argparse import Namespace
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from perilune.cli.answer import Answer, Files, aside, deliver, failed, refusal, say, tell
from perilune.cli.arguments import Told, help_text, parsed, settings
from perilune.cli.doctor import diagnosis
from perilune.cli.options import time_limit
from perilune.cli.progress import LONGEST_LOG, WRITING, failure_kept, progress, refuse_used, warn
from perilune.cli.stopping import advised, heed, put_off
from perilune.words.outcome import InfeasibleError, PeriluneError
from perilune.words.units import told

if TYPE_CHECKING:
    from perilune.problem.solution import Solution

_MOST_NAMES = 8  # of files in a note


def obey(arguments: Sequence[str]) -> int:
    """Parse a command line and run its command; returns the exit code."""
    try:
        typed = parsed(arguments)
    except Told as asked:
        return tell(str(asked))
    except PeriluneError as usage:
        return say(refusal(usage, usage.exit_code), as_json="--json" in arguments)
    if typed.command is None:
        aside(help_text())
        return 2
    if getattr(typed, "no_cache", False):
        os.environ["PERILUNE_CACHE"] = "off"  # read by perilune.kernels.code.cache
    return deliver(typed.as_json, lambda: COMMANDS[typed.command](typed), getattr(typed, "verbose", False))


def _solve(typed: Namespace) -> Answer:
    from perilune.cli.methods import method_of
    from perilune.problem.preflight import preflight
    from perilune.scenario import load_file

    chosen, out, limit = method_of(typed.method, settings(typed)), typed.out, time_limit(typed)
    log: deque[str] = deque(maxlen=LONGEST_LOG)
    with progress(False, log):
        scenario = load_file(typed.file, typed.changes)
        refuse_used(out, typed.force)
        found = preflight(scenario.problem)
    warn(found)
    from perilune.solve import solve as solve_problem

    kept, files = "", Files()
    with advised(lambda: kept), progress(typed.verbose, log) as watch:
        with failure_kept(scenario, out, typed.force, log):
            solution = solve_problem(
                scenario.problem, chosen, level=typed.level, tolerance=scenario.tolerance, watch=watch,
                time_limit=limit,
            )  # fmt: skip
            if out is not None:
                with put_off(), files.written():
                    from perilune.io.export import save

                    save(solution, out, scenario.text, force=typed.force)
                    kept = f"the solution is in {out}; its figures and the report may be missing"
        if out is not None:
            watch(WRITING)
            ordinary = None
            with files.written():
                ordinary = _beside(solution)
            with files.written():
                from perilune.report import add_report

                add_report(solution, out, scenario_text=scenario.text, ordinary=ordinary)
    return files.placed(_solution_answer(solution, typed.verbose), out)


def _beside(solution: Solution) -> Solution | None:
    """Solve for the plainer flight that the problem's views name, for the figures.

    None if the solution is that already, or it has no solution.
    """
    from perilune.solve import solve as solve_problem

    beside = solution.problem.views.beside
    if beside is None or all(getattr(solution.parameters, name) == value for name, value in beside.given):
        return None
    try:
        return solve_problem(solution.problem.with_given(**dict(beside.given)), level=0)
    except PeriluneError:
        return None


def _solution_answer(solution: Solution, verbose: bool) -> Answer:
    from perilune.io.export import solution_document
    from perilune.report.summary import solution_summary

    heed()
    try:
        text, document = solution_summary(solution, every_check=verbose), solution_document(solution)
    except Exception as error:
        return _plain_answer(solution, failed(error))
    return Answer(text=text, document=document, exit_code=solution.outcome.exit_code)


def _plain_answer(solution: Solution, fault: Answer) -> Answer:
    """Return the answer for a flight whose results cannot be computed by a fault: objective and free parameters."""
    problem = solution.problem
    units = {"objective": problem.objective_unit, **{free.name: free.unit for free in problem.free}}
    values = {"objective": float(solution.objective), **solution.free}
    aside(fault.text)
    lines = [f"{problem.heading}: {solution.outcome.name}, and its results cannot be told", ""]
    lines += [f"  {name}: {told(value, units.get(name, ''))}" for name, value in values.items()]
    document = {"problem": problem.name, "outcome": solution.outcome.name, "values": values, "fault": fault.document}
    return Answer(text="\n".join(lines), document=document, exit_code=fault.exit_code)


def _sweep(typed: Namespace) -> Answer:
    from perilune.cli.sweeping import sweep_answer

    return sweep_answer(typed)


def _check(typed: Namespace) -> Answer:
    from perilune.problem.preflight import preflight, refuse_impossible
    from perilune.scenario import load_file

    with progress(False, deque(maxlen=1)) as watch:
        problem = load_file(typed.file, typed.changes).problem
        watch("comparing with what physics allows")
        found = preflight(problem)
    rows = [
        {
            "name": f.name,
            "value": f.value,
            "relation": "at least" if f.at_least else "at most",
            "limit": f.limit,
            "unit": f.unit,
            "verdict": f.verdict,
            "meaning": f.meaning if not f.passed else "",
        }
        for f in found
    ]
    lines = [problem.heading, *(f"  {'read':10} {text}" for text in problem.inputs_read)]
    for f in found:
        lines.append(f"  {f.verdict:10} {f.name}: {f.told[0]} ({f.told[1]})")
        lines += [] if f.passed else [f"             {f.meaning}"]
    inputs = {"inputs": list(problem.inputs_read)} if problem.inputs_read else {}
    try:
        refuse_impossible(found)
    except InfeasibleError as error:
        said = refusal(error, error.exit_code)
        lines.append(str(error))
        return replace(said, text="\n".join(lines), document={**said.document, **inputs, "findings": rows})
    warned = any(f.verdict == "warning" for f in found)
    document = {"problem": problem.name, "outcome": "POSSIBLE", "warnings": warned, **inputs, "findings": rows}
    return Answer(text="\n".join(lines), document=document)


def _opportunities(typed: Namespace) -> Answer:
    from perilune.models.deorbit.opportunities import opportunities, refuse_none
    from perilune.report.opportunities import opportunities_document, opportunities_text
    from perilune.scenario import load_file

    with progress(False, deque(maxlen=1)) as watch:
        problem = load_file(typed.file, typed.changes).problem
        watch("looking at the passes")
        found = opportunities(problem, typed.days)
    document, text = opportunities_document(found), opportunities_text(found, every=typed.every)
    try:
        refuse_none(found, typed.days)
    except InfeasibleError as error:
        said = refusal(error, error.exit_code)
        told = f"{text}\n{error}" if typed.every else str(error)
        return replace(said, text=told, document={**said.document, **document})
    return Answer(text=text, document=document)


def _atlas(typed: Namespace) -> Answer:
    from perilune.cli.mapping import ACTIONS

    return ACTIONS[typed.action](typed)


def _verify(typed: Namespace) -> Answer:
    from perilune.io.reload import load
    from perilune.solve import prove

    certificate = typed.certificate
    if certificate is not None:
        from perilune.io.files import new_file

        certificate = new_file(certificate, "the certificate", typed.force)  # refused before the work, not after it
    with progress(typed.verbose, deque(maxlen=LONGEST_LOG)) as watch:
        solution = _with_unread_files(prove(load(typed.directory), typed.level, watch=watch), typed.directory)
    answer, files = _solution_answer(solution, typed.verbose), Files()
    if certificate is None:
        return answer
    with files.written():
        answer = replace(answer, text=f"{answer.text}\n\n{_certified(solution, certificate)}")
    return files.noted(answer)


def _with_unread_files(solution: Solution, directory: Path) -> Solution:
    """Add a note that names the files beside ``solution.json``: derived from it, and no evidence."""
    from perilune.io.format import SOLUTION_FILE

    if not directory.is_dir():
        return solution
    names = sorted(repr(path.name)[1:-1][:60] for path in directory.iterdir() if path.name != SOLUTION_FILE)
    if not names:
        return solution
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    note = f"not read, as only {SOLUTION_FILE} is evidence: {', '.join(names[:_MOST_NAMES])}{more}"
    verification = solution.verification
    return replace(solution, verification=replace(verification, notes=(*verification.notes, note)))


def _certified(solution: Solution, file: Path) -> str:
    """Write the certificate of a theorem; returns a sentence on it."""
    from perilune.io.files import fresh_file, json_text

    if solution.verification.certificate is None:
        return "no certificate was written, as there is no theorem"
    text = json_text(dict(solution.verification.certificate))
    with fresh_file(file, "the certificate") as beside:
        beside.write_text(text, encoding="utf-8")
    return f"certificate written to {file}"


def _export(typed: Namespace) -> Answer:
    from perilune.io.exports.epochs import epoch_of
    from perilune.io.exports.provenance import provenance
    from perilune.io.exports.writing import demand_named, placed, write
    from perilune.io.reload import opened
    from perilune.solve import prove

    _, form = placed(typed.out, typed.format, typed.force)
    named = demand_named(form, typed.object_name, typed.object_id)
    loaded, document = opened(typed.directory)
    epoch_of(loaded, typed.epoch)  # refused before the proof, which may take long
    with progress(False, deque(maxlen=1)) as watch:
        solution = prove(loaded, typed.prove, watch=watch)
    heed()
    about = provenance(solution, document=document)
    write(solution, typed.out, form, about, epoch=typed.epoch, force=typed.force, **named)
    size = typed.out.stat().st_size
    told = {"written": str(typed.out), "format": form, "bytes": size, "proof": about["proof"]}
    text = f"written to {typed.out}: {form}, {size / 2**10:.0f} KiB; proof: {about['proof']}"
    return Answer(text=text, document=told, exit_code=solution.outcome.exit_code if typed.prove else 0)


def _reproduce(typed: Namespace) -> Answer:
    from perilune.reproductions.papers import reproduce as reproduce_paper

    refuse_used(typed.out, typed.force)
    with progress(typed.verbose, deque(maxlen=LONGEST_LOG)) as watch:
        asked = {} if typed.seeds is None else {"seeds": typed.seeds}
        proved = reproduce_paper(typed.paper, typed.out, force=typed.force, watch=watch, **asked).proved
    report = str(typed.out / "report.md")
    document = {
        "paper": typed.paper,
        "outcome": proved.outcome.name,
        "verification": {"level": proved.verification.level},
        "report": report,
    }
    return Answer(text=f"written to {report}", document=document, exit_code=proved.outcome.exit_code)


def _new(typed: Namespace) -> Answer:
    from perilune.cli.beginning import new_answer

    return new_answer(typed)


def _explore(typed: Namespace) -> Answer:
    from perilune.cli.exploring import explore

    return explore(typed)


def _doctor(typed: Namespace) -> Answer:
    return diagnosis(typed.clear_cache)


COMMANDS: dict[str, Callable[[Namespace], Answer]] = {
    "solve": _solve,
    "sweep": _sweep,
    "check": _check,
    "opportunities": _opportunities,
    "atlas": _atlas,
    "verify": _verify,
    "export": _export,
    "explore": _explore,
    "reproduce": _reproduce,
    "new": _new,
    "doctor": _doctor,
}
