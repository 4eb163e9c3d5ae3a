"""Limits of the worm-like chain: small forces, and large ones without and with stretch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from openmm_filament import _checks as check
from openmm_filament.wlc.numerics import Floats, root, scalar_or_array
from openmm_filament.wlc.reduced import fractions, reduced_forces, stretch_softness

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "extension_high_force",
    "extension_hookean",
    "extension_odijk",
    "force_high_force",
    "force_hookean",
    "force_odijk",
]


def extension_high_force(
    force: ArrayLike, persistence_length: float, contour_length: float, kT: float, *, dimension: int = 3
) -> float | Floats:
    """Extension at large force, `z/L = 1 - (d-1)/4 f^(-1/2)`; thesis (3.10).

    Its error is 3.9 % at f = 1, 0.2 % at 4, 0.04 % at 10 (two dimensions: 0.8, 0.02, 0.004 %). Below
    `f = ((d-1)/4)^2` the formula is negative and 0 is returned.

    Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> extension_high_force(8.0, 50.0, 1000.0, 4.0)
    950.0
    """
    f, contour = reduced_forces(force, persistence_length, contour_length, kT, dimension)
    with np.errstate(divide="ignore"):
        return scalar_or_array(contour * np.maximum(1 - (dimension - 1) / (4 * np.sqrt(f)), 0.0))


def force_high_force(
    extension: ArrayLike, persistence_length: float, contour_length: float, kT: float, *, dimension: int = 3
) -> float | Floats:
    """Force at large extension, `F l_p/kT = ((d-1)/4)^2/(1 - z/L)^2`: the inverse of `extension_high_force`.

    Takes z in (0, L); 0 is refused, since many forces give it. Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(force_high_force(950.0, 50.0, 1000.0, 4.0), 9)
    8.0
    """
    z, unit = fractions(extension, persistence_length, contour_length, kT, dimension)
    check.positive("extension", extension)
    return scalar_or_array(unit * ((dimension - 1) / (4 * (1 - z))) ** 2)


def extension_hookean(
    force: ArrayLike, persistence_length: float, contour_length: float, kT: float, *, dimension: int = 3
) -> float | Floats:
    """Extension at small force, `z/L = 2 f/3` in three dimensions (thesis (3.11)) and `2 f` in two.

    Linear response of the long chain, `z = F <R^2>/(d kT)`. High by 0.5 % at f = 0.1, 4.3 % at 0.3
    (two dimensions: 3.4 and 27 %). Nothing keeps z below L.

    Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(extension_hookean(0.006, 50.0, 1000.0, 4.0), 9)
    50.0
    """
    f, contour = reduced_forces(force, persistence_length, contour_length, kT, dimension)
    return scalar_or_array(contour * 4 / (dimension * (dimension - 1)) * f)


def force_hookean(
    extension: ArrayLike, persistence_length: float, contour_length: float, kT: float, *, dimension: int = 3
) -> float | Floats:
    """Force at small extension, `F = 3 kT/(2 l_p) z/L` (two dimensions: `kT/(2 l_p) z/L`); see `extension_hookean`.

    Takes any z >= 0. Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(force_hookean(50.0, 50.0, 1000.0, 4.0), 9)
    0.006
    """
    z, unit = fractions(extension, persistence_length, contour_length, kT, dimension, bounded=False)
    return scalar_or_array(unit * dimension * (dimension - 1) / 4 * z)


def extension_odijk(
    force: ArrayLike,
    persistence_length: float,
    contour_length: float,
    kT: float,
    stretch_modulus: float,
    *,
    dimension: int = 3,
) -> float | Floats:
    """Extension of the extensible chain at large force, `z/L = 1 - (d-1)/4 f^(-1/2) + F/S`.

    Odijk, Macromolecules 28, 7016 (1995), for three dimensions. For DNA (l_p = 53 nm, S = 1000 pN) within 0.15 % of the
    exact extensible infinite chain from 0.4 to 50 pN, 2.7 % high at 0.1 pN. Where the formula is negative 0 is
    returned.

    Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(extension_odijk(8.0, 50.0, 1000.0, 4.0, 1000.0), 9)
    958.0
    """
    f, contour = reduced_forces(force, persistence_length, contour_length, kT, dimension)
    softness = stretch_softness(persistence_length, kT, stretch_modulus)
    with np.errstate(divide="ignore"):
        return scalar_or_array(contour * np.maximum(1 - (dimension - 1) / (4 * np.sqrt(f)) + softness * f, 0.0))


def force_odijk(
    extension: ArrayLike,
    persistence_length: float,
    contour_length: float,
    kT: float,
    stretch_modulus: float,
    *,
    dimension: int = 3,
) -> float | Floats:
    """Force of the extensible chain: the inverse of `extension_odijk`.

    Takes any z > 0, which may exceed L. Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(force_odijk(958.0, 50.0, 1000.0, 4.0, 1000.0), 9)
    8.0
    """
    z, unit = fractions(extension, persistence_length, contour_length, kT, dimension, bounded=False)
    check.positive("extension", extension)
    softness = stretch_softness(persistence_length, kT, stretch_modulus)
    # x = f^(1/2) is the one positive root of softness x^3 + (1 - z) x - a, and at most the bound below.
    a = (dimension - 1) / 4
    high = np.sqrt(2 * np.maximum(z - 1, 0) / softness) + (2 * a / softness) ** (1 / 3)
    return scalar_or_array(unit * root(lambda x, z: softness * x**3 + (1 - z) * x - a, z, 0.0, high) ** 2)
