"""Figures of the mass-spring chains."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from openmm_filament.analysis import spectrum
from systems.mass_spring.chain import amplitude_law, continuum_frequency, leapfrog
from systems.mass_spring.convergence import Curve, Steps
from systems.mass_spring.table import Measured

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_continuum", "draw_convergence", "draw_shapes", "draw_spectra"]


def draw_spectra(path: Path, measured: list[Measured]) -> None:
    """The spectrum of each chain over its exact lines."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 9.0), layout="constrained")
    rows = figure.subplots(len(measured), 1, sharex=True)
    for ax, one in zip(rows, measured, strict=True):
        found = spectrum(one.recording.across, one.recording.interval, padding=4)
        height = np.sqrt(np.mean(found.amplitudes**2, axis=1)) * 1e3  # of l0
        for line in one.chain.frequencies:
            ax.axvline(line, color="C1", lw=3, alpha=0.45)
        ax.semilogy(found.frequencies, height, color="C0", lw=1)
        ax.plot(one.frequencies, np.full(len(one.frequencies), 0.25), "v", color="C3", ms=5)
        ax.set(ylim=(1e-7, 0.5), xlim=(0, 600), yticks=[1e-6, 1e-4, 1e-2])
        ax.minorticks_off()
        ax.text(0.995, 0.9, f"N = {one.chain.masses}", transform=ax.transAxes, ha="right", va="top", fontweight="bold")
    rows[0].set_title(
        "Spectra of chains of N masses, the first moved aside by 1e-4 l0 and let go\n"
        "bars: exact lines; triangles: lines found in the motion",
        fontsize=11,
    )
    rows[len(rows) // 2].set_ylabel("amplitude, root mean square over the masses (l0/1000)")
    rows[-1].set_xlabel("frequency (Hz)")
    figure.savefig(path, dpi=120)


def draw_shapes(path: Path, measured: list[Measured]) -> None:
    """The modes of the chains of one to five masses, as in the thesis's figure 2.3."""
    from matplotlib.figure import Figure

    kept = [one for one in measured if one.chain.masses <= 5]
    figure = Figure(figsize=(10.0, 7.5), layout="constrained")
    grid = figure.subplots(len(kept), len(kept), sharex=True, sharey=True)
    fine = np.linspace(0, 1, 200)
    for row, one in zip(grid, kept, strict=True):
        n = one.chain.masses
        at = np.arange(n + 2) / (n + 1)
        for j, ax in enumerate(row):
            if j >= n:
                ax.set_axis_off()
                continue
            ax.plot(fine, np.sin((j + 1) * np.pi * fine), color="C1", lw=2.5, alpha=0.6)
            ax.plot(at, np.pad(one.shapes[j], 1), "-", color="C0", lw=1)
            ax.plot(at[1:-1], one.shapes[j], "o", color="C0", ms=5)
            ax.plot([0, 1], [0, 0], "ks", ms=4, clip_on=False)
            ax.set(xticks=[], yticks=[], ylim=(-1.25, 1.25))
            ax.set_title(f"mode {j + 1}: {one.frequencies[j]:.2f} Hz", fontsize=9)
            for side in ax.spines.values():
                side.set_visible(False)
        row[0].set_ylabel(f"N = {n}", fontsize=11, fontweight="bold")
    figure.suptitle("Modes of masses on a stretched chain: shapes from simulated motion (dots) over exact sines")
    figure.savefig(path, dpi=120)


def draw_convergence(path: Path, curves: list[Curve], steps: Steps) -> None:
    """Shift of a line by amplitude, and error by time step."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_amplitudes(left, curves)
    _draw_timesteps(right, steps)
    figure.savefig(path, dpi=120)


def _draw_amplitudes(ax: Axes, curves: list[Curve]) -> None:
    for i, curve in enumerate(curves):
        law = amplitude_law(curve.chain, curve.mode)
        label = f"N = {curve.chain.masses}, mode {curve.mode}, $k = {curve.chain.ratio:g}\\,T_0/l_0$: {curve.coefficient:.4g}"
        ax.loglog(curve.amplitudes, law * curve.amplitudes**2, "-", color=f"C{i}", lw=1)
        ax.loglog(curve.amplitudes, curve.shifts, "os^Dv"[i % 5], color=f"C{i}", ms=5, label=label)
    ax.set(
        xlabel="amplitude ($l_0$)",
        ylabel="relative rise of the frequency",
        title="A line rises with the square of the amplitude\n(points: simulated; lines: harmonic balance)",
    )
    ax.legend(fontsize=8, title="coefficient of (amplitude/$l_0$)²", title_fontsize=8)
    ax.minorticks_off()
    ax.grid(alpha=0.3)


def _draw_timesteps(ax: Axes, steps: Steps) -> None:
    chain = steps.chain
    dense = np.geomspace(steps.timesteps[-1], steps.timesteps[0], 60)
    shown = sorted({0, chain.masses // 2, chain.masses - 1})
    for i, j in enumerate(shown):
        line = chain.frequencies[j]
        ax.loglog(dense * 1e6, leapfrog(line, dense) / line - 1, "-", color=f"C{i}", lw=1)
        ax.loglog(
            steps.timesteps * 1e6,
            steps.errors[:, j],
            "os^"[i],
            color=f"C{i}",
            ms=5,
            label=f"line {j + 1}, {line:.1f} Hz",
        )
    ax.axhline(1e-5, color="0.5", lw=1, ls="--")
    ax.annotate("1e-5, wanted", (dense[-1] * 1e6, 1.15e-5), color="0.4", fontsize=8, ha="right")
    ax.set(
        xlabel="time step (µs)",
        ylabel="relative error of the line",
        title=f"Second order in the time step, N = {chain.masses}\n(points: simulated; lines: leapfrog's dispersion)",
    )
    ax.legend(fontsize=8)
    ax.minorticks_off()
    ax.grid(alpha=0.3)


def draw_continuum(path: Path, table: list[dict[str, float]]) -> None:
    """The first line against the number of masses, and its distance from the continuous string's."""
    from matplotlib.figure import Figure

    masses, found, exact = (np.array([row[name] for row in table]) for name in ("masses", "simulated_Hz", "exact_Hz"))
    limit = continuum_frequency()
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.axhline(limit, color="k", lw=1, label=f"continuous string (2.9), {limit:.2f} Hz")
    left.semilogx(masses, exact, "-", color="C1", lw=1.5, label="exact discrete chain")
    left.semilogx(masses, found, "o", color="C0", ms=5, label="simulated")
    left.set(xlabel="masses N", ylabel="first line (Hz)", title="The first line tends to that of a continuous string")
    left.legend(fontsize=9)
    right.loglog(masses + 1, found / limit - 1, "o", color="C0", ms=5, label="simulated, above the continuous string")
    right.loglog(masses + 1, exact / limit - 1, "-", color="C1", lw=1.5, label="exact")
    right.loglog(masses + 1, 0.5 / (masses + 1), "k--", lw=1, label="1/(2 (N + 1))")
    right.loglog(
        masses + 1, np.abs(found / exact - 1), "s", color="C3", ms=4, label="simulated, off the exact discrete chain"
    )
    right.set(
        xlabel="springs N + 1", ylabel="relative difference", title="Its distance from the limit falls as 1/(N + 1)"
    )
    right.legend(fontsize=8, loc="center left", bbox_to_anchor=(0.0, 0.42))
    left.minorticks_off()
    right.minorticks_off()
    right.grid(alpha=0.3)
    figure.savefig(path, dpi=120)
