"""Growth: what a bead and step cost from ten beads to a million, on each platform, with each term, in replicas and processes."""

from __future__ import annotations

import gc
import math
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament.executors import available_workers
from openmm_filament.parallel import run_all
from systems.error_vs_runtime.integrators import available

__all__ = ["CROWDED", "TERMS", "WHOLE", "Growth", "Row", "crossover", "expected", "flatness", "grown"]

Array = NDArray[np.float64]

KJ = unit.kilojoule_per_mole
TERMS: dict[str, tuple[str, ...]] = {
    "stretching": ("stretching",),
    "+ bending": ("stretching", "bending"),
    "+ bending (arctangent)": ("stretching", "arctangent"),
    "+ bending + torsion": ("stretching", "bending", "torsion"),
    "+ bending + weighted torsion": ("stretching", "bending", "weighted"),
    "+ bending + torsion + electrostatics": ("stretching", "bending", "torsion", "electrostatics"),
    "+ bending + torsion + contact": ("stretching", "bending", "torsion", "contact"),
}
"""What chains are made of."""

WHOLE = "+ bending + torsion"
CROWDED = "+ bending + torsion + contact"
"""Measured beside WHOLE on the CPU platform, which contact is for: Reference makes its list of neighbours in every step."""
FLAT_FROM = 100
"""Beads from which on the cost of a bead and step is to be flat."""
FLAT = 0.15
"""Within what part of its median."""

_SPEND = 0.08
"""Seconds of one timing."""

_LARGE = 30_000
"""Beads up to which a model is built anew for each of its turns."""


@dataclass(frozen=True)
class Row:
    """One measurement: medians with the least and the largest of some repeats; NaN for what was not measured.

    `kind` is "size", "term", "replicas", "processes" or "memory".
    """

    kind: str
    beads: int
    platform: str
    terms: str
    workers: int
    replicas: int
    ns_per_bead_step: float
    least: float
    most: float
    build_seconds: float = math.nan
    bytes_per_bead: float = math.nan


@dataclass(frozen=True, eq=False)
class Growth:
    """All rows."""

    rows: list[Row]

    def sizes(self, platform: str) -> list[Row]:
        """Of one platform by size, the whole chain."""
        return [r for r in self.rows if r.kind == "size" and r.platform == platform]


def _model(beads: int, terms: str, replicas: int = 1) -> of.Model:
    """Helices: every term has something to do."""
    rest = of.shapes.helix(beads - 1, radius=2 * unit.nanometer, pitch=3 * unit.nanometer, turns=(beads - 1) / 12)
    every = {
        "stretching": of.stretching.Harmonic(200 * KJ / unit.nanometer**2),
        "bending": of.bending.Harmonic(20 * KJ),
        "arctangent": of.bending.Harmonic(20 * KJ, form="arctangent"),
        "torsion": of.torsion.Harmonic(4 * KJ),
        "weighted": of.torsion.Weighted(4 * KJ),
        "electrostatics": of.electrostatics.Neighbour(0.1 * unit.elementary_charge),
        "contact": of.contact.Repulsion(1 * unit.nanometer, 200 * KJ / unit.nanometer**2),
    }
    filament = of.Filament(rest, 10 * unit.dalton, tuple(every[name] for name in TERMS[terms]))
    return of.build([filament] * replicas if replicas > 1 else filament)


def _resident() -> float:
    """Resident memory of this process in bytes; NaN where the operating system does not say."""
    status = Path("/proc/self/statm")
    return float(status.read_text().split()[1]) * resource.getpagesize() if status.exists() else math.nan


def timed(
    beads: int, terms: str, platform: str, repeats: int, *, threads: int = 1, replicas: int = 1, kind: str
) -> Row:
    """Build a chain, run it by Verlet at a tenth of its limit, and time it."""
    begun = time.perf_counter()
    model = _model(beads, terms, replicas)
    integrator = mm.VerletIntegrator(1e-4)
    properties = {"CPU": {"Threads": str(threads)}, "OpenCL": {"Precision": "mixed"}}.get(platform, {})
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName(platform), properties)
    context.setPositions(model.positions)
    built = time.perf_counter() - begun
    _spend(context, 1)
    steps, spent = 1, _spend(context, 1)
    while spent < _SPEND / 4:
        steps *= 4
        spent = _spend(context, steps)
    steps = max(1, round(steps * _SPEND / spent))
    times = sorted(1e9 * _spend(context, steps) / steps / (beads * replicas) for _ in range(repeats))
    return Row(kind, beads, platform, terms, threads, replicas, median(times), times[0], times[-1], built)


def _spend(context: mm.Context, steps: int) -> float:
    begun = time.perf_counter()
    context.getIntegrator().step(steps)
    context.getState(positions=True)  # waits for the kernels of OpenCL
    return time.perf_counter() - begun


def _process(task: tuple[int, int, int]) -> float:
    """Nanoseconds of a bead and step in a process of its own, of so many replicas."""
    beads, replicas, repeats = task
    return timed(beads, "+ bending", "Reference", repeats, replicas=replicas, kind="processes").ns_per_bead_step


def _memory(beads: int) -> float:
    """Bytes a bead that a model of the whole chain and its Context add to a process that has just begun."""
    warm = _opened(10)  # what is loaded once is no matter of beads
    gc.collect()
    before = _resident()
    kept = _opened(beads)
    added = _resident() - before
    del warm, kept
    return added / beads


def _opened(beads: int) -> tuple[of.Model, mm.Context]:
    model = _model(beads, WHOLE)
    context = mm.Context(model.system, mm.VerletIntegrator(1e-4), mm.Platform.getPlatformByName("Reference"))
    context.setPositions(model.positions)
    return model, context


def expected(*, quick: bool) -> float:
    """Seconds that all measurements are expected to take."""
    return 20.0 if quick else 180.0


@dataclass(frozen=True)
class _Job:
    """What makes so many timings of one thing; `once` where it takes long to begin, with all of its timings."""

    take: Callable[[int], Row]
    once: bool


def _jobs(sizes: list[int], *, quick: bool) -> list[_Job]:
    """All that is timed."""
    cores = available_workers(None)
    jobs: list[_Job] = []
    for platform in available():
        some = sizes
        if platform != "Reference" and quick:
            some = [1000, 10_000] if platform == "CPU" else [10_000]
        elif platform == "OpenCL":
            some = [100, 1000, 10_000, 100_000]
        for threads in {1, cores} if platform == "CPU" else {1}:
            jobs += [
                _Job(partial(timed, beads, WHOLE, platform, threads=threads, kind="size"), beads > _LARGE)
                for beads in some
            ]
    made_of = [(name, "Reference") for name in TERMS if name != CROWDED]
    if "CPU" in available():
        made_of += [(WHOLE, "CPU"), (CROWDED, "CPU")]
    jobs += [_Job(partial(timed, 1000, name, platform, kind="term"), False) for name, platform in made_of]
    jobs += [
        _Job(partial(timed, 20, "+ bending", "Reference", replicas=n, kind="replicas"), False) for n in (1, 4, 16, 64)
    ]
    return jobs + [_Job(partial(_processes, workers), False) for workers in sorted({1, cores})]


def grown(*, quick: bool, progress: Callable[[float], None]) -> Growth:
    """All measurements: most of them in turns, so that what else the machine does falls on all of them."""
    rounds = 2 if quick else 5
    sizes = [10, 30, 100, 1000, 10_000, 30_000] if quick else [10, 30, 100, 300, 1000, 10_000, 100_000, 1_000_000]
    jobs = _jobs(sizes, quick=quick)
    turns = [i for _ in range(rounds) for i, job in enumerate(jobs) if not job.once]
    turns += [i for i, job in enumerate(jobs) if job.once]
    found: list[list[Row]] = [[] for _ in jobs]
    for done, i in enumerate(turns):
        found[i].append(jobs[i].take(rounds if jobs[i].once else 1))
        progress(done / (len(turns) + 1))
    rows = [_together(each) for each in found]
    (memory,) = run_all(_memory, [sizes[-1]], 1, None)
    if memory is not None:
        nothing = math.nan
        rows.append(
            Row("memory", sizes[-1], "Reference", WHOLE, 1, 1, nothing, nothing, nothing, bytes_per_bead=memory)
        )
    progress(1.0)
    return Growth(rows)


def _processes(workers: int, repeats: int) -> Row:
    """So many processes at once, each with 16 replicas of 20 beads: they do so many times the work."""
    lasting = 12 * repeats  # a second or more, beside which it matters little that one begins before the other
    finished = run_all(_process, [(20, 16, lasting)] * workers, workers, None)
    each = [value / workers for value in finished if value is not None]
    return Row("processes", 20, "Reference", "+ bending", workers, 16, median(each), min(each), max(each))


def _together(turns: list[Row]) -> Row:
    """One row of those of its turns."""
    return replace(
        turns[0],
        ns_per_bead_step=median(row.ns_per_bead_step for row in turns),
        least=min(row.least for row in turns),
        most=max(row.most for row in turns),
        build_seconds=median(row.build_seconds for row in turns),
    )


def flatness(rows: list[Row]) -> float:
    """The largest deviation of the cost of a bead and step from its median over the sizes from 100 beads, as a part of it.

    Of the shortest run of each size: what else the machine does only adds to it.
    """
    costs = np.array([r.least for r in rows if r.beads >= FLAT_FROM])
    return float(np.abs(costs / np.median(costs) - 1).max())


def crossover(slow: list[Row], fast: list[Row]) -> float:
    """The number of beads from which on the second platform is faster, straight on logarithmic axes; NaN if it never is."""
    common = sorted({r.beads for r in slow} & {r.beads for r in fast})
    ratio = [
        math.log(
            next(r.ns_per_bead_step for r in fast if r.beads == n)
            / next(r.ns_per_bead_step for r in slow if r.beads == n)
        )
        for n in common
    ]
    if not common or ratio[-1] >= 0:
        return math.nan
    last = max((i for i, value in enumerate(ratio) if value >= 0), default=-1)
    if last < 0:
        return float(common[0])
    part = ratio[last] / (ratio[last] - ratio[last + 1])
    return float(common[last] * (common[last + 1] / common[last]) ** part)
