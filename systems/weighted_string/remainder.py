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
from systems.weighted_string.chain import LINES, Case, Playing

__all__ = ["Kept", "Remainder", "amplitudes", "checks", "energy", "findings", "remainder"]

Array = NDArray[np.float64]

LEFT = 2e-3
"""What the exact modes may leave of a spectrum, over its strongest line. Measured: 4e-4 or less; with 1 % more tension 0.9."""

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


def remainder(run: Playing) -> Remainder:
    """Take out the exact modes with their exact frequencies and decay in these time steps; only amplitudes are fitted."""
    f, rates = run.modes.stepped, run.modes.stepped_rates
    top = float(f[LINES - 1])
    chosen = f <= _HIGHEST * top
    times = np.arange(len(run.sound)) / run.rate
    waves = np.exp((2j * np.pi * f[chosen] - rates[chosen]) * times[:, None])
    window = np.hanning(len(times) + 1)[:-1]
    bins = np.fft.rfftfreq(len(times), 1 / run.rate) <= (1 + _HIGHEST) / 2 * top

    def seen(values: Array) -> NDArray[np.complex128]:
        return np.asarray(np.fft.rfft(window[:, None] * values.reshape(len(times), -1), axis=0)[bins])

    table = np.hstack([seen(waves.real), seen(waves.imag), seen(np.ones(len(times)))])
    wanted = seen(run.sound)[:, 0]
    parts = np.linalg.lstsq(
        np.vstack([table.real, table.imag]), np.concatenate([wanted.real, wanted.imag]), rcond=None
    )[0]
    exact = np.hstack([waves.real, waves.imag, np.ones((len(times), 1))]) @ parts
    sound, modes, left = (analysis.spectrum(signal, 1 / run.rate) for signal in (run.sound, exact, run.sound - exact))
    shown = (sound.frequencies > 20) & (sound.frequencies <= 1.03 * top)
    strongest = sound.amplitudes[shown].max()
    away = np.abs(sound.frequencies[shown, None] - f).min(axis=1) > _AWAY
    heights = [spectrum.amplitudes[shown] / strongest for spectrum in (sound, modes, left)]
    between = [float(height[away].max()) for height in heights]
    peaks = [_peaks(height) for height in heights[:2]]
    return Remainder(
        run.case.name,
        sound.frequencies[shown],
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


def amplitudes(case: Case, segments: int = 30) -> tuple[Remainder, Remainder]:
    """What is left of the sound of a coarse string as plucked, and plucked `WEAKER` times more weakly."""
    as_plucked, weaker = (
        remainder(chain.play(case, segments, 2.02, 6_000, 8, weaker=factor)) for factor in (1.0, WEAKER)
    )
    return as_plucked, weaker


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
    exact, bend = plucked(pluck, segments, length, form="arctangent", heavy=heavy)
    default, _ = plucked(pluck, segments, length, heavy=heavy)
    return Kept(case.name, segments, exact, default, bend)


def _power(weak: tuple[Remainder, Remainder]) -> float:
    """Power of the pluck with which what is left grows, over the line itself."""
    return float(np.log(weak[0].largest / weak[1].largest) / np.log(WEAKER))


def checks(leftovers: Sequence[Remainder], weak: tuple[Remainder, Remainder], kept: Kept) -> list[Check]:
    """That nothing is in the spectra but the exact modes and what is of third order in the pluck, and that energy stays."""
    power = _power(weak)
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
            "(c) power of the pluck in what they leave, over the strongest line, 30 segments",
            "exact",
            power,
            2.0,
            abs(power - 2.0),
            0.2,
        ),
        conservation.check_drift(
            kept.exact, f"({kept.name}) {kept.segments} segments, 0.01 N, bending by arctangent: "
        ),
    ]


def findings(leftovers: Sequence[Remainder], weak: tuple[Remainder, Remainder], kept: Kept) -> list[str]:
    """What stands between the lines, and the slopes."""
    c = leftovers[-1]
    return [
        "Of the spectrum of 2 s of sound the exact modes, of fitted amplitude alone, leave at most "
        + ", ".join(f"{left.largest:.1e} in ({left.name})" for left in leftovers)
        + " of the strongest line.",
        f"(c) Between its {LINES} lines the spectrum has {c.peaks} maxima above {_SKIRT:g} of the strongest, that of the exact "
        f"modes alone {c.exact_peaks}: ripples on the skirts of lines that decay. {_AWAY:.0f} Hz or more from every line "
        f"the sound has at most {c.sound_between:.1e} of the strongest, the exact modes {c.exact_between:.1e}, and what is "
        f"neither {c.between:.1e}.",
        f"(c) What the modes leave grows with the power {_power(weak):.2f} of the pluck, over the line itself: it is "
        f"{weak[0].largest:.1e} and, plucked {WEAKER:.0f} times more weakly, {weak[1].largest:.1e} with 30 segments, of third "
        "order in the amplitude, from the stretching that both directions of motion share.",
        f"Undamped, at a tenth of the stability limit, ({kept.name}) in {kept.segments} segments (bends up to {kept.bend:.1e} rad) "
        f"changes the energy of its motion by {kept.exact} of it in 10^6 steps with bending by arctangent and by {kept.default} "
        f"with the default form ({kept.exact.length} steps).",
    ]
