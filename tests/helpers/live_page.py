"""Chromium with playwright on the page of a live mission: what goes wrong on it, and what the server sends."""

import contextlib
import importlib.util
import json
import os
import re
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import expect, sync_playwright

WAIT_MS = 30_000
_SPEC = importlib.util.spec_from_file_location(
    "chromium_over_a_pipe", Path(__file__).parents[1] / "end_to_end" / "chromium.py"
)


@contextlib.contextmanager
def chromium():
    """A browser; the test is skipped without Chromium, or fails in continuous integration."""
    module = importlib.util.module_from_spec(_SPEC)
    _SPEC.loader.exec_module(module)
    program = module.find_chromium()
    if program is None:
        message = "Chromium is missing: install it or name it in the variable CHROMIUM"
        pytest.fail(message) if os.environ.get("CI") else pytest.skip(message)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-dev-shm-usage"])
        yield browser
        browser.close()


def until(page, expression):
    """Wait until a JavaScript expression is true; by polling, as the page's own policy forbids it to evaluate text."""
    for _ in range(WAIT_MS // 50):
        if page.evaluate(expression):
            return
        page.wait_for_timeout(50)
    pytest.fail(f"not within {WAIT_MS / 1000:g} s: {expression}")


def says(page, pattern):
    """Wait until the status line says `pattern`."""
    expect(page.locator("#verdict-text")).to_have_text(re.compile(pattern), timeout=WAIT_MS)


class Visit:
    """A page of its own in the browser, with all that it complains of and all that the server tells it."""

    def __init__(self, browser, address, width=1400, height=900, scheme="light", **options):
        self.context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme, **options)
        self.page = self.context.new_page()
        self.complaints, self.received = [], []
        self.host = urlsplit(address).netloc
        self.page.on("console", lambda m: m.type in ("error", "warning") and self.complaints.append(m.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", self._requested)
        self.page.on("websocket", lambda socket: socket.on("framereceived", self._heard))
        self.address = address

    def open(self):
        """Open the page, and wait until it has a solution."""
        self.page.goto(self.address)
        says(self.page, "^(?!Connecting|Waiting)")
        return self

    def _requested(self, request):
        if urlsplit(request.url).scheme not in ("data", "blob") and urlsplit(request.url).netloc != self.host:
            self.complaints.append(f"request to {request.url}")

    def _heard(self, payload):
        if isinstance(payload, str):
            self.received.append(json.loads(payload))

    def messages(self, kind):
        """Messages of a type received so far."""
        return [message for message in self.received if message["type"] == kind]

    def latest(self, kind):
        """The latest message of a type; waits for the first one."""
        for _ in range(WAIT_MS // 50):
            if found := self.messages(kind):
                return found[-1]
            self.page.wait_for_timeout(50)
        return pytest.fail(f"no {kind} within {WAIT_MS / 1000:g} s")

    def close(self):
        """End the visit; nothing may have gone wrong."""
        self.context.close()
        assert not self.complaints, self.complaints
