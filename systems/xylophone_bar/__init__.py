"""A bar: the thesis's, under tension between held ends (2.3.2), and as it is played, with free ends and no tension.

Struck at one place, undamped, its lines are those of the exact discrete chain; the free bar's converge to those of Euler
and Bernoulli. A coarser bar with light damping rings for two seconds and is heard.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from openmm import unit

import openmm_filament as of
from openmm_filament.sound import strongest_line, write_wav
from systems import stage
from systems.scene import Check, Summary
from systems.xylophone_bar import bar, energy, figures, judgement

__all__ = ["STEP", "options", "run"]

Array = NDArray[np.float64]

FULL, QUICK = {"tense": 201, "free": 199}, {"tense": 60, "free": 60}
"""Segments of the bars whose lines are read: 200 beads that move, or with `--quick` fewer."""

STEP = 0.8
"""Time step over the stability limit, at most: the fifth line of 60 segments is then 4e-5 high."""

COARSE, COARSE_QUICK = (30, 60, 120), (30, 45, 60)
"""Segments of the free bars from which its lines are extrapolated."""

COARSE_STEP = 0.25
"""Their time step over the limit: fewer segments have a longer one, and to extrapolate makes errors up to three times larger."""

DURATION, INTERVAL = 5e-3, 2.5e-6
"""Length of a recording and time between its samples, in s."""

LINES = 12
"""Lines of a fit; the first five are asked for."""

PLACES, RISES = {"tense": 0.27, "free": 0.24}, {"tense": 0.01, "free": 0.03}
"""Where a bar is struck, over L, off the nodes of its first modes, and how hard (see `strike`): the held bar is the stiffer the
further it moves."""

SOUND_DAMPING, SOUND_SECONDS = 8.0, 2.0
"""1/s and s of the bar that is heard."""

SOUND = {True: (12, 44_100, 0.2), False: (40, 88_200, 0.1)}
"""Segments of that bar, samples of its motion a second, and width of the mallet over L, quick or not. Above what those samples
resolve the mallet excites nothing that would be heard folded back: at most 9e-5 of the strongest line."""

GOLDEN = (math.sqrt(5) - 1) / 2
"""Multiples of it, modulo 1, are places that no mode has all its nodes at."""


def options(group: argparse._ArgumentGroup) -> None:
    """The system has no options of its own."""


def struck(kind: str, segments: int, *, tension: float = bar.TENSION, step: float = STEP) -> judgement.Struck:
    """Strike a bar and read its lines; `step` is the time step over the stability limit, at most."""
    model = bar.tense(segments, tension) if kind == "tense" else bar.free(segments)
    near = bar.discrete_tense(LINES, segments, tension) if kind == "tense" else bar.discrete_free(LINES, segments)
    velocities = bar.strike(model, PLACES[kind], rise=RISES[kind])
    ring = bar.ring_out(model, velocities, DURATION, INTERVAL, lowest=near[0], step=step)
    x = ring.transverse
    columns = np.unique((np.arange(1, 14) * GOLDEN % 1 * x.shape[1]).astype(int))
    fit = bar.fitted(x[:, columns], INTERVAL, near)
    waves = np.exp(2j * np.pi * fit.frequencies * (ring.times - ring.times[0])[:, None])
    table = np.concatenate([waves.real, waves.imag, np.ones((len(x), 1))], axis=1)
    amplitudes = np.linalg.lstsq(table, x, rcond=None)[0]
    cosines, sines = amplitudes[:LINES], amplitudes[LINES : 2 * LINES]
    shapes = np.array([_principal(c, s) for c, s in zip(cosines, sines, strict=True)])
    return judgement.Struck(ring, fit.frequencies, fit.frequency_errors, shapes)


def _principal(cosine: Array, sine: Array) -> Array:
    """The shape (N,) of an undamped mode: its beads move in phase; the largest displacement is 1."""
    _, _, rows = np.linalg.svd(np.stack([cosine, sine]), full_matrices=False)
    shape = rows[0]
    return np.asarray(shape / shape[np.abs(shape).argmax()])


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Run both bars, write the results into `folder`; 1 if an exact check fails, else 0. Nothing is random: no seed."""
    begun = time.perf_counter()
    segments = QUICK if quick else FULL
    with stage.progress("striking bars") as report:
        bars = {}
        for i, kind in enumerate(("tense", "free")):
            bars[kind] = struck(kind, segments[kind])
            report(0.2 * (i + 1))
        coarse = {n: struck("free", n, step=COARSE_STEP) for n in (COARSE_QUICK if quick else COARSE)}
        report(0.6)
        other = struck("tense", QUICK["tense"], tension=judgement.OTHER_TENSION)
        steady = energy.steadiness(32 if quick else 60, 50_000 if quick else 200_000)
        report(0.7)
        heard, pitch = _sound(folder / "xylophone_bar.wav", *SOUND[quick])
        report(1.0)
    exact = {"tense": bar.discrete_tense(LINES, segments["tense"]), "free": bar.discrete_free(LINES, segments["free"])}
    hessian = {kind: bar.modes(one.ring.model, LINES) for kind, one in bars.items()}
    limit = _extrapolated({n: one.frequencies[:5] for n, one in coarse.items()})
    checks = [
        *judgement.line_checks(bars, exact, hessian),
        *judgement.beam_checks({n: one.frequencies[:5] for n, one in coarse.items()}, limit),
        *judgement.third_checks(bars["tense"].frequencies, other.frequencies, segments["tense"], QUICK["tense"]),
        energy.check(steady),
        Check(
            f"strongest line of the WAV file, of {SOUND[quick][0]} segments", "exact", heard, pitch, abs(heard / pitch - 1),
            judgement.TOLERANCE, "Hz",
        ),
    ]  # fmt: skip
    figures.frequencies(folder / "frequencies.png", {k: one.frequencies for k, one in bars.items()}, exact)
    drawn = {k: one.shapes[:5] for k, one in bars.items()}
    figures.shapes(folder / "shapes.png", drawn, {k: judgement.aligned(hessian[k][1][:5], drawn[k]) for k in bars})
    figures.spectra(folder / "spectrum.png", {k: one.ring for k, one in bars.items()}, exact)
    figures.convergence(folder / "convergence.png", {n: one.frequencies[:5] for n, one in coarse.items()}, limit)
    _table(folder / "lines.csv", bars, exact, hessian)
    for kind, one in bars.items():
        name = "trajectory.dcd" if kind == "free" else "trajectory_tense.dcd"
        frames = slice(0, 640, 4)
        stage.write_trajectory(folder / name, one.ring.model, one.ring.times[frames], 1e9 * one.ring.positions[frames])
    findings = [
        *judgement.findings(bars, exact, other, limit, heard, pitch),
        *energy.findings(steady),
        *_pictures(folder, bars["free"], quick=quick),
    ]
    summary = Summary(
        system="xylophone_bar",
        models=[*(one.ring.model for one in bars.values()), steady.model],
        platform="Reference",
        wall_seconds=time.perf_counter() - begun,
        filament={
            "segments_under_tension": segments["tense"], "segments_free": segments["free"],
            "length_m": bar.LENGTH, "radius_m": bar.RADIUS, "youngs_modulus_Pa": bar.YOUNG,
            "line_density_kg_per_m": bar.DENSITY, "tension_N": bar.TENSION, "end_mass_of_free_bar_over_bead_mass": 0.5,
            "timestep_s": bars["free"].ring.timestep, "bending_form": "harmonic", "stretching_form": "harmonic",
            "stretching_softer_by": bar.softness(segments["free"]), "sound_segments": SOUND[quick][0],
            "sound_damping_per_s": SOUND_DAMPING,
        },
        checks=checks,
        findings=findings,
    )  # fmt: skip
    return stage.close(folder, summary)


def _sound(path: Path, segments: int, rate: int, mallet: float) -> tuple[float, float]:
    """Strongest line of the file that is written, and the fundamental of the bar that was run, both in Hz.

    The motion is that of an end, where every mode of a free bar is large; the sum over the beads, weighed by their masses,
    does not move.
    """
    model = bar.free(segments, damping=SOUND_DAMPING)
    limit = of.stable_timestep(model).value_in_unit(unit.second)
    every = math.ceil(1 / rate / (0.85 * limit))
    context = stage.context(model, stage.alike(model, 1 / rate / every, SOUND_DAMPING), "Reference")
    bar.set_velocities(context, model, bar.strike(model, 0.4, rise=0.1, width=mallet))
    motion = of.record(model, context, round(SOUND_SECONDS * rate), every, observe=lambda x: x[0, 0])
    write_wav(path, motion.values, 1 / rate * unit.second, seconds=SOUND_SECONDS)
    undamped = float(bar.modes(model, 1)[0][0])
    return strongest_line(path), math.sqrt(undamped**2 - (SOUND_DAMPING / (4 * math.pi)) ** 2)


def _extrapolated(values: Mapping[int, Array]) -> Array:
    """The limit of many segments: the polynomial in 1/N^2 through all the values (5,), at zero."""
    squared = np.array([n**-2.0 for n in values])
    weights = [np.prod([b / (b - a) for b in squared if b != a]) for a in squared]
    return np.asarray(np.dot(weights, list(values.values())))


def _table(
    path: Path,
    bars: Mapping[str, judgement.Struck],
    exact: Mapping[str, Array],
    hessian: Mapping[str, tuple[Array, Array]],
) -> None:
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            ["bar", "mode", "simulated_Hz", "simulated_error_Hz", "exact_discrete_Hz", "normal_modes_Hz",
             "euler_bernoulli_Hz", "f_over_f1"]
        )  # fmt: skip
        for kind, one in bars.items():
            for i, f in enumerate(one.frequencies):
                beam = f"{bar.beam()[i]:.9g}" if kind == "free" and i < 5 else ""
                row = [f, one.errors[i], exact[kind][i], hessian[kind][0][i]]
                table.writerow([kind, i + 1, *(f"{v:.9g}" for v in row), beam, f"{f / one.frequencies[0]:.6f}"])


def _pictures(folder: Path, one: judgement.Struck, *, quick: bool) -> list[str]:
    """A still and an animation of the free bar; a finding where nothing can draw."""
    if not of.rendering.available():
        return [stage.NO_PICTURES]
    rest = one.ring.model.to_physical(one.ring.model.positions, "length")
    count = round(2 / one.frequencies[0] / INTERVAL)
    frames = slice(0, count + 1, max(1, count // (16 if quick else 125)))
    larger = float(f"{0.05 / np.abs(one.ring.transverse[:count]).max():.1g}")
    radius = bar.RADIUS * unit.meter
    title = "Bar with free ends, struck at 0.24 of its length"
    of.rendering.animate(
        one.ring.positions[frames] * unit.meter, folder / "animation.mp4", times=one.ring.times[frames] * unit.second,
        radius=radius, title=title, rest=rest, exaggerate=larger, fps=8 if quick else 25,
        size=(640, 360) if quick else (960, 540),
    )  # fmt: skip
    still = rest.value_in_unit(unit.meter)
    moments = [count // 8 * i for i in range(1, 5)]
    shown = [still + larger * (one.ring.positions[i] - still) + (0.1 * k, 0, 0) for k, i in enumerate(moments)]
    of.rendering.still(
        [shape * unit.meter for shape in shown], folder / "still.png", radius=radius,
        title=f"{title}: four moments, displaced {larger:g} times as far",
    )  # fmt: skip
    return []
