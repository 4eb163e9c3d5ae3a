"""An open ring whose two ends are pulled apart: in its plane, normal to it, and between (thesis 2.5).

13 beads, steel wire of 1 mm radius, segments of 10 mm; opposite constant forces on the end beads at an angle phi to the
tangent at the cut, 5 ms from rest, no damping. The force is such that the internal energy at phi = 0 peaks at 4 mJ.
Both readings of "13 beads on a circle, open" are run: see `ring`.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from openmm import unit

import openmm_filament as of
from systems import conservation, stage
from systems.open_ring import figures, judgement, pictures, static
from systems.open_ring.figures import ANGLES, SHAPES
from systems.open_ring.ring import (
    BEADS,
    DENSITY,
    PARTS,
    RADIUS,
    SEGMENT,
    SHEAR,
    YOUNG,
    Ring,
    Swing,
    swing,
    thesis_ring,
    turned,
)
from systems.scene import Summary

__all__ = ["PEAK", "SAMPLES", "STEP", "force_for", "options", "run"]

PEAK = 4e-3
"""Peak of the internal energy at phi = 0 in J."""

SIZES = (13, 25, 49, 100, 200, 400)
"""Beads of the rings whose deflections are compared with the cut ring's."""


SAMPLES, QUICK_SAMPLES = 500, 200
"""Samples of a run; the second with `--quick`."""

STEP = 0.8
"""Time step over the stability limit, at most: the energy then balances to some 1e-6 of its peak."""


def options(group: argparse._ArgumentGroup) -> None:
    """The system has no options of its own."""


def force_for(body: Ring, peak: float, *, samples: int = 500) -> float:
    """The force in N at which the internal energy at phi = 0 peaks at `peak` J: nearly its square, so two steps do."""
    force = 2.0
    for _ in range(2):
        force *= math.sqrt(peak / swing(body, force, 0.0, samples=samples, step=0.3).peak)
    return force


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Run the ring, write the results into `folder`; 1 if an exact check fails, else 0. Nothing is random: no seed."""
    begun = time.perf_counter()
    samples = QUICK_SAMPLES if quick else SAMPLES
    bodies = {gap: thesis_ring(gap=gap) for gap in SHAPES}
    forces = {gap: force_for(body, PEAK, samples=samples) for gap, body in bodies.items()}
    runs: dict[tuple[bool, float], Swing] = {}
    with stage.progress("pulling rings") as report:
        for gap, body in bodies.items():
            for phi in ANGLES:
                runs[gap, phi] = swing(body, forces[gap], phi, samples=samples, step=STEP)
                report(len(runs) / 20)
        general = {
            gap: swing(turned(body), forces[gap], 0.0, samples=samples, step=STEP) for gap, body in bodies.items()
        }
        balance = [
            (f, swing(bodies[True], forces[True], math.pi / 4, samples=samples, step=f).imbalance)
            for f in (0.4, 0.2, 0.1)
        ]
        report(0.6)
        shares = {gap: _bending_shares(body, runs[gap, math.pi / 2], samples) for gap, body in bodies.items()}
        report(0.7)
        drift = _free_energy(bodies[True], 100_000 if quick else 1_000_000)
        report(0.8)
        sizes = (13, 17, 21) if quick else (13, 25, 37)
        relaxed = {
            name: {n: static.relaxed(n, name) for n in (sizes[:2] if name == "radial" else sizes)}
            for name in static.DIRECTIONS
        }
        report(1.0)
    closed = {d: {n: static.from_statics(static.of_size(n), d) for n in SIZES} for d in static.DIRECTIONS}
    hess: dict[str, dict[int, float]] = {d: {} for d in static.DIRECTIONS}
    for beads in SIZES[:-1] if quick else SIZES:
        for name, value in static.from_hessian(static.of_size(beads)).items():
            hess[name][beads] = value
    gap_sizes = {n: static.from_statics(static.of_size(n, gap=True), "tangential") for n in SIZES}
    checks = [
        *judgement.motion_checks(runs, general, balance, shares, drift),
        *judgement.linear_checks(bodies[False], 1e-4 * forces[False]),
        *judgement.static_checks(closed, hess, relaxed),
    ]
    figures.energies(folder / "energies.png", runs)
    figures.paths(folder / "paths.png", runs)
    figures.deflections(folder / "deflections.png", closed, hess, relaxed, gap_sizes)
    figures.balance(folder / "balance.png", balance, shares, drift)
    _tables(folder, runs, closed, hess, relaxed)
    for (gap, phi), one in runs.items():
        if gap and phi >= 0:
            frames = slice(None, None, 2)
            name = "trajectory" if phi == math.pi / 4 else f"trajectory_{math.degrees(phi):.0f}deg"
            stage.write_trajectory(folder / f"{name}.dcd", one.model, one.times[frames], 1e9 * one.positions[frames])
    findings = [
        *judgement.findings(runs, general, forces, balance, shares, drift, gap_sizes),
        *pictures.draw(folder, runs, quick=quick),
    ]
    summary = Summary(
        system="open_ring",
        models=[one.model for one in runs.values()],
        platform="Reference",
        wall_seconds=time.perf_counter() - begun,
        filament={
            "beads": BEADS, "segment_length_m": SEGMENT, "radius_m": RADIUS, "youngs_modulus_Pa": YOUNG,
            "shear_modulus_Pa": SHEAR, "line_density_kg_per_m": DENSITY, "damping_per_s": 0.0, "duration_s": 5e-3,
            "force_gap_of_one_segment_N": forces[True], "force_ends_meeting_N": forces[False],
            "timestep_s": runs[True, 0.0].timestep, "stretching_form": "harmonic", "bending_form": "harmonic",
            "torsion_form": "harmonic",
        },
        checks=checks,
        findings=findings,
    )  # fmt: skip
    return stage.close(folder, summary)


def _bending_shares(body: Ring, full: Swing, samples: int) -> list[tuple[float, float]]:
    """Forces in N normal to the plane, falling, and the mean share of bending that each leaves in the energy."""
    force = float(np.linalg.norm(full.model.pulls[0])) * full.model.scale.factor("force") / stage.NEWTON
    less = [
        (part * force, swing(body, part * force, math.pi / 2, samples=samples, step=0.2).share("bending"))
        for part in (0.1, 0.02, 0.005)
    ]
    return [(force, full.share("bending")), *less]


def _free_energy(body: Ring, steps: int) -> tuple[Any, Any, float, float]:
    """Steps, total energy in J, slope and its error of a free ring that swings in its four lowest modes by 0.02 mm each."""
    model = of.build(body.filament)
    shapes = of.normal_modes(model, 10).shapes[6:]
    context = stage.context(model, of.verlet(model), "Reference")
    moved = (body.positions + 2e-5 * shapes.sum(axis=0)) * unit.meter
    context.setPositions(model.to_internal(moved))
    every = 100
    motion = of.record(model, context, steps // every, every, observe=lambda x: 0.0, energies=True)
    total = np.sum(list(motion.energies.values()), axis=0) / stage.JOULE
    found = conservation.through(total, every)
    return every * np.arange(len(total), dtype=float), total, found.slope, found.error


def _tables(
    folder: Path, runs: Mapping[tuple[bool, float], Swing], closed: Mapping[str, Mapping[int, float]],
    hess: Mapping[str, Mapping[int, float]], relaxed: Mapping[str, Mapping[int, float]],
) -> None:  # fmt: skip
    columns = (*PARTS, "internal", "kinetic", "work")
    with (folder / "energies.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["shape", "phi_rad", "time_s", *(f"{name}_J" for name in columns)])
        for (gap, phi), one in runs.items():
            for i, moment in enumerate(one.times):
                values = [float(one.energies[name][i]) for name in columns]
                table.writerow([SHAPES[gap], f"{phi:.6f}", f"{moment:.9g}", *(f"{v:.9g}" for v in values)])
    with (folder / "deflections.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            ["direction", "beads", "cut_ring_m_per_N", "statics_m_per_N", "hessian_m_per_N", "openmm_m_per_N"]
        )
        for name in static.DIRECTIONS:
            for n in sorted({*closed[name], *relaxed[name]}):
                values = [static.cut_ring(name), static.from_statics(static.of_size(n), name)]
                found = [hess[name].get(n), relaxed[name].get(n)]
                table.writerow(
                    [name, n, *(f"{v:.9g}" for v in values), *("" if v is None else f"{v:.9g}" for v in found)]
                )
