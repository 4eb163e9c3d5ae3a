"""How well the energy of a chain is kept without damping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from systems.mass_spring.chain import Chain, launch
from systems.scene import Check

__all__ = ["Drift", "check_drift", "drift", "finding"]

Array = NDArray[np.float64]

_DRIFT = 1e-6
"""Slope of the energy per 10^6 steps and two standard errors, relative to the energy of the motion. Measured: 1e-9 over 10^6
steps, 5e-7 over 10^5, where the blocks are shorter and so is the line through them."""
_BLOCKS = 10


@dataclass(frozen=True, eq=False)
class Drift:
    """Energy of a chain's motion without damping.

    Attributes
    ----------
    steps, energies : (B,) array
        Steps at the middle of a block, and the block's mean energy over that of the first, less one.
    slope, error : float
        Per 10^6 steps, relative to the energy of the motion; one standard error.
    spread : float
        Standard deviation of the energy within a period, relative.
    length : int
        Steps made.
    """

    steps: Array
    energies: Array
    slope: float
    error: float
    spread: float
    length: int


def drift(chain: Chain, length: int, *, amplitude: float = 1e-3) -> Drift:
    """Make at least `length` steps at a tenth of the stability limit with all modes in motion, and fit a slope to the energy.

    The energy is kinetic plus potential, above that at rest; a step's error makes it swing twice a period about a constant.
    Means of blocks under a Hann window take that out, and a straight line through them leaves the drift.
    """
    dt = 0.1 * of.stable_timestep(chain.model).value_in_unit(unit.second)
    every = 7  # twice the highest frequency is sampled three times a period
    start = np.zeros(chain.masses)
    resting = launch(chain, start, dt).getState(energy=True).getPotentialEnergy()
    start[0] = amplitude
    context = launch(chain, start, dt)
    integrator = context.getIntegrator()
    energies = np.empty(-(-length // (every * _BLOCKS)) * _BLOCKS)
    for i in range(len(energies)):
        integrator.step(every)
        state = context.getState(energy=True)
        energies[i] = (state.getKineticEnergy() + state.getPotentialEnergy() - resting)._value
    blocks = energies.reshape(_BLOCKS, -1)
    window = np.sin(np.pi * (np.arange(blocks.shape[1]) + 0.5) / blocks.shape[1]) ** 2
    means = blocks @ window / window.sum()
    middles = np.asarray((np.arange(_BLOCKS) + 0.5) * (every * blocks.shape[1]), dtype=np.float64)
    line, covariance = np.polyfit(middles / 1e6, means / means.mean(), 1, cov=True)
    return Drift(
        middles,
        np.asarray(means / means[0] - 1),
        float(line[0]),
        float(np.sqrt(covariance[0, 0])),
        float(energies.std() / means.mean()),
        every * len(energies),
    )


def check_drift(kept: Drift) -> Check:
    """That the slope is zero."""
    name = f"slope of the energy per 10^6 steps over {kept.length} steps, relative, with two standard errors"
    return Check(name, "exact", kept.slope, 0.0, abs(kept.slope) + 2 * kept.error, _DRIFT)


def finding(kept: Drift) -> str:
    """The slope with its standard error."""
    return (
        f"Undamped, at a tenth of the stability limit, the energy of the motion has a slope of {kept.slope:.1e} "
        f"+- {kept.error:.1e} of it per 10^6 steps ({kept.length} steps); within a period it swings by {kept.spread:.1e} of it."
    )
