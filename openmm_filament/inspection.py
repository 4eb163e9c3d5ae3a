"""Checks before a run: what would go wrong in it, said while nothing is lost yet."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import bending, traps, units
from openmm_filament._term import Interaction
from openmm_filament.evaluation import internal_positions
from openmm_filament.filament import COLLINEAR
from openmm_filament.geometry import bending_angles, cross, dot, unit_vectors
from openmm_filament.integrators import is_made_for, temperature_of
from openmm_filament.model import Model
from openmm_filament.passage import reason_to_refuse
from openmm_filament.timestep import highest_frequency

__all__ = ["Preflight", "PreflightError", "PreflightWarning", "describe_bead", "preflight"]

Array = NDArray[np.float64]

_FORCE_TOLERANCE = 1e-3
"""Largest error of a term's forces relative to its largest force, or to a thousandth of the stiffness of that term."""

_ROUNDED = 64 * float(np.finfo(np.float64).eps)
"""Rounding of coordinates, relative to the largest, below which a force has no meaning: 64 of the last digit."""

_SINGLE = float(np.finfo(np.float32).eps) / 2
"""Rounding of coordinates in single precision."""

_AT_REST, _AT_REST_SINGLE = 1e-9, 1e-5
"""Error of a force, over that of a strain or an angle of one, that is warned of where there should be none at all."""

_ON_THE_CONE = 1e-7
"""Difference in rad from the rest angle below which a joint in line is taken to rest so."""

_NEARLY_COLLINEAR = 1e-3
"""sin(beta) below which the torsion force, growing as 1/sin(beta), is warned of."""

_MUCH_TOO_SHORT = 0.03
"""Time step over the limit below which a scaled model was probably given a physical time step."""

_DEEP = 0.1
"""Overlap over the diameter that is warned of: a filament lies in another, not on it."""

_TOO_HOT = 0.5
"""k_B T over the stretching energy k b^2 above which bonds, fluctuating by 70 % of their length, do not make a chain."""


class PreflightError(ValueError):
    """A run that would give wrong results or none."""


class PreflightWarning(UserWarning):
    """A run that may give less than it promises."""


@dataclass(frozen=True)
class Preflight:
    """What was measured. Times are physical.

    Attributes
    ----------
    timestep_limit : Quantity
        The stability limit at these positions.
    timestep : Quantity or None
        The Context's own time step.
    force_errors : dict of str to float
        Largest deviation from the NumPy forces by term, relative as for `force_tolerance`; empty without a Context.
    """

    timestep_limit: unit.Quantity
    timestep: unit.Quantity | None
    force_errors: dict[str, float]


def preflight(
    model: Model, context: mm.Context | None = None, *, force_tolerance: float = _FORCE_TOLERANCE
) -> Preflight:
    """Refuse or warn of a run that would go wrong, naming beads and values.

    With a Context its own positions, time step, temperature and forces are checked, the last against the NumPy
    reference at these positions; without one, the rest positions alone.

    Parameters
    ----------
    force_tolerance : float
        The largest accepted error of a term's forces, relative to the largest force of that term or to a thousandth
        of its stiffness (a bending angle of 1e-3 rad, a strain of 1e-3), whichever is larger.

    Raises
    ------
    PreflightError
        For non-finite or coincident beads, collinear beads under a torsion term, a time step above the stability
        limit, a temperature that tears the bonds, forces off by more than the tolerance, and filaments in contact that
        could pass through one another: beads too far apart, or a push, a motion, a temperature or a step too large for
        the barrier between them (`of.barrier`).

    Warns
    -----
    PreflightWarning
        For nearly collinear beads under torsion, beads that overlap by a tenth of their diameter, beads in line whose
        joint rests bent, a time step that looks physical on a scaled model, an integrator there that is not of this
        package, and smaller forces that carry an error above the tolerance, down to what the rounding of the coordinates
        makes.
    """
    x = internal_positions(model) if context is None else _context_positions(model, context)
    _check_positions(model, x)
    _check_contact(model, context, x)
    limit = 2.0 / highest_frequency(model, x)
    step = None
    errors: dict[str, float] = {}
    if context is not None:
        step = _check_integrator(model, context.getIntegrator(), limit)
        errors = _check_forces(model, context, x, force_tolerance)
    return Preflight(
        model.to_physical(limit, "time"), None if step is None else model.to_physical(step, "time"), errors
    )


def describe_bead(model: Model, *beads: int) -> str:
    """Beads of one filament in words: "bead 3", "beads 3, 4 and 5", with "of filament 1" where there are several."""
    filament = int(np.searchsorted(model.starts, beads[0], side="right")) - 1
    local = [str(bead - model.starts[filament]) for bead in beads]
    named = f"bead {local[0]}" if len(local) == 1 else f"beads {', '.join(local[:-1])} and {local[-1]}"
    return named if len(model.filaments) == 1 else f"{named} of filament {filament}"


def _context_positions(model: Model, context: mm.Context) -> Array:
    size = context.getSystem().getNumParticles()
    if size != model.starts[-1]:
        raise PreflightError(
            f"Argument `context` must be of the model's System with {model.starts[-1]} beads, but has {size}."
        )
    return units.numbers("positions", context.getState(positions=True).getPositions(asNumpy=True), "length")


def _check_positions(model: Model, x: Array) -> None:
    bad = ~np.isfinite(x).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad))
        raise PreflightError(f"Positions must be finite, but {describe_bead(model, first)} is at {x[first].tolist()}.")
    for interaction in model.interactions:
        if interaction.term.span == 1:
            continue
        pairs = interaction.beads[:, :2]
        lengths = np.linalg.norm(x[pairs[:, 1]] - x[pairs[:, 0]], axis=-1)
        if (lengths == 0).any():
            i, j = pairs[int(np.argmin(lengths))]
            raise PreflightError(f"Neighbours must not coincide, but {describe_bead(model, i, j)} do.")
        if interaction.term.needs_bends:
            _check_bends(model, interaction, x)
    for interaction in model.interactions:
        if "beta0" in interaction.parameters:
            _warn_of_cones(model, interaction, x)


def _check_contact(model: Model, context: mm.Context | None, x: Array) -> None:
    """Refuse chains that could pass through one another, and beads in one place; warn of deep overlaps."""
    if reason := reason_to_refuse(model, context, x):
        raise PreflightError(reason)
    for interaction in model.interactions:
        if interaction.term.family != "contact" or not len((here := interaction.at(x)).beads):
            continue
        distances = np.linalg.norm(x[here.beads[:, 1]] - x[here.beads[:, 0]], axis=-1)
        worst = int(np.argmin(distances / here.parameters["d"]))
        depth = 1 - float(distances[worst] / here.parameters["d"][worst])
        where = " and ".join(describe_bead(model, bead) for bead in here.beads[worst])
        if depth == 1:
            raise PreflightError(f"Beads in contact must not coincide, but {where} do.")
        if depth > _DEEP:
            warnings.warn(
                f"Beads in contact overlap by {depth:.2g} of their diameter, {where} the most: they will spring apart.",
                PreflightWarning,
                stacklevel=3,
            )


def _warn_of_cones(model: Model, interaction: Interaction, x: Array) -> None:
    """Joints exactly straight or folded back that rest at another angle: the force there has no direction."""
    angles, rest = bending_angles(x[interaction.beads]), interaction.parameters["beta0"]
    lost = np.isin(angles, (0.0, np.pi)) & (np.abs(angles - rest) > _ON_THE_CONE)
    if lost.any():
        first = int(np.argmax(lost))
        warnings.warn(
            f"Joints in line should rest so, but {describe_bead(model, *interaction.beads[first])} at {angles[first]:.3g} rad "
            f"rest at {rest[first]:.3g} rad: their force has no direction and is taken as zero, so that they may stay there. "
            "Move them off the line a little.",
            PreflightWarning,
            stacklevel=4,
        )


def _check_bends(model: Model, interaction: Interaction, x: Array) -> None:
    for first in (0, 1):
        beads = interaction.beads[:, first : first + 3]
        u, v = (unit_vectors(x[beads[:, k + 1]] - x[beads[:, k]]) for k in range(2))
        sine = np.sqrt(dot(cross(u, v), cross(u, v)))
        if not len(sine) or (smallest := float(sine.min())) >= _NEARLY_COLLINEAR:
            continue
        i, j, k = (int(b) for b in beads[int(np.argmin(sine))])
        where = f"{describe_bead(model, i, j, k)} (sin of the bending angle {smallest:.3g})"
        if smallest < COLLINEAR:
            raise PreflightError(
                f"Beads under torsion.{interaction.term.__name__} must not be collinear, but {where} are: use torsion.Weighted."
            )
        warnings.warn(
            f"Nearly collinear {where} under torsion.{interaction.term.__name__}: its force grows as one over that "
            "sine; torsion.Weighted stays smooth.",
            PreflightWarning,
            stacklevel=4,
        )


def _check_integrator(model: Model, integrator: Any, limit: float) -> float:
    step = integrator.getStepSize().value_in_unit(unit.picosecond)
    to_ps = model.scale.factor("time")
    if step > limit:
        hint = "" if model.scale.is_identity else _scaled_hint(model)
        raise PreflightError(
            f"The time step must be at most the stability limit of {limit * to_ps:.6g} ps, but is {step * to_ps:.6g} ps{hint}."
        )
    temperature = temperature_of(integrator)
    stretching = [i for i in model.interactions if i.term.family == "stretching" and len(i.beads)]
    if temperature is not None and stretching and not model.scale.is_identity:
        kt = units.BOLTZMANN * temperature
        stored = min(float((i.parameters["k"] * i.parameters["r0"] ** 2).min()) for i in stretching)
        if kt > _TOO_HOT * stored:
            raise PreflightError(
                f"k_B T must be small against the stretching energy k b^2, but is {kt / stored:.3g} times it"
                f"{_scaled_hint(model)}."
            )
    foreign = not is_made_for(integrator, model)
    if not model.scale.is_identity and step > 0 and (foreign or step < _MUCH_TOO_SHORT * limit):
        meant = (
            f": {step * to_ps:.6g} ps, by an integrator that is not openmm_filament's, which says nothing of its units. If "
            "it was made with model.to_internal all is well, and this warning may be filtered"
            if foreign
            else ""
        )
        warnings.warn(
            f"The time step is {step / limit:.2g} of the stability limit{meant}{_scaled_hint(model)}.",
            PreflightWarning,
            stacklevel=3,
        )
    return float(step)


def _scaled_hint(model: Model) -> str:
    return (
        f"; this model runs in scaled units (1 internal ps is {model.scale.factor('time'):.6g} ps): take the integrator "
        "from openmm_filament, or pass its time step, friction and temperature through model.to_internal"
    )


def _check_forces(model: Model, context: mm.Context, x: Array, tolerance: float) -> dict[str, float]:
    """The error of each term's forces; refused above the tolerance, warned of where the smaller forces alone are off."""
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
