"""What the time step of LangevinMiddle does to the extension of DNA, against the exact discrete chain.

Each force of the DNA curve is run on the chain chosen for it at a given part of the limit of stability, and the deviation is
told as that of the persistence length which would make it. The law in `openmm_filament.discretisation` rests on parts 0.8 (to
0.3 %) and 0.55 (to 0.2 %), half an hour each on one core.

Run by hand: python tests/benchmarks/bench_time_step.py PART RELATIVE_ERROR [seed]
"""

from __future__ import annotations

import sys

import numpy as np
from openmm import unit

import openmm_filament as of
from openmm_filament import wlc
from openmm_filament.discretisation import choose, exact_chain
from openmm_filament.integrators import thermal_step
from systems.dna_force_extension import curve as dna


def main(part: float, relative_error: float, seed: int) -> None:
    """Print a line a force and the weighted mean over all."""
    kelvin = dna.TEMPERATURE * unit.kelvin
    longer, weights = [], []
    for force, choice in zip(
        dna.FORCES, choose(dna.chain(), dna.FORCES, kelvin, dna.wanted_errors(None, quick=False)), strict=True
    ):
        model = of.build(choice.filament, [of.loads.Hold(0), of.loads.Pull(-1, (0, 0, force) * unit.piconewton)])
        step = thermal_step(model, dna.TEMPERATURE, None, part) * model.scale.factor("time") * unit.picosecond
        curve = of.force_extension(
            choice.filament, force * unit.piconewton, kelvin, relative_error, seed=seed, timestep=step, processes=1
        )
        chain = exact_chain(choice.filament, kelvin)
        assert chain is not None
        exact = float(chain.extension(force))
        deviation = float(curve.extension[0]) / exact - 1
        error = float(curve.extension_error[0]) / exact
        finite = [
            wlc.extension_exact(
                force, s * dna.PERSISTENCE, dna.CONTOUR, dna.KT, stretch_modulus=dna.MODULUS, finite=True
            )
            for s in (1.0, 1.01)
        ]
        slope = (float(finite[1] / finite[0]) - 1) / 0.01
        longer.append(deviation / slope)
        weights.append((slope / error) ** 2)
        print(
            f"{force:7.3f} pN, {chain.segments:3d} segments, alpha {float(chain.bending) / chain.kT:5.2f} kT: extension "
            f"{100 * deviation:+.3f} +- {100 * error:.3f} %, persistence length {100 * longer[-1]:+.2f} +- "
            f"{100 / weights[-1] ** 0.5:.2f} %",
            flush=True,
        )
    mean = np.average(longer, weights=weights)
    chi2 = float(np.dot(weights, (np.array(longer) - mean) ** 2))
    print(
        f"all at {part:g} of the limit: {100 * mean:+.2f} +- {100 / sum(weights) ** 0.5:.2f} %, chi-squared {chi2:.1f} of "
        f"{len(longer) - 1}"
    )


if __name__ == "__main__":
    main(float(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 1)
