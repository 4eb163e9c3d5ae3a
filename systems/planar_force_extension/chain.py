"""The random planar chain of the thesis (3.2.1), in metres for the cold pulling and a million times smaller for the hot one.

Stretching and bending stiffness are both proportional to E, so that the reduced chain - lengths in segments l0, energies in
`alpha = E I/l0` - has two numbers besides its bends: 30 segments and `k l0^2/alpha = 4 l0^2/R^2 = 40000`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament import wlc
from openmm_filament.discretisation import PN

__all__ = [
    "BENDS",
    "CONTOUR",
    "FREE",
    "FROZEN",
    "KT",
    "RADIUS",
    "REST",
    "SEGMENTS",
    "SPREAD",
    "STEP",
    "STIFFNESS_RATIO",
    "TEMPERATURE",
    "WALK_SEED",
    "YOUNG",
    "Reduced",
    "cold_model",
    "rigidities",
    "scaled_filament",
    "signed_bends",
]

Array = NDArray[np.float64]

SEGMENTS, CONTOUR, RADIUS = 30, 0.15, 0.5e-4
"""Number, and contour length and radius of the wire in m."""

STEP = CONTOUR / SEGMENTS

YOUNG = (1e9, 1e10, 1e11, 2e11, 1e12)
"""The thesis's values of E in Pa."""

SPREAD, WALK_SEED = 1.0, 3
"""Standard deviation of the angle between segments in rad, and the seed of the shape; the thesis names neither."""

SCALE = 1e-6
"""The chain that is run hot over the chain that is pulled cold: segments of 5 nm in place of 5 mm."""

TEMPERATURE = 300.0  # K
KT = TEMPERATURE * of.units.BOLTZMANN / PN  # pN nm
MASS = 1000.0  # Da a bead; an average over configurations knows no mass


def signed_bends(x: Array) -> Array:
    """Signed angles (..., N-2) in (-pi, pi) from each segment of a planar chain (..., N, 3) to the next."""
    s = np.diff(x[..., :2], axis=-2)
    a, b = s[..., :-1, :], s[..., 1:, :]
    return np.asarray(np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=-1)))


def _rest() -> Array:
    """The walk turned so that its ends lie on x, where a force along x leaves it as it is in the limit of small forces."""
    walk = of.shapes.planar_walk(SEGMENTS, STEP * unit.meter, bend=SPREAD * unit.radian, seed=WALK_SEED)
    x: Array = walk.value_in_unit(unit.meter)
    c, s = x[-1, :2] / np.hypot(*x[-1, :2])
    turned = np.stack([c * x[:, 0] + s * x[:, 1], c * x[:, 1] - s * x[:, 0], 0 * x[:, 0]], axis=-1)
    turned[-1, 1] = 0.0
    return turned


REST = _rest()
"""Rest positions (31, 3) in m, bead 0 at the origin, the last on the x axis."""

BENDS = signed_bends(REST)
"""Signed rest angles of the 29 joints in rad."""

FREE, FROZEN = (0.0,) * len(BENDS), tuple(np.sign(BENDS).tolist())
"""Sides of joints that bend either way, and of joints that stay as they are at rest; see `Reduced`."""

STIFFNESS_RATIO = 4 * (STEP / RADIUS) ** 2


def rigidities(young: float) -> tuple[float, float]:
    """Stiffness of a bond in N/m, and of a joint in J, of the wire."""
    return (
        young * math.pi * RADIUS**2 / STEP,
        young * math.pi * RADIUS**4 / 4 / STEP,
    )


def cold_model(young: float, force: float) -> of.Model:
    """The wire in its plane, held at bead 0, pulled at the last one along x with a force in N."""
    bond, joint = rigidities(young)
    terms = (of.stretching.Harmonic(bond * unit.newton / unit.meter), of.bending.Harmonic(joint * unit.joule))
    filament = of.Filament(REST * unit.meter, 1e-6 * unit.kilogram, terms)
    loads = [of.loads.Hold(0), of.loads.Pull(-1, (force, 0.0, 0.0) * unit.newton), of.loads.Plane()]
    return of.build(filament, loads)


@dataclass(frozen=True)
class Reduced:
    """The reduced chain at a temperature: energies in alpha, lengths in l0, forces in alpha/l0.

    Attributes
    ----------
    heat : float
        `k_B T/alpha`.
    ratio : float
        `k l0^2/alpha`.
    bent : bool
        Whether it has the bends of the wire, or is straight at rest.
    sides : 29 floats
        0 for joints that bend either way, +1 or -1 for those that stay on that side.
    """

    heat: float
    ratio: float = STIFFNESS_RATIO
    bent: bool = True
    sides: tuple[float, ...] = FREE

    def exact(self, forces: Array) -> Array:
        """Mean extensions over the contour at forces in alpha/l0; NaN where the exact sums are lost to underflow."""
        try:
            return self._extensions(forces)
        except ValueError as error:
            if "underflow" not in str(error):
                raise
            if len(forces) == 1:
                return np.array([math.nan])
        return np.concatenate([self.exact(part) for part in np.array_split(forces, 2)])

    def _extensions(self, forces: Array) -> Array:
        sizes, sides = np.abs(BENDS) if self.bent else np.zeros_like(BENDS), np.asarray(self.sides)
        lengths = wlc.extension_discrete(
            forces,
            segments=SEGMENTS,
            bond_length=1.0,
            bending=1.0,
            kT=self.heat,
            stretching=self.ratio,
            rest_angles=np.where(sides == 0, sizes, sides * sizes),
            flip=sides == 0,
            dimension=2,
        )
        return np.asarray(lengths) / SEGMENTS


def scaled_filament(heat: float, ratio: float) -> of.Filament:
    """The chain that runs at 300 K with `alpha = k_B T/heat` and `k l0^2 = ratio alpha`."""
    alpha, step = KT * PN / heat, STEP * SCALE * 1e9
    terms = (
        of.stretching.Harmonic(ratio * alpha / step**2 * unit.kilojoule_per_mole / unit.nanometer**2),
        of.bending.Harmonic(alpha * unit.kilojoule_per_mole),
    )
    return of.Filament(REST * SCALE * unit.meter, MASS * unit.dalton, terms)
