"""The example of docs/tracking.md runs."""

import re
from pathlib import Path


def test_example_runs(capsys):
    page = Path(__file__).parents[2] / "docs" / "tracking.md"
    (example,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(example, str(page), "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("lost_in_space")
    assert all(line.startswith("tracking") for line in lines[1:])
    assert len(lines) == 8
