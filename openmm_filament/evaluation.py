"""Energies and forces of a model through OpenMM, converted back to physical units."""

from __future__ import annotations

from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.model import Model

__all__ = ["energies", "forces", "internal_positions", "kinetic_temperature", "snapshot"]


def internal_positions(model: Model, positions: Any = None) -> NDArray[np.float64]:
    """Physical positions, a Quantity (N, 3), as internal numbers; the rest positions by default."""
    if positions is None:
        return units.numbers("positions", model.positions, "length")
    values = check.shape("positions", units.numbers("positions", positions, "length"), (int(model.starts[-1]), 3))
    return values / model.scale.length


def kinetic_temperature(model: Model, velocities: NDArray[np.float64], beads: NDArray[np.bool_] | None = None) -> float:
    """Internal kinetic temperature (K) of internal velocities (N, 3): `sum m v^2/(k_B n)` over the n free degrees.

    Held beads are left out, and the third coordinate of a planar model; with `beads` (N,) all others too. 0 where nothing is
    free.
    """
    free = np.ones(len(velocities), dtype=bool) if beads is None else beads.copy()
    free[model.held] = False
    moving = velocities[free, : 2 if model.planar else 3]
    twice = float(model.masses[free] @ (moving * moving).sum(axis=1))
    return twice / (units.BOLTZMANN * moving.size) if moving.size else 0.0


def snapshot(context: mm.Context) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Internal positions and velocities (N, 3) and the step count of a Context: a good frame to go back to."""
    state = context.getState(positions=True, velocities=True)
    return (
        units.numbers("positions", state.getPositions(asNumpy=True), "length"),
        units.numbers("velocities", state.getVelocities(asNumpy=True), "velocity"),
        context.getStepCount(),
    )


def _context(model: Model, positions: Any, platform: mm.Platform | None) -> mm.Context:
    platform = platform or mm.Platform.getPlatformByName("Reference")
    context = mm.Context(model.system, mm.VerletIntegrator(1.0), platform)
    context.setPositions(internal_positions(model, positions))
    return context


def energies(model: Model, positions: Any = None, platform: mm.Platform | None = None) -> dict[str, float]:
    """Potential energies in kJ/mol by term, through OpenMM's force groups.

    Parameters
    ----------
    positions : Quantity, optional
        Physical positions (N, 3); the rest positions by default.
    platform : openmm.Platform, optional
        Reference by default.
    """
    context = _context(model, positions, platform)
    factor = model.scale.factor("energy")
    out = {}
    for name, group in model.groups.items():
        energy = context.getState(energy=True, groups=1 << group).getPotentialEnergy()
        out[name] = units.number("energy", energy, "energy") * factor
    return out


def forces(model: Model, positions: Any = None, platform: mm.Platform | None = None) -> NDArray[np.float64]:
    """Total forces (N, 3) in kJ/mol/nm on all beads, held ones included, through OpenMM; arguments as for `energies`."""
    state = _context(model, positions, platform).getState(forces=True)
    return units.numbers("forces", state.getForces(asNumpy=True), "force") * model.scale.factor("force")
