"""One group of replicas whose end is led from one place or force to another: what a worker process runs.

Bead 0 is held at the origin and the last bead is pulled along z, clamped or trapped. What leads it, the control, changes in
jumps with steps in between; the work of a jump is the change of the energy at the positions it finds. That is the work
of Jarzynski's and Crooks's theorems, with jumps of any size: a jump forward undone by one back, in reverse order.

OpenMM's LangevinMiddle begins each step with the kicks by the forces, half of which belong before the jump: they are made
with the forces there were. Left out, the work would be off in the first order of the time step; so it is exact for
harmonic chains at any stable step. (The step is then VRORV of Fass et al., Entropy 20, 318 (2018), or BAOAB.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import units
from openmm_filament._term import Interaction
from openmm_filament.divergence import check_heat, diagnose
from openmm_filament.evaluation import snapshot
from openmm_filament.filament import Filament
from openmm_filament.holding import held_starts
from openmm_filament.integrators import calm, internal_langevin
from openmm_filament.loads import Hold, Load, Pluck, Pull, Trap
from openmm_filament.model import Model, build
from openmm_filament.starts import equilibrium_starts
from openmm_filament.traps import parameter

__all__ = ["Control", "Ramp", "RampResult", "controlled_model", "run_ramp"]

Array = NDArray[np.float64]
Control = Literal["force", "extension", "trap"]


@dataclass(frozen=True, eq=False)
class Ramp:
    """What to run: `replicas` of a filament in one System on Reference.

    The control takes its `values` (kJ/mol/nm or nm) one after another, the first being the one it is equilibrated at for
    `warm_up` steps, with `stride` steps after each of the others and a record after `every` of them; then, with `back`, it is
    equilibrated at the last value and takes them in reverse order. With more `reads` than one, `every` being 1, a record is
    the mean of so many readings, each after `stride` steps. `tensions` (kJ/mol/nm) are those of the chain at the
    first value and at the last, roughly; `stiffness` (3,) in kJ/mol/nm^2 is that of the trap; `timestep` (ps) and
    `friction` (1/ps) are physical.
    """

    filament: Filament
    control: Control
    values: Array
    stiffness: Array
    tensions: tuple[float, float]
    temperature: float
    replicas: int
    seed: int
    timestep: float
    friction: float
    warm_up: int
    stride: int
    every: int
    back: bool
    reads: int = 1


@dataclass(frozen=True, eq=False)
class RampResult:
    """Records of each direction, replica and time, (1 or 2, replicas, records + 1): nm, kJ/mol/nm and kJ/mol.

    The force is that of the trap or clamp on the last bead. `work` is done on the filament since the first record.
    """

    extension: Array
    force: Array
    work: Array


def controlled_model(
    filament: Filament, control: Control, first: float, last: float, stiffness: Array, replicas: int
) -> Model:
    """Replicas with bead 0 held, the last one under a control that is built at its `first` value.

    A force goes from the first to the last value with the Context parameter "pluck" from 0 to 1.
    """
    z = np.array([0.0, 0.0, 1.0])
    match control:
        case "force":
            pull, more = (units.quantity(value * z, "force") for value in (first, last - first))
            loads: list[Load] = [Hold(0), Pull(-1, pull), Pluck(-1, more, 1.0 * unit.picosecond)]
        case "extension":
            loads = [Hold([0, -1])]
        case "trap":
            loads = [Hold(0), Trap(-1, units.quantity(stiffness, "stiffness"), units.quantity(first * z, "length"))]
    return build([filament] * replicas, [loads] * replicas)


def run_ramp(ramp: Ramp) -> RampResult:
    """Run a group of replicas in this process.

    Raises
    ------
    DivergedError
        If a coordinate is not finite, or the run is far hotter than its thermostat after it was equilibrated.
    """
    led = _Led(ramp)
    directions = [ramp.values, ramp.values[::-1]] if ramp.back else [ramp.values]
    records = []
    for values in directions:
        led.equilibrate()
        records.append(tuple(np.stack(columns, axis=-1) for columns in zip(*led.through(values), strict=True)))
    extension, force, work = (np.stack(columns) for columns in zip(*records, strict=True))
    return RampResult(extension, force, work)


class _Led:
    """A Context of replicas, its control set, moved and read in physical units."""

    def __init__(self, ramp: Ramp) -> None:
        self.ramp = ramp
        self.beads = len(ramp.filament)
        first, last = float(ramp.values[0]), float(ramp.values[-1])
        self.model = controlled_model(ramp.filament, ramp.control, first, last, ramp.stiffness, ramp.replicas)
        scale = self.model.scale
        self.heat = ramp.temperature / scale.factor("temperature")
        self.integrator = internal_langevin(
            self.model,
            self.heat,
            ramp.friction / scale.factor("rate"),
            ramp.timestep / scale.factor("time"),
            ramp.seed,
        )
        self.context = mm.Context(self.model.system, self.integrator, mm.Platform.getPlatformByName("Reference"))
        self.context.setPositions(self._starts().reshape(-1, 3) / scale.length)
        self.context.setVelocitiesToTemperature(self.heat, ramp.seed)
        self.ends = self.model.starts[1:] - 1
        self.at_ends = [_acting_on(interaction, self.ends) for interaction in self.model.interactions]
        self.kick = ramp.timestep / scale.factor("time") / 2 / self.model.masses[:, None]
        self.value = first
        if ramp.control == "force":
            self.context.setParameter("pluck", 0.0)
        calm(self.integrator, self.model)
        self.good = snapshot(self.context)

    def _starts(self) -> Array:
        ramp = self.ramp
        rng = np.random.default_rng(ramp.seed)
        kelvin, force = ramp.temperature, ramp.tensions[0]
        if ramp.control == "force":
            return equilibrium_starts(ramp.filament, force, kelvin, ramp.replicas, rng)
        stiffness = np.full(3, np.inf) if ramp.control == "extension" else ramp.stiffness
        return held_starts(ramp.filament, float(ramp.values[0]), stiffness, force, kelvin, ramp.replicas, rng)

    def equilibrate(self) -> None:
        """Run at the present value, and see that the thermostat holds."""
        self.integrator.step(self.ramp.warm_up)
        self.positions()
        self.good = snapshot(self.context)
        check_heat(self.model, self.good[0], self.good[1], self.heat, self.good[2])

    def through(self, values: Array) -> Iterator[tuple[Array, Array, Array]]:
        """Extension, force and work (replicas,) at the first value and after every `every` of the others."""
        work = np.zeros(self.ramp.replicas)
        yield *self.read(), work
        for i, value in enumerate(values[1:], start=1):
            if value != self.value:
                work = work + self.lead(float(value))
            if self.ramp.reads > 1:
                yield *self._mean(), work
                continue
            self.integrator.step(self.ramp.stride)
            if i % self.ramp.every == 0:
                yield *self.read(), work

    def _mean(self) -> tuple[Array, Array]:
        """The mean of so many readings, `stride` steps apart."""
        total = np.zeros((2, self.ramp.replicas))
        for _ in range(self.ramp.reads):
            self.integrator.step(self.ramp.stride)
            total += self.read()
        extension, force = total / self.ramp.reads
        return extension, force

    def lead(self, value: float) -> Array:
        """Set the control, and give the work (replicas,) of that in kJ/mol."""
        ramp, model, before = self.ramp, self.model, self.value
        state = self.context.getState(positions=True, velocities=True)
        positions = self._finite(state)
        velocities = _numbers(state.getVelocities(asNumpy=True), "velocity")
        z = positions[self.ends, 2] * model.scale.length
        step = value - before
        self.value = value
        match ramp.control:
            case "force":
                first, last = ramp.values[0], ramp.values[-1]
                self.context.setParameter("pluck", float((value - first) / (last - first)))
                work, pushed = -step * z, step
            case "trap":
                self.context.setParameter(parameter(0, "z"), float(value - ramp.values[0]) / model.scale.length)
                work, pushed = ramp.stiffness[2] * step * ((value + before) / 2 - z), ramp.stiffness[2] * step
            case "extension":
                moved = positions.copy()
                moved[self.ends, 2] = value / model.scale.length
                self.context.setPositions(moved)
                work = (self._energies(moved) - self._energies(positions)) * model.scale.energy
                for interaction in self.at_ends:
                    velocities -= self.kick * (interaction.forces(moved) - interaction.forces(positions))
                velocities[model.held] = 0.0
                self.context.setVelocities(velocities)
                return work
        velocities[self.ends, 2] -= self.kick[self.ends, 0] * pushed / model.scale.factor("force")
        self.context.setVelocities(velocities)
        return np.asarray(work)

    def _energies(self, positions: Array) -> Array:
        """Of the elements that the last beads belong to, summed by replica."""
        total = np.zeros(self.ramp.replicas)
        for interaction in self.at_ends:
            energies = interaction.term.energy(positions[interaction.beads], interaction.parameters)
            total += np.bincount(interaction.beads[:, 0] // self.beads, energies, self.ramp.replicas)
        return total

    def read(self) -> tuple[Array, Array]:
        """Extension in nm and force in kJ/mol/nm, (replicas,).

        The force of a clamp is the tension `-sum_i (i/N) F_i.z` of the whole chain, F_i being the forces on its beads: the
        mean is that on the last bead, since the mean force on each free one is zero, and the noise much smaller.
        """
        ramp = self.ramp
        z = self.positions()[self.ends, 2] * self.model.scale.length
        match ramp.control:
            case "force":
                return z, np.full(ramp.replicas, self.value)
            case "trap":
                return z, ramp.stiffness[2] * (self.value - z)
            case "extension":
                state = self.context.getState(forces=True)
                forces = units.numbers("forces", state.getForces(asNumpy=True), "force")[:, 2]
                along = np.linspace(0.0, 1.0, self.beads)
                return z, -forces.reshape(-1, self.beads) @ along * self.model.scale.factor("force")

    def positions(self) -> Array:
        """The present positions (N, 3), internal; raises DivergedError where one is not finite."""
        return self._finite(self.context.getState(positions=True))

    def _finite(self, state: mm.State) -> Array:
        positions = _numbers(state.getPositions(asNumpy=True), "length")
        if not np.isfinite(positions).all():
            raise diagnose(self.model, self.context, positions, self.context.getStepCount(), self.good)
        return positions


def _numbers(value: Any, dimension: str) -> Array:
    return units.numbers("state", value, dimension)


def _acting_on(interaction: Interaction, beads: NDArray[np.int64]) -> Interaction:
    """The elements of an interaction that one of these beads belongs to."""
    chosen = np.isin(interaction.beads, beads).any(axis=1)
    parameters = {name: values[chosen] for name, values in interaction.parameters.items()}
    return Interaction(interaction.term, interaction.beads[chosen], parameters)
