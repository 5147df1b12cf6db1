"""Blocks of trials on a dask.distributed cluster; a worker that dies costs only the time of its blocks."""

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
"""Seconds between looks at how many workers there are: they may come and go."""
STOP_CHECK_S = 0.2
"""Seconds between looks at whether the run is to stop."""

_local = threading.local()


def run_on_cluster(
    scenario: Scenario, blocks: Blocks, address: str, stop: threading.Event
) -> Generator[Result, None, None]:
    """Finished blocks in the order in which they come, two under way for every thread of the cluster.

    dask itself runs the blocks of a worker that died on another one. A stop keeps what is finished and drops the rest.

    Parameters
    ----------
    scenario : Scenario
        Sent with every block; a worker builds what its trials share once. Files that it names must be at the same
        path on every machine.
    blocks : Blocks
        What is left to run.
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.
    stop : threading.Event
        Set to end early.

    Raises
    ------
    InputError
        When dask is not installed, nobody answers at the address, there are no workers, or they run another version.
    BoresightError
        When workers die with the same block again and again, or the scheduler is gone.
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
                f"--dask {address}: workers died again and again with the same trials (out of memory?); the finished "
                "trials are kept: run again with --resume"
            ) from None
        except (CommClosedError, FutureCancelledError) as error:
            raise BoresightError(
                f"--dask {address}: the scheduler is gone ({error}); the finished trials are kept: run again with "
                "--resume"
            ) from None
        finally:
            with contextlib.suppress(Exception):  # a cluster that is gone has nothing left to cancel
                client.cancel(list(pending))


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "--dask: needs the package distributed; install it with: pip install 'boresight[dask]'"
        ) from None
    with contextlib.ExitStack() as stack:
        try:
            client = stack.enter_context(Client(address, timeout=CONNECT_S, set_as_default=False))
        except (OSError, TimeoutError, ValueError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"--dask {address}: no scheduler answers there ({reason})") from None
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            raise InputError(
                f"--dask {address}: the scheduler has no workers; start one with: dask worker {address}"
            ) from None
        yield client


def _run_block(scenario: Scenario, key: str, version: str, block: range) -> Result:
    """On the worker: what the trials of a scenario share is built once a thread, and only the last one is kept."""
    if version != __version__:
        raise InputError(f"--dask: a worker has boresight {__version__}, this is {version}; install the same on all")
    if getattr(_local, "key", None) != key:
        runner = TrialRunner(scenario)
        refuse_other_files(scenario, key)
        _local.runner, _local.key = runner, key
    return run_block(_local.runner.run, block)
