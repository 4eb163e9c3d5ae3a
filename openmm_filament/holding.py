"""Starting shapes of chains whose far end is kept at a place, by a clamp or a trap, and the tension in them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_filament import units
from openmm_filament.filament import Filament
from openmm_filament.starts import equilibrium_starts

__all__ = ["held_starts", "tension"]

Array = NDArray[np.float64]

_CHAINS, _HALVINGS, _DOUBLINGS = 8, 7, 60
"""Chains whose mean extension is taken at each force that is tried, and how often the bracket is halved and doubled."""

_SPREAD = 16
"""Chains, at least, from which the spread of a free end is taken."""


def tension(filament: Filament, distance: float, stiffness: float, temperature: float) -> float:
    """The force (kJ/mol/nm) of an open chain whose end is drawn to `distance` (nm) from its beginning, roughly.

    That at which `<z(F)> + F/k` is the distance, k being the stiffness of the trap (infinite for a clamp); zero where the
    free chain is longer. By the mean of a few chains in equilibrium: an estimate for starts and friction, no result.
    """

    def surplus(force: float) -> float:
        chains = equilibrium_starts(filament, force, temperature, _CHAINS, np.random.default_rng(0))
        return float(chains[:, -1, 2].mean()) + force / stiffness - distance

    length = float(np.linalg.norm(np.diff(units.numbers("rest", filament.rest, "length"), axis=0), axis=-1).sum())
    low, high = 0.0, units.BOLTZMANN * temperature / length
    for _ in range(_DOUBLINGS):
        if surplus(high) >= 0:
            break
        low, high = high, 2 * high
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if surplus(middle) >= 0 else (middle, high)
    return high if low else 0.0


def held_starts(
    filament: Filament,
    distance: float,
    stiffness: Array,
    force: float,
    temperature: float,
    count: int,
    rng: np.random.Generator,
) -> Array:
    """Shapes (count, N, 3) in nm near equilibrium with bead 0 at the origin and the end drawn to (0, 0, distance).

    Drawn under a constant `force` (kJ/mol/nm), then sheared so that the ends spread as under the trap of this stiffness
    (3,), all beads in proportion to their number; infinite stiffness puts every end there.
    """
    shapes = equilibrium_starts(filament, force, temperature, max(count, _SPREAD), rng)
    ends = shapes[:, -1]
    thermal = units.BOLTZMANN * temperature
    narrower = 1 / np.sqrt(1 + stiffness * ends.var(axis=0) / thermal)  # the product of two normal distributions
    off = ends - [0.0, 0.0, ends[:, 2].mean()]
    wanted = [0.0, 0.0, distance - force / stiffness[2]] + narrower * off
    along = np.linspace(0.0, 1.0, shapes.shape[1])[:, None]
    return np.asarray((shapes + (wanted - ends)[:, None] * along)[:count])
