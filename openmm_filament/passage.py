"""Whether filaments in contact could pass through one another: how much it would take, and how much a run has."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import contact, traps, units
from openmm_filament.evaluation import internal_positions
from openmm_filament.falling import energy_of_falling
from openmm_filament.geometry import chain_indices
from openmm_filament.integrators import temperature_of
from openmm_filament.model import Model

__all__ = ["Barrier", "barrier", "crossing_energy", "reason_to_refuse"]

Array = NDArray[np.float64]

_THERMAL = 25.0
"""Barrier over k_B T below which thermal motion may cross it: exp(-25) is 1e-11."""

_STRIDE = 0.2
"""Largest way of a bead in one step, over the diameter."""

_SCATTER = 5.0
"""Standard deviations of the thermal kinetic energy that are taken for thermal."""

_MANY = 1e6
"""Piconewtons, or kJ/mol, from which a force or an energy is told in newtons or joules."""

_REACH = 4
"""Beads on each side of a crossing that can touch, as the spacing is at least a third of the diameter where it counts."""


@dataclass(frozen=True)
class Barrier:
    """What it takes to push two filaments of a model through each other.

    Attributes
    ----------
    energy : Quantity
        The least energy of two crossed filaments in one place, the bonds giving way.
    force : Quantity
        That energy over the diameter: a steady push below it cannot do that work on the way.
    """

    energy: unit.Quantity
    force: unit.Quantity


def barrier(model: Model, positions: unit.Quantity | None = None) -> Barrier | None:
    """The barrier between the filaments of a model with `contact.Repulsion`, from its weakest numbers; None without contact
    or without bonds.

    The longest bond (of those at rest and at physical `positions`, (N, 3), by default the rest shapes), the smallest
    diameter and the softest springs of the filaments in contact are taken together, so that no pair of them has less.
    Levers and wedges can make more of a force than it is; an energy cannot be passed.
    """
    numbers = _weakest(model, check.finite("positions", internal_positions(model, positions)))
    if numbers is None:
        return None
    spacing, diameter, stiffness, stretching = numbers
    energy = crossing_energy(spacing, diameter, stiffness, stretching)
    return Barrier(model.to_physical(energy, "energy"), model.to_physical(energy / diameter, "force"))


def _weakest(model: Model, x: Array) -> tuple[float, float, float, float] | None:
    crowd = contact.crowd_of(model.interactions)
    if crowd is None:
        return None
    members = crowd.beads[:, 0]
    bonds = np.concatenate(
        [start + chain_indices(len(f), 2, f.closed) for start, f in zip(model.starts, model.filaments, strict=False)]
    )
    bonds = bonds[np.isin(bonds, members).all(axis=1)]
    if not len(bonds):  # lone beads, which nothing could be threaded through
        return None
    spacing = float(np.linalg.norm(x[bonds[:, 1]] - x[bonds[:, 0]], axis=-1).max())
    stretching, sprung = math.inf, []
    for interaction in model.interactions:
        if interaction.term.family == "stretching":
            inside = np.isin(interaction.beads, members).all(axis=1)
            sprung.append(interaction.beads[inside])
            stretching = float(interaction.parameters["k"][inside].min(initial=stretching))
            spacing = float(interaction.parameters["r0"][inside].max(initial=spacing))
    if not sprung or len(np.unique(np.concatenate(sprung), axis=0)) < len(bonds):
        stretching = 0.0  # a bond without a spring
    return spacing, float(crowd.parameters["d"].min()), float(crowd.parameters["k"].min()), stretching


@lru_cache(maxsize=256)
def crossing_energy(spacing: float, diameter: float, stiffness: float, stretching: float) -> float:
    """The least energy of two straight crossed bead chains whose axes meet, in one consistent set of units.

    The chains cross at a right angle, where they overlap least, at any place along their bonds, those at their ends too;
    the two bonds that cross may open, the parts of a chain moving away with them. Without bonds that resist there is no
    barrier.
    """
    if not stretching > 0:
        return 0.0
    from scipy.optimize import minimize

    whole, end = np.arange(-_REACH, _REACH + 2), np.arange(-_REACH, 2)  # bonds that cross lie between beads 0 and 1

    def energy(where: Array, chains: tuple[NDArray[np.int64], NDArray[np.int64]]) -> float:
        offsets, gaps = where[:2], where[2:]  # of the crossing from the bonds' middles, and openings, over the spacing
        u, v = (
            spacing * (number - 0.5 - offset + gap * (np.where(number > 0, 0.5, -0.5)))
            for number, offset, gap in zip(chains, offsets, gaps, strict=True)
        )
        depth = np.maximum(diameter - np.sqrt(u[:, None] ** 2 + v**2), 0)
        stored = stiffness / 2 * (depth**2).sum() + stretching / 2 * float((spacing * gaps) @ (spacing * gaps))
        return float(stored / (stiffness * diameter**2))

    bounds = [(-0.5, 0.5)] * 2 + [(0, 4 * diameter / spacing)] * 2
    starts = [(p, q, 0.1, 0.1) for p, q in ((0.01, 0.01), (0.25, 0.25), (0.01, 0.49), (0.49, 0.49))]
    least = min(
        float(minimize(energy, start, args=(chains,), method="L-BFGS-B", bounds=bounds).fun)
        for chains in ((whole, whole), (whole, end), (end, end))
        for start in starts
    )
    return stiffness * diameter**2 * least


def reason_to_refuse(model: Model, context: mm.Context | None, x: Array) -> str | None:
    """Why filaments could pass through one another at internal positions (N, 3), or None.

    Without a Context the spacing and the loads are judged, with one its temperature, motion and time step too. Judged is
    what acts now, and what steady forces give free filaments on their way to one another: not what bent filaments let go,
    nor traps that are moved later.
    """
    numbers = _weakest(model, x)
    if numbers is None:
        return None
    energy, diameter = crossing_energy(*numbers), numbers[1]
    if reason := _of_spacing(*numbers, energy):
        return reason
    falling = energy_of_falling(model, x, _friction(context))
    pushing = _together(model, x, _pushes(model, context, x)) * diameter
    if pushing > energy:
        return _too_much(model, "steady force on filaments", "force", pushing / diameter, energy / diameter)
    if pushing + falling > energy:
        what = "energy that steady forces give, on the way and at the crossing, to filaments"
        return _too_much(model, what, "energy", pushing + falling, energy)
    return None if context is None else _of_motion(model, context, x, energy - pushing - falling, diameter)


def _of_spacing(spacing: float, diameter: float, stiffness: float, stretching: float, energy: float) -> str | None:
    if spacing < math.sqrt(2) * diameter and energy > 0:
        return None
    why = f"are {spacing / diameter:.3g} apart" if stretching else "nothing resists stretching"
    return f"Beads in contact must stand within 1.41 diameters along a filament that is not to be passed, but {why}."


def _friction(context: mm.Context | None) -> float:
    """Of the thermostat, 1/ps; zero without one."""
    rate = None if context is None else getattr(context.getIntegrator(), "getFriction", None)
    return 0.0 if rate is None else float(rate().value_in_unit(unit.picosecond**-1))


def _of_motion(model: Model, context: mm.Context, x: Array, energy: float, diameter: float) -> str | None:
    integrator = context.getIntegrator()
    kt = units.BOLTZMANN * (temperature_of(integrator) or 0.0)
    if _THERMAL * kt > energy:
        return (
            f"The barrier between filaments in contact, less what loads do, must be at least {_THERMAL:g} k_B T, but is "
            f"{energy / kt:.3g} k_B T: use stiffer contact, a smaller spacing or a lower temperature."
        )
    velocities = context.getState(velocities=True).getVelocities(asNumpy=True)._value
    excess = _together(model, x, _excess_motion(model, velocities, kt))
    if excess > energy:
        return _too_much(model, "energy of motion of filaments", "energy", excess, energy)
    fastest = float(np.linalg.norm(velocities, axis=-1).max())
    stride = fastest * integrator.getStepSize().value_in_unit(unit.picosecond) / diameter
    if stride <= _STRIDE:
        return None
    return (
        f"Beads in contact must move less than {_STRIDE:g} of their diameter in a time step, but the fastest moves "
        f"{stride:.3g}."
    )


def _too_much(model: Model, what: str, dimension: str, found: float, allowed: float) -> str:
    in_words = [_in_words(value * model.scale.factor(dimension), dimension) for value in (allowed, found)]
    return (
        f"The {what} in contact must stay below what pushes them through one another, {in_words[0]}, but is {in_words[1]}: "
        "use stiffer contact or a smaller spacing."
    )


def _in_words(value: float, dimension: str) -> str:
    """A physical force (kJ/mol/nm) or energy (kJ/mol) in the unit of its size."""
    small, large = {
        "force": (unit.piconewton, unit.newton),
        "energy": (unit.kilojoule_per_mole, unit.joule),
    }[dimension]
    for chosen in (small, large):
        shown = value / units.number("unit", 1.0 * chosen, dimension)
        if shown < _MANY:
            break
    return f"{shown:.6g} {chosen.get_symbol()}"


def _together(model: Model, x: Array, each: list[float]) -> float:
    """The largest sum of what filaments have: of any two, or of all that lie on one another, a diameter apart at most."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    crowd = contact.crowd_of(model.interactions)
    assert crowd is not None
    members = crowd.beads[:, 0]
    near = cKDTree(x[members]).query_pairs(2 * float(crowd.parameters["d"].max()), output_type="ndarray")
    i, j = np.searchsorted(model.starts, members[near], side="right").T - 1
    _, heaps = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(len(each),) * 2), directed=False)
    return max(sum(sorted(each)[-2:]), float(np.bincount(heaps, weights=each).max()))


def _pushes(model: Model, context: mm.Context | None, x: Array) -> list[float]:
    """The sum of the sizes of the external forces on each filament."""
    size = np.linalg.norm(model.pulls, axis=-1) + np.linalg.norm(model.plucks, axis=-1)
    for interaction in model.interactions:
        if interaction.term is traps.Harmonic:
            here = interaction if context is None else traps.as_moved(interaction, model.trap_numbers, context)
            size += np.linalg.norm(here.forces(x), axis=-1)
    return [float(part.sum()) for part in model.split(size)]


def _excess_motion(model: Model, velocities: Any, kt: float) -> list[float]:
    """The kinetic energy of each filament beyond what a thermostat gives it."""
    energies = 0.5 * model.masses * (np.asarray(velocities) ** 2).sum(axis=-1)
    energies[model.held] = 0.0
    out = []
    for part in model.split(energies):
        freedoms = 3 * len(part)
        out.append(max(float(part.sum()) - kt * (freedoms / 2 + _SCATTER * math.sqrt(freedoms / 2)), 0.0))
    return out
