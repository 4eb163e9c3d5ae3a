"""How well the bar as played keeps its energy, without damping and at small amplitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from openmm import unit

import openmm_filament as of
from openmm_filament.geometry import bending_angles, chain_indices
from systems import conservation, stage
from systems.conservation import Drift
from systems.scene import Check
from systems.xylophone_bar import bar

__all__ = ["Steadiness", "check", "findings", "kept", "steadiness"]

_EVERY = 20
"""Steps between two energies."""

RISES = (0.03, 3.0)
"""How hard the bar is struck (`bar.strike`): gently, and a hundred times harder."""


@dataclass(frozen=True)
class Steadiness:
    """Energy of a free bar after a gentle blow in both forms of bending, and after a hard one; bends at the end in rad; the bar
    by arctangent.
    """

    segments: int
    gentle: Drift
    default: Drift
    hard: Drift
    bend: float
    hard_bend: float
    model: of.Model


def kept(
    segments: int, length: int, rise: float, form: Literal["arccosine", "arctangent"], *, fraction: float = 0.1
) -> tuple[Drift, float, of.Model]:
    """The energy of an undamped free bar over `length` steps after a blow, its largest bend in rad at the end, and the bar.

    `fraction` is the time step over the stability limit.
    """
    model = bar.free(segments, form=form)
    context = stage.context(model, of.verlet(model, timestep=fraction * of.stable_timestep(model)), "Reference")
    resting = context.getState(energy=True).getPotentialEnergy()
    bar.set_velocities(context, model, bar.strike(model, 0.24, rise=rise, width=0.2))
    found = conservation.drift(context, length, resting=resting, every=_EVERY)
    x = np.asarray(context.getState(positions=True).getPositions(asNumpy=True).value_in_unit(unit.nanometer))
    return found, float(bending_angles(x[chain_indices(len(x), 3)]).max()), model


def steadiness(segments: int, length: int) -> Steadiness:
    """All of it."""
    gentle, bend, model = kept(segments, length, RISES[0], "arctangent")
    default, *_ = kept(segments, length, RISES[0], "arccosine")
    hard, hard_bend, _ = kept(segments, length, RISES[1], "arctangent")
    return Steadiness(segments, gentle, default, hard, bend, hard_bend, model)


def check(found: Steadiness) -> Check:
    """That the energy of the small motion stays."""
    return conservation.check_drift(found.gentle, f"free bar of {found.segments} segments, bending by arctangent: ")


def findings(found: Steadiness) -> list[str]:
    """The slopes."""
    return [
        f"Undamped, at a tenth of the stability limit, a free bar of {found.segments} segments with bends up to "
        f"{found.bend:.1e} rad changes its energy by {found.gentle} of it in 10^6 steps with bending by arctangent and by "
        f"{found.default} with the default form ({found.gentle.length} steps).",
        f"Struck {RISES[1] / RISES[0]:.0f} times harder, with bends up to {found.hard_bend:.1e} rad, it changes it by {found.hard} "
        f"(arctangent).",
    ]
