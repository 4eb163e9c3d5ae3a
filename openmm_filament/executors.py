"""Worker processes of this machine, and what is asked of an executor that a caller brings."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for
from types import ModuleType
from typing import Any

from openmm_filament import _checks as check

__all__ = ["available_workers", "main_hidden", "worker_options"]


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
