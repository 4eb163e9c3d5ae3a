"""Three-dimensional pictures of the rings, where PyVista is installed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from openmm import unit

import openmm_filament as of
from systems.open_ring.ring import RADIUS, Swing

__all__ = ["draw"]

_APART = 0.075
"""Distance between the rings in m."""


def draw(folder: Path, runs: Mapping[tuple[bool, float], Swing]) -> list[str]:
    """A still and an animation of the rings at phi = 0, pi/4 and pi/2 side by side; a finding where nothing can draw."""
    if not of.rendering.available():
        text = "No 3D pictures: install the extra `render` (pip install openmm_filament[render])."
        print(text)
        return [text]
    shown = [runs[True, phi] for phi in (0.0, math.pi / 4, math.pi / 2)]
    every = max(1, len(shown[0].times) // 125)
    aside = np.array([[_APART * i, 0.0, 0.0] for i in range(len(shown))])
    moving = [(run.positions[::every] + shift) * unit.meter for run, shift in zip(shown, aside, strict=True)]
    radius = RADIUS * unit.meter
    title = "Open rings under opposite forces on their ends: in the plane, at 45 degrees, normal to it"
    of.rendering.animate(
        moving, folder / "open_ring.mp4", times=shown[0].times[::every] * unit.second, radius=radius, title=title
    )
    middle = [(run.positions[len(run.positions) // 2] + shift) * unit.meter for run, shift in zip(shown, aside, strict=True)]
    of.rendering.still(middle, folder / "open_ring_3d.png", radius=radius, title=f"{title}, after 2.5 ms")
    return []
