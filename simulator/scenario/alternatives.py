"""Keys that exclude each other, and what becomes of those that a file inherits.

A file that defines something in another way than its base, such as an orbit by its elements instead of a circular one,
or another model of the star images, need not know the keys with which the base defines it: they fall away. Only keys
of one layer (a file, or the options of a command) can contradict each other; the rules of the sections report that.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, NamedTuple

from simulator.mission.parameters import ATTITUDE_FILES, FILES, SOURCES
from simulator.optics.psf_model import ABERRATIONS
from simulator.scenario.detector_rules import CCD_ONLY, SHUTTER_OF
from simulator.scenario.document import Entry, Table, Value
from simulator.scenario.orbit_rules import GIVEN_BY
from simulator.scenario.overrides import merge
from simulator.scenario.pointing_rules import LAW_KEYS

Given = Mapping[str, Any]
"""Values of a layer or of one of its sections, as plain nested mappings."""

CIRCULAR = ("altitude_km", "inclination_deg", "ltan_h", "raan_deg", "argument_of_latitude_deg")
"""Keys that define a circular orbit."""
_ORBITS = ("orbit", "pointing.track.spacecraft")
_WIDTHS = ("sigma_px", "first_dark_ring_px")
_NOT_OF_MODEL = {
    "gaussian": ("polychromatic", *ABERRATIONS),
    "airy": ("sigma_px", *ABERRATIONS),
    "diffraction": _WIDTHS,
}
"""Keys of ``optics.psf`` that a model does not use."""


class _Rule(NamedTuple):
    section: str
    replaced: Callable[[Given, Given], Collection[str]]
    """Keys of the section in the layer below that the layer above replaces, from both."""


def layered(below: Table, above: Table) -> Table:
    """`above` over `below`, without the keys of `below` that `above` replaces by others."""
    for path in replaced_keys(below.plain(), above.plain()):
        below = _without(below, path)
    if _file_of(above):
        below = _without(below, "study.sampling")
    return merge(below, above)


def replaced_keys(below: Given, above: Given) -> Iterator[str]:
    """Dotted paths of keys and sections of `below` that `above` replaces by others; both are nested values."""
    for rule in _RULES:
        lower, upper = (_at(values, rule.section) for values in (below, above))
        if isinstance(lower, Mapping) and isinstance(upper, Mapping):
            yield from (f"{rule.section}.{key}" for key in rule.replaced(lower, upper))


def with_sampling(tree: Table) -> Table:
    """A tree whose orbit or attitude is that of a file, and which does not say how trials are distributed: over the
    span of that file."""
    section, named = tree.entries.get("study"), _file_of(tree)
    study = section.node if section else Table(tree.location)
    if named is None or not isinstance(study, Table) or "sampling" in study.entries:
        return tree
    sampling = Entry(named.location, Value("span", named.location))
    filled = Table(study.location, {**study.entries, "sampling": sampling})
    return Table(
        tree.location, {**tree.entries, "study": Entry(section.location if section else named.location, filled)}
    )


def _file_of(tree: Table) -> Entry | None:
    """The key with the file of an orbit or attitude; None if there is none."""
    for section, keys in (("orbit", FILES), ("pointing.attitude", ATTITUDE_FILES)):
        table = _table(tree, section)
        for key in keys:
            entry = table.entries.get(key) if table else None
            if entry and isinstance(entry.node, Value) and entry.node.data is not None:
                return entry
    return None


def _orbit(below: Given, above: Given) -> Collection[str]:
    """All keys of an orbit that is defined in another way; of a circular one, the other key of the node."""
    old, new = _source(below), _source(above)
    if old and new and old != new:
        return below.keys()
    node = {"ltan_h": "raan_deg", "raan_deg": "ltan_h"}
    return [other for key, other in node.items() if above.get(key) is not None and other not in above]


def _source(orbit: Given) -> str:
    """What defines an orbit: ``circular``, or the key that does; empty if nothing does."""
    defining = ((key, GIVEN_BY.get(key, key)) for key in SOURCES)
    given = [key for key, path in defining if _at(orbit, path) is not None]
    circular = any(orbit.get(key) is not None for key in CIRCULAR)
    return given[0] if given else "circular" if circular else ""


def _attitude(below: Given, above: Given) -> Collection[str]:
    """The other laws, if one is given."""
    if not any(_at(above, key) for keys in LAW_KEYS.values() for key in keys):
        return ()
    return [law for law in LAW_KEYS if law not in above and law in below]


def _jitter(below: Given, above: Given) -> Collection[str]:
    if above.get("series") is not None:
        return below.keys()
    return ("series",) if "rms_arcsec" in above else ()


def _psf(below: Given, above: Given) -> Collection[str]:
    old, new = below.get("model", "gaussian"), above.get("model")
    replaced = set(_NOT_OF_MODEL.get(str(new), ())) if new not in (None, old) else set()
    if above.get("polychromatic"):
        replaced |= set(_WIDTHS)
    for key, other in zip(_WIDTHS, reversed(_WIDTHS), strict=True):
        if above.get(key) is not None:
            replaced.add(other)
    return replaced


def _detector(below: Given, above: Given) -> Collection[str]:
    """Effects and shutter that another kind of detector does not have."""
    kind = above.get("kind")
    if kind is None:
        return ()
    shutter = () if kind in SHUTTER_OF.get(str(below.get("shutter")), (kind,)) else ("shutter",)
    return (*(CCD_ONLY if kind == "cmos" else ()), *shutter)


def _projection(below: Given, above: Given) -> Collection[str]:
    """The coefficients of another projection."""
    new = above.get("projection")
    return ("distortion",) if new not in (None, below.get("projection", "pinhole")) else ()


_RULES = (
    *(_Rule(section, _orbit) for section in _ORBITS),
    _Rule("pointing", _attitude),
    _Rule("pointing.jitter", _jitter),
    _Rule("optics.psf", _psf),
    _Rule("optics", _projection),
    _Rule("detector", _detector),
)


def _at(values: Any, path: str) -> Any:
    """Value at a dotted path; None if there is none, or no section, whose error is reported elsewhere."""
    for name in path.split("."):
        values = values.get(name) if isinstance(values, Mapping) else None
    return values


def _table(tree: Table, path: str) -> Table | None:
    """A section; None if there is none."""
    node: Table | Value = tree
    for part in path.split("."):
        if not isinstance(node, Table) or part not in node.entries:
            return None
        node = node.entries[part].node
    return node if isinstance(node, Table) else None


def _without(tree: Table, path: str) -> Table:
    """The tree without a key or a section."""
    name, _, rest = path.partition(".")
    entries = dict(tree.entries)
    entry = entries.pop(name, None)
    if entry is not None and rest:
        entries[name] = Entry(entry.location, _without(entry.node, rest)) if isinstance(entry.node, Table) else entry
    return Table(tree.location, entries)
