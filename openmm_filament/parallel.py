"""Independent tasks on worker processes, the results in order, Ctrl-C keeping those that are done."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack, suppress
from multiprocessing.process import BaseProcess
from typing import TypeVar

from openmm_filament.executors import check_executor, main_hidden, worker_options

__all__ = ["PATIENCE", "run_all"]

T = TypeVar("T")
R = TypeVar("R")

PATIENCE = 5.0
"""Seconds that tasks under way are given at Ctrl-C."""


def run_all(
    function: Callable[[T], R],
    tasks: Sequence[T],
    workers: int,
    progress: Callable[[float], None] | None,
    *,
    executor: Executor | None = None,
    costs: Sequence[float] | None = None,
) -> list[R | None]:
    """The result of `function`, an importable one, of each task; None where Ctrl-C came first.

    Tasks that are under way at Ctrl-C have PATIENCE seconds to end, or until it is pressed again. `progress` is called with
    the fraction done as tasks end, by `costs` where these are given, else by number. With an `executor`, as
    `force_extension` takes it, the tasks run there and not in `workers` processes; it is left open. Raises what a task raises.
    """
    weights = [1.0] * len(tasks) if costs is None else list(costs)
    if executor is not None:
        check_executor(executor)
    pending: dict[Future[R], int] = {}
    others = multiprocessing.active_children()
    results: list[R | None] = [None] * len(tasks)
    with ExitStack() as opened:
        pool: Executor = executor or opened.enter_context(
            ProcessPoolExecutor(min(workers, len(tasks)), **worker_options())
        )
        try:
            with main_hidden():
                for i, task in enumerate(tasks):
                    pending[pool.submit(function, task)] = i
            while pending:
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    results[pending.pop(future)] = future.result()
                    if progress is not None:
                        progress(1 - sum(weights[i] for i in pending.values()) / sum(weights))
        except KeyboardInterrupt:
            _give_up(pool, pending, others if executor is None else None)
            for future, i in pending.items():
                if not future.cancelled() and future.done() and future.exception() is None:
                    results[i] = future.result()
        except BaseException:
            for future in pending:
                future.cancel()
            if executor is None:
                pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results


def _give_up(pool: Executor, pending: Iterable[Future[R]], others: list[BaseProcess] | None) -> None:
    """Cancel what has not begun; where the workers are ours, all children but `others`, end what takes too long."""
    for future in pending:
        future.cancel()
    if others is None:
        return
    with suppress(KeyboardInterrupt):
        wait([future for future in pending if not future.cancelled()], timeout=PATIENCE)
    for worker in multiprocessing.active_children():
        if worker not in others:
            worker.terminate()
    pool.shutdown(wait=True, cancel_futures=True)
