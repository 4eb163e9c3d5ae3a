"""What came of each pair: its works, forces and linking integrals, as rows of a table."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from systems.pseudoknot.plan import Case, linked
from systems.pseudoknot.runs import Result

__all__ = ["FREE", "STEADY", "Row", "rows_of", "steadily", "write_csv"]

Array = NDArray[np.float64]

FREE = 0.15
"""Linking integral below which, and out of touch, a pair counts as free: it falls slowly with the distance."""

STEADY = 0.1
"""Time over which a force is averaged, over the period of the slowest swing: coils that slip ring at several times that of a
segment, and single records of the force reach twice the mean. Twice the time changes the largest mean by a tenth."""


@dataclass(frozen=True)
class Row:
    """One pair.

    Attributes
    ----------
    start : int
        Number of the start: the same starts are used at all speeds and in all cases.
    making_speed, breaking_speed : float
        Way of the hand over the time, m/s; when screwing, that of a held bead along its helix.
    made, formed : bool
        Whether the two have at least half the linking integral of an ideal knot before and after they are left alone.
    freed_at : float
        Part of the pull after which they stay free; NaN if they do not come free.
    work_making, work_breaking : float
        Of the hand, J: from apart to entangled, and from entangled to free (else to the end of the pull).
    net_making, net_breaking : float
        The same less the work on an upper chain that is moved alone, against friction and inertia, J.
    holding : float
        Largest force along the pull beyond that on a chain moved alone, as a mean over `STEADY` periods, N.
    """

    label: str
    group: str
    value: float
    slowness: float
    start: int
    phase: float
    making_speed: float
    breaking_speed: float
    link_made: float
    link_kept: float
    link_broken: float
    made: bool
    formed: bool
    freed_at: float
    work_making: float
    net_making: float
    work_breaking: float
    net_breaking: float
    holding: float
    largest_jump: float
    nearest: float


def rows_of(case: Case, slowness: float, result: Result, first: int = 0) -> list[Row]:
    """The pairs of a task; the last, which is out of reach, is what they are compared with."""
    task, made, kept, broken = result.task, result.making, result.resting, result.breaking
    ideal = linked(case.lower)
    out = []
    for i, pose in enumerate(task.poses[:-1]):
        bound = (np.abs(broken.link[:, i]) > FREE) | (broken.touching[:, i] > 0)
        last = int(np.flatnonzero(bound)[-1]) + 1 if bound.any() else 0
        freed = last <= len(bound) - 1
        end = min(last, len(bound) - 1)
        along = np.array(task.breaking.along) / task.breaking.distance
        extra = (broken.force[: end + 1, i] - broken.force[: end + 1, -1]) @ along
        jumps = [float(np.abs(np.diff(phase.link[:, i])).max()) for phase in (made, kept, broken)]
        out.append(
            Row(
                case.label,
                case.group,
                case.value,
                slowness,
                first + i,
                pose.phase,
                task.making.length(task.upper.radius) / task.times[0],
                task.breaking.length(task.upper.radius) / task.times[2],
                float(made.link[-1, i]),
                float(kept.link[-1, i]),
                float(broken.link[-1, i]),
                bool(abs(made.link[-1, i]) >= ideal / 2),
                bool(abs(kept.link[-1, i]) >= ideal / 2),
                float(broken.parts[end]) if freed else float("nan"),
                float(made.work[-1, i]),
                float(made.work[-1, i] - made.work[-1, -1]),
                float(broken.work[end, i]),
                float(broken.work[end, i] - broken.work[end, -1]),
                steadily(extra, broken.times, task.lower.period()),
                max(jumps),
                float(min(phase.nearest[i] for phase in (made, kept, broken))),
            )
        )
    return out


def steadily(force: Array, times: Array, period: float) -> float:
    """The largest running mean of a force (K,) over `STEADY` periods; of all of it, where it is shorter than that."""
    records = round(STEADY * period / (times[1] - times[0]))
    window = min(max(records, 1), len(force))
    return float(np.convolve(force, np.full(window, 1 / window), "valid").max())


_UNITS = {
    "phase": "rad",
    "making_speed": "m_per_s",
    "breaking_speed": "m_per_s",
    "work_making": "J",
    "net_making": "J",
    "work_breaking": "J",
    "net_breaking": "J",
    "holding": "N",
}


def write_csv(path: Path, rows: list[Row]) -> None:
    """One line a pair, units in the head."""
    names = list(Row.__dataclass_fields__)
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow([f"{name}_{_UNITS[name]}" if name in _UNITS else name for name in names])
        for row in rows:
            values = [getattr(row, name) for name in names]
            writer.writerow([f"{v:.8g}" if isinstance(v, float) else v for v in values])
