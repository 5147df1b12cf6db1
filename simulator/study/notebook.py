"""Notebooks: the answer of a study with a chart of its errors, small figures, and sliders that redraw them."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.study.axes import BODY_AXES
from simulator.study.specification.outcome import outcome_counts_text
from startracker.core import FloatArray
from startracker.display import html_card

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_LINES = {"roll": ("#2f81c9", ""), "pitch": ("#c9730a", "7 3"), "yaw": ("#2a9d6f", "2 3")}
"""Colour, 3 : 1 and more against white and black alike, and dashes of each body axis."""
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 420.0, 250.0, 42.0, 38.0, 22.0


def study_card(summary: Mapping[str, Any], columns: Mapping[str, NDArray[Any]]) -> str:
    """HTML with the number of solved and wrong trials, each axis beside its specification, and the chart of errors."""
    rows = {
        "trials": f"{summary['trials']}, seed {summary['seed']}",
        "solved": f"{summary['solved']}, {outcome_counts_text(summary)}",
    }
    for judged in summary["specification"].values():
        title, _, said = judged["text"].partition(": ")
        rows[title] = said
    rows["specification"] = summary["verdict"]["text"].partition(": ")[2]
    errors = {axis: np.abs(np.asarray(columns[f"error_{axis}_deg"], dtype=float)) for axis in BODY_AXES}
    finite = {axis: np.sort(values[np.isfinite(values) & (values > 0.0)]) for axis, values in errors.items()}
    chart = _distribution(finite) if all(len(values) > 1 for values in finite.values()) else ""
    return html_card(f"Study of {summary['name']}", rows, chart)


def _distribution(errors_deg: Mapping[str, FloatArray]) -> str:
    """Share of the solved trials with an error below x, about each body axis, as SVG with a logarithmic scale."""
    arcsec = {axis: values * 3600.0 for axis, values in errors_deg.items()}
    low = math.floor(math.log10(min(float(np.quantile(values, 0.02)) for values in arcsec.values())))
    high = math.ceil(math.log10(max(float(values[-1]) for values in arcsec.values())))
    right, down = _WIDTH - 8.0, _HEIGHT - _BOTTOM

    def across(value: float) -> float:
        return _LEFT + (right - _LEFT) * (math.log10(value) - low) / max(high - low, 1)

    def up(share: float) -> float:
        return down - (down - _TOP) * share

    lines, labels = "", ""
    for power in range(low, high + 1):
        x, text = across(10.0**power), f"{10.0**power:g}″"
        lines += f"M{x:.1f} {_TOP}V{down}"
        labels += f'<text x="{x:.1f}" y="{down + 14}" text-anchor="middle">{text}</text>'
    for percent in (0, 50, 100):
        y = up(percent / 100)
        lines += f"M{_LEFT} {y:.1f}H{right}"
        labels += f'<text x="{_LEFT - 5}" y="{y + 3.5:.1f}" text-anchor="end">{percent} %</text>'
    curves = ""
    for k, (axis, values) in enumerate(arcsec.items()):
        colour, dashes = _LINES[axis]
        shown = np.unique(np.linspace(0, len(values) - 1, 200).astype(int))
        points = [(across(max(values[n], 10.0**low)), up((n + 1) / len(values))) for n in shown.tolist()]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        style = f'fill="none" stroke="{colour}" stroke-width="2" stroke-dasharray="{dashes}"'
        x = _LEFT + 8 + 78 * k
        curves += f'<polyline points="{line}" {style}/>'
        curves += f'<path d="M{x} 10h22" {style}/><text x="{x + 27}" y="14">{axis}</text>'
    return (
        f'<svg role="img" aria-label="distribution of the errors" viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" '
        f'style="display:block;width:100%;max-width:{_WIDTH:.0f}px;height:auto" xmlns="http://www.w3.org/2000/svg">'
        '<g fill="currentColor" font-size="11" font-family="sans-serif" stroke="none">'
        f'<path d="{lines}" stroke="currentColor" stroke-opacity="0.18" fill="none"/>{labels}{curves}'
        f'<text x="{(_LEFT + right) / 2:.0f}" y="{_HEIGHT - 6:.0f}" text-anchor="middle">'
        "error; share of solved trials below it</text></g></svg>"
    )


Slider = tuple[float, float, float, float]
"""Lowest and highest value, step and value at the start of a parameter; whole numbers stay whole."""

_COLOURS = 96


def compact_figures(dpi: float = 80.0) -> None:
    """Show matplotlib's figures of this notebook as PNG pictures of 96 colours, a third of the usual size.

    Call it after ``%matplotlib inline``.

    Parameters
    ----------
    dpi : float
        Resolution, pixels per inch of the figure.
    """
    from IPython.core.getipython import get_ipython
    from matplotlib.figure import Figure

    shell = get_ipython()
    if shell is not None:
        formatter = shell.display_formatter.formatters["image/png"]
        formatter.for_type(Figure, lambda figure: _small_png(figure, dpi))


def _small_png(figure: Figure, dpi: float) -> bytes:
    from PIL import Image

    drawn, small = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png", dpi=dpi, bbox_inches="tight", facecolor="white")
    picture = Image.open(drawn).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE)
    picture.save(small, "PNG", optimize=True)
    return small.getvalue()


def with_sliders(draw: Callable[..., Figure], **parameters: Slider) -> None:
    """Show a figure, and a slider for each of its parameters that draws it again.

    The figure is part of the notebook's output and is seen without a kernel, and without ipywidgets.

    Parameters
    ----------
    draw : callable
        Returns a figure for the values of the parameters, which are given by keyword.
    **parameters : (lowest, highest, step, value)
        Range of each parameter.
    """
    from IPython.display import display

    values = {name: value for name, (_, _, _, value) in parameters.items()}
    shown = display(draw(**values), display_id=True)
    try:
        import ipywidgets
    except ImportError:
        print("pip install ipywidgets shows sliders here; without them, call the function with other values")
        return
    sliders = {}
    for name, (low, high, step, value) in parameters.items():
        whole = all(isinstance(number, int) for number in (low, high, step, value))
        kind = ipywidgets.IntSlider if whole else ipywidgets.FloatSlider
        label = name.replace("_", " ")
        sliders[name] = kind(value, min=low, max=high, step=step, description=label, continuous_update=False)
        sliders[name].style.description_width = "initial"

    def redraw(_: Any) -> None:
        shown.update(draw(**{name: slider.value for name, slider in sliders.items()}))

    for slider in sliders.values():
        slider.observe(redraw, "value")
    display(ipywidgets.VBox(list(sliders.values())))
