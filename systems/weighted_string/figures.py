"""Figures of the loaded string."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from openmm_filament import analysis
from systems import strings
from systems.weighted_string.chain import LINES, Playing
from systems.weighted_string.remainder import Remainder

__all__ = ["decay", "shapes", "spectra"]

_FAINTEST = 1e-7
"""Faintest amplitude shown, over the largest."""


def spectra(path: Path, runs: Sequence[Playing], leftovers: Sequence[Remainder]) -> None:
    """Spectrum of the sound of each case and what the exact modes leave of it, with their lines and the unloaded string's."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 9), layout="constrained")
    axes = figure.subplots(len(runs), 1, sharex=True, sharey=True)
    segments = runs[0].beads.shape[1] - 1
    plain = strings.discrete_law(np.arange(1, LINES + 1), segments)
    for ax, run, left in zip(axes, runs, leftovers, strict=True):
        spectrum = analysis.spectrum(run.sound, 1 / run.rate)
        top = spectrum.amplitudes[spectrum.frequencies > 20].max()
        exact = run.modes.frequencies[:LINES]
        ax.vlines(exact, _FAINTEST, 2, color="C1", lw=0.9, alpha=0.6, label="exact lines of the loaded string")
        ax.vlines(plain, _FAINTEST, 3 * _FAINTEST, color="k", lw=1.5, label="harmonics without load")
        ax.semilogy(spectrum.frequencies, spectrum.amplitudes / top, "C0-", lw=1, label="simulated, mean of the beads")
        ax.semilogy(left.frequencies, left.amplitudes, color="0.35", lw=0.6, label="what the exact modes leave of it")
        ax.set(ylabel="amplitude / largest", title=run.case.label, xlim=(0, 1.03 * exact[-1]), ylim=(_FAINTEST, 2))
    axes[0].legend(loc="upper right", fontsize=8, ncols=2)
    axes[-1].set_xlabel("frequency (Hz)")
    figure.savefig(path, dpi=110)


def decay(path: Path, runs: Sequence[Playing]) -> None:
    """Decay rate of each line against its frequency."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 5), layout="constrained")
    ax = figure.subplots()
    for i, run in enumerate(runs):
        ax.plot(run.modes.frequencies[:LINES], run.modes.decay_rates[:LINES], "_", color=f"C{i}", ms=14, mew=1.5)
        ax.plot(run.frequencies, run.decay_rates, "osD"[i], color=f"C{i}", ms=5, mfc="none", label=run.case.label)
    ax.plot([], [], "k_", ms=12, label="exact")
    ax.axhline(strings.DAMPING / 2, color="0.6", lw=0.8, zorder=0)
    ax.set(
        xlabel="frequency (Hz)",
        ylabel="decay rate of the amplitude (1/s)",
        yscale="log",
        title="Heavy beads damped harder: low modes, which move them, decay faster",
    )
    ax.legend(fontsize=9)
    figure.savefig(path, dpi=110)


def shapes(path: Path, runs: Sequence[Playing]) -> None:
    """The lowest exact modes of each load, and the string at some moments."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 6.5), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    for row, run in zip(axes, runs[:2], strict=True):
        segments = run.beads.shape[1] - 1
        place = np.linspace(0, 1e3 * strings.LENGTH, segments + 1)
        heavy = run.case.heavy(segments)
        for k in range(4):
            shape = run.modes.shapes[k] * np.sign(run.modes.shapes[k, 1])
            row[0].plot(place, shape - 2.4 * k, lw=1.3, label=f"{run.modes.frequencies[k]:.1f} Hz")
            row[0].plot(place[heavy], shape[heavy] - 2.4 * k, "ko", ms=5)
        row[0].set(yticks=[], ylabel="displacement", title=f"{run.case.label}: lowest modes")
        row[0].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
        for i, time in enumerate(np.linspace(strings.PLUCKING, 0.02, 7)):
            frame = 1e6 * run.beads[round(time * run.rate), :, 0]
            row[1].plot(place, frame, color=f"C{i}", lw=1.3, label=f"{1e3 * time:.1f} ms")
            row[1].plot(place[heavy], frame[heavy], "o", color=f"C{i}", ms=4)
        row[1].set(ylabel="displacement (µm)", title="after the pluck at L/4")
        row[1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    for ax in axes[1]:
        ax.set_xlabel("position along the string (mm)")
    figure.savefig(path, dpi=110)
