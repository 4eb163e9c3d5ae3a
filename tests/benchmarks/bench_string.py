"""Wall time of 50 ms of the guitar string with partials 1 to 10 within 2 % of the exact stiff string.

Three strings side by side: the wire's own bonds and softened bonds, each with the fewest beads that meet 2 %, and the
system's 200 beads with bonds 64 times softer. In turn with them PyElastica (extra `peers`): 50 elements, hinged, at the
longest step that stays stable to within a tenth; the rotation of its elements, not the wave, sets that step. Without it the
ratios are to 21 s, a figure from another two-core machine. The lines are those of the simulated motion.

Run by hand: python tests/benchmarks/bench_string.py [repeats]
"""

from __future__ import annotations

import sys
import time
from importlib.util import find_spec
from statistics import median

import numpy as np
from openmm import unit

import openmm_filament as of
from openmm_filament import analysis
from systems import stage, strings

PYELASTICA = 21.0
"""Seconds, for 50 elements: measured elsewhere on this kind of machine; used where PyElastica is not installed."""
ELEMENTS, ELEMENTS_STEP = 50, 8e-8
"""Of PyElastica's rod; at a step of 1e-7 s it leaves the string within a millisecond."""
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
    return done - begun, done - ready, worst(moved, 1 / rate)


def worst(moved: np.ndarray, interval: float) -> float:
    """Largest relative error of the partials found in shapes (frames, beads) that much time apart."""
    places = np.arange(moved.shape[1]) / (moved.shape[1] - 1)
    waves = np.sin(np.pi * PARTIALS[:, None] * places) @ moved.T
    found = [float(analysis.lines(wave, interval, count=1).frequencies[0]) for wave in waves]
    return float(np.abs(np.array(found) / strings.stiff_law(PARTIALS) - 1).max())


def run_elastica(seconds: float) -> tuple[float, float]:
    """Wall seconds of PyElastica's motion over the pluck and so much time, and the largest relative error of a partial."""
    import elastica as ea

    class Scene(ea.BaseSystemCollection, ea.Constraints, ea.Forcing, ea.CallBacks):  # type: ignore[misc]
        pass

    class Pluck(ea.NoForces):  # type: ignore[misc]
        def apply_forces(self, system, time=0.0):  # type: ignore[no-untyped-def]
            if time < strings.PLUCKING:
                system.external_forces[0, round(0.07 * ELEMENTS)] += 0.01

    times, shapes = [], []

    class Record(ea.CallBackBaseClass):  # type: ignore[misc]
        def make_callback(self, system, time, current_step):  # type: ignore[no-untyped-def]
            if current_step % round(1e-4 / ELEMENTS_STEP) == 0 and time > strings.PLUCKING:
                times.append(time)
                shapes.append(system.position_collection[0].copy())

    area = np.pi * strings.RADIUS**2
    rod = ea.CosseratRod.straight_rod(
        ELEMENTS,
        np.zeros(3),
        np.array([0.0, 0.0, 1.0]),
        np.array([1.0, 0.0, 0.0]),
        strings.LENGTH,
        strings.RADIUS,
        strings.DENSITY / area,
        youngs_modulus=strings.YOUNG,
        shear_modulus=strings.YOUNG / 2.6,
    )
    shortened = 1 + strings.TENSION / (strings.YOUNG * area)
    rod.rest_lengths[:] /= shortened
    rod.rest_voronoi_lengths[:] /= shortened
    scene = Scene()
    scene.append(rod)
    scene.constrain(rod).using(ea.FixedConstraint, constrained_position_idx=(0, -1))
    scene.add_forcing_to(rod).using(Pluck)
    scene.collect_diagnostics(rod).using(Record)
    scene.finalize()
    begun = time.perf_counter()
    whole = strings.PLUCKING + seconds
    ea.integrate(ea.PositionVerlet(), scene, whole, round(whole / ELEMENTS_STEP), progress_bar=False)
    wall = time.perf_counter() - begun
    if len(times) < 2 * len(PARTIALS):
        return wall, np.nan
    return wall, worst(np.array(shapes), (times[-1] - times[0]) / (len(times) - 1))


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
    peers: list[float] = []
    if measured := find_spec("elastica") is not None:
        run_elastica(0.0)  # compiles its kernels
    for _ in range(repeats):
        for name, arguments in strings_.items():
            runs[name].append(run(*arguments))
        if measured:
            seconds, error = run_elastica(SECONDS)
            peers.append(seconds)
    print(
        f"{1e3 * SECONDS:.0f} ms of the guitar string, partials 1 to {len(PARTIALS)}; median (least to largest) of {repeats}."
    )
    if measured:
        print(f"PyElastica, {ELEMENTS} elements: {spread(peers)} s, largest error {100 * error:.2f} %")
    else:
        peers = [PYELASTICA] * repeats
        print(
            f"{PYELASTICA:.0f} s is PyElastica's figure for {ELEMENTS} elements on another machine, not measured in this run."
        )
    for name, (segments, softer, rate, every) in strings_.items():
        whole, motion = ([1e3 * r[i] for r in runs[name]] for i in (0, 1))
        print(
            f"{name}: {segments - 1} moving beads, bonds {softer:g} times softer, {1e6 / (rate * every):.3g} us a step, largest "
            f"error {100 * runs[name][0][2]:.2f} %\n"
            f"    motion {spread(motion)} ms, with the set-up {spread(whole)} ms; PyElastica over that with the set-up: "
            f"{spread([1e3 * p / t for p, t in zip(peers, whole, strict=True)])}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
