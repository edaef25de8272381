"""The command ``explore``: a page on this machine, and messages while it is open."""

from __future__ import annotations

import signal
import socket
from argparse import Namespace
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from perilune import PeriluneError
from perilune.cli.interrupts import handle_interrupt
from perilune.cli.output import CommandAnswer, print_to_stderr
from perilune.cli.progress import LONGEST_LOG, progress
from perilune.core import Quantity, unknown_name

if TYPE_CHECKING:
    from perilune import Problem
    from perilune.app import Knob, Subject


def serve_or_write_page(typed: Namespace) -> CommandAnswer:
    """Serve the page until Ctrl-C, or write it."""
    from perilune.app import subject_of

    if typed.html is not None:
        return _write_static_page(
            subject_of(typed.target, typed.changes or ()), typed.html, typed.vary or (), typed.force
        )
    try:
        import starlette  # noqa: F401
        import uvicorn
        import websockets  # noqa: F401
    except ImportError as missing:
        raise PeriluneError(
            "the explorer needs a web server, which is not installed",
            got=f"no {missing.name}",
            advice="pip install 'perilune[explore]', or write a page that needs no server: --html FILE",
        ) from None
    from perilune.app import MESSAGE, Explorer

    subject = subject_of(typed.target, typed.changes or ())
    if typed.vary:
        raise PeriluneError(
            "--vary selects the parameters of a page written with --html",
            advice="on a live page every parameter can be moved",
        )
    listening = _listening(typed.port)
    port = listening.getsockname()[1]
    explorer = Explorer(subject, port)
    address = f"http://127.0.0.1:{port}/{explorer.token}/"
    print_to_stderr(
        f"perilune: exploring {subject.title}\n{address}\nreachable from this machine only; Ctrl-C stops it"
    )
    if not typed.no_open:
        import webbrowser

        webbrowser.open(address)
    settings = uvicorn.Config(
        explorer.app, log_level="error", ws_max_size=MESSAGE, ws_max_queue=8, lifespan="off", server_header=False
    )
    server = uvicorn.Server(settings)
    signal.signal(signal.SIGTERM, handle_interrupt)  # by which services are ended: as Ctrl-C
    try:
        server.run([listening])
    except KeyboardInterrupt:  # what ended it, which the server passes on when it has ended in order
        pass
    finally:
        explorer.close()
        listening.close()
    return CommandAnswer(text="the explorer has stopped", document={"served": address})


def _write_static_page(subject: Subject, file: Path, vary: Sequence[str], force: bool) -> CommandAnswer:
    from perilune.app import build_static_page, default_sliders
    from perilune.io import fresh_file, new_file

    chosen = _chosen_sliders(subject, vary) or default_sliders(subject)
    new_file(file, "the page", force)
    with progress(False, deque(maxlen=LONGEST_LOG)) as watch:
        page, words = build_static_page(subject, watch, chosen)
    with fresh_file(file, "the page") as beside:
        beside.write_text(page, encoding="utf-8")
    moves = {
        knob.key: f"{knob.low / knob.size:.6g} to {knob.high / knob.size:.6g} {knob.unit}".removesuffix(" 1")
        for knob in chosen
    }
    told = " and ".join(f"{key} from {span}" for key, span in moves.items())
    text = f"written to {file}: {len(page) / 1e6:.1f} MB; on it {told} can be moved (--vary selects others)\n{words}"
    return CommandAnswer(text=text, document={"written": str(file), "sliders": moves, "stored": words})


def _chosen_sliders(subject: Subject, vary: Sequence[str]) -> tuple[Knob, ...]:
    """Return the parameters that were named, each with the stated range, or its own."""
    from perilune.scenario import bounds_of

    known: dict[str, Knob] = {knob.key: knob for knob in subject.knobs}
    found: dict[str, Knob] = {}
    for stated in vary:
        key, _, text = (part.strip() for part in stated.partition("="))
        if key not in known:
            raise unknown_name("parameter that can be moved", key, list(known))
        if key in found:
            raise PeriluneError(f"--vary names {key} twice", got=stated[:60], expected="each parameter once")
        knob, unit = known[key], subject.problem.unit_of(known[key].name)
        low, high = (knob.low, knob.high)
        if text:
            low, high = bounds_of(key, text, {key: Quantity(unit=unit, example=f"1 {unit}")})
        found[key] = replace(knob, low=low, high=high, value=min(max(knob.value, low), high))
    if len(found) > 2:
        raise PeriluneError("too many parameters for one page", got=", ".join(found), expected="one parameter, or two")
    _refuse_unstated(subject.problem, tuple(found.values()))
    return tuple(found.values())


def _refuse_unstated(problem: Problem, chosen: Sequence[Knob]) -> None:
    """Refuse an end of a range at which no problem can be stated, whatever else moves."""
    refused: dict[tuple[str, float], PeriluneError] = {}
    stated: set[tuple[str, float]] = set()
    for corner in product(*((knob.low, knob.high) for knob in chosen)):
        ends = {(knob.name, value) for knob, value in zip(chosen, corner, strict=True)}
        try:
            problem.with_given(**dict(ends))
        except PeriluneError as error:
            refused |= dict.fromkeys(ends, error)
        else:
            stated |= ends
    for end, error in refused.items():
        if end not in stated:
            raise error


def _listening(port: int) -> socket.socket:
    """Return a socket that listens on this machine only."""
    made = socket.socket()
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind(("127.0.0.1", port))
        made.listen()  # who opens the address at once waits until it is served
    except OSError as error:
        made.close()
        raise PeriluneError(
            f"port {port} cannot be used", got=str(error.strerror), advice="another --port; 0 takes any free one"
        ) from None
    return made
