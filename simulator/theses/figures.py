"""Figures as YAML files: what is drawn into which panel, from values by name.

A file holds figures by name. A figure has ``size`` (inches), ``grid`` (rows and columns of panels), ``axes`` (keywords
of ``subplots``), ``suptitle``, ``panels``, and ``every``, a panel whose entries come after those of each of them. A
figure of one panel has the panel's own keys instead:

``draw``
    A list of calls of the axes' methods: the first key is the method, its value the positional arguments, the other
    keys are keywords, such as ``{plot: [$x, $y, "--"], color: BLUE, label: "{count} stars"}``.
``set``, ``legend``
    Keywords of ``axes.set`` and ``axes.legend``.
``projection``
    Of the panel, such as ``3d``.

A text with ``$`` in front is a value by name, braces in a text are filled in, and BLUE or INK is a colour of
`simulator.study.style`. A call or a panel with ``each: NAME`` stands once for every mapping of that list, whose entries
join the values, and takes the keywords of ``styles`` in turn; one with ``when: NAME`` is left out where that value is
empty. Beside the axes' own methods there are ``circle`` and ``rectangle``; ``colorbar`` and ``bar_label`` in a call are
the keywords of what belongs to what it has drawn, and ``figure_legend`` those of one legend for all panels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache, partial
from itertools import cycle
from typing import TYPE_CHECKING, Any, cast

from simulator.study import style
from simulator.theses.printed import new_figure
from simulator.theses.tables import Values, read_yaml, value_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw", "figures"]

_COLOURS = {name: getattr(style, name) for name in ("INK", "SOFT", "BLUE", "ORANGE", "GREEN", "VERMILION")}


def figures(file: str, values: Mapping[str, Callable[[], Values]]) -> dict[str, Callable[[], Figure]]:
    """Figures of a file, such as ``"greyling1995/path"``, by name: each with the function that gives its values."""
    return {name: partial(_of_function, file, name, function) for name, function in values.items()}


def _of_function(file: str, name: str, function: Callable[[], Values]) -> Figure:
    return draw(f"{file}/{name}", function())


def draw(name: str, values: Mapping[str, Any]) -> Figure:
    """One figure, such as ``"greyling1995/path/fig_3_3_path"``, from its values.

    Raises
    ------
    KeyError
        When it names a value that is not among them, or there is no such figure.
    """
    folder, file, key = name.split("/")
    plan = _plans(f"{folder}/figures/{file}")[key]
    rows, columns = plan.get("grid", (1, 1))
    figure, made = new_figure(rows, columns, tuple(plan["size"]), squeeze=False, **plan.get("axes", {}))
    panels = (panel for entry in plan.get("panels", [plan]) for panel in _each(entry, values))
    for at, (panel, _style, known) in zip(made.ravel(), panels, strict=True):
        axes = _projected(at, panel["projection"]) if "projection" in panel else at
        _draw_panel(axes, panel, known)
        _draw_panel(axes, plan.get("every", {}), known)
    if "suptitle" in plan:
        figure.suptitle(_filled(plan["suptitle"], values), fontsize=10)
    if "figure_legend" in plan:
        figure.legend(*figure.axes[0].get_legend_handles_labels(), **plan["figure_legend"])
    return figure


@lru_cache(maxsize=32)
def _plans(name: str) -> dict[str, dict[str, Any]]:
    return dict(read_yaml(name))


def _projected(axes: Axes, projection: str) -> Axes:
    """Axes of another projection in place of a panel."""
    figure: Any = axes.figure
    cell = axes.get_subplotspec()
    axes.remove()
    return cast("Axes", figure.add_subplot(cell, projection=projection))


def _draw_panel(axes: Axes, panel: Mapping[str, Any], values: Mapping[str, Any]) -> None:
    for entry in panel.get("draw", []):
        for call, style_of_turn, known in _each(entry, values):
            method, positional = next(iter(call.items()))
            keywords = _filled({key: value for key, value in call.items() if key not in (method, *_CONTROL)}, known)
            _call(axes, method, _filled(positional, known), keywords | style_of_turn, _filled(call.get("then"), known))
    if "set" in panel:
        axes.set(**_filled(panel["set"], values))
    if "legend" in panel:
        axes.legend(**_filled(panel["legend"], values))


_CONTROL = ("each", "styles", "when", "then")


def _call(axes: Axes, method: str, positional: Any, keywords: dict[str, Any], then: dict[str, Any] | None) -> None:
    from matplotlib import patches

    patch = {"circle": patches.Circle, "rectangle": patches.Rectangle}.get(method)
    if patch is not None:
        axes.add_patch(patch(*positional, **keywords))
        return
    made = getattr(axes, method)(*positional, **keywords)
    for name, options in (then or {}).items():
        if name == "colorbar":
            axes.figure.colorbar(made, ax=axes, **options)
        else:
            getattr(axes, name)(made, **options)


def _each(
    entry: Mapping[str, Any], values: Mapping[str, Any]
) -> Iterator[tuple[Mapping[str, Any], dict[str, Any], Mapping[str, Any]]]:
    """An entry as often as it stands: with the keywords of its turn and the values that it knows."""
    items = value_of(entry["each"], values) if "each" in entry else [{}]
    for item, turn in zip(items, cycle(entry.get("styles", [{}]))):
        known = {**values, **item}
        if "when" not in entry or len(value_of(entry["when"], known)):
            yield entry, _filled(turn, known), known


def _filled(cell: Any, values: Mapping[str, Any]) -> Any:
    """A cell of the file with its values in place of their names."""
    if isinstance(cell, dict):
        return {key: _filled(value, values) for key, value in cell.items()}
    if isinstance(cell, list):
        return [_filled(value, values) for value in cell]
    if not isinstance(cell, str):
        return cell
    if cell.startswith("$"):
        return value_of(cell[1:], values)
    return _COLOURS.get(cell) or cell.format_map(values)
