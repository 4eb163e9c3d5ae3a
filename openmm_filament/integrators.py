"""Integrators with the time step and friction chosen from the model."""

from __future__ import annotations

import math
import warnings
from functools import partial
from typing import Any

import numpy as np
import openmm as mm
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.evaluation import internal_positions
from openmm_filament.model import Model
from openmm_filament.starts import equilibrium_starts
from openmm_filament.timestep import highest_frequency, slow_frequency
from openmm_filament.trial import energy_gain

__all__ = [
    "CALM",
    "FRICTION",
    "LANGEVIN_STEP",
    "calm",
    "drawn_seed",
    "euler_cromer",
    "internal_langevin",
    "is_made_for",
    "langevin",
    "needs_calm",
    "temperature_of",
    "thermal_step",
    "verlet",
]

LANGEVIN_STEP = 0.35
"""Default time step of `langevin` over the limit.

LangevinMiddle samples harmonic motion without error up to the limit, but at the small friction that samples fastest it
lengthens a chain whose bonds and joints are coupled. Measured on DNA: 30 segments (alpha = 1.4 k_B T) at 0.05 pN, 3.3 %
too long at 0.8 of the limit and 1.5 % at 0.6 (standard errors 0.4 %); 124 segments (alpha = 6.4 k_B T) at 0.33 pN, 0.5 %
at 0.6 (0.14 %). As the third power of the step, about what these show, 0.35 leaves 0.3 and 0.1 %.
"""

_TORSION_STEP = 0.3
"""The same for chains with torsion, over the smallest limit among some shapes in equilibrium."""

_THERMAL_SHAPES = 8
"""Shapes in equilibrium among which the stiffest sets the time step of a chain with torsion: with 2 nm segments, a
bending stiffness of 80 k_B T and a torsion of 40, their limits were 0.70 to 0.87 of that of the rest shape, and runs at 0.45
of the latter heated up without bound."""

_RING_STEP = 0.5
"""Part of the limit of a ring's rest shape taken for that of its thermal shapes, which are not drawn."""

_GAIN = 0.1
"""Gain of energy in a trial, over the thermal kinetic energy, that is warned of. Measured on helices: at most 0.006 where
long runs keep their temperature, above 100 where they heat up without end; 9 on one with soft joints, 750 K hot, not 298."""

_TAG = "_openmm_filament_scale"
"""Attribute in which the integrators made here keep the units that they count in."""

_THERMAL_ENERGY = "kT"
"""Global variable in which a CustomIntegrator says k_B T."""

_MECHANICAL_STEP = 0.1
"""Default time step of `verlet` and `euler_cromer` over the limit; frequencies are then off by 1/600 at the stiffest mode
and by the square of the frequency below it."""

CALM = 0.3, 1000
"""Friction times the step, and steps, of `calm`: a velocity is forgotten in three steps, and stretched bonds in a few tens."""

FRICTION = 1.0
"""Default friction over the slow frequency: between 0.25 and 2 the steps for an independent sample change by less than
half, measured on DNA from 0.05 to 5 pN."""


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
        Physical; by default 0.35 of the stability limit (see `LANGEVIN_STEP`), with torsion 0.3 of the limit of the
        stiffest among some shapes in equilibrium. Judge sampling by configurations: kinetic temperatures are too low
        at long time steps.
    friction : Quantity, optional
        Physical rate; by default the frequency of the slowest mode, at which about the fewest steps give an
        independent sample.
    seed : int, optional
        Of the noise; by default OpenMM draws one.

    Warns
    -----
    UserWarning
        Where beads under a dihedral come into line so that the run would heat up, in a trial of about a second.
    """
    kelvin = check.positive("temperature", units.number("temperature", temperature, "temperature")).item()
    internal = kelvin / model.scale.factor("temperature")
    dt = thermal_step(model, kelvin, timestep)
    rate = (
        slow_frequency(model, internal) * FRICTION
        if friction is None
        else _internal(model, "friction", friction, "rate")
    )
    if seed is not None:
        check.integer("seed", seed, low=1, high=2**31 - 1)
    _try(model, internal, dt)
    return internal_langevin(model, internal, rate, dt, seed)


def internal_langevin(
    model: Model, temperature: float, friction: float, timestep: float, seed: int | None
) -> mm.Integrator:
    """The integrator of `langevin` for numbers in internal units, which are not checked again."""
    make = partial(_planar_langevin, model) if model.planar else mm.LangevinMiddleIntegrator
    integrator = make(temperature, friction, timestep)
    if seed is not None:
        integrator.setRandomNumberSeed(seed)
    return _tagged(integrator, model)


def drawn_seed(child: np.random.SeedSequence) -> int:
    """A seed that OpenMM takes for its noise, drawn from a child of a NumPy seed sequence."""
    return int(child.generate_state(1)[0]) % (2**31 - 1) + 1


def calm(integrator: Any, model: Model) -> None:
    """Take the energy out of a start before it can bring beads into line or throw them apart: steps of strong friction.

    Starts are not quite in equilibrium, those sheared to a clamp least of all, and may hold tens of times the thermal energy;
    they are drawn without contact, so that chains may lie in one another. Chains without dihedrals or contact, and planar
    ones without contact, are left alone.
    """
    if not needs_calm(model):
        return
    if model.planar:  # the CustomIntegrator of `_planar_langevin`
        mild = [integrator.getGlobalVariableByName(name) for name in ("keep", "noise")]
        strong = _kept_and_added(CALM[0], integrator.getGlobalVariableByName(_THERMAL_ENERGY))
        for values, steps in ((strong, CALM[1]), (mild, 0)):
            for name, value in zip(("keep", "noise"), values, strict=True):
                integrator.setGlobalVariableByName(name, value)
            integrator.step(steps)
        return
    friction = integrator.getFriction()
    integrator.setFriction(CALM[0] / integrator.getStepSize())
    integrator.step(CALM[1])
    integrator.setFriction(friction)


def needs_calm(model: Model) -> bool:
    """Whether starts of a model may bring beads under a dihedral into line, or lay chains that repel into one another."""
    return "contact" in model.groups or _has_dihedrals(model)


def _has_dihedrals(model: Model) -> bool:
    return not model.planar and any(i.term.needs_bends and len(i.beads) for i in model.interactions)


def is_made_for(integrator: Any, model: Model) -> bool:
    """Whether an integrator comes from this module and counts in the units of this model."""
    return bool(getattr(integrator, _TAG, None) == model.scale)


def _tagged(integrator: Any, model: Model) -> mm.Integrator:
    setattr(integrator, _TAG, model.scale)  # kept: `Context.getIntegrator` returns this very object
    return integrator


def temperature_of(integrator: Any) -> float | None:
    """The internal temperature (K) of an integrator's thermostat, or None where it has none.

    That of `getTemperature`, or of a CustomIntegrator's global variable kT (kJ/mol), as planar models have it.
    """
    if (temperature := getattr(integrator, "getTemperature", None)) is not None:
        return float(temperature().value_in_unit(unit.kelvin))
    if isinstance(integrator, mm.CustomIntegrator):
        names = [integrator.getGlobalVariableName(i) for i in range(integrator.getNumGlobalVariables())]
        if _THERMAL_ENERGY in names:
            return float(integrator.getGlobalVariableByName(_THERMAL_ENERGY)) / units.BOLTZMANN
    return None


def verlet(model: Model, *, timestep: unit.Quantity | None = None) -> mm.Integrator:
    """A leapfrog Verlet integrator (Euler-Cromer without damping); by default at a tenth of the stability limit.

    Warns (UserWarning) where the filaments have a damping, which it leaves out.
    """
    if model.damping.any():
        warnings.warn("Verlet leaves out the filaments' damping: `euler_cromer` takes it.", UserWarning, stacklevel=2)
    dt = _step(model, timestep, _MECHANICAL_STEP)
    if not model.planar:
        return _tagged(mm.VerletIntegrator(dt), model)
    integrator = mm.CustomIntegrator(dt)
    integrator.addUpdateContextState()
    _add_mask(integrator, model)
    integrator.addComputePerDof("v", "v+dt*mask*f/m")
    integrator.addComputePerDof("x", "x+dt*mask*v")
    return _tagged(integrator, model)


def euler_cromer(model: Model, *, timestep: unit.Quantity | None = None) -> mm.Integrator:
    """The thesis's integrator: `v += (F/m - gamma v) dt`, then `x += v dt`, with the filaments' damping rate a bead.

    By default at a tenth of the stability limit; filaments without damping have gamma = 0.

    Raises
    ------
    ValueError
        If a damping rate is so large that `(omega dt)^2 + 2 gamma dt >= 4`, where the step is unstable.
    """
    dt = _step(model, timestep, _MECHANICAL_STEP)
    gamma = model.damping
    worst = int(np.argmax(gamma))
    swing = highest_frequency(model, internal_positions(model)) * dt
    if gamma[worst] and swing**2 + 2 * gamma[worst] * dt >= 4:
        raise ValueError(
            f"Argument `damping` must keep 2 gamma dt below 4 - (omega dt)^2 = {4 - swing**2:.3g} for Euler-Cromer, but "
            f"bead {worst} has 2 gamma dt = {2 * gamma[worst] * dt:.3g}: take a shorter time step."
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
    return _tagged(integrator, model)


def thermal_step(
    model: Model, kelvin: float, timestep: unit.Quantity | None = None, part: float = LANGEVIN_STEP
) -> float:
    """The time step of `langevin` in internal units: as given, checked, or `part` of the limit of stability.

    With torsion it is a fixed part of the limit found among shapes at so many physical kelvin.
    """
    if timestep is not None:
        return _step(model, timestep, 1.0)
    limit = 2.0 / highest_frequency(model, internal_positions(model))
    if any(interaction.term.needs_bends for interaction in model.interactions):
        return _TORSION_STEP * min(limit, _thermal_limit(model, kelvin))
    return part * limit


def _try(model: Model, temperature: float, dt: float) -> None:
    """Warn where a trial of a model with dihedrals heats up at this internal temperature and time step."""
    if not _has_dihedrals(model):
        return
    gain = energy_gain(model, temperature, dt)
    if gain > _GAIN:
        warnings.warn(
            f"In a trial at this time step the energy rose to {gain:.3g} times the thermal kinetic energy before a "
            "thermostat could take it away: beads under a dihedral come into line, where its force grows as one over the "
            "sine of the bending angle, and no time step is short enough for good. Take torsion.Weighted, which is "
            "smooth there, or stiffer or more bent joints.",
            UserWarning,
            stacklevel=3,
        )


def _thermal_limit(model: Model, kelvin: float) -> float:
    """The smallest stability limit, internal, among some shapes in equilibrium: torsion is stiffer where beads line up."""
    if any(filament.closed for filament in model.filaments):
        return _RING_STEP * 2.0 / highest_frequency(model, internal_positions(model))
    rng = np.random.default_rng(0)
    limits = []
    for _ in range(_THERMAL_SHAPES):
        shapes = []
        for filament, load in zip(model.filaments, model.loads, strict=True):
            pull = float(np.linalg.norm(sum(load.pulls.values(), np.zeros(3))))
            shapes.append(equilibrium_starts(filament, pull, kelvin, 1, rng)[0])
        limits.append(2.0 / highest_frequency(model, np.concatenate(shapes) / model.scale.length, apart=True))
    return min(limits)


def _internal(model: Model, name: str, value: unit.Quantity, dimension: str) -> float:
    physical = check.positive(name, units.number(name, value, dimension))
    return float(physical) / model.scale.factor(dimension)


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


def _kept_and_added(friction: float, kt: float) -> tuple[float, float]:
    """The part of a velocity that a step of this friction (per step) keeps, and the noise at kt for a mass of one."""
    return math.exp(-friction), math.sqrt(-math.expm1(-2 * friction) * kt)


def _planar_langevin(model: Model, temperature: float, friction: float, dt: float) -> mm.CustomIntegrator:
    """LangevinMiddle's splitting (Zhang et al., J. Phys. Chem. A 2019) in the first two coordinates."""
    integrator = mm.CustomIntegrator(dt)
    keep, noise = _kept_and_added(friction * dt, units.BOLTZMANN * temperature)
    integrator.addGlobalVariable("keep", keep)
    integrator.addGlobalVariable("noise", noise)
    integrator.addGlobalVariable(_THERMAL_ENERGY, units.BOLTZMANN * temperature)  # only read: by `temperature_of`
    _add_mask(integrator, model)
    integrator.addUpdateContextState()
    integrator.addComputePerDof("v", "mask*(v+dt*f/m)")
    integrator.addComputePerDof("x", "x+0.5*dt*v")
    integrator.addComputePerDof("v", "mask*(keep*v+noise*sqrt(1/m)*gaussian)")
    integrator.addComputePerDof("x", "x+0.5*dt*v")
    return integrator
