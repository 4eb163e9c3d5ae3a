"""A plucked chain of nine masses to be looked at and listened to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from openmm import unit

import openmm_filament as of
from systems import stage
from systems.mass_spring.chain import LENGTH, Chain, launch, play
from systems.scene import Check

__all__ = ["listen", "show"]

_PLUCKED = 3
"""The mass of nine that is held aside: all modes answer."""
_SHOWN = 1.0
"""How far, in l0, for the film: far enough to be seen."""
_HEARD = 1e-3
"""How far for the sound: all lines stand where theory has them."""
_FRAMES = 240
_RADIUS = 4e-3
"""Of a drawn spring in m."""

_TONE = 1e-4
"""Strongest line of the file against the exact one, relative: 16 bits, 2 s, and 3e-6 of time step."""


def show(folder: Path, chain: Chain, *, quick: bool = False) -> list[str]:
    """Write `topology.pdb`, `trajectory.dcd` and, where that can be drawn, a still and a film; returns findings.

    A quick film is small and jerky.
    """
    period = 1 / float(chain.frequencies[0])
    timestep = 0.05 / chain.cutoff
    context = launch(chain, _SHOWN * chain.pluck(_PLUCKED), timestep)
    motion = of.record(chain.model, context, _FRAMES, int(4 * period / _FRAMES / timestep))
    times = stage.seconds(motion)
    stage.write_trajectory(folder / "trajectory.dcd", chain.model, times, motion.values)
    said = [
        f"trajectory.dcd shows mass {_PLUCKED} of {chain.masses} held {_SHOWN * chain.spacing * 1e3:.0f} mm aside and let go, over "
        f"{times[-1] * 1e3:.1f} ms; an amplitude to be seen, at which the lines are no longer those of the table."
    ]
    if not of.rendering.available():
        return [*said, stage.NO_PICTURES]
    title = f"{chain.masses} masses on a stretched chain of {LENGTH * 1e3:.0f} mm, plucked at the third"
    radius = _RADIUS * unit.meter
    beads = np.full(chain.masses + 2, 2.5 * _RADIUS) * unit.meter
    kept = slice(None, None, 8 if quick else 2)
    of.rendering.animate(
        motion.values[kept] * unit.nanometer,
        folder / "animation.mp4",
        times=times[kept] * unit.second,
        radius=radius,
        bead_radius=beads,
        title=title,
        plane="xy",
        size=(640, 360) if quick else (960, 540),
        fps=8 if quick else 25,
    )
    shown = _FRAMES // 40
    of.rendering.still(
        motion.values[shown] * unit.nanometer,
        folder / "still.png",
        radius=radius,
        bead_radius=beads,
        title=f"{title}, after {times[shown] * 1e3:.1f} ms",
        plane="xy",
    )
    return said


def listen(folder: Path, chain: Chain, seconds: float = 2.0) -> Check:
    """Write the summed motion of the masses after a small pluck as a WAV file, and read its strongest line back."""
    timestep = 0.05 / chain.cutoff
    recording = play(
        chain, _HEARD * chain.pluck(_PLUCKED), seconds * 1.001, timestep=timestep, interval=np.pi / chain.cutoff / 2
    )
    path = folder / "mass_spring.wav"
    of.sound.write_wav(path, recording.across.sum(axis=1), recording.interval * unit.second, seconds=seconds)
    found, exact = of.sound.strongest_line(path), float(chain.frequencies[0])
    return Check(
        "strongest line (Hz) of mass_spring.wav, relative", "exact", found, exact, abs(found / exact - 1), _TONE, "Hz"
    )
