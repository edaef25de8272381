"""The commands, each a thin order of work over the library; nothing is computed here."""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from perilune.cli.answer import Answer, deliver, forsake_stdout, refusal, say
from perilune.cli.doctor import diagnosis
from perilune.cli.progress import LONGEST_LOG, failure_kept, progress, refuse_used, warn
from perilune.reproductions.papers import PAPERS
from perilune.words.outcome import InfeasibleError, PeriluneError

if TYPE_CHECKING:
    from perilune.problem.solution import Solution

app = typer.Typer(
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Optimal finite-thrust landings, each with its proof.",
    epilog="Exit codes: 0 proved, 2 bad scenario, 3 infeasible, 4 not converged, 5 not proved, 130 stopped.",
)


def obey(arguments: Sequence[str]) -> int:
    """Parse a command line and do what it says; the exit code."""
    command = typer.main.get_command(app)
    try:
        # Not `app(...)`, which takes Ctrl-C for itself and leaves without a word.
        with command.make_context("perilune", list(arguments)) as context:
            command.invoke(context)
    except typer.Exit as left:
        return left.exit_code
    except BrokenPipeError:
        forsake_stdout()
    except Exception as error:
        message = getattr(error, "format_message", None)  # of the parser's refusals
        if message is None:
            raise
        usage = PeriluneError(message() or "no command", advice="perilune --help")
        return say(refusal(usage, usage.exit_code), as_json="--json" in arguments)
    return 0


ScenarioFile = Annotated[Path, typer.Argument(metavar="FILE", help="Scenario in TOML; `perilune new` writes one.")]
Changes = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help='Change a value, e.g. "vehicle.thrust=500 N".'),
]
Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Write everything into this directory.")]
Json = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]
Force = Annotated[bool, typer.Option("--force", help="Replace files that are there.")]
Verbose = Annotated[bool, typer.Option("--verbose", help="Show every iteration on stderr, and every check.")]


def _keep_no_code(chosen: bool) -> None:
    if chosen:
        os.environ["PERILUNE_CACHE"] = "off"  # read by perilune.kernels.code.cache


NoCache = Annotated[
    bool, typer.Option("--no-cache", callback=_keep_no_code, help="Compile anew and keep no machine code on disk.")
]
Method = Annotated[
    str,
    typer.Option(
        "--method",
        metavar="METHOD",
        help="indirect; direct, which also flies along a limit; hybrid: genetic search, then direct.",
    ),
]
Level = Annotated[int, typer.Option("--level", min=0, max=3, help="Verification level to prove; 0 for none.")]


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Show the version and leave.")] = False,
) -> None:
    if version:
        from perilune import __version__

        print(f"perilune {__version__}")
        raise typer.Exit()
    if context.invoked_subcommand is None:
        print(context.get_help(), file=sys.stderr)
        raise typer.Exit(2)


@app.command()
def solve(
    file: ScenarioFile,
    changes: Changes = None,
    out: Out = None,
    as_json: Json = False,
    verbose: Verbose = False,
    force: Force = False,
    level: Level = 3,
    method: Method = "indirect",
    no_cache: NoCache = False,
) -> None:
    """Find the best landing, without a guess, and prove it."""
    deliver(as_json, lambda: _solve(file, changes or [], out, verbose, force, level, method))


def _solve(
    file: Path, changes: list[str], out: Path | None, verbose: bool, force: bool, level: int, method: str
) -> Answer:
    from perilune.cli.methods import method_of
    from perilune.problem.preflight import preflight
    from perilune.scenario import load_file

    chosen = method_of(method)
    scenario = load_file(file, changes)
    refuse_used(out, force)
    warn(preflight(scenario.problem))
    from perilune.solve import solve as solve_problem

    log: deque[str] = deque(maxlen=LONGEST_LOG)
    with progress(verbose, log) as watch, failure_kept(scenario, out, force, log):
        solution = solve_problem(scenario.problem, chosen, level=level, watch=watch)
        if out is not None:
            from perilune.report import write_all

            watch("writing files and figures")
            write_all(solution, out, scenario_text=scenario.text, ordinary=_beside(solution), force=force)
    return _solution_answer(solution, verbose, out)


def _beside(solution: Solution) -> Solution | None:
    """The plainer flight that the problem's views name, for the figures.

    None where it is that already, or has no solution.
    """
    from perilune.solve import solve as solve_problem

    beside = solution.problem.views.beside
    if beside is None or all(getattr(solution.parameters, name) == value for name, value in beside.given):
        return None
    try:
        return solve_problem(solution.problem.with_given(**dict(beside.given)), level=0)
    except PeriluneError:
        return None


def _solution_answer(solution: Solution, verbose: bool, out: Path | None = None) -> Answer:
    from perilune.io.export import solution_document
    from perilune.report.summary import solution_summary

    text = solution_summary(solution, every_check=verbose) + (f"\n\nwritten to {out}" if out is not None else "")
    return Answer(text=text, document=solution_document(solution), exit_code=solution.outcome.exit_code)


@app.command()
def sweep(
    file: ScenarioFile,
    vary: Annotated[
        list[str],
        typer.Option(
            "--vary",
            metavar="KEY=START:STOP:STEP",
            help='E.g. "retro.delta_v=0:1600:50 m/s"; given more than once, the family is the grid.',
        ),
    ],
    changes: Changes = None,
    out: Out = None,
    as_json: Json = False,
    verbose: Verbose = False,
    force: Force = False,
    level: Level = 1,
    method: Method = "indirect",
    workers: Annotated[int, typer.Option("--workers", min=1, help="Processes that solve members side by side.")] = 1,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the members that are in --out DIR already.")
    ] = False,
    no_cache: NoCache = False,
) -> None:
    """Solve along parameters; table as CSV on stdout, with --out also as JSON and figure, and every member."""
    from perilune.cli.sweeping import SweepOrder, sweep_answer

    order = SweepOrder(
        file=file, vary=vary, changes=changes or [], out=out, resume=resume, verbose=verbose, force=force, level=level,
        method=method, workers=workers,
    )  # fmt: skip
    deliver(as_json, lambda: sweep_answer(order))


@app.command()
def check(file: ScenarioFile, changes: Changes = None, as_json: Json = False) -> None:
    """Validate a scenario and compare it with what physics allows, without solving."""
    deliver(as_json, lambda: _check(file, changes or []))


def _check(file: Path, changes: list[str]) -> Answer:
    from perilune.problem.preflight import preflight, refuse_impossible
    from perilune.scenario import load_file

    problem = load_file(file, changes).problem
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
    lines = [problem.title]
    for row in rows:
        value = f"{row['value']:.6g} {row['unit']}".removesuffix(" 1")
        lines.append(f"  {row['verdict']:10} {row['name']}: {value} ({row['relation']} {row['limit']:.6g})")
        lines += [f"             {row['meaning']}"] if row["meaning"] else []
    try:
        refuse_impossible(found)
    except InfeasibleError as error:
        said = refusal(error, error.exit_code)
        lines.append(str(error))
        return replace(said, text="\n".join(lines), document={**said.document, "findings": rows})
    warned = any(f.verdict == "warning" for f in found)
    document = {"problem": problem.name, "outcome": "POSSIBLE", "warnings": warned, "findings": rows}
    return Answer(text="\n".join(lines), document=document)


@app.command()
def verify(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="What `perilune solve --out` wrote.")],
    as_json: Json = False,
    verbose: Annotated[bool, typer.Option("--verbose", help="Show every check.")] = False,
    level: Annotated[int, typer.Option("--level", min=1, max=3, help="Verification level to prove.")] = 3,
    no_cache: NoCache = False,
) -> None:
    """Prove a saved solution again, from its file alone."""

    def work() -> Answer:
        from perilune.io.reload import load
        from perilune.solve import prove

        return _solution_answer(prove(load(directory), level), verbose)

    deliver(as_json, work)


@app.command()
def reproduce(
    paper: Annotated[str, typer.Argument(metavar="PAPER", help=" or ".join(PAPERS))],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Where the report goes.")],
    as_json: Json = False,
    verbose: Verbose = False,
    force: Force = False,
    no_cache: NoCache = False,
) -> None:
    """Compute every number and figure of a paper and set them beside the printed ones."""

    def work() -> Answer:
        from perilune.reproductions.papers import reproduce as reproduce_paper

        refuse_used(out, force)
        with progress(verbose, deque(maxlen=LONGEST_LOG)) as watch:
            proved = reproduce_paper(paper, out, force=force, watch=watch).proved
        report = str(out / "report.md")
        document = {
            "paper": paper,
            "outcome": proved.outcome.name,
            "verification": {"level": proved.verification.level},
            "report": report,
        }
        return Answer(text=f"written to {report}", document=document, exit_code=proved.outcome.exit_code)

    deliver(as_json, work)


@app.command()
def new(
    kind: Annotated[
        str | None,
        typer.Argument(metavar="[KIND]", help="hybrid_landing (unless given), powered_descent, precision_landing."),
    ] = None,
    place: Annotated[
        Path | None, typer.Argument(metavar="[FILE]", help="Where to write; to stdout if left out.")
    ] = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """Write a commented scenario to start from."""

    def work() -> Answer:
        from perilune.scenario import KINDS, template

        alone = kind is not None and kind not in KINDS and place is None  # `perilune new FILE`
        text, file = (template(), Path(kind)) if alone and kind else (template(kind or "hybrid_landing"), place)
        if file is None:
            return Answer(text=text, document={"template": text})
        try:
            with file.open("w" if force else "x", encoding="utf-8") as opened:
                opened.write(text)
        except FileExistsError:
            raise PeriluneError(
                "the file is there already", got=str(file), advice="choose another name, or pass --force"
            ) from None
        return Answer(text=f"written to {file}\nsolve it: perilune solve {file}", document={"written": str(file)})

    deliver(as_json, work)


@app.command()
def doctor(
    as_json: Json = False,
    clear_cache: Annotated[bool, typer.Option("--clear-cache", help="Remove the machine code kept on disk.")] = False,
) -> None:
    """Show versions, which optional parts are there, and the machine code kept on disk."""
    deliver(as_json, lambda: diagnosis(clear_cache))
