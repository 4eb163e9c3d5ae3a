"""Tangent correlations of chains in thermal motion, and the persistence length from their decay."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from openmm_filament import _checks as check
from openmm_filament.analysis.averages import average, standard_error
from openmm_filament.analysis.chains import chain_positions, chain_segments

__all__ = ["PersistenceLength", "TangentCorrelation", "persistence_length", "tangent_correlation"]

Array = NDArray[np.float64]

_FEWEST = 20.0
"""Effective samples below which an error bar is not to be trusted."""

_ENOUGH = math.exp(-1.0)
"""Correlation down to which separations enter the fit: beyond it they are mostly noise."""

_OFF = 5.0
"""Standard errors from the exponential at which a correlation is said not to be one."""


@dataclass(frozen=True, eq=False)
class TangentCorrelation:
    """Mean products of tangents against their separation along the chain.

    Attributes
    ----------
    separations : (K,) array
        nm along the chain: n times the mean segment length, from n = 0.
    values, errors : (K,) array
        `<t_i . t_(i+n)>`, averaged over i, and one standard error of each; errors at different n are correlated.
    segment_length : float
        Mean length of a segment in nm.
    """

    separations: Array
    values: Array
    errors: Array
    segment_length: float


@dataclass(frozen=True, eq=False)
class PersistenceLength:
    """A persistence length and what it was fitted to.

    Attributes
    ----------
    value, error : float
        nm; one standard error.
    effective_samples : float
        Independent samples that would give the same error.
    autocorrelation_time : float
        Integrated, in frames, of what moves the persistence length.
    fitted : tuple of int
        First and last separation that was fitted, in segments.
    correlation : TangentCorrelation
        With the errors of its values.
    dimension : int
        3 or 2.
    """

    value: float
    error: float
    effective_samples: float
    autocorrelation_time: float
    fitted: tuple[int, int]
    correlation: TangentCorrelation
    dimension: int


def _products(positions: Any, atoms: ArrayLike | None) -> tuple[Array, Array]:
    """Mean segment lengths (T, M), and tangent products averaged along each chain (T, M, K), n = 0 ... K - 1."""
    lengths, tangents = chain_segments(chain_positions(positions, atoms))
    count = tangents.shape[2]
    padded = fft.next_fast_len(2 * count, real=True)
    power = (np.abs(fft.rfft(tangents, n=padded, axis=2)) ** 2).sum(axis=-1)
    products = fft.irfft(power, n=padded, axis=2)[:, :, :count] / (count - np.arange(count))
    products[..., 0] = 1.0
    return lengths.mean(axis=2), products


def _correlation(lengths: Array, products: Array) -> TangentCorrelation:
    step = float(lengths.mean())
    errors = [standard_error(products[..., n])[0] for n in range(products.shape[2])]
    separations = step * np.arange(products.shape[2], dtype=np.float64)
    return TangentCorrelation(separations, products.mean(axis=(0, 1)), np.array(errors), step)


def tangent_correlation(positions: Any, *, atoms: ArrayLike | None = None) -> TangentCorrelation:
    """Tangent correlation of chains, with standard errors that allow for the correlation of successive frames.

    Exact values: `exp(-s/l_p)` for the continuous chain (`exp(-s/(2 l_p))` in a plane),
    `wlc.tangent_correlation_discrete` for beads with bending and torsion.

    Parameters
    ----------
    positions : (T, N, 3) array in nm, or mdtraj.Trajectory
        Frames in the order of time, evenly spaced; chains are whole and independent of one another.
    atoms : (N,) or (M, N) array of int, optional
        The beads of each chain; by default all of an array, and each chain of a trajectory's topology.

    Raises
    ------
    ValueError
        If the shapes do not fit, chains differ in length, successive beads coincide or a coordinate is not finite.

    Examples
    --------
    >>> tangent_correlation([[[0.0, 0, 0], [1, 0, 0], [1, 2, 0], [3, 2, 0]]]).values.round(9) + 0.0
    array([1., 0., 1.])
    """
    return _correlation(*_products(positions, atoms))


def persistence_length(
    positions: Any, *, atoms: ArrayLike | None = None, dimension: int = 3, fit: tuple[int, int] | None = None
) -> PersistenceLength:
    """Persistence length in nm with a standard error, from the decay of the tangent correlation.

    `<t_i . t_(i+n)> = exp(-n b/xi)` is fitted by least squares, b the mean segment length, `xi = l_p` in three dimensions
    and `2 l_p` in a plane. The weights are those of independent pairs on such a chain. For the discrete chain of rigid or
    harmonic bonds this is exact, `l_p = -b/ln<cos beta>`.

    Of a chain whose joints rest bent, by however little, and have no torsion, that is not `K b/(k_B T)` of its bending
    stiffness K: the bends turn freely about the segments, so that a rest angle beta0 counts as a random bend, and for
    `K beta0^2` well above `k_B T` the length is near `-b/ln(cos beta0)`, however stiff the joints. With a torsion the
    correlation of a bent shape oscillates, and has no persistence length at all.

    The error follows from the series of what each frame moves the result by, to first order, and its autocorrelation:
    it allows for the correlation of frames and of separations alike.

    Parameters
    ----------
    positions : (T, N, 3) array in nm, or mdtraj.Trajectory
        As for `tangent_correlation`.
    atoms : (N,) or (M, N) array of int, optional
        The beads of each chain.
    dimension : int
        3, or 2 for chains that lie in a plane.
    fit : tuple of int, optional
        First and last separation to fit, in segments. By default from 1 to the last before the correlation first falls
        below 1/e. Begin later where neighbouring segments are bound to each other otherwise than the chain at large.

    Raises
    ------
    ValueError
        If the chains have fewer than 3 beads, the range is out of the chain, or the correlation does not fall there.

    Warns
    -----
    UserWarning
        If fewer than 20 effective samples bear the error, or the correlation is not an exponential.

    Examples
    --------
    >>> t = np.cumsum(np.random.default_rng(1).normal(0, 0.2, (500, 40)), axis=1)  # in a plane: l_p = 1/0.2^2 segments
    >>> walks = np.cumsum(np.stack([np.cos(t), np.sin(t), 0 * t], axis=-1), axis=1)
    >>> found = persistence_length(walks, dimension=2)
    >>> abs(found.value - 25) < 3 * found.error < 2
    True
    """
    check.one_of("dimension", dimension, (2, 3))
    lengths, products = _products(positions, atoms)
    count = products.shape[2]
    if count < 2:
        raise ValueError("Argument `positions` must have chains of at least 3 beads, but has 2.")
    found = _correlation(lengths, products)
    first, last = _range(found.values, fit)
    n = np.arange(first, last + 1.0)
    rate, step = _rate(found.values[first : last + 1], n, count, dimension), found.segment_length
    decay = np.exp(-rate * n)
    slopes = _weights(decay, n, count, dimension) * n * decay
    # `sum slopes (C - decay) = 0` defines the rate: this is what a change of C moves it by, to first order
    influence = -slopes / (slopes @ (n * decay))
    series = lengths / rate - step / rate**2 * (products[..., first : last + 1] @ influence)
    factor = (dimension - 1) / 2
    moved = average(series)
    result = PersistenceLength(
        factor * step / rate,
        factor * moved.error,
        moved.effective_samples,
        moved.autocorrelation_time,
        (first, last),
        found,
        dimension,
    )
    _tell(result, decay)
    return result


def _range(values: Array, fit: tuple[int, int] | None) -> tuple[int, int]:
    """First and last separation to fit, checked."""
    longest = len(values) - 1
    if fit is None:
        below = np.flatnonzero(values < _ENOUGH)
        first, last = 1, max(int(below[0]) - 1, 1) if len(below) else longest
    else:
        first = check.integer("fit", fit[0], low=1, high=longest)
        last = check.integer("fit", fit[1], low=first, high=longest)
    if not 0 < values[first] < 1:
        raise ValueError(
            f"Argument `positions` must have tangents whose correlation lies between 0 and 1 at separation {first}, but it "
            f"is {values[first]:.6g}."
        )
    return first, last


def _weights(decay: Array, n: Array, count: int, dimension: int) -> Array:
    """One over the variance of each mean product, up to a factor: that of one pair, over the stretches without overlap.

    The cosine of the angle between two tangents whose mean cosine is c has the variance `(1 - c)^2 (1 + 2 c)/3`, in a
    plane `(1 - c^2)^2/2`.
    """
    planar = (1 - decay**2) ** 2 / 2
    variance = planar if dimension == 2 else (1 - decay) ** 2 * (1 + 2 * decay) / 3
    weights: Array = (count - n) / (n * variance)
    return weights


def _rate(values: Array, n: Array, count: int, dimension: int) -> float:
    """The rate of the exponential through the correlations at separations n, in 1/segments, by Gauss and Newton."""
    rate = -math.log(values[0]) / float(n[0])
    for _ in range(200):
        decay = np.exp(-rate * n)
        slopes = _weights(decay, n, count, dimension) * n * decay
        step = float(slopes @ (values - decay) / (slopes @ (n * decay)))
        rate -= min(max(step, -rate), rate / 2)
        if abs(step) < 1e-12 * rate:
            return rate
    raise RuntimeError(f"No exponential fits the correlations {values}.")


def _tell(result: PersistenceLength, decay: Array) -> None:
    """Warn of too few samples, and of a correlation that is not an exponential."""
    if not result.effective_samples >= _FEWEST:
        warnings.warn(
            f"The persistence length rests on {result.effective_samples:.1f} effective samples: its error is uncertain.",
            stacklevel=3,
        )
        return
    first, last = result.fitted
    found = result.correlation
    off = (found.values[first : last + 1] - decay) / np.maximum(found.errors[first : last + 1], 1e-12)
    worst = int(np.argmax(np.abs(off)))
    if abs(off[worst]) > _OFF:
        warnings.warn(
            f"The tangent correlation is not an exponential: at a separation of {first + worst} segments it is "
            f"{found.values[first + worst]:.6g}, {abs(off[worst]):.1f} standard errors from {decay[worst]:.6g}.",
            stacklevel=3,
        )
