"""What the figures of a datasheet show: curves of each stage of life, labels, scales."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from simulator.study.datasheet.plots import _draw, _draw_series, _draw_spectrum
from simulator.study.datasheet.scan import STEP_PX


def column(life, factor=1.0, values=(0.0, 5.0, 20.0, 50.0)):
    """A stage of life with a series of errors that grow with the value, and an availability that falls."""
    sizes = [[factor * (2.0 + k), factor * (1.5 + k), factor * (3.0 + k)] for k in range(len(values))]
    points = [
        {"value": value, "cross_rms_arcsec": size, "available": [1.0 if k < 2 else 0.8 - 0.1 * k, None, None]}
        for k, (value, size) in enumerate(zip(values, sizes, strict=True))
    ]
    points.append({"value": 60.0, "cross_rms_arcsec": [None, None, None], "available": [0.0, 0.0, 0.1]})
    return SimpleNamespace(life=life, series=[SimpleNamespace(points=points)])


def drawn(draw, *given):
    ax = Figure().add_subplot()
    draw(*given, ax)
    return ax


def test_a_series_has_a_curve_of_each_stage_and_the_availability_of_the_first():
    ax = drawn(_draw_series, [column("BOL"), column("EOL", 3.0)], 0, "false stars")
    lines = [container.lines[0] for container in ax.containers]
    assert [line.get_xdata().tolist() for line in lines] == [[0.0, 5.0, 20.0, 50.0]] * 2
    assert [line.get_ydata().tolist() for line in lines] == [[2.0, 3.0, 4.0, 5.0], [6.0, 9.0, 12.0, 15.0]]
    bars = ax.containers[1].lines[2][0].get_segments()
    assert [segment[:, 1].tolist() for segment in bars] == [[4.5 + 3 * k, 9.0 + 3 * k] for k in range(4)]
    assert [(text.get_text(), text.xy) for text in ax.texts] == [("60 %", (20.0, 4.0)), ("50 %", (50.0, 5.0))]
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["BOL", "EOL"]
    assert ax.get_xlabel() == "false stars"
    assert ax.get_xscale() == "linear"
    assert ax.get_ylim()[0] == 0.0
    assert ax.get_ylim()[1] > 18.0  # room for the shares above the curves


@pytest.mark.parametrize(("values", "scale"), [((0.0, 10.0, 500.0), "linear"), ((0.0, 10.0, 501.0), "symlog")])
def test_more_than_a_factor_of_fifty_is_logarithmic(values, scale):
    ax = drawn(_draw_series, [column("BOL", values=values)], 0, "particles")
    far = column("BOL", values=values)
    far.series[0].points.pop()  # the last value of `column`, 60
    assert drawn(_draw_series, [far], 0, "particles").get_xscale() == scale
    assert ax.get_legend() is None


def test_points_without_errors_make_no_curve():
    empty = column("BOL")
    empty.series[0].points = empty.series[0].points[-1:]
    assert drawn(_draw_series, [empty], 0, "false stars").containers == []


@pytest.mark.parametrize(("shares", "low"), [((0.95, 1.0), 0.9), ((0.7, 1.0), 0.68), ((0.2, 1.0), -0.03)])
def test_shares_have_an_axis_up_to_one(shares, low):
    """From 0.9 if all are above it, from zero if some are below a half."""
    points = [{"value": float(k), "available": [share, share, share]} for k, share in enumerate(shares)]
    from simulator.study.datasheet.plots import SHARE

    ax = drawn(_draw, [column("BOL"), column("EOL")], lambda _column: points, "available", "rate", SHARE)
    assert ax.get_ylim()[1] == pytest.approx(1.02)
    assert ax.get_ylim()[0] == pytest.approx(low, abs=0.012)
    errors = drawn(_draw, [column("BOL")], lambda _column: points, "available", "rate", "error [″]")
    assert errors.get_ylim()[0] == 0.0
    assert errors.get_ylim()[1] > 1.0
    assert errors.get_legend() is None
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["BOL", "EOL"]
    assert (ax.get_xlabel(), errors.get_ylabel()) == ("rate", "error [″]")


def test_a_spectrum_leaves_out_what_is_noise_and_marks_the_pixel():
    cycles = np.linspace(0.0, 0.5, 6)
    density = np.stack([np.full(6, 9.0), np.full(6, 2.0), np.full(6, 1.0)], axis=1)
    part = density.copy()
    part[2, 1], part[3, 1] = -0.1, 1e-5  # below 1e-4 of the total about this axis
    spectra = SimpleNamespace(cycles_per_px=cycles, total=density, noise=density, repeated=part, common=part)
    accuracy = SimpleNamespace(separated=SimpleNamespace(spectra=spectra), geometry=SimpleNamespace(step_px=1.7))
    ax = drawn(_draw_spectrum, SimpleNamespace(accuracy=accuracy), 1)
    values = {line.get_label(): np.asarray(line.get_ydata()) for line in ax.lines[:4]}
    assert values["total"].tolist() == [2.0] * 6
    assert np.isnan(values["repeated by other pixels"]).tolist() == [False, False, True, True, False, False]
    marks = [line.get_xdata()[0] for line in ax.lines[4:]]
    assert marks == pytest.approx([abs(step - round(step)) / 1.7 for step in STEP_PX])
    assert ax.get_yscale() == "log"
