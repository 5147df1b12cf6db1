"""The page of a datasheet, and the same as PDF."""

from __future__ import annotations

import io
from dataclasses import replace
from typing import TYPE_CHECKING

from simulator.scenario import Scenario
from simulator.study.datasheet.plots import panels
from simulator.study.datasheet.sheet import select
from simulator.study.datasheet.tables import (
    AXIS_NAMES,
    accuracy_table,
    conditions_table,
    estimate_text,
    list_table,
    rate_table,
    terms_table,
)
from simulator.study.datasheet.words import INTERPRETATIONS, STANDARD
from simulator.study.html_page import DIGEST_DIGITS, TONES, Table, drawn, render_page, verdict_table
from simulator.study.report.drawing import drawn_apart
from simulator.study.style import SOFT, style
from startracker._version import __version__

if TYPE_CHECKING:
    from simulator.study.datasheet.result import Column, Datasheet


def datasheet_pages(sheet: Datasheet) -> tuple[str, bytes]:
    """A complete page without scripts or external links, and the same as a PDF file of A4 pages."""
    return drawn_apart(_pages, sheet)


def _pages(sheet: Datasheet) -> tuple[str, bytes]:
    return _html(sheet), _pdf(sheet)


def _html(sheet: Datasheet) -> str:
    found = panels(sheet.columns)
    return render_page(
        "datasheet/datasheet.html.j2",
        scenario=sheet.scenario,
        provenance=_provenance(sheet),
        tone=TONES[sheet.columns[-1].judgement.state],
        answers=[
            (column.life, column.judgement.text, verdict_table(column.judgement), list(map(_joined, _answers(column))))
            for column in sheet.columns
        ],
        conditions=_conditions(sheet.columns),
        accuracy=[(column.life, _joined_cells(accuracy_table(column))) for column in sheet.columns],
        sections=[(heading, _joined_cells(table)) for heading, table in _sections(sheet.columns)],
        figures=[drawn(panel, f"d{k}") for k, panel in enumerate(found)],
        terms=terms_table(),
        interpretations=INTERPRETATIONS,
        standard=STANDARD,
        resolved=sheet.scenario.to_yaml(),
    )


def _joined(text: str) -> str:
    """Text in which a browser does not break an interval after its dash."""
    return text.replace("–", "–\N{WORD JOINER}")


def _joined_cells(table: Table) -> Table:
    return replace(table, rows=tuple(tuple(map(_joined, row)) for row in table.rows))


def _pdf(sheet: Datasheet) -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages

    from simulator.study.report.pdf import Paper

    stream = io.BytesIO()
    title = {"Title": f"{sheet.scenario.name}: datasheet", "CreationDate": None}
    with style(), PdfPages(stream, metadata=title) as pages:
        paper = Paper(pages, _provenance(sheet))
        paper.text(f"{sheet.scenario.name}: datasheet", 18, weight="bold")
        paper.text(sheet.scenario.description, 9, colour=SOFT)
        paper.text(_provenance(sheet), 8, colour=SOFT)
        for column in sheet.columns:
            paper.text(f"{column.life}. {column.judgement.text}.", 11, weight="bold")
            paper.table(verdict_table(column.judgement), 6.5)
            for line in _answers(column):
                paper.text(line, 9)
        paper.heading("Conditions")
        paper.table(_conditions(sheet.columns))
        for column in sheet.columns:
            paper.heading(f"Accuracy, {column.life}")
            table = accuracy_table(column)
            paper.table(table, 6.5)
            paper.text(table.note, 8, colour=SOFT)
        paper.heading("Figures")
        paper.panels(panels(sheet.columns), 2)
        for heading, table in _sections(sheet.columns):
            paper.heading(heading)
            paper.table(table, 6.5)
        paper.heading("Terms")
        paper.table(terms_table(), 6.5)
        paper.text(" ".join(f"{name}: {text}." for name, text in INTERPRETATIONS.items()), 8)
        paper.text(STANDARD, 8, colour=SOFT)
        paper.end()
    return stream.getvalue()


def _sections(columns: list[Column]) -> list[tuple[str, Table]]:
    """Tables after the accuracy, with their headings."""
    return [
        ("Acquisition", list_table(columns, "acquisition")),
        ("Tracking", list_table(columns, "tracking")),
        ("Angular rate", rate_table(columns)),
        ("Limit of the rate", list_table(columns, "rate_limit")),
        ("Sky coverage and exclusion", list_table(columns, "sky")),
        ("Temperature and robustness", conditions_table(columns)),
        ("Update rate and latency", list_table(columns, "timing")),
    ]


def _provenance(sheet: Datasheet) -> str:
    digest = sheet.identity.sha256[:DIGEST_DIGITS]
    return f"Scenario {sheet.scenario.name}, digest {digest}, seed {sheet.scenario.seed}, boresight {__version__}"


def _answers(column: Column) -> list[str]:
    """The answer in three lines: error of the whole, noise, acquisition and rate."""
    accuracy = column.sections["accuracy"]

    def line(name: str, level: float) -> str:
        values = [(axis, select(accuracy, name, axis, level)) for axis in AXIS_NAMES]
        known = [f"{AXIS_NAMES[axis]} {estimate_text(q.estimate, q.unit)}" for axis, q in values if q is not None]
        return ", ".join(known)

    found = [
        f"Measurement error, 99.7 %, mixed: {line('measurement_error', 99.7)}.",
        f"Temporal noise (NEA), 68 %, mixed: {line('temporal_noise', 68.0)}.",
    ]
    singles = (
        ("acquisition", "acquisition_probability_lost_in_space", True),
        ("rate_limit", "greatest_rate", False),
        ("tracking", "greatest_acceleration", False),
    )
    texts = []
    for section, name, percent in singles:
        quantity = select(column.sections[section], name)
        if quantity is not None:
            texts.append(f"{quantity.title}: {estimate_text(quantity.estimate, quantity.unit, percent)}")
    return [*found, "; ".join(texts) + "."]


def _conditions(columns: list[Column]) -> Table:
    """Camera and mission of each stage of life."""
    lines = [_camera(column.scenario) for column in columns]
    rows = tuple((name, *(line[name] for line in lines)) for name in lines[0])
    return Table(("condition", *(column.life for column in columns)), rows, tuple(range(len(columns) + 1)))


def _age(scenario: Scenario) -> str:
    environment = scenario.environment
    if not environment.has_damage:
        return "as new"
    return f"{environment.age_years:g} years behind {environment.shield_mm:g} mm of aluminium, {environment.estimate}"


def _camera(scenario: Scenario) -> dict[str, str]:
    optics, detector, tracker = scenario.optics, scenario.detector, scenario.tracker
    pitch = " × ".join(f"{value:g}" for value in dict.fromkeys(detector.pitch_um))
    return {
        "lens": f"{optics.focal_length_mm:g} mm, aperture {optics.aperture_mm:g} mm",
        "detector": f"{detector.width} × {detector.height} pixels of {pitch} µm",
        "exposure": f"{detector.exposure_s:g} s, every {scenario.sequence.step_s:g} s",
        "temperature": f"detector {detector.temperature_c:g} °C, lens {optics.thermal.temperature_c:g} °C",
        "orbit": scenario.orbit.described,
        "age": _age(scenario),
        "tracker": f"{tracker.catalog} to V {tracker.magnitude_limit:g}, {tracker.centroider}, {tracker.identifier}",
        "fields": f"attitudes by study.sampling: {scenario.study.sampling}",
    }
