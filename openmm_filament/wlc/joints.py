"""One joint of a discrete chain, harmonic or cosine: quadrature over its bending angle, and its mean cosine."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np

from openmm_filament import _checks as check
from openmm_filament.wlc.numerics import Floats, gauss, root, scalar_or_array

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["CUT", "BendingForm", "bending_from_cosine", "check_joint", "joint_rule", "mean_cosine"]

BendingForm = Literal["harmonic", "cosine"]

CUT = 40.0  # kernels are cut where they fall below exp(-40), a few 1e-18 of their peak


def joint_rule(stiffness: Floats, rest: Floats, form: str, dimension: int, order: int) -> tuple[Floats, Floats]:
    """Gauss-Legendre rule in beta for each joint: angles and normalised Boltzmann weights, both (joints, order).

    `stiffness` is alpha/kT. Where the Boltzmann factor is below exp(-40) there are no nodes.
    """
    with np.errstate(divide="ignore"):
        reach = np.sqrt(2 * CUT / stiffness) if form == "harmonic" else np.arccos(np.maximum(1 - CUT / stiffness, -1))
    low, high = np.maximum(rest - reach, 0), np.minimum(rest + reach, math.pi)
    nodes, weights = gauss(order)
    beta = low[:, None] + (high - low)[:, None] * (nodes + 1) / 2
    shape = (beta - rest[:, None]) ** 2 / 2 if form == "harmonic" else 2 * np.sin(beta / 2) ** 2
    boltzmann = weights * np.exp(-stiffness[:, None] * shape) * np.sin(beta) ** (dimension - 2)
    return beta, boltzmann / boltzmann.sum(axis=1, keepdims=True)


def _one_minus_cosine(stiffness: Floats, rest: float, form: str, dimension: int) -> Floats:
    """`1 - <cos beta>` without cancellation, shaped like `stiffness`."""
    flat = stiffness.ravel()
    beta, weights = joint_rule(flat, np.full(flat.shape, rest), form, dimension, 96)
    average: Floats = (weights * 2 * np.sin(beta / 2) ** 2).sum(axis=1)
    return average.reshape(stiffness.shape)


def check_joint(form: str, dimension: int) -> None:
    """Refuse a bending form or a dimension that does not exist."""
    check.one_of("bending_form", form, ("harmonic", "cosine"))
    check.one_of("dimension", dimension, (2, 3))


def mean_cosine(
    bending_over_kT: ArrayLike, *, bending_form: BendingForm = "harmonic", rest_angle: float = 0.0, dimension: int = 3
) -> float | Floats:
    """Mean cosine `<cos beta>` of a free joint, weight `sin(beta)^(d-2) exp(-E(beta)/kT)` over [0, pi].

    `E = 1/2 alpha (beta - beta0)^2` (harmonic) or `-alpha cos(beta)` (cosine; in three dimensions
    `<cos beta> = coth K - 1/K`, in two `I1(K)/I0(K)`). The persistence length of a chain of rigid links b follows as
    `-b/ln<cos beta>` (the decay length of the tangent correlation). Errors: see `openmm_filament.wlc`.

    Parameters
    ----------
    bending_over_kT : array_like
        K = alpha/kT, scalar or array, not negative.
    bending_form : str
        "harmonic" or "cosine".
    rest_angle : float
        beta0 in [0, pi]; must be 0 for the cosine form.
    dimension : int
        2 or 3.

    Returns
    -------
    float or ndarray
        The mean cosine, shaped like `bending_over_kT`, with an absolute error of about 1e-15.

    Examples
    --------
    >>> [round(-1 / math.log(mean_cosine(10.0, bending_form=form)), 5) for form in ("harmonic", "cosine")]
    [10.17174, 9.49122]
    """
    check_joint(bending_form, dimension)
    stiffness = check.non_negative("bending_over_kT", bending_over_kT)
    rest = float(check.within("rest_angle", rest_angle, 0, math.pi))
    if bending_form == "cosine" and rest != 0:
        raise check.fail("rest_angle", "be 0 for the cosine form", rest)
    return scalar_or_array(1 - _one_minus_cosine(stiffness, rest, bending_form, dimension))


def bending_from_cosine(
    mean_cosine: ArrayLike, *, bending_form: BendingForm = "harmonic", dimension: int = 3
) -> float | Floats:
    """K = alpha/kT of the straight joint with this mean cosine: the inverse of `mean_cosine`.

    `bending_form` and `dimension` as there. Errors: see `openmm_filament.wlc`.

    Parameters
    ----------
    mean_cosine : array_like
        `<cos beta>`, scalar or array, in (0, 1).

    Returns
    -------
    float or ndarray
        K, shaped like `mean_cosine`; its relative error is that of `1 - mean_cosine` as a float (1e-10 at 1 - 1e-6).

    Examples
    --------
    >>> round(bending_from_cosine(mean_cosine(12.5)), 9)
    12.5
    """
    check_joint(bending_form, dimension)
    cosine = check.within("mean_cosine", mean_cosine, 0, 1, open_ends=True)

    def difference(stiffness: Floats, target: Floats) -> Floats:
        return (1 - target) - _one_minus_cosine(stiffness, 0.0, bending_form, dimension)

    return scalar_or_array(root(difference, cosine, cosine / 2, 4 / (1 - cosine)))
