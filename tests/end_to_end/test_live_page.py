"""The page of a live mission in Chromium, from its own server: what people do with it, and what they then see."""

import contextlib
import io
import json
import re
import time
import urllib.request

import numpy as np
import pytest
from live_page import WAIT_MS, Visit, chromium, says, until
from pages import CONTRAST, OVERFLOW
from PIL import Image
from playwright.sync_api import expect

from simulator import Scenario
from simulator.live.server import ServerOptions, serving
from simulator.study.sequence.run import run_sequence

pytestmark = pytest.mark.system

CAMERA = ["detector.width=192", "detector.height=192", "detector.pixel_pitch_um=29", "optics.psf.sigma_px=0.7"]
SMALL = [*CAMERA, "sequence.step_s=0.25"]
SETTLED = "!document.querySelector('.slider.busy')"
NAMELESS = """[...document.querySelectorAll('button, input, select, canvas, dialog, section, [role]')].filter(n => {
  const ids = (n.getAttribute('aria-labelledby') ?? '').split(' ');
  const by = ids.map(id => document.getElementById(id)?.textContent ?? '');
  return !(n.getAttribute('aria-label') || by.join('') || n.labels?.[0]?.textContent || n.textContent || '').trim()
         && n.role !== 'alert';
}).map(n => n.outerHTML.slice(0, 90))"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("live")


@pytest.fixture(scope="module")
def address(folder):
    scenario = Scenario.load("cubesat_ideal", SMALL)
    with serving(scenario, ServerOptions(port=0, recordings=folder)) as server:
        for _ in range(3000):  # kernels may have to be compiled first
            with urllib.request.urlopen(f"{server.url}healthz") as answer:
                if json.load(answer)["index"] >= 0:
                    break
            time.sleep(0.1)
        yield server.url


@pytest.fixture(scope="module")
def browser():
    with chromium() as opened:
        yield opened


@pytest.fixture
def visit(browser, address):
    visit = Visit(browser, address).open()
    yield visit
    visit.close()


def brightness(page, name="frame"):
    """Mean grey level of a canvas as it is seen."""
    return np.asarray(Image.open(io.BytesIO(page.locator(f"#{name}").screenshot())).convert("L")).mean()


@contextlib.contextmanager
def blinded(page):
    page.click("#blind")
    says(page, "^Blinded")
    expect(page.locator("#blind")).to_have_attribute("aria-pressed", "true", timeout=WAIT_MS)  # some frames later
    try:
        yield
    finally:
        page.click("#blind")
        says(page, "^(Tracking|Solved)")


# ------------------------------------------------------------------ what people do
def test_longer_exposure_makes_a_brighter_frame(visit):
    page = visit.page
    slider = page.get_by_role("slider", name="Exposure")
    before_s = visit.latest("frame")["exposure_s"]
    page.click("#hold")
    page.wait_for_timeout(500)
    before = brightness(page)
    slider.focus()
    for _ in range(8):
        page.keyboard.press("PageUp")  # a tenth of the range, which is a factor of 100 either way
    until(page, SETTLED)
    page.wait_for_timeout(1000)
    asked_s = float(page.locator('[data-path="detector.exposure_s"] input[type=number]').input_value())
    assert visit.latest("frame")["exposure_s"] == asked_s > 5 * before_s
    held = brightness(page)
    assert held > before + 20
    page.click("#hold")
    page.wait_for_timeout(500)
    assert brightness(page) < held - 20  # fitted to the frame again
    page.click("#reset")
    until(page, SETTLED)
    assert float(page.locator('[data-path="detector.exposure_s"] input[type=number]').input_value()) == before_s


def test_value_outside_its_range_is_refused_with_the_range(visit):
    page = visit.page
    number = page.locator('[data-path="detector.temperature_c"] input[type=number]')
    before = number.input_value()
    number.fill("5000")
    number.press("Enter")
    assert page.locator('[data-path="detector.temperature_c"] .fault').inner_text().startswith("−60")
    assert number.input_value() == before


def test_blinded_camera_is_said_to_be_and_recovers(visit):
    page = visit.page
    with blinded(page):
        page.wait_for_selector("#veil:visible")
        assert "Blinded" in page.inner_text("#veil")
        assert page.get_attribute("#verdict", "data-tone") == "bad"
        assert page.inner_text("#sol-residual") == "–"
    page.wait_for_selector("#veil", state="hidden")
    expect(page.locator("#sol-residual")).to_contain_text("px")


def test_too_small_an_aperture_is_lost_and_says_why(visit):
    page = visit.page
    aperture = page.get_by_role("slider", name="Aperture")
    exposure = page.get_by_role("slider", name="Exposure")
    for slider in (aperture, exposure):
        slider.press("Home")
    says(page, "^Lost: ")
    page.wait_for_selector("#veil:visible")
    assert page.inner_text("#veil").startswith("Lost: ")
    page.click("#reset")
    says(page, "^(Tracking|Solved)")


def test_pause_step_and_speed(visit):
    page = visit.page
    page.click("#pause")
    says(page, "paused")
    page.wait_for_timeout(400)
    index = visit.latest("frame")["index"]
    page.click("#step")
    page.wait_for_timeout(1500)
    assert visit.latest("frame")["index"] == index + 1
    page.click("#pause")
    page.select_option("#speed", "2")
    page.wait_for_timeout(1000)
    assert visit.latest("state")["speed"] == 2
    page.select_option("#speed", "1")


def test_kick_turns_the_camera(visit):
    page = visit.page
    before = np.linalg.norm(visit.latest("truth")["rate_deg_s"])
    page.fill("#kick-rate", "0.4")
    page.select_option("#kick-axis", "1")
    page.click("#kick")
    for _ in range(WAIT_MS // 50):
        if abs(np.linalg.norm(visit.latest("truth")["rate_deg_s"]) - before) > 0.2:
            break
        page.wait_for_timeout(50)
    else:
        pytest.fail("the rate did not change")
    page.click("#reset")


def test_recording_is_a_sequence_that_run_reads(visit, folder):
    """The attitudes of the replay are those that the page was shown, bit for bit."""
    page = visit.page
    page.click("#record")
    expect(page.locator("#record-text")).to_have_text("Stop")
    seen = len(visit.received)
    page.wait_for_timeout(2500)
    page.click("#record")
    expect(page.locator("#record-text")).to_have_text("Record", timeout=WAIT_MS)
    expect(page.locator("#notice")).to_contain_text("boresight run", timeout=WAIT_MS)
    recorded = {state["recording"] for state in visit.messages("state") if state["recording"]}
    assert len(recorded) == 1
    sequence = run_sequence(Scenario.load(folder / recorded.pop() / "scenario.yaml"))
    columns = sequence.columns
    replayed = {
        tuple(float(columns[f"q{axis}"][k]) for axis in "xyzw")
        for k in range(len(columns["t_s"]))
        if columns["status"][k] == "solved"
    }
    shown = [m for m in visit.received[seen:] if m["type"] == "solution" and m["status"] == "solved"]
    assert len(replayed) >= 5
    assert sum(tuple(m["quaternion"]) in replayed for m in shown) >= 5


def test_connection_lost_is_said_and_made_again(browser, address):
    visit = Visit(browser, address)
    sockets = []

    def through(route):
        sockets.append(route)
        route.connect_to_server()

    visit.page.route_web_socket(re.compile("/ws"), through)
    visit.open()
    sockets[-1].close()
    says(visit.page, "^Connection lost")
    assert visit.page.is_disabled("#blind")
    says(visit.page, "^(Tracking|Solved)")
    assert len(sockets) == 2
    assert not visit.page.is_disabled("#blind")
    visit.close()


# ------------------------------------------------------------------ who meets it
def test_keyboard_alone(visit):
    page = visit.page
    reached = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        name, outline = page.evaluate(
            "(() => { const n = document.activeElement, s = getComputedStyle(n);"
            " return [n.id || n.getAttribute('aria-label') || n.tagName, parseFloat(s.outlineWidth)]; })()"
        )
        reached.add(name)
        assert outline >= 2 or name == "BODY", f"focus is not visible on {name}"
    assert {
        "pause",
        "step",
        "speed",
        "record",
        "frame",
        "sky",
        "log",
        "blind",
        "saa",
        "kick",
        "reset",
        "theme",
    } <= reached
    page.focus("#frame")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#cursor")).to_have_text(re.compile(r"^x \d+, y \d+: \d+ DN"))
    page.keyboard.press("Space")
    says(page, "paused")
    page.keyboard.press("Space")
    says(page, "^(?!.*paused)")
    page.keyboard.press("g")
    assert page.get_attribute("#show-grid", "aria-pressed") == "false"
    page.keyboard.press("?")
    assert page.locator("#shortcuts").is_visible()
    assert page.locator("#shortcut-rows tr").count() >= 15
    page.keyboard.press("Escape")
    page.keyboard.press("b")
    says(page, "^Blinded")
    expect(page.locator("#blind")).to_have_attribute("aria-pressed", "true", timeout=WAIT_MS)  # else "b" blinds again
    page.keyboard.press("b")
    says(page, "^(Tracking|Solved)")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [360, 800, 1400])
def test_layout_fits_and_is_legible(browser, address, width, scheme):
    visit = Visit(browser, address, width, 900, scheme, is_mobile=width < 500, has_touch=width < 500).open()
    page = visit.page
    page.wait_for_timeout(500)
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    assert page.evaluate(f"({OVERFLOW})({width})") == []
    assert page.evaluate(CONTRAST) == []
    cut = page.evaluate(
        "[...document.querySelectorAll('button, select, label, dd, h2')].filter(n => n.getClientRects().length"
        " && !n.closest('.word, .sr') && n.scrollWidth > n.clientWidth + 1 && getComputedStyle(n).display !== 'inline')"
        ".map(n => n.outerHTML.slice(0, 80))"
    )
    assert cut == []
    for name in ("frame", "sky", "errors"):  # drawn, in the device's own pixels
        canvas = page.locator(f"#{name}")
        ratio, device = canvas.evaluate("c => [c.width / c.clientWidth, devicePixelRatio]")
        assert ratio == pytest.approx(device, rel=0.01)
        colours = Image.open(io.BytesIO(canvas.screenshot())).convert("RGB").getcolors(1 << 24)
        assert len(colours) > 20, f"{name} is empty"
    if width < 500:  # targets for a finger: 24 px at least (WCAG 2.2, 2.5.8)
        small = page.evaluate(
            "[...document.querySelectorAll('button, select, input')].filter(n => n.getClientRects().length)"
            ".filter(n => n.getBoundingClientRect().height < 24).map(n => n.id)"
        )
        assert [name for name in small if name != "shortcuts-on"] == []
    visit.close()


def test_names_and_structure_for_screen_readers(visit):
    page = visit.page
    assert page.evaluate("document.documentElement.lang") == "en"
    assert page.locator("h1").count() == page.locator("main").count() == 1
    ids = page.evaluate("[...document.querySelectorAll('[id]')].map(n => n.id)")
    assert len(ids) == len(set(ids))
    assert page.evaluate(NAMELESS) == []
    referred = page.evaluate(
        "[...document.querySelectorAll('[aria-labelledby], [aria-describedby]')].every(n =>"
        " [n.getAttribute('aria-labelledby'), n.getAttribute('aria-describedby')].filter(Boolean)"
        ".every(id => document.getElementById(id)))"
    )
    assert referred
    assert page.get_attribute("#verdict", "role") == "status"
    slider = page.get_by_role("slider", name="Exposure")
    assert slider.get_attribute("aria-valuetext").endswith(" s")
    expect(page.locator("#errors")).to_have_attribute("aria-label", re.compile("about x"))


def test_theme_is_chosen_and_remembered(visit):
    page = visit.page
    back = "getComputedStyle(document.body).backgroundColor"
    light = page.evaluate(back)
    page.click("#theme")  # light
    page.click("#theme")  # dark
    assert page.evaluate(back) != light
    page.reload()
    page.wait_for_selector("text=Theme: dark")
    assert page.evaluate(back) != light


def test_motion_is_reduced_where_asked(browser, address):
    visit = Visit(browser, address, reduced_motion="reduce").open()
    running = "document.querySelector('#record .dot').classList.add('on'); document.getAnimations().length"
    assert visit.page.evaluate(running) == 0
    visit.close()
