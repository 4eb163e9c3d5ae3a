"""Rest shapes: bead positions as (N, 3) Quantities of length."""

from __future__ import annotations

import numpy as np
from openmm import unit

from openmm_filament import _checks as check
from openmm_filament import units

__all__ = ["helix", "line", "planar_walk", "ring"]


def line(segments: int, segment_length: unit.Quantity) -> unit.Quantity:
    """A straight chain of `segments` along z, bead 0 at the origin: (segments + 1, 3)."""
    check.integer("segments", segments, low=1)
    step = float(check.positive("segment_length", units.number("segment_length", segment_length, "length")))
    positions = np.zeros((segments + 1, 3))
    positions[:, 2] = step * np.arange(segments + 1)
    return units.quantity(positions, "length")


def ring(beads: int, segment_length: unit.Quantity) -> unit.Quantity:
    """Beads on a circle in the xy plane, `segment_length` between neighbours all the way round: (beads, 3).

    The shape serves closed rings and, with `closed=False`, open ones, whose gap is one segment.
    """
    check.integer("beads", beads, low=3)
    step = float(check.positive("segment_length", units.number("segment_length", segment_length, "length")))
    radius = step / (2 * np.sin(np.pi / beads))
    angle = 2 * np.pi * np.arange(beads) / beads
    return units.quantity(radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1), "length")


def helix(
    segments: int, *, radius: unit.Quantity, pitch: unit.Quantity, turns: float, left_handed: bool = False
) -> unit.Quantity:
    """Beads at equal angles on a helix about z, bead 0 at (radius, 0, 0): (segments + 1, 3).

    `pitch` is the rise per turn; a right-handed helix has positive torsion.
    """
    check.integer("segments", segments, low=1)
    r = float(check.positive("radius", units.number("radius", radius, "length")))
    rise = float(check.positive("pitch", units.number("pitch", pitch, "length")))
    angle = 2 * np.pi * float(check.positive("turns", turns)) * np.arange(segments + 1) / segments
    hand = -1.0 if left_handed else 1.0
    positions = np.stack([r * np.cos(angle), hand * r * np.sin(angle), rise * angle / (2 * np.pi)], axis=-1)
    return units.quantity(positions, "length")


def planar_walk(segments: int, segment_length: unit.Quantity, *, bend: unit.Quantity, seed: int) -> unit.Quantity:
    """A random chain in the xy plane whose successive segments turn by independent normal angles: (segments + 1, 3).

    `bend` is the standard deviation of the turning angle; the first segment runs along x.
    """
    check.integer("segments", segments, low=1)
    step = float(check.positive("segment_length", units.number("segment_length", segment_length, "length")))
    spread = float(check.non_negative("bend", units.number("bend", bend, "angle")))
    turns = np.random.default_rng(seed).normal(0.0, spread, segments - 1)
    heading = np.concatenate([[0.0], np.cumsum(turns)])
    steps = step * np.stack([np.cos(heading), np.sin(heading), 0 * heading], axis=-1)
    return units.quantity(np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), "length")
