"""Monte Carlo moves that turn the joints of planar chains over, where dynamics alone is held up by the barrier between.

Chains are given by the headings h (R, 30) of their segments in rad and the lengths s (R, 30) of these in segments l0; no
move changes a length. Every move is as likely as its inverse and keeps volume in h, so that Metropolis's rule leaves the
Boltzmann weight of bending and pull as it is. A joint that is held to a side is never turned over.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from systems.planar_force_extension import chain

__all__ = ["Moves", "wrapped"]

Array = NDArray[np.float64]

_TURNS_EVERY = 10
"""Moves between turns of the whole chain."""

_SOFTEST = 0.3
"""Force over k_B T, times l0, below which headings are not shaken as a still weaker one would let them."""


def wrapped(angles: Array) -> Array:
    """Angles in [-pi, pi]."""
    return np.asarray(angles - 2 * np.pi * np.rint(angles / (2 * np.pi)))


class Moves:
    """Moves of chains at a temperature under a force along x.

    Parameters
    ----------
    heat : float
        `k_B T/alpha`.
    force : float
        In alpha/l0.
    sides : sequence of 29 floats
        +1 or -1 for joints that are held to that side, 0 for free ones.
    rng : Generator
    """

    def __init__(self, heat: float, force: float, sides: Sequence[float], rng: np.random.Generator) -> None:
        self._heat, self._pull, self._rng = heat, force / heat, rng
        self._sizes, self._sides = np.abs(chain.BENDS), np.asarray(sides, dtype=float)
        self._held, self._free = np.flatnonzero(self._sides), np.flatnonzero(self._sides == 0)
        self._segments = np.arange(len(self._sides) + 1)
        turn = np.diff(np.eye(len(self._segments)), axis=0)
        self._kinks = _kinks(turn, force)
        self._width = 1 / np.sqrt(1 / heat + self._pull)
        stiffness = turn.T @ turn / heat + max(self._pull, _SOFTEST) * np.eye(len(self._segments))
        self._shake = 2 / np.sqrt(len(stiffness)) * linalg.cholesky(linalg.inv(stiffness))
        few = 2 * len(self._free) < len(self._sides)
        kink = self._kink if len(self._free) else self._part_turned
        turns = self._part_turned if few or heat >= 1 else kink
        last = kink if few else self._tail_mirrored
        self.kinds: tuple[Callable[[Array], Array], ...] = (
            turns, self._shaken, turns, self._part_turned, turns, self._shaken, turns, last,
        )  # fmt: skip
        """The moves in the order in which they are tried."""

    def __call__(self, h: Array, s: Array, count: int) -> Array:
        """The headings after `count` tried moves of every chain."""
        thresholds = np.log(self._rng.random((count, len(h))))
        for i in range(count):
            if i % _TURNS_EVERY == 0:
                h = self.turned(h, s)
                weight = self.log_weight(h, s)
            tried = self.kinds[i % len(self.kinds)](h)
            new = self.log_weight(tried, s)
            taken = thresholds[i] < new - weight
            h = np.where(taken[:, None], tried, h)
            weight = np.where(taken, new, weight)
        return h

    def log_weight(self, h: Array, s: Array) -> Array:
        """Logarithm of the Boltzmann weight (R,) of bending and pull, -inf with a held joint on its wrong side."""
        bends = wrapped(h[:, 1:] - h[:, :-1])
        off = np.abs(bends) - self._sizes
        weight = self._pull * (s * np.cos(h)).sum(axis=1) - (off * off).sum(axis=1) / (2 * self._heat)
        if len(self._held):
            wrong = (bends[:, self._held] * self._sides[self._held] < 0).any(axis=1)
            weight = np.where(wrong, -np.inf, weight)
        return np.asarray(weight)

    def turned(self, h: Array, s: Array) -> Array:
        """Whole chains turned to directions drawn from their exact distribution, that of von Mises: always taken."""
        end = (s * np.exp(1j * h)).sum(axis=1)
        return np.asarray(h + (self._rng.vonmises(0.0, self._pull * np.abs(end)) - np.angle(end))[:, None])

    def _kink(self, h: Array) -> Array:
        """A free joint turned over the shorter way, the headings about it following as on a nearly straight chain."""
        rows, a = np.arange(len(h)), self._free[self._rng.integers(0, len(self._free), len(h))]
        angle = wrapped(-2 * (h[rows, a + 1] - h[rows, a]))
        return np.asarray(h + angle[:, None] * self._kinks[a])

    def _tail_mirrored(self, h: Array) -> Array:
        """All beyond a segment mirrored in its line: bends keep their sizes."""
        a = self._rng.integers(0, h.shape[1] - 1, (len(h), 1))
        return np.where(self._segments > a, 2 * np.take_along_axis(h, a, 1) - h, h)

    def _part_turned(self, h: Array) -> Array:
        """Some segments in a row, of all scales, turned by an angle of the size of its fluctuations."""
        n = h.shape[1]
        scale, place, size = self._rng.random((3, len(h), 1))
        length = np.ceil(n**scale)
        first = np.floor(place * (n - length + 1))
        inside = (self._segments >= first) & (self._segments < first + length)
        angle = self._width * (0.5 + (size < 0.5)) * self._rng.standard_normal((len(h), 1))
        return np.asarray(h + inside * angle)

    def _shaken(self, h: Array) -> Array:
        """All headings changed by a part of their fluctuations on a nearly straight chain."""
        return np.asarray(h + self._rng.standard_normal(h.shape) @ self._shake)


def _kinks(turn: Array, force: float) -> Array:
    """Changes of heading (29, 30) that turn each joint by 1 rad at the least energy under a force in alpha/l0.

    Least is `sum_(j != a) (change of bend j)^2 + F sum_k (change of heading k)^2`: that of a nearly straight chain. `turn`
    (29, 30) takes headings to bends.
    """
    out = []
    for a, row in enumerate(turn):
        others = np.delete(turn, a, axis=0)
        profile = linalg.solve(others.T @ others + force * np.eye(len(row)), row, assume_a="pos")
        out.append(profile / (row @ profile))
    return np.array(out)
