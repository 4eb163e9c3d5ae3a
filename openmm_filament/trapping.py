"""Traps while a model runs: moved, and read."""

from __future__ import annotations

import numpy as np
import openmm as mm
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import traps, units
from openmm_filament.model import Model

__all__ = ["move_trap", "trap_forces"]


def move_trap(model: Model, context: mm.Context, displacement: unit.Quantity, trap: int = 0) -> None:
    """Move a trap of a running Context.

    Parameters
    ----------
    displacement : Quantity
        Length, (3,), from where the trap was built: set, not added to what was set before.
    trap : int
        Its number, by default its place among the traps of its filament; those of one number move together.

    Raises ValueError for a number that the model has no trap of.
    """
    shift = units.numbers("displacement", displacement, "length") / model.scale.length
    check.finite("displacement", check.shape("displacement", shift, (3,)))
    _known(model, trap)
    for axis, value in zip(traps.AXES, shift.tolist(), strict=True):
        context.setParameter(traps.parameter(trap, axis), value)


def trap_forces(model: Model, context: mm.Context, trap: int = 0) -> unit.Quantity:
    """The forces k (r0 - r) of the traps of a number on their beads where they now stand: (M, 3), filament by filament.

    The force on a bead is the one that pulls the filament; minus the force that the light feels. The Quantity is in
    kJ/mol/nm, as OpenMM's own forces are, and per mole: divide its `value_in_unit(unit.kilojoule_per_mole/unit.nanometer)`
    by 0.602214 for pN.
    """
    _known(model, trap)
    whole = next(i for i in model.interactions if i.term is traps.Harmonic)
    chosen = model.trap_numbers == trap
    shift = [context.getParameter(traps.parameter(trap, axis)) for axis in traps.AXES]
    moved = traps.displaced(whole, np.where(chosen[:, None], shift, 0.0))
    state = context.getState(positions=True)
    positions = units.numbers("positions", state.getPositions(asNumpy=True), "length")
    forces = -moved.term.gradient(positions[moved.beads], moved.parameters)[chosen, 0]
    return model.to_physical(forces, "force")


def _known(model: Model, trap: int) -> None:
    if check.integer("trap", trap, low=0) not in model.trap_numbers:
        numbers = ", ".join(map(str, np.unique(model.trap_numbers))) or "it has none"
        raise check.fail("trap", f"be the number of a trap of the model ({numbers})", trap)
