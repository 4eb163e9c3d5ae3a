"""The continuous worm-like chain, numerically exact: infinite, or finite with free ends, with or without stretch."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from openmm_filament.wlc.interpolations import marko_siggia
from openmm_filament.wlc.numerics import Floats, invert, scalar_or_array
from openmm_filament.wlc.reduced import fractions, reduced_forces, stretch_softness

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["extension_exact", "force_exact"]


_STRONGEST = 1e10
"""Reduced force up to which the harmonics, 10 times its fourth root, make a matrix of reasonable size."""


def _exact_fraction(f: float, softness: float, length: float, dimension: int) -> float:
    """`z/L` at the reduced force f, softness = kT/(S l_p), length = L/l_p (infinite: the ground state alone).

    `H = L^2/2 - f cos - softness f^2/2 cos^2` in Legendre functions (cosines in two dimensions), where L^2 is diagonal
    and cos tridiagonal. Messages of width `g^(-1/4)`, `g = f + softness f^2`, reach the harmonics up to about
    `8.6 g^(1/4)`.
    """
    if f + softness * f**2 > _STRONGEST:
        raise ValueError(
            f"Argument `force`, or the one that the extension asks for, must keep F l_p/kT below {_STRONGEST:g}, but is {f:.6g}."
        )
    size = 24 + math.ceil(10 * (f + softness * f**2) ** 0.25)
    n = np.arange(size + 2.0)
    if dimension == 3:
        kinetic, step = n * (n + 1) / 2, n / np.sqrt(np.maximum(4 * n**2 - 1, 1))  # step[n]: <n-1|cos|n>
    else:
        kinetic, step = n**2 / 2, np.full(n.shape, 0.5)
        step[0], step[1] = 0.0, math.sqrt(0.5)
    cosine = step[1:size]
    cosine_squared = (step[:size] ** 2 + step[1 : size + 1] ** 2, step[1 : size - 1] * step[2:size])

    # -dH/df = cos + softness f cos^2 in bands, and H = kinetic - f cos - softness f^2/2 cos^2.
    bands = np.zeros((3 if softness else 2, size))
    bands[1, :-1] = cosine
    slope, hamiltonian = bands, -f * bands
    hamiltonian[0] = kinetic[:size]
    if softness:
        squared = np.zeros((3, size))
        squared[0], squared[2, :-2] = cosine_squared
        slope, hamiltonian = bands + softness * f * squared, hamiltonian - softness * f**2 / 2 * squared

    infinite = math.isinf(length)
    if infinite:
        _, states = linalg.eig_banded(hamiltonian, lower=True, select="i", select_range=(0, 0), check_finite=False)
    elif softness:
        energies, states = linalg.eig_banded(hamiltonian, lower=True, check_finite=False)
    else:
        energies, states = linalg.eigh_tridiagonal(hamiltonian[0], hamiltonian[1, :-1], check_finite=False)
    applied = slope[0, :, None] * states
    for distance, band in enumerate(slope[1:], start=1):
        applied[distance:] += band[:-distance, None] * states[:-distance]
        applied[:-distance] += band[:-distance, None] * states[distance:]
    elements = states.T @ applied
    if infinite:
        return float(elements[0, 0])
    # d/df <0|exp(-length H)|0>: divided differences of the exponential between the levels.
    decay = length * (energies - energies[0])
    gap = np.abs(decay[:, None] - decay)
    with np.errstate(invalid="ignore"):
        ratio = np.where(gap > 0, -np.expm1(-gap) / gap, 1.0)
    ends = states[0]
    total = ends @ (elements * ratio * np.exp(-np.minimum(decay[:, None], decay))) @ ends
    return float(total / (ends**2 @ np.exp(-decay)))


def _exact(f: Floats, softness: float, length: float, dimension: int) -> Floats:
    """`_exact_fraction` elementwise."""
    values = [_exact_fraction(value, softness, length, dimension) for value in f.ravel().tolist()]
    return np.reshape(np.array(values, dtype=np.float64), f.shape)


def _exact_parameters(
    persistence_length: float, contour_length: float, kT: float, stretch_modulus: float | None, finite: bool
) -> tuple[float, float]:
    """Softness and reduced length for `_exact`."""
    softness = 0.0 if stretch_modulus is None else stretch_softness(persistence_length, kT, stretch_modulus)
    return softness, contour_length / persistence_length if finite else math.inf


def extension_exact(
    force: ArrayLike,
    persistence_length: float,
    contour_length: float,
    kT: float,
    *,
    stretch_modulus: float | None = None,
    finite: bool = False,
    dimension: int = 3,
) -> float | Floats:
    """Mean extension of the continuous worm-like chain, numerically exact.

    `H = L^2/2 - f cos(theta) - (f^2/2) (kT/(S l_p)) cos^2(theta)`: the last term is the local stretch, integrated out.
    The infinite chain is its ground state, `z/L = -dE_0/df`; the finite one with free ends
    `z = l_p d/df ln <0|exp(-(L/l_p) H)|0>` with |0> the uniform state (Marko and Siggia, Macromolecules 28, 8759
    (1995); the stretch as in Odijk, Macromolecules 28, 7016 (1995)).

    Relative error below 1e-11 for f from 1e-6 to 1e5 and L from 1e-3 l_p. The other arguments, and errors: see
    `openmm_filament.wlc`.

    Parameters
    ----------
    stretch_modulus : float, optional
        S in pN; None for an inextensible chain.
    finite : bool
        True for the chain of length L with free ends, False for the infinite-chain formula times L.

    Examples
    --------
    >>> round(extension_exact(1.0, 53.0, 1000.0, 4.114, finite=True), 2)
    858.51
    """
    f, contour = reduced_forces(force, persistence_length, contour_length, kT, dimension)
    parameters = _exact_parameters(persistence_length, contour, kT, stretch_modulus, finite)
    return scalar_or_array(contour * _exact(f, *parameters, dimension))


def force_exact(
    extension: ArrayLike,
    persistence_length: float,
    contour_length: float,
    kT: float,
    *,
    stretch_modulus: float | None = None,
    finite: bool = False,
    dimension: int = 3,
) -> float | Floats:
    """Force that gives this mean extension: the inverse of `extension_exact`.

    Relative error 1e-8, and near full extension what rounding leaves of `1 - z/L`. Takes z in [0, L), any z >= 0 with a
    stretch modulus. Arguments as there; errors: see `openmm_filament.wlc`.

    Examples
    --------
    >>> round(force_exact(858.510, 53.0, 1000.0, 4.114, finite=True), 4)
    1.0
    """
    stretches = stretch_modulus is not None
    z, unit = fractions(extension, persistence_length, contour_length, kT, dimension, bounded=not stretches)
    parameters = _exact_parameters(persistence_length, contour_length, kT, stretch_modulus, finite)
    guess = marko_siggia(np.minimum(z, 0.99))
    return scalar_or_array(unit * invert(lambda f: _exact(f, *parameters, dimension), z, guess))
