"""How the lower chain stands before the upper one is brought to it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Pose", "drawn"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pose:
    """Turned about its axis (rad), tilted about its foot (rad, about x and y), and shifted (m) from under the upper chain.

    Last of all its axis is laid across that of the upper chain: turned by `crossing` (rad) about a line along y at the
    height `crossed_at` (m).
    """

    phase: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    tilt: tuple[float, float] = (0.0, 0.0)
    crossing: float = 0.0
    crossed_at: float = 0.0

    def placed(self, shape: Array) -> Array:
        """The beads (N, 3) of a chain along z, in this pose."""
        (sine, cosine), (a, b) = _turn(self.phase), self.tilt
        about_z = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
        sine, cosine = _turn(a)
        about_x = np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
        sine, cosine = _turn(b)
        about_y = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
        standing = shape @ (about_y @ about_x @ about_z).T + np.array([*self.shift, 0.0])
        (sine, cosine), pivot = _turn(self.crossing), np.array([0.0, 0.0, self.crossed_at])
        across = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
        return np.asarray((standing - pivot) @ across.T + pivot)


def _turn(angle: float) -> tuple[float, float]:
    return math.sin(angle), math.cos(angle)


def drawn(count: int, seed: int, *, shift: float, tilt: float) -> tuple[Pose, ...]:
    """Poses of any phase, with shifts up to `shift` in m and tilts up to `tilt` in rad, evenly in a disc."""
    rng = np.random.default_rng(seed)
    poses = []
    for _ in range(count):
        phase, *directions = rng.uniform(0, 2 * math.pi, 3)
        sizes = np.sqrt(rng.uniform(0, 1, 2)) * (shift, tilt)
        (x, y), (a, b) = (
            (float(size * math.cos(t)), float(size * math.sin(t))) for size, t in zip(sizes, directions, strict=True)
        )
        poses.append(Pose(float(phase), (x, y), (a, b)))
    return tuple(poses)
