"""The page of a datasheet."""

from __future__ import annotations

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
from simulator.study.pages.drawing import drawn_apart
from simulator.study.pages.html import html_of
from simulator.study.pages.page import Block, Figures, Page, Section, Table, Words, lead, paragraph, soft
from simulator.study.pages.parts import provenance, unphysical_notes, verdict_table
from simulator.study.pages.pdf import pdf_of
from startracker._version import __version__

if TYPE_CHECKING:
    from simulator.study.datasheet.result import Column, Datasheet

_TIMES_NOTE = (
    "Computing times are in datasheet.timing.json beside this page, as they differ from run to run; everything on this "
    "page is reproduced bit for bit."
)


def datasheet_files(sheet: Datasheet) -> tuple[str, bytes]:
    """The page of a datasheet as HTML and as PDF."""
    return drawn_apart(_files, sheet)


def _files(sheet: Datasheet) -> tuple[str, bytes]:
    page = datasheet_page(sheet)
    return html_of(page), pdf_of(page)


def datasheet_page(sheet: Datasheet) -> Page:
    """Content of the page of a datasheet."""
    scenario, columns = sheet.scenario, sheet.columns
    origin = {"name": scenario.name, "seed": scenario.seed, "version": __version__}
    interpretations = Table(("interpretation", "meaning"), tuple(INTERPRETATIONS.items()), (1,))
    return Page(
        heading=f"{scenario.name}: datasheet",
        description=scenario.description,
        provenance=provenance(origin, sheet.identity.sha256),
        answer=tuple(block for column in columns for block in _answer(column)),
        verdict=columns[-1].judgement.state,
        notes=tuple(unphysical_notes(scenario.unphysical)),
        sections=(
            Section("Conditions", (_conditions(columns),)),
            *(Section(f"Accuracy, {column.life}", (accuracy_table(column),)) for column in columns),
            Section("Figures", (Figures(tuple(panels(columns))),)),
            *_sections(columns),
            Section("Terms", (terms_table(), interpretations, soft(STANDARD), soft(_TIMES_NOTE))),
        ),
        scenario=scenario.to_yaml(),
    )


def _sections(columns: list[Column]) -> list[Section]:
    """Performance and conditions, after the accuracy."""
    tables = [
        ("Acquisition", list_table(columns, "acquisition")),
        ("Tracking", list_table(columns, "tracking")),
        ("Angular rate", rate_table(columns)),
        ("Limit of the rate", list_table(columns, "rate_limit")),
        ("Sky coverage and exclusion", list_table(columns, "sky")),
        ("Temperature and robustness", conditions_table(columns)),
        ("Update rate and latency", list_table(columns, "timing")),
    ]
    return [Section(title, (table,)) for title, table in tables]


def _answer(column: Column) -> tuple[Block, ...]:
    """The answer for a stage of life: verdict, and error of the whole, noise, acquisition and rate in three lines."""
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
    return (
        lead(Words(f"{column.life}. {column.judgement.text}.", column.judgement.state)),
        verdict_table(column.judgement),
        *(paragraph(line) for line in (*found, "; ".join(texts) + ".")),
    )


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
