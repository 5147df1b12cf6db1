"""The detectors of the two theses, which register themselves as those of any other package do.

The entry points of the group ``boresight.detectors`` in ``pyproject.toml`` name them; the tracker imports none of them.
"""
