"""The guitar string of the thesis (2.3.1): 200 beads plucked at L/4, by 12 N as printed and by 0.01 N for its lines.

The net force acts for 1/300 s on bead 50, the nearest to L/4 of 202 (the held bead at the end is bead 0). The 0.01 N run
plucks bead 10 as well (0.04 N), in the other transverse direction: small motion in one does not feel the other. Its lines and
their decay are held against the exact discrete string. Its bonds are 64 times softer at the same tension, which changes
none of its lines and lets its time step be eight times as long: this is measured against the true bonds.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from pathlib import Path

import numpy as np
from openmm import unit

from openmm_filament import rendering, sound
from systems import stage, strings
from systems.guitar_string import figures, hard, report, soft, steady
from systems.scene import Summary

__all__ = ["options", "run"]

_FRAMES, _FRAME_STEP = 160, 4
"""Frames of the trajectory and the animation, of the 12 N pluck, 1/6 ms apart."""
_EXAGGERATE = 4.0


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options."""
    parser.add_argument(
        "--seconds", type=float, default=None, help="motion of the 0.01 N pluck; default 2.1 s (0.25 s with --quick)"
    )


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Run both plucks and write the results into `folder`; 1 if an exact check fails, else 0."""
    del seed  # nothing is random
    begun = time.perf_counter()
    duration = (0.25 if quick else 2.1) if options.seconds is None else options.seconds
    if not 0.2 <= duration < math.inf:
        raise ValueError(
            f"Argument `--seconds` must be finite and at least 0.2, to part the harmonics, but is {duration:g}."
        )
    with stage.progress(f"pluck of 0.01 N, {duration:g} s") as show:
        recording = soft.record(duration, min(duration, 0.35), show)
    found = soft.harmonics(recording)
    softness = soft.softness(recording, 0.006 if quick else 0.03)
    with stage.progress("pluck of 12 N") as show:
        motion = hard.run(0.025 if quick else 0.15, show)
    kept = steady.steadiness(*((50, 50_000) if quick else (soft.SEGMENTS, 100_000)))
    heard, exact, sounding = _sounds(folder, recording, motion)
    _tables(folder, found, motion)
    figures.shapes(folder / "shapes.png", recording)
    figures.spectra(folder / "spectra.png", recording)
    figures.law(folder / "harmonics.png", found)
    figures.decay(folder / "decay.png", recording, found)
    figures.hard_pluck(folder / "hard_pluck.png", motion)
    findings = report.findings(recording, found, softness, motion) + steady.findings(kept)
    findings += _pictures(folder, motion, quick=quick)
    models = [recording.model, motion.model, kept.model]
    return stage.close(
        folder,
        Summary(
            system="guitar_string",
            models=models,
            platform="Reference",
            wall_seconds=time.perf_counter() - begun,
            filament={
                "beads": soft.SEGMENTS + 1,
                "held_beads": 2,
                "length_m": strings.LENGTH,
                "radius_m": strings.RADIUS,
                "youngs_modulus_Pa": strings.YOUNG,
                "line_density_kg_per_m": strings.DENSITY,
                "tension_N": strings.TENSION,
                "damping_per_s": strings.DAMPING,
                "pluck_s": strings.PLUCKING,
                "plucked_beads": list(soft.BEADS),
                "small_plucks_N": list(soft.FORCES),
                "hard_pluck_N": hard.FORCE,
                "bonds_softer_in_small_pluck": strings.SOFTER,
                "small_pluck_timestep_s": recording.timestep,
                "hard_pluck_timestep_s": 1 / (hard.RATE * hard.EVERY),
                "sound_segments": sounding,
            },
            checks=[*report.checks(recording, found, softness, motion, heard, exact), *steady.checks(kept)],
            findings=findings,
        ),
    )


def _sounds(folder: Path, recording: soft.Recording, motion: hard.HardPluck) -> tuple[float, float, int]:
    """Write the sounds; the strongest line of the small pluck's, the exact one, and the segments of that string."""
    n, signal, rate = soft.SEGMENTS, recording.sums[recording.played :, 0], recording.rate
    if len(signal) < 2.0 * rate:
        n, signal, rate = soft.coarse_sound(2.02)
    file = folder / "guitar_string.wav"
    sound.write_wav(file, signal, 1 / rate * unit.second, seconds=2.0)
    after = motion.times > strings.PLUCKING
    length = float(np.floor(100 * (after.sum() / hard.RATE)) / 100)
    if length >= 0.1:
        sound.write_wav(folder / "hard_pluck.wav", motion.mean[after], 1 / hard.RATE * unit.second, seconds=length)
    exact = strings.beats(strings.discrete_law(np.array([1.0]), n), strings.DAMPING)
    return sound.strongest_line(file), float(exact.frequencies[0]), n


def _tables(folder: Path, found: soft.Harmonics, motion: hard.HardPluck) -> None:
    n = np.arange(1, soft.HARMONICS + 1)
    undamped = strings.discrete_law(n, soft.SEGMENTS)
    exact = strings.beats(undamped, strings.DAMPING)
    with (folder / "harmonics.csv").open("w", newline="") as out:
        table = csv.writer(out)
        head = ["frequency_Hz", "frequency_error_Hz", "decay_time_s", "amplitude_m"]
        table.writerow(
            ["harmonic", "stiff_string_Hz", "discrete_Hz", "discrete_damped_Hz"]
            + [f"{name}_bead{bead}" for bead in soft.BEADS for name in head]
        )
        for i, number in enumerate(n):
            cells = [strings.stiff_law(number), undamped[i], exact.frequencies[i]]
            for c in range(len(soft.BEADS)):
                cells += [found.frequencies[i, c], found.frequency_errors[i, c], found.decay_times[i, c]]
                cells.append(found.amplitudes[i, c])
            table.writerow([number, *(f"{float(cell):.10g}" for cell in cells)])
    with (folder / "hard_pluck.csv").open("w", newline="") as out:
        table = csv.writer(out)
        table.writerow(
            [
                "time_s",
                "lift_m",
                "mean_displacement_m",
                "mean_tension_N",
                "least_tension_N",
                "largest_tension_N",
                "pitch_Hz",
            ]
        )
        pitch = np.interp(
            motion.times, motion.pitch.times + strings.PLUCKING, motion.pitch.frequencies, left=np.nan, right=np.nan
        )
        tension = motion.tensions
        columns = (motion.times, motion.lift, motion.mean, tension.mean(1), tension.min(1), tension.max(1), pitch)
        table.writerows([f"{value:.8g}" for value in row] for row in zip(*columns, strict=True))


def _pictures(folder: Path, motion: hard.HardPluck, *, quick: bool) -> list[str]:
    """The trajectory, a still and an animation; a finding where there is nothing to draw with."""
    chosen = slice(0, _FRAMES * _FRAME_STEP, _FRAME_STEP)
    frames, times = 1e9 * motion.positions[chosen], motion.times[chosen]
    stage.write_trajectory(folder / "trajectory.dcd", motion.model, times, frames)
    if not rendering.available():
        return [stage.NO_PICTURES]
    rest = 1e9 * motion.positions[0]
    highest = int(np.argmax(motion.lift))
    rendering.still(
        (rest + _EXAGGERATE * (1e9 * motion.positions[highest] - rest)) * unit.nanometer,
        folder / "still.png",
        radius=strings.RADIUS * unit.meter,
        title=f"Guitar string plucked with 12 N at L/4, {1e3 * motion.times[highest]:.2f} ms (displacement x {_EXAGGERATE:g})",
    )
    every = 8 if quick else 1
    rendering.animate(
        frames[::every] * unit.nanometer,
        folder / "animation.mp4",
        times=times[::every] * unit.second,
        radius=strings.RADIUS * unit.meter,
        title="Guitar string plucked with 12 N at L/4",
        rest=rest * unit.nanometer,
        exaggerate=_EXAGGERATE,
    )
    return []
