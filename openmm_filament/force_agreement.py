"""The forces of a Context against the NumPy reference at its own positions: refused, warned of, or told as a number."""

from __future__ import annotations

import math
import warnings

import numpy as np
import openmm as mm
from numpy.typing import NDArray

from openmm_filament import bending, traps, units
from openmm_filament._term import Interaction
from openmm_filament.geometry import bending_angles
from openmm_filament.integrators import temperature_of
from openmm_filament.model import Model
from openmm_filament.refusals import PreflightError, PreflightWarning, describe_bead

__all__ = ["check_forces"]

Array = NDArray[np.float64]

_ROUNDED = 64 * float(np.finfo(np.float64).eps)
"""Rounding of coordinates, relative to the largest, below which a force has no meaning: 64 of the last digit."""

_SINGLE = float(np.finfo(np.float32).eps) / 2
"""Rounding of coordinates in single precision."""

_AT_REST, _AT_REST_SINGLE = 1e-9, 1e-5
"""Error of a force, over that of a strain or an angle of one, that is warned of where there should be none at all."""


def check_forces(model: Model, context: mm.Context, x: Array, tolerance: float) -> dict[str, float]:
    """The error of each term's forces; refused above the tolerance, warned of where the smaller forces alone are off.

    Parameters
    ----------
    x : (N, 3) array
        The Context's own positions in internal units.
    tolerance : float
        As `force_tolerance` of `of.preflight`.

    Returns
    -------
    dict of str to float
        By term: the largest deviation, relative to the term's largest force or to a thousandth of its stiffness.
    """
    errors: dict[str, float] = {}
    families = dict.fromkeys(interaction.term.family for interaction in model.interactions)
    for family in families:
        members = [i for i in model.interactions if i.term.family == family and len(i.beads)]
        if not members:
            continue
        members = [_as_moved(model, interaction, context) for interaction in members]
        exact = np.sum([interaction.forces(x) for interaction in members], axis=0)
        state = context.getState(forces=True, groups=1 << model.groups[family])
        found = units.numbers("forces", state.getForces(asNumpy=True), "force")
        deviation = float(np.abs(found - exact).max())
        largest = float(np.abs(exact).max())
        natural = max(_natural_force(interaction, x) for interaction in members)
        error = deviation / max(largest, 1e-3 * natural)
        errors[family] = error
        if not error <= tolerance:
            worst = int(np.argmax(np.abs(found - exact).max(axis=1)))
            raise PreflightError(
                f"Forces of {family} must agree with the NumPy reference to {tolerance:g}, but differ by {error:.3g} at "
                f"{describe_bead(model, worst)} on {_platform(context)}{_angles(members, x)}."
            )
        if (precision := _precision(context, family)) == "single":  # the positions in the Context are rounded already
            deviation += max(_rounded_force(interaction, x, _SINGLE) for interaction in members)
        floor = max(_rounded_force(interaction, x) for interaction in members)
        at_rest = (_AT_REST if precision == "double" else _AT_REST_SINGLE) * natural
        if not deviation <= (tolerance * largest if largest > floor else at_rest):
            of_what = f"{deviation / largest:.2g}" if largest > floor else f"{deviation / natural:.2g} of the stiffness"
            warnings.warn(
                f"Forces of {family} at these positions carry an error of {of_what} on "
                f"{_platform(context)}{_angles(members, x)}: motion so small needs larger strains and angles, double precision"
                f"{_finer_form(members)}.",
                PreflightWarning,
                stacklevel=3,
            )
        _warn_of_precision(model, context, family, members, x)
    return errors


def _warn_of_precision(model: Model, context: mm.Context, family: str, members: list[Interaction], x: Array) -> None:
    """Single and mixed precision lose bending angles below 3e-4 rad; rest at zero angle hides it from the forces."""
    if family != "bending" or _precision(context) == "double":
        return
    smallest = min(float(bending_angles(x[interaction.beads]).min()) for interaction in members)
    kt = units.BOLTZMANN * (temperature_of(context.getIntegrator()) or 0.0)
    thermal = min(math.sqrt(kt / float(interaction.parameters["alpha"].max())) for interaction in members)
    if max(smallest, thermal) < 3e-3:
        warnings.warn(
            f"Bending angles down to {smallest:.2g} rad in {_precision(context)} precision: below 3e-4 rad the bending "
            "force is lost there. Use double precision (platform_properties gives it).",
            PreflightWarning,
            stacklevel=4,
        )


def _precision(context: mm.Context, family: str = "") -> str:
    platform = context.getPlatform()
    if family == "contact" and platform.getName() == "CPU":
        return "single"  # of its nonbonded forces; those along the chain are computed in double precision
    if "Precision" in platform.getPropertyNames():
        return str(platform.getPropertyValue(context, "Precision"))
    return "double"


def _platform(context: mm.Context) -> str:
    return f"{context.getPlatform().getName()} in {_precision(context)} precision"


def _angles(members: list[Interaction], x: Array) -> str:
    triples = [interaction.beads for interaction in members if interaction.term.span == 3]
    if not triples:
        return ""
    angles = bending_angles(x[np.concatenate(triples)])
    return f" with bending angles from {angles.min():.3g} to {angles.max():.3g} rad"


def _as_moved(model: Model, interaction: Interaction, context: mm.Context) -> Interaction:
    """Traps where a Context has them; any other interaction as it is."""
    if interaction.term is not traps.Harmonic:
        return interaction
    return traps.as_moved(interaction, model.trap_numbers, context)


def _finer_form(members: list[Interaction]) -> str:
    arccosine = any(interaction.term is bending.Harmonic for interaction in members)
    return ', or bending.Harmonic(..., form="arctangent")' if arccosine else ""


def _rounded_force(interaction: Interaction, x: Array, rounding: float = _ROUNDED) -> float:
    """What the rounding of the coordinates alone, relative to the largest of them, may make of a force."""
    return _natural_force(interaction, x) * rounding * float(np.abs(x).max()) / _shortest(interaction, x)


def _shortest(interaction: Interaction, x: Array) -> float:
    """The shortest segment under a term; the diameter in contact; for traps 1, the length that they are judged by."""
    if interaction.term.family == "contact":
        return float(interaction.parameters["d"].min())
    if interaction.term.span == 1:
        return 1.0
    pairs = interaction.beads[:, :2]
    return float(np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=-1).min())


def _natural_force(interaction: Interaction, x: Array) -> float:
    """The force that a change of order one (a strain, a radian) would make; of a trap, a displacement by 1."""
    if interaction.term.family == "contact":
        return float((interaction.parameters["k"] * interaction.parameters["d"]).max())
    length = _shortest(interaction, x)
    return interaction.stored_energy(length) / length
