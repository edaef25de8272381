"""Connection to one open page: its requests, the messages to it, and the computations for it.

The newest values are answered and older ones dropped; at rest the flight is compared with a cold start, and proved.
"""

from __future__ import annotations

import asyncio
import json
import secrets
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, TypeVar

from starlette.websockets import WebSocket, WebSocketDisconnect

from perilune import PeriluneError, Solution
from perilune.app.answers import Answering, FlightAnswer, NoNearbyFlight, cost_along_free_parameter
from perilune.app.background import compare_with_cold_start, prove_timed, solve_without_guess
from perilune.app.messages import extremals_message, flight_message, opening_message, refusal_message
from perilune.app.slices import Slices
from perilune.app.source import Subject
from perilune.app.worker import SupersededWork, WorkerKilled, WorkerProcess, in_thread
from perilune.core import Iteration, Watch

MESSAGE = 16_384  # bytes that a message may have
COMPARING = 60.0  # s for the search of a better flight without an initial guess
_MOST, _PER = 240, 2.0  # messages in so many seconds
_REST = 0.35  # s without a new value until what takes longer is done
_TELL, _SLOW = 1.0, 1.0  # s until it is said that a flight takes its time; until it makes way for newer values
_FIRST = 120.0  # s of CPU, until the first flight does, from which newer values are followed
_FAR = 100.0  # times the largest value of a slider that may be typed
_T = TypeVar("_T")


class Shown(NamedTuple):
    """Flight on a page, with the number and values of its request; None without a flight."""

    number: int
    values: dict[str, float]
    solution: Solution | None


class Client:
    """Answers one page.

    Parameters
    ----------
    subject, socket, beside
        What is explored, the page, and the process for what takes long.
    """

    def __init__(self, subject: Subject, socket: WebSocket, beside: WorkerProcess) -> None:
        self.subject, self.socket, self.beside = subject, socket, beside
        self.name = secrets.token_urlsafe(9)
        self.answering = Answering(subject.problem, subject.atlas, subject.known)
        self.slices = Slices(subject)
        self.shown = Shown(-1, {}, None)
        self._newest: dict[str, Any] | None = None
        self._new = asyncio.Event()
        self._when: list[float] = []
        self._doing, self._since, self._gone = "", 0.0, False  # what is done, since when

    async def run(self) -> None:
        """Until it has gone."""
        await self._send({"type": "hello", "client": self.name, **opening_message(self.subject)})
        reading, answering = asyncio.create_task(self._read()), asyncio.create_task(self._answer())
        try:
            done, left = await asyncio.wait([reading, answering], return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._gone = True
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
                await self.socket.close(1008, "too many messages at once")
                return
            try:
                self._newest = parse_request(text, self.subject)
            except PeriluneError as error:
                await self._send({"type": "fault", **refusal_message(error)})
                continue
            self._new.set()

    async def _answer(self) -> None:
        while True:
            await self._new.wait()
            self._new.clear()
            request = self._newest
            assert request is not None, "set before the event"
            found = await self._telling(in_thread(self._flown, request), request)
            if found is None:
                continue  # something newer came
            await self._show(request, found)
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._new.wait(), _REST)
                continue
            await self._rested(request, found)

    async def _telling(self, work: Awaitable[_T], request: dict[str, Any]) -> _T:
        """Say what is done as long as it is done."""
        doing, self._since = asyncio.ensure_future(work), time.monotonic()
        try:
            while not (await asyncio.wait([doing], timeout=_TELL))[0]:
                said = {"words": self._doing, "took": time.monotonic() - self._since}
                await self._send({"type": "progress", "number": request["number"], **said})
            return doing.result()
        finally:
            doing.cancel()  # nobody waits for it if the page has gone

    def _flown(self, request: dict[str, Any]) -> FlightAnswer | PeriluneError | None:
        """Return, in a thread, the flight at the newest values, its error, or None if newer values have come."""
        self._doing = "stating the problem"

        def watching(clock: Callable[[], float], longest: float) -> Watch:
            end = clock() + longest

            def watch(event: Iteration | str) -> None:
                if isinstance(event, str):
                    self._doing = event
                if self._gone or (self._new.is_set() and clock() > end):
                    raise SupersededWork

            return watch

        try:
            watches = watching(time.monotonic, _SLOW), watching(time.thread_time, _FIRST)
            return self.answering.at(request["values"], *watches)
        except SupersededWork:
            return None
        except Exception as error:
            return page_error(error)

    async def _show(self, request: dict[str, Any], found: FlightAnswer | PeriluneError) -> None:
        number, values = request["number"], request["values"]
        head = {"number": number, "values": values}
        if isinstance(found, FlightAnswer):
            began = time.perf_counter()
            try:
                document = await in_thread(flight_message, found.solution)
            except Exception as error:
                found = page_error(error)
            else:
                latency = found.latency + time.perf_counter() - began
                more = {"source": found.source, "words": found.words, "solved": found.latency, "latency": latency}
                self.shown = Shown(number, values, found.solution)
                await self._send({"type": "flight", **head, **document, **more})
                return
        self.shown = Shown(number, values, None)
        await self._send({"type": "refusal", **head, **refusal_message(found)})

    # -- at rest --------------------------------------------------------------------------------------------------

    async def _rested(self, request: dict[str, Any], found: FlightAnswer | PeriluneError) -> None:
        """Compute what takes longer than a frame, until newer values come."""
        number, killed, told = request["number"], self.beside.killed, ""
        try:
            if isinstance(found, FlightAnswer) and self.subject.atlas is not None:
                drawn = partial(self.slices.at, request["values"], request["slice"], lambda: not self._stale)
                await self._beside_it("slice", request, "drawing the map", drawn)
            better = None if self._new.is_set() else await self._compared(request, found)
            if better is not None:
                words = "following the family of extremals"
                await self._beside_it("family", request, words, partial(cost_along_free_parameter, better))
                proof = await self._done(request, "proving", None, prove_timed, better)
                if proof is not None:
                    if self.shown.number == number:  # what is taken away says it too
                        self.shown = self.shown._replace(solution=proof.of(better))
                    await self._send({"type": "proof", "number": number, **proof.document})
        except WebSocketDisconnect:
            raise
        except Exception as error:
            why = page_error(error)
            told = f"{why.what} {why.got}".strip()
        if not told and self.beside.killed > killed:
            told = "the process that compares and proves was killed and restarted"
        if told:  # one line: what failed, before what went on all the same
            await self._send({"type": "notice", "words": told})

    async def _beside_it(
        self, kind: str, request: dict[str, Any], words: str, work: Callable[[], dict[str, Any] | None]
    ) -> None:
        """Compute and send what is shown next to a flight, unless newer values come."""
        if self._stale:
            return
        self._doing = words
        known = await self._telling(self._unless_newer(in_thread(_answer_or_none, work)), request)
        if known is not None:
            await self._send({"type": kind, "number": request["number"], **known})

    async def _compared(self, request: dict[str, Any], found: FlightAnswer | PeriluneError) -> Solution | None:
        """The flight that is to be proved: the one shown, or one found without a guess, which is then shown."""
        if isinstance(found, FlightAnswer) and found.source != "neighbour":
            return found.solution
        if isinstance(found, PeriluneError) and not isinstance(found, NoNearbyFlight):
            return None
        began, words = (
            time.perf_counter(),
            f"searching without an initial guess for a better one, for {COMPARING:g} s at most",
        )
        try:
            if isinstance(found, NoNearbyFlight):
                problem = self.answering.problem_at(request["values"])
                better = await self._done(request, words, COMPARING, solve_without_guess, problem)
            else:
                better = await self._done(request, words, COMPARING, compare_with_cold_start, found.solution)
        except WorkerKilled:
            raise
        except (TimeoutError, PeriluneError) as error:
            if isinstance(found, NoNearbyFlight):
                late = PeriluneError(
                    "there is no extremal near the previous flight",
                    got=f"none in {COMPARING:g} s without an initial guess",
                )
                await self._show(request, error if isinstance(error, PeriluneError) else late)
                return None
            why = f"within {COMPARING:g} s" if isinstance(error, TimeoutError) else "without an initial guess"
            words = f"not compared: no other was found {why}"
            await self._send({"type": "compared", "number": request["number"], "words": words})
            return found.solution
        if better is None:
            return None
        if better.jumped:
            took = time.perf_counter() - began
            self.answering.last = better.solution
            jump = FlightAnswer(solution=better.solution, source="jumped", words=better.words, latency=took)
            await self._show(request, jump)
        if better.family is not None:
            await self._send({"type": "family", "number": request["number"], **better.family})
        if better.jumped:
            return better.solution
        assert isinstance(found, FlightAnswer), "the flight that jumped is no longer shown"
        known = replace(found.solution, extremals=better.solution.extremals)  # as it was found, with its family
        self.shown = self.shown._replace(solution=known)
        await self._send(
            {"type": "compared", "number": request["number"], "words": better.words, **extremals_message(known)}
        )
        return known

    async def _done(
        self, request: dict[str, Any], words: str, limit: float | None, work: Callable[..., _T], *arguments: Any
    ) -> _T | None:
        """Return the result of work in the process that all pages share, and report progress meanwhile.

        Returns None, and drops the work, if newer values come before. TimeoutError after `limit` seconds of work.
        """
        begun, self._doing = asyncio.Event(), "waiting for another page's comparison or proof"

        def begins() -> None:
            self._doing, self._since = words, time.monotonic()
            begun.set()

        return await self._telling(
            self._unless_newer(self.beside.done(work, *arguments, begun=begins), begun, limit), request
        )

    @property
    def _stale(self) -> bool:
        """Return True if nobody waits for the present computation."""
        return self._gone or self._new.is_set()

    async def _unless_newer(
        self, work: Awaitable[_T], begun: asyncio.Event | None = None, limit: float | None = None
    ) -> _T | None:
        doing, newer = asyncio.ensure_future(work), asyncio.ensure_future(self._new.wait())
        begins = asyncio.ensure_future(begun.wait() if begun is not None else asyncio.sleep(0))
        try:
            await asyncio.wait([doing, newer, begins], return_when=asyncio.FIRST_COMPLETED)
            await asyncio.wait([doing, newer], timeout=limit, return_when=asyncio.FIRST_COMPLETED)
            if self._new.is_set():
                return None
            if not doing.done():
                raise TimeoutError
            return doing.result()
        finally:
            newer.cancel()
            begins.cancel()
            doing.cancel()

    async def _send(self, document: dict[str, Any]) -> None:
        await self.socket.send_text(json.dumps(document, allow_nan=False, separators=(",", ":")))


def page_error(error: Exception) -> PeriluneError:
    """Return an error for a page; one that is no refusal is a fault of the program."""
    if isinstance(error, PeriluneError):
        return error
    got = f"{type(error).__name__}: {str(error)[:300]}"
    return PeriluneError("perilune failed; this is a fault of the program, not of your input", got=got)


def parse_request(text: str, subject: Subject) -> dict[str, Any]:
    """Parse and check a request of a page: finite numbers of ordinary size for existing knobs.

    Parameters
    ----------
    text
        JSON text from the page.
    subject
        Subject of the explorer, with its knobs.

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
        most = _FAR * max(abs(knob.low), abs(knob.high))
        if not abs(value) <= most:  # nor is what is no number
            got, expected = knob.shown(value), knob.shown(most)
            raise PeriluneError(f"{knob.key} is far outside its range", got=got, expected=f"at most {expected}")
    return {"number": number, "values": found, "slice": [name for name in axes if name in known and known[name].mapped]}


def _answer_or_none(work: Any) -> Any:
    """Return the result of work; None if the physics or the map refuse it."""
    try:
        return work()
    except PeriluneError:
        return None
