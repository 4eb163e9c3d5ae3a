"""Vibrations: the error of the lines of a simulated motion, as a part of them, the worst of several.

The motion of each mode is followed by itself: bead positions are projected on its exact shape, and one sinusoid is
fitted to the projection. That takes a few periods of motion and is not part of the wall time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament.analysis import damped_sinusoids
from systems import stage
from systems.error_vs_runtime.integrators import made, opened
from systems.error_vs_runtime.settings import Result, Setting
from systems.mass_spring.chain import leapfrog

__all__ = ["Scene", "measure", "play"]

Array = NDArray[np.float64]

_SAMPLES = 8.0
"""Samples in a period of the highest line."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A chain that swings.

    Attributes
    ----------
    build : callable
        Makes the model of a setting.
    begin : callable
        Sets the chain in motion: moves beads or gives them velocities.
    lines : callable
        Of a setting: the lines (K,) in Hz that its motion is near, those that it ought to have, and what projects the
        coordinate `axis` (N,) on their shapes, (K, N), or all of them, (K, N, 3).
    seconds, skip : float
        Length of the motion that is fitted, and of the pluck before it.
    damping : float
        1/s, where the integrator knows it.
    """

    build: Callable[[Setting], of.Model]
    begin: Callable[[mm.Context, of.Model], None]
    lines: Callable[[Setting], tuple[Array, Array, Array]]
    seconds: float
    axis: int
    skip: float = 0.0
    damping: float = 0.0


def play(scene: Scene, setting: Setting, near: Array, shapes: Array) -> tuple[Array, float, float, float]:
    """Build and run: the motion (T, K) of the modes in nm, seconds between samples, the time step in s, and the wall time."""
    begun = time.perf_counter()
    model = scene.build(setting)
    timestep = setting.step * of.stable_timestep(model).value_in_unit(unit.second)
    integrator = made(setting.integrator, model, timestep, scene.damping)
    context = opened(model, integrator, setting.platform, setting.precision)
    scene.begin(context, model)
    every = max(1, int(1 / (_SAMPLES * near.max() * timestep)))
    samples = math.ceil((scene.skip + scene.seconds) / (every * timestep))
    flat = shapes.reshape(len(shapes), -1)

    def project(x: Array) -> Array:
        return np.asarray(flat @ (x[:, scene.axis] if shapes.ndim == 2 else x.ravel()))

    motion = of.record(model, context, samples, every, observe=project)
    wall = time.perf_counter() - begun
    after = stage.seconds(motion) > scene.skip + timestep / 2 if scene.skip else slice(None)
    return motion.values[after], every * timestep, timestep, wall


def measure(scene: Scene, setting: Setting, seed: int) -> Result:
    """The largest relative error of a line, and the wall time. Nothing is random."""
    del seed
    near, exact, shapes = scene.lines(setting)
    motion, interval, timestep, wall = play(scene, setting, near, shapes)
    if not np.isfinite(motion).all():
        raise FloatingPointError("The motion diverged.")
    guesses = near if setting.integrator == "PEFRL" else leapfrog(near, timestep)
    damped = scene.damping > 0 and setting.integrator in {"Euler-Cromer", "LangevinMiddle"}
    found = np.array(
        [
            damped_sinusoids(column, interval, [guess], damped=damped).frequencies[0]
            for column, guess in zip(motion.T, guesses, strict=True)
        ]
    )
    return Result(wall, np.array([np.abs(found / exact - 1).max()]))
