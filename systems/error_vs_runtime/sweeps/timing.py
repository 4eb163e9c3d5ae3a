"""What a bead and step cost: chains that are built, run and timed."""

from __future__ import annotations

import gc
import math
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
import openmm as mm
from openmm import unit

import openmm_filament as of

__all__ = ["CONTROL", "CROWDED", "TERMS", "WHOLE", "Row", "controlled", "in_a_process", "memory", "timed"]

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
CONTROL = 1000
"""Beads of the chain that others are compared with in turn."""

_SPEND = 0.08
"""Seconds of one timing."""


@dataclass(frozen=True)
class Row:
    """One measurement: medians with the least and the largest of some repeats; NaN for what was not measured.

    `kind` is "size", "term", "replicas", "processes" or "memory". `over_control` is the cost over that of a chain of CONTROL
    beads that is run right before and after, whatever else the machine does meanwhile.
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
    over_control: float = math.nan


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
    beads: int,
    terms: str,
    platform: str,
    repeats: int,
    *,
    threads: int = 1,
    replicas: int = 1,
    kind: str,
    control: Callable[[], float] | None = None,
) -> Row:
    """Build a chain, run it by Verlet at a tenth of its limit, and time it; `control` times a bead and step of another one."""
    begun = time.perf_counter()
    _, context = _opened(beads, terms, platform, threads, replicas)
    built = time.perf_counter() - begun
    steps = _steps(context)
    times, ratios = [], []
    for _ in range(repeats):
        before = control() if control else math.nan
        times.append(_spend(context, steps) / steps / (beads * replicas))
        ratios.append(2 * times[-1] / (before + control()) if control else math.nan)
    least, most = 1e9 * min(times), 1e9 * max(times)
    cost = 1e9 * median(times)
    return Row(
        kind, beads, platform, terms, threads, replicas, cost, least, most, built, over_control=float(np.median(ratios))
    )


def _steps(context: mm.Context) -> int:
    """How many steps take about `_SPEND` seconds."""
    _spend(context, 1)
    steps, spent = 1, _spend(context, 1)
    while spent < _SPEND / 4:
        steps *= 4
        spent = _spend(context, steps)
    return max(1, round(steps * _SPEND / spent))


def controlled() -> Callable[[], float]:
    """What times a bead and step of the chain that others are compared with, in seconds."""
    _, context = _opened(CONTROL)
    steps = _steps(context)
    return lambda: _spend(context, steps) / steps / CONTROL


def _spend(context: mm.Context, steps: int) -> float:
    begun = time.perf_counter()
    context.getIntegrator().step(steps)
    context.getState(positions=True)  # waits for the kernels of OpenCL
    return time.perf_counter() - begun


def in_a_process(task: tuple[int, int, int]) -> float:
    """Nanoseconds of a bead and step in a process of its own, of so many replicas."""
    beads, replicas, repeats = task
    return timed(beads, "+ bending", "Reference", repeats, replicas=replicas, kind="processes").ns_per_bead_step


def memory(beads: int) -> float:
    """Bytes a bead that a model of the whole chain and its Context add to a process that has just begun."""
    warm = _opened(10)  # what is loaded once is no matter of beads
    gc.collect()
    before = _resident()
    kept = _opened(beads)
    added = _resident() - before
    del warm, kept
    return added / beads


def _opened(
    beads: int, terms: str = WHOLE, platform: str = "Reference", threads: int = 1, replicas: int = 1
) -> tuple[of.Model, mm.Context]:
    model = _model(beads, terms, replicas)
    properties = {"CPU": {"Threads": str(threads)}, "OpenCL": {"Precision": "mixed"}}.get(platform, {})
    integrator = mm.VerletIntegrator(1e-4)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName(platform), properties)
    context.setPositions(model.positions)
    return model, context
