"""Where the blocks of a sampled curve run: in worker processes of this machine, or on a Dask cluster."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from openmm_filament.executors import available_workers

__all__ = ["dask_executor"]


@contextmanager
def dask_executor(scheduler: str, processes: int | None) -> Iterator[Executor]:
    """The workers of the Dask scheduler at an address; for "local", so many processes started here, by default one a core.

    Raises ValueError where Dask is not installed or no scheduler answers.
    """
    try:
        from dask.distributed import Client, LocalCluster
    except ImportError:
        raise ValueError(
            "Argument `--scheduler` needs Dask, which is not installed: pip install 'openmm-filament[cluster]'."
        ) from None
    if scheduler == "local":
        workers = available_workers(processes)
        with (
            LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            yield client.get_executor()
        return
    try:
        client = Client(scheduler)
    except (OSError, ValueError) as error:
        raise ValueError(
            f"Argument `--scheduler` must be the address of a Dask scheduler, but {scheduler} does not answer: {error}."
        ) from error
    with client:
        if not client.scheduler_info()["workers"]:
            print(f"waiting for a worker of {scheduler}", file=sys.stderr)
        yield client.get_executor()
