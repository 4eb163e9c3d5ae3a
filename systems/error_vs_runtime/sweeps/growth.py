"""Growth: what a bead and step cost from ten beads to a million, on each platform, with each term, in replicas and processes."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from statistics import median

import numpy as np
import openmm as mm

from openmm_filament.executors import available_workers
from openmm_filament.parallel import run_all
from systems.error_vs_runtime.integrators import available
from systems.error_vs_runtime.sweeps.timing import CROWDED, TERMS, WHOLE, Row, controlled, in_a_process, memory, timed

__all__ = ["CLEAR", "FLAT", "FLAT_FROM", "Growth", "crossover", "expected", "flatness", "grown"]

FLAT_FROM = 100
"""Beads from which on the cost of a bead and step is to be flat."""
FLAT = 0.15
"""Within what part of its median."""
CLEAR = 0.95
"""Ratio of costs below which one is lower, and not by chance: costs beside a control scatter by a few hundredths."""
_LARGE = 30_000
"""Beads up to which a model is built anew for each of its turns."""


@dataclass(frozen=True, eq=False)
class Growth:
    """All rows."""

    rows: list[Row]

    def sizes(self, platform: str) -> list[Row]:
        """Of one platform by size, the whole chain."""
        return [r for r in self.rows if r.kind == "size" and r.platform == platform]


def expected(*, quick: bool) -> float:
    """Seconds that all measurements are expected to take."""
    return 25.0 if quick else 180.0


@dataclass(frozen=True)
class _Job:
    """What makes so many timings of one thing: some in each turn, or all of them `once` where it takes long to begin."""

    take: Callable[[int], Row]
    once: bool = False
    timings: int = 1


def _jobs(sizes: list[int], *, quick: bool) -> list[_Job]:
    """All that is timed."""
    cores, control, platforms = available_workers(None), controlled(), _working()
    jobs: list[_Job] = []
    for platform in platforms:
        some = sizes
        if platform != "Reference" and quick:
            some = [1000, 10_000] if platform == "CPU" else [10_000]
        elif platform == "OpenCL":
            some = [100, 1000, 10_000, 100_000]
        several = 3 if platform == "Reference" and not quick else 1
        for threads in {1, cores} if platform == "CPU" else {1}:
            jobs += [
                _Job(
                    partial(timed, beads, WHOLE, platform, threads=threads, kind="size", control=control),
                    beads > _LARGE,
                    several,
                )
                for beads in some
            ]
    made_of = [(name, "Reference") for name in TERMS if name != CROWDED]
    if "CPU" in platforms:
        made_of += [(WHOLE, "CPU"), (CROWDED, "CPU")]
    jobs += [_Job(partial(timed, 1000, name, platform, kind="term", control=control)) for name, platform in made_of]
    jobs += [_Job(partial(timed, 20, "+ bending", "Reference", replicas=n, kind="replicas")) for n in (1, 4, 16, 64)]
    return jobs + [_Job(partial(_processes, workers), once=quick) for workers in sorted({1, cores})]


def _working() -> list[str]:
    """The platforms that run a chain: one may be there, but no device for it."""
    found = []
    for platform in available():
        with suppress(mm.OpenMMException):
            timed(10, "stretching", platform, 1, kind="size")
            found.append(platform)
    return found


def grown(*, quick: bool, progress: Callable[[float], None]) -> Growth:
    """All measurements: most of them in turns, so that what else the machine does falls on all of them."""
    rounds = 2 if quick else 5
    sizes = [10, 100, 1000, 10_000] if quick else [10, 30, 100, 300, 1000, 10_000, 100_000, 1_000_000]
    jobs = _jobs(sizes, quick=quick)
    turns = [i for _ in range(rounds) for i, job in enumerate(jobs) if not job.once]
    turns += [i for i, job in enumerate(jobs) if job.once]
    found: list[list[Row]] = [[] for _ in jobs]
    for done, i in enumerate(turns):
        found[i].append(jobs[i].take(jobs[i].timings * (rounds if jobs[i].once else 1)))
        progress(done / (len(turns) + 1))
    rows = [_together(each) for each in found]
    (added,) = run_all(memory, [sizes[-1]], 1, None)
    if added is not None:
        nothing = math.nan
        rows.append(Row("memory", sizes[-1], "Reference", WHOLE, 1, 1, nothing, nothing, nothing, bytes_per_bead=added))
    progress(1.0)
    return Growth(rows)


def _processes(workers: int, repeats: int) -> Row:
    """So many processes at once, each with 16 replicas of 20 beads: they do so many times the work.

    Raises KeyboardInterrupt where Ctrl-C came first.
    """
    lasting = 12 * repeats  # a second or more, beside which it matters little that one begins before the other
    finished = run_all(in_a_process, [(20, 16, lasting)] * workers, workers, None)
    each = [value / workers for value in finished if value is not None]
    if len(each) < workers:
        raise KeyboardInterrupt
    return Row("processes", 20, "Reference", "+ bending", workers, 16, median(each), min(each), max(each))


def _together(turns: list[Row]) -> Row:
    """One row of those of its turns."""
    return replace(
        turns[0],
        ns_per_bead_step=median(row.ns_per_bead_step for row in turns),
        least=min(row.least for row in turns),
        most=max(row.most for row in turns),
        build_seconds=median(row.build_seconds for row in turns),
        over_control=median(row.over_control for row in turns),
    )


def flatness(rows: list[Row]) -> float:
    """The largest deviation of the cost of a bead and step from its median over the sizes from 100 beads, as a part of it.

    Of costs over that of the control, which what else the machine does changes with them.
    """
    costs = np.array([r.over_control for r in rows if r.beads >= FLAT_FROM])
    return float(np.abs(costs / np.median(costs) - 1).max())


def crossover(slow: list[Row], fast: list[Row]) -> float:
    """The number of beads from which on the second platform is faster, straight on logarithmic axes; NaN if it never is.

    Faster is what takes less than `CLEAR` of the time.
    """
    cost = [{r.beads: r.over_control for r in rows} for rows in (slow, fast)]
    common = sorted(cost[0].keys() & cost[1].keys())
    ratio = [math.log(cost[1][n] / cost[0][n] / CLEAR) for n in common]
    if not common or ratio[-1] >= 0:
        return math.nan
    last = max((i for i, value in enumerate(ratio) if value >= 0), default=-1)
    if last < 0:
        return float(common[0])
    part = ratio[last] / (ratio[last] - ratio[last + 1])
    return float(common[last] * (common[last + 1] / common[last]) ** part)
