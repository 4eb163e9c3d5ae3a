"""Mean squared end-to-end distances without force, of the continuous and of the freely rotating chain."""

from __future__ import annotations

import math

import numpy as np

from openmm_filament import _checks as check
from openmm_filament.wlc.numerics import positive_scalar

__all__ = ["mean_squared_end_to_end", "mean_squared_end_to_end_discrete"]


def mean_squared_end_to_end(persistence_length: float, contour_length: float, *, dimension: int = 3) -> float:
    """`<R^2> = 2 xi L [1 - (xi/L) (1 - exp(-L/xi))]`, `xi = l_p` in three dimensions and `2 l_p` in two.

    Kratky and Porod, Recueil des Travaux Chimiques des Pays-Bas 68, 1106 (1949). Relative error 1e-13 at any length.

    Returns `<R^2>` in nm^2. Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(mean_squared_end_to_end(53.0, 1000.0), 3)
    100382.0
    """
    check.one_of("dimension", dimension, (2, 3))
    contour = positive_scalar("contour_length", contour_length)
    x = contour * (dimension - 1) / (2 * positive_scalar("persistence_length", persistence_length))
    if x < 0.5:  # 2 (x - 1 + exp(-x))/x^2 as a series, where the closed form cancels
        return contour**2 * sum(2 * (-x) ** k / math.factorial(k + 2) for k in range(16))
    return contour**2 * 2 * (x + math.expm1(-x)) / x**2


def mean_squared_end_to_end_discrete(segments: int, bond_length: float, mean_cosine: float) -> float:
    """`<R^2>` of the freely rotating chain: `N b^2 [(1 + c)/(1 - c) - 2 c (1 - c^N)/(N (1 - c)^2)]`, c = `<cos beta>`.

    Flory, *Statistical Mechanics of Chain Molecules* (1969), chapter 1. Summed term by term, so it holds its relative
    accuracy (1e-13) up to c = 1, a rod. Errors: see `openmm_filament.wlc`.

    Parameters
    ----------
    segments : int
        Number N of rigid bonds, at least 1.
    bond_length : float
        b in nm.
    mean_cosine : float
        c in [-1, 1].

    Returns
    -------
    float
        `<R^2>` in nm^2.

    Examples
    --------
    >>> mean_squared_end_to_end_discrete(10, 2.0, 0.0), mean_squared_end_to_end_discrete(10, 2.0, 1.0)
    (40.0, 400.0)
    """
    segments = check.integer("segments", segments, low=1)
    length, cosine = positive_scalar("bond_length", bond_length), float(check.within("mean_cosine", mean_cosine, -1, 1))
    apart = np.arange(1, segments)
    return length**2 * (segments + 2 * float(np.sum((segments - apart) * cosine**apart)))
