"""Force-extension curves by Langevin dynamics, to a wanted error, on every core.

At each force a few independent groups of replicas run from equilibrium starts, in rounds: after a round the error is
estimated from all chains together, corrected for autocorrelation, and the next round is as long as the error asks.
Groups, rounds and seeds do not depend on the number of processes or on timing: a seed gives the same numbers anywhere.
"""

from __future__ import annotations

import math
import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.blocks import BlockResult, run_block
from openmm_filament.curves import dataset
from openmm_filament.discretisation import PN
from openmm_filament.divergence import DivergedError
from openmm_filament.executors import available_workers, main_hidden, worker_options
from openmm_filament.filament import Filament
from openmm_filament.planning import GROUPS, REPLICAS, Plan, plan_curve
from openmm_filament.points import FIRST_ROUND
from openmm_filament.points import Point as _Point
from openmm_filament.points import Run as _Run
from openmm_filament.rods import WormlikeChain
from openmm_filament.trajectory import TrajectoryWriter

if TYPE_CHECKING:
    import xarray

__all__ = ["Progress", "force_extension"]

Array = NDArray[np.float64]

_BLOCK_BEAD_STEPS = 2e7
"""Beads times steps of one block, two to four seconds."""


@dataclass(frozen=True)
class Progress:
    """The state of a running curve, as passed to `progress`.

    Attributes
    ----------
    fraction : float
        Of the work now expected, done.
    seconds_left : float
        Expected, at the pace so far; NaN before the first block.
    force : float
        The force, in pN, at which the last block ended.
    extension, error : float
        The estimate there and its standard error in nm; NaN before its first round.
    finished : int
        Forces whose error has been reached.
    """

    fraction: float
    seconds_left: float
    force: float
    extension: float
    error: float
    finished: int


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
    platform: str = "Reference",
    trajectories: Mapping[int, str | os.PathLike[str]] | None = None,
    overwrite: bool = False,
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
        Positive, one number or (M,).
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
    platform : str
        Reference, by default: for chains of this size one process a core beats every platform's own threads.
    trajectories : mapping of int to path, optional
        Indices into `forces`, and the DCD to write the samples of the first replica to, with its PDB and sidecar.
    overwrite : bool
        Whether trajectories that exist may be replaced.
    progress : callable, optional
        Called with a `Progress` as blocks end.

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
        For arguments that are wrong, before anything runs.
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
    kelvin = check.positive("temperature", units.number("temperature", temperature, "temperature")).item()
    wanted = check.within("relative_error", relative_error, 0, 1, open_ends=True)
    if wanted.ndim:
        check.shape("relative_error", wanted, (len(values),))
    wanted = np.broadcast_to(wanted, values.shape)
    check.integer("seed", seed, low=0)
    check.one_of("dimension", dimension, (2, 3))
    names = [mm.Platform.getPlatform(i).getName() for i in range(mm.Platform.getNumPlatforms())]
    check.one_of("platform", platform, names)
    workers = available_workers(processes)
    paths = {check.integer("trajectories", i, low=0, high=len(values) - 1): p for i, p in (trajectories or {}).items()}
    if len({os.path.abspath(path) for path in paths.values()}) < len(paths):
        raise ValueError(
            f"Argument `trajectories` must name a file for each force, but names one twice: {trajectories}."
        )

    plans = plan_curve(chain, values, kelvin, wanted, dimension, timestep)
    points = _points(plans, kelvin, seed, dimension, platform, paths, overwrite)
    try:
        interrupted = _sample(points, workers, progress)
    finally:
        for point in points:
            if point.writer is not None:
                point.writer.close()
    failures = [(point.force, point.failure) for point in points if point.failure is not None]
    if len(failures) == len(points):
        raise failures[0][1]
    for force, error in failures:
        warnings.warn(f"The run at {force:.6g} pN is given up: {error}", stacklevel=2)
    if not interrupted and (apart := [point for point in points if point.finished and point.is_apart]):
        _tell_of(apart, "the estimate and its error rest on where they began")
    return dataset(
        points,
        kelvin=kelvin,
        dimension=dimension,
        attributes={
            "seed": seed,
            "chains": GROUPS * REPLICAS,
            "platform": platform,
            "interrupted": int(interrupted),
        },
    )


def _points(
    plans: Sequence[Plan],
    kelvin: float,
    seed: int,
    dimension: int,
    platform: str,
    paths: Mapping[int, str | os.PathLike[str]],
    overwrite: bool,
) -> list[_Point]:
    points = []
    for i, (plan, seeds) in enumerate(zip(plans, np.random.SeedSequence(seed).spawn(len(plans)), strict=True)):
        runs = []
        for group, child in enumerate(seeds.spawn(GROUPS)):
            number = int(child.generate_state(1)[0]) % (2**31 - 1) + 1
            block = plan.block(number, kelvin, dimension, platform, keep_frames=i in paths and group == 0)
            runs.append(_Run(block, FIRST_ROUND))
        writer = TrajectoryWriter(plan.model, paths[i], overwrite=overwrite) if i in paths else None
        points.append(_Point(plan.force, plan.relative_error, plan.choice, runs, writer))
    return points


def _tell_of(apart: Sequence[_Point], consequence: str) -> None:
    """Warn of forces whose chains stay in separate shapes."""
    named = ", ".join(f"{point.force:.6g} pN (R-hat {point.r_hat:.3f})" for point in apart)
    warnings.warn(f"Chains stay in shapes of their own at {named}: {consequence}.", stacklevel=3)
    for point in apart:
        point.told = True


def _sample(points: Sequence[_Point], workers: int, progress: Callable[[Progress], None] | None) -> bool:
    """Run all points to their errors; whether it was interrupted."""
    begun = time.perf_counter()
    pending: dict[Future[BlockResult], tuple[_Point, _Run]] = {}
    with ProcessPoolExecutor(workers, **worker_options()) as pool:

        def submit(point: _Point, run: _Run) -> None:
            with main_hidden():
                pending[pool.submit(run_block, run.next_block(_BLOCK_BEAD_STEPS))] = point, run

        try:
            for point in sorted(points, key=lambda p: -p.weight):
                for run in point.runs:
                    submit(point, run)
            while pending:
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    if future not in pending:  # of a point given up while these results were gone through
                        continue
                    point, run = pending.pop(future)
                    if isinstance(error := future.exception(), DivergedError):
                        point.fail(error)
                        _forget(point, pending)
                    else:
                        point.take(run, future.result())
                        for due in point.due_after(run):
                            submit(point, due)
                        if point.is_stuck:
                            _tell_of(
                                [point], "the error falls only as fast as they change them, which may take very long"
                            )
                    if progress is not None:
                        progress(_progress(points, point, time.perf_counter() - begun))
        except KeyboardInterrupt:
            pool.shutdown(wait=True, cancel_futures=True)
            _harvest(points, pending)
            return True
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return False


def _forget(point: _Point, pending: dict[Future[BlockResult], tuple[_Point, _Run]]) -> None:
    """Drop the blocks of a point; one that a worker is at already runs to its end unheard."""
    for future in [future for future, (other, _) in pending.items() if other is point]:
        future.cancel()
        del pending[future]


def _harvest(points: Sequence[_Point], pending: Mapping[Future[BlockResult], tuple[_Point, _Run]]) -> None:
    """Take what the workers had still finished, and estimate from what there is."""
    for future, (point, run) in pending.items():
        if not future.done() or future.cancelled() or point.failure is not None:
            continue
        if isinstance(error := future.exception(), DivergedError):
            point.fail(error)
        elif error is None:
            point.take(run, future.result())
    for point in points:
        point.stop()


def _progress(points: Sequence[_Point], point: _Point, elapsed: float) -> Progress:
    running = [p for p in points if p.failure is None]
    done = sum(p.weight * sum(run.done for run in p.runs) / len(p.runs) for p in running)
    expected = sum(p.weight * p.expected() for p in running)
    fraction = min(done / expected, 1.0) if running else 1.0
    left = elapsed * (1 - fraction) / fraction if fraction else math.nan
    return Progress(fraction, left, point.force, point.mean, point.error, sum(p.finished for p in points))
