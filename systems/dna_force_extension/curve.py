"""The DNA, the forces, and one row of numbers a force of its sampled curve."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from openmm import unit

import openmm_filament as of
from openmm_filament import wlc
from openmm_filament.blocks import clamped_model
from openmm_filament.discretisation import PN

if TYPE_CHECKING:
    import xarray

__all__ = [
    "CONTOUR",
    "FORCES",
    "KT",
    "MODULUS",
    "PERSISTENCE",
    "SHOWN",
    "TEMPERATURE",
    "Row",
    "chain",
    "error_parts",
    "model_shown",
    "rows_of",
    "wanted_errors",
    "write_csv",
]

Row = dict[str, float]

CONTOUR, PERSISTENCE, MODULUS, TEMPERATURE = 1000.0, 53.0, 1000.0, 298.0  # nm, nm, pN, K
KT = TEMPERATURE * of.units.BOLTZMANN / PN  # pN nm
FORCES = np.geomspace(0.05, 50.0, 12)  # pN
SHOWN = 5  # the force, about 1 pN, whose trajectory is kept


def wanted_errors(relative_error: float | None, *, quick: bool) -> np.ndarray:
    """The relative error asked for at each force."""
    if relative_error is not None:
        return np.full(len(FORCES), relative_error)
    if quick:
        return np.full(len(FORCES), 0.06)
    return 0.9 * np.where(FORCES < 0.3, 0.03, 0.01)


def chain() -> of.WormlikeChain:
    """The DNA as a continuous chain."""
    return of.WormlikeChain(
        contour_length=CONTOUR * unit.nanometer,
        persistence_length=PERSISTENCE * unit.nanometer,
        stretch_modulus=MODULUS * unit.piconewton,
    )


def rows_of(curve: xarray.Dataset) -> list[Row]:
    """One row a force: what was sampled, the chain that was run, and the exact answers, all in the units of the names."""
    continuous = np.asarray(wlc.extension_exact(FORCES, PERSISTENCE, CONTOUR, KT, stretch_modulus=MODULUS, finite=True))
    marko_siggia = np.asarray(wlc.extension_marko_siggia(FORCES, PERSISTENCE, CONTOUR, KT))
    columns = {
        "force_pN": curve.force,
        "extension_nm": curve.extension,
        "extension_error_nm": curve.extension_error,
        "effective_samples": curve.effective_samples,
        "segments": curve.segments,
        "bond_length_nm": curve.bond_length,
        "bending_kJ_per_mol": curve.bending,
        "stretching_kJ_per_mol_nm2": curve.stretching,
        "exact_discrete_nm": curve.exact_discrete,
        "exact_continuous_nm": continuous,
        "marko_siggia_nm": marko_siggia,
        "time_step_bias_nm": curve.time_step_bias,
    }
    return [{name: float(column[i]) for name, column in columns.items()} for i in range(len(FORCES))]


def error_parts(curve: xarray.Dataset) -> list[Row]:
    """One row a force: what the error of its extension is made of, in per cent of the exact continuous chain's."""
    exact = wlc.extension_exact(FORCES, PERSISTENCE, CONTOUR, KT, stretch_modulus=MODULUS, finite=True)
    columns = {
        "force_pN": curve.force,
        "discretisation_percent": 100 * curve.discretisation_bias / exact,
        "stretch_percent": 100 * curve.stretch_bias / exact,
        "time_step_percent": 100 * curve.time_step_bias / exact,
        "two_standard_errors_percent": 200 * curve.extension_error / exact,
        "deviation_percent": 100 * (curve.extension / exact - 1),
        "time_step_ps": curve.time_step,
    }
    return [{name: float(column[i]) for name, column in columns.items()} for i in range(len(FORCES))]


def model_shown(curve: xarray.Dataset) -> of.Model:
    """The chain that was run at the force whose trajectory is kept (masses aside)."""
    kj = unit.kilojoule_per_mole
    filament = of.Filament(
        of.shapes.line(int(curve.segments[SHOWN]), float(curve.bond_length[SHOWN]) * unit.nanometer),
        1.0 * unit.dalton,
        (
            of.stretching.Harmonic(float(curve.stretching[SHOWN]) * kj / unit.nanometer**2),
            of.bending.Harmonic(float(curve.bending[SHOWN]) * kj),
        ),
    )
    return clamped_model(filament, float(FORCES[SHOWN]) * PN, 3, 1)


def write_csv(path: Path, rows: list[Row]) -> None:
    """Write the rows under the names of their columns."""
    with path.open("w", newline="") as out:
        writer = csv.DictWriter(out, rows[0].keys())
        writer.writeheader()
        writer.writerows({name: f"{value:.10g}" for name, value in row.items()} for row in rows)
