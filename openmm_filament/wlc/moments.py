"""Mean squared end-to-end distances and radii of gyration without force, of continuous and of discrete chains."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from openmm_filament import _checks as check
from openmm_filament.wlc.numerics import Floats, positive_scalar

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "mean_squared_end_to_end",
    "mean_squared_end_to_end_discrete",
    "mean_squared_radius_of_gyration",
    "mean_squared_radius_of_gyration_discrete",
    "mean_squared_sizes",
]


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


def mean_squared_radius_of_gyration(persistence_length: float, contour_length: float, *, dimension: int = 3) -> float:
    """`<R_g^2> = xi L/3 - xi^2 + 2 xi^3/L - 2 (xi^4/L^2) (1 - exp(-L/xi))`, xi as in `mean_squared_end_to_end`.

    Benoit and Doty, Journal of Physical Chemistry 57, 958 (1953). Relative error 1e-13 at any length.

    Returns `<R_g^2>` in nm^2. Arguments and errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(mean_squared_radius_of_gyration(53.0, 1000.0), 3)
    15139.64
    """
    check.one_of("dimension", dimension, (2, 3))
    contour = positive_scalar("contour_length", contour_length)
    x = contour * (dimension - 1) / (2 * positive_scalar("persistence_length", persistence_length))
    if x < 2.0:  # 2 (x^3/6 - x^2/2 + x - 1 + exp(-x))/x^4 as a series, where the closed form cancels
        return contour**2 * sum(2 * (-x) ** k / math.factorial(k + 4) for k in range(30))
    return contour**2 * (1 / (3 * x) - 1 / x**2 + 2 / x**3 + 2 * math.expm1(-x) / x**4)


def mean_squared_end_to_end_discrete(
    segments: int, bond_length: float, mean_cosine: float, *, bond_variance: float = 0.0
) -> float:
    """`<R^2>` of the freely rotating chain: `N b^2 [(1 + c)/(1 - c) - 2 c (1 - c^N)/(N (1 - c)^2)] + N var(s)`.

    c is `<cos beta>`. Flory, *Statistical Mechanics of Chain Molecules* (1969), chapter 1; bond lengths that vary
    independently add their variance. Summed term by term, so it holds its relative accuracy (1e-13) up to c = 1, a rod.
    Errors: see `openmm_filament.wlc`.

    Parameters
    ----------
    segments : int
        Number N of bonds, at least 1.
    bond_length : float
        b in nm, the length of rigid bonds or the mean length of others (`mean_bond_length`).
    mean_cosine : float
        c in [-1, 1].
    bond_variance : float
        var(s) in nm^2 (`bond_length_variance`); 0 for rigid bonds.

    Returns
    -------
    float
        `<R^2>` in nm^2.

    Examples
    --------
    >>> mean_squared_end_to_end_discrete(10, 2.0, 0.0), mean_squared_end_to_end_discrete(10, 2.0, 1.0)
    (40.0, 400.0)
    """
    correlation = _freely_rotating(segments, mean_cosine)
    return mean_squared_sizes(correlation, bond_length, bond_variance=bond_variance)[0]


def mean_squared_radius_of_gyration_discrete(
    segments: int, bond_length: float, mean_cosine: float, *, bond_variance: float = 0.0
) -> float:
    """`<R_g^2>` in nm^2 of the N + 1 beads, all of one weight, of the freely rotating chain.

    `<R_g^2> = sum_(i<j) <|r_i - r_j|^2>/(N + 1)^2`, the distances being those of
    `mean_squared_end_to_end_discrete` for j - i bonds; the arguments are as there, and so are errors.

    Examples
    --------
    >>> mean_squared_radius_of_gyration_discrete(1, 2.0, 0.5), mean_squared_radius_of_gyration_discrete(2, 3.0, 1.0)
    (1.0, 6.0)
    """
    correlation = _freely_rotating(segments, mean_cosine)
    return mean_squared_sizes(correlation, bond_length, bond_variance=bond_variance)[1]


def _freely_rotating(segments: int, mean_cosine: float) -> Floats:
    """`<t_n . t_0> = c^n` for n = 0 ... segments - 1."""
    count = check.integer("segments", segments, low=1)
    cosine = float(check.shape("mean_cosine", check.within("mean_cosine", mean_cosine, -1, 1), ()))
    return cosine ** np.arange(float(count))


def mean_squared_sizes(
    correlation: ArrayLike, bond_length: float, *, bond_variance: float = 0.0
) -> tuple[float, float]:
    """`<R^2>` and `<R_g^2>` of a uniform chain from its tangent correlation, such as `tangent_correlation_discrete`.

    m successive bonds span `<R_m^2> = m (b^2 + var(s)) + 2 b^2 sum_(n=1..m-1) (m - n) <t_n . t_0>`; the mean squared
    radius of gyration of the N + 1 beads is `sum_m (N + 1 - m) <R_m^2>/(N + 1)^2`.

    Parameters
    ----------
    correlation : array_like
        `<t_n . t_0>` for n = 0 ... N - 1, (N,), the first 1: one entry a bond.
    bond_length, bond_variance : float
        As in `mean_squared_end_to_end_discrete`.

    Returns
    -------
    tuple of float
        `<R^2>` and `<R_g^2>` in nm^2.

    Raises
    ------
    ValueError
        If a correlation lies outside [-1, 1] or the first is not 1, or a length is out of its range.

    Examples
    --------
    >>> mean_squared_sizes([1.0, 0.0, -1.0, 0.0], 1.0)  # a square
    (0.0, 0.48)
    """
    values = check.shape("correlation", check.within("correlation", correlation, -1, 1), (None,))
    if not len(values) or values[0] != 1:
        raise check.fail("correlation", "begin with 1", values[:1])
    length = positive_scalar("bond_length", bond_length)
    variance = float(check.shape("bond_variance", check.non_negative("bond_variance", bond_variance), ()))
    bonds = len(values)
    apart = np.arange(bonds + 1.0)
    # sum_(n=1..m-1) (m - n) C_n is the sum of the sums of C_1 ... C_(m-1)
    inner = np.concatenate([[0.0, 0.0], np.cumsum(np.cumsum(values[1:]))])
    squared = apart * (length**2 + variance) + 2 * length**2 * inner
    gyration = float(((bonds + 1 - apart) * squared).sum()) / (bonds + 1) ** 2
    return float(squared[-1]), gyration
