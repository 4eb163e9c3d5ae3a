"""Force-extension curves by Langevin dynamics, to a wanted error, on every core.

At each force a few independent groups of replicas run from equilibrium starts, in rounds: after a round the error is
estimated from all chains together, corrected for autocorrelation, and the next round is as long as the error asks.
Groups, rounds and seeds do not depend on the number of processes or on timing: a seed gives the same numbers anywhere.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import contact, units
from openmm_filament.blocks import BlockResult, run_block
from openmm_filament.checkpoints import Checkpoint
from openmm_filament.curves import dataset
from openmm_filament.discretisation import PN
from openmm_filament.divergence import DivergedError
from openmm_filament.executors import available_workers, check_executor, deaths, main_hidden, worker_options
from openmm_filament.filament import Filament
from openmm_filament.fingerprints import fingerprint
from openmm_filament.integrators import drawn_seed
from openmm_filament.keeping import intact, keep, restored, tell_of
from openmm_filament.planning import GROUPS, REPLICAS, Plan, plan_curve
from openmm_filament.platforms import GPUS
from openmm_filament.points import FIRST_ROUND
from openmm_filament.points import Point as _Point
from openmm_filament.points import Run as _Run
from openmm_filament.progress import Meter, Progress
from openmm_filament.rods import WormlikeChain
from openmm_filament.trajectory import TrajectoryWriter
from openmm_filament.wide import sample_wide, wide_points

if TYPE_CHECKING:
    import xarray

__all__ = ["Progress", "force_extension"]

Array = NDArray[np.float64]

_Pending = dict[Future[BlockResult], tuple[_Point, _Run]]

_BLOCK_BEAD_STEPS = 2e7
"""Beads times steps of one block, two to four seconds."""


def force_extension(
    chain: WormlikeChain | Filament,
    forces: unit.Quantity,
    temperature: unit.Quantity,
    relative_error: float | Sequence[float] | Array = 0.01,
    *,
    seed: int = 1,
    dimension: int = 3,
    timestep: unit.Quantity | None = None,
    processes: int | None = None,
    executor: Executor | None = None,
    platform: str = "Reference",
    trajectories: Mapping[int, str | os.PathLike[str]] | None = None,
    overwrite: bool = False,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> xarray.Dataset:
    """The mean extension of a thermal chain against the force that pulls it, sampled by Langevin dynamics.

    Bead 0 is held and the last bead pulled by a constant force; the extension is the end-to-end vector along it.

    Parameters
    ----------
    chain : WormlikeChain or Filament
        A `Filament` is sampled exactly as it is. A `WormlikeChain` is cut into segments for each force: as few, with
        bonds as soft, as the wanted error against the continuous chain allows.
    forces : Quantity
        Positive, one number or (M,), none of them twice.
    temperature : Quantity
    relative_error : float or sequence of float
        In (0, 1), for all forces or one each. It bounds `|bias| + |time_step_bias| + 2 standard errors` of the extension,
        relative to it, and for a `Filament` 2 standard errors.
    seed : int
        Of starts and noise. On Reference the same seed gives the same numbers whatever the number of processes.
    dimension : int
        3, or 2 for chains confined to a plane (a `Filament` alone).
    timestep : Quantity, optional
        By default, for each force of a `WormlikeChain`, what is cheapest with its error counted, and for a `Filament` that of
        `langevin`.
    processes : int, optional
        Worker processes; by default one for each core that this process may use.
    executor : concurrent.futures.Executor, optional
        Runs the blocks instead, on this machine or others: of any kind whose workers are processes of one thread each,
        such as `dask.distributed.Client.get_executor()` or `mpi4py.futures.MPIPoolExecutor()`. It is left open.
    platform : str
        Reference, by default: for chains of this size one process a core beats every platform's own threads. On CUDA,
        HIP and OpenCL the whole curve is one Context: all replicas of all forces in one System, each chain with its own
        time step and friction, and more replicas where more steps are needed. Neither `processes` nor `executor` go
        with it.
    trajectories : mapping of int to path, optional
        Indices into `forces`, and the DCD to write the samples of the first replica to, with its PDB and sidecar.
    overwrite : bool
        Whether trajectories that exist may be replaced.
    checkpoint : path, optional
        A file that keeps every block as it ends, a few seconds of one core. Where it exists, the call goes on from it,
        and ends with the numbers and trajectories that it would have had without an interruption, on Reference bit for
        bit. The file stays; a call that finds it finished returns at once.
    progress : callable, optional
        Called with a `Progress` as the chains are chosen for a WormlikeChain, and as blocks end.

    Returns
    -------
    xarray.Dataset
        Over the coordinate `force` (pN): `extension`, `extension_error` (one standard error, from sampling), both nm;
        `bias` (nm, exact discrete minus exact continuous chain; NaN for a `Filament`), the sum of `discretisation_bias`
        (of so many segments) and `stretch_bias` (of bonds softer than the chain's own); `time_step_bias` (nm, estimated:
        see `time_step_bias` in `openmm_filament.discretisation`; NaN with torsion, bent joints or in the plane, where it
        was not measured); `effective_samples`; `r_hat`; the chain that was
        run (`segments`, `bond_length`, `bending`, `stretching`) and its `exact_discrete` extension, NaN where they are
        not one number or no exact answer is known; `time_step` (ps), `friction` (1/ps), `steps` (of each of the
        chains); `finished`; `diverged`, where a run was given up and the estimate is NaN. Units stand in the
        attributes of each variable; versions, platform and seed in those of the dataset. After Ctrl-C it holds what was
        done until then, and its attribute `interrupted` is 1.

    Raises
    ------
    ValueError, TypeError
        For arguments that are wrong, before anything runs: among them the checkpoint of a call with other arguments, and
        an executor of threads.
    OSError
        If the checkpoint or a trajectory cannot be written. What the checkpoint holds stays intact.
    BrokenExecutor
        If a worker process is killed, and the executor does not start its block again as Dask does.
    DivergedError
        If at every force a coordinate is not finite, or a run far hotter than its thermostat.

    Warns
    -----
    UserWarning
        For each force whose run has diverged while others went on, and for forces at which chains stay in shapes of
        their own, by R-hat and by the scatter of their means over the error that each chain claims.
    """
    values = check.positive("forces", np.atleast_1d(units.numbers("forces", forces, "force")) / PN, unit="pN")
    check.shape("forces", values, (None,))
    if not len(values):
        raise ValueError("Argument `forces` must hold at least one force, but is empty.")
    check.distinct("forces", values, unit="pN")
    kelvin = check.positive("temperature", units.number("temperature", temperature, "temperature")).item()
    wanted = check.within("relative_error", relative_error, 0, 1, open_ends=True)
    if wanted.ndim:
        check.shape("relative_error", wanted, (len(values),))
    wanted = np.broadcast_to(wanted, values.shape)
    check.integer("seed", seed, low=0)
    check.one_of("dimension", dimension, (2, 3))
    names = [mm.Platform.getPlatform(i).getName() for i in range(mm.Platform.getNumPlatforms())]
    check.one_of("platform", platform, names)
    _check_workers(platform, executor, processes)
    workers = available_workers(processes)
    if trajectories is not None and not isinstance(trajectories, Mapping):
        raise TypeError(
            f"Argument `trajectories` must map the number of a force to a path, such as {{0: 'a.dcd'}}, but is {trajectories!r}."
        )
    paths = {check.integer("trajectories", i, low=0, high=len(values) - 1): p for i, p in (trajectories or {}).items()}
    if len({os.path.abspath(path) for path in paths.values()}) < len(paths):
        raise ValueError(
            f"Argument `trajectories` must name a file for each force, but names one twice: {trajectories}."
        )

    if executor is not None:
        check_executor(executor)
    meter = Meter(values.tolist(), progress)
    plans = plan_curve(chain, values, kelvin, wanted, dimension, timestep, meter.chosen)
    if platform in GPUS:
        contact.refuse("chain", plans[0].choice.filament.interactions(), f"on {platform}")
    files = tuple(os.path.abspath(path) for path in paths.values())
    with ExitStack() as opened:
        store = None
        if checkpoint is not None:
            others = {"seed": seed, "dimension": dimension, "platform": platform}
            arguments = fingerprint(chain, plans, kelvin, timestep, paths, **others)
            store = opened.enter_context(closing(Checkpoint(checkpoint, arguments, files)))
        old = store.files if store is not None else ()
        wide = platform in GPUS
        points = (wide_points if wide else _points)(plans, kelvin, dimension, seed, platform)
        for i, path in paths.items():
            writer = TrajectoryWriter(plans[i].model, path, overwrite=overwrite or os.path.abspath(path) in old)
            points[i].writer = opened.enter_context(closing(writer))
            points[i].runs[0].block = replace(points[i].runs[0].block, keep_frames=True)
        interrupted = (
            sample_wide(points, seed, store, meter) if wide else _sample(points, executor or workers, store, meter)
        )
    failures = [(point.force, point.failure) for point in points if point.failure is not None]
    if len(failures) == len(points):
        raise failures[0][1]
    for force, error in failures:
        warnings.warn(f"The run at {force:.6g} pN is given up: {error}", stacklevel=2)
    if not interrupted and (apart := [point for point in points if point.finished and point.is_apart]):
        tell_of(apart, "the estimate and its error rest on where they began")
    return dataset(
        points,
        kelvin=kelvin,
        dimension=dimension,
        attributes={
            "seed": seed,
            "chains": [p.runs[0].block.replicas for p in points] if wide else GROUPS * REPLICAS,
            "platform": platform,
            "interrupted": int(interrupted),
        },
    )


def _check_workers(platform: str, executor: Executor | None, processes: int | None) -> None:
    if platform in GPUS and (executor is not None or processes is not None):
        raise ValueError(
            f"Arguments `executor` and `processes` must be left out on {platform}, where the whole curve is one Context."
        )
    if executor is not None and processes is not None:
        raise ValueError(
            "Argument `processes` must be left out where there is an `executor`, which has its own workers."
        )


def _points(plans: Sequence[Plan], kelvin: float, dimension: int, seed: int, platform: str) -> list[_Point]:
    points = []
    for plan, seeds in zip(plans, np.random.SeedSequence(seed).spawn(len(plans)), strict=True):
        numbers = [drawn_seed(child) for child in seeds.spawn(GROUPS)]
        runs = [_Run(plan.block(number, kelvin, dimension, platform), FIRST_ROUND) for number in numbers]
        points.append(_Point(plan.force, plan.relative_error, plan.choice, runs))
    return points


def _sample(points: Sequence[_Point], workers: Executor | int, store: Checkpoint | None, meter: Meter) -> bool:
    """Run all points to their errors, from where the checkpoint has them; whether it was interrupted."""
    due, last = restored(points, store)
    meter.begin(points, last)
    if not due:
        return False
    executor: AbstractContextManager[Executor] = (
        nullcontext(workers) if isinstance(workers, Executor) else ProcessPoolExecutor(workers, **worker_options())
    )
    with executor as pool:

        def submit(run: _Run) -> Future[BlockResult]:
            with nullcontext() if pool is workers else main_hidden():
                return pool.submit(run_block, run.next_block(_BLOCK_BEAD_STEPS))

        pending: _Pending = {}
        try:
            for point, run in due:
                pending[submit(run)] = point, run
            while pending:
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    if future in pending:  # not of a point given up while these results were gone through
                        point, run = pending.pop(future)
                        pending |= {submit(again): (point, again) for again in _end(points, point, run, future, store)}
                        _forget_failed(pending)
                        meter.show(points, point)
        except KeyboardInterrupt:
            wait([future for future in pending if not future.cancel()])
            _harvest(points, pending, store)
            return True
        except deaths() as error:
            raise BrokenExecutor(
                f"The run has stopped: a worker process has ended, killed or out of memory, with its block.{intact(store)}"
            ) from error
        finally:
            for future in pending:
                future.cancel()
    return False


def _end(
    points: Sequence[_Point], point: _Point, run: _Run, future: Future[BlockResult], store: Checkpoint | None
) -> list[_Run]:
    """Take the block that has ended; the runs that need another one now."""
    if isinstance(error := future.exception(), DivergedError):
        point.fail(error)
        return []
    keep(points, point, run, future.result(), store)
    due = point.due_after(run)
    if point.is_stuck:
        tell_of([point], "the error falls only as fast as they change them, which may take very long")
    return due


def _forget_failed(pending: _Pending) -> None:
    """Drop the blocks of points given up; one that a worker is at already runs to its end unheard."""
    for future in [future for future, (point, _) in pending.items() if point.failure is not None]:
        future.cancel()
        del pending[future]


def _harvest(
    points: Sequence[_Point],
    pending: _Pending,
    store: Checkpoint | None,
) -> None:
    """Take what the workers had still finished, and estimate from what there is."""
    for future, (point, run) in pending.items():
        if not future.done() or future.cancelled() or point.failure is not None:
            continue
        if isinstance(error := future.exception(), DivergedError):
            point.fail(error)
        elif error is None:
            keep(points, point, run, future.result(), store)
    for point in points:
        point.stop()
