"""The page of the explorer in a real browser: dragged, refused, reloaded, and from a file alone."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

playwright = pytest.importorskip("playwright.sync_api", reason="these tests need pip install 'perilune[test]'")
pytest.importorskip("starlette", reason="the explorer needs starlette: pip install 'perilune[explore]'")

from explored import CHROMIUM, QUIET, ROOT, atlas_of_the_jump, drag, served, until  # noqa: E402
from perilune.app.source import subject_of  # noqa: E402
from perilune.app.static_page import build_static_page  # noqa: E402

pytestmark = pytest.mark.skipif(not CHROMIUM, reason="these tests need a browser: apt-get install chromium")
ISP = "#knob-retro_specific_impulse"


@pytest.fixture(scope="module")
def atlas(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return atlas_of_the_jump(tmp_path_factory.mktemp("browser") / "map")


@pytest.fixture(scope="module")
def alone(atlas: Path) -> Path:
    """A page in a file, as from a mail."""
    file = atlas.parent / "page.html"
    file.write_text(build_static_page(subject_of(atlas)).page, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        made = started.chromium.launch(executable_path=CHROMIUM, args=QUIET)
        yield made
        made.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A new page; at its end nothing was asked from elsewhere and nothing complained."""
    made = browser.new_page(viewport={"width": 1280, "height": 900})
    said, asked = list[str](), list[str]()
    made.on("console", lambda message: said.append(message.text))
    made.on("pageerror", lambda error: said.append(str(error)))
    made.on("request", lambda request: asked.append(request.url))
    yield made
    made.close()
    assert not said
    assert not [url for url in asked if not url.startswith(("http://127.0.0.1:", "file:", "blob:", "data:"))]


def _follows(page: Any, begin: float, end: float) -> bool:
    """Whether 40 frames are shown while the impulsive Isp is dragged: in two seconds, or in more of a slow machine."""
    return any(drag(page, ISP, begin, end, seconds) >= 40 for seconds in (2.0, 4.0, 8.0, 16.0))


def test_the_flight_follows_a_slider_and_jumps_where_a_retro_burn_begins_to_pay(page: Any, atlas: Path) -> None:
    """Across 277.867 s: no retro burn before, hundreds of m/s behind; then proved.

    How many frames a second these are is measured by ``benchmarks/explorer.py``.
    """
    with served(str(atlas)) as address:
        page.goto(address)
        until(page, "perilune.frames > 0")
        assert _follows(page, 0.95, 0.05)
        until(page, "perilune.shown === perilune.number && perilune.flight.free.retro_delta_v === 0")
        assert page.evaluate("perilune.values.retro_specific_impulse") < 277.0
        drag(page, ISP, 0.05, 0.95, 0.5)
        until(page, "perilune.shown === perilune.number && perilune.flight.free.retro_delta_v > 500")
        until(page, "!!perilune.flight.proved")
        until(page, "document.querySelector('#source').innerText.includes('PROVED, level 3')")  # by the next frame
        assert page.locator("#lights .yes").count() > 20 and page.locator("#lights .no").count() == 0
        before = page.evaluate("perilune.values")
        page.reload()
        until(page, "perilune.frames > 0")
        assert page.evaluate("perilune.values") == before  # to the last bit
        page.keyboard.press("Tab")
        page.locator(ISP).focus()
        page.keyboard.press("ArrowLeft")
        until(page, "perilune.values.retro_specific_impulse < " + str(before["retro_specific_impulse"]))
        page.click("#undo")
        assert page.evaluate("perilune.values") == before
        page.keyboard.press("Control+Shift+Z")
        assert page.evaluate("perilune.values") != before
        page.keyboard.press("Control+z")
        assert page.evaluate("perilune.values") == before
        page.goto(address + "#retro.specific_impulse=273")  # a link into the page that is open
        until(page, "perilune.values.retro_specific_impulse === 273")
        steps = page.evaluate("perilune.past.length")
        page.goto(address + "#retro.specific_impulse=2.73e2")  # in other words
        until(page, "location.hash === '#retro.specific_impulse=273'")
        assert page.evaluate("perilune.past.length") == steps
        page.locator(".skip").focus()
        page.keyboard.press("Enter")
        assert (
            page.url.endswith("#retro.specific_impulse=273") and page.evaluate("document.activeElement.id") == "knobs"
        )
        page.click("#more summary")
        page.fill("input[aria-label='vehicle.mass in kg']", "303")  # no axis of the map
        page.keyboard.press("Enter")
        until(page, "perilune.shown === perilune.number && perilune.flight.source === 'neighbour'")
        until(page, "document.getElementById('slice').hidden")
        assert "another vehicle.mass" in page.inner_text("#slice-words")
        for typed, said in (("1e400", "no number that can be used"), ("", "No number was typed")):
            page.fill("input[aria-label='vehicle.mass in kg']", "")
            page.type("input[aria-label='vehicle.mass in kg']", typed)
            page.keyboard.press("Enter")
            assert said in page.inner_text("#more .wrong[role=alert]:not(:empty)")
            assert page.evaluate("perilune.values.vehicle_mass") == 303.0


def test_without_an_atlas_the_flight_follows_as_fast_and_jumps_at_rest(page: Any) -> None:
    with served() as address:
        page.goto(address)
        until(page, "perilune.frames > 0")
        assert _follows(page, 0.5, 0.05)
        until(page, "perilune.shown === perilune.number && perilune.flight.free.retro_delta_v === 0")
        drag(page, ISP, 0.05, 0.5, 0.3)
        until(page, "perilune.flight.source === 'jumped' && perilune.flight.free.retro_delta_v > 500")
        until(page, "!!perilune.flight.proved")
        until(page, "document.querySelector('#source').innerText.includes('PROVED, level 3')")  # by the next frame
        assert "has jumped" in page.inner_text("#source")
        until(page, "document.getElementById('said').innerText.includes('has jumped')")  # for who hears it
        assert "landed mass 160." in page.inner_text("#said")


def test_a_refusal_is_shown_in_words_and_the_flight_before_stays_behind_it(page: Any) -> None:
    """An approach that starts below the glide slope cannot be flown."""
    weak = "--set", "approach.up=800 m"
    with served(str(ROOT / "examples" / "precision_landing.toml"), *weak, end=signal.SIGTERM) as address:
        page.goto(address)
        until(page, "perilune.frames > 0", 60.0)
        if not page.locator("#knob-approach_up").is_visible():
            page.click("#more summary")
        page.fill("input[aria-label='approach.up in m']", "620")
        page.keyboard.press("Enter")
        until(page, "!!perilune.refused && perilune.refused.impossible", 60.0)
        until(page, "!document.getElementById('refusal').hidden")
        assert "glide slope" in page.inner_text("#refusal")
        page.set_viewport_size({"width": 1200, "height": 3000})  # as a phone that is turned: plots are drawn anew
        page.evaluate("dispatchEvent(new Event('resize'))")
        until(page, "document.querySelectorAll('#states canvas').length > 3")
        page.click("#undo")
        until(page, "document.getElementById('refusal').hidden", 60.0)
        page.fill("input[aria-label='approach.up in m']", "1234.5678912345")  # outside of the slider's range
        page.keyboard.press("Enter")
        assert page.evaluate("perilune.values.approach_up") == 1234.5678912345
        assert page.evaluate("+document.getElementById('knob-approach_up').max") == 1234.5678912345
        until(page, "document.getElementById('title').innerText.includes('but with approach_up 1234.56')", 60.0)
        typed = "typed = (v) => {const n = document.querySelector('[aria-label=\"vehicle.mass in kg\"]');"
        typed += " n.value = v; n.dispatchEvent(new Event('change'))}"
        page.evaluate(f"() => {{const {typed}; typed('2030'); typed('1e9')}}")  # while a flight is on the way
        until(page, "!!perilune.refused && perilune.refused.what.includes('far outside its range')")
        time.sleep(1.0)  # and when it has come
        assert page.is_visible("#refusal") and page.evaluate("perilune.shown === perilune.number")


def test_the_landing_site_is_dragged_and_the_descent_bends(page: Any) -> None:
    """From above: what leads to a site that is moved begins where it began, and ends there.

    When nobody answers any longer the page goes on saying so, whatever is moved.
    """
    lines: list[Any] = []
    page.route_web_socket(re.compile("/live$"), lambda line: lines.append(line) or line.connect_to_server())
    with served(str(ROOT / "examples" / "precision_landing.toml")) as address:
        page.goto(address)
        until(page, "perilune.frames > 0", 60.0)
        page.click("#pin")
        page.locator("#ground").scroll_into_view_if_needed()
        box, before = page.locator("#ground").bounding_box(), page.evaluate("perilune.values")
        first = page.evaluate("perilune.flight.phases[0].columns.north.values[0]")
        x, y = box["x"] + 0.7 * box["width"], box["y"] + 0.45 * box["height"]
        page.mouse.move(x, y)
        page.mouse.down()
        for step in range(8):
            page.mouse.move(x + 2 * step, y - 3 * step)
            time.sleep(0.02)
        page.mouse.up()
        until(page, "perilune.shown === perilune.number && !perilune.refused", 60.0)
        after = page.evaluate("perilune.values")
        assert after["approach_north"] < before["approach_north"] and after["approach_east"] != before["approach_east"]
        north = page.evaluate("perilune.flight.phases[0].columns.north.values")
        assert north[0] == pytest.approx(after["approach_north"], rel=1e-5) and north[0] < first
        assert abs(north[-1]) < 1e-3
        assert page.evaluate("getComputedStyle(document.getElementById('ground')).touchAction") == "none"  # by a finger
        until(page, f"({_INK})(['article:has(#ground)', '--pin1']) > 20")  # to its own site
        lines[0].close(code=1008, reason="too many messages at once")
        ended = "document.getElementById('source').innerText.startsWith('The program has closed this page: too many')"
        until(page, ended)
        page.fill("input[aria-label='vehicle.mass in kg']", "2001")
        page.keyboard.press("Enter")
        page.click("#pin")
        assert page.evaluate(ended) and page.evaluate("document.getElementById('view').matches('.stale')")


def test_a_finger_that_scrolls_the_page_from_a_slider_moves_nothing(browser: Any, alone: Path) -> None:
    """On a phone; one that goes along the slider drags it."""
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
    page = context.new_page()
    touch = context.new_cdp_session(page)

    def swiped(place: str, right: float, down: float) -> None:
        page.locator(place).scroll_into_view_if_needed()
        box = page.locator(place).bounding_box()
        x, y = box["x"] + 0.9 * box["width"], box["y"] + 0.5 * box["height"]
        for step in range(10):
            at = {"x": x + step / 9 * right, "y": y + step / 9 * down}
            kind = "touchMove" if step else "touchStart"
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [at]})
            time.sleep(0.02)
        touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

    page.goto(alone.as_uri())
    until(page, "perilune.frames > 0")
    before = page.evaluate("perilune.values")
    swiped(ISP, 0, -120)
    until(page, "scrollY > 0")
    assert page.evaluate("perilune.values") == before and page.evaluate("perilune.past.length") == 0
    swiped(ISP, -60, 0)
    assert page.evaluate("perilune.values") != before and page.evaluate("perilune.past.length") == 1
    context.close()


_INK = """([view, name]) => {
  const box = document.querySelector(view + " canvas"), copy = document.createElement("canvas");
  if (!box) { return 0; } // which is not in sight yet
  copy.width = box.width; copy.height = box.height + 1;
  const c = copy.getContext("2d", { willReadFrequently: true });
  c.drawImage(box, 0, 0); c.fillStyle = Draw.css(name); c.fillRect(0, box.height, 1, 1);
  const ink = c.getImageData(0, box.height, 1, 1).data, seen = c.getImageData(0, 0, box.width, box.height).data;
  let count = 0;
  for (let i = 0; i < seen.length; i += 4) {
    count += seen[i + 3] > 90 && [0, 1, 2].every((k) => Math.abs(seen[i + k] - ink[k]) < 24);
  }
  return count;
}"""  # how much of the first plot of a view is drawn in a colour


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_every_view_draws_two_pinned_flights_beside_the_one_that_moves(
    page: Any, alone: Path, width: int, scheme: str
) -> None:
    """In lines of their own, which a legend names by what is not as it is now."""
    page.set_viewport_size({"width": width, "height": 844})
    page.emulate_media(color_scheme=scheme)
    page.goto(alone.as_uri())
    until(page, "perilune.frames > 0")
    for share in (0.05, 0.95, 0.5):
        drag(page, ISP, share, share, 0.1)
        until(page, "perilune.shown === perilune.number")
        if share != 0.5:
            page.click("#pin")
    moved = "retro.specific_impulse"
    said = rf"now\s*pinned 1: {moved} 27\S+ s\s*pinned 2: {moved} 28\S+ s"
    assert re.fullmatch(said, page.inner_text("article:has(#states) .legend"))
    for view in ("#states", "#controls", "#costates"):
        page.locator(view).scroll_into_view_if_needed()
        for name in ("--go", "--pin1", "--pin2"):
            until(page, f"({_INK})({[view, name]}) > 20")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.click("#pin")
    page.locator("#costates").scroll_into_view_if_needed()
    until(page, f"({_INK})(['#costates', '--pin1']) === 0")
    assert page.locator(".legend:visible").count() == 0


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_a_page_from_a_file_alone_shows_its_flights(page: Any, alone: Path, width: int, scheme: str) -> None:
    """No server; nothing wider than the screen; the jump is in it."""
    page.set_viewport_size({"width": width, "height": 844})
    page.emulate_media(color_scheme=scheme)
    page.goto(alone.as_uri())
    until(page, "perilune.frames > 0")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.click("#reset")
    assert page.locator("#undo").is_disabled()  # as nothing has moved
    page.locator(ISP).scroll_into_view_if_needed()
    for share, burn in ((0.05, "=== 0"), (0.95, "> 500")):
        drag(page, ISP, share, share, 0.1)
        until(page, f"perilune.flight.free.retro_delta_v {burn}")
    assert "stored" in page.inner_text("#source") and "a flight at each of 225 points" in page.inner_text("#stored")
    said = page.evaluate(
        "[[0.1, 0.2], [3.45123, 3.45124, 3.45125], [0.0345, 0.0345 + 1e-9, 0.0345 + 2e-9]].map(Draw.labels)"
    )
    assert said == [["0.1", "0.2"], ["3.45123", "3.45124", "3.45125"], ["0.0345", "+1e-9", "+2e-9"]]
    assert page.locator("#path svg polyline").count() >= 2
    with page.expect_download() as taken:
        page.click("#picture")
    drawn = taken.value.path().read_text(encoding="utf-8")
    assert "300 kg lander from 15 km" in drawn and "stored without a proof to level 3" in drawn
    page.evaluate("document.getElementById('path').replaceChildren()")  # as of a problem that states no path
    page.click("#picture")
    assert "there is no path to draw" in page.inner_text("#source")
    page.evaluate("perilune.flight.results.turn = { value: Math.PI, unit: 'rad' }")
    page.evaluate("perilune.flight.extremals = [{ objective: -957.0, nature: 'best' }]")  # where nothing is maximised
    page.click("#pin")
    assert "objective [kg]" in page.inner_text("#extremals")
    assert "180 deg\npinned 1: 180 deg" in page.inner_text("#numbers")
    for said in (
        "nosuch=3",
        "vehicle.thrust=440N",
        "vehicle.thrust=0x1b8",
        "vehicle.thrust=1e9",
    ):  # a link of another page, or mistyped
        page.goto(f"{alone.as_uri()}#{said}")
        until(page, f"document.getElementById('source').innerText.includes('not as the link says: {said}')")
    drag(page, ISP, 0.95, 0.95, 0.1)
    until(page, "!document.getElementById('source').innerText.includes('link')")
    if width > 900:  # beside the views the parameters stay in sight, and below the head of the page
        page.evaluate("scrollTo(0, 500)")
        until(
            page,
            "scrollY > 0 && document.getElementById('knobs').getBoundingClientRect().top >= "
            "document.querySelector('header').getBoundingClientRect().bottom",
        )
