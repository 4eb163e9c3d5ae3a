"""An ensemble of pairs that share a Context: brought together, left alone in thermal motion, pulled apart. SI units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament.inspection import PreflightError
from systems.pseudoknot.hands import Hand, Motion, Task, World, model_of
from systems.pseudoknot.ways import Way, smooth

__all__ = ["EVERY", "STEP", "Phase", "Result", "attempt", "run"]

Array = NDArray[np.float64]

STEP = 0.5
"""Time step over the limit of stability at rest. Drawn out, a coil's torsion stiffens; its energy balance is checked."""

STRIDE = 5
"""Steps between two moves of the hand: more often than the stiffest mode swings, which takes six. Jumps less often would
find modes to shake, and do much work on them."""

EVERY = 8
"""Moves of the hand between two records: 40 steps, in which a coil that snaps off moves by a part of its thickness."""


TORN = 0.2
"""Strain of a segment that none of these loads comes near."""

HEATED = 0.5
"""Loss beyond the work over E I/R that no start brings along: near straight stretches the torsion is too stiff for a step."""


@dataclass(frozen=True, eq=False)
class Phase:
    """K + 1 records of n pairs, `EVERY` moves of the hand apart.

    Attributes
    ----------
    times, parts : (K + 1,)
        s since the start of the phase, and part of the way done.
    work, lost : (K + 1, n)
        Work of the hand and energy taken by friction since the start of the phase, J; `lost` is NaN under the thermostat.
    force : (K + 1, n, 3)
        Of the hand on the chain as it last moved on, N.
    link, touching : (K + 1, n)
        Gauss linking integral, and pairs of beads of the two chains in contact.
    nearest : (n,)
        Smallest distance of two beads of the two chains over the diameter.
    stored, kinetic : (K + 1,)
        Potential energy, the traps included, and kinetic energy of all pairs together, J.
    frames : (K + 1, N, 3)
        Of the first pair, m; without a film, (0, N, 3).
    """

    times: Array
    parts: Array
    work: Array
    lost: Array
    force: Array
    link: Array
    touching: NDArray[np.int64]
    nearest: Array
    stored: Array
    kinetic: Array
    frames: Array

    @property
    def misfit(self) -> float:
        """Work less what was stored and lost, over the largest of the three, of all pairs together."""
        work, lost = float(self.work[-1].sum()), float(self.lost[-1].sum())
        gained = float((self.stored + self.kinetic)[[0, -1]] @ [-1.0, 1.0])
        return (work - lost - gained) / max(abs(work), abs(lost), abs(gained))


@dataclass(frozen=True, eq=False)
class Result:
    """The phases of a task, and its time step in s."""

    task: Task
    making: Phase
    resting: Phase
    breaking: Phase
    step: float


class _TornError(Exception):
    """A chain has come apart or heated up: the time step was too long for a coil so drawn out."""


def attempt(task: Task) -> Result | str:
    """The result of `run`, or why there is none: one setting that fails leaves the others."""
    try:
        return run(task)
    except (RuntimeError, PreflightError) as error:
        return f"{task.label}: {error}"


def run(task: Task) -> Result:
    """Make, leave alone and break the pairs of a task; again with half the time step where a chain comes apart or heats up.

    Raises
    ------
    RuntimeError
        If one does with a quarter of it, too.
    """
    limit = of.stable_timestep(model_of(task, task.start())).value_in_unit(unit.second)
    for part in (STEP, STEP / 2, STEP / 4):
        try:
            return _attempt(task, part * limit)
        except _TornError:
            continue
    raise RuntimeError(f"A chain of {task.label!r} comes apart with {STEP / 4:.3g} of the stable time step.")


def _attempt(task: Task, longest: float) -> Result:
    rng = np.random.default_rng(task.seed)
    x, masses = task.start(), task.masses()
    spread = np.sqrt(task.chill / np.where(masses > 0, masses, np.inf))
    motion = Motion(x, rng.normal(size=x.shape) * spread[:, None])
    phases = []
    for way, time in zip((task.making, task.resting, task.breaking), task.times, strict=True):
        records = max(math.ceil(time / (longest * STRIDE * EVERY)), 1)
        step = time / (records * EVERY * STRIDE)
        phases.append(_phase(task, motion, way, step, records * EVERY, 1 + int(rng.integers(2**31 - 2))))
        motion.turned = task.making.turns
    return Result(task, phases[0], phases[1], phases[2], longest)


def _phase(task: Task, motion: Motion, way: Way | None, step: float, moves: int, seed: int) -> Phase:
    """Go a way (or none: the hand has let go), and leave the motion as it is at its end."""
    model = model_of(task, motion.x, gripped=way is not None)
    world = World(task, model, motion, 0.0 if way else task.warmth, step, seed)
    hand = Hand(task, motion) if way else None
    masses, loss = task.masses(), STRIDE * math.expm1(2 * task.damping * step) / 2
    count = len(task.poses)
    work, lost = np.zeros(count), np.zeros(count) if way else np.full(count, np.nan)
    rows: list[tuple[Any, ...]] = []

    def record(i: int, part: float) -> None:
        force = hand.force if hand else np.zeros((count, 3))
        rows.append((i * STRIDE * step, part, work.copy(), lost.copy(), force, *world.energies(), motion.x))

    record(0, 0.0)
    for i in range(1, moves + 1):
        part = smooth(i / moves)
        if way and hand:
            work += hand.move(way, part, motion, step, world)
        world.advance(STRIDE)
        motion.x, motion.v = world.look()
        lost += loss * np.einsum("b,nbk,nbk->n", masses, motion.v, motion.v)
        if i % EVERY == 0:
            record(i, part)
    return _reduced(task, rows)


def _reduced(task: Task, rows: Sequence[tuple[Any, ...]]) -> Phase:
    """A phase from its records: time, part, work, loss, force, energies, positions (n, N, 3)."""
    times, parts, work, lost, force, stored, kinetic, x = (np.array(column) for column in zip(*rows, strict=True))
    first, reach = task.lower.segments + 1, (task.lower.thickness + task.upper.thickness) / 2
    link, touching = np.empty(work.shape), np.empty(work.shape, dtype=np.int64)
    nearest = np.empty(work.shape[1])
    for chain, wire in ((x[:, :, :first], task.lower), (x[:, :, first:], task.upper)):
        strain = np.linalg.norm(np.diff(chain, axis=2), axis=-1) / wire.segment_length() - 1
        if not (np.abs(strain) < TORN).all():
            raise _TornError
    if (lost - work > HEATED * task.lower.energy).any():
        raise _TornError
    for i, pair in enumerate(x.swapaxes(0, 1)):
        below, above = pair[:, :first], pair[:, first:]
        link[:, i] = of.analysis.linking(below, above)
        distances = np.linalg.norm(below[:, :, None] - above[:, None], axis=-1)
        touching[:, i] = (distances < reach).sum(axis=(1, 2))
        nearest[i] = distances.min() / reach
    frames = x[:, 0] if task.film else x[:0, 0]
    return Phase(times, parts, work, lost, force, link, touching, nearest, stored, kinetic, frames)
