"""Time to build a model of a million beads, with and without torsion, against adding the same elements by hand.

Run by hand: `python tests/benchmarks/bench_build.py [beads]`. It prints medians and ratios and asserts nothing.
"""

from __future__ import annotations

import sys
import time
from statistics import median
from typing import Any

import openmm as mm
from openmm import unit

import openmm_filament as of

KJ = unit.kilojoule_per_mole
ROUNDS = 3


def by_hand(beads: int, torsion: bool) -> mm.System:
    """What a script without the package does, without a rest shape to read from."""
    system = mm.System()
    bond, angle = mm.CustomBondForce("100*(r-1)^2"), mm.CustomAngleForce("10*(theta-2.5)^2")
    dihedral = mm.CustomTorsionForce("2*(theta-1)^2")
    for i in range(beads):
        system.addParticle(10.0)
        if i > 0:
            bond.addBond(i - 1, i)
        if i > 1:
            angle.addAngle(i - 2, i - 1, i)
        if i > 2 and torsion:
            dihedral.addTorsion(i - 3, i - 2, i - 1, i)
    for force in (bond, angle, *((dihedral,) if torsion else ())):
        system.addForce(force)
    return system


def timed(function: Any, *arguments: Any) -> float:
    """Seconds of one call, its result given up within."""
    begun = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - begun


def main() -> None:
    """Print one line with torsion and one without."""
    beads = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    rest = of.shapes.helix(beads - 1, radius=2 * unit.nanometer, pitch=3 * unit.nanometer, turns=(beads - 1) / 12)
    print(f"{beads} beads   filament + build / s   by hand / s   ratio (median of pairs)")
    for torsion in (False, True):
        terms = (
            of.stretching.Harmonic(200 * KJ / unit.nanometer**2), of.bending.Harmonic(20 * KJ),
            *((of.torsion.Harmonic(4 * KJ),) if torsion else ()),
        )  # fmt: skip

        def package(terms: Any = terms) -> of.Model:
            return of.build(of.Filament(rest, 10 * unit.dalton, terms))

        pairs = [(timed(package), timed(by_hand, beads, torsion)) for _ in range(ROUNDS)]
        mine, hand = (median(side) for side in zip(*pairs, strict=True))
        ratio = median(a / b for a, b in pairs)
        print(f"{'with' if torsion else 'without'} torsion   {mine:.2f}   {hand:.2f}   {ratio:.2f}")


if __name__ == "__main__":
    main()
