"""Solid angles of pairs of straight segments: 4 pi times what a pair adds to a Gauss linking integral."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from openmm_filament.geometry import cross, dot

__all__ = ["solid_angles"]

Array = NDArray[np.float64]

_NEAR = 0.1
"""A pair is worked out again by its corners where the real part in `solid_angles`, at most 8 |a||b||c||d|, is less than this
times |a||b||c||d|: where it is near or seen under more than half a turn."""

_CLOSE = 0.01
"""So it is where a corner of a pair is shorter than this times the longest segment about."""

_TOUCHING = 1e-14
"""Real and imaginary part over |a||b||c||d|, and distance of two corners over a segment, that rounding may have made."""


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


def solid_angles(p: Array, q: Array, place: tuple[int, int, int], left_out: NDArray[np.bool_] | None) -> Array:
    """Solid angles (T, n, m) of segments of p (T, n + 1, 3) seen from those of q (T, m + 1, 3), right-handed ones positive.

    The vectors from a segment to another fill a parallelogram with corners a, b, c, d. Half its solid angle is the phase
    of `tr (1 + a)(1 + b)(1 + c)(1 + d)`, a to d standing for unit vectors times Pauli matrices (the geometric phase of a spin
    led round it). With lengths written |a| and put back,

    `Re = (|a||b| + a.b)(|c||d| + c.d) + (|b||c| + b.c)(|d||a| + d.a) - (|a||c| - a.c)(|b||d| - b.d)`,
    `Im = [a b c] (|a| + |b| + |c| + |d|)`,

    the triple product being that of any three corners in turn. Both vanish only where a corner lies on the other segment.
    Segments in `left_out` (n, m) add nothing; `place` is that of the block, for messages.

    Raises
    ------
    ValueError
        If segments touch, to rounding.
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
    angles: Array = np.arctan2(imaginary, real)
    angles *= 2
    near = real <= _NEAR * size
    reach = _CLOSE * max(float(np.abs(np.diff(z)).max()) for z in (np.moveaxis(x, -2, -1), y))
    if r.min() < reach:
        for corner in (a, b, c, d):
            near |= r[corner] < reach
    if left_out is not None:
        angles[:, left_out] = 0.0
        near &= ~left_out
    if near.any():
        t, i, j = np.nonzero(near)
        corners = [q[t, j + n] - p[t, i + m] for m, n in ((0, 0), (1, 0), (1, 1), (0, 1))]
        noise = _TOUCHING * size[near]
        lengths = [np.sqrt(dot(x, x)) for x in (*corners, corners[1] - corners[0], corners[2] - corners[1])]
        whole = _volumes(corners, np.argmin(lengths[:4], axis=0)) * np.sum(lengths[:4], axis=0)
        angles[near] = 2 * np.arctan2(whole, real[near])
        touching = (np.abs(whole) <= noise) & (real[near] <= noise)
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


def _volumes(corners: list[Array], shortest: NDArray[np.int64]) -> Array:
    """Triple products (n,) of three corners in turn, the shortest in their middle: another three would round more."""
    ordered = np.stack(corners)
    each = np.arange(len(shortest))
    before, middle, after = (ordered[(shortest + k) % 4, each] for k in (-1, 0, 1))
    return np.asarray(dot(middle, cross(after, before)))


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
