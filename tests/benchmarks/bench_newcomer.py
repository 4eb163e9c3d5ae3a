"""DNA under a force: the sampler against plain OpenMM as one writes it at first, to the same error on one core.

The newcomer's chain has 10 segments a persistence length, `alpha = kT l_p/l0`, unit masses, CustomBondForce and
CustomAngleForce, a straight start, OpenMM's own choice of a platform and the friction of its examples, 1/ps. The step is
guessed: doubled from 1 fs as long as the chain holds, 50 fs after a step back (1 fs would take 50 times as long).

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

FORCES = dna.FORCES[[9, 10]]
WANTED = 0.009
"""Relative error, as the system asks for there: bias and two standard errors."""

SEGMENTS = round(10 * dna.CONTOUR / dna.PERSISTENCE)
BOND = dna.CONTOUR / SEGMENTS
BENDING, STRETCHING = dna.KT * dna.PERSISTENCE / BOND, dna.MODULUS / BOND  # pN nm, pN/nm
STEP, FRICTION = 0.05, 1.0  # ps, 1/ps

RELAXATIONS, WARM_UP, SAMPLES = 5, 2.5, 20
"""Length of the run in relaxation times, those left out before it, and samples in one."""

ROUNDS, TIMED = 3, 400
"""Rounds in turns, and steps of one timing."""


def newcomer(force: float, platform: str | None = None) -> mm.Context:
    """The script: a Context whose first bead is held and whose last is pulled along z by `force` in pN."""
    system = mm.System()
    bonds = mm.CustomBondForce("0.5*k*(r-r0)^2")
    bonds.addGlobalParameter("k", STRETCHING * PN)
    bonds.addGlobalParameter("r0", BOND)
    angles = mm.CustomAngleForce("0.5*a*(theta-pi)^2; pi=3.141592653589793")
    angles.addGlobalParameter("a", BENDING * PN)
    pull = mm.CustomExternalForce("-f*z")
    pull.addGlobalParameter("f", force * PN)
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


def relaxation(force: float) -> float:
    """Steps in a relaxation time of the slowest mode, overdamped: a taut string's between a held and a pulled end."""
    squared = force * PN / BOND * (math.pi / 2 / SEGMENTS) ** 2 + BENDING * PN / BOND**2 * (math.pi / 2 / SEGMENTS) ** 4
    return FRICTION / squared / STEP


def needed(force: float) -> tuple[float, float, float]:
    """Steps until the error is met, the known bias, and the deviation from the exact answer that the run ended at."""
    from arviz_stats.base import array_stats

    arguments = {"segments": SEGMENTS, "bond_length": BOND, "bending": BENDING, "kT": dna.KT, "stretching": STRETCHING}
    exact = float(
        wlc.extension_exact(force, dna.PERSISTENCE, dna.CONTOUR, dna.KT, stretch_modulus=dna.MODULUS, finite=True)
    )
    discrete, up, down = (float(wlc.extension_discrete(f * force, **arguments)) for f in (1.0, 1.01, 0.99))
    bias = discrete / exact - 1
    if abs(bias) >= WANTED:
        return math.inf, bias, math.nan
    spread = math.sqrt(dna.KT * (up - down) / (0.02 * force)) / exact
    context, slow = newcomer(force, "Reference"), relaxation(force)
    stride = max(1, round(slow / SAMPLES))
    context.getIntegrator().step(round(WARM_UP * slow))
    series = np.empty(RELAXATIONS * SAMPLES)
    for i in range(len(series)):
        context.getIntegrator().step(stride)
        series[i] = context.getState(positions=True).getPositions(asNumpy=True)[-1, 2]._value
    independent = float(array_stats.ess(series[None], chain_axis=0, draw_axis=1, method="mean"))
    samples = (2 * spread / (WANTED - abs(bias))) ** 2
    return WARM_UP * slow + samples * len(series) * stride / independent, bias, float(series.mean()) / exact - 1


def step_seconds(context: mm.Context) -> float:
    """Wall time of a step."""
    begun = time.perf_counter()
    context.getIntegrator().step(TIMED)
    context.getState(positions=True)
    return (time.perf_counter() - begun) / TIMED


def main() -> None:
    """Print one line a force and platform."""
    print(f"Newcomer: {SEGMENTS} segments, {1000 * STEP:g} fs, 1/ps; both to {100 * WANTED:g} %, one process.")
    for force in FORCES:
        steps, bias, ended = needed(float(force))
        own, plain = newcomer(float(force)), newcomer(float(force), "Reference")
        for context in (own, plain):
            step_seconds(context)
        rows, deviations = [], []
        for seed in range(ROUNDS):
            begun = time.perf_counter()
            found = of.force_extension(
                dna.chain(),
                [force] * unit.piconewton,
                dna.TEMPERATURE * unit.kelvin,
                WANTED,
                seed=1 + seed,
                processes=1,
            )
            here = time.perf_counter() - begun
            exact = wlc.extension_exact(
                force, dna.PERSISTENCE, dna.CONTOUR, dna.KT, stretch_modulus=dna.MODULUS, finite=True
            )
            deviations.append(abs(float(found.extension[0]) / exact - 1))
            rows.append((here, steps * step_seconds(own), steps * step_seconds(plain)))
        mine = median(row[0] for row in rows)
        print(
            f"{force:.3g} pN: newcomer's bias {100 * bias:+.2f} %, mean of its run {100 * ended:+.2f} %; {steps:.2g} steps. The "
            f"sampler takes {mine:.2g} s and is off by at most {100 * max(deviations):.2f} %."
        )
        for column, context in ((1, own), (2, plain)):
            ratios = sorted(row[column] / row[0] for row in rows)
            print(
                f"  on {context.getPlatform().getName()}: {median(row[column] for row in rows):.3g} s, "
                f"{median(ratios):.3g} times as long ({ratios[0]:.3g} to {ratios[-1]:.3g})",
                flush=True,
            )


if __name__ == "__main__":
    main()
