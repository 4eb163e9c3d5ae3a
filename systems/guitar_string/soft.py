"""The pluck of 0.01 N: small motion, whose lines and decay have exact answers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import openmm_filament as of
from openmm_filament import analysis
from systems import stage, strings
from systems.strings import Pluck

__all__ = ["BEADS", "FORCES", "HARMONICS", "Harmonics", "Recording", "harmonics", "record", "softness"]

Array = NDArray[np.float64]

SEGMENTS = 201
HARMONICS = 20
BEADS = (50, 10)
"""Plucked beads: the nearest to L/4 (at 0.2488 L) moves in x, bead 10 in y; small motion in x does not feel that in y."""
FORCES = (0.01, 0.04)
"""N. Bead 10, nearer to the end, is not lifted as far: with 0.04 N even line 20, near a node of both, stands out of the
rounding of nearly straight angles."""


_FITTED = 0.7
"""Seconds that are fitted at most, about the decay time: a weak line sinks into rounding afterwards."""


@dataclass(frozen=True, eq=False)
class Recording:
    """What was kept of a run.

    Attributes
    ----------
    rate : float
        Samples a second.
    beads : (T', 202, 2) array
        x and y of all beads in m, from the start.
    modes : (T, HARMONICS, 2) array
        Motion of the harmonics, `2/201 sum_j x_j sin(n pi j/201)`, in m, from the start.
    sums : (T, 2) array
        Mean of the beads' displacements in m, from the start.
    played : int
        Index of the first sample after the pluck.
    wall_seconds, processor_seconds : float
        Wall and processor time of a second of motion, recording included.
    timestep : float
        s.
    """

    model: of.Model
    rate: float
    beads: Array
    modes: Array
    sums: Array
    played: int
    wall_seconds: float
    processor_seconds: float
    timestep: float


def _plucks() -> list[Pluck]:
    return [Pluck(bead, force, i) for i, (bead, force) in enumerate(zip(BEADS, FORCES, strict=True))]


def sines(segments: int, count: int) -> Array:
    """Shapes of the harmonics 1 to `count` at all beads, (count, segments + 1)."""
    n, bead = np.arange(1, count + 1)[:, None], np.arange(segments + 1)
    return np.sin(np.pi * n * bead / segments)


def record(duration: float, kept: float, progress: Callable[[float], None] | None = None) -> Recording:
    """Pluck and run for `duration` s; every bead is kept for the first `kept` s, then sums and harmonics alone."""
    model = strings.string(SEGMENTS, _plucks())
    context = strings.start(model, strings.RATE, strings.EVERY, alike=True)
    # the mean over beads first, then one row a harmonic
    shapes = np.vstack([np.full(SEGMENTS + 1, 1 / (SEGMENTS - 1)), 2 / SEGMENTS * sines(SEGMENTS, HARMONICS)])
    begun, spent = time.perf_counter(), time.process_time()
    first = of.record(
        model, context, round(kept * strings.RATE), strings.EVERY, observe=lambda x: x[:, :2].astype(np.float32)
    )
    beads = stage.metres(first.values)
    seen = np.einsum("kj,tjd->tkd", shapes, beads)
    if duration > kept:
        more = round((duration - kept) * strings.RATE)
        rest = of.record(model, context, more, strings.EVERY, observe=lambda x: shapes @ x[:, :2], progress=progress)
        seen = np.concatenate([seen, stage.metres(rest.values)[1:]])
    wall, spent = (time.perf_counter() - begun) / duration, (time.process_time() - spent) / duration
    played = int(np.argmax(strings.released(first)))
    return Recording(
        model, strings.RATE, beads, seen[:, 1:], seen[:, 0], played, wall, spent, 1 / (strings.RATE * strings.EVERY)
    )


@dataclass(frozen=True, eq=False)
class Harmonics:
    """Harmonics as simulated, (HARMONICS,) arrays unless said otherwise.

    Attributes
    ----------
    frequencies, frequency_errors : (HARMONICS, 2) arrays
        Hz, of the motion after each pluck, and one standard error.
    decay_times : (HARMONICS, 2) array
        s, of the amplitude.
    amplitudes : (HARMONICS, 2) array
        m, at the moment of release.
    """

    frequencies: Array
    frequency_errors: Array
    decay_times: Array
    amplitudes: Array

    def better(self, values: Array) -> Array:
        """Of values (HARMONICS, 2), those after the pluck that tells the harmonic's frequency better."""
        return np.take_along_axis(values, self.frequency_errors.argmin(axis=1)[:, None], 1)[:, 0]


def harmonics(recording: Recording) -> Harmonics:
    """Each harmonic's motion after the pluck, fitted by one decaying sinusoid."""
    interval = 1 / recording.rate
    late = recording.played * interval - strings.PLUCKING
    fits = [
        [
            analysis.damped_sinusoids(signal, interval, analysis.lines(signal, interval, count=1).frequencies)
            for signal in recording.modes[recording.played :, n][: round(_FITTED * recording.rate)].T
        ]
        for n in range(HARMONICS)
    ]

    def table(value: Callable[[analysis.DampedSinusoids], float]) -> Array:
        return np.array([[value(fit) for fit in pair] for pair in fits])

    return Harmonics(
        table(lambda fit: float(fit.frequencies[0])),
        table(lambda fit: float(fit.frequency_errors[0])),
        table(lambda fit: 1 / float(fit.decay_rates[0])),
        table(lambda fit: float(abs(fit.amplitudes[0]) * np.exp(fit.decay_rates[0] * late))),
    )


def amplitudes(frequencies: Array) -> Array:
    """Exact amplitudes (HARMONICS, 2) in m at the moment of release, for undamped `frequencies` (HARMONICS,) in Hz.

    A constant force on bead j for the time t leaves `m q'' + gamma m q' + k q = 2/N F sin(n pi j/N)` with the state that
    this starts from rest and that then rings freely.
    """
    omega = 2 * np.pi * frequencies
    half = strings.DAMPING / 2
    damped = np.sqrt(omega**2 - half**2)
    mass = strings.DENSITY * strings.LENGTH / SEGMENTS
    decay = np.exp(-half * strings.PLUCKING)
    cosine, sine = np.cos(damped * strings.PLUCKING), np.sin(damped * strings.PLUCKING)
    place = 1 - decay * (cosine + half / damped * sine)
    speed = decay * omega**2 / damped * sine
    size = np.hypot(place, (speed + half * place) / damped)  # of the ringing that starts there, for a static lift of 1
    force = 2 / SEGMENTS * np.array(FORCES) * np.abs(sines(SEGMENTS, HARMONICS)[:, BEADS])
    return np.asarray(force / (mass * omega[:, None] ** 2) * size[:, None])


@dataclass(frozen=True)
class Softness:
    """What softer bonds change: the same pluck with the wire's own bonds.

    Attributes
    ----------
    seconds : float
        Length of both runs.
    difference : float
        Largest difference of a bead's displacement, over the largest displacement.
    wall_true, wall_soft : float
        Wall time of a second of motion.
    lines, true_lines : (200,) arrays
        Hz, transverse normal modes of the two models.
    """

    seconds: float
    difference: float
    wall_true: float
    wall_soft: float
    lines: Array
    true_lines: Array


def softness(recording: Recording, seconds: float) -> Softness:
    """Run the first `seconds` again with the true bonds, at eight times as many steps."""
    true = strings.string(SEGMENTS, _plucks(), softer=1.0)
    samples, every = round(seconds * recording.rate), 8 * strings.EVERY
    context = strings.start(true, recording.rate, every, alike=True)
    begun = time.perf_counter()
    motion = of.record(true, context, samples, every, observe=lambda x: x[:, :2])
    wall = (time.perf_counter() - begun) / seconds
    found, soft = stage.metres(motion.values), recording.beads[: samples + 1]
    return Softness(
        seconds,
        float(np.abs(found - soft).max() / np.abs(found).max()),
        wall,
        recording.wall_seconds,
        transverse(recording.model),
        transverse(true),
    )


def transverse(model: of.Model) -> Array:
    """Undamped frequencies in Hz of the modes that move across the string in x, in rising order, by `of.normal_modes`."""
    modes = of.normal_modes(model)
    power = np.sum(modes.shapes**2, axis=1)
    across = power[:, 2] < 0.5 * power.sum(axis=1)
    return np.asarray(modes.frequencies[across][::2])


def coarse_sound(seconds: float) -> tuple[int, Array, float]:
    """A short-cut to the sound for quick runs: the segments of a coarser string, the mean of its beads in m, and its rate."""
    segments, rate, every = 24, 6_000, 5
    context = strings.start(model := strings.string(segments, [Pluck(10, FORCES[0])]), rate, every)
    motion = of.record(model, context, round(seconds * rate), every, observe=lambda x: x[1:-1, 0].mean())
    return segments, stage.metres(motion.values)[strings.released(motion)], rate
