"""DNA under a force: the sampler against plain OpenMM as one writes it at first, to the same error on one core.

The newcomer's chain has 10 segments a persistence length, `alpha = kT l_p/l0`, unit masses, CustomBondForce and
CustomAngleForce, a straight start, OpenMM's own choice of a platform and the friction of its examples, 1/ps. The step is
guessed: 50 fs, half of what holds (1 fs, as in many examples, would take 50 times as long).

Steps to the error follow from the autocorrelation of such a run on the Reference platform, which has the same statistics and
lets the bench end in two minutes; its wall time is that of a step on each platform, timed in turns with the sampler.

Run by hand: `python tests/benchmarks/bench_newcomer.py`. It asserts nothing.
"""

from __future__ import annotations

import math
import time
from statistics import median

import numpy as np
import openmm as mm
from openmm import unit

import openmm_filament as of
from openmm_filament import wlc
from openmm_filament.discretisation import PN
from systems.dna_force_extension import curve as dna

FORCE = float(dna.FORCES[9])
"""14 pN."""
WANTED = (0.02, 0.009)
"""Relative errors, bias and two standard errors; the second is what the system asks for there."""

SEGMENTS = round(10 * dna.CONTOUR / dna.PERSISTENCE)
BOND = dna.CONTOUR / SEGMENTS
BENDING, STRETCHING = dna.KT * dna.PERSISTENCE / BOND, dna.MODULUS / BOND  # pN nm, pN/nm
STEP, FRICTION = 0.05, 1.0  # ps, 1/ps

RELAXATIONS, WARM_UP, SAMPLES = 5, 2.5, 20
"""Length of the run in relaxation times, those left out before it, and samples in one."""

ROUNDS, TIMED = 3, 400
"""Rounds in turns, and steps of one timing."""


def newcomer(platform: str | None = None) -> mm.Context:
    """The script: a Context whose first bead is held and whose last is pulled along z."""
    system = mm.System()
    bonds = mm.CustomBondForce("0.5*k*(r-r0)^2")
    bonds.addGlobalParameter("k", STRETCHING * PN)
    bonds.addGlobalParameter("r0", BOND)
    angles = mm.CustomAngleForce("0.5*a*(theta-pi)^2; pi=3.141592653589793")
    angles.addGlobalParameter("a", BENDING * PN)
    pull = mm.CustomExternalForce("-f*z")
    pull.addGlobalParameter("f", FORCE * PN)
    for i in range(SEGMENTS + 1):
        system.addParticle(1.0 if i else 0.0)
    for i in range(SEGMENTS):
        bonds.addBond(i, i + 1)
    for i in range(SEGMENTS - 1):
        angles.addAngle(i, i + 1, i + 2)
    pull.addParticle(SEGMENTS)
    for term in (bonds, angles, pull):
        system.addForce(term)
    integrator = mm.LangevinMiddleIntegrator(dna.TEMPERATURE, FRICTION, STEP)
    integrator.setRandomNumberSeed(1)
    own = () if platform is None else (mm.Platform.getPlatformByName(platform),)
    context = mm.Context(system, integrator, *own)
    context.setPositions(np.outer(np.arange(SEGMENTS + 1), [0, 0, BOND]))
    context.setVelocitiesToTemperature(dna.TEMPERATURE, 1)
    return context


def relaxation() -> float:
    """Steps in a relaxation time of the slowest mode, overdamped: a taut string's between a held and a pulled end."""
    wave = (math.pi / 2 / SEGMENTS) ** 2
    return FRICTION / (FORCE * PN / BOND * wave + BENDING * PN / BOND**2 * wave**2) / STEP


def exact() -> float:
    """Mean extension of the continuous chain in nm."""
    return float(
        wlc.extension_exact(FORCE, dna.PERSISTENCE, dna.CONTOUR, dna.KT, stretch_modulus=dna.MODULUS, finite=True)
    )


def needed() -> tuple[list[float], float, float]:
    """Steps until each of the errors is met, the known bias, and the deviation from the exact answer that the run ended at."""
    from arviz_stats.base import array_stats

    arguments = {"segments": SEGMENTS, "bond_length": BOND, "bending": BENDING, "kT": dna.KT, "stretching": STRETCHING}
    discrete, up, down = (float(wlc.extension_discrete(f * FORCE, **arguments)) for f in (1.0, 1.01, 0.99))
    bias = discrete / exact() - 1
    spread = math.sqrt(dna.KT * (up - down) / (0.02 * FORCE)) / exact()
    context, slow = newcomer("Reference"), relaxation()
    stride = max(1, round(slow / SAMPLES))
    context.getIntegrator().step(round(WARM_UP * slow))
    series = np.empty(RELAXATIONS * SAMPLES)
    for i in range(len(series)):
        context.getIntegrator().step(stride)
        series[i] = context.getState(positions=True).getPositions(asNumpy=True)[-1, 2]._value
    independent = float(array_stats.ess(series[None], chain_axis=0, draw_axis=1, method="mean"))
    steps = []
    for wanted in WANTED:
        samples = (2 * spread / (wanted - abs(bias))) ** 2 if abs(bias) < wanted else math.inf
        steps.append(WARM_UP * slow + samples * len(series) * stride / independent)
    return steps, bias, float(series.mean()) / exact() - 1


def step_seconds(context: mm.Context) -> float:
    """Wall time of a step."""
    begun = time.perf_counter()
    context.getIntegrator().step(TIMED)
    context.getState(positions=True)
    return (time.perf_counter() - begun) / TIMED


def sampled(wanted: float, seed: int) -> tuple[float, float]:
    """Wall time of the sampler, planning and all, and how far it is from the exact answer."""
    begun = time.perf_counter()
    found = of.force_extension(
        dna.chain(), [FORCE] * unit.piconewton, dna.TEMPERATURE * unit.kelvin, wanted, seed=seed, processes=1
    )
    return time.perf_counter() - begun, abs(float(found.extension[0]) / exact() - 1)


def main() -> None:
    """Print one line an error and platform."""
    steps, bias, ended = needed()
    print(
        f"Newcomer at {FORCE:.3g} pN: {SEGMENTS} segments, {1000 * STEP:g} fs, 1/ps; bias {100 * bias:+.2f} %, mean of its run "
        f"{100 * ended:+.2f} %. One process each."
    )
    contexts = newcomer(), newcomer("Reference")
    for context in contexts:
        step_seconds(context)
    for wanted, count in zip(WANTED, steps, strict=True):
        rows = [(*sampled(wanted, 1 + i), *(count * step_seconds(c) for c in contexts)) for i in range(ROUNDS)]
        print(
            f"to {100 * wanted:g} %: the sampler {median(row[0] for row in rows):.2g} s, off by at most "
            f"{100 * max(row[1] for row in rows):.2f} %; the newcomer {count:.2g} steps"
        )
        for column, context in enumerate(contexts, 2):
            ratios = sorted(row[column] / row[0] for row in rows)
            print(
                f"  on {context.getPlatform().getName()}: {median(row[column] for row in rows):.3g} s, "
                f"{median(ratios):.3g} times as long ({ratios[0]:.3g} to {ratios[-1]:.3g})",
                flush=True,
            )


if __name__ == "__main__":
    main()
