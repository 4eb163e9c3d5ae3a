"""Tasks on worker processes or on an executor that a caller brings."""

from __future__ import annotations

import math
import multiprocessing
import signal
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pytest

from openmm_filament import parallel
from openmm_filament.executors import worker_options
from openmm_filament.parallel import run_all


def test_results_come_in_order_and_progress_counts_costs() -> None:
    seen: list[float] = []
    assert run_all(math.sqrt, [4.0, 9.0, 16.0], 1, seen.append, costs=[1.0, 1.0, 6.0]) == [2.0, 3.0, 4.0]
    assert seen[-1] == 1.0
    assert seen == sorted(seen)
    assert {round(8 * fraction, 9) % 1 for fraction in seen} == {0.0}


def test_an_executor_of_the_caller_does_the_work_and_is_left_open() -> None:
    with ProcessPoolExecutor(1, **worker_options()) as pool:
        assert run_all(math.sqrt, [4.0, 9.0], 1, None, executor=pool) == [2.0, 3.0]
        assert pool.submit(math.sqrt, 25.0).result() == 5.0


def test_what_a_task_raises_is_raised_and_the_executor_stays_open() -> None:
    with ProcessPoolExecutor(1, **worker_options()) as pool:
        with pytest.raises(ValueError, match="math domain error"):
            run_all(math.sqrt, [4.0, -1.0, 9.0], 1, None, executor=pool)
        assert pool.submit(math.sqrt, 25.0).result() == 5.0


def test_threads_are_refused() -> None:
    with ThreadPoolExecutor(1) as pool, pytest.raises(ValueError, match="must run in other processes"):
        run_all(math.sqrt, [4.0], 1, None, executor=pool)


def asleep(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def test_ctrl_c_ends_what_takes_too_long_and_keeps_what_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(fraction: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(parallel, "PATIENCE", 1.0)
    begun = time.monotonic()
    assert run_all(asleep, [0.0, 0.3, 600.0, 600.0], 1, stop) == [0.0, 0.3, None, None]
    assert time.monotonic() - begun < 60
    assert not multiprocessing.active_children()


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="needs POSIX signals")
def test_a_second_ctrl_c_ends_the_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(fraction: float) -> None:
        threading.Timer(0.5, signal.pthread_kill, (threading.main_thread().ident, signal.SIGINT)).start()
        raise KeyboardInterrupt

    monkeypatch.setattr(parallel, "PATIENCE", 60.0)
    begun = time.monotonic()
    assert run_all(asleep, [0.0, 600.0], 1, stop) == [0.0, None]
    assert time.monotonic() - begun < 30
    assert not multiprocessing.active_children()
