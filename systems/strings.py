"""The guitar string of the thesis (2.3.1), plain or loaded: its model, its exact lines, and how it is played.

200 moving beads between two held ones, along z; x and y are the two directions of transverse motion. The ends are
hinged: no angle is measured at a held bead. `Euler-Cromer` damps the velocity at the rate gamma, an amplitude therefore
at gamma/2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import openmm as mm
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament.motion import Motion
from systems import stage

__all__ = [
    "DAMPING",
    "DENSITY",
    "EVERY",
    "LENGTH",
    "PLUCKING",
    "RADIUS",
    "RATE",
    "SOFTER",
    "TENSION",
    "YOUNG",
    "Line",
    "Pluck",
    "beats",
    "discrete_law",
    "released",
    "start",
    "stiff_law",
    "string",
]

Array = NDArray[np.float64]

LENGTH, RADIUS, YOUNG, DENSITY = 0.710, 0.25e-3, 190e9, 1.55e-3  # m, m, Pa, kg/m
TENSION, DAMPING, PLUCKING = 20.0, 3.0, 1 / 300  # N, 1/s, s

BENDING = YOUNG * math.pi * RADIUS**4 / 4
"""E I in N m^2."""

SOFTER = 64.0
"""What the bonds' stiffness is divided by where motion is small: transverse lines depend on the tension alone."""

RATE, EVERY = 48_000, 5
"""Samples a second, and steps between two: line 20 then stands 0.9e-4 too high, by the square of the time step."""


@dataclass(frozen=True)
class Pluck:
    """A force in N on one bead, in the direction x (0) or y (1), for 1/300 s."""

    bead: int
    force: float
    direction: int = 0

    def load(self) -> of.loads.Pluck:
        """The same as a load."""
        vector = np.zeros(3)
        vector[self.direction] = self.force
        return of.loads.Pluck(self.bead, vector * unit.newton, PLUCKING * unit.second)


def string(
    segments: int,
    plucks: Sequence[Pluck] = (),
    *,
    tension: float = TENSION,
    damping: float | Array | None = DAMPING,
    heavy: dict[int, float] | None = None,
    softer: float = SOFTER,
    form: Literal["arccosine", "arctangent"] = "arccosine",
) -> of.Model:
    """The string in so many segments, with its ends held.

    Parameters
    ----------
    tension : float
        N.
    damping : float or (segments + 1,) array
        1/s.
    heavy : dict of int to float
        What the masses of single beads are multiplied by.
    softer : float
        What the bonds' stiffness is divided by, at the same tension.
    form : "arccosine" or "arctangent"
        Of `of.bending.Harmonic`.
    """
    masses = np.full(segments + 1, DENSITY * LENGTH / segments)
    for bead, factor in (heavy or {}).items():
        masses[bead] *= factor
    filament = stage.wire(
        segments,
        length=LENGTH,
        radius=RADIUS,
        youngs_modulus=YOUNG,
        line_density=DENSITY,
        damping=damping,
        masses=masses,
        softer=softer,
        form=form,
    )
    held = [of.loads.Hold([0, -1]), of.loads.Tension(tension * unit.newton)]
    return of.build(filament, loads=[*held, *(pluck.load() for pluck in plucks)])


def start(model: of.Model, rate: float, every: int, *, alike: bool = False) -> mm.Context:
    """A Context at rest, to be run by Euler-Cromer with `every` steps between two of `rate` samples a second.

    It runs on Reference: positions are read often.

    Parameters
    ----------
    alike : bool
        Whether all beads are damped alike, at 3/s: `stage.alike` then halves the time, with forces 6 millionths less at a
        step of 4 us.

    Raises ValueError if the time step, `1/(rate every)`, is above the stability limit.
    """
    timestep = 1 / (rate * every)
    if alike:
        return stage.context(model, stage.alike(model, timestep, DAMPING), "Reference")
    return stage.context(model, of.euler_cromer(model, timestep=timestep * unit.second), "Reference")


def released(motion: Motion) -> NDArray[np.bool_]:
    """Which samples (T,) of a motion come after the pluck."""
    return stage.seconds(motion) > PLUCKING * (1 + 1e-6)


def stiff_law(n: Any, tension: float = TENSION) -> Array:
    """Lines in Hz of the continuous stiff string with hinged ends (2.11), `n f1 sqrt(1 + pi^2 n^2 E I/(T L^2))`."""
    number = np.asarray(n, dtype=float)
    flexible = number / (2 * LENGTH) * math.sqrt(tension / DENSITY)
    return np.asarray(flexible * np.sqrt(1 + (np.pi * number / LENGTH) ** 2 * BENDING / tension))


def discrete_law(n: Any, segments: int, tension: float = TENSION) -> Array:
    """Lines in Hz of the string of beads, exact for small undamped motion.

    `omega^2 = (4 T/(m a)) sin^2(q a/2) + (16 K/(m a^2)) sin^4(q a/2)` with `q = n pi/L`, `a = L/segments`, `K = E I/a`.
    """
    a = LENGTH / segments
    mass, stiffness = DENSITY * a, BENDING / a
    sine = np.sin(np.asarray(n, dtype=float) * np.pi / (2 * segments))
    squared = 4 * tension / (mass * a) * sine**2 + 16 * stiffness / (mass * a**2) * sine**4
    return np.asarray(np.sqrt(squared) / (2 * np.pi))


@dataclass(frozen=True, eq=False)
class Line:
    """What a mode of frequency f shows when all beads are damped alike: (K,) arrays in Hz and 1/s."""

    frequencies: Array
    decay_rates: Array


def beats(frequencies: Array, damping: float, timestep: float | None = None) -> Line:
    """Lines of damped oscillators of these undamped frequencies (K,) in Hz.

    In continuous time `f_d = sqrt(f^2 - (gamma/4 pi)^2)` and `d = gamma/2`. With a time step in s, what Euler-Cromer shows:
    the roots of `z^2 - (2 - gamma dt - (omega dt)^2) z + 1 - gamma dt`.
    """
    if timestep is None:
        seen = np.sqrt(frequencies**2 - (damping / (4 * np.pi)) ** 2)
        return Line(seen, np.full_like(frequencies, damping / 2))
    keep = 1 - damping * timestep
    angle = np.arccos((1 + keep - (2 * np.pi * frequencies * timestep) ** 2) / (2 * math.sqrt(keep)))
    return Line(
        angle / (2 * np.pi * timestep), np.full_like(frequencies, -math.log1p(-damping * timestep) / (2 * timestep))
    )
