"""The curve against theory, and what its error is made of."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from openmm_filament import wlc
from systems.dna_force_extension.curve import CONTOUR, KT, MODULUS, PERSISTENCE, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_budget", "draw_curve"]


def draw_curve(path: Path, rows: Sequence[Row]) -> None:
    """Extensions with theory, and below them their deviation from the exact continuous chain."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 7.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1.3))
    _draw_curves(upper, rows)
    _draw_deviations(lower, rows)
    figure.savefig(path, dpi=150)


def draw_budget(path: Path, parts: Sequence[Row], wanted: np.ndarray) -> None:
    """The parts of the error at each force, stacked, under the error asked for."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.2), layout="constrained")
    ax = figure.subplots()
    force = np.array([part["force_pN"] for part in parts])
    edges = np.sqrt(force[1:] * force[:-1])
    ratio = force[1] / force[0]
    edges = np.concatenate([[force[0] / ratio**0.5], edges, [force[-1] * ratio**0.5]])
    below = np.zeros(len(parts))
    for name, label, colour in (
        ("discretisation", "segments (exact)", "C0"),
        ("stretch", "softer bonds (exact)", "C1"),
        ("time_step", "time step (estimated)", "C2"),
        ("two_standard_errors", "sampling, 2 standard errors", "C3"),
    ):
        size = np.array([abs(part[f"{name}_percent"]) for part in parts])
        ax.bar(edges[:-1], size, width=0.92 * np.diff(edges), bottom=below, align="edge", color=colour, label=label)
        below += size
    ax.stairs(100 * wanted, edges, baseline=None, color="k", lw=1.5, label="asked for")
    ax.set(
        xscale="log",
        xlabel="pulling force (pN)",
        ylabel="error of the mean extension (%)",
        title="DNA, 1 µm: what the error is made of",
    )
    figure.legend(loc="outside lower center", ncols=3, fontsize=9)
    figure.savefig(path, dpi=150)


def _draw_curves(ax: Axes, rows: Sequence[Row]) -> None:
    f = np.geomspace(0.03, 80, 200)
    low = f[f < 0.14]
    ax.plot(
        f,
        wlc.extension_exact(f, PERSISTENCE, CONTOUR, KT, stretch_modulus=MODULUS, finite=True),
        "k-",
        label="exact worm-like chain (finite, extensible)",
    )
    ax.plot(
        f,
        wlc.extension_marko_siggia(f, PERSISTENCE, CONTOUR, KT),
        "C0--",
        label="Marko-Siggia (infinite, inextensible)",
    )
    ax.plot(f, wlc.extension_fjc(f, PERSISTENCE, CONTOUR, KT), "C2-.", label="freely jointed chain, Kuhn length 106 nm")
    ax.plot(low, wlc.extension_hookean(low, PERSISTENCE, CONTOUR, KT), "C1:", lw=2, label="Hookean, small forces")
    ax.errorbar(
        *_points(rows), fmt="o", color="C3", ms=5, capsize=3, label="OpenMM, Langevin dynamics (2 standard errors)"
    )
    ax.axhline(CONTOUR, color="0.7", lw=0.8)
    ax.annotate("contour length", (0.032, CONTOUR), textcoords="offset points", xytext=(0, 4), color="0.4", fontsize=9)
    ax.set(
        xscale="log",
        ylabel="mean extension (nm)",
        ylim=(0, 1130),
        title="Double-stranded DNA: 1 µm, persistence length 53 nm, 1000 pN, 298 K",
    )
    ax.legend(loc="lower right", fontsize=9)


def _points(rows: Sequence[Row]) -> tuple[list[float], list[float], list[float]]:
    return (
        [r["force_pN"] for r in rows],
        [r["extension_nm"] for r in rows],
        [2 * r["extension_error_nm"] for r in rows],
    )


def _draw_deviations(ax: Axes, rows: Sequence[Row]) -> None:
    force, extension, error = (np.array(column) for column in _points(rows))
    exact = np.array([r["exact_continuous_nm"] for r in rows])
    discrete = np.array([r["exact_discrete_nm"] for r in rows])
    ax.axhline(0, color="k", lw=1)
    ax.fill_between([0.03, 80], -1, 1, color="0.92", label="±1 %")
    ax.plot(force, 100 * (discrete / exact - 1), "k_", ms=10, label="exact discrete chain that was run")
    ax.errorbar(force, 100 * (extension / exact - 1), 100 * error / exact, fmt="o", color="C3", ms=4, capsize=3)
    ax.set(xlabel="pulling force (pN)", ylabel="deviation from the exact\ncontinuous chain (%)", xlim=(0.03, 80))
    ax.legend(loc="upper right", fontsize=9)
