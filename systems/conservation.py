"""How well a run keeps the energy of its motion: the slope of a straight line through it, and the error of that slope."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from systems.scene import Check

__all__ = ["SLOPE", "Drift", "check_drift", "drift", "through"]

Array = NDArray[np.float64]

SLOPE = 1e-6
"""What is asked of the slope of the energy per 10^6 steps plus two standard errors, over the energy of the motion."""

BLOCKS = 10


@dataclass(frozen=True, eq=False)
class Drift:
    """Energy of an undamped motion.

    Attributes
    ----------
    steps, energies : (B,) array
        Steps at the middle of a block, and the block's mean energy over that of the first, less one.
    slope, error : float
        Per 10^6 steps, relative to the energy of the motion; one standard error.
    spread : float
        Standard deviation of the energy about its mean, relative: the error of a single step comes and goes.
    length : int
        Steps made.
    """

    steps: Array
    energies: Array
    slope: float
    error: float
    spread: float
    length: int

    def __str__(self) -> str:
        """The slope with its standard error, "(1.2e-09 +- 3e-10)"."""
        return f"({self.slope:.1e} +- {self.error:.0e})"


def drift(context: mm.Context, length: int, *, resting: unit.Quantity, every: int = 7) -> Drift:
    """Make at least `length` steps and fit a slope to kinetic plus potential energy above that at rest, `resting`.

    OpenMM's kinetic energy under `of.verlet` is that of the step, not of half a step before. The default of 7 steps between
    two energies is for a tenth of the stability limit: the energy swings at twice a mode's frequency, and of the fastest
    this is three samples a period.
    """
    integrator = context.getIntegrator()
    energies = np.empty(-(-length // (every * BLOCKS)) * BLOCKS)
    for i in range(len(energies)):
        integrator.step(every)
        state = context.getState(energy=True)
        energies[i] = (state.getKineticEnergy() + state.getPotentialEnergy() - resting)._value
    return through(energies, every)


def through(energies: Array, every: int) -> Drift:
    """A straight line through the energies (T,) taken every so many steps.

    A step's error makes the energy swing about a constant. Means of blocks under a Hann window take that out, and the
    line through them leaves the drift. The line through ten blocks weighs slow swings as a drift too: then the run is too
    short, and the error of the slope says so.
    """
    kept = energies[: len(energies) // BLOCKS * BLOCKS]
    blocks = kept.reshape(BLOCKS, -1)
    window = np.sin(np.pi * (np.arange(blocks.shape[1]) + 0.5) / blocks.shape[1]) ** 2
    means = blocks @ window / window.sum()
    middles = np.asarray((np.arange(BLOCKS) + 0.5) * (every * blocks.shape[1]), dtype=np.float64)
    line, covariance = np.polyfit(middles / 1e6, means / means.mean(), 1, cov=True)
    return Drift(
        middles,
        np.asarray(means / means[0] - 1),
        float(line[0]),
        math.sqrt(float(covariance[0, 0])),
        float(kept.std() / means.mean()),
        every * len(kept),
    )


def check_drift(kept: Drift, name: str = "") -> Check:
    """That the slope is zero to within `SLOPE`, its own uncertainty of two standard errors included: a noisy slope fails."""
    text = f"{name}slope of the energy per 10^6 steps over {kept.length} steps, relative, with two standard errors"
    return Check(text, "exact", kept.slope, 0.0, abs(kept.slope) + 2 * kept.error, SLOPE)
