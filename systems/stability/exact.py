"""Forces in 50 digits at the very doubles of the positions, by differences of the energies alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import mpmath as mp
import numpy as np
from numpy.typing import NDArray

from openmm_filament import bending, stretching, torsion
from openmm_filament._term import Interaction

__all__ = ["error", "forces", "natural"]

Array = NDArray[np.float64]
Points = list[list[Any]]
Numbers = dict[str, Any]

_STEP = "1e-20"
"""Displacement, nm, of central differences: their error is its square, their rounding 50 digits less its 20."""

_FLOOR = 1e-11
"""Part of the natural force (a strain or an angle of one) that an error is at least divided by: at rest there is no force,
and the rounding of coordinates makes one of 1e-15 or so of it."""


def _steps(x: Points) -> Points:
    return [[q - p for p, q in zip(a, b, strict=True)] for a, b in pairwise(x)]


def _dot(a: list[Any], b: list[Any]) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: list[Any], b: list[Any]) -> list[Any]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _norm(a: list[Any]) -> Any:
    return mp.sqrt(_dot(a, a))


def _bend(s: list[Any], t: list[Any]) -> Any:
    return mp.atan2(_norm(_cross(s, t)), _dot(s, t))


def _dihedral(x: Points) -> Any:
    s, t, u = _steps(x)
    p, q = _cross(s, t), _cross(t, u)
    return mp.atan2(_dot(s, q) * _norm(t), _dot(p, q))


def _stretched(x: Points, p: Numbers) -> Any:
    return p["k"] / 2 * (_norm(_steps(x)[0]) - p["r0"]) ** 2


def _bent(x: Points, p: Numbers) -> Any:
    return p["alpha"] / 2 * (_bend(*_steps(x)) - p["beta0"]) ** 2


def _cosine(x: Points, p: Numbers) -> Any:
    s, t = _steps(x)
    return -p["alpha"] * _dot(s, t) / (_norm(s) * _norm(t))


def _twisted(x: Points, p: Numbers) -> Any:
    d = _dihedral(x) - p["tau0"]
    return p["c"] / 2 * (d - 2 * mp.pi * mp.nint(d / (2 * mp.pi))) ** 2


def _periodic(x: Points, p: Numbers) -> Any:
    return p["k"] * (1 - mp.cos(p["n"] * (_dihedral(x) - p["tau0"])))


def _weighted(x: Points, p: Numbers) -> Any:
    u, v, w = ([c / _norm(s) for c in s] for s in _steps(x))
    a, b = _cross(u, v), _cross(v, w)
    return -p["k"] * (_dot(a, b) * mp.cos(p["tau0"]) + _dot(v, _cross(a, b)) * mp.sin(p["tau0"]))


_ENERGIES: dict[type, Callable[[Points, Numbers], Any]] = {
    stretching.Harmonic: _stretched,
    bending.Harmonic: _bent,
    bending.ArctangentHarmonic: _bent,
    bending.Cosine: _cosine,
    torsion.Harmonic: _twisted,
    torsion.Periodic: _periodic,
    torsion.Weighted: _weighted,
}


def forces(interactions: Sequence[Interaction], positions: Array) -> Array:
    """Forces (N, 3) of all terms on all beads, in their own units; each number is rounded once, at the end."""
    with mp.workdps(50):
        total = [[mp.mpf(0)] * 3 for _ in positions]
        step = mp.mpf(_STEP)
        for interaction in interactions:
            energy = _ENERGIES[interaction.term]
            for i, beads in enumerate(interaction.beads):
                numbers = {name: mp.mpf(float(values[i])) for name, values in interaction.parameters.items()}
                x = [[mp.mpf(float(c)) for c in positions[bead]] for bead in beads]
                for local, bead in enumerate(beads):
                    for axis in range(3):
                        kept = x[local][axis]
                        x[local][axis] = kept + step
                        above = energy(x, numbers)
                        x[local][axis] = kept - step
                        total[bead][axis] -= (above - energy(x, numbers)) / (2 * step)
                        x[local][axis] = kept
        return np.array([[float(c) for c in row] for row in total])


def natural(interactions: Sequence[Interaction], positions: Array) -> float:
    """The force that a strain or an angle of one would make."""
    largest = 0.0
    for interaction in interactions:
        pairs = interaction.beads[:, :2]
        lengths = np.linalg.norm(positions[pairs[:, 1]] - positions[pairs[:, 0]], axis=-1)
        largest = max(largest, interaction.stored_energy(float(lengths.min())) / float(lengths.min()))
    return largest


def error(found: Array, interactions: Sequence[Interaction], positions: Array) -> float:
    """The largest error of forces over the largest exact force (or 1e-11 of the natural one)."""
    right = forces(interactions, positions)
    scale = max(float(np.abs(right).max()), _FLOOR * natural(interactions, positions))
    return float(np.abs(found - right).max()) / scale
