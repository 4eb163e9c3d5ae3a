"""Stretching of the segments (equations 1.3 and 1.7 of the thesis). Conventions: see `geometry`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament._term import Array, Parameters, Term, per_element, read_off
from openmm_filament.geometry import dot, segments

__all__ = ["Harmonic"]


@final
@dataclass(frozen=True, eq=False)
class Harmonic(Term):
    """Energy `1/2 sum k_i (s_i - s_i^eq)^2` over the segments (1.3).

    Parameters
    ----------
    stiffness : Quantity
        k, energy/length^2, positive; one number, or one per segment.
    rest_length : Quantity, optional
        s^eq, positive; one number, or one per segment. By default the segment lengths of the rest shape.
    """

    stiffness: unit.Quantity
    rest_length: unit.Quantity | None = None

    family = "stretching"
    span = 2
    expression = "0.5*k*(r-r0)^2"
    dimensions = {"k": "stiffness", "r0": "length"}

    def parameters(self, rest: Array, closed: bool) -> dict[str, Array]:
        k = per_element("stiffness", self.stiffness, "stiffness", rest, 2, closed, check.positive)
        if self.rest_length is None:
            return {"k": k, "r0": read_off(np.linalg.norm(segments(rest, closed), axis=-1), rest)}
        return {"k": k, "r0": per_element("rest_length", self.rest_length, "length", rest, 2, closed, check.positive)}

    @staticmethod
    def energy(x: Array, p: Parameters) -> Array:
        s = x[:, 1] - x[:, 0]
        return 0.5 * p["k"] * (np.sqrt(dot(s, s)) - p["r0"]) ** 2

    @staticmethod
    def gradient(x: Array, p: Parameters) -> Array:
        s = x[:, 1] - x[:, 0]
        length = np.sqrt(dot(s, s))
        g = (p["k"] * (length - p["r0"]) / length)[:, None] * s
        return np.stack([-g, g], axis=1)
