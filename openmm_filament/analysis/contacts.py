"""Contacts: how many pairs of beads lie near one another."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from openmm_filament import _checks as check
from openmm_filament.analysis.chains import curve_points

__all__ = ["contacts"]

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
    y, also = curve_points("second", second, 1)
    if len(x) != len(y) and 1 not in {len(x), len(y)}:
        raise ValueError(f"Argument `second` must have {len(x)} frames or one, but has {len(y)}.")
    frames = max(len(x), len(y))
    x, y = (np.broadcast_to(beads, (frames, *beads.shape[1:])) for beads in (x, y))
    counts = np.array([cKDTree(u).count_neighbors(cKDTree(v), radius) for u, v in zip(x, y, strict=True)])
    return counts if framed or also else counts[0]


def _within(beads: NDArray[np.float64], radius: float, apart: int, closed: bool) -> int:
    """Pairs of one chain's beads (N, 3)."""
    pairs = cKDTree(beads).query_pairs(radius, output_type="ndarray")
    along = np.abs(pairs[:, 1] - pairs[:, 0])
    if closed:
        along = np.minimum(along, len(beads) - along)
    return int(np.count_nonzero(along >= apart))
