"""Means of correlated samples and their standard errors, from the autocorrelation of the samples.

The variance of the mean of n samples with autocovariance G(t) is `(1/n) sum_t G(t)`, summed to a window beyond which
there is only noise, as U. Wolff, Computer Physics Communications 156, 143 (2004), does it: also for a function of several
means, by the series of what each sample moves the function by. The window is set by the magnitudes of the autocorrelation,
not by itself: that of chains under little friction swings about zero, and its sum passes the end of Wolff's window early
(errors of an oscillation that decays over nine samples come out 0.84 of the true ones by the sum, 0.99 by the magnitudes).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from openmm_filament import _checks as check

__all__ = ["Average", "average", "standard_error"]

Array = NDArray[np.float64]

_RATIO = 1.5
"""S of Wolff: the exponential autocorrelation time that is assumed over the integrated one, which sets the window."""


@dataclass(frozen=True)
class Average:
    """A mean and one standard error of it.

    Attributes
    ----------
    value, error : float
        In the unit of the samples. The error is NaN where there are fewer than 4 samples.
    effective_samples : float
        Independent samples that would give the same error.
    autocorrelation_time : float
        Integrated, in frames: 0.5 where frames are independent.
    """

    value: float
    error: float
    effective_samples: float
    autocorrelation_time: float


def average(samples: ArrayLike) -> Average:
    """The mean of samples (T,) in the order of time, or of M independent runs (T, M), with its standard error.

    A run must be long against its autocorrelation time: with fewer than about 20 effective samples the error itself is
    known to no better than a third, and a run that never leaves its start shows no correlation at all.

    Raises
    ------
    ValueError
        If there is no sample, or one that is not finite.

    Examples
    --------
    >>> average([1.0, 3.0, 1.0, 3.0, 2.0]).value
    2.0
    """
    values = check.finite("samples", samples)
    if values.ndim not in (1, 2) or values.size == 0:
        raise ValueError(f"Argument `samples` must have shape (n,) or (n, m), but has shape {values.shape}.")
    error, time = standard_error(values.reshape(len(values), -1))
    return Average(float(values.mean()), error, values.size / (2 * time), time)


def standard_error(values: Array) -> tuple[float, float]:
    """Standard error of the mean of all `values` (T, M), and the integrated autocorrelation time in frames.

    Columns are independent runs of one length. Deviations are taken from the mean of all of them, so runs that stay apart
    look correlated for their whole length. The window is where `exp(-W/tau) - tau/sqrt(W T)` turns negative.
    """
    length, runs = values.shape
    count = values.size
    deviations = values - values.mean()
    if count < 4:
        return math.nan, 0.5
    spread = float((deviations**2).mean())
    if spread <= (1e-14 * float(np.abs(values).max())) ** 2:  # all alike: nothing left but rounding
        return 0.0, 0.5
    padded = fft.next_fast_len(2 * length, real=True)
    power = (np.abs(fft.rfft(deviations, n=padded, axis=0)) ** 2).sum(axis=1)
    covariance = fft.irfft(power, n=padded)[:length] / (runs * (length - np.arange(length)))
    correlation = covariance[1:] / covariance[0]
    window = _window(0.5 + np.cumsum(np.maximum(np.abs(correlation) - 1 / math.sqrt(count), 0.0)), count)
    time = 0.5 + float(correlation[:window].sum())
    # the mean that was subtracted takes its own variance out of every covariance
    time = max(time, 0.5 / (2 * window + 1)) * (1 + (2 * window + 1) / count)
    return math.sqrt(2 * time * spread / count), time


def _window(times: Array, count: int) -> int:
    """The window for integrated times (T - 1,) as they grow with it from 1 on, of `count` samples in all; 0 for T = 1."""
    if not len(times):
        return 0
    w = np.arange(1, len(times) + 1)
    with np.errstate(divide="ignore", over="ignore"):
        tau = np.where(times > 0.5, _RATIO / np.log1p(1 / np.maximum(times - 0.5, 1e-300)), 1e-10)
        falling = np.exp(-w / tau) - tau / np.sqrt(w * count)
    ends = np.flatnonzero(falling < 0)
    return int(w[ends[0]]) if len(ends) else len(times)
