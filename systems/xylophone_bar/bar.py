"""The bar of the thesis (2.3.2), under tension and as played: its models, its exact lines, and a strike. SI units.

Under tension the ends are held and hinged: no angle is measured at a held bead. As played the ends are free and nothing
pulls; the end beads then have half the mass of the others, so that each mass stands for the material next to it and the
whole weighs mu L. That makes the error of the frequencies one of second order in the segment length; with whole masses at
the ends it is one of first order, 2.4 % with 80 segments.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from openmm import unit
from scipy import linalg

import openmm_filament as of
from openmm_filament import _checks as check
from openmm_filament.analysis import DampedSinusoids, damped_sinusoids, lines
from systems import stage

__all__ = [
    "BENDING",
    "BETA_L",
    "DENSITY",
    "LENGTH",
    "RADIUS",
    "TENSION",
    "YOUNG",
    "Ringing",
    "beam",
    "discrete_free",
    "discrete_tense",
    "fitted",
    "free",
    "modes",
    "ring_out",
    "set_velocities",
    "softness",
    "strike",
    "tense",
]

Array = NDArray[np.float64]

LENGTH, RADIUS, YOUNG, DENSITY = 0.5, 3e-3, 190e9, 1.55e-3  # m, m, Pa, kg/m (as printed; steel would weigh 0.22 kg/m)
TENSION = 17.7e3  # N

BENDING = YOUNG * math.pi * RADIUS**4 / 4
"""E I in N m^2."""

BETA_L = np.array([4.7300407, 7.8532046, 10.9956078, 14.1371655, 17.2787597])
"""Roots of cos x cosh x = 1, from which the frequencies of a free Euler-Bernoulli bar follow."""


@dataclass(frozen=True, eq=False)
class Ringing:
    """A bar that rings after a strike.

    Attributes
    ----------
    model : Model
    times : (T,) array
        s.
    interval : float
        s between samples.
    positions : (T, N, 3) array
        m.
    timestep : float
        s.
    """

    model: of.Model
    times: Array
    interval: float
    positions: Array
    timestep: float

    @property
    def transverse(self) -> Array:
        """Displacement (T, N) along x in m."""
        return self.positions[..., 0]


def softness(segments: int) -> float:
    """What the stretching stiffness is divided by, so that not it but bending limits the time step (1 from 150 segments up)."""
    return float(min(max(1.0, (150 / segments) ** 2), 30.0))


def tense(segments: int, tension: float = TENSION) -> of.Model:
    """The bar between held, hinged ends under `tension` in N."""
    filament = stage.wire(
        segments, length=LENGTH, radius=RADIUS, youngs_modulus=YOUNG, line_density=DENSITY, softer=softness(segments)
    )
    return of.build(filament, [of.loads.Hold([0, -1]), of.loads.Tension(tension * unit.newton)])


def free(
    segments: int, *, damping: float | None = None, form: Literal["arccosine", "arctangent"] = "arccosine"
) -> of.Model:
    """The bar as played: free ends with half masses, no tension; `damping` of every bead in 1/s, `form` of its bending."""
    filament = stage.wire(
        segments, length=LENGTH, radius=RADIUS, youngs_modulus=YOUNG, line_density=DENSITY, damping=damping,
        masses=_masses(segments), softer=softness(segments), form=form,
    )  # fmt: skip
    return of.build(filament)


def _masses(segments: int, ends: float = 0.5) -> Array:
    masses = np.full(segments + 1, DENSITY * LENGTH / segments)
    masses[[0, -1]] *= ends
    return masses


def discrete_tense(count: int, segments: int, tension: float = TENSION) -> Array:
    """The first lines (count,) in Hz of the chain under tension, exact.

    `omega^2 = (4 T/(m a)) sin^2(q a/2) + (16 K/(m a^2)) sin^4(q a/2)`, q = n pi/L, K = EI/a.
    """
    a = LENGTH / segments
    sine = np.sin(np.arange(1, count + 1) * np.pi / (2 * segments))
    mass = DENSITY * a
    squared = 4 * tension / (mass * a) * sine**2 + 16 * BENDING / (mass * a**3) * sine**4
    return np.asarray(np.sqrt(squared) / (2 * np.pi))


def discrete_free(count: int, segments: int, *, ends: float = 0.5) -> Array:
    """The first lines (count,) in Hz of the free chain, exact: `K D^T D u = omega^2 a^2 M u`, D second differences.

    `ends` is the mass of an end bead over that of the others.
    """
    a = LENGTH / segments
    second = np.zeros((segments - 1, segments + 1))
    for i in range(segments - 1):
        second[i, i : i + 3] = 1, -2, 1
    stiffness = BENDING / a**3 * second.T @ second
    squared = linalg.eigh(
        stiffness, np.diag(_masses(segments, ends)), eigvals_only=True, subset_by_index=(2, count + 1)
    )
    return np.asarray(np.sqrt(squared) / (2 * np.pi))


def beam() -> Array:
    """The first five lines in Hz of a free Euler-Bernoulli bar: `(beta L)^2 sqrt(EI/mu)/(2 pi L^2)`."""
    return BETA_L**2 * math.sqrt(BENDING / DENSITY) / (2 * math.pi * LENGTH**2)


def modes(model: of.Model, count: int) -> tuple[Array, Array]:
    """Frequencies (count,) in Hz and shapes (count, N) of the bending modes, rigid motions left out (`of.normal_modes`).

    Each comes twice, along x and y; a shape is the displacement in the plane of its mode, its largest value 1.
    """
    found = of.normal_modes(model)
    across = np.abs(found.shapes[..., 2]).max(axis=1) < 0.5
    moving = found.frequencies > 1e-4 * found.frequencies[across].max()
    chosen = np.flatnonzero(across & moving)[: 2 * count : 2]
    shapes = found.shapes[chosen]
    peak = np.abs(np.linalg.norm(shapes, axis=2)).argmax(axis=1)
    direction = np.take_along_axis(shapes, peak[:, None, None], axis=1)
    flat = np.sum(shapes * direction, axis=2)
    return found.frequencies[chosen], flat / np.abs(flat).max(axis=1, keepdims=True)


def strike(model: of.Model, place: float, *, rise: float, width: float = 0.07) -> Array:
    """Initial velocities (N,) along x in m/s: a Gaussian of `width` about `place`, both over L, at its middle about `rise`
    times the wave speed sqrt(EI/mu)/L of the bar. What sets a free bar in rigid motion is taken out.
    """
    filament = model.filaments[0]
    z = filament.rest.value_in_unit(unit.meter)[:, 2]
    blow = np.exp(-0.5 * ((z - place * LENGTH) / (width * LENGTH)) ** 2)
    if len(model.held):
        blow[model.held] = 0.0
    else:
        masses = model.masses
        rigid = np.stack([np.ones_like(z), z], axis=1)
        weighted = rigid * masses[:, None]
        blow -= rigid @ np.linalg.solve(rigid.T @ weighted, weighted.T @ blow)
    return np.asarray(rise * math.sqrt(BENDING / DENSITY) / LENGTH * blow)


def ring_out(
    model: of.Model, velocities: Array, duration: float, interval: float, *, lowest: float, step: float = 0.8
) -> Ringing:
    """Let a bar ring, undamped (`of.verlet`).

    Parameters
    ----------
    velocities : (N,) array
        At the start, along x, in m/s.
    duration, interval : float
        s, of the recording and between its samples.
    lowest : float
        Hz, the lowest line that the recording is to resolve.
    step : float
        Time step over the stability limit, at most.

    Raises
    ------
    ValueError
        If the recording holds fewer than four periods of the lowest line.
    """
    if duration * lowest < 4:
        raise check.fail("duration", f"hold four periods of {lowest:.6g} Hz, {4 / lowest:.4g} s", f"{duration:.4g} s")
    limit = of.stable_timestep(model).value_in_unit(unit.second)
    every = math.ceil(interval / (step * limit))
    timestep = interval / every
    context = stage.context(model, of.verlet(model, timestep=timestep * unit.second), "Reference")
    set_velocities(context, model, velocities)
    motion = of.record(model, context, round(duration / interval), every)
    return Ringing(model, stage.seconds(motion), interval, stage.metres(motion.values), timestep)


def set_velocities(context: object, model: of.Model, velocities: Array) -> None:
    """Velocities (N,) along x in m/s of the beads of a Context."""
    full = np.zeros((len(velocities), 3))
    full[:, 0] = velocities
    context.setVelocities(model.to_internal(full * unit.meter / unit.second))  # type: ignore[attr-defined]


def fitted(signal: Array, interval: float, near: Sequence[float] | Array) -> DampedSinusoids:
    """Undamped lines of a signal (T, N) about the frequencies `near` in Hz."""
    guesses = lines(signal, interval, near=near).frequencies
    return damped_sinusoids(signal, interval, guesses, damped=False)
