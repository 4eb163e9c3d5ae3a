"""Electrostatics between neighbours along the chain (equation 1.21 of the thesis)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament._term import Array, Parameters, Term
from openmm_filament.geometry import chain_indices, dot

__all__ = ["Neighbour"]


@final
@dataclass(frozen=True, eq=False)
class Neighbour(Term):
    """Energy `1/2 sum K^el q_i q_{i+1}/s_i` over the segments (1.21).

    The factor 1/2 is kept as the thesis prints it: each pair counts half of its Coulomb energy, since the sum runs
    over every segment once. For the full Coulomb energy give charges larger by sqrt(2).

    Parameters
    ----------
    charges : Quantity
        q, one number for all beads or one per bead.
    """

    charges: unit.Quantity

    family = "electrostatics"
    span = 2
    expression = "q/r"
    dimensions = {"q": "energy_length"}

    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        charges = check.finite("charges", units.numbers("charges", self.charges, "charge"))
        if charges.ndim:
            check.shape("charges", charges, (len(rest),))
        pairs = np.broadcast_to(charges, (len(rest),))[chain_indices(len(rest), 2, closed)]
        return {"q": 0.5 * units.COULOMB * pairs[:, 0] * pairs[:, 1]}

    @staticmethod
    def energy(x: Array, p: Parameters) -> Array:
        s = x[:, 1] - x[:, 0]
        return p["q"] / np.sqrt(dot(s, s))

    @staticmethod
    def gradient(x: Array, p: Parameters) -> Array:
        s = x[:, 1] - x[:, 0]
        g = -(p["q"] / dot(s, s) ** 1.5)[:, None] * s
        return np.stack([-g, g], axis=1)
