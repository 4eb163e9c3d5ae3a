"""Ensembles of pairs that share a Context: brought together, left alone in thermal motion, pulled apart. SI units."""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament.inspection import PreflightError
from systems.pseudoknot.hands import Hand, Motion, Task, World, model_of, placed
from systems.pseudoknot.ways import Way, smooth

__all__ = ["CLOSES", "EVERY", "STEPS", "Phase", "Result", "attempt", "made", "run"]

Array = NDArray[np.float64]

STEPS = (0.5, 0.7, 0.4)
"""Time steps of making, resting and breaking over the limit of stability at rest. Drawn out, a coil's torsion stiffens."""

CLOSES = 0.01
"""Largest misfit of the energy balance, over the largest of work, loss and change; beyond it half the time step is taken."""

STRIDE = 5
"""Steps between two moves of the hand: about as often as the stiffest mode swings, which takes four to six. Jumps less often
would find modes to shake, and do much work on them."""

EVERY = 8
"""Moves of the hand between two records: 40 steps, in which a coil that snaps off moves by a part of its thickness."""

WARMING = 6.0
"""Rate of the thermostat times the rest: at that of the motion the pairs would come to a seventh of the temperature."""

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
    stored, kinetic, whole_work, whole_lost : (K + 1,)
        Potential energy, the traps included, kinetic energy, work and loss of all pairs in the Context together, J.
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
    whole_work: Array
    whole_lost: Array
    frames: Array

    @property
    def misfit(self) -> float:
        """Work less what was stored and lost, over the largest of the three, of all pairs in the Context together."""
        work, lost = float(self.whole_work[-1]), float(self.whole_lost[-1])
        gained = float((self.stored + self.kinetic)[[0, -1]] @ [-1.0, 1.0])
        return (work - lost - gained) / max(abs(work), abs(lost), abs(gained))


@dataclass(frozen=True, eq=False)
class Result:
    """The phases of a task."""

    task: Task
    making: Phase
    resting: Phase
    breaking: Phase


class _TornError(Exception):
    """A chain has come apart or heated up: the time step was too long for a coil so drawn out."""


def attempt(tasks: tuple[Task, ...]) -> list[Result | str]:
    """The results of `run`, or why there is none: one setting that fails leaves the others."""
    try:
        with _on_one_core():
            return [*run(tasks)]
    except (RuntimeError, PreflightError) as error:
        if len(tasks) == 1:
            return [f"{tasks[0].label}: {error}"]
        return [result for task in tasks for result in attempt((task,))]


@contextmanager
def _on_one_core() -> Iterator[None]:
    """Keep a worker process on a core of its own, where the system can.

    The CPU platform wakes a thread several times a step: on the core of the thread that waits for it steps take half the time.
    """
    number = getattr(multiprocessing.current_process(), "_identity", ())
    if not number or not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {cores[number[-1] % len(cores)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def run(tasks: Sequence[Task]) -> list[Result]:
    """Make, leave alone and break the pairs of tasks in one Context.

    Where a chain comes apart or heats up, or the energies do not balance, they run again with half the time step, down to a
    quarter; several tasks each by itself where one comes apart.

    Raises
    ------
    ValueError
        If the tasks differ in what they must have in common.
    RuntimeError
        If a chain comes apart with a quarter of the time step, too.
    """
    if len({task.shared for task in tasks}) != 1:
        raise ValueError("Argument `tasks` must share times, damping, warmth and whether the hand lets go.")
    limit = _limit(tasks)
    found: list[Result] = []
    for part in (1, 0.5, 0.25):
        try:
            found = _attempt(tasks, part * limit)
        except _TornError:
            if len(tasks) > 1:
                return [result for task in tasks for result in run([task])]
            continue
        if max(abs(phase.misfit) for phase in (found[0].making, found[0].breaking)) <= CLOSES:
            break
    if not found:
        raise RuntimeError(
            f"A chain of {tasks[0].label!r} comes apart with {STEPS[-1] / 4:.3g} of the stable time step."
        )
    return found


def made(task: Task, part: float) -> Phase:
    """The making of one task alone, at this part of the limit of the time step, whatever comes of it.

    Raises RuntimeError if a chain comes apart or heats up.
    """
    try:
        (phase,) = _phase([task], _starting([task]), "making", task.times[0], part * _limit([task]), 1)
    except _TornError as error:
        raise RuntimeError(f"A chain of {task.label!r} comes apart with {part:.3g} of the stable time step.") from error
    return phase


def _limit(tasks: Sequence[Task]) -> float:
    """Of the time step at rest, s: the least of the tasks', whose chains never meet those of another task."""
    alone = [replace(task, poses=task.poses[:1]) for task in tasks]
    return min(float(of.stable_timestep(model_of([t], placed([t]))).value_in_unit(unit.second)) for t in alone)


def _starting(tasks: Sequence[Task]) -> list[Motion]:
    """Where the pairs begin, and with what velocities."""
    motions = []
    for task, x in zip(tasks, placed(tasks), strict=True):
        masses = task.masses()
        spread = np.sqrt(task.chill / np.where(masses > 0, masses, np.inf))
        motions.append(Motion(x, np.random.default_rng(task.seed).normal(size=x.shape) * spread[:, None]))
    return motions


def _attempt(tasks: Sequence[Task], limit: float) -> list[Result]:
    motions = _starting(tasks)
    seeds = np.random.default_rng([tasks[0].seed, 1]).integers(1, 2**31 - 1, 3)
    phases = []
    for name, part, time, seed in zip(("making", "resting", "breaking"), STEPS, tasks[0].times, seeds, strict=True):
        phases.append(_phase(tasks, motions, name, time, part * limit, int(seed)))
        for task, motion in zip(tasks, motions, strict=True):
            motion.turned = task.making.turns
    return [Result(task, *parts) for task, *parts in zip(tasks, *phases, strict=True)]


@dataclass
class _Pairs:
    """What is kept of a task while a phase runs: its hand (none that has let go), works and losses (n,), and records."""

    task: Task
    motion: Motion
    way: Way | None
    hand: Hand | None
    work: Array
    lost: Array
    rows: list[tuple[Any, ...]]


def _phase(
    tasks: Sequence[Task], motions: Sequence[Motion], name: str, time: float, longest: float, seed: int
) -> list[Phase]:
    """Go the ways of this name (or none: the hands have let go) in so long a time, and leave the motions as they are then.

    The time step is the longest, or somewhat less to come out even.
    """
    moves = EVERY * max(math.ceil(time / (longest * STRIDE * EVERY)), 1)
    step = time / (moves * STRIDE)
    ways = [getattr(task, name) for task in tasks]
    gripped = ways[0] is not None
    model = model_of(tasks, [motion.x for motion in motions], gripped=gripped)
    warmth, damping = (0.0, tasks[0].damping) if gripped else (tasks[0].warmth, WARMING / tasks[0].times[1])
    world = World(model, motions, warmth=warmth, damping=damping, step=step, seed=seed)
    pairs = []
    for number, (task, motion, way) in enumerate(zip(tasks, motions, ways, strict=True)):
        hand, count = Hand(task, motion, number) if gripped else None, len(task.poses)
        lost = np.zeros(count) if gripped else np.full(count, np.nan)
        pairs.append(_Pairs(task, motion, way, hand, np.zeros(count), lost, []))
    masses, loss = [task.masses() for task in tasks], STRIDE * math.expm1(2 * tasks[0].damping * step) / 2

    def record(i: int, part: float) -> None:
        energies = world.energies()
        whole = (sum(float(p.work.sum()) for p in pairs), sum(float(p.lost.sum()) for p in pairs))
        for p in pairs:
            force = p.hand.force if p.hand else np.zeros((len(p.work), 3))
            p.rows.append((i * STRIDE * step, part, p.work.copy(), p.lost.copy(), force, *energies, *whole, p.motion.x))

    record(0, 0.0)
    for i in range(1, moves + 1):
        part = smooth(i / moves)
        for p in pairs:
            if p.way and p.hand:
                p.work += p.hand.move(p.way, part, p.motion, step, world)
        try:
            world.advance(STRIDE)
        except mm.OpenMMException as error:
            if "NaN" not in str(error):
                raise
            raise _TornError from error
        for p, mass, (x, v) in zip(pairs, masses, world.look(), strict=True):
            p.motion.x, p.motion.v = x, v
            p.lost += loss * np.einsum("b,nbk,nbk->n", mass, v, v)
        if i % EVERY == 0:
            record(i, part)
    return [_reduced(p.task, p.rows) for p in pairs]


def _reduced(task: Task, rows: Sequence[tuple[Any, ...]]) -> Phase:
    """A phase from its records: time, part, work, loss, force, energies, work and loss of all, positions (n, N, 3)."""
    columns = (np.array(column) for column in zip(*rows, strict=True))
    times, parts, work, lost, force, stored, kinetic, whole_work, whole_lost, x = columns
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
    return Phase(
        times, parts, work, lost, force, link, touching, nearest, stored, kinetic, whole_work, whole_lost, frames
    )
