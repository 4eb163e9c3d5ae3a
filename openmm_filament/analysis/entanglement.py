"""Entanglement of polygonal curves: Gauss linking integral and writhe, exact for straight segments.

Conventions
-----------
The Gauss integral of curves x and y is `1/(4 pi) int int (x - y).(dx x dy)/|x - y|^3`. A right-handed crossing counts
positive: seen along any line of sight, the strand in front is turned counter-clockwise, by less than half a turn, into the
direction of the one behind. Closed curves linked by 2 n right-handed crossings more than left-handed ones have n. A mirror
image has the opposite sign, and so has one curve run backwards; rotation, shift and scale change nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from openmm_filament import _checks as check
from openmm_filament.analysis.chains import common_frames, curve_points
from openmm_filament.analysis.solid_angles import solid_angles
from openmm_filament.geometry import segments

__all__ = ["linking", "writhe"]

Array = NDArray[np.float64]

_PAIRS = 2**14
"""Pairs of segments worked on at a time: arrays of an eighth of a megabyte, which stay in a cache."""

_ROWS = 32
"""Segments taken against all that follow them when a curve meets itself: of such a square, half is wasted."""


def linking(first: Any, second: Any, *, closed: bool | tuple[bool, bool] = False) -> Array:
    """Gauss linking integral of two polygonal curves: an integer to rounding where both are closed.

    Each pair of segments adds the solid angle, over 4 pi, of the parallelogram of the vectors from one to the other
    (Banchoff, Indiana Univ. Math. J. 25, 1171, 1976; Klenin and Langowski, Biopolymers 54, 307, 2000). It is taken from one
    arctangent for each pair, which keeps its digits for far and for near segments; see `analysis.solid_angles`.

    Parameters
    ----------
    first, second : (N, 3) or (T, N, 3) array, or mdtraj.Trajectory of one chain
        Points along each curve, whole, not wrapped into a periodic box, in any one unit of length; T frames, or one that
        stands for all. Chains of one trajectory: `linking(*split_chains(frames))`.
    closed : bool or (bool, bool)
        Whether a last segment runs from the last point to the first, of both or of each; do not repeat the first point.

    Returns
    -------
    () or (T,) array
        The integral of each frame.

    Raises
    ------
    ValueError
        If shapes do not fit, a coordinate is not finite, successive points coincide, or the curves touch, which leaves open
        on what side they pass, and the integral by 1. That is told from rounding down to about 1e-14 of a segment's length,
        to 1e-7 where segments run side by side.

    Notes
    -----
    Some 0.1 us a pair of segments, in memory that does not grow with their number.

    Examples
    --------
    >>> ring = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    >>> hooked = np.array([[0.0, 0, 1], [0, 0, -1], [3, 0, -1], [3, 0, 1]])
    >>> linking(ring, hooked, closed=True).round(12)
    np.float64(-1.0)
    """
    ends = closed if isinstance(closed, tuple) else (closed, closed)
    if len(ends) != 2 or not all(isinstance(end, (bool, np.bool_)) for end in ends):
        raise check.fail("closed", "be True, False or a tuple of two of them", repr(closed))
    p, framed = _polygon("first", first, ends[0])
    q, also = _polygon("second", second, ends[1])
    total = np.zeros(common_frames(p, q))
    p, q = (np.broadcast_to(x, (len(total), *x.shape[1:])) for x in _near_one(p, q))
    count, columns = p.shape[1] - 1, q.shape[1] - 1
    rows = max(1, min(count, _PAIRS // columns))
    for frames, i in _blocks(len(total), count, rows, columns):
        angles = solid_angles(p[frames, i.start : i.stop + 1], q[frames], (frames.start, i.start, 0), None)
        total[frames] += angles.sum(axis=(1, 2))
    result = total / (4 * np.pi)
    return result if framed or also else result[0]


def writhe(curve: Any, *, closed: bool = False) -> Array:
    """Writhe of a polygonal curve: its Gauss integral with itself, 0 for planar curves.

    It is the signed number of crossings, averaged over all directions of view. Neighbouring segments lie in a plane and
    add nothing. For a closed ribbon, `Lk = Tw + Wr`.

    Parameters
    ----------
    curve : (N, 3) or (T, N, 3) array, or mdtraj.Trajectory of one chain
        As for `linking`.
    closed : bool
        Whether a last segment runs from the last point to the first.

    Returns
    -------
    () or (T,) array
        The writhe of each frame.

    Raises
    ------
    ValueError
        As `linking` does; here where segments that are not neighbours touch.

    Examples
    --------
    >>> turns = np.linspace(0, 20 * np.pi, 601)
    >>> helix = np.stack([np.cos(turns), np.sin(turns), 0.3 * turns], axis=-1)
    >>> writhe(helix).round(2)
    np.float64(6.44)
    """
    if not isinstance(closed, (bool, np.bool_)):
        raise check.fail("closed", "be True or False", repr(closed))
    x, framed = _polygon("curve", curve, bool(closed))
    (x,) = _near_one(x)
    count = x.shape[1] - 1
    total = np.zeros(len(x))
    rows = max(1, min(_ROWS, _PAIRS // count))
    for frames, i in _blocks(len(x), count, rows, count):
        j = np.arange(i.start + 2, count)
        if not len(j):
            continue
        row = np.arange(i.start, i.stop)[:, None]
        neighbours = (j < row + 2) | (closed & (row == 0) & (j == count - 1))
        place = (frames.start, i.start, i.start + 2)
        total[frames] += solid_angles(x[frames, i.start : i.stop + 1], x[frames, i.start + 2 :], place, neighbours).sum(
            axis=(1, 2)
        )
    result = total / (2 * np.pi)
    return result if framed else result[0]


def _polygon(name: str, curve: Any, closed: bool) -> tuple[Array, bool]:
    """The corners (T, n + 1, 3) of n segments, the first again at the end where it is closed."""
    x, framed = curve_points(name, curve, 3 if closed else 2)
    if closed:
        x = np.concatenate([x, x[:, :1]], axis=1)
    still = ~segments(x).any(axis=-1)
    if still.any():
        frame, point = (int(i) for i in np.argwhere(still)[0])
        after = 0 if closed and point == x.shape[1] - 2 else point + 1
        raise ValueError(
            f"Argument `{name}` must keep successive points apart, but points {point} and {after} coincide in frame {frame}."
        )
    return x, framed


def _near_one(*curves: Array) -> tuple[Array, ...]:
    """Curves in one unit of their own size, a power of two, which rounds nothing: products of six lengths stay in range."""
    _, exponent = np.frexp(max(np.abs(x).max() for x in curves))
    return tuple(np.ldexp(x, -exponent) for x in curves)


def _blocks(frames: int, count: int, rows: int, columns: int) -> Iterator[tuple[slice, slice]]:
    """Blocks of frames and of segments of the first curve, each of about `_PAIRS` pairs."""
    together = max(1, _PAIRS // (min(rows, count) * columns))
    for i in range(0, count, rows):
        for frame in range(0, frames, together):
            yield slice(frame, min(frame + together, frames)), slice(i, min(i + rows, count))
