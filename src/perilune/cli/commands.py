"""Commands of the terminal, each a short sequence of calls of the library; nothing is computed here."""

from __future__ import annotations

import os
from argparse import Namespace
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from perilune import InfeasibleError, PeriluneError
from perilune.cli.arguments import HelpShown, help_text, method_settings, parse_command_line
from perilune.cli.doctor import diagnosis
from perilune.cli.interrupts import advise_on_interrupt, defer_interrupt, raise_pending_interrupt
from perilune.cli.options import time_limit
from perilune.cli.output import (
    CommandAnswer,
    WrittenFiles,
    answer_of_error,
    emit_answer,
    print_answer,
    print_text,
    print_to_stderr,
    refusal_answer,
)
from perilune.cli.progress import LONGEST_LOG, WRITING, failure_kept, print_warnings, progress, refuse_unusable_target
from perilune.core import format_quantity

if TYPE_CHECKING:
    from perilune import Solution

_MOST_NAMES = 8  # of files in a note


def run_command(arguments: Sequence[str]) -> int:
    """Parse a command line and run its command; returns the exit code."""
    try:
        typed = parse_command_line(arguments)
    except HelpShown as asked:
        return print_text(str(asked))
    except PeriluneError as usage:
        return print_answer(refusal_answer(usage, usage.exit_code), as_json="--json" in arguments)
    if typed.command is None:
        print_to_stderr(help_text())
        return 2
    if getattr(typed, "no_cache", False):
        os.environ["PERILUNE_CACHE"] = "off"  # read by perilune.kernels.code.cache
    return emit_answer(typed.as_json, lambda: COMMANDS[typed.command](typed), getattr(typed, "verbose", False))


def _run_solve_command(typed: Namespace) -> CommandAnswer:
    from perilune import preflight
    from perilune.cli.methods import method_of
    from perilune.scenario import load_file

    chosen, out, limit = method_of(typed.method, method_settings(typed)), typed.out, time_limit(typed)
    log: deque[str] = deque(maxlen=LONGEST_LOG)
    with progress(False, log):
        scenario = load_file(typed.file, typed.changes)
        refuse_unusable_target(out, typed.force)
        found = preflight(scenario.problem)
    print_warnings(found)
    from perilune import solve as solve_problem

    kept, files = "", WrittenFiles()
    with advise_on_interrupt(lambda: kept), progress(typed.verbose, log) as watch:
        with failure_kept(scenario, out, typed.force, log):
            solution = solve_problem(
                scenario.problem, chosen, verify=typed.level, tolerance=scenario.tolerance, callback=watch,
                time_limit=limit,
            )  # fmt: skip
            if out is not None:
                with defer_interrupt(), files.written():
                    from perilune import save

                    save(solution, out, scenario.text, force=typed.force)
                    kept = f"the solution is in {out}; its figures and the report may be missing"
        if out is not None:
            watch(WRITING)
            ordinary = None
            with files.written():
                ordinary = _plainer_flight(solution)
            with files.written():
                from perilune.report import add_report

                add_report(solution, out, scenario_text=scenario.text, ordinary=ordinary)
    return files.placed(_solution_answer(solution, typed.verbose), out)


def _plainer_flight(solution: Solution) -> Solution | None:
    """Solve for the plainer flight that the problem's views name, for the figures.

    None if the solution is that already, or it has no solution.
    """
    from perilune import solve as solve_problem

    comparison = solution.problem.views.comparison
    if comparison is None or all(getattr(solution.parameters, name) == value for name, value in comparison.given):
        return None
    try:
        return solve_problem(solution.problem.with_given(**dict(comparison.given)), verify=0)
    except PeriluneError:
        return None


def _solution_answer(solution: Solution, verbose: bool) -> CommandAnswer:
    from perilune.io import solution_document
    from perilune.report import solution_summary

    raise_pending_interrupt()
    try:
        text, document = solution_summary(solution, every_check=verbose), solution_document(solution)
    except Exception as error:
        return _plain_answer(solution, answer_of_error(error))
    return CommandAnswer(text=text, document=document, exit_code=solution.outcome.exit_code)


def _plain_answer(solution: Solution, fault: CommandAnswer) -> CommandAnswer:
    """Return the answer for a flight whose results cannot be computed by a fault: objective and free parameters."""
    problem = solution.problem
    units = {"objective": problem.objective_unit, **{free.name: free.unit for free in problem.free}}
    values = {"objective": float(solution.objective), **solution.free}
    print_to_stderr(fault.text)
    lines = [f"{problem.heading}: {solution.outcome.name}, and its results cannot be shown", ""]
    lines += [f"  {name}: {format_quantity(value, units.get(name, ''))}" for name, value in values.items()]
    document = {"problem": problem.name, "outcome": solution.outcome.name, "values": values, "fault": fault.document}
    return CommandAnswer(text="\n".join(lines), document=document, exit_code=fault.exit_code)


def _run_sweep_command(typed: Namespace) -> CommandAnswer:
    from perilune.cli.sweep import sweep_answer

    return sweep_answer(typed)


def _run_check_command(typed: Namespace) -> CommandAnswer:
    from perilune import preflight
    from perilune.problem import refuse_impossible
    from perilune.scenario import load_file

    with progress(False, deque(maxlen=1)) as watch:
        problem = load_file(typed.file, typed.changes).problem
        watch("comparing with physical bounds")
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
        lines.append(f"  {f.verdict:10} {f.name}: {f.formatted[0]} ({f.formatted[1]})")
        lines += [] if f.passed else [f"             {f.meaning}"]
    inputs = {"inputs": list(problem.inputs_read)} if problem.inputs_read else {}
    try:
        refuse_impossible(found)
    except InfeasibleError as error:
        said = refusal_answer(error, error.exit_code)
        lines.append(str(error))
        return replace(said, text="\n".join(lines), document={**said.document, **inputs, "findings": rows})
    warned = any(f.verdict == "warning" for f in found)
    document = {"problem": problem.name, "outcome": "POSSIBLE", "warnings": warned, **inputs, "findings": rows}
    return CommandAnswer(text="\n".join(lines), document=document)


def _run_opportunities_command(typed: Namespace) -> CommandAnswer:
    from perilune.models import opportunities, refuse_no_opportunity
    from perilune.report import opportunities_answer
    from perilune.scenario import load_file

    with progress(False, deque(maxlen=1)) as watch:
        problem = load_file(typed.file, typed.changes).problem
        watch("searching for passes")
        found = opportunities(problem, typed.days)
    document, text = opportunities_answer(found, every=typed.every)
    try:
        refuse_no_opportunity(found, typed.days)
    except InfeasibleError as error:
        said = refusal_answer(error, error.exit_code)
        told = f"{text}\n{error}" if typed.every else str(error)
        return replace(said, text=told, document={**said.document, **document})
    return CommandAnswer(text=text, document=document)


def _run_atlas_command(typed: Namespace) -> CommandAnswer:
    from perilune.cli.atlas import ACTIONS

    return ACTIONS[typed.action](typed)


def _run_verify_command(typed: Namespace) -> CommandAnswer:
    from perilune import load, verify

    certificate = typed.certificate
    if certificate is not None:
        from perilune.io import new_file

        certificate = new_file(certificate, "the certificate", typed.force)  # refused before the work, not after it
    with progress(typed.verbose, deque(maxlen=LONGEST_LOG)) as watch:
        solution = _with_unread_files(verify(load(typed.directory), typed.level, callback=watch), typed.directory)
    answer, files = _solution_answer(solution, typed.verbose), WrittenFiles()
    if certificate is None:
        return answer
    with files.written():
        answer = replace(answer, text=f"{answer.text}\n\n{_write_certificate(solution, certificate)}")
    return files.noted(answer)


def _with_unread_files(solution: Solution, directory: Path) -> Solution:
    """Add a note that names the files beside ``solution.json``: derived from it, and no evidence."""
    from perilune.io import SOLUTION_FILE

    if not directory.is_dir():
        return solution
    names = sorted(repr(path.name)[1:-1][:60] for path in directory.iterdir() if path.name != SOLUTION_FILE)
    if not names:
        return solution
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    note = f"not read, as only {SOLUTION_FILE} is evidence: {', '.join(names[:_MOST_NAMES])}{more}"
    verification = solution.verification
    return replace(solution, verification=replace(verification, notes=(*verification.notes, note)))


def _write_certificate(solution: Solution, file: Path) -> str:
    """Write the certificate of a theorem; returns a sentence on it."""
    from perilune.io import fresh_file, json_text

    if solution.verification.certificate is None:
        return "no certificate was written, because there is no theorem"
    text = json_text(dict(solution.verification.certificate))
    with fresh_file(file, "the certificate") as beside:
        beside.write_text(text, encoding="utf-8")
    return f"certificate written to {file}"


def _run_export_command(typed: Namespace) -> CommandAnswer:
    from perilune import verify
    from perilune.io import export_target, flight_epoch, load_with_tree, provenance, require_object, write_export

    _, form = export_target(typed.out, typed.format, typed.force)
    named = require_object(form, typed.object_name, typed.object_id)
    loaded, document = load_with_tree(typed.directory)
    flight_epoch(loaded, typed.epoch)  # refused before the proof, which may take long
    with progress(False, deque(maxlen=1)) as watch:
        solution = verify(loaded, typed.verify, callback=watch)
    raise_pending_interrupt()
    about = provenance(solution, document=document)
    write_export(solution, typed.out, form, about, epoch=typed.epoch, force=typed.force, **named)
    size = typed.out.stat().st_size
    told = {"written": str(typed.out), "format": form, "bytes": size, "proof": about["proof"]}
    text = f"written to {typed.out}: {form}, {size / 2**10:.0f} KiB; proof: {about['proof']}"
    return CommandAnswer(text=text, document=told, exit_code=solution.outcome.exit_code if typed.verify else 0)


def _run_reproduce_command(typed: Namespace) -> CommandAnswer:
    from perilune_papers.papers import reproduce_paper as reproduce_paper

    refuse_unusable_target(typed.out, typed.force)
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
    return CommandAnswer(text=f"written to {report}", document=document, exit_code=proved.outcome.exit_code)


def _run_new_command(typed: Namespace) -> CommandAnswer:
    from perilune.cli.new import new_answer

    return new_answer(typed)


def _run_explore_command(typed: Namespace) -> CommandAnswer:
    from perilune.cli.explore import serve_or_write_page

    return serve_or_write_page(typed)


def _run_doctor_command(typed: Namespace) -> CommandAnswer:
    return diagnosis(typed.clear_cache)


COMMANDS: dict[str, Callable[[Namespace], CommandAnswer]] = {
    "solve": _run_solve_command,
    "sweep": _run_sweep_command,
    "check": _run_check_command,
    "opportunities": _run_opportunities_command,
    "atlas": _run_atlas_command,
    "verify": _run_verify_command,
    "export": _run_export_command,
    "explore": _run_explore_command,
    "reproduce": _run_reproduce_command,
    "new": _run_new_command,
    "doctor": _run_doctor_command,
}
