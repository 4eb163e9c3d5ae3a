"""The energy of both plucks without damping: at a tenth of the stability limit it stays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from openmm import unit

import openmm_filament as of
from openmm_filament.geometry import bending_angles, chain_indices
from systems import conservation, stage, strings
from systems.conservation import Drift
from systems.guitar_string import hard, soft
from systems.scene import Check
from systems.strings import Pluck

__all__ = ["Steadiness", "checks", "findings", "plucked", "steadiness"]

Form = Literal["arccosine", "arctangent"]

_EVERY = 25
"""Steps between two energies. Higher modes than the fifteenth or so swing faster than this shows, by a part in 10^8."""


@dataclass(frozen=True)
class Steadiness:
    """Energy of strings of so many segments after the small pluck, in both forms of bending, and after the hard one; the string by
    arctangent.
    """

    segments: int
    small: Drift
    default: Drift
    hard: Drift
    bend: float
    model: of.Model


def plucked(
    plucks: Sequence[Pluck],
    segments: int,
    length: int,
    *,
    form: Form = "arccosine",
    softer: float = strings.SOFTER,
    heavy: dict[int, float] | None = None,
    fraction: float = 0.1,
) -> tuple[Drift, float, of.Model]:
    """The energy of an undamped string's motion over `length` steps after plucks, its largest bend in rad at the end, and it.

    The energy is above that of the string at rest under tension, `heavy` beads are those of `strings.string`, and
    `fraction` is the time step over the stability limit.
    """
    model = strings.string(segments, plucks, damping=None, softer=softer, form=form, heavy=heavy)
    timestep = fraction * of.stable_timestep(model)
    context = stage.context(model, of.verlet(model, timestep=timestep), "Reference")
    context.setParameter("pluck", 0.0)
    resting = context.getState(energy=True).getPotentialEnergy()
    context.setParameter("pluck", 1.0)
    context.getIntegrator().step(round(strings.PLUCKING / timestep.value_in_unit(unit.second)))
    context.setParameter("pluck", 0.0)
    kept = conservation.drift(context, length, resting=resting, every=_EVERY)
    x = np.asarray(context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer))
    return kept, float(bending_angles(x[chain_indices(len(x), 3)]).max()), model


def steadiness(segments: int, length: int) -> Steadiness:
    """All of it; the plucked bead lies at the same part of the length as that of the string of 201 segments."""
    bead = round(soft.BEADS[0] * segments / soft.SEGMENTS)
    gentle, violent = [Pluck(bead, soft.FORCES[0])], [Pluck(bead, hard.FORCE)]
    small, bend, model = plucked(gentle, segments, length, form="arctangent")
    default, *_ = plucked(gentle, segments, length)
    loud, *_ = plucked(violent, segments, length, softer=1.0)
    return Steadiness(segments, small, default, loud, bend, model)


def checks(found: Steadiness) -> list[Check]:
    """That the energy of the small motion stays."""
    return [conservation.check_drift(found.small, f"{found.segments} segments, 0.01 N, bending by arctangent: ")]


def findings(found: Steadiness) -> list[str]:
    """The slopes."""
    return [
        f"Undamped, at a tenth of the stability limit, a string of {found.segments} segments plucked with 0.01 N (bends up to "
        f"{found.bend:.1e} rad) changes the energy of its motion by {found.small} of it in 10^6 steps with bending by "
        f"arctangent and by {found.default} with the default form, whose force is not quite the gradient of its energy "
        f"({found.small.length} steps).",
        f"Plucked with 12 N it changes by {found.hard} of it in 10^6 steps (default form, true bonds, {found.hard.length} "
        f"steps); within a period it swings by {found.hard.spread:.1e} of it.",
    ]
