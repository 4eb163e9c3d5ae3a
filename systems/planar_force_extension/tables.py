"""The tables and the trajectory of the planar chain."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from openmm_filament.discretisation import PN
from openmm_filament.trajectory import TrajectoryWriter
from systems.planar_force_extension import chain, cold, fits, warm
from systems.planar_force_extension.hot import Sampled

__all__ = ["fits_of", "write_cold", "write_fits", "write_hot", "write_levels", "write_thermal", "write_trajectory"]

FRAMES = 200
"""Thermal shapes that are kept at most."""


def fits_of(curves: Sequence[cold.Curve]) -> dict[float, list[fits.Fit]]:
    """Every form fitted to every cold curve, by Young's modulus; forces in N."""
    out = {}
    for curve in curves:
        force = np.array([point.force for point in curve.converged])
        extension = np.array([point.extension for point in curve.converged]) / chain.CONTOUR
        out[curve.young] = [fits.fitted(force, extension, form) for form in fits.FORMS]
    return out


def _write(path: Path, heading: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(heading)
        for row in rows:
            writer.writerow([entry if isinstance(entry, str) else f"{entry:.10g}" for entry in row])


def write_cold(path: Path, curves: Sequence[cold.Curve]) -> None:
    """The converged points of the cold curves."""
    heading = ["youngs_modulus_Pa", "force_N", "extension_m", "residual", "floor", "joints_turned_over"]
    rows = [(c.young, p.force, p.extension, p.residual, p.floor, float(p.over)) for c in curves for p in c.converged]
    _write(path, heading, rows)


def write_fits(path: Path, fitted: dict[float, list[fits.Fit]]) -> None:
    """Every fit to a cold curve: its one number, and by how much of the contour it misses."""
    heading = ["youngs_modulus_Pa", "form", "kT_over_lp_N", "standard_error_N", "rms_miss"]
    heading += [f"largest_miss_{part}" for part in fits.RANGES]
    rows = [
        (young, fit.form, fit.scale, fit.scale_error, fit.rms, *fit.misses)
        for young, several in fitted.items()
        for fit in several
    ]
    _write(path, heading, rows)


def write_hot(path: Path, sampled: Sequence[Sampled]) -> None:
    """Every run: the chain, what was sampled, and the exact answer."""
    heading = [
        "kT_over_alpha", "joints", "reduced_force", "force_pN", "extension_nm", "extension_error_nm", "effective_samples",
        "segments", "bond_length_nm", "bending_kJ_per_mol", "stretching_kJ_per_mol_nm2", "r_hat", "exact_discrete_nm",
    ]  # fmt: skip
    step = chain.STEP * chain.SCALE * 1e9
    contour = chain.SEGMENTS * step
    rows = []
    for s in sampled:
        alpha = chain.KT / s.job.heat  # pN nm
        rows.append(
            (
                s.job.heat,
                warm.kind(s.job),
                s.job.force,
                s.job.force * alpha / step,
                s.extension * contour,
                s.error * contour,
                s.samples,
                float(chain.SEGMENTS),
                step,
                alpha * PN,
                s.job.ratio * alpha / step**2 * PN,
                s.r_hat,
                warm.exact(s.job) * contour,
            )
        )
    _write(path, heading, rows)


def write_levels(path: Path, levels: Sequence[warm.Level]) -> None:
    """The misfit of each form at each temperature, over the contour, and the persistence length it gives in segments."""
    heading = ["chain", "kT_over_alpha", "form", "kT_over_lp_alpha_per_l0", "rms_miss"]
    heading += [f"largest_miss_{part}" for part in fits.RANGES]
    rows = [
        (level.name, level.heat, form, fit.scale, fit.rms, *fit.misses)
        for level in levels
        for form, fit in level.fits.items()
    ]
    _write(path, heading, rows)


def write_trajectory(path: Path, curve: cold.Curve) -> None:
    """The equilibria as frames; the sidecar has the force of each. Nothing moves in time: all times are zero."""
    writer = TrajectoryWriter(curve.model, path)
    for i, point in enumerate(curve.converged):
        writer.write(point.positions * 1e9 / curve.model.scale.length, i, 0.0, force_N=point.force)
    writer.close()


def write_thermal(path: Path, sampled: Sampled) -> None:
    """Sampled shapes of one chain as frames; moves lie between them, so that they have no times either."""
    model = warm.model(sampled.job)
    writer = TrajectoryWriter(model, path)
    for i, frame in enumerate(sampled.frames[:FRAMES]):
        writer.write(
            frame / model.scale.length, i, 0.0, kT_over_alpha=sampled.job.heat, reduced_force=sampled.job.force
        )
    writer.close()
