"""Contacts: how many pairs of beads lie near one another, and how near two polygonal curves come."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from openmm_filament import _checks as check
from openmm_filament.analysis.chains import common_frames, curve_points
from openmm_filament.geometry import dot, segments

__all__ = ["contacts", "nearest"]

Array = NDArray[np.float64]

_APART = 2
"""Beads along a chain from which on pairs of it count by default: all but those of one segment."""


def contacts(
    first: Any, second: Any = None, *, distance: float, apart: int | None = None, closed: bool | None = None
) -> NDArray[np.int64]:
    """Number of pairs of beads at most `distance` apart, of two chains or of one with itself, frame by frame.

    Parameters
    ----------
    first : (N, 3) or (T, N, 3) array, or mdtraj.Trajectory of one chain
        Beads along the chain, not wrapped into a periodic box, in the unit of `distance` (nm of a trajectory).
    second : as `first`, optional
        Another chain, of the same frames or of one that stands for all. Without it, pairs are those within `first`.
        Chains of one trajectory: `contacts(*split_chains(frames), distance=...)`.
    distance : float
        In the unit of the positions.
    apart : int, optional
        Within one chain: pairs of beads i and j count from `|i - j| = apart` on; 2 by default.
    closed : bool, optional
        Within one chain: whether it is a ring, so that i and j are counted apart the shorter way round.

    Returns
    -------
    () or (T,) array of int
        The count of each frame.

    Raises
    ------
    ValueError
        If shapes do not fit, a coordinate is not finite, `distance` is not positive, or `apart` or `closed` is given with
        two chains, where it says nothing.

    Examples
    --------
    >>> square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    >>> contacts(square, distance=1.2), contacts(square, distance=1.2, closed=True)
    (np.int64(1), np.int64(0))
    """
    radius = float(check.positive("distance", distance))
    x, framed = curve_points("first", first, 1)
    if second is None:
        span = _APART if apart is None else check.integer("apart", apart, low=1)
        counts = np.array([_within(beads, radius, span, bool(closed)) for beads in x])
        return counts if framed else counts[0]
    for name, option in (("apart", apart), ("closed", closed)):
        if option is not None:
            raise check.fail(name, "be left out for two chains", option)
    x, y, framed = _paired(x, framed, second, 1)
    counts = np.array([cKDTree(u).count_neighbors(cKDTree(v), radius) for u, v in zip(x, y, strict=True)])
    return counts if framed else counts[0]


def nearest(first: Any, second: Any, *, closed: bool = False) -> Array:
    """Smallest distance of two polygonal curves, exact between their straight segments, frame by frame.

    Two wires of diameter d are in contact where it is d or less, also in the middle of segments, where `contacts` sees no
    beads.

    Parameters
    ----------
    first, second : (N, 3) or (T, N, 3) array, or mdtraj.Trajectory of one chain
        Points along each curve, whole, in any one unit of length; T frames, or one that stands for all.
    closed : bool
        Whether a last segment runs from the last point to the first, of both curves.

    Returns
    -------
    () or (T,) array
        In the unit of the positions; 0 where the curves touch.

    Raises
    ------
    ValueError
        If shapes do not fit or a coordinate is not finite.

    Examples
    --------
    >>> float(nearest([[-1.0, 0, 0], [1, 0, 0]], [[0.0, -1, 3], [0, 1, 3]]))
    3.0
    """
    x, framed = curve_points("first", first, 2)
    x, y, framed = _paired(x, framed, second, 2)
    found = np.array([_gap(u, segments(u, closed), v, segments(v, closed)) for u, v in zip(x, y, strict=True)])
    return found if framed else found[0]


def _paired(x: Array, framed: bool, second: Any, least: int) -> tuple[Array, Array, bool]:
    """The points of two curves with as many frames each, and whether either has frames."""
    y, also = curve_points("second", second, least)
    frames = common_frames(x, y)
    x, y = (np.broadcast_to(points, (frames, *points.shape[1:])) for points in (x, y))
    return x, y, framed or also


def _gap(p: Array, u: Array, q: Array, v: Array) -> float:
    """Smallest distance of segments p + s u and q + t v, s and t from 0 to 1, over all pairs."""
    p, u, q, v = p[: len(u), None], u[:, None], q[None, : len(v)], v[None]
    w = p - q
    uu, uv, vv, uw, vw = dot(u, u), dot(u, v), dot(v, v), dot(u, w), dot(v, w)
    lengths = np.where(uu > 0, uu, 1), np.where(vv > 0, vv, 1)  # a segment without length is its point
    area = uu * vv - uv * uv

    def beside(s: Array) -> Array:
        """Distance from the point s of each first segment to all of the second."""
        t = np.clip((uv * s + vw) / lengths[1], 0, 1)
        s = np.clip((uv * t - uw) / lengths[0], 0, 1)
        apart = w + s[..., None] * u - t[..., None] * v
        return np.asarray(np.sqrt(dot(apart, apart)))

    crossing = np.where(area > 0, (uv * vw - uw * vv) / np.where(area > 0, area, 1), 0.0)
    starts = (np.clip(crossing, 0, 1), np.zeros_like(area), np.ones_like(area))  # side by side the first is noise
    return float(min(beside(s).min() for s in starts))


def _within(beads: NDArray[np.float64], radius: float, apart: int, closed: bool) -> int:
    """Pairs of one chain's beads (N, 3)."""
    pairs = cKDTree(beads).query_pairs(radius, output_type="ndarray")
    along = np.abs(pairs[:, 1] - pairs[:, 0])
    if closed:
        along = np.minimum(along, len(beads) - along)
    return int(np.count_nonzero(along >= apart))
