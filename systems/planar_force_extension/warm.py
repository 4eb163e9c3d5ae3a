"""Which temperatures and forces are sampled, and how well worm-like chains fit the exact curves at any temperature."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

import openmm_filament as of
from openmm_filament.blocks import clamped_model
from openmm_filament.discretisation import PN
from systems.planar_force_extension import chain, cold, fits
from systems.planar_force_extension.hot import LENGTH, Job

__all__ = [
    "FROZEN",
    "HEATS",
    "LOST",
    "SOFTER",
    "Level",
    "at_ease",
    "exact",
    "forces",
    "jobs",
    "kind",
    "levels",
    "model",
    "sides",
    "stretch",
]

Array = NDArray[np.float64]

SOFTER = 100.0
"""`k l0^2` over the larger of alpha and k_B T in the runs; the wire's is 40000 alpha. The exact answer is for what is run."""

HEATS = (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0)
"""`k_B T/alpha` at which joints bend either way."""

_FREE_FORCES = {1e-3: (0.001, 0.002, 0.003, 0.005), 1e-2: (0.01, 0.03, 0.1, 0.3)}
"""Forces in alpha/l0 there: larger ones hold the joints of so cold a chain on their sides."""

_OTHER_FORCES = (0.1, 0.3, 1.0, 2.0)
"""The same at the other temperatures, over the larger of alpha and k_B T, times l0."""

FROZEN, _FROZEN_FORCES = 1e-3, (0.01, 0.02, 0.05, 0.3)
"""The temperature at which joints are also run frozen on their sides, as in the cold chain, and the forces there."""

LOST = 0.3
"""Force in alpha/l0 at that temperature, joints free, above which the exact sums are wrong for weights that underflow."""

CLEAR = 5.0
"""Standard deviations of a bend by which it must be clear of zero and of pi in the cold chain to count as frozen."""


def jobs(*, seed: int, quick: bool) -> list[Job]:
    """What is run: free joints at every temperature, and frozen ones on the shapes of the cold chain."""
    samples, every = (60, 2) if quick else (300, 1)
    seeds = iter((np.random.SeedSequence(seed).generate_state(64) % (2**31 - 2) + 1).tolist())
    out = [
        Job(heat, SOFTER * at_ease(heat), force * at_ease(heat), samples, next(seeds))
        for heat in HEATS
        for force in _FREE_FORCES.get(heat, _OTHER_FORCES)[::every]
    ]
    pulls = _FROZEN_FORCES[1::2] if quick else _FROZEN_FORCES
    for force, shape in zip(pulls, cold.shapes_at(pulls), strict=True):
        out.append(Job(FROZEN, SOFTER, force, samples, next(seeds), sides(shape, FROZEN), shape))
    return out


def sides(shape: Array, heat: float) -> tuple[float, ...]:
    """The sides of the joints of a shape (31, 3), 0 for those that noise turns over."""
    bends = chain.signed_bends(shape)
    clear = np.minimum(np.abs(bends), np.pi - np.abs(bends)) > CLEAR * np.sqrt(heat)
    return tuple((clear * np.sign(bends)).tolist())


def kind(job: Job) -> str:
    """How the joints are in a run: "free", or "frozen" but for those that noise turns over."""
    return "frozen" if any(job.sides) else "free"


@cache
def _exact(heat: float, ratio: float, sides: tuple[float, ...], force: float) -> float:
    return float(chain.Reduced(heat, ratio, sides=sides).exact(np.array([force]))[0])


def exact(job: Job) -> float:
    """The exact extension over contour of what was run."""
    return _exact(job.heat, job.ratio, job.sides, job.force)


def stretch(job: Job) -> float:
    """The length of a bond along the force over l0, of the chain that was run."""
    return 1 + job.force / job.ratio


def model(job: Job) -> of.Model:
    """One of the chains of a job."""
    pull = job.force * chain.KT / job.heat / LENGTH * PN
    return clamped_model(chain.scaled_filament(job.heat, job.ratio), pull, 2, 1)


def forces(count: int = 25) -> Array:
    """Forces of the fits, over the larger of alpha and k_B T, times l0: four decades, as in the thesis for 1000 GPa."""
    return np.geomspace(1e-3, 10.0, count)


@dataclass(frozen=True, eq=False)
class Level:
    """A chain at one temperature (0 for the cold one): its exact curve, without stretch, and the fits to it.

    `name` is "bent" or "straight" with joints free, "frozen" for the bends of the cold chain; forces are in alpha/l0.
    """

    name: str
    heat: float
    force: Array
    extension: Array
    fits: dict[str, fits.Fit]


def at_ease(heat: float) -> float:
    """The larger of alpha and k_B T in alpha."""
    return max(1.0, heat)


def levels(*, quick: bool) -> list[Level]:
    """The curves and their fits at all temperatures at which the exact sums can be made, the cold one first."""
    f = forces(9 if quick else 25)
    unit_force = chain.rigidities(chain.YOUNG[-1])[1] / chain.STEP
    found = cold.pulled(chain.YOUNG[-1], f * unit_force)
    out = [_level("frozen", 0.0, f, np.array([point.extension / chain.CONTOUR for point in found.points]))]
    heats = np.geomspace(1e-2, 100.0, 9 if quick else 17)
    for heat in heats.tolist():
        applied = f * at_ease(heat)
        kinds = {"bent": chain.Reduced(heat), "straight": chain.Reduced(heat, bent=False)}
        if heat < 0.9:
            kinds["frozen"] = chain.Reduced(heat, sides=chain.FROZEN)
        for name, reduced in kinds.items():
            curve = reduced.exact(applied)
            if not np.isnan(curve).any():
                out.append(_level(name, heat, applied, curve))
    return out


def _level(name: str, heat: float, force: Array, curve: Array) -> Level:
    """Stretch is taken out to first order, so that what is left to the fits is the shape of the chain."""
    bare = curve / (1 + force / chain.STIFFNESS_RATIO)
    return Level(name, heat, force, bare, {form: fits.fitted(force, bare, form) for form in fits.FORMS})
