"""Wall time of 50 ms of the guitar string with partials 1 to 10 within 2 % of the exact stiff string.

PyElastica takes 21 s for that (50 elements, two-core machine). Here the chain has few beads, soft bonds and steps as
long as 2 % allow; the same error with the wire's own bonds is timed too. The lines are those of the simulated motion.

Run by hand: python tests/benchmarks/bench_string.py [repeats]
"""

from __future__ import annotations

import sys
import time
from statistics import median

import numpy as np
from openmm import unit

import openmm_filament as of
from openmm_filament import analysis
from systems import stage, strings

PYELASTICA = 21.0
"""Seconds, measured elsewhere on this kind of machine."""
SECONDS, PARTIALS = 0.05, np.arange(1, 11)


def run(segments: int, softer: float, rate: float, every: int) -> tuple[float, float, float]:
    """Wall seconds from the chain to the recorded motion, those of the motion alone, and the largest relative error."""
    begun = time.perf_counter()
    pluck = strings.Pluck(round(0.07 * segments), 0.01)
    model = strings.string(segments, [pluck], damping=None, softer=softer)
    context = stage.context(model, of.verlet(model, timestep=1 / (rate * every) * unit.second), "Reference")
    ready = time.perf_counter()
    # let go at once: the pluck is over after 1/300 s, and the 50 ms count from there
    motion = of.record(model, context, round((strings.PLUCKING + SECONDS) * rate), every, observe=lambda x: x[:, 0])
    done = time.perf_counter()
    moved = stage.metres(motion.values)[strings.released(motion)]
    shapes = np.sin(np.pi * PARTIALS[:, None] * np.arange(segments + 1) / segments)
    found = [float(analysis.lines(wave, 1 / rate, count=1).frequencies[0]) for wave in shapes @ moved.T]
    error = np.abs(np.array(found) / strings.stiff_law(PARTIALS) - 1).max()
    return done - begun, done - ready, float(error)


def main(repeats: int) -> None:
    """Print a line a chain."""
    for name, arguments in {
        "200 beads, bonds 64 times softer": (201, 64.0, 24_000.0, 10),
        "few beads, soft bonds, long steps": (40, 900.0, 9_600.0, 1),
        "the wire's own bonds": (48, 1.0, 9_000.0, 46),
    }.items():
        runs = [run(*arguments) for _ in range(repeats)]
        whole, motion = ([r[i] for r in runs] for i in (0, 1))
        ratios = [PYELASTICA / t for t in whole]
        print(
            f"{name} ({arguments[0]} segments, {1e6 / (arguments[2] * arguments[3]):.3g} us a step): largest error "
            f"{100 * runs[0][2]:.2f} %, motion {1e3 * median(motion):.1f} ms ({1e3 * min(motion):.1f} to {1e3 * max(motion):.1f}), with "
            f"the set-up {1e3 * median(whole):.1f} ms; PyElastica's 21 s over that: {median(ratios):.0f} "
            f"({min(ratios):.0f} to {max(ratios):.0f})"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
