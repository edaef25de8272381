"""Papers that are computed again. Each is a package of three files, one way: case, compute, report."""

from __future__ import annotations

from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any

from perilune.core import Watch, ignore_events, unknown_name

# Name on the command line: package in this room, loaded when asked for.
PAPERS = {"cho-2015": "cho2015", "peng-2012": "peng2012", "liu-2019": "liu2019"}
_MAKERS = {
    "cho-2015": ("compute_cho", "write_cho_report"),
    "liu-2019": ("compute_liu", "write_liu_report"),
    "peng-2012": ("compute_peng", "write_peng_report"),
}


def reproduce_paper(
    paper: str, out_dir: str | Path, force: bool = False, watch: Watch | None = None, **settings: Any
) -> Any:
    """Compute everything in a paper and write ``report.md``, its data and its figures.

    Parameters
    ----------
    paper
        A name of `PAPERS`.
    out_dir
        Directory; its files appear together when all are complete.
    force
        Whether what an earlier run wrote there may be replaced.
    watch
        Receives lines of text and iterations.
    settings
        Of the paper's own ``compute``: the verification level (`level`), and of a paper with a random search how often
        it is tried (`seeds`).

    Returns
    -------
    Reproduction
        What was computed; its `outcome` is that of the solution that was to be proved, `proved`.

    Raises
    ------
    PeriluneError
        If the paper or a setting is not known, or the directory cannot be written.
    """
    from perilune.io import fresh_directory

    if paper not in PAPERS:
        raise unknown_name("paper", paper, list(PAPERS))
    compute, write = (
        getattr(import_module(f"perilune_papers.{PAPERS[paper]}.{part}"), name)
        for part, name in zip(("compute", "report"), _MAKERS[paper], strict=True)
    )
    known = [name for name in signature(compute).parameters if name != "watch"]
    for name in settings:
        if name not in known:
            raise unknown_name(f"setting of {paper}", name, known)
    with fresh_directory(out_dir, force) as work:
        made = compute(watch or ignore_events, **settings)
        write(made, work)
    return made
