"""Blocks of trials on a dask.distributed cluster; if a worker dies, only the time of its blocks is lost."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections.abc import Generator, Iterator
from typing import TYPE_CHECKING

from simulator.scenario import Scenario
from simulator.study.results_folder import refuse_other_files, scenario_sha256
from simulator.study.trials.blocks import Blocks, Result, run_block
from simulator.study.trials.trial import TrialRunner
from startracker._version import __version__
from startracker.errors import BoresightError, InputError

if TYPE_CHECKING:
    from distributed import Client, Future

CONNECT_S = 15.0
"""Seconds to wait for the scheduler and its first worker."""
LOOK_S = 5.0
"""Seconds between checks of the number of workers, which may change."""
STOP_CHECK_S = 0.2
"""Seconds between checks for a stop."""

_local = threading.local()


def run_on_cluster(
    scenario: Scenario, blocks: Blocks, address: str, stop: threading.Event
) -> Generator[Result, None, None]:
    """Finished blocks in order of completion, with two submitted per thread of the cluster.

    Dask reruns the blocks of a dead worker on another one. On a stop finished blocks are kept and others dropped.

    Parameters
    ----------
    scenario : Scenario
        Sent with every block; a worker builds common data once. Its files must have the same path on every machine.
    blocks : Blocks
        Remaining trials.
    address : str
        Address of the scheduler, such as ``tcp://10.0.0.1:8786``.
    stop : threading.Event
        Set to stop early.

    Raises
    ------
    InputError
        If dask is not installed, no scheduler responds, there are no workers, or they run another version.
    BoresightError
        If workers die repeatedly with the same block, or the connection to the scheduler is lost.
    """
    with _connected(address) as client:
        from distributed import KilledWorker, wait
        from distributed.client import FutureCancelledError
        from distributed.comm import CommClosedError

        key, names = scenario_sha256(scenario), itertools.count()
        pending: dict[Future, range] = {}
        looked = -LOOK_S
        try:
            while (blocks or pending) and not stop.is_set():
                if time.monotonic() - looked > LOOK_S:
                    looked = time.monotonic()
                    blocks.workers = max(1, sum(client.nthreads().values()))
                while blocks and len(pending) < 2 * blocks.workers:
                    block = blocks.take()
                    task = f"boresight-{client.id}-{next(names)}"
                    future = client.submit(_run_block, scenario, key, __version__, block, key=task, pure=False)
                    pending[future] = block
                with contextlib.suppress(TimeoutError), client.as_current():
                    wait(list(pending), timeout=STOP_CHECK_S, return_when="FIRST_COMPLETED")
                for future in [future for future in pending if future.done()]:
                    result = future.result()
                    blocks.finished(result)
                    del pending[future]
                    yield result
                if client.status != "running":
                    raise CommClosedError("no connection")
        except KilledWorker:
            raise BoresightError(
                f"--dask {address}: workers died repeatedly with the same trials (out of memory?); finished "
                "trials are kept: run again with --resume"
            ) from None
        except (CommClosedError, FutureCancelledError) as error:
            raise BoresightError(
                f"--dask {address}: the connection to the scheduler was lost ({error}); finished trials are kept: "
                "run again with --resume"
            ) from None
        finally:
            with contextlib.suppress(Exception):  # a lost cluster has nothing to cancel
                client.cancel(list(pending))


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--dask needs the package distributed; install it with: pip install 'boresight[dask]'"
        ) from None
    with contextlib.ExitStack() as stack:
        try:
            client = stack.enter_context(Client(address, timeout=CONNECT_S, set_as_default=False))
        except (OSError, TimeoutError, ValueError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"--dask {address}: no scheduler responds ({reason})") from None
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise InputError(
                f"--dask {address}: the scheduler has no workers; start one with: dask worker {address}"
            ) from None
        yield client


def _run_block(scenario: Scenario, key: str, version: str, block: range) -> Result:
    """On the worker: common data of a scenario is built once per thread; only the last one is kept."""
    if version != __version__:
        raise InputError(f"--dask: a worker has boresight {__version__}, this is {version}; install the same on all")
    if getattr(_local, "key", None) != key:
        runner = TrialRunner(scenario)
        refuse_other_files(scenario, key)
        _local.runner, _local.key = runner, key
    return run_block(_local.runner.run, block)
