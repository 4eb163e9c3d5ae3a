"""What contact costs as a model grows, on each platform that can run it. `python tests/benchmarks/bench_contact.py [--most BEADS]`.

Straight filaments of 125 beads on a square lattice, two diameters apart, in thermal motion: the same density at every size.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import openmm as mm
from openmm import unit

import openmm_filament as of

BEADS, SPACING, DIAMETER = 125, 0.5, 1.0
REFERENCE_AT_MOST = 1000
"""Beads; Reference, which makes its list of neighbours anew in every step, takes seconds beyond."""


def model_of(filaments: int, *, contact: bool) -> of.Model:
    """So many filaments side by side."""
    nm, kj = unit.nanometer, unit.kilojoule_per_mole
    stiffness = 1000 * kj / nm**2
    terms = (of.stretching.Harmonic(stiffness), of.bending.Harmonic(50 * kj))
    if contact:
        terms += (of.contact.Repulsion(DIAMETER * nm, stiffness),)
    line = np.outer(np.arange(BEADS), [SPACING, 0, 0])
    side = int(np.ceil(np.sqrt(filaments)))
    places = [[0, 2 * DIAMETER * (i % side), 2 * DIAMETER * (i // side)] for i in range(filaments)]
    return of.build([of.Filament((line + place) * nm, 10 * unit.dalton, terms) for place in places])


def seconds_per_step(model: of.Model, platform: str, repeats: int) -> list[float]:
    """Of so many runs of Langevin dynamics, after a short one."""
    integrator = of.langevin(model, temperature=300 * unit.kelvin, seed=1, friction=1 / unit.picosecond)
    context = mm.Context(model.system, integrator, mm.Platform.getPlatformByName(platform))
    context.setPositions(model.positions)
    integrator.step(5)
    steps = max(3, 1_000_000 // int(model.starts[-1]) // 4)
    out = []
    for _ in range(repeats):
        begun = time.perf_counter()
        integrator.step(steps)
        context.getState(positions=True)
        out.append((time.perf_counter() - begun) / steps)
    return out


def main() -> None:
    """One line a size and platform: with contact, without, and the ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=int, default=100_000)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    names = {mm.Platform.getPlatform(i).getName() for i in range(mm.Platform.getNumPlatforms())} & {"Reference", "CPU"}
    for filaments in (2, 8, 80, 800):
        beads = filaments * BEADS
        if beads > options.most:
            break
        models = [model_of(filaments, contact=contact) for contact in (True, False)]
        for name in sorted(names):
            if name == "Reference" and beads > REFERENCE_AT_MOST:
                continue
            times = [np.array(seconds_per_step(model, name, options.repeats)) for model in models]
            cost, bare = (1e9 * np.median(t) / beads for t in times)
            print(
                f"{beads:7d} beads on {name}: {cost:.0f} ns a bead and step with contact ({1e9 * times[0].min() / beads:.0f} to "
                f"{1e9 * times[0].max() / beads:.0f}), {bare:.0f} without",
                flush=True,
            )
        print(f"        fastest_platform: {of.fastest_platform(models[0], 300 * unit.kelvin).getName()}", flush=True)


if __name__ == "__main__":
    main()
