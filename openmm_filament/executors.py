"""Worker processes of this machine, and what is asked of an executor that a caller brings."""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import sys
import threading
import warnings
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for
from types import ModuleType
from typing import Any

import openmm as mm

from openmm_filament import _checks as check

__all__ = ["available_workers", "check_executor", "deaths", "main_hidden", "worker_options"]


def available_workers(processes: int | None) -> int:
    """How many worker processes to start: so many as asked, one for each core that this process may use at most."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if processes is None:
        return available
    asked = check.integer("processes", processes, low=1)
    if asked > available:
        warnings.warn(
            f"Argument `processes` is {asked}, but this process may use {available} cores: running {available}.",
            stacklevel=3,
        )
    return min(asked, available)


def check_executor(executor: Any) -> None:
    """Refuse what cannot run blocks in processes of their own, by asking one of its workers.

    OpenMM's Reference platform has one random stream a process: two blocks at once would take each other's numbers. A
    worker may run a block in any one of its threads, as long as that thread is alone.

    Raises
    ------
    TypeError
        If it is no `concurrent.futures.Executor`.
    ValueError
        If it runs blocks in this process, or several of them in one, or has another version of OpenMM or this package.
    """
    if not isinstance(executor, Executor):
        hint = ": pass client.get_executor()" if hasattr(executor, "get_executor") else ""
        raise TypeError(f"Argument `executor` must be a concurrent.futures.Executor, but is {executor!r}{hint}.")
    try:
        place, threads, *versions = executor.submit(_where).result()
    except RuntimeError as error:
        raise ValueError(f"Argument `executor` must take tasks, but does not: {error}.") from error
    reason = "OpenMM's Reference platform has one random stream a process"
    if place == _where()[0]:
        raise ValueError(
            f"Argument `executor` must run in other processes, but {type(executor).__name__} runs in this one: {reason}."
        )
    if threads > 1:
        raise ValueError(
            f"Argument `executor` must have workers of one thread each, but has one of {threads} threads: {reason}. Start "
            "Dask workers with --nthreads 1."
        )
    for name, here, there in zip(("OpenMM", "openmm_filament"), _versions(), versions, strict=True):
        if here != there:
            raise ValueError(f"Argument `executor` must have {name} {here} as this process has, but has {there}.")


def _where() -> tuple[tuple[str, int], int, str, str]:
    """The process, how many tasks it may be given at once as far as it knows, and its versions."""
    threads = 1
    if (dask := sys.modules.get("distributed")) is not None:
        try:
            threads = dask.get_worker().state.nthreads
        except ValueError:  # a process that only talks to Dask
            threads = 1
    return (socket.gethostname(), os.getpid()), threads, *_versions()


def _versions() -> tuple[str, str]:
    from openmm_filament import __version__

    return mm.Platform.getOpenMMVersion(), __version__


def deaths() -> tuple[type[BaseException], ...]:
    """What futures raise when workers have died with their blocks."""
    dask = sys.modules.get("distributed")
    return (BrokenExecutor, CancelledError) if dask is None else (BrokenExecutor, CancelledError, dask.KilledWorker)


def worker_options() -> dict[str, Any]:
    """Arguments for a ProcessPoolExecutor whose workers leave Ctrl-C to the parent and do not outlive it."""
    return {"mp_context": multiprocessing.get_context("spawn"), "initializer": _begin_worker}


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent process, and do not outlive it, whatever ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        wait_for([parent.sentinel])
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


@contextmanager
def main_hidden() -> Iterator[None]:
    """While worker processes start: they do not import the caller's script, which may lack a __main__ guard, and inherit
    a mask that leaves Ctrl-C to the parent.
    """
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if hasattr(signal, "pthread_sigmask") else None
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        if blocked is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
