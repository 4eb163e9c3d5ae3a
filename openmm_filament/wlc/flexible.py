"""Chains without bending stiffness that share the long worm-like chain's `<R^2>`: freely jointed and Gaussian."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from openmm_filament.wlc.numerics import Floats, root, scalar_or_array
from openmm_filament.wlc.reduced import fractions, reduced_forces

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["extension_fjc", "extension_gaussian", "force_fjc", "force_gaussian"]


def _kuhn_ratio(dimension: int) -> int:
    """Kuhn length over persistence length, 2 in three dimensions and 4 in two."""
    return 4 // (dimension - 1)


def _langevin(x: Floats, dimension: int) -> Floats:
    """`<cos theta>` under the weight `exp(x cos theta)`: `coth x - 1/x` or `I1(x)/I0(x)`, stable for every x >= 0."""
    middle = np.clip(x, 1e-8, 1e8)
    value = special.ive(dimension / 2, middle) / special.ive(dimension / 2 - 1, middle)
    return np.where(x < 1e-8, x / dimension, np.where(x > 1e8, 1 - (dimension - 1) / (2 * np.maximum(x, 1)), value))


def extension_fjc(
    force: ArrayLike, persistence_length: float, contour_length: float, kT: float, *, dimension: int = 3
) -> float | Floats:
    """Extension of the freely jointed chain with the same `<R^2>`, Kuhn length `b = 2 l_p` (two dimensions: `4 l_p`).

    With `x = F b/kT`: `z/L = coth x - 1/x`, in two dimensions `I1(x)/I0(x)` (Kuhn and Gruen, Kolloid-Zeitschrift 101,
    248 (1942)). Exact for that chain; relative error 1e-13.

    Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(extension_fjc(0.04, 50.0, 1000.0, 4.0), 4)  # x = 1
    313.0353
    """
    f, contour = reduced_forces(force, persistence_length, contour_length, kT, dimension)
    return scalar_or_array(contour * _langevin(_kuhn_ratio(dimension) * f, dimension))


def force_fjc(
    extension: ArrayLike, persistence_length: float, contour_length: float, kT: float, *, dimension: int = 3
) -> float | Floats:
    """Force of the freely jointed chain: the inverse of `extension_fjc`.

    Takes z in [0, L). Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(force_fjc(extension_fjc(0.3, 50.0, 1000.0, 4.0), 50.0, 1000.0, 4.0), 9)
    0.3
    """
    z, unit = fractions(extension, persistence_length, contour_length, kT, dimension)
    guess = z * (dimension - z**2) / ((1 - z) * (1 + z))  # a few per cent off
    x = root(lambda x, z: _langevin(x, dimension) - z, z, guess / 2, guess * 2)
    return scalar_or_array(unit / _kuhn_ratio(dimension) * x)


def extension_gaussian(
    force: ArrayLike, persistence_length: float, contour_length: float, kT: float, *, dimension: int = 3
) -> float | Floats:
    """Extension of the Gaussian chain, `z = F L b/(d kT)`, Kuhn length `b = 2 l_p` (two dimensions: `4 l_p`).

    The same line as `extension_hookean`, here exact at every force; z may exceed L.

    Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(extension_gaussian(0.006, 50.0, 1000.0, 4.0), 9)
    50.0
    """
    f, contour = reduced_forces(force, persistence_length, contour_length, kT, dimension)
    return scalar_or_array(contour * _kuhn_ratio(dimension) / dimension * f)


def force_gaussian(
    extension: ArrayLike, persistence_length: float, contour_length: float, kT: float, *, dimension: int = 3
) -> float | Floats:
    """Force of the Gaussian chain, `F = d kT z/(L b)`: the inverse of `extension_gaussian`.

    Takes any z >= 0. Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(force_gaussian(50.0, 50.0, 1000.0, 4.0), 9)
    0.006
    """
    z, unit = fractions(extension, persistence_length, contour_length, kT, dimension, bounded=False)
    return scalar_or_array(unit * dimension / _kuhn_ratio(dimension) * z)
