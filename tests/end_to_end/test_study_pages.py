"""Pages of sequences, sweeps and comparisons as readers see them: desktop, tablet and phone, light, dark, on paper.

The sequence is a real one of few frames; sweep and comparison have made-up trials, as only the layout is tested.
"""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pages import browser, faults, faults_on_paper, screens

from simulator.checks import load_scenario
from simulator.study.axes import AXES
from simulator.study.pages.html import html_of
from simulator.study.point_statistics import point_statistics
from simulator.study.sequence.page import sequence_page
from simulator.study.sequence.run import run_sequence
from simulator.study.specification.measured import Measured
from simulator.study.specification.requirements import Specification
from simulator.study.specification.verdicts import judge
from simulator.study.sweep.compare import compare
from simulator.study.sweep.comparison_page import comparison_page
from simulator.study.sweep.page import sweep_page
from simulator.study.sweep.plots import sweep_figures

pytestmark = pytest.mark.system

DIGEST = "0123456789abcdef" * 4
ORIGIN = {"seed": 1, "version": "1.2.3", "finished_utc": "2026-11-23T04:00:00+00:00"}


def trials(scale, n=40):
    """Columns of trials with Gaussian errors of `scale` arcseconds."""
    rng = np.random.default_rng(1)
    columns = {
        "index": np.arange(n),
        "status": np.array(["solved"] * n, dtype=object),
        "wrong": np.zeros(n, dtype=bool),
        "stars_matched": np.full(n, 12),
        "render_ms": np.full(n, 20.0),
        "solve_ms": np.full(n, 5.0),
    }
    return columns | {f"error_{axis}_deg": rng.normal(0, scale / 3600, n) for axis in AXES}


def judged(scale):
    """Verdicts on such trials."""
    specification = Specification.of_limits({"roll": 0.025, "pitch": 0.286, "yaw": 0.025})
    return judge(specification, Measured(trials(scale), specification))


def sweep_table():
    """A full grid of two keys as in ``sweep.json``, with one unphysical point."""
    focal, exposure = [35.0, 45.0, 55.0], [0.1, 0.3]
    points = [
        {"point": k, "values": {"optics.focal_length_mm": f, "detector.exposure_s": e}, "status": "done", "reason": "",
         "statistics": point_statistics(trials(2.0 + k), 1, judged(2.0 + k))}
        for k, (f, e) in enumerate((f, e) for f in focal for e in exposure)
    ]  # fmt: skip
    points[-1] = {**points[-1], "status": "refused", "reason": "the exposure is longer than " + "a very long time " * 9}
    del points[-1]["statistics"]
    axes = [("optics.focal_length_mm", "mm", focal), ("detector.exposure_s", "s", exposure)]
    swept = [{"path": p, "unit": u, "values": v, "numeric": True, "log": False} for p, u, v in axes]
    return {
        "name": "made-up", "scenario_file": "made-up.yaml", **ORIGIN, "identity": {"sha256": DIGEST}, "kind": "grid",
        "trials_per_point": 40, "interrupted": False, "swept": swept, "points": points,
        "specification_deg": {"roll": 0.025, "pitch": 0.286, "yaw": 0.025}, "trials_needed": 1228,
    }  # fmt: skip


def compared_runs(folder):
    """Folders of three runs, of which the last differs in many keys."""
    for name, scale, overrides in (("a", 1.0, []), ("b", 2.0, ["optics.aperture_mm=12"]), ("c", 3.0, ["seed=2"])):
        run = folder / name
        run.mkdir()
        scenario = load_scenario("tc211", overrides)
        (run / "scenario.resolved.yaml").write_text(scenario.to_yaml())
        identity = {"name": "tc211", "seed": scenario.seed, "version": "1.2.3", "sha256": DIGEST}
        (run / "summary.json").write_text(json.dumps({"seed": scenario.seed, "identity": identity}))
        pq.write_table(pa.table(trials(scale)), run / "trials.parquet")
        yield run


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """File of each page by kind."""
    folder = tmp_path_factory.mktemp("pages")
    sweep = sweep_table()
    small = ["sequence.frames=8", "detector.width=200", "detector.height=200", "detector.pixel_pitch_um=28"]
    sequence = run_sequence(load_scenario("slew", [*small, "optics.psf.sigma_px=0.7"]), single=True)
    sequence.summary["unphysical"] = ["a lens of f/0.3"]
    pages = {
        "sweep": sweep_page(sweep, sweep_figures(sweep)),
        "compare": comparison_page(compare(list(compared_runs(folder)))),
        "sequence": sequence_page(sequence),
    }
    for kind, content in pages.items():
        (folder / f"{kind}.html").write_text(html_of(content), encoding="utf-8")
    return {kind: folder / f"{kind}.html" for kind in pages}


@pytest.fixture(scope="module")
def page():
    with browser() as opened:
        yield opened


@pytest.mark.parametrize("kind", ["sweep", "compare", "sequence"])
@screens(1400, 800, 390)
def test_page_is_complete_and_legible(page, files, kind, scheme, width):
    assert faults(page, files[kind].as_uri(), width, scheme) == []


@pytest.mark.parametrize("kind", ["sweep", "compare", "sequence"])
def test_page_prints_on_a_few_sheets(page, files, kind):
    assert faults_on_paper(page, files[kind].as_uri(), most_pages=6) == []


def test_pages_state_their_origin(files):
    texts = {kind: file.read_text(encoding="utf-8") for kind, file in files.items()}
    assert "Scenario made-up, digest 0123456789ab, seed 1, boresight 1.2.3, 2026-11-23 04:00 UTC" in texts["sweep"]
    assert texts["compare"].count("0123456789ab") == 3
    assert " UTC" in texts["sequence"]


def test_a_fault_is_found(page, tmp_path):
    """A wide table, pale text and a plot without content."""
    file = tmp_path / "bad.html"
    file.write_text(
        '<body style="background: #fff"><p style="width: 3000px; color: #ddd">pale and wide</p>'
        '<figure><svg aria-label="nothing" viewBox="0 0 300 200"></svg></figure></body>'
    )
    found = "\n".join(faults(page, file.as_uri(), 800, "light"))
    for words in ("scrolls sideways", "beyond the page", "contrast", "empty plot: nothing", "hardly anything"):
        assert words in found
