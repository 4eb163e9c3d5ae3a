"""The map: a row a chain, a column a setting, the error in each cell; beside it the limits of the time step and the drift."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from systems.stability.cells import Cell
from systems.stability.limits import LIMIT, Limit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw", "slope"]

_COLOURS = {"warned": "#f2c14e", "refused": "#8aa9d6", "wrong": "#d7263d", "not available": "#eeeeee"}
_WORDS = {"warned": "told", "refused": "refused", "wrong": "WRONG", "not available": "-"}


def slope(points: Sequence[tuple[float, float]]) -> float:
    """The power law through points (x, y)."""
    x, y = np.log(np.array(points)).T
    return float(np.polyfit(x, y, 1)[0])


def _right(error: float) -> tuple[float, float, float]:
    """Green, the lighter the larger the error, from 1e-16 to 0.1."""
    part = min(max((math.log10(max(error, 1e-16)) + 16) / 15, 0.0), 1.0)
    dark, light = np.array([0.36, 0.68, 0.45]), np.array([0.88, 0.95, 0.84])
    red, green, blue = dark + part * (light - dark)
    return float(red), float(green), float(blue)


def draw(
    path: Path, cells: Sequence[Cell], limits: Sequence[Limit], drifts: Sequence[tuple[float, float, float]]
) -> None:
    """Write the figure."""
    from matplotlib.figure import Figure

    axes = list(dict.fromkeys(cell.axis for cell in cells))
    rows = {axis: list(dict.fromkeys(c.case for c in cells if c.axis == axis)) for axis in axes}
    columns: list[list[str]] = [[], []]
    heights = [0.0, 0.0]
    for axis in sorted(axes, key=lambda a: -len(rows[a])):  # two columns of axes, of about the same height
        side = int(heights[1] + 6 < heights[0]) if heights[0] else 0
        columns[side].append(axis)
        heights[side] += len(rows[axis]) + 3
    figure = Figure(figsize=(27, 0.27 * max(heights[0], heights[1] + 20) + 1.5), layout="constrained")
    left, right = figure.subfigures(1, 2, wspace=0.01, squeeze=False)[0]
    for side, part, spare in ((left, columns[0], 0.0), (right, columns[1], 20.0)):
        shares = [len(rows[axis]) + 2.0 for axis in part]
        drawn = side.subplots(len(part) + bool(spare), 1, height_ratios=shares + [spare] * bool(spare), squeeze=False)[
            :, 0
        ]
        for ax, axis in zip(drawn, part, strict=False):
            _block(ax, axis, rows[axis], [c for c in cells if c.axis == axis])
        if spare:
            _series(drawn[-1], limits, drifts)
    said = ", ".join(f"{sum(c.outcome == n for c in cells)} {n}" for n in ("right", *_WORDS))
    figure.suptitle(
        f"What breaks it, by running: {said}\nin each cell the power of ten of the relative error, 0 where there is none",
        fontsize=17,
    )
    figure.savefig(path, dpi=75)


def _block(ax: Axes, axis: str, cases: Sequence[str], cells: Sequence[Cell]) -> None:
    """One axis of the map."""
    from matplotlib.patches import Rectangle

    settings = [label for _, label in sorted({(cell.value, cell.label) for cell in cells})]
    for cell in cells:
        x, y = settings.index(cell.label), cases.index(cell.case)
        colour = _right(cell.error) if cell.outcome == "right" else _COLOURS[cell.outcome]
        ax.add_patch(Rectangle((x - 0.48, y - 0.46), 0.96, 0.92, facecolor=colour))
        if cell.outcome == "right":
            text = "0" if cell.error < 1e-17 else f"{round(math.log10(cell.error))}"
        else:
            text = _WORDS[cell.outcome]
        ax.text(x, y, text, ha="center", va="center", fontsize=8.5 if len(text) < 5 or len(settings) < 14 else 6.5)
    ax.set(xlim=(-0.5, max(len(settings), 13) - 0.5), ylim=(len(cases) - 0.5, -0.5))
    ax.set_xticks(range(len(settings)), settings, fontsize=8, rotation=0 if len(settings) < 20 else 40)
    ax.set_yticks(range(len(cases)), cases, fontsize=9)
    ax.tick_params(length=0)
    ax.set_title(axis, fontsize=12, loc="left", fontweight="bold", pad=4)
    ax.spines[:].set_visible(False)


def _series(ax: Axes, limits: Sequence[Limit], drifts: Sequence[tuple[float, float, float]]) -> None:
    """Predicted over found limits of the time step; drift and spread of the energy against the step."""
    ax.set_axis_off()
    one, two = ax.inset_axes((0.02, 0.12, 0.43, 0.8)), ax.inset_axes((0.56, 0.12, 0.43, 0.8))
    kinds = {"stretch": "o", "bend": "s", "torsion": "^", "softer": "x", "one": "+"}
    for kind, mark in kinds.items():
        own = [v for v in limits if (f"limited by {kind}" in v.case) or (kind in ("softer", "one") and kind in v.case)]
        label = {"softer": "stiffness ratio to 1e12", "one": "mass ratio to 1e6"}.get(kind, f"limited by {kind}")
        one.plot([v.found for v in own], [v.predicted / v.found for v in own], mark, label=label)
    one.axhspan(1 - LIMIT, 1 + LIMIT, color="0.92", zorder=0)
    one.axhline(1, color="0.6", lw=0.8, zorder=0)
    one.set(xscale="log", ylim=(0.9, 1.1), xlabel="limit found by running (ps)", ylabel="predicted over found")
    one.set_title("Limit of the time step; band: 5 %", fontsize=11)
    one.legend(fontsize=8, loc="upper left", ncols=2)
    part, drift, spread = np.array(drifts).T
    two.loglog(part, spread, "o-", ms=4, label="spread about its mean")
    two.loglog(part, drift / 100, "s-", ms=4, label="drift in 10⁴ steps + 2 s.e.")
    guide = np.array([0.01, 0.4])
    two.loglog(guide, spread[0] * (guide / part[0]) ** 2, "k:", lw=1, label="second order")
    two.axvline(1, color="0.6", lw=0.8)
    two.set(xlabel="time step over the predicted limit", ylabel="relative to the energy of the motion")
    two.set_title("Energy of an undamped run", fontsize=11)
    two.legend(fontsize=8, loc="upper left")
