"""Error against run time of the DNA curve: the README's table. `python tests/benchmarks/bench_error.py`."""

import time

import numpy as np
from openmm import unit

import openmm_filament as of
from openmm_filament import wlc
from systems.dna_force_extension import curve as dna

ASKED = {
    "0.06 (`--quick`)": np.full(12, 0.06),
    "0.03": np.full(12, 0.03),
    "0.027 below 0.3 pN, 0.009 above (default)": dna.wanted_errors(None, quick=False),
    "0.01": np.full(12, 0.01),
}


def main() -> None:
    """Print one row a wanted error: what was promised, what it deviates by, and how long it took."""
    exact = wlc.extension_exact(
        dna.FORCES, dna.PERSISTENCE, dna.CONTOUR, dna.KT, stretch_modulus=dna.MODULUS, finite=True
    )
    print(
        "| relative error asked | largest bias + 2 SE | largest deviation found | segments | bead-steps | wall time |"
    )
    print("|---|---|---|---|---|---|")
    for name, asked in ASKED.items():
        begun = time.perf_counter()
        curve = of.force_extension(
            dna.chain(), dna.FORCES * unit.piconewton, dna.TEMPERATURE * unit.kelvin, asked, seed=1
        )
        seconds = time.perf_counter() - begun
        bound = ((abs(curve.bias) + 2 * curve.extension_error) / exact).values
        deviation = abs(curve.extension / exact - 1).values
        work = float((curve.steps * curve.attrs["chains"] * (curve.segments + 1)).sum())
        print(
            f"| {name} | {_both(bound)} | {_both(deviation)} | {int(curve.segments.min())}-{int(curve.segments.max())} "
            f"| {work:.2g} | {seconds:.0f} s |",
            flush=True,
        )


def _both(values: np.ndarray) -> str:
    """The largest below 0.3 pN, and from there up, in per cent."""
    low = dna.FORCES < 0.3
    return f"{100 * values[low].max():.2f} %, {100 * values[~low].max():.2f} %"


if __name__ == "__main__":
    main()
