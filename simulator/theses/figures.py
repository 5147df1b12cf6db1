"""Figures as YAML files: content of each panel, from values by name.

A file holds figures by name. A figure has ``size`` (inches), ``grid`` (rows and columns of panels), ``axes`` (keywords
of ``subplots``), ``suptitle``, ``panels``, and ``every``, a panel whose entries are appended to those of each panel. A
figure with one panel has the keys of the panel instead:

``draw``
    A list of calls of methods of the axes: the first key is the method, its value the positional arguments, and the
    other keys are keywords, such as ``{plot: [$x, $y, "--"], color: BLUE, label: "{count} stars"}``.
``set``, ``legend``
    Keywords of ``axes.set`` and ``axes.legend``.
``projection``
    Projection of the panel, such as ``3d``.
``with``
    In a figure: a value whose entries are added to the values.

A text that starts with ``$`` is a value by name, braces in a text are replaced by values, and BLUE or INK is a colour
of `simulator.study.style`. A call or a panel with ``each: NAME`` is repeated for every mapping of that list, whose
entries are added to the values, with the keywords of ``styles`` in turn. In addition to the methods of axes there are
``circle`` and ``rectangle``; ``then`` in a call has the keywords of a ``colorbar`` or a ``bar_label`` of its result,
and ``figure_legend`` of a figure those of a common legend of all panels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from itertools import cycle
from typing import TYPE_CHECKING, Any, cast

from simulator.study import style
from simulator.theses.printed import Section, new_figure
from simulator.theses.tables import read_yaml, table_rows, value_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = {name: getattr(style, name) for name in ("INK", "SOFT", "BLUE", "ORANGE", "GREEN", "VERMILION")}


def section_of(name: str, title: str, values: Mapping[str, Any], tables: Sequence[str] = ()) -> Section:
    """A section from its values: the rows of its tables and the figures of its file, by default those of its name."""
    rows = [row for table in tables or (name,) for row in table_rows(table, values)]
    return Section(title, rows, figures(name, values))


def figures(name: str, values: Mapping[str, Any]) -> dict[str, Callable[[], Figure]]:
    """The figures of a file, such as ``"greyling1995/path"``, in its order."""
    return {key: partial(draw, f"{name}/{key}", values) for key in _plans(name)}


def draw(name: str, values: Mapping[str, Any]) -> Figure:
    """One figure, such as ``"greyling1995/path/fig_3_3_path"``, from its values.

    Raises
    ------
    KeyError
        For an unknown value or figure.
    """
    folder, file, key = name.split("/")
    plan = _plans(f"{folder}/{file}")[key]
    if "with" in plan:
        values = {**values, **value_of(plan["with"], values)}
    rows, columns = plan.get("grid", (1, 1))
    figure, made = new_figure(rows, columns, tuple(plan["size"]), squeeze=False, **plan.get("axes", {}))
    panels = [(panel, known) for panel in plan.get("panels", [plan]) for _turn, known in _each(panel, values)]
    for at, (panel, known) in zip(made.ravel(), panels, strict=True):
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
    folder, file = name.split("/")
    return dict(read_yaml(f"{folder}/figures/{file}"))


def _projected(axes: Axes, projection: str) -> Axes:
    """Axes of another projection instead of a panel."""
    figure: Any = axes.figure
    cell = axes.get_subplotspec()
    axes.remove()
    return cast("Axes", figure.add_subplot(cell, projection=projection))


def _draw_panel(axes: Axes, panel: Mapping[str, Any], values: Mapping[str, Any]) -> None:
    for call in panel.get("draw", []):
        method, positional = next(iter(call.items()))
        keywords = {key: value for key, value in call.items() if key not in (method, "each", "styles", "then")}
        for turn, known in _each(call, values):
            _call(axes, method, _filled(positional, known), _filled(keywords | turn, known), call.get("then", {}))
    if "set" in panel:
        axes.set(**_filled(panel["set"], values))
    if "legend" in panel:
        axes.legend(**_filled(panel["legend"], values))


def _call(axes: Axes, method: str, positional: Any, keywords: dict[str, Any], then: dict[str, Any]) -> None:
    from matplotlib import patches

    patch = {"circle": patches.Circle, "rectangle": patches.Rectangle}.get(method)
    if patch is not None:
        axes.add_patch(patch(*positional, **keywords))
        return
    made = getattr(axes, method)(*positional, **keywords)
    for name, options in then.items():
        if name == "colorbar":
            axes.figure.colorbar(made, ax=axes, **options)
        else:
            getattr(axes, name)(made, **options)


def _each(entry: Mapping[str, Any], values: Mapping[str, Any]) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Keywords and values of each repetition of a call or a panel."""
    items = value_of(entry["each"], values) if "each" in entry else [{}]
    for item, turn in zip(items, cycle(entry.get("styles", [{}]))):
        yield turn, {**values, **item}


def _filled(cell: Any, values: Mapping[str, Any]) -> Any:
    """A cell of the file with names replaced by values."""
    if isinstance(cell, dict):
        return {key: _filled(value, values) for key, value in cell.items()}
    if isinstance(cell, list):
        return [_filled(value, values) for value in cell]
    if not isinstance(cell, str):
        return cell
    if cell.startswith("$"):
        return value_of(cell[1:], values)
    return _COLOURS.get(cell) or cell.format_map(values)
