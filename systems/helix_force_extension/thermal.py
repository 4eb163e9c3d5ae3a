"""The same kind of helix under a thermostat, without a load: its tangent correlations against the exact ones.

A helix of nanometres with eight beads a turn. Bends stay six standard deviations away from straight, where a dihedral does
not exist; torsion is soft, so that the turns are lost within a few of them.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament.geometry import bending_angles, dihedrals
from openmm_filament.starts import equilibrium_starts
from systems import stage
from systems.scene import Check

__all__ = [
    "FRAMES",
    "KELVIN",
    "SEGMENTS",
    "SIGMAS",
    "TORSION",
    "Sampled",
    "checks",
    "deviations",
    "exact",
    "filament",
    "numbers",
    "sampled",
    "write",
]

Array = NDArray[np.float64]

KELVIN = 300.0
SEGMENTS, TURNS = 24, 3
RADIUS, PITCH = 3.0, 6.0  # nm
STRETCHING, BENDING, TORSION = 500.0, 150.0, 15.0
"""kJ/mol/nm^2, and kJ/mol: 60 and 6 k_B T."""

CHAINS = 4
EVERY = 100
"""Steps between samples; the slowest mode relaxes in about 2,400."""

WARM_UP = 5_000

FRAMES = 200
"""Frames kept in the trajectory, at most."""

SIGMAS = 4.5
"""Standard errors within which the worst of all separations must lie: chance exceeds it about once in 2,000 runs."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """A run: positions (T, chains, N, 3) in nm, their times in s, the correlation found and the exact one."""

    model: of.Model
    positions: Array
    times: Array
    found: of.analysis.TangentCorrelation
    exact: Array


def filament(torsion: float = TORSION) -> of.Filament:
    """The helix, its torsion in kJ/mol."""
    kj = unit.kilojoule_per_mole
    return of.Filament(
        of.shapes.helix(SEGMENTS, radius=RADIUS * unit.nanometer, pitch=PITCH * unit.nanometer, turns=TURNS),
        300 * unit.dalton,
        (
            of.stretching.Harmonic(STRETCHING * kj / unit.nanometer**2),
            of.bending.Harmonic(BENDING * kj),
            of.torsion.Harmonic(torsion * kj),
        ),
    )


def exact() -> Array:
    """`<t_n . t_0>`, (SEGMENTS,), by the product of mean rotations; energies in kJ/mol, of which it takes only ratios."""
    x = filament().rest.value_in_unit(unit.nanometer)
    return of.wlc.tangent_correlation_discrete(
        SEGMENTS - 1,
        bending=BENDING,
        kT=of.units.BOLTZMANN * KELVIN,
        rest_angle=float(bending_angles(x[None, :3])[0]),
        torsion=TORSION,
        rest_torsion=float(dihedrals(x[None, :4])[0]),
    )


def sampled(
    samples: int, seed: int, *, torsion: float = TORSION, progress: Callable[[float], None] | None = None
) -> Sampled:
    """Run `CHAINS` helices with a Langevin thermostat, from shapes drawn from equilibrium."""
    helix = filament(torsion)
    model = of.build([helix] * CHAINS)
    noise = 1 + seed % (2**31 - 2)
    integrator = of.langevin(model, KELVIN * unit.kelvin, seed=noise)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    starts = equilibrium_starts(helix, 0.0, KELVIN, CHAINS, np.random.default_rng(seed))
    context.setPositions(starts.reshape(-1, 3) / model.scale.length)
    context.setVelocitiesToTemperature(KELVIN / model.scale.factor("temperature"), noise)
    of.preflight(model, context)
    integrator.step(WARM_UP)
    motion = of.record(model, context, samples, EVERY, progress=progress)
    beads = np.arange(CHAINS * (SEGMENTS + 1)).reshape(CHAINS, -1)
    return Sampled(
        model,
        motion.values[:, beads],
        stage.seconds(motion),
        of.analysis.tangent_correlation(motion.values, atoms=beads),
        exact(),
    )


def deviations(run: Sampled) -> Array:
    """Found less exact correlations, over their standard errors, from one segment apart on."""
    return (run.found.values[1:] - run.exact[1:]) / run.found.errors[1:]


def checks(run: Sampled) -> list[Check]:
    """Correlations, `<R^2>` and `<R_g^2>` against the exact ones, in standard errors."""
    z = deviations(run)
    worst = int(np.argmax(np.abs(z)))
    found, wanted = float(run.found.values[worst + 1]), float(run.exact[worst + 1])
    out = [
        Check(
            f"thermal helix, tangent correlation, in standard errors (worst, {worst + 1} segments apart)",
            "exact",
            found,
            wanted,
            float(abs(z[worst])),
            SIGMAS,
        )
    ]
    kt, b0 = of.units.BOLTZMANN * KELVIN, _bond()
    mean, variance = (float(f(b0, STRETCHING, kt)) for f in (of.wlc.mean_bond_length, of.wlc.bond_length_variance))
    sizes = of.wlc.mean_squared_sizes(run.exact, mean, bond_variance=variance)
    flat = run.positions.reshape(len(run.positions), -1, 3)
    beads = np.arange(flat.shape[1]).reshape(CHAINS, -1)
    for name, measure, size in (
        ("<R^2>", of.analysis.mean_squared_end_to_end, sizes[0]),
        ("<R_g^2>", of.analysis.mean_squared_radius_of_gyration, sizes[1]),
    ):
        measured = measure(flat, atoms=beads)
        error = abs(measured.value - size) / measured.error
        out.append(
            Check(f"thermal helix, {name} in nm^2, in standard errors", "exact", measured.value, size, error, SIGMAS)
        )
    return out


def _bond() -> float:
    """Rest length of a segment in nm."""
    x = filament().rest.value_in_unit(unit.nanometer)
    return float(np.linalg.norm(x[1] - x[0]))


def numbers() -> dict[str, float]:
    """What defines the chain, unit in the key."""
    return {
        "thermal_segments": SEGMENTS,
        "thermal_helix_radius_nm": RADIUS,
        "thermal_pitch_nm": PITCH,
        "thermal_turns": TURNS,
        "thermal_stretching_kJ_per_mol_nm2": STRETCHING,
        "thermal_bending_kJ_per_mol": BENDING,
        "thermal_torsion_kJ_per_mol": TORSION,
        "thermal_temperature_K": KELVIN,
    }


def write(folder: Path, run: Sampled) -> None:
    """The table, the figure and a trajectory."""
    found = run.found
    with (folder / "tangent_correlations.csv").open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(["segments_apart", "separation_nm", "correlation", "correlation_error", "exact"])
        columns = (found.separations, found.values, found.errors, run.exact)
        for n, row in enumerate(zip(*columns, strict=True)):
            writer.writerow([n, *(f"{number:.10g}" for number in row)])
    _figure(folder / "tangent_correlations.png", run)
    every = -(-len(run.times) // FRAMES)
    flat = run.positions.reshape(len(run.positions), -1, 3)
    stage.write_trajectory(folder / "trajectory_thermal.dcd", run.model, run.times[::every], flat[::every])


def _figure(path: Path, run: Sampled) -> None:
    """Correlations with error bars on the exact ones, and their differences in standard errors."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(8.0, 6.5), layout="constrained")
    upper, lower = drawing.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    found = run.found
    free = float(run.exact[1]) ** np.arange(SEGMENTS)
    upper.plot(found.separations, free, color="0.7", lw=1, label="without torsion: powers of the first")
    upper.plot(found.separations, run.exact, "-", color="C0", label="exact: product of mean rotations")
    upper.errorbar(
        found.separations, found.values, 2 * found.errors, fmt="o", ms=4, color="C3", capsize=2,
        label="Langevin dynamics, two standard errors",
    )  # fmt: skip
    upper.axhline(0, color="0.85", lw=0.8)
    upper.set(
        ylabel="tangent correlation",
        title=f"Helix at {KELVIN:g} K: {SEGMENTS / TURNS:g} segments a turn, bending {BENDING:g}, torsion {TORSION:g} kJ/mol",
    )
    upper.legend(fontsize=9)
    lower.plot(found.separations[1:], deviations(run), "o", ms=4, color="C3")
    for z in (-2, 0, 2):
        lower.axhline(z, color="0.85", lw=0.8)
    lower.set(xlabel="separation along the chain (nm)", ylabel="difference over\nstandard error", ylim=(-5, 5))
    drawing.savefig(path, dpi=150)
