"""Whether a run without thermostat keeps its energy, as an observer who looks now and then can tell."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import openmm as mm
from openmm import unit

from openmm_filament import units
from openmm_filament.evaluation import internal_positions
from openmm_filament.integrators import is_made_for, temperature_of
from openmm_filament.model import Model
from openmm_filament.timestep import highest_frequency

__all__ = ["Books", "allowed_rise"]

_RISE = 0.1
"""Rise of the energy, over what was seen to move between its kinds, that a time step well below the limit never makes."""

_ROUNDING = 1e-9
"""Rise over the energies themselves below which it may be rounding."""

_STILL = 1e-14
"""The same over what a strain or an angle of one would store: a strain of 1e-7, near which the arccosine loses an angle."""


def allowed_rise(model: Model, integrator: Any) -> float:
    """The rise of the energy, over the energy of the motion, above which a run has gone wrong; infinite where none can be told.

    The energy of Verlet steps swings by `(dt/limit)^2` of itself about what it keeps, and near the limit without bound; a
    CustomIntegrator's kinetic energy, half a step late, by `dt/limit`. Thermostats, plucks, traps and integrators of others
    may give energy for good reason.
    """
    driven = any(load.plucks or len(load.traps.beads) for load in model.loads)
    if driven or temperature_of(integrator) is not None or not is_made_for(integrator, model):
        return math.inf
    step = integrator.getStepSize().value_in_unit(unit.picosecond)
    part = step * highest_frequency(model, internal_positions(model)) / 2
    if part >= 1:
        return math.inf
    late = isinstance(integrator, mm.CustomIntegrator)
    return float(_RISE + (part**2 + 2 * part * late) / (1 - part**2))


class Books:
    """The energies seen in a run: what it began with, and how much went from one kind to the other."""

    def __init__(self, model: Model) -> None:
        x = internal_positions(model)
        shortest = float(np.linalg.norm(np.diff(x, axis=0), axis=-1).min(initial=np.inf))
        stored = (i.stored_energy(shortest) for i in model.interactions if len(i.beads) and i.term.span > 1)
        self._floor = _STILL * max(stored, default=0.0)
        self._began: float | None = None
        self._kinetic = 0.0
        self._potential = (math.inf, -math.inf)

    def rise(self, state: mm.State) -> float:
        """Enter a State with energies; the rise since the first one, over the largest energy seen to move."""
        kinetic = units.number("energy", state.getKineticEnergy(), "energy")
        potential = units.number("energy", state.getPotentialEnergy(), "energy")
        if self._began is None:
            self._began = kinetic + potential
        self._kinetic = max(self._kinetic, kinetic)
        self._potential = min(self._potential[0], potential), max(self._potential[1], potential)
        moved = max(self._kinetic, self._potential[1] - self._potential[0])
        rise = kinetic + potential - self._began
        return rise / moved if rise > max(_ROUNDING * (kinetic + abs(potential)), self._floor) else 0.0
