"""Integrators with the time step and friction chosen from the model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import openmm as mm
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.evaluation import internal_positions
from openmm_filament.model import Model
from openmm_filament.timestep import highest_frequency, slow_frequency

__all__ = ["euler_cromer", "langevin", "verlet"]

_LANGEVIN_STEP = 0.8
"""Default time step of `langevin` over the limit: LangevinMiddle samples harmonic configurations without bias up to it."""

_MECHANICAL_STEP = 0.1
"""Default time step of `verlet` and `euler_cromer` over the limit; frequencies are then off by 1/600 at the stiffest mode
and by the square of the frequency below it."""

_FRICTION = 1.0
"""Default friction over the slow frequency: within 1.5 of the best found between 0.05 and 50 pN on DNA."""


def langevin(
    model: Model,
    temperature: unit.Quantity,
    *,
    timestep: unit.Quantity | None = None,
    friction: unit.Quantity | None = None,
    seed: int | None = None,
) -> mm.Integrator:
    """A LangevinMiddle integrator; on a planar model, the same scheme with the third coordinate left out.

    Parameters
    ----------
    temperature : Quantity
        Physical, positive.
    timestep : Quantity, optional
        Physical; by default 0.8 of the stability limit, at which configurations are still sampled without bias that
        shows. Kinetic temperatures are not: judge sampling by configurations.
    friction : Quantity, optional
        Physical rate; by default the frequency of the slowest mode, which it damps about critically, so that the
        fewest steps give an independent sample.
    seed : int, optional
        Of the noise; by default OpenMM draws one.
    """
    kelvin = check.positive("temperature", units.number("temperature", temperature, "temperature")).item()
    internal = kelvin / model.scale.factor("temperature")
    dt = _step(model, timestep, _LANGEVIN_STEP)
    rate = slow_frequency(model, internal) * _FRICTION if friction is None else _internal(model, "friction", friction, "rate")
    if model.planar:
        integrator = _planar_langevin(model, internal, rate, dt)
    else:
        integrator = mm.LangevinMiddleIntegrator(internal, rate, dt)
    if seed is not None:
        integrator.setRandomNumberSeed(check.integer("seed", seed, low=1, high=2**31 - 1))
    return integrator


def verlet(model: Model, *, timestep: unit.Quantity | None = None) -> mm.Integrator:
    """A leapfrog Verlet integrator (Euler-Cromer without damping); by default at a tenth of the stability limit."""
    dt = _step(model, timestep, _MECHANICAL_STEP)
    if not model.planar:
        return mm.VerletIntegrator(dt)
    integrator = mm.CustomIntegrator(dt)
    integrator.addUpdateContextState()
    _add_mask(integrator, model)
    integrator.addComputePerDof("v", "v+dt*mask*f/m")
    integrator.addComputePerDof("x", "x+dt*mask*v")
    return integrator


def euler_cromer(model: Model, *, timestep: unit.Quantity | None = None) -> mm.Integrator:
    """The thesis's integrator: `v += (F/m - gamma v) dt`, then `x += v dt`, with the filaments' damping rate a bead.

    By default at a tenth of the stability limit; filaments without damping have gamma = 0.

    Raises
    ------
    ValueError
        If a damping rate is so large that gamma dt >= 2, where the step is unstable.
    """
    dt = _step(model, timestep, _MECHANICAL_STEP)
    rates = [
        np.zeros(len(filament)) if filament.damping is None else units.numbers("damping", filament.damping, "rate")
        for filament in model.filaments
    ]
    gamma = np.concatenate(rates) / model.scale.factor("rate")
    if (gamma * dt >= 2).any():
        worst = int(np.argmax(gamma))
        raise ValueError(
            f"Argument `damping` must stay below 2/dt for Euler-Cromer, but bead {worst} has damping x time step = "
            f"{gamma[worst] * dt:.3g}."
        )
    integrator = mm.CustomIntegrator(dt)
    integrator.addUpdateContextState()
    damped = bool(gamma.any())
    if damped:
        integrator.addPerDofVariable("gamma", 0.0)
        integrator.setPerDofVariableByName("gamma", np.repeat(gamma[:, None], 3, axis=1).tolist())
    mask = ""
    if model.planar:
        _add_mask(integrator, model)
        mask = "*mask"
    integrator.addComputePerDof("v", f"v+dt*({'f/m-gamma*v' if damped else 'f/m'}){mask}")
    integrator.addComputePerDof("x", f"x+dt*v{mask}")
    return integrator


def _internal(model: Model, name: str, value: unit.Quantity, dimension: str) -> float:
    return check.positive(name, units.number(name, value, dimension)).item() / model.scale.factor(dimension)


def _step(model: Model, timestep: unit.Quantity | None, fraction: float) -> float:
    """The time step in internal units: as given, refused above the limit, or this fraction of the limit."""
    limit = 2.0 / highest_frequency(model, internal_positions(model))
    if timestep is None:
        return fraction * limit
    dt = _internal(model, "timestep", timestep, "time")
    if dt > limit:
        physical = model.scale.factor("time")
        raise ValueError(
            f"Argument `timestep` must be at most the stability limit of {limit * physical:.6g} ps, "
            f"but is {dt * physical:.6g} ps."
        )
    return dt


def _add_mask(integrator: Any, model: Model) -> None:
    integrator.addPerDofVariable("mask", 1.0)
    integrator.setPerDofVariableByName("mask", [(1.0, 1.0, 0.0)] * int(model.starts[-1]))


def _planar_langevin(model: Model, temperature: float, friction: float, dt: float) -> mm.CustomIntegrator:
    """LangevinMiddle's splitting (Zhang et al., J. Phys. Chem. A 2019) in the first two coordinates."""
    integrator = mm.CustomIntegrator(dt)
    integrator.addGlobalVariable("keep", math.exp(-friction * dt))
    integrator.addGlobalVariable("noise", math.sqrt(-math.expm1(-2 * friction * dt) * units.BOLTZMANN * temperature))
    _add_mask(integrator, model)
    integrator.addUpdateContextState()
    integrator.addComputePerDof("v", "mask*(v+dt*f/m)")
    integrator.addComputePerDof("x", "x+0.5*dt*v")
    integrator.addComputePerDof("v", "mask*(keep*v+noise*sqrt(1/m)*gaussian)")
    integrator.addComputePerDof("x", "x+0.5*dt*v")
    return integrator
