"""The server of the explorer: what it answers, and whom it does not."""

from __future__ import annotations

import asyncio
import csv
import io
import json
import math
import re
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path
from threading import Event
from typing import Any, cast
from urllib.parse import urlsplit

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the explorer needs starlette: pip install 'perilune[explore]'")

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

import perilune.app.answers
from explored import ROOT, atlas_of_the_jump, served
from perilune import PeriluneError, Problem, Solution, save
from perilune.app.answers import Answering, meets_path_constraints
from perilune.app.background import compare_with_cold_start, prove_timed
from perilune.app.client import MESSAGE, Client, parse_request
from perilune.app.files import page_files
from perilune.app.messages import ALL_DIGITS, flight_message, opening_message, round_to_digits
from perilune.app.slices import Slices
from perilune.app.source import Subject, subject_of
from perilune.app.static_page import build_static_page
from perilune.app.worker import SupersededWork, WorkerKilled, WorkerProcess, in_thread
from perilune.cli.commands import run_command
from perilune.core import InfeasibleError, NotConvergedError, Watch, ignore_events
from perilune.problem import preflight, refuse_impossible
from perilune.scenario import load_file, load_text
from perilune.solve import solve

ISP = "retro_specific_impulse"


@pytest.fixture(scope="module")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    return subject_of(atlas_of_the_jump(tmp_path_factory.mktemp("explore") / "map"))


@pytest.fixture(scope="module")
def address(subject: Subject) -> Iterator[str]:
    assert subject.atlas is not None
    with served(str(subject.atlas.store.directory)) as found:
        yield found


def _socket(address: str, **more: Any) -> ClientConnection:
    origin = more.pop("origin", "http://" + urlsplit(address).netloc)
    return connect(address.replace("http", "ws") + "live", origin=origin, proxy=None, **more)


def _told(page: ClientConnection, kind: str) -> dict[str, Any]:
    while True:
        said = json.loads(page.recv(timeout=30))
        if said["type"] == kind:
            return said


def _status(url: str, data: bytes | None = None, **headers: str) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, data=data, headers=headers)) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def test_a_page_is_told_what_moves_and_the_flight_that_follows(address: str) -> None:
    """Across the jump the retro burn is none, or hundreds of m/s; at rest family, slice and proof follow."""
    with _socket(address) as page:
        said = _told(page, "hello")
        assert {knob["key"] for knob in said["knobs"] if knob["mapped"]} == {"retro.specific_impulse", "vehicle.thrust"}
        burns = []
        for number, isp in enumerate((277.0, 279.0)):
            page.send(json.dumps({"number": number, "values": {ISP: isp}, "slice": [ISP]}))
            found = _told(page, "flight")
            assert found["number"] == number and found["source"] == "map" and 0 < found["latency"] < 10
            assert found["phases"][0]["way"]["kind"] == "limb" and "H" in found["phases"][0]["columns"]
            burns.append(found["free"]["retro_delta_v"])
        assert burns[0] == 0.0 and burns[1] > 500.0
        assert len(_told(page, "slice")["objective"]) == 61
        family = _told(page, "family")
        assert min(family["objective"]) == pytest.approx(found["objective"], rel=1e-9)
        proof = _told(page, "proof")
        assert (proof["outcome"], proof["level"]) == ("PROVED", 3)
        with urllib.request.urlopen(f"{address}flight.csv?client={said['client']}&number=1") as answer:
            assert answer.read().decode().rstrip().endswith(",level 3: locally optimal")


class _Page:
    """A page without a browser or a server: asks by `put`, and keeps what it is told."""

    def __init__(self) -> None:
        self._asked, self.told = asyncio.Queue[dict[str, str]](), list[dict[str, Any]]()

    def put(self, **request: Any) -> None:
        self.told.clear()
        self._asked.put_nowait({"type": "websocket.receive", "text": json.dumps(request)})

    async def receive(self) -> dict[str, str]:
        return await self._asked.get()

    async def send_text(self, text: str) -> None:
        self.told.append(json.loads(text))

    async def until(self, kind: str) -> dict[str, Any]:
        while not (found := [said for said in self.told if said["type"] == kind]):
            await asyncio.sleep(0.01)
        return found[0]


def _told_to(subject: Subject, story: Callable[[_Page], Awaitable[None]]) -> None:
    """A story of a page of a subject, to its end."""

    async def live() -> None:
        page, beside = _Page(), WorkerProcess()
        running = asyncio.ensure_future(Client(subject, cast("Any", page), beside).run())
        try:
            await asyncio.wait_for(story(page), 60.0)
        finally:
            running.cancel()
            beside.close()

    asyncio.run(live())


def test_without_an_atlas_a_flight_jumps_when_it_is_compared() -> None:
    """Past 277.867 s it stays on its family; at rest the best is shown, and proved by whatever process there is."""

    async def story(page: _Page) -> None:
        flights = list[dict[str, Any]]()
        for number, isp in enumerate((273.0, 277.0, 279.0, 283.0)):
            page.put(number=number, values={ISP: isp})
            flights.append(await page.until("flight"))
        assert [found["source"] for found in flights] == ["nothing", *3 * ["neighbour"]]
        assert all(found["free"]["retro_delta_v"] == 0.0 for found in flights)
        proof = await page.until("proof")
        assert (proof["number"], proof["outcome"]) == (3, "PROVED")
        jumped = next(said for said in page.told if said["type"] == "flight" and said["source"] == "jumped")
        assert jumped["number"] == 3 and jumped["free"]["retro_delta_v"] > 500.0
        before, after = (-found["objective"] for found in (flights[-1], jumped))
        assert after > before + 0.1 and f"{after:.6g} kg" in jumped["words"] and f"{before:.6g} kg" in jumped["words"]
        roots = [(root["free"]["retro_delta_v"], root["objective"]) for root in jumped["roots"]]
        assert len(roots) == len(jumped["extremals"]) == 3 and -before in [pytest.approx(J, rel=1e-9) for _, J in roots]
        reached = (await page.until("family"))["values"]
        assert reached[0] <= min(dv for dv, _ in roots) and reached[-1] > max(dv for dv, _ in roots)
        for child in active_children():
            child.kill()
        page.put(number=4, values={ISP: 284.0})
        assert (await page.until("compared"))["words"] == "best of 3 found"
        assert (await page.until("family"))["values"][0] == 0.0
        assert (await page.until("proof"))["outcome"] == "PROVED"
        assert "killed" in (await page.until("notice"))["words"]

    _told_to(subject_of(None), story)


def test_a_lander_that_is_too_weak_comes_alive_where_its_slider_makes_it_strong_enough() -> None:
    subject = subject_of(ROOT / "examples" / "precision_landing.toml", ["vehicle.thrust=2000 N"])
    thrust = next(knob for knob in subject.knobs if knob.name == "vehicle_thrust")

    async def story(page: _Page) -> None:
        page.put(number=0, values={})
        said = await page.until("refusal")
        assert said["impossible"] and "cannot stop the descent" in said["what"]
        page.put(number=1, values={"vehicle_thrust": thrust.high})
        assert (await page.until("flight"))["number"] == 1

    _told_to(subject, story)


def test_only_the_newest_values_are_answered(address: str) -> None:
    with _socket(address) as page:
        for number in range(40):
            page.send(json.dumps({"number": number, "values": {ISP: 273.0 + 0.25 * number}}))
        numbers = []
        while not numbers or numbers[-1] != 39:
            numbers.append(_told(page, "flight")["number"])
        assert len(numbers) < 40 and numbers == sorted(numbers)


def test_what_is_no_answer_is_said_in_words(address: str) -> None:
    with _socket(address) as page:
        for text, words in (
            ("[1, 2", "no page sends"),
            ('{"number": 1, "values": {"nothing": 1}}', "no such parameter"),
            ('{"number": 1, "values": {"vehicle_thrust": 1e9}}', "far outside its range"),
            ('{"number": 1, "values": {"vehicle_thrust": NaN}}', "far outside its range"),
            ('{"number": Infinity, "values": {}}', "no page sends"),
            (b"{}", "no page sends"),
        ):
            page.send(text)
            assert words in _told(page, "fault")["what"]


@pytest.mark.parametrize("origin", ["http://evil.example", "https://127.0.0.1", None])
def test_other_pages_do_not_reach_it(address: str, origin: str | None) -> None:
    with pytest.raises((InvalidStatus, ConnectionClosed)), _socket(address, origin=origin) as page:
        page.recv(timeout=5)


def test_nothing_is_handed_out_without_the_token_or_by_another_name(address: str) -> None:
    parts = urlsplit(address)
    root = f"http://{parts.netloc}"
    assert _status(address) == 200
    assert _status(address, Host="evil.example") == 404
    for origin in ("http://evil.example", parts.netloc, f"https://{parts.netloc}"):
        assert _status(address, Origin=origin) == 404
    assert _status(f"{root}/guess", Host="evil.example") == 404  # and no other address is named
    assert _status(f"{root}/guess/x", data=b"", Host="evil.example") == 404
    for path in (
        "/",
        "/x/",
        "/x/app.js",
        parts.path + "../server.py",
        parts.path + "%2e%2e/server.py",
        parts.path + "vendor",
    ):
        assert _status(root + path) == 404, path
    with urllib.request.urlopen(address) as answer:
        assert answer.headers["Content-Security-Policy"].startswith("default-src 'self'")
    with pytest.raises(OSError), socket.create_connection((socket.gethostbyname(socket.gethostname()), parts.port), 1):
        if socket.gethostbyname(socket.gethostname()).startswith("127."):
            raise OSError("this machine has no other address")


def test_what_is_shown_is_handed_out_and_nothing_else(address: str) -> None:
    """Figures, table and scenario are of the very flight of a page, which names it by the number it was told."""
    with _socket(address) as page:
        client = _told(page, "hello")["client"]
        page.send(json.dumps({"number": 7, "values": {ISP: 279.0}}))
        found = _told(page, "flight")
        query = f"?client={client}&number=7"
        with urllib.request.urlopen(address + "figures.zip" + query) as answer:
            names = zipfile.ZipFile(io.BytesIO(answer.read())).namelist()
        assert len(names) > 3 and all(name.endswith(".svg") for name in names)
        with urllib.request.urlopen(address + "flight.csv" + query) as answer:
            head, *_, last = csv.reader(io.TextIOWrapper(answer))
        landed = float(last[head.index("m [kg]")])
        assert landed == pytest.approx(found["results"]["landed_mass"]["value"], rel=1e-12)
        assert _status(address + f"flight.csv?client={client}&number=6") == 409
        assert _status(address + "flight.csv?client=nobody&number=7") == 409
        assert _status(address + "scenario.toml" + query) == 400  # an atlas has none


def test_too_much_at_once_ends_the_page(address: str) -> None:
    with pytest.raises(ConnectionClosed), _socket(address) as page:
        page.send("x" * (MESSAGE + 1))
        while True:
            page.recv(timeout=5)
    with pytest.raises(ConnectionClosed), _socket(address) as page:
        for number in range(600):
            page.send(json.dumps({"number": number, "values": {}}))
        while True:
            page.recv(timeout=5)


def test_nothing_outlives_it(subject: Subject) -> None:
    """Not the process of proofs when it is killed; and a long computation does not hold up its end."""
    assert subject.atlas is not None
    command = [sys.executable, "-m", "perilune", "explore", "--no-open", str(subject.atlas.store.directory)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        address = next(line.strip() for line in process.stderr if line.startswith("http"))
        with _socket(address) as page:
            page.send(json.dumps({"number": 1, "values": {}}))
            _told(page, "proof")
            process.kill()
        process.communicate(timeout=10)  # which ends when nobody is left who could write
    work = "import asyncio, time; from perilune.app.worker import in_thread"
    run = "asyncio.run(asyncio.wait_for(in_thread(time.sleep, 60), 0.1))"
    with pytest.raises(subprocess.CalledProcessError):  # by the timeout inside, not the one outside
        subprocess.run([sys.executable, "-c", f"{work}; {run}"], check=True, timeout=20, capture_output=True)


def test_of_the_map_is_drawn_what_does_not_take_long_and_nothing_twice(
    subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That of a return takes ten milliseconds a point: 61 by 61 of them kept the proof waiting for 46 s of CPU."""
    monkeypatch.setattr("perilune.app.slices._LONGEST", math.inf)
    slices, both = Slices(subject), [ISP, "vehicle_thrust"]
    shown = slices.at({}, both)
    assert shown is not None and [len(values) for values in shown["along"]] == [61, 61]
    assert slices.at({ISP: 280.0}, both) is shown  # a move along its axes changes nothing
    assert slices.at({"vehicle_thrust": 430.0}, [ISP], lambda: False) is None  # nobody waits for it
    assert slices.at({"vehicle_mass": 301.0}, both) is None  # the map is of another
    monkeypatch.setattr("perilune.app.slices._LONGEST", 0.0)
    rough = Slices(subject).at({}, both)
    assert rough is not None and [len(values) for values in rough["along"]] == [16, 16]


def test_newer_values_do_not_wait_until_the_map_is_drawn(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    ended = Event()

    async def story(page: _Page) -> None:
        page.put(number=0, values={})
        assert (await page.until("progress"))["words"] == "drawing the map"
        page.put(number=1, values={ISP: 280.0})
        assert (await page.until("flight"))["number"] == 1
        ended.set()

    monkeypatch.setattr(Slices, "at", lambda *_: ended.wait(30.0) and None)
    _told_to(subject, story)


def test_what_is_computed_for_a_page_that_has_gone_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = Event()

    def without_end(self: Answering, values: Any, watch: Watch, patient: Watch) -> None:
        try:
            while True:
                time.sleep(0.02)
                watch("deriving")
        finally:
            ended.set()

    async def story(page: _Page) -> None:
        page.put(number=0, values={})
        await page.until("progress")

    monkeypatch.setattr(Answering, "at", without_end)
    _told_to(subject_of(None), story)
    assert ended.wait(5.0)


def test_newer_values_do_not_end_the_first_flight_from_which_they_are_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    """At theirs nothing may be found for minutes, and each of them would begin to look for it anew."""
    solve, nudged = perilune.app.answers.solve, Event()

    def slow(asked: Problem, *, guess: Solution | None = None, callback: Watch, verify: int) -> Solution:
        if guess is None:  # and nothing is at other values
            assert asked.given["vehicle_thrust"].value == 440.0 and nudged.wait(30.0)
        callback("looking for it")
        return solve(asked, guess=guess, verify=verify, callback=callback)

    async def story(page: _Page) -> None:
        first = {knob.name: knob.value for knob in subject.knobs}  # as a page says it: all of them, as numbers
        page.put(number=0, values=first)
        await page.until("progress")
        page.put(number=1, values={**first, "vehicle_thrust": 445.0})
        await asyncio.sleep(0.1)  # until it is read
        nudged.set()
        while len(flights := [said for said in page.told if said["type"] in ("flight", "refusal")]) < 2:
            await asyncio.sleep(0.01)
        assert [(said["number"], said.get("source")) for said in flights] == [(0, "nothing"), (1, "neighbour")]

    subject = subject_of(None)
    monkeypatch.setattr("perilune.app.answers.solve", slow)
    for name in ("_TELL", "_SLOW"):
        monkeypatch.setattr(f"perilune.app.client.{name}", 0.01)
    _told_to(subject, story)


def test_it_is_said_when_nothing_more_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """And not that the process was begun anew, which is true of the next flight."""

    async def killed(self: WorkerProcess, *work: Any, **more: Any) -> None:
        self.killed += 1
        raise WorkerKilled("killed whenever it was begun")

    async def story(page: _Page) -> None:
        page.put(number=0, values={})
        await page.until("notice")
        await asyncio.sleep(0.1)
        assert [said["words"] for said in page.told if said["type"] == "notice"] == ["killed whenever it was begun"]

    monkeypatch.setattr(WorkerProcess, "done", killed)
    _told_to(subject_of(None), story)


def test_what_waits_for_another_page_says_so_and_its_time_has_not_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    async def late(self: WorkerProcess, work: Any, *arguments: Any, begun: Callable[[], None]) -> Any:
        await asyncio.sleep(1.3)  # more than there is for the work
        begun()
        return await in_thread(work, *arguments, ignore_events)

    async def story(page: _Page) -> None:
        page.put(number=0, values={})
        await page.until("flight")
        page.put(number=1, values={ISP: 309.0})
        assert (await page.until("compared"))["words"] == "best of 3 found"
        assert any(said["type"] == "progress" and "another page" in said["words"] for said in page.told)

    monkeypatch.setattr(WorkerProcess, "done", late)
    monkeypatch.setattr("perilune.app.client.COMPARING", 1.0)
    _told_to(subject_of(None), story)


def test_a_scenario_is_explored_from_neighbour_to_neighbour_and_handed_out_changed() -> None:
    subject = subject_of(ROOT / "examples" / "hybrid_lander.toml", ["vehicle.thrust=450 N"])
    assert not any(knob["mapped"] for knob in opening_message(subject)["knobs"])
    text = subject.scenario({"vehicle_thrust": 470.0})
    assert 'thrust = "470 N"' in text
    template = subject_of(None)  # of which the body is known by its name
    values = {"body_radius": 1.7e6 + 1 / 3, "vehicle_thrust": 1300 / 3, "orbit_perilune_altitude": 14e3 + 1 / 7}
    text = template.scenario(values)
    read, moved = load_text(text).given, template.problem.with_given(**values).given  # to the last bit
    assert {name: given.value for name, given in read.items()} == {name: given.value for name, given in moved.items()}
    without = subject_of(ROOT / "examples" / "ordinary_lander.toml")
    assert "retro" not in {
        knob.key.partition(".")[0] for knob in without.knobs
    }  # a file with it states another problem
    with pytest.raises(PeriluneError, match="far outside its range"):
        parse_request('{"number": 0, "values": {"vehicle_thrust": 1e6}}', subject)


def test_a_saved_flight_is_shown_as_it_was_saved_and_made_anew_once_to_be_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Solving it again may take longer than a page waits, and newer values do not end what they are followed from."""
    save(solve(load_file(ROOT / "examples" / "hybrid_lander.toml").problem, verify=0), tmp_path / "run")
    subject, solve_it, asked = subject_of(tmp_path / "run"), perilune.app.answers.solve, list[float]()

    def noted(problem: Problem, **more: Any) -> Solution:
        asked.append(problem.given["vehicle_thrust"].value)
        more["callback"]("Newton's method")
        return solve_it(problem, **more)

    def newer(_: object) -> None:
        if asked != [440.0]:
            return
        raise SupersededWork

    monkeypatch.setattr("perilune.app.answers.solve", noted)
    answering, first = Answering(subject.problem, None, subject.known), {k.name: k.value for k in subject.knobs}
    found = answering.at(first, newer)
    assert found.solution is subject.known and found.words == "as it was saved" and not asked
    assert answering.at({**first, "vehicle_thrust": 441.0}, newer, ignore_events).source == "neighbour"
    assert asked == [440.0, 441.0]


def test_a_saved_flight_is_compared_and_proved_like_any_other(tmp_path: Path) -> None:
    """Its file's word on what it is does not count: that of what is found from nothing does, where it is the same."""
    save(solve(load_file(ROOT / "examples" / "hybrid_lander.toml").problem, verify=0), tmp_path / "run")
    known = subject_of(tmp_path / "run" / "solution.json").known  # by the file in it, too
    assert known is not None and not known.extremals
    found = compare_with_cold_start(known, ignore_events)
    assert not found.jumped and found.words == "best of 3 found" and found.family is not None
    assert [one.nature.name for one in found.solution.extremals] == ["BEST", "LOCAL_OPTIMUM_AT_BOUND", "WORST"]
    assert prove_timed(found.solution, ignore_events).outcome.name == "PROVED"
    worse, better = (
        compare_with_cold_start(replace(known, objective=known.objective + off), ignore_events) for off in (1.0, -1.0)
    )
    assert worse.jumped and [one.nature.name for one in worse.solution.extremals][-1] == "UNPROVED"
    assert not better.jumped and [one.nature.name for one in better.solution.extremals][:2] == [
        "UNPROVED", "LOCAL_OPTIMUM"
    ]  # fmt: skip


def test_a_saved_solution_hands_out_the_scenario_that_it_keeps(tmp_path: Path) -> None:
    scenario = load_file(ROOT / "examples" / "ordinary_lander.toml", ["vehicle.thrust=450 N"])
    solution = solve(scenario.problem, verify=0)
    save(solution, tmp_path / "with", scenario.text)
    save(solution, tmp_path / "without")
    kept, bare = subject_of(tmp_path / "with"), subject_of(tmp_path / "without")
    assert kept.known is not None and kept.scenario({}) == scenario.text
    moved = load_text(kept.scenario({"vehicle_mass": 310.0})).given
    assert (moved["vehicle_mass"].value, moved["vehicle_thrust"].value) == (310.0, 450.0)
    assert not any(knob.key.startswith("retro.") for knob in kept.knobs)  # a file with it states another problem
    assert not opening_message(bare)["scenario"] and "saved without" in opening_message(bare)["unwritten"]
    with pytest.raises(PeriluneError, match="saved without a scenario"):
        bare.scenario({})


def test_a_switch_is_shown_as_a_step_and_a_flat_curve_as_it_goes() -> None:
    flown = solve(load_file(ROOT / "examples" / "precision_landing.toml").problem, verify=0)
    (phase,) = flight_message(flown)["phases"]
    throttle, times = phase["columns"]["throttle"]["values"], phase["time"]
    assert set(throttle) == {0.3, 0.9}
    steps = [(a, b) for a, b, x, y in zip(times, times[1:], throttle, throttle[1:], strict=False) if x != y]
    assert len(steps) == 2 and all(a == b for a, b in steps)
    flat = phase["columns"]["lambda_east"]["values"]  # constant to 1e-3, of which six digits show a thousand steps
    assert len(set(flat)) == len(set(times))
    called = flight_message(flown)["labels"]
    assert "v_east" not in called and called["thrust_tilt"] == "tilt"  # beside the panel of "east" it is no "east" too


def test_numbers_are_as_short_as_they_may_be() -> None:
    """To the last bit as printf rounds them, and what is none is none."""
    numbers = np.random.default_rng(1).normal(size=3000) * 10.0 ** np.random.default_rng(2).uniform(-8, 20, 3000)
    numbers[:5] = 0.0, -0.0, 999999.5, -123456789.0, 0.1
    for digits in (3, 6, 9):
        assert round_to_digits(numbers, digits) == [float(f"{number:.{digits}g}") for number in numbers.tolist()]
    assert round_to_digits(numbers, ALL_DIGITS) == numbers.tolist()
    assert round_to_digits([math.nan, 2.0000001, -math.inf]) == [None, 2.0, None]


def test_quantities_are_called_as_on_the_axes_of_figures(subject: Subject) -> None:
    told = flight_message(solve(subject.problem, verify=0))["labels"]
    assert told["u"] == "horizontal velocity" and told["thrust_angle"] == "thrust angle β"
    assert "propellant" not in told  # which is its name


def test_sliders_keep_to_what_may_be_stated_and_flown() -> None:
    """Whatever one of them says alone may be stated and is not refused; numbers of nature are apart."""
    for name in ("hybrid_lander", "precision_landing", "mars_pinpoint", "polar_descent"):
        subject = subject_of(ROOT / "examples" / f"{name}.toml")
        knobs = {knob.key: knob for knob in subject.knobs}
        for knob in knobs.values():
            assert knob.low <= knob.value <= knob.high and knob.low < knob.high
            for value in (knob.low, knob.high):
                refuse_impossible(preflight(subject.problem.with_given(**{knob.name: value})))
        assert knobs["vehicle.standard_gravity"].natural and not knobs["vehicle.thrust"].natural
        site = {"hybrid_lander": "landing.altitude", "precision_landing": "site.altitude"}.get(name)
        assert site is None or site in knobs  # which is 0 m, and the only length of its section
    assert (
        knobs["start.latitude"].high == pytest.approx(math.pi / 2) and "start.sideways_speed" in knobs
    )  # which is 0 m/s


def test_a_page_that_needs_no_server_holds_its_flights(subject: Subject) -> None:
    page, words = build_static_page(subject)
    assert page.count('"type":"flight"') == 225 and "http://" not in page.replace("http://www.w3.org/2000/svg", "")
    assert words == "a flight at each of 225 points"


def test_what_cannot_be_explored_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["explore", str(tmp_path / "nothing.toml")]) == 2
    assert "nothing to explore" in capsys.readouterr().err
    assert run_command(["explore", str(tmp_path)]) == 2
    assert "perilune atlas build --out" in capsys.readouterr().err  # not of a saved solution alone
    assert run_command(["explore", str(tmp_path), "--set", "vehicle.thrust=1 N"]) == 2
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert run_command(["explore", "--no-open", "--port", str(taken.getsockname()[1])]) == 2
    assert "cannot be used" in capsys.readouterr().err


def test_a_page_without_an_atlas_jumps_too() -> None:
    """Followed from both ends, so that on either side of 277.867 s the better family is there."""
    subject = subject_of(None)
    knob = next(knob for knob in subject.knobs if knob.name == ISP)
    page, _ = build_static_page(replace(subject, knobs=(replace(knob, low=272.0, high=284.0),)))
    document = json.loads(page.partition('id="frozen">')[2].partition("</script>")[0])
    flights = document["flights"]
    burns = [(flight["values"][ISP], flight["free"]["retro_delta_v"] > 0.0) for flight in flights]
    assert burns == [(isp, isp > 277.867) for isp, _ in burns]
    # To the last digit: the page writes its table of these.
    assert all(flight["phases"][-1]["time"][-1] == flight["free"]["flight_time"] for flight in flights)


def test_what_moves_on_a_page_is_chosen_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("perilune.app.static_page._BOTH", 3)
    monkeypatch.setattr("perilune.app.static_page._ALONG", 2)
    file, ask = tmp_path / "page.html", ["explore", str(ROOT / "examples" / "hybrid_lander.toml"), "--html"]
    vary = ["--vary", "vehicle.thrust=429:450 N", "--vary", "retro.specific_impulse=270:290 s"]
    assert run_command([*ask, str(file), *vary]) == 0
    assert "vehicle.thrust from 429 to 450 N and retro.specific_impulse from 270 to 290 s" in capsys.readouterr().out
    document = json.loads(file.read_text("utf-8").partition('id="frozen">')[2].partition("</script>")[0])
    moved, flights = [knob["name"] for knob in document["hello"]["knobs"]], document["flights"]
    assert moved == ["vehicle_thrust", ISP]
    thrusts = [found["values"]["vehicle_thrust"] for found in flights]
    assert thrusts == [429.0] * 3 + [440.0] * 3 + [450.0] * 3  # that of the scenario is among them
    assert [found["free"]["retro_delta_v"] > 0.0 for found in flights] == [False, True, True] * 3  # the best at each
    laden = ["--set", "vehicle.dry_mass=30 kg", "--vary", "vehicle.thrust=20:430 N"]  # which 20 N cannot hold
    assert run_command([*ask, str(tmp_path / "beside.html"), *laden]) == 0
    words = "a flight at 1 of 2 points; vehicle.thrust as it is stated, 440 N, is not among them"
    assert words in capsys.readouterr().out and words in (tmp_path / "beside.html").read_text("utf-8")
    for more, words in (
        (["--vary", "vehicle.thrst"], "did you mean 'vehicle.thrust'"),
        ([*vary, "--vary", "vehicle.mass"], "too many parameters for one page"),
        ([*vary[:2], *vary[:2]], "twice"),
        (["--vary", "vehicle.thrust=3:2 N"], "is empty"),
        (["--vary", "vehicle.thrust=-5:400 N"], "vehicle.thrust"),
    ):
        assert run_command([*ask, str(tmp_path / "other.html"), *more]) == 2
        assert words in capsys.readouterr().err
    assert run_command([*ask[:2], "--no-open", *vary]) == 2
    assert "page written with --html" in capsys.readouterr().err


def test_a_page_that_needs_no_server_is_written_without_one() -> None:
    """Who only sends pages has no need of its packages."""
    missing = "import sys; sys.modules.update(dict.fromkeys(['starlette', 'uvicorn', 'websockets']))"
    subprocess.run([sys.executable, "-c", f"{missing}; import perilune.app.static_page"], check=True)


def _light(colour: str) -> float:
    """Relative luminance as WCAG 2.2 defines it."""
    digits = colour.lstrip("#") if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
    parts = (int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4))
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def test_every_colour_of_a_word_stands_out_from_its_ground() -> None:
    """At least 4.5 to 1, in the light and in the dark."""
    themes = re.findall(r":root \{.*?\}", page_files()["style.css"].decode())
    assert len(themes) == 2
    for theme in themes:
        colours = {name: _light(colour) for name, colour in re.findall(r"--(\w+): (#\w+)", theme)}
        for word in ("ink", "soft", "go", "hot", "good", "bad", "pin1", "pin2"):
            for ground in ("paper", "box"):
                low, high = sorted((colours[word], colours[ground]))
                assert (high + 0.05) / (low + 0.05) >= 4.5, (word, ground)


def test_a_neighbour_that_never_comes_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method may go on for minutes from a flight that leads nowhere; from nothing there is one at once."""
    answering = Answering(load_text((ROOT / "examples" / "hybrid_lander.toml").read_text()))
    answering.at({})
    solve = perilune.app.answers.solve

    def lost(problem: Problem, *, guess: Solution | None = None, callback: Watch, verify: int) -> Solution:
        while guess is not None:
            callback("structure: of many arcs")
        return solve(problem, verify=verify, callback=callback)

    monkeypatch.setattr("perilune.app.answers.solve", lost)
    monkeypatch.setattr("perilune.app.answers._FOLLOW", 0.1)
    began = time.monotonic()
    found = answering.at({"vehicle_thrust": 445.0})
    assert found.source == "nothing" and time.monotonic() - began < 5.0


def test_what_cannot_be_flown_is_told_as_soon_as_a_solve_would(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the first flight was found at once: smaller steps towards it took up to half a minute."""
    answering = Answering(load_file(ROOT / "examples" / "mars_pinpoint.toml").problem)
    thrust = 0.8 * answering.at({}).solution.problem.given["vehicle_thrust"].value
    monkeypatch.setattr(Answering, "_between", lambda *_: pytest.fail("a smaller step"))
    with pytest.raises(InfeasibleError, match=r"violates vehicle\.dry_mass by"):
        answering.at({"vehicle_thrust": thrust})


def test_a_large_step_is_followed_in_smaller_ones_and_newer_values_go_on_from_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where Newton's method reaches 3 N at most; 440 to 450 N is the whole, two halves, and then four quarters."""
    answering = Answering(load_file(ROOT / "examples" / "hybrid_lander.toml").problem)
    solve, tried = perilune.app.answers.solve, list[float]()

    def near(asked: Problem, *, guess: Solution | None = None, callback: Watch, verify: int) -> Solution:
        if guess is None:
            raise NotConvergedError("no extremal was found")
        thrust, before = (p.given["vehicle_thrust"].value for p in (asked, guess.problem))
        tried.append(thrust)
        callback("Newton's method")
        if abs(thrust - before) > 3.0:
            raise NotConvergedError("too far")
        return solve(asked, guess=guess, verify=verify, callback=callback)

    def dropping(_: object) -> None:
        if tried[-1:] == [445.0] and len(tried) > 2:
            raise SupersededWork

    first = answering.at({}).solution
    monkeypatch.setattr("perilune.app.answers.solve", near)
    with pytest.raises(SupersededWork):
        answering.at({"vehicle_thrust": 450.0}, dropping)
    assert tried == [450.0, 445.0, 442.5, 445.0]
    assert answering.last is not None and answering.last.problem.given["vehicle_thrust"].value == 442.5
    answering.last = first
    found = answering.at({"vehicle_thrust": 450.0})
    assert tried[4:] == [450.0, 445.0, 442.5, 445.0, 447.5, 450.0] and "followed in 4 steps" in found.words
    assert found.solution.objective == pytest.approx(solve(found.solution.problem, verify=0).objective, rel=1e-9)


def test_a_step_that_leads_nowhere_leaves_time_to_smaller_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """It took all there was: Newton's method fails at once, and what is tried behind it takes long."""
    answering = Answering(load_file(ROOT / "examples" / "hybrid_lander.toml").problem)
    solve = perilune.app.answers.solve

    def lost(asked: Problem, *, guess: Solution | None = None, callback: Watch, verify: int) -> Solution:
        if guess is None:
            raise NotConvergedError("no extremal was found")
        while abs(asked.given["vehicle_thrust"].value - guess.problem.given["vehicle_thrust"].value) > 3.0:
            callback("direct method")
        return solve(asked, guess=guess, verify=verify, callback=callback)

    answering.at({})
    monkeypatch.setattr("perilune.app.answers.solve", lost)
    monkeypatch.setattr("perilune.app.answers._FOLLOW", 1.5)
    answering.patience = 60.0  # as long as the first flight took
    assert "followed in 2 steps" in answering.at({"vehicle_thrust": 445.0}).words


def test_the_last_attempt_is_one_step_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of the way in one step; behind it no smaller one leads on, but the whole rest."""
    answering = Answering(load_file(ROOT / "examples" / "hybrid_lander.toml").problem)
    solve, led = perilune.app.answers.solve, {(440.0, 442.5), (442.5, 450.0)}

    def near(asked: Problem, *, guess: Solution | None = None, callback: Watch, verify: int) -> Solution:
        if guess is None:
            raise NotConvergedError("no extremal was found")
        before, thrust = (p.given["vehicle_thrust"].value for p in (guess.problem, asked))
        if (before, thrust) not in led:
            raise NotConvergedError("it leads nowhere")
        return solve(asked, guess=guess, verify=verify, callback=callback)

    answering.at({})
    monkeypatch.setattr("perilune.app.answers.solve", near)
    assert "followed in 2 steps" in answering.at({"vehicle_thrust": 450.0}).words


def test_a_link_to_what_is_not_found_from_nothing_is_reached_from_the_first_values(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It may hold values that a slider reached from neighbour to neighbour."""
    problem = load_file(ROOT / "examples" / "hybrid_lander.toml").problem
    solve = perilune.app.answers.solve

    def hard(asked: Problem, *, guess: Solution | None = None, callback: Watch, verify: int) -> Solution:
        if guess is None and asked.given != problem.given:
            raise NotConvergedError("no extremal was found")
        return solve(asked, guess=guess, verify=verify, callback=callback)

    monkeypatch.setattr("perilune.app.answers.solve", hard)
    found = Answering(problem).at({"vehicle_thrust": 445.0})
    assert found.source == "neighbour" and found.solution.problem.given["vehicle_thrust"].value == 445.0
    assert found.words.endswith("a search without an initial guess found none")


def test_a_link_to_what_is_not_found_soon_is_reached_from_the_first_values(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = load_file(ROOT / "examples" / "hybrid_lander.toml").problem
    solve = perilune.app.answers.solve

    def long(asked: Problem, *, guess: Solution | None = None, callback: Watch, verify: int) -> Solution:
        while guess is None and asked.given != problem.given:
            callback("looking for it")
        return solve(asked, guess=guess, verify=verify, callback=callback)

    monkeypatch.setattr("perilune.app.answers.solve", long)
    monkeypatch.setattr("perilune.app.answers._FOLLOW", 0.5)
    found = Answering(problem).at({"vehicle_thrust": 440.1})
    assert found.source == "neighbour" and found.words.endswith(
        "a search without an initial guess found none in 0.5 s of CPU"
    )


def test_a_neighbour_that_breaks_a_condition_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a guess `solve` follows the extremal alone, here out of the bounds of steering, and further on underground."""
    monkeypatch.setattr("perilune.app.answers._LOOK", 60.0)  # s: what is found from nothing tells why
    answering = Answering(load_file(ROOT / "examples" / "polar_descent.toml").problem)
    assert meets_path_constraints(answering.at({"site_longitude": math.radians(7.0)}).solution)
    with pytest.raises(PeriluneError, match=r"the best violates steering.azimuth_upper by about 11 deg"):
        answering.at({"site_longitude": math.radians(9.0)})
    near = solve(answering.problem_at({"site_longitude": math.radians(9.0)}), guess=answering.last, verify=0)
    assert not meets_path_constraints(near)
