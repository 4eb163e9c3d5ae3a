"""How the hand moves: straight ways and screws, started and stopped smoothly."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Way", "smooth"]

Array = NDArray[np.float64]

_EASE = 0.15
"""Part of the time in which the hand speeds up, and again in which it slows down."""


@dataclass(frozen=True)
class Way:
    """A rigid motion of the hand.

    Attributes
    ----------
    name : str
    along : (float, float, float)
        The whole shift, m.
    turns : float
        Turns about z in the meantime, positive from x to y.
    """

    name: str
    along: tuple[float, float, float]
    turns: float = 0.0

    def displacements(self, points: Array, part: float) -> Array:
        """Displacements (G, 3) of points (G, 3), counted from the axis of the turn, after `part` of the way."""
        angle = 2 * math.pi * self.turns * part
        sine, versine = math.sin(angle), 2 * math.sin(angle / 2) ** 2
        turned = points @ np.array([[-versine, sine, 0.0], [-sine, -versine, 0.0], [0.0, 0.0, 0.0]])
        return np.asarray(turned + part * np.array(self.along))

    @property
    def distance(self) -> float:
        """Length of the shift, m."""
        return float(np.linalg.norm(self.along))

    def length(self, radius: float) -> float:
        """Way of a point at this distance from the axis, m."""
        return math.hypot(self.distance, 2 * math.pi * self.turns * radius)


def smooth(time: float) -> float:
    """Part of the way done at a part of the time, both from 0 to 1: evenly, but for a soft start and a soft stop."""
    top = 1 / (1 - _EASE)
    t = min(max(time, 0.0), 1.0)
    if t < _EASE:
        return top * t * t / (2 * _EASE)
    if t > 1 - _EASE:
        return 1 - top * (1 - t) ** 2 / (2 * _EASE)
    return top * (t - _EASE / 2)
