"""What the guitar string is held against, and what is found."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from openmm_filament import analysis
from systems import strings
from systems.guitar_string import hard, soft
from systems.scene import Check

__all__ = ["checks", "findings"]

Array = NDArray[np.float64]


def _worst(name: str, found: Array, exact: Array, tolerance: float, numbers: Array) -> Check:
    """The largest relative error among lines."""
    error = np.abs(found / exact - 1)
    i = int(np.argmax(error))
    return Check(f"{name} (worst: n = {numbers[i]})", "exact", found[i], exact[i], float(error[i]), tolerance)


def checks(
    recording: soft.Recording,
    found: soft.Harmonics,
    softness: soft.Softness,
    motion: hard.HardPluck,
    heard: float,
    pitch: float,
) -> list[Check]:
    """Simulated motion against exact answers, and the thesis's statements."""
    n = np.arange(1, soft.HARMONICS + 1)
    undamped = strings.discrete_law(n, soft.SEGMENTS)
    exact = strings.beats(undamped, strings.DAMPING)
    stepped = strings.beats(undamped, strings.DAMPING, recording.timestep)
    modes = soft.transverse(recording.model)[: soft.HARMONICS]
    odd = n[::2]
    summed = analysis.lines(
        recording.sums[recording.played :, 0], 1 / recording.rate, near=exact.frequencies[::2]
    ).frequencies
    weights = soft.amplitudes(undamped)
    departure = float(100 * (found.frequencies[-1, 0] / (soft.HARMONICS * found.frequencies[0, 0]) - 1))
    rows = [_worst("normal modes of the model, against the discrete law", modes, undamped, 1e-9, n)]
    for column, bead in enumerate(soft.BEADS):
        seen = found.frequencies[:, column]
        rows += [
            _worst(f"lines 1 to 20, plucked at bead {bead}, exact discrete string", seen, exact.frequencies, 1e-4, n),
            _worst(f"lines 1 to 20, bead {bead}, exact discrete string in time steps", seen, stepped.frequencies, 2e-6, n),
            _worst(
                f"decay times 1 to 20, plucked at bead {bead}", found.decay_times[:, column], 1 / exact.decay_rates, 1e-2, n
            ),
            Check(
                f"amplitudes 1 to 20, plucked at bead {bead}: largest error over the largest amplitude",
                "exact",
                float(found.amplitudes[:, column].max()),
                float(weights[:, column].max()),
                float(np.abs(found.amplitudes[:, column] - weights[:, column]).max() / weights[:, column].max()),
                5e-3,
            ),
        ]
    rows += [
        _worst("odd lines to 19 in the spectrum of the summed motion", summed, exact.frequencies[::2], 1e-4, odd),
        Check(
            "displacements with true and with 64 times softer bonds, largest difference over largest displacement",
            "exact",
            softness.difference,
            0.0,
            softness.difference,
            1e-2,
        ),
        Check(
            "transverse frequencies with true and with softer bonds, largest relative difference",
            "exact",
            softness.line_difference,
            0.0,
            softness.line_difference,
            1e-9,
        ),
        Check("strongest line of guitar_string.wav in Hz", "exact", heard, pitch, abs(heard / pitch - 1), 1e-4),
        Check(
            "12 N: energy + loss to damping - work, over the work (J)",
            "exact",
            motion.imbalance,
            0.0,
            motion.imbalance,
            2e-3,
        ),
        Check(
            "departure of the 20th line from 20 f1, in % (the thesis says 0.2)",
            "thesis",
            departure,
            0.2,
            abs(departure - 0.2),
            0.1,
        ),
        _lift(motion),
    ]
    return rows


def _lift(motion: hard.HardPluck) -> Check:
    lift = 1e3 * float(motion.lift.max())
    return Check("12 N: lift in mm (19 was expected)", "claim", lift, 19.0, abs(lift / 19.0 - 1), 0.1)


def findings(
    recording: soft.Recording, found: soft.Harmonics, softness: soft.Softness, motion: hard.HardPluck
) -> list[str]:
    """Single sentences with numbers."""
    return [*_departure(found), *_soft(recording, found, softness), *_hard(motion)]


def _departure(found: soft.Harmonics) -> list[str]:
    """What the thesis's 0.2 % at n = 20 can be."""
    n = soft.HARMONICS
    factor = (math.pi * n / strings.LENGTH) ** 2 * strings.BENDING / strings.TENSION
    law = strings.stiff_law(n) / (n * strings.stiff_law(1)) - 1
    discrete = strings.discrete_law(n, soft.SEGMENTS) / (n * strings.discrete_law(1, soft.SEGMENTS)) - 1
    simulated = found.frequencies[n - 1, 0] / (n * found.frequencies[0, 0]) - 1
    beads = strings.discrete_law(n, soft.SEGMENTS) / strings.stiff_law(n) - 1
    # (2.11) is 0.2 % above n f1 where n^2 e - e = 1.002^2 (1 + e) - 1 with e the factor at n = 1
    wanted = (1.002**2 - 1) / (n**2 - 1.002**2) * n**2 / factor
    flexible = n * math.pi / (2 * soft.SEGMENTS)
    return [
        f"The thesis's 0.2 % at n = {n} does not hold for its string: line {n} stands {100 * simulated:.2f} % above {n} f1 as "
        f"simulated, {100 * discrete:.2f} % in the exact discrete string and {100 * law:.2f} % by (2.11).",
        f"Discreteness takes {-100 * beads:.2f} % of the frequency of line {n}; without bending it alone would put the line "
        f"{100 * (1 - math.sin(flexible) / flexible):.2f} % below {n} f1, so that no mix of the two gives 0.2 %.",
        f"(2.11) gives 0.2 % at n = {n} with E I/T {1 / wanted:.0f} times smaller: a radius of {1e3 * strings.RADIUS * wanted**0.25:.3f} mm, "
        f"E = {1e-9 * strings.YOUNG * wanted:.2f} GPa, or T = {strings.TENSION / wanted:.0f} N; a diameter of 0.25 mm would give "
        f"{100 * (math.sqrt((1 + factor / 16) / (1 + factor / 16 / n**2)) - 1):.2f} %.",
        f"The term pi^2 n^2 E I/(T L^2) of (2.11) is {factor:.3f} at n = {n}: a 0.2 that is no per cent, which may be what the thesis "
        "printed (a guess).",
    ]


def _soft(recording: soft.Recording, found: soft.Harmonics, softness: soft.Softness) -> list[str]:
    n = np.arange(1, soft.HARMONICS + 1)
    exact = strings.beats(strings.discrete_law(n, soft.SEGMENTS), strings.DAMPING)
    error = np.abs(found.frequencies / exact.frequencies[:, None] - 1)
    times = found.decay_times
    ratio = found.amplitudes / found.amplitudes[0]
    return [
        f"Lines 1 to 20 stand within {error.max():.1e} of the exact discrete string, as the square of the time step of "
        f"{1e6 * recording.timestep:.2f} us has it, and decay in {1e3 * times.min():.2f} to {1e3 * times.max():.2f} ms "
        f"(2/gamma = {2e3 / strings.DAMPING:.2f} ms).",
        f"Plucked at bead 10 instead of 50, line 10 over line 1 is {ratio[9, 1]:.4f} instead of {ratio[9, 0]:.4f}, at frequencies "
        f"that differ by at most {np.abs(found.frequencies[:, 1] / found.frequencies[:, 0] - 1).max():.1e}.",
        f"With bonds {strings.SOFTER:.0f} times softer at the same tension no bead's displacement differs by more than "
        f"{softness.difference:.1e} of the largest in the first {1e3 * softness.seconds:.0f} ms, no transverse frequency by more than "
        f"{softness.line_difference:.1e}.",
        f"A second of motion of the 200-bead string takes {softness.wall_soft:.1f} s of wall time with softer bonds "
        f"({strings.RATE} samples a second) and {softness.wall_true:.1f} s with the true ones.",
    ]


def _hard(motion: hard.HardPluck) -> list[str]:
    after = motion.times > strings.PLUCKING
    mean = motion.tensions.mean(axis=1)
    first, last = motion.pitch.frequencies[0], motion.pitch.frequencies[-1]
    at_release = 1e3 * motion.lift[int(np.argmax(after)) - 1]
    small = float(strings.stiff_law(1))
    return [
        f"12 N lift the string by {1e3 * motion.lift.max():.1f} mm at most ({at_release:.1f} mm at release) and raise its mean "
        f"tension from {strings.TENSION:.0f} N to {mean.max():.0f} N at most; after release it swings between {mean[after].min():.0f} and "
        f"{mean[after].max():.0f} N, {mean[after].mean():.0f} N on average.",
        f"Its pitch starts at {first:.1f} Hz and is {last:.1f} Hz at {1e3 * (motion.pitch.times[-1] + strings.PLUCKING):.0f} ms, against "
        f"{small:.2f} Hz for small motion.",
        f"The energy balance of the 12 N pluck closes to {motion.imbalance:.1e} of the work done.",
    ]

