"""The platform that the package chooses against OpenMM's own default, LangevinMiddle steps, paired in one process.

Run by hand: `python tests/benchmarks/bench_platform.py`. It prints medians and ratios and asserts nothing.
"""

from __future__ import annotations

import time
from statistics import median

import openmm as mm
from openmm import unit

import openmm_filament as of

WARM = 298 * unit.kelvin
ROUNDS = 9


def context(model: of.Model, platform: mm.Platform | None) -> mm.Context:
    """A Context as a user makes one; without a platform OpenMM chooses."""
    integrator = of.langevin(model, WARM, seed=1)
    if platform is None:
        made = mm.Context(model.system, integrator)
    else:
        made = mm.Context(model.system, integrator, platform, of.platform_properties(model, platform, WARM))
    made.setPositions(model.positions)
    integrator.step(20)
    return made


def seconds(made: mm.Context, steps: int) -> float:
    """Of one step."""
    begun = time.perf_counter()
    made.getIntegrator().step(steps)
    made.getState(energy=False)
    return (time.perf_counter() - begun) / steps


def main() -> None:
    """Print one line a size."""
    print("beads   chosen       us/step   OpenMM's own   us/step   ratio (median of pairs)")
    for beads in (10, 100):
        chain = of.WormlikeChain(10 * beads * unit.nanometer, 53 * unit.nanometer, 1000 * unit.piconewton)
        model = of.build(chain.filament(beads - 1, WARM), [of.loads.Hold(0)])
        mine, own = context(model, of.fastest_platform(model, WARM)), context(model, None)
        pairs = [(seconds(mine, 5000), seconds(own, 300)) for _ in range(ROUNDS)]
        a, b = (1e6 * median(side) for side in zip(*pairs, strict=True))
        ratio = median(y / x for x, y in pairs)
        chosen, default = (made.getPlatform().getName() for made in (mine, own))
        print(f"{beads:5d}   {chosen:10s} {a:9.2f}   {default:12s} {b:9.2f}   {ratio:.1f}")


if __name__ == "__main__":
    main()
