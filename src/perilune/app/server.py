"""Web server of the page: on this machine only, for holders of the address that was printed.

It listens on 127.0.0.1, answers below a random token, and looks at Host and Origin, so that no other page that is open
in the same browser reaches it. What it hands out is read into memory when it starts: nothing that a browser sends
becomes a path. What a page takes away is the flight that it shows.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Mapping
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from perilune import PeriluneError
from perilune.app.client import Client
from perilune.app.downloads import TAKEN
from perilune.app.files import page_files
from perilune.app.source import Subject
from perilune.app.worker import WorkerProcess, in_thread

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
    """Server of one subject.

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
        self._open, self._beside = dict[str, Client](), WorkerProcess()
        self._taking = asyncio.Lock()  # figures are drawn one after the other
        self.app = Starlette(
            routes=[
                WebSocketRoute("/{token}/live", self._live),
                Route("/{token}/{name:path}", self._file, methods=["GET"]),
            ],
            exception_handlers={404: _nothing, 405: _nothing},
        )
        self.app.router.redirect_slashes = False  # who does not know the token is told nothing

    def close(self) -> None:
        """End all computations."""
        self._beside.close()

    # -- files ----------------------------------------------------------------------------------------------------

    async def _file(self, request: Request) -> Response:
        name = request.path_params["name"] or "index.html"
        if not self._known(request.path_params["token"], request.headers):
            return await _nothing(request, None)
        if name in TAKEN:
            return await self._taken(name, request.query_params)
        if name not in self._files:
            return await _nothing(request, None)
        kind = _KINDS.get(name[name.rfind(".") :], "text/plain")
        return Response(self._files[name], media_type=f"{kind}; charset=utf-8", headers=_HEADERS)

    async def _taken(self, name: str, query: Mapping[str, str]) -> Response:
        """Return a file of the flight that a page shows, by the file's name and the number of the request."""
        client = self._open.get(query.get("client", ""))
        if client is None or str(client.shown.number) != query.get("number"):
            return PlainTextResponse("this flight is no longer shown: ask again", status_code=409, headers=_HEADERS)
        try:
            async with self._taking:
                content = await in_thread(TAKEN[name], self.subject, client.shown)
        except PeriluneError as error:
            return PlainTextResponse(str(error), status_code=400, headers=_HEADERS)
        return Response(content, media_type="application/octet-stream", headers=_HEADERS)

    def _known(self, token: str, headers: Mapping[str, str]) -> bool:
        origin = headers.get("origin")
        return (
            secrets.compare_digest(token.encode(), self.token.encode())
            and headers.get("host") in self._hosts
            and (origin is None or origin in {f"http://{host}" for host in self._hosts})
        )

    # -- live -----------------------------------------------------------------------------------------------------

    async def _live(self, socket: WebSocket) -> None:
        headers = socket.headers
        if not self._known(socket.path_params["token"], headers) or "origin" not in headers:
            await socket.close(1008)
            return
        if len(self._open) >= _CLIENTS:
            await socket.close(1013, "too many pages are open")
            return
        client = Client(self.subject, socket, self._beside)
        self._open[client.name] = client
        try:
            await socket.accept()
            await client.run()
        finally:
            del self._open[client.name]


async def _nothing(request: Request, error: Any) -> Response:
    return PlainTextResponse("there is nothing here", status_code=404, headers=_HEADERS)
