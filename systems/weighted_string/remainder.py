"""What the exact modes leave of the sound, and the energy: how far the motion is from the linear one that they are exact for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from openmm_filament import analysis
from systems import conservation
from systems.conservation import Drift
from systems.guitar_string.steady import plucked
from systems.scene import Check
from systems.strings import Pluck
from systems.weighted_string import chain
from systems.weighted_string.chain import LINES, Case, Modes

__all__ = ["Causes", "Kept", "Remainder", "causes", "checks", "energy", "findings", "remainder"]

Array = NDArray[np.float64]

LEFT = 2e-3
"""What the exact modes may leave of a spectrum, over its strongest line. Measured: at most 6e-4, in 30 segments; with one
per cent more tension 0.9."""

BETWEEN = 1e-5
"""What may stand between the lines of (c). At 24,000 samples a second folded modes of 210 segments stood there with 1.1e-4."""

WEAKER = 4.0
"""How many times weaker the second pluck is that shows what is not linear."""

_HIGHEST = 1.25
"""Modes up to this much above the last line asked for take part: those above it reach down through the window's skirts."""

_AWAY = 12.0
"""Hz from every exact line, which is between the lines."""

_SKIRT = 1e-5
"""Threshold of the peaks that are counted, over the strongest line."""


@dataclass(frozen=True, eq=False)
class Remainder:
    """What is left of a sound's spectrum without its exact modes.

    Attributes
    ----------
    name : str
        Of the case.
    frequencies, amplitudes : (F,) arrays
        Hz, up to the last line, and over the strongest line of the sound.
    largest, between : float
        The largest of them, and that at least 12 Hz from every exact line.
    sound_between, exact_between : float
        What the sound and the exact modes have there, over the strongest line: the skirts of lines that decay.
    peaks, exact_peaks : int
        Maxima above 1e-5 in the spectra of the sound and of the exact modes, up to the last line.
    """

    name: str
    frequencies: Array
    amplitudes: Array
    largest: float
    between: float
    sound_between: float
    exact_between: float
    peaks: int
    exact_peaks: int


def remainder(name: str, sound: Array, rate: float, modes: Modes) -> Remainder:
    """Take the exact modes out of a sound (T,), with their frequencies and decay in its time steps: amplitudes alone are fitted.

    Parameters
    ----------
    name : str
        Of the case.
    rate : float
        Samples a second.
    """
    f, rates = modes.stepped, modes.stepped_rates
    top = float(f[LINES - 1])
    chosen = f <= _HIGHEST * top
    times = np.arange(len(sound)) / rate
    waves = np.exp((2j * np.pi * f[chosen] - rates[chosen]) * times[:, None])
    window = np.hanning(len(times) + 1)[:-1]
    bins = np.fft.rfftfreq(len(times), 1 / rate) <= (1 + _HIGHEST) / 2 * top

    def seen(values: Array) -> NDArray[np.complex128]:
        return np.asarray(np.fft.rfft(window[:, None] * values.reshape(len(times), -1), axis=0)[bins])

    table = np.hstack([seen(waves.real), seen(waves.imag), seen(np.ones(len(times)))])
    wanted = seen(sound)[:, 0]
    parts = np.linalg.lstsq(
        np.vstack([table.real, table.imag]), np.concatenate([wanted.real, wanted.imag]), rcond=None
    )[0]
    exact = np.hstack([waves.real, waves.imag, np.ones((len(times), 1))]) @ parts
    heard, modal, left = (analysis.spectrum(signal, 1 / rate) for signal in (sound, exact, sound - exact))
    shown = (heard.frequencies > 20) & (heard.frequencies <= 1.03 * top)
    strongest = heard.amplitudes[shown].max()
    away = np.abs(heard.frequencies[shown, None] - f).min(axis=1) > _AWAY
    heights = [spectrum.amplitudes[shown] / strongest for spectrum in (heard, modal, left)]
    between = [float(height[away].max()) for height in heights]
    peaks = [_peaks(height) for height in heights[:2]]
    return Remainder(
        name,
        heard.frequencies[shown],
        heights[2],
        float(heights[2].max()),
        between[2],
        between[0],
        between[1],
        peaks[0],
        peaks[1],
    )


def _peaks(height: Array) -> int:
    """How many maxima a spectrum has above `_SKIRT`."""
    inner = height[1:-1]
    return int(((inner > height[:-2]) & (inner >= height[2:]) & (inner >= _SKIRT)).sum())


@dataclass(frozen=True, eq=False)
class Causes:
    """What is left of the sound of a coarse string as plucked, plucked more weakly, and as plucked with the default form."""

    as_plucked: Remainder
    weaker: Remainder
    default: Remainder

    @property
    def power(self) -> float:
        """Power of the pluck with which what is left grows, over the line itself."""
        return float(np.log(self.as_plucked.largest / self.weaker.largest) / np.log(WEAKER))


def causes(case: Case, segments: int = 30, rate: float = 6_000, every: int = 8) -> Causes:
    """Three short runs: the pluck as it is and `WEAKER` times weaker in the form "arctangent", and as it is in the other."""
    runs = []
    for weaker, form in ((1.0, "arctangent"), (WEAKER, "arctangent"), (1.0, "arccosine")):
        sound, modes = chain.sounding(case, segments, 2.02, rate, every, weaker=weaker, form=form)  # type: ignore[arg-type]
        runs.append(remainder(case.name, sound, rate, modes))
    return Causes(*runs)


@dataclass(frozen=True)
class Kept:
    """Energy of the undamped string of so many segments in both forms of bending, and its largest bend in rad at the end."""

    name: str
    segments: int
    exact: Drift
    default: Drift
    bend: float


def energy(case: Case, segments: int, length: int) -> Kept:
    """The energy of a case without damping, plucked with 0.01 N near L/4."""
    pluck = [Pluck(round(segments / 4), 0.01)]
    heavy = case.factors(segments)
    exact, bend, _ = plucked(pluck, segments, length, form="arctangent", heavy=heavy)
    default, *_ = plucked(pluck, segments, length, heavy=heavy)
    return Kept(case.name, segments, exact, default, bend)


def checks(leftovers: Sequence[Remainder], why: Causes, kept: Kept) -> list[Check]:
    """That nothing is in the spectra but the exact modes and what is of third order in the pluck, and that energy stays."""
    return [
        *(
            Check(
                f"({left.name}) largest that the exact modes leave of the spectrum, over its strongest line",
                "exact",
                left.largest,
                0.0,
                left.largest,
                LEFT,
            )
            for left in leftovers
        ),
        Check(
            f"(c) largest {_AWAY:.0f} Hz or more from every exact line, without the skirts of these, over the strongest line",
            "exact",
            leftovers[-1].between,
            0.0,
            leftovers[-1].between,
            BETWEEN,
        ),
        Check(
            "(c) power of the pluck in what they leave, over the strongest line, 30 segments",
            "exact",
            why.power,
            2.0,
            abs(why.power - 2.0),
            0.2,
        ),
        conservation.check_drift(
            kept.exact, f"({kept.name}) {kept.segments} segments, 0.01 N, bending by arctangent: "
        ),
    ]


def findings(leftovers: Sequence[Remainder], why: Causes, kept: Kept) -> list[str]:
    """What stands between the lines, and the slopes."""
    c = leftovers[-1]
    more = why.default.peaks - why.as_plucked.peaks
    return [
        "Of the spectrum of 2 s of sound the exact modes, of fitted amplitude alone, leave at most "
        + ", ".join(f"{left.largest:.1e} in ({left.name})" for left in leftovers)
        + " of the strongest line.",
        f"(c) The spectrum has {c.peaks} maxima above {_SKIRT:g} of the strongest up to the last of {LINES} lines, that of the "
        f"exact modes alone {c.exact_peaks}. {_AWAY:.0f} Hz or more from every line the sound has at most "
        f"{c.sound_between:.1e} of the strongest, skirts of lines that decay, the exact modes {c.exact_between:.1e}, and what is "
        f"neither {c.between:.1e}: there are no other lines.",
        f"(c) With the default form of bending it has {why.default.peaks} maxima, where that by arctangent has "
        f"{why.as_plucked.peaks} and the exact modes {why.as_plucked.exact_peaks} (30 segments), and the exact modes leave "
        f"{why.default.largest:.1e} instead of {why.as_plucked.largest:.1e}: {max(more, 0)} weak peaks are there "
        "OpenMM's arccosine, which disturbs the tiny bends that hard damping leaves.",
        f"(c) What the modes leave of that by arctangent grows with the power {why.power:.2f} of the pluck, over the line itself "
        f"({WEAKER:.0f} times weaker it is {why.weaker.largest:.1e}, 30 segments): it is of third order in the amplitude, from the "
        "stretching that both directions of motion share.",
        f"Undamped, at a tenth of the stability limit, ({kept.name}) in {kept.segments} segments (bends up to {kept.bend:.1e} rad) "
        f"changes the energy of its motion by {kept.exact} of it in 10^6 steps with bending by arctangent and by {kept.default} "
        f"with the default form ({kept.exact.length} steps).",
    ]
