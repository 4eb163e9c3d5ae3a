"""One bond of a discrete chain, rigid or harmonic: its weight and mean length under tension."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from openmm_filament import _checks as check
from openmm_filament.wlc.numerics import Floats, positive_scalar, root, scalar_or_array

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["bond", "bond_length_variance", "mean_bond_length", "rest_length"]


def bond(
    tension: Floats, length: float | Floats, stretching: float | None, kT: float, dimension: int
) -> tuple[Floats, Floats]:
    """Log of the weight, and mean length, of a bond pulled along itself by `tension` (negative when pushed).

    The weight is `int_0^inf s^(d-1) exp(-k (s - b0)^2/(2 kT) + tension s/kT) ds` up to a constant factor: with
    `sigma^2 = kT/k` and `y = (b0 + tension/k)/sigma` a Gaussian moment `J_(d-1)(y)`, from `J_(n+1) = y J_n + n J_(n-1)`
    and the error function, times `exp(tension (b0 + tension/(2 k))/kT)`. Far on the pushed side (y < -20) the recursion
    cancels and the asymptotic series takes its place.
    """
    if stretching is None:
        return tension * length / kT, np.broadcast_to(np.asarray(length, dtype=np.float64), tension.shape)
    sigma = math.sqrt(kT / stretching)
    y = (length + tension / stretching) / sigma
    pushed = y < 0  # there the common factor exp(-y^2/2) is taken out
    gauss = np.exp(-(y**2) / 2)
    erfc = np.where(pushed, special.erfcx(np.maximum(-y, 0) / math.sqrt(2)), special.erfc(-y / math.sqrt(2)))
    moments = [math.sqrt(math.pi / 2) * erfc]
    moments.append(y * moments[0] + np.where(pushed, 1.0, gauss))
    for n in range(1, dimension):
        moments.append(y * moments[n] + n * moments[n - 1])
    far = y < -20
    if far.any():
        x = -y[far]
        for n in (dimension - 1, dimension):
            series = [(-0.5) ** k * math.factorial(n + 2 * k) / math.factorial(k) for k in range(9)]
            moments[n][far] = np.polynomial.polynomial.polyval(x**-2, series) / x ** (n + 1)
    log_weight = tension * (length + tension / (2 * stretching)) / kT - np.where(pushed, y**2 / 2, 0.0)
    return log_weight + np.log(moments[dimension - 1]), sigma * moments[dimension] / moments[dimension - 1]


def mean_bond_length(bond_length: ArrayLike, stretching: float, kT: float, *, dimension: int = 3) -> float | Floats:
    """Mean length of a free harmonic bond, `<s>` with the weight `s^(d-1) exp(-k (s - b0)^2/(2 kT))`, s > 0.

    To first order `b0 + (d-1) kT/(k b0)`; here to rounding (relative 1e-13), for any stiffness. Errors: see
    `openmm_filament.wlc`.

    Parameters
    ----------
    bond_length : array_like
        Rest length b0 in nm, scalar or array, not negative.
    stretching : float
        Stiffness k in pN/nm.
    kT : float
        Thermal energy in pN nm.
    dimension : int
        2 or 3.

    Returns
    -------
    float or ndarray
        The mean length in nm, shaped like `bond_length`.

    Examples
    --------
    >>> round(mean_bond_length(10.0, 5.0, 4.114), 4)
    10.1632
    """
    length = check.non_negative("bond_length", bond_length)
    stretching, kT = positive_scalar("stretching", stretching), positive_scalar("kT", kT)
    check.one_of("dimension", dimension, (2, 3))
    return scalar_or_array(np.asarray(bond(np.zeros(length.shape), length, stretching, kT, dimension)[1]))


def bond_length_variance(bond_length: ArrayLike, stretching: float, kT: float, *, dimension: int = 3) -> float | Floats:
    """Variance in nm^2 of the length of a free harmonic bond, with the weight of `mean_bond_length`.

    `<s^2> = b0 <s> + d kT/k`, from the integral of `(s^d exp(-k (s - b0)^2/(2 kT)))'` over all lengths. For stiff bonds
    about kT/k; where `<s>^2` is large beside that the difference loses digits (relative error 1e-16 `b0^2 k/kT`).
    Arguments and errors as there.

    Examples
    --------
    >>> round(bond_length_variance(10.0, 5.0, 4.114), 4)
    0.8096
    """
    mean = np.asarray(mean_bond_length(bond_length, stretching, kT, dimension=dimension))
    return scalar_or_array(mean * (np.asarray(bond_length, dtype=np.float64) - mean) + dimension * kT / stretching)


def rest_length(mean_length: ArrayLike, stretching: float, kT: float, *, dimension: int = 3) -> float | Floats:
    """Rest length b0 whose bond has the mean length `mean_length`: the inverse of `mean_bond_length`.

    `stretching`, `kT` and `dimension` as there.

    Parameters
    ----------
    mean_length : array_like
        Wanted mean length in nm, scalar or array; it must exceed that of a bond with b0 = 0.

    Returns
    -------
    float or ndarray
        b0 in nm, shaped like `mean_length`.

    Raises
    ------
    ValueError
        If the bond is so soft, or so short, that no b0 >= 0 gives this mean length, or as `mean_bond_length`.

    Examples
    --------
    >>> round(rest_length(10.163241, 5.0, 4.114), 4)
    10.0
    """
    mean = check.positive("mean_length", mean_length)
    shortest = float(mean_bond_length(0.0, stretching, kT, dimension=dimension))
    if (mean < shortest).any():
        raise check.fail("mean_length", f"be at least {shortest:.6g} nm for this stiffness", f"{mean.min():.6g}")

    def difference(length: Floats, target: Floats) -> Floats:
        return bond(np.zeros(length.shape), length, stretching, kT, dimension)[1] - target

    return scalar_or_array(root(difference, mean, 0.0, mean))
