"""One stretch of a force-clamp simulation: what a worker process runs, from numbers and bytes to numbers and bytes.

A block ends with an OpenMM checkpoint, which on Reference holds the random stream too, so that the next block of the
same run may be made by any process and the run is the same bit for bit however it was cut up. Reference has one random
stream a process: a block therefore makes its Context, runs alone, and gives it up.
"""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import units
from openmm_filament.divergence import check_heat, diagnose
from openmm_filament.evaluation import snapshot
from openmm_filament.filament import Filament
from openmm_filament.integrators import calm, internal_langevin
from openmm_filament.loads import Hold, Load, Plane, Pull
from openmm_filament.model import Model, build
from openmm_filament.platforms import platform_properties
from openmm_filament.starts import equilibrium_starts

__all__ = ["Block", "BlockResult", "check_ends", "clamped_model", "clamps", "run_block"]

Array = NDArray[np.float64]

_LOOK_BEAD_STEPS = 3e4
"""Beads times steps between looks at the heat, which then cost at most 2 % (50 to 70 us a look; a bead's step 0.15 us)."""

_alone = threading.Lock()


@dataclass(frozen=True, eq=False)
class Block:
    """What to run: `replicas` of a filament, bead 0 held, the last one pulled by `force` (kJ/mol/nm).

    `timestep` (ps) and `friction` (1/ps) are physical. Samples are taken every `stride` steps. Without a checkpoint
    the run begins, at shapes drawn from equilibrium, with `warm_up` steps that give no samples.
    """

    filament: Filament
    force: float
    temperature: float
    dimension: int
    replicas: int
    seed: int
    timestep: float
    friction: float
    stride: int
    samples: int
    warm_up: int
    platform: str
    keep_frames: bool
    checkpoint: bytes | None = None


@dataclass(frozen=True, eq=False)
class BlockResult:
    """What a block sampled.

    Extensions (replicas, samples) in nm; replica 0's shape (N, 3) at step 0 and its frames (samples, N, 3), in internal
    units, where they are kept; the checkpoint to go on from; and the wall time spent, in seconds.
    """

    extensions: Array
    start: NDArray[np.float32] | None
    frames: NDArray[np.float32] | None
    checkpoint: bytes
    seconds: float


def check_ends(name: str, filament: Filament) -> None:
    """Refuse a filament without two ends to hold and to pull."""
    if filament.closed or len(filament) < 2:
        raise ValueError(f"Argument `{name}` must be an open filament of two beads or more to be pulled.")


def clamped_model(filament: Filament, force: float, dimension: int, replicas: int) -> Model:
    """Replicas with bead 0 held and the last bead pulled along z (x in two dimensions) by `force` in kJ/mol/nm."""
    return build([filament] * replicas, [clamps(force, dimension)] * replicas)


def clamps(force: float, dimension: int) -> list[Load]:
    """The loads of one replica."""
    pull = np.zeros(3)
    pull[_axis(dimension)] = force
    loads: list[Load] = [Hold(0), Pull(-1, units.quantity(pull, "force"))]
    if dimension == 2:
        loads.append(Plane())
    return loads


def _axis(dimension: int) -> int:
    return 2 if dimension == 3 else 0


def run_block(block: Block) -> BlockResult:
    """Run a block in this process.

    Raises
    ------
    DivergedError
        If a coordinate is not finite, or the run is far hotter than its thermostat.
    RuntimeError
        If another thread of this process is at a block.
    """
    if not _alone.acquire(blocking=False):
        raise RuntimeError(
            "A block must be alone in its process, whose random stream it uses, but another thread is at one: give an "
            "executor whose workers have one thread each."
        )
    try:
        return _run(block)
    finally:
        _alone.release()


def _run(block: Block) -> BlockResult:
    begun = time.perf_counter()
    model = clamped_model(block.filament, block.force, block.dimension, block.replicas)
    temperature = block.temperature * unit.kelvin
    heat = block.temperature / model.scale.factor("temperature")
    integrator = internal_langevin(
        model,
        heat,
        block.friction / model.scale.factor("rate"),
        block.timestep / model.scale.factor("time"),
        block.seed,
    )
    platform = mm.Platform.getPlatformByName(block.platform)
    context = mm.Context(model.system, integrator, platform, platform_properties(model, platform, temperature))
    start = None
    if block.checkpoint is None:
        _begin(block, model, context)
        if block.keep_frames:
            start = _positions(context.getState(positions=True))[: len(block.filament)].astype(np.float32)
    else:
        context.loadCheckpoint(block.checkpoint)
    good = snapshot(context)

    def checked(look: bool) -> Array:
        """The present positions; with `look` their heat too. Raises DivergedError."""
        state = context.getState(positions=True, velocities=look)
        positions = _positions(state)
        if not np.isfinite(positions).all():
            raise diagnose(model, context, positions, context.getStepCount(), good)
        if look:
            check_heat(model, positions, _velocities(state), heat, context.getStepCount())
        return positions

    if block.checkpoint is None:
        calm(integrator, model)
        integrator.step(block.warm_up)
        checked(True)
    axis, beads = _axis(block.dimension), len(block.filament)
    extensions = np.empty((block.replicas, block.samples))
    frames = np.empty((block.samples, beads, 3), dtype=np.float32) if block.keep_frames else None
    between_looks = math.ceil(_LOOK_BEAD_STEPS / (block.replicas * beads * block.stride))
    for sample in range(block.samples):
        integrator.step(block.stride)
        positions = checked(sample % between_looks == 0 or sample == block.samples - 1)
        chains = positions.reshape(block.replicas, beads, 3)
        extensions[:, sample] = chains[:, -1, axis] - chains[:, 0, axis]
        if frames is not None:
            frames[sample] = chains[0]
    seconds = time.perf_counter() - begun
    return BlockResult(extensions * model.scale.length, start, frames, context.createCheckpoint(), seconds)


def _positions(state: mm.State) -> Array:
    return units.numbers("positions", state.getPositions(asNumpy=True), "length")


def _velocities(state: mm.State) -> Array:
    return units.numbers("velocities", state.getVelocities(asNumpy=True), "velocity")


def _begin(block: Block, model: Model, context: mm.Context) -> None:
    rng = np.random.default_rng(block.seed)
    starts = equilibrium_starts(block.filament, block.force, block.temperature, block.replicas, rng, block.dimension)
    if "contact" in model.groups:  # replicas in one System must not meet
        longest = float(np.linalg.norm(np.diff(starts, axis=1), axis=-1).sum(axis=1).max())
        starts[:, :, 1] += 4 * longest * np.arange(block.replicas)[:, None]
    context.setPositions(starts.reshape(-1, 3) / model.scale.length)
    context.setVelocitiesToTemperature(block.temperature / model.scale.factor("temperature"), block.seed)
