"""The sound of a motion: a recorded displacement as a WAV file, and the file's pitch."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from openmm import unit
from scipy import ndimage
from scipy import signal as dsp
from scipy.io import wavfile

from openmm_filament import _checks as check
from openmm_filament import units
from openmm_filament.analysis import lines, spectrum

__all__ = ["RATE", "Sound", "strongest_line", "write_wav"]

Array = NDArray[np.float64]

RATE = 44_100
"""Samples per second of a file."""

AUDIBLE = (20.0, 20_000.0)
"""Hz, what an ear may hear."""

_FAINT = 1e-3
"""Strongest audible line over the strongest of all below which a motion is refused as inaudible (-60 dB)."""

_PEAK = 10 ** (-1 / 20) * 32767
"""Largest sample written: 1 dB below full scale."""

_FADE = 0.005
"""Seconds of the raised cosine at either end."""

_STOP, _TRANSITION = 100.0, 0.09
"""The filter: dB of attenuation above the lower of the two Nyquist frequencies, and the part of that below it where the
filter falls: sound up to 20 kHz passes whole."""

_OVERSAMPLING = 8
"""Least rate from which a spline reads the samples, over the file's."""

_SILENCE = 1e-12
"""Motion over the largest value of the signal below which it is rounding."""


@dataclass(frozen=True)
class Sound:
    """What was written.

    Attributes
    ----------
    path : Path
    seconds : float
        Length of the file.
    speed : float
        Frequencies in the file over those of the motion.
    """

    path: Path
    seconds: float
    speed: float


def write_wav(
    path: str | os.PathLike[str],
    signal: Any,
    interval: unit.Quantity,
    *,
    seconds: float = 2.0,
    speed: float = 1.0,
    overwrite: bool = False,
) -> Sound:
    """Write the first `seconds` of a motion as a WAV file: 44.1 kHz, 16 bit, mono.

    The mean is removed, what lies above 20 kHz or half the recording's own rate is filtered out before resampling (100 dB
    down), the loudest sample stands 1 dB below full scale, and 5 ms at either end are faded. Nothing is repeated or added.

    Parameters
    ----------
    path : path
        Ends in .wav.
    signal : (T,) array or Quantity
        Displacement of a bead, the sum over beads, or anything that moves; its unit does not matter.
    interval : Quantity
        Time between samples.
    seconds : float
        Length of the file, at least 0.1; the recording must last as long.
    speed : float
        How many times faster the motion is played, which multiplies all frequencies: 0.001 makes 440 kHz heard as 440 Hz and
        takes 0.002 s of motion for 2 s of sound.
    overwrite : bool
        Whether a file that exists may be replaced.

    Raises
    ------
    ValueError
        If the recording, played at this speed, is shorter than `seconds`; if its audible lines (20 Hz to 20 kHz as played)
        are 60 dB below its strongest one, with a speed that would make that heard; if the interval, as played, is so long
        that nothing could be heard; if the signal is constant (or moves by less than 1e-295), not finite
        or not one column; if `path` does not end in .wav.
    TypeError
        If `interval` is no time.
    FileExistsError, FileNotFoundError
        If the file exists and may not be replaced; if its folder does not exist.
    """
    file = _checked_path(path, overwrite)
    values, step = _motion(signal), units.number("interval", interval, "time") * 1e-12
    check.positive("interval", step, unit="s")
    speed = float(check.shape("speed", check.positive("speed", speed), ()))
    if (played := step / speed) > (longest := 0.5 / AUDIBLE[0]):
        raise check.fail("interval", f"be below {longest * speed:g} s to sound at speed {speed:g}", f"{step:g} s")
    length = float(check.shape("seconds", check.within("seconds", seconds, 0.1, 3600.0, unit="s"), ()))
    if (whole := len(values) * played) < length * (1 - 1e-9):
        raise check.fail(
            "seconds",
            f"not exceed the recording, {len(values) * step:g} s played at speed {speed:g} in {whole:g} s",
            f"{length:g} s (the default is 2 s): record for longer, "
            + (
                f"pass seconds={math.floor(1000 * whole) / 1000:g}, or play it slower"
                if whole >= 0.1
                else "or play it slower"
            )
            + f", speed={speed * whole / length:.3g} or less",
        )
    values = values[: int(np.ceil(length / played * (1 + 1e-9))) + 1]
    values = values - values.mean()
    _refuse_inaudible(values, played, speed)
    samples = _resampled(values, played, round(length * RATE))
    fade = np.sin(np.linspace(0, np.pi / 2, round(_FADE * RATE))) ** 2
    samples[: len(fade)] *= fade
    samples[-len(fade) :] *= fade[::-1]
    samples *= _PEAK / np.abs(samples).max()
    wavfile.write(file, RATE, np.round(samples).astype(np.int16))
    return Sound(file, len(samples) / RATE, speed)


def strongest_line(path: str | os.PathLike[str]) -> float:
    """Frequency in Hz of the strongest line of a mono WAV file, refined beyond the bin.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is no WAV file, has several channels, or is silent.
    """
    rate, samples = wavfile.read(path)
    check.shape("path", samples, (None,))
    return float(lines(samples, 1 / rate, count=1).frequencies[0])


def _checked_path(path: str | os.PathLike[str], overwrite: bool) -> Path:
    file = Path(path)
    if file.suffix.lower() != ".wav":
        raise check.fail("path", "end in .wav", str(path))
    if not file.parent.is_dir():
        raise FileNotFoundError(f"Argument `path` must lie in a folder that exists, but {path} does not.")
    if file.exists() and not overwrite:
        raise FileExistsError(
            f"Argument `path` must not name an existing file, but {file} exists: pass overwrite=True."
        )
    return file


def _motion(signal: Any) -> Array:
    """The signal (T,) as numbers, checked to move."""
    numbers = (
        units.numbers("signal", signal, units.dimension_of("signal", signal)) if unit.is_quantity(signal) else signal
    )
    values = check.shape("signal", check.finite("signal", numbers), (None,))
    if len(values) < 16:
        raise check.fail("signal", "have at least 16 samples", f"{len(values)} samples long")
    largest = np.abs(values).max()
    if np.ptp(values) <= max(_SILENCE * largest, np.finfo(np.float64).tiny / _SILENCE):
        raise check.fail("signal", "move", f"silent: {values[0]:g} throughout, or within {np.ptp(values):.3g} of it")
    return values


def _refuse_inaudible(values: Array, played: float, speed: float) -> None:
    """Raise if hardly anything of the motion can be heard."""
    found = spectrum(values, played)
    heard = (found.frequencies >= AUDIBLE[0]) & (found.frequencies <= AUDIBLE[1])
    loudest = int(np.argmax(found.amplitudes))
    if found.amplitudes[heard].max(initial=0.0) < _FAINT * found.amplitudes[loudest]:
        line = found.frequencies[loudest]
        raise check.fail(
            "speed",
            f"bring the motion between 20 Hz and 20 kHz (such as {speed * 440 / line:.3g}, for 440 Hz)",
            f"{speed:g}, which plays its strongest line at {line:g} Hz",
        )


def _resampled(values: Array, played: float, count: int) -> Array:
    """`count` samples at 44.1 kHz, free of what lies above half of either rate.

    A steep filter, with whole-number oversampling where the recording is coarse, then a quintic spline: the ratio of the
    rates may be any number, and the spline, at eight times 44.1 kHz or more, is off by less than 1e-6 at 20 kHz.
    """
    up = max(1, int(np.ceil(_OVERSAMPLING * RATE * played)))
    wider = up * max(1.0, 1 / (RATE * played))
    taps, beta = dsp.kaiserord(_STOP, _TRANSITION / wider)
    kernel = dsp.firwin(2 * (taps // 2) + 1, (1 - _TRANSITION / 2) / wider, window=("kaiser", beta))
    stuffed = np.zeros(up * len(values))
    stuffed[::up] = up * values
    fine = dsp.oaconvolve(stuffed, kernel)[len(kernel) // 2 :][: len(stuffed)]
    places = np.arange(count) * (up / (RATE * played))
    return np.asarray(ndimage.map_coordinates(fine, places[None], order=5, mode="mirror"))
