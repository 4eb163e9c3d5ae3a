"""Helices and rods of elastic wire: their numbers, their shapes, their filaments with contact. SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of

__all__ = ["GRIP", "HELD", "Wire", "start_gap"]

Array = NDArray[np.float64]

HELD = 5
"""Beads of the lower chain that are held at its foot: its base does not turn."""

GRIP = (-1, -3, -5)
"""Beads of the upper chain that the hand holds, each in a trap of its own: three points fix a direction."""


@dataclass(frozen=True)
class Wire:
    """A wire of circular section that rests as a helix about z, or as a straight rod.

    Attributes
    ----------
    hand : int
        1 for a right-handed helix, -1 for a left-handed one, 0 for a rod of the helix's contour length.
    thickness : float
        Diameter d of the wire, m; contact begins where centre lines are as near as that.
    radius, pitch : float
        Radius R of the centre line about the axis, and rise of a turn, m.
    turns : float
    youngs_modulus, shear_modulus : float
        E and G, Pa. A rod has no torsion term, which does not exist on a straight chain.
    density : float
        kg/m^3; it sets the time scale only.
    spacing : float
        Wanted distance of beads over the thickness.
    """

    hand: int = 1
    thickness: float = 1e-3
    radius: float = 1.5e-3
    pitch: float = 4e-3
    turns: float = 2.5
    youngs_modulus: float = 1e9
    shear_modulus: float = 1e9 / 2.6
    density: float = 1e3
    spacing: float = 1.0

    @property
    def contour(self) -> float:
        """Length of the centre line in m."""
        return self.turns * math.hypot(2 * math.pi * self.radius, self.pitch)

    @property
    def segments(self) -> int:
        """How many segments the chain has."""
        return round(self.contour / (self.spacing * self.thickness))

    @property
    def height(self) -> float:
        """Extent along z at rest, m."""
        return self.turns * self.pitch if self.hand else self.contour

    @property
    def bending(self) -> float:
        """E I, N m^2."""
        return self.youngs_modulus * math.pi * self.thickness**4 / 64

    @property
    def energy(self) -> float:
        """E I/R, J: the scale of the energies that bend a coil open."""
        return self.bending / self.radius

    def period(self) -> float:
        """Of the slowest swing of the helix of these numbers, clamped at its foot, s; a rod is given that of its helix.

        By the formula of a cantilever beam, a coil of height h and contour L bending with
        `(h/L) 2 E I G J/(E I + G J)`.
        """
        twisting = self.shear_modulus * math.pi * self.thickness**4 / 32
        height = self.turns * self.pitch
        mean = 2 * self.bending * twisting / (self.bending + twisting)
        mass = self.density * math.pi * self.thickness**2 / 4 * self.contour / height
        return 2 * math.pi / 3.516 * height**2 * math.sqrt(mass * self.contour / (height * mean))

    def shape(self) -> Array:
        """Beads (N, 3) in m, bead 0 at z = 0."""
        count = self.segments
        if not self.hand:
            return np.asarray(of.shapes.line(count, self.contour / count * unit.meter).value_in_unit(unit.meter))
        coil = of.shapes.helix(
            count,
            radius=self.radius * unit.meter,
            pitch=self.pitch * unit.meter,
            turns=self.turns,
            left_handed=self.hand < 0,
        )
        return np.asarray(coil.value_in_unit(unit.meter))

    def segment_length(self) -> float:
        """Distance of neighbouring beads at rest, m."""
        first, second = self.shape()[:2]
        return float(np.linalg.norm(second - first))

    def stretching(self) -> float:
        """E S/l0, N/m: the stiffness of a segment, and that of contact."""
        return self.youngs_modulus * math.pi * self.thickness**2 / 4 / self.segment_length()

    def bead_mass(self) -> float:
        """Mass of a bead in kg."""
        return self.density * math.pi * self.thickness**2 / 4 * self.segment_length()

    def filament(self, rest: Array) -> of.Filament:
        """The chain with stretching, bending, torsion (of a helix) and contact, its shape standing as `rest` (N, 3), m."""
        rod = of.rod_terms(
            self.youngs_modulus * unit.pascal,
            self.shear_modulus * unit.pascal if self.hand else None,
            self.thickness / 2 * unit.meter,
            self.segment_length() * unit.meter,
            contact=True,
        )
        return of.Filament(rest * unit.meter, self.bead_mass() * unit.kilogram, rod)


def start_gap(lower: Wire, upper: Wire) -> float:
    """Height of the upper chain's foot above the lower one's tip before they are brought together, m: out of touch."""
    return 1.5 * (lower.thickness + upper.thickness) / 2
