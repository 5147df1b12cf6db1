"""Constraints for pip that hold every dependency at its lower bound in pyproject.toml: `make test-lowest`.

python tests/lowest_versions.py > constraints.txt
pip install --constraint constraints.txt --editable . pytest hypothesis
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
_BOUND = re.compile(r"(?P<name>[\w.-]+)>=(?P<version>[\w.]+)(,<[\w.]+)?")


def constraints(project: Path = PROJECT) -> list[str]:
    """``name==lowest`` of every dependency and of those of the extra ``test``; ValueError for one without a bound."""
    with project.open("rb") as stream:
        table = tomllib.load(stream)["project"]
    lines = []
    for requirement in [*table["dependencies"], *table["optional-dependencies"]["test"]]:
        found = _BOUND.fullmatch(requirement)
        if found is None:
            raise ValueError(f"{requirement}: needs a lower bound, as in name>=1.2")
        lines.append(f"{found['name']}=={found['version']}")
    return lines


if __name__ == "__main__":
    print("\n".join(constraints()))
