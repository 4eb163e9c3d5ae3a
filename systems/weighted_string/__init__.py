"""The weighted string of the thesis (2.3.3): the guitar string with beads 40 times heavier, and with these damped harder.

(a) One at the middle; (b) two, at 2L/5 and 2L/3; (c) as (b), the heavy beads damped at 120/s, 40 times the others' rate.
The string has 209 moving beads instead of 200, so that all three places are beads, and even harmonics stay exactly.
It is plucked at L/4 in x, which is heard, and near its end in y, where no line has a node. Each line of the simulated
motion and its decay is held against the exact modes of the loaded chain, from matrices that know no OpenMM.
"""

from __future__ import annotations

import argparse
import csv
import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from openmm import unit
from rich.console import Console

import openmm_filament as of
from openmm_filament import rendering, sound
from systems import stage, strings
from systems.scene import Check, Summary
from systems.weighted_string import chain, figures, remainder
from systems.weighted_string.chain import CASES, LINES, Playing

__all__ = ["RATE", "options", "run"]

_FRAMES = 160
_EXAGGERATE = 1000.0
RATE, QUICK_RATE = (48_000, 4), (6_000, 8)
"""Samples a second, and steps between two."""
_HARMONIC = 0.01
"""How far the ratio of two pitches may be from a whole number for harmonics."""


def options(parser: argparse._ArgumentGroup) -> None:
    """Add the system's own command-line options."""
    parser.add_argument(
        "--segments", type=int, default=None, help="a multiple of 30; default 210 (30 with --quick, as heavily loaded)"
    )


def run(folder: Path, *, quick: bool, seed: int, options: argparse.Namespace) -> int:
    """Play all cases and write the results into `folder`; 1 if an exact check fails, else 0."""
    del seed  # nothing is random
    begun = time.perf_counter()
    segments = (30 if quick else chain.SEGMENTS) if options.segments is None else options.segments
    if segments % 30 or segments < 30:
        raise ValueError(f"Argument `--segments` must be a multiple of 30, but is {segments}.")
    rate, every = QUICK_RATE if quick else RATE
    runs = []
    for case in CASES:
        with stage.progress(case.label) as show:
            runs.append(chain.play(case, segments, 2.02, rate, every, show))
    with stage.progress("what is not linear, and the energy") as show:
        leftovers = [remainder.remainder(run.case.name, run.sound, run.rate, run.modes) for run in runs]
        show(0.3)
        why = remainder.causes(CASES[2])
        show(0.6)
        kept = remainder.energy(CASES[1], *((30, 40_000) if quick else (60, 100_000)))
    heard = [_sound(folder, run) for run in runs]
    _table(folder / "lines.csv", runs)
    figures.spectra(folder / "spectra.png", runs, leftovers)
    figures.decay(folder / "decay.png", runs)
    figures.shapes(folder / "shapes.png", runs)
    findings = _findings(runs) + remainder.findings(leftovers, why, kept) + _pictures(folder, runs[1], quick=quick)
    return stage.close(
        folder,
        Summary(
            system="weighted_string",
            models=[run.model for run in runs],
            platform="Reference",
            wall_seconds=time.perf_counter() - begun,
            filament={
                "beads": segments + 1,
                "held_beads": 2,
                "length_m": strings.LENGTH,
                "radius_m": strings.RADIUS,
                "youngs_modulus_Pa": strings.YOUNG,
                "line_density_kg_per_m": strings.DENSITY,
                "tension_N": strings.TENSION,
                "damping_per_s": strings.DAMPING,
                "heavy_bead_kg": float(CASES[0].masses(segments).max()),
                "heavy_beads": {case.name: case.heavy(segments) for case in CASES},
                "heavy_bead_damping_per_s": {case.name: case.damping for case in CASES},
                "bonds_softer": strings.SOFTER,
                "timestep_s": runs[0].timestep,
            },
            checks=[*_checks(runs, heard), *remainder.checks(leftovers, why, kept)],
            findings=findings,
        ),
        Console(),
    )


def _sound(folder: Path, run: Playing) -> float:
    """Write the sound of a case; its strongest line read back."""
    file = folder / f"weighted_string_{run.case.name}.wav"
    sound.write_wav(file, run.sound, 1 / run.rate * unit.second, seconds=2.0)
    return sound.strongest_line(file)


def _table(path: Path, runs: Sequence[Playing]) -> None:
    with path.open("w", newline="") as out:
        table = csv.writer(out)
        head = "case,line,frequency_Hz,exact_Hz,exact_undamped_Hz,exact_in_steps_Hz"
        table.writerow([*head.split(","), "decay_per_s", "exact_decay_per_s", "strength_m"])
        for run in runs:
            columns = (
                run.frequencies,
                run.modes.frequencies[:LINES],
                run.modes.undamped[:LINES],
                run.modes.stepped[:LINES],
                run.decay_rates,
                run.modes.decay_rates[:LINES],
                run.strengths,
            )
            for k, row in enumerate(zip(*columns, strict=True)):
                table.writerow([run.case.name, k + 1, *(f"{value:.10g}" for value in row)])


def _worst(name: str, found: np.ndarray, exact: np.ndarray, tolerance: float, unit: str = "Hz") -> Check:
    error = np.abs(found / exact - 1)
    i = int(np.argmax(error))
    return Check(f"{name} (worst: line {i + 1})", "exact", found[i], exact[i], float(error[i]), float(tolerance), unit)


def _checks(runs: Sequence[Playing], heard: Sequence[float]) -> list[Check]:
    """Simulated lines and decay against exact modes, and the thesis's statements."""
    rows = []
    for run, pitch in zip(runs, heard, strict=True):
        name, modes = run.case.name, run.modes
        of_model = _across(run.model)[:LINES]
        steps = (
            2 * np.pi * modes.frequencies[LINES - 1] * run.timestep
        ) ** 2 / 24 + run.case.damping * run.timestep / 4
        strongest = _strongest(run)
        rows += [
            _worst(
                f"({name}) normal modes of the model in Hz, against matrices", of_model, modes.undamped[:LINES], 1e-8
            ),
            _worst(f"({name}) lines in Hz, in these time steps", run.frequencies, modes.stepped[:LINES], 5e-5),
            _worst(
                f"({name}) lines in Hz, within what the time step adds",
                run.frequencies,
                modes.frequencies[:LINES],
                1.2 * steps,
            ),
            _worst(f"({name}) decay rates in 1/s", run.decay_rates, modes.decay_rates[:LINES], 2e-2, "1/s"),
            Check(
                f"({name}) strongest line of the sound file in Hz",
                "exact",
                pitch,
                strongest,
                abs(pitch / strongest - 1),
                1e-3,
                "Hz",
            ),
        ]
    segments = runs[0].beads.shape[1] - 1
    even = strings.discrete_law(np.arange(2, LINES + 1, 2), segments)
    found = runs[0].frequencies[1::2]
    rows.append(
        _worst(
            "(a) even harmonics stay: simulated, and without load in these steps, Hz",
            found,
            _unloaded(even, runs[0]),
            5e-5,
        )
    )
    rows.append(_damped(runs[2]))
    low, high = runs[2].decay_rates[:5].mean(), runs[2].decay_rates[-5:].mean()
    rows.append(
        Check(
            "(c) low modes decay faster: mean rate of lines 1 to 5 over that of the last 5 (more than 1)",
            "claim",
            float(low / high),
            1.0,
            max(0.0, 1.0 - float(low / high)),
            0.0,
        )
    )
    return rows


def _unloaded(lines: np.ndarray, run: Playing) -> np.ndarray:
    """What undamped lines in Hz of the string without load show in the time steps of a run (see `stage.alike`)."""
    felt = lines * math.sqrt(1 - strings.DAMPING * run.timestep / 2)
    return strings.beats(felt, strings.DAMPING, run.timestep).frequencies


def _strongest(run: Playing) -> float:
    """The exact frequency in Hz of the line that stands highest in the spectrum of 2 s: one that decays fast does not."""
    moment = np.linspace(0, 2, 4001)[1:-1]
    window = np.sin(np.pi * moment / 2) ** 2
    kept = np.exp(-run.modes.decay_rates[:LINES, None] * moment) @ window
    return float(run.modes.frequencies[int(np.argmax(run.strengths * kept))])


def _across(model: of.Model) -> np.ndarray:
    """Undamped transverse frequencies in Hz, one of each pair, by `of.normal_modes`."""
    modes = of.normal_modes(model)
    power = np.sum(modes.shapes**2, axis=1)
    return np.asarray(modes.frequencies[power[:, 2] < 0.5 * power.sum(axis=1)][::2])


def _damped(run: Playing) -> Check:
    """Decay rates by `of.damped_modes` against the matrices, on 30 segments."""
    model, modes = run.case.model(30), chain.exact(run.case, 30, run.timestep)
    found = of.damped_modes(model)
    shape = np.abs(found.shapes) ** 2
    across = (found.frequencies > 0) & (shape.sum(axis=1)[:, 2] < 0.5 * shape.sum(axis=(1, 2)))
    return _worst(
        "(c) decay rates of the model's damped modes in 1/s, against matrices, 30 segments",
        found.decay_rates[across][: 2 * LINES : 2],
        modes.decay_rates[:LINES],
        1e-6,
        "1/s",
    )


def _findings(runs: Sequence[Playing]) -> list[str]:
    a, b, c = runs
    segments = a.beads.shape[1] - 1
    plain = strings.discrete_law(np.arange(1, LINES + 1), segments)
    loud = np.argsort(b.strengths)[::-1]
    first, second, third = (float(b.frequencies[k]) for k in loud[:3])
    part = 100 * b.strengths / b.strengths.max()
    top = plain[-1]
    ratio = max(second / first, first / second)
    harmonic = abs(ratio - round(ratio)) <= _HARMONIC
    falling = bool((np.diff(c.decay_rates) <= 0).all())
    stay = np.abs(a.frequencies[1::2] / _unloaded(plain[1::2], a) - 1).max()
    more = [int((run.modes.undamped <= top * (1 + 1e-9)).sum()) for run in (a, b)]
    shown = [int((run.strengths > 1e-4 * run.strengths.max()).sum()) for run in (a, b)]
    return [
        f"(a) The simulated even harmonics stay within {stay:.0e}; the odd ones fall, the first from {plain[0]:.2f} to "
        f"{a.frequencies[0]:.2f} Hz, the third from {plain[2]:.2f} to {a.frequencies[2]:.2f} Hz.",
        f"Up to {top:.0f} Hz the plain string has {LINES} lines, (a) {more[0]} and (b) {more[1]}; "
        f"above 1e-4 of the strongest the sound of (a) shows {shown[0]} of its first {LINES} and that of (b) {shown[1]}.",
        f"(b) The two pitches heard are its two strongest lines, {first:.2f} and {second:.2f} Hz, {second / first:.3f} to 1, which "
        f"{'are' if harmonic else 'are not'} a fundamental and a harmonic of it; the second has "
        f"{part[loud[1]]:.1f} % of the first's amplitude, the next ({third:.1f} Hz) "
        f"{part[loud[2]]:.1f} %.",
        f"(c) With the heavy beads damped at {c.case.damping:.0f}/s lines 1 to 5 decay at {c.decay_rates[:5].mean():.2f}/s "
        f"on average and the last five of {LINES} at {c.decay_rates[-5:].mean():.2f}/s; from {c.decay_rates.max():.2f} to "
        f"{c.decay_rates.min():.2f}/s they {'fall' if falling else 'do not fall'} from every line to the next.",
        f"(c) In 2 s of sound its strongest line is {_strongest(c):.1f} Hz, where that of (b) is {_strongest(b):.1f} Hz.",
    ]


def _pictures(folder: Path, run: Playing, *, quick: bool) -> list[str]:
    """Trajectory, still and animation of (b); a finding where there is nothing to draw with."""
    segments = run.beads.shape[1] - 1
    every = max(1, round(run.rate * 0.04 / _FRAMES))
    xy = run.beads[::every][:_FRAMES]
    frames = np.zeros((len(xy), segments + 1, 3))
    frames[..., 0] = 1e9 * xy[..., 0]
    frames[..., 2] = 1e9 * np.linspace(0, strings.LENGTH, segments + 1)
    times = np.arange(len(frames)) * every / run.rate
    stage.write_trajectory(folder / "trajectory.dcd", run.model, times, frames)
    if not rendering.available():
        return [stage.NO_PICTURES]
    radius = strings.RADIUS * unit.meter
    beads = np.full(segments + 1, 1.6 * strings.RADIUS)
    beads[run.case.heavy(segments)] *= 40 ** (1 / 3)
    rest = frames[0] * [0, 0, 1]
    chosen = frames[:: 4 if quick else 1]
    moment = int(np.argmax(np.abs(frames[..., 0]).max(axis=1)))
    rendering.still(
        (rest + _EXAGGERATE * (frames[moment] - rest)) * unit.nanometer,
        folder / "still.png",
        radius=radius,
        bead_radius=beads * unit.meter,
        title=f"{run.case.label}, {1e3 * times[moment]:.1f} ms (displacement x {_EXAGGERATE:g})",
    )
    rendering.animate(
        chosen * unit.nanometer,
        folder / "animation.mp4",
        times=times[:: 4 if quick else 1] * unit.second,
        radius=radius,
        bead_radius=beads * unit.meter,
        title=f"Weighted string {run.case.label}",
        rest=rest * unit.nanometer,
        exaggerate=_EXAGGERATE,
    )
    return []
