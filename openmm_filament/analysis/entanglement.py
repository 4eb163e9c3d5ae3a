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
from openmm_filament.analysis.chains import curve_points
from openmm_filament.geometry import cross, dot, segments

__all__ = ["linking", "writhe"]

Array = NDArray[np.float64]

_PAIRS = 2**14
"""Pairs of segments worked on at a time: arrays of an eighth of a megabyte, which stay in a cache."""

_ROWS = 32
"""Segments taken against all that follow them when a curve meets itself: of such a square, half is wasted."""

_NEAR = 0.1
"""A pair is worked out again by its corners where the real part in `_solid_angles`, at most 8 |a||b||c||d|, is less than this
times |a||b||c||d|: where it is near or seen under more than half a turn."""

_TOUCHING = 1e-14
"""Real and imaginary part over |a||b||c||d|, and distance of two corners over a segment, that rounding may have made."""


def linking(first: Any, second: Any, *, closed: bool | tuple[bool, bool] = False) -> Array:
    """Gauss linking integral of two polygonal curves: an integer to rounding where both are closed.

    Each pair of segments adds the solid angle, over 4 pi, of the parallelogram of the vectors from one to the other
    (Banchoff, Indiana Univ. Math. J. 25, 1171, 1976; Klenin and Langowski, Biopolymers 54, 307, 2000). It is taken from one
    arctangent for each pair, which keeps its digits for far and for near segments; see `_solid_angles`.

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
    if len(ends) != 2:
        raise check.fail("closed", "be one or two of True and False", closed)
    p, framed = _polygon("first", first, ends[0])
    q, also = _polygon("second", second, ends[1])
    if len(p) != len(q) and 1 not in {len(p), len(q)}:
        raise ValueError(f"Argument `second` must have {len(p)} frames or one, but has {len(q)}.")
    total = np.zeros(max(len(p), len(q)))
    p, q = (np.broadcast_to(x, (len(total), *x.shape[1:])) for x in _near_one(p, q))
    count, columns = p.shape[1] - 1, q.shape[1] - 1
    rows = max(1, min(count, _PAIRS // columns))
    for frames, i in _blocks(len(total), count, rows, columns):
        angles = _solid_angles(p[frames, i.start : i.stop + 1], q[frames], (frames.start, i.start, 0), None)
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
    x, framed = _polygon("curve", curve, closed)
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
        total[frames] += _solid_angles(
            x[frames, i.start : i.stop + 1], x[frames, i.start + 2 :], place, neighbours
        ).sum(axis=(1, 2))
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


def _along(u: Array, v: Array) -> Array:
    """Scalar products over the first axis."""
    product: Array = np.einsum("k...,k...->...", u, v)
    return product


def _triple(u: Array, v: Array, w: Array) -> Array:
    """Triple products `u.(v x w)` of vectors with their components along the first axis."""
    product: Array = u[0] * (v[1] * w[2] - v[2] * w[1])
    product += u[1] * (v[2] * w[0] - v[0] * w[2])
    product += u[2] * (v[0] * w[1] - v[1] * w[0])
    return product


def _solid_angles(p: Array, q: Array, place: tuple[int, int, int], left_out: NDArray[np.bool_] | None) -> Array:
    """Solid angles (T, n, m) of segments of p (T, n + 1, 3) seen from those of q (T, m + 1, 3), right-handed ones positive.

    The vectors from a segment to another fill a parallelogram with corners a, b, c, d. Half its solid angle is the phase
    of `tr (1 + a)(1 + b)(1 + c)(1 + d)`, a to d standing for unit vectors times Pauli matrices (the geometric phase of a spin
    led round it). With lengths written |a| and put back,

    `Re = (|a||b| + a.b)(|c||d| + c.d) + (|b||c| + b.c)(|d||a| + d.a) - (|a||c| - a.c)(|b||d| - b.d)`,
    `Im = [a b c] (|a| + |b| + |c| + |d|)`,

    the triple product being that of any three corners in turn. Both vanish only where a corner lies on the other segment.
    Segments in `left_out` (n, m) add nothing; `place` is that of the block, for messages.
    """
    x, y = np.moveaxis(p, -1, 0)[..., :, None], np.moveaxis(q, -1, 0)[..., None, :]
    v = np.ascontiguousarray(y - x)
    r = np.sqrt(_along(v, v))
    a, b, c, d = (np.s_[..., :-1, :-1], np.s_[..., 1:, :-1], np.s_[..., 1:, 1:], np.s_[..., :-1, 1:])
    first = r[..., :-1, :] * r[..., 1:, :]
    first += _along(v[..., :-1, :], v[..., 1:, :])
    second = r[..., :-1] * r[..., 1:]
    second += _along(v[..., :-1], v[..., 1:])
    across, other = r[a] * r[c], r[b] * r[d]
    size = across * other
    across -= _along(v[a], v[c])
    other -= _along(v[b], v[d])
    across *= other
    real = first[..., :-1] * first[..., 1:]
    real += second[..., :-1, :] * second[..., 1:, :]
    real -= across
    sums = r[..., :-1] + r[..., 1:]
    imaginary = _triple(np.diff(y), np.diff(x, axis=-2), v[a])
    imaginary *= sums[..., :-1, :] + sums[..., 1:, :]
    angles = np.arctan2(imaginary, real)
    angles *= 2
    near = real <= _NEAR * size
    if left_out is not None:
        angles[:, left_out] = 0.0
        near &= ~left_out
    if near.any():
        t, i, j = np.nonzero(near)
        corners = [q[t, j + n] - p[t, i + m] for m, n in ((0, 0), (1, 0), (1, 1), (0, 1))]
        noise = _TOUCHING * size[near]
        lengths = [np.sqrt(dot(x, x)) for x in (*corners, corners[1] - corners[0], corners[2] - corners[1])]
        touching = (np.abs(imaginary[near]) <= noise) & (real[near] <= noise)
        touching |= np.min(lengths[:4], axis=0) <= _TOUCHING * np.max(lengths[4:], axis=0)
        if touching.any():
            k = int(np.argmax(touching))
            raise ValueError(
                f"The curves must not touch, but segments {i[k] + place[1]} and {j[k] + place[2]} do in frame "
                f"{t[k] + place[0]}."
            )
        turns = _exterior_angles(corners)
        angles[near] = 2 * np.pi * np.round((angles[near] + turns) / (2 * np.pi)) - turns
    return angles


def _exterior_angles(corners: list[Array]) -> Array:
    """Sums (n,) of the exterior angles of spherical quadrilaterals with corners (n, 3): 2 pi less the solid angle.

    Segments with a corner in common have a normal in common: what rounding does to it, near a corner that almost lies on
    the other curve, cancels in their sum.
    """
    normals = [cross(corner, corners[(k + 1) % 4]) for k, corner in enumerate(corners)]
    total = np.zeros(len(corners[0]))
    for k, corner in enumerate(corners):
        before, after = normals[k - 1], normals[k]
        total += np.arctan2(dot(corner, cross(before, after)) / np.sqrt(dot(corner, corner)), dot(before, after))
    return total
