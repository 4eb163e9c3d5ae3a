"""Three-dimensional pictures of the rings, where PyVista is installed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from openmm import unit

import openmm_filament as of
from systems import stage
from systems.open_ring.figures import LARGER
from systems.open_ring.ring import RADIUS, Swing

__all__ = ["draw"]

_APART = 0.065
"""Distance between the rings in m."""


def draw(folder: Path, runs: Mapping[tuple[bool, float], Swing], *, quick: bool) -> list[str]:
    """A still and an animation of rings whose ends meet, phi = 0, pi/4, pi/2 side by side; a finding where nothing can draw."""
    if not of.rendering.available():
        return [stage.NO_PICTURES]
    shown = [runs[False, phi] for phi in (0.0, math.pi / 4, math.pi / 2)]
    half = len(shown[0].times) // 2
    frames = slice(0, half + 1, max(1, half // (25 if quick else 125)))
    rests = [run.positions[0] + (_APART * i, 0.0, 0.0) for i, run in enumerate(shown)]
    moved = [LARGER * (run.positions - run.positions[0]) for run in shown]
    radius = RADIUS * unit.meter
    title = "Open rings, ends pulled apart: in the plane, at 45 degrees, normal to it"
    of.rendering.animate(
        [(rest + shift[frames] / LARGER) * unit.meter for rest, shift in zip(rests, moved, strict=True)],
        folder / "animation.mp4",
        times=shown[0].times[frames] * unit.second,
        radius=radius,
        title=title,
        rest=[rest * unit.meter for rest in rests],
        exaggerate=LARGER,
        size=(640, 360) if quick else (960, 540),
        fps=10 if quick else 25,
    )
    widest = [int(np.argmax(run.energies["internal"][: half + 1])) for run in shown]
    of.rendering.still(
        [(rest + shift[i]) * unit.meter for rest, shift, i in zip(rests, moved, widest, strict=True)],
        folder / "still.png",
        radius=radius,
        title=f"{title}, displaced {LARGER} times as far",
    )
    return []
