"""Geometry of a chain of beads: segments, bending angles, torsions. Arrays in, arrays out; lengths in any one unit.

Conventions, used by the whole package
--------------------------------------
Beads are r_0 ... r_{N-1}; segment i runs from bead i to bead i+1, a closed chain having one more from the last bead to
the first. The bending angle beta is the angle between two successive segments, 0 on a straight chain (OpenMM's
`theta` is pi - beta). The torsion tau is the dihedral angle of four beads in (-pi, pi] with the sign of IUPAC and
OpenMM: 0 where the first and last bead lie on the same side (cis), positive for a right-handed helix.
It is the geometric torsion of the centre line, not the twist of a material.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["angle", "bending_angles", "chain_indices", "cross", "dihedrals", "dot", "segments", "unit_vectors"]

Array = NDArray[np.float64]


def chain_indices(beads: int, span: int, closed: bool = False) -> NDArray[np.int64]:
    """The runs of `span` successive beads: shape (beads - span + 1, span), or (beads, span) on a closed chain."""
    first = np.arange(beads if closed else max(beads - span + 1, 0))
    return (first[:, None] + np.arange(span)) % beads


def dot(a: Array, b: Array) -> Array:
    """Scalar products along the last axis: (..., 3), (..., 3) -> (...)."""
    product: Array = np.einsum("...i,...i->...", a, b)
    return product


def cross(a: Array, b: Array) -> Array:
    """Vector products along the last axis, three times faster than `numpy.cross` on long arrays."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def angle(sine: Array, cosine: Array) -> Array:
    """`arctan2`, for complex arguments with an infinitesimal imaginary part too (see `hessian`)."""
    if np.iscomplexobj(sine) or np.iscomplexobj(cosine):
        slope = (cosine.real * sine.imag - sine.real * cosine.imag) / (sine.real**2 + cosine.real**2)
        return np.asarray(np.arctan2(sine.real, cosine.real) + 1j * slope)
    return np.arctan2(sine, cosine)


def unit_vectors(vectors: Array) -> Array:
    """Vectors (..., 3) divided by their lengths."""
    return vectors / np.sqrt(dot(vectors, vectors))[..., None]


def segments(positions: Array, closed: bool = False) -> Array:
    """Segment vectors of a chain (..., N, 3): (..., N - 1, 3), or (..., N, 3) where it is closed."""
    if closed:
        return np.roll(positions, -1, axis=-2) - positions
    return np.diff(positions, axis=-2)


def bending_angles(triples: Array) -> Array:
    """Bending angles in [0, pi] of bead triples (..., 3, 3), by atan2: exact near 0 and near pi."""
    first = unit_vectors(triples[..., 1, :] - triples[..., 0, :])
    second = unit_vectors(triples[..., 2, :] - triples[..., 1, :])
    normal = cross(first, second)
    return angle(np.sqrt(dot(normal, normal)), dot(first, second))


def dihedrals(quadruples: Array) -> Array:
    """Torsions in (-pi, pi] of bead quadruples (..., 4, 3); meaningless where three beads are collinear."""
    s1, s2, s3 = (quadruples[..., i + 1, :] - quadruples[..., i, :] for i in range(3))
    p1, p2 = cross(s1, s2), cross(s2, s3)
    return angle(dot(s1, p2) * np.sqrt(dot(s2, s2)), dot(p1, p2))
