"""A helix pulled without temperature (thesis 3.2.2): does its torsion matter?

Two turns, 55 segments, E = 1 GPa and G from 0.01 to 100 GPa, pulled at its end beads along the axis from 0.01 to 1000 N.
Every point is a static equilibrium with its residual; only converged ones count. Small loads are held against the helix
formulas, all of them against the work: the energy falls with the force as the extension says.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import openmm_filament as of
from openmm_filament.trajectory import TrajectoryWriter
from systems import stage
from systems.helix_force_extension import coil, figures, thermal
from systems.scene import Check, Summary

__all__ = ["options", "run"]

STIFFNESS_SEGMENTS = 64
"""Segments of the chain that the small-load formulas are checked with: with the thesis's 55 the softest torsion is 1.2 % off."""

STIFFNESS = 0.01
"""Of the small-load stiffness against the formula, relative."""

WEIGHTED_TO = 10.0
"""Largest force in N under which the weighted torsion is tried: its collapsed coil takes long to come to rest beyond."""

OVERLAP = 0.02
"""Difference of extensions over the contour length up to which curves are said to overlap, as they do to the eye."""


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options."""
    parser.add_argument("--points", type=int, help="forces from 0.01 to 1000 N; default 31 (6 with --quick)")


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Pull the helix and write the results into `folder`; 1 if an exact check fails, else 0."""
    begun = time.perf_counter()
    count = (6 if quick else 31) if options.points is None else options.points
    if count < 6:
        raise ValueError(f"Argument `--points` must be at least 6, one a decade, but is {count}.")
    forces = np.geomspace(1e-2, 1e3, count)
    cases = [(shear, of.torsion.Harmonic) for shear in coil.SHEAR] + [(1e9, of.torsion.Weighted)]
    curves = []
    with stage.progress("equilibria") as show:
        for done, (shear, form) in enumerate(cases):
            applied = forces if form is of.torsion.Harmonic else forces[forces <= WEIGHTED_TO]
            curves.append(coil.pulled(shear, applied, form=form, progress=_part(show, done, len(cases))))
    with stage.progress("thermal motion") as show:
        warm = thermal.sampled(600 if quick else 6000, seed, progress=show)
    checks = [*_stiffness_checks(), *_work_checks(curves), *_claims(curves), *thermal.checks(warm)]
    _write_csv(folder / "force_extension.csv", curves)
    figures.curves(folder / "force_extension.png", curves)
    _write_trajectory(folder / "trajectory.dcd", curves[coil.SHEAR.index(1e9)])
    thermal.write(folder, warm)
    findings = [*_findings(curves), *figures.pictures(folder, curves[coil.SHEAR.index(1e9)])]
    return stage.close(
        folder,
        Summary(
            system="helix_force_extension",
            models=[*(curve.model for curve in curves), warm.model],
            platform="none (statics), Reference (thermal)",
            wall_seconds=time.perf_counter() - begun,
            filament={
                "segments": coil.SEGMENTS,
                "helix_radius_m": coil.RADIUS,
                "height_m": coil.HEIGHT,
                "turns": coil.TURNS,
                "contour_length_m": coil.CONTOUR,
                "wire_radius_m": coil.WIRE,
                "youngs_modulus_Pa": coil.YOUNG,
                "shear_moduli_Pa": list(coil.SHEAR),
                "bending_form": "harmonic",
                "temperature_K": 0,
                "held_bead": 0,
                "pulled_bead": -1,
                **thermal.numbers(),
            },
            checks=checks,
            findings=findings,
        ),
    )


def _part(show: Callable[[float], None], done: int, parts: int) -> Callable[[float], None]:
    """Progress of one of several equal parts."""
    return lambda fraction: show((done + fraction) / parts)


def _stiffness_checks() -> list[Check]:
    checks = []
    for shear in coil.SHEAR:
        exact = coil.end_stiffness(shear)
        found = coil.end_stiffness_found(shear, STIFFNESS_SEGMENTS, max(2e-5 * exact, 1e-13 * shear))
        checks.append(
            Check(
                f"small-load stiffness, G/E = {shear / coil.YOUNG:g}, {STIFFNESS_SEGMENTS} segments, N/m",
                "exact",
                found,
                exact,
                abs(found / exact - 1),
                STIFFNESS,
                "N/m",
            )
        )
    return checks


def _work_checks(curves: list[coil.Curve]) -> list[Check]:
    """Hellmann and Feynman: between two points the stored energy grows by the work of the force, `int F dx`."""
    checks = []
    for curve in curves:
        points = curve.converged
        worst = 0.0
        for point in points[1 :: max(1, len(points) // 2)]:
            worst = max(worst, _work_error(curve, point))
        tolerance = (
            1e-6 if curve.form == "harmonic" else 1e-3
        )  # stored energies so large beside the work leave few digits
        label = f"stored energy against work, {_name(curve)}: largest error over the work, points"
        checks.append(Check(label, "exact", worst, 0.0, worst, tolerance))
    return checks


def _work_error(curve: coil.Curve, point: coil.Point) -> float:
    """The work of the force between equilibria at 0.995 and 1.005 of it, by Simpson's rule, less the energy stored."""
    form = {"harmonic": of.torsion.Harmonic, "weighted": of.torsion.Weighted}[curve.form]
    forces, lengths, stored = point.force * np.array([0.995, 1.0, 1.005]), [], []
    for force in forces:
        model = coil.helix(curve.shear, float(force), form=form)
        found = of.equilibrium(model, positions=point.positions * of.units.quantity(1.0, "length"), begin_at=1.0)
        x = found.positions._value * 1e-9
        lengths.append(float(x[-1, 2] - x[0, 2]))
        stored.append(sum(value for name, value in found.energies.items() if name != "pull") / stage.JOULE)
    a, b, c = lengths
    by_force = (forces[2] - forces[0]) * (a + 4 * b + c) / 6  # int x dF
    work = forces[2] * c - forces[0] * a - by_force  # int F dx by parts
    return float(abs(stored[2] - stored[0] - work) / work)


def _claims(curves: list[coil.Curve]) -> list[Check]:
    thesis = [curve for curve in curves if curve.form == "harmonic" and curve.shear >= coil.YOUNG]
    spread, _ = _spread(thesis)
    return [
        Check(
            "curves of G/E = 1, 10 and 100 overlap: largest difference of extension over contour length",
            "claim",
            spread,
            0.0,
            spread,
            OVERLAP,
        )
    ]


def _spread(curves: list[coil.Curve]) -> tuple[float, float]:
    """Largest difference of the extensions over the contour length at one force, and that force in N."""
    common = set.intersection(*({point.force for point in curve.converged} for curve in curves))
    lengths = {
        force: [p.extension for curve in curves for p in curve.converged if p.force == force] for force in common
    }
    worst = max(common, key=lambda force: float(np.ptp(lengths[force])))
    return float(np.ptp(lengths[worst])) / coil.CONTOUR, worst


def _findings(curves: list[coil.Curve]) -> list[str]:
    harmonic = [curve for curve in curves if curve.form == "harmonic"]
    stiff = [curve for curve in harmonic if curve.shear >= coil.YOUNG]
    steel = next(curve for curve in harmonic if curve.shear == coil.YOUNG)
    smooth = next(curve for curve in curves if curve.form == "weighted")
    spread, at = _spread(stiff)
    soft = [(curve.shear / coil.YOUNG, *_spread([curve, stiff[-1]])) for curve in harmonic if curve not in stiff]
    sentences = [
        f"Torsion matters only where it is softer than bending: from G/E = 1 to 100 extensions differ by at most "
        f"{100 * spread:.2f} % of the contour (at {at:.3g} N), but for "
        + " and ".join(f"G/E = {ratio:g} by {100 * far:.1f} % (at {where:.3g} N)" for ratio, far, where in soft)
        + " from those of G/E = 100.",
        f"{sum(len(curve.converged) for curve in curves)} of {sum(len(curve.points) for curve in curves)} points converged; "
        f"the largest residual among them is {max(p.residual for c in curves for p in c.converged):.1e} of the force, where "
        f"rounding alone leaves {max(p.floor for c in curves for p in c.converged):.1e}.",
    ]
    hard = [point for point in steel.converged if point.step < 0.1]
    last = steel.converged[-1]
    if hard:
        sentences.append(
            f"Near full extension the harmonic torsion stiffens as one over the square of the bend: at {hard[0].force:.3g} N "
            f"(extension {hard[0].extension / coil.CONTOUR:.3f} of the contour, smallest bend {hard[0].bend:.2g} rad) the stable "
            f"time step of dynamics has fallen to {hard[0].step:.2g} of that at rest, at {last.force:.3g} N to {last.step:.1g}: "
            "statics goes on, dynamics is of no use there."
        )
    if smooth.converged:
        ends = smooth.converged[0], smooth.converged[-1]
        sentences.append(
            "The weighted torsion stays smooth, but pushes its bends open: of the same stiffness at rest it is no stand-in for "
            f"this helix, which it draws together to {ends[0].extension / coil.CONTOUR:.2f} of the contour at "
            f"{ends[0].force:.3g} N and {ends[1].extension / coil.CONTOUR:.2f} at {ends[1].force:.3g} N."
        )
    return sentences


def _name(curve: coil.Curve) -> str:
    return f"G/E = {curve.shear / coil.YOUNG:g}, {curve.form} torsion"


def _write_csv(path: Path, curves: list[coil.Curve]) -> None:
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(
            [
                "torsion",
                "shear_modulus_Pa",
                "force_N",
                "extension_m",
                "residual",
                "floor",
                "smallest_bend_rad",
                "step_ratio",
            ]
        )
        for curve in curves:
            for p in curve.converged:
                numbers = (curve.shear, p.force, p.extension, p.residual, p.floor, p.bend, p.step)
                writer.writerow([curve.form, *(f"{number:.10g}" for number in numbers)])


def _write_trajectory(path: Path, curve: coil.Curve) -> None:
    """The equilibria as frames; the sidecar has the force of each. Nothing moves in time: all times are zero."""
    writer = TrajectoryWriter(curve.model, path)
    for i, point in enumerate(curve.converged):
        writer.write(point.positions / curve.model.scale.length, i, 0.0, force_N=point.force)
    writer.close()
