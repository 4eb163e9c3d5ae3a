"""Stepping a model of the package against the same chain written by hand with per-element parameters, paired.

Run by hand: `python tests/benchmarks/bench_step.py`. It prints medians and ratios and asserts nothing.
"""

from __future__ import annotations

import time
from statistics import median

import openmm as mm
from openmm import app, unit

import openmm_filament as of

KJ = unit.kilojoule_per_mole
REFERENCE = mm.Platform.getPlatformByName("Reference")
ROUNDS = 9


def by_hand(beads: int, torsion: bool, x: unit.Quantity) -> mm.System:
    """The same energies with a parameter an element, as scripts usually write them."""
    system = mm.System()
    bond = mm.CustomBondForce("0.5*k*(r-r0)^2")
    angle = mm.CustomAngleForce("0.5*alpha*(theta-theta0)^2")
    dihedral = mm.CustomTorsionForce("0.5*c*d^2; d=t-6.283185307179586*floor(0.5+t/6.283185307179586); t=theta-tau0")
    for force, add, names in (
        (bond, bond.addPerBondParameter, ("k", "r0")),
        (angle, angle.addPerAngleParameter, ("alpha", "theta0")),
        (dihedral, dihedral.addPerTorsionParameter, ("c", "tau0")),
    ):
        for name in names:
            add(name)
        if force is not dihedral or torsion:
            system.addForce(force)
    filament = of.Filament(x, 10 * unit.dalton, (of.stretching.Harmonic(200 * KJ / unit.nanometer**2), of.bending.Harmonic(20 * KJ),
                                                 of.torsion.Harmonic(4 * KJ)))  # fmt: skip
    rest = {i.term.family: i.parameters for i in filament.interactions()}
    for i in range(beads):
        system.addParticle(10.0)
        if i > 0:
            bond.addBond(i - 1, i, (200.0, rest["stretching"]["r0"][i - 1]))
        if i > 1:
            angle.addAngle(i - 2, i - 1, i, (20.0, 3.141592653589793 - rest["bending"]["beta0"][i - 2]))
        if i > 2 and torsion:
            dihedral.addTorsion(i - 3, i - 2, i - 1, i, (4.0, rest["torsion"]["tau0"][i - 3]))
    return system


def simulation(model: of.Model, system: mm.System) -> app.Simulation:
    """With the integrator that the package chooses, on Reference."""
    made = app.Simulation(model.topology, system, of.langevin(model, 298 * unit.kelvin, seed=1), REFERENCE)
    made.context.setPositions(model.positions)
    made.step(10)
    return made


def seconds(made: app.Simulation, steps: int) -> float:
    """Of one step."""
    begun = time.perf_counter()
    made.step(steps)
    return (time.perf_counter() - begun) / steps


def main() -> None:
    """Print one line a size and kind."""
    print("beads   torsion   package ns/bead/step   by hand   ratio (median of pairs)")
    for beads in (10, 100, 10_000):
        rest = of.shapes.helix(beads - 1, radius=2 * unit.nanometer, pitch=3 * unit.nanometer, turns=(beads - 1) / 12)
        for torsion in (False, True):
            terms = (
                of.stretching.Harmonic(200 * KJ / unit.nanometer**2), of.bending.Harmonic(20 * KJ),
                *((of.torsion.Harmonic(4 * KJ),) if torsion else ()),
            )  # fmt: skip
            model = of.build(of.Filament(rest, 10 * unit.dalton, terms))
            both = simulation(model, model.system), simulation(model, by_hand(beads, torsion, rest))
            steps = max(10, 300_000 // beads)
            pairs = [tuple(seconds(made, steps) for made in both) for _ in range(ROUNDS)]
            mine, hand = (1e9 * median(side) / beads for side in zip(*pairs, strict=True))
            ratio = median(a / b for a, b in pairs)
            print(
                f"{beads:5d}   {'yes' if torsion else 'no ':3s}       {mine:8.1f}               {hand:8.1f}   {ratio:.2f}"
            )


if __name__ == "__main__":
    main()
