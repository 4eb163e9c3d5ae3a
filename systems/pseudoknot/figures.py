"""The figures: the works against speed, the course of one knot, its energies, and what the numbers of the wire do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from systems.pseudoknot.judgement import Outcome, Setting, Slow, least
from systems.pseudoknot.plan import BASE
from systems.pseudoknot.runs import Result

__all__ = ["course", "energies", "parameters", "summary"]

_MAKE, _REST, _BREAK = "#0072B2", "#999999", "#D55E00"
_MOST = 12
"""Lines of single pairs drawn at most."""


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def course(path: Path, shown: Result) -> None:
    """Linking integral, force and work of the pairs of the slowest ensemble against time."""
    drawing = _figure(8.5, 8.5)
    upper, middle, lower = drawing.subplots(3, 1, sharex=True)
    energy, radius = shown.task.lower.energy, shown.task.lower.radius
    begun = 0.0
    names = ("screwed in", "left alone, warm", "pulled straight out")
    for phase, colour, name in zip(
        (shown.making, shown.resting, shown.breaking), (_MAKE, _REST, _BREAK), names, strict=True
    ):
        times = 1e3 * (begun + phase.times)
        pairs = min(phase.link.shape[1] - 1, _MOST)
        upper.plot(times, phase.link[:, :pairs], color=colour, lw=0.8, alpha=0.7)
        if np.isfinite(phase.lost).all():
            pull = phase.force[:, :pairs, 2] * radius / energy
            middle.plot(times, _smoothed(pull), color=colour, lw=0.8, alpha=0.7)
            work = np.maximum(phase.work[:, :pairs] / energy, 1e-5)
            lower.plot(times, work, color=colour, lw=0.8, alpha=0.7)
        for axes in (upper, middle, lower):
            axes.axvspan(times[0], times[-1], color=colour, alpha=0.06, lw=0)
        place, side = (times[-1], "right") if phase is shown.resting else (times.mean(), "center")  # a narrow band
        upper.text(place, 1.02, name, color=colour, ha=side, va="bottom", transform=upper.get_xaxis_transform())
        begun += float(phase.times[-1])
    upper.axhline(0, color="0.7", lw=0.8)
    upper.set(ylabel="Gauss linking integral")
    middle.set(ylabel="pull of the hand along the axis\nover E I/R$^2$, running mean")
    lower.set(ylabel="work of the hand\nover E I/R", yscale="log", ylim=(1e-4, 5), xlabel="time (ms)")
    drawing.suptitle(f"{pairs} of the attempts at the slowest speed: brought together, left alone, pulled apart")
    drawing.savefig(path, dpi=150)


def _smoothed(values: Any) -> Any:
    """Running means over 25 records, (K, n): coils ring, freed ones as strongly as they were pulled."""
    width = min(25, len(values))
    sums = np.cumsum(np.concatenate([np.zeros((1, values.shape[1])), values]), axis=0)
    means = (sums[width:] - sums[:-width]) / width
    return np.concatenate(
        [np.repeat(means[:1], width // 2, axis=0), means, np.repeat(means[-1:], (width - 1) // 2, axis=0)]
    )


def energies(path: Path, shown: Result) -> None:
    """Where the work goes, of all pairs of the slowest ensemble together, and what is missing from the balance."""
    drawing = _figure(9.5, 6.0)
    panels = drawing.subplots(2, 2, sharex="col", height_ratios=(3, 1))
    energy = shown.task.lower.energy * len(shown.task.poses)
    for (upper, lower), phase, title in zip(
        panels.T, (shown.making, shown.breaking), ("making", "breaking"), strict=True
    ):
        times = 1e3 * phase.times
        stored, moving = (part - part[0] for part in (phase.stored, phase.kinetic))
        work, lost = phase.work.sum(axis=1), phase.lost.sum(axis=1)
        for values, colour, name in (
            (work, "k", "work of the hand"),
            (stored, "#009E73", "stored: elastic, contact, traps"),
            (moving, "#56B4E9", "kinetic"),
            (lost, _BREAK, "lost to friction"),
        ):
            upper.plot(times, values / energy, color=colour, lw=1.2, label=name)
        scale = max(abs(float(values[-1])) for values in (work, stored + moving, lost))
        lower.plot(times, 100 * (work - stored - moving - lost) / scale, color="k", lw=0.8)
        for level in (-1, 1):
            lower.axhline(level, color="0.7", lw=0.8, ls="--")
        lower.set(xlabel="time (ms)", ylim=(-1.6, 1.6))
        upper.set(title=f"{title}: misfit {100 * phase.misfit:.2g} % at the end")
    panels[0, 0].set(ylabel="energy a pair over E I/R\n(a coil moved alone counts as one)")
    panels[1, 0].set(ylabel="missing (%)")
    panels[0, 1].legend(fontsize=9)
    drawing.suptitle("Work in = stored + kinetic + lost: three independent countings")
    drawing.savefig(path, dpi=150)


def summary(path: Path, table: list[Setting], found: Outcome) -> None:
    """Works against speed with their slow limits, and the settings without a number side by side."""
    drawing = _figure(11.0, 5.2)
    left, right = drawing.subplots(1, 2, width_ratios=(1, 1.25))
    making, breaking = found.net_making, found.net_breaking
    said = f"{found.ratio[0]:.0f} $\\pm$ {found.ratio[1]:.0f}"
    if not making.resolved:
        low = least(making, breaking)
        said = "not told" if np.isnan(low) else f"at least {low:.0f} (two standard errors)"
    for works, colour, name in ((making, _MAKE, "making"), (breaking, _BREAK, "breaking")):
        _limit(left, works, colour, name)
    left.set(
        yscale="log",
        ylim=(2e-4, 8),
        xlabel="speed of the hand (m/s)",
        ylabel="work beyond that on a coil moved alone, over E I/R",
        title=f"slow limits: ratio {said}",
    )
    left.legend(fontsize=8, loc="upper left", bbox_to_anchor=(0.0, -0.12), ncols=2)
    shown = [line for line in table if line.group in {"base", "control", "way"}]
    _bars(right, sorted(shown, key=lambda line: line.group != "base"))
    drawing.savefig(path, dpi=150)


def _limit(axes: Any, works: Slow, colour: str, name: str) -> None:
    energy = BASE.energy
    jitter = np.linspace(-0.02, 0.02, works.works.shape[1]) * works.speeds.max()
    for speed, values in zip(works.speeds, works.works, strict=True):
        axes.plot(speed + jitter, np.maximum(values / energy, 2.2e-4), ".", color=colour, ms=4, alpha=0.5)
    means = works.works.mean(axis=1)
    errors = works.works.std(axis=1, ddof=1) / np.sqrt(works.works.shape[1])
    axes.errorbar(
        works.speeds,
        means / energy,
        2 * errors / energy,
        fmt="o",
        color=colour,
        capsize=3,
        label=f"{name}, mean, 2 std. errors",
    )
    line = np.linspace(0, works.speeds.max(), 100)
    fitted = (works.mean + works.slope * line) / energy
    axes.plot(line, np.where(fitted > 0, fitted, np.nan), "-", color=colour, lw=1)
    axes.errorbar(
        [0],
        [works.mean / energy],
        [2 * works.error / energy],
        fmt="D",
        mfc="w",
        color=colour,
        capsize=3,
        label=f"{name}, slow limit",
    )


def _bars(axes: Any, lines: list[Setting]) -> None:
    """Works of contact of each setting, with the share that formed."""
    place = np.arange(len(lines))[::-1]
    least = 1e-4
    for values, colour, offset, name in (
        ([line.making / line.energy_unit for line in lines], _MAKE, 0.2, "making"),
        ([line.breaking / line.energy_unit for line in lines], _BREAK, -0.2, "breaking, of what formed"),
    ):
        shown = [0 if np.isnan(value) else max(value, least) for value in values]
        axes.barh(place + offset, shown, 0.36, color=colour, label=name)
        for y, value in zip(place + offset, values, strict=True):
            if not np.isnan(value):
                text = f"{value:.2g}" if value > least else f"{value:.1g}"
                axes.text(max(value, least) * 1.15, y, text, va="center", fontsize=8)
    names = [f"{line.label}\n{line.formed} of {line.starts} form" for line in lines]
    axes.set_yticks(place, names, fontsize=8)
    axes.set(
        xscale="log", xlim=(least, 20), xlabel="work of contact over E I/R", title="controls, and other ways in and out"
    )
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(0.0, -0.12), ncols=2)


_NAMES = {
    "E_GPa": "E (GPa), G/E kept",
    "G_over_E": "G/E",
    "helix_radius_mm": "helix radius / thickness",
    "pitch_mm": "pitch / thickness",
    "thickness_mm": "thickness (mm), radius and pitch kept",
    "clumsiness": "largest offset / thickness,\nlargest tilt / 0.1 rad",
    "crossing_deg": "angle of the axes (degrees)",
}


def parameters(path: Path, table: list[Setting]) -> None:
    """Probability, holding force, works and ratio against each number that was varied."""
    groups = [group for group in _NAMES if any(line.group == group for line in table)]
    if not groups:
        return
    drawing = _figure(2.9 * len(groups) + 0.8, 9.5)
    panels = drawing.subplots(4, len(groups), sharex="col", sharey="row", squeeze=False)
    base = [line for line in table if line.group == "base"]
    for column, group in zip(panels.T, groups, strict=True):
        own = {"G_over_E": BASE.shear_modulus / BASE.youngs_modulus, "helix_radius_mm": 1e3 * BASE.radius}
        own |= {"pitch_mm": 1e3 * BASE.pitch, "thickness_mm": 1e3 * BASE.thickness, "clumsiness": 1.0}
        own |= {"crossing_deg": 0.0, "E_GPa": 1e-9 * BASE.youngs_modulus}
        points = [(line.value, line) for line in table if line.group == group] + [(own[group], line) for line in base]
        points.sort(key=lambda point: point[0])
        x = np.array([value for value, _ in points])
        lines = [line for _, line in points]
        probability = np.array([line.probability for line in lines])
        low, high = np.array([(line.probability_low, line.probability_high) for line in lines]).T
        both = [probability - low, high - probability]
        column[0].errorbar(x, probability, both, fmt="o-", color="k", lw=1, ms=4, capsize=3)
        _errors(
            column[1],
            x,
            [(line.holding / line.force_unit, line.holding_error / line.force_unit) for line in lines],
            "k",
        )
        for name, colour in (("making", _MAKE), ("breaking", _BREAK)):
            values = [
                (getattr(line, name) / line.energy_unit, getattr(line, f"{name}_error") / line.energy_unit)
                for line in lines
            ]
            _errors(column[2], x, values, colour, name)
        _errors(column[3], x, [(line.ratio, line.ratio_error) for line in lines], "k")
        column[3].axhline(100, color="0.7", lw=0.8, ls="--")
        column[0].set(ylim=(-0.05, 1.1))
        column[2].set(yscale="log", ylim=(5e-6, 10))
        column[3].set(yscale="log", ylim=(3, 2e5), xlabel=_NAMES[group])
        for axes in column:
            if group in {"E_GPa", "G_over_E", "clumsiness"}:
                axes.set(xscale="log")
                axes.set_xticks(x, [f"{value:.2g}" for value in x])
                axes.set_xticks([], minor=True)
    for axes, label in zip(
        panels[:, 0],
        ("probability of forming", "holding force\nover E I/R$^2$", "work of contact\nover E I/R", "breaking / making"),
        strict=True,
    ):
        axes.set(ylabel=label)
    panels[2, 0].legend(fontsize=8)
    drawing.suptitle(
        "The knot's numbers varied one at a time, all at one speed in units of the coil's own swing (bars: one standard error)"
    )
    drawing.savefig(path, dpi=150)


def _errors(axes: Any, x: Any, values: list[tuple[float, float]], colour: str, name: str | None = None) -> None:
    y, error = np.array(values).T
    axes.errorbar(x, y, np.nan_to_num(error), fmt="o-", color=colour, lw=1, ms=4, capsize=3, label=name)
