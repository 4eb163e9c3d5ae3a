"""Checks before a run: what would go wrong in it, said while nothing is lost yet."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

from openmm_filament import units
from openmm_filament._term import Interaction
from openmm_filament.contact import crowd_of
from openmm_filament.evaluation import internal_positions
from openmm_filament.filament import COLLINEAR
from openmm_filament.force_agreement import check_forces
from openmm_filament.geometry import bending_angles, cross, dot, unit_vectors
from openmm_filament.integrators import is_made_for, temperature_of
from openmm_filament.model import Model
from openmm_filament.passage import reason_to_refuse
from openmm_filament.refusals import PreflightError, PreflightWarning, describe_bead
from openmm_filament.timestep import highest_frequency

__all__ = ["Preflight", "PreflightError", "PreflightWarning", "describe_bead", "preflight"]

Array = NDArray[np.float64]

_FORCE_TOLERANCE = 1e-3
"""Largest error of a term's forces relative to its largest force, or to a thousandth of the stiffness of that term."""

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
        errors = check_forces(model, context, x, force_tolerance)
    return Preflight(
        model.to_physical(limit, "time"), None if step is None else model.to_physical(step, "time"), errors
    )


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
    crowd = crowd_of(model.interactions)
    if crowd is None:
        return
    _warn_of_phantoms(model, crowd.beads[:, 0])
    if not len((here := crowd.at(x)).beads):
        return
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


def _warn_of_phantoms(model: Model, members: NDArray[np.int64]) -> None:
    """Warn of filaments without contact beside some with it: the others pass through them."""
    ends = zip(model.starts[:-1], model.starts[1:], strict=True)
    without = [i for i, (start, end) in enumerate(ends) if not ((members >= start) & (members < end)).any()]
    if without:
        warnings.warn(
            f"Filaments in contact pass through those without contact.Repulsion, of which there are {len(without)}, the "
            f"first being filament {without[0]}.",
            PreflightWarning,
            stacklevel=4,
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
