"""Which temperatures and forces are sampled, and how well worm-like chains fit the exact curves at any temperature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import openmm_filament as of
from openmm_filament.blocks import clamped_model
from systems.planar_force_extension import chain, cold, fits
from systems.planar_force_extension.hot import Job

__all__ = ["FLEXIBLE", "SOFTER", "Level", "at_ease", "exact", "forces", "jobs", "kind", "levels", "model", "stretch"]

Array = NDArray[np.float64]

SOFTER = 100.0
"""`k l0^2` over the larger of alpha and k_B T in the runs; the wire's is 40000 alpha. The exact answer is for what is run."""

FREE = (0.1, 1.0, 10.0, 100.0)
"""`k_B T/alpha` at which joints bend either way."""

FROZEN, STUCK = 1e-3, 1e-2
"""The same at which small loads turn no joint over, and at which dynamics turns joints too seldom to be sampled."""

LOADED = 0.1
"""The load in alpha/l0 of the stuck runs."""

FLEXIBLE = 0.1
"""Rest angle in rad below which a joint has no barrier to speak of, 5 k_B T at the lowest temperature."""


def jobs(*, seed: int, quick: bool) -> list[Job]:
    """What is run: free joints, frozen ones at small loads, and two runs that show where joints are stuck."""
    effort = 3e5 if quick else 5e6
    seeds = iter((np.random.SeedSequence(seed).generate_state(64) % (2**31 - 2) + 1).tolist())
    out = [
        Job(heat, SOFTER * at_ease(heat), force * at_ease(heat), effort, next(seeds))
        for heat in FREE
        for force in (0.1, 0.3, 1.0, 3.0)
    ]
    small = (0.01, 0.015, 0.02)
    for force, shape in zip((*small, LOADED), cold.shapes_at((*small, LOADED)), strict=True):
        out.append(Job(FROZEN, SOFTER, force, effort, next(seeds), start=shape, moves=False))
    out.append(Job(STUCK, SOFTER, LOADED, effort, next(seeds), moves=False))
    return out


def kind(job: Job) -> str:
    """How the joints are in a run: "free", "frozen", or "stuck" between the two."""
    if job.moves:
        return "free"
    return "frozen" if job.start is not None and job.force < LOADED else "stuck"


def exact(job: Job) -> float:
    """The exact extension over contour of what was run; for stuck runs that of free joints, which they do not reach."""
    flip: bool | tuple[bool, ...] = True
    if kind(job) == "frozen":
        flip = tuple((np.abs(chain.BENDS) < FLEXIBLE).tolist())
    return float(chain.Reduced(job.heat, job.ratio, flip=flip).exact(np.array([job.force]))[0])


def stretch(job: Job) -> float:
    """The length of a bond along the force over l0, of the chain that was run."""
    return 1 + job.force / job.ratio


def model() -> of.Model:
    """One of the chains that were run hot."""
    return clamped_model(chain.scaled_filament(1.0, SOFTER), 1.0, 2, 1)


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
    f = forces(13 if quick else 25)
    unit_force = chain.rigidities(chain.YOUNG[-1])[1] / chain.STEP
    found = cold.pulled(chain.YOUNG[-1], f * unit_force)
    out = [_level("frozen", 0.0, f, np.array([point.extension / chain.CONTOUR for point in found.points]))]
    heats = np.geomspace(1e-2, 100.0, 9 if quick else 17)
    for heat in heats.tolist():
        applied = f * at_ease(heat)
        kinds = {"bent": chain.Reduced(heat), "straight": chain.Reduced(heat, bent=False)}
        if heat < 0.9:
            kinds["frozen"] = chain.Reduced(heat, flip=False)
        for name, reduced in kinds.items():
            curve = reduced.exact(applied)
            if not np.isnan(curve).any():
                out.append(_level(name, heat, applied, curve))
    return out


def _level(name: str, heat: float, force: Array, curve: Array) -> Level:
    """Stretch is taken out to first order, so that what is left to the fits is the shape of the chain."""
    bare = curve / (1 + force / chain.STIFFNESS_RATIO)
    return Level(name, heat, force, bare, {form: fits.fitted(force, bare, form) for form in fits.FORMS})
