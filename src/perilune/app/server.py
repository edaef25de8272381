"""The server of the page: on this machine alone, for who has the address that was printed.

It listens on 127.0.0.1, answers below a random token, and looks at Host and Origin, so that no other page that is open
in the same browser reaches it. What it hands out is read into memory when it starts: nothing that a browser sends
becomes a path. Messages are small and few, and of one client one computation is done at a time: the newest values are
answered, older ones dropped.
"""

from __future__ import annotations

import asyncio
import json
import math
import secrets
import time
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from importlib.resources import files
from io import BytesIO
from typing import Any
from zipfile import ZipFile

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from perilune.app.answering import Answering, family
from perilune.app.frames import flight, refusal
from perilune.app.resting import Prover, in_thread
from perilune.app.slices import slice_of
from perilune.app.subject import Subject
from perilune.words.outcome import PeriluneError

MESSAGE = 16_384  # bytes that a message may have
_MOST, _PER = 240, 2.0  # messages in so many seconds
_REST = 0.35  # s without a new value until what takes longer is done
_CLIENTS = 4
_KINDS = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Explorer:
    """Serves one subject.

    Parameters
    ----------
    subject
        What is explored.
    port
        On which it is served, for the names by which a browser may call it.
    """

    def __init__(self, subject: Subject, port: int) -> None:
        self.subject, self.token = subject, secrets.token_urlsafe(24)
        self._hosts = {f"{host}:{port}" for host in ("127.0.0.1", "localhost")}
        self._files = page_files()
        self._clients, self._prover = 0, Prover()
        self.app = Starlette(
            routes=[
                WebSocketRoute("/{token}/live", self._live),
                Route("/{token}/{name:path}", self._file, methods=["GET"]),
            ],
            exception_handlers={404: _nothing},
        )

    def close(self) -> None:
        """End what is still computed."""
        self._prover.close()

    # -- files ----------------------------------------------------------------------------------------------------

    async def _file(self, request: Request) -> Response:
        name = request.path_params["name"] or "index.html"
        if not self._known(request.path_params["token"], request.headers):
            return await _nothing(request, None)
        if name in ("scenario.toml", "figures.zip"):
            try:
                values = self._values(request.query_params)
                if name == "scenario.toml":
                    return PlainTextResponse(self.subject.scenario(values), headers=_HEADERS)
                content = await in_thread(figures, self.subject, values)
            except PeriluneError as error:
                return PlainTextResponse(str(error), status_code=400, headers=_HEADERS)
            return Response(content, media_type="application/zip", headers=_HEADERS)
        if name not in self._files:
            return await _nothing(request, None)
        kind = _KINDS.get(name[name.rfind(".") :], "text/plain")
        return Response(self._files[name], media_type=f"{kind}; charset=utf-8", headers=_HEADERS)

    def _values(self, query: Mapping[str, str]) -> dict[str, float]:
        """Values of knobs by name [SI] of what an address says of their keys, in the units in which they are shown."""
        size, number = {knob.key: knob.size for knob in self.subject.knobs}, len(query)
        values = {key: float(text) * size[key] for key, text in query.items() if key in size and _is_number(text)}
        named = {knob.name: values[knob.key] for knob in self.subject.knobs if knob.key in values}
        return asked(json.dumps({"number": number, "values": named}), self.subject)["values"]

    def _known(self, token: str, headers: Mapping[str, str]) -> bool:
        origin = headers.get("origin")
        return (
            secrets.compare_digest(token.encode(), self.token.encode())
            and headers.get("host") in self._hosts
            and (origin is None or origin.removeprefix("http://") in self._hosts)
        )

    # -- live -----------------------------------------------------------------------------------------------------

    async def _live(self, socket: WebSocket) -> None:
        headers = socket.headers
        if not self._known(socket.path_params["token"], headers) or "origin" not in headers:
            await socket.close(1008)
            return
        if self._clients >= _CLIENTS:
            await socket.close(1013, "too many pages are open")
            return
        self._clients += 1
        try:
            await socket.accept()
            await _Client(self.subject, socket, self._prover).run()
        finally:
            self._clients -= 1


class _Client:
    """One page that is open."""

    def __init__(self, subject: Subject, socket: WebSocket, prover: Prover) -> None:
        self.subject, self.socket, self.prover = subject, socket, prover
        self.answering = Answering(subject.problem, subject.atlas, subject.known)
        self._newest: dict[str, Any] | None = None
        self._new = asyncio.Event()
        self._when: list[float] = []

    async def run(self) -> None:
        await self._send({"type": "hello", **hello(self.subject)})
        reading, answering = asyncio.create_task(self._read()), asyncio.create_task(self._answer())
        done, left = await asyncio.wait([reading, answering], return_when=asyncio.FIRST_COMPLETED)
        for task in left:
            task.cancel()
        for task in done:
            with suppress(WebSocketDisconnect, RuntimeError):
                task.result()

    async def _read(self) -> None:
        """Take what comes; only the newest waits."""
        while True:
            message = await self.socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text") or ""
            now = time.monotonic()
            self._when = [*(at for at in self._when if now - at < _PER), now]
            if len(self._when) > _MOST or len(text) > MESSAGE:
                await self.socket.close(1008, "too much at once")
                return
            try:
                self._newest = asked(text, self.subject)
            except PeriluneError as error:
                await self._send({"type": "fault", **refusal(error)})
                continue
            self._new.set()

    async def _answer(self) -> None:
        while True:
            await self._new.wait()
            self._new.clear()
            request = self._newest
            assert request is not None, "set before the event"
            flown = await in_thread(self._flown, request)
            await self._send(flown)
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._new.wait(), _REST)
                continue  # something newer came
            if flown["type"] == "flight":
                await self._rested(request)

    async def _rested(self, request: dict[str, Any]) -> None:
        """What takes longer than a frame, as long as nothing newer comes."""
        solution, number = self.answering.last, request["number"]
        assert solution is not None, "of a flight"
        if (known := await in_thread(_quietly, partial(family, solution))) is not None:
            await self._send({"type": "family", "number": number, **known})
        if self.subject.atlas is not None and not self._new.is_set():
            work = partial(slice_of, self.subject, request["values"], request["slice"])
            shown = await in_thread(_quietly, work)
            if shown is not None:
                await self._send({"type": "slice", "number": number, **shown})
        if self._new.is_set():
            return
        proving = asyncio.ensure_future(self.prover.proved(solution))
        newer = asyncio.ensure_future(self._new.wait())
        try:
            await asyncio.wait([proving, newer], return_when=asyncio.FIRST_COMPLETED)
        finally:
            newer.cancel()
            proving.cancel()  # one that has not begun is made for nobody
        if proving.done() and not self._new.is_set():
            with suppress(Exception):
                await self._send({"type": "proof", "number": number, **proving.result()})

    def _flown(self, request: dict[str, Any]) -> dict[str, Any]:
        began = time.perf_counter()
        head = {"number": request["number"], "values": request["values"]}
        try:
            found = self.answering.at(request["values"])
            document = flight(found.solution)
        except PeriluneError as error:
            return {"type": "refusal", **head, **refusal(error), "latency": time.perf_counter() - began}
        source = {"source": found.source, "words": found.words, "solved": found.latency}
        return {"type": "flight", **head, **document, **source, "latency": time.perf_counter() - began}

    async def _send(self, document: dict[str, Any]) -> None:
        await self.socket.send_text(json.dumps(document, allow_nan=False, separators=(",", ":")))


def hello(subject: Subject) -> dict[str, Any]:
    """What a page has to know before anything is asked."""
    problem = subject.problem
    return {
        "title": subject.title,
        "kind": problem.name,
        "mapped": subject.atlas is not None,
        "scenario": bool(subject.text),
        "maximised": problem.maximised or "",
        "knobs": [vars(knob) for knob in subject.knobs],
        "coasts": _coasts() if problem.views.ground is not None and problem.views.ground.coasts else [],
    }


def _coasts() -> list[list[list[float]]]:
    from perilune.report.ground import coastline

    return [line.round(1).tolist() for line in coastline()]


def asked(text: str, subject: Subject) -> dict[str, Any]:
    """A request of a page, looked at: finite numbers for knobs that there are, within twice their ranges.

    Raises
    ------
    PeriluneError
        If it is anything else.
    """
    try:
        said = json.loads(text)
        number, values = int(said["number"]), said["values"]
        found = {str(name): float(value) for name, value in values.items()}
        axes = [str(name) for name in said.get("slice", [])][:2]
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        raise PeriluneError("a message that no page sends", expected="number, values, slice") from None
    known = {knob.name: knob for knob in subject.knobs}
    for name, value in found.items():
        if name not in known:
            raise PeriluneError("there is no such parameter to move", got=name[:60])
        knob = known[name]
        reach = knob.high - knob.low
        if not (math.isfinite(value) and knob.low - reach <= value <= knob.high + reach):
            raise PeriluneError(f"{knob.key} is far from its range", got=str(value)[:40])
    return {"number": number, "values": found, "slice": [name for name in axes if name in known and known[name].mapped]}


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def figures(subject: Subject, values: Mapping[str, float]) -> bytes:
    """All figures of the flight at values of the knobs, as vector graphics in one archive.

    Raises
    ------
    PeriluneError
        If there is no flight.
    """
    from perilune.report.figures import drawings

    solution, made = Answering(subject.problem, subject.atlas, subject.known).at(values).solution, BytesIO()
    with ZipFile(made, "w") as archive:
        for name, draw in drawings(solution).items():
            drawn = BytesIO()
            draw().savefig(drawn, format="svg")
            archive.writestr(f"{name}.svg", drawn.getvalue())
    return made.getvalue()


def page_files() -> dict[str, bytes]:
    """All that the page is made of, by name."""
    found, left = dict[str, bytes](), [("", files("perilune.app") / "page")]
    while left:
        before, folder = left.pop()
        for entry in folder.iterdir():
            if entry.is_dir():
                left.append((f"{before}{entry.name}/", entry))
            else:
                found[before + entry.name] = entry.read_bytes()
    return found


def _quietly(work: Any) -> Any:
    """What comes of it; None where the physics or the map say no."""
    try:
        return work()
    except PeriluneError:
        return None


async def _nothing(request: Request, error: Any) -> Response:
    return PlainTextResponse("there is nothing here", status_code=404, headers=_HEADERS)
