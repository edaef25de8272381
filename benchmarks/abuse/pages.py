"""Malformed requests to the explorer. Nobody may be let in, and who is served is served on."""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from abused import Fault, Material, demand, falsified, kill, started
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from perilune.app.server import page_files

_BATCH = 60  # requests to one server
_SAME = 1e-9


def requests(rng: np.random.Generator, material: Material, at: Path) -> str:
    """A batch of them to one server that shows an atlas."""
    with _served(material.atlas) as (address, process):
        _asks(address, material, 0)
        taken = 0
        for number in range(_BATCH):
            taken += (_raw if rng.random() < 0.6 else _message)(rng, address)
            if number % 20 == 19:
                _asks(address, material, number % len(material.points))
        demand(process.poll() is None, "the server has ended")
        process.send_signal(2)
        _, err = process.communicate(timeout=30)
        demand("Traceback" not in err, err[-500:])
        demand(process.returncode == 0, f"the server ends with {process.returncode}")
    return f"{_BATCH} requests" if not taken else f"{_BATCH} requests, answered in part"


@contextmanager
def _served(atlas: Path) -> Iterator[tuple[str, Any]]:
    process = started("explore", "--no-open", atlas)
    try:
        assert process.stderr is not None
        said = ""
        while not (found := re.search(r"http://\S+", said)):
            line = process.stderr.readline()
            demand(bool(line), f"the server does not start: {said}")
            said += line
        yield found.group(), process
    finally:
        kill(process)


def _live(address: str, **more: Any) -> ClientConnection:
    origin = Origin("http://" + urlsplit(address).netloc)
    return connect(address.replace("http", "ws") + "live", origin=origin, proxy=None, open_timeout=20, **more)


def _asks(address: str, material: Material, number: int) -> None:
    """A page as it should be gets the flight of a point of the atlas."""
    names = ("vehicle_thrust", "retro_specific_impulse")
    values = dict(zip(names, map(float, material.points[number]), strict=True))
    try:
        with _live(address) as page:
            page.send(json.dumps({"number": 1, "values": values}))
            while (said := json.loads(page.recv(timeout=30)))["type"] != "flight":
                pass
    except (WebSocketException, OSError, TimeoutError) as error:
        raise Fault(f"a page is served no longer: {error!r}") from None
    right = material.objectives[number]
    demand(abs(said["objective"] - right) <= _SAME * abs(right), f"J {said['objective']} for {right}")


def _raw(rng: np.random.Generator, address: str) -> bool:
    """Bytes at its port. With the token, host and origin as they are: only what the page is made of is handed out."""
    parts = urlsplit(address)
    token, files = parts.path.strip("/"), page_files()
    names = [*files, "live", "scenario.toml", "../../../etc/passwd", "..%2f..%2fsetup.py", "%00", "a" * 9000]
    known, host, origin = rng.random(3) < 0.5
    name = names[rng.integers(len(names))]
    said = token if known else ("x" * len(token), "", token[:-1], token.swapcase(), "%2e%2e")[rng.integers(5)]
    where = parts.netloc if host else ("evil.example", "127.0.0.1", f"evil.example:{parts.port}", "")[rng.integers(4)]
    came = f"http://{parts.netloc}" if origin else ("http://evil.example", "null", "file://")[rng.integers(3)]
    head = f"GET /{said}/{name} HTTP/1.1\r\nHost: {where}\r\nOrigin: {came}\r\n"
    if rng.random() < 0.4:
        head += "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
        head += "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    content, changed = (head + "\r\n").encode("latin-1"), bool(rng.random() < 0.5)
    if changed:
        content = falsified(rng, content)
    answer = _exchanged(parts.port or 0, content)
    status = answer[9:12]
    if status in (b"200", b"101"):
        body = answer.partition(b"\r\n\r\n")[2]
        as_is = (known and host and origin) or token.encode() in content
        demand(as_is, f"let in: {content[:300]!r}")
        demand(
            status == b"101" or not body or any(map(body.startswith, files.values())), f"handed out: {content[:300]!r}"
        )
        if not changed:
            demand(bool(known and host and origin), f"let in by another host or origin: {content[:300]!r}")
    return status in (b"200", b"101")


def _exchanged(port: int, content: bytes) -> bytes:
    """What is answered, until it closes, falls silent, or has sent enough."""
    answer = b""
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=5) as line:
        line.settimeout(0.3)
        line.sendall(content)
        while len(answer) < 5_000_000 and (piece := line.recv(65536)):
            answer += piece
    return answer


def _message(rng: np.random.Generator, address: str) -> bool:
    """Messages of a page that has the address: answered, refused in words, or the page is closed."""
    values = {"vehicle_thrust": 440.0, "retro_specific_impulse": 300.0}
    asked = json.dumps({"number": 1, "values": values, "slice": ["vehicle_thrust"], "family": True}).encode()
    odd = [b"{" * 9000, b"[]", b"null", b"x" * 20_000, json.dumps({"number": 1e308, "values": {"a" * 999: 1}}).encode()]
    with suppress(WebSocketException, OSError, TimeoutError), _live(address) as page:
        for _ in range(rng.integers(1, 12)):
            content = falsified(rng, asked) if rng.random() < 0.7 else odd[rng.integers(len(odd))]
            page.send(content if rng.random() < 0.2 else content.decode("utf-8", "replace"))
        said = json.loads(page.recv(timeout=5))
        demand(isinstance(said, dict) and "type" in said, f"no answer of ours: {said!r}"[:300])
        return True
    return False
