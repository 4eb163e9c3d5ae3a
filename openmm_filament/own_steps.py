"""LangevinMiddle for many chains at once, each with a time step and a friction of its own, which may change while it runs.

The scheme is that of Zhang et al., J. Phys. Chem. A 2019. One step of the integrator is a step of its own for each chain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import openmm as mm
from numpy.typing import NDArray

from openmm_filament.integrators import CALM
from openmm_filament.model import Model

__all__ = ["calmed", "own_steps", "set_values", "stand_still", "values_of"]

Array = NDArray[np.float64]

_NAMES = ("own", "keep", "noise")
"""Per degree of freedom: the time step over the shortest one, the part of a velocity that a step keeps, and the standard
deviation of what it adds. Where all are zero a bead stands still."""


def own_steps(model: Model, values: Array, shortest: float, seed: int) -> mm.CustomIntegrator:
    """The integrator for `values` (N, 3), a row of `own`, `keep` and `noise` a bead, and its shortest time step, internal."""
    integrator = mm.CustomIntegrator(shortest)
    each = np.repeat(values.T[:, :, None], 3, axis=2)
    if model.planar:
        each[:, :, 2] = 0.0
    for name in _NAMES:
        integrator.addPerDofVariable(name, 0.0)
    set_values(integrator, each)
    integrator.addUpdateContextState()
    integrator.addComputePerDof("v", "v+own*dt*f/m")
    integrator.addComputePerDof("x", "x+0.5*own*dt*v")
    integrator.addComputePerDof("v", "keep*v+noise*gaussian")
    integrator.addComputePerDof("x", "x+0.5*own*dt*v")
    integrator.setRandomNumberSeed(seed % (2**31 - 1) + 1)
    return integrator


def values_of(integrator: mm.CustomIntegrator) -> Array:
    """`own`, `keep` and `noise` of each degree of freedom, (3, N, 3)."""
    columns = [[tuple(vector) for vector in integrator.getPerDofVariableByName(name)] for name in _NAMES]
    return np.array(columns, dtype=np.float64)


def set_values(integrator: mm.CustomIntegrator, values: Array) -> None:
    """Give each degree of freedom its `own`, `keep` and `noise`, (3, N, 3)."""
    for name, column in zip(_NAMES, values, strict=True):
        integrator.setPerDofVariableByName(name, [mm.Vec3(*row) for row in column.tolist()])


@contextmanager
def calmed(integrator: mm.CustomIntegrator) -> Iterator[None]:
    """While it lasts, friction is as strong as in `integrators.calm`, in units of each chain's own time step."""
    before = values_of(integrator)
    own, keep, noise = before
    strong = math.exp(-CALM[0])
    louder = np.sqrt((1 - strong**2) / np.where(keep < 1, 1 - keep**2, 1.0))
    set_values(integrator, np.stack([own, np.full_like(keep, strong), noise * louder]))
    yield
    set_values(integrator, before)


def stand_still(integrator: mm.CustomIntegrator, beads: NDArray[np.bool_]) -> None:
    """Let these beads (N,) neither move nor be pushed any more."""
    values = values_of(integrator)
    values[:, beads] = 0.0
    set_values(integrator, values)
