"""Figures of the open ring: energies and bead paths of its motion, deflections, and how well its energy balances."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from systems.open_ring import static
from systems.open_ring.ring import Swing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["ANGLES", "LARGER", "SHAPES", "balance", "deflections", "energies", "paths"]

ANGLES: dict[float, str] = {
    0.0: "0",
    math.pi / 4: "π/4",
    -math.pi / 4: "-π/4",
    math.pi / 2: "π/2",
    -math.pi / 2: "-π/2",
}
"""Angles of the forces and their names."""

SHAPES = {True: "gap of one segment", False: "ends that meet"}
LARGER = 5
"""Factor of the displacements where pictures of small ones say so."""
COLOURS = {"internal": "k", "bending": "C0", "torsion": "C3", "stretching": "C2"}
MARKS = {"tangential": ("C0", "o"), "radial": ("C2", "s"), "normal": ("C3", "D")}


def energies(path: Path, runs: Mapping[tuple[bool, float], Swing]) -> None:
    """Energy of each term against time (the thesis's figure 2.7); the runs at -phi dotted over those at phi."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.4), layout="constrained")
    axes = figure.subplots(2, 3, sharex=True, sharey=True)
    for row, gap in zip(axes, SHAPES, strict=True):
        for ax, phi in zip(row, (0.0, math.pi / 4, math.pi / 2), strict=True):
            run = runs[gap, phi]
            for name, colour in COLOURS.items():
                label = "total internal" if name == "internal" else name
                ax.plot(
                    1e3 * run.times,
                    1e3 * run.energies[name],
                    colour,
                    label=label,
                    lw=2.4 if name == "internal" else 1.6,
                )
                if phi:
                    other = runs[gap, -phi]
                    every = max(1, len(other.times) // 60)
                    ax.plot(
                        1e3 * other.times[::every],
                        1e3 * other.energies[name][::every],
                        "o",
                        color=colour,
                        mfc="w",
                        ms=3,
                    )
            sign = "" if phi == 0 else "±"
            ax.set_title(f"φ = {sign}{ANGLES[phi]}, {SHAPES[gap]}", fontsize=10)
            ax.grid(alpha=0.3)
        row[0].set_ylabel("energy (mJ)")
    for ax in axes[1]:
        ax.set_xlabel("time (ms)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.suptitle("Open ring of 13 beads, opposite forces on its ends: energies in time (lines: +φ, circles: -φ)")
    figure.savefig(path, dpi=100)


def paths(path: Path, runs: Mapping[tuple[bool, float], Swing]) -> None:
    """Bead paths in space over the whole run (the thesis's figure 2.6), with the first shape and the last."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7.6), layout="constrained")
    axes = figure.subplots(2, 3, subplot_kw={"projection": "3d"})
    for row, gap in zip(axes, SHAPES, strict=True):
        for ax, phi in zip(row, (0.0, math.pi / 4, math.pi / 2), strict=True):
            run = runs[gap, phi]
            larger = 1 if gap and phi else LARGER
            x = 1e3 * (run.positions[0] + larger * (run.positions - run.positions[0]))
            ax.plot(*x[0].T, "-", color="0.6", lw=1.2)
            ax.plot(*x[-1].T, "-", color="k", lw=1.2)
            beads = np.arange(x.shape[1])
            for i in beads:
                ax.plot(*x[:, i].T, color=_colour(i / beads[-1]), lw=1.3)
            ax.scatter(*x[-1].T, c=beads, cmap="viridis", s=16, depthshade=False)
            for end in (0, -1):
                push = (1 if end == 0 else -1) * _direction(run)
                ax.quiver(*x[0, end], *(9 * push), color="C3", lw=1.8, arrow_length_ratio=0.3)
            _even(ax, x, ticks=larger == 1)
            drawn = "" if larger == 1 else f",\ndrawn with {larger} times the displacement (no scale)"
            ax.set_title(f"φ = {ANGLES[phi]}, {SHAPES[gap]}{drawn}", fontsize=10)
    figure.suptitle(
        "Paths of the 13 beads over 5 ms (grey: at rest; black: after 5 ms; red: the forces; scales in mm)\n"
        "φ: angle of the forces from the tangent at the cut towards the normal of the plane;\n"
        "gap of one segment: at rest the two ends are 10 mm apart, as any two neighbours; else they meet",
        fontsize=11,
    )
    figure.savefig(path, dpi=100)


def _direction(run: Swing) -> Any:
    force = run.model.pulls[0]
    return force / np.linalg.norm(force)


def _colour(fraction: float) -> Any:
    from matplotlib import colormaps

    return colormaps["viridis"](fraction)


def _even(ax: Any, x: Any, *, ticks: bool) -> None:
    """One scale for the three axes; numbers only where the displacement is drawn as it is."""
    middle, half = (x.max(axis=(0, 1)) + x.min(axis=(0, 1))) / 2, np.ptp(x, axis=(0, 1)).max() / 2
    ax.set(**{f"{axis}lim": (m - half, m + half) for axis, m in zip("xyz", middle, strict=True)})
    ax.set_box_aspect((1, 1, 1), zoom=1.12)
    ax.view_init(elev=28, azim=-38)
    ax.tick_params(labelsize=7, pad=-2)
    for axis in "xyz":
        getattr(ax, f"set_{axis}label")(f"{axis} (mm)" if ticks else axis, labelpad=-6)
        if not ticks:
            getattr(ax, f"set_{axis}ticklabels")([])


def deflections(
    path: Path, closed: Mapping[str, Mapping[int, float]], hess: Mapping[str, Mapping[int, float]],
    runs: Mapping[str, Mapping[int, float]], gap: Mapping[int, float],
) -> None:  # fmt: skip
    """Deviation of the small-load deflections from the cut ring against the number of beads."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.4, 5.2), layout="constrained")
    ax = figure.subplots()
    for name, (colour, mark) in MARKS.items():
        exact = static.cut_ring(name)

        def off(values: Mapping[int, float], exact: float = exact) -> tuple[list[int], list[float]]:
            return list(values), [100 * abs(v / exact - 1) for v in values.values()]

        formula = {"tangential": "3πPR³/EI", "radial": "πPR³/EI", "normal": "3πPR³/GJ"}[name]
        ax.loglog(
            *off(closed[name]),
            colour,
            lw=3 if name == "tangential" else 1.2,
            label=f"{name}, {formula}: statics of the bead chain",
        )
        ax.loglog(*off(hess[name]), mark, color=colour, mfc="none", ms=8, label="   Hessian")
        if name in runs:
            ax.loglog(*off(runs[name]), mark, color=colour, ms=4, label="   OpenMM, damped run")
    exact = static.cut_ring("tangential")
    ax.loglog(
        list(gap), [100 * abs(v / exact - 1) for v in gap.values()], "k--", lw=1, label="tangential, gap of one segment"
    )
    ax.set(
        xlabel="beads", ylabel="deviation from the cut ring (%)", title="Small-load deflection of a cut ring of beads",
        xticks=(13, 25, 49, 100, 200, 400), xticklabels=("13", "25", "49", "100", "200", "400"),
    )  # fmt: skip
    ax.minorticks_off()
    ax.grid(alpha=0.3, which="both")
    ax.legend(fontsize=8)
    figure.savefig(path, dpi=100)


def balance(
    path: Path,
    imbalance: Sequence[tuple[float, float]],
    shares: Mapping[bool, Sequence[tuple[float, float]]],
    drift: tuple[Any, Any, float, float],
) -> None:
    """Three panels: energy balance against the time step, bending at pi/2 against the load, energy of a long free run."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 4.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    step, error = np.array(imbalance).T
    left.loglog(step, error, "o-", color="C0", label="measured")
    left.loglog(step, error[-1] * (step / step[-1]) ** 2, "k:", label="second order")
    left.set(
        xlabel="time step (stability limits)", ylabel="largest difference over peak internal energy",
        title="Ring with a gap of one segment, φ = π/4:\nwork of the forces less kinetic and internal energy",
        xticks=step, xticklabels=[f"{s:.3g}" for s in step],
        ylim=(error.min() / 3, error.max() * 3),
    )  # fmt: skip
    _loaded(middle, shares)
    steps, values, slope, slope_error = drift
    right.plot(steps / 1e6, (values / values.mean() - 1) * 1e6, ".", color="0.6", ms=2)
    right.axhline(0, color="k", lw=0.8)
    right.set(
        xlabel="steps (millions)", ylabel="energy / mean - 1 (millionths)",
        title=f"Free ring, four modes: slope of its energy\n"
        f"({1e9 * slope:+.1f} ± {1e9 * slope_error:.1f})·10⁻⁹ per 10⁶ steps",
    )  # fmt: skip
    for ax in (left, middle):
        ax.minorticks_off()
        ax.legend(fontsize=9)
    for ax in (left, middle, right):
        ax.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


def _loaded(ax: Axes, shares: Mapping[bool, Sequence[tuple[float, float]]]) -> None:
    for gap, points in shares.items():
        load, share = np.array(points).T
        ax.loglog(load, share, "o-" if gap else "s-", color="C0" if gap else "C2", label=SHAPES[gap])
        ax.loglog(load, share[-1] * (load / load[-1]) ** 2, "k:", label="second order" if gap else None)
    ax.set(
        xlabel="force (N)",
        ylabel="bending over internal energy",
        title="Forces normal to the plane (φ = π/2):\nshare of bending, mean over 5 ms",
    )
