"""A short measured trial of a thermal model whose dihedrals may come into line, where no time step holds.

The force of a dihedral grows as 1/sin(beta). A joint that comes close to straight in the thermal motion of a pulled chain
is thrown about by it in one step, and such events, each giving energy that makes the next more likely, heat a chain to
1e5 K. Whether they happen is measured, not guessed: the model runs at the time step in question, and its energy, which
without them is kept, is compared at both ends of stretches a few times as long as the thermostat needs to take energy away.
"""

from __future__ import annotations

import math

import numpy as np
import openmm as mm

from openmm_filament import units
from openmm_filament.evaluation import internal_positions
from openmm_filament.model import Model
from openmm_filament.timestep import slow_frequency

__all__ = ["energy_gain"]

_PERIODS_TO_RELAX, _PERIODS = 1.0, 6.0
"""Periods of the slowest mode after which the chain is taken to lie under its pull, and after which the trial ends."""

_STRETCH = 4.0
"""Time between two draws of the velocities over 1/omega of that mode; half of it while the chain relaxes. With 2 a helix that
heats up was found in 9 of 10 trials, with 4 in 6 of 6."""

_BEAD_STEPS = 2.2e6
"""Beads times steps of a trial at most: about a second."""

_ENOUGH = 1.0
"""Gain at which a trial ends, its answer being plain."""


def energy_gain(model: Model, temperature: float, timestep: float) -> float:
    """The largest gain of energy in a stretch without thermostat, over the thermal kinetic energy; infinite if it diverged.

    From the rest positions, at an internal temperature (K) and time step. Where the step holds, the gain is within 0.01.
    The velocities are drawn by NumPy for a Verlet integrator: on Reference, whose Contexts share one random stream,
    others are not disturbed. For models in three dimensions.
    """
    positions = internal_positions(model)
    free = np.ones(len(positions), dtype=bool)
    free[model.held] = False
    thermal = 1.5 * units.BOLTZMANN * temperature * free.sum()
    speed = np.where(free, np.sqrt(units.BOLTZMANN * temperature / model.masses), 0.0)[:, None]
    rng = np.random.default_rng(0)
    integrator = mm.VerletIntegrator(timestep)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    context.setPositions(positions)

    def energy() -> float:
        state = context.getState(energy=True)
        total = state.getKineticEnergy() + state.getPotentialEnergy()
        return units.number("energy", total, "energy")

    period = 2 * math.pi / slow_frequency(model, temperature) / timestep
    end = min(_PERIODS * period, _BEAD_STEPS / len(positions))
    stretch = max(
        min(math.ceil(_STRETCH / (2 * math.pi) * period), int(end / 4)), 1
    )  # cold chains have endless periods
    done, worst = 0, 0.0
    while done < end and worst < _ENOUGH:
        relaxing = done < min(_PERIODS_TO_RELAX * period, end / 3)
        context.setVelocities(speed * rng.normal(size=positions.shape))
        before = energy()
        steps = max(stretch // 2, 1) if relaxing else stretch
        integrator.step(steps)
        done += steps
        gain = (energy() - before) / thermal
        if not math.isfinite(gain):
            return math.inf
        if not relaxing:
            worst = max(worst, gain)
    return worst
