"""A whole force-extension curve in one Context, for a GPU: every replica of every force in one System.

Each chain keeps the time step and friction of its own plan: one step of the integrator is a step of `timestep` of its own
for every chain, as chains do not interact. There are as many replicas of a force as let all forces come to their errors at
about the same time. A force of which a chain diverges is given up: its chains are put back to where they last were well, and
stand still while the others go on.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import units
from openmm_filament.blocks import BlockResult, clamped_model, clamps
from openmm_filament.checkpoints import Checkpoint
from openmm_filament.discretisation import FEWEST_SAMPLES, exact_chain
from openmm_filament.divergence import DivergedError, check_heat, diagnose
from openmm_filament.evaluation import snapshot
from openmm_filament.integrators import CALM, needs_calm
from openmm_filament.keeping import take_all, tell_of
from openmm_filament.model import Model, build
from openmm_filament.own_steps import calmed, own_steps, set_values, stand_still, values_of
from openmm_filament.planning import Plan
from openmm_filament.platforms import platform_properties
from openmm_filament.points import Point, Run
from openmm_filament.progress import Meter
from openmm_filament.starts import equilibrium_starts

__all__ = ["WideRun", "replicas", "sample_wide", "wide_points"]

Array = NDArray[np.float64]

_BEADS = 20_000
"""Beads in the System, enough to occupy a GPU."""

_FEWEST = 8
"""Replicas of a force."""

_FIRST_ROUND = 60
"""Samples a chain in the first round: twelve relaxation times, as many short chains would not tell their own error."""

_BLOCK_BEAD_STEPS = 2e8
"""Beads times steps between two looks at the heat, and records in the checkpoint, at most."""


def replicas(plans: Sequence[Plan], kelvin: float, dimension: int) -> list[int]:
    """How many replicas of each force to run: in proportion to the steps that one would need, as far as that is known."""
    needs = np.array([_need(plan, kelvin, dimension) for plan in plans])
    needs[np.isnan(needs)] = np.nanmean(needs) if np.isfinite(needs).any() else 1.0
    beads = np.array([len(plan.choice.filament) for plan in plans])
    counts: Array = np.maximum(np.round(needs * _BEADS / (needs @ beads)), _FEWEST)
    return [int(count) for count in counts]


def _need(plan: Plan, kelvin: float, dimension: int) -> float:
    """Steps to the wanted error, up to a factor: independent samples by the exact fluctuation, `k_B T dz/dF`."""
    exact = exact_chain(plan.choice.filament, kelvin * unit.kelvin)
    if exact is None:
        return math.nan
    low, here, high = (float(exact.extension(plan.force * factor, dimension)) for factor in (0.99, 1.0, 1.01))
    variance = exact.kT * (high - low) / (0.02 * plan.force) / here**2
    samples = variance * (2 / (plan.relative_error - plan.choice.known)) ** 2
    return max(samples, FEWEST_SAMPLES) * plan.stride


def wide_points(plans: Sequence[Plan], kelvin: float, dimension: int, seed: int, platform: str) -> list[Point]:
    """The points of a curve in one Context: a run each, all with the same warm-up and strides that are multiples."""
    tick = min(plan.stride for plan in plans)
    warm_up = max(plan.warm_up for plan in plans)
    points = []
    for plan, count in zip(plans, replicas(plans, kelvin, dimension), strict=True):
        block = replace(
            plan.block(seed, kelvin, dimension, platform),
            replicas=count,
            stride=max(1, round(plan.stride / tick)) * tick,
            warm_up=warm_up,
        )
        points.append(Point(plan.force, plan.relative_error, plan.choice, [Run(block, _FIRST_ROUND)]))
    return points


class WideRun:
    """The Context of all points, from its starts or from the end of an earlier run of the same points.

    `failures` are the points that it has given up, by their numbers.
    """

    def __init__(self, points: Sequence[Point], seed: int, checkpoint: bytes | None = None) -> None:
        self._blocks = [point.runs[0].block for point in points]
        first = self._blocks[0]
        self._kelvin, self._axis = first.temperature, 2 if first.dimension == 3 else 0
        self.tick = min(block.stride for block in self._blocks)
        self._every = [block.stride // self.tick for block in self._blocks]
        self._model = _model(points)
        scale = self._model.scale
        self._heat = self._kelvin / scale.factor("temperature")
        self._integrator = _integrator(self._model, points, self._heat, seed)
        properties = platform_properties(self._model, first.platform, self._kelvin * unit.kelvin)
        platform = mm.Platform.getPlatformByName(first.platform)
        self._context = mm.Context(self._model.system, self._integrator, platform, properties)
        counts = np.array([block.replicas for block in self._blocks])
        self._chains = np.concatenate([[0], np.cumsum(counts)])
        self._point = np.repeat(np.arange(len(points)), np.diff(self._model.starts[self._chains]))  # of each bead
        self.failures = {i: point.failure for i, point in enumerate(points) if point.failure is not None}
        # a trajectory counts in the units of its own chain
        self._to_frame = [
            scale.length / clamped_model(block.filament, block.force, block.dimension, 1).scale.length
            for block in self._blocks
        ]
        if checkpoint is not None:
            self._context.loadCheckpoint(checkpoint)
            stand_still(self._integrator, np.isin(self._point, list(self.failures)))
            self._starts: list[NDArray[np.float32] | None] = [None] * len(points)
            self._good = snapshot(self._context)
        else:
            self._begin(seed)
        self._ticks = (self._good[2] - first.warm_up) // self.tick

    @property
    def weight(self) -> float:
        """Beads times steps of one tick."""
        return float(self._model.starts[-1] * self.tick)

    def most_ticks(self) -> int:
        """Ticks of one record at most."""
        return max(1, int(_BLOCK_BEAD_STEPS / self.weight))

    def ticks_to(self, points: Iterable[Point]) -> int:
        """Ticks until the first of the points that are not finished has the samples it wants, or a record is due."""
        left = [
            (point.runs[0].wanted - point.runs[0].done) * every - self._ticks % every
            for point, every in zip(points, self._every, strict=True)
            if not _is_done(point)
        ]
        return max(1, min(*left, self.most_ticks()) if left else 1)

    def advance(self, ticks: int) -> list[BlockResult]:
        """So many ticks; what each point has sampled, NaN where it is given up; the last with the checkpoint at the end.

        Raises DivergedError where the platform itself stops at a coordinate that is not finite, so that no point can go on.
        """
        begun = time.perf_counter()
        first, last = self._model.starts[:-1], self._model.starts[1:] - 1
        extensions = np.empty((len(first), ticks))
        frames: list[list[NDArray[np.float32]]] = [[] for _ in self._blocks]
        length = self._model.scale.length
        for column in range(ticks):
            self._step(self.tick)
            state = self._context.getState(positions=True)
            positions = self._finite(units.numbers("positions", state.getPositions(asNumpy=True), "length"))
            extensions[:, column] = (positions[last, self._axis] - positions[first, self._axis]) * length
            for i, block in enumerate(self._blocks):
                if block.keep_frames and not (self._ticks + column + 1) % self._every[i]:
                    frames[i].append(self._first_replica(positions, i))
        self._cool(snapshot(self._context))
        results = []
        numbers = self._ticks + 1 + np.arange(ticks)
        for i, block in enumerate(self._blocks):
            own = extensions[self._chains[i] : self._chains[i + 1], numbers % self._every[i] == 0]
            if i in self.failures:  # one sample at least, which says so
                nothing = np.full((block.replicas, max(1, own.shape[1])), np.nan)
                results.append(BlockResult(nothing, None, None, b"", 0.0))
                continue
            kept = np.array(frames[i], dtype=np.float32).reshape(-1, len(block.filament), 3)
            results.append(BlockResult(own, self._starts[i], kept if block.keep_frames else None, b"", 0.0))
        self._ticks += ticks
        self._starts = [None] * len(self._blocks)
        results[-1] = replace(
            results[-1], checkpoint=self._context.createCheckpoint(), seconds=time.perf_counter() - begun
        )
        return results

    def _begin(self, seed: int) -> None:
        """Shapes drawn from equilibrium, calmed where they have dihedrals, and the warm-up."""
        shapes = []
        for block, child in zip(self._blocks, np.random.SeedSequence(seed).spawn(len(self._blocks)), strict=True):
            rng = np.random.default_rng(child)
            starts = equilibrium_starts(
                block.filament, block.force, block.temperature, block.replicas, rng, block.dimension
            )
            shapes.append(starts.reshape(-1, 3))
        self._context.setPositions(np.concatenate(shapes) / self._model.scale.length)
        self._context.setVelocitiesToTemperature(self._heat, seed % (2**31 - 1) + 1)
        self._good = snapshot(self._context)
        self._starts = [
            self._first_replica(self._good[0], i) if block.keep_frames else None for i, block in enumerate(self._blocks)
        ]
        if needs_calm(self._model):
            with calmed(self._integrator):
                self._step(CALM[1])
            self._context.setStepCount(0)
            self._finite(snapshot(self._context)[0])
        self._step(self._blocks[0].warm_up)
        self._finite(snapshot(self._context)[0])
        self._cool(snapshot(self._context))

    def _step(self, steps: int) -> None:
        """Raises DivergedError where the platform will not go on."""
        try:
            self._integrator.step(steps)
        except mm.OpenMMException as error:
            if "nan" not in str(error).lower():
                raise
            raise DivergedError(
                f"A chain diverged by step {self._context.getStepCount()}, and the platform {self._blocks[0].platform} stops "
                f"the whole Context for it ({error}), so that no force can go on: leave `platform` out, and the others do.",
                0,
                "unknown",
                self._context.getStepCount(),
                self._model.to_physical(self._good[0], "length"),
            ) from error

    def _first_replica(self, positions: Array, point: int) -> NDArray[np.float32]:
        begin = int(self._model.starts[self._chains[point]])
        chain = positions[begin : begin + len(self._blocks[point].filament)]
        return np.asarray(chain * self._to_frame[point], dtype=np.float32)

    def _finite(self, positions: Array) -> Array:
        """The positions, once the points that have lost a bead are given up."""
        lost = ~np.isfinite(positions).all(axis=1)
        if not lost.any():
            return positions
        for i in np.unique(self._point[lost]).tolist():
            self._give_up(i, self._diagnosed(i, positions))
        return snapshot(self._context)[0]

    def _cool(self, frame: tuple[Array, Array, int]) -> None:
        """Give up the points that are far too hot; the frame is then a good one to go back to."""
        for i in range(len(self._blocks)):
            if i in self.failures:
                continue
            try:
                check_heat(self._model, frame[0], frame[1], self._heat, frame[2], self._point == i)
            except DivergedError as error:
                self._give_up(i, error)
                frame = snapshot(self._context)
        self._good = frame

    def _diagnosed(self, point: int, positions: Array) -> DivergedError:
        """The report on a point that diverged: its steps are repeated while the others stand still, and all is put back."""
        own = self._point == point
        saved, values = self._context.createCheckpoint(), values_of(self._integrator)
        stand_still(self._integrator, ~own)
        error = diagnose(
            self._model,
            self._context,
            np.where(own[:, None], positions, self._good[0]),
            self._context.getStepCount(),
            self._good,
        )
        self._context.loadCheckpoint(saved)
        set_values(self._integrator, values)
        return error

    def _give_up(self, point: int, error: DivergedError) -> None:
        """Put the chains of a point back to where they were well, for good."""
        own = self._point == point
        positions, velocities, _ = snapshot(self._context)
        self._context.setPositions(np.where(own[:, None], self._good[0], positions))
        self._context.setVelocities(np.where(own[:, None], 0.0, velocities))
        stand_still(self._integrator, own)
        self.failures[point] = error


def _model(points: Sequence[Point]) -> Model:
    blocks = [point.runs[0].block for point in points]
    filaments = [block.filament for block in blocks for _ in range(block.replicas)]
    loads = [clamps(block.force, block.dimension) for block in blocks for _ in range(block.replicas)]
    return build(filaments, loads)


def _integrator(model: Model, points: Sequence[Point], heat: float, seed: int) -> mm.CustomIntegrator:
    """LangevinMiddle's steps with a time step and a friction for each degree of freedom; those frozen have no step."""
    scale, columns = model.scale, []
    blocks = [point.runs[0].block for point in points]
    shortest = min(block.timestep for block in blocks)
    for block in blocks:
        keep = math.exp(-block.friction * block.timestep)
        noise = math.sqrt((1 - keep**2) * units.BOLTZMANN * heat)
        beads = block.replicas * len(block.filament)
        columns.append(np.tile([block.timestep / shortest, keep, noise], (beads, 1)))
    values = np.concatenate(columns)
    values[:, 2] /= np.sqrt(model.masses)
    return own_steps(model, values, shortest / scale.factor("time"), seed)


def _is_done(point: Point) -> bool:
    return point.finished or point.failure is not None


def _restored(points: Sequence[Point], store: Checkpoint | None) -> bytes | None:
    """Take what the checkpoint has; the state of the Context at its end."""
    saved = None
    group: list[BlockResult] = []
    for i, _, result in () if store is None else store.stored():
        group = [*(group if i else []), result]  # an end may have cut a group off
        if len(group) == len(points):
            take_all(points, group, store)
            saved = result.checkpoint
    return saved


def sample_wide(points: Sequence[Point], seed: int, store: Checkpoint | None, meter: Meter) -> bool:
    """Run all points to their errors in one Context, from where the checkpoint has them; whether it was interrupted."""
    saved = _restored(points, store)
    meter.begin(points, None if saved is None else points[-1])
    try:
        if all(_is_done(point) for point in points):
            return False
        run = WideRun(points, seed, saved)
        while not all(_is_done(point) for point in points):
            results = run.advance(run.ticks_to(points))
            if store is not None:
                for i, result in enumerate(results):
                    store.add(i, 0, result)
            take_all(points, results, store, run.failures)
            for point in points:
                if point.is_stuck:
                    tell_of([point], "the error falls only as fast as they change them, which may take very long")
            if running := [point for point in points if point.failure is None]:
                meter.show(points, min(running, key=lambda p: (p.finished, p.runs[0].done / p.expected())))
    except DivergedError as error:
        for point in points:
            if not _is_done(point):
                point.fail(error)
    except KeyboardInterrupt:
        for point in points:
            point.stop()
        return True
    return False
