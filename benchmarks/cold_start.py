"""Start-up of a fresh installation: time to compile the kernels before the first result.

    python -m benchmarks.cold_start [--what run solve] [--scenario FILE] [--image FILE] [--least-s 0.3] [--signatures]

Each command runs in a separate process with an empty ``NUMBA_CACHE_DIR``; Python's byte code is on disk. The tables
give the CPU time of compilation by package, module and kernel, without that of the called kernels. "NumPy and Python"
are library functions compiled into ours, such as ``np.sort``.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

from numba.core import event

from benchmarks.report import Table, show

ROOT = Path(__file__).resolve().parent.parent
PHOTOGRAPH = ROOT.parent / "shared" / "sky" / "short_exposure_50ms.jpg"
TARGET_CPU_S = {"run": 48.0, "solve": 18.0}
OURS = ("simulator", "startracker")
LIBRARIES = "NumPy and Python"


@dataclass(frozen=True)
class Compiled:
    """A kernel compiled for one signature; CPU seconds without those of the kernels it calls."""

    module: str
    kernel: str
    arguments: str
    cpu_s: float
    caller: str
    """Our kernel during whose compilation this one was compiled, if any."""

    @property
    def ours(self) -> bool:
        return self.module.startswith(OURS)

    @property
    def room(self) -> str:
        return ".".join(self.module.split(".")[:2]) if self.ours else LIBRARIES


@dataclass(frozen=True)
class ColdStart:
    """One command with an empty cache, and repeated with a filled one."""

    cpu_s: float
    wall_s: float
    warm_cpu_s: float
    warm_wall_s: float
    compiled: list[Compiled]


def main() -> None:
    """Measure and print."""
    if sys.argv[1:2] == ["--child"]:
        _record(Path(sys.argv[2]), sys.argv[3:])
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--what", nargs="+", choices=sorted(TARGET_CPU_S), default=["run", "solve"])
    parser.add_argument("--scenario", type=Path, default=ROOT / "scenarios" / "cubesat.yaml", help="scenario to run")
    parser.add_argument("--image", type=Path, help="photograph to solve; default: one of ../shared/sky, or a frame")
    parser.add_argument("--least-s", type=float, default=0.3, help="kernels of less processor time are not listed")
    parser.add_argument("--signatures", action="store_true", help="list each signature")
    asked = parser.parse_args()
    for what in asked.what:
        with tempfile.TemporaryDirectory() as folder:
            if what == "run":
                found = measure(["run", str(asked.scenario.resolve()), *_RUN, f"{folder}/out"], Path(folder))
            else:
                found = measure(["solve", str(asked.image or _image(Path(folder)))], Path(folder))
        _print(what, found, asked.least_s, asked.signatures)


_RUN = ["--trials", "4", "--workers", "1", "--force", "--out"]


def measure(command: list[str], folder: Path) -> ColdStart:
    """Run a command of ``boresight`` with an empty cache in `folder`, and again with the filled cache."""
    child = [sys.executable, "-m", "benchmarks.cold_start", "--child", str(folder / "compiled.json"), *command]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "numba"), "OMP_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # it is written once for an installation
    cpu_s, wall_s = _times(child, environment)
    compiled = [Compiled(**row) for row in json.loads((folder / "compiled.json").read_text())]
    return ColdStart(cpu_s, wall_s, *_times(child, environment), compiled)


def _times(command: list[str], environment: dict[str, str]) -> tuple[float, float]:
    """CPU and wall-clock seconds of a process and its children."""
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu_s, time.perf_counter() - started


def _image(folder: Path) -> Path:
    """A photograph, or the preview of a rendered frame if there is none."""
    if PHOTOGRAPH.exists():
        return PHOTOGRAPH
    preview = folder / "preview.png"
    render = [sys.executable, "-m", "simulator.cli", "render", "cubesat", "--preview", str(preview)]
    subprocess.run(render, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    return preview


class _Recorder(event.Listener):  # type: ignore[misc]  # numba has no types
    """Numba event listener that records compile times, excluding those of nested kernels."""

    def __init__(self) -> None:
        self.compiled: list[Compiled] = []
        self._under_way: list[tuple[str, float]] = []
        """Callers of the kernel being compiled, and when each began, put later by what was compiled within."""

    def on_start(self, started: event.Event) -> None:
        self._under_way.append((_name(started), time.process_time()))

    def on_end(self, ended: event.Event) -> None:
        now = time.process_time()
        _, began = self._under_way.pop()
        module, _, kernel = _name(ended).partition(":")
        callers = [name for name, _ in self._under_way if name.startswith(OURS)]
        arguments = str(ended.data["args"])
        self.compiled.append(Compiled(module, kernel, arguments, now - began, callers[-1] if callers else ""))
        self._under_way = [(name, start + now - began) for name, start in self._under_way]


def _name(seen: event.Event) -> str:
    function = seen.data["dispatcher"].py_func
    return f"{function.__module__}:{function.__qualname__}"


def _record(file: Path, command: list[str]) -> None:
    """In the child process: run the command and write the list of compiled kernels."""
    recorder = _Recorder()
    event.register("numba:compile", recorder)
    from simulator.cli import main as boresight

    sys.argv = ["boresight", *command]
    try:
        boresight()
    except SystemExit as end:
        if end.code:
            raise
    finally:
        file.write_text(json.dumps([asdict(kernel) for kernel in recorder.compiled]))


def _print(what: str, found: ColdStart, least_s: float, signatures: bool) -> None:
    compiled_s = sum(kernel.cpu_s for kernel in found.compiled)
    ours = {(kernel.module, kernel.kernel) for kernel in found.compiled if kernel.ours}
    of_ours = sum(kernel.ours for kernel in found.compiled)
    print(
        f"boresight {what}, from an empty cache: {found.cpu_s:.1f} CPU-s (target {TARGET_CPU_S[what]:.0f}), "
        f"{found.wall_s:.1f} s; then {found.warm_cpu_s:.1f} CPU-s, {found.warm_wall_s:.1f} s.\n"
        f"Compiling: {compiled_s:.1f} CPU-s; {len(ours)} kernels of {of_ours} signatures, "
        f"{len(found.compiled) - of_ours} functions of libraries.\n"
    )
    tables = [_table("room", found.compiled, lambda kernel: kernel.room, 0.0)]
    tables += [_table("module", found.compiled, lambda kernel: kernel.module, least_s)]
    within: dict[str, float] = defaultdict(float)
    for kernel in found.compiled:
        if not kernel.ours:
            within[kernel.caller] += kernel.cpu_s
    tables += [_table("kernel", found.compiled, _kernel, least_s, within)]
    if signatures:
        tables += [_table("signature", found.compiled, lambda kernel: f"{_kernel(kernel)}{kernel.arguments}", least_s)]
    show(tables)


def _kernel(kernel: Compiled) -> str:
    return f"{kernel.module}:{kernel.kernel}"


def _table(
    title: str,
    compiled: Iterable[Compiled],
    key: Callable[[Compiled], str],
    least_s: float,
    within: dict[str, float] | None = None,
) -> Table:
    """CPU seconds and counts, the most expensive first."""
    seconds: dict[str, float] = defaultdict(float)
    counts: dict[str, int] = defaultdict(int)
    for kernel in compiled:
        seconds[key(kernel)] += kernel.cpu_s
        counts[key(kernel)] += 1
    within = within or {}
    order = sorted(seconds, key=lambda name: -seconds[name] - within.get(name, 0.0))
    rows = [
        [name, str(counts[name]), f"{seconds[name]:.2f}", *([f"{within.get(name, 0.0):.2f}"] if within else [])]
        for name in order
        if seconds[name] + within.get(name, 0.0) >= least_s
    ]
    return title, [title, "compiled", "CPU s", *(["of libraries, within"] if within else [])], rows


if __name__ == "__main__":
    main()
