"""Force-extension curves by Langevin dynamics, to a wanted error, on every core.

At each force a few independent groups of replicas run from equilibrium starts, in rounds: after a round the error is
estimated from all chains together, corrected for autocorrelation, and the next round is as long as the error asks.
Groups, rounds and seeds do not depend on the number of processes or on timing: a seed gives the same numbers anywhere.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import platform as host
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from multiprocessing.connection import wait as wait_for
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.blocks import Block, BlockResult, clamped_model, run_block
from openmm_filament.discretisation import FEWEST_SAMPLES, PN, ExactChain, choose, exact_chain
from openmm_filament.divergence import DivergedError
from openmm_filament.filament import Filament
from openmm_filament.integrators import FRICTION, thermal_step
from openmm_filament.rods import WormlikeChain
from openmm_filament.timestep import slow_frequency
from openmm_filament.trajectory import TrajectoryWriter

if TYPE_CHECKING:
    import xarray

__all__ = ["Progress", "force_extension"]

Array = NDArray[np.float64]

_GROUPS = 4
"""Independent runs a force, so that several processes can share one force."""

_REPLICAS = 2
"""Chains in the System of each run."""

_SAMPLE_TIME, _WARM_UP_TIME, _FIRST_ROUND = 0.2, 2.5, 20
"""Between samples, and before the first: times over 1/omega of the slowest mode; samples a chain in the first round."""

_GROWTH = 3.0
"""A round may make a run at most so many times longer: early estimates of the error are themselves uncertain."""

_MARGIN = 1.05
"""Samples taken over those that the estimated error asks for."""

_APART, _SCATTER, _LONG = 1.01, 6.0, 100
"""R-hat, and variance of the chains' means over the one that each chain's own error explains, from which chains are said to
stay in shapes of their own; samples a chain from which that is said while they run. R-hat alone will not do: on DNA it was
up to 1.17 where 20 to 100 samples a chain were enough, while the variance was at most 3.4 times the explained one in 120
points, and 4.5 in 50 of short chains (chi-squared of 7 degrees of freedom over 7 exceeds 6 once in two million)."""

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


@dataclass
class _Run:
    """One group of replicas at one force: its next block, and what it has sampled."""

    block: Block
    wanted: int
    extensions: list[Array] = field(default_factory=list)

    @property
    def done(self) -> int:
        return sum(part.shape[1] for part in self.extensions)

    def next_block(self) -> Block:
        most = max(1, int(_BLOCK_BEAD_STEPS / (self.block.replicas * len(self.block.filament) * self.block.stride)))
        return replace(self.block, samples=min(self.wanted - self.done, most))


@dataclass
class _Point:
    """One force of the curve."""

    force: float
    relative_error: float
    bias: float
    runs: list[_Run]
    writer: TrajectoryWriter | None = None
    frames: int = 0
    mean: float = math.nan
    error: float = math.nan
    samples: float = math.nan
    r_hat: float = math.nan
    finished: bool = False
    scatter: float = math.nan
    failure: DivergedError | None = None
    told: bool = False

    @property
    def is_apart(self) -> bool:
        """Whether chains stay in shapes of their own, so that the estimate rests on where they began."""
        return self.r_hat > _APART and self.scatter > _SCATTER

    def fail(self, error: DivergedError) -> None:
        """Give the point up, and its estimate, with the first error of its runs."""
        self.failure = self.failure or error
        self.mean = self.error = self.samples = self.r_hat = self.scatter = math.nan
        self.finished = False

    def due_after(self, run: _Run) -> list[_Run]:
        """The runs that need another block now that this one has ended a block."""
        if run.done < run.wanted:
            return [run]
        if any(run.done < run.wanted for run in self.runs):
            return []
        self.end_round()
        return [] if self.finished else self.runs

    @property
    def weight(self) -> float:
        """Beads times steps for one more sample of every run."""
        return sum(run.block.replicas * len(run.block.filament) * run.block.stride for run in self.runs)

    def end_round(self) -> None:
        """Estimate, and either finish or say how many samples the runs are to have after the next round."""
        have = min(run.done for run in self.runs)
        if have < 4:
            return
        self._estimate(have)
        target = (self.relative_error * abs(self.mean) - abs(self.bias * self.mean / (1 + self.bias))) / 2
        if self.error <= target and self.samples >= FEWEST_SAMPLES:
            self.finished = True
            return
        asked = have * max(_MARGIN * (self.error / max(target, 1e-300)) ** 2, FEWEST_SAMPLES / self.samples)
        wanted = math.ceil(min(max(asked, 1.2 * have), _GROWTH * have))
        for run in self.runs:
            run.wanted = wanted

    def stop(self) -> None:
        """Estimate from what there is, after an interruption: the runs that have come furthest."""
        if not self.finished and self.failure is None:
            self.runs = [run for run in self.runs if run.done >= _FIRST_ROUND] or self.runs
            if (have := min(run.done for run in self.runs)) >= _FIRST_ROUND:
                self._estimate(have)

    def _estimate(self, have: int) -> None:
        from arviz_stats.base import array_stats

        chains = np.concatenate([np.concatenate(run.extensions, axis=1)[:, :have] for run in self.runs])
        self.mean = float(chains.mean())
        self.samples = float(array_stats.ess(chains, chain_axis=0, draw_axis=1, method="mean"))
        self.error = float(array_stats.mcse(chains, chain_axis=0, draw_axis=1, method="mean"))
        self.r_hat = float(array_stats.rhat(chains, chain_axis=0, draw_axis=1))
        alone = [array_stats.mcse(chain[None], chain_axis=0, draw_axis=1, method="mean") for chain in chains]
        self.scatter = float(chains.mean(axis=1).var(ddof=1) / np.mean(np.square(alone)))

    def expected(self) -> int:
        """Samples a run that the point will have taken in all, as far as is known."""
        have = min(run.done for run in self.runs)
        if self.finished or math.isnan(self.error):
            return max(run.wanted for run in self.runs)
        target = (self.relative_error - abs(self.bias)) * abs(self.mean) / 2
        return max(self.runs[0].wanted, math.ceil(have * (self.error / max(target, 1e-300)) ** 2))


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
        In (0, 1), for all forces or one each. It bounds `|bias| + 2 standard errors` of the extension, relative to it.
    seed : int
        Of starts and noise. On Reference the same seed gives the same numbers whatever the number of processes.
    dimension : int
        3, or 2 for chains confined to a plane (a `Filament` alone).
    timestep : Quantity, optional
        By default that of `langevin` for each chain.
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
        Over the coordinate `force` (pN): `extension`, `extension_error` (one standard error), both nm; `bias` (nm, exact
        discrete minus exact continuous chain; NaN for a `Filament`); `effective_samples`; `r_hat`; the chain that was
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
    workers = _workers(processes)
    paths = {check.integer("trajectories", i, low=0, high=len(values) - 1): p for i, p in (trajectories or {}).items()}
    if len({os.path.abspath(path) for path in paths.values()}) < len(paths):
        raise ValueError(
            f"Argument `trajectories` must name a file for each force, but names one twice: {trajectories}."
        )

    points = _points(chain, values, kelvin, wanted, seed, dimension, platform, paths, overwrite, timestep)
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
    return _dataset(points, chain, kelvin, seed, dimension, platform, interrupted)


def _tell_of(apart: Sequence[_Point], consequence: str) -> None:
    """Warn of forces whose chains stay in separate shapes."""
    named = ", ".join(f"{point.force:.6g} pN (R-hat {point.r_hat:.3f})" for point in apart)
    warnings.warn(f"Chains stay in shapes of their own at {named}: {consequence}.", stacklevel=3)
    for point in apart:
        point.told = True


def _workers(processes: int | None) -> int:
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


def _points(
    chain: WormlikeChain | Filament,
    forces: Array,
    kelvin: float,
    wanted: Array,
    seed: int,
    dimension: int,
    platform: str,
    paths: Mapping[int, str | os.PathLike[str]],
    overwrite: bool,
    timestep: unit.Quantity | None,
) -> list[_Point]:
    temperature = kelvin * unit.kelvin
    if isinstance(chain, WormlikeChain):
        if dimension != 3:
            raise ValueError("Argument `dimension` must be 3 for a WormlikeChain, but is 2: pass a Filament.")
        plans = choose(chain, forces, temperature, wanted)
    elif isinstance(chain, Filament):
        if chain.closed or len(chain) < 2:
            raise ValueError("Argument `chain` must be an open filament of two beads or more to be pulled.")
        plans = [(chain if dimension == 3 else _laid_flat(chain), 0.0)] * len(forces)
    else:
        raise TypeError(f"Argument `chain` must be a WormlikeChain or a Filament, but is {chain!r}.")
    seeds = np.random.SeedSequence(seed).spawn(len(forces))
    points = []
    for i, ((filament, bias), force) in enumerate(zip(plans, forces, strict=True)):
        model = clamped_model(filament, force * PN, dimension, 1)
        rate = slow_frequency(model, kelvin / model.scale.factor("temperature"))
        to_ps = model.scale.factor("time")
        friction = FRICTION * rate / to_ps
        dt = thermal_step(model, kelvin, timestep)
        stride = max(1, round(_SAMPLE_TIME / rate / dt))
        runs = [
            _Run(
                Block(
                    filament=filament,
                    force=force * PN,
                    temperature=kelvin,
                    dimension=dimension,
                    replicas=_REPLICAS,
                    seed=int(child.generate_state(1)[0]) % (2**31 - 1) + 1,
                    timestep=dt * to_ps,
                    friction=friction,
                    stride=stride,
                    samples=0,
                    warm_up=round(_WARM_UP_TIME / rate / dt),
                    platform=platform,
                    keep_frames=i in paths and group == 0,
                ),
                _FIRST_ROUND,
            )
            for group, child in enumerate(seeds[i].spawn(_GROUPS))
        ]
        writer = TrajectoryWriter(model, paths[i], overwrite=overwrite) if i in paths else None
        points.append(_Point(float(force), float(wanted[i]), bias, runs, writer))
    return points


def _laid_flat(chain: Filament) -> Filament:
    """The filament with its rest shape turned into the xy plane, the only place where a planar run can hold it.

    Raises ValueError if no plane holds it.
    """
    rest = units.numbers("rest", chain.rest, "length")
    if not rest[:, 2].any():
        return chain
    centred = rest - rest.mean(axis=0)
    _, sizes, axes = np.linalg.svd(centred, full_matrices=False)
    if sizes[2] > 1e-9 * sizes[0]:
        raise ValueError(
            "Argument `chain` must have a rest shape in one plane for dimension 2, but it leaves the best one by "
            f"{np.abs(centred @ axes[2]).max():.3g} nm."
        )
    flat = centred @ axes.T
    flat[:, 2] = 0.0
    return replace(chain, rest=units.quantity(flat, "length"))


def _sample(points: Sequence[_Point], workers: int, progress: Callable[[Progress], None] | None) -> bool:
    """Run all points to their errors; whether it was interrupted."""
    begun = time.perf_counter()
    pending: dict[Future[BlockResult], tuple[_Point, _Run]] = {}
    with ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin_worker,
    ) as pool:

        def submit(point: _Point, run: _Run) -> None:
            with _main_hidden():
                pending[pool.submit(run_block, run.next_block())] = point, run

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
                        _take(point, run, future.result())
                        for due in point.due_after(run):
                            submit(point, due)
                        if not point.told and not point.finished and point.is_apart and run.done >= _LONG:
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
            _take(point, run, future.result())
    for point in points:
        point.stop()


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent process, and do not outlive it, whatever ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def follow() -> None:
        wait_for([parent.sentinel])
        os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _take(point: _Point, run: _Run, result: BlockResult) -> None:
    if point.writer is not None and result.frames is not None:
        dt = run.block.timestep
        if result.start is not None:
            axis = 2 if run.block.dimension == 3 else 0
            span = float(result.start[-1, axis] - result.start[0, axis])
            point.writer.write(result.start, 0, 0.0, extension_nm=span * point.writer.length_nm)
        for frame, extension in zip(result.frames, result.extensions[0], strict=True):
            point.frames += 1
            step = run.block.warm_up + point.frames * run.block.stride
            point.writer.write(frame, step, step * dt / point.writer.time_ps, extension_nm=float(extension))
    run.extensions.append(result.extensions)
    run.block = replace(run.block, checkpoint=result.checkpoint)


def _progress(points: Sequence[_Point], point: _Point, elapsed: float) -> Progress:
    running = [p for p in points if p.failure is None]
    done = sum(p.weight * sum(run.done for run in p.runs) / len(p.runs) for p in running)
    expected = sum(p.weight * p.expected() for p in running)
    fraction = min(done / expected, 1.0) if running else 1.0
    left = elapsed * (1 - fraction) / fraction if fraction else math.nan
    return Progress(fraction, left, point.force, point.mean, point.error, sum(p.finished for p in points))


@contextmanager
def _main_hidden() -> Iterator[None]:
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


def _dataset(
    points: Sequence[_Point],
    chain: WormlikeChain | Filament,
    kelvin: float,
    seed: int,
    dimension: int,
    platform: str,
    interrupted: bool,
) -> xarray.Dataset:
    import xarray

    from openmm_filament import __version__

    def column(values: Sequence[Any], units_: str, meaning: str) -> tuple[str, Array, dict[str, str]]:
        return "force", np.array(values), {"units": units_, "long_name": meaning}

    blocks = [point.runs[0].block for point in points]
    exact = [exact_chain(block.filament, kelvin * unit.kelvin) for block in blocks]

    def of_chain(value: Callable[[ExactChain], float]) -> list[float]:
        return [math.nan if chain is None else value(chain) for chain in exact]

    continuous = isinstance(chain, WormlikeChain)
    variables = {
        "extension": column([p.mean for p in points], "nm", "mean extension along the force"),
        "extension_error": column([p.error for p in points], "nm", "one standard error of the extension"),
        "bias": column(
            [p.mean * p.bias / (1 + p.bias) if continuous else math.nan for p in points],
            "nm",
            "exact discrete minus exact continuous extension",
        ),
        "effective_samples": column([p.samples for p in points], "1", "effective sample size of all chains"),
        "r_hat": column([p.r_hat for p in points], "1", "rank-normalised split R-hat"),
        "segments": column([len(b.filament) - 1 for b in blocks], "1", "segments of the chain"),
        "bond_length": column(of_chain(lambda c: c.bond_length), "nm", "rest length of the bonds"),
        "bending": column(of_chain(lambda c: _uniform(c.bending) * PN), "kJ/mol", "bending stiffness of the joints"),
        "stretching": column(of_chain(lambda c: c.stretching * PN), "kJ/mol/nm^2", "stiffness of the bonds"),
        "exact_discrete": column(
            [
                math.nan if c is None else float(c.extension(p.force, dimension))
                for c, p in zip(exact, points, strict=True)
            ],
            "nm",
            "exact extension of the discrete chain",
        ),
        "time_step": column([b.timestep for b in blocks], "ps", "time step"),
        "friction": column([b.friction for b in blocks], "1/ps", "friction"),
        "steps": column(
            [b.stride * min(run.done for run in p.runs) for b, p in zip(blocks, points, strict=True)],
            "1",
            "sampled steps of each chain",
        ),
        "finished": column([int(p.finished) for p in points], "1", "whether the wanted error was reached"),
        "diverged": column([int(p.failure is not None) for p in points], "1", "whether the run was given up"),
    }
    return xarray.Dataset(
        variables,
        coords={"force": ("force", np.array([p.force for p in points]), {"units": "pN", "long_name": "pulling force"})},
        attrs={
            "temperature_K": kelvin,
            "seed": seed,
            "dimension": dimension,
            "chains": _GROUPS * _REPLICAS,
            "platform": platform,
            "integrator": "LangevinMiddle",
            "interrupted": int(interrupted),
            "openmm_filament_version": __version__,
            "openmm_version": mm.Platform.getOpenMMVersion(),
            "numpy_version": np.__version__,
            "python_version": host.python_version(),
        },
    )


def _uniform(values: float | Array) -> float:
    return float(values) if np.ndim(values) == 0 else math.nan
