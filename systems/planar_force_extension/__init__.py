"""A random planar chain pulled without and with temperature (thesis 3.2.1): is missing noise why no worm-like chain fits?

30 segments, L = 0.15 m, d = 0.1 mm, E from 1 to 1000 GPa, forces from 0.1 mN to 1 N, in the plane. Cold: static equilibria
with their residuals and the fits of the thesis. Hot: the same reduced chain with `k_B T/alpha` from 1e-3 to 100, sampled in
two dimensions and held against the exact discrete chain; `alpha = E I/l0` is the energy that bends a joint by sqrt(2) rad.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from systems import stage
from systems.planar_force_extension import chain, cold, figures, hot, report, tables, warm
from systems.scene import Summary

__all__ = ["options", "run"]

FEWEST = 9

SHOWN = 0.1
"""`k_B T/alpha` of the thermal shapes that are kept."""


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options."""
    parser.add_argument("--points", type=int, help="forces from 1e-4 to 1 N; default 21 (9 with --quick)")


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Pull the chain cold and hot and write the results into `folder`; 1 if an exact check fails, else 0."""
    begun = time.perf_counter()
    count = (FEWEST if quick else 21) if options.points is None else options.points
    if count < FEWEST or count % 4 != 1:
        raise ValueError(
            f"Argument `--points` must be 9, 13, 17, ... so that forces are alike in every decade, but is {count}."
        )
    forces = np.geomspace(1e-4, 1.0, count)
    with hot.started(warm.jobs(seed=seed, quick=quick)) as thermal:
        with stage.progress("equilibria") as show:
            parts = len(chain.YOUNG) + 1
            curves = [cold.pulled(e, forces, _part(show, i, parts)) for i, e in enumerate(chain.YOUNG)]
            back = cold.let_go(curves[-1])
            levels = warm.levels(quick=quick)
        with stage.progress("thermal motion") as show:
            sampled = thermal(show)
    fitted = tables.fits_of(curves)
    tables.write_cold(folder / "force_extension.csv", curves)
    tables.write_fits(folder / "fits.csv", fitted)
    tables.write_hot(folder / "thermal_force_extension.csv", sampled)
    tables.write_levels(folder / "misfit.csv", levels)
    tables.write_trajectory(folder / "trajectory.dcd", curves[-1])
    shown = next(s for s in sampled if s.job.heat == SHOWN)
    tables.write_thermal(folder / "thermal_trajectory.dcd", shown)
    figures.cold_curves(folder / "force_extension.png", curves, fitted, back)
    figures.answer(folder / "thermal_force_extension.png", curves, sampled, levels)
    findings = [*report.findings(curves, back, fitted, sampled, levels), *figures.pictures(folder, curves[-1])]
    return stage.close(
        folder,
        Summary(
            system="planar_force_extension",
            models=[*(curve.model for curve in curves), warm.model(shown.job)],
            platform="none (statics) and Reference (thermal motion)",
            wall_seconds=time.perf_counter() - begun,
            filament={
                "segments": chain.SEGMENTS,
                "contour_length_m": chain.CONTOUR,
                "wire_radius_m": chain.RADIUS,
                "youngs_moduli_Pa": list(chain.YOUNG),
                "rest_bend_standard_deviation_rad": chain.SPREAD,
                "rest_shape_seed": chain.WALK_SEED,
                "rest_angles_rad": chain.BENDS.round(12).tolist(),
                "rest_end_to_end_m": float(chain.REST[-1, 0]),
                "bending_form": "harmonic",
                "temperature_K": [0.0, chain.TEMPERATURE],
                "heat_definition": "k_B T/alpha, alpha = E I/l0",
                "heats": sorted({s.job.heat for s in sampled}),
                "thermal_segment_length_nm": chain.STEP * chain.SCALE * 1e9,
                "thermal_bond_stiffness_over_alpha_per_l0_squared": sorted({s.job.ratio for s in sampled}),
                "wire_bond_stiffness_over_alpha_per_l0_squared": chain.STIFFNESS_RATIO,
                "seed": seed,
                "held_bead": 0,
                "pulled_bead": -1,
            },
            checks=[*report.cold_checks(curves), *report.hot_checks(sampled), *report.claims(curves, fitted, levels)],
            findings=findings,
        ),
    )


def _part(show: Callable[[float], None], done: int, parts: int) -> Callable[[float], None]:
    """Progress of one of several equal parts."""
    return lambda fraction: show((done + fraction) / parts)
