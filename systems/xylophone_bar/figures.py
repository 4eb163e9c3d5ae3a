"""Figures of the bar: its lines, its shapes, its spectrum, and how it converges to Euler and Bernoulli's."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from openmm_filament.analysis import spectrum
from systems.xylophone_bar.bar import LENGTH, Ringing, beam, discrete_free

__all__ = ["convergence", "frequencies", "shapes", "spectra"]

Array = NDArray[np.float64]

NAMES = {"tense": "held ends, 17.7 kN (thesis)", "free": "free ends, no tension (as played)"}
COLOURS = {"tense": "C0", "free": "C3"}


def frequencies(path: Path, found: Mapping[str, Array], exact: Mapping[str, Array]) -> None:
    """f_n/f_1 of both bars, and what n f_1 leaves of them."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, law in exact.items():
        n = np.arange(1, len(law) + 1)
        simulated = found[name]
        left.loglog(n, law / law[0], "-", color=COLOURS[name], lw=1, label=f"{NAMES[name]}: exact, discrete")
        left.plot(n, simulated / simulated[0], "o", color=COLOURS[name], ms=5, label="   simulated")
        right.semilogy(n, np.abs(simulated / law - 1), "o-", color=COLOURS[name], lw=0.8, label=NAMES[name])
    count = len(exact["tense"])
    left.plot([1, count], [1, count], "k:", label="harmonic, n")
    left.plot(np.arange(1, 6), beam() / beam()[0], "k+", ms=11, label="Euler-Bernoulli, free")
    left.set(
        xlabel="mode n", ylabel="f_n / f_1", title="Lines of the bar", ylim=(0.9, 400), xticks=(1, 2, 3, 4, 5, 6, 8, 10, 12),
        xticklabels=("1", "2", "3", "4", "5", "6", "8", "10", "12"), yticks=(1, 3, 10, 30, 100),
        yticklabels=("1", "3", "10", "30", "100"),
    )  # fmt: skip
    left.minorticks_off()
    right.set(
        xlabel="mode n", ylabel="|simulated / exact - 1|", title="Simulated lines against the exact discrete chain"
    )
    right.axhline(1e-4, color="0.6", lw=0.8, ls="--")
    for ax in (left, right):
        ax.grid(alpha=0.3)
        ax.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def shapes(path: Path, found: Mapping[str, Array], exact: Mapping[str, Array]) -> None:
    """The first five mode shapes, simulated (points) and exact (lines)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.6), layout="constrained")
    for ax, name in zip(figure.subplots(1, 2, sharey=True), found, strict=True):
        for i, (points, line) in enumerate(zip(found[name], exact[name], strict=True)):
            z = np.linspace(0, 1e3 * LENGTH, len(line))
            some = np.unique(np.linspace(0, len(line) - 1, 41).round().astype(int))
            ax.plot(z, -2.4 * i + line, color=f"C{i}", lw=1)
            ax.plot(z[some], -2.4 * i + points[some], "o", color=f"C{i}", ms=3.5)
            ax.axhline(-2.4 * i, color="0.85", lw=0.7, zorder=0)
        ax.set(xlabel="place along the bar (mm)", title=NAMES[name], yticks=[-2.4 * i for i in range(len(found[name]))])
        ax.set_yticklabels([f"n = {i + 1}" for i in range(len(found[name]))])
    figure.suptitle("Mode shapes: simulated (points), exact discrete chain (lines)")
    figure.savefig(path, dpi=110)


def spectra(path: Path, rings: Mapping[str, Ringing], exact: Mapping[str, Array]) -> None:
    """Spectrum of the motion, root mean square over the beads, with the exact lines."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5.6), layout="constrained")
    for ax, (name, ring) in zip(figure.subplots(2, 1), rings.items(), strict=True):
        seen = spectrum(ring.transverse, ring.interval)
        height = np.sqrt(np.mean(seen.amplitudes**2, axis=1))
        for n, frequency in enumerate(exact[name], 1):
            ax.axvline(frequency / 1e3, color="0.75", lw=0.8, ls="--", label="exact lines" if n == 1 else None)
        ax.semilogy(seen.frequencies / 1e3, 1e6 * height, color=COLOURS[name], lw=1, label="simulated")
        top = 1.02 * exact[name][-1] / 1e3
        kept = seen.frequencies / 1e3 < top
        ax.set(
            xlim=(0, top), ylim=(1e6 * height[kept][2:].max() * 1e-6, 2e6 * height[kept].max()),
            ylabel="amplitude (µm)", title=NAMES[name],
        )  # fmt: skip
        ax.legend(fontsize=8, loc="upper right")
    ax.set_xlabel("frequency (kHz)")
    figure.savefig(path, dpi=110)


def convergence(path: Path, simulated: Mapping[int, Array], extrapolated: Array) -> None:
    """Deviation of the free bar's lines from Euler and Bernoulli's against the number of segments."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.4, 5), layout="constrained")
    ax = figure.subplots()
    sizes = np.array([12, 16, 24, 30, 45, 60, 90, 120, 160, 200])
    law = np.array([discrete_free(5, n) for n in sizes])
    whole = np.array([discrete_free(1, n, ends=1.0)[0] for n in sizes])
    for i in range(5):
        ax.loglog(sizes, 100 * np.abs(law[:, i] / beam()[i] - 1), f"C{i}", lw=1, label=f"n = {i + 1}: exact, discrete")
        points = [100 * abs(f[i] / beam()[i] - 1) for f in simulated.values()]
        ax.loglog(list(simulated), points, "o", color=f"C{i}", ms=5, label="   simulated" if i == 0 else None)
    ax.loglog(sizes, 100 * np.abs(whole / beam()[0] - 1), "k--", lw=1, label="n = 1, whole masses at the ends")
    worst = np.abs(extrapolated / beam() - 1).max()
    ax.set(
        xlabel="segments", ylabel="deviation from Euler-Bernoulli (%)", xticks=(12, 30, 60, 120, 200),
        xticklabels=("12", "30", "60", "120", "200"),
        title=f"Free bar, half masses at the ends: second order\n(simulated lines extrapolated: off by {worst:.1e} at most)",
    )  # fmt: skip
    ax.minorticks_off()
    ax.grid(alpha=0.3)
    ax.legend(fontsize=8)
    figure.savefig(path, dpi=110)
