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
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from openmm import unit

import openmm_filament as of
from systems import stage
from systems.open_ring import figures, pictures, static
from systems.open_ring.figures import ANGLES, SHAPES
from systems.open_ring.ring import (
    BEADS, BENDING, DENSITY, PARTS, RADIUS, SEGMENT, SHEAR, TORSION, YOUNG, Ring, Swing, swing, thesis_ring,
)  # fmt: skip
from systems.scene import Check, Summary

__all__ = ["force_for", "options", "run"]

PEAK = 4e-3
"""Peak of the internal energy at phi = 0 in J."""

BALANCE, SLOPE = 1e-4, 1e-6
"""What is asked of the energy balance, and of the slope of the energy per 10^6 steps."""

SIZES = (13, 25, 49, 100, 200, 400)
"""Beads of the rings whose deflections are compared with the cut ring's."""

HESSIAN_SIZE = 200
"""The ring whose Hessian is held against the closed forms: finer ones lose digits, 2e-4 at 400 beads (a torsion is a third
difference of the positions)."""


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
    samples = 250 if quick else 500
    bodies = {gap: thesis_ring(gap=gap) for gap in SHAPES}
    forces = {gap: force_for(body, PEAK, samples=samples) for gap, body in bodies.items()}
    runs: dict[tuple[bool, float], Swing] = {}
    with stage.progress("pulling rings") as report:
        for gap, body in bodies.items():
            for phi in ANGLES:
                runs[gap, phi] = swing(body, forces[gap], phi, samples=samples)
                report(len(runs) / 20)
        fractions = (0.4, 0.2, 0.1) if quick else (0.4, 0.2, 0.1, 0.05)
        loads = {gap: np.array([1.0, 0.1, 0.01] if gap else [1.0, 0.3, 0.1]) * forces[gap] for gap in SHAPES}
        balance = [
            (f, swing(bodies[True], forces[True], math.pi / 4, samples=samples, step=f).imbalance) for f in fractions
        ]
        report(0.6)
        shares = {
            gap: [(f, swing(bodies[gap], f, math.pi / 2, samples=samples, step=0.2).share("bending")) for f in loads[gap]]
            for gap in SHAPES
        }
        report(0.7)
        drift = _free_energy(bodies[True], 200_000 if quick else 1_000_000)
        report(0.8)
        sizes = (13, 19, 25) if quick else (13, 25, 37)
        relaxed = {
            name: {n: static.relaxed(n, name) for n in (sizes[:2] if name == "radial" else sizes)}
            for name in static.DIRECTIONS
        }
        report(1.0)
    closed = {d: {n: static.from_statics(static.of_size(n), d) for n in SIZES} for d in static.DIRECTIONS}
    hess_sizes = SIZES[:-1] if quick else SIZES
    hess = {d: {n: static.from_hessian(static.of_size(n), d) for n in hess_sizes} for d in static.DIRECTIONS}
    gap_sizes = {n: static.from_statics(static.of_size(n, gap=True), "tangential") for n in SIZES}
    checks = [
        *_motion_checks(runs, balance, shares, drift),
        *_linear_checks(bodies[False], 1e-4 * forces[False], samples),
        *_static_checks(closed, hess, relaxed),
    ]
    figures.energies(folder / "energies.png", runs)
    figures.paths(folder / "paths.png", runs)
    figures.deflections(folder / "deflections.png", closed, hess, relaxed, gap_sizes)
    figures.trust(folder / "trust.png", balance, shares, drift)
    _tables(folder, runs, closed, hess, relaxed)
    for (gap, phi), one in runs.items():
        if gap and phi >= 0:
            frames = slice(None, None, 2)
            name = "trajectory" if phi == math.pi / 4 else f"trajectory_{math.degrees(phi):.0f}deg"
            stage.write_trajectory(folder / f"{name}.dcd", one.model, one.times[frames], 1e9 * one.positions[frames])
    findings = [
        *_findings(runs, forces, balance, shares, drift, gap_sizes),
        *pictures.draw(folder, runs),
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
    taken = every * np.arange(len(total), dtype=float)
    return taken, total, *stage.energy_slope(total, taken)


def _largest(name: str, kind: Any, value: float, tolerance: float) -> Check:
    """A check of a number that should be zero."""
    return Check(name, kind, value, 0.0, abs(value), tolerance)


def _motion_checks(
    runs: Mapping[tuple[bool, float], Swing],
    balance: Sequence[tuple[float, float]],
    shares: Mapping[bool, Sequence[tuple[float, float]]],
    drift: tuple[Any, Any, float, float],
) -> list[Check]:
    _, _, slope, error = drift
    order = math.log(balance[0][1] / balance[1][1]) / math.log(balance[0][0] / balance[1][0])
    checks = [
        _largest(f"energy balance, largest of the runs with a {SHAPES[gap]}", "exact", max(r.imbalance for (g, _), r in runs.items() if g is gap), BALANCE)
        for gap in SHAPES
    ]  # fmt: skip
    checks.append(Check("order of the energy balance in the time step", "exact", order, 2.0, abs(order - 2), 0.3))
    checks.append(_largest("energy slope per 10^6 steps, plus two errors", "exact", abs(slope) + 2 * error, SLOPE))
    for gap, shape in SHAPES.items():
        mirrored = max(
            float(np.abs(runs[gap, phi].energies[part] - runs[gap, -phi].energies[part]).max()) / runs[gap, phi].peak
            for phi in ANGLES
            if phi > 0
            for part in PARTS
        )
        plane, normal, between = (runs[gap, phi] for phi in (0.0, math.pi / 2, math.pi / 4))
        points = shares[gap]
        exponent = math.log(points[-1][1] / points[-2][1]) / math.log(points[-1][0] / points[-2][0])
        ratio = between.energies["torsion"].max() / between.energies["bending"].max()
        stretched = max(r.peak_share("stretching") for (g, _), r in runs.items() if g is gap)
        checks += [
            _largest(f"difference between +phi and -phi over the peak, {shape}", "exact", mirrored, 1e-9),
            _largest(f"torsion in the plane over the peak, {shape}", "exact", plane.peak_share("torsion"), 1e-20),
            Check(f"power of the load in the bending share at pi/2, {shape}", "exact", exponent, 2.0, abs(exponent - 2), 0.05),
            _largest(f"claim: torsion only at pi/2 (mean share of bending), {shape}", "claim", normal.share("bending"), 0.01),
            Check(f"claim: torsion peaks above bending at pi/4, {shape}", "claim", ratio, 1.0, max(0.0, 1 - ratio), 0.0),
            _largest(f"claim: stretching negligible (largest share), {shape}", "claim", stretched, 1e-3),
        ]  # fmt: skip
    return checks


def _linear_checks(body: Ring, force: float, samples: int) -> list[Check]:
    """Motion under a small load against the sum over the normal modes."""
    checks = []
    for phi in (0.0, math.pi / 4, math.pi / 2):
        vector = force * (math.cos(phi) * body.opening + math.sin(phi) * np.array([0.0, 0.0, 1.0]))
        small = swing(body, force, phi, samples=samples)
        exact = static.modal_opening(body, vector, small.times + small.timestep / 2)
        off = np.abs(small.positions[:, 0] - small.positions[:, -1] - exact).max() / np.abs(exact).max()
        name = f"small load, phi = {ANGLES[phi]}: motion of the ends against the sum over the normal modes"
        checks.append(_largest(name, "exact", float(off), 1e-4))
    return checks


def _static_checks(
    closed: Mapping[str, Mapping[int, float]],
    hess: Mapping[str, Mapping[int, float]],
    relaxed: Mapping[str, Mapping[int, float]],
) -> list[Check]:
    checks = []
    for name, values in relaxed.items():
        worst = max(values, key=lambda n: abs(values[n] / static.from_statics(static.of_size(n), name) - 1))
        exact = static.from_statics(static.of_size(worst), name)
        error = abs(values[worst] / exact - 1)
        checks.append(Check(f"{name} compliance of {worst} beads, damped run against statics, m/N", "exact", values[worst], exact, error, 1e-5))
        limit = static.extrapolated(list(values), list(values.values()))
        formula = static.cut_ring(name)
        checks.append(Check(f"{name} compliance, damped runs extrapolated, against the cut ring, m/N", "exact", limit, formula, abs(limit / formula - 1), 2e-4))
    for name, values in hess.items():
        found, formula = values[HESSIAN_SIZE], static.cut_ring(name)
        error = abs(found / formula - 1)
        checks.append(Check(f"{name} compliance of {HESSIAN_SIZE} beads from the Hessian against the cut ring, m/N", "exact", found, formula, error, 5e-4))
        worst = max(abs(values[n] / closed[name][n] - 1) for n in values if n <= HESSIAN_SIZE)
        checks.append(_largest(f"{name} compliance: Hessian against statics up to {HESSIAN_SIZE} beads", "exact", worst, 1e-6))
    return checks  # fmt: skip


def _findings(
    runs: Mapping[tuple[bool, float], Swing],
    forces: Mapping[bool, float],
    balance: Sequence[tuple[float, float]],
    shares: Mapping[bool, Sequence[tuple[float, float]]],
    drift: tuple[Any, Any, float, float],
    gap_sizes: Mapping[int, float],
) -> list[str]:
    apart, meet = (runs[gap, math.pi / 2] for gap in SHAPES)
    between = {gap: runs[gap, math.pi / 4] for gap in SHAPES}
    low = min(r.sines[0] for r in runs.values())
    high = max(r.sines[1] for r in runs.values())
    missing = 3 * BENDING / TORSION
    softer = 1 + 1 / missing
    _, _, slope, error = drift
    return [
        f"Forces of {forces[True]:.3f} N (gap of one segment) and {forces[False]:.3f} N (ends that meet) make the internal "
        f"energy at phi = 0 peak at {1e3 * runs[True, 0.0].peak:.3f} and {1e3 * runs[False, 0.0].peak:.3f} mJ.",
        "In the plane the torsion energy is "
        f"{max(float(runs[gap, 0.0].energies['torsion'].max()) for gap in SHAPES):.1e} J at most: the claim holds to rounding.",
        f"Torsion only at phi = pi/2 holds where the ends meet: bending stores {100 * meet.share('bending'):.3f} % of the energy "
        f"on average and peaks at {100 * meet.peak_share('bending'):.3f} % of the total's peak.",
        f"With a gap of one segment it fails: normal forces are a couple that turns the line between the ends by "
        f"{math.degrees(apart.turn):.0f} degrees in 5 ms, and bending stores {100 * apart.share('bending'):.1f} % on average, "
        f"{100 * apart.peak_share('bending'):.1f} % at its peak; the thesis's claims suggest that its ends met.",
        "That bending is of second order: its share falls as the square of the force, to "
        + " and ".join(f"{p[-1][1]:.1e} at {p[-1][0]:.2g} N ({SHAPES[g]})" for g, p in shares.items()) + ".",
        "At phi = pi/4 torsion peaks at "
        + " and ".join(f"{r.energies['torsion'].max() / r.energies['bending'].max():.2f} times bending ({SHAPES[g]})" for g, r in between.items())
        + ".",
        f"Stretching stores at most {max(r.peak_share('stretching') for r in runs.values()):.1e} of the peak energy.",
        f"sin(beta) stays from {low:.3f} to {high:.3f}: no joint comes near straight, where dihedral torsion is singular.",
        f"Work of the loads and energy agree to {max(r.imbalance for r in runs.values()):.1e} of the peak at a tenth of the "
        f"stability limit, and to {balance[0][1]:.1e} at {balance[0][0]:g} of it.",
        f"Energy of the free ring: slope ({slope:.1e} +- {error:.1e}) of it per 10^6 steps.",
        "Normal to the plane the bead chain gives 3 pi P R^3/GJ, for its torsion is that of the centre line; a rod with material "
        f"twist has pi P R^3/EI besides, here {100 / missing:.1f} % more: the chain is too stiff there by a factor {softer:.3f}, "
        "and agrees with the rod in the plane.",
        f"At 13 beads the chain is off by {100 * abs(static.from_statics(static.of_size(13), 'tangential') / static.cut_ring('tangential') - 1):.1f} % "
        f"along the tangents and {100 * abs(static.from_statics(static.of_size(13), 'normal') / static.cut_ring('normal') - 1):.1f} % "
        f"normal to the plane, with a gap by {100 * abs(gap_sizes[13] / static.cut_ring('tangential') - 1):.1f} % along the tangents; "
        "all fall as the square of the segment length.",
    ]  # fmt: skip


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
        table.writerow(["direction", "beads", "cut_ring_m_per_N", "statics_m_per_N", "hessian_m_per_N", "openmm_m_per_N"])
        for name in static.DIRECTIONS:
            for n in sorted({*closed[name], *relaxed[name]}):
                values = [static.cut_ring(name), static.from_statics(static.of_size(n), name)]
                found = [hess[name].get(n), relaxed[name].get(n)]
                table.writerow([name, n, *(f"{v:.9g}" for v in values), *("" if v is None else f"{v:.9g}" for v in found)])
