"""The curves of the planar chain, cold and hot, and its shapes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from openmm import unit

import openmm_filament as of
from systems import stage
from systems.planar_force_extension import chain, cold, fits, warm
from systems.planar_force_extension.hot import Sampled
from systems.planar_force_extension.report import EXACT, MARKO_SIGGIA, compared

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["answer", "cold_curves", "pictures"]


def cold_curves(
    path: Path, curves: Sequence[cold.Curve], fitted: dict[float, list[fits.Fit]], back: Sequence[cold.Point]
) -> None:
    """Figure 3.4 of the thesis: the five curves and their fits, what the fits leave, and all curves against F/E."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 8.0), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.25, 1), height_ratios=(1.7, 1))
    upper, lower = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[1, 0])
    master, over = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    fine = np.geomspace(1e-4, 1.0, 200)
    for i, curve in enumerate(curves):
        color, label = f"C{i}", f"{curve.young / 1e9:g} GPa"
        force = np.array([p.force for p in curve.converged])
        extension = np.array([p.extension for p in curve.converged]) / chain.CONTOUR
        upper.plot(force, extension, "o", color=color, ms=4, label=f"E = {label}")
        for fit, style in zip(fitted[curve.young][:2], ("--", "-"), strict=True):
            drawn = fits.FORMS[fit.form](fine, fit.scale)
            upper.plot(fine, np.where(drawn > -0.05, drawn, np.nan), style, color=color, lw=1, alpha=0.8)
            lower.plot(force, fit.left, style, color=color, lw=1.2, marker="o", ms=2.5)
        master.plot(
            [cold.reduced_force(curve.young, f) for f in force],
            extension,
            "o",
            color=color,
            ms=5 - 0.6 * i,
            label=label,
        )
        over.plot(
            [cold.reduced_force(curve.young, f) for f in force],
            [p.over for p in curve.converged],
            "o",
            color=color,
            ms=4,
        )
    stiff = curves[-1].young
    down = [cold.reduced_force(stiff, p.force) for p in back]
    master.plot(down, [p.extension / chain.CONTOUR for p in back], "k:", lw=1.2, label="1000 GPa, letting go")
    over.plot(down, [p.over for p in back], "k:", lw=1.2)
    reduced = np.geomspace(3, 6e3, 50)
    master.plot(reduced, 1 + reduced / chain.STIFFNESS_RATIO, color="0.6", lw=1, label="straight, 1 + F/(E S)")
    for ax in (upper, master):
        ax.axhline(1.0, color="0.8", lw=0.8)
        ax.set(xscale="log", ylabel="end-to-end distance over contour, x/L", ylim=(0, 1.2))
    upper.plot([], [], "k--", lw=1, label="fit of (3.10) in 2D")
    upper.plot([], [], "k-", lw=1, label="fit of (3.12), Marko-Siggia")
    upper.legend(fontsize=8.5, loc="lower right")
    upper.set(title="Random planar chain of 30 segments, no temperature: L = 0.15 m, d = 0.1 mm")
    lower.axhline(0, color="k", lw=0.8)
    for edge in np.geomspace(1e-4, 1, 4)[1:-1]:
        lower.axvline(edge, color="0.8", lw=0.8)
    for at, text in zip(np.geomspace(1e-4, 1, 7)[1::2], fits.RANGES, strict=True):
        lower.text(at, 0.43, text, ha="center", color="0.4", fontsize=9)
    lower.set(xscale="log", ylim=(-0.5, 0.5), xlabel="force (N)", ylabel="curve less fit (of L)")
    master.set(title="One curve: the same points against F/E")
    master.legend(fontsize=8.5, loc="lower right")
    over.set(xscale="log", xlabel="force times l0/alpha = F l0²/(E I)", ylabel="joints snapped over")
    figure.savefig(path, dpi=140)


def answer(path: Path, curves: Sequence[cold.Curve], sampled: Sequence[Sampled], levels: Sequence[warm.Level]) -> None:
    """Whether missing noise explains the misfit: hot curves, how each shortening ends, and the misfit against temperature."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(16.0, 6.4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    _draw_curves(left, sampled, levels)
    _draw_shortening(middle, curves)
    _draw_misfit(right, levels)
    figure.suptitle(
        "Is missing thermal noise why no worm-like chain fits? The same planar chain, cold and hot", fontsize=14
    )
    figure.savefig(path, dpi=130)


def _colour(heat: float) -> Any:
    from matplotlib import colormaps

    return colormaps["plasma"](0.02 + 0.86 * (np.log10(heat) + 3) / 5)


def _draw_curves(ax: Axes, sampled: Sequence[Sampled], levels: Sequence[warm.Level]) -> None:
    from matplotlib.lines import Line2D

    zero = levels[0]
    ax.plot(zero.force, zero.extension, "k-", lw=1.8)
    fine = np.geomspace(1e-3, 10, 21)
    for heat in warm.HEATS:
        scale = warm.at_ease(heat)
        at = fine[fine < warm.LOST] if heat == warm.FROZEN else fine
        drawn = chain.Reduced(heat, warm.SOFTER * scale).exact(at * scale) / (1 + at / warm.SOFTER)
        ax.plot(at, drawn, "-", lw=1.3, color=_colour(heat))
    frozen = [s for s in sampled if warm.kind(s.job) == "frozen"]
    ax.plot(
        [s.job.force for s in frozen], [warm.exact(s.job) / warm.stretch(s.job) for s in frozen], "--", lw=1.3,
        color=_colour(warm.FROZEN),
    )  # fmt: skip
    marks = {"free": "o", "frozen": "s"}
    for s in sampled:
        bare = warm.stretch(s.job)
        ax.errorbar(
            s.job.force / warm.at_ease(s.job.heat), s.extension / bare, 2 * s.error / bare, fmt=marks[warm.kind(s.job)],
            ms=5, capsize=2, color=_colour(s.job.heat), mfc=None if compared(s) else "none",
        )  # fmt: skip
    ax.set(
        xscale="log", ylim=(-0.03, 1.55), xlabel="force times l0, over the larger of alpha and k_BT",
        ylabel="mean extension over contour, stretch taken out", title="OpenMM in 2D against the exact discrete chain",
        yticks=np.linspace(0, 1, 6),
    )  # fmt: skip
    lines = [Line2D([], [], color="k", lw=1.8, label="cold: static equilibrium")]
    lines += [Line2D([], [], color=_colour(heat), label=f"exact, k_BT/alpha = {heat:g}") for heat in warm.HEATS]
    lines.append(
        Line2D([], [], color=_colour(warm.FROZEN), ls="--", label=f"exact, {warm.FROZEN:g}, joints frozen as cold")
    )
    texts = {"free": "OpenMM, joints free", "frozen": "OpenMM, joints frozen as cold"}
    lines += [Line2D([], [], color="0.3", ls="", marker=mark, label=texts[kind]) for kind, mark in marks.items()]
    if not all(compared(s) for s in sampled):
        lines.append(Line2D([], [], color="0.3", ls="", marker="o", mfc="none", label="R-hat too large, not compared"))
    ax.legend(
        handles=lines, fontsize=8.5, loc="upper left", ncols=2, title="bars: 2 standard errors", title_fontsize=8.5
    )


def _draw_shortening(ax: Axes, curves: Sequence[cold.Curve]) -> None:
    cold_points = sorted(
        (cold.reduced_force(c.young, p.force), p.extension / chain.CONTOUR) for c in curves for p in c.converged
    )
    at, taken = np.array([point for point in cold_points if 3e-3 < point[0] < 100]).T
    ax.plot(at, 1 - taken / (1 + at / chain.STIFFNESS_RATIO), "k-", lw=1.8, label="cold: static equilibrium")
    f = np.geomspace(3e-3, 100, 19)
    for heat in (0.1, 1.0):
        for bent, style in ((True, "-"), (False, "--")):
            short = 1 - chain.Reduced(heat, bent=bent).exact(f) / (1 + f / chain.STIFFNESS_RATIO)
            label = f"k_BT/alpha = {heat:g}, {'bent' if bent else 'straight'} at rest"
            ax.plot(f, short, style, color=_colour(heat), lw=1.3, label=label)
        ax.plot(f, heat / (4 * np.sqrt(f)), ":", color=_colour(heat), lw=1.5)
    ax.plot([], [], ":", color="0.4", label="(3.10) of the straight chain, 1/√F")
    ax.set(
        xscale="log", yscale="log", ylim=(1e-5, 1.3), xlabel="force times l0/alpha", ylabel="1 - x/L, stretch taken out",
        title="The end: cold as 1/F², segments with noise\nas 1/F, a worm-like chain as 1/√F",
    )  # fmt: skip
    ax.legend(fontsize=8.5, loc="lower left")


def _draw_misfit(ax: Axes, levels: Sequence[warm.Level]) -> None:
    zero = levels[0]
    looks = {MARKO_SIGGIA: ("C0", "o"), EXACT: ("C3", "s")}
    styles = {"bent": "-", "frozen": ":", "straight": "--"}
    names = {"bent": "bends free to turn over", "frozen": "bends frozen", "straight": "straight at rest"}
    for form, (color, marker) in looks.items():
        ax.axhline(zero.fits[form].rms, color=color, lw=1)
        above = form == EXACT
        ax.text(
            90, zero.fits[form].rms * (1.03 if above else 0.97), f"cold chain, {form}", color=color, fontsize=8.5, ha="right",
            va="bottom" if above else "top",
        )  # fmt: skip
        for name, style in styles.items():
            chosen = [v for v in levels if v.name == name and v.heat > 0]
            ax.plot(
                [v.heat for v in chosen], [v.fits[form].rms for v in chosen], style, color=color, lw=1.3,
                marker=marker if name == "bent" else None, ms=4,
            )  # fmt: skip
    for form, (color, marker) in looks.items():
        ax.plot([], [], color=color, marker=marker, ms=4, label=form)
    for name, style in styles.items():
        ax.plot([], [], "k" + style, label=names[name])
    ax.set(
        xscale="log", yscale="log", ylim=(4e-3, 0.2), xlabel="k_BT/alpha", ylabel="rms misfit of the best fit (of L)",
        title="What the best worm-like chain leaves, exact curves",
    )  # fmt: skip
    ax.legend(fontsize=8.5, loc="lower right")


def pictures(folder: Path, curve: cold.Curve) -> list[str]:
    """The chain drawn out, as a still and a film; a finding where it cannot be drawn."""
    if not of.rendering.available():
        return [stage.NO_PICTURES]
    points = curve.converged
    radius = 2 * chain.RADIUS * unit.meter
    chosen = [0, len(points) // 2, len(points) * 3 // 4, len(points) - 1]
    tall = [float(np.ptp(points[i].positions[:, 1])) for i in chosen]
    spread, floor = [], 0.0
    for i, height in zip(chosen, tall, strict=True):
        floor -= height + 0.008
        lift = np.array([0.0, floor - points[i].positions[:, 1].min(), 0.0])
        spread.append((points[i].positions + lift) * unit.meter)
    labels = ", ".join(f"{points[i].force:.2g}" for i in chosen)
    title = f"Random planar chain, E = {curve.young / 1e9:g} GPa, pulled cold"
    of.rendering.still(spread, folder / "still.png", radius=radius, title=f"{title} with {labels} N", plane="xy")
    shapes = np.array([p.positions for p in points]) * unit.meter
    of.rendering.animate(shapes, folder / "animation.mp4", radius=radius, fps=6, title=title, plane="xy")
    return []
