"""Masses on a stretched chain of springs: the lines of the thesis's Table 2.1 from simulated motion (2.2).

One to nine masses, all modes in motion at small amplitude: 31 lines and their shapes. How the lines depend on amplitude, time
step and stiffness; how the first tends to that of a continuous string up to 1023 masses; how well the energy is kept.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

from openmm import unit

import openmm_filament as of
from systems import conservation, stage
from systems.mass_spring import continuum, convergence, energy, figures, pictures, table
from systems.mass_spring.chain import LENGTH, MASS, TENSION, Chain
from systems.scene import Summary

__all__ = ["PHASE", "options", "run", "timestep_of"]

PHASE = 0.28
"""Time step times the chain's cutoff frequency, for the table: PEFRL shifts a line by at most 4e-7 there. Leapfrog does so at
0.003, in 2.5 times the time (`error_vs_runtime`)."""
_STABLE = 0.4
"""Largest step for the table over the stability limit, which counts where springs are stiff."""
_LARGE, _LARGE_QUICK = 0.0015, 0.003
"""The same as PHASE, by leapfrog, for the large amplitudes of a single mass."""
_COARSE = 0.02
"""The same for other amplitudes and stiffnesses, where lines at this very step are compared with one another."""
_SHORT = 0.25
"""Seconds of recording for them, five resolutions between the closest lines of nine masses."""


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options."""
    parser.add_argument(
        "--seconds", type=float, default=0.3, help="length of the recordings of Table 2.1 (default 0.3 s)"
    )
    parser.add_argument(
        "--stiffness-ratio",
        type=float,
        default=2.0,
        metavar="R",
        help="stiffness of a spring in units of tension/length, above 1 (default 2); the thesis does not give it",
    )


def timestep_of(chain: Chain) -> float:
    """The time step of the table in s."""
    limit = float(of.stable_timestep(chain.model).value_in_unit(unit.second))
    return min(PHASE / chain.cutoff, _STABLE * limit)


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Run everything and write it into `folder`; 1 if an exact check fails, else 0. Nothing here is random."""
    begun = time.perf_counter()
    ratio, seconds = options.stiffness_ratio, options.seconds
    chains = [Chain(masses, ratio) for masses in table.THESIS]
    for chain in reversed(chains):  # the longest has the closest lines
        table.refuse_short(chain, seconds)
    with stage.progress("masses on springs") as show:
        measured = [table.measure(chain, seconds, timestep=timestep_of(chain), order=4) for chain in chains]
        show(0.15)
        softer, stiffer = Chain(9, ratio), Chain(9, 10 * ratio)
        curves = [
            convergence.amplitudes(Chain(1, ratio), 1, periods=12, phase=_LARGE_QUICK if quick else _LARGE),
            convergence.amplitudes(softer, 1, periods=12, phase=_COARSE),
            convergence.amplitudes(softer, 3, periods=12, phase=_COARSE),
            convergence.amplitudes(stiffer, 1, periods=12, phase=_COARSE),
        ]
        steps = convergence.timesteps(chains[-1], _SHORT)
        stiff = convergence.stiffnesses(5, _SHORT, phase=_COARSE)
        show(0.4)
        first = continuum.rows(ratio, 1.0 if quick else 4, lambda part: show(0.4 + 0.35 * part))
        kept = energy.drift(Chain(5, ratio), 100_000 if quick else 1_000_000)
        show(0.85)
        heard = pictures.listen(folder, chains[-1])
        said = pictures.show(folder, chains[-1], quick=quick)
    lines = table.rows(measured)
    _write(folder / "table_2_1.csv", lines)
    _write(folder / "amplitude.csv", [row for curve in curves for row in convergence.amplitude_rows(curve)])
    _write(folder / "timestep.csv", convergence.timestep_rows(steps))
    _write(folder / "continuum.csv", first)
    figures.draw_spectra(folder / "spectra.png", measured)
    figures.draw_shapes(folder / "mode_shapes.png", measured)
    figures.draw_convergence(folder / "convergence.png", curves, steps)
    figures.draw_continuum(folder / "continuum.png", first)
    summary = Summary(
        system="mass_spring",
        models=[chain.model for chain in chains],
        platform="Reference",
        wall_seconds=time.perf_counter() - begun,
        filament={
            "length_m": LENGTH,
            "mass_kg": MASS,
            "tension_N": TENSION,
            "tension_over_mass_and_length_per_s2": TENSION / (MASS * LENGTH),
            "masses": [chain.masses for chain in chains],
            "bead_mass_kg": [chain.mass for chain in chains],
            "segment_length_m": [chain.spacing for chain in chains],
            "stiffness_N_per_m": [chain.stiffness for chain in chains],
            "stiffness_ratio": ratio,
            "amplitude_of_the_first_mass_m": [table.AMPLITUDE * chain.spacing for chain in chains],
            "timestep_s": [timestep_of(chain) for chain in chains],
            "integrator": "PEFRL, of fourth order",
            "recording_s": seconds,
        },
        checks=[
            *table.checks(measured, lines),
            *convergence.checks(curves, steps, stiff),
            conservation.check_drift(kept),
            *continuum.checks(first),
            heard,
        ],
        findings=[
            *table.findings(lines),
            *convergence.findings(curves, steps, stiff),
            energy.finding(kept),
            *continuum.findings(first),
            *said,
        ],
    )
    return stage.close(folder, summary)


def _write(path: Path, rows: list[dict[str, float]]) -> None:
    with path.open("w", newline="") as out:
        writer = csv.DictWriter(out, rows[0].keys())
        writer.writeheader()
        writer.writerows({name: f"{value:.12g}" for name, value in row.items()} for row in rows)
