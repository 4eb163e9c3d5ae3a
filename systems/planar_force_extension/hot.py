"""The chain in thermal motion, strictly in its plane: what is run, and what it gives.

Joints are double wells in a plane. Dynamics alone never crosses most of them where `k_B T` is small beside bending, so
free joints are helped by mirror moves between the stretches of dynamics (see `mirrored`). Frozen joints get none.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament import units
from openmm_filament.blocks import clamped_model
from openmm_filament.discretisation import PN
from openmm_filament.integrators import internal_langevin, thermal_step
from openmm_filament.starts import equilibrium_starts
from openmm_filament.timestep import slow_frequency
from systems.planar_force_extension import chain

__all__ = ["Job", "Sampled", "mirrored", "run", "sample"]

Array = NDArray[np.float64]

REPLICAS = 16
_MOVES = 20
"""Mirror moves a chain between samples."""

_SAMPLE_TIME, _WARM_UP_TIME = 0.1, 1.0
"""Between samples, and before the first: times over 1/omega of the slowest mode."""


@dataclass(frozen=True, eq=False)
class Job:
    """A temperature, a force in alpha/l0, and how much to run.

    `start` is a shape (31, 3) in segments l0 for chains with frozen joints, None for shapes drawn from equilibrium with
    joints either way. Whether joints are helped over is `moves`.
    """

    heat: float
    ratio: float
    force: float
    bead_steps: float
    seed: int
    start: Array | None = None
    moves: bool = True


@dataclass(frozen=True, eq=False)
class Sampled:
    """What a job gave: extension over contour with its standard error, and how the chains moved.

    `turned` (29,) is the number of changes of sign of each joint over all chains and samples.
    """

    job: Job
    extension: float
    error: float
    samples: float
    r_hat: float
    turned: Array


def run(jobs: Sequence[Job], progress: Callable[[float], None]) -> list[Sampled]:
    """Run jobs, longest first, one process a core; each is the same whatever the number of processes."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    order = sorted(range(len(jobs)), key=lambda i: -jobs[i].bead_steps)
    out: list[Sampled | None] = [None] * len(jobs)
    with ProcessPoolExecutor(min(cores, len(jobs)), mp_context=multiprocessing.get_context("spawn")) as pool:
        for done, (i, result) in enumerate(zip(order, pool.map(sample, [jobs[i] for i in order]), strict=True), 1):
            out[i] = result
            progress(done / len(jobs))
    return [result for result in out if result is not None]


def sample(job: Job) -> Sampled:
    """Run one job in this process."""
    filament = chain.scaled_filament(job.heat, job.ratio)
    step = chain.STEP * chain.SCALE * 1e9  # nm
    pull = job.force * chain.KT / job.heat / step * PN  # kJ/mol/nm
    model = clamped_model(filament, pull, 2, REPLICAS)
    heat = chain.TEMPERATURE / model.scale.factor("temperature")
    rate = slow_frequency(model, heat)
    dt = thermal_step(model, chain.TEMPERATURE)
    integrator = internal_langevin(model, heat, rate, dt, job.seed)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    rng = np.random.default_rng(job.seed)
    if job.start is None:
        x = equilibrium_starts(filament, pull, chain.TEMPERATURE, REPLICAS, rng, 2) / model.scale.length
    else:
        x = np.broadcast_to(job.start * step / model.scale.length, (REPLICAS, *job.start.shape))
    context.setPositions(x.reshape(-1, 3))
    context.setVelocitiesToTemperature(heat, job.seed)
    of.preflight(model, context)
    stride = max(1, round(_SAMPLE_TIME / (rate * dt)))
    count = max(20, round(job.bead_steps / (x[..., 0].size * stride)))
    integrator.step(round(_WARM_UP_TIME / (rate * dt)))
    extensions = np.empty((REPLICAS, count))
    turned: Array = np.zeros(len(chain.BENDS))
    signs = np.sign(chain.signed_bends(_positions(context)))
    kT = units.BOLTZMANN * heat
    force = pull / model.scale.factor("force")
    for i in range(count):
        integrator.step(stride)
        if job.moves:
            _move(context, force / kT, job.heat, rng)
        x = _positions(context)
        if not np.isfinite(x).all():
            raise FloatingPointError(f"The run at k_BT/alpha = {job.heat:g}, F l0/alpha = {job.force:g} diverged.")
        extensions[:, i] = x[:, -1, 0] - x[:, 0, 0]
        now = np.sign(chain.signed_bends(x))
        turned += (now != signs).sum(axis=0)
        signs = now
    return _estimated(job, np.asarray(extensions * (model.scale.length / (chain.SEGMENTS * step)), dtype=float), turned)


def _estimated(job: Job, extensions: Any, turned: Array) -> Sampled:
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
    )


def _positions(context: mm.Context) -> Array:
    x = context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer)
    return np.asarray(x).reshape(REPLICAS, -1, 3)


def _move(context: mm.Context, pull: float, heat: float, rng: np.random.Generator) -> None:
    """Mirror moves of every chain, velocities reflected with the beads: momenta keep their distribution.

    `pull` is the force over k_B T in 1/nm of the Context, `heat` is k_B T/alpha.
    """
    state = context.getState(positions=True, velocities=True)
    x = np.array(state.getPositions(asNumpy=True)._value).reshape(REPLICAS, -1, 3)
    v = np.array(state.getVelocities(asNumpy=True)._value).reshape(REPLICAS, -1, 3)
    for _ in range(_MOVES):
        x, v = mirrored(x, v, pull, heat, rng)
    context.setPositions(x.reshape(-1, 3))
    context.setVelocities(v.reshape(-1, 3))


def mirrored(x: Array, v: Array, pull: float, heat: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """One move tried on each of planar chains (R, N, 3) under a force along x: the chains, and their velocities, after it.

    Half of the moves reflect all beads beyond a joint in the line of the segment before it: bends keep their sizes, the
    force does work. The others reflect the beads between two in the line through these: the ends stay, two bends change.
    Each is its own inverse and as likely as it, so that Metropolis's rule holds.
    """
    chains, beads, _ = x.shape
    rows = np.arange(chains)
    ends: NDArray[np.int64] = np.sort(rng.permuted(np.tile(np.arange(beads), (chains, 1)), axis=1)[:, :2], axis=1)
    pivots: NDArray[np.bool_] = np.asarray(rng.random(chains) < 0.5)
    first: NDArray[np.int64] = np.where(pivots, np.minimum(ends[:, 0], beads - 2), ends[:, 0])
    end: NDArray[np.int64] = np.where(pivots, first + 1, ends[:, 1])
    axis: Array = x[rows, end] - x[rows, first]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    origin: Array = x[rows, first][:, None]
    bead = np.arange(beads)
    inside = np.where(pivots[:, None], bead > end[:, None], (bead > first[:, None]) & (bead < end[:, None]))

    def reflected(vectors: Array) -> Array:
        along = (vectors * axis[:, None]).sum(axis=-1, keepdims=True)
        return np.asarray(2 * along * axis[:, None] - vectors)

    flat = np.array([1.0, 1.0, 0.0])
    moved = np.where(inside[..., None], origin + flat * reflected(x - origin), x)
    gain = _weight(moved, pull, heat) - _weight(x, pull, heat)
    accepted = (np.log(rng.random(chains)) < gain)[:, None, None]
    after = np.where(inside[..., None], flat * reflected(v), v)
    return np.where(accepted, moved, x), np.where(accepted, after, v)


def _weight(x: Array, pull: float, heat: float) -> Array:
    """Logarithm of the Boltzmann weight of chains (R, N, 3), lengths of bonds aside: (R,)."""
    bends = np.abs(chain.signed_bends(x)) - np.abs(chain.BENDS)
    return np.asarray(pull * x[:, -1, 0] - (bends**2).sum(axis=-1) / (2 * heat))
