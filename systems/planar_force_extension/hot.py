"""The chain in thermal motion, strictly in its plane: what is run, and what it gives.

Joints are double wells in a plane. Dynamics alone never crosses most of them where `k_B T` is small beside bending, so
stretches of Langevin dynamics in OpenMM take turns with Monte Carlo moves (`moves`); velocities are drawn anew after these.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament.blocks import clamped_model
from openmm_filament.discretisation import PN
from openmm_filament.integrators import internal_langevin, thermal_step
from openmm_filament.starts import equilibrium_starts
from systems.planar_force_extension import chain
from systems.planar_force_extension.moves import Moves

__all__ = ["LENGTH", "REPLICAS", "Job", "Sampled", "sample", "started"]

Array = NDArray[np.float64]

REPLICAS = 16

_STRIDE, _MOVES = 10, 50
"""Steps of dynamics, and then moves tried on every chain, between samples."""

_WARM_UP = 20
"""Samples left out at the start."""

LENGTH = chain.STEP * chain.SCALE * 1e9
"""Rest length of a segment of the chain that is run, in nm."""


@dataclass(frozen=True, eq=False)
class Job:
    """A temperature, a force in alpha/l0, and how many samples to take of each of the replicas.

    `ratio` is `k l0^2/alpha`. `sides` (29 numbers) are +1 or -1 for joints that stay on that side and 0 for free ones. `start`
    is the shape (31, 3) in segments l0 to start from, None for shapes drawn from equilibrium.
    """

    heat: float
    ratio: float
    force: float
    samples: int
    seed: int
    sides: tuple[float, ...] = chain.FREE
    start: Array | None = None


@dataclass(frozen=True, eq=False)
class Sampled:
    """What a job gave: extension over contour with its standard error, and how the chains moved.

    `turned` (29,) is the number of changes of side of each joint over all chains and samples, `frames` (samples, 31, 3) are
    the shapes of the first replica in nm.
    """

    job: Job
    extension: float
    error: float
    samples: float
    r_hat: float
    turned: Array
    frames: Array


@contextmanager
def started(jobs: Sequence[Job]) -> Iterator[Callable[[Callable[[float], None]], list[Sampled]]]:
    """Jobs at work, one process a core; yields the function that waits for all, given one that takes the fraction done.

    Each result is the same whatever the number of processes.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with ProcessPoolExecutor(min(cores, len(jobs)), mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = [pool.submit(_run, job) for job in jobs]

        def finished(progress: Callable[[float], None]) -> list[Sampled]:
            out = []
            for job, future in zip(jobs, futures, strict=True):
                out.append(_estimated(job, *future.result()))
                progress(len(out) / len(jobs))
            return out

        try:
            yield finished
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def sample(job: Job) -> Sampled:
    """Run one job in this process."""
    return _estimated(job, *_run(job))


def _run(job: Job) -> tuple[Array, Array, Array]:
    """Extensions (R, samples) over contour, and the last two attributes of `Sampled`."""
    filament = chain.scaled_filament(job.heat, job.ratio)
    pull = job.force * chain.KT / job.heat / LENGTH * PN  # kJ/mol/nm
    model = clamped_model(filament, pull, 2, REPLICAS)
    scale = model.scale.length
    heat = chain.TEMPERATURE / model.scale.factor("temperature")
    dt = thermal_step(model, chain.TEMPERATURE)
    integrator = internal_langevin(model, heat, 1 / (_STRIDE * dt), dt, job.seed)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    rng = np.random.default_rng(job.seed)
    if job.start is None:
        x = equilibrium_starts(filament, pull, chain.TEMPERATURE, REPLICAS, rng, 2) / scale
    else:
        x = np.broadcast_to(job.start * LENGTH / scale, (REPLICAS, *job.start.shape))
    context.setPositions(x.reshape(-1, 3))
    context.setVelocitiesToTemperature(heat, job.seed)
    of.preflight(model, context)
    moves = Moves(job.heat, job.force, job.sides, rng)
    extensions, frames = np.empty((REPLICAS, job.samples)), np.empty((job.samples, chain.SEGMENTS + 1, 3))
    turned: Array = np.zeros(len(chain.BENDS))
    sides = np.sign(chain.signed_bends(x))
    for i in range(-_WARM_UP, job.samples):
        integrator.step(_STRIDE)
        state = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer)
        x = np.array(state, dtype=float).reshape(REPLICAS, -1, 3)
        if not np.isfinite(x).all():
            raise FloatingPointError(f"The run at k_BT/alpha = {job.heat:g}, F l0/alpha = {job.force:g} diverged.")
        s = np.diff(x[..., 0], axis=1) + 1j * np.diff(x[..., 1], axis=1)
        lengths = np.abs(s) * scale / LENGTH
        headings = moves(np.angle(s), lengths, _MOVES)
        ends = np.cumsum(lengths * np.exp(1j * headings), axis=1) * LENGTH / scale
        x[:, 1:, 0], x[:, 1:, 1] = x[:, :1, 0] + ends.real, x[:, :1, 1] + ends.imag
        context.setPositions(x.reshape(-1, 3))
        context.setVelocitiesToTemperature(heat, int(rng.integers(1, 2**31 - 1)))
        now = np.sign(chain.signed_bends(x))
        turned += (now != sides).sum(axis=0)
        sides = now
        if i >= 0:
            extensions[:, i] = x[:, -1, 0] - x[:, 0, 0]
            frames[i] = x[0] * scale
    return extensions * (scale / (chain.SEGMENTS * LENGTH)), turned, frames


def _estimated(job: Job, extensions: Array, turned: Array, frames: Array) -> Sampled:
    from arviz_stats.base import array_stats

    def of_chains(name: str, **more: str) -> float:
        return float(getattr(array_stats, name)(extensions, chain_axis=0, draw_axis=1, **more))

    return Sampled(
        job,
        float(extensions.mean()),
        of_chains("mcse", method="mean"),
        of_chains("ess", method="mean"),
        of_chains("rhat"),
        turned,
        frames,
    )
