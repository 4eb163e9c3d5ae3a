"""Pitch and strength of a signal against time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from openmm_filament import _checks as check
from openmm_filament.analysis.peaks import hann_transform, refine
from openmm_filament.analysis.spectra import recording

__all__ = ["Pitch", "instantaneous_pitch"]

Array = NDArray[np.float64]

_OVERLAP = 4
"""Windows that cover each moment: the Hann window is narrower than its length."""

_ROUNDING = 16 * np.finfo(np.float64).eps
"""Variation over the largest value up to which a stretch is constant: the mean of equal numbers is off by this much."""


@dataclass(frozen=True, eq=False)
class Pitch:
    """The strongest line of each stretch of a signal.

    Attributes
    ----------
    times : (W,) array
        Seconds from the first sample to the middle of the stretch.
    frequencies : (W,) array
        Hz.
    amplitudes : (W,) array
        The line's mean amplitude in the stretch, in the unit of the signal: its envelope.
    """

    times: Array
    frequencies: Array
    amplitudes: Array


def instantaneous_pitch(
    signal: ArrayLike, interval: float, window_seconds: float, *, band: tuple[float, float] | None = None
) -> Pitch:
    """The pitch of a signal (T,) against time: the strongest line of each window, refined beyond the bin.

    Parameters
    ----------
    signal : (T,) array
    interval : float
        Seconds between samples.
    window_seconds : float
        Length of the Hann windows, which follow one another by a quarter of it. Other lines must be some four times
        `1/window_seconds` away. The mean of a gliding pitch over the window is returned.
    band : (float, float)
        Hz, where to look for the line; anywhere from two periods a window to half the sampling rate if left out.

    Raises
    ------
    ValueError
        If the window holds fewer than 16 samples or is longer than the signal; if the band lies outside (2/window_seconds,
        half the sampling rate), is empty, or holds no bin; if the signal is constant in a window
        but for rounding.
    TypeError
        If the signal is complex.
    """
    values, step = recording(signal, interval)
    check.shape("signal", np.asarray(signal, dtype=np.float64), (None,))
    width = round(float(check.positive("window_seconds", window_seconds, unit="s")) / step)
    if not 16 <= width <= len(values):
        raise check.fail(
            "window_seconds",
            f"lie in [{16 * step:g}, {len(values) * step:g}] s, 16 samples to the whole signal",
            f"{window_seconds} s",
        )
    resolution = 1 / (width * step)
    low, high = (2 * resolution, 0.5 / step) if band is None else band
    check.within("band", [low, high], 2 * resolution * (1 - 1e-12), 0.5 / step, unit="Hz")
    first, last = int(np.ceil(low / resolution - 1e-9)), min(int(high / resolution + 1e-9), width // 2 - 2)
    if last < first:
        raise check.fail("band", f"hold a multiple of the resolution, {resolution:g} Hz", f"({low:g}, {high:g}) Hz")
    starts = np.arange(0, len(values) - width + 1, max(1, width // _OVERLAP))
    lines = [_strongest(values[start : start + width], first, last) for start in starts]
    places, heights = np.array(lines, dtype=np.float64).T
    if not heights.all():
        raise check.fail("signal", "vary in each window", f"constant from {starts[np.argmin(heights)] * step:g} s on")
    return Pitch(np.asarray(step * (starts + (width - 1) / 2), dtype=np.float64), places * resolution, heights)


def _strongest(values: Array, first: int, last: int) -> tuple[float, float]:
    """Place in bins and height of the strongest line among the bins from `first` to `last`."""
    bins = hann_transform(values)
    sizes = np.abs(bins[:, 0])
    peak = first + int(np.argmax(sizes[first : last + 1]))
    if sizes[peak] == 0.0 or np.ptp(values) <= _ROUNDING * np.abs(values).max():
        return float(peak), 0.0
    lower = peak if sizes[peak + 1] >= sizes[peak - 1] or peak == 2 else peak - 1
    places, heights = refine(bins, np.array([lower]), len(values))
    return float(places.real[0]), float(heights[0, 0])
