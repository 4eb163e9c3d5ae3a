"""The integrators that are compared, by name, and Contexts for them without checks that would refuse what is to be shown."""

from __future__ import annotations

import warnings

import openmm as mm
from openmm import unit

import openmm_filament as of
from systems import stage

__all__ = ["INTEGRATORS", "available", "made", "opened"]

INTEGRATORS = ("Verlet", "Euler-Cromer", "LangevinMiddle", "PEFRL")
"""Euler-Cromer is the thesis's; LangevinMiddle runs at 0 K; PEFRL is of fourth order, with four forces a step."""

_XI, _LAMBDA, _CHI = 0.1786178958448091, -0.2123418310626054, -0.06626458266981849
"""Coefficients of Omelyan, Mryglod and Folk, Comput. Phys. Commun. 146, 188 (2002)."""


def made(name: str, model: of.Model, timestep: float, damping: float) -> mm.Integrator:
    """An integrator with a time step in s; `damping` in 1/s is that of every bead.

    Verlet and PEFRL know no damping. Raises ValueError for a step above the stability limit of leapfrog.
    """
    quantity = timestep * unit.second
    if name == "Verlet":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # damped scenes are run without damping too
            return of.verlet(model, timestep=quantity)
    if name == "Euler-Cromer":
        return of.euler_cromer(model, timestep=quantity)
    if name == "LangevinMiddle":
        return stage.alike(model, timestep, damping)
    if name == "PEFRL":
        return _fourth_order(of.verlet(model, timestep=quantity).getStepSize())
    raise ValueError(f"Argument `name` must be one of {INTEGRATORS}, but is {name}.")


def _fourth_order(step: unit.Quantity) -> mm.CustomIntegrator:
    integrator = mm.CustomIntegrator(step)
    integrator.addUpdateContextState()
    drifts = (_XI, _CHI, 1 - 2 * (_CHI + _XI), _CHI, _XI)
    kicks = (0.5 - _LAMBDA, _LAMBDA, _LAMBDA, 0.5 - _LAMBDA)
    for i, drift in enumerate(drifts):
        integrator.addComputePerDof("x", f"x+{drift!r}*dt*v")
        if i < len(kicks):
            integrator.addComputePerDof("v", f"v+{kicks[i]!r}*dt*f/m")
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
