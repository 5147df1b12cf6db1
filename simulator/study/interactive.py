"""Figures of notebooks: small files, and sliders that redraw a figure that is also there without them."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
