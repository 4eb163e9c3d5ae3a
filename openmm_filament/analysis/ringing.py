"""Least-squares fit of decaying sinusoids that all columns of a recording share.

The model of column n is `c_n + Re sum_k A_kn exp((-d_k + 2 pi i f_k) t)`. `projection` eliminates A and c; what is solved
for here are the frequencies f and the decay rates d.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from openmm_filament import _checks as check
from openmm_filament.analysis.peaks import hann_transform, refine
from openmm_filament.analysis.projection import Problem
from openmm_filament.analysis.spectra import recording

__all__ = ["DampedSinusoids", "damped_sinusoids"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_CONDITION = 1e4
"""Condition number of the fit above which its lines are not told apart."""

_WANDER = 2.0
"""Resolutions plus line widths that a frequency may move from its guess."""


@dataclass(frozen=True, eq=False)
class DampedSinusoids:
    """A sum of decaying sinusoids, in the order of the guesses.

    Attributes
    ----------
    frequencies, frequency_errors : (K,) array
        Hz, and one standard error.
    decay_rates, decay_rate_errors : (K,) array
        1/s; zero where the fit was told that nothing decays.
    amplitudes : (K,) or (K, N) complex array
        Size and phase at the first sample, in the unit of the signal.
    offset : () or (N,) array
        The constant part of each column.
    residual : float
        Root-mean-square of what the fit leaves, per degree of freedom, in the unit of the signal. The errors take it for
        white noise, the same in every column: a line left out of the fit is not that.
    condition : float
        Condition number of the least-squares problem, its unknowns scaled alike: noise in nearly parallel directions is
        multiplied by it. Of order 1 where all lines are resolved.
    """

    frequencies: Array
    frequency_errors: Array
    decay_rates: Array
    decay_rate_errors: Array
    amplitudes: Complex
    offset: Array
    residual: float
    condition: float

    def at(self, times: ArrayLike) -> Array:
        """The fitted signal (T,) or (T, N) at `times` (T,) in seconds after the first sample."""
        t = check.shape("times", check.finite("times", times), (None,))
        rates = -self.decay_rates + 2j * np.pi * self.frequencies
        return np.asarray((np.exp(t[:, None] * rates) @ self.amplitudes).real + self.offset)


def damped_sinusoids(
    signal: ArrayLike,
    interval: float,
    frequencies: ArrayLike,
    *,
    decay_rates: ArrayLike | None = None,
    damped: bool = True,
) -> DampedSinusoids:
    """Fit decaying sinusoids to a signal (T,), or shared ones to the columns of (T, N).

    Parameters
    ----------
    signal : (T,) or (T, N) array
    interval : float
        Seconds between samples.
    frequencies : (K,) array
        Hz, guesses to within about half a resolution (one over the length of the recording) or half a line width
        `d/(2 pi)`: those of `lines`, or of theory with `lines(..., near=theory).frequencies` where the recording is long.
    decay_rates : (K,) array
        1/s, guesses; taken from the spectrum at the guessed frequencies if left out.
    damped : bool
        Whether the sinusoids decay; otherwise `decay_rates` are fixed at zero.

    Raises
    ------
    ValueError
        If a frequency is not positive and below half the sampling rate; if there are not more samples than unknowns
        (4 K + 1 in a column); if lines are so close for this length of recording that the fit is ill-conditioned; if a
        guess has no line near it, so that its frequency wanders off.
    RuntimeError
        If the fit does not converge.
    """
    values, step = recording(signal, interval)
    samples, duration = len(values), len(values) * step
    guesses = check.shape("frequencies", np.atleast_1d(check.finite("frequencies", frequencies)), (None,))
    check.within("frequencies", guesses, 0, 0.5 / step, open_ends=True, unit="Hz (half the sampling rate)")
    if samples < 4 * len(guesses) + 2:
        raise check.fail(
            "signal",
            f"have more samples than the {4 * len(guesses) + 1} unknowns of {len(guesses)} lines",
            f"{samples} samples long",
        )
    rates = _guessed_decay(values, duration, guesses, decay_rates, damped)
    start = np.concatenate([2 * np.pi * guesses * duration, rates * duration])
    mean = values.mean(axis=0)
    moving = values - mean
    size = float(np.sqrt(np.mean(moving**2)))
    if size == 0.0:
        raise check.fail("signal", "vary in time", "constant")
    problem = Problem(moving / size, len(guesses), damped)
    _refuse_ill_conditioned(problem.solve(start).condition, guesses, duration)
    fixed = start[len(guesses) :] if not damped else start[:0]
    result = optimize.least_squares(
        lambda x: problem.solve(np.append(x, fixed)).residual,
        start[: len(start) - len(fixed)],
        jac=lambda x: problem.solve(np.append(x, fixed)).jacobian,
        ftol=1e-13,
        xtol=1e-14,
        gtol=None,
    )
    if not result.success:
        raise RuntimeError(f"The fit of {len(guesses)} lines did not converge in {result.nfev} steps: {result.message}")
    found = np.append(result.x, fixed)
    return _report(problem, size, mean, found, guesses, duration, np.shape(signal)[1:])


def _guessed_decay(
    values: Array, duration: float, guesses: Array, decay_rates: ArrayLike | None, damped: bool
) -> Array:
    if decay_rates is not None:
        if not damped:
            raise ValueError("Argument `decay_rates` must be left out where `damped` is False, but is given.")
        return check.shape("decay_rates", np.atleast_1d(check.finite("decay_rates", decay_rates)), guesses.shape)
    if not damped:
        return np.zeros(len(guesses))
    bins = hann_transform(values)
    lower = np.clip((guesses * duration).astype(np.intp), 2, len(bins) - 2)
    places, _ = refine(bins, lower, len(values))
    return np.asarray(np.clip(2 * np.pi * places.imag, 0, len(values) / 4) / duration)


def _refuse_ill_conditioned(condition: float, frequencies: Array, duration: float) -> None:
    if condition < _CONDITION:
        return
    order = np.sort(frequencies)
    gaps = np.diff(order)
    i = int(np.argmin(gaps)) if len(gaps) else 0
    pair = (
        f"; {order[i]:.9g} and {order[i + 1]:.9g} Hz are {gaps[i] * duration:.3g} resolutions apart"
        if len(gaps)
        else ""
    )
    raise ValueError(
        f"Argument `frequencies` must be lines that {duration:g} s of signal tell apart (resolution {1 / duration:g} Hz), but "
        f"the fit has a condition number of {condition:.1e}{pair}."
    )


def _report(
    problem: Problem, size: float, mean: Array, found: Array, guesses: Array, duration: float, columns: tuple[int, ...]
) -> DampedSinusoids:
    """The result in the caller's units, with errors, unless a line has wandered off."""
    k = len(guesses)
    solution = problem.solve(found)
    frequencies, rates = found[:k] / (2 * np.pi * duration), found[k:] / duration
    _refuse_ill_conditioned(solution.condition, frequencies, duration)
    limit = _WANDER * (1 / duration + np.abs(rates) / (2 * np.pi))
    if (far := np.abs(frequencies - guesses) > limit).any():
        i = int(np.argmax(far))
        raise check.fail(
            "frequencies",
            f"lie within {limit[i]:g} Hz of a line",
            f"{guesses[i]:.9g} Hz at index {i}, from where the fit went to {frequencies[i]:.9g} Hz",
        )
    samples, width = problem.values.shape
    freedom = samples * width - (2 * k + 1) * width - solution.jacobian.shape[1]
    residual = float(np.linalg.norm(solution.residual) / np.sqrt(freedom))
    inverse = np.linalg.pinv(solution.jacobian)
    errors = np.zeros(2 * k)
    errors[: len(inverse)] = residual * np.linalg.norm(inverse, axis=1) / duration
    coefficients = solution.coefficients * size
    amplitudes = coefficients[:k] - 1j * coefficients[k : 2 * k]
    return DampedSinusoids(
        frequencies,
        errors[:k] / (2 * np.pi),
        rates,
        errors[k:],
        amplitudes.reshape(k, *columns),
        (mean + coefficients[2 * k]).reshape(columns),
        residual * size,
        solution.condition,
    )
