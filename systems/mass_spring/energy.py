"""How well the energy of a chain is kept without damping."""

from __future__ import annotations

import numpy as np
from openmm import unit

import openmm_filament as of
from systems import conservation
from systems.conservation import Drift
from systems.mass_spring.chain import Chain, launch

__all__ = ["drift", "finding"]


def drift(chain: Chain, length: int, *, amplitude: float = 1e-3) -> Drift:
    """Make at least `length` steps at a tenth of the stability limit with all modes in motion, and fit a slope to the energy.

    See `conservation.drift`.
    """
    dt = 0.1 * of.stable_timestep(chain.model).value_in_unit(unit.second)
    start = np.zeros(chain.masses)
    resting = launch(chain, start, dt).getState(energy=True).getPotentialEnergy()
    start[0] = amplitude
    return conservation.drift(launch(chain, start, dt), length, resting=resting)


def finding(kept: Drift) -> str:
    """The slope with its standard error."""
    return (
        f"Undamped, at a tenth of the stability limit, the energy of the motion has a slope of {kept} "
        f"of it per 10^6 steps ({kept.length} steps); within a period it swings by {kept.spread:.1e} of it."
    )
