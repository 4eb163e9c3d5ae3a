"""How the lines depend on amplitude, time step and stiffness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament.analysis import lines
from systems.mass_spring.chain import Chain, amplitude_law, leapfrog, play
from systems.mass_spring.table import measure
from systems.scene import Check

__all__ = [
    "Curve",
    "Steps",
    "amplitude_rows",
    "amplitudes",
    "checks",
    "findings",
    "stiffnesses",
    "timestep_rows",
    "timesteps",
]

Array = NDArray[np.float64]

SHIFTS = np.array([0.01, 0.02, 0.04, 0.08, 0.16])
"""Amplitudes in units of l0."""

FRACTIONS = np.array([0.4, 0.2, 0.1, 0.05, 0.02, 0.005])
"""Time steps over the stability limit."""

STIFFER = (1.25, 2.0, 10.0, 100.0)
"""Stiffnesses in units of T0/l0."""

_ANY_AMPLITUDE = 1e-6
"""A single mass against the quadrature of its period, relative: (omega dt)^2/24 = 1e-7 to 8e-7."""
_LAW = 1e-3
"""Coefficient of amplitude^2 by a straight line in amplitude^2, relative. Measured: 1e-4."""
_DISPERSION = 1e-7
"""Lines against leapfrog's exact dispersion, relative. Measured: 2e-9, of which the amplitude makes 1e-9."""
_ORDER = 0.01
"""Order of convergence between the two shortest steps. Measured: 5e-4."""
_STIFFNESS = 1e-6
"""Lines of one chain at stiffnesses from 1.25 to 100, relative. Measured: 2e-7 at 100, in proportion to amplitude^2."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Frequencies of one mode that swings alone, by amplitude.

    Attributes
    ----------
    chain : Chain
    mode : int
    amplitudes : (A,) array
        In units of l0.
    frequencies : (A,) array
        Hz.
    shifts : (A,) array
        Relative, from the line at small amplitude and the same time step.
    tensions : (A,) array
        Rise of the mean tension, relative.
    coefficient : float
        c in `shift = c amplitude^2`, extrapolated to small amplitude.
    """

    chain: Chain
    mode: int
    amplitudes: Array
    frequencies: Array
    shifts: Array
    tensions: Array
    coefficient: float


def amplitudes(chain: Chain, mode: int, *, periods: int, phase: float) -> Curve:
    """Run one mode at growing amplitudes; `phase` is the time step times the chain's cutoff frequency."""
    line = float(chain.frequencies[mode - 1])
    dt = phase / chain.cutoff
    scaled = SHIFTS / np.sqrt(chain.ratio - 1)
    found, tensions = [], []
    for amplitude in scaled:
        recording = play(
            chain, amplitude * chain.shapes[mode - 1], periods / line, timestep=dt, interval=1 / (24 * line)
        )
        found.append(lines(recording.across, recording.interval, count=1).frequencies[0])
        # what the springs gain along the chain adds up to nothing between fixed ends
        steps = np.diff(recording.across, axis=1, prepend=0.0, append=0.0)
        tensions.append(chain.ratio * np.mean(np.hypot(1.0, steps) - 1))
    shifts = np.array(found) / leapfrog(line, dt) - 1
    coefficient = np.polyfit(scaled[:4] ** 2, shifts[:4] / scaled[:4] ** 2, 1)[1]
    return Curve(chain, mode, scaled, np.array(found), shifts, np.array(tensions), float(coefficient))


def amplitude_rows(curve: Curve) -> list[dict[str, float]]:
    """One row an amplitude."""
    law = amplitude_law(curve.chain, curve.mode)
    return [
        {
            "masses": curve.chain.masses,
            "mode": curve.mode,
            "stiffness_ratio": curve.chain.ratio,
            "amplitude_over_l0": a,
            "frequency_Hz": f,
            "relative_shift": s,
            "harmonic_balance": law * a**2,
            "mean_tension_rise": t,
        }
        for a, f, s, t in zip(curve.amplitudes, curve.frequencies, curve.shifts, curve.tensions, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class Steps:
    """Lines of a chain by time step.

    Attributes
    ----------
    chain : Chain
    timesteps : (S,) array
        Seconds.
    frequencies : (S, N) array
        Hz.
    """

    chain: Chain
    timesteps: Array
    frequencies: Array

    @property
    def errors(self) -> Array:
        """(S, N), relative to the exact lines."""
        return self.frequencies / self.chain.frequencies - 1


def timesteps(chain: Chain, seconds: float) -> Steps:
    """Measure all lines at fractions of the stability limit."""
    steps = FRACTIONS * of.stable_timestep(chain.model).value_in_unit(unit.second)
    return Steps(chain, steps, np.stack([measure(chain, seconds, timestep=float(dt)).frequencies for dt in steps]))


def timestep_rows(steps: Steps) -> list[dict[str, float]]:
    """One row a time step and line."""
    return [
        {
            "masses": steps.chain.masses,
            "timestep_s": dt,
            "line": j + 1,
            "simulated_Hz": found[j],
            "exact_Hz": exact,
            "relative_error": found[j] / exact - 1,
            "leapfrog_relative_error": leapfrog(exact, dt) / exact - 1,
        }
        for dt, found in zip(steps.timesteps, steps.frequencies, strict=True)
        for j, exact in enumerate(steps.chain.frequencies)
    ]


def stiffnesses(masses: int, seconds: float, *, phase: float) -> Array:
    """Lines (K, N) in Hz of a chain whose springs have the stiffnesses STIFFER."""
    chains = [Chain(masses, ratio) for ratio in STIFFER]
    return np.stack([measure(chain, seconds, timestep=phase / chain.cutoff).frequencies for chain in chains])


def checks(curves: list[Curve], steps: Steps, stiff: Array) -> list[Check]:
    """All of these against exact answers."""
    out = []
    for curve in curves:
        name = f"N = {curve.chain.masses}, mode {curve.mode}, k = {curve.chain.ratio:g} T0/l0"
        if curve.chain.masses == 1:
            exact = np.array([curve.chain.frequency_at(float(a)) for a in curve.amplitudes])
            error = np.abs(curve.frequencies / exact - 1)
            i = int(np.argmax(error))
            value, expected = float(curve.frequencies[i]), float(exact[i])
            label = f"{name}: frequency (Hz) at amplitudes to {curve.amplitudes[-1]:.2g} l0 against quadrature (worst)"
            out.append(Check(label, "exact", value, expected, float(error[i]), _ANY_AMPLITUDE, "Hz"))
        law = amplitude_law(curve.chain, curve.mode)
        error_of_law = abs(curve.coefficient / law - 1)
        label = f"{name}: relative shift over (amplitude/l0)^2"
        out.append(Check(label, "exact", curve.coefficient, law, error_of_law, _LAW))
    expected_steps = np.stack([leapfrog(steps.chain.frequencies, dt) for dt in steps.timesteps])
    deviation = np.abs(steps.frequencies / expected_steps - 1)
    at = np.unravel_index(int(np.argmax(deviation)), deviation.shape)
    out.append(
        Check(
            f"N = {steps.chain.masses}: lines (Hz) at time steps to {FRACTIONS[0]:g} of the limit against leapfrog (worst)",
            "exact", float(steps.frequencies[at]), float(expected_steps[at]), float(deviation[at]), _DISPERSION, "Hz",
        )
    )  # fmt: skip
    order = _order(steps)
    out.append(Check("order of convergence with the time step", "exact", order, 2.0, abs(order - 2), _ORDER))
    spread = float(np.ptp(stiff, axis=0).max() / stiff.min())
    out.append(
        Check(
            f"spread of the lines over stiffnesses from {STIFFER[0]:g} to {STIFFER[-1]:g} T0/l0, relative",
            "exact", spread, 0.0, spread, _STIFFNESS,
        )
    )  # fmt: skip
    return out


def _order(steps: Steps) -> float:
    """From the strongest error, that of the highest line, at the two shortest steps."""
    errors = np.abs(steps.errors[-2:, -1])
    return float(np.log(errors[0] / errors[1]) / np.log(steps.timesteps[-2] / steps.timesteps[-1]))


def findings(curves: list[Curve], steps: Steps, stiff: Array) -> list[str]:
    """Measured laws."""
    out = []
    for curve in curves:
        share = (curve.tensions / 2 / curve.shifts)[0]
        law = amplitude_law(curve.chain, curve.mode)
        out.append(
            f"N = {curve.chain.masses}, mode {curve.mode}, k = {curve.chain.ratio:g} T0/l0: the frequency rises by the part "
            f"{curve.coefficient:.5g} (amplitude/l0)^2, where harmonic balance expects {law:.5g}; the rise of the mean tension "
            f"alone would give {share:.3f} times that."
        )
    out.append(
        f"N = {steps.chain.masses}: at a tenth of the stability limit the highest line is {100 * steps.errors[2, -1]:.3f} % high; "
        f"the error falls with the power {_order(steps):.4f} of the time step, as leapfrog's dispersion says."
    )
    spread = float(np.ptp(stiff, axis=0).max() / stiff.min())
    out.append(
        f"Between stiffnesses of {STIFFER[0]:g} and {STIFFER[-1]:g} T0/l0 the transverse lines differ by {spread:.1e}: they do not "
        "depend on the stiffness where the amplitude is small."
    )
    return out
