"""Independent tasks on worker processes, the results in order, Ctrl-C keeping those that are done."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from typing import TypeVar

from openmm_filament.executors import main_hidden, worker_options

__all__ = ["run_all"]

T = TypeVar("T")
R = TypeVar("R")


def run_all(
    function: Callable[[T], R], tasks: Sequence[T], workers: int, progress: Callable[[float], None] | None
) -> list[R | None]:
    """The result of `function`, an importable one, of each task; None where Ctrl-C came first.

    Tasks that are under way at Ctrl-C run to their end. `progress` is called with the fraction done as tasks end.
    Raises what a task raises.
    """
    pending: dict[Future[R], int] = {}
    results: list[R | None] = [None] * len(tasks)
    with ProcessPoolExecutor(min(workers, len(tasks)), **worker_options()) as pool:
        try:
            with main_hidden():
                for i, task in enumerate(tasks):
                    pending[pool.submit(function, task)] = i
            while pending:
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    results[pending.pop(future)] = future.result()
                    if progress is not None:
                        progress(1 - len(pending) / len(tasks))
        except KeyboardInterrupt:
            pool.shutdown(wait=True, cancel_futures=True)
            for future, i in pending.items():
                if not future.cancelled() and future.done() and future.exception() is None:
                    results[i] = future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results
