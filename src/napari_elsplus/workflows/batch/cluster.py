"""The workers of a batch: processes of this computer, forked from one that has imported everything, or a scheduler's.

A second worker shortens none of a batch's start and end. So the process that workers are forked from imports the
kernels while this one imports dask, and the dashboard is imported when one of its pages is first opened.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, Final

from napari_elsplus.errors import InputError
from napari_elsplus.io.formats.extras import extra_needed

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

SCHEDULER_TIMEOUT_S: Final = 10.0
"""Time for an existing scheduler to answer, seconds; chosen: a busy one answers within one."""
LOCAL: Final = "127.0.0.1"
WORKER_ENVIRONMENT: Final = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Environment of local workers. Dask's own also lowers malloc's trim threshold to 64 kB, by which the memory of every
image is returned to the system and mapped anew."""
WORKER_MODULE: Final = "napari_elsplus.workflows.batch.worker"
"""Imported by the process that local workers are forked from, or by each of them."""
FORKSERVER: Final = "forkserver"


@contextmanager
def batch_client(scheduler: str | None, workers: int | None) -> Iterator[Any]:
    """Yield a dask client of an existing scheduler, or of local workers, which end with the context.

    Parameters
    ----------
    scheduler : str, optional
        Address of an existing scheduler.
    workers : int, optional
        Number of local workers, a process of one thread each; one per core by default.

    Raises
    ------
    InputError
        If no scheduler answers, or dask is not installed.
    """
    if scheduler is None:
        with _environment(WORKER_ENVIRONMENT), _local_client(workers) as client:
            yield client
        return
    with extra_needed("batch", "batches"):
        from distributed import Client
    try:
        client = Client(scheduler, timeout=SCHEDULER_TIMEOUT_S)
    except (OSError, ValueError, TypeError) as error:  # no answer, or no address
        raise InputError(
            f"no scheduler answers at {scheduler} ({type(error).__name__})",
            "start one with `dask scheduler`, or leave --scheduler out",
        ) from None
    with client:
        yield client


@contextmanager
def _local_client(workers: int | None) -> Iterator[Any]:
    method = _started_method()
    with extra_needed("batch", "batches"):
        import dask
        from distributed import Client, LocalCluster
    settings = {
        "distributed.nanny.pre-spawn-environ": WORKER_ENVIRONMENT,
        "distributed.worker.multiprocessing-method": method,
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",  # of a check of each event loop; 20 ms take 4 % of a core
    }
    local = {"host": LOCAL, "dashboard_address": f"{LOCAL}:0", "threads_per_worker": 1, "preload": [WORKER_MODULE]}
    with dask.config.set(settings), ExitStack() as running:
        with _interrupted_later():
            cluster = running.enter_context(
                LocalCluster(n_workers=workers, silence_logs="CRITICAL", scheduler_kwargs={"dashboard": False}, **local)
            )
            client = running.enter_context(Client(cluster))
        _connect_dashboard(cluster.scheduler)
        yield client


def _connect_dashboard(scheduler: Any) -> None:
    from napari_elsplus.workflows.batch.dashboard import DashboardOnDemand

    scheduler.http_application.add_application(DashboardOnDemand(scheduler))


def _started_method() -> str:
    """Return the method by which workers are started; the process that they are forked from begins to import."""
    if FORKSERVER not in multiprocessing.get_all_start_methods():
        return "spawn"
    from multiprocessing.forkserver import ensure_running, set_forkserver_preload

    set_forkserver_preload(["distributed", WORKER_MODULE])
    with _on_interrupt(signal.SIG_IGN):  # inherited by that process and its forks, which this one ends
        ensure_running()
    return FORKSERVER


@contextmanager
def _interrupted_later() -> Iterator[None]:
    """Keep Ctrl-C back until the end of the context: a cluster that is interrupted while it starts cannot be closed."""
    interrupts: list[int] = []
    with _on_interrupt(lambda number, _: interrupts.append(number)):
        yield
    if interrupts:
        raise KeyboardInterrupt


@contextmanager
def _on_interrupt(handler: Any) -> Iterator[None]:
    """Handle Ctrl-C otherwise within the context, where it arrives in this thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Let the processes that are started within the context have these environment variables."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value
