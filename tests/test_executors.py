"""Curves on executors that a caller brings: the same numbers, workers that die, and executors that cannot do it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Executor, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_resume import PN, ROOT, WARM, InProcess, filament, same, sampled

import openmm_filament as of
from openmm_filament import executors, sampling
from openmm_filament.blocks import run_block
from openmm_filament.executors import check_executor
from openmm_filament.progress import Progress

distributed = pytest.importorskip("distributed")

SMALL_BLOCKS = 2e5


@pytest.fixture(autouse=True)
def short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "_BLOCK_BEAD_STEPS", SMALL_BLOCKS)


def curve_here(folder: Path, **options: Any) -> Any:
    """Without any worker process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampling, "ProcessPoolExecutor", InProcess)
        return sampled(folder, "here", checkpoint=None, trajectories=None, **options)


def curve_by(executor: Executor, folder: Path, **options: Any) -> Any:
    return sampled(folder, **{"checkpoint": None, "trajectories": None, **options}, executor=executor, processes=None)


# A Dask cluster -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a scheduler in a process of its own, on loopback."""
    file = tmp_path_factory.mktemp("dask") / "scheduler.json"
    command = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-show"]
    run = subprocess.Popen(
        [sys.executable, "-m", *command, "--scheduler-file", str(file)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 60
    while not file.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    import json

    time.sleep(0.2)
    yield json.loads(file.read_text())["address"]
    run.terminate()
    run.wait(20)


def worker(address: str, threads: int = 1) -> subprocess.Popen[bytes]:
    command = ["distributed.cli.dask_worker", address, "--nthreads", str(threads), "--no-nanny", "--no-dashboard"]
    return subprocess.Popen(
        [sys.executable, "-m", *command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=ROOT
    )


@pytest.fixture
def workers(scheduler: str) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Two workers of one thread each."""
    runs = [worker(scheduler) for _ in range(2)]
    yield runs
    for run in runs:
        run.kill()
        run.wait()


@pytest.fixture
def client(scheduler: str) -> Iterator[Any]:
    with distributed.Client(scheduler) as client:
        yield client


def test_two_workers_of_a_cluster_give_the_numbers_of_one_process_though_one_is_killed(
    workers: list[subprocess.Popen[bytes]], client: Any, tmp_path: Path
) -> None:
    client.wait_for_workers(2, timeout=60)
    here = curve_here(tmp_path, relative_error=0.03)
    same(curve_by(client.get_executor(), tmp_path, relative_error=0.03), here)

    pids = client.run(os.getpid)
    assert len(set(pids.values())) == 2
    seen: list[Progress] = []

    def progress(report: Progress) -> None:
        seen.append(report)
        if len(seen) == 12:
            workers[0].send_signal(signal.SIGKILL)
            workers[0].wait()

    kept = {"checkpoint": tmp_path / "kept.checkpoint", "trajectories": {0: tmp_path / "kept.dcd"}}
    curve = curve_by(client.get_executor(), tmp_path, relative_error=0.03, progress=progress, **kept)
    assert len(seen) > 14
    assert len(client.run(os.getpid)) == 1
    same(curve, here)


def test_a_worker_of_two_threads_is_refused(scheduler: str, client: Any, tmp_path: Path) -> None:
    run = worker(scheduler, threads=2)
    try:
        client.wait_for_workers(1, timeout=60)
        with pytest.raises(ValueError, match=r"workers of one thread each, but has one of 2 threads: .* random stream"):
            curve_by(client.get_executor(), tmp_path)
        with pytest.raises(
            TypeError, match=r"must be a concurrent\.futures\.Executor, .* pass client\.get_executor\(\)"
        ):
            curve_by(client, tmp_path)
    finally:
        run.kill()
        run.wait()


# Process pools --------------------------------------------------------------------------------------------------------


@pytest.fixture
def pool() -> Iterator[ProcessPoolExecutor]:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as executor:
        yield executor


def test_a_pool_gives_the_same_numbers_and_stays_open(pool: ProcessPoolExecutor, tmp_path: Path) -> None:
    here = curve_here(tmp_path)
    same(curve_by(pool, tmp_path), here)

    def interrupt(_: Progress) -> None:
        raise KeyboardInterrupt

    assert curve_by(pool, tmp_path, progress=interrupt).attrs["interrupted"] == 1
    assert pool.submit(abs, -1).result() == 1


def test_a_killed_worker_of_a_pool_is_told_of_and_loses_nothing(pool: ProcessPoolExecutor, tmp_path: Path) -> None:
    kept = tmp_path / "kept.checkpoint"
    victim = pool.submit(os.getpid).result()
    seen: list[Progress] = []

    def progress(report: Progress) -> None:
        seen.append(report)
        if len(seen) == 5:
            os.kill(victim, signal.SIGKILL)

    with pytest.raises(BrokenExecutor, match=r"a worker process has ended, .*kept\.checkpoint is intact"):
        curve_by(pool, tmp_path, checkpoint=kept, progress=progress)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampling, "ProcessPoolExecutor", InProcess)
        finished = sampled(tmp_path, checkpoint=kept, trajectories=None)
    same(finished, curve_here(tmp_path))


# Refused --------------------------------------------------------------------------------------------------------------


def test_threads_are_refused(tmp_path: Path) -> None:
    with (
        ThreadPoolExecutor(1) as threads,
        pytest.raises(
            ValueError, match=r"must run in other processes, but ThreadPoolExecutor runs in this one: OpenMM's"
        ),
    ):
        curve_by(threads, tmp_path)


def test_what_is_no_executor_is_refused_and_so_are_processes_beside_one(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"`executor` must be a concurrent\.futures\.Executor, but is 'cluster'"):
        of.force_extension(filament(6), 1 * PN, WARM, 0.1, executor="cluster")
    with pytest.raises(ValueError, match="`processes` must be left out where there is an `executor`"):
        of.force_extension(filament(6), 1 * PN, WARM, 0.1, executor=InProcess(), processes=1)


def test_workers_of_other_versions_are_refused(pool: ProcessPoolExecutor, monkeypatch: pytest.MonkeyPatch) -> None:
    check_executor(pool)
    monkeypatch.setattr(executors, "_versions", lambda: ("8.0", "0.0"))
    with pytest.raises(ValueError, match=r"`executor` must have OpenMM 8\.0 as this process has, but has \d"):
        check_executor(pool)


def test_two_blocks_at_once_in_one_process_are_refused() -> None:
    """Whatever executor brings them together."""
    from test_sampling import block

    alone = run_block(block())
    failures: list[BaseException] = []
    results = []

    def run() -> None:
        try:
            results.append(run_block(block(samples=3000)))
        except RuntimeError as error:
            failures.append(error)

    threads = [threading.Thread(target=run) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == len(failures) == 1
    assert "must be alone in its process" in str(failures[0])
    np.testing.assert_array_equal(results[0].extensions[:, :30], alone.extensions)
