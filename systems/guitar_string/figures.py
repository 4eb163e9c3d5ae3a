"""Figures of the guitar string."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from openmm_filament import analysis
from systems import strings
from systems.guitar_string import hard, soft

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["decay", "hard_pluck", "law", "shapes", "spectra"]

Array = NDArray[np.float64]

_DYNAMIC = 1e-4
"""Faintest amplitude shown, over the largest."""

_DPI = 110


def _places() -> Array:
    return np.linspace(0, 1e3 * strings.LENGTH, soft.SEGMENTS + 1)


def shapes(path: Path, recording: soft.Recording) -> None:
    """The string at some moments of the pluck and of the period after it, for both plucked beads."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 6.8), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    period = 1 / float(strings.stiff_law(1))
    spans = (
        (0.0, strings.PLUCKING, 9, "while it is pulled"),
        (strings.PLUCKING, strings.PLUCKING + period, 13, "after"),
    )
    for row, bead in zip((0, 1), soft.BEADS, strict=True):
        for ax, (begin, end, count, what) in zip(axes[row], spans, strict=True):
            norm = Normalize(1e3 * begin, 1e3 * end)
            for time in np.linspace(begin, end, count):
                frame = recording.beads[round(time * recording.rate), :, row]
                ax.plot(_places(), 1e6 * frame, color=colormaps["viridis"](0.92 * norm(1e3 * time)), lw=1.4)
            ax.axhline(0, color="0.6", lw=0.7, zorder=0)
            ax.axvline(_places()[bead], color="C3", lw=0.9, ls=":")
            ax.set_title(f"bead {bead} ({_places()[bead]:.0f} mm), {soft.FORCES[row]} N, {what}", fontsize=10)
            if row == 1:
                ax.set_xlabel("position along the string (mm)")
            bar = figure.colorbar(ScalarMappable(norm, colormaps["viridis"]), ax=ax, pad=0.01)
            bar.set_label("time (ms)")
        axes[row, 0].set_ylabel("displacement (µm)")
    figure.suptitle("Guitar string pulled for 1/300 s, and the first period after it")
    figure.savefig(path, dpi=_DPI)


def spectra(path: Path, recording: soft.Recording) -> None:
    """Spectrum of the summed motion and of every bead, for both plucked beads."""
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, height_ratios=(1, 1.15))
    lines = strings.discrete_law(np.arange(1, soft.HARMONICS + 1), soft.SEGMENTS)
    for column, bead in enumerate(soft.BEADS):
        summed = analysis.spectrum(recording.sums[recording.played :, column], 1 / recording.rate)
        top, below = axes[:, column]
        height = summed.amplitudes / summed.amplitudes[summed.frequencies > 20].max()
        top.vlines(lines, 1e-5, 3, color="0.85", lw=0.8, zorder=0)
        top.semilogy(summed.frequencies, height, color=f"C{column}", lw=1)
        top.set(ylim=(1e-5, 2), title=f"plucked at bead {bead}: mean of all beads", ylabel="amplitude / largest")
        each = analysis.spectrum(recording.beads[recording.played :, :, column], 1 / recording.rate, padding=2)
        shown = each.frequencies < 1.05 * lines[-1]
        image = each.amplitudes[shown]
        mesh = below.imshow(
            np.maximum(image / image[3:].max(), _DYNAMIC).T,
            norm=LogNorm(_DYNAMIC, 1),
            cmap="magma",
            aspect="auto",
            origin="lower",
            extent=(0, each.frequencies[shown][-1], -0.5, soft.SEGMENTS + 0.5),
            interpolation="antialiased",
        )
        below.axhline(bead, color="w", lw=0.8, ls=":")
        below.set(title="each bead", xlabel="frequency (Hz)", ylabel="bead", xlim=(0, 1.05 * lines[-1]))
    figure.colorbar(mesh, ax=axes[1, :], label="amplitude / largest", pad=0.01)
    figure.suptitle(
        "Guitar string after a gentle pluck: the same lines, other weights (grey: exact lines of the bead chain)"
    )
    figure.savefig(path, dpi=_DPI)


def law(path: Path, found: soft.Harmonics) -> None:
    """Departure of the harmonics from a straight line, and from the exact discrete law."""
    from matplotlib.figure import Figure

    n, smooth = np.arange(1, soft.HARMONICS + 1), np.linspace(1, soft.HARMONICS, 200)
    flexible = smooth / (2 * strings.LENGTH) * np.sqrt(strings.TENSION / strings.DENSITY)
    figure = Figure(figsize=(7.5, 7.5), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    upper.plot(smooth, 100 * (strings.stiff_law(smooth) / flexible - 1), "k--", lw=1.2, label="stiff string (2.11)")
    discrete = strings.discrete_law(smooth, soft.SEGMENTS)
    upper.plot(smooth, 100 * (discrete / flexible - 1), "C0-", lw=1.2, label="stiff string of 201 segments, exact")
    at = n / (2 * strings.LENGTH) * np.sqrt(strings.TENSION / strings.DENSITY)
    upper.plot(n, 100 * (found.frequencies[:, 0] / at - 1), "o", color="C3", ms=5, label="simulated")
    upper.axhline(0.2, color="0.5", ls=":", label="0.2 %, the thesis's figure at n = 20")
    upper.set(
        ylabel=r"$f_n / (n f_1^0) - 1$ (%)",
        title="Guitar string: departure of the harmonics from $n f_1^0$, flexible string",
    )
    upper.legend()
    exact = strings.beats(strings.discrete_law(n, soft.SEGMENTS), strings.DAMPING)
    step = 1 / (strings.RATE * strings.EVERY)
    stepped = strings.beats(strings.discrete_law(n, soft.SEGMENTS), strings.DAMPING, step)
    for column, bead in enumerate(soft.BEADS):
        off = 1e6 * (found.frequencies[:, column] / exact.frequencies - 1)
        lower.plot(n, off, "os"[column], mfc="none", ms=(6, 9)[column], label=f"plucked at bead {bead}")
    off = 1e6 * (stepped.frequencies / exact.frequencies - 1)
    lower.plot(n, off, "k-", lw=1, zorder=0, label=f"a time step of {1e6 * step:.3g} µs, exact")
    lower.set(xlabel="harmonic n", ylabel="simulated / exact discrete - 1\n(millionths)", xticks=n[1::2])
    lower.legend()
    figure.savefig(path, dpi=_DPI)


def decay(path: Path, recording: soft.Recording, found: soft.Harmonics) -> None:
    """Envelopes of some harmonics, and the decay time of all."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    inner = slice(recording.played + 1000, -1000)  # the transform that gives envelopes fails at the ends
    times = np.arange(len(recording.modes))[inner] / recording.rate
    for shown in (1, 2, 3, 5, 10, 19):
        envelope = _envelope(recording.modes[:, shown - 1, 0])[inner]
        left.semilogy(times, 1e6 * envelope, lw=1.3, label=f"n = {shown}")
        start = 1e6 * found.amplitudes[shown - 1, 0]
        left.semilogy(times, start * np.exp(-strings.DAMPING / 2 * (times - strings.PLUCKING)), "k:", lw=1)
    left.plot([], [], "k:", label=r"$\exp(-\gamma t/2)$")
    left.set(xlabel="time (s)", ylabel="amplitude of the harmonic (µm)", title="Plucked at bead 50", ylim=(0.03, 300))
    left.legend(ncols=2, fontsize=9)
    n = np.arange(1, soft.HARMONICS + 1)
    for column, bead in enumerate(soft.BEADS):
        told = found.frequency_errors.argmin(axis=1) == column
        right.plot(n[told], 1e3 * found.decay_times[told, column], "os"[column], ms=5, label=f"plucked at bead {bead}")
    exact = 2e3 / strings.DAMPING
    right.axhline(exact, color="k", lw=1, label=r"$2/\gamma$")
    right.axhspan(0.99 * exact, 1.01 * exact, color="0.92", label="±1 %")
    right.set(
        xlabel="harmonic n",
        ylabel="decay time (ms)",
        ylim=(0.97 * exact, 1.03 * exact),
        title="All harmonics decay alike",
        xticks=n[1::2],
    )
    right.legend(fontsize=9)
    figure.savefig(path, dpi=_DPI)


def _envelope(signal: Array) -> Array:
    """The magnitude of the signal (T,) without its negative frequencies."""
    bins = np.fft.fft(signal)
    bins[len(bins) // 2 + 1 :] = 0
    return np.asarray(2 * np.abs(np.fft.ifft(bins)))


def hard_pluck(path: Path, motion: hard.HardPluck) -> None:
    """Lift, tension, pitch and energy of the string plucked with 12 N."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 10), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    t = 1e3 * motion.times
    axes[0].plot(t, 1e3 * motion.lift, "C0-", lw=1, label="highest bead, from the axis")
    axes[0].plot(t, 1e3 * motion.mean, "C1-", lw=1, label="mean of the beads")
    axes[0].set(ylabel="displacement (mm)", title="Guitar string plucked with 12 N at L/4, as printed")
    _band(axes[1], t, motion.tensions)
    axes[1].axhline(strings.TENSION, color="k", ls=":", lw=1, label="at rest")
    axes[1].set(ylabel="tension (N)", ylim=(0, None))
    centre = 1e3 * (motion.pitch.times + strings.PLUCKING)
    axes[2].plot(centre, motion.pitch.frequencies, "C3.-", label=f"simulated, in windows of {1e3 * hard.WINDOW:.0f} ms")
    mean = np.array([_mean_tension(motion, c / 1e3) for c in centre])
    steady = [float(strings.stiff_law(1, tension)) for tension in mean]
    axes[2].plot(centre, steady, "C0--", lw=1.2, label="small motion at the mean tension of the window")
    axes[2].axhline(float(strings.stiff_law(1)), color="k", ls=":", lw=1, label="small motion at 20 N")
    axes[2].set(ylabel="pitch (Hz)", ylim=(60, 200))
    for name, values in motion.energies.items():
        if name != "pluck":
            axes[3].plot(t, 1e3 * values, lw=1, label=name)
    total = np.sum([values for name, values in motion.energies.items() if name != "pluck"], axis=0)
    axes[3].plot(t, 1e3 * total, "k-", lw=1.4, label="sum")
    axes[3].set(xlabel="time (ms)", ylabel="energy (mJ)", ylim=(0, None))
    for ax in axes:
        ax.axvspan(0, 1e3 * strings.PLUCKING, color="0.9", zorder=0)
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.22 * (high - low))
        ax.legend(fontsize=8, loc="upper right", ncols=4)
    figure.savefig(path, dpi=_DPI)


def _band(ax: Axes, times: Array, tensions: Array) -> None:
    ax.fill_between(
        times, tensions.min(axis=1), tensions.max(axis=1), color="C0", alpha=0.25, lw=0, label="among the segments"
    )
    ax.plot(times, tensions.mean(axis=1), "C0-", lw=1, label="mean")


def _mean_tension(motion: hard.HardPluck, time: float) -> float:
    near = np.abs(motion.times - time) <= hard.WINDOW / 2
    return float(motion.tensions[near].mean())
