"""examples/plugin installs without a network, is found by its entry point, and passes its own test."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

PLUGIN = Path(__file__).parents[2] / "examples" / "plugin"


def test_plugin_installs_and_passes_its_test(tmp_path):
    for module in ("sep", "hatchling"):
        pytest.importorskip(module)
    source, target = tmp_path / "source", tmp_path / "installed"
    shutil.copytree(PLUGIN, source)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-build-isolation", "--no-deps"]
    subprocess.run([*pip, "--target", str(target), str(source)], check=True, capture_output=True)
    (source / "boresight_sep.py").unlink()  # what is tested is the installed one
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(target), str(PLUGIN.parents[1])])}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir", "."]
    done = subprocess.run(
        [*command, "test_boresight_sep.py"], cwd=source, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout
