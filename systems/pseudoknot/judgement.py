"""What the ensemble says: slow limits of the works, their ratio, the table of settings, checks and findings."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from systems.pseudoknot.plan import BASE, Case
from systems.pseudoknot.rows import Row
from systems.pseudoknot.runs import CLOSES, Result
from systems.scene import Check

__all__ = ["Outcome", "Setting", "Slow", "checks", "least", "outcome", "settings", "slow", "write_settings"]

Array = NDArray[np.float64]

PASSED = 0.5
"""Jump of the linking integral between records that a passage of one chain through the other would exceed: it makes 1."""

ALIKE = 1e-3
"""Relative difference of works in units of E I/R that E and G of another size may make."""

_THESIS = 100.0, 0.3
"""The ratio of breaking to making that "nearly two orders of magnitude" is taken for, and how far off, in decades, beside two
standard errors of the ratio."""


@dataclass(frozen=True, eq=False)
class Slow:
    """Works of the starts at speed zero, by a straight line through those at the speeds: their mean, its standard error.

    `slope` is the mean slope in J s/m, `each` the intercepts, `speeds` and `works` (S,), (S, starts) what they come from.
    """

    mean: float
    error: float
    slope: float
    each: Array
    speeds: Array
    works: Array

    @property
    def resolved(self) -> bool:
        """Whether it is two standard errors above zero."""
        return self.mean >= 2 * self.error

    @property
    def most(self) -> float:
        """Two standard errors above the mean, J."""
        return self.mean + 2 * self.error


def slow(rows: list[Row], work: str, speed: str) -> Slow:
    """The slow limit of a work of the main ensemble, over the starts that formed at every speed.

    Raises ValueError with fewer than two speeds or starts.
    """
    main = [row for row in rows if row.group == "main"]
    paces = sorted({row.slowness for row in main})
    formed = [{row.start for row in main if row.slowness == pace and row.formed} for pace in paces]
    starts = sorted(set.intersection(*formed)) if formed else []
    if len(paces) < 2 or len(starts) < 2:
        raise ValueError(f"A slow limit needs two speeds and two starts, but there are {len(paces)} and {len(starts)}.")
    found = {(row.slowness, row.start): row for row in main}
    speeds = np.array([getattr(found[pace, starts[0]], speed) for pace in paces])
    works = np.array([[getattr(found[pace, start], work) for start in starts] for pace in paces])
    slopes, each = np.polyfit(speeds, works, 1)
    error = float(each.std(ddof=1) / math.sqrt(len(each)))
    return Slow(float(each.mean()), error, float(slopes.mean()), each, speeds, works)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Slow limits of making and breaking, as done by the hand and net of what a chain moved alone takes; the ratio of the net."""

    making: Slow
    breaking: Slow
    net_making: Slow
    net_breaking: Slow
    ratio: tuple[float, float]


def outcome(rows: list[Row]) -> Outcome:
    """From the main ensemble."""
    making, net_making = (slow(rows, name, "making_speed") for name in ("work_making", "net_making"))
    breaking, net_breaking = (slow(rows, name, "breaking_speed") for name in ("work_breaking", "net_breaking"))
    return Outcome(making, breaking, net_making, net_breaking, _ratio(net_breaking, net_making))


def least(making: Slow, breaking: Slow) -> float:
    """What the ratio is at least, by two standard errors of making; NaN where that is below zero: no work is, when slow."""
    return breaking.mean / making.most if making.most > 0 else math.nan


def _ratio(breaking: Slow, making: Slow) -> tuple[float, float]:
    """Of the means, and half the width of the middle 68 % of what drawing the starts anew gives."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(len(making.each), size=(4000, len(making.each)))
    ratios = breaking.each[drawn].mean(axis=1) / making.each[drawn].mean(axis=1)
    low, high = np.percentile(ratios, (16, 84))
    return breaking.mean / making.mean, float(high - low) / 2


@dataclass(frozen=True)
class Setting:
    """One case at one speed: what forms, what it costs and what it holds, in J and N, and over E I/R and E I/R^2.

    Works are net of what a chain moved alone takes; works of breaking and forces are those of the pairs that formed. The
    probability's bounds are Wilson's at one standard deviation.
    """

    label: str
    group: str
    value: float
    slowness: float
    starts: int
    formed: int
    freed: int
    probability: float
    probability_low: float
    probability_high: float
    making: float
    making_error: float
    breaking: float
    breaking_error: float
    holding: float
    holding_error: float
    ratio: float
    ratio_error: float
    energy_unit: float
    force_unit: float


def settings(rows: list[Row], cases: list[Case]) -> list[Setting]:
    """A line for each case and speed."""
    out = []
    for case in cases:
        for pace in case.slowness:
            chosen = [row for row in rows if row.label == case.label and row.slowness == pace]
            if not chosen:
                continue
            knots = [row for row in chosen if row.formed]
            making = _mean([row.net_making for row in knots or chosen])
            breaking, holding = _mean([row.net_breaking for row in knots]), _mean([row.holding for row in knots])
            n, k = len(chosen), len(knots)
            ratio = breaking[0] / making[0]
            spread = ratio * math.hypot(breaking[1] / breaking[0], making[1] / making[0]) if knots else math.nan
            energy = case.lower.energy
            out.append(
                Setting(
                    case.label, case.group, case.value, pace, n, k, sum(not math.isnan(row.freed_at) for row in knots),
                    k / n, *_wilson(k, n), *making, *breaking, *holding, ratio, abs(spread),
                    energy, energy / case.lower.radius,
                )
            )  # fmt: skip
    return out


def _wilson(formed: int, starts: int) -> tuple[float, float]:
    """Wilson's bounds of a probability at one standard deviation: within 0 and 1, where k/n itself has no error at either."""
    half = math.sqrt(formed * (starts - formed) / starts + 0.25)
    return max((formed + 0.5 - half) / (starts + 1), 0.0), min((formed + 0.5 + half) / (starts + 1), 1.0)


def _mean(values: list[float]) -> tuple[float, float]:
    """And its standard error; NaN of nothing."""
    if not values:
        return math.nan, math.nan
    error = float(np.std(values, ddof=1)) / math.sqrt(len(values)) if len(values) > 1 else math.nan
    return float(np.mean(values)), error


def write_settings(path: Path, table: list[Setting]) -> None:
    """`parameters.csv`: a line a setting, SI units in the head."""
    units = dict.fromkeys(("making", "making_error", "breaking", "breaking_error", "energy_unit"), "_J")
    units |= dict.fromkeys(("holding", "holding_error", "force_unit"), "_N")
    names = list(Setting.__dataclass_fields__)
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow([name + units.get(name, "") for name in names])
        for line in table:
            values = [getattr(line, name) for name in names]
            writer.writerow([f"{v:.6g}" if isinstance(v, float) else v for v in values])


def _thesis(found: Outcome) -> Check:
    """The thesis's ratio, of works net of what a chain moved alone takes: a line to zero speed misses its friction.

    Where making is not resolved from zero, against the least that the ratio may be.
    """
    name = (
        'work of breaking over work of making, both net and slow{}: "nearly two orders of magnitude", error in decades'
    )
    (ratio, error), (near, room) = found.ratio, _THESIS
    if not found.net_making.resolved:
        low = least(found.net_making, found.net_breaking)
        far = max(math.log10(low / near), 0.0) if low > 0 else math.inf
        return Check(name.format(", at least (two standard errors of making)"), "claim", low, near, far, room)
    if ratio <= 0:
        return Check(name.format(""), "claim", ratio, near, math.inf, room)
    far = abs(math.log10(ratio / near))
    return Check(name.format(""), "claim", ratio, near, far, room + 2 * error / ratio / math.log(10))


def checks(
    results: list[tuple[Case, float, Result]], rows: list[Row], found: Outcome | None, failed: int = 0
) -> list[Check]:
    """Energy, passage, dimensions and that no setting failed are exact; the thesis's ratio, hold and rods are claims.

    Without slow limits the ratio is left out, and what needs a pair where there is none.
    """
    ran = Check("settings that could not be run", "exact", failed, 0.0, failed, 0.0)
    if not results:
        return [ran]
    misfit = max((phase.misfit for _, _, r in results for phase in (r.making, r.breaking)), key=abs)
    jump, nearest = max(row.largest_jump for row in rows), min(row.nearest for row in rows)
    gap = math.sqrt(0.5) * BASE.spacing
    kept = [row.link_kept / row.link_made for row in rows if row.group == "main" and row.made]
    out = [
        ran,
        Check("energy: work less stored less lost to friction, worst Context, over the largest of them",
              "exact", misfit, 0.0, abs(misfit), CLOSES),
        Check("no chain passed through another: largest jump of a linking integral between records",
              "exact", jump, 0.0, jump, PASSED),
        Check("no chain passed through another: nearest beads of two chains over the diameter (crossing bonds need "
              f"{gap:.2f})", "exact", nearest, 1.0, max(1 - nearest, 0.0), 1 - gap),
    ]  # fmt: skip
    if kept:
        out.append(
            Check("the knot holds with no load: smallest linking integral after rest in thermal motion over that made",
                  "claim", min(kept), 1.0, max(1 - min(kept), 0.0), 0.5))  # fmt: skip
    if found is not None:
        out.append(_thesis(found))
    twins = {row.start: row for row in rows if row.label == "unscrewed"}
    scaled = [row for row in rows if row.group == "E_GPa" and row.start in twins]
    if scaled:
        scale = scaled[0].value * 1e9 / BASE.youngs_modulus
        worst = max((row.work_making / scale / twins[row.start].work_making - 1 for row in scaled), key=abs)
        text = "E and G ten times larger: work of making over E I/R, largest relative difference"
        out.append(Check(text, "exact", worst, 0.0, abs(worst), ALIKE))
    rods = [row for row in rows if row.label == "two rods"]
    if rods:
        pull = max(abs(row.net_breaking) for row in rods) / BASE.energy
        out.append(Check("two straight rods come apart for nothing: largest work of contact over E I/R", "claim", pull, 0.0,
                         pull, 0.05))  # fmt: skip
    return out
