"""An open filament held at its first bead or its first two, in what its terms depend on: lengths, bends, torsions.

In them the energy of the terms is as good as quadratic, also where a nearly straight chain makes it all but singular in
Cartesian coordinates, and the work of the loads is smooth. The coordinates are those of an arm: each moves all beads
beyond it, by a shift along a segment or a turn about an axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from openmm_filament import bending, electrostatics, stretching, torsion
from openmm_filament._term import Interaction
from openmm_filament.geometry import bending_angles, cross, dihedrals, unit_vectors

__all__ = ["relaxed"]

Array = NDArray[np.float64]

_FURTHEST = 0.7
"""Largest change in one step: of a torsion in rad, of a length in segments, of the logarithm of a bend."""


def relaxed(
    positions: Array,
    interactions: Sequence[Interaction],
    loads: Array,
    *,
    most: int,
    tolerance: float,
    clamped: bool = False,
) -> tuple[Array, int]:
    """Positions (N, 3) of least energy near these, bead 0 staying where it is, and the steps taken; internal units.

    Parameters
    ----------
    loads : (N, 3) array
        Constant forces on the beads.
    tolerance : float
        Stops at a gradient this small over the largest load, lengths being counted in segments.
    clamped : bool
        Whether bead 1 stays, too.
    """
    arm = _Arm(positions)
    ways = arm.ways(clamped)
    unit_length = float(arm.lengths.mean())
    damping, steps = 0.0, 0
    energy, gradient, matrix = arm.derivatives(interactions, loads)
    scale, bends = arm.scales(unit_length), arm.bend_places
    enough = tolerance * float(np.abs(loads).max()) * unit_length
    while steps < most and float(np.abs(ways.T @ (gradient * scale)).max()) > enough:
        scaled = matrix * np.outer(scale, scale)
        scaled[bends, bends] += (gradient * scale)[bends]  # second derivatives by log(beta)
        step = _step(ways.T @ scaled @ ways, ways.T @ (gradient * scale), damping)
        steps += 1
        moved = arm.moved(ways @ step, unit_length) if step is not None else None
        if moved is not None:
            found = moved.derivatives(interactions, loads)
            rounding = 64 * np.finfo(float).eps * (abs(energy) + abs(found[0]))
            if found[0] < energy + rounding:
                flat = energy - found[0] < rounding
                if flat and np.linalg.norm(ways.T @ (found[1] * scale)) >= np.linalg.norm(ways.T @ (gradient * scale)):
                    break
                arm, (energy, gradient, matrix) = moved, found
                scale = arm.scales(unit_length)
                damping = damping / 8 if damping > 1e-14 else 0.0
                continue
        damping = max(4 * damping, 1e-14)
        if damping > 1e8:
            break
    return arm.positions, steps


def _step(matrix: Array, gradient: Array, damping: float) -> Array | None:
    """The damped Newton step, or None where the matrix is not positive definite."""
    size = float(np.abs(np.diag(matrix)).max())
    try:
        factor = linalg.cho_factor(matrix + damping * size * np.eye(len(matrix)), lower=True)
    except linalg.LinAlgError:
        return None
    return np.asarray(-linalg.cho_solve(factor, gradient))


class _Arm:
    """Lengths (n,), bends (n - 1,), torsions (n - 2,), and the frame of the first segment."""

    def __init__(self, positions: Array) -> None:
        s = np.diff(positions, axis=0)
        n = len(s)
        self.origin = positions[0]
        self.lengths = np.linalg.norm(s, axis=1)
        self.bends = bending_angles(np.stack([positions[i : i + 3] for i in range(n - 1)])) if n > 1 else np.zeros(0)
        quads = np.stack([positions[i : i + 4] for i in range(n - 2)]) if n > 2 else np.zeros((0, 4, 3))
        self.torsions = dihedrals(quads)
        self.frame = _frame(s)
        self._build()

    def _build(self) -> None:
        """Positions, and the direction and normal of every segment's end."""
        n = len(self.lengths)
        tangent, normal = self.frame
        self.tangents, self.normals = np.empty((n, 3)), np.empty((max(n - 1, 0), 3))
        self.tangents[0] = tangent
        for i in range(n - 1):
            if i:
                c, s = np.cos(self.torsions[i - 1]), np.sin(self.torsions[i - 1])
                normal = c * normal + s * cross(tangent, normal)
            tangent = np.cos(self.bends[i]) * tangent + np.sin(self.bends[i]) * cross(normal, tangent)
            self.tangents[i + 1], self.normals[i] = tangent, normal
        steps = self.lengths[:, None] * self.tangents
        self.positions = self.origin + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    def scales(self, unit_length: float) -> Array:
        """Derivatives of the coordinates by those that steps are taken in: lengths in segments, and log(beta)."""
        n = len(self.lengths)
        return np.concatenate([np.ones(3), np.full(n, unit_length), self.bends, np.ones(n - 2)])

    def ways(self, clamped: bool) -> Array:
        """The coordinates that may change, as columns: all, or of the first segment only the turn about itself."""
        n = len(self.lengths)
        every = np.eye(3 + n + (n - 1) + (n - 2))
        if not clamped:
            return every
        about = np.concatenate([self.frame[0], np.zeros(len(every) - 3)])
        return np.column_stack([about, every[:, 4:]])

    @property
    def bend_places(self) -> NDArray[np.int64]:
        """Where the bends stand among the coordinates."""
        n = len(self.lengths)
        return 3 + n + np.arange(n - 1)

    def moved(self, step: Array, unit_length: float) -> _Arm | None:
        """The arm after a step, the logarithms of the bends being moved; None where that is too far."""
        n = len(self.lengths)
        turn, longer, bent, twisted = np.split(step, [3, 3 + n, 2 + 2 * n])
        lengths = self.lengths + unit_length * longer
        if np.abs(step).max() > _FURTHEST or (lengths <= 0.2 * self.lengths).any():
            return None
        bends = self.bends * np.exp(bent)
        out = object.__new__(_Arm)
        out.origin, out.lengths, out.bends, out.torsions = self.origin, lengths, bends, self.torsions + twisted
        angle = float(np.linalg.norm(turn))
        rotated = linalg.expm(np.cross(np.eye(3), turn)) if angle else np.eye(3)
        out.frame = rotated @ self.frame[0], rotated @ self.frame[1]
        out._build()
        return out

    def derivatives(self, interactions: Sequence[Interaction], loads: Array) -> tuple[float, Array, Array]:
        """Energy, gradient and Hessian in the coordinates (three turns of the whole, lengths, bends, torsions)."""
        n = len(self.lengths)
        size = 3 + n + (n - 1) + max(n - 2, 0)
        gradient, matrix = np.zeros(size), np.zeros((size, size))
        energy = -float((loads * self.positions).sum())
        for interaction in interactions:
            energy += _inner(self, interaction, gradient, matrix)
        velocity, axes, beyond = self._velocities()
        # velocity (K, N, 3): how each coordinate moves each bead; those on which nothing acts are left out
        acting = np.flatnonzero(loads.any(axis=1))
        force, velocity = loads[acting], velocity[:, acting]
        gradient -= np.einsum("kba,ba->k", velocity, force)
        # d^2 r/dq_k dq_l = a_k x (dr/dq_l) for the turn k that comes first along the chain
        turned = np.einsum("ka,lba->klb", axes, cross(velocity, force[None]))
        second = turned.sum(axis=2)
        order = beyond[:, None] <= beyond[None, :]
        ordered = np.where(order, second, second.T)
        ordered[:3, :3] = (second[:3, :3] + second[:3, :3].T) / 2  # the turns of the whole are one rotation vector
        matrix -= ordered
        return energy, gradient, matrix

    def _velocities(self) -> tuple[Array, Array, Array]:
        """(K, N, 3) derivatives of the beads, (K, 3) axes of the turns (zero for shifts), (K,) places along the chain."""
        n = len(self.lengths)
        r, beads = self.positions, np.arange(n + 1)
        axes = [*np.eye(3), *np.zeros((n, 3)), *self.normals, *self.tangents[1 : n - 1]]
        points = [*np.tile(r[0], (3, 1)), *np.zeros((n, 3)), *r[1:n], *r[1 : n - 1]]
        # along the chain: a segment's length, the bend at its end, the next length, the torsion about that segment
        places = [0.0, 0.0, 0.0, *(np.arange(n) + 0.5), *np.arange(1, n), *(np.arange(1, n - 1) + 0.7)]
        first = [0, 0, 0, *range(n), *range(1, n), *range(1, n - 1)]
        axes_, points_ = np.array(axes), np.array(points)
        velocity = cross(axes_[:, None, :], r[None] - points_[:, None, :])
        velocity[3 : 3 + n] = self.tangents[:, None, :]
        velocity *= (beads[None, :] > np.array(first)[:, None])[..., None]
        return velocity, axes_, np.array(places)


def _frame(s: Array) -> tuple[Array, Array]:
    """Direction of the first segment, and the normal of the first bend (any, where it is straight)."""
    tangent = unit_vectors(s[0])
    for later in s[1:2]:
        normal = cross(tangent, later)
        if np.linalg.norm(normal) > 1e-12 * np.linalg.norm(later):
            return tangent, unit_vectors(normal)
    aside = np.eye(3)[int(np.argmin(np.abs(tangent)))]
    return tangent, unit_vectors(cross(tangent, aside))


def _inner(arm: _Arm, interaction: Interaction, gradient: Array, matrix: Array) -> float:
    """Adds the derivatives of one term to the gradient and the Hessian; returns its energy."""
    n, p = len(arm.lengths), interaction.parameters
    at_length, at_bend, at_torsion = 3 + np.arange(n), 3 + n + np.arange(n - 1), 2 + 2 * n + np.arange(n - 2)
    s, beta, tau = arm.lengths, arm.bends, arm.torsions
    place, energy, slope, curvature = at_length, 0.0 * s, 0.0 * s, 0.0 * s
    if interaction.term is stretching.Harmonic:
        d = s - p["r0"]
        energy, slope, curvature = p["k"] * d**2 / 2, p["k"] * d, p["k"]
    elif interaction.term is electrostatics.Neighbour:
        energy, slope, curvature = p["q"] / s, -p["q"] / s**2, 2 * p["q"] / s**3
    elif issubclass(interaction.term, bending.Harmonic):
        d, place = beta - p["beta0"], at_bend
        energy, slope, curvature = p["alpha"] * d**2 / 2, p["alpha"] * d, p["alpha"]
    elif interaction.term is bending.Cosine:
        place = at_bend
        energy, slope, curvature = -p["alpha"] * np.cos(beta), p["alpha"] * np.sin(beta), p["alpha"] * np.cos(beta)
    elif interaction.term is torsion.Harmonic:
        d, place = (tau - p["tau0"] + np.pi) % (2 * np.pi) - np.pi, at_torsion
        energy, slope, curvature = p["c"] * d**2 / 2, p["c"] * d, p["c"]
    elif interaction.term is torsion.Periodic:
        d, place = p["n"] * (tau - p["tau0"]), at_torsion
        energy = p["k"] * (1 - np.cos(d))
        slope, curvature = p["k"] * p["n"] * np.sin(d), p["k"] * p["n"] ** 2 * np.cos(d)
    else:
        return _weighted(arm, p, at_bend, at_torsion, gradient, matrix)
    gradient[place] += slope
    matrix[place, place] += curvature
    return float(np.sum(energy))


def _weighted(arm: _Arm, p: Any, at_bend: Any, at_torsion: Any, gradient: Array, matrix: Array) -> float:
    """-K sin(beta_1) sin(beta_2) cos(tau - tau0)."""
    d = arm.torsions - p["tau0"]
    s1, c1 = np.sin(arm.bends[:-1]), np.cos(arm.bends[:-1])
    s2, c2 = np.sin(arm.bends[1:]), np.cos(arm.bends[1:])
    k, c, s = p["k"], np.cos(d), np.sin(d)
    first, second = at_bend[:-1], at_bend[1:]
    np.add.at(gradient, first, -k * c1 * s2 * c)
    np.add.at(gradient, second, -k * s1 * c2 * c)
    gradient[at_torsion] += k * s1 * s2 * s
    np.add.at(matrix, (first, first), k * s1 * s2 * c)
    np.add.at(matrix, (second, second), k * s1 * s2 * c)
    matrix[at_torsion, at_torsion] += k * s1 * s2 * c
    for i, j, value in (
        (first, second, -k * c1 * c2 * c),
        (first, at_torsion, k * c1 * s2 * s),
        (second, at_torsion, k * s1 * c2 * s),
    ):
        np.add.at(matrix, (i, j), value)
        np.add.at(matrix, (j, i), value)
    return float(np.sum(-k * s1 * s2 * c))
