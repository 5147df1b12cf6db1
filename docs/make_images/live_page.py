"""Do the experiments of docs/how-to/teach-live.md on the live page, print what it says, and draw its pictures.

python docs/make_images/live_page.py [--frames N]

With fewer frames after each change than the 25 of the guide's figures, it draws the same pictures sooner.
Needs the extra `live`, playwright and Chromium, named in the variable CHROMIUM or on the path.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from simulator import Scenario
from simulator.live.server import ServerOptions, serving

IMAGES = Path(__file__).resolve().parents[1] / "images"
SPEED, FRAMES = 5.0, 25
"""Factor on real time, and frames after a change before the page's figures are read, which are of its last 10 s."""
UPDATE_MS = 5500
"""The page updates its figures every five seconds."""


@contextmanager
def lesson(browser: Any, most: int, scenario: str) -> Iterator[Lesson]:
    """The page on a server of its own; `most` frames after each change."""
    options = ServerOptions(port=0, speed=SPEED, recordings=Path(tempfile.mkdtemp()))
    with serving(Scenario.load(scenario), options) as server:
        page = browser.new_context(viewport={"width": 1400, "height": 900}).new_page()
        page.goto(server.url)
        page.wait_for_selector("text=/^(Tracking|Solved)/")
        yield Lesson(page, server, most)
        page.context.close()


class Lesson:
    """What a class does with the page."""

    def __init__(self, page: Any, server: Any, most: int) -> None:
        self.page, self.server, self.most = page, server, most

    def frames(self, count: int = FRAMES) -> None:
        """Wait until so many more frames have been made, or as many as there may be after a change."""
        last = self.server.mission.index + min(count, self.most)
        while self.server.mission.index < last:
            self.page.wait_for_timeout(100)
        self.page.wait_for_timeout(500)

    def enter(self, path: str, value: float) -> None:
        """Type a value beside its slider."""
        number = self.page.locator(f'[data-path="{path}"] input[type=number]')
        number.fill(f"{value:g}")
        number.press("Enter")
        while self.page.locator(".slider.busy").count():
            self.page.wait_for_timeout(50)

    def says(self, what: str) -> str:
        """Print and return what the page says: verdict, stars, errors of its window."""
        page = self.page
        chart = page.evaluate("[...document.querySelectorAll('#errors')].map(n => n.ariaLabel)[0]") or ""
        figures = re.findall(r"rms ([\d.]+)″ = ([\d.]+) × bound ([\d.]+)", chart)
        named = zip("xyz", figures, strict=False)
        errors = ", ".join(f"{axis} {rms}″ = {ratio} × {bound}″" for axis, (rms, ratio, bound) in named)
        text = f"{page.inner_text('#verdict-text')}; stars {page.inner_text('#sol-stars')}; {errors}"
        print(f"{what:28} {text}  [1σ {page.inner_text('#sol-sigma')}]", flush=True)
        return text

    def measure(self, what: str) -> str:
        """The same after enough frames for a window of its own."""
        self.page.select_option("#window", "10")
        self.frames()
        if self.most >= FRAMES:
            self.page.wait_for_timeout(UPDATE_MS)
        return self.says(what)

    def draw(self, name: str, selector: str | None = None) -> None:
        """The page, or one part of it, as a picture."""
        shown = self.page.locator(selector) if selector else self.page
        (IMAGES / name).write_bytes(shown.screenshot(type="jpeg", quality=82))


def exposure(browser: Any, most: int) -> None:
    with lesson(browser, most, "cubesat_ideal") as does:
        does.frames(25)
        does.draw("live-page.jpg")
        does.page.click("#hold")
        for value_s in (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0):
            does.enter("detector.exposure_s", value_s)
            does.measure(f"exposure {value_s:g} s")
        does.page.click("#zoom")
        does.draw("live-exposure.jpg", ".panel.frame")


def bound(browser: Any, most: int) -> None:
    for scenario in ("cubesat_ideal", "cubesat"):
        with lesson(browser, most, scenario) as does:
            does.frames(40)
            does.measure(scenario)


def rate(browser: Any, most: int) -> None:
    with lesson(browser, most, "cubesat_ideal") as does:
        for value in (0.1, 0.3, 1.0):
            does.enter("pointing.rate_deg_s.yaw", value)
            does.measure(f"rate yaw {value:g}°/s")
        does.draw("live-rate.jpg", ".panel.frame")
        does.enter("pointing.rate_deg_s.yaw", 0.0)
        does.frames(3)
        does.says("rate yaw 0, 3 frames later")
        does.enter("detector.exposure_s", 0.02)
        does.page.fill("#kick-rate", "1")
        does.page.select_option("#kick-axis", "2")
        does.page.click("#kick")
        does.measure("kick 1°/s, exposure 0.02 s")


def blind(browser: Any, most: int) -> None:
    with lesson(browser, most, "cubesat_ideal") as does:
        does.frames(20)
        does.says("before")
        does.page.click("#blind")
        for _ in range(3):
            does.frames(5)
            does.says("blinded")
        does.page.click("#blind")
        does.frames(1)
        does.says("first frame after")
        does.frames(15)
        does.says("later")
        does.page.select_option("#window", "300")
        does.page.wait_for_timeout(1000)
        does.draw("live-blind.jpg", ".panel.errors")


def age(browser: Any, most: int) -> None:
    with lesson(browser, most, "cubesat_ideal") as does:
        does.measure("new, 20 °C")
        does.enter("detector.hot_pixel_fraction", 0.01)
        does.measure("1 % hot pixels, 20 °C")
        does.enter("detector.temperature_c", 60)
        does.measure("1 % hot pixels, 60 °C")
        does.enter("detector.temperature_c", -20)
        does.measure("1 % hot pixels, −20 °C")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=40, metavar="N", help="at most N frames after a change")
    most = parser.parse_args().frames
    program = os.environ.get("CHROMIUM") or shutil.which("chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        for experiment in (exposure, bound, rate, blind, age):
            print(f"\n{experiment.__name__}", flush=True)
            experiment(browser, most)
        browser.close()


if __name__ == "__main__":
    main()
