"""The lines of the thesis's Table 2.1 and their shapes, from the motion of the masses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import openmm_filament as of
from openmm_filament import _checks as check
from openmm_filament.analysis import damped_sinusoids, lines
from systems.mass_spring.chain import Chain, Recording, play
from systems.scene import Check

__all__ = ["AMPLITUDE", "THESIS", "Measured", "checks", "findings", "measure", "refuse_short", "rows"]

Array = NDArray[np.float64]

THESIS: dict[int, tuple[float, ...]] = {
    1: (88.28,),
    2: (88.28, 152.91),
    3: (87.23, 161.18, 210.59),
    4: (86.27, 164.10, 225.86, 265.51),
    5: (85.49, 165.16, 233.58, 286.07, 319.07),
    7: (84.38, 165.51, 240.28, 305.82, 359.61, 399.58, 424.19),
    9: (83.63, 165.19, 242.61, 314.22, 378.01, 432.49, 476.32, 508.42, 528.02),
}
"""Table 2.1 as printed, theory in Hz, by the number of masses."""

AMPLITUDE = 1e-4
"""Displacement of the first mass at the start in units of l0: it shifts the lines by some 1e-9 of them."""

LIMIT = 1e-5
"""Largest relative error of a line. The thesis had 1e-3."""

DIGIT = 0.0055
"""Half the last printed digit in Hz, and a tenth of it for the simulation (1e-6 of a line, at most 0.0005 Hz)."""

SHAPE = 1e-6
"""Largest error of a shape whose largest displacement is 1. Measured: 4e-9."""

MODES = 1e-9
"""Closed formula against the Hessian's eigenvalues, relative. Measured: 1e-13; rounding of a 27 x 27 matrix."""

_RESOLUTIONS = 4.0
"""Resolutions between two lines that are told apart without a guess."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What was read off the motion of a chain.

    Attributes
    ----------
    chain : Chain
    frequencies, errors : (N,) array
        Hz, and one standard error of the fit.
    shapes : (N, N) array
        One line a row, displacements of the masses as the exact shapes have them: those of largest product one.
    recording : Recording
    """

    chain: Chain
    frequencies: Array
    errors: Array
    shapes: Array
    recording: Recording


def measure(
    chain: Chain, seconds: float, *, timestep: float, amplitude: float = AMPLITUDE, order: Literal[2, 4] = 2
) -> Measured:
    """The lines of a chain whose first mass is moved aside by `amplitude` l0 and let go, which sets all modes in motion.

    The lines are found in the spectrum, without a guess, and refined by a fit of steady sinusoids that all masses share,
    whose amplitudes are the shapes. `order` is that of the integrator, as in `launch`.

    Raises
    ------
    ValueError
        If `seconds` are too short to tell the lines apart.
    """
    refuse_short(chain, seconds)
    start = np.zeros(chain.masses)
    start[0] = amplitude
    recording = play(chain, start, seconds, timestep=timestep, order=order)
    guess = lines(recording.across, recording.interval, count=chain.masses).frequencies
    fit = damped_sinusoids(recording.across, recording.interval, guess, damped=False)
    return Measured(chain, fit.frequencies, fit.frequency_errors, _shapes(fit.amplitudes, chain.shapes), recording)


def refuse_short(chain: Chain, seconds: float) -> None:
    """Raise ValueError if recordings of this length cannot tell the lines of a chain apart."""
    gap = float(np.diff(chain.frequencies, prepend=0.0).min())
    if not check.positive("seconds", seconds, unit="s") * gap >= _RESOLUTIONS:
        raise check.fail(
            "seconds",
            f"be at least {_RESOLUTIONS / gap:.3g} to tell apart lines {gap:.3g} Hz from one another (N = {chain.masses})",
            seconds,
        )


def _shapes(amplitudes: NDArray[np.complex128], exact: Array) -> Array:
    """Real shapes from complex amplitudes (N, N): turned in phase and scaled to the exact ones by least squares."""
    factors = np.sum(amplitudes.conj() * exact, axis=1) / np.sum(np.abs(amplitudes) ** 2, axis=1)
    return np.asarray((amplitudes * factors[:, None]).real)


def rows(measured: list[Measured]) -> list[dict[str, float]]:
    """One row a line of the table."""
    out = []
    for one in measured:
        chain = one.chain
        for j, exact in enumerate(chain.frequencies):
            out.append(
                {
                    "masses": chain.masses,
                    "line": j + 1,
                    "simulated_Hz": float(one.frequencies[j]),
                    "exact_Hz": float(exact),
                    "relative_error": float(one.frequencies[j] / exact - 1),
                    "fit_standard_error_Hz": float(one.errors[j]),
                    "thesis_Hz": THESIS[chain.masses][j],
                    "shape_error": float(np.abs(one.shapes[j] - chain.shapes[j]).max()),
                }
            )
    return out


def checks(measured: list[Measured], table: list[dict[str, float]]) -> list[Check]:
    """Every line against the exact one and the printed one, the shapes, and the formula against the Hessian."""
    out = []
    for kind, limit in (("exact", LIMIT), ("thesis", DIGIT)):
        for row in table:
            value, expected = row["simulated_Hz"], row[f"{kind}_Hz"]
            error = abs(row["relative_error"]) if kind == "exact" else abs(value - expected)
            unit = "Hz, relative error" if kind == "exact" else "Hz, to the printed digit"
            name = f"N = {row['masses']:.0f}, line {row['line']:.0f} ({unit})"
            out.append(Check(name, "exact" if kind == "exact" else "thesis", value, expected, error, limit, "Hz"))
    worst = max(row["shape_error"] for row in table)
    out.append(Check("simulated mode shapes against sines, largest deviation", "exact", worst, 0.0, worst, SHAPE))
    found = [_transverse(one.chain) / one.chain.frequencies for one in measured]
    deviation = max(float(np.abs(ratio - 1).max()) for ratio in found)
    out.append(
        Check(
            "eigenfrequencies of the Hessian over the closed formula (worst)",
            "exact",
            1 + deviation,
            1.0,
            deviation,
            MODES,
        )
    )
    return out


def _transverse(chain: Chain) -> Array:
    """The frequencies (N,) that the model's Hessian has across the chain, in y and in z alike."""
    modes = of.normal_modes(chain.model)
    along = np.abs(modes.shapes[:, :, 0]).max(axis=1) > 0.5
    return np.asarray(modes.frequencies[~along][::2])  # they come in pairs


def findings(table: list[dict[str, float]]) -> list[str]:
    """How far the lines are off, and the errata of the printed table."""
    worst = max(abs(row["relative_error"]) for row in table)
    out = [
        f"All {len(table)} lines of Table 2.1 come out of simulated motion within {worst:.1e} of the exact ones (the thesis: 1e-3)."
    ]
    for row in table:
        place = f"N = {row['masses']:.0f}, line {row['line']:.0f}"
        off = abs(row["exact_Hz"] - row["thesis_Hz"])
        if off > DIGIT:
            out.append(
                f"Erratum of Table 2.1: {place} is printed as {row['thesis_Hz']:.2f} Hz, but theory gives "
                f"{row['exact_Hz']:.2f} and the simulation {row['simulated_Hz']:.2f} Hz."
            )
        elif off > 0.005:
            out.append(
                f"{place} stands on the edge of rounding: printed as {row['thesis_Hz']:.2f} Hz, by theory "
                f"{row['exact_Hz']:.5f} Hz with M L = 7.8e-4 kg m."
            )
    return out
