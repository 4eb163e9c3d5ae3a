"""Spectral lines: peaks of the Hann-windowed spectrum, refined beyond the bin.

The Hann-windowed transform of `exp(2 pi i lambda t/T)`, t = 0, 1, ..., T - 1, at the bin k is, with `u = lambda - k` and
`h = pi/T`, proportional to `cos(h u)/(sin(h u) sin(h (u - 1)) sin(h (u + 1)))`. The complex ratio of two neighbouring bins
therefore gives `lambda` in closed form, and with it frequency and decay: `lambda/(T interval) = f + i d/(2 pi)`. What the
other lines and the mirror images at negative frequencies leak into the two bins has the same form and is taken out by
iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from openmm_filament import _checks as check
from openmm_filament.analysis.spectra import recording

__all__ = ["Lines", "hann_transform", "lines", "refine"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_APART = 2.0
"""Resolutions between two lines that a Hann window shows as two peaks."""

_THRESHOLD = 0.01
"""Default height of the lowest line over that of the strongest."""

_ROUNDS = 40
"""Iterations of `refine`, which stops when no line moves: 3 to 10 are usual."""

_MANY, _FEWER_ROUNDS = 100, 12
"""More lines than this are mostly noise, which never comes to rest: fewer iterations."""

_HIGHEST = 10.0
"""Height of a line over its two bins above which it is cut down to that: a line stands near the larger of them."""

_MOST = 500
"""Lines that are refined together: each leaks into every other."""

_STEEPEST = (-40.0, 200.0)
"""Growth and decay over the recording, as exponents, beyond which a place says nothing of a line and is not taken. Noise
between two bins has any place; a real decay by exp(-200) is some 60 bins wide, and growth by exp(40) is 1e17."""


@dataclass(frozen=True, eq=False)
class Lines:
    """Spectral lines in the order of their frequencies.

    Attributes
    ----------
    frequencies : (K,) array
        Hz.
    decay_rates : (K,) array
        1/s, of `exp(-d t)`. An estimate to start a fit from; noise may make it negative.
    amplitudes : (K,) or (K, N) array
        Height of the line in the spectrum: the amplitude of a steady sinusoid, the windowed mean of a decaying one.
    resolution : float
        Hz, one over the length of the recording.
    """

    frequencies: Array
    decay_rates: Array
    amplitudes: Array
    resolution: float


def lines(
    signal: ArrayLike,
    interval: float,
    *,
    count: int | None = None,
    threshold: float | None = None,
    near: ArrayLike | None = None,
) -> Lines:
    """The lines of a signal (T,), or those that the columns of (T, N) share.

    Parameters
    ----------
    signal : (T,) or (T, N) array
        Peaks are those of the root-mean-square spectrum over the columns. The mean is removed.
    interval : float
        Seconds between samples.
    count : int
        The strongest `count` lines.
    threshold : float
        All lines of at least this part of the strongest; 0.01 if nothing else is asked for.
    near : (K,) array
        Hz: for each the strongest line about it, no further off than half the way to the next of them (for a single one:
        half its frequency).

    Raises
    ------
    ValueError
        If fewer lines are found than asked for, or none about one of `near`; if `near` is empty, two of it are closer than
        two resolutions, which a Hann window does not part, or one lies outside (2 resolutions, half the sampling rate); if
        the signal is constant; if more than 500 peaks are asked for, as a threshold below the noise does.
    TypeError
        If the signal is complex.

    Notes
    -----
    Steady or decaying sinusoids at least some four resolutions apart come out to rounding. Noise of standard deviation s
    moves a line of amplitude A by about `s/(A sqrt(T))` resolutions; for error bars use `damped_sinusoids`. Two lines closer
    than about two resolutions show as one, and a line decaying by far more than `exp(-10)` in noise may show as several.
    """
    if sum(choice is not None for choice in (count, threshold, near)) > 1:
        raise ValueError("Arguments `count`, `threshold` and `near` exclude one another, but more than one is given.")
    values, step = recording(signal, interval)
    resolution = 1 / (len(values) * step)
    if not (np.ptp(values, axis=0) > 0).any():
        raise check.fail("signal", "vary in time", "constant")
    bins = hann_transform(values)
    height = np.sqrt(np.mean(np.abs(bins) ** 2, axis=1))
    peaks = 1 + np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:]))
    height[:2] = 0.0  # what is left of the mean
    peaks = peaks[(peaks >= 2) & (peaks <= len(height) - 3)]
    if near is not None:
        chosen = _nearest(check.finite("near", near), peaks, height, resolution, 0.5 / step)
    elif count is not None:
        chosen = _strongest(check.integer("count", count, low=1), peaks, height, resolution)
    else:
        least = _THRESHOLD if threshold is None else float(check.within("threshold", threshold, 0, 1))
        chosen = peaks[height[peaks] >= least * height[peaks].max(initial=0.0)]
    if len(chosen) > _MOST:
        asked = "near" if near is not None else "threshold" if count is None else "count"
        raise check.fail(
            asked,
            f"ask for at most {_MOST} lines (a higher `threshold`, or a `count`, leaves out the noise)",
            f"met by {len(chosen)} peaks",
        )
    lower = np.where((height[chosen + 1] >= height[chosen - 1]) | (chosen == 2), chosen, chosen - 1)
    places, heights = refine(bins, lower, len(values))
    order = np.argsort(places.real)
    return Lines(
        places.real[order] * resolution,
        2 * np.pi * places.imag[order] * resolution,
        heights[order].reshape(len(order), *np.shape(signal)[1:]),
        resolution,
    )


def _strongest(count: int, peaks: NDArray[np.intp], height: Array, resolution: float) -> NDArray[np.intp]:
    if len(peaks) < count:
        raise check.fail(
            "count", f"not exceed the {len(peaks)} peaks of a spectrum with a resolution of {resolution:g} Hz", count
        )
    return np.sort(peaks[np.argsort(height[peaks])[::-1][:count]])


def _nearest(
    near: Array, peaks: NDArray[np.intp], height: Array, resolution: float, nyquist: float
) -> NDArray[np.intp]:
    """The strongest peak about each of the frequencies `near`."""
    wanted = check.shape("near", np.atleast_1d(near), (None,))
    if not len(wanted):
        raise ValueError("Argument `near` must hold at least one frequency, but is empty.")
    wanted = np.sort(check.within("near", wanted, 2 * resolution, nyquist, open_ends=True, unit="Hz"))
    gaps = np.diff(wanted)
    if len(gaps) and gaps.min() < _APART * resolution:
        i = int(np.argmin(gaps))
        raise ValueError(
            f"Argument `near` must have lines at least {_APART * resolution:g} Hz apart, two resolutions of a recording of "
            f"{1 / resolution:g} s, but {wanted[i]:g} and {wanted[i + 1]:g} Hz are {gaps[i]:g} Hz apart."
        )
    inner = gaps / 2 if len(gaps) else wanted / 2
    below, above = np.append(inner[:1], inner)[: len(wanted)], np.append(inner, inner[-1:])[: len(wanted)]
    chosen = []
    for frequency, down, up in zip(wanted, below, above, strict=True):
        low, high = frequency - down, frequency + up
        about = peaks[(peaks * resolution > low) & (peaks * resolution < high)]
        if not len(about):
            raise ValueError(
                "Argument `near` must hold frequencies with a line no further off than half the way to the next of them, but "
                f"{frequency:g} Hz has none from {low:g} to {high:g} Hz."
            )
        chosen.append(about[np.argmax(height[about])])
    return np.array(chosen)


def hann_transform(values: Array) -> Complex:
    """Complex Hann-windowed spectrum (F, N) of columns (T, N) less their mean; a sinusoid on a bin gives its amplitude."""
    samples = len(values)
    window = np.sin(np.pi * np.arange(samples) / samples) ** 2
    bins: Complex = fft.rfft(window[:, None] * (values - values.mean(axis=0)), axis=0)
    return bins * (4 / samples)


def _hann(u: Complex, samples: int) -> Complex:
    """Hann-windowed transform of a unit exponential, `u` bins from the place where it is taken, over the window's sum."""
    h = np.pi / samples
    whole = np.round(u.real)
    nearby = (np.abs(whole) <= 1) & (np.abs(u - whole) < 1e-12)
    u = np.where(nearby, whole + 1e-12 * (1 - 1j), u)  # 0/0 at -1, 0 and 1
    rest = np.where(nearby, 1e-12 * (1 - 1j), u - whole)
    a = h * u
    near = [h * np.where(whole == n, rest, u - n) for n in (-1, 0, 1)]
    product = np.sin(near[0]) * np.sin(near[1]) * np.sin(near[2])
    transform: Complex = 1j * np.expm1(2j * np.pi * rest) * np.sin(h) ** 2 * np.cos(a) / (2 * samples * product)
    return transform


def _place(ratio: Complex, samples: int) -> Complex:
    """How many bins above the lower of two bins the exponential stands whose transforms there have this ratio."""
    h = np.pi / samples
    p, s = ratio * np.cos(2 * h) - 1, np.sin(2 * h)
    root = np.sqrt(p**2 - s**2 * (2 * ratio + 1) + 0j)
    root = np.where((root * p.conj()).real < 0, -root, root)
    place: Complex = np.arctan((2 * ratio + 1) * s / (p + root)) / h
    return place


def refine(bins: Complex, lower: NDArray[np.intp], samples: int) -> tuple[Complex, Array]:
    """Places (K,) in bins (imaginary part: decay) and heights (K, N) of lines.

    `bins` is the Hann transform (F, N); line k stands between or about the bins `lower[k]` and `lower[k] + 1`. A line
    whose two bins give no place there, or one of a growth or decay that no recording shows, keeps the place it had, at
    first the middle between them.
    """
    pair = lower[:, None] + np.arange(2)  # (K, 2)
    seen = bins[pair]  # (K, 2, N)
    leaked = np.zeros_like(seen)
    tiny = np.finfo(float).tiny
    places = np.zeros(len(lower), dtype=complex)
    amplitudes = np.zeros((len(lower), bins.shape[1]), dtype=complex)
    most = _HIGHEST * np.sqrt(np.max(np.sum(np.abs(seen) ** 2, axis=2), axis=1))
    own = np.eye(len(lower), dtype=bool)[:, None, :]
    for round_ in range(_ROUNDS if len(lower) <= _MANY else _FEWER_ROUNDS):
        clean = seen - leaked
        power = np.sum(np.abs(clean[:, 0]) ** 2, axis=1)
        ratio = np.sum(clean[:, 0].conj() * clean[:, 1], axis=1) / np.maximum(power, tiny)
        with np.errstate(all="ignore"):
            u = _place(ratio, samples)
        steep = 2 * np.pi * u.imag
        good = np.isfinite(u) & (u.real > -1) & (u.real < 2) & (power > 0)
        good &= (steep > _STEEPEST[0]) & (steep < _STEEPEST[1])
        moved = np.where(good, lower + u, places if round_ else lower + 0.5)
        shapes = _hann(moved[:, None] - pair, samples)  # (K, 2)
        amplitudes = np.sum(shapes.conj()[:, :, None] * clean, axis=1) / np.sum(np.abs(shapes) ** 2, axis=1)[:, None]
        height = np.linalg.norm(amplitudes * _hann(1j * moved.imag, samples)[:, None], axis=1)
        amplitudes *= np.minimum(1.0, most / np.maximum(height, tiny))[:, None]
        still = round_ > 0 and np.abs(moved - places).max(initial=0.0) < 1e-12
        places = moved
        if still:
            break
        others = np.where(own, 0.0, _hann(places[None, None, :] - pair[:, :, None], samples))
        images = _hann(-places.conj()[None, None, :] - pair[:, :, None], samples)
        leaked = others @ amplitudes + images @ amplitudes.conj()
    return places, np.abs(amplitudes * _hann(1j * places.imag, samples)[:, None])
