"""The integrators that are compared, by name, and Contexts for them without checks that would refuse what is to be shown."""

from __future__ import annotations

import math
import warnings

import openmm as mm
from openmm import unit

import openmm_filament as of
from systems import stage
from systems.fourth_order import fourth_order

__all__ = ["INTEGRATORS", "available", "made", "noisy_euler_cromer", "opened"]

INTEGRATORS = ("Verlet", "Euler-Cromer", "LangevinMiddle", "PEFRL")
"""Euler-Cromer is the thesis's; LangevinMiddle runs at 0 K; PEFRL is of fourth order, with four forces a step."""


def made(name: str, model: of.Model, timestep: float, damping: float) -> mm.Integrator:
    """An integrator with a time step in s; `damping` in 1/s is that of every bead.

    Verlet and PEFRL know no damping. Raises ValueError for a step above the stability limit of leapfrog.
    """
    quantity = timestep * unit.second
    if name in {"Verlet", "PEFRL"}:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # damped scenes are run without damping too
            leapfrog = of.verlet(model, timestep=quantity)
        return leapfrog if name == "Verlet" else fourth_order(leapfrog.getStepSize())
    if name == "Euler-Cromer":
        return of.euler_cromer(model, timestep=quantity)
    if name == "LangevinMiddle":
        return stage.alike(model, timestep, damping)
    raise ValueError(f"Argument `name` must be one of {INTEGRATORS}, but is {name}.")


def noisy_euler_cromer(heat: float, rate: float, step: float, seed: int) -> mm.Integrator:
    """The thesis's integrator with the noise of a thermostat in its kick, for numbers in internal units.

    It widens a stiff well, by `1/(1 - r^2)` at r of the limit of stability.
    """
    integrator = mm.CustomIntegrator(step)
    integrator.addGlobalVariable("noise", math.sqrt(2 * rate * step * of.units.BOLTZMANN * heat))
    integrator.addUpdateContextState()
    integrator.addComputePerDof("v", f"v+dt*(f/m-{rate!r}*v)+noise*gaussian/sqrt(m)")
    integrator.addComputePerDof("x", "x+dt*v")
    integrator.setRandomNumberSeed(seed)
    return integrator


def opened(model: of.Model, integrator: mm.Integrator, platform: str, precision: str) -> mm.Context:
    """A Context at the rest positions."""
    properties = {"Precision": precision} if platform in {"OpenCL", "CUDA", "HIP"} else {}
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName(platform), properties)
    context.setPositions(model.positions)
    return context


def available() -> list[str]:
    """Names of the platforms of this machine."""
    return [mm.Platform.getPlatform(i).getName() for i in range(mm.Platform.getNumPlatforms())]
