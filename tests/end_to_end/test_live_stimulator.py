"""The stimulator's page in Chromium: pixels of a known list of stars, the schedule, and a mission that feeds it."""

import io
import shutil
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simulator.live.stimulator import Curve, DisplayGeometry, Photometry, Stimulator
from startracker import Attitude, Camera

playwright = pytest.importorskip("playwright.sync_api")
pytest.importorskip("uvicorn")
PAGE = Path(__file__).parents[2] / "simulator" / "live" / "page"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [pytest.mark.system, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium on the PATH")]

SIZE = (640, 480)
LIGHT = Photometry(
    SIZE, dict.fromkeys(("red", "green", "blue"), 1.0), dict.fromkeys(("red", "green", "blue"), Curve(2.2))
)
DISPLAY = Stimulator(
    DisplayGeometry(Camera.from_fov(13.0, *SIZE)), LIGHT, Attitude(np.array([0.0, 0, 0, 1]), "collimator", "camera")
)


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield running
        running.close()


@pytest.fixture
def page(browser):
    window = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
    faults = []
    window.on("pageerror", lambda error: faults.append(str(error)))
    yield window
    window.close()
    assert not faults


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The page's modules from a plain server: `Screen` and `Schedule` know of no other."""
    folder = tmp_path_factory.mktemp("page")
    shutil.copy(PAGE / "stimulator_screen.js", folder)
    (folder / "empty.html").write_text(
        "<!doctype html><style>html,body{margin:0;background:#000}canvas{display:block}</style><canvas></canvas>"
    )
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=folder))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/empty.html"
    server.shutdown()
    thread.join()
    server.server_close()


def on_screen(page):
    return np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"))


def test_each_pixel_of_the_screen_has_the_level_of_the_list(page, files):
    rng = np.random.default_rng(3)
    position = 10 + rng.uniform(0, 1, (12, 2)) * [600, 440]
    lists = [DISPLAY.spots(position + move, rng.uniform(1.0, 7.0, 12), np.arange(12)) for move in (0.0, 3.3)]
    page.goto(files)
    page.evaluate(
        "async (size) => { const { Screen } = await import('./stimulator_screen.js');"
        " window.shown = new Screen(document.querySelector('canvas')); window.shown.resize(...size); }",
        list(SIZE),
    )
    for one in lists:  # the second picture leaves nothing of the first
        expected = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
        expected[one.pixels[:, 1], one.pixels[:, 0]] = one.rgb
        table = np.zeros(len(one.pixels), np.dtype([("at", "<u2", 2), ("rgb", "u1", 3), ("zero", "u1")]))
        table["at"], table["rgb"] = one.pixels, one.rgb
        page.evaluate(
            "(b) => window.shown.show({ data: new Uint8Array(b).buffer, first: 1, pixels: b.length / 8 - 1 })",
            [255] * 8 + list(table.tobytes()),
        )
        assert np.array_equal(on_screen(page), expected)


SCHEDULE = """async ({ messages, ticks, period }) => {
  const { Schedule } = await import('./stimulator_screen.js');
  const schedule = new Schedule({ delayMs: 20 });
  const shown = [];
  for (const now of ticks) {
    while (messages.length && messages[0].arrival <= now) { const m = messages.shift(); schedule.add(m, m.arrival); }
    const picture = schedule.next(now, period);
    if (picture) shown.push([now, picture.t_s]);
  }
  const { late, skipped } = schedule;
  return { shown, late, skipped };
}"""


def message(index, arrival, count=4, paced=True):
    pictures = [{"t_s": 0.04 * index + 0.01 * k, "pixels": 0} for k in range(count)]
    return {"index": index, "t_s": 0.04 * index, "speed": 1.0, "paced": paced, "pictures": pictures, "arrival": arrival}


def scheduled(page, files, messages, ticks, period=10):
    page.goto(files)
    return page.evaluate(SCHEDULE, {"messages": messages, "ticks": ticks, "period": period})


def wait(page, expression, timeout_s=60.0):
    """Until an expression is true; the page's own rules forbid Playwright's way to wait for it."""
    end = time.monotonic() + timeout_s
    while not page.evaluate(expression):
        assert time.monotonic() < end, expression
        page.wait_for_timeout(50)


def test_pictures_appear_in_time_with_the_refreshes(page, files):
    """Messages every 40 ms of four pictures each, up to 15 ms late: one picture a refresh of 10 ms, none late."""
    messages = [message(n, 40.0 * n + late) for n, late in enumerate((0, 5, 15, 0, 10))]
    result = scheduled(page, files, messages, list(range(0, 260, 10)))
    assert result["late"] == result["skipped"] == 0
    assert [t_s for _, t_s in result["shown"]] == pytest.approx(np.arange(20) * 0.01)
    assert [now for now, _ in result["shown"]] == list(range(20, 220, 10))


def test_late_pictures_are_counted(page, files):
    """A message that arrives 60 ms late, with 20 ms of patience: its four pictures are due 40, 30, 20 and 10 ms ago."""
    messages = [message(0, 0.0), message(1, 40.0), message(2, 140.0), message(3, 140.0), message(4, 160.0)]
    result = scheduled(page, files, messages, list(range(0, 260, 10)))
    assert result["late"] == 3  # 40, 30 and 20 ms: more than a refresh and a half
    assert len(result["shown"]) + result["skipped"] + 3 == 20
    result = scheduled(page, files, [message(0, 0.0), message(1, 40.0), message(2, 180.0)], list(range(0, 260, 10)))
    assert result["late"] == 4  # due at 100 to 130: the first three are not shown, and the last at 180
    assert result["shown"][-1] == [180, pytest.approx(0.11)]
    ticks = [*range(0, 60, 10), *range(110, 260, 10)]  # the page is held up for 60 ms, the messages are not
    result = scheduled(page, files, [message(n, 40.0 * n) for n in range(5)], ticks)
    assert result["late"] == 4  # those due at 60, 70, 80 and 90 are shown at 110, or not at all; that at 100 is in time
    assert len(result["shown"]) == 15


def test_a_display_slower_than_the_pictures_skips_without_being_late(page, files):
    result = scheduled(page, files, [message(n, 40.0 * n) for n in range(5)], list(range(0, 260, 20)), 20)
    assert result["late"] == 0
    assert len(result["shown"]) in (10, 11)
    assert result["skipped"] == 20 - len(result["shown"])


def test_without_a_clock_a_picture_is_shown_at_once(page, files):
    messages = [message(n, 300.0 * n, 1, paced=False) for n in range(3)]
    result = scheduled(page, files, messages, list(range(0, 700, 10)))
    assert [now for now, _ in result["shown"]] == [0, 300, 600]
    assert result["late"] == 0


@pytest.fixture(scope="module")
def server():
    from simulator.checks import load_scenario
    from simulator.live.server import ServerOptions, serving

    changes = ["sequence.step_s=0.25", "pointing.rate_deg_s=[0.0, 0.5, 0.2]", "detector.exposure_s=0.05"]
    options = ServerOptions(port=0, stimulator=DISPLAY, refresh_hz=20.0)
    with serving(load_scenario("cubesat_ideal", changes), options) as running:
        yield running


def test_the_page_shows_the_mission_and_reports_what_is_late(page, server):
    page.goto(f"{server.url}stimulator?delay_ms=200")
    wait(page, "window.stimulator?.schedule.shown > 15")
    assert page.locator("#link").inner_text() == "Connected."
    page.keyboard.press("h")
    assert not page.locator("#panel").is_visible()
    lit = on_screen(page).any(axis=2)
    assert 50 < lit.sum() < 5000, "some ten stars of some pixels on black"
    before = page.evaluate("window.stimulator.schedule.late")
    page.evaluate("() => { const end = performance.now() + 700; while (performance.now() < end); }")
    wait(page, f"window.stimulator.schedule.late > {before} + 5")
    page.wait_for_timeout(1500)
    reported = server.loop.state().late_pictures
    assert before + 5 < reported <= page.evaluate("window.stimulator.schedule.late")


def test_pictures_of_a_message_lead_to_the_next_one(server):
    """Turned on by the rate for a step, the attitude is that of the next frame: the same stars at the same pixels."""
    from simulator.live.mission import LiveMission
    from simulator.live.stimulus import Stimulus

    mission = LiveMission(server.mission.scenario)
    stimulus, step_s = Stimulus(DISPLAY, 20.0), 0.25
    first, pixels = stimulus.message(mission.step(), step_s, 1.0)
    frame = mission.step()
    second, following = stimulus.message(frame, step_s, 1.0)
    assert (first.bytes, second.bytes) == (len(pixels), len(following))
    assert [picture.t_s - first.t_s for picture in first.pictures] == pytest.approx(0.05 * np.arange(5))
    end = np.cumsum([0, *(8 * picture.pixels for picture in first.pictures)])
    assert end[-1] == first.bytes
    before, last = centroid(pixels[end[3] : end[4]]), centroid(pixels[end[4] :])
    # the stars go on as they went: half a degree a second is 1.2 px a picture
    assert centroid(following[: 8 * second.pictures[0].pixels]) - last == pytest.approx(last - before, abs=0.1)
    assert np.abs(last - before).max() > 0.5
    assert stimulus.message(frame, 0.0, 1.0)[0].paced is False


def centroid(pixels):
    """Of the brightest pixel's surroundings."""
    table = np.frombuffer(pixels, np.dtype([("at", "<u2", 2), ("rgb", "u1", 3), ("zero", "u1")]))
    at, levels = table["at"].astype(float), table["rgb"].astype(float)
    near = np.abs(at - at[np.argmax(levels.sum(axis=1))]).max(axis=1) < 4
    weight = ((levels[near] / 255) ** 2.2).sum(axis=1)
    return weight @ at[near] / weight.sum()
