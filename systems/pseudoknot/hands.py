"""The running pairs: the task that says what they do, their Context in SI units, and the hand that moves the upper chains."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament import traps
from openmm_filament.inspection import PreflightWarning
from openmm_filament.integrators import internal_langevin
from systems import stage
from systems.pseudoknot.chains import GRIP, HELD, Wire
from systems.pseudoknot.poses import Pose
from systems.pseudoknot.ways import Way

__all__ = ["PLATFORM", "TRAP", "Hand", "Motion", "Task", "World", "model_of", "placed"]

Array = NDArray[np.float64]

CELL = (0.04, 0.04, 0.08)
"""Distances in m, along x, y and z, of the pairs that share a Context: they never meet."""

TRAP = 0.1
"""Stiffness of a trap over that of a segment."""

ROUNDING = 0.02
"""Of contact forces, which the CPU platform computes from distances in single precision: light touches lose digits. The
balance of energies is checked instead."""

PLATFORM = "CPU"
"""Of OpenMM, on one thread: contact on Reference takes ten times as long."""


@dataclass(frozen=True)
class Task:
    """What a worker does, in SI units.

    Attributes
    ----------
    poses : tuple of Pose
        Of the lower chain, one a pair.
    place : (float, float, float)
        The upper chain's foot before it is brought.
    making, resting, breaking : Way or None
        Of the hand; None where it lets go, and a thermostat takes over.
    times : (float, float, float)
        Of making, resting and breaking.
    damping : float
        Rate of all beads while the hand moves, 1/s.
    chill, warmth : float
        k_B T of the first velocities and of the thermostat while the pair rests, J; the hand moves without a thermostat.
    film : bool
        Whether to keep the positions of the first pair.
    """

    label: str
    lower: Wire
    upper: Wire
    poses: tuple[Pose, ...]
    place: tuple[float, float, float]
    making: Way
    resting: Way | None
    breaking: Way
    times: tuple[float, float, float]
    damping: float
    chill: float
    warmth: float
    seed: int
    film: bool = False

    @property
    def shared(self) -> tuple[float | bool, ...]:
        """What tasks must have in common to run in one Context, to nine digits."""
        numbers = (*self.times, self.damping, self.warmth)
        return (*(float(f"{number:.8e}") for number in numbers), self.resting is None)

    def start(self) -> Array:
        """All beads (n, N, 3) before anything moves, every pair with its lower chain's foot near the origin."""
        lower, upper = self.lower.shape(), self.upper.shape() + np.array(self.place)
        return np.array([np.concatenate([pose.placed(lower), upper]) for pose in self.poses])

    def masses(self) -> Array:
        """(N,), zero where held."""
        out = np.concatenate([np.full(wire.segments + 1, wire.bead_mass()) for wire in (self.lower, self.upper)])
        out[:HELD] = 0.0
        return out


def placed(tasks: Sequence[Task]) -> list[Array]:
    """The starts of the tasks that share a Context, each pair in a cell of its own."""
    counts = [len(task.poses) for task in tasks]
    side = math.ceil(round(sum(counts) ** (1 / 3), 9))
    cells = np.array([(i % side, i // side % side, i // side**2) for i in range(sum(counts))], dtype=np.float64)
    spots = np.split((cells - cells.mean(axis=0)) * CELL, np.cumsum(counts)[:-1])
    return [task.start() + spot[:, None] for task, spot in zip(tasks, spots, strict=True)]


@dataclass
class Motion:
    """Beads (n, N, 3) in m and m/s, and where the hand's axis has turned to, in turns."""

    x: Array
    v: Array
    turned: float = 0.0


def model_of(tasks: Sequence[Task], where: Sequence[Array], *, gripped: bool = True) -> of.Model:
    """The pairs with the lower chains held at their feet and, `gripped`, the upper ones in traps where they are.

    The pairs of each task are at `where` (n, N, 3); their traps have numbers of their own. The rest shapes of the model are
    those of the poses, in places apart.
    """
    filaments: list[of.Filament] = []
    loads: list[list[of.loads.Load]] = []
    for number, (task, start, x) in enumerate(zip(tasks, placed(tasks), where, strict=True)):
        stiffness = TRAP * task.upper.stretching() * unit.newton / unit.meter
        first = task.lower.segments + 1
        for rest, pair in zip(start, x, strict=False):
            filaments += [task.lower.filament(rest[:first]), task.upper.filament(rest[first:])]
            hand: list[of.loads.Load] = []
            if gripped:
                hand += [
                    of.loads.Trap(bead, stiffness, pair[first:][bead] * unit.meter, number=len(GRIP) * number + i)
                    for i, bead in enumerate(GRIP)
                ]
            loads += [[of.loads.Hold(range(HELD))], hand]
    return of.build(filaments, loads=loads)


class World:
    """A running Context of some tasks' pairs, in SI units."""

    def __init__(
        self,
        model: of.Model,
        motions: Sequence[Motion],
        *,
        warmth: float,
        damping: float,
        step: float,
        seed: int,
    ) -> None:
        self.shapes = [motion.x.shape for motion in motions]
        self.metre = 1e9 / model.scale.length
        self.second = 1e12 / model.scale.factor("time")
        self.joule = stage.JOULE / model.scale.factor("energy")
        kelvin = warmth * self.joule / of.units.BOLTZMANN
        integrator = internal_langevin(model, kelvin, damping / self.second, step * self.second, seed)
        platform = mm.Platform.getPlatformByName(PLATFORM)
        self.context = mm.Context(model.system, integrator, platform, {"Threads": "1"})
        x, v = (np.concatenate([getattr(motion, name).reshape(-1, 3) for motion in motions]) for name in ("x", "v"))
        self.context.setPositions(x * self.metre)
        self.context.setVelocities(v * (self.metre / self.second))
        self.advance = integrator.step
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PreflightWarning)
            of.preflight(model, self.context, force_tolerance=ROUNDING)

    def look(self) -> list[tuple[Array, Array]]:
        """Positions (n, N, 3) in m of each task, and velocities in m/s, half a step before them."""
        state = self.context.getState(positions=True, velocities=True)
        x = state.getPositions(asNumpy=True)._value / self.metre
        v = state.getVelocities(asNumpy=True)._value * (self.second / self.metre)
        ends = np.cumsum([n * beads for n, beads, _ in self.shapes])[:-1]
        parts = zip(np.split(x, ends), np.split(v, ends), self.shapes, strict=True)
        return [(a.reshape(shape), b.reshape(shape)) for a, b, shape in parts]

    def energies(self) -> tuple[float, float]:
        """Potential and kinetic, J."""
        state = self.context.getState(energy=True)
        return state.getPotentialEnergy()._value / self.joule, state.getKineticEnergy()._value / self.joule


class Hand:
    """Traps on beads of the upper chains of a task that move together as one rigid body; `number` is the task's in its World."""

    def __init__(self, task: Task, motion: Motion, number: int) -> None:
        traps_of = range(len(GRIP) * number, len(GRIP) * (number + 1))
        self.names = [traps.parameter(trap, axis) for trap in traps_of for axis in traps.AXES]
        beads = task.upper.segments + 1
        grip = np.array(GRIP) % beads
        points = task.upper.shape()[grip]
        self.points = points + Way("", (0.0, 0.0, 0.0), motion.turned).displacements(points, 1.0)
        self.beads = task.lower.segments + 1 + grip
        self.stiffness = TRAP * task.upper.stretching()
        self.centres = motion.x[:, self.beads]
        self.shift = np.zeros((len(grip), 3))
        self.force = np.zeros((len(motion.x), 3))

    def move(self, way: Way, part: float, motion: Motion, step: float, world: World) -> Array:
        """Go on to a part of the way; the work of that, (n,) in J. The mean of the forces before and after is kept.

        The step that follows begins with its whole kick, as if the hand had moved half a step ago: the work is done where
        the beads were then.
        """
        there = motion.x[:, self.beads] - 0.5 * step * motion.v[:, self.beads]
        before = self.centres + self.shift - there
        self.shift = way.displacements(self.points, part)
        after = self.centres + self.shift - there
        for name, value in zip(self.names, (self.shift * world.metre).ravel().tolist(), strict=True):
            world.context.setParameter(name, value)
        self.force = self.stiffness * (before + after).sum(axis=1) / 2
        return np.asarray(0.5 * self.stiffness * (after**2 - before**2).sum(axis=(1, 2)))
