"""The first line against that of a continuous string, from one mass to a thousand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from openmm_filament.analysis import damped_sinusoids
from systems.mass_spring.chain import Chain, continuum_frequency, play
from systems.mass_spring.table import AMPLITUDE
from systems.scene import Check

__all__ = ["MASSES", "checks", "findings", "first_line", "limit_of_ratio", "radicals", "rows"]

MASSES = tuple(2**k - 1 for k in range(1, 11))
"""1, 3, 7, ..., 1023."""

_FIRST = 1e-6
"""First line against the exact discrete one, relative: (omega dt)^2/24 is 1e-7 to 2e-7, the amplitude's share 2e-9."""
_LIMIT = 5e-4
"""Extrapolated coefficient of 1/(N + 1): an error of 2e-7 in a line times 3 * 512, and 1/N^2."""

_STABLE = 0.8
"""Time step of long chains over the stability limit: leapfrog's error is that of the slow motion, not of the limit."""
_STEPS = 3000
"""Least number of steps in a period."""


def first_line(chain: Chain, periods: float) -> float:
    """The frequency in Hz of a chain that starts in the shape of its first mode, fitted to some periods of its motion.

    The guess is the continuous string's frequency.
    """
    guess = continuum_frequency()
    timestep = min(_STABLE * 2 / (chain.cutoff * float(np.sqrt(chain.ratio))), 1 / (guess * _STEPS))
    start = AMPLITUDE * chain.shapes[0]
    recording = play(chain, start, periods / guess, timestep=timestep, interval=1 / (64 * guess))
    return float(damped_sinusoids(recording.across, recording.interval, [guess], damped=False).frequencies[0])


def radicals(masses: int) -> float:
    """The first line in Hz of `2^k - 1` masses by repeated halving of an angle, `2 cos(x/2) = sqrt(2 + 2 cos x)` (appendix B)."""
    chain = Chain(masses)
    twice_cosine = 0.0  # 2 cos(pi/2)
    for _ in range((masses + 1).bit_length() - 2):
        twice_cosine = float(np.sqrt(2 + twice_cosine))
    return float(chain.cutoff / 2 * np.sqrt(2 - twice_cosine) / (2 * np.pi))


def rows(ratio: float, periods: float, progress: Callable[[float], None]) -> list[dict[str, float]]:
    """One row a chain: simulated, exact and by radicals, and the excess over the continuous string."""
    out = []
    for masses in MASSES:
        chain = Chain(masses, ratio)
        out.append(
            {
                "masses": masses,
                "simulated_Hz": first_line(chain, periods),
                "exact_Hz": float(chain.frequencies[0]),
                "radicals_Hz": radicals(masses),
                "continuum_Hz": continuum_frequency(),
            }
        )
        out[-1]["relative_excess"] = out[-1]["simulated_Hz"] / out[-1]["continuum_Hz"] - 1
        progress((masses + 1) / (MASSES[-1] + 1))
    return out


def limit_of_ratio(table: list[dict[str, float]]) -> float:
    """The coefficient c in `f1 = f_continuum (1 + c/(N + 1))` for long chains, from the two longest, the next order taken out."""
    last, longest = ((row["masses"] + 1) * row["relative_excess"] for row in table[-2:])
    return 2 * longest - last


def checks(table: list[dict[str, float]]) -> list[Check]:
    """First lines against the exact ones, and their approach to (2.9)."""
    errors = [abs(row["simulated_Hz"] / row["exact_Hz"] - 1) for row in table]
    worst = table[int(np.argmax(errors))]
    rooted = [abs(row["simulated_Hz"] / row["radicals_Hz"] - 1) for row in table]
    root = table[int(np.argmax(rooted))]
    longest = table[-1]
    coefficient = limit_of_ratio(table)
    return [
        Check(
            f"first line (Hz) of {table[0]['masses']:.0f} to {longest['masses']:.0f} masses against the exact (worst, relative)",
            "exact", worst["simulated_Hz"], worst["exact_Hz"], max(errors), _FIRST, "Hz",
        ),
        Check(
            "first line (Hz) of these chains against the nested radicals of appendix B (worst, relative)",
            "exact", root["simulated_Hz"], root["radicals_Hz"], max(rooted), _FIRST, "Hz",
        ),
        Check(
            "coefficient of 1/(N + 1) in the relative excess of f1 over the continuous string",
            "exact", coefficient, 0.5, abs(coefficient - 0.5), _LIMIT,
        ),
        Check(
            f"f1 (Hz) of {longest['masses']:.0f} masses against the continuum limit (2.9), relative",
            "thesis", longest["simulated_Hz"], longest["continuum_Hz"], abs(longest["relative_excess"]), 1e-3, "Hz",
        ),
    ]  # fmt: skip


def findings(table: list[dict[str, float]]) -> list[str]:
    """The law of the difference."""
    longest = table[-1]
    power = np.log(table[-2]["relative_excess"] / longest["relative_excess"]) / np.log(
        (longest["masses"] + 1) / (table[-2]["masses"] + 1)
    )
    limit, power_text = longest["continuum_Hz"], f"power -{power:.4f} between the two longest chains"
    return [
        f"f1 approaches the limit (2.9), {limit:.4f} Hz, from above as {limit_of_ratio(table):.4f}/(N + 1) ({power_text}): "
        f"{longest['simulated_Hz']:.4f} Hz with {longest['masses']:.0f} masses. It is of first order only because the fixed beads "
        "take two shares of the mass; with m = M/(N + 1) it would be of second order."
    ]
