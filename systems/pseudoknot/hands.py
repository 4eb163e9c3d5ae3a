"""The running pairs: the task that says what they do, their Context in SI units, and the hand that moves the upper chains."""

from __future__ import annotations

import math
import warnings
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

__all__ = ["PLATFORM", "TRAP", "Hand", "Motion", "Task", "World", "model_of"]

Array = NDArray[np.float64]

APART = 0.04
"""Distance in m of the pairs that share a Context: they never meet."""

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
        Rate of all beads, 1/s.
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

    def start(self) -> Array:
        """All beads (n, N, 3) before anything moves."""
        columns = math.ceil(math.sqrt(len(self.poses)))
        spots = np.array([(i % columns, i // columns, 0) for i in range(len(self.poses))]) * APART
        lower, upper = self.lower.shape(), self.upper.shape() + np.array(self.place)
        pairs = [np.concatenate([pose.placed(lower), upper]) for pose in self.poses]
        return np.asarray(np.array(pairs) + (spots - spots.mean(axis=0))[:, None])

    def masses(self) -> Array:
        """(N,), zero where held."""
        out = np.concatenate([np.full(wire.segments + 1, wire.bead_mass()) for wire in (self.lower, self.upper)])
        out[:HELD] = 0.0
        return out


@dataclass
class Motion:
    """Beads (n, N, 3) in m and m/s, and where the hand's axis has turned to, in turns."""

    x: Array
    v: Array
    turned: float = 0.0


def model_of(task: Task, x: Array, *, gripped: bool = True) -> of.Model:
    """The pairs with the lower chains held at their feet and, `gripped`, the upper ones in traps where they are at x (n, N, 3).

    The rest shapes of the model are those of the poses.
    """
    stiffness = TRAP * task.upper.stretching() * unit.newton / unit.meter
    start, first = task.start()[: len(x)], task.lower.segments + 1
    filaments: list[of.Filament] = []
    loads: list[list[of.loads.Load]] = []
    for rest, pair in zip(start, x, strict=True):
        filaments += [task.lower.filament(rest[:first]), task.upper.filament(rest[first:])]
        hand: list[of.loads.Load] = []
        if gripped:
            hand += [of.loads.Trap(bead, stiffness, pair[first:][bead] * unit.meter) for bead in GRIP]
        loads += [[of.loads.Hold(range(HELD))], hand]
    return of.build(filaments, loads=loads)


class World:
    """A running Context, in SI units."""

    def __init__(self, task: Task, model: of.Model, motion: Motion, warmth: float, step: float, seed: int) -> None:
        self.shape = motion.x.shape
        self.metre = 1e9 / model.scale.length
        self.second = 1e12 / model.scale.factor("time")
        self.joule = stage.JOULE / model.scale.factor("energy")
        kelvin = warmth * self.joule / of.units.BOLTZMANN
        integrator = internal_langevin(model, kelvin, task.damping / self.second, step * self.second, seed)
        platform = mm.Platform.getPlatformByName(PLATFORM)
        self.context = mm.Context(model.system, integrator, platform, {"Threads": "1"})
        self.context.setPositions(motion.x.reshape(-1, 3) * self.metre)
        self.context.setVelocities(motion.v.reshape(-1, 3) * (self.metre / self.second))
        self.advance = integrator.step
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PreflightWarning)
            of.preflight(model, self.context, force_tolerance=ROUNDING)

    def look(self) -> tuple[Array, Array]:
        """Positions (n, N, 3) in m, and velocities in m/s, half a step before them."""
        state = self.context.getState(positions=True, velocities=True)
        x, v = state.getPositions(asNumpy=True)._value, state.getVelocities(asNumpy=True)._value
        return x.reshape(self.shape) / self.metre, v.reshape(self.shape) * (self.second / self.metre)

    def energies(self) -> tuple[float, float]:
        """Potential and kinetic, J."""
        state = self.context.getState(energy=True)
        return state.getPotentialEnergy()._value / self.joule, state.getKineticEnergy()._value / self.joule


class Hand:
    """Traps on beads of the upper chains that move together as one rigid body."""

    def __init__(self, task: Task, motion: Motion) -> None:
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
        for number, move in enumerate(self.shift * world.metre):
            for axis, value in zip(traps.AXES, move.tolist(), strict=True):
                world.context.setParameter(traps.parameter(number, axis), value)
        self.force = self.stiffness * (before + after).sum(axis=1) / 2
        return np.asarray(0.5 * self.stiffness * (after**2 - before**2).sum(axis=(1, 2)))
