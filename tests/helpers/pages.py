"""Pages of studies in headless Chromium: overflow, contrast, empty plots.

Contrast: WCAG 2.1, 1.4.3 asks for 4.5 : 1 between text and what is behind it.
"""

import contextlib
import importlib.util
import io
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

CHROMIUM = Path(__file__).parents[1] / "end_to_end" / "chromium.py"
CONTRAST = """
(() => {
  const rgb = text => text.match(/[\\d.]+/g).slice(0, 3).map(Number);
  const linear = v => (v /= 255) <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  const light = text => { const [r, g, b] = rgb(text).map(linear);
                          return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const behind = node => { for (; node; node = node.parentElement) { const c = getComputedStyle(node).backgroundColor;
                           if (c !== 'rgba(0, 0, 0, 0)') return c; } return 'rgb(255, 255, 255)'; };
  const found = [];
  for (const node of document.querySelectorAll('body *')) {
    const own = [...node.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
    if (!own || !node.getClientRects().length) continue;
    if (node.closest('svg')?.querySelector('image')) continue;  // text on a picture has its own background
    const style = getComputedStyle(node);
    const front = light(node instanceof SVGElement ? style.fill : style.color), back = light(behind(node));
    const ratio = (Math.max(front, back) + 0.05) / (Math.min(front, back) + 0.05);
    if (ratio < 4.5) found.push(`contrast ${ratio.toFixed(1)}: ${node.textContent.trim().slice(0, 40)}`);
  }
  return found;
})()
"""
OVERFLOW = """
(width => [...document.querySelectorAll('body *')]
  .filter(n => !(n.closest('svg') && n.tagName !== 'svg') && n.getBoundingClientRect().right > width + 0.5)
  .map(n => `beyond the page: ${n.outerHTML.slice(0, 80)}`))
"""
EMPTY_PLOTS = """
[...document.querySelectorAll('figure svg')].filter(s => s.getClientRects().length)
  .filter(s => s.getBoundingClientRect().height < 60 || s.getBoundingClientRect().width < 150
             || s.querySelectorAll('[id*=axes] path, [id*=axes] use, [id*=axes] image').length < 6)
  .map(s => `empty plot: ${s.getAttribute('aria-label')}`)
"""


@contextlib.contextmanager
def browser():
    """A page of Chromium; the test is skipped without it, or fails in continuous integration."""
    spec = importlib.util.spec_from_file_location("chromium_over_a_pipe", CHROMIUM)
    chromium = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(chromium)
    program = chromium.find_chromium()
    if program is None:
        message = (
            "Chromium is missing: install it (Debian: apt-get install chromium) or name it in the variable CHROMIUM"
        )
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    with chromium.Page(program) as opened:
        yield opened


def screens(*widths):
    """Parameters `width` and `scheme`: each width and both schemes in every run, all pairs in ``make test-all``."""
    usual = {(width, ("light", "dark")[k % 2]) for k, width in enumerate(widths)}
    pairs = [(width, scheme) for width in widths for scheme in ("light", "dark")]
    marked = [pytest.param(*pair, marks=[] if pair in usual else [pytest.mark.slow]) for pair in pairs]
    return pytest.mark.parametrize(("width", "scheme"), marked)


def faults(page, uri, width, scheme):
    """What is wrong with a page at a width of the window, in light or dark: one line each."""
    page.screen(width, scheme=scheme, mobile=width < 500)
    page.open(uri)
    found = [str(complaint) for complaint in page.complaints()]
    if page.value("document.documentElement.scrollWidth > document.documentElement.clientWidth"):
        found.append("the page scrolls sideways")
    found += page.value(f"{OVERFLOW}({width})") + page.value(CONTRAST) + page.value(EMPTY_PLOTS)
    shot = np.asarray(Image.open(io.BytesIO(page.picture())).convert("L"), dtype=float)
    if not ((shot[2, 2] > 240) if scheme == "light" else (shot[2, 2] < 40)):
        found.append(f"background {shot[2, 2]} in {scheme}")
    if np.mean(np.abs(shot - shot[2, 2]) > 60) < 0.02:
        found.append("hardly anything on the page")
    return found


def faults_on_paper(page, uri, most_pages):
    """What is wrong with the print on A4 paper: one line each. 703 px is the width of the text."""
    page.screen(703, scheme="dark", medium="print", mobile=True)
    page.open(uri)
    found = page.value(f"{OVERFLOW}(703)") + page.value(CONTRAST) + page.value(EMPTY_PLOTS)
    if page.value("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 254)":
        found.append("the paper is not white")
    pages = page.printed().count(b"/Type /Page\n")
    return found + ([] if 0 < pages <= most_pages else [f"{pages} pages, at most {most_pages}"])
