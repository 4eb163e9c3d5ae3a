"""Wall time of 50 ms of the guitar string with partials 1 to 10 within 2 % of the exact stiff string.

Three strings side by side: the wire's own bonds and softened bonds, each with the fewest beads that meet 2 %, and the
system's 200 beads with bonds 64 times softer. Beside them PyElastica's 21 s for 50 elements on a two-core machine, a figure
that is quoted and not measured here. The lines are those of the simulated motion.

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
"""Seconds, for 50 elements: measured elsewhere on this kind of machine, not by this benchmark."""
ALLOWED = 0.02
"""Largest relative error of a partial."""
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


def fewest(known: int, softer: float, rate: float, every: int) -> int:
    """The least number of segments from which on, up to the `known`, every string meets 2 %."""
    met = known
    for segments in range(known, 23, -1):
        if run(segments, softer, rate, every)[2] > ALLOWED:
            break
        met = segments
    return met


def spread(values: list[float]) -> str:
    """Median, least and largest."""
    return f"{median(values):.4g} ({min(values):.4g} to {max(values):.4g})"


def main(repeats: int) -> None:
    """Print a line a chain; the chains take turns, so that what else the machine does falls on all of them."""
    own, soft = (1.0, 9_000.0, 46), (900.0, 9_600.0, 1)
    strings_ = {
        "the wire's own bonds, fewest beads": (fewest(48, *own), *own),
        "softened bonds, fewest beads": (fewest(40, *soft), *soft),
        "200 beads, bonds 64 times softer": (201, 64.0, 24_000.0, 10),
    }
    runs: dict[str, list[tuple[float, float, float]]] = {name: [] for name in strings_}
    for _ in range(repeats):
        for name, arguments in strings_.items():
            runs[name].append(run(*arguments))
    print(
        f"{1e3 * SECONDS:.0f} ms of the guitar string, partials 1 to {len(PARTIALS)}; median (least to largest) of {repeats}.\n"
        f"{PYELASTICA:.0f} s is PyElastica's figure for 50 elements on a machine of this kind. It was not measured in this run."
    )
    for name, (segments, softer, rate, every) in strings_.items():
        whole, motion = ([1e3 * r[i] for r in runs[name]] for i in (0, 1))
        print(
            f"{name}: {segments - 1} moving beads, bonds {softer:g} times softer, {1e6 / (rate * every):.3g} us a step, largest "
            f"error {100 * runs[name][0][2]:.2f} %\n"
            f"    motion {spread(motion)} ms, with the set-up {spread(whole)} ms; "
            f"{PYELASTICA:.0f} s over that with the set-up: {spread([1e3 * PYELASTICA / t for t in whole])}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
